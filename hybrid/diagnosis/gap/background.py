"""What is a little off everywhere, and not the cause.

The simulator's own numbers, and how its dry friction goes through rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.spring import Spring
from hybrid.effects.viscous import Viscous
from hybrid.robot.spatial import link_spread

_KNEES = (0.003, 0.01, 0.017, 0.03)  # rad/s
_LEADS = (0.0, 0.01)  # s
_USUALLY_OFF, _MOST_OFF = 0.01, 0.03  # of the numbers, for which that holds


@lru_cache(maxsize=1)  # each set of samples asks for them
def background(gap: Gap) -> tuple[list[Columns], list[Array]]:
    """Columns of link parameters and friction, and how far off they may be.

    Simulators, and arms, differ in how dry friction goes through rest; presliding that
    matters lasts for longer.

    Returns:
        A block of ten columns for each link, one for each declared armature, damping,
        friction loss and stiffness, and some of dry friction, declared or not, that is
        full from a small speed on; and the size of each number: it may be a few per
        cent off.
    """
    robot = gap.robot
    n = robot.size
    full: list[Array] = []
    for _, body, sampler in gap:
        columns = body.columns  # (N, n, 10n)
        rows = [sampler(columns[:, i]) for i in range(n)]
        full.append(np.stack(rows, axis=1))
    stacked = np.concatenate(full)
    std = link_spread(robot.chain.inertial)
    blocks: list[Columns] = [
        {i: stacked[:, i, 10 * k : 10 * k + 10] for i in range(k + 1)} for k in range(n)
    ]
    sizes: list[Array] = list(std)
    for value, effect in (
        (robot.chain.armature, Armature),
        (robot.damping, Viscous),
        (robot.frictionloss, Coulomb),
    ):
        for j in np.flatnonzero(value):
            blocks.append(gap.columns(effect((int(j),))))
            sizes.append(np.array([value[j]]))
    for j in np.flatnonzero(robot.stiffness):
        law = np.array([[1.0], [-robot.springref[j]]])  # k (q − q₀) per unit of k
        blocks.append({int(j): gap.columns(Spring((int(j),)))[int(j)] @ law})
        sizes.append(robot.stiffness[[j]])
    return blocks, sizes


@lru_cache(maxsize=1)  # each set of samples asks for them
def rest(gap: Gap) -> tuple[list[Columns], list[Array]]:
    """Columns of how dry friction goes through rest, and the size of each.

    Of a solver nobody knows more than what its file declares; what an arm has may be as
    soft as can be, and no softer.
    """
    size, blocks = dry_friction(gap), list[Columns]()
    for joint in range(gap.robot.size):
        blocks.append({joint: soft_friction(gap, joint, _KNEES, _LEADS)})
    return blocks, [
        np.full(x[joint].shape[1], size[joint]) for joint, x in enumerate(blocks)
    ]


@lru_cache(maxsize=1)  # each set of samples asks for them
def clocks(gap: Gap) -> tuple[list[Columns], list[Array]]:
    """Columns of torque that is logged between two samples, and how late it may be.

    A drive holds its torque from one sample to the next, and no log says when in
    between it was read: all times are known to within half a sample either way.

    Returns:
        A block of one column for each joint, and the size of its gain.
    """
    joints = range(gap.robot.size)
    size = 1.0 / gap.motions[0].rate / np.sqrt(12.0)
    blocks = [gap.columns(Delay((j,))) for j in joints]
    return blocks, [np.array([size])] * len(joints)


def dry_friction(gap: Gap) -> Array:
    """Dry friction of each joint, as declared and as the gap has it, shape (n,), [N·m].

    Many a file declares none, and what is there goes through rest as softly.
    """
    level = gap.robot.frictionloss.copy()
    for j, moving in enumerate(gap.moving.T):
        laws = [gap.columns(kind((j,)))[j] for kind in (Coulomb, Viscous, Armature)]
        columns = np.hstack([*laws, np.ones((len(moving), 1))])[moving]
        level[j] += max(0.0, np.linalg.lstsq(columns, gap.left[moving, j])[0][0])
    return level


def soft_friction(
    gap: Gap, joint: int, knees: Sequence[float], leads: Sequence[float]
) -> Array:
    """Dry friction of a joint as solvers soften it, less sharp friction.

    It is full from a speed on, the knee. A solver that asks for a deceleration of v / T
    turns it round T before the joint does, the lead.

    Returns:
        Columns of unit size for each lead and knee, shape (M, p).
    """
    parts = []
    for motion, _, sampler in gap:
        v, a = motion.v[:, joint, None], motion.a[:, joint, None]
        ahead = (v + a * np.asarray(leads))[:, :, None] / np.asarray(knees)
        soft = np.clip(ahead, -1.0, 1.0) - np.sign(v)[:, :, None]
        parts.append(sampler(soft.reshape(len(v), -1)))
    return np.concatenate(parts)
