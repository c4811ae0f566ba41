"""Compare a robot with the MuJoCo model of its file, to find forces not modelled.

MuJoCo computes the torque of both for the same states. If they differ, the elements
that are not modelled are those that change the torque of the file when disabled.
Contacts, limits and dry friction are left out, because a log shows the first two, and
MuJoCo softens the last.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot.mjcf import joint_numbers, sum_tendons

if TYPE_CHECKING:
    from hybrid.robot.robot import Robot

_STATES = 3  # number of random states
_SAME = 1e-6  # of the largest torque
# Elements of MuJoCo besides links, and the arrays that disable each of them.
_ELEMENTS = {
    "tendon": (
        "tendon_stiffness", "tendon_stiffnesspoly", "tendon_damping",
        "tendon_dampingpoly", "tendon_armature", "tendon_frictionloss",
    ),
    "equality": ("eq_active0",),
    "gravcomp of body": ("body_gravcomp",),
    "nonlinear stiffness of joint": ("jnt_stiffnesspoly", "jnt_springyield"),
    "damping of actuator": ("actuator_damping", "actuator_dampingpoly"),
}  # fmt: skip


def check_modelled(robot: Robot, model: Any) -> None:
    """Refuse a robot whose torque differs from that of its MuJoCo model."""
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
    model.dof_frictionloss[:] = 0.0
    index, home = joint_numbers(model, robot.joints), model.qpos0.copy()
    home[model.jnt_qposadr[joint_numbers(model, robot.held)]] = [*robot.held.values()]
    sums = [t for t, own, _ in sum_tendons(model) if {*own} <= {*index}]
    model.tendon_frictionloss[sums] = 0.0
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, _STATES, robot.size))
    expected = _torque(model, index, states, home)
    own = robot.mujoco_spec().compile()
    own.dof_frictionloss[:] = own.tendon_frictionloss[:] = 0.0
    found = _torque(own, list(range(robot.size)), states, own.qpos0)
    error = np.abs(expected - found).max(axis=0)
    if (error <= _SAME * np.abs(expected).max()).all():
        return
    causes = [
        name
        for name in _disabled_in_turn(model)
        if not np.allclose(_torque(model, index, states, home), expected, rtol=_SAME)
    ]
    joint = robot.joints[int(np.argmax(error))]
    what = ", ".join(causes) or f"something at joint {joint!r}"
    raise RobotError(
        f"{robot.path or robot.name}: {what} acts on the arm and is not modelled; take "
        "it out of the file, or choose joints that it does not act on"
    )


def _torque(model: Any, index: list[int], states: Array, home: Array) -> Array:
    """Inverse dynamics by MuJoCo, shape (samples, n), [N·m]."""
    data = mujoco.MjData(model)
    dofs, at = model.jnt_dofadr[index], model.jnt_qposadr[index]
    found = []
    for q, v, a in states.transpose(1, 0, 2):
        data.qpos[:], data.qpos[at] = home, q
        data.qvel[dofs], data.qacc[dofs] = v, a
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[dofs].copy())
    return np.array(found)


def _disabled_in_turn(model: Any) -> Iterator[str]:
    """Disable each element in turn, and yield its name meanwhile."""
    for kind, fields in _ELEMENTS.items():
        arrays = [getattr(model, field) for field in fields]
        accessor = getattr(model, kind.rpartition(" ")[2])
        for k in range(len(arrays[0])):
            before = [x[k].copy() for x in arrays]
            if not any(np.any(x) for x in before):
                continue
            for x in arrays:
                x[k] = 0
            yield f"{kind} {accessor(k).name or k!r}"
            for x, old in zip(arrays, before, strict=True):
                x[k] = old
    density, viscosity = model.opt.density, model.opt.viscosity
    if density or viscosity:
        model.opt.density = model.opt.viscosity = 0.0
        yield "the fluid of option"
        model.opt.density, model.opt.viscosity = density, viscosity
