"""Torques that may have lost their sign: which are looked at, and by what they gain."""

from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.inspect import physics
from hybrid.inspect.physics import _gain, doubts_of_magnitude
from hybrid.recording import Recording


def looked_at(*columns):
    """Whether any torque of a log may be a magnitude."""
    tau = np.stack(columns, axis=1).astype(float)
    n = tau.shape[1]
    log = Recording(np.arange(len(tau)) / 100.0, np.zeros_like(tau), tau=tau)
    state = SimpleNamespace(q=log.q, v=log.q, a=log.q, tau=tau)

    class Looked(Exception):
        pass

    def look(*_):
        raise Looked

    with pytest.MonkeyPatch.context() as m:
        m.setattr(physics, "unit_masses", look)
        try:
            assert list(doubts_of_magnitude(log, pendulum(n), state)) == []
        except Looked:
            return True
    return False


RISING = np.linspace(0.0, 1.0, 50)


def test_a_torque_that_is_never_below_zero_and_nearly_zero_at_times_is_looked_at():
    assert looked_at(RISING)
    assert not looked_at(RISING - 0.01)  # it has signs
    for least, suspect in ((0.09, True), (0.11, False)):
        assert looked_at(np.linspace(least, 1.0, 50)) == suspect
    assert not looked_at(-RISING)
    assert looked_at(RISING - 0.5, RISING)  # one of two is enough
    assert not looked_at(np.full(50, np.nan))


def test_without_an_arm_no_sign_is_told():
    log = Recording(RISING, RISING[:, None], tau=RISING[:, None])
    assert list(doubts_of_magnitude(log, None, None)) == []


def test_a_log_of_right_signs_has_no_gain_and_a_cleared_variance_counts_by_its_log():
    """Half of the logarithm of the ratio of variances, summed over joints."""
    before, after = np.array([0.5, 0.2]), np.array([0.05, 0.2])
    assert _gain(before, after) == pytest.approx(0.5 * np.log(10.0))
    assert _gain(before, before) == 0.0
    # A joint counts down to a fiftieth of the mean only.
    tiny = np.array([0.5, 1e-9])
    least = 0.02 * 0.25
    assert _gain(tiny, np.array([0.5, 1e-12])) == pytest.approx(0.0)
    assert _gain(np.array([0.5, 0.5]), tiny) == pytest.approx(
        0.5 * np.log(0.5 / (0.02 * 0.5))
    )
    assert _gain(tiny, np.array([1e-9, 1e-9])) == pytest.approx(
        0.5 * np.log(0.5 / least)
    )


def reading(*, factor=(1.0, 1.0), clock=1.0):
    return SimpleNamespace(factor=np.array(factor), clock=clock)


def test_a_scale_of_torque_has_to_explain_more_than_friction():
    before, after = np.array([0.5, 0.5]), np.array([0.5, 0.001])
    plain = _gain(before, after, reading())
    scaled = _gain(before, after, reading(factor=(1.0, -2.0)))
    assert plain == pytest.approx(0.5 * np.log(0.5 / 0.01))
    assert scaled == pytest.approx(0.5 * np.log(0.5 / 0.03))
    turned = _gain(before, after, reading(factor=(1.0, -1.0)))
    assert turned == plain


def test_a_scale_of_time_has_to_explain_more_than_one_joint():
    before, after = np.array([0.5, 0.5]), np.array([0.25, 0.05])
    whole = _gain(before, after, reading())
    slower = _gain(before, after, reading(clock=0.5))
    assert whole - slower == pytest.approx(0.5 * np.log(10.0))
    worse = _gain(before, 2 * before, reading(clock=0.5))
    assert worse == pytest.approx(-np.log(2.0))
    one = reading(factor=(1.0,), clock=0.5)
    assert _gain(before[:1], after[1:], one) == pytest.approx(0.5 * np.log(10.0))
