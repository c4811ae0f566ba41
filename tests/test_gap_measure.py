"""Which samples of a gap count, in which units it is, and whether they suffice."""

import gc
import weakref
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arms import LIFT
from pendulum import RATE, gap_of, pendulum, swings, with_torque

from hybrid.diagnosis.gap.background import (
    background,
    dry_friction,
    friction_near_rest,
    sampling_delays,
    soft_friction,
)
from hybrid.diagnosis.gap.coverage import not_excited, too_little_motion
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import (
    _asked,
    _folds,
    _standing,
    block_seconds,
    measure_gap,
    split,
    unseen_samples,
)
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning, RecordingError
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals.filters import butterworth

CUTOFF = 10.0
LIFTED = Robot.load(mujoco.MjModel.from_xml_string(LIFT))


# --- units ----------------------------------------------------------------------------


def test_units_are_those_of_a_slide_where_all_joints_are_slides():
    chain = LIFTED.chain
    assert (chain.unit_at([0], "rad"), chain.unit_at([1], "rad")) == ("rad", "m")
    assert chain.unit_at([0, 1], "N·m") == chain.unit_at([], "N·m") == "N·m"


@pytest.mark.parametrize(
    ("unit", "there"),
    [
        ("kg·m²", "kg"), ("N·m", "N"), ("N·m·s/rad", "N·s/m"), ("rad/s", "m/s"),
        ("N·m/(N·m)", "N/N"), ("1/turn", "1/turn"), ("s", "s"),
    ],
)  # fmt: skip
def test_a_unit_at_a_slide_has_metres_for_radians(unit, there):
    assert LIFTED.chain.unit_at([1], unit) == there
    assert LIFTED.chain.unit_at([0], unit) == unit


# --- whether recordings suffice -------------------------------------------------------


def motion(seconds, rate=100.0):
    return SimpleNamespace(t=np.arange(round(seconds * rate) + 1) / rate, rate=rate)


def usable(*, seconds=(4.0,), masked=0.0, moving=(2.0, 2.0)):
    """A gap of so many seconds, and seconds for which each joint moves, at 100 Hz."""
    motions = [motion(x) for x in seconds]
    count = sum(len(m.t) for m in motions)
    mask = np.arange(count) >= masked * count
    moves = np.arange(count)[:, None] < np.array(moving) * 100.0
    return SimpleNamespace(
        motions=motions, rate=100.0, sampled=SimpleNamespace(mask=mask), moving=moves,
        robot=SimpleNamespace(size=len(moving), joints=("a", "b", "c")[: len(moving)]),
    )  # fmt: skip


def test_three_seconds_of_two_joints_suffice():
    assert too_little_motion(usable(seconds=(3.0,))) is None
    assert too_little_motion(usable(seconds=(1.5, 1.5))) is None
    assert too_little_motion(usable(seconds=(2.999,))) is None  # by its last sample
    text = too_little_motion(usable(seconds=(2.98,)))
    assert text == (
        "2.98 s of recording are too few to name a cause; valid are 3 s or more"
    )


def test_half_of_three_seconds_has_to_be_usable():
    assert too_little_motion(usable(masked=0.6)) is None
    said = "less than half of the recordings can be used"
    assert too_little_motion(usable(masked=0.64)) == said


def test_two_joints_move_for_a_second_each():
    assert too_little_motion(usable(moving=(1.0, 1.0, 0.0))) is None
    assert too_little_motion(usable(moving=(1.0,))) is None  # it has no other
    said = too_little_motion(usable(moving=(1.0, 0.98, 0.0)))
    assert said.startswith("a alone moves: what acts on the others")
    assert said.endswith("valid are motions of 2 joints or more")
    none = too_little_motion(usable(moving=(0.5,)))
    assert none.startswith("no joint alone moves") and "of 1 joints or more" in none


# --- samples that count ---------------------------------------------------------------


