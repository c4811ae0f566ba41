"""Stage three: learn what is left, joint by joint, where that helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.identification.data import Data, Rest
from hybrid.identification.gate import lowers

_FEWEST_SAMPLES = 200
_WORTH = 0.01  # least relative fall of squares for anything to be learned
_COMPONENTS = (2, 4, 8, 16)
_FEATURES = 48
_RIDGES = (1e-5, 1e-3, 1e-1)  # of the squares of a feature
_MOST_SAMPLES = 3000  # of a fit that only scores; the final one takes what it needs

Inputs = tuple[tuple[int, ...], tuple[int, ...]]  # joints whose q and v are looked at


@dataclass(frozen=True)
class Learned:
    """A remainder and what it does on folds it was not fitted on.

    Attributes:
        remainder: Fitted on all samples.
        cross: Torque of the regressions that left each sample's fold out, shape (N, n)
            for each motion, [N·m].
        squares: Held-out squares with it, shape (B, n), [N²·m²].
    """

    remainder: ArmRemainder
    cross: list[Array]
    squares: Array


def fit_remainder(
    data: Data,
    left: Sequence[Array],
    *,
    among: ArmRemainder | None = None,
    bound: Array | float = np.inf,
    seed: int = 0,
) -> Learned:
    """A Gaussian-mixture regression for each joint that gains from one.

    Each joint is offered its own position and speed, then its neighbours' too. Ridge
    regression on smooth features of them tells at little cost whether they hold
    anything, and which hold most; on these the regression is learned.

    Args:
        data: Motions with folds.
        left: What the physical terms leave on folds that they were not fitted on, shape
            (N, n) for each motion, [N·m].
        among: Try only the joints and inputs of this remainder.
        bound: Largest torque that may be learned, shape (n,), [N·m]. It is never
            larger than the largest that is left.
        seed: Seed of the starts.
    """
    n = left[0].shape[1]
    rest, parts = data.sampled(left), []
    cross = [np.zeros_like(x) for x in left]
    before = data.squares(left)
    offered = {j: _candidates(j, n) for j in range(n)}
    if among is not None:
        offered = {p.joint: [(p.positions, p.speeds)] for p in among.parts}
    limits = np.broadcast_to(bound, n)
    for joint, candidates in offered.items():
        inputs = _most_telling(rest, joint, candidates)
        if inputs is None:
            continue
        fitting = _Fitting(rest, joint, inputs, float(limits[joint]), seed)
        predicted = fitting.cross(data)
        if predicted is None:
            continue
        less = [x.copy() for x in left]
        for x, known in zip(less, predicted, strict=True):
            x[:, joint] -= known
        if lowers(before, data.squares(less), tried=len(candidates))[joint]:
            parts.append(fitting.part(None))
            for x, known in zip(cross, predicted, strict=True):
                x[:, joint] = known
    after = data.squares([x - y for x, y in zip(left, cross, strict=True)])
    return Learned(ArmRemainder(n, tuple(parts)), cross, after)


def _most_telling(
    rest: Rest, joint: int, candidates: Sequence[Inputs]
) -> Inputs | None:
    """Inputs whose smooth functions lower the held-out squares most, if any do."""
    use = rest.moving[:, joint]
    y, fold = rest.tau[use, joint], rest.fold[use]
    best, chosen = (1 - _WORTH) * float(y @ y), None
    for inputs in candidates:
        left = _smooth_left(_inputs(rest, inputs)[use], y, fold)
        if left < best:
            best, chosen = left, inputs
    return chosen


def _inputs(rest: Rest, inputs: Inputs) -> Array:
    positions, speeds = inputs
    return np.concatenate([rest.q[:, positions], rest.v[:, speeds]], axis=1)


def _smooth_left(x: Array, y: Array, fold: NDArray[np.intp]) -> float:
    """Held-out squares that ridge regression on random Fourier features leaves.

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
    left = np.zeros(len(_RIDGES))
    for S in sums:
        T = sums.sum(axis=0) - S
        for k, ridge in enumerate(_RIDGES):
            A = T[:-1, :-1] + ridge * len(y) * np.eye(_FEATURES)
            c = np.append(-np.linalg.solve(A, T[:-1, -1]), 1.0)
            left[k] += c @ S @ c
    return float(left.min())


def _candidates(joint: int, n: int) -> list[Inputs]:
    near = tuple(j for j in (joint - 1, joint, joint + 1) if 0 <= j < n)
    own = (joint,)
    return [(own, own), (near, own), (own, near)]


@dataclass
class _Fitting:
    """How one joint's remainder is fitted.

    Attributes:
        rest: What is left.
        joint: The joint.
        inputs: What is looked at.
        bound: Largest torque that may be learned, [N·m].
        seed: Seed of the starts.
        components: Those of a mixture, once the first one has chosen.
    """

    rest: Rest
    joint: int
    inputs: Inputs
    bound: float
    seed: int
    components: int | None = None

    def cross(self, data: Data) -> list[Array] | None:
        """Torque at each sample by a regression that left its fold out."""
        fold, moving = self.rest.fold, self.rest.moving[:, self.joint]
        predicted = [np.zeros(len(m.t)) for m in data.motions]
        for k in np.unique(fold):
            seen, held = (moving & (fold != k)).sum(), (moving & (fold == k)).sum()
            if min(seen, 4 * held) < _FEWEST_SAMPLES:
                return None
            part = self.part(int(k))
            for x, motion, own in zip(predicted, data.motions, data.folds, strict=True):
                here = own == k
                if here.any():
                    at = part.inputs(motion.q[here], motion.v[here])
                    x[here] = part.regression.predict(at)[:, 0]
        return predicted

    def part(self, left_out: int | None) -> JointRemainder:
        """Fit on all folds but one, which chooses the size if none is known."""
        x, y = _inputs(self.rest, self.inputs), self.rest.tau[:, self.joint, None]
        moving = self.rest.moving[:, self.joint]
        scoring = moving & (self.rest.fold == left_out)
        fitting = moving & ~scoring
        choose = self.components is None and bool(scoring.any())
        regression = GaussianMixtureRegression.fit(
            x[fitting],
            y[fitting],
            components=self.components,
            candidates=_COMPONENTS,
            validation=(x[scoring], y[scoring]) if choose else None,
            bound=min(self.bound, float(np.abs(y[fitting]).max())),
            max_samples=_MOST_SAMPLES if scoring.any() else 20_000,
            seed=self.seed,
        )
        self.components = regression.components
        return JointRemainder(self.joint, *self.inputs, regression)
