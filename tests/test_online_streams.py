"""Online identification on streams as robots give them, on good days and bad."""

import sys
from functools import cache

import numpy as np
import pytest
from arms import MODELS
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import studied
from streams import FAULTS, damaged
from test_online import RATE, arm, effects, log, tracked

from hybrid.dynamics import inverse_dynamics
from hybrid.effects import effects_from_text
from hybrid.errors import IdentificationError
from hybrid.online import OnlineIdentifier, Sample
from hybrid.online.health import Health
from hybrid.plant import random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

LEFT_OUT = ("not_finite", "implausible", "repeated", "late", "jumped")


def tracker(**options):
    return OnlineIdentifier(arm(), effects(), rate=RATE, **options)


def fed(samples, to=None):
    to = to or tracker()
    for sample in samples:
        to.update(sample)
    return to


@cache
def after(seconds):
    return tracked(log(seconds=seconds))


def samples(clock=lambda t: t, keep=lambda k: True, seconds=30.0):
    t, q, tau, _ = log(seconds=seconds)
    return [Sample(float(clock(t[k])), q[k], tau[k]) for k in range(len(t)) if keep(k)]


def off(found, clean):
    """Largest distance of two estimates, in standard deviations."""
    return np.abs((found.theta - clean.theta) / clean.std).max()


def adds_up(health):
    return health.received == health.used + sum(getattr(health, x) for x in LEFT_OUT)


@pytest.mark.parametrize("seed", [0, *studied(1)])
def test_a_storm_of_bad_samples_moves_no_estimate_by_its_uncertainty(seed):
    t, q, tau, _ = log(seconds=15.0)
    found = fed(damaged(t, q, tau, seed=seed))
    assert off(found, after(15.0)) < 1.0
    assert not found.changes
    health = found.health
    assert adds_up(health) and all(getattr(health, x) > 10 for x in LEFT_OUT)
    assert health.missing > 40 and health.restarts == 0
    assert health.rate == pytest.approx(RATE, rel=0.03)
    assert not health.ok and "are lost" in health.problems[0]


# The storm above has all kinds.
@pytest.mark.parametrize("fault", ["nan", *studied(*FAULTS[1:])])
def test_no_kind_of_bad_sample_does_harm_by_itself(fault):
    t, q, tau, _ = log(seconds=10.0)
    found = fed(damaged(t, q, tau, faults=(fault,)))
    assert off(found, after(10.0)) < 1.0
    assert adds_up(found.health) and not found.changes


def test_one_sample_that_is_not_a_number_is_counted_and_nothing_else():
    stream, clean = samples(seconds=10.0), after(10.0)
    bad = stream[1000]
    stream[1000] = Sample(bad.t, np.full(6, np.nan), bad.tau)
    found = fed(stream)
    assert found.health.not_finite == 1 and found.health.missing == 0
    assert off(found, clean) < 0.3 and not found.changes and found.health.ok


def test_three_hundred_missing_samples_are_bridged():
    whole, at, worst = samples(seconds=15.0), 2000, {}
    for name, kept in (("gap", whole[:at] + whole[at + 300 :]), ("none", whole)):
        found, errors = tracker(), []
        for sample in kept:
            found.update(sample)
            if sample.t > whole[at + 300].t:
                errors.append(np.abs(found.error).max())
        worst[name] = max(errors)
        if name == "gap":
            bridged = found
    assert worst["gap"] < 1.5 * worst["none"]
    found = bridged
    assert off(found, after(15.0)) < 1.0 and not found.changes
    assert found.health.missing == 300 and found.health.restarts == 1
    assert found.health.ok and adds_up(found.health)


@pytest.mark.parametrize("step", [3600.0, -10.0, -1e9])
def test_a_clock_that_jumps_is_followed_and_counted(step):
    jumped = samples(clock=lambda t: t + step * (t > 6), seconds=10.0)
    found = fed(jumped)
    assert off(found, after(10.0)) < 1.0 and not found.changes
    assert found.health.restarts == 1 and adds_up(found.health)
    assert found.health.received - found.health.used == 10


def test_epoch_time_with_jitter_is_as_good_as_a_perfect_clock():
    rng, (t, q, tau, _) = np.random.default_rng(0), log(seconds=15.0)
    early = rng.uniform(-0.2, 0.2, len(t)) / RATE
    at = [np.interp(t + early, t, x) for x in q.T]
    found = fed(
        Sample(float(x), *y)
        for x, *y in zip(1.7e9 + t + early, np.array(at).T, tau, strict=True)
    )
    assert off(found, after(15.0)) < 3.0
    assert found.health.ok and found.health.used == len(t)


