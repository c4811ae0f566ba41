"""How large an effect is: the gap it makes, in units of a perfect fit's residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import nominal
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects import Effect, Scale
from hybrid.errors import HybridError
from hybrid.plant import Noise, Plant, Reference
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.robot import Robot

_CLOSE = 0.1  # of the size asked for
_TRIES = 4
_LEAST = 0.15  # of a declared number, three times what it may be off by
_MOST_LINK, _MOST_PAYLOAD = 0.5, 0.25  # of the masses of link and arm


@dataclass(frozen=True)
class Rig:
    """The arm of a file on a short motion, to try effects on.

    Attributes:
        robot: The arm.
        reference: The motion.
        cutoff: Cut-off that its recording is filtered with, [Hz].
        floor: Residual of a perfect fit, RMS, shape (n,), [N·m].
        bare: The same without noise, shape (n,), [N·m].
        torque: Torque along the motion, shape (N, n), [N·m].
    """

    robot: Robot
    reference: Reference
    cutoff: float
    floor: Array
    bare: Array
    torque: Array

    @classmethod
    def build(
        cls, robot: Robot, reference: Reference, noise: Noise, rng: np.random.Generator
    ) -> Rig:
        """Run the arm without any effect, without noise and with it."""
        (clean,) = _perfect(robot, ()).run([reference], seed=rng)
        signals = {"q": clean.q, "v": clean.v, "tau": clean.tau}
        assert clean.v is not None
        noisy = noise.apply(signals, rate=_rate(clean), rng=rng)  # type: ignore[arg-type]
        seen = measure_gap(robot, [_with(clean, noisy)])
        bare = gap_rms(measure_gap(robot, [clean], cutoff=seen.cutoff))
        return cls(robot, reference, seen.cutoff, gap_rms(seen), bare, clean.tau)

    @property
    def scales(self) -> tuple[Scale, ...]:
        """Rated torque and speed of each joint."""
        return joint_scales(self.robot)

    def sizes(self, *effects: Effect) -> Array:
        """Gap at each joint over the residual of a perfect fit there, shape (n,)."""
        plant = _perfect(self.robot, effects)
        run = plant.run([self.reference], seed=np.random.default_rng(0))
        rms = gap_rms(measure_gap(self.robot, run, cutoff=self.cutoff))
        excess = np.sqrt(np.maximum(rms**2 - self.bare**2, 0.0))
        return np.asarray(excess / np.maximum(self.floor, 1e-12))

    def scaled(self, effect: Effect, size: float) -> Effect | None:
        """The effect at some size at the joint where it is largest.

        Returns:
            Nothing if only a value that is not plausible has that size.
        """
        for _ in range(_TRIES):
            try:
                now = float(self.sizes(effect).max())
            except HybridError:  # the plant swings up
                return None
            if now <= 0:
                return None
            if abs(now / size - 1.0) < _CLOSE:
                return effect
            effect = effect.at(larger(effect, size / now))
            if not self.plausible(effect):
                return None
        return None

    def plausible(self, effect: Effect) -> bool:
        """Whether all values are within physical bounds, and none is background.

        What changes a number of the file by no more than the file may be off by anyway
        is no effect; and none is more than the part of the arm that it changes.
        """
        scale, j = self.scales[effect.joints[-1]], effect.joints[-1]
        bounds = [x.scaled(scale) for x in (*effect.gains, *effect.shapes)]
        if not all(x.lower <= effect.values[x.name] <= x.upper for x in bounds):
            return False
        robot, masses = self.robot, self.robot.chain.inertial[:, 0]
        declared, first = effect.declared(nominal(robot)), abs(effect.gain_values[0])
        if declared is not None:
            return bool(first >= _LEAST * declared[j])
        most = {
            "asymmetric_friction": robot.frictionloss[j],  # friction never pushes
            "link_inertia": _MOST_LINK * masses[j],
            "payload": _MOST_PAYLOAD * masses.sum(),
        }
        return bool(first <= most.get(effect.id, np.inf))


def larger(effect: Effect, factor: float) -> Mapping[str, float]:
    """The values by which an effect is ``factor`` times as large."""
    return {g.name: factor * effect.values[g.name] for g in effect.gains}


def gap_rms(gap: Gap) -> Array:
    """RMS of a gap where joints move, shape (n,), [N·m]."""
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    return np.asarray(
        np.sqrt(squares.sum(axis=0) / np.maximum(gap.moving.sum(axis=0), 1))
    )


def _perfect(robot: Robot, effects: Sequence[Effect]) -> Plant:
    return Plant(robot, effects, nominal=robot, noise=Noise.none(robot.size))


def _rate(recording: Recording) -> float:
    return float((len(recording.t) - 1) / recording.duration)


def _with(recording: Recording, signals: Mapping[str, Array]) -> Recording:
    from dataclasses import replace

    return replace(recording, q=signals["q"], v=signals["v"], tau=signals["tau"])
