"""Where the gap lies, and what the recordings do not visit."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated import arm

from hybrid.diagnosis.answer.regions import locate, time_since_reversal
from hybrid.diagnosis.gap.coverage import not_excited, reversals
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.spring import Spring
from hybrid.plant import random_fourier
from hybrid.recording import Recording
from hybrid.signals import motion_from_recording

STD = 0.2  # of the torque noise, N·m


@cache
def still_gap():
    """What an arm leaves whose simulator is right: rounding errors."""
    robot, rng = arm("planar"), np.random.default_rng(3)
    logs = []
    for _ in range(4):
        r = random_fourier(robot, duration=8.0, rate=200.0, seed=rng)
        log = Recording(t=r.t, q=r.q, tau=0 * r.q, joints=robot.joints)
        logs.append(motion_from_recording(log, cutoff=15.0))
    return measure_gap(robot, logs, cutoff=15.0)


def gap_with(torque=None, seed=0):
    """A gap of white noise that passed the filter, and a torque of the motion."""
    gap, rng = still_gap(), np.random.default_rng(seed)
    parts = []
    for motion, _, sampler in gap:
        extra = rng.normal(scale=STD, size=motion.q.shape)
        if torque is not None:
            extra = extra + torque(motion)
        parts.append(sampler(extra))
    return replace(gap, left=np.concatenate(parts))


def floor():
    """RMS of the noise after the filter, N·m."""
    gap = gap_with()
    return np.array([gap.left[gap.moving[:, i], i].std() for i in range(2)])


def located(torque=None, seed=0):
    gap = gap_with(torque, seed)
    return locate(gap, floor(), np.random.default_rng(seed))


def on_first(x):
    """A torque on the first joint only."""
    return np.stack([x, 0 * x], axis=1)


@pytest.mark.parametrize("seed", range(10))
def test_noise_alone_lies_nowhere(seed):
    assert located(seed=seed) == ()


def test_the_gap_is_at_the_joint_that_has_it():
    regions = located(lambda m: on_first(0.5 * np.sign(m.v[:, 0])))
    whole = {r.joint: r for r in regions if r.variable == "link"}
    joints = arm("planar").joints
    assert list(whole) == [joints[0]]
    assert whole[joints[0]].share == pytest.approx(1.0, abs=0.05)
    low, high = whole[joints[0]].interval
    assert low <= whole[joints[0]].share <= high


def test_a_torque_below_some_speed_is_found_there():
    def slow(m):
        return on_first(
            np.where(np.abs(m.v[:, 0]) < 0.5, 0.6, 0.0) * np.sign(m.v[:, 0])
        )

    (found,) = [r for r in located(slow) if r.variable == "speed"]
    assert (found.low, found.high) == (0.0, 0.5)
    assert found.share > 0.9


def test_a_torque_of_one_direction_is_found_there():
    found = located(lambda m: on_first(0.4 * (m.v[:, 0] < 0)))
    (direction,) = [r for r in found if r.variable == "direction"]
    assert (direction.low, direction.high) == (-1.0, 0.0)


def test_a_stop_at_one_end_is_found_in_position():
    def stop(m):
        return on_first(5.0 * np.maximum(m.q[:, 0] - 0.8, 0.0))

    (found,) = [r for r in located(stop) if r.variable == "position"]
    assert found.low == pytest.approx(0.8, abs=0.25)
    top = max(m.q[:, 0].max() for m in still_gap().motions)
    assert found.high >= top - 0.05


def test_a_tone_is_found_in_its_band():
    tone = located(lambda m: on_first(0.5 * np.sin(2 * np.pi * 7.0 * m.t)))
    (found,) = [r for r in tone if r.variable == "frequency"]
    assert found.low == 5.0
    assert found.high == 10.0


def test_a_drift_is_found_in_time():
    found = located(lambda m: on_first(np.where(m.t > 5.0, 0.5, 0.0)))
    (time,) = [r for r in found if r.variable == "time"]
    assert time.low == pytest.approx(5.0, abs=0.5)


def test_regions_come_by_excess_over_their_share_of_samples():
    found = located(lambda m: on_first(0.5 * np.sign(m.v[:, 0])))
    assert found[0].joint == arm("planar").joints[0]
    assert len(found) <= 40
    assert all(0.0 < r.share < 1.1 for r in found)


def test_intervals_widen_with_what_happens_in_few_blocks():
    steady = located(lambda m: np.full_like(m.q, 0.3))

    def rare(m):
        burst = (m.t > 2.0) & (m.t < 3.0)
        return on_first(np.where(burst, 1.0, 0.0)) + np.full_like(m.q, 0.3)

    def width(regions):
        first = arm("planar").joints[0]
        (r,) = [r for r in regions if r.variable == "link" and r.joint == first]
        return r.interval[1] - r.interval[0]

    assert width(located(rare)) > 1.5 * width(steady)


def test_a_gap_in_a_single_block_has_an_interval():
    gap = gap_with(lambda m: on_first(0.5 * np.sign(m.v[:, 0])))
    moving = gap.moving.copy()
    moving[200:] = False
    found = locate(replace(gap, moving=moving), floor(), np.random.default_rng(0))
    assert found and np.isfinite([r.interval for r in found]).all()


def test_time_since_a_reversal_starts_anew_when_speed_changes_sign():
    gap = still_gap()
    since, v = time_since_reversal(gap, 0), gap.sampled.v[:, 0]
    same = gap.trajectory[1:] == gap.trajectory[:-1]
    turned = v[1:] * v[:-1] <= 0
    assert np.all(since[1:][turned | ~same] == 0.0)
    on = ~turned & same
    np.testing.assert_allclose(np.diff(since)[on], 1 / gap.rate, rtol=1e-9)


def one_log(q):
    """A gap of a single log of the planar arm's two joints."""
    robot = arm("planar")
    t = np.arange(len(q)) / 200.0
    log = Recording(t=t, q=q, tau=0 * q, joints=robot.joints)
    return measure_gap(robot, [motion_from_recording(log, cutoff=15.0)], cutoff=15.0)


def test_what_is_not_visited_is_said_in_words():
    t = np.arange(2000) / 200.0
    first, second = arm("planar").joints
    words = not_excited(one_log(np.stack([0.1 * t, 0.0 * t], axis=1)))
    assert words[0] == f"{second} does not move"
    assert f"{first} moving down" in words
    assert f"{first} below 0.05 rad/s" in words
    assert f"reversals of {first}" in words
    assert not any(w.startswith(f"{second} below") for w in words)


def test_encoder_noise_is_no_motion():
    t, rng = np.arange(2000) / 200.0, np.random.default_rng(0)
    q = np.stack([np.sin(t), rng.normal(scale=2e-4, size=len(t))], axis=1)
    assert f"{arm('planar').joints[1]} does not move" in not_excited(one_log(q))


def test_rich_motion_leaves_little_out():
    said = not_excited(still_gap())
    assert not any("moving" in x or "not move" in x or "reversals" in x for x in said)


def test_reversals_within_the_threshold_do_not_count():
    assert reversals(np.array([1.0, -0.01, 0.01, -0.01, 1.0, -1.0]), 0.1) == 1


def test_effects_of_the_library_are_found_where_they_act():
    gap = still_gap()
    for effect in (Coulomb((1,), {"level": 0.5}), Spring((1,), {"stiffness": 0.6})):
        left = gap_with().left.copy()
        for j, column in gap.columns(effect).items():
            left[:, j] += column @ effect.gain_values
        regions = locate(replace(gap, left=left), floor(), np.random.default_rng(0))
        assert regions[0].joint == gap.robot.joints[1]
