"""What a log shows and what of it counts; the law of a servo from its signals."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import RATE, gap_of, pendulum, swings
from scipy.interpolate import CubicSpline

from hybrid.diagnosis.answer import command
from hybrid.diagnosis.answer.findings import ExtraFindings, finding_of, listed
from hybrid.diagnosis.answer.regions import (
    _decade_edges,
    _even_edges,
    _merged_edges,
    time_since_reversal,
)
from hybrid.diagnosis.evidence.bayes import heavy_tailed, log_bayes
from hybrid.diagnosis.evidence.noise import noise_bound
from hybrid.diagnosis.explanations.servo_fit import (
    _more_likely,
    _refined,
    fit,
    fit_without_latency,
    hidden_damping,
    log_likelihood_ratio,
)
from hybrid.diagnosis.gap.coverage import not_excited, reversals
from hybrid.diagnosis.gap.faults import Faults
from hybrid.diagnosis.gap.measure import (
    _around,
    block_seconds,
    measure_gap,
    split,
    unseen_samples,
)
from hybrid.diagnosis.gap.servo import LATENCIES, ServoLog, laws
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.viscous import Viscous
from hybrid.recording import Recording
from hybrid.signals import autocorrelation_time

CUTOFF = 10.0
T = np.arange(0.0, 20.0, 1 / RATE)


def shown(q, **limits):
    """What a motion of a pendulum does not show."""
    q = np.asarray(q)[:, None]
    v = np.gradient(q, T, axis=0)
    (m, *_) = swings(1, count=1)
    mask = np.ones(len(T), dtype=bool)
    motion = replace(m, t=T, q=q, v=v, a=0 * q, tau=0 * q, mask=mask)
    limits = {k: np.array([float(x)]) for k, x in limits.items()}
    free = {"v_max": np.array([np.inf])} | limits
    gap = SimpleNamespace(robot=replace(pendulum(), **free), sampled=motion, rate=RATE)
    return not_excited(gap)


def test_a_motion_that_shows_all_leaves_nothing_to_ask_for():
    assert shown(1.8 * np.sin(T) * np.sin(0.3 * T), v_max=1.5) == ()


@pytest.mark.parametrize(
    ("q", "limits", "says"),
    [
        (0.002 * np.sin(T), {}, ["hinge_0 does not move"]),
        (
            0.22 * T - 2.2, {},
            ["hinge_0 moving down", "hinge_0 below 0.2 rad/s", "reversals of hinge_0"],
        ),
        (
            2.2 - 0.22 * T, {},
            ["hinge_0 moving up", "hinge_0 below 0.2 rad/s", "reversals of hinge_0"],
        ),
        (1.8 * np.sin(T), {"v_max": 10.0}, ["hinge_0 above 1.8 rad/s"]),
        (0.9 * np.sin(T), {}, ["hinge_0 beyond -0.9 to 0.9 rad"]),
        (
            0.9 * np.sin(T), {"v_max": 10.0},
            ["hinge_0 above 0.9 rad/s", "hinge_0 beyond -0.9 to 0.9 rad"],
        ),
        (0.9 * np.sin(T), {"q_max": np.inf}, []),
    ],
)  # fmt: skip
def test_what_a_motion_does_not_show_is_said_first_what_matters_most(q, limits, says):
    assert list(shown(q, **limits)) == says


def test_a_reversal_is_from_beyond_a_threshold_to_beyond_it():
    v = np.array([0.0, 1.0, 0.1, -0.1, 0.2, 1.0, -1.0, 0.05, -1.0, 2.0])
    assert reversals(v, 0.3) == 2 and reversals(v, 0.0) == 6
    assert reversals(np.zeros(3), 0.1) == 0


def test_only_samples_count_at_which_a_joint_moves():
    gap = gap_of(noise=0.0)
    speed = np.abs(gap.sampled.v[:, 0])
    standing = speed <= 0.01 * max(np.abs(m.v).max() for m in gap.motions)
    v = gap.sampled.v[:, 0]
    turned = np.append(False, (v[1:] * v[:-1] < 0) & (np.diff(gap.trajectory) == 0))
    np.testing.assert_array_equal(gap.moving[:, 0], ~(standing | turned))
    assert np.abs(gap.left).max() < 1e-9  # the file has all there is
    masked = [replace(m, mask=m.t > 1.0) for m in swings()]
    later = measure_gap(pendulum(), masked, cutoff=CUTOFF)
    assert not later.moving[later.sampled.t <= 1.0].any()
    assert later.moving[later.sampled.t > 1.5].mean() > 0.9


def test_a_joint_that_hardly_moves_is_not_looked_at():
    parts = [
        replace(m, q=m.q * [1, x], v=m.v * [1, x], a=m.a * [1, x])
        for m, x in zip(swings(2), (0.0, 0.0, 0.0, 0.0), strict=True)
    ]
    gap = measure_gap(pendulum(2), parts, cutoff=CUTOFF)
    assert gap.moving[:, 0].mean() > 0.9 and not gap.moving[:, 1].any()


def test_flags_reach_as_far_as_a_filter_spreads_them():
    flags = np.zeros((20, 2), dtype=bool)
    flags[[5, 17], 0] = True
    found = _around(flags, 2)
    assert np.flatnonzero(found[:, 0]).tolist() == [3, 4, 5, 6, 7, 15, 16, 17, 18, 19]
    assert not found[:, 1].any()
    np.testing.assert_array_equal(_around(flags, 0), flags)


@pytest.mark.parametrize(("count", "seconds"), [(1, 4.0), (2, 30.0), (5, 4.0)])
def test_recordings_are_folds_or_blocks_of_at_most_three_seconds(count, seconds):
    gap = gap_of(count=count, seconds=seconds)
    assert set(gap.trajectory) == set(range(count))
    length = block_seconds(gap.motions)
    whole = {(1, 4.0): 0.5, (2, 30.0): 3.0, (5, 4.0): 2.5}[count, seconds]
    assert length == pytest.approx(whole, abs=0.01)
    since = gap.sampled.t - np.array([m.t[0] for m in gap.motions])[gap.trajectory]
    for k in range(count):
        own = gap.fold[gap.trajectory == k]
        block = (since[gap.trajectory == k] // length).astype(int)
        assert (np.diff(own)[np.diff(block) == 0] == 0).all()
        assert (np.diff(own)[np.diff(block) == 1] != 0).all()
    assert gap.fold.max() <= 7
    learn = split(gap)
    unseen = unseen_samples(gap, learn)
    reach = 0 if count >= 4 else round(length / 6 * gap.rate)
    for k in np.flatnonzero(unseen):
        assert not learn[max(0, k - reach) : k + reach + 1].any()
    assert unseen.any()


def test_first_order_columns_are_slopes_of_the_simulated_torque():
    """Rotor and spring of the file feel a motion that encoders show wrongly, too."""
    stiff = replace(pendulum(), damping=np.array([0.7]), stiffness=np.array([5.0]))
    gap = measure_gap(stiff, swings(), cutoff=CUTOFF)
    small = EncoderOffset((0,), {"offset": 1e-4})
    first = gap.columns(EncoderOffset((0,)))[0][:, 0]
    exact = gap.columns(small)[0] @ small.gain_values / 1e-4
    np.testing.assert_allclose(first, exact, atol=2e-2 * np.abs(exact).max())


def test_columns_that_are_asked_for_again_are_those_of_the_same_effect():
    """Those of a linear law for all its gains, others for theirs alone."""
    gap, fresh = (measure_gap(pendulum(), swings(), cutoff=CUTOFF) for _ in range(2))
    effects = [
        Coulomb((0,), {"level": 1.0}),
        Coulomb((0,), {"level": 2.0}),
        EncoderOffset((0,)),
        EncoderOffset((0,), {"offset": 0.1}),
    ]
    kept = [gap.columns(e) for e in effects]
    again = [gap.columns(e) for e in effects]
    assert all(x is y for x, y in zip(kept, again, strict=True))
    assert kept[0] is kept[1] and kept[2] is not kept[3]
    for e, x in zip(reversed(effects), reversed(kept), strict=True):
        np.testing.assert_array_equal(x[0], fresh.columns(e)[0])


# --- the law of a servo ---------------------------------------------------------------


def served(*, kp=80.0, kd=5.0, feed=0.0, weight=0.0, age=0.0, late=0.0, shift=0.0,
           asked=True, noise=0.01):  # fmt: skip
    """Signals of a servo with a law, its command, and torque that is logged late."""
    t = np.arange(0.0, 15.0, 0.01)
    wide = np.arange(-1.0, 16.0, 0.002)
    rng = np.random.default_rng(0)

    def smooth(x):
        w, phase = 2 * np.pi * rng.uniform(0.2, 3.0, 6), rng.uniform(0, 6, 6)
        return lambda t, k=0: (
            x * (np.sin(np.multiply.outer(t, w) + phase + k * np.pi / 2) * w**k).sum(-1)
        )

    q, ref, fed, heavy = smooth(0.3), smooth(0.3), smooth(4.0), smooth(6.0)
    command = CubicSpline(wide, np.stack([fed(wide), ref(wide), ref(wide, 1)], axis=1))

    def given(at):
        feed_, c, speed = command(at - late).T
        speed = speed if asked else 0.0
        pull = kp * (c - q(at)) + kd * (speed - q(at, 1)) + age * q(at, 2)
        return feed * feed_ + weight * heavy(at) + pull + 0.3

    torque = given(wide - shift) + noise * rng.standard_normal(len(wide))
    own = np.stack([heavy(t), q(t), q(t, 1), q(t, 2)], axis=1)
    return ServoLog(np.arange(len(t)), t, own, command, CubicSpline(wide, torque))


@pytest.mark.parametrize(
    ("law", "gains"),
    [
        ({}, [80.0, 5.0, 0.0, 0.3]),
        ({"feed": 1.0}, [80.0, 5.0, 0.0, 0.3]),
        ({"weight": 1.0, "asked": False}, [80.0, 5.0, 0.0, 0.3]),
        ({"asked": False, "age": -0.2}, [80.0, 5.0, -0.2, 0.3]),
        ({"feed": 0.85}, [0.85, 80.0, 5.0, 0.0, 0.3]),
        ({"late": 0.043}, [80.0, 5.0, 0.0, 0.3]),
        ({"shift": 0.021}, [80.0, 5.0, 0.0, 0.3]),
        ({"late": 0.06, "shift": 0.02, "feed": 1.0}, [80.0, 5.0, 0.0, 0.3]),
    ],
)
def test_a_servos_law_is_found_with_its_gains_and_times(law, gains):
    found = fit(served(**law), list(laws()), immediate=False)
    np.testing.assert_allclose(found.gains, gains, rtol=0.01, atol=0.01)
    assert found.late == pytest.approx(law.get("late", 0.0), abs=2e-4)
    assert found.shift == pytest.approx(law.get("shift", 0.0), abs=2e-4)
    assert found.latency == pytest.approx(found.late + min(found.shift, 0.0))
    assert found.law.scaled == (len(gains) == 5)
    assert np.std(found.left) < 0.02
    again = found.residual(served(**law))
    np.testing.assert_allclose(again, found.left, atol=1e-9)
    std = np.sqrt(np.diag(found.covariance))
    off = np.abs(found.gains - gains) / std[2:]
    assert off.max() < 6.0 and std[2] < 0.1


def test_a_position_that_is_logged_late_is_no_latency():
    """Torque is early then, by as much as the command is late."""
    log = served(late=0.03, shift=-0.03)
    found = fit(log, list(laws()), immediate=True)
    assert (found.late, found.shift) == pytest.approx((0.03, -0.03), abs=5e-4)
    assert found.latency == pytest.approx(0.0, abs=5e-4)
    assert found.latency_std < 1e-3
    late = fit(served(shift=0.02), list(laws()), immediate=True)
    assert (late.late, late.shift) == pytest.approx((0.0, 0.02), abs=5e-4)
    prompt = fit(served(late=0.04), list(laws()), immediate=True)
    assert np.std(prompt.left) > 0.1  # the command is late, and that is not asked


def test_without_its_latency_a_law_leaves_more_and_evidence_says_by_how_much():
    log = served(late=0.04)
    found = fit(log, list(laws()), immediate=False)
    less = fit_without_latency(log, list(laws()), found)
    assert (less.late, less.shift) == (0.0, 0.0)
    assert (
        log_likelihood_ratio(log, less, found)
        > 50.0
        > log_likelihood_ratio(log, found, found)
        == 0.0
    )
    assert log_likelihood_ratio(log, found, less) < 0.0
    assert not found.law.scaled and not less.law.scaled
    off = served(late=0.04, feed=0.85)
    found = fit(off, list(laws()), immediate=False)
    assert found.law.scaled and fit_without_latency(off, list(laws()), found).law.scaled


@pytest.mark.parametrize(("nats", "taken"), [(13.9, False), (14.1, True)])
def test_a_parameter_more_is_taken_at_odds_of_fourteen_nats(nats, taken):
    servo = SimpleNamespace(row=np.arange(500))
    left = np.random.default_rng(0).standard_normal(500)
    count = 500 / autocorrelation_time(left, servo.row)
    simple = SimpleNamespace(left=left * np.exp(nats / count))
    other = SimpleNamespace(left=left)
    assert (_more_likely(servo, simple, other) is other) == taken
    assert _more_likely(servo, None, other) is _more_likely(servo, other, None) is other


def test_a_signal_that_is_zero_throughout_has_no_gain():
    log = served()
    blank = replace(log, own=log.own * [0.0, 1.0, 1.0, 1.0])
    law = next(x for x in laws() if x.scaled and x.columns[1, 0] == 1.0)
    found = _refined(blank, law, np.zeros(2), np.zeros((2, 0)))
    np.testing.assert_allclose(found.gains, [0.0, 80.0, 5.0, 0.0, 0.3], atol=0.02)
    assert np.isfinite(found.covariance).all()


def test_stated_gains_are_taken_as_they_are():
    stated = list(laws(80.0, 5.0))
    found = fit(served(feed=1.0), stated, immediate=False)
    np.testing.assert_allclose(found.gains, [0.0, 0.3], atol=0.01)
    soft = fit(served(kp=60.0), stated, immediate=False)
    assert np.std(soft.left) > 0.5
    assert LATENCIES[0] == 0.0 and len(stated) == 10 == len(list(laws()))


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_noise_of_a_speed_hides_so_much_of_its_damping(noise):
    log, rng = served(), np.random.default_rng(1)
    own = log.own.copy()
    own[:, 2] += noise * rng.standard_normal(len(own))
    log = replace(log, own=own)
    found = fit(log, list(laws()), immediate=False)
    part = hidden_damping(log, found, 100.0, 50.0)
    assert part == pytest.approx(1 - found.gains[1] / 5.0, abs=0.06)
    assert (part > 0.05) == (noise > 0)


def test_the_most_that_noise_can_be_is_that_of_the_upper_half_of_the_band():
    rng, row = np.random.default_rng(0), np.arange(4000)
    white = rng.standard_normal(4000)
    tone = 5.0 * np.sin(2 * np.pi * 3.0 * row / 100.0)
    found = noise_bound(white + tone, row, 100.0, 50.0)
    assert found == pytest.approx(1.0, rel=0.1)
    slow = noise_bound(tone, row, 100.0, 50.0)
    assert slow < 1e-3


# --- evidence and words ---------------------------------------------------------------


def test_each_decade_of_a_wider_prior_is_ten_times_less_probable():
    H, s = np.array([[[400.0]]]), np.array([[2000.0]])
    precision, lower = np.array([[1.0]]), np.array([[-np.inf]])
    worth, gains, wider = heavy_tailed(H, s, precision, lower)
    widths = np.logspace(-2, 2, 9)  # half decades
    alone = [log_bayes(H, s, precision / w**2, lower)[0][0] for w in widths]
    alone -= np.abs(np.log(widths))
    best = widths[np.argmax(alone)]
    assert wider == pytest.approx([best]) and best == pytest.approx(10.0**0.5)
    assert worth[0] == pytest.approx(max(alone))
    assert gains[0, 0] == pytest.approx(2000.0 / 400.1)


def test_names_are_listed_and_shares_are_of_all_that_is_explained():
    assert listed([]) == "" and listed(["a"]) == "a"
    assert listed(["a", "b"]) == "a and b" and listed("abc") == "a, b and c"
    one, other = (
        replace(finding_of(kind, ["a"], (), ()), share=1.0)
        for kind in (Coulomb, Viscous)
    )
    both = ExtraFindings((one,), (), np.array([1.0, 2.0])).merged([other], 9.0)
    assert [(f.effect, f.share) for f in both] == [
        ("viscous", pytest.approx(0.75)), ("coulomb", pytest.approx(0.25)),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("gains", "hidden", "wrong"),
    [
        ([80.0, 5.0], 0.0, False),
        ([70.0, 5.0], 0.0, True),
        ([90.0, 5.0], 0.0, True),
        ([80.0, 3.5], 0.0, True),
        ([80.0, 3.5], 0.4, False),  # 3.5 of 5 is what noise leaves of up to 5.8
        ([80.0, 3.5], 0.2, True),
        ([80.0, 6.5], 0.4, True),
        ([70.0, 5.0], 0.4, True),  # a stiffness hides in no noise
    ],
)
def test_a_damping_that_noise_hides_part_of_is_not_wrong_by_that(
    monkeypatch, gains, hidden, wrong
):
    servo = replace(pendulum(), kp=np.array([80.0]), kd=np.array([5.0]))
    gap = SimpleNamespace(robot=servo, rate=100.0, cutoff=10.0)
    found = SimpleNamespace(
        law=SimpleNamespace(scaled=False), gains=np.array(gains),
        covariance=np.diag([1.0, 1.0, 1e-4, 1e-6]),
    )  # fmt: skip
    monkeypatch.setattr(command, "hidden_damping", lambda *_: hidden)
    assert command._gains_differ(found, gap, None, 0) == wrong


# --- regions --------------------------------------------------------------------------


def test_time_since_a_reversal_begins_anew_where_a_joint_turns_and_with_each_log():
    v = np.array([1.0, 2.0, 1.0, -1.0, -1.0, -2.0, 0.0, 1.0, 1.0])[:, None]
    gap = SimpleNamespace(
        sampled=SimpleNamespace(v=v), rate=10.0,
        trajectory=np.array([0, 0, 0, 0, 0, 1, 1, 1, 1]),
    )  # fmt: skip
    found = time_since_reversal(gap, 0)
    np.testing.assert_allclose(found, [0, 0.1, 0.2, 0, 0.1, 0, 0, 0, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("low", "high", "step"),
    [(-1.0, 1.0, 0.5), (0.0, 0.037, 0.005), (3.0, 40.0, 5.0), (-0.4, 0.5, 0.1)],
)
def test_bins_of_a_range_are_round_at_most_ten_and_hold_all_of_it(low, high, step):
    edges = _even_edges(np.array([low, high, (low + high) / 2]))
    np.testing.assert_allclose(np.diff(edges), step)
    assert edges[0] <= low < edges[1] and edges[-2] <= high < edges[-1]
    assert 5 <= len(edges) - 1 <= 11


def test_bins_from_zero_end_beyond_the_largest_value():
    np.testing.assert_array_equal(
        _decade_edges(np.array([0.01, 0.3])), [0, 0.02, 0.05, 0.1, 0.2, 0.5]
    )
    np.testing.assert_array_equal(_decade_edges(np.array([0.001])), [0, 0.02])


def test_bins_that_hold_too_few_are_put_to_the_next():
    x = np.array([0.5] * 10 + [1.5] * 2 + [2.5] * 10 + [3.5])
    edges = np.arange(5.0)
    np.testing.assert_array_equal(_merged_edges(edges, x, 5), [0.0, 1.0, 4.0])
    np.testing.assert_array_equal(_merged_edges(edges, x, 1), edges)
    np.testing.assert_array_equal(_merged_edges(edges, x, 100), [0.0, 4.0])


def fast_log(rate=2000.0) -> Recording:
    """A pendulum with dry friction, logged fast."""
    t = np.arange(0.0, 10.0, 1 / rate)
    q = np.sin(2 * t)[:, None] + 0.3 * np.sin(5 * t)[:, None]
    v = np.gradient(q, t, axis=0)
    tau = 3.0 * np.tanh(v / 1e-2) + np.random.default_rng(0).normal(0, 0.1, q.shape)
    return Recording(t, q, tau, joints=pendulum().joints)


def test_a_fast_log_has_the_gap_of_all_its_samples(monkeypatch):
    robot, log = pendulum(), fast_log()
    few = measure_gap(robot, [log], cutoff=CUTOFF)
    monkeypatch.setattr(
        "hybrid.diagnosis.gap.measure.decimated_motion", lambda motion, cutoff: motion
    )
    every = measure_gap(robot, [log], cutoff=CUTOFF)
    assert few.motions[0].rate <= 25 * CUTOFF < every.motions[0].rate
    assert few.period == every.period == pytest.approx(1 / 2000)
    friction = []
    for gap in (few, every):
        column, use = gap.columns(Coulomb((0,)))[0][:, 0], gap.moving[:, 0]
        friction.append(column[use] @ gap.left[use, 0] / (column[use] @ column[use]))
        friction.append(np.sqrt(np.mean(gap.left[use] ** 2)))
    np.testing.assert_allclose(friction[:2], friction[2:], rtol=0.01)


def test_what_is_left_out_of_a_short_fast_log_is_left_out_at_its_time(monkeypatch):
    """It failed: with fewer samples kept than are skipped, it came out elsewhere."""
    log = fast_log()
    log = replace(log, t=log.t[:1891], q=log.q[:1891], tau=log.tau[:1891])
    torque = np.zeros((1891, 1), dtype=bool)
    torque[900:1120] = True
    bad = Faults(np.zeros(1891, dtype=bool), torque, ())
    monkeypatch.setattr("hybrid.diagnosis.gap.measure._faults", lambda *_: bad)
    gap = measure_gap(pendulum(), [log], cutoff=CUTOFF)
    skipped = 1.0 / (gap.period * gap.rate)
    assert len(gap.left) < skipped
    inside = (gap.sampled.t >= 0.45) & (gap.sampled.t < 0.56)
    assert inside.any() and not gap.moving[inside].any()
    after = (gap.sampled.t >= 0.56) & (gap.sampled.t < 0.6)
    assert gap.moving[after].all()
