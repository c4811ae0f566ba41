"""Learn the remainder of each joint's torque, where that lowers the held-out error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.identification.gate import lowers
from hybrid.regression.data import Data, Residual

_FEWEST_SAMPLES = 200
_LEAST_FALL = 0.01  # of the squared residuals, relative, for inputs to be of use
_COMPONENTS = (2, 4, 8, 16)
_FEATURES = 48
_RIDGES = (1e-5, 1e-3, 1e-1)  # of the squares of a feature
_MOST_SAMPLES = 3000  # of a fit that is only used for a score

Inputs = tuple[tuple[int, ...], tuple[int, ...]]  # joints of the positions, the speeds


@dataclass(frozen=True)
class Learned:
    """A learned remainder and its predictions on held-out folds.

    Attributes:
        remainder: Fitted on all samples.
        cross: Cross-validated torque: that of the regression without the fold of each
            sample, shape (N, n) for each motion, [N·m].
        squares: Held-out squares with the remainder, shape (B, n), [N²·m²].
    """

    remainder: ArmRemainder
    cross: list[Array]
    squares: Array


def fit_remainder(
    data: Data,
    held_out: Sequence[Array],
    *,
    among: ArmRemainder | None = None,
    bound: Array | float = np.inf,
    seed: int = 0,
) -> Learned:
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
    """
    n = held_out[0].shape[1]
    residual, parts = data.decimated(held_out), []
    cross = [np.zeros_like(x) for x in held_out]
    before = data.squares(held_out)
    offered = {j: _candidates(j, n) for j in range(n)}
    if among is not None:
        offered = {p.joint: [(p.positions, p.speeds)] for p in among.parts}
    limits = np.broadcast_to(bound, n)
    for joint, candidates in offered.items():
        inputs = _best_inputs(residual, joint, candidates)
        if inputs is None:
            continue
        fit = partial(_part, residual, joint, inputs, float(limits[joint]), seed)
        predicted, components = _cross_validated(data, residual, joint, inputs, fit)
        if components is None:
            continue
        corrected = [x.copy() for x in held_out]
        for x, known in zip(corrected, predicted, strict=True):
            x[:, joint] -= known
        if lowers(before, data.squares(corrected), tried=len(candidates))[joint]:
            parts.append(JointRemainder(joint, *inputs, fit(None, components)))
            for x, known in zip(cross, predicted, strict=True):
                x[:, joint] = known
    after = data.squares([x - y for x, y in zip(held_out, cross, strict=True)])
    return Learned(ArmRemainder(n, tuple(parts)), cross, after)


def _best_inputs(
    residual: Residual, joint: int, candidates: Sequence[Inputs]
) -> Inputs | None:
    """Inputs whose smooth functions lower the held-out squares most, if any do."""
    use = residual.moving[:, joint]
    y, fold = residual.tau[use, joint], residual.fold[use]
    best, chosen = (1 - _LEAST_FALL) * float(y @ y), None
    for inputs in candidates:
        error = _ridge_error(_inputs(residual.q, residual.v, inputs)[use], y, fold)
        if error < best:
            best, chosen = error, inputs
    return chosen


def _inputs(q: Array, v: Array, inputs: Inputs) -> Array:
    positions, speeds = inputs
    return np.concatenate([q[:, positions], v[:, speeds]], axis=1)


def _ridge_error(x: Array, y: Array, fold: NDArray[np.intp]) -> float:
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


def _cross_validated(
    data: Data,
    residual: Residual,
    joint: int,
    inputs: Inputs,
    fit: Callable[[int, int | None], GaussianMixtureRegression],
) -> tuple[list[Array], int | None]:
    """Torque at each sample by a regression without its fold.

    Returns:
        The torque, shape (N,) for each motion, and the number of components, which the
        first fold selects; None if the samples are too few.
    """
    fold, moving = residual.fold, residual.moving[:, joint]
    predicted, components = [np.zeros(len(m.t)) for m in data.motions], None
    for k in np.unique(fold).tolist():
        seen, held = (moving & (fold != k)).sum(), (moving & (fold == k)).sum()
        if min(seen, 4 * held) < _FEWEST_SAMPLES:
            return predicted, None
        regression = fit(k, components)
        components = regression.components
        for x, motion, own in zip(predicted, data.motions, data.folds, strict=True):
            here = own == k
            if here.any():
                at = _inputs(motion.q[here], motion.v[here], inputs)
                x[here] = regression.predict(at)[:, 0]
    return predicted, components


def _part(
    residual: Residual,
    joint: int,
    inputs: Inputs,
    bound: float,
    seed: int,
    left_out: int | None,
    components: int | None,
) -> GaussianMixtureRegression:
    """Fit on all folds but one, which selects the components if they are not given."""
    x, y = _inputs(residual.q, residual.v, inputs), residual.tau[:, joint, None]
    moving = residual.moving[:, joint]
    scoring = moving & (residual.fold == left_out)
    fitting = moving & ~scoring
    choose = components is None and bool(scoring.any())
    return GaussianMixtureRegression.fit(
        x[fitting],
        y[fitting],
        components=components,
        candidates=_COMPONENTS,
        validation=(x[scoring], y[scoring]) if choose else None,
        bound=min(bound, float(np.abs(y[fitting]).max())),
        max_samples=_MOST_SAMPLES if scoring.any() else 20_000,
        seed=seed,
    )
