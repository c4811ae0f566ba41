"""Stage three: learn what is left, joint by joint, where that helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.compensator import GaussianMixtureRegression, Remainder
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


class Learner(Protocol):
    """How a joint's remainder is learned."""

    def __call__(
        self,
        x: Array,
        y: Array,
        *,
        like: Remainder | None,
        validation: tuple[Array, Array],
        **options: Any,
    ) -> Remainder:
        """Learn.

        Args:
            x: Inputs, shape (N, d), [rad, rad/s].
            y: Torque that is left, shape (N, 1), [N·m].
            like: A regression whose size to take; without one, choose a size.
            validation: Held-out samples to choose by; perhaps none.
            **options: ``bound``, ``max_samples`` and ``seed``.
        """


def mixture(
    x: Array,
    y: Array,
    *,
    like: Remainder | None,
    validation: tuple[Array, Array],
    **options: Any,
) -> Remainder:
    """A Gaussian-mixture regression; see :class:`Learner`."""
    if isinstance(like, GaussianMixtureRegression):
        options["components"] = like.components
    elif len(validation[0]):
        options["validation"] = validation
    return GaussianMixtureRegression.fit(x, y, candidates=_COMPONENTS, **options)


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
    learn: Learner = mixture,
    seed: int = 0,
) -> Learned:
    """A regression for each joint that gains from one.

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
        learn: How to learn.
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
        fitting = _Fitting(rest, joint, float(limits[joint]), learn, seed)
        tried = fitting.cross(inputs, data) if inputs else None
        if tried is None or inputs is None:
            continue
        regression, predicted = tried
        less = [x.copy() for x in left]
        for x, known in zip(less, predicted, strict=True):
            x[:, joint] -= known
        if lowers(before, data.squares(less), tried=len(candidates))[joint]:
            parts.append(fitting.part(inputs, None, regression))
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
    for positions, speeds in candidates:
        x = np.concatenate([rest.q[use][:, positions], rest.v[use][:, speeds]], axis=1)
        left = _smooth_left(x, y, fold)
        if left < best:
            best, chosen = left, (positions, speeds)
    return chosen


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


@dataclass(frozen=True)
class _Fitting:
    """How one joint's remainder is fitted; its fields are as for the whole arm."""

    rest: Rest
    joint: int
    bound: float
    learn: Learner
    seed: int

    def cross(self, inputs: Inputs, data: Data) -> tuple[Remainder, list[Array]] | None:
        """A regression, and torque at each sample by those that left its fold out."""
        rest, joint = self.rest, self.joint
        predicted = [np.zeros(len(m.t)) for m in data.motions]
        regression = None
        for fold in np.unique(rest.fold):
            moving = rest.moving[:, joint]
            fitting, scoring = (
                moving & (rest.fold != fold),
                moving & (rest.fold == fold),
            )
            if min(fitting.sum(), 4 * scoring.sum()) < _FEWEST_SAMPLES:
                return None
            part = self.part(inputs, int(fold), regression)
            regression = part.regression
            for x, motion, own in zip(predicted, data.motions, data.folds, strict=True):
                here = own == fold
                if here.any():
                    at = part.inputs(motion.q[here], motion.v[here])
                    x[here] = regression.predict(at)[:, 0]
        assert regression is not None
        return regression, predicted

    def part(
        self,
        inputs: Inputs,
        left_out: int | None,
        like: Remainder | None,
    ) -> JointRemainder:
        """Fit on all folds but one; without a regression like it that one chooses."""
        (positions, speeds), rest = inputs, self.rest
        x = np.concatenate([rest.q[:, positions], rest.v[:, speeds]], axis=1)
        y = rest.tau[:, self.joint, None]
        moving = rest.moving[:, self.joint]
        scoring = moving & (rest.fold == left_out)
        fitting = moving & ~scoring
        regression = self.learn(
            x[fitting],
            y[fitting],
            like=like,
            validation=(x[scoring], y[scoring]),
            bound=min(self.bound, float(np.abs(y[fitting]).max())),
            max_samples=_MOST_SAMPLES if scoring.any() else 20_000,
            seed=self.seed,
        )
        return JointRemainder(self.joint, positions, speeds, regression)
