"""Motions, torques and fits that several test files share; each is made once."""

import warnings
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from arms import MODELS
from coarse import load_truth, simulate
from scipy.signal import lfilter

from hybrid.dynamics import RigidBody
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning
from hybrid.identification import Fit, Validation, identify, validate
from hybrid.plant import random_fourier
from hybrid.regression.data import Data
from hybrid.regression.intervals import with_uncertainty
from hybrid.regression.least_squares import solve_weighted
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion

LINEAR = (Viscous, Coulomb, TorqueOffset)


@cache
def arm(name):
    """An arm from models/."""
    return Robot.load(MODELS / f"{name}.xml")


def quiet(function, *args, **options):
    """A result, and the warnings of this package that came with it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", HybridWarning)
        result = function(*args, **options)
    return result, [str(w.message) for w in caught]


def linear_problem(robot):
    """Rigid body with viscous and dry friction and an offset at every joint."""
    joints = range(robot.size)
    return build_problem(robot.chain, [kind((j,)) for kind in LINEAR for j in joints])


def motions(robot, *, count=2, duration=10.0, rate=100.0, seed=0):
    """Random motions, exact to rounding; no torque."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        r = random_fourier(robot, duration=duration, rate=rate, seed=rng)
        mask = np.ones(len(r.t), dtype=bool)
        found.append(Motion(r.t, r.q, r.v, r.a, 0 * r.q, mask, joints=robot.joints))
    return found


def stacked(problem, motion):
    """All columns written out, without the program's bookkeeping, shape (N, n, p)."""
    body = RigidBody(problem.chain, motion, problem.inertial)
    samples, n = motion.q.shape
    full = [body.columns]
    for effect in problem.effects:
        for column in effect.columns(motion, body).transpose(2, 0, 1):
            wide = np.zeros((samples, n, 1))
            wide[:, list(effect.joints), 0] = column
            full.append(wide)
    return np.concatenate(full, axis=2)[:, :, list(problem.base.kept)]


def with_torque(motion, tau):
    """The same motion with a torque."""
    return replace(motion, tau=np.asarray(tau))


def data_of(chosen, *, cutoff=np.inf, standing=-1.0, folds=None):
    """Data of motions, by default in one fold and with every sample moving."""
    folds = folds or [np.zeros(len(m.t), dtype=int) for m in chosen]
    still = np.full(chosen[0].q.shape[1], standing)
    return Data(tuple(chosen), tuple(folds), cutoff, still)


def solve(products, estimator="irls", **options):
    """A solution with its uncertainty."""
    found = solve_weighted(products, estimator, **options)
    return with_uncertainty(products, found)


def coloured(rng, samples, covariance, memory):
    """Stationary noise e[k+1] = memory · e[k] + white, shape (samples, n)."""
    root = np.linalg.cholesky(covariance)
    white = rng.standard_normal((samples, len(root))) @ root.T
    white[1:] *= np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], white, axis=0)


def errors_alike(n, correlation):
    """Correlation of neighbours and their neighbours, shape (n, n)."""
    return correlation ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))


@dataclass(frozen=True)
class Experiment:
    """A fit, what it warned of, and its score on motions it has not seen."""

    robot: Robot
    plant: object
    fit: Fit
    said: list
    validation: Validation


@cache
def coman():
    """Three stages on 40 s of the documented COMAN-like truth, scored on 30 s."""
    robot, plant = load_truth(MODELS / "coman_truth.yaml")
    logs = simulate(plant, trajectories=7, duration=10, seed=3)
    fit, said = quiet(identify, robot, logs[:4])
    return Experiment(robot, plant, fit, said, validate(fit.model, logs[4:]))
