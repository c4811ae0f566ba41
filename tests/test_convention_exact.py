"""How a loop logs, from exact pendulums: evidence written out, and what is told."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import NOISE, RATE, pendulum, swings, with_torque
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from hybrid.diagnosis.evidence.convention import (
    Convention,
    _TimeEvidence,
    _TimePrior,
    find_convention,
)
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.coulomb import Coulomb
from hybrid.recording import Recording

STEP = 1 / RATE
SERVO = np.array([6.0, 2.0])  # N·m·s/rad, the dampings of the servos


def robot():
    return replace(pendulum(2), kp=60 * SERVO, kd=SERVO, timestep=STEP)


def logs(late=0.0, step=0.0, effects=(), only=(0, 1)):
    """Torque that is late, and without a servo's damping of a step, at some joints."""
    found = []
    for k, m in enumerate(swings(2, seconds=6.0)):
        exact = with_torque(m, effects)
        tau = exact.tau + step * SERVO * m.a
        then = np.column_stack([np.interp(m.t - late, m.t, x) for x in tau.T])
        own = np.where(np.isin([0, 1], only), then, exact.tau)
        noise = NOISE * np.random.default_rng(k).standard_normal(own.shape)
        found.append(replace(exact, tau=own + noise))
    return found


def told(**options):
    motions = logs(**options)
    return find_convention(measure_gap(robot(), motions, cutoff=10.0), motions)


def test_a_log_as_it_should_be_has_no_convention():
    found = told()
    assert not found and found == Convention() and found.notes == ()


def test_torque_of_the_step_before_is_late_by_a_step():
    found = told(late=STEP)
    assert found == Convention(STEP) and found and not found.clocks
    (note,) = found.notes
    assert "10 ms late" in note and "corrected" in note


def test_an_implicit_step_leaves_out_its_damping():
    found = told(step=STEP)
    assert found == Convention(0.0, STEP) and found
    (note,) = found.notes
    assert "implicit step of 10 ms" in note


def test_another_clock_is_told_with_its_time():
    found = told(late=0.034)
    assert found.clocks and found.step == 0.0
    assert found.late == pytest.approx(0.034, abs=5e-4)
    assert 0.0 < found.std < 5e-4
    (note,) = found.notes
    assert "34.1 ms late" in note and "without this delay" in note


@pytest.mark.parametrize("options", [{"late": 0.034}, {"step": STEP}])
def test_what_one_joint_alone_has_is_no_convention(options):
    assert not told(**options, only=(1,))


def test_friction_is_no_convention():
    assert not told(effects=[Coulomb((j,), {"level": 1.0}) for j in (0, 1)])


def test_an_arm_that_stands_has_none():
    still = [replace(m, q=0 * m.q, v=0 * m.v, a=0 * m.a) for m in logs()]
    assert not find_convention(measure_gap(robot(), still, cutoff=10.0), still)


@pytest.fixture
def times():
    """Three delays and two steps with a made-up likelihood: s = H x + noise, cov. H."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 5)) * 30.0
    made = object.__new__(_TimeEvidence)
    made._H = root @ root.T
    made._s = made._H @ rng.normal(0.0, 0.03, 5) + root @ rng.standard_normal(5)
    made._sizes, made._cause = (3, 2), 10.0
    return made


def test_the_evidence_for_a_guess_is_that_of_the_whole_covariance(times):
    rng, H, s = np.random.default_rng(0), times._H, times._s
    nothing = multivariate_normal(np.zeros(5), H).logpdf(s)
    for _ in range(5):
        a, b = (
            _TimePrior(c, 0.1 * rng.standard_normal((n, 2)), x)
            for c, n, x in ((1.0, 3, 0.02), (3.0, 2, 0.0))
        )
        mean = np.repeat([a.common, b.common], (3, 2))
        prior = block_diag(a.root @ a.root.T, b.root @ b.root.T)
        law = multivariate_normal(H @ mean, H + H @ prior @ H)
        expected = law.logpdf(s) - nothing - 1.0 - 3.0
        assert times._score(a, b) == pytest.approx(expected, rel=1e-6)


def test_there_may_be_nothing_a_step_one_joint_or_each_its_own(times):
    steps = [0.002, 0.01]
    found = times._priors(3, steps)
    covariances = [g.root @ g.root.T for g in found]
    nothing, own, *shared = covariances[:4]
    assert not nothing.any() and found[0].cost == 0.0
    np.testing.assert_allclose(own, 0.1**2 * np.eye(3))
    assert found[1].cost == 3 * 10.0  # a cause at each joint
    for step, guess, covariance in zip(steps, found[2:4], shared, strict=True):
        assert guess.common == step and guess.cost == 10.0
        np.testing.assert_allclose(covariance, (0.1 * step) ** 2 * np.eye(3))
    for j, covariance in enumerate(covariances[4:]):
        alone = np.zeros((3, 3))
        alone[j, j] = 0.1**2
        np.testing.assert_allclose(covariance, alone)
    assert len(found) == 7 and {g.cost for g in found[4:]} == {10.0}


def test_the_time_that_all_share_is_the_regression_on_it(times):
    """With what a step takes taken off, and a prior of a tenth of a second."""
    H, s = times._H, times._s - times._H @ [0.0, 0.0, 0.0, 0.01, 0.01]
    ones = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    precision = ones @ H @ ones + 100.0
    time, std = times.common_delay(0.01)
    assert time == pytest.approx(ones @ s / precision)
    assert std == pytest.approx(precision**-0.5)


def test_a_log_in_step_has_torque_and_command_of_each_instant():
    t = np.arange(0.0, 1.0, 0.01)
    x = np.sin(3 * t)[:, None]
    log = Recording(t, x, tau=2 * x, command=3 * x, joints=("a",))
    assert Convention().shift(log) is log
    moved = Convention(0.01).shift(log)
    for channel, size in (("tau", 2.0), ("command", 3.0)):
        np.testing.assert_allclose(getattr(moved, channel)[:-1], size * x[1:])
        assert getattr(moved, channel)[-1] == size * x[-1]
    other = Convention(0.01, 0.0, 0.001).shift(log)
    np.testing.assert_array_equal(other.tau, moved.tau)
    np.testing.assert_array_equal(other.command, log.command)


def test_the_torque_that_acted_in_a_step_is_without_its_damping():
    (m, *_) = logs()
    found = Convention(STEP, 2 * STEP).correct(robot(), m)
    np.testing.assert_allclose(found.tau, m.tau - 2 * STEP * SERVO * m.a)
    np.testing.assert_allclose(found.v, m.v + STEP * m.a)  # in its middle
    assert found.mask[:-1].all() and not found.mask[-1]
    clocks = Convention(0.025, 0.0, 1e-4).correct(robot(), m)
    np.testing.assert_array_equal(clocks.v, m.v)
    assert clocks.mask[:-3].all() and not clocks.mask[-3:].any()
    assert Convention(STEP).correct(robot(), m).v == pytest.approx(m.v + STEP / 2 * m.a)
    gaps = replace(m, mask=np.arange(len(m.t)) != 50)
    masked = Convention(STEP).correct(robot(), gaps).mask
    assert np.flatnonzero(~masked).tolist() == [49, 50, len(m.t) - 1]
