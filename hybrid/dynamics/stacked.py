"""Columns of rigid body and effects, and their base parameters."""

from collections.abc import Collection, Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.base import BaseParameters, base_parameters, inertial_labels
from hybrid.dynamics.body import RigidBody
from hybrid.effects import Effect
from hybrid.robot.chain import Chain
from hybrid.signals import Motion

_STRUCTURE_SAMPLES = 600


def effect_gains(
    effects: Sequence[Effect], without: Collection[tuple[int, str]] = ()
) -> tuple[tuple[int, int], ...]:
    """Indices (effect, gain) of every unknown gain, in the order of the columns."""
    return tuple(
        (e, g)
        for e, effect in enumerate(effects)
        for g, gain in enumerate(effect.gains)
        if (e, gain.name) not in without
    )


def stacked_base(
    chain: Chain, effects: Sequence[Effect], gains: Sequence[tuple[int, int]]
) -> BaseParameters:
    """Base parameters of all inertial parameters and gains."""
    labels, units = inertial_labels(chain.size)
    labels += tuple(gain_labels(chain.joints, effects, effects[e])[g] for e, g in gains)
    units += tuple(
        chain.unit_at(effects[e].unit_joints, effects[e].gains[g].unit)
        for e, g in gains
    )
    stacked = stacked_columns(chain, effects, gains, rich_motion(chain))
    return base_parameters(stacked.reshape(-1, stacked.shape[2]), labels, units)


def gain_labels(
    joints: Sequence[str], effects: Sequence[Effect], effect: Effect
) -> list[str]:
    """Labels of the gains of an effect, which is one of several on these joints."""
    where = "+".join(joints[j] for j in effect.joints)
    where = "arm" if effect.scope == "arm" else where
    if sum((x.id, x.joints) == (effect.id, effect.joints) for x in effects) > 1:
        # Two ripples of one joint differ only in their shapes.
        shapes = [s.name for s in effect.shapes if not s.whole]
        where = ", ".join([where, *(f"{x} {effect.values[x]:.6g}" for x in shapes)])
    return [f"{effect.id}.{gain.name}[{where}]" for gain in effect.gains]


def stacked_columns(
    chain: Chain,
    effects: Sequence[Effect],
    gains: Sequence[tuple[int, int]],
    motion: Motion,
) -> Array:
    """All columns of all joints, shape (N, n, 10n + gains)."""
    # A robot file without inertias must not hide effects that need a load.
    inertial = np.where(np.any(chain.inertial), chain.inertial, 1.0)
    body = RigidBody(chain, motion, inertial)
    rigid = 10 * chain.size
    stacked = np.zeros((len(motion.t), chain.size, rigid + len(gains)))
    stacked[:, :, :rigid] = body.columns
    values = [effect.columns(motion, body) for effect in effects]
    for column, (e, g) in enumerate(gains, rigid):
        reached = list(effects[e].reaches(chain.size))
        stacked[:, reached, column] = values[e][:, :, g]
    return stacked


def rich_motion(chain: Chain) -> Motion:
    """A motion that excites every parameter: six incommensurate tones a joint.

    It is always the same and ignores limits, since only the column space matters.
    """
    rng = np.random.default_rng(20080523)
    n = chain.size
    t = np.linspace(0.0, 20.0, _STRUCTURE_SAMPLES)
    frequency = rng.uniform(0.3, 6.0, (6, 1, n))
    phase = rng.uniform(0, 2 * np.pi, (6, 1, n))
    size = rng.uniform(0.2, 0.6, (6, 1, n))
    angle = frequency * t[:, None] + phase
    q = (size * np.sin(angle)).sum(axis=0)
    v = (size * frequency * np.cos(angle)).sum(axis=0)
    a = -(size * frequency**2 * np.sin(angle)).sum(axis=0)
    mask = np.ones(len(t), dtype=bool)
    temperature = 25 + 10 * rng.random((len(t), n)).cumsum(axis=0) / len(t)
    # A torque beyond any limit, for effects that depend on the logged torque.
    tau = 1e4 * rng.standard_normal((len(t), n))
    return Motion(t, q, v, a, tau, mask, temperature, chain.joints)
