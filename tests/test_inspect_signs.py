"""Torques that may have lost their sign: which are looked at, and by what they gain."""

from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.inspect import physics
from hybrid.inspect.physics import _gain, doubts_of_magnitude
from hybrid.inspect.state import State
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


@pytest.mark.parametrize(("left", "told"), [((0.02, 0.02), False), ((0.2, 0.02), True)])
def test_signs_are_told_by_what_is_left_and_not_by_its_share(monkeypatch, left, told):
    """An offset keeps a torque above zero: with signs its variance is larger."""
    tau = 1.0 + 0.05 * np.cos(7 * RISING)[:, None]
    tau[3] = 0.05  # nearly zero at times
    wanted = np.sign(np.sin(20 * RISING))[:, None]

    class Fit:
        def __init__(self, robot, state, masses, Y):
            self.signed, self.size = (state.tau < 0).any(), state.tau.var(axis=0)
            self.explained = wanted

        def residual(self, order, factor):
            return left[int(self.signed)] / self.size

    monkeypatch.setattr(physics, "MassColumns", Fit)
    monkeypatch.setattr(physics, "inverse_dynamics", lambda *_: wanted.copy())
    log = Recording(RISING, 0 * tau, tau=tau)
    state = State(*[0 * tau] * 3, tau)
    found = list(doubts_of_magnitude(log, pendulum(1), state))
    assert [x.joints for x in found] == [(0,)] * told


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
    assert _gain(before, after, reading(), elsewhere=True) == slower
    worse = _gain(before, 2 * before, reading(clock=0.5))
    assert worse == pytest.approx(-np.log(2.0))
    one = reading(factor=(1.0,), clock=0.5)
    assert _gain(before[:1], after[1:], one) == pytest.approx(0.5 * np.log(10.0))


# --- which reading is better ----------------------------------------------------------


class Told:
    """Residuals of readings that gain stated amounts at the first of two joints.

    ``first`` are gains by fits without weights, and ``unseen`` on samples not seen.
    """

    gains, written = physics._Readings.gains, object()

    def __init__(self, gains, first=None, unseen=lambda blocks: 9.0, before=0.9):
        self.stated = gains if isinstance(gains, dict) else {"any": gains}
        self.first, self.unseen_gain, self.before = first, unseen, before
        self.masses = dict.fromkeys(self.stated)
        self.robot = None
        self.state = SimpleNamespace(q=np.array([[0.0, 0.0], [1.0, 1.0]]), later={})

    def _move(self, others):
        """Its readings have no motion."""

    def columns(self, *_):
        return SimpleNamespace(residual_of_pairs=lambda: np.ones((2, 2)))

    def left(self, gain):
        return np.array([self.before * np.exp(-2 * gain), self.before])

    def residual(self, reading, masses, rounds=2, blocks=1):
        if reading is self.written:
            return self.left(0.0)
        if blocks > 1:
            return self.left(self.unseen_gain(blocks))
        gains = self.first if self.first and rounds == 1 else self.stated[masses]
        return self.left(gains[reading.number])

    def better(self, *, of_time=-1, lag=0.0, clock_is_right=False):
        """Number, masses and severity of the better reading; None without one."""
        count = len(next(iter(self.stated.values())))
        listed = [
            SimpleNamespace(
                number=k,
                channels=("t" if k == of_time else "tau",),
                clock=1.0,
                factor=np.ones(2),
                shift=0.0,
                lag=lag,
            )
            for k in range(count)
        ]
        with pytest.MonkeyPatch.context() as m:
            m.setattr(physics, "readings", lambda *_: listed)
            found = physics._better_reading(self, clock_is_right)
        return found and (found[0].number, *found[3:])


def test_a_reading_is_better_by_half_a_nat_and_on_unseen_samples_by_a_fifth():
    assert Told([0.49]).better() is None
    assert Told([0.51]).better() == (0, "any", "error")
    for unseen, severity in ((0.51, "error"), (0.49, "warning"), (0.21, "warning")):
        assert Told([1.0], unseen=lambda b, x=unseen: x).better()[2] == severity
    assert Told([1.0], unseen=lambda b: 0.19).better() is None
    assert Told([0.6, 1.2, 0.9]).better()[0] == 1


def test_torque_at_another_time_at_one_joint_alone_is_a_warning():
    """Friction that lags there looks so."""
    assert Told([1.0]).better(lag=0.1) == (0, "any", "warning")


@pytest.mark.parametrize("blocks", [2, 4, 8])
def test_a_log_is_split_in_three_ways_and_the_least_gain_counts(blocks):
    assert Told([1.0], unseen=lambda b: 0.1 if b == blocks else 9.0).better() is None
    assert Told([1.0], unseen=lambda b: 9.0 if b in (2, 4, 8) else 0.1).better()


def test_six_readings_are_fitted_with_weighted_joints():
    first = [1.0, 0.9, 0.8, 0.7, 0.6, 0.55, 0.5]
    assert Told([0.6] * 5 + [1.5, 0.6], first).better()[0] == 5
    assert Told([0.6] * 6 + [1.5], first).better()[0] == 0


def test_what_only_the_files_links_tell_is_a_warning():
    """And only of readings that masses do not rule out."""
    told = {"any": [0.0, -0.19], "file": [1.0, 1.5]}
    assert Told(told).better() == (1, "file", "warning")
    ruled_out = {"any": [0.0, -0.21], "file": [1.0, 1.5]}
    assert Told(ruled_out).better() == (0, "file", "warning")
    assert Told({"any": [-0.3], "file": [1.5]}).better() is None


def test_a_log_that_nothing_could_improve_is_not_looked_into():
    """By friction that is another law: three thousandths of the variance."""
    for nats, looked in ((0.24, False), (0.26, True)):
        assert bool(Told([9.0], before=0.003 * np.exp(2 * nats)).better()) == looked


def test_a_clock_that_speeds_confirm_has_no_other_reading():
    told = Told([1.5, 1.0])
    assert told.better(of_time=0)[0] == 0
    assert told.better(of_time=0, clock_is_right=True)[0] == 1


@pytest.mark.parametrize("most", [2, 6])
def test_a_log_has_four_faults_at_most(monkeypatch, most):
    """Each is undone before the next one is sought."""
    found = []

    def better(log, clock_is_right):
        if len(found) == most:
            return None
        found.append(log.state)
        return SimpleNamespace(of=lambda state: state + 1), None, None, "any", "error"

    log = Recording(RISING, RISING[:, None], tau=RISING[:, None])
    monkeypatch.setattr(
        physics, "_Readings", lambda chain, state, _: SimpleNamespace(state=state)
    )
    monkeypatch.setattr(physics, "_better_reading", better)
    monkeypatch.setattr(physics, "_doubt", lambda *_: "doubt")
    monkeypatch.setattr(physics, "speeds_confirm_clock", lambda state: True)
    doubts = list(physics.doubts_of_physics(log, pendulum(1), 0))
    assert doubts == ["doubt"] * min(most, 4) and found == list(range(min(most, 4)))
