"""A fit of fixed structure by ``mujoco.sysid``, the tool that most would turn to.

Free are rotor, damping and friction loss of each joint and the mass of the last link;
the start is what the file says. It needs the extra ``bench``.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from typing import Any

import mujoco
import numpy as np

from blind.score import Named
from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.recording import Recording
from hybrid.robot import Robot

# What of the file is fitted at each joint, and the effect that a change of it means.
FIELDS = {"armature": "armature", "damping": "viscous", "frictionloss": "coulomb"}
_SENSORS = {
    "jointpos": mujoco.mjtSensor.mjSENS_JOINTPOS,
    "jointvel": mujoco.mjtSensor.mjSENS_JOINTVEL,
    "jointactuatorfrc": mujoco.mjtSensor.mjSENS_JOINTACTFRC,
}
_MOST = 5.0  # times what the file says
_UNDECLARED = 1.0  # most of a number that the file leaves at nothing
_LIGHTEST = 0.1  # of the last link's mass


@dataclass(frozen=True)
class SysidFit:
    """Numbers of the file, fitted.

    Attributes:
        names: Effect and joint of each, p of them; the last is the last link's mass.
        values: What was found, shape (p,).
        declared: What the file says, shape (p,).
        half: Half the width of the 95 % intervals, shape (p,).
    """

    names: tuple[tuple[str, str], ...]
    values: Array
    declared: Array
    half: Array

    def named(self) -> tuple[Named, ...]:
        """Causes: numbers whose interval excludes the file's, the surest first."""
        off = np.abs(self.values - self.declared) / np.maximum(self.half, 1e-300)
        joints: dict[str, list[str]] = {}
        for k in np.argsort(-off):
            if off[k] > 1.0:
                effect, joint = self.names[k]
                joints.setdefault(effect, []).append(joint)
        everywhere = {"payload": tuple(dict.fromkeys(j for _, j in self.names))}
        return tuple(
            Named(e, everywhere.get(e, tuple(x)), (e,)) for e, x in joints.items()
        )


def has_sysid() -> bool:
    """Whether the extra is installed."""
    try:
        return hasattr(import_module("mujoco.sysid"), "optimize")
    except ImportError:
        return False


def fit_sysid(robot: Robot, log: Recording, *, iterations: int = 30) -> SysidFit:
    """Fit 3 n + 1 numbers to one log, in closed loop with the servos' own gains.

    Args:
        robot: The file, with gains of its servos.
        log: Positions, torques, and commands.
        iterations: Most steps of the fit.

    Raises:
        IdentificationError: The log holds no command, or the file no gains; or its
            replay is unstable with numbers that are tried.
    """
    if log.command is None or log.tau is None or not np.isfinite(robot.kp).all():
        raise IdentificationError("sysid needs torques, commands, and servo gains")
    sysid = import_module("mujoco.sysid")
    spec = _with_servos(robot)
    model = spec.compile()
    clock = log.t - log.t[0]
    command, v = log.command, _speed(log.q, clock) if log.v is None else log.v
    drive = sysid.TimeSeries(clock, np.hstack([command, _speed(command, clock)]))
    start = sysid.create_initial_state(model, log.q[0], v[0])
    # Its rollout stamps what sensors show before a step with the time after it.
    stamp, seen = clock + model.opt.timestep, np.hstack([log.q, v, log.tau])
    measured = sysid.TimeSeries.from_names(stamp, seen, model)
    sequence = sysid.ModelSequences("arm", spec, "log", start, drive, measured)
    params, names = _parameters(sysid, robot)
    residual = sysid.build_residual_fn(models_sequences=[sequence])
    try:
        with redirect_stdout(StringIO()):  # it reports its steps, asked to or not
            found, result = sysid.optimize(
                params, residual, verbose=False, max_iters=iterations
            )
    except ValueError as error:  # with some numbers the arm swings up, and is reset
        raise IdentificationError(f"sysid cannot replay the log: {error}") from error
    values = found.as_vector()
    _, half = sysid.calculate_intervals(residual(values, found)[0], result.jac)
    declared = params.as_nominal_vector()
    return SysidFit(tuple(names), values, declared, np.asarray(half))


def _speed(x: Array, clock: Array) -> Array:
    return np.asarray(np.gradient(x, clock, axis=0, edge_order=2))


def _with_servos(robot: Robot) -> mujoco.MjSpec:
    """The file with position and speed servos, and sensors of what is logged."""
    spec = robot.mujoco_spec()
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    # An implicit step would treat servos as part of the arm: armatures would come out
    # too small by the speed gain times the step, on a plant that lacks nothing, too.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    for kind, gains in (("position", robot.kp), ("speed", robot.kd)):
        for joint, gain in zip(robot.joints, gains, strict=True):
            bias = [0.0] * 10
            bias[1 if kind == "position" else 2] = -gain
            spec.add_actuator(
                name=f"{joint}_{kind}",
                target=joint,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                gaintype=mujoco.mjtGain.mjGAIN_FIXED,
                biastype=mujoco.mjtBias.mjBIAS_AFFINE,
                gainprm=[gain, *[0.0] * 9],
                biasprm=bias,
            )
    for name, kind in _SENSORS.items():
        for joint in robot.joints:
            spec.add_sensor(
                name=f"{joint}_{name}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint,
            )
    return spec


def _parameters(sysid: Any, robot: Robot) -> tuple[Any, Sequence[tuple[str, str]]]:
    params, names = sysid.ParameterDict(), []
    columns = (robot.chain.armature, robot.damping, robot.frictionloss)
    for field, column in zip(FIELDS, columns, strict=True):
        for joint, value in zip(robot.joints, column, strict=True):

            def set_(s: Any, p: Any, joint: str = joint, field: str = field) -> None:
                x = float(p.value[0])
                now = getattr(s.joint(joint), field)
                setattr(s.joint(joint), field, [x, *now[1:]] if np.size(now) > 1 else x)

            most = _MOST * value or _UNDECLARED
            params.add(
                sysid.Parameter(f"{joint} {field}", value, 0.0, most, modifier=set_)
            )
            names.append((FIELDS[field], joint))
    body, mass = robot.joints[-1], float(robot.chain.inertial[-1, 0])

    def heavier(s: Any, p: Any) -> None:
        s.body(body).mass = float(p.value[0])

    low, high = _LIGHTEST * mass, _MOST * mass
    params.add(sysid.Parameter("last mass", mass, low, high, modifier=heavier))
    return params, [*names, ("payload", body)]
