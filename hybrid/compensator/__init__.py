"""Learned remainders of the torque that no physical term explains."""

from hybrid.compensator.gmr import GaussianMixtureRegression

__all__ = ["GaussianMixtureRegression"]
