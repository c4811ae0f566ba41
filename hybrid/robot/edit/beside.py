"""Friction and ripple that an MJCF joint has no attribute for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.actuators import bristles, passive_motors
from hybrid.robot.edit.document import Document, element
from hybrid.robot.edit.parsed import joint_tag, model_of
from hybrid.robot.mjcf import joint_names
from hybrid.robot.robot import Robot

# By default MuJoCo's dry friction is so soft that it is viscous at low speed.
DRY = {"solimpfriction": (0.9999, 0.9999, 0.001, 0.5, 2.0)}
_SWING = 1.0  # rad of a bristle's swing in a step: stable up to 2
_POSTURES = 100  # among which a joint's inertia is the least
_SOFTEST, _HARDEST = 0.0001, 0.9999  # impedances that MuJoCo allows


def put_dry(document: Document, joint: str, dry: Mapping[str, Any]) -> None:
    """Dry friction of a joint whose own rises to a level: that of a tendon on it."""
    parts = [
        (tag, own[0])
        for tag in document.find("tendon", "fixed")
        if len(own := document.within(tag, "joint")) == 1
        and own[0].attributes.get("joint") == joint
    ]
    for tag, its in parts:
        pull = abs(float(its.attributes.get("coef", 1.0)))
        document.set(tag, {**dry, "frictionloss": dry["frictionloss"] / pull})
        dry = {"frictionloss": 0.0}
    if not parts and dry["frictionloss"]:
        head = element("fixed", {"name": f"{joint}/dry", **dry}).replace("/>", ">")
        text = head + element("joint", {"joint": joint, "coef": 1.0}) + "</fixed>"
        document.put(document.tags[0].close, f"  <tendon>{text}</tendon>\n")


def put_motors(document: Document, model: Any, old: Robot, new: Robot) -> None:
    """Ripple and friction that falls, if they are others: motors nothing commands.

    Bristles are as stiff as a step allows: they swing with the inertia at the joint.
    What they hold is nothing once they slide, so that they need no damping: the dry
    friction beside them stops the joint.

    Args:
        document: The file.
        model: MuJoCo's model of it, as it was.
        old: The arm as it was.
        new: The arm as it shall be.
    """
    if not _motors_differ(old, new) and not sliding(model, old, new).any():
        return
    fastest = _SWING / model.opt.timestep  # rad/s
    stiffness = fastest**2 * _least_inertia(document, old, new)
    for joint in new.joints:
        drop_motors(document, joint)
    for number, (j, sine, cosine, k) in enumerate(new.ripple, 1):
        size, phase = np.hypot(sine, cosine), np.arctan2(-cosine, -sine)
        cogging = {"cogging": (size, k, phase)}
        _put_motor(document, new.joints[int(j)], f"ripple_{number}", cogging)
    for number, (j, level, speed) in enumerate(new.falling, 1):
        lugre = {"lugre": (stiffness[int(j)], 0.0, 0.0, level, speed)}
        _put_motor(document, new.joints[int(j)], f"falling_{number}", lugre)
    _room(document, model, new)


def drop_motors(document: Document, joint: str) -> None:
    """Take out the motors of a joint that nothing commands."""
    for kind in ("dcmotor", "general"):
        for tag in document.find("actuator", kind, input="none", joint=joint):
            document.replace(tag, "")


def _put_motor(document: Document, joint: str, name: str, has: dict[str, Any]) -> None:
    # A resistance that lets no current flow: no damping by it.
    motor = {"input": "none", "motorconst": 1.0, "resistance": 1e12}
    given = {"name": f"{joint}/{name}", "joint": joint, **motor, **has}
    text = f"  <actuator>{element('dcmotor', given)}</actuator>\n"
    document.put(document.tags[0].close, text)


def _room(document: Document, model: Any, new: Robot) -> None:
    """Give keyframes a bend of each bristle: none, of those that are new."""
    names = joint_names(model)
    gone = {
        int(model.actuator_actadr[a])
        for a, joint, _ in passive_motors(model)
        if names[joint] in new.joints
    }
    for tag in document.find("keyframe", "key"):
        if "act" in tag.attributes:
            words = enumerate(tag.attributes["act"].split())
            kept = [word for k, word in words if k not in gone]
            document.set(tag, {"act": " ".join(kept + ["0"] * len(new.falling))})


def _motors_differ(old: Robot, new: Robot) -> bool:
    pairs = (old.ripple, new.ripple), (old.falling, new.falling)
    return not all(np.array_equal(x, y) for x, y in pairs)


def sliding(model: Any, old: Robot, new: Robot) -> Array:
    """Dry friction of motors to be replaced, which the joint takes, (n,), [N·m]."""
    index, found = [joint_names(model).index(x) for x in new.joints], np.zeros(new.size)
    if _motors_differ(old, new) or (old.frictionloss != new.frictionloss).any():
        for j, level, _, _ in bristles(model, index):
            found[int(j)] += level
    return found


def _least_inertia(document: Document, old: Robot, new: Robot) -> Array:
    """Torque per acceleration at each joint in the document, (n,), [kg·m²].

    The least of many postures, all other joints free.
    """
    import mujoco

    model = model_of(document, old)
    index = [joint_names(model).index(x) for x in new.joints]
    at, dofs = model.jnt_qposadr[index], model.jnt_dofadr[index]
    low, high = np.maximum(new.q_min, -np.pi), np.minimum(new.q_max, np.pi)
    rng = np.random.default_rng(0)
    data, most = mujoco.MjData(model), model.dof_invweight0[dofs]
    inverse, unit = np.empty((2, model.nv, model.nv))
    for q in rng.uniform(low, np.maximum(low, high), (_POSTURES, new.size)):
        data.qpos[at], unit[:] = q, np.eye(model.nv)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_solveM(model, data, inverse, unit)
        most = np.maximum(most, np.diag(inverse)[dofs])
    return np.asarray(1.0 / most)


def _mobility(document: Document, old: Robot, new: Robot) -> Array:
    """Acceleration per torque at each joint in the document, (n,), [1/(kg·m²)]."""
    model = model_of(document, old)
    dofs = model.jnt_dofadr[[joint_names(model).index(x) for x in new.joints]]
    return np.asarray(model.dof_invweight0[dofs])


def put_knees(document: Document, step: float, old: Robot, new: Robot) -> None:
    """Friction that rises to a level: MuJoCo's dry friction, as soft as that.

    How soft it is depends on the inertia at the joint, so that it comes last.
    """
    names = "knee", "knee_speed", "frictionloss"
    ours, theirs = (
        np.c_[x.chain.inertial, x.chain.armature, *(getattr(x, y) for y in names)]
        for x in (new, old)
    )
    if not new.knee.any() or (ours == theirs).all():
        return
    mobility = _mobility(document, old, new)
    for j in np.flatnonzero(new.knee):
        slope = new.knee[j] / new.knee_speed[j]
        # The speed of the end of a step counts: the friction never overshoots.
        share = slope * mobility[j] * step
        d = float(np.clip(share / (1.0 + share), _SOFTEST, _HARDEST))
        given = {
            "frictionloss": new.knee[j],
            "solreffriction": (0.0, -slope * (1.0 - d) * mobility[j]),
            "solimpfriction": (d, d, *DRY["solimpfriction"][2:]),
        }
        document.set(joint_tag(document, new.joints[j]), given)
