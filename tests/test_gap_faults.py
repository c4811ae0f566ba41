"""Faulty samples of a log at the bounds of each rule, on signals written by hand."""

import numpy as np
import pytest

from hybrid.diagnosis.gap.faults import (
    _leaps,
    find_faults,
)
from hybrid.inspect.stuck import _clipped, _moving, _usual_run, repeats, stretches
from hybrid.recording import Recording

STEP = 2.0**-6  # s; steps of time and position without rounding errors


def leaps(tau, v=1.0):
    """Where torque jumps beside a joint of some speed at every step."""
    tau = np.asarray(tau, dtype=float)
    speed = np.broadcast_to(v, len(tau) - 1)
    t, q = STEP * np.arange(len(tau)), np.append(0.0, np.cumsum(speed * STEP))
    return np.flatnonzero(_leaps(t, q[:, None], tau[:, None])[:, 0]).tolist()


def stair(size, at=100, *, count=400, steps=0.0):
    """Torque with one jump, and a change at every other step."""
    tau = np.cumsum(np.broadcast_to(steps, count).astype(float))
    tau[at:] += size
    return tau


def test_a_jump_is_left_out_with_the_samples_on_either_side():
    assert leaps(stair(10.0)) == [99, 100]
    assert leaps(stair(-10.0)) == [99, 100]
    assert leaps(stair(10.0), v=-1.0) == [99, 100]
    assert leaps(stair(0.0)) == []


@pytest.mark.parametrize(("size", "rare"), [(1.9, False), (2.1, True)])
def test_a_jump_is_more_than_a_quarter_of_the_range_of_torque(size, rare):
    ramp = stair(size, steps=6.0 / 400)  # a third of the rest is a quarter of all
    assert bool(leaps(ramp)) == rare


@pytest.mark.parametrize(("size", "rare"), [(4.6, False), (5.4, True)])
def test_a_jump_is_more_than_five_times_the_usual_step(size, rare):
    saw = (-1.0) ** np.arange(400)
    assert bool(leaps(stair(size - 1.0, steps=saw))) == rare
    # The step of the saw at the jump goes the same way.


@pytest.mark.parametrize("beside", [-1, 1])
@pytest.mark.parametrize(("share", "alone"), [(0.3, True), (0.36, False)])
def test_a_fast_change_of_several_steps_is_no_jump(beside, share, alone):
    steps = np.zeros(400)
    steps[100], steps[100 + beside] = 10.0, share * 10.0
    assert (99 in leaps(np.cumsum(steps)) and 100 in leaps(np.cumsum(steps))) == alone
    steps[100 + beside] *= -1.0  # a step back is another matter
    assert {99, 100} <= {*leaps(np.cumsum(steps))}


def test_no_jump_is_near_a_reversal():
    """Dry friction jumps there as well; three samples away it does not."""
    turns = np.where(np.arange(399) <= 200, 1.0, -1.0)
    for at, found in ((198, [197, 198]), (199, []), (204, []), (205, [204, 205])):
        assert leaps(stair(10.0, at=at), v=turns) == found


@pytest.mark.parametrize(("speed", "rare"), [(0.046, False), (0.055, True)])
def test_a_joint_is_under_way_above_a_twentieth_of_its_highest_speed(speed, rare):
    v = np.full(399, 2.0 * speed)
    v[:50] = 2.0
    assert bool(leaps(stair(10.0, at=300), v=v)) == rare


@pytest.mark.parametrize(("factor", "rare"), [(2.6, True), (3.4, False)])
def test_at_an_impact_the_speed_jumps_as_well(factor, rare):
    wobble = 2.0**-7
    v = 1.0 + wobble * (-1.0) ** np.arange(399)  # changes of twice this
    for at in (99, 100, 101):
        jolted = v.copy()
        jolted[at + 1 :] += (-1.0) ** (at + 1) * (factor - 1) * 2 * wobble
        assert bool(leaps(stair(10.0, at=101), v=jolted)) == rare


def test_runs_are_at_least_so_long():
    x = np.repeat([0.0, 1.0, 0.0, 2.0], [3, 4, 5, 2])
    assert repeats(x, 4).tolist() == [False] * 3 + [True] * 9 + [False] * 2
    assert repeats(x, 6).sum() == 0 and repeats(x, 1).all()


def test_a_run_counts_where_some_joint_moves_for_more_than_half_of_it():
    flags = np.zeros(20, dtype=bool)
    flags[4:12] = True
    for moving, kept in ((4, False), (5, True)):
        q = np.zeros((20, 2))
        q[:, 1] = np.cumsum((np.arange(20) >= 4) & (np.arange(20) < 4 + moving))
        assert _moving(q, flags).tolist() == (flags & kept).tolist()


