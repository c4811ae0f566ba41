"""Compilation of a robot with effects to a MuJoCo model."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array, Index
from hybrid.dynamics import inverse_dynamics as rigid_torque
from hybrid.effects import Effect, JointEffect, Port
from hybrid.errors import EffectError, HybridError
from hybrid.robot.robot import Robot

_INTEGRATORS = "euler", "implicit", "implicitfast", "rk4"
# Impedance of dry friction, which MuJoCo holds as a soft constraint. A stuck joint
# creeps with (1 − impedance)·step of its free acceleration.
IMPEDANCE = 0.9999
_HOOKS = (
    "edit_spec", "actuator", "deliver", "resist", "push", "sense", "measure", "report",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Arm:
    """A compiled arm of n motor joints, some of them in series with a deflection."""

    model: Any  # its dofs are motor joints and deflections, in any order
    motor: Index  # dof of each motor joint, (n,)
    # Joint of each deflection, (m,); one with elasticity and backlash occurs twice.
    elastic: Index
    deflection: Index  # dof of each deflection, (m,)
    behind: tuple[str, ...]  # kind of each deflection, see `Effect.behind`
    armature: Array  # rotor inertia of each motor joint, (n,), [kg·m²]
    tip: int  # MuJoCo body of the last link


def build_arm(
    robot: Robot, effects: Sequence[Effect], *, step: float, integrator: str
) -> Arm:
    """Compile an arm with the effects that MuJoCo simulates itself.

    Effects edit the spec in the order of their ports, so that a spring finds the rotor
    it needs.

    Raises:
        HybridError: Step [s] or integrator is not valid, or MuJoCo refuses the model.
        EffectError: An effect cannot be simulated.
    """
    if integrator not in _INTEGRATORS:
        raise HybridError(
            f"no integrator {integrator!r}; valid are {', '.join(_INTEGRATORS)}"
        )
    if not 1e-6 <= step <= 0.01:
        raise HybridError(f"step is {step:g} s, valid is 1e-6 to 0.01 s")
    check_simulable(effects, robot.size)
    spec = robot.mujoco_spec()
    for effect in sorted(effects, key=lambda e: list(Port).index(e.port)):
        effect.edit_spec(spec, robot.joints)
    try:
        model = spec.compile()
    except ValueError as error:
        reason = str(error).replace("\n", " ")
        raise HybridError(f"MuJoCo refuses {robot.name!r}: {reason}") from error
    model.opt.timestep = step
    number = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    model.opt.integrator = number
    # An automatic reset would move the arm without a warning; Lockstep stops instead.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model.opt.tolerance = 1e-12
    for solref, solimp in (
        (model.dof_solref, model.dof_solimp),
        (model.tendon_solref_fri, model.tendon_solimp_fri),
    ):
        solref[:] = 2 * step, 1.0
        solimp[:, :2] = IMPEDANCE
    kinds = dict.fromkeys(e.behind for e in effects if e.behind)
    return _indexed(model, robot.joints, kinds)


def _indexed(model: Any, joints: Sequence[str], kinds: Iterable[str]) -> Arm:
    dof = {model.joint(j).name: int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    behind = [
        (k, dof[f"{name}/{kind}"], kind)
        for k, name in enumerate(joints)
        for kind in kinds
        if f"{name}/{kind}" in dof
    ]
    motor = np.array([dof[name] for name in joints], dtype=np.intp)
    return Arm(
        model=model,
        motor=motor,
        elastic=np.array([k for k, _, _ in behind], dtype=np.intp),
        deflection=np.array([d for _, d, _ in behind], dtype=np.intp),
        behind=tuple(kind for _, _, kind in behind),
        armature=model.dof_armature[motor].copy(),
        tip=model.body(joints[-1]).id,
    )


def overrides(effect: Effect, hook: str) -> bool:
    """Whether the class of an effect overrides a hook."""
    return getattr(type(effect), hook) is not getattr(Effect, hook)


def has_hook(effect: Effect) -> bool:
    """Whether the class of an effect overrides any hook of the plant."""
    return any(overrides(effect, hook) for hook in _HOOKS)


def drives(effect: Effect) -> bool:
    """Whether the effect changes the torque between command and delivery."""
    return overrides(effect, "deliver") or "lag" in effect.actuator


def encoder_readings(
    effects: Sequence[Effect], q: Array, v: Array
) -> tuple[Array, Array]:
    """Position and speed that the encoders show for the true ones, shape (B, n)."""
    for effect in effects:
        if overrides(effect, "sense"):
            q, v, j = q.copy(), v.copy(), list(effect.joints)
            q[:, j], v[:, j] = effect.sense(q[:, j], v[:, j])
    return q, v


@typed
def check_simulable(effects: Sequence[Effect], size: int) -> None:
    """Refuse effects that a plant of n joints cannot simulate."""
    for effect in effects:
        lawful = isinstance(effect, JointEffect) or bool(effect.memory)
        if not (has_hook(effect) or lawful):
            raise EffectError(
                f"{effect.id} cannot be simulated: it is no JointEffect, remembers "
                f"nothing, and overrides none of {', '.join(_HOOKS)}"
            )
        if not all(0 <= j < size for j in effect.joints):
            raise EffectError(
                f"{effect.id} acts on joints {effect.joints}, the arm has {size}"
            )


def inverse_dynamics(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    """Torque of rigid body, rotors and springs, without friction, (N, n), [N·m].

    The motion has the shape (N, n), in [rad], [rad/s] and [rad/s²].
    """
    smooth = replace(robot, ripple=robot.ripple[:0])
    rigid = rigid_torque(robot.chain, robot.chain.inertial, q, v, a)
    return rigid + smooth.joint_torque(q, np.zeros_like(v), a)
