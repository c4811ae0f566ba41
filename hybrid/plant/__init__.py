"""A simulated arm with known effects, which makes recordings with a known truth."""

from hybrid.plant.install import install
from hybrid.plant.noise import Noise
from hybrid.plant.plant import Plant
from hybrid.plant.reference import Reference, random_fourier
from hybrid.plant.servo import Servo
from hybrid.plant.simulate import simulate
from hybrid.plant.truth import load_truth

__all__ = [
    "Noise",
    "Plant",
    "Reference",
    "Servo",
    "install",
    "load_truth",
    "random_fourier",
    "simulate",
]
