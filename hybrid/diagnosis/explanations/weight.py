"""What a sample weighs: noise, and what no law and no simulator has exactly."""

from __future__ import annotations

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.noise import LAGS, autocovariance, floored
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.prior import Prior
from hybrid.signals import autocorrelation_time


def weigh(
    evidence: Evidence, measured: Array, rigid: Index, prior: Prior
) -> list[Array]:
    """Let noise be what was estimated, and some of the gap and of the torque.

    What these leave is as slow as what they are of. The stop band of a filter has no
    less noise than the upper half of its band.

    Args:
        evidence: Cross-products of a gap.
        measured: Variance of each joint's noise, shape (n,), [N²·m²].
        rigid: Columns of the background.
        prior: What is believed of laws and simulators.

    Returns:
        Covariances of each joint's noise at lags from zero on, shape (p + 1,) each.
    """
    found, gap = evidence.solve(rigid), evidence.gap
    evidence.noise, covariances = measured.copy(), list[Array]()
    for i, rows in enumerate(evidence.rows):
        covariance = evidence.covariances[i].copy()
        if len(rows):
            back = np.argsort(rows)
            left = evidence.residual(i, found.index, found.gains)[back]
            torque = gap.measured[rows[back], i]
            torque -= np.mean(torque)
            law = prior.inexact**2 * autocovariance(left, rows[back], LAGS)
            steps = (
                prior.solver**2
                * np.mean(torque**2)
                * autocorrelation_time(torque, rows[back])
            )
            evidence.noise[i] += steps + law[0] * autocorrelation_time(left, rows[back])
            if gap.known is not None:
                # Laws that were identified are as inexact as real ones are.
                known = gap.known[rows[back], i]
                law += prior.misfit**2 * autocovariance(known, rows[back], LAGS)
                evidence.noise[i] += (
                    prior.misfit**2
                    * np.mean(known**2)
                    * autocorrelation_time(known, rows[back])
                )
            covariance += law
            covariance[0] += law[0] + steps
        covariances.append(floored(covariance, gap.cutoff / gap.rate))
    evidence.weigh(covariances)
    return covariances