def test_recordings_without_torque_and_motions_without_a_cut_off_are_refused():
    (m, *_) = swings(count=1)
    with pytest.raises(RecordingError, match="valid is a cut-off besides, in Hz"):
        measure_gap(pendulum(), [m])
    silent = replace(m, tau=np.full_like(m.tau, np.nan))
    with pytest.raises(RecordingError, match="swing 0: no torque"):
        measure_gap(pendulum(), [silent], cutoff=CUTOFF)
    with pytest.raises(RecordingError, match="^recording: no torque"):
        measure_gap(pendulum(), [replace(silent, source="")], cutoff=CUTOFF)


def test_no_filter_lets_through_more_than_half_the_rate():
    for cutoff in (10.0, 50.0, np.inf):
        gap = measure_gap(pendulum(), swings(count=1), cutoff=cutoff)
        assert gap.cutoff == min(cutoff, 50.0)
    with pytest.warns(HybridWarning, match="80 Hz filters nothing.* 50 Hz"):
        assert measure_gap(pendulum(), swings(count=1), cutoff=80.0).cutoff == 50.0


def test_a_correction_is_made_before_the_gap_is_measured():
    """Torque of twice the size leaves the file's own torque as the gap."""
    logs = swings(count=1)
    twice = measure_gap(
        pendulum(), logs, cutoff=CUTOFF, correct=lambda m: replace(m, tau=2 * m.tau)
    )
    np.testing.assert_allclose(twice.left, twice.samplers[0](logs[0].tau), atol=1e-9)
    assert [m.number for m in gap_of(count=3).motions] == [0, 1, 2]


def turning(v, friction=0.0, cutoff=20.0):
    """Samples of a joint that count as standing, 100 Hz."""
    robot = replace(pendulum(), frictionloss=np.array([friction]))
    (m, *_) = swings(count=1)
    v = np.asarray(v, dtype=float)[:, None]
    m = replace(m, t=np.arange(len(v)) / RATE, q=0 * v, v=v, a=0 * v, tau=0 * v)
    return np.flatnonzero(_standing(robot, m, np.array([0.1]), cutoff)[:, 0]).tolist()


def test_a_joint_stands_below_its_slowest_speed_and_where_it_turns():
    assert turning([1, 0.1, 1, 0.11, -0.1, -1]) == [1, 4]
    assert turning([1.0, 1.0, -1.0, -1.0, 1.0]) == [2, 4]


@pytest.mark.parametrize(("cutoff", "reach"), [(30.0, 2), (19.0, 4), (15.0, 5)])
def test_declared_friction_reaches_seven_tenths_of_a_period(cutoff, reach):
    """Beside the sample at which a joint turns; the rate here is kept."""
    v = np.where(np.arange(40) < 20, 1.0, -1.0)
    assert turning(v, 0.0, cutoff) == [20]
    near = list(range(20 - reach, 20 + reach + 1))
    assert turning(v, 0.5, cutoff) == near


def test_the_slowest_speed_is_a_hundredth_of_the_highest_or_what_noise_shows():
    """Two thousandths of a radian per second are noise of an encoder."""
    for widest, least in ((0.5, None), (5e-4, 0.002)):
        gap = gap_of(noise=0.0, widest=widest)
        if least is None:
            fastest = max(np.abs(m.v).max() for m in gap.motions)
            least = 0.01 * fastest
        v = gap.sampled.v[:, 0]
        same = np.diff(gap.trajectory) == 0
        turns = np.append(False, (v[1:] * v[:-1] < 0) & same)
        expected = (np.abs(v) > least) & ~turns
        np.testing.assert_array_equal(gap.moving[:, 0], expected)


@pytest.mark.parametrize(("share", "used"), [(0.045, False), (0.055, True)])
def test_a_joint_that_moves_for_less_than_a_twentieth_is_left_out(share, used):
    (m, *_) = swings(2, count=1, seconds=10.0)
    stands = np.ones((len(m.t), 2))
    stands[round(share * len(m.t)) :, 1] = 0.0
    v = 1.0 + 0 * m.v
    gap = measure_gap(pendulum(2), [replace(m, v=v * stands)], cutoff=50.0)
    assert gap.moving[:, 0].all() and gap.moving[:, 1].any() == used
    assert gap.moving[:, 1].mean() == pytest.approx(share * used, abs=2e-3)


