"""Stage three: learn what is left, joint by joint, where that helps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.identify.data import Rest, helps
from hybrid.robot.chain import Array

_FEWEST_SAMPLES = 200
_WORTH = 0.01  # least relative fall of squares for a remainder to stay
_COMPONENTS = (1, 2, 4, 8, 16)
_MOST_SAMPLES = 3000  # of a fit that only scores; the final one takes what it needs


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
    rest: Rest, *, among: ArmRemainder | None = None, seed: int = 0
) -> Learned:
    """A Gaussian-mixture regression for each joint that gains from one.

    Each joint is offered its own position and speed, then its neighbours' too; what
    lowers the error most stays, if it does so on every fold.

    Args:
        rest: What the physical terms leave on folds they were not fitted on.
        among: Try only the joints and inputs of this remainder.
        seed: Seed of the mixtures' starts.
    """
    n = rest.tau.shape[1]
    parts, cross = [], np.zeros_like(rest.tau)
    offered = {j: _candidates(j, n) for j in range(n)}
    if among is not None:
        offered = {p.joint: [(p.positions, p.speeds)] for p in among.parts}
    for joint, candidates in offered.items():
        best = rest.squares(joint, 0.0)
        chosen = None
        for inputs in candidates:
            tried = _cross_fit(rest, joint, inputs, seed)
            if tried is None:
                continue
            components, predicted = tried
            squares = rest.squares(joint, predicted)
            if helps(best, squares, _WORTH):
                best, chosen = squares, (inputs, components)
                cross[:, joint] = predicted
        if chosen is not None:
            parts.append(_fit(rest, joint, chosen[0], None, chosen[1], seed))
    left = replace(rest, tau=rest.tau - cross).rms()
    return Learned(ArmRemainder(n, tuple(parts)), cross, left)


def _candidates(joint: int, n: int) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    near = tuple(j for j in (joint - 1, joint, joint + 1) if 0 <= j < n)
    own = (joint,)
    return [(own, own), (near, own), (own, near)]


def _cross_fit(
    rest: Rest, joint: int, inputs: tuple[tuple[int, ...], tuple[int, ...]], seed: int
) -> tuple[int, Array] | None:
    """Components, and torque at each sample by regressions that left its fold out."""
    predicted = np.zeros(len(rest.fold))
    components = None
    for fold in np.unique(rest.fold):
        fitting = rest.moving[:, joint] & (rest.fold != fold)
        scoring = rest.moving[:, joint] & (rest.fold == fold)
        if min(fitting.sum(), 4 * scoring.sum()) < _FEWEST_SAMPLES:
            return None
        part = _fit(rest, joint, inputs, fold, components, seed)
        assert isinstance(part.regression, GaussianMixtureRegression)
        components = part.regression.components
        x = part.inputs(rest.q[scoring], rest.v[scoring])
        predicted[scoring] = part.regression.predict(x)[:, 0]
    assert components is not None
    return components, predicted


def _fit(
    rest: Rest,
    joint: int,
    inputs: tuple[tuple[int, ...], tuple[int, ...]],
    left_out: int | None,
    components: int | None,
    seed: int,
) -> JointRemainder:
    """Fit on all folds but one; without a number of components that one chooses it."""
    positions, speeds = inputs
    x = np.concatenate([rest.q[:, positions], rest.v[:, speeds]], axis=1)
    y = rest.tau[:, joint, None]
    moving = rest.moving[:, joint]
    scoring = moving & (rest.fold == left_out)
    regression = GaussianMixtureRegression.fit(
        x[moving & ~scoring],
        y[moving & ~scoring],
        components=components,
        candidates=_COMPONENTS,
        max_samples=_MOST_SAMPLES if scoring.any() else 20_000,
        validation=None if components else (x[scoring], y[scoring]),
        rng=seed,
    )
    return JointRemainder(joint, positions, speeds, regression)
