"""What single checks of a log say of made-up samples: rows, clocks, scales."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum
from scipy.signal import lfilter
from simulated import arm

from hybrid.dynamics import inverse_dynamics
from hybrid.inspect.coverage import coverage_of, excitation_of
from hybrid.inspect.glitches import doubts_of_rows
from hybrid.inspect.physics import _doubt, _gain
from hybrid.inspect.positions import doubts_of_positions
from hybrid.inspect.reading import OtherReading, readings
from hybrid.inspect.samples import doubts_of_samples
from hybrid.inspect.scale import scales
from hybrid.inspect.speeds import (
    doubts_of_speeds,
    speeds_confirm_clock,
)
from hybrid.inspect.state import State, filtered_state
from hybrid.recording import Recording

T = np.arange(0.0, 5.0, 0.01)
SMOOTH = np.sin(2.0 * T) + 0.3 * np.sin(7.0 * T)


def log(x, t=T, tau=None) -> Recording:
    return Recording(t, x[:, None], tau=tau, joints=("a",), source="log")


def moved(rows, by: float):
    x = SMOOTH.copy()
    x[rows] += by
    return x


def state_of(robot, factor=1.0) -> State:
    """What the links of the file ask for along a motion, times a factor."""
    rng, t = np.random.default_rng(0), np.arange(0.0, 10.0, 0.02)[:, None]
    w, phase = rng.uniform(1.0, 6.0, (2, 3, 1, robot.size))
    angle = w * t + phase
    q = np.sin(angle).sum(axis=0)
    v, a = (w * np.cos(angle)).sum(axis=0), (-(w**2) * np.sin(angle)).sum(axis=0)
    a_rotor = robot.chain.armature * a
    tau = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a) + a_rotor
    return State(q, v, a, factor * tau)


def test_a_torque_that_is_zero_has_no_scale():
    robot = arm("planar")
    state = state_of(robot)
    state.tau[:, 1] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scales(robot, state)
    assert found[0] == pytest.approx(1.0, rel=0.05)
    assert np.isnan(found[1])


def columns(state, order, channels=("q", "tau"), factor=1.0) -> State:
    """A state with its columns in another order, or times a factor."""
    names = {"q": ("q", "v", "a"), "tau": ("tau",)}
    own = {x: getattr(state, x) for c in channels for x in names[c]}
    return replace(state, **{x: factor * y[:, order] for x, y in own.items()})


def sped(state, clock) -> State:
    """A state whose time was logged as a multiple of what it was."""
    return replace(state, v=state.v * clock, a=state.a * clock**2)


STRAIGHT, TURNED = np.arange(6), np.where(np.arange(6) == 2, -1.0, 1.0)
SWAPPED, SORTED = np.array([0, 3, 2, 1, 4, 5]), np.array([4, 2, 3, 5, 0, 1])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: columns(s, STRAIGHT[::-1]), "in reverse order"),
        (lambda s: columns(s, STRAIGHT[::-1], ("tau",)), "in reverse order"),
        (lambda s: columns(s, SWAPPED, ("q",)), "swapped"),
        (lambda s: columns(s, SORTED, ("tau",)), "in the order"),
        (lambda s: columns(s, STRAIGHT, ("q", "tau"), TURNED), "the other way round"),
        (lambda s: columns(s, STRAIGHT, ("tau",), TURNED), "the other way round"),
        (lambda s: columns(s, STRAIGHT, ("tau",), -1.0), "the other way round"),
        (lambda s: columns(s, STRAIGHT, ("tau",), 0.001 ** (TURNED < 0)), "kN·m"),
        (lambda s: columns(s, STRAIGHT, ("tau",), 1000.0 ** (TURNED < 0)), "mN·m"),
        (lambda s: columns(s, STRAIGHT, ("tau",), 0.01 ** (TURNED < 0)), "motor side"),
        (lambda s: columns(s, STRAIGHT, ("q",), np.rad2deg(1.0)), "degrees"),
        (lambda s: sped(s, 1e-3), "milliseconds"),
        (lambda s: sped(s, 1e-6), "microseconds"),
        (lambda s: sped(s, 1e-9), "nanoseconds"),
        (lambda s: sped(s, 0.1), "scaled by 10"),
        (lambda s: sped(s, 0.25), "scaled by 4"),
        (lambda s: sped(s, 0.5), "scaled by 2"),
        (lambda s: sped(s, 2.0), "scaled by 1/2"),
        (lambda s: sped(s, 4.0), "scaled by 1/4"),
        (lambda s: sped(s, 10.0), "scaled by 1/10"),
    ],
)
def test_some_reading_undoes_what_is_wrong_and_says_what_it_is(spoil, words):
    robot = arm("coman_like")
    right = state_of(robot)
    wrong = spoil(right)
    found = [
        reading.looks_like
        for reading in readings(robot, list(STRAIGHT), np.argsort(SORTED), ())
        for read in [reading.of(wrong)]
        if all(
            np.allclose(getattr(read, x), getattr(right, x), rtol=1e-9)
            for x in ("q", "v", "a", "tau")
        )
    ]
    assert any(words in x for x in found), found


def test_a_scale_has_to_explain_more_than_friction_leaves_and_a_sign_need_not():
    robot = arm("coman_like")
    best = np.argsort(SORTED)
    ways = list(readings(robot, list(STRAIGHT), best, ()))
    sign = next(x for x in ways if (x.factor == -1.0).any())
    scale = next(x for x in ways if "mN·m" in x.looks_like)
    clock = next(x for x in ways if x.clock == 2.0)
    before, after = np.full(6, 0.002), np.full(6, 0.002)
    before[4], after[4] = 0.03, 0.008  # of the variance, as after a stop
    assert _gain(before, after, sign) > 0.5
    assert _gain(before, after, scale) == _gain(before, after, clock) == 0.0
    before[4] = 0.3
    assert _gain(before, after, scale) > 1.0
    before[3] = 0.03  # a scale of time shows at two joints at least
    assert _gain(before, after, clock) > 0.5


@pytest.mark.parametrize(
    ("channels", "joints", "says"),
    [
        (("tau",), (1,), "tau2 (b) looks odd: read so, an arm of real masses leaves"),
        (("tau",), (0, 1), "tau1 (a) and tau2 (b) look odd"),
        (("q", "tau"), (1,), "q2 (b) and tau2 (b) look odd"),
        (("tau",), (0, 1, 2), "tau look odd"),
        (("t",), (), "time looks odd"),
    ],
)
def test_what_looks_odd_is_said_in_words(channels, joints, says):
    recording = Recording(T, np.zeros((len(T), 3)), tau=None, joints=("a", "b", "c"))
    reading = OtherReading(channels, joints, "odd", np.arange(3), np.ones(3))
    before, after = np.array([0.9, 0.8, 0.7]), np.array([0.9, 0.1, 0.7])
    doubt = _doubt(recording, reading, before, after, "any", "error")
    assert says in doubt.text
    assert "leaves 0.1 of the variance of tau2 (b) unexplained" in doubt.text


def of_one(change):
    """Speeds of three joints, of which the second is changed."""

    def spoil(v):
        v = v.copy()
        v[:, 1] = change(v)
        return v

    return spoil


def hum(v):
    return np.random.default_rng(2).normal(size=len(v))


@pytest.mark.parametrize(
    ("spoil", "says", "severity"),
    [
        (lambda v: v, None, None),
        (lambda v: 1.08 * v, None, None),
        (lambda v: 3.0 * v, "scaled by that", "error"),
        (of_one(lambda v: v[:, 2]), "looks like the speed of c", "error"),
        (of_one(hum), "does not follow dq2/dt", "warning"),
        (of_one(lambda v: -v[:, 1]), "one counts the other way round", "error"),
        (of_one(lambda v: 1.3 * v[:, 1]), "1.3 times dq2/dt", "warning"),
        (of_one(lambda v: 0.5 * v[:, 1]), "0.5 times dq2/dt", "error"),
    ],
)
def test_a_speed_that_is_not_that_of_its_position_is_told(spoil, says, severity):
    rng = np.random.default_rng(1)
    w, phase = rng.uniform(1.0, 6.0, (2, 4, 1, 3))
    angle = w * T[:, None] + phase
    q, v = np.sin(angle).sum(axis=0), (w * np.cos(angle)).sum(axis=0)
    state = State(q, v, 0 * q, 0 * q, spoil(v))
    recording = Recording(T, q, tau=None, v=spoil(v), joints=("a", "b", "c"))
    found = list(doubts_of_speeds(recording, None, state))
    assert len(found) == (says is not None)
    for doubt in found:
        assert says in doubt.text and doubt.severity == severity
    # Of three joints one that is wrong does not outvote the others.
    assert speeds_confirm_clock(state) == (
        says is None or np.array_equal(spoil(v)[:, 0], v[:, 0])
    )


# --- what a log covers ----------------------------------------------------------------


def seen(log):
    v = np.gradient(log.q, log.t, axis=0)
    a = np.gradient(v, log.t, axis=0)
    tau = log.tau if log.has_torque else 0 * v
    return State(log.q, v, a, tau)


@pytest.mark.parametrize("pace", [0.02, 1.0, 50.0])
def test_a_joint_moves_at_any_pace(pace):
    """It is slower than a part of its own highest speed, not than a number."""
    t = np.arange(0.0, 10.0, 0.01) / pace
    q = np.where(pace * t < 5.0, np.sin(2.0 * pace * t), np.sin(10.0))
    (found,) = coverage_of(*[x := log(q, t), seen(x)][:2])
    assert found.moving == pytest.approx(0.5, abs=0.03)
    assert found.fastest == pytest.approx(2.0 * pace, rel=0.01)
    assert (found.low, found.high) == (q.min(), q.max())
    (still,) = coverage_of(*[x := log(0 * t, t), seen(x)][:2])
    assert (still.fastest, still.moving, still.lag) == (0.0, 0.0, None)


@pytest.mark.parametrize("samples", [0, 7, 30])
def test_the_lag_is_where_a_position_differs_least_from_its_command(samples):
    """Also where the command drifts, and the sums over the overlap change with it."""
    t = np.arange(0.0, 5.0, 0.01)
    rng = np.random.default_rng(1)
    command = np.cumsum(rng.normal(0.02, 0.2, len(t) + 50))
    q = command[50 - samples : len(t) + 50 - samples] + 0.3
    command = command[50:]
    x = Recording(t, q[:, None], command=command[:, None], joints=("a",), source="log")
    (found,) = coverage_of(x, seen(x))
    assert found.lag == pytest.approx(0.01 * samples)
    variance = [np.var(q[k:] - command[: len(q) - k]) for k in range(50)]
    assert int(np.argmin(variance)) == samples


DRIVE = (
    "viscous.coefficient[hinge_0]",
    "coulomb.level[hinge_0]",
    "torque_offset.level[hinge_0]",
)


def excitation(v, noise=0.0, memory=0.0, seed=0):
    """What is told of a pendulum at 50 samples a second, in a torque with noise."""
    time = np.arange(len(v)) / 50.0
    q, a = np.cumsum(v)[:, None] / 50.0, np.gradient(v, time)[:, None]
    random = np.random.default_rng(seed).normal(size=len(v)) * np.sqrt(1 - memory**2)
    tau = 7 * np.sin(q) + 0.5 * a + noise * lfilter([1], [1, -memory], random)[:, None]
    state = State(q, v[:, None], a, tau)
    return excitation_of(pendulum().chain, state)


def test_dry_friction_is_not_told_from_an_offset_where_a_joint_turns_one_way():
    found = excitation(4.0 + 0.8 * np.sin(np.arange(400) / 20.0), noise=0.1)
    assert set(DRIVE[1:]) <= set(found.untold)
    assert found.condition == np.inf


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_noise_that_lasts_is_taken_for_no_parameter(memory):
    """At 95 % confidence, one in twenty of what is not there may be told."""
    v = 0.9 * np.sin(np.arange(400) / 20.0) + 0.5 * np.sin(np.arange(400) / 6.1)
    untold = [excitation(v, 0.5, memory, seed).untold for seed in range(40)]
    absent = [x in names for names in untold for x in DRIVE]
    assert np.mean(absent) > 0.85


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_row_that_is_farthest_outside_its_limits_is_named(side):
    t = np.arange(0.0, 2.0, 0.01)
    q = 0.5 * np.sin(t)[:, None] * [1.0, 1.0]
    q[120, 0], q[60, 0] = side * 2.5, side * 2.3
    x = Recording(t, q, joints=pendulum(2).joints, source="log")
    (doubt,) = doubts_of_positions(x, pendulum(2))
    assert "row 121" in doubt.line and f"{side * 2.5:g} is outside" in doubt.line
    assert doubt.evidence == pytest.approx(0.5)
    x = replace(x, q=0.5 * np.sin(t)[:, None] * [1.0, 1.0])
    assert not list(doubts_of_positions(x, pendulum(2)))


@pytest.mark.parametrize("count", [40, 400])
def test_samples_of_a_log_have_the_speed_of_its_motion(count):
    """However few there are: steps are one less than samples."""
    t = np.linspace(0.0, 6.0, count)
    x = Recording(t, np.sin(t)[:, None], joints=("a",), source="log")
    found = filtered_state(x)
    assert found.v**2 + found.q**2 == pytest.approx(np.ones_like(found.q), abs=0.02)
    np.testing.assert_allclose(found.a, -found.q, atol=0.05)


@pytest.mark.parametrize("start", [0, 30])
def test_a_log_that_repeats_itself_is_told_from_where(start):
    """Also one that stands at first."""
    once = np.concatenate([np.full(start, SMOOTH[0]), SMOOTH])
    twice = np.concatenate([once, once])
    x = log(twice, t=0.01 * np.arange(len(twice)), tau=(2 * twice)[:, None])
    found = [d for d in doubts_of_rows(x) if "repeats" in d.line]
    (doubt,) = found
    assert doubt.evidence == len(once) and f"from row {len(once) + 1} " in doubt.line
    once = log(SMOOTH, tau=(2 * SMOOTH)[:, None])
    assert not [d for d in doubts_of_rows(once) if "repeats" in d.line]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_glitch_is_told_with_the_positions_beside_it(sign):
    x = moved(200, 0.3 * sign)
    (doubt,) = [d for d in doubts_of_rows(log(x)) if "glitch" in d.text]
    beside = f"{x[200]:.6g} between {x[199]:.6g} and {x[201]:.6g}, the first of 1"
    assert beside in doubt.text and x[199] != x[201] and "row 201" in doubt.line


@pytest.mark.parametrize(
    ("peak", "rows", "told"), [(51, 4, 1), (-51, 19, 1), (49, 4, 0), (51, 21, 0)]
)
def test_a_torque_that_jumps_above_five_ratings_is_no_torque(peak, rows, told):
    """Of more than a twentieth of all rows, the unit or the rating is wrong."""
    rated = replace(pendulum(), tau_max=np.array([10.0]))
    tau = 4 * SMOOTH[:400, None]
    tau[100 : 100 + rows] = peak
    found = list(doubts_of_rows(log(SMOOTH[:400], T[:400], tau), rated))
    assert [(x.evidence, x.is_error) for x in found] == [(rows, True)] * told
    assert all(f"row 101 (data rows count from 1): jumps to {peak}," in x.text
               for x in found)  # fmt: skip


def test_the_torques_of_two_joints_are_never_the_same():
    tau = np.stack([SMOOTH, 2 * SMOOTH, SMOOTH, 0 * SMOOTH, 0 * SMOOTH], axis=1)
    both = Recording(T, tau, tau=tau, source="log")
    (found,) = [x for x in doubts_of_samples(both) if "same in every row" in x.text]
    assert found.joints == (0, 2) and found.is_error


def test_glitches_are_told_apart_from_seven_rows_on_and_are_no_jumps():
    """The bend of one reaches five rows to the bend of another."""
    (both,) = doubts_of_rows(log(moved([200, 207], 0.3)))
    assert "glitch: " in both.text and "the first of 2" in both.text
    (one,) = doubts_of_rows(log(moved(200, 0.3)))
    assert "glitch: " in one.text


def test_a_way_of_two_steps_is_no_jump():
    x = moved(200, 0.4)
    x[201:] += 0.8
    assert list(doubts_of_rows(log(x))) == []
