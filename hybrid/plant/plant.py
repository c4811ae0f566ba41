"""The simulated arm with controller and sensors."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.errors import HybridError, warn
from hybrid.plant.arm import Arm, build_arm, drives, encoder_readings, overrides
from hybrid.plant.joint_fields import curves
from hybrid.plant.lockstep import Lockstep
from hybrid.plant.noise import Noise
from hybrid.plant.reference import Reference
from hybrid.plant.servo import Servo
from hybrid.recording.recording import Recording
from hybrid.robot.robot import Robot

_SETTLE = 0.5  # s before a record, in which the servo settles under gravity
_OFTEN_SATURATED = 0.01  # of the time, from which a warning is given


@dataclass(frozen=True, eq=False)
class Plant:
    """A MuJoCo arm with effects, a controller and sensors.

    It has the links, friction and rotors of the robot file, and the effects. The logged
    torque is the commanded one, at the instant of the logged position and speed.

    Attributes:
        robot: The true arm.
        effects: Effects that the robot file does not have.
        nominal: The arm that the controller knows; ``robot`` by default.
        noise: Sensor noise; usual values by default.
        servo: Controller; by default tuned to the arm, with feed-forward of the
            dynamics of ``nominal``.
        step: Physics step, [s].
        control_rate: Samples of the controller per second, [Hz].
        log_rate: Samples of the recording per second, [Hz].
        integrator: ``implicitfast``, ``implicit``, ``euler`` or ``rk4``.

    Raises:
        HybridError: The rates do not divide each other, or the arm cannot be built.
    """

    robot: Robot
    effects: Sequence[Effect] = ()
    nominal: Robot | None = None
    noise: Noise | None = None
    servo: Servo | None = None
    step: float = 0.0005
    control_rate: float = 1000.0
    log_rate: float = 500.0
    integrator: str = "implicitfast"
    arm: Arm = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        robot, n, effects = self.robot, self.robot.size, tuple(self.effects)
        arm = build_arm(robot, effects, step=self.step, integrator=self.integrator)
        _ratio("control_rate", 1.0 / self.step, self.control_rate)
        _ratio("log_rate", self.control_rate, self.log_rate)
        nominal, noise = self.nominal or robot, self.noise or Noise.typical(robot)
        servo, period, lag = self.servo, 1.0 / self.control_rate, np.zeros(n)
        if servo is None:
            for effect in effects:
                lag[list(effect.joints)] += effect.actuator.get("lag", 0.0)
            servo = Servo.tuned(arm, nominal, period=period, lag=lag)
        if len(noise.torque_covariance) != n or len(servo.kp) != n:
            raise HybridError(f"noise and servo need {n} joints, as the robot has")
        made = {"effects": effects, "arm": arm, "nominal": nominal, "noise": noise}
        for name, x in (made | {"servo": servo}).items():
            object.__setattr__(self, name, x)

    def run(
        self, references: Sequence[Reference], *, seed: int | np.random.Generator = 0
    ) -> list[Recording]:
        """Follow references, all at the same time, and log.

        Args:
            references: B motions to follow, of any lengths.
            seed: Seed or generator of the noise; the motion itself is not random.

        Returns:
            One recording for each reference.

        Raises:
            HybridError: A reference has other joints, or the simulation diverges.

        Warns:
            HybridWarning: A drive was at its torque limit too often.
        """
        n, recordings = self.robot.size, []
        if not references or any(r.q.shape[1] != n for r in references):
            raise HybridError(f"one reference or more of {n} joints is needed")
        clock, signals = self._simulate(references)
        children = np.random.default_rng(seed).spawn(len(references))
        for k, (reference, child) in enumerate(zip(references, children, strict=True)):
            t = clock[: 1 + _samples(reference, self.log_rate)].copy()
            log = {name: x[: len(t), k].copy() for name, x in signals.items()}
            source = f"simulated {self.robot.name}, trajectory {k + 1}"
            log, joints = self._measured(t, log, child), self.robot.joints
            q, tau, v, command = (log[x] for x in ("q", "tau", "v", "command"))
            made = Recording(t, q, tau, v, command, joints=joints, source=source)
            recordings.append(made)
        return recordings

    def _simulate(
        self, references: Sequence[Reference]
    ) -> tuple[Array, dict[str, Array]]:
        """Clock (N,) and the true signals, shape (N, B, n), of the longest run."""
        servo, every = self.servo, round(self.control_rate / self.log_rate)
        assert servo is not None  # a plant has made it
        substeps = round(1.0 / (self.step * self.control_rate))
        before = round(_SETTLE * self.control_rate)
        samples = 1 + max(_samples(r, self.log_rate) for r in references)
        t = (np.arange((samples - 1) * every + 1 + before) - before) / self.control_rate
        plans = [servo.plan(reference, t) for reference in references]
        command = np.stack([q for q, _, _ in plans], axis=1)
        q_ref, v_ref, feed = (
            np.stack([self._commanded(t, x) for x in signal], axis=1)
            for signal in zip(*plans, strict=True)
        )
        kp, kd = self._gains(servo)
        effects = [*self.effects, *curves(self.robot)]
        state = Lockstep(self.arm, effects, q_ref[0], time=t[0])
        weight, lead = self._alignment(substeps)
        log = {x: np.empty((samples, *q_ref.shape[1:])) for x in ("q", "v", "tau")}
        torque, least, most = feed[0], -servo.limit, servo.limit
        saturated = np.empty(q_ref.shape, dtype=bool)
        sensing = [e for e in self.effects if overrides(e, "sense")]
        for k in range(len(t)):
            q, v = encoder_readings(sensing, state.q, state.v)
            wanted = feed[k] + kp * (q_ref[k] - q) + kd * (v_ref[k] - v)
            previous = torque
            torque = np.minimum(np.maximum(wanted, least), most)
            np.not_equal(torque, wanted, out=saturated[k])
            sample, rest = divmod(k - before, every)
            if sample >= 0 and rest == 0:
                log["q"][sample], log["v"][sample] = encoder_readings(
                    sensing, state.q, state.v + lead * state.a
                )
                log["tau"][sample] = weight * previous + (1 - weight) * torque
            state.step(torque, substeps)
        self._warn_of_saturation(saturated.mean(axis=(0, 1)))
        return t[before::every], log | {"command": command[before::every]}

    def _commanded(self, t: Array, signal: Array) -> Array:
        """A commanded signal as the controller receives it, shape (M, n)."""
        signal = signal.copy()
        for effect in self.effects:
            if late := effect.actuator.get("latency"):
                for j in effect.joints:
                    signal[:, j] = np.interp(t - late, t, signal[:, j])
        return signal

    def _gains(self, servo: Servo) -> tuple[Array, Array]:
        """True stiffness and damping of the servo, shape (n,)."""
        kp, kd = servo.kp.copy(), servo.kd.copy()
        for effect in self.effects:
            j, changed = list(effect.joints), effect.actuator
            kp[j] *= changed.get("stiffness", 1.0)
            kd[j] *= changed.get("damping", 1.0)
        return kp, kd

    def _alignment(self, substeps: int) -> tuple[float, float]:
        """Alignment of the logged torque and speed with the instant of the position.

        The semi-implicit step relates the torque of step k to the second difference of
        position *around* sample k. So a torque held over m steps is centred (m − 1)/2
        steps after the first; a weight of (m − 1)/2m of the previous torque centres the
        sum on the sample. Speed lags by half a step, the second result, [s]. Runge-
        Kutta steps use the torque between samples and have the speed at them.
        """
        if self.integrator == "rk4":
            return 0.5, 0.0
        return (substeps - 1) / (2 * substeps), self.step / 2

    def _measured(
        self, t: Array, log: dict[str, Array], rng: np.random.Generator
    ) -> dict[str, Array]:
        """What is logged of the true signals of a trajectory, shape (N, n) each."""
        assert self.noise is not None  # a plant has made it
        for effect in self.effects:
            # An effect that changes the delivered torque leaves the logged one as it
            # is: its `report`, which a fit uses, must not be applied again.
            if overrides(effect, "measure") or not drives(effect):
                log = effect.measure(t, log)
        return self.noise.apply(log, rate=self.log_rate, rng=rng)

    def _warn_of_saturation(self, share: Array) -> None:
        for name, part in zip(self.robot.joints, share, strict=True):
            if part > _OFTEN_SATURATED:
                warn(
                    f"the drive of {name!r} was at its torque limit for {part:.0%} of "
                    "the time; use a slower reference"
                )


def _samples(reference: Reference, rate: float) -> int:
    return round(float(reference.t[-1]) * rate)


def _ratio(name: str, faster: float, slower: float) -> None:
    ratio = faster / slower if slower > 0 else 0.0
    if not (ratio >= 0.999 and np.isclose(ratio, round(ratio), rtol=1e-6)):
        raise HybridError(
            f"{name} is {slower:g} Hz, {faster:g} Hz divided by a whole number is valid"
        )
