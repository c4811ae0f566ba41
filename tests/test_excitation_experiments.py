"""Ready-made experiments: each shows what it is for, within the limits."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import MODELS, public_arm
from pendulum import pendulum

from hybrid.errors import ExcitationError
from hybrid.excitation import (
    Limits,
    at_speeds,
    micro_reversals,
    multisine,
    speed_ladder,
    static_poses,
)
from hybrid.excitation.experiments import checked
from hybrid.robot import Robot

COMAN = Robot.load(MODELS / "coman_like.xml")


@cache
def experiments(arm):
    robot = COMAN if arm == "coman" else public_arm(arm)
    rng = np.random.default_rng(0)
    limits = Limits.of(robot)
    middle = (limits.low + limits.high) / 2
    poses = middle + rng.uniform(-0.4, 0.4, (4, robot.size))
    return robot, {
        "ladder": speed_ladder(robot, 1, longest=1.0),
        "reversals": micro_reversals(robot, 2),
        "poses": static_poses(robot, poses),
        "multisine": multisine(robot, duration=8.0, seed=rng),
    }


@cache
def ladder():
    return speed_ladder(COMAN, "elbow")


@pytest.mark.parametrize("name", ["ladder", "reversals", "poses", "multisine"])
@pytest.mark.parametrize("arm", ["coman", "ur10"])
def test_experiments_are_smooth_at_rest_at_the_ends_and_within_limits(arm, name):
    robot, motions = experiments(arm)
    reference = motions[name]
    step = reference.t[1]
    for x, dx in ((reference.q, reference.v), (reference.v, reference.a)):
        middle = (x[2:] - x[:-2]) / (2 * step)
        jerk = np.abs(np.diff(dx, axis=0)).max()
        assert np.abs(middle - dx[1:-1]).max() <= jerk + 1e-9
    for x in (reference.v, reference.a):
        assert np.abs(x[[0, -1]]).max() < 1e-9
    checked(robot, reference, Limits.of(robot))


def test_a_ladder_moves_one_joint_at_each_speed_both_ways():
    reference = ladder()
    j = COMAN.joint_index("elbow")
    speeds = np.geomspace(0.01, 0.9, 8) * Limits.of(COMAN).speed[j]
    others = np.delete(reference.v, j, axis=1)
    assert np.abs(others).max() == 0
    steady = np.abs(reference.a[:, j]) < 1e-9
    for speed in speeds:
        for sign in (1, -1):
            at = steady & np.isclose(reference.v[:, j], sign * speed, rtol=1e-6)
            assert at.sum() > 100


def test_poses_are_held_still():
    poses = np.array([[0.1, 0.5, 0.2, 0, 0, 0], [0.4, 0.8, -0.2, 0.3, 0, 0]])
    reference = static_poses(COMAN, poses, hold=1.0, rate=200.0)
    for pose in poses:
        at = np.isclose(reference.q, pose, atol=1e-9).all(axis=1)
        assert (at & (np.abs(reference.v).max(axis=1) < 1e-9)).sum() >= 199


def test_a_multisine_has_power_in_its_band_only_and_no_common_tones():
    reference = multisine(COMAN, duration=20.0, seed=np.random.default_rng(0))
    lines = np.abs(np.fft.rfft(reference.a[:-1], axis=0))
    own = lines[4:101:6]  # of the first joint, in twentieths of a hertz
    assert own[:, 0].mean() > 5 * own[:, 1:].mean(axis=0).max() * (
        lines[:, 0].max() / lines.max()
    )
    a = reference.a - reference.a.mean(axis=0)
    power = np.abs(
        np.fft.rfft(a[1000:-1000] * np.hanning(len(a) - 2000)[:, None], axis=0)
    )
    frequency = np.fft.rfftfreq(len(a) - 2000, reference.t[1])
    band = frequency < 5.2
    share = (power[band] ** 2).sum(axis=0) / (power**2).sum(axis=0)
    assert (share > 0.99).all()


def test_the_same_path_at_other_speeds():
    path = multisine(COMAN, duration=6.0, fill=0.3, seed=np.random.default_rng(1))
    slow, same, fast = at_speeds(COMAN, path, (0.5, 1.0, 1.5))
    assert [x.t[-1] for x in (slow, same, fast)] == pytest.approx([12.0, 6.0, 4.0])
    np.testing.assert_allclose(same.q, path.q, atol=1e-12)
    np.testing.assert_allclose(slow.q[::2], path.q, atol=1e-9)
    np.testing.assert_allclose(slow.v[::2], path.v / 2, atol=1e-9)
    np.testing.assert_allclose(slow.a[::2], path.a / 4, atol=1e-9)


def test_too_fast_a_path_names_the_limit():
    path = multisine(COMAN, duration=6.0, fill=0.8, seed=np.random.default_rng(1))
    with pytest.raises(
        ExcitationError, match="(speed|acceleration|torque) of .* exceed"
    ):
        at_speeds(COMAN, path, (4.0,))


@pytest.mark.parametrize(
    "make, says",
    [
        (lambda: static_poses(COMAN, np.zeros((2, 3))), "poses of 6 joints"),
        (lambda: static_poses(COMAN, np.full((2, 6), 9.0)), "position of"),
        (
            lambda: multisine(COMAN, duration=1.0, seed=np.random.default_rng(0)),
            "one tone or more",
        ),
        (lambda: speed_ladder(COMAN, 1, posture=np.full(6, 50.0)), "outside"),
    ],
)
def test_bad_requests_say_what_is_valid(make, says):
    with pytest.raises(ExcitationError, match=says):
        make()


def test_weak_drives_are_refused_before_anything_moves():
    weak = replace(COMAN, tau_max=np.full(6, 0.5))
    with pytest.raises(ExcitationError, match="torque"):
        multisine(weak, seed=np.random.default_rng(0))


def test_a_ladder_reaches_each_speed_where_a_fifth_of_a_ramp_is_left():
    """A ramp up and one down take the way of one at full speed; one lasts 0.35 s."""
    short = speed_ladder(COMAN, "elbow", longest=0.1)
    j = COMAN.joint_index("elbow")
    fastest = 0.9 * Limits.of(COMAN).speed[j]
    assert np.abs(short.v[:, j]).max() == pytest.approx(fastest)
    with pytest.raises(ExcitationError, match="are needed to reach"):
        speed_ladder(COMAN, "elbow", longest=0.05)


def test_reversals_turn_each_second_three_times_at_each_size_and_then_pause():
    reference = micro_reversals(COMAN, 1)
    away = reference.q[:, 0] - reference.q[0, 0]
    assert reference.t[1] == pytest.approx(1 / 500.0)
    expected = []
    for size in (0.001, 0.002, 0.005, 0.01, 0.02):
        expected += [size, -size] * 3 + [0.0]
    ends = [1.0 + k + 0.5 * (k // 7) for k in range(len(expected))]
    np.testing.assert_allclose(np.interp(ends, reference.t, away), expected, atol=1e-9)
    np.testing.assert_allclose(reference.t[-1], 5 * (7 * 1.0 + 0.5))
    still = np.abs(reference.v).max(axis=1) < 1e-12
    pauses = [np.interp(7.5 * (k + 1) - 0.25, reference.t, still) for k in range(5)]
    assert pauses == [1.0] * 5


def test_a_ladder_keeps_slow_speeds_for_four_seconds_and_pauses_beside_them():
    reference = ladder()
    j, step = COMAN.joint_index("elbow"), 1 / 500.0
    assert reference.t[1] == pytest.approx(step, rel=1e-3)
    limits = Limits.of(COMAN)
    slow = 0.01 * limits.speed[j]
    steady = np.abs(reference.v[:, j] - slow) < 1e-9
    assert steady.sum() * step == pytest.approx(4.0, abs=3 * step)
    first, last = np.flatnonzero(steady)[[0, -1]]
    # A ramp of a tenth of a second on either side, and half a second of rest.
    moving = np.abs(reference.v[:, j]) > 1e-9
    before = reference.t[first] - reference.t[:first][~moving[:first]].max()
    after = reference.t[last:][~moving[last:]].min() - reference.t[last]
    assert before == pytest.approx(0.1, abs=3 * step)
    assert after == pytest.approx(0.1, abs=3 * step)
    rest = np.diff(np.flatnonzero(moving))
    assert rest[rest > 1].min() * step == pytest.approx(0.5, abs=6 * step)
    away = reference.q[[first, last], j] - limits.middle[j]
    assert away.sum() == pytest.approx(0.0, abs=2 * slow * step)


def test_a_fast_ramp_takes_all_of_the_acceleration_and_the_room():
    reference = ladder()
    j, limits = COMAN.joint_index("elbow"), Limits.of(COMAN)
    fast = 0.9 * limits.speed[j]
    ramp = 1.5 * fast / limits.usable_acceleration[j]
    assert ramp > 0.1
    at = np.flatnonzero(np.abs(reference.v[:, j] - fast) < 1e-9)
    own = slice(at[0] - round(ramp * 500), at[-1] + round(ramp * 500))
    most = np.abs(reference.a[own, j]).max()
    assert most == pytest.approx(limits.usable_acceleration[j], rel=1e-3)
    stroke = np.ptp(reference.q[own, j])
    room = limits.high[j] - limits.low[j]
    assert stroke == pytest.approx(min(0.98 * room, fast * (ramp + 4.0)), rel=1e-3)


def test_poses_are_held_for_a_second():
    poses = np.tile(Limits.of(COMAN).middle, (3, 1))
    reference = static_poses(COMAN, poses)
    assert reference.t[-1] == pytest.approx(3.0)
    assert reference.t[1] == pytest.approx(1 / 500.0)


def test_a_multisine_takes_half_of_a_limit_of_each_joint():
    reference = multisine(COMAN, seed=3)
    assert reference.t[-1] == pytest.approx(20.0)
    assert reference.t[1] == pytest.approx(1 / 500.0)
    limits = Limits.of(COMAN)
    away = reference.q - limits.middle
    room = limits.high - limits.middle
    rates = room, limits.speed, limits.usable_acceleration
    share = [
        np.abs(x).max(axis=0) / most
        for x, most in zip((away, reference.v, reference.a), rates, strict=True)
    ]
    np.testing.assert_allclose(np.max(share, axis=0), 0.5)


@pytest.mark.parametrize(("duration", "fade"), [(20.0, 1.0), (2.0, 0.5)])
def test_tones_of_a_multisine_have_equal_accelerations(duration, fade):
    reference = multisine(COMAN, duration=duration, rate=100.0, seed=3)
    t, lines = reference.t, np.arange(np.ceil(duration / 5), 5 * duration + 1)
    inside = (t > fade) & (t < duration - fade)  # it rises and falls in between
    for j in (0, 5):
        angle = np.outer(t[inside], 2 * np.pi * lines[j::6] / duration)
        waves, a = np.hstack([np.sin(angle), np.cos(angle)]), reference.a[inside, j]
        gains = np.linalg.lstsq(waves, a, rcond=None)[0]
        np.testing.assert_allclose(waves @ gains, a, atol=1e-6 * np.abs(a).max())
        size = np.hypot(*np.split(gains, 2))
        np.testing.assert_allclose(size, size[0], rtol=1e-4)


def test_a_multisine_has_a_tone_for_each_joint_below_half_the_rate():
    assert len(multisine(COMAN, duration=1.2).t) == 601
    with pytest.raises(ExcitationError, match="5 tones in 1.19 s"):
        multisine(COMAN, duration=1.19)
    with pytest.raises(ExcitationError, match="0 tones in 0 s"):
        multisine(pendulum(1), duration=0.0)
    assert len(multisine(COMAN, rate=10.5).t) == 211
    with pytest.raises(ExcitationError, match="at 10 Hz"):
        multisine(COMAN, rate=10.0)


def test_paths_run_at_half_their_speed_as_it_is_and_at_twice():
    path = multisine(COMAN, duration=6.0, fill=0.1, seed=1)
    assert [x.t[-1] for x in at_speeds(COMAN, path)] == [12.0, 6.0, 3.0]
    assert [len(x.t) for x in at_speeds(COMAN, path)] == [6001, 3001, 1501]


def test_a_multisine_away_from_the_middle_has_room_to_the_nearer_limit():
    limits = Limits.of(COMAN)
    for near, sign in ((limits.low, 1.0), (limits.high, -1.0)):
        posture = limits.middle.copy()
        posture[2] = near[2] + sign * 0.02
        away = multisine(COMAN, posture=posture, rate=100.0).q - posture
        assert np.abs(away[:, 2]).max() == pytest.approx(0.5 * 0.02)
