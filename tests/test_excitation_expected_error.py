"""The expected torque error: what it says is what repeated fits show."""

import numpy as np
import pytest
from arms import MODELS

from hybrid.dynamics import regressor
from hybrid.effects import effects_from_text
from hybrid.excitation import Condition, Fourier, Limits, design, observe
from hybrid.excitation.constraints import MotionLimits
from hybrid.excitation.expected_error import ExpectedError, typical_structure
from hybrid.excitation.observation import FIRST, PIVOTED, rigid_columns
from hybrid.excitation.program import MotionProgram
from hybrid.plant import Noise
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

SCARA = Robot.load(MODELS / "scara.xml")
FAMILY = Fourier(4, 0.1)
FITTED = effects_from_text(
    "armature,torque_offset,coulomb,viscous", SCARA.joints, joint_scales(SCARA)
)
OBSERVATION = observe(
    SCARA.chain, FITTED, covariance=Noise.typical(SCARA).torque_covariance
)


def random_paths(count: int, seed: int):
    limits, b = Limits.of(SCARA), OBSERVATION.size
    kept = (MotionLimits(limits, SCARA.joints),)
    nothing = np.zeros((b, b))
    program = MotionProgram(
        OBSERVATION, Condition(), FAMILY, kept, limits, nothing, 10.0, 1.0, 1e-3
    )
    rng = np.random.default_rng(seed)
    points = [program._random(rng, 1.0) for _ in range(count)]
    return [program.grid.path(program.coefficients(x)) for x in points]


def test_structure_stands_behind_the_fitted_columns():
    expected = ExpectedError.of(SCARA, OBSERVATION, random_paths(2, 0))
    wide, k = expected.observation, expected.fitted
    assert wide.base.kept[:k] == OBSERVATION.base.kept
    path = random_paths(1, 1)[0]
    found, plain = wide.matrix(path), OBSERVATION.matrix(path)
    np.testing.assert_allclose(found[:, :, :k], plain, atol=1e-12)
    effects, sizes = typical_structure(SCARA)
    assert len(sizes) == sum(len(x.gains) for x in effects)
    assert (sizes > 0).all()


def test_the_error_of_both_fits_is_that_of_repeated_ones():
    usage = random_paths(5, 0)
    expected = ExpectedError.of(SCARA, OBSERVATION, usage)
    wide, k = expected.observation, expected.fitted
    rho = 10.0
    path, rng = random_paths(1, 1)[0], np.random.default_rng(0)
    W = wide.matrix(path).reshape(-1, wide.size)
    later = np.concatenate([wide.matrix(x) for x in usage])
    later = np.linalg.inv(wide.whitening) @ later  # in N·m
    phi = rng.normal(size=(wide.size - k, 4000))
    y = W[:, k:] @ phi
    few = np.linalg.pinv(W[:, :k]) @ (y + rng.normal(size=y.shape))
    known = np.diag((np.arange(wide.size) >= k).astype(float))
    rest = y + np.sqrt(rho) * rng.normal(size=y.shape)
    every = np.linalg.solve(W.T @ W / rho + known, W.T @ rest / rho)
    logs = []
    for theta in (np.vstack([few, np.zeros_like(phi)]), every):
        theta[k:] -= phi
        error = np.einsum("tjb,bs->tjs", later, theta)
        logs.append(np.log((error**2).mean(axis=(0, 2))).mean() / 2)
    assert expected.value(W.T @ W) == pytest.approx(np.exp(np.mean(logs)), rel=0.03)


def test_the_default_design_is_expected_to_err_less_than_random_motions():
    found = design(
        SCARA, OBSERVATION, FAMILY, seed=np.random.default_rng(0), starts=1, rate=10.0
    )
    measure = found.criterion
    assert isinstance(measure, ExpectedError)
    grams = [measure.observation.gram(x) for x in random_paths(20, 5)]
    assert found.value < min(map(measure.value, grams))
    assert found.gram.shape == (OBSERVATION.size,) * 2
    assert max(found.excess.values()) <= 0


def test_condition_numbers_are_of_columns_that_are_named():
    path = random_paths(1, 2)[0]
    chain = SCARA.chain
    H = regressor(chain, path.q, path.v, path.a).reshape(-1, 10 * chain.size)
    named = rigid_columns(chain, H)
    rank = np.linalg.matrix_rank(H)
    assert set(named) == {FIRST, PIVOTED}
    for columns in named.values():
        assert len(columns) == np.linalg.matrix_rank(H[:, columns]) == rank
    plain = observe(chain)
    value = Condition().value(plain.gram(path))
    assert np.linalg.cond(H[:, named[FIRST]]) == pytest.approx(value, rel=1e-6)
    lengths = np.linalg.norm(H, axis=0)
    assert lengths[named[PIVOTED][0]] == lengths.max()
