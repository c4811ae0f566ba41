"""Fit of the mixture: expectation maximisation, and selection of its size."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from hybrid.arrays import Array
from hybrid.compensator.gmr import GaussianMixtureRegression, check_matrix
from hybrid.errors import HybridError, IdentificationError

TRUSTED_SHARE = 0.995  # of the training samples, within the start of the fade
FADE_RATIO = 4.0  # squared distance at the end of the fade, over that at its start
_MOST_ROUNDS = 200  # of expectation maximisation
_INDIFFERENCE = 0.01  # nat per sample
CONSTANT = 1e-12  # relative variation of a channel that counts as constant


def fit_gmr(
    x: ArrayLike,
    y: ArrayLike,
    *,
    components: int | Sequence[int] = (1, 2, 4, 8, 16),
    validation: tuple[ArrayLike, ArrayLike] | None = None,
    seed: int | np.random.Generator = 0,
    covariance_floor: float = 1e-4,
    max_samples: int = 20_000,
    bound: ArrayLike | None = None,
) -> GaussianMixtureRegression:
    """Learn a mixture by expectation maximisation.

    Args:
        x: Inputs such as joint position and speed, shape (N, d), any unit.
        y: Residual torque of the physical terms, shape (N, 1), [N·m].
        components: Number of components K, or numbers of which the best is chosen.
        validation: Held-out ``(x, y)``, preferably whole motions; they choose K by
            predictive likelihood. Without them BIC chooses K, which assumes
            independent samples and so tends to a number too large.
        seed: Seed or generator; equal seeds give equal models.
        covariance_floor: Added to every variance, as a share of the variance of its
            channel. It prevents components that collapse on a standstill, at whose
            border the torque would jump.
        max_samples: Largest number of rows, drawn without replacement.
        bound: Largest absolute output, shape (1,) or scalar, [N·m], for instance a
            share of the rated torque; the largest residual in ``y`` by default.

    Raises:
        HybridError: An array has the wrong shape or holds NaN or infinity.
        IdentificationError: Too few samples for the number of components.
    """
    x, y = check_pair(x, y, columns=(None, 1))
    rng = np.random.default_rng(seed)
    limit = np.atleast_1d(np.abs(y).max() if bound is None else bound)
    pair = draw(x, y, max_samples, rng)
    if validation is not None:
        checked = check_pair(*validation, columns=(x.shape[1], 1))
        held_out = draw(*checked, max_samples, rng)
    units = [_offset_and_scale(values) for values in pair]
    joint = np.hstack([(z - at) / s for z, (at, s) in zip(pair, units, strict=True)])
    models: dict[int, GaussianMixtureRegression] = {}
    scores: dict[int, float] = {}
    for count in _usable(np.atleast_1d(components).tolist(), *joint.shape):
        mixture = _run_em(joint, count, floor=covariance_floor, rng=rng)
        models[count] = model = _build(mixture, *pair, units, limit, covariance_floor)
        if validation is None:
            scores[count] = -mixture.bic(joint) / (2.0 * len(joint))
        else:
            scores[count] = predictive_log_likelihood(model, *held_out)
    return models[choose_components(scores)]


def choose_components(scores: Mapping[int, float]) -> int:
    """The smallest number of components that is as good as the best.

    Scores are log-likelihoods per sample by number of components, [nat]. A difference
    of 0.01 nat is a standard deviation 1 % larger, and does not count.
    """
    least = max(scores.values()) - _INDIFFERENCE
    return min(k for k, score in scores.items() if score >= least)


def predictive_log_likelihood(
    model: GaussianMixtureRegression, x: Array, y: Array
) -> float:
    """Log-likelihood of torque y, mean over samples, [nat].

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
    mixture: GaussianMixture,
    x: Array,
    y: Array,
    units: Sequence[tuple[Array, Array]],
    bound: Array,
    floor: float,
) -> GaussianMixtureRegression:
    (input_offset, input_scale), (output_offset, output_scale) = units
    offset = np.concatenate([np.zeros_like(input_offset), output_offset])
    scale = np.concatenate([np.ones_like(input_scale), output_scale])
    model = GaussianMixtureRegression(
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


def check_pair(
    x: ArrayLike, y: ArrayLike, *, columns: tuple[int | None, int | None] = (None, None)
) -> tuple[Array, Array]:
    """Inputs and outputs as finite matrices with equal numbers of rows.

    Raises:
        HybridError: The shapes are wrong, or a number is not finite.
    """
    inputs = check_matrix("x", x, columns[0])
    outputs = check_matrix("y", y, columns[1])
    if len(inputs) != len(outputs) or 0 in (inputs.size, outputs.size):
        raise HybridError(
            f"x has shape {inputs.shape} and y {outputs.shape}, "
            "valid are equal numbers of rows and at least one column each"
        )
    return inputs, outputs


def draw(
    x: Array, y: Array, size: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw at most ``size`` rows without replacement, in their order."""
    if len(x) <= size:
        return x, y
    rows = np.sort(rng.choice(len(x), size, replace=False))
    return x[rows], y[rows]
