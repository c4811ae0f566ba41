"""A simulated arm with known effects, which makes recordings with a known truth."""

from hybrid.plant.install import install as install
from hybrid.plant.noise import Noise as Noise
from hybrid.plant.plant import Plant as Plant
from hybrid.plant.reference import Reference as Reference
from hybrid.plant.reference import random_fourier as random_fourier
from hybrid.plant.simulate import simulate as simulate
from hybrid.plant.truth import load_truth as load_truth
