"""Batches of open-loop replays in MuJoCo."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.robot import Robot
from hybrid.servo.drive import Drive
from hybrid.servo.model import (
    bristles,
    declared_spec,
    install,
    lay_ground,
    places,
    servo_spec,
    weight,
)
from hybrid.servo.noise import INEXACT
from hybrid.servo.stretch import Stretch

_HALVINGS = 4  # of the step, at most
_MODELS = 64  # compiled models in the cache
_STEP = 0.005  # s: longest step of the physics
_ONLY_HERE = "play", "load_friction", "quadratic"  # MJX lacks it
_STEPPED = "dead_band", "play", "load_friction"  # servos of MuJoCo lack it
_SPARE = 0.1  # steps: clocks are not exact, so that as much more takes no step more


@dataclass(frozen=True, eq=False)
class Run:
    """One replay: a stretch and a model with its servos."""

    stretch: Stretch
    parts: int  # physics steps between two samples
    model: Any
    state: Array
    control: Array  # at every physics step, (·, n)
    drive: Drive

    @property
    def stepped(self) -> bool:
        """Whether the servos have what has to be set at every step."""
        return any(self.drive[name].any() for name in _STEPPED)

    @property
    def only_here(self) -> bool:
        """Whether a GPU cannot replay it."""
        return any(self.drive[name].any() for name in _ONLY_HERE)


class ServoSimulator:
    """Open-loop replays of an arm with servos, from the first state of a stretch.

    Args:
        robot: The arm.
        step: Longest step of the physics, [s].
        gpu: Replay on a GPU, except with the servos of the robot file.

    Raises:
        HybridError: A GPU is asked for, and none is there.
    """

    def __init__(self, robot: Robot, step: float = _STEP, *, gpu: bool = False) -> None:
        self.robot, self._longest, self.roll = robot, step, rolled
        if gpu:
            from hybrid.servo.accelerated import GpuRollout, check_gpu

            check_gpu()
            self.roll = GpuRollout(robot)
        self._declared = Drive.declared(robot)
        self._models: dict[tuple[float, bytes], Any] = {}
        self._weights: dict[tuple[Stretch, bytes], Array] = {}

    def with_step(self, step: float) -> ServoSimulator:
        """A copy with another longest step, [s]."""
        other = ServoSimulator(self.robot, step)
        other.roll = self.roll
        return other

    def replay(
        self, stretches: Sequence[Stretch], drives: Sequence[Drive | None]
    ) -> list[list[Array]]:
        """Replay every stretch with each of some servos.

        Args:
            stretches: Logs to replay.
            drives: Servos; or only None, for those of the robot file.

        Returns:
            Positions by drive and stretch, shape (N, n) each, [rad].
        """
        runs = self.runs(stretches, drives)
        moved: list[Array] = [np.empty(0)] * len(runs)
        for here in (False, True):  # what only MuJoCo's C can do, and the others
            own = [k for k, x in enumerate(runs) if x.only_here == here]
            roll = rolled if here or None in drives else self.roll
            rows = roll([runs[k] for k in own]) if own else ()
            for k, x in zip(own, rows, strict=True):
                moved[k] = self._seen(runs[k], x)
        size = len(stretches)
        return [moved[i : i + size] for i in range(0, len(moved), size)]

    def runs(
        self, stretches: Sequence[Stretch], drives: Sequence[Drive | None]
    ) -> list[Run]:
        """Prepare the replays of every stretch with each of some servos."""
        runs = []
        for drive in drives:
            models: dict[float, Any] = {}  # by step
            runs += [self._run(drive, stretch, models) for stretch in stretches]
        return runs

    def _run(
        self, drive: Drive | None, stretch: Stretch, models: dict[float, Any]
    ) -> Run:
        parts = max(1, int(np.ceil(stretch.step / self._longest - _SPARE)))
        n = self.robot.size
        step, none = round(stretch.step / parts, 9), np.zeros(n)
        if step not in models:
            models[step] = self._model(drive, step)
        late, pace = (
            none if drive is None else drive[name] for name in ("delay", "pace")
        )
        control = goals(stretch, late, pace, parts)
        state = self._state(models[step], drive, stretch, control[0])
        return Run(
            stretch, parts, models[step], state, control, drive or self._declared
        )

    def _seen(self, run: Run, moved: Array) -> Array:
        after = moved[run.parts - 1 : len(run.control) : run.parts]
        return np.vstack([run.stretch.q[:1], after])

    def _model(self, drive: Drive | None, step: float) -> Any:
        key = step, _turned(drive)
        if key not in self._models:
            if len(self._models) > _MODELS:
                self._models.clear()
                self._weights.clear()
            self._models[key] = self._compiled(drive, step)
        model = copy.copy(self._models[key])
        if drive is not None:
            install(model, self.robot, drive)
        return model

    def _compiled(self, drive: Drive | None, step: float) -> Any:
        if drive is None:
            spec = declared_spec(self.robot)
        else:
            plays = np.flatnonzero(drive["play"]).tolist()
            spec = servo_spec(self.robot, drive["zero"], drive["sign"], plays)
            drive.tilt.edit_spec(spec, self.robot.joints)
            lay_ground(spec, self.robot)
        model = spec.compile()
        model.opt.timestep = step
        return model

    def _state(
        self, model: Any, drive: Drive | None, stretch: Stretch, first: Array
    ) -> Array:
        """Time, positions, speeds, and bends of the bristles if there are any."""
        own, behind = places(plays := (drive or self._declared).plays)
        q, v, bent = np.zeros(model.nq), np.zeros(model.nv), np.zeros(0)
        q[own], v[own] = stretch.q[0], stretch.v
        if drive is not None:
            key = stretch, _turned(drive) + drive["mass"].tobytes()
            if key not in self._weights:
                self._weights[key] = weight(model, own, stretch.q[0], stretch.v)
            down = self._weights[key]
            bent = bristles(drive, stretch, first, down)
            # The weight of the link presses it against one side of the gap.
            q[behind] = -np.sign(down[plays]) * drive["play"][plays]
            q[own[plays]] -= q[behind]
        return np.concatenate([np.zeros(1), q, v, bent])


def _turned(drive: Drive | None) -> bytes:
    """The parameters that need another compiled model."""
    if drive is None:
        return b""
    tilt = drive["roll"][0], drive["pitch"][0]
    turned = np.r_[drive["zero"], drive["sign"], drive["play"] > 0, tilt]
    return bytes(turned.tobytes())


def rolled(runs: Sequence[Run]) -> Array:
    """Replay on all cores: positions after each step, (batch, steps, n), [rad].

    Args:
        runs: The replays.
    """
    import mujoco
    from mujoco import rollout

    steps, n = max(len(x.control) for x in runs), runs[0].control.shape[1]
    out = np.empty((len(runs), steps, n))
    kinds: dict[tuple[bool, bytes], list[int]] = {}
    for k, x in enumerate(runs):
        kinds.setdefault((x.stepped, x.drive.plays.tobytes()), []).append(k)
    with _quiet():  # some servos are unstable
        for (stepped, _), own in kinds.items():
            some = [runs[k] for k in own]
            ends = [x.control[-1:].repeat(steps - len(x.control), 0) for x in some]
            pairs = zip(some, ends, strict=True)
            control = np.array([np.r_[x.control, y] for x, y in pairs])
            threads = min(len(os.sched_getaffinity(0)), len(some))
            data = [mujoco.MjData(some[0].model) for _ in range(threads)]
            if stepped:
                out[own] = _stepped(some, data, control)
                continue
            state = np.array([x.state for x in some])
            models = [x.model for x in some]
            out[own] = rollout.rollout(models, data, state, control)[0][..., 1 : 1 + n]
    return out


def _stepped(runs: Sequence[Run], data: list[Any], control: Array) -> Array:
    """Replay servos that MuJoCo lacks; their goals or friction change at each step.

    They have a dead band, read the position of the link behind the play of a gear, or
    have dry friction that grows with the load.

    Args:
        runs: Replays of models with the same joints.
        data: One for each thread.
        control: Goals, shape (batch, steps, n), [rad].

    Returns:
        Positions of the links after each step, shape (batch, steps, n), [rad].
    """
    from mujoco import rollout

    drives, state = [x.drive for x in runs], np.array([x.state for x in runs])
    dead = np.array([x["dead_band"] for x in drives])
    levels = _FrictionLevels(runs)
    after, plays = np.empty((len(runs), 1, state.shape[1])), drives[0].plays
    own, behind = (1 + x for x in places(plays))
    out, gap = np.empty_like(control), np.zeros_like(dead)
    with rollout.Rollout(nthread=len(data)) as roll:
        for k in range(control.shape[1]):
            motor, gap[:, plays] = state[:, own], state[:, behind]
            off = control[:, k] - motor - gap
            off -= np.clip(off, -dead, dead)
            levels.set(off, state)
            goal = (motor + off)[:, None]
            roll.rollout(
                levels.models, data, state, goal, nstep=1, state=after, skip_checks=True
            )
            state = after[:, 0].copy()
            out[:, k] = state[:, own]
            out[:, k, plays] += state[:, behind]
    return out


class _FrictionLevels:
    """Dry friction of some replays, which may change at each step.

    Args:
        runs: Replays of models with the same joints.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        drives = [x.drive for x in runs]

        def of(name: str) -> Array:
            return np.array([x[name] for x in drives])

        self._load, self._coulomb = of("load_friction"), of("coulomb")
        self._stiction = of("stiction")
        self._stiffness, self._stall = of("stiffness"), of("stall")
        self._presliding = of("presliding")
        self._bristle = self._coulomb / self._presliding
        # Replays share models, but not these.
        self._moving = {
            k: copy.copy(x.model)
            for k, x in enumerate(runs)
            if x.drive["load_friction"].any()
        }
        self.models = [self._moving.get(k, x.model) for k, x in enumerate(runs)]
        first, n = self.models[0], len(drives[0].stall)
        own, _ = places(drives[0].plays)
        self._of_servo = np.array([m.actuator_gainprm[:, 6] for m in self.models])
        self._of_joint = np.array([m.dof_damping[own] for m in self.models])
        self._speed = 1 + first.nq + own
        self._bent = slice(1 + first.nq + first.nv, 1 + first.nq + first.nv + n)

    def set(self, off: Array, state: Array) -> None:
        """Set the friction of the next step.

        Args:
            off: Goals less positions, as the servos see them, (batch, n), [rad].
            state: Times, positions, speeds and bends, shape (batch, ·).
        """
        if not self._moving:
            return
        v, friction = state[:, self._speed], self._bristle * state[:, self._bent]
        torque = self._stiffness * off - self._of_servo * v
        torque = np.clip(torque, -self._stall, self._stall) - self._of_joint * v
        load = np.abs(torque - friction)
        level = self._coulomb + self._load * load
        self._bristle = level / self._presliding
        both = np.stack([level, level + self._stiction], axis=2)
        for model, k in zip(self._moving.values(), self._moving, strict=True):
            model.actuator_biasprm[:, 3:5] = both[k]
            model.actuator_dynprm[:, 5] = self._bristle[k]


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the warnings of MuJoCo, and its log file."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def converged(
    simulator: ServoSimulator,
    stretches: Sequence[Stretch],
    drive: Drive,
    floor: Array,
) -> ServoSimulator:
    """A simulator with the longest step at which replays have converged.

    Args:
        simulator: Replays with some step.
        stretches: Logs to replay.
        drive: Approximate servos.
        floor: Error that a replay may have, shape (n,), [rad]. It may also have 3 % of
            what it misses of the log.
    """
    steps = [_STEP / 2**k for k in range(_HALVINGS)]
    measured = np.concatenate([x.q for x in stretches])
    before: Array | None = None
    for step in steps:
        (moved,) = simulator.with_step(step).replay(stretches, [drive])
        after = np.concatenate(moved)
        if before is not None:
            off = np.sqrt(np.mean((after - before) ** 2, axis=0))
            miss = np.sqrt(np.mean((after - measured) ** 2, axis=0))
            if (off <= np.maximum(floor, INEXACT * miss)).all():
                return simulator.with_step(2 * step)
        before = after
    return simulator.with_step(steps[-1])


