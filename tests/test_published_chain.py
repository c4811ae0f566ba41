"""The published chain: friction by a threshold, mixtures by BIC, and iteration."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from hose_and_grease import Grease, Hose, unmodelled
from published_chain import (
    RegimeFriction,
    Rest,
    five,
    mixtures,
    published_chain,
    regimes,
)

from hybrid import Robot, simulate, validate
from hybrid.effects import Scale
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.viscous import Viscous
from hybrid.plant import Noise
from hybrid.signals import Motion

# Coulomb of either direction, v³, v², v.
SLOW, FAST = [6.0, 5.0, 0.0, 0.0, 0.0], [3.0, 4.0, 0.2, 0.0, 1.5]


def still(q):
    """A motion through positions, shape (N, n), at rest."""
    zero, mask = np.zeros_like(q), np.ones(len(q), dtype=bool)
    return Motion(np.arange(len(q)) / 100, q, zero, zero, zero, mask)


def two_regimes(threshold, noise, seed=0):
    rng = np.random.default_rng(seed)
    v = rng.uniform(-2.0, 2.0, 4000)
    columns = np.stack(five(np.sign(v), v), axis=1)
    slow = np.abs(v) < threshold
    tau = np.where(slow, columns @ SLOW, columns @ FAST)
    return np.abs(v), columns, tau + noise * rng.standard_normal(len(v))


@pytest.mark.parametrize("threshold", [0.15, 0.4, 1.1])
def test_threshold_and_gains_of_either_regime_are_found(threshold):
    found, gains = regimes(*two_regimes(threshold, noise=0.0))
    # Candidates are some 0.3 % of the samples apart at last, that is 0.006 rad/s here.
    assert abs(found - threshold) < 0.01
    np.testing.assert_allclose(gains, [*SLOW, *FAST], atol=0.2)


def test_gains_above_the_threshold_come_back_through_noise_within_their_spread():
    speed, columns, tau = two_regimes(0.4, noise=0.5)
    found, gains = regimes(speed, columns, tau)
    assert abs(found - 0.4) < 0.01
    fast = columns[speed >= 0.4]
    std = 0.5 * np.sqrt(np.linalg.inv(fast.T @ fast).diagonal())
    assert (np.abs(gains[5:] - FAST) < 3 * std).all()
    assert std.max() < 1.0  # so that this says something


def test_no_gain_drives_even_where_friction_falls_with_speed():
    rng = np.random.default_rng(1)
    v = rng.uniform(-2.0, 2.0, 2000)
    columns = np.stack(five(np.sign(v), v), axis=1)
    _, gains = regimes(np.abs(v), columns, np.sign(v) * (4.0 - np.abs(v)))
    assert (gains >= 0).all() and gains[:2].min() > 2.0


def test_the_law_jumps_at_the_threshold_and_opposes_both_directions():
    names = [g.name for g in RegimeFriction.gains]
    values = dict(zip(names, [*SLOW, *FAST], strict=True)) | {"threshold": 0.5}
    effect, v = RegimeFriction((0,), values), np.array([-1.0, -0.4, 0.4, 1.0])
    motion = replace(still(np.zeros((4, 1))), v=v[:, None])
    body = type("Body", (), {"load": np.zeros((4, 1))})
    expected = [-(4 + 0.2 + 1.5), -5.0, 6.0, 3 + 0.2 + 1.5]
    np.testing.assert_allclose(effect.torque(motion, body)[:, 0], expected)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_bic_finds_how_many_components_a_mixture_has(count):
    """Components far apart, on samples that are independent."""
    rng = np.random.default_rng(count)
    of = rng.integers(0, count, 3000)
    q = 4.0 * of + 0.3 * rng.standard_normal(3000)
    tau = 3.0 * (-1.0) ** of + 2.0 * (q - 4.0 * of) + 0.2 * rng.standard_normal(3000)
    v = rng.standard_normal(3000)
    moving = np.ones((3000, 1), dtype=bool)
    rest = Rest(q[:, None], v[:, None], tau[:, None], moving, rate=5.0)
    (part,) = mixtures(rest, [None], seed=0).parts
    assert part.regression.components == count
    predicted = part.regression.predict(np.stack([q, v], axis=1))[:, 0]
    assert np.sqrt(np.mean((tau - predicted) ** 2)) < 0.25  # 0.2 is noise


@pytest.fixture(scope="module")
def planar():
    """A two-link arm with friction, a hose and grease; two of its logs are kept."""
    robot = Robot.load(MODELS / "planar.xml")
    laws = [Coulomb((j,), {"level": 1.0}) for j in range(2)]
    laws += [Viscous((j,), {"coefficient": 0.5}) for j in range(2)]
    size = Scale(60.0, 2.0)
    hidden = unmodelled([size, size], np.random.default_rng(0))
    covariance = 0.05**2 * np.array([[1.0, 0.3], [0.3, 1.0]])
    quiet = replace(Noise.typical(robot), torque_covariance=covariance)
    logs = simulate(robot, [*laws, *hidden], trajectories=6, seed=1, noise=quiet)
    chain = published_chain(robot, logs[:4])
    last = chain.models["published, iterated"]
    rows = validate(replace(last, simpler=chain.models), logs[4:]).rows
    return chain, {row.name: row.rms for row in rows}


@pytest.mark.study
def test_the_mixture_learns_on_other_motions_what_no_effect_describes(planar):
    _, rms = planar
    before, after = rms["published + friction"], rms["published + mixture"]
    assert (after < before).all() and after.mean() < 0.8 * before.mean()


@pytest.mark.study
def test_iteration_lowers_the_error_on_other_motions_and_settles(planar):
    chain, rms = planar
    assert chain.settled and 1 < chain.rounds
    assert rms["published, iterated"].mean() <= rms["published + mixture"].mean()


@pytest.mark.study
def test_every_gain_of_the_chain_is_friction(planar):
    chain, _ = planar
    laws = [
        e
        for e in chain.models["published, iterated"].effects
        if e.id == "regime_friction"
    ]
    assert len(laws) == 2
    assert all((e.gain_values >= 0).all() for e in laws)
    assert chain.thresholds == tuple(e.values["threshold"] for e in laws)


def test_a_hose_stores_what_it_is_given():
    """Its torque is the gradient of an energy: crossed derivatives are equal."""
    values = {"tension": 2.0, "first_arm": 1.5, "second_arm": 0.7, "first_rest": 0.3}
    hose, q, step = Hose((0, 1), values), np.array([1.1, -0.8]), 1e-6

    def torque(x):
        return hose.torque(still(x[None]), None)[0]

    slope = np.array([torque(q + s) - torque(q - s) for s in step * np.eye(2)])
    slope /= 2 * step
    assert abs(slope[0, 1]) > 0.05  # what one joint feels depends on the other
    np.testing.assert_allclose(slope[0, 1], slope[1, 0], rtol=1e-6)


def test_grease_never_drives():
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-3, 3, (2, 500, 1))
    motion = replace(still(q), v=v)
    body = type("Body", (), {"load": np.zeros((500, 1))})
    assert (Grease((0,), {"drag": 1.0}).torque(motion, body) * v >= 0).all()