def test_folds_are_blocks_of_each_recording_by_eight():
    """What acts in one recording alone is in several folds."""
    logs = [replace(m, t=m.t + 100.0 * k) for k, m in enumerate(swings(count=9))]
    fold, of = _folds(logs, CUTOFF)
    assert sorted(set(of)) == list(range(9))
    for k in range(9):  # of four seconds: blocks of three, and of the rest
        own = fold[of == k]
        assert list(dict.fromkeys(own)) == [2 * k % 8, (2 * k + 1) % 8]
        assert (own == own[0]).mean() == pytest.approx(0.75, abs=0.02)
    # Three of four seconds: blocks of an eighth of twelve, three in each.
    fold, of = _folds(logs[:3], CUTOFF)
    size = len(fold) // 3
    block = np.minimum(np.arange(size) / size * 4.0 // 1.496, 2).astype(int)
    for k in range(3):
        own = fold[of == k]
        assert len(set(own)) == 3
        changes = np.flatnonzero(np.diff(own))
        np.testing.assert_allclose(changes, np.flatnonzero(np.diff(block)), atol=1)
    assert (np.unique(fold) == np.arange(8)).all()  # the ninth is the first again


def test_torque_is_the_measured_one_where_both_differ_by_far():
    """More than ten deviations of the noise, below half of the band."""
    rng = np.random.default_rng(0)
    (m, *_) = swings(count=1, seconds=20.0)
    simulated = np.sin(m.t)[:, None]
    noise = 0.01 * rng.standard_normal(simulated.shape)
    assert np.array_equal(
        _asked(replace(m, tau=simulated + noise), simulated, CUTOFF), simulated
    )
    late = (m.t > 10.0)[:, None]
    # Of noise of 0.01 are 0.0025 in the upper half of the band.
    for step, far in ((0.018, False), (0.033, True)):
        tau = simulated + noise + step * late
        asked = _asked(replace(m, tau=tau), simulated, CUTOFF)
        assert (asked[:900] == simulated[:900]).all()
        assert (asked[1100:] == (tau if far else simulated)[1100:]).mean() > 0.9


def test_torque_is_far_from_ten_deviations_of_the_noise_on():
    """Sample by sample, by the median of its upper half band."""
    (m, *_) = swings(count=1, seconds=20.0)
    rough = 0.01 * np.random.default_rng(3).standard_normal(m.tau.shape)
    low = butterworth(rough, rate=RATE, cutoff=CUTOFF / 2)
    band = butterworth(rough, rate=RATE, cutoff=CUTOFF) - low
    far = 10.0 * 1.4826 * np.median(np.abs(band))
    zero = np.zeros_like(rough)
    asked = _asked(replace(m, tau=far + rough), zero, CUTOFF)
    expected = np.abs(far + low) > far
    np.testing.assert_array_equal(asked, np.where(expected, far + rough, zero))
    assert 0.3 < expected.mean() < 0.7
    # Where the mask is, noise is estimated.
    mask = np.arange(len(m.t)) < 500
    some = 10.0 * 1.4826 * np.median(np.abs(band[mask]))
    asked = _asked(replace(m, tau=far + rough, mask=mask), zero, CUTOFF)
    np.testing.assert_array_equal(asked != 0, np.abs(far + low) > some)


def test_faults_spoil_what_the_filter_reaches():
    """Half a second at 10 Hz, and nothing where no filter is."""
    (m, *_) = swings(count=1, seconds=10.0)
    tau = m.tau.copy()
    tau[400:440] = tau[400]  # and jumps then
    sound, faulty = (Recording(m.t, m.q, tau=x, joints=m.joints) for x in (m.tau, tau))
    for cutoff, first, last in ((CUTOFF, 3.55, 4.85), (50.0, 4.0, 4.4)):
        before, after = (
            measure_gap(pendulum(), [x], cutoff=cutoff) for x in (sound, faulty)
        )
        t = after.sampled.t[before.moving[:, 0]]
        lost = ~after.moving[before.moving[:, 0], 0]
        spoilt = (t > first - 1e-9) & (t < last + 1e-9)
        assert lost[spoilt].all() and not lost[np.abs(t - 4.2) > 0.68].any()
        if cutoff == 50.0:
            np.testing.assert_array_equal(lost, spoilt)
        assert after.notes[0] == "torque of hinge_0 is frozen for 4%"


# --- split ----------------------------------------------------------------------------


def parted(count, folds, *, far=None, samples=10, joints=1):
    """A gap of some trajectories, each cut into folds, with squares of one."""
    rows = count * folds * samples
    trajectory = np.repeat(np.arange(count), folds * samples)
    fold = np.tile(np.repeat(np.arange(folds), samples), count)
    fold = trajectory if count >= 4 else fold
    left = np.ones((rows, joints))
    for k, f, size in far or ():
        left[(trajectory == k) & (fold == (k if count >= 4 else f))] = size
    return SimpleNamespace(
        trajectory=trajectory, fold=fold, left=left, moving=np.ones_like(left) > 0,
        motions=[motion(folds * 3.0)], rate=2.0 * samples / 6.0,
    )  # fmt: skip


def held_out(gap):
    """Pairs of trajectory and fold that are for testing."""
    test = ~split(gap)
    pairs = zip(gap.trajectory[test].tolist(), gap.fold[test].tolist(), strict=True)
    return sorted((k, 0 if gap.trajectory.max() >= 3 else f) for k, f in set(pairs))


def test_every_fourth_recording_or_every_fourth_block_is_for_testing():
    assert held_out(parted(5, 1)) == [(3, 0)]
    assert held_out(parted(8, 1)) == [(3, 0), (7, 0)]
    assert held_out(parted(1, 8)) == [(0, 3), (0, 7)]
    # Of several recordings other blocks each, as they often end alike.
    assert held_out(parted(2, 4)) == [(0, 3), (1, 2)]
    assert held_out(parted(3, 4)) == [(0, 3), (1, 2), (2, 1)]


@pytest.mark.parametrize(("size", "moves"), [(3.1, False), (3.2, True)])
def test_another_split_is_taken_where_the_test_alone_is_ten_times_as_large(size, moves):
    """Of squares: three times as large is nine times."""
    assert (held_out(parted(5, 1, far=[(3, 0, size)])) == [(3, 0)]) != moves
    assert held_out(parted(4, 1, far=[(3, 0, 9.0)])) == [(2, 0)]
    assert held_out(parted(4, 1, far=[(3, 0, 30.0), (2, 0, 9.0)])) == [(1, 0)]
    far = [(k, 0, x) for k, x in ((3, 200.0), (2, 30.0), (1, 9.0))]
    assert held_out(parted(4, 1, far=far)) == [(0, 0)]
    # Of blocks the ones before, then those two before.
    assert held_out(parted(1, 4, far=[(0, 3, 9.0)])) == [(0, 2)]
    far = [(0, f, x) for f, x in ((3, 400.0), (2, 90.0), (1, 20.0))]
    assert held_out(parted(1, 4, far=far)) == [(0, 0)]
    assert held_out(parted(1, 4, far=[(0, 3, 400.0), (0, 2, 90.0)])) == [(0, 1)]
    assert held_out(parted(2, 4, far=[(0, 3, 9.0)])) == [(0, 3 - 1), (1, 1)]
    # Where one recording has to be split in other ways than the others.
    far = [(k, f, 9.0) for k, f in ((0, 3), (0, 2), (0, 1), (0, 0))]
    assert held_out(parted(2, 4, far=far)) == [(0, 3), (1, 2)]
    # Where training samples are as unusual, the first one stays.
    assert held_out(parted(5, 1, far=[(3, 0, 9.0), (0, 0, 9.0)])) == [(3, 0)]


def test_one_unusual_joint_decides_and_what_stands_does_not():
    gap = parted(5, 1, joints=2)
    gap.left[gap.trajectory == 3, 1] = 50.0
    assert held_out(gap) == [(2, 0)]
    gap.moving[gap.trajectory == 3, 1] = False
    assert held_out(gap) == [(3, 0)]
    gap.left[:] = 0.0
    assert held_out(gap) == [(3, 0)]


def test_what_is_unusual_is_by_sample_that_moves():
    """A part in which a joint moves for a tenth of the time has a tenth of squares."""
    gap = parted(5, 1, samples=100)
    at = np.flatnonzero(gap.trajectory == 3)
    gap.moving[at[10:]] = False
    gap.left[at[:10]] = 3.1
    assert held_out(gap) == [(3, 0)]
    gap.left[at[:10]] = 3.2
    assert held_out(gap) == [(2, 0)]


def test_blocks_of_three_recordings_lose_their_ends_and_four_are_whole():
    for count, whole in ((3, False), (4, True)):
        gap = parted(count, 4, samples=60)
        gap.rate = 20.0
        learn = split(gap)
        assert np.array_equal(unseen_samples(gap, learn), ~learn) == whole


def test_a_block_is_no_shorter_than_half_a_second_and_no_longer_than_three():
    for seconds, block in ((2.0, 0.5), (4.0, 0.5), (8.0, 1.0), (24.0, 3.0), (80, 3.0)):
        assert block_seconds([motion(seconds)]) == pytest.approx(block)
        assert block_seconds([motion(seconds / 2)] * 2) == pytest.approx(block)


def test_test_blocks_lose_a_sixth_at_both_ends():
    """Of three seconds half a second, and of whole recordings nothing."""
    gap = parted(1, 8, samples=60)
    gap.rate = 20.0
    learn = split(gap)
    unseen = unseen_samples(gap, learn)
    assert np.flatnonzero(~learn).tolist() == [*range(180, 240), *range(420, 480)]
    assert np.flatnonzero(unseen).tolist() == [*range(190, 230), *range(430, 480)]
    whole = parted(4, 1)
    np.testing.assert_array_equal(unseen_samples(whole, split(whole)), ~split(whole))


# --- what is not covered --------------------------------------------------------------


def said(q=None, v=None, *, count=2000, mask=None, **limits):
    """What a motion does not show, at 100 Hz; without limits by default."""
    v = np.ones(count) if v is None else np.asarray(v, dtype=float)
    q = np.cumsum(v) / 100.0 if q is None else q
    free = {"v_max": np.inf, "q_max": np.inf, "q_min": -np.inf} | limits
    robot = replace(pendulum(), **{k: np.array([x]) for k, x in free.items()})
    mask = np.ones(len(v), dtype=bool) if mask is None else mask
    sampled = SimpleNamespace(q=q[:, None], v=v[:, None], mask=mask)
    return not_excited(SimpleNamespace(robot=robot, sampled=sampled, rate=100.0))


def both_ways(*parts):
    """Speeds that are held for some samples each, and then the other way."""
    once = np.concatenate([np.full(k, x) for k, x in parts])
    return np.concatenate([once, -once, once, -once])


SLOW = (20, 0.005)


@pytest.mark.parametrize(("samples", "shown"), [(19, False), (20, True)])
def test_a_direction_is_shown_for_a_fifth_of_a_second(samples, shown):
    v = np.concatenate([np.full(500, 1.0), np.full(samples, -1.0), both_ways(SLOW)])
    assert ("hinge_0 moving down" not in said(v=v)) == shown
    assert ("hinge_0 moving up" not in said(v=-v)) == shown


@pytest.mark.parametrize(("samples", "shown"), [(4, False), (5, True)])
@pytest.mark.parametrize("slowest", [0.02, 0.2])
def test_slow_motion_is_below_a_fifth_of_the_highest_speed(slowest, samples, shown):
    """Four times five samples of it are a fifth of a second."""
    v = both_ways((200, 0.9), (200, 0.3), (samples, 0.99 * slowest))
    found = [x for x in said(v=v) if "below" in x]
    assert found == ([] if shown else ["hinge_0 below 0.2 rad/s"])


def test_slow_motion_is_asked_for_in_round_speeds():
    for word in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
        v = both_ways((200, 1.2 * word))
        (found,) = [x for x in said(v=v) if "below" in x]
        assert found == f"hinge_0 below {word:g} rad/s"


def test_what_matters_most_of_all_joints_comes_first():
    """The first joint lacks range, the second one speed, the third one turns."""
    fast = both_ways((300, 1.0), (30, 0.1), SLOW)
    up = np.abs(fast)
    v = np.stack([fast, fast, up, 0 * fast], axis=1)
    q = np.stack([0.5 * np.sin(np.arange(len(fast)))] * 3 + [0 * fast], axis=1)
    robot = replace(
        pendulum(4), q_min=np.array([-2.0, -np.inf, -np.inf, -1.0]),
        q_max=np.array([2.0, np.inf, np.inf, 1.0]),
        v_max=np.array([np.inf, 5.0, np.inf, 1.0]),
    )  # fmt: skip
    sampled = SimpleNamespace(q=q, v=v, mask=np.ones(len(v), dtype=bool))
    gap = SimpleNamespace(robot=robot, sampled=sampled, rate=100.0)
    assert [x.partition(" rad")[0] for x in not_excited(gap)] == [
        "hinge_3 does not move", "hinge_2 moving down", "reversals of hinge_2",
        "hinge_1 above 1", "hinge_0 beyond -0.5 to 0.5",
    ]  # fmt: skip


@pytest.mark.parametrize(("turns", "shown"), [(2, False), (3, True)])
def test_a_joint_turns_three_times(turns, shown):
    v = np.concatenate([np.full(300, (-1.0) ** k) for k in range(turns + 1)])
    assert ("reversals of hinge_0" not in said(v=v)) == shown


@pytest.mark.parametrize(("limit", "shown"), [(1.9, True), (2.1, False)])
def test_half_of_the_limits_of_speed_and_position_is_enough(limit, shown):
    v = both_ways((300, 1.0), SLOW)
    assert ("hinge_0 above 1 rad/s" not in said(v=v, v_max=limit)) == shown
    q = np.linspace(-0.5, 0.5, len(v))
    found = said(q, v, q_min=-limit / 2, q_max=limit / 2)
    assert ("hinge_0 beyond -0.5 to 0.5 rad" not in found) == shown


def test_the_highest_speed_is_that_of_all_but_a_hundredth():
    v = np.full(2000, 1.0)
    v[:10] = 3.0
    assert "hinge_0 above 1 rad/s" in said(v=v, v_max=5.0)


@pytest.mark.parametrize(("width", "moves"), [(0.0049, False), (0.0051, True)])
def test_a_joint_moves_by_five_milliradians(width, moves):
    q = np.linspace(0.0, width, 2000)
    assert (said(q) != ("hinge_0 does not move",)) == moves
    assert said(q, mask=np.zeros(2000, dtype=bool)) == ("hinge_0 does not move",)


# --- background -----------------------------------------------------------------------


def test_a_link_moves_the_joints_before_it_and_its_own():
    gap = gap_of(size=3, count=2, seconds=4.0, noise=0.0)
    blocks, sizes = background(gap)
    assert [sorted(x) for x in blocks[:3]] == [[0], [0, 1], [0, 1, 2]]
    links = pendulum(3).chain.inertial
    for i in range(3):
        torque = sum(blocks[k][i] @ links[k] for k in range(3) if i in blocks[k])
        exact = [s(b.load[:, i]) for _, b, s in gap.lower_band]
        np.testing.assert_allclose(torque, np.concatenate(exact), atol=1e-9)
    assert all(len(x) == 10 for x in sizes[:3]) and len(sizes) == len(blocks) == 6


def test_a_background_is_made_once_and_goes_with_its_gap():
    gap, other = gap_of(seconds=2.0), gap_of(seconds=2.0)
    for of in (background, friction_near_rest, sampling_delays):
        first = of(gap)
        assert of(other) is not first and of(gap) is first
    gone, first = weakref.ref(gap), None
    del gap
    gc.collect()
    assert gone() is None


def test_a_heavier_link_is_a_rotor_of_a_single_joint():
    """Had its torque another band, both together would fit what lies between."""
    gap = gap_of(noise=0.02)
    link, *_ = background(gap)[0]
    rotor = gap.columns(Armature((0,)))[0]
    about_axis = link[0][:, 6]  # Iyy
    np.testing.assert_allclose(about_axis, rotor[:, 0], atol=1e-9)


def test_dry_friction_is_told_from_drag_rotor_and_offset():
    for level, found in ((0.8, 0.8), (-0.8, 0.0)):
        effects = Coulomb((0,), {"level": level}), Viscous((0,), {"coefficient": 0.5})
        logs = [with_torque(m, effects) for m in swings()]
        logs = [replace(m, tau=m.tau + 0.2 * m.a + 3.0) for m in logs]
        gap = measure_gap(pendulum(), logs, cutoff=CUTOFF)
        assert dry_friction(gap) == pytest.approx([found], abs=2e-3)
        rubs = replace(pendulum(), frictionloss=np.array([0.3]))
        assert dry_friction(replace(gap, robot=rubs)) == pytest.approx(
            [0.3 + found], abs=2e-3
        )


def test_soft_friction_reverses_early_by_its_lead():
    """At a steady acceleration the speed is ahead by as much."""
    t = np.arange(-200, 201) / 100.0
    v, a = t[:, None], np.ones((401, 1))
    motion = SimpleNamespace(v=v, a=a)
    gap = SimpleNamespace(motions=[motion], filtered=np.concatenate)
    found = soft_friction(gap, 0, (0.1, 0.5), (0.0, 0.25))
    assert found.shape == (401, 4)
    for k, (lead, knee) in enumerate([(0, 0.1), (0, 0.5), (0.25, 0.1), (0.25, 0.5)]):
        law = np.clip((t + lead) / knee, -1.0, 1.0) - np.sign(t)
        np.testing.assert_allclose(found[:, k], law)


def test_friction_near_rest_has_four_knees_and_is_late_or_early_by_a_hundredth():
    gap = gap_of(Coulomb((0,), {"level": 0.8}))
    (columns,), (sizes,) = friction_near_rest(gap)
    stated = (0.003, 0.01, 0.017, 0.03), (0.0, 0.01)
    np.testing.assert_array_equal(columns[0], soft_friction(gap, 0, *stated))
    np.testing.assert_allclose(sizes, np.full(8, dry_friction(gap)[0]))


def test_a_gap_knows_its_rate_and_what_was_measured():
    gap = gap_of(noise=0.0)
    assert isinstance(gap, Gap) and gap.rate == pytest.approx(RATE / 2)
    np.testing.assert_allclose(
        gap.measured, np.concatenate([s(m.tau) for m, _, s in gap]), atol=1e-9
    )
    np.testing.assert_allclose(gap.load[:, 0], np.concatenate(
        [b.load[:: s.factor, 0] for _, b, s in gap]
    ))  # fmt: skip


def test_declared_friction_keeps_its_band_up_to_twenty_five_hertz():
    """Above, the lower half of the band has all of it."""
    rubs = replace(pendulum(), frictionloss=np.array([2.0]))
    for cutoff, kept in ((50.0, False), (40.0, True), (10.0, True)):
        gap = measure_gap(rubs, swings(count=1), cutoff=cutoff)
        ((plain, _, _),), ((found, _, _),) = gap.lower_band, gap.lower_band_reported
        dry = 2.0 * np.sign(gap.motions[0].v)
        wide = butterworth(dry, rate=100.0, cutoff=25.0) if cutoff >= 25.0 else dry
        narrow = butterworth(dry, rate=100.0, cutoff=cutoff / 2)
        more = kept * (wide - narrow)
        np.testing.assert_allclose(found.tau - plain.tau, more, atol=1e-12)
        slow = butterworth(gap.motions[0].q, rate=100.0, cutoff=cutoff / 2)
        np.testing.assert_allclose(plain.q, slow)


def test_a_split_has_a_test_set_where_there_are_fewer_than_four_blocks():
    assert held_out(parted(1, 3)) == [(0, 2)]
    assert held_out(parted(1, 2)) == [(0, 1)]


def test_slow_motion_of_one_joint_is_asked_for_before_reversals_of_another():
    v = np.concatenate([np.full(500, 1.0), np.full(500, -1.0), np.full(40, 0.005)])
    turning = both_ways((260, 1.0))
    both = np.stack([v, turning], axis=1)
    sampled = SimpleNamespace(
        q=np.cumsum(both, axis=0), v=both, mask=np.ones(len(v), dtype=bool)
    )
    free = np.full(2, np.inf)
    robot = replace(pendulum(2), q_min=-free, q_max=free, v_max=free)
    gap = SimpleNamespace(robot=robot, sampled=sampled, rate=100.0)
    assert not_excited(gap) == ("hinge_1 below 1 rad/s", "reversals of hinge_0")
