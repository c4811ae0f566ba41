"""Batches of open-loop replays in MuJoCo."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from hybrid.arrays import Array
from hybrid.robot import Robot
from hybrid.robot.mujoco_model import mujoco_warnings
from hybrid.servo.drive import Drive
from hybrid.servo.model import (
    bristles,
    declared_spec,
    install,
    lay_ground,
    places,
    servo_spec,
)
from hybrid.servo.noise import INEXACT
from hybrid.servo.stretch import Stretch
from hybrid.threads import cores

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

    def has(self, names: Sequence[str]) -> bool:
        """Whether the servos have any of some properties."""
        return any(self.drive[name].any() for name in names)


class ServoSimulator:
    """Open-loop replays of an arm with servos, from the first state of a stretch.

    The physics has a longest step, [s]. With ``gpu`` all but the servos of the robot
    file are replayed on a GPU.

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
        # The file's own servos may have friction by bristles: these are ours.
        self._file = self._declared if len(robot.bristle) else None
        self._models: dict[tuple[float, bytes], tuple[Any, Any]] = {}

    def with_step(self, step: float) -> ServoSimulator:
        """A copy with another longest step, [s]."""
        other = copy.copy(self)
        other._longest = step
        return other

    def replay(
        self, stretches: Sequence[Stretch], drives: Sequence[Drive | None]
    ) -> list[list[Array]]:
        """Positions by drive and stretch, shape (N, n) each, [rad].

        Every stretch is replayed with each of some servos; or only None, for those of
        the robot file.
        """
        runs = self.runs(stretches, drives)
        moved: list[Array] = [np.empty(0)] * len(runs)
        for here in (False, True):  # what only MuJoCo's C can do, and the others
            own = [k for k, x in enumerate(runs) if x.has(_ONLY_HERE) == here]
            roll = rolled if here or None in drives else self.roll
            rows = roll([runs[k] for k in own]) if own else ()
            for k, steps in zip(own, rows, strict=True):
                run = runs[k]
                after = steps[run.parts - 1 : len(run.control) : run.parts]
                moved[k] = np.vstack([run.stretch.q[:1], after])
        size = len(stretches)
        return [moved[i : i + size] for i in range(0, len(moved), size)]

    def runs(
        self, stretches: Sequence[Stretch], drives: Sequence[Drive | None]
    ) -> list[Run]:
        """Prepare the replays of every stretch with each of some servos."""
        runs = []
        for drive in (x or self._file for x in drives):
            models, own = dict[float, tuple[Any, Any]](), drive or self._declared
            for stretch in stretches:
                parts = max(1, int(np.ceil(stretch.step / self._longest - _SPARE)))
                step = round(stretch.step / parts, 9)
                if step not in models:
                    models[step] = self._model(drive, step)
                control = stretch.goals(own["delay"], own["pace"], parts)
                state = self._state(*models[step], drive, stretch, control[0])
                runs.append(Run(stretch, parts, models[step][0], state, control, own))
        return runs

    def _model(self, drive: Drive | None, step: float) -> tuple[Any, Any]:
        """A model of the servo, and data that models with its joints share."""
        key = step, drive.layout if drive else b""
        if key not in self._models:
            if len(self._models) > _MODELS:
                self._models.clear()
            if drive is None:
                spec = declared_spec(self.robot)
            else:
                spec = servo_spec(self.robot, drive)
                lay_ground(spec, self.robot)
            compiled = spec.compile()
            compiled.opt.timestep = step
            self._models[key] = compiled, mujoco.MjData(compiled)
        model, data = self._models[key]
        if drive is not None:
            model = copy.copy(model)
            install(model, self.robot, drive, data)
        return model, data

    def _state(
        self, model: Any, data: Any, drive: Drive | None, stretch: Stretch, goal: Array
    ) -> Array:
        """Time, positions, speeds, and bends of the bristles if there are any."""
        own, behind = places(plays := (drive or self._declared).plays)
        q, v, bent = np.zeros(model.nq), np.zeros(model.nv), np.zeros(0)
        q[own], v[own] = stretch.q[0], stretch.v
        if drive is not None:
            data.qpos[own], data.qvel[own] = stretch.q[0], stretch.v
            mujoco.mj_forward(model, data)
            # By gravity and speed, less springs.
            down = (data.qfrc_bias - data.qfrc_spring)[own]
            bent = bristles(drive, stretch, goal, down)
            # The weight of the link presses it against one side of the gap.
            q[behind] = -np.sign(down[plays]) * drive["play"][plays]
            q[own[plays]] -= q[behind]
        return np.concatenate([np.zeros(1), q, v, bent])


