"""What an effect with a memory of its own remembers during one run of a plant."""

from __future__ import annotations

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect, JointState


def past(effect: Effect, state: JointState, *names: str) -> dict[str, Array]:
    """Arrays of the state's shape that an effect keeps from step to step.

    They are zero at the start. A clock that does not run on is a new run.

    Args:
        effect: The effect; the memory hangs on this object.
        state: What it sees in this step.
        *names: Names of the arrays.
    """
    memory: dict[str, Array] = effect.__dict__.setdefault("_past", {})
    clock, now = memory.get("clock"), state.t
    if clock is None or clock.shape != now.shape or clock.flat[0] >= now.flat[0]:
        memory.update({name: np.zeros_like(state.q) for name in names})
    memory["clock"] = now.copy()
    return memory
