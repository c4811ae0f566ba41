"""A model of the healthy arm as the simulator, to diagnose what has changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import Effect, effect_classes
from hybrid.effects.instant import FRICTION
from hybrid.identification.preparation import motions_from_logs
from hybrid.model import DynamicModel
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler
from hybrid.signals.bandwidth import band_of

_LACKS = (
    "the model has no {}: it may always have lacked it. Diagnose other logs of the "
    "healthy arm against it: what is found there, too, has not changed"
)


@dataclass(frozen=True, eq=False)
class Baseline:
    """A model of the healthy arm, whose torque is subtracted from the logs.

    The model's friction, ripple and remainder are subtracted. The torque of its links
    and of all that has changed is left.
    """

    model: DynamicModel

    @cached_property
    def robot(self) -> Robot:
        """The arm with the model's links, if the model has physical ones."""
        robot, known = self.model.robot, self.model.inertial
        return robot if known is None else robot.with_inertial(known)

    @property
    def inborn(self) -> list[str]:
        """Ids of effects that a healthy arm cannot acquire."""
        return [x.id for x in effect_classes().values() if x.inborn]

    def subtract_from(
        self, logs: Sequence[Recording | Motion]
    ) -> tuple[list[Recording | Motion], float]:
        """Logs without the model's torque, and the bandwidth of theirs, [Hz]."""
        motions, _ = motions_from_logs(logs, self.model.cutoff)
        whole = [self.model.predict(m) for m in motions]
        band = band_of(motions, whole, self.model.cutoff)
        pairs = zip(logs, motions, strict=True)
        return [
            replace(x, tau=x.tau - Sampler(m.rate, band, 1)(self._torque(m)))
            for x, m in pairs
        ], band

    def with_subtracted(self, gap: Gap) -> Gap:
        """A gap that knows the subtracted torque, which may be slightly wrong."""
        return replace(gap, healthy=tuple(map(self._torque, gap.motions)))

    def doubts(self, found: Sequence[Effect]) -> list[str]:
        """What may be no change: effects that the model could not have had before."""
        lacks = [e.id.replace("_", " ") for e in found if not self._could_have(e)]
        return [_LACKS.format(", ".join(dict.fromkeys(lacks)))] if lacks else []

    def _could_have(self, effect: Effect) -> bool:
        """Whether the model, or its fit, has a term for what an effect does."""
        # Links take what a payload or a tilt does, friction terms what friction does.
        # Of ripples it has the strongest, and a contact happens once.
        rigid = effect.rigid_change(self.robot.size, self.robot.chain.gravity)
        fields = set(effect.fields.values())
        drag = bool(fields) and fields <= {*FRICTION} and not effect.memory
        own = [(e.id, e.joints) for e in self.model.effects if e.repeats != "joint"]
        once = effect.repeats == "recording"
        known = (effect.id, effect.joints) in own
        return rigid is not None or drag or once or known

    def _torque(self, motion: Motion) -> Array:
        """Torque of the model's effects and remainder, shape (N, n), [N·m]."""
        body = RigidBody(self.robot.chain, motion)
        return self.model.predict(motion) - simulated_torque(self.robot, motion, body)
