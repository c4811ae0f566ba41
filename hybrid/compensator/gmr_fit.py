"""Fit of the mixture: expectation maximisation, and selection of its size."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from hybrid.arrays import Array
from hybrid.errors import IdentificationError

if TYPE_CHECKING:
    from hybrid.compensator.gmr import GaussianMixtureRegression

TRUSTED_SHARE = 0.995  # of the training samples, within the start of the fade
FADE_RATIO = 4.0  # squared distance at the end of the fade, over that at its start
_MOST_ROUNDS = 200  # of expectation maximisation
CONSTANT = 1e-12  # relative variation of a channel that counts as constant


def fit_gmr(
    kind: type[GaussianMixtureRegression],
    pair: tuple[Array, Array],
    held_out: tuple[Array, Array] | None,
    *,
    candidates: Sequence[int],
    bound: Array,
    floor: float,
    rng: np.random.Generator,
) -> GaussianMixtureRegression:
    """See :meth:`GaussianMixtureRegression.fit`, of checked samples."""
    joint = np.hstack([_standardise(values) for values in pair])
    models: dict[int, GaussianMixtureRegression] = {}
    scores: dict[int, float] = {}
    for count in _usable(candidates, *joint.shape):
        mixture = _run_em(joint, count, floor=floor, rng=rng)
        models[count] = model = _build(kind, mixture, *pair, bound, floor)
        if held_out is None:
            scores[count] = -mixture.bic(joint) / (2.0 * len(joint))
        else:
            scores[count] = predictive_log_likelihood(model, *held_out)
    return models[choose_components(scores)]


def choose_components(
    scores: Mapping[int, float], *, indifference: float = 0.01
) -> int:
    """The smallest number of components that is as good as the best.

    Scores are log-likelihoods per sample by number of components, [nat]. A difference
    of 0.01 nat is a standard deviation 1 % larger, and does not count.
    """
    best = max(scores.values())
    return min(k for k, score in scores.items() if score >= best - indifference)


def predictive_log_likelihood(
    model: GaussianMixtureRegression, x: Array, y: Array
) -> float:
    """Log-likelihood of torque y, summed over outputs, mean over samples, [nat].

    Bound and fade are included, so that a few samples outside the training range cannot
    outweigh all others.
    """
    mean, variance = model.predict_distribution(x)
    terms = np.log(2.0 * np.pi * variance) + (y - mean) ** 2 / variance
    return float(-0.5 * terms.sum(axis=1).mean())


def _usable(candidates: Sequence[int], samples: int, width: int) -> list[int]:
    # A covariance of full rank needs one sample more than it has rows.
    largest = samples // (width + 1)
    usable = sorted({int(k) for k in candidates if 1 <= k <= largest})
    if not usable:
        raise IdentificationError(
            f"{samples} samples cannot support {sorted(candidates)} components of "
            f"{width} channels, valid is 1 to {largest}"
        )
    return usable


def _offset_and_scale(values: Array) -> tuple[Array, Array]:
    offset, scale = values.mean(axis=0), values.std(axis=0)
    size = np.maximum(np.abs(offset), 1.0)
    return offset, np.where(scale > CONSTANT * size, scale, size)


def _standardise(values: Array) -> Array:
    offset, scale = _offset_and_scale(values)
    return (values - offset) / scale


def _run_em(
    joint: Array, count: int, *, floor: float, rng: np.random.Generator
) -> GaussianMixture:
    mixture = GaussianMixture(
        count,
        covariance_type="full",
        init_params="k-means++",
        reg_covar=floor,
        tol=1e-3,
        max_iter=_MOST_ROUNDS,
        random_state=int(rng.integers(2**31)),
    )
    with warnings.catch_warnings():
        # Early stopping is no error, since the held-out score compares the results.
        warnings.simplefilter("ignore", ConvergenceWarning)
        try:
            return mixture.fit(joint)
        except ValueError as error:
            raise IdentificationError(
                f"{count} components cannot be fitted to {len(joint)} samples with "
                f"covariance_floor {floor:g}; fewer components or a larger floor "
                "such as 1e-4 can"
            ) from error


def _build(
    kind: type[GaussianMixtureRegression],
    mixture: GaussianMixture,
    x: Array,
    y: Array,
    bound: Array,
    floor: float,
) -> GaussianMixtureRegression:
    input_offset, input_scale = _offset_and_scale(x)
    output_offset, output_scale = _offset_and_scale(y)
    offset = np.concatenate([np.zeros_like(input_offset), output_offset])
    scale = np.concatenate([np.ones_like(input_scale), output_scale])
    model = kind(
        weights=mixture.weights_,
        means=offset + scale * mixture.means_,
        covariances=mixture.covariances_ * np.outer(scale, scale),
        input_offset=input_offset,
        input_scale=input_scale,
        prior_variance=np.maximum((y**2).mean(axis=0), floor * output_scale**2),
        bound=bound,
        fade=np.array([1.0, FADE_RATIO]),
    )
    seen = float(np.quantile(model.distance(x), TRUSTED_SHARE))
    start = max(seen, 1.0)
    return replace(model, fade=np.array([start, FADE_RATIO * start]))
