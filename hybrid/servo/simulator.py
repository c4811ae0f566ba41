"""Batches of open-loop replays in MuJoCo."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.robot import Robot
from hybrid.servo.drive import Drive
from hybrid.servo.stretch import Stretch

if TYPE_CHECKING:
    import mujoco

_HALVINGS = 4  # of the step, at most
_MODELS = 64  # that are kept compiled
_FINE = 0.03  # of what a replay misses: a law leaves out as much
_STEP = 0.005  # s: at most, of the physics
# N·m/A at 1 Ω: so small that speed takes nothing off the torque at the limit.
CONSTANT = 1e-3
SOFT = 1e-6  # N·m/rad
_CREEPS = 0.05  # rad/s: below, friction holds a joint


class ServoSimulator:
    """An arm with servos, replayed from the state in which a stretch begins.

    Args:
        robot: The arm.
        step: Longest step of the physics, [s].
    """

    def __init__(self, robot: Robot, step: float = _STEP) -> None:
        self.robot, self._longest = robot, step
        self._models: dict[tuple[float, bytes], Any] = {}
        self._scratch: dict[bool, Any] = {}

    def replay(
        self, stretches: Sequence[Stretch], drives: Sequence[Drive | None]
    ) -> list[list[Array]]:
        """Positions that servos make of commands.

        Args:
            stretches: What is replayed.
            drives: Servos to replay it with; None alone for those of the robot file.

        Returns:
            For each drive and each stretch positions, shape (N, n), [rad].
        """
        steps = [max(1, int(np.ceil(x.step / self._longest))) for x in stretches]
        longest = max((len(x.q) - 1) * k for x, k in zip(stretches, steps, strict=True))
        count, n = len(drives) * len(stretches), self.robot.size
        control = np.zeros((count, longest, n))
        models: list[Any] = []
        states = []
        for drive in drives:
            own: dict[float, Any] = {}
            for stretch, k in zip(stretches, steps, strict=True):
                model = own.get(step := round(stretch.step / k, 9))
                if model is None:
                    model = own[step] = self._model(drive, step)
                late = np.zeros(n) if drive is None else drive["delay"]
                pace = np.zeros(n) if drive is None else drive["pace"]
                command = delayed(slowed(stretch, pace), late, k)
                rows = control[len(models)]
                rows[: len(command)], rows[len(command) :] = command, command[-1]
                models.append(model)
                states.append(self._state(model, drive, stretch, command[0]))
        dead = np.zeros((len(drives), n))
        for row, drive in zip(dead, drives, strict=True):
            row[:] = 0.0 if drive is None else drive["dead_band"]
        dead = np.repeat(dead, len(stretches), axis=0)
        found = _rolled(models, np.array(states), control, dead)
        moved = []
        for i in range(len(drives)):
            replayed = []
            for s, (stretch, k) in enumerate(zip(stretches, steps, strict=True)):
                after = found[i * len(stretches) + s, k - 1 :: k, 1 : 1 + n]
                rows = after[: len(stretch.q) - 1]
                replayed.append(np.vstack([stretch.q[:1], rows]))
            moved.append(replayed)
        return moved

    def _model(self, drive: Drive | None, step: float) -> Any:
        turned = b"" if drive is None else np.r_[drive["zero"], drive["sign"]].tobytes()
        key = step, turned
        if key not in self._models:
            if len(self._models) > _MODELS:
                self._models.clear()
            self._models[key] = self._compiled(drive, step)
        model = copy.copy(self._models[key])
        if drive is not None:
            install(model, self.robot, drive)
        return model

    def _compiled(self, drive: Drive | None, step: float) -> Any:
        import mujoco

        spec = (
            declared_spec(self.robot)
            if drive is None
            else servo_spec(self.robot, drive["zero"], drive["sign"])
        )
        model = spec.compile()
        model.opt.timestep = step
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        return model

    def _state(
        self, model: Any, drive: Drive | None, stretch: Stretch, first: Array
    ) -> Array:
        """Full state at the start; bristles hold what servo and weight leave."""
        import mujoco

        data = self._scratch.setdefault(drive is None, mujoco.MjData(model))
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = stretch.q[0], stretch.v, first
        if drive is not None:
            mujoco.mj_forward(model, data)
            data.act[:] = bristles(drive, stretch, first, data.qfrc_bias)
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(model, full))
        mujoco.mj_getState(model, data, state, full)
        return state


def _rolled(models: list[Any], states: Array, control: Array, dead: Array) -> Array:
    """States after every step, (batch, steps, size), of servos with dead bands."""
    import mujoco
    from mujoco import rollout

    count, steps, n = control.shape
    threads = min(len(os.sched_getaffinity(0)), count)
    data = [mujoco.MjData(models[0]) for _ in range(threads)]
    out = np.empty((count, steps, states.shape[1]))
    plain, zoned = np.flatnonzero(~dead.any(axis=1)), np.flatnonzero(dead.any(axis=1))
    with _quiet():  # a servo that is tried may be unstable
        if len(plain):
            own = [models[i] for i in plain]
            found, _ = rollout.rollout(own, data, states[plain], control[plain])
            out[plain] = found
        if not len(zoned):
            return out
        # MuJoCo's servo has no dead band: its goal is moved at every step instead.
        own, state, most = [models[i] for i in zoned], states[zoned], dead[zoned]
        after = np.empty((len(zoned), 1, states.shape[1]))
        with rollout.Rollout(nthread=threads) as roll:
            for k in range(steps):
                off = control[zoned, k] - state[:, 1 : 1 + n]
                goal = control[zoned, k] - np.clip(off, -most, most)
                roll.rollout(
                    own,
                    data,
                    state,
                    goal[:, None],
                    nstep=1,
                    state=after,
                    skip_checks=True,
                )
                state = out[zoned, k] = after[:, 0].copy()
    return out


@contextmanager
def _quiet() -> Iterator[None]:
    """Nothing that MuJoCo warns of is shown, or left in a file of its own."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def file_step(robot: Robot) -> float:
    """Step with which the file's simulation runs, or MuJoCo's usual one, [s]."""
    return float(robot.timestep) if np.isfinite(robot.timestep) else 0.002


