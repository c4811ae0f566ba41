"""A fit of fixed structure by ``mujoco.sysid``, to stand beside a diagnosis.

Free are armature, damping and friction loss of six joints and the mass of the last
link; the start is what the file says, which is the truth. It needs ``mujoco[sysid]``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import mujoco
import numpy as np

from hybrid import Robot
from hybrid.plant import Plant
from hybrid.recording import Recording

_FIELDS = ("armature", "damping", "frictionloss")
_SENSORS = {
    "jointpos": mujoco.mjtSensor.mjSENS_JOINTPOS,
    "jointvel": mujoco.mjtSensor.mjSENS_JOINTVEL,
    "jointactuatorfrc": mujoco.mjtSensor.mjSENS_JOINTACTFRC,
}
_ITERATIONS = 30


@dataclass(frozen=True)
class Fitted:
    """Parameters that came out.

    Attributes:
        robot: The arm with them.
        names: Their names, p of them.
        values: What was found, shape (p,).
        true: What the plant has, shape (p,).
        half: Half the width of the 95 % intervals, shape (p,).
        seconds: Processor time.
    """

    robot: Robot
    names: tuple[str, ...]
    values: np.ndarray
    true: np.ndarray
    half: np.ndarray
    seconds: float

    @property
    def wrong(self) -> np.ndarray:
        """Relative errors, shape (p,)."""
        return np.asarray(np.abs(self.values / self.true - 1))

    @property
    def inside(self) -> np.ndarray:
        """Which true values lie in their intervals, shape (p,)."""
        return np.asarray(np.abs(self.values - self.true) <= self.half)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        own = {x: getattr(self, x) for x in ("names", "values", "true", "half")}
        return own | {"cpu_seconds": self.seconds}


def has_sysid() -> bool:
    """Whether the extra is installed."""
    import mujoco.sysid

    return hasattr(mujoco.sysid, "optimize")


def fit_by_sysid(file: Path, plant: Plant, log: Recording) -> Fitted:
    """Fit 19 parameters to one log, in closed loop with the servos' own gains."""
    from mujoco import sysid

    robot = Robot.load(file)
    spec = _with_servos(file, robot, plant)
    model = spec.compile()
    clock = log.t - log.t[0]
    speed = np.gradient(log.command, clock, axis=0, edge_order=2)
    drive = sysid.TimeSeries(clock, np.hstack([log.command, speed]))
    seen = np.hstack([log.q, log.v, log.tau])
    start = sysid.create_initial_state(model, log.q[0], log.v[0])
    # Its rollout stamps what sensors show before a step with the time after it.
    stamp = clock + model.opt.timestep
    measured = sysid.TimeSeries.from_names(stamp, seen, model)
    sequence = sysid.ModelSequences("arm", spec, "log", start, drive, measured)
    params = _parameters(sysid, robot, spec)
    residual = sysid.build_residual_fn(models_sequences=[sequence])
    begin = process_time()
    found, result = sysid.optimize(
        params, residual, verbose=False, max_iters=_ITERATIONS
    )
    seconds = process_time() - begin
    values = found.as_vector()
    _, half = sysid.calculate_intervals(residual(values, found)[0], result.jac)
    names, true = tuple(params.keys()), params.as_nominal_vector()
    fitted = _with_values(robot, values)
    return Fitted(fitted, names, values, true, np.asarray(half), seconds)


def _with_servos(file: Path, robot: Robot, plant: Plant) -> Any:
    """The file with position and speed servos, and sensors of what is logged."""
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    # An implicit step would treat servos as part of the arm: armatures would come out
    # too small by the speed gain times the step, on a plant that lacks nothing, too.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    for old in [*spec.actuators, *spec.sensors]:
        spec.delete(old)
    for kind, gains in (("position", plant.servo.kp), ("speed", plant.servo.kd)):
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


def _parameters(sysid: Any, robot: Robot, spec: Any) -> Any:
    params = sysid.ParameterDict()
    chain = robot.chain
    columns = (chain.armature, robot.damping, robot.frictionloss)
    for field, column in zip(_FIELDS, columns, strict=True):
        for joint, value in zip(robot.joints, column, strict=True):

            def set_(s: Any, p: Any, joint: str = joint, field: str = field) -> None:
                x = float(p.value[0])
                now = getattr(s.joint(joint), field)
                setattr(s.joint(joint), field, [x, *now[1:]] if np.size(now) > 1 else x)

            params.add(
                sysid.Parameter(
                    f"{joint} {field}", value, 0.0, 5 * value, modifier=set_
                )
            )
    body, mass = spec.joint(robot.joints[-1]).parent.name, chain.inertial[-1, 0]

    def heavier(s: Any, p: Any) -> None:
        s.body(body).mass = float(p.value[0])

    params.add(sysid.Parameter("last mass", mass, 0.1, 5.0, modifier=heavier))
    return params


def _with_values(robot: Robot, values: np.ndarray) -> Robot:
    armature, damping, friction = values[:-1].reshape(3, -1)
    inertial = robot.chain.inertial.copy()
    # The mass alone changes: its centre stays, and so does its inertia about it.
    mass, moment = inertial[-1, 0], inertial[-1, 1:4]
    centre, added = moment / mass, values[-1] - mass
    xx, xy, yy, xz, yz, zz = ((centre @ centre) * np.eye(3) - np.outer(centre, centre))[
        [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    ]
    inertial[-1] += added * np.array([1, *centre, xx, xy, yy, xz, yz, zz])
    chain = replace(robot.chain, inertial=inertial, armature=armature)
    return replace(robot, chain=chain, damping=damping, frictionloss=friction)