@pytest.mark.parametrize("rate", [0.5, 0.9, 1.1, 2.0, 1e-3])
def test_a_wrong_rate_is_noticed(rate):
    found = fed(samples(clock=lambda t: t / rate, seconds=5.0))
    assert not found.health.ok and not found.health.rate_is_right
    assert any("Hz" in problem for problem in found.health.problems)
    if rate > 0.1:
        assert found.health.rate == pytest.approx(rate * RATE, rel=0.01)
    assert np.all(np.isfinite(found.theta)) and not found.changes


def test_the_right_rate_is_no_problem():
    health = after(15.0).health
    assert health.ok and health.problems == () and health.lost < 1e-12
    assert health == Health(
        received=3751, used=3751, rate=pytest.approx(RATE), stated_rate=RATE
    )
    assert tracker().health == Health(stated_rate=RATE)


def test_a_joint_that_stands_between_two_steps_of_its_encoder_hides_no_other():
    t, q, tau, _ = log(seconds=10.0)
    step, rng = 2 * np.pi / 2**13, np.random.default_rng(0)
    ends = []
    for flips in (np.zeros(len(t)), rng.random(len(t)) < 0.03):
        stands = q.copy()
        stands[:, 5] = q[0, 5] + step * flips
        ends.append(tracked((t, stands, tau, None)))
    first = [k for k, p in enumerate(ends[0].parameters) if "[base]" in p.name]
    assert np.all(ends[1].std[first] < 1.1 * ends[0].std[first])


def test_after_a_bad_first_sample_all_is_well():
    stream, clean = samples(seconds=10.0), after(10.0)
    first = Sample(1e9, stream[0].q + 500.0, stream[0].tau)
    found = fed([first, *stream])
    assert found.health.restarts == 1 and off(found, clean) < 0.3


NUMBERS = st.one_of(
    st.floats(-3, 3),
    st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e155, 1e20, 5e-324, 1e6]),
)
TIMES = st.one_of(
    st.integers(-3, 30).map(lambda k: k / RATE), st.floats(-1, 1), NUMBERS
)


@cache
def planar():
    return Robot.load(MODELS / "planar.xml")


@cache
def warm():
    """What an arm of two joints shows in its first 0.8 s."""
    rng = np.random.default_rng(0)
    ref = random_fourier(planar(), duration=3.0, rate=RATE, seed=rng)
    links = planar().chain.inertial
    tau = inverse_dynamics(planar().chain, links, ref.q, ref.v, ref.a)
    return [Sample(float(ref.t[k]), ref.q[k], tau[k]) for k in range(200)]


@settings(max_examples=20, deadline=None)
@given(
    exact=st.booleans(),
    rows=st.lists(
        st.tuples(TIMES, st.lists(NUMBERS, min_size=4, max_size=4)), max_size=60
    ),
)
def test_whatever_comes_the_estimate_stays_finite_and_the_counts_add_up(exact, rows):
    robot = planar()
    kinds = effects_from_text("coulomb,viscous", robot.joints, joint_scales(robot))
    to, t = OnlineIdentifier(robot, kinds, rate=RATE), 0.0
    for step, values in rows:
        t = t + step if np.isfinite(step) and abs(t) < 1e300 else step
        q, tau, v, a = (np.full(2, x) * [0.5, 1.0] for x in values)
        to.update(Sample(t, q, tau, v, a) if exact else Sample(t, q, tau))
    for k, s in enumerate(warm()):
        still = np.zeros(2)
        to.update(Sample(s.t, s.q, s.tau, still + k % 2, still) if exact else s)
    assert np.all(np.isfinite(to.theta)) and np.all(np.isfinite(to.std))
    assert np.all(np.isfinite(to.noise)) and np.all(np.isfinite(to.error))
    assert to.health.received == len(rows) + 200 and adds_up(to.health)
    assert 0 <= to.health.lost <= 1 and to.health.used > 100


def test_a_sample_of_the_wrong_shape_is_one_clear_line():
    to = tracker()
    with pytest.raises(IdentificationError, match="6 of each kind, 12 in all"):
        to.update(Sample(0.0, np.zeros(5), np.zeros(6)))
    with pytest.raises(IdentificationError, match="not of numbers"):
        to.update(Sample(0.0, ["a"] * 6, np.zeros(6)))
    exact = tracker()
    exact.update(Sample(0.0, *np.zeros((4, 6))))
    with pytest.raises(IdentificationError, match="every sample must"):
        exact.update(Sample(0.1, *np.zeros((2, 6))))


def test_no_call_does_much_more_than_another():
    t, q, tau, _ = log(seconds=10.0)
    to = OnlineIdentifier(arm(), effects(), rate=1000.0)
    work = np.zeros(600)

    def count(_, event, __):
        work[k] += event in ("call", "c_call")

    for k in range(len(work)):
        sample = Sample(k / 1000, q[k], tau[k])
        sys.setprofile(count)
        try:
            to.update(sample)
        finally:
            sys.setprofile(None)
    usual = work[200:]
    assert usual.max() < 4 * usual.mean()
    assert to._steps <= to._block  # one a call