def rolled(runs: Sequence[Run]) -> Array:
    """Replay on all cores: positions after each step, (batch, steps, n), [rad]."""
    steps, n = max(len(x.control) for x in runs), runs[0].control.shape[1]
    out = np.empty((len(runs), steps, n))
    kinds: dict[tuple[bool, bytes], list[int]] = {}
    for k, x in enumerate(runs):
        kinds.setdefault((x.has(_STEPPED), x.drive.plays.tobytes()), []).append(k)
    with mujoco_warnings():  # some servos are unstable
        for (stepped, _), own in kinds.items():
            some = [runs[k] for k in own]
            ends = [x.control[-1:].repeat(steps - len(x.control), 0) for x in some]
            pairs = zip(some, ends, strict=True)
            control = np.array([np.r_[x.control, y] for x, y in pairs])
            threads = min(cores(), len(some))
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
    have dry friction that grows with the load. The models have the same joints, and
    each thread has its data. Goals and positions have the shape (batch, steps, n).
    """
    state, levels = np.array([x.state for x in runs]), _FrictionLevels(runs)
    after, plays = np.empty((len(runs), 1, state.shape[1])), runs[0].drive.plays
    dead = levels.drives["dead_band"]
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

    All servos are one drive, with values of the shape (len(QUANTITIES), batch, n).
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        one = runs[0].drive
        self.drives = Drive(np.stack([x.drive.values for x in runs], axis=1), one.stall)
        self._bristle = self.drives.bristle
        self._moving = np.flatnonzero(self.drives["load_friction"].any(axis=1)).tolist()
        self.models = [x.model for x in runs]
        for k in self._moving:  # replays share models, but not these
            self.models[k] = copy.copy(self.models[k])
        first, n, (own, _) = self.models[0], len(one.stall), places(one.plays)
        self._of_servo = np.array([m.actuator_gainprm[:, 6] for m in self.models])
        self._of_joint = np.array([m.dof_damping[own] for m in self.models])
        self._speed = 1 + first.nq + own
        self._bent = slice(1 + first.nq + first.nv, 1 + first.nq + first.nv + n)

    def set(self, off: Array, state: Array) -> None:
        """Set the friction of the next step.

        ``off`` is goal less position as the servos see it, shape (batch, n), [rad].
        """
        if not self._moving:
            return
        own, v = self.drives, state[:, self._speed]
        friction = self._bristle * state[:, self._bent]
        torque = own["stiffness"] * off - self._of_servo * v
        torque = np.clip(torque, -own["stall"], own["stall"]) - self._of_joint * v
        level = own["coulomb"] + own["load_friction"] * np.abs(torque - friction)
        self._bristle = level / own["presliding"]
        both = np.stack([level, level + own["stiction"]], axis=2)
        for k in self._moving:
            self.models[k].actuator_biasprm[:, 3:5] = both[k]
            self.models[k].actuator_dynprm[:, 5] = self._bristle[k]


def converged(
    simulator: ServoSimulator, stretches: Sequence[Stretch], drive: Drive, floor: Array
) -> ServoSimulator:
    """A simulator with the longest step at which replays have converged.

    A replay may have an error of ``floor``, shape (n,), [rad], or of 3 % of what it
    misses of the log.
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
