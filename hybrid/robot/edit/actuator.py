"""Changes of a joint's drive, in terms of a simulator's actuator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf


@dataclass(frozen=True)
class Actuator:
    """Changes of an actuator, at the joint.

    Attributes:
        gain: Factor of the torque that it is asked for.
        lag: Time constant with which its torque follows, [s].
        limit: Largest torque, [N·m].
        latency: By how much commands act later, [s].
        stiffness: Factor of the stiffness of a position servo.
        damping: Factor of its damping.
    """

    gain: float = 1.0
    lag: float = 0.0
    limit: float = inf
    latency: float = 0.0
    stiffness: float = 1.0
    damping: float = 1.0

    def and_then(self, other: Mapping[str, float]) -> Actuator:
        """Combine with further changes, given by name."""
        new = {}
        for name, x in other.items():
            own = getattr(self, name)
            if name == "limit":
                new[name] = min(own, x)
            elif name in ("gain", "stiffness", "damping"):
                new[name] = own * x
            else:
                new[name] = own + x
        return replace(self, **new)
