"""Log Bayes factors of a few columns, with Gaussian priors of their gains."""

import numpy as np

from hybrid.arrays import Array

_LINEAR = 0.3  # smallest ratio of two gains, for which the columns of one serve both
# By which a prior may be wider, or narrower below 1: half decades.
PRIOR_FACTORS = tuple(10.0 ** (k / 2) for k in range(-4, 5))


def log_bayes(
    H: Array,
    s: Array,
    precision: Array,
    lower: Array,
    fixed_gains: Array | None = None,
) -> tuple[Array, Array]:
    """Log Bayes factor and most probable gains, within their lower bounds.

    Args:
        H: Normal matrix of the columns over the noise variance, shape (..., p, p).
        s: Its right-hand side, shape (..., p).
        precision: Inverse prior variance of each gain, shape (..., p).
        lower: Lower bound of each gain, shape (..., p).
        fixed_gains: Gains at which nonlinear columns were evaluated, shape (..., p).
            They are kept where the most probable gains differ much from them.

    Returns:
        Log evidence with the columns less that without, [nat], shape (...), and the
        gains, shape (..., p).
    """
    unit = 1.0 / np.sqrt(precision)
    A = np.eye(s.shape[-1]) + unit[..., :, None] * H * unit[..., None, :]
    b, least = unit * s, lower * np.sqrt(precision)
    x = np.asarray(np.linalg.solve(A, b[..., None])[..., 0])
    least = np.broadcast_to(least, x.shape)
    out = np.any(x < least, axis=-1)
    if out.any():
        x[out] = _within_bounds(A[out], b[out], x[out], least[out])
    _, occam = np.linalg.slogdet(A)
    worth, gains = _quadratic(A, b, x) - 0.5 * occam, np.asarray(unit * x)
    if fixed_gains is not None:
        far = (gains < _LINEAR * fixed_gains) | (gains > fixed_gains / _LINEAR)
        fixed = np.any(far, axis=-1)
        worth = np.where(fixed, _quadratic(H, s, fixed_gains), worth)
        gains = np.where(fixed[..., None], fixed_gains, gains)
    return np.asarray(worth), gains


def heavy_tailed(
    H: Array,
    s: Array,
    precision: Array,
    lower: Array,
    fixed_gains: Array | None = None,
) -> tuple[Array, Array, Array]:
    """:func:`log_bayes` with the best of some priors, less those of other sizes.

    The typical size of a gain is not known well: files hold placeholders, and drives
    are of all sizes. It is about as large for all gains of a law.

    Returns:
        The log Bayes factor, [nat], shape (...), the most probable gains, shape
        (..., p), and the factor by which the prior is wider, shape (...).
    """
    factors = np.array(PRIOR_FACTORS).reshape(-1, *[1] * s.ndim)
    worth, gains = log_bayes(H, s, precision / factors**2, lower, fixed_gains)
    worth = worth - size_odds(factors[..., 0])
    best = np.argmax(worth, axis=0)
    chosen = np.take_along_axis(gains, best[None, ..., None], axis=0)[0]
    return worth.max(axis=0), chosen, np.array(PRIOR_FACTORS)[best]


def size_odds(factor: Array | float) -> Array:
    """Log odds against gains that are larger or smaller by a factor than usual, [nat].

    A decade off is ten times less probable.
    """
    return np.asarray(np.abs(np.log(factor)))


def _within_bounds(A: Array, b: Array, x: Array, least: Array) -> Array:
    """Solutions of A x = b, (B, p), with those below their bounds held there."""
    free = x >= least
    held = np.where(free, 0.0, least)
    rest = np.where(free, b - (A @ held[..., None])[..., 0], held)
    both = free[..., :, None] & free[..., None, :]
    among = np.where(both, A, np.eye(x.shape[-1]) * ~free[..., None])
    return np.maximum(np.linalg.solve(among, rest[..., None])[..., 0], least)


def _quadratic(A: Array, b: Array, x: Array) -> Array:
    return np.asarray((b * x).sum(-1) - 0.5 * np.einsum("...k,...kl,...l", x, A, x))
