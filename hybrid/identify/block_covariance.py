"""Covariance of a least-squares estimate whose residuals are correlated in time.

Source: Cameron and Miller 2015, doi 10.3368/jhr.50.2.317 (scores summed over blocks
that are correlated within).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.robot.chain import Array

_FINE_BLOCKS = 384
_FEWEST_BLOCKS = 24
_UNCORRELATED = 0.05
_BLIND = 1e-12  # relative curvature below which a parameter is not determined


def block_covariance(
    J: Array, residual: Array, block: NDArray[np.intp] | None
) -> tuple[Array, int]:
    """Covariance of the parameters, infinite on the diagonal for what J does not tell.

    Args:
        J: Derivatives of the residual by the parameters, shape (M, p).
        residual: What is left, shape (M,).
        block: Number of the block of time each row belongs to, ascending from 0, shape
            (M,); rows in order of time by default.

    Returns:
        Covariance, shape (p, p), and its degrees of freedom (blocks less one).
    """
    rows = len(residual)
    if block is None:
        block = np.arange(rows) * min(_FINE_BLOCKS, rows) // rows
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 0, size, 1.0)
    unit = J / size
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    scores = np.add.reduceat(unit * residual[:, None], starts, axis=0)
    scores = _independent(scores)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    seen = values > _BLIND * values.max(initial=0.0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    count = len(scores)
    spread = scores @ inverse / size
    covariance = count / max(count - 1, 1) * spread.T @ spread
    blind = (vectors[:, ~seen] ** 2).sum(axis=1) > 0.01
    covariance[np.diag_indices_from(covariance)] += np.where(blind, np.inf, 0.0)
    return covariance, max(count - 1, 1)


def _independent(scores: Array) -> Array:
    """Neighbouring blocks joined until the scores of successive ones are unrelated."""
    while len(scores) >= 2 * _FEWEST_BLOCKS:
        power = np.maximum((scores**2).sum(axis=0), 1e-300)
        if np.mean((scores[1:] * scores[:-1]).sum(axis=0) / power) < _UNCORRELATED:
            break
        scores = np.add.reduceat(scores, np.arange(0, len(scores), 2), axis=0)
    return scores
