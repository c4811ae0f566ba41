"""Write friction, ripple and springs that MJCF has no joint attribute for."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any

import mujoco
import numpy as np

from hybrid.arrays import Array
from hybrid.robot.actuators import bristles, motors_of
from hybrid.robot.edit.document import Document, Tag, element, joint_tag, model_of
from hybrid.robot.mjcf import joint_numbers
from hybrid.robot.robot import Robot

_FORCES = "armature", "damping", "frictionloss"  # of a tendon
_PHASE = 1.0  # rad, of a bristle's oscillation in a time step; stable up to 2
_POSTURES = 100  # random postures in the search for the least inertia of a joint
_SOFTEST, _HARDEST = 0.0001, 0.9999  # impedances that MuJoCo allows
_WIDTH = (0.001, 0.5, 2.0)  # the rest of an impedance, which is MuJoCo's default


def hard(step: float) -> dict[str, Any]:
    """Attributes of hard dry friction at a time step, [s].

    MuJoCo's default is so soft that the friction is viscous at low speed.
    """
    impedance = (_HARDEST, _HARDEST, *_WIDTH)
    return {"solreffriction": (2 * step, 1.0), "solimpfriction": impedance}


def set_tendon(
    document: Document, joints: Sequence[str], step: float, **forces: float
) -> None:
    """Write forces on the sum of one or two joints to a tendon of an MJCF file.

    They are ``armature``, ``damping`` and ``frictionloss``, in SI units at the joints;
    the time step of the file is in seconds.
    """
    softness = hard(step) if forces["frictionloss"] else {}
    for tag, ratio in _tendons_on(document, joints):
        given = {
            name: x / (ratio if name == "frictionloss" else ratio**2)
            for name, x in forces.items()
        }
        document.set(tag, given | softness)
        forces, softness = dict.fromkeys(forces, 0.0), {}
    if any(forces.values()):
        named = {"name": "+".join(joints) + ("/dry" if len(joints) == 1 else "/rotor")}
        _append_tendon(document, named | forces | softness, joints)


def _tendons_on(
    document: Document, joints: Sequence[str]
) -> Iterator[tuple[Tag, float]]:
    """Tendons on the sum of joints, and torque at each of them per force."""
    for tag in document.find("tendon", "fixed"):
        parts = [x.attributes for x in document.children(tag, "joint")]
        ratios = {float(x.get("coef", 1.0)) for x in parts}
        same = sorted(x.get("joint", "") for x in parts) == sorted(joints)
        if same and len(ratios) == 1 and any(ratios):
            yield tag, abs(ratios.pop())


def set_couplings(document: Document, step: float, old: Robot, new: Robot) -> None:
    """Write changed rotors that turn with the sum of two joints."""
    before, after = (
        {(int(i), int(j)): forces for i, j, *forces in x.coupled.tolist()}
        for x in (old, new)
    )
    for pair in dict.fromkeys((*before, *after)):
        forces = after.get(pair, [0.0] * 3)
        if forces != before.get(pair):
            names = [new.joints[j] for j in pair]
            set_tendon(document, names, step, **dict(zip(_FORCES, forces, strict=True)))


def set_passive_motors(document: Document, model: Any, old: Robot, new: Robot) -> None:
    """Write changed ripple and Stribeck friction as motors without control input.

    LuGre bristles are as stiff as the time step allows, because they oscillate with the
    inertia at the joint. Their force vanishes when they slide. They need no damping,
    because the dry friction of the joint stops it.
    """
    if not (_motors_differ(old, new) or replaced_friction(model, old, new).any()):
        return
    frequency = _PHASE / model.opt.timestep  # rad/s
    stiffness = frequency**2 * _least_inertia(document, old, new)
    for joint in new.joints:
        remove_passive_motors(document, joint)
    for number, (j, sine, cosine, k) in enumerate(new.ripple, 1):
        size, phase = np.hypot(sine, cosine), np.arctan2(-cosine, -sine)
        cogging = {"cogging": (size, k, phase)}
        _insert_motor(document, new.joints[int(j)], f"ripple_{number}", cogging)
    for number, (j, level, speed) in enumerate(new.falling, 1):
        lugre = {"lugre": (stiffness[int(j)], 0.0, 0.0, level, speed)}
        _insert_motor(document, new.joints[int(j)], f"falling_{number}", lugre)
    _set_keyframe_bristles(document, model, new)


def set_springs(document: Document, old: Robot, new: Robot) -> None:
    """Write changed stiffening springs as tendons, each on one joint."""
    kept = len(old.stiffening)
    if not np.array_equal(old.stiffening, new.stiffening[:kept]):
        kept = 0
        for joint in {old.joints[int(row[0])] for row in old.stiffening}:
            for tag, _ in _tendons_on(document, [joint]):
                document.set(tag, {"stiffness": 0.0})
    names = {tag.attributes.get("name") for tag in document.find("tendon", "fixed")}
    for j, stiffness, rest, knee in new.stiffening[kept:].tolist():
        joint = new.joints[int(j)]
        numbered = (f"{joint}/hose_{number}" for number in count(1))
        name = next(x for x in numbered if x not in names)
        names.add(name)
        cubic = [stiffness, 0.0, stiffness / knee**2]
        given = {"name": name, "stiffness": cubic, "springlength": rest}
        _append_tendon(document, given, [joint])


def _append_tendon(
    document: Document, given: Mapping[str, Any], joints: Iterable[str]
) -> None:
    """Add a tendon that is as long as the sum of the joints' positions."""
    head = element("fixed", given).replace("/>", ">")
    parts = [element("joint", {"joint": x, "coef": 1.0}) for x in joints]
    document.append(f"<tendon>{head}{''.join(parts)}</fixed></tendon>")


