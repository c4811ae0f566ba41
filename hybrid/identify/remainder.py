"""Stage three: learn what is left, joint by joint, where that helps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from hybrid.compensator import GaussianMixtureRegression, Remainder
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.identify.data import Rest, helps
from hybrid.robot.chain import Array

_FEWEST_SAMPLES = 200
_WORTH = 0.01  # least relative fall of squares for a remainder to stay
_COMPONENTS = (1, 2, 4, 8, 16)
_MOST_SAMPLES = 3000  # of a fit that only scores; the final one takes what it needs


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
            **options: ``bound``, ``max_samples`` and ``rng``.
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
        cross: At each sample, torque of the regressions that left its fold out, shape
            (M, n), [N·m].
        rms: What is left of each joint then, shape (n,), [N·m].
    """

    remainder: ArmRemainder
    cross: Array
    rms: Array


def fit_remainder(
    rest: Rest,
    *,
    among: ArmRemainder | None = None,
    bound: Array | float = np.inf,
    learn: Learner = mixture,
    seed: int = 0,
) -> Learned:
    """A regression for each joint that gains from one.

    Each joint is offered its own position and speed, then its neighbours' too; what
    lowers the error most stays, if it does so on every fold.

    Args:
        rest: What the physical terms leave on folds they were not fitted on.
        among: Try only the joints and inputs of this remainder.
        bound: Largest torque that may be learned, shape (n,), [N·m]. It is never
            larger than the largest that is left.
        learn: How to learn.
        seed: Seed of the starts.
    """
    n = rest.tau.shape[1]
    parts, cross = [], np.zeros_like(rest.tau)
    offered = {j: _candidates(j, n) for j in range(n)}
    if among is not None:
        offered = {p.joint: [(p.positions, p.speeds)] for p in among.parts}
    limits = np.broadcast_to(bound, n)
    for joint, candidates in offered.items():
        fitting = _Fitting(rest, joint, float(limits[joint]), learn, seed)
        best = rest.squares(joint, 0.0)
        chosen = None
        for inputs in candidates:
            tried = fitting.cross(inputs)
            if tried is None:
                continue
            regression, predicted = tried
            squares = rest.squares(joint, predicted)
            if helps(best, squares, _WORTH):
                best, chosen = squares, (inputs, regression)
                cross[:, joint] = predicted
        if chosen is not None:
            parts.append(fitting.part(chosen[0], None, chosen[1]))
    left = replace(rest, tau=rest.tau - cross).rms()
    return Learned(ArmRemainder(n, tuple(parts)), cross, left)


def _candidates(joint: int, n: int) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
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

    def cross(
        self, inputs: tuple[tuple[int, ...], tuple[int, ...]]
    ) -> tuple[Remainder, Array] | None:
        """A regression, and torque at each sample by those that left its fold out."""
        rest, joint = self.rest, self.joint
        predicted = np.zeros(len(rest.fold))
        regression = None
        for fold in np.unique(rest.fold):
            fitting = rest.moving[:, joint] & (rest.fold != fold)
            scoring = rest.moving[:, joint] & (rest.fold == fold)
            if min(fitting.sum(), 4 * scoring.sum()) < _FEWEST_SAMPLES:
                return None
            part = self.part(inputs, int(fold), regression)
            regression = part.regression
            x = part.inputs(rest.q[scoring], rest.v[scoring])
            predicted[scoring] = regression.predict(x)[:, 0]
        assert regression is not None
        return regression, predicted

    def part(
        self,
        inputs: tuple[tuple[int, ...], tuple[int, ...]],
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
            rng=self.seed,
        )
        return JointRemainder(self.joint, positions, speeds, regression)
