"""The background of a gap: small errors that every simulator has, and no causes.

They are errors of the numbers of the robot file, the shape of dry friction near rest,
and the time between two samples.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from weakref import WeakKeyDictionary

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Columns, Gap, stacked
from hybrid.effects import Effect, Port, effect_at, effect_classes
from hybrid.plant.joint_fields import declared_effects
from hybrid.robot.spatial import link_spread

_Blocks = tuple[list[Columns], list[Array]]
_KNEES = (0.003, 0.01, 0.017, 0.03)  # rad/s, speed of full friction
_LEADS = (0.0, 0.01)  # s, time by which a solver reverses friction early


def _once(function: Callable[[Gap], _Blocks]) -> Callable[[Gap], _Blocks]:
    """A function that is evaluated once for each gap, and kept as long as the gap."""
    known: WeakKeyDictionary[Gap, _Blocks] = WeakKeyDictionary()

    @wraps(function)
    def of(gap: Gap) -> _Blocks:
        if gap not in known:
            known[gap] = function(gap)
        return known[gap]

    return of


@_once  # the training and the test samples share them
def background(gap: Gap) -> _Blocks:
    """Columns of the numbers of the robot file, and the size of each number.

    A block has ten columns for each link, and there is one of a column for each rotor,
    friction and spring that the file declares: its torque, of size one. The relative
    error of a number refers to its size.
    """
    if gap.joins:
        return _stacked(gap, background)
    robot = gap.robot
    blocks = [_link(gap, k) for k in range(robot.size)]
    sizes = list(link_spread(robot.chain.inertial))
    for effect in declared_effects(robot):
        one, gains = gap.columns(effect), effect.gain_values
        blocks.append({j: (x @ gains)[:, None] for j, x in one.items()})
        sizes.append(np.ones(1))
    return blocks, sizes


def _link(gap: Gap, k: int) -> Columns:
    """Columns of the ten numbers of a link, at all joints before it, (M, 10) each."""
    # In the lower band, as those of effects that differentiate.
    along = [body.link_columns(k)[:, : k + 1] for _, body, _ in gap.lower_band]
    return dict(enumerate(gap.filtered(along).swapaxes(0, 1)))


@_once  # the training and the test samples share them
def friction_near_rest(gap: Gap) -> _Blocks:
    """Columns of soft dry friction near rest, and the size of each gain."""
    # Arms and solvers differ in the speed at which dry friction is full.
    level, (blocks, _) = dry_friction(gap), _soft(gap)
    sizes = [np.full(x[j].shape[1], level[j]) for j, x in enumerate(blocks)]
    return blocks, sizes


@_once  # two joins may share a gap
def _soft(gap: Gap) -> _Blocks:
    """The columns of :func:`friction_near_rest`."""
    if gap.joins:
        return _stacked(gap, _soft)
    joints = range(gap.robot.size)
    return [{j: soft_friction(gap, j, _KNEES, _LEADS)} for j in joints], []


def _stacked(gap: Gap, blocks: Callable[[Gap], _Blocks]) -> _Blocks:
    """Blocks of the gaps that a gap joins, one after the other."""
    each, (sizes, *_) = zip(*map(blocks, gap.joins), strict=True)
    return [stacked(x) for x in zip(*each, strict=True)], sizes


@_once  # the training and the test samples share them
def sampling_delays(gap: Gap) -> _Blocks:
    """Columns of torque read between two samples, and standard deviations of gains."""
    # No log says when torque was read within a sample: its time is uniform over one.
    delay = effect_at(Port.MEASUREMENT, shifts=True)
    late = [delay((j,)) for j in range(gap.robot.size)]
    size = gap.period / np.sqrt(12.0)
    return [gap.columns(x) for x in late], [np.array([size])] * len(late)


def dry_friction(gap: Gap) -> Array:
    """Dry friction of each joint: declared, and fitted to the gap, (n,), [N·m]."""
    level = gap.robot.frictionloss.copy()
    fields = [cls.fields.get(g.name) for cls in _usual() for g in cls.gains]
    for j, moving in enumerate(gap.moving.T):
        columns = np.hstack(usual_columns(gap, j))[moving]
        gains = np.linalg.lstsq(columns, gap.left[moving, j])[0]
        level[j] += max(0.0, gains[fields.index("frictionloss")])
    return level


def usual_columns(gap: Gap, joint: int) -> list[Array]:
    """Columns of what most drives have: friction, a rotor; shape (M, p) each."""
    return [gap.columns(cls((joint,)))[joint] for cls in _usual()]


def _usual() -> list[type[Effect]]:
    return [cls for cls in effect_classes().values() if cls.usual]


def soft_friction(
    gap: Gap, joint: int, knees: Sequence[float], leads: Sequence[float]
) -> Array:
    """Soft dry friction of a joint, less the sharp one, for each lead and knee, (M, p).

    Friction is full from a speed on, the knee, [rad/s]. A solver reverses it before the
    joint does, by the lead, [s].
    """
    parts, knee = [], np.asarray(knees)[:, None]
    for motion in gap.motions:
        v, a = motion.v[:, joint], motion.a[:, joint]
        ahead = np.stack([v + a * lead for lead in leads])
        soft = np.clip(ahead[:, None] / knee, -1.0, 1.0) - np.sign(v)
        parts.append(soft.reshape(-1, 1, len(v)).T)
    return gap.filtered(parts)[:, 0]