def bristles(drive: Drive, stretch: Stretch, first: Array, weight: Array) -> Array:
    """Deflections that hold what servo and weight leave, shape (n,), [rad]."""
    off = first - stretch.q[0]
    pull = drive["stiffness"] * (
        off - np.clip(off, -drive["dead_band"], drive["dead_band"])
    )
    rest = np.clip(pull, -drive["stall"], drive["stall"]) + drive["offset"] - weight
    most = drive["coulomb"] + drive["stiction"]
    sliding = np.sign(stretch.v) * drive["coulomb"]
    held = np.clip(rest, -most, most)
    return np.where(np.abs(stretch.v) > _CREEPS, sliding, held) / drive.bristle


def converged(
    robot: Robot, stretches: Sequence[Stretch], drive: Drive, floor: Array
) -> ServoSimulator:
    """Replays with the longest step that is fine enough.

    Args:
        robot: The arm.
        stretches: What is replayed.
        drive: Servos like those that are sought.
        floor: What a replay may be off by, shape (n,), [rad]; or by as little of what
            it misses.
    """
    steps = [_STEP / 2**k for k in range(_HALVINGS)]
    measured = np.concatenate([x.q for x in stretches])
    before: Array | None = None
    for step in steps:
        (moved,) = ServoSimulator(robot, step).replay(stretches, [drive])
        after = np.concatenate(moved)
        if before is not None:
            off = np.sqrt(np.mean((after - before) ** 2, axis=0))
            miss = np.sqrt(np.mean((after - measured) ** 2, axis=0))
            if (off <= np.maximum(floor, _FINE * miss)).all():
                return ServoSimulator(robot, 2 * step)
        before = after
    return ServoSimulator(robot, steps[-1])


def missed(
    simulator: ServoSimulator, logs: Sequence[Stretch], drives: Sequence[Drive | None]
) -> Array:
    """RMS error of replays, shape (len(drives), n), [rad]."""
    found = []
    for moved in simulator.replay(logs, drives):
        errors = [q - x.q for q, x in zip(moved, logs, strict=True)]
        found.append(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
    return np.asarray(np.nan_to_num(np.array(found), nan=np.inf))


def delayed(stretch: Stretch, delay: Array, parts: int) -> Array:
    """Commands as they act at every physics step, shape (parts·(N − 1), n), [rad].

    Args:
        stretch: Commands at the rate of the log.
        delay: By how much each joint's acts later, shape (n,), [s].
        parts: Physics steps between two samples.
    """
    t = np.arange((len(stretch.command) - 1) * parts) * (stretch.step / parts)
    logged = np.arange(len(stretch.command)) * stretch.step
    each = zip(stretch.command.T, delay, strict=True)
    return np.stack([np.interp(t - d, logged, x) for x, d in each], axis=1)


def slowed(stretch: Stretch, pace: Array) -> Stretch:
    """A stretch whose goals move no faster than they may.

    Args:
        stretch: Commands at the rate of the log.
        pace: Least time of a rad of each joint's goal, shape (n,), [s/rad].
    """
    command = stretch.command
    for j in np.flatnonzero(pace > 0).tolist():
        most = stretch.step / pace[j]
        if np.abs(np.diff(stretch.command[:, j])).max() <= most:
            continue
        goals, goal = stretch.command[:, j].tolist(), float(stretch.command[0, j])
        for k, x in enumerate(goals):
            goals[k] = goal = goal + min(max(x - goal, -most), most)
        command = command.copy() if command is stretch.command else command
        command[:, j] = goals
    return stretch if command is stretch.command else replace(stretch, command=command)


def servo_spec(
    robot: Robot, zero: Array | float = 0.0, sign: Array | float = 1.0
) -> mujoco.MjSpec:
    """An arm with a DC motor behind a position controller at every joint.

    Args:
        robot: The arm.
        zero: Position of the file where the log says zero, shape (n,), [rad].
        sign: −1 for axes that point the other way, shape (n,).
    """
    import mujoco

    spec = robot.mujoco_spec()
    shifts, signs = np.broadcast_arrays(zero, sign, np.empty(robot.size))[:2]
    for joint, shift, way in zip(robot.joints, shifts, signs, strict=True):
        own = spec.joint(joint)
        own.ref, own.axis = -float(shift), float(way) * np.array(own.axis)
        own.limited, own.range = True, np.array([-1.0, 1.0])
        # Any values: they are set in the compiled model.
        _actuator(spec, joint).set_to_dcmotor(
            motorconst=[CONSTANT, CONSTANT],
            resistance=1.0,
            controller=[1.0, 0, 0, 0, 0, 0],
            saturation=[1.0, 0, 0],
            lugre=[1.0, 1.0, 1.0, 1.0, 1.0],
            ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_POS),
        )
    return spec


