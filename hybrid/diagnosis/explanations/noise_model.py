"""Noise model of the evidence: measured noise, and errors of laws and simulators."""

from __future__ import annotations

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.noise import LAGS, autocovariance, floored
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.prior import Prior
from hybrid.signals import memory


def set_noise_model(
    evidence: Evidence, measured: Array, rigid: Index, prior: Prior
) -> list[Array]:
    """Set the noise of the evidence to measured noise plus model errors.

    The errors of laws are a part of the gap, and have its autocovariance; those of
    simulators are a part of the torque.

    ``measured`` is the noise variance of each joint, shape (n,), [N²·m²], and ``rigid``
    are the columns of the background.

    Returns:
        Covariance of each joint's noise at lags from zero on, shape (p + 1,) each.
    """
    residuals, gap = evidence.residuals(rigid), evidence.gap
    evidence.noise, covariances = measured.copy(), list[Array]()
    for i, rows in enumerate(evidence.rows):
        covariance = evidence.covariances[i].copy()
        if len(rows):
            back = np.argsort(rows)
            left = residuals[i][back]
            torque = gap.measured[rows[back], i]
            torque -= np.mean(torque)
            solver = prior.solver_error**2 * np.mean(torque**2)
            solver *= memory(torque, rows[back])
            law = prior.law_error**2 * autocovariance(left, rows[back], LAGS)
            evidence.noise[i] += solver + law[0] * memory(left, rows[back])
            if gap.subtracted is not None:
                known, part = gap.subtracted[rows[back], i], prior.real_law_error**2
                law += part * autocovariance(known, rows[back], LAGS)
                evidence.noise[i] += (
                    part * np.mean(known**2) * memory(known, rows[back])
                )
            covariance += law
            covariance[0] += law[0] + solver
        covariances.append(floored(covariance, gap.cutoff / gap.rate))
    evidence.set_covariances(covariances)
    return covariances