def remove_passive_motors(document: Document, joint: str) -> None:
    """Remove the motors of a joint that have no control input."""
    for kind in ("dcmotor", "general"):
        for tag in document.find("actuator", kind, input="none", joint=joint):
            document.replace(tag, "")


def _insert_motor(
    document: Document, joint: str, name: str, friction: dict[str, Any]
) -> None:
    # The resistance is so large that no current flows and damps.
    motor = {"input": "none", "motorconst": 1.0, "resistance": 1e12}
    given = {"name": f"{joint}/{name}", "joint": joint, **motor, **friction}
    document.append(f"<actuator>{element('dcmotor', given)}</actuator>")


def _set_keyframe_bristles(document: Document, model: Any, new: Robot) -> None:
    """Replace the deflections of old bristles in keyframes by zeros for new ones."""
    joints = joint_numbers(model, new.joints)
    passive = motors_of(model, driven=False)
    removed = {int(model.actuator_actadr[a]) for a, j, _ in passive if j in joints}
    for tag in document.find("keyframe", "key"):
        if "act" in tag.attributes:
            words = enumerate(tag.attributes["act"].split())
            kept = [word for k, word in words if k not in removed]
            document.set(tag, {"act": " ".join(kept + ["0"] * len(new.falling))})


def _motors_differ(old: Robot, new: Robot) -> bool:
    same = np.array_equal(old.ripple, new.ripple)
    return not (same and np.array_equal(old.falling, new.falling))


def replaced_friction(model: Any, old: Robot, new: Robot) -> Array:
    """Sliding friction of motors that are replaced, shape (n,), [N·m]."""
    index, found = joint_numbers(model, new.joints), np.zeros(new.size)
    if _motors_differ(old, new) or (old.frictionloss != new.frictionloss).any():
        for j, level, *_ in bristles(model, index):
            found[int(j)] += level
    return found


def _least_inertia(document: Document, old: Robot, new: Robot) -> Array:
    """Least inertia at each joint over many postures, shape (n,), [kg·m²].

    It is torque per acceleration, with all other joints free.
    """
    model = model_of(document, old)
    index = joint_numbers(model, new.joints)
    at, dofs = model.jnt_qposadr[index], model.jnt_dofadr[index]
    low, high = np.maximum(new.q_min, -np.pi), np.minimum(new.q_max, np.pi)
    rng = np.random.default_rng(0)
    data, mobility = mujoco.MjData(model), model.dof_invweight0[dofs]
    inverse, unit = np.empty((2, model.nv, model.nv))
    for q in rng.uniform(low, np.maximum(low, high), (_POSTURES, new.size)):
        data.qpos[at], unit[:] = q, np.eye(model.nv)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_solveM(model, data, inverse, unit)
        mobility = np.maximum(mobility, np.diag(inverse)[dofs])
    return np.asarray(1.0 / mobility)


def set_knee_friction(document: Document, step: float, old: Robot, new: Robot) -> None:
    """Write friction that is linear below its level, as soft dry friction of MuJoCo.

    Its softness depends on the inertia at the joint; call this after all other edits.
    """
    names = "knee", "knee_speed", "frictionloss"
    after, before = (
        np.c_[x.chain.inertial, x.chain.armature, *(getattr(x, y) for y in names)]
        for x in (new, old)
    )
    if not new.knee.any() or (after == before).all():
        return
    model = model_of(document, old)
    dofs = model.jnt_dofadr[joint_numbers(model, new.joints)]
    mobility = model.dof_invweight0[dofs]  # acceleration per torque, 1/(kg·m²)
    for j in np.flatnonzero(new.knee):
        slope = new.knee[j] / new.knee_speed[j]
        # Friction uses the speed at the end of a step, so that it never overshoots.
        share = slope * mobility[j] * step
        d = float(np.clip(share / (1.0 + share), _SOFTEST, _HARDEST))
        given = {
            "frictionloss": new.knee[j],
            "solreffriction": (0.0, -slope * (1.0 - d) * mobility[j]),
            "solimpfriction": (d, d, *_WIDTH),
        }
        document.set(joint_tag(document, new.joints[j]), given)
