"""Learned remainders of the torque that no physical term explains."""

from hybrid.compensator.gmr import (
    GaussianMixtureRegression as GaussianMixtureRegression,
)
