"""Batches of open-loop replays in MuJoCo."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
_SPARE = 0.1  # steps: clocks are not exact, so that as much more takes no step more


@dataclass(frozen=True, eq=False)
class Run:
    """One replay: a stretch and a model with its servos."""

    stretch: Stretch
    parts: int  # physics steps between two samples
    model: Any
    state: Array
    control: Array  # at every physics step, (·, n)
    dead: Array
    plays: NDArray[np.bool_]  # whether gears have play, (n,)


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
        for play in (False, True):
            own = [k for k, x in enumerate(runs) if x.plays.any() == play]
            roll = rolled if play or None in drives else self.roll
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
        late, pace, dead = (
            none if drive is None else drive[name]
            for name in ("delay", "pace", "dead_band")
        )
        control = goals(stretch, late, pace, parts)
        state = self._state(models[step], drive, stretch, control[0])
        return Run(stretch, parts, models[step], state, control, dead, _plays(drive, n))

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
            lay_ground(spec, self.robot)
        model = spec.compile()
        model.opt.timestep = step
        return model

    def _state(
        self, model: Any, drive: Drive | None, stretch: Stretch, first: Array
    ) -> Array:
        """Time, positions, speeds, and bends of the bristles if there are any."""
        own, behind = places(plays := _plays(drive, len(stretch.v)))
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


def _plays(drive: Drive | None, n: int) -> NDArray[np.bool_]:
    return np.zeros(n, dtype=bool) if drive is None else np.asarray(drive["play"] > 0)


def _turned(drive: Drive | None) -> bytes:
    """The parameters that need another compiled model."""
    if drive is None:
        return b""
    turned = np.r_[drive["zero"], drive["sign"], drive["play"] > 0]
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
        stepped = bool(x.dead.any() or x.plays.any())
        kinds.setdefault((stepped, x.plays.tobytes()), []).append(k)
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
    """Replay servos that MuJoCo lacks, whose goals move at each step.

    They have a dead band, or read the position of the link behind the play of a gear.

    Args:
        runs: Replays of models with the same joints.
        data: One for each thread.
        control: Goals, shape (batch, steps, n), [rad].

    Returns:
        Positions of the links after each step, shape (batch, steps, n), [rad].
    """
    from mujoco import rollout

    state, dead = np.array([x.state for x in runs]), np.array([x.dead for x in runs])
    after, plays = np.empty((len(runs), 1, state.shape[1])), runs[0].plays
    own, behind = (1 + x for x in places(plays))
    out, models = np.empty_like(control), [x.model for x in runs]
    motor, gap = state[:, own], np.zeros_like(dead)
    gap[:, plays] = state[:, behind]
    with rollout.Rollout(nthread=len(data)) as roll:
        for k in range(control.shape[1]):
            off = control[:, k] - motor - gap
            goal = (control[:, k] - gap - np.clip(off, -dead, dead))[:, None]
            roll.rollout(
                models, data, state, goal, nstep=1, state=after, skip_checks=True
            )
            state = after[:, 0].copy()
            motor, gap[:, plays] = state[:, own], state[:, behind]
            out[:, k] = motor + gap
    return out


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