def declared_spec(robot: Robot) -> mujoco.MjSpec:
    """An arm with the position servos that its file declares, or usual ones."""
    spec, drive = robot.mujoco_spec(), Drive.declared(robot)
    servo = np.where(np.isfinite(robot.kd), robot.kd, 0.0)
    for j, joint in enumerate(robot.joints):
        actuator, most = _actuator(spec, joint), drive["stall"][j]
        actuator.set_to_position(kp=drive["stiffness"][j], kv=servo[j])
        actuator.forcerange, actuator.forcelimited = [-most, most], True
        own = spec.joint(joint)
        own.limited, own.range = True, np.array([drive["lower"][j], drive["upper"][j]])
    return spec


def _actuator(spec: Any, joint: str) -> Any:
    import mujoco

    kind = mujoco.mjtTrn.mjTRN_JOINT
    return spec.add_actuator(name=joint, trntype=kind, target=joint)


def install(model: Any, robot: Robot, drive: Drive) -> None:
    """Set the numbers of servos in a compiled model, joints in the order of the arm.

    Args:
        model: MuJoCo model with a dcmotor at every joint.
        robot: The arm.
        drive: The servos.
    """
    model.actuator_gainprm[:, 1] = CONSTANT
    model.actuator_gainprm[:, 4] = drive["stiffness"]
    model.actuator_gainprm[:, 7] = drive["stall"] / CONSTANT
    model.actuator_forcelimited[:] = 0
    model.actuator_ctrllimited[:] = 0
    model.actuator_biasprm[:, 3] = drive["coulomb"]
    model.actuator_biasprm[:, 4] = drive["coulomb"] + drive["stiction"]
    model.actuator_biasprm[:, 5] = drive["stribeck_speed"]
    model.actuator_dynprm[:, 5] = drive.bristle
    model.actuator_dynprm[:, 6] = bristle_damping(drive)
    model.dof_frictionloss[:] = 0.0
    servo, joint = dampings(robot, drive)
    model.actuator_gainprm[:, 6], model.dof_damping[:] = servo, joint
    model.dof_armature[:] = drive["armature"]
    model.jnt_stiffness[:], model.qpos_spring[:] = springs(robot, drive)
    model.jnt_range[:] = stops(drive)
    if (drive["mass"] != 1.0).any():
        import mujoco

        model.body_mass[1:] *= drive["mass"]
        model.body_inertia[1:] *= drive["mass"][:, None]
        mujoco.mj_setConst(model, mujoco.MjData(model))


def dampings(robot: Robot, drive: Drive) -> tuple[Array, Array]:
    """Damping of servos and of joints, (n,) each: shares as in the file.

    Motion tells them apart only where a servo is at its limit.
    """
    servo = np.nan_to_num(robot.kd)
    share = servo / np.maximum(servo + robot.damping, 1e-12)
    return share * drive["damping"], (1 - share) * drive["damping"]


def stops(drive: Drive) -> Array:
    """Range of every joint as the log counts, shape (n, 2), [rad]."""
    ends = np.stack([drive["lower"], drive["upper"]]) * drive["sign"]
    return np.asarray((np.sort(ends, axis=0) - drive["zero"]).T)


def springs(robot: Robot, drive: Drive) -> tuple[Array, Array]:
    """Stiffness [N·m/rad] and relaxed position [rad] of every joint's spring, (n,).

    An offset of torque is a spring so soft that its torque does not change, or shifts
    the one that the file declares.
    """
    stiffness = np.maximum(robot.stiffness, SOFT) + drive["spring"]
    relaxed = drive["sign"] * robot.springref - drive["zero"]
    return stiffness, relaxed + drive["offset"] / stiffness


def bristle_damping(drive: Drive) -> Array:
    """Damping σ₁ with which a rotor on bristles comes to rest, (n,), [N·m·s/rad]."""
    return np.asarray(np.sqrt(drive.bristle * drive["armature"]))
