"""Whether the links and the gravity of a robot file are those of the arm in the logs.

The torque of the file's links, beyond what drives explain (friction, rotors, offsets),
is compared at each joint with that of any links on this chain, and with that of the
same links in gravity from anywhere. An error of one link, a spring, or what an arm
carries, leaves most joints as they are; another arm does not.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.background import background, usual_columns
from hybrid.diagnosis.gap.gap import Gap

_LEAST_GAIN = 1.0  # nat, of another gravity; of right files none reached 0.1
_LEAST_LEFT = 0.01  # of a joint's squares: a law of friction leaves as much
_LARGEST_TILT = 0.2  # rad; a smaller one is an error of mounting
_LIGHTEST = 0.5  # of the file's masses
_HALF = 0.5  # of squares, and of joints
_FEWEST_JOINTS = 2  # one may have a cause of its own
_RANK = 1e-3  # smallest singular value, over the largest
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class _Joint:
    """Torque of a joint beyond its drive, over the root of its squares."""

    left: Array  # measured less simulated, (M,)
    gravity: Array  # of the file's links, per gravity in x, y and z, (M, 3)
    least: float  # share of the squares that any links on the chain leave

    def squares(self, change: Array) -> float:
        """What the file's links leave in gravity that is changed, shape (3,)."""
        return float(np.sum((self.left - self.gravity @ change) ** 2))

    def is_bad(self, change: Array) -> bool:
        """Whether they explain less than half of what any links do in the file's."""
        return self.squares(change) > 1.0 - _HALF * (1.0 - self.least)


class Unlike(NamedTuple):
    """What of a file is not as in the logs, in a few words and as a doubt; or empty."""

    short: str
    doubt: str


def unlike(gap: Gap) -> Unlike:
    """Say whether the file's links or its gravity are not this arm's."""
    # Gravity comes first: with another one no links fit.
    joints = list(_joints(gap))
    return _other_gravity(gap, joints) or _other_arm(joints) or Unlike("", "")


def _other_gravity(gap: Gap, joints: list[_Joint]) -> Unlike | None:
    """Say that gravity comes from elsewhere than in the file, if it clearly does."""
    # The file's links in gravity of any size and direction, which have to fit, are
    # compared with those in gravity of other sizes, as masses may be off.
    if not joints:
        return None
    own = gap.robot.chain.gravity
    change = _least_squares([x.gravity for x in joints], joints)
    scale = _least_squares([x.gravity @ own[:, None] for x in joints], joints)
    other, scaled = own + change, max(_LIGHTEST - 1.0, float(scale[0])) * own
    before, after = (
        np.maximum([x.squares(g) for x in joints], _LEAST_LEFT)
        for g in (scaled, change)
    )
    gain = 0.5 * float(np.log(before / after).sum())
    sizes = [np.linalg.norm(g) for g in (other, own)]
    aligned = own.any() and other @ own >= np.cos(_LARGEST_TILT) * np.prod(sizes)
    if gain < _LEAST_GAIN or aligned or _bad_joints(joints, change):
        return None
    in_file, in_logs = (
        "(" + ", ".join(f"{x:.1f}".replace("-0.0", "0.0") for x in g) + ")"
        for g in (own, other)
    )
    short = f"gravity of the file, {in_file}, is not that of the logs, {in_logs} m/s²"
    doubt = "another gravity than that of the file fits the logs far better: is the "
    return Unlike(short, f"{doubt}arm mounted otherwise, or gravity switched off?")


def _other_arm(joints: list[_Joint]) -> Unlike | None:
    """Say that most joints have other links than in the file, if they have."""
    count = _bad_joints(joints, np.zeros(3))
    if not count:
        return None
    return Unlike(
        f"links of the file do not fit the logs at {count} of {len(joints)} joints",
        "the file's links explain less than half of the torque that other links would: "
        "is it the file of this robot? is torque in N·m, and position in radians?",
    )


def _bad_joints(joints: list[_Joint], change: Array) -> int:
    """Number of joints that other links would explain far better; 0 if not most."""
    told = [x.is_bad(change) for x in joints if x.least < _HALF]
    count = sum(told)
    return count if count >= _FEWEST_JOINTS and count > _HALF * len(told) else 0


def _least_squares(columns: list[Array], joints: list[_Joint]) -> Array:
    """Coefficients of the columns of all joints that leave least, shape (p,)."""
    left = np.concatenate([x.left for x in joints])
    return np.asarray(np.linalg.lstsq(np.concatenate(columns), left, rcond=_RANK)[0])


def _joints(gap: Gap) -> Iterator[_Joint]:
    """Joints that move."""
    links = background(gap)[0][: gap.robot.size]
    load = np.concatenate([sampler(body.load) for _, body, sampler in gap])
    gravity = np.concatenate([
        np.stack([sampler(body.weight(g)) for g in np.eye(3)], axis=-1)
        for _, body, sampler in gap.lower_band
    ])  # fmt: skip
    for j in np.flatnonzero(gap.moving.any(axis=0)).tolist():
        used = gap.moving[:, j]
        basis = _basis(np.hstack(usual_columns(gap, j))[used])

        def beyond(x: Array, basis: Array = basis) -> Array:
            return np.asarray(x - basis @ (basis.T @ x))

        left = gap.left[used, j]
        torque = beyond(left + load[used, j])
        size = max(float(np.linalg.norm(torque)), _TINY)
        any_links = _basis(beyond(np.hstack([x[j] for x in links if j in x])[used]))
        least = 1.0 - float(np.sum((any_links.T @ torque / size) ** 2))
        yield _Joint(beyond(left) / size, beyond(gravity[used, j]) / size, least)


def _basis(columns: Array) -> Array:
    """Orthonormal basis of the space of columns, shape (M, r)."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > _TINY] / size[size > _TINY]
    if not columns.size:
        return columns[:, :0]
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, values > _RANK * values[0]])
