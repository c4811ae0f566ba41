"""Doubts about a log on either side of each bound, on signals written by hand."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.diagnosis.gap.faults import find_faults
from hybrid.inspect.coverage import coverage_of
from hybrid.inspect.glitches import doubts_of_rows
from hybrid.inspect.positions import doubts_of_positions
from hybrid.inspect.samples import doubts_of_samples, stuck_position
from hybrid.inspect.scale import _constants, _text
from hybrid.inspect.speeds import doubts_of_speeds
from hybrid.inspect.state import State, filtered_state
from hybrid.recording import Recording
from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import butterworth


def said(x, word, tau=None):
    """Whether some doubt about the rows of one joint holds a word."""
    x = np.asarray(x, dtype=float)
    log = Recording(np.arange(len(x)) / 100.0, x[:, None], tau=tau, joints=("a",))
    return any(word in doubt.text for doubt in doubts_of_rows(log))


@pytest.mark.parametrize("drop", [0.05, 0.1, 0.2])
def test_rows_that_were_lost_are_neither_a_glitch_nor_a_jump(drop):
    """As a subscriber loses them; a position that is wrong there is still found."""
    t = np.arange(0.0, 20.0, 0.004)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        kept = np.sort(rng.choice(len(t), round((1 - drop) * len(t)), replace=False))
        q = np.c_[0.4 * np.sin(2 * t), 0.3 * np.cos(1.3 * t)][kept]
        assert not list(doubts_of_rows(Recording(t[kept], q, joints=("a", "b"))))
        wrong = q.copy()
        wrong[1000, 1] += 0.5
        (doubt,) = doubts_of_rows(Recording(t[kept], wrong, joints=("a", "b")))
        assert "glitch" in doubt.text and doubt.joints == (1,)


def test_a_joint_goes_far_in_a_long_time():
    """Twelve rows are lost: no jump, which the same step in one row is."""
    t = np.delete(np.arange(0.0, 4.0, 0.01), range(200, 212))
    q = 0.5 * t[:, None]
    assert not list(doubts_of_rows(Recording(t, q, joints=("a",))))
    assert said(q[:, 0], "jumps")


def jumped(size, *, near=0.01, rest=0.01, at=200, other=()):
    """Positions that jump among steps that are ``near``, and ``rest`` far from it."""
    steps = np.full(400, rest)
    steps[at - 20 : at + 20] = near
    steps[0] = min(steps[0], 1e-4)
    for distance, step in other:
        steps[at + distance] = step
    steps[at] = size
    return np.append(0.0, np.cumsum(steps))


@pytest.mark.parametrize(("size", "told"), [(0.095, False), (0.105, True)])
def test_a_jump_is_ten_times_any_step_nearby(size, told):
    assert said(jumped(size), "jumps") == told
    assert said(-jumped(size), "jumps") == told


@pytest.mark.parametrize("side", [-1, 1])
def test_steps_nearby_are_five_on_either_side(side):
    for distance in range(1, 7):
        x = jumped(0.5, other=[(side * distance, 0.06)])
        assert said(x, "jumps") == (distance > 5)


@pytest.mark.parametrize(("size", "told"), [(0.19, False), (0.21, True)])
def test_a_jump_is_twice_a_large_step_of_the_joint(size, told):
    assert said(jumped(size, near=0.005, rest=0.1), "jumps") == told


@pytest.mark.parametrize(("size", "told"), [(0.095, False), (0.105, True)])
def test_a_jump_of_a_joint_at_rest_is_ten_steps_of_its_encoder(size, told):
    steps = np.zeros(400)
    steps[50:60], steps[200] = 0.01, size
    assert said(np.cumsum(steps), "jumps") == told


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("rest", "told"), [(4, True), (5, False)])
def test_a_joint_that_rested_for_five_steps_was_frozen(side, rest, told):
    still = [(side * k, 0.0) for k in range(1, rest + 1)]
    assert said(jumped(0.5, other=still), "jumps") == told


def bent(size, *, near=0.001, rest=0.001, kink=None, left=0.0, count=400, at=200):
    """Positions of steady bends with one that is off by half of ``size``."""
    bends = np.full(count, rest)
    bends[at - 40 : at + 40] = near
    if kink:
        bends[at + 1 + kink[0]] += kink[1]
    speed = np.cumsum(bends)
    x = np.cumsum(speed - speed.mean())
    x[at + 1 :] -= left * size / 2
    x[at] -= size / 2
    return x


@pytest.mark.parametrize(("size", "told"), [(0.036, False), (0.040, True)])
def test_a_glitch_bends_ten_times_as_much_as_any_bend_nearby(size, told):
    """Its own bend, of 0.004, comes on top of twice its size."""
    assert said(bent(size - 0.001, near=0.004), "glitch") == told


@pytest.mark.parametrize(("size", "told"), [(0.038, False), (0.042, True)])
def test_a_glitch_bends_ten_times_as_much_as_the_joint_usually_does(size, told):
    assert said(bent(size, near=0.0, rest=0.004), "glitch") == told


@pytest.mark.parametrize("side", [-1, 1])
def test_bends_nearby_are_three_to_five_rows_away(side):
    for distance, told in ((2, True), (3, False), (4, False), (5, False), (6, True)):
        x = bent(0.2, kink=(side * distance, 0.03))
        assert said(x, "glitch") == told, distance


@pytest.mark.parametrize(("left", "told"), [(0.5, True), (0.62, False)])
def test_a_glitch_returns_by_more_than_half(left, told):
    """Else it is a step: neighbours bend by half of it, but for a fifth."""
    assert said(bent(0.4, left=left), "glitch") == told
    assert said(-bent(0.4, left=left), "glitch") == told


@pytest.mark.parametrize(("size", "told"), [(0.0018, False), (0.0023, True)])
def test_a_glitch_is_more_than_two_milliradians_of_bend(size, told):
    assert said(bent(size, near=0.0, rest=1e-7), "glitch") == told


@pytest.mark.parametrize(("rows", "told"), [(51, False), (52, True)])
def test_rows_are_held_fifty_times(rows, told):
    x = np.repeat(np.sin(0.1 * np.arange(rows)), 3)
    assert said(x, "holds each sample for 3 rows") == told


@pytest.mark.parametrize(("odd", "told"), [(8, True), (12, False)])
def test_nine_tenths_of_the_rows_are_held_alike(odd, told):
    counts = np.full(102, 4)
    counts[np.arange(odd) * 8 + 3] = 5
    assert said(np.repeat(np.sin(0.1 * np.arange(102)), counts), "holds") == told


@pytest.mark.parametrize(("rows", "told"), [(49, False), (50, True)])
def test_fifty_rows_that_come_again_are_a_repeated_log(rows, told):
    once = np.sin(0.1 * np.arange(120)) + 0.001 * np.arange(120)
    x = np.append(once, once[: rows + 1])
    assert said(x, "repeats its first rows", 2 * x[:, None]) == told


@pytest.mark.parametrize(("size", "told"), [(0.0008, False), (0.0012, True)])
def test_what_is_repeated_moves_by_a_milliradian(size, told):
    """After a first move of any size, and before another one."""
    slow = 0.5 + size * np.linspace(0.0, 1.0, 50)
    x = np.tile(np.concatenate([[0.0], slow, np.arange(1.0, 9.0)]), 2)
    assert said(x, "repeats its first rows", 2 * x[:, None]) == told


# --- samples --------------------------------------------------------------------------

T = np.arange(0.0, 5.0, 0.01)
WAVE = np.sin(2.0 * T) + 0.3 * np.sin(7.0 * T)


def doubts(q=WAVE, t=None, **channels):
    """What the samples of one joint are said to be."""
    q = np.asarray(q, dtype=float)
    t = 0.01 * np.arange(len(q)) if t is None else t
    columns = {name: np.asarray(x)[:, None] for name, x in channels.items()}
    log = Recording(t, q[:, None], joints=("a",), **columns)
    return [doubt.text for doubt in doubts_of_samples(log)]


@pytest.mark.parametrize(
    ("rate", "looks"),
    [
        (19.5, "no arm is logged so rarely"), (20.5, "time looks to be in nanoseconds"),
        (19999.5, "time looks to be in nanoseconds"),
        (20000.5, "time looks to be in microseconds"),
    ],
)  # fmt: skip
def test_a_clock_is_read_as_one_of_twenty_to_twenty_thousand_hertz(rate, looks):
    (text,) = doubts(t=np.arange(len(WAVE)) / rate * 1e9)
    assert text.endswith(looks)


@pytest.mark.parametrize(("value", "told"), [(1e9, False), (1e9 + 0.5, True)])
def test_a_number_is_up_to_a_billion(value, told):
    tau = WAVE.copy()
    tau[7] = value
    assert any(x.startswith("tau1") for x in doubts(tau=tau)) == told


@pytest.mark.parametrize(
    ("samples", "run", "told"),
    [(12, 2, False), (12, 3, True), (9, 3, False), (3, 3, False)],
)
def test_a_torque_is_saturated_for_a_hundredth_and_three_samples_in_a_row(
    samples, run, told
):
    tau = np.linspace(-0.5, 0.5, 1000) + 1e-3 * np.sin(np.arange(1000.0))
    at = np.arange(samples)
    for sign in (1.0, -1.0):
        limited = tau.copy()
        limited[100 + at + 5 * (at // run)] = sign
        q = np.sin(0.01 * np.arange(1000))
        assert any("saturated" in x for x in doubts(q, tau=limited)) == told


@pytest.mark.parametrize(
    ("samples", "run", "told"),
    [(300, 19, False), (300, 20, True), (1000, 19, False), (1000, 20, True)],
)
def test_a_torque_is_frozen_for_a_fifth_of_a_second(samples, run, told):
    q = np.sin(0.02 * np.arange(samples))
    tau = np.cos(0.02 * np.arange(samples))
    tau[120 : 120 + run] = tau[120]
    found = [x for x in doubts(q, tau=tau) if f"frozen for {run} samples" in x]
    assert bool(found) == told


def paused(first, last, *, step=0.1, bend=0.01, jump=0.0, count=400):
    """A position whose steps change by a bend, and that stays for some samples."""
    steps = step + bend * (np.arange(count) % 2)
    steps[first:last] = 0.0
    if last < count:
        steps[last] += jump
    return np.append(0.0, np.cumsum(steps))


def frozen(q):
    return np.flatnonzero(stuck_position(0.02 * np.arange(len(q)), q)).tolist()


@pytest.mark.parametrize(("step", "told"), [(0.039, False), (0.051, True)])
def test_a_position_is_frozen_that_stops_by_five_large_changes_of_its_step(step, told):
    x = paused(100, 130, step=step)
    assert frozen(x) == (list(range(100, 131)) if told else [])


@pytest.mark.parametrize(("jump", "told"), [(0.049, False), (0.051, True)])
def test_a_position_that_comes_to_rest_is_frozen_if_it_jumps_afterwards(jump, told):
    x = paused(100, 130, step=0.0, jump=jump)
    assert frozen(x) == (list(range(100, 131)) if told else [])


@pytest.mark.parametrize(("last", "told"), [(108, False), (109, True)])
def test_a_position_is_frozen_for_ten_samples_or_more(last, told):
    assert bool(frozen(paused(100, last))) == told


def test_a_position_is_frozen_from_the_first_sample_on_or_to_the_last():
    assert frozen(paused(0, 40)) == list(range(41))
    assert frozen(paused(360, 400)) == list(range(360, 401))


def test_a_joint_that_rests_but_for_ticks_of_its_encoder_is_not_frozen():
    ticks = np.zeros(1000)
    ticks[100::300] = 0.01
    assert frozen(np.cumsum(ticks)) == frozen(np.zeros(50)) == []


def test_inspection_and_diagnosis_agree_on_what_is_frozen():
    q = np.sin(0.02 * np.arange(500))
    for stop, told in ((119, False), (120, True)):
        q[100:stop] = q[100]
        assert any("frozen" in x for x in doubts(q)) == told
        log = Recording(0.01 * np.arange(500), q[:, None], joints=("a",))
        log = replace(log, tau=np.cos(0.3 * log.t)[:, None])
        assert bool(find_faults(log).notes) == told


# --- positions ------------------------------------------------------------------------


def placed(q, **limits):
    """What is said of positions beside limits of ±2 rad, or others."""
    q = np.atleast_2d(np.asarray(q, dtype=float).T).T
    arm = pendulum(q.shape[1])
    arm = replace(arm, **{k: np.broadcast_to(x, arm.size) for k, x in limits.items()})
    log = Recording(0.01 * np.arange(len(q)), q, joints=arm.joints)
    return [doubt.text for doubt in doubts_of_positions(log, arm)]


@pytest.mark.parametrize(("over", "told"), [(0.09, False), (0.11, True)])
def test_a_limit_is_exceeded_by_a_tenth(over, told):
    reach = np.linspace(-1.0, 1.0, 200) * (2.0 + over)
    assert bool(placed(reach)) == told


@pytest.mark.parametrize(("over", "unit"), [(3.1, False), (3.2, True)])
def test_half_a_turn_beyond_a_limit_is_another_unit(over, unit):
    (text,) = placed(np.linspace(0.0, 2.0 + over, 200))
    assert ("looks like degrees" in text) == unit
    assert ("is outside the limits" in text) != unit


@pytest.mark.parametrize("way", [-1, 1])
def test_a_joint_a_whole_turn_off_is_not_only_said_to_be_in_degrees(way):
    q = np.stack([np.linspace(-1.0, 1.5, 200), np.linspace(-1.0, 1.0, 200)], axis=1)
    (text,) = placed(q + [0.0, way * 2 * np.pi])
    assert "looks like degrees, or radians a whole turn off" in text
    assert "turn" not in placed(np.rad2deg(q))[0]


@pytest.mark.parametrize("way", [-7, 7])
def test_a_joint_many_turns_off_is_not_only_said_to_be_in_degrees(way):
    q = np.linspace(-0.7, 0.5, 200) + way * 2 * np.pi
    (text,) = placed(q)
    assert "looks like degrees, or radians 7 whole turns off" in text


@pytest.mark.parametrize(("turns", "told"), [(1.99, False), (2.01, True)])
def test_a_joint_without_limits_makes_two_turns(turns, told):
    q = np.linspace(0.0, turns * 2 * np.pi, 200)
    assert bool(placed(q, q_min=-np.inf, q_max=np.inf)) == told


@pytest.mark.parametrize(("metres", "unit"), [(5.4, False), (5.6, True)])
def test_a_slide_is_ten_times_its_reach_beyond_its_limit_in_another_unit(metres, unit):
    arm = pendulum(1)
    chain = replace(arm.chain, revolute=np.array([False]))
    half = np.full(1, 0.5)
    arm = replace(arm, chain=chain, q_min=-half, q_max=half)
    q = np.linspace(0.0, metres, 200)[:, None]
    log = Recording(0.01 * np.arange(200), q, joints=arm.joints)
    (doubt,) = doubts_of_positions(log, arm)
    assert ("looks like millimetres" in doubt.text) == unit


def test_of_the_orders_that_fit_the_one_that_moves_fewest_columns_is_told():
    low, high = np.array([-1.0, 0.0, 1.0, -1.0]), np.array([0.0, 1.0, 2.0, 1.0])
    t = np.linspace(0.0, 1.0, 200)[:, None]
    q = low[[1, 0, 2, 3]] + t * [1.0, 1.0, 1.0, 0.0] - [0.0, 0.0, 0.0, -1.5]
    (text,) = placed(q, q_min=low, q_max=high)
    assert "in the order hinge_1, hinge_0, hinge_2, hinge_3" in text


# --- speeds ---------------------------------------------------------------------------


def sped(*factors, size=1.0):
    """Doubts about speeds that are some factors of those of their positions."""
    t, w = 0.01 * np.arange(800)[:, None], 2.0 + np.arange(len(factors))
    q, v = size * np.sin(w * t), size * w * np.cos(w * t)
    logged = v * np.array(factors)
    state = State(q, v, 0 * q, 0 * q, logged)
    log = Recording(t[:, 0], q, v=logged, joints=("a", "b", "c")[: len(factors)])
    return [(d.severity, d.text) for d in doubts_of_speeds(log, None, state)]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_speed_is_odd_by_a_tenth_and_wrong_by_a_half(way):
    for factor, told in (
        (1.09, None), (1.12, "warning"), (1.45, "warning"), (1.55, "error")
    ):  # fmt: skip
        said = sped(factor**way, 1.0)
        assert [x for x, _ in said] == ([told] if told else [])


def test_a_factor_is_common_within_a_twentieth():
    ((severity, text),) = sped(2.0, 2.08)
    assert severity == "error" and text.startswith("v is 2.04 times dq/dt at every")
    assert len(sped(2.0, 2.12)) == 2
    assert [x for x, _ in sped(1.48, 1.48)] == ["warning"] * 2
    assert len(sped(2.0)) == 1 and "v1 (a) is 2 times" in sped(2.0)[0][1]


@pytest.mark.parametrize(("off", "near"), [(1.0496, True), (1.0504, False)])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(
    ("unit", "looks"),
    [
        (180 / np.pi, "speeds look to be in degrees per second"),
        (30 / np.pi, "speeds look to be in revolutions per minute"),
        (np.pi / 180, "positions look to be in degrees"),
        (1e3, "time looks to be in milliseconds"), (1e6, "in microseconds"),
        (1e9, "in nanoseconds"),
    ],
)  # fmt: skip
def test_a_factor_is_that_of_a_unit_within_a_twentieth(unit, looks, off, near, way):
    factor = unit * off**way
    ((_, text),) = sped(factor, factor)
    assert (looks in text) == near


@pytest.mark.parametrize(("size", "told"), [(0.0095, False), (0.0105, True)])
def test_speeds_are_compared_at_joints_that_travel_two_hundredths(size, told):
    assert bool(sped(2.0, size=size)) == told


@pytest.mark.parametrize(
    ("hum", "says"),
    [(0.45, None), (0.55, None), (1.65, None), (1.85, "does not follow dq1/dt")],
)
def test_a_speed_follows_its_position_if_half_of_it_correlates(hum, says):
    t = 0.01 * np.arange(4000)[:, None]
    q, v = np.sin(2.0 * t), 2.0 * np.cos(2.0 * t)
    noise = np.random.default_rng(0).normal(size=v.shape)
    noise -= v * (v * noise).sum() / (v * v).sum()
    logged = v + hum * noise * np.sqrt((v * v).sum() / (noise * noise).sum())
    state = State(q, v, 0 * q, 0 * q, logged)
    log = Recording(t[:, 0], q, v=logged, joints=("a",))
    said = [d.text for d in doubts_of_speeds(log, None, state)]
    assert len(said) == (says is not None) and all(says in x for x in said)


# --- scales ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scale", "current", "gear"),
    [
        (1 / 2.9, False, False), (1 / 3.1, True, False), (1 / 9.9, True, False),
        (1 / 10.1, True, True), (1 / 29.5, True, True), (1 / 30.5, False, True),
        (1 / 300.0, False, True), (4.0, False, False),
    ],
)  # fmt: skip
def test_a_scale_looks_like_a_current_or_the_motor_side(scale, current, gear):
    text = _text("tau", scale)
    assert ("a motor current in A" in text) == current
    assert (f"of a gear 1:{1 / scale:.0f}" in text) == gear


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(("unit", "name"), [(1e-3, " kN·m"), (1e3, " mN·m")])
def test_a_scale_is_that_of_a_unit_within_a_factor_of_three(unit, name, way):
    assert name in _text("tau", unit * 2.9**way)
    assert name not in _text("tau", unit * 3.1**way)


def test_constants_of_motors_are_told_where_scales_are_those_of_currents():
    for scale, told in ((1 / 2.9, False), (1 / 3.1, True), (1 / 29, True), (0.03, 0)):
        assert bool(_constants(np.full(3, scale))) == bool(told)
    said = _constants(np.array([0.25, np.nan, 0.2, -0.1]))
    assert "ask for 4, ?, 5, ? N·m/A" in said


# --- a state --------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [150, 400, 4000])
@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_a_state_is_three_hundred_samples_between_the_edges_of_the_filter(
    samples, unit
):
    """A line shows which samples they are, in any unit of time."""
    place = np.arange(float(samples))
    tones = np.sin(place * np.array([0.11, 0.23])[:, None]).sum(axis=0)
    q = np.stack([place, 3 * tones], axis=1)
    log = Recording(unit * place / 250.0, q, joints=("a", "b"))
    cutoff = choose_cutoff(replace(log, t=place / 500.0))
    edge = min(samples // 10, int(1.5 * 500.0 / cutoff) + 4)
    count = min(300, samples - 2 * edge)
    kept = np.unique(np.linspace(edge, samples - 1 - edge, count).astype(int))
    found = filtered_state(log)
    np.testing.assert_allclose(found.q[:, 0], kept, atol=1e-6)
    np.testing.assert_allclose(found.v[:, 0], 250.0 / unit, rtol=1e-6)
    smooth = butterworth(q, rate=500.0, cutoff=2 * cutoff)
    smooth = butterworth(smooth, rate=500.0, cutoff=cutoff)
    np.testing.assert_allclose(found.q, smooth[kept], atol=1e-9)


@pytest.mark.parametrize(("late", "found"), [(49, True), (51, False)])
def test_a_lag_is_sought_up_to_half_a_second(late, found):
    rng = np.random.default_rng(0)
    command = np.cumsum(rng.normal(size=600))
    q = np.concatenate([np.full(late, command[0]), command])[:600]
    log = Recording(
        0.01 * np.arange(600), q[:, None], command=command[:, None], joints=("a",)
    )
    v = np.gradient(q)[:, None]
    (joint,) = coverage_of(log, State(q[:, None], v, v, v))
    assert (joint.lag == pytest.approx(0.01 * late)) == found


def test_a_log_of_scraps_is_refused_for_its_gaps():
    t = np.arange(0.0, 8.0, 0.01)
    t = t[t % 0.8 > 0.2]
    log = Recording(t, np.sin(t)[:, None], joints=("a",))
    first, *_ = doubts_of_samples(log)
    assert first.is_error and "gaps of more than 10 steps, and no part" in first.text
