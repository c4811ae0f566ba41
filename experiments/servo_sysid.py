"""Plain numbers of servos but delay and offset by `mujoco.sysid`, in logarithms.

With MuJoCo's own friction, on stretches of logs.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import mujoco
import numpy as np

from hybrid.robot import Robot
from hybrid.servo.model import declared_spec
from hybrid.servo.stretch import Stretch

FAR = 7.0  # logarithms: a thousandth to a thousand times what the file says
STEP = 0.005  # s


def _spec(robot: Robot) -> mujoco.MjSpec:
    """The arm with sensors of its joints, without contacts."""
    spec = declared_spec(robot)
    spec.option.timestep = STEP
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for name in robot.joints:
        kind = mujoco.mjtSensor.mjSENS_JOINTPOS
        target = mujoco.mjtObj.mjOBJ_JOINT
        spec.add_sensor(name=f"{name}_q", type=kind, objtype=target, objname=name)
    return spec


def by_sysid(
    robot: Robot, parts: Sequence[Stretch], iterations: int = 30
) -> tuple[Robot, float]:
    """The arm with the servos that `mujoco.sysid` finds, and seconds of it."""
    from mujoco import sysid

    begun, names = time.process_time(), robot.joints
    damping = np.nan_to_num(robot.kd) + robot.damping
    robot = replace(robot, kd=np.zeros(robot.size), damping=damping)
    spec = _spec(robot)
    model, runs = spec.compile(), []
    for part in parts:
        clock = np.arange(len(part.q)) * part.step
        # Its rollout stamps what sensors show before a step with the time after it.
        seen = sysid.TimeSeries.from_names(clock + STEP, part.q, model)
        start = sysid.create_initial_state(model, part.q[0], part.v)
        runs.append((start, sysid.TimeSeries(clock, part.command), seen))
    sequence = sysid.ModelSequences(
        "arm",
        spec,
        [f"{k}" for k in range(len(parts))],
        *map(list, zip(*runs, strict=True)),
    )
    nominal = robot.kp, damping, robot.frictionloss, robot.chain.armature
    params = sysid.ParameterDict()
    for j, name in enumerate(names):
        for k, column in enumerate(nominal):

            def apply(s, p, j=j, k=k, value=float(column[j])) -> None:
                x = value * float(np.exp(p.value[0]))
                if k == 0:
                    s.actuators[-len(names) + j].set_to_position(kp=x, kv=0.0)
                elif k == 1:
                    s.joint(names[j]).damping = [x, 0, 0]
                else:
                    field = ("frictionloss", "armature")[k - 2]
                    setattr(s.joint(names[j]), field, x)

            params.add(sysid.Parameter(f"{name} {k}", 0.0, -FAR, FAR, modifier=apply))
    with redirect_stdout(StringIO()):  # it reports its steps, asked to or not
        residual = sysid.build_residual_fn(models_sequences=[sequence])
        found, _ = sysid.optimize(params, residual, verbose=False, max_iters=iterations)
    x = np.exp(found.as_vector()).reshape(len(names), 4).T * np.array(nominal)
    chain = replace(robot.chain, armature=x[3])
    arm = replace(robot, kp=x[0], damping=x[1], frictionloss=x[2], chain=chain)
    return arm, time.process_time() - begun
