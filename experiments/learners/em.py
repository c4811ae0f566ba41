"""Mixtures whose covariances have a structure, by expectation maximisation in torch.

Sources: Dempster, Laird and Rubin 1977, doi 10.1111/j.2517-6161.1977.tb01600.x; low
rank after Tipping and Bishop 1999, doi 10.1162/089976699300016728 (a closed M-step).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.gmr_fit import fit_gmr

Structure = Literal["full", "diagonal", "low_rank"]

_CHUNK_BYTES = 2**21  # of the largest temporary array, so that it stays in the cache
_PASSES, _FLOOR = 20, 1e-4  # of the search; added to every variance
_LEAST_WEIGHT = 1e-6  # of a component, so that none dies


@dataclass(frozen=True)
class Mixture:
    """Parameters of a Gaussian mixture of K components in D variables.

    Attributes:
        weights: Component weights, shape (K,).
        means: Means, shape (K, D).
        covariances: Covariances, shape (K, D, D).
    """

    weights: Array
    means: Array
    covariances: Array


def fit_structured(
    x: Array, y: Array, *, structure: Structure, rank: int = 2, **options: Any
) -> GaussianMixtureRegression:
    """A regression with covariances of a structure, by passes from free ones.

    Args:
        x: Inputs, shape (N, d).
        y: Torque that is left, shape (N, m), [N·m].
        structure: What covariances may be: ``full``, ``diagonal``, or ``low_rank``:
            some directions and one variance for all others.
        rank: Number of directions.
        **options: As for :func:`fit_gmr`.
    """
    import torch

    free = fit_gmr(x, y, **options)
    size = np.sqrt(free.prior_variance)
    scale = np.concatenate([np.ones(free.inputs), size])
    joint = np.hstack([(x - free.input_offset) / free.input_scale, y / size])
    area = np.outer(scale, scale)
    found = Mixture(free.weights, free.means / scale, free.covariances / area)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    data = torch.from_numpy(np.ascontiguousarray(joint)).to(device)
    for _ in range(_PASSES):
        found = _maximised(*_sums(data, found), structure, rank)
    return replace(
        free,
        weights=found.weights,
        means=found.means * scale,
        covariances=found.covariances * area,
    )


def _sums(data: Any, mixture: Mixture) -> tuple[Array, Array, Array]:
    """Sums of responsibility, of weighted samples, and of their squares."""
    import torch

    count, size = mixture.means.shape
    factor = np.linalg.cholesky(mixture.covariances)
    whitening = np.linalg.solve(factor, np.eye(size)[None])
    log_weight = np.log(mixture.weights)
    log_weight -= np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    centre = np.einsum("kij,kj->ki", whitening, mixture.means)
    W, c, log = (
        torch.from_numpy(np.ascontiguousarray(x)).to(data.device)
        for x in (whitening.reshape(-1, size).T, centre.reshape(-1), log_weight)
    )
    zero = {"dtype": data.dtype, "device": data.device}
    n, first = torch.zeros(count, **zero), torch.zeros((count, size), **zero)
    second = torch.zeros((count * size, size), **zero)
    for part in data.split(max(1, _CHUNK_BYTES // (8 * count * size))):
        w = (part @ W - c).reshape(len(part), count, size)
        share = torch.softmax(log - 0.5 * (w * w).sum(dim=2), dim=1)
        n += share.sum(dim=0)
        first += share.T @ part
        weighted = (share[:, :, None] * part[:, None, :]).reshape(len(part), -1)
        second += weighted.T @ part
    second = second.reshape(count, size, size)
    return n.cpu().numpy(), first.cpu().numpy(), second.cpu().numpy()


def _maximised(
    n: Array, first: Array, second: Array, structure: Structure, rank: int
) -> Mixture:
    n = np.maximum(n, _LEAST_WEIGHT * n.sum())
    means = first / n[:, None]
    covariances = second / n[:, None, None] - means[:, :, None] * means[:, None, :]
    covariances = structured(covariances, structure, rank)
    covariances += _FLOOR * np.eye(means.shape[1])
    return Mixture(n / n.sum(), means, covariances)


def structured(covariances: Array, structure: Structure, rank: int) -> Array:
    """Covariances of a structure that are most likely for free ones, (K, D, D)."""
    size = covariances.shape[1]
    if structure == "diagonal":
        return covariances * np.eye(size)
    if structure == "full" or rank >= size - 1:
        return covariances
    values, vectors = np.linalg.eigh(covariances)
    values[:, :-rank] = values[:, :-rank].mean(axis=1, keepdims=True)
    return np.asarray((vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1))
