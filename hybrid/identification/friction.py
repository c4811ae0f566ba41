"""Fit of nonlinear friction of one joint: threshold, width and coefficients.

The law is linear in its coefficients for a given threshold and width, and its dry part
is piecewise linear in speed. So its columns at every pair on a grid are sums of the
same few hat functions of speed. These are filtered and multiplied once; the search over
the grid then solves small non-negative least-squares problems.

Source: Lawson and Hanson 1974, doi 10.1137/1.9781611971217 (non-negative least
squares).
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import nnls

from hybrid.arrays import Array
from hybrid.effects import Effect, JointState
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.regression.data import Data

_THRESHOLDS = 16
_WIDTHS = (0.0, 0.01, 0.04)  # of the joint's highest speed
_SMALLEST_THRESHOLD = 0.01  # of the joint's highest speed
_SMOOTH = 3  # columns of powers of speed
_COLUMNS = len(ThresholdFriction.gains)


@cache
def _shapes() -> list[dict[str, float]]:
    """Every threshold and width below it, as shares of the highest speed."""
    ratios = np.geomspace(_SMALLEST_THRESHOLD, 1.0, _THRESHOLDS).tolist()
    return [{"threshold": x, "width": w} for w in _WIDTHS for x in ratios if w < x]


@cache
def _knots() -> Array:
    """Speeds at which their laws bend, from 0 to 1, shape (K,)."""
    return np.unique([x for shapes in _shapes() for x in (0.0, *shapes.values())])


@cache
def _maps() -> Array:
    """Matrix from :func:`_columns`, load and torque to the rows of each law."""
    zero, count = np.zeros(len(_knots())), len(_knots())
    dry = _COLUMNS - _SMOOTH
    found = []
    for shapes in _shapes():
        hats = np.zeros((dry, 2 * count))
        for k, sign in enumerate((1.0, -1.0)):
            v = sign * np.maximum(_knots(), 1e-9)
            state = JointState(zero, zero, v, zero, np.sign(v), zero)
            law = ThresholdFriction.law(state, fastest=1.0, **shapes)
            hats[:, k * count : (k + 1) * count] = sign * np.stack(law[:dry])
        found.append(block_diag(hats, np.eye(_SMOOTH + 2)))
    return np.array(found)


def _columns(v: Array, fastest: float) -> Array:
    """Hat functions of each direction, then powers of speed; shape (2K + 3, N)."""
    speed, knots = abs(v), fastest * _knots()
    hats = np.array([np.interp(speed, knots, x) for x in np.eye(len(knots))])
    powers = speed ** np.arange(1, _SMOOTH + 1)[:, None]
    return np.asarray(
        np.sign(v) * np.concatenate([hats * (v > 0), hats * (v < 0), powers])
    )


def fit_friction(
    data: Data, joint: int, rest: Sequence[Array], load: Sequence[Array]
) -> tuple[Effect, ...]:
    """Threshold friction of one joint, and load friction if it lowers the error.

    It is fitted to ``rest``, the torque less all terms but friction. Rest and load, the
    torque transmitted to the link, have the shape (N,) for each motion, [N·m].
    """
    products = _maps()[:, None] @ _products(data, joint, rest, load)
    products = products @ _maps().transpose(0, 2, 1)[:, None]
    bare = np.delete(np.arange(_COLUMNS + 2), _COLUMNS)
    laws = products[:, :, bare[:, None], bare], products  # without load, and with it
    errors = np.stack([held_out(x) for x in laws], axis=1)
    best, loaded = divmod(int(errors.argmin()), 2)
    coefficients = _nonnegative(laws[loaded][best].sum(axis=0)).tolist()
    names = [g.name for g in ThresholdFriction.gains]
    values = _canonical(dict(zip(names, coefficients, strict=False)))
    fastest = float(data.visited["v_max"][joint])
    shapes = {"fastest": fastest}
    shapes |= {name: x * fastest for name, x in _shapes()[best].items()}
    effects: tuple[Effect, ...] = (ThresholdFriction((joint,), values | shapes),)
    if loaded and coefficients[-1] > 0:
        effects += (LoadFriction((joint,), {"coefficient": coefficients[-1]}),)
    return effects


def _products(
    data: Data, joint: int, rest: Sequence[Array], load: Sequence[Array]
) -> Array:
    """Cross-products of [columns, load, rest] of each fold, shape (F, rows, rows)."""
    size = _maps().shape[-1]
    fastest = float(data.visited["v_max"][joint])
    sums = np.zeros((data.fold_count, size, size))
    for motion, fold, *new in zip(data.motions, data.folds, load, rest, strict=True):
        sampler = data.sampler(motion.rate)
        moves = sampler.keep(data.moves(motion)[:, joint])
        own, v = sampler.keep(fold)[moves], motion.v[:, joint]
        new[0] = np.abs(new[0]) * np.sign(v)
        rows = sampler(np.concatenate([_columns(v, fastest), new]), axis=1)
        if data.band < np.inf:  # the rest has passed that filter
            rows[-1] = sampler.keep(new[-1])
        rows = rows[:, moves]
        for k in np.unique(own):
            part = rows[:, own == k]
            sums[k] += part @ part.T
    return sums[sums[:, -1, -1] > 0]


def _canonical(values: dict[str, float]) -> dict[str, float]:
    """The same law with one of its falling and rising parts zero."""
    both = min(values["falling"], values["rising"])
    change = {"falling": -both, "rising": -both}
    change |= {"coulomb_positive": both, "coulomb_negative": both}
    return {name: x + change.get(name, 0.0) for name, x in values.items()}


def held_out(sums: Array) -> Array:
    """Held-out squares of non-negative coefficients, summed over folds, shape (...).

    The sums are those of columns and torque of each fold, (..., F, k + 1, k + 1).
    """
    theta = _nonnegative(sums.sum(axis=-3, keepdims=True) - sums)
    left = np.concatenate([-theta, np.ones_like(theta[..., :1])], axis=-1)
    squares = np.einsum("...i,...ij,...j", left, sums, left)
    return np.asarray(np.maximum(squares, 0.0).sum(axis=-1))


def _nonnegative(sums: Array) -> Array:
    """Non-negative least-squares coefficients, shape (..., k)."""
    G, c = sums[..., :-1, :-1], sums[..., :-1, -1]
    size = np.sqrt(np.maximum(np.diagonal(G, axis1=-2, axis2=-1), 1e-300))
    values, vectors = np.linalg.eigh(G / size[..., None] / size[..., None, :])
    values = np.where(values > 1e-12 * values[..., -1:], values, 0.0)
    root = np.sqrt(values)[..., None] * vectors.swapaxes(-1, -2)
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)
    target = inverse * (root @ (c / size)[..., None])[..., 0]
    pairs = zip(
        root.reshape(-1, *root.shape[-2:]), target.reshape(-1, c.shape[-1]), strict=True
    )
    found = [nnls(x, y)[0] for x, y in pairs]
    return np.asarray(np.reshape(found, c.shape) / size)
