"""Learn the remainder of each joint's torque, where that lowers the held-out error."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.identification.gate import lowers
from hybrid.regression.data import Data

_FEWEST_SAMPLES = 200
_LEAST_FALL = 0.01  # of the squared residuals, relative, for inputs to be of use
_COMPONENTS = (2, 4, 8, 16)
_FEATURES = 48
_RIDGES = (1e-5, 1e-3, 1e-1)  # of the squares of a feature
_MOST_SAMPLES = 3000  # of a fit that is only used for a score

Inputs = tuple[tuple[int, ...], tuple[int, ...]]  # joints of the positions, the speeds
# Positions and speeds of the arm, (M, n) each, residual of a joint, (M,), and folds.
_Samples = tuple[Array, Array, Array, Index]


def fit_remainder(
    data: Data,
    held_out: Sequence[Array],
    *,
    among: ArmRemainder | None = None,
    bound: Array | float = np.inf,
    seed: int = 0,
) -> tuple[ArmRemainder, list[Array]]:
    """Fit a Gaussian-mixture regression at each joint whose held-out error it lowers.

    The candidate inputs are the joint's own position and speed, then also those of its
    neighbours. Ridge regression on smooth features selects the inputs at little cost;
    the mixture is then fitted to those.

    Args:
        data: Motions with folds.
        held_out: Held-out residual of the physical terms, shape (N, n) for each motion,
            [N·m].
        among: Use only the joints and inputs of this remainder.
        bound: Largest learned torque, shape (n,), [N·m]. It is never larger than the
            largest residual.
        seed: Seed of the mixtures' initial values.

    Returns:
        The remainder, fitted on all samples, and its cross-validated torque: that of
        the regression without the fold of each sample, shape (N, n) for each motion,
        [N·m].
    """
    n = held_out[0].shape[1]
    parts, cross = [], [np.zeros_like(x) for x in held_out]
    before, limits = data.squares(held_out), np.broadcast_to(bound, n)
    offered = {j: _candidates(j, n) for j in range(n)}
    if among is not None:
        offered = {p.joint: [(p.positions, p.speeds)] for p in among.parts}
    for joint, candidates in offered.items():
        samples = _samples(data, [x[:, joint] for x in held_out], joint)
        inputs = _best_inputs(samples, candidates)
        if inputs is None:
            continue
        found = _learned(data, samples, inputs, float(limits[joint]), seed)
        if found is None:
            continue
        predicted, fit = found
        corrected = [x.copy() for x in held_out]
        for x, known in zip(corrected, predicted, strict=True):
            x[:, joint] -= known
        if lowers(before, data.squares(corrected), tried=len(candidates))[joint]:
            parts.append(JointRemainder(joint, *inputs, fit()))
            for x, known in zip(cross, predicted, strict=True):
                x[:, joint] = known
    return ArmRemainder(n, tuple(parts)), cross


def _samples(data: Data, residual: Sequence[Array], joint: int) -> _Samples:
    """Decimated samples at which a joint moves; its residual, (N,), gets filtered."""
    parts = []
    for motion, tau, fold in zip(data.motions, residual, data.folds, strict=True):
        keep = slice(None, None, data.sampler(motion.rate).factor)
        use, y = data.moves(motion)[keep, joint], data.sampler(motion.rate)(tau)
        parts.append(
            (motion.q[keep][use], motion.v[keep][use], y[use], fold[keep][use])
        )
    q, v, y, fold = map(np.concatenate, zip(*parts, strict=True))
    return q, v, y, fold


def _best_inputs(samples: _Samples, candidates: Sequence[Inputs]) -> Inputs | None:
    """Inputs whose smooth functions lower the held-out squares most, if any do."""
    q, v, y, fold = samples
    best, chosen = (1 - _LEAST_FALL) * float(y @ y), None
    for inputs in candidates:
        error = _ridge_error(_inputs(q, v, inputs), y, fold)
        if error < best:
            best, chosen = error, inputs
    return chosen


def _inputs(q: Array, v: Array, inputs: Inputs) -> Array:
    positions, speeds = inputs
    return np.concatenate([q[:, positions], v[:, speeds]], axis=1)


def _ridge_error(x: Array, y: Array, fold: Index) -> float:
    """Held-out squares of ridge regression on random Fourier features.

    Source: Rahimi and Recht 2007, "Random features for large-scale kernel machines".
    """
    if len(y) < _FEWEST_SAMPLES:
        return np.inf
    rng = np.random.default_rng(0)
    x = (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-12)
    phase = rng.uniform(0, 2 * np.pi, _FEATURES)
    F = np.cos(x @ rng.standard_normal((x.shape[1], _FEATURES)) + phase)
    parts = [np.column_stack([F, y])[fold == k] for k in np.unique(fold)]
    sums = np.array([p.T @ p for p in parts])
    squares = np.zeros(len(_RIDGES))
    for S in sums:
        T = sums.sum(axis=0) - S
        for k, ridge in enumerate(_RIDGES):
            A = T[:-1, :-1] + ridge * len(y) * np.eye(_FEATURES)
            c = np.append(-np.linalg.solve(A, T[:-1, -1]), 1.0)
            squares[k] += c @ S @ c
    return float(squares.min())


def _candidates(joint: int, n: int) -> list[Inputs]:
    near = tuple(j for j in (joint - 1, joint, joint + 1) if 0 <= j < n)
    own = (joint,)
    return [(own, own), (near, own), (own, near)]


def _learned(
    data: Data, samples: _Samples, inputs: Inputs, bound: float, seed: int
) -> tuple[list[Array], Callable[[], GaussianMixtureRegression]] | None:
    """Torque of a regression without the fold of each sample, and the fit to all.

    The first fold selects the number of components. It is None if there are too few
    samples.
    """
    from hybrid.compensator.gmr_fit import fit_gmr  # scikit-learn is slow to load

    q, v, y, fold = samples
    x, y, components = _inputs(q, v, inputs), y[:, None], None

    def fit(held: Mask) -> GaussianMixtureRegression:
        return fit_gmr(
            x[~held],
            y[~held],
            components=components or _COMPONENTS,
            validation=None if components else (x[held], y[held]),
            bound=min(bound, float(np.abs(y[~held]).max())),
            max_samples=_MOST_SAMPLES if held.any() else 20_000,
            seed=seed,
        )

    predicted = [np.zeros(len(m.t)) for m in data.motions]
    for k in range(data.fold_count):
        held = fold == k
        if min((~held).sum(), 4 * held.sum()) < _FEWEST_SAMPLES:
            return None
        regression = fit(held)
        components = regression.components
        for known, motion, own in zip(predicted, data.motions, data.folds, strict=True):
            here = own == k
            if here.any():
                at = _inputs(motion.q[here], motion.v[here], inputs)
                known[here] = regression.predict(at)[:, 0]
    return predicted, partial(fit, np.zeros(len(fold), dtype=bool))