def test_a_usual_run_is_the_third_longest_of_three_or_more():
    assert _usual_run(np.repeat([0, 1, 2, 3], [4, 6, 5, 1])) == 12
    assert _usual_run(np.repeat([0, 1, 2], [4, 6, 5])) == 0
    runs = stretches(np.array([0, 1, 1, 0, 1], dtype=bool))
    assert runs == [slice(1, 3), slice(4, 5)]


def held(top, *, length=3, count=1000, low=0.5):
    """A fine ramp that reaches a top value in runs of some length."""
    x = np.linspace(-low, low, count)
    at = np.arange(top)
    x[at + at // length] = 1.0
    return x


def test_torque_at_its_limit_is_held_in_runs_of_three_and_for_a_hundredth():
    for length, clipped in ((2, False), (3, True)):
        x = held(60, length=length)
        assert _clipped(x, False).sum() == 60 * clipped
        assert _clipped(-x, False).sum() == 60 * clipped
    for top, clipped in ((9, False), (12, True)):
        assert _clipped(held(top), False).any() == clipped
    assert _clipped(np.where(np.arange(90) < 40, 1.0, -1.0), False).all()
    assert not _clipped(np.ones(50), False).any()


@pytest.mark.parametrize(("times", "clipped"), [(4.6, False), (5.4, True)])
def test_the_last_level_of_a_coarse_sensor_is_far_more_frequent(times, clipped):
    """Five times as often as the level beside it."""
    counts = [40, 60, 50, round(50 * times)]
    x = np.repeat([-1.0, 0.0, 1.0, 2.0], counts)
    assert np.array_equal(_clipped(x, True), (x == 2.0) & clipped)
    assert np.array_equal(_clipped(-x, True), (x == 2.0) & clipped)
    assert _clipped(x, False).sum() == counts[0] + counts[-1]  # each end is held


def recorded(tau, *, rate=100.0, joints=("a", "b"), source=""):
    t = np.arange(len(tau)) / rate
    q = np.stack([np.sin(t), np.cos(1.3 * t)], axis=1)
    return find_faults(Recording(t, q, tau=tau, joints=joints, source=source))


def torque(count=1000, seed=0):
    t = np.arange(count)[:, None] / 100.0
    noise = 0.01 * np.random.default_rng(seed).standard_normal((count, 2))
    return np.sin(t * [2.0, 3.1]) + noise


@pytest.mark.parametrize(
    ("rate", "samples", "frozen"),
    [
        (100.0, 19, False), (100.0, 20, True),  # a fifth of a second
        (20.0, 9, False), (20.0, 10, True),  # and ten samples
        (500.0, 99, False), (500.0, 100, True),
    ],
)  # fmt: skip
def test_torque_is_frozen_for_a_fifth_of_a_second_and_ten_samples(
    rate, samples, frozen
):
    tau = torque()
    first = 253 - samples // 2  # around a peak, without a jump at its end
    tau[first : first + samples, 1] = tau[first, 1]
    found = recorded(tau, rate=rate)
    assert found.torque[:, 1].sum() == samples * frozen
    assert not found.torque[:, 0].any() and not found.posture.any()
    words = f"torque of b is frozen for {samples / 1000:.0%}"
    assert found.notes == ((words,) if frozen else ())


@pytest.mark.parametrize(("samples", "frozen"), [(98, False), (102, True)])
def test_coarse_torque_is_frozen_after_five_times_as_long(samples, frozen):
    """And after three times its third longest run."""
    tau = torque()
    coarse = 0.1 * np.round(np.tile([-1, 0, 1, 0], 250) + 0.0)
    coarse[400 : 400 + samples] = 0.1
    coarse[400 + samples] = -0.1
    tau[:, 1] = coarse
    found = recorded(tau)
    assert found.torque[:, 1].any() == frozen
    slow = 0.1 * np.repeat(np.arange(25.0) % 2, 40)
    slow[200:318] = 0.05  # long, but not three times as long as forty
    tau[:, 1] = slow
    assert recorded(tau).notes == ()


def test_notes_name_the_log_and_every_joint_that_jumps():
    tau = torque()
    tau[330:] += [8.0, 0.0]
    tau[500:] += [0.0, 8.0]
    found = recorded(tau, source="run 3")
    (note,) = found.notes
    assert note.startswith("run 3: torque of a, b jumps while the joint moves")
    assert "first at 3.29 s" in note
    assert np.flatnonzero(found.posture).tolist() == [329, 330, 499, 500]