def missed(
    simulator: ServoSimulator, logs: Sequence[Stretch], drives: Sequence[Drive | None]
) -> Array:
    """RMS error of replays, shape (len(drives), n), [rad]."""
    found = []
    for moved in simulator.replay(logs, drives):
        errors = [q - x.q for q, x in zip(moved, logs, strict=True)]
        found.append(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
    return np.asarray(np.nan_to_num(np.array(found), nan=np.inf))


def goals(stretch: Stretch, delay: Array, pace: Array, parts: int) -> Array:
    """Goals of the servos at every physics step, shape (parts·(N − 1), n), [rad].

    Args:
        stretch: Commands at the rate of the log.
        delay: By how much each joint's command acts later, shape (n,), [s].
        pace: Least time of a rad of each joint's goal, shape (n,), [s/rad].
        parts: Physics steps between two samples.
    """
    sent, samples, step = stretch.sent, len(stretch.command), stretch.step / parts
    logged = np.arange(samples - len(sent), samples) * stretch.step
    steps, earlier = (samples - 1) * parts, (len(sent) - samples) * parts
    out = np.empty((steps, sent.shape[1]))
    for j, (late, slow) in enumerate(zip(delay, pace, strict=True)):
        first = -earlier if slow > 0 else 0
        asked = np.interp(np.arange(first, steps) * step - late, logged, sent[:, j])
        out[:, j] = (slowed(asked, step / slow) if slow > 0 else asked)[-steps:]
    return out


def slowed(asked: Array, most: float) -> Array:
    """Goals that follow what is asked, shape (K,), by no more than ``most`` a step."""
    if np.abs(np.diff(asked)).max() <= most:
        return asked
    followed, goal = asked.tolist(), float(asked[0])
    for k, x in enumerate(followed):
        followed[k] = goal = goal + min(max(x - goal, -most), most)
    return np.array(followed)
