"""Parts of a diagnosis against sums that are worked out here."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import NOISE, RATE, gap_of, pendulum, swings, with_torque

from hybrid.diagnosis.answer.diagnosis import Value
from hybrid.diagnosis.answer.events import events_at_rest
from hybrid.diagnosis.answer.findings import finding_of, implausible, interval, shrunk
from hybrid.diagnosis.answer.motion_gap import (
    motion_shrink,
    rollout_agrees,
    step_warning,
)
from hybrid.diagnosis.answer.regions import locate
from hybrid.diagnosis.answer.unseen import left_unseen
from hybrid.diagnosis.evidence.bayes import PRIOR_FACTORS, log_bayes
from hybrid.diagnosis.evidence.candidates import (
    candidate,
    candidates,
    with_gains,
)
from hybrid.diagnosis.evidence.screening import Screening, by_size
from hybrid.diagnosis.evidence.shapes import (
    Range,
    fit_shapes,
    normalised_shapes,
    part_of_range,
    price,
    shape_derivatives,
    shape_units,
    with_normalised_shapes,
)
from hybrid.diagnosis.gap.background import (
    background,
    dry_friction,
    sampling_delays,
    soft_friction,
)
from hybrid.diagnosis.gap.faults import find_faults
from hybrid.diagnosis.gap.measure import measure_gap, split, unseen_samples
from hybrid.effects import Quantity, effect_class
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.viscous import Viscous
from hybrid.recording import Recording

# --- intervals and shares -------------------------------------------------------------


def test_an_interval_is_that_of_resampled_blocks():
    x = np.random.default_rng(0).normal(2.0, 1.0, 50)
    low, high = interval(lambda k: x[k].mean(axis=1), 50, np.random.default_rng(1))
    draws = x[np.random.default_rng(1).integers(50, size=(400, 50))].mean(axis=1)
    assert (low, high) == tuple(np.quantile(draws, [0.025, 0.975]))
    assert interval(lambda k: x[k].mean(axis=1), 1, np.random.default_rng(1)) == (0, 1)


def test_what_is_removed_is_a_part_of_the_rms():
    squares = np.array([[40.0, 0.0, 60.0], [10.0, 5.0, 15.0]])
    found = shrunk(squares, 4, "N·m", np.random.default_rng(0))
    assert (found.before, found.after) == pytest.approx((5.0, 2.5))
    assert found.removed == pytest.approx(0.5) and found.unit == "N·m"
    assert found.interval == pytest.approx((0.5, 0.5))
    none = shrunk(0 * squares, 4, "N·m", np.random.default_rng(0))
    assert (none.before, none.after, none.removed) == (0.0, 0.0, 0.0)


# --- motion ---------------------------------------------------------------------------


class Replayed:
    """Squared motion errors by term; windows of two joints and three times."""

    horizon, step = 0.2, 0.002

    def __init__(self, worth, halved=1.0):
        self.effects, self.halved = worth, halved
        gap = SimpleNamespace(robot=pendulum(2))
        self.scored = SimpleNamespace(
            gap=gap, left=lambda terms: terms, without=lambda *k: k, before=(), after=()
        )

    def squares_of(self, effects, step=None):
        rms = 0.5 - sum(effects)
        rms = rms * (self.halved if step == self.step / 2 else 1.0)
        return (
            np.tile((rms * np.linspace(0.9, 1.1, 9)[:, None]) ** 2, (1, 2))[:, :, None]
            .repeat(3, axis=2)
            .mean(axis=2)
        )

    def windows_with(self, members):
        return np.arange(9) > 0


@pytest.mark.parametrize(
    ("effect", "name", "unit", "most"),
    [
        ("encoder_eccentricity", "cosine", "rad", 0.05),
        ("delay", "time", "s", 0.05),
        ("torque_gain", "gain", "", 0.5),
    ],
)
def test_an_angle_a_time_or_a_ratio_beyond_its_bound_is_doubted(
    effect, name, unit, most
):
    def doubts(value):
        size = Value("elbow", name, value, unit, (value, value))
        return implausible([finding_of(effect_class(effect), ["elbow"], [], [size])])

    assert doubts(most) == doubts(-most) == []
    (said,) = doubts(-1.1 * most)
    assert f"of {-1.1 * most:.2g}" in said and "at elbow is more than is" in said
    assert doubts(1.1 * most)


def test_a_mass_has_no_bound_that_holds_for_all_arms():
    size = Value("arm", "mass", 80.0, "kg", (79.0, 81.0))
    assert (
        implausible([finding_of(effect_class("payload"), ["tool"], [], [size])]) == []
    )


def test_a_motion_error_is_the_median_over_the_windows(monkeypatch):
    from hybrid.diagnosis.answer import motion_gap

    monkeypatch.setattr(motion_gap, "changed_joints", lambda scored, left: [0, 1])
    made, rng = Replayed([0.2, 0.0, -0.1]), np.random.default_rng(0)
    found = motion_shrink(made, [0], rng)
    middle = np.median(np.linspace(0.9, 1.1, 9)[1:])
    assert found.before == pytest.approx((0.5 - 0.0 + 0.1) * middle)
    assert found.after == pytest.approx(0.4 * middle)
    assert found.removed == pytest.approx(1 - 0.4 / 0.6) and found.unit == "rad"
    assert found.horizon_s == 0.2
    assert rollout_agrees(made, 0, rng) is True
    assert rollout_agrees(made, 2, rng) is False
    assert rollout_agrees(made, 1, rng) is None
    made.horizon = None
    assert (
        motion_shrink(made, [0], rng) is None and rollout_agrees(made, 0, rng) is None
    )


@pytest.mark.parametrize(("halved", "says"), [(1.09, False), (1.12, True), (0.8, True)])
def test_a_step_that_changes_the_motion_error_is_told(halved, says):
    notes = step_warning(Replayed([0.1], halved))
    assert bool(notes) == says
    if says:
        assert "half the step of 2 ms" in notes[0]
        assert f"differs by {abs(halved - 1):.0%}" in notes[0]


def test_what_is_left_unseen_is_above_noise_and_at_most_all():
    scored = SimpleNamespace(
        before=[np.full(10, 4.0), np.full(10, 1.0)],
        after=[np.full(10, 2.0), np.full(10, 3.0)],
    )
    account = SimpleNamespace(noise=np.array([1.0, 2.0]))
    # 160 and 40 of noise 15, and 5 and 45 of 15: no more than is left
    expected = ((40 - 15) + (45 - 15)) / ((160 - 15) + (45 - 15))
    assert left_unseen(scored, account) == pytest.approx(expected)
    none = SimpleNamespace(before=[np.zeros(5)], after=[np.zeros(5)])
    assert left_unseen(none, SimpleNamespace(noise=np.ones(1))) == 0.0


# --- where ----------------------------------------------------------------------------


def gap_left(torque, seed=0):
    """A gap of two pendulums: white noise of 1 N·m, and more of the first joint."""
    gap = gap_of(size=2, count=4, seconds=8.0)
    rng = np.random.default_rng(seed)
    left = rng.normal(size=gap.left.shape)
    left[:, 0] += torque(gap.sampled, rng)
    return replace(gap, left=left)


@pytest.mark.parametrize(
    ("torque", "variable", "ends"),
    [
        (lambda m, rng: 3.0 * (np.abs(m.v[:, 0]) > 5.0) * np.sign(m.v[:, 0]), "speed",
         (5.0, None)),
        (lambda m, rng: 3.0 * (m.v[:, 0] > 0), "direction", (0.0, 1.0)),
        (lambda m, rng: 3.0 * (m.t > 6.0), "time", (6.0, None)),
    ],
)  # fmt: skip
def test_a_region_is_where_the_excess_is(torque, variable, ends):
    gap = gap_left(torque)
    found = locate(gap, np.ones(2), np.random.default_rng(0))
    assert found and all(r.joint == "hinge_0" for r in found[:3])
    (region,) = [r for r in found if r.variable == variable and r.joint == "hinge_0"]
    assert region.low == ends[0] and ends[1] in (None, region.high)
    (whole,) = [r for r in found if r.variable == "link"]
    assert whole.unit == "torque to motion" and (whole.low, whole.high) == (0.0, 1.0)
    excess = np.where(gap.moving, gap.left**2 - 1.0, 0.0).sum(axis=0)
    # The other joint has less than its noise by chance, which is a share of none.
    assert whole.share == pytest.approx(min(excess[0] / excess.sum(), 1.0))
    assert whole.interval[0] < whole.share <= whole.interval[1] <= 1.0


def test_an_event_ends_with_its_last_sample():
    t = np.arange(0.0, 6.0, 1 / RATE)
    (m, *_) = swings(1, count=1)
    q, zero = np.full((len(t), 1), 0.5), np.zeros((len(t), 1))
    mask = np.ones(len(t), dtype=bool)
    held = with_torque(replace(m, t=t, q=q, v=zero, a=zero, mask=mask, tau=zero), ())
    gap = measure_gap(pendulum(), [held], cutoff=10.0)
    s = gap.sampled.t
    left = 0.02 * np.random.default_rng(0).normal(size=gap.left.shape)
    on = ((s >= 2.0) & (s < 2.5)) | ((s >= 4.0) & (s < 4.4))
    left[on] += 2.0
    first, second = events_at_rest(replace(gap, left=left))
    for event, (low, high) in ((first, (2.0, 2.5)), (second, (4.0, 4.4))):
        inside = s[(s >= low) & (s < high)]
        assert (event.start, event.end) == (inside[0], inside[-1])
        assert event.torque == pytest.approx((2.0,), abs=0.05)
    # the last frame is at the axis: only a moment about it is felt
    assert first.force[4] == pytest.approx(first.torque[0], abs=1e-6)
    assert first.force[:3] == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


# --- evidence -------------------------------------------------------------------------


def test_screening_is_the_evidence_of_each_block_beside_the_base():
    """As worked out with all columns together."""
    rng = np.random.default_rng(3)
    base, blocks = (
        rng.normal(size=(60, 3)),
        [rng.normal(size=(60, p)) for p in (1, 2, 1)],
    )
    y = base @ [1.0, -0.5, 0.3] + blocks[1] @ [0.4, 0.2] + 0.3 * rng.normal(size=60)
    X = np.hstack(blocks)
    places = by_size([np.arange(x.shape[1]) for x in blocks])
    assert {p: x.tolist() for p, x in places.items()} == {1: [[0], [3]], 2: [[1, 2]]}
    A = np.eye(3) + base.T @ base
    from scipy.linalg import cho_factor

    within = {p: np.array([X[:, k].T @ X[:, k] for k in x]) for p, x in places.items()}
    made = Screening.of(
        np.arange(3), places, (base.T @ X, within, X.T @ y), cho_factor(A), base.T @ y
    )
    precision, lower = np.full(4, 1.0), np.full(4, -np.inf)
    for less in ([], [1], [0, 2]):
        kept = [k for k in range(3) if k not in less]

        def evidence(columns):
            S = np.eye(60) + columns @ columns.T
            return -0.5 * np.linalg.slogdet(S)[1] - 0.5 * y @ np.linalg.solve(S, y)

        own = base[:, kept]
        expected = []
        for x in blocks:
            wider = [
                evidence(np.hstack([own, f * x])) - abs(np.log(f))
                for f in PRIOR_FACTORS
            ]
            expected.append(max(wider) - evidence(own))
        found = made.worth(np.array(less, dtype=int), precision, lower, [None] * 3)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_gains_stay_above_their_bounds_and_fixed_ones_where_they_are():
    H = np.array([[4.0, 1.0], [1.0, 3.0]])
    s, precision = np.array([-2.0, 5.0]), np.array([1.0, 2.0])
    _, free = log_bayes(H, s, precision, np.full(2, -np.inf))
    np.testing.assert_allclose(free, np.linalg.solve(H + np.diag(precision), s))
    _, held = log_bayes(H, s, precision, np.zeros(2))
    np.testing.assert_allclose(held, [0.0, 5.0 / 5.0])
    for at, far in ((np.array([0.7]), False), (np.array([4.0]), True)):
        one = np.array([[4.0]]), np.array([3.0]), np.array([1.0]), np.array([-np.inf])
        worth, gains = log_bayes(*one, at)
        assert gains == pytest.approx(at if far else [0.6])
        expected = 3.0 * 4.0 - 0.5 * 4.0 * 16.0 if far else 0.9 - 0.5 * np.log(5.0)
        assert worth == pytest.approx(expected)


# --- shapes and candidates ------------------------------------------------------------


def test_a_wide_range_is_logarithmic():
    wide = Range(Quantity("x", "s", 0.1, 0.01, 1.0))
    assert wide.logarithmic and wide.normalised(0.1) == pytest.approx(0.5)
    assert wide.value(0.5) == pytest.approx(0.1)
    assert wide.value(-1.0) == 0.01 and wide.value(2.0) == 1.0
    plain = Range(Quantity("x", "s", 1.0, 0.5, 3.0))
    assert not plain.logarithmic and plain.normalised(1.0) == pytest.approx(0.2)
    assert plain.value(0.2) == pytest.approx(1.0)
    assert part_of_range(plain.shape, 1.0, 2.5) == pytest.approx(0.6)
    assert not Range(Quantity("x", "s", 1.0, 0.0, 3.0)).logarithmic


def test_shapes_are_searched_near_those_of_an_effect():
    gap = gap_of(size=1)
    start = Stribeck((0,), {"level": 0.5, "velocity": 0.1, "exponent": 1.5})
    x = normalised_shapes(gap, start)
    assert x == pytest.approx([np.log(100) / np.log(1000), 0.4])
    back = with_normalised_shapes(gap, start, x)
    assert back.values == pytest.approx(start.values)
    units = shape_units(gap, start)
    assert units == pytest.approx([0.1 * np.log(1000), 2.5], rel=1e-3)

    def gain(e):
        at = normalised_shapes(gap, e)
        return -((at[0] - x[0] - 0.05) ** 2) - (at[1] - 0.45) ** 2

    best, worth = fit_shapes(start, gain, gap)
    assert normalised_shapes(gap, best) == pytest.approx([x[0] + 0.05, 0.45], abs=0.02)
    assert worth == gain(best) and worth > -1e-3
    assert price(start) == 4.0 and price(Coulomb((0,))) == 0.0
    two_values = effect_class("deadzone")((0,))  # beside a shape that is fitted
    assert price(two_values) == pytest.approx(2.0 + np.log(2.0))
    plain, worth = fit_shapes(Coulomb((0,)), lambda e: 7.0, gap)
    assert worth == 7.0 and plain == Coulomb((0,))


def test_derivatives_of_shapes_are_those_of_the_torque():
    gap = gap_of(size=1)
    effect = Stribeck((0,), {"level": 0.5, "velocity": 0.3, "exponent": 1.5})
    x, step = normalised_shapes(gap, effect), 1e-4
    gains = effect.gain_values
    for k, block in enumerate(shape_derivatives(gap, effect)):
        ends = [
            gap.columns(
                with_normalised_shapes(gap, effect, x + way * step * np.eye(2)[k])
            )
            for way in (1, -1)
        ]
        slope = (ends[0][0] - ends[1][0]) @ gains / (2 * step)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(block[0][:, 0], slope, atol=0.05 * scale)


def test_candidates_are_on_a_grid_within_the_range_of_each_shape():
    gap = gap_of(size=2)
    found = candidates(gap, without=("payload",))
    ids = {c.effect.id for c in found}
    assert {"coulomb", "viscous", "stribeck", "elasticity"} <= ids
    assert not ids & {"payload", "contact", "controller_gain", "torque_ripple"}
    own = [c.effect for c in found if c.place == ("stribeck", (1,))]
    speeds = sorted({round(e.values["velocity"], 9) for e in own})
    bends = sorted({round(e.values["exponent"], 9) for e in own})
    grid = 0.001 * 1000 ** (np.arange(1, 8) / 8)
    assert set(np.round(grid, 9)) <= set(speeds) and len(speeds) <= 8
    assert set(np.round(0.5 + 2.5 * np.arange(1, 5) / 5, 9)) <= set(bends)
    (dry,) = [c for c in found if c.place == ("coulomb", (0,))]
    assert dry.lower == pytest.approx([0.0]) and dry.std[0] > 0
    assert dry.fixed_gains(gap) is None
    tuned = with_gains(dry.effect, [0.7])
    assert tuned.values["level"] == 0.7
    again = candidate(gap, tuned)
    assert again.std == pytest.approx(dry.std) and again.prior_factor == 1.0


def test_a_steep_effect_is_scanned_over_its_gain():
    from hybrid.effects.backlash import Backlash

    gap = gap_of(size=1)
    few = [c.effect for c in candidates(gap) if c.effect.id == "backlash"]
    widths = [e.values["half_width"] for e in few][:14]
    gain = Backlash.gains[0].scaled(gap.scales[0])
    np.testing.assert_allclose(widths, np.geomspace(gain.typical / 30, gain.upper, 14))
    (first, *_) = [c for c in candidates(gap) if c.effect.id == "backlash"]
    assert first.fixed_gains(gap) == pytest.approx([widths[0]])
    assert with_gains(first.effect, [9.0]) is first.effect


def test_springs_above_the_visible_band_are_one_candidate():
    gap = gap_of(size=1)
    springs = [c for c in candidates(gap) if c.effect.id == "elasticity"]
    stiff, *soft = springs
    gain = type(stiff.effect).gains[0].scaled(gap.scales[0])
    every = np.geomspace(gain.typical / 30, gain.upper, 14)
    above = [gap.is_above_band(stiff.effect.at({gain.name: x})) for x in every]
    assert 1 < sum(above) == 15 - len(springs)
    assert stiff.effect.values[gain.name] == every[sum(above) - 1]
    assert stiff.fixed_gains(gap) is None  # its torque is proportional to it
    assert all(c.fixed_gains(gap) == c.effect.gain_values for c in soft)


# --- background and split -------------------------------------------------------------


def test_the_background_is_of_the_numbers_of_the_file():
    robot = replace(
        pendulum(2), damping=np.array([0.0, 0.3]), frictionloss=np.array([0.2, 0.0]),
        stiffness=np.array([5.0, 0.0]), springref=np.array([0.1, 0.0]),
    )  # fmt: skip
    gap = measure_gap(robot, swings(2, count=2, seconds=4.0), cutoff=10.0)
    blocks, sizes = background(gap)
    assert len(blocks) == len(sizes) == 2 + 2 + 1 + 1 + 1
    # A declared number has the torque of its whole value: it is off by a part of it.
    assert [sorted(b) for b in blocks] == [[0], [0, 1], [0], [0], [0], [1], [1]]
    assert all(x.tolist() == [1.0] for x in sizes[2:])
    s = gap.sampled
    damping = blocks[6][1][20:-20, 0]
    np.testing.assert_allclose(damping, 0.3 * s.v[20:-20, 1], atol=0.06)
    inner = np.r_[40:80]
    spring = blocks[4][0][inner, 0]
    np.testing.assert_allclose(spring, 5.0 * (s.q[inner, 0] - 0.1), atol=0.25)
    links = np.concatenate([blocks[0][0], blocks[1][0]], axis=1)
    torque = links @ robot.chain.inertial.ravel()
    np.testing.assert_allclose(torque[inner], gap.load[inner, 0], atol=0.5)
    delays, spread = sampling_delays(gap)
    assert spread[0] == pytest.approx([1 / RATE / np.sqrt(12)]) and len(delays) == 2


def test_dry_friction_is_what_the_file_has_and_what_the_gap_shows():
    robot = replace(pendulum(1), frictionloss=np.array([0.2]))
    dry = [Coulomb((0,), {"level": 1.5}), Viscous((0,), {"coefficient": 0.3})]
    logs = [with_torque(m, dry, NOISE) for m in swings(1, count=2, seconds=4.0)]
    gap = measure_gap(robot, logs, cutoff=10.0)
    assert dry_friction(gap) == pytest.approx([1.5], rel=0.05)
    less = [replace(m, tau=2 * swing.tau - m.tau) for m, swing in
            zip(logs, swings(1, count=2, seconds=4.0), strict=True)]  # fmt: skip
    assert dry_friction(measure_gap(robot, less, cutoff=10.0)) == pytest.approx([0.2])
    soft = soft_friction(gap, 0, (0.5, 1.0), (0.0, 0.05))
    assert soft.shape == (len(gap.left), 4)
    (m, *_), (sampler, *_) = gap.motions, gap.samplers
    v, a = m.v[:, 0], m.a[:, 0]
    law = np.clip((v + 0.05 * a) / 1.0, -1, 1) - np.sign(v)
    np.testing.assert_allclose(soft[: len(sampler(law)), 3], sampler(law), atol=1e-9)


def test_every_fourth_log_is_for_testing_unless_it_alone_is_far_off():
    gap = gap_of(size=1, count=8)
    learn = split(gap)
    assert sorted(set(gap.trajectory[~learn])) == [3, 7]
    assert (unseen_samples(gap, learn) == ~learn).all()
    far = gap.left.copy()
    far[gap.trajectory == 3] *= 50.0
    other = split(replace(gap, left=far))
    tested = set(gap.trajectory[~other].tolist())
    assert len(tested) == 2 and not tested & {3, 7}
    one = gap_of(size=1, count=1, seconds=24.0)
    learn = split(one)
    assert 0.6 < learn.mean() < 0.9
    unseen = unseen_samples(one, learn)
    reach = round(3.0 / 6 * one.rate)
    assert not (unseen & learn).any() and unseen.any()
    for k in np.flatnonzero(unseen):
        assert not learn[max(k - reach, 0) : k + reach + 1].any()


# --- faults ---------------------------------------------------------------------------


def faults_of(tau=None, q=None):
    t = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(0)
    move = np.stack([np.sin(2 * t), 0.5 * np.cos(3 * t)], axis=1)
    load = np.stack([5 * np.cos(2.3 * t), 2 * np.sin(1.7 * t)], axis=1)
    load = load + 0.01 * rng.normal(size=load.shape)
    q = move if q is None else q(move.copy())
    tau = load if tau is None else tau(load.copy())
    return find_faults(Recording(t, q, tau=tau, joints=("a", "b"), source="log"))


def put(rows, joint, value):
    def changed(x):
        x[rows, joint] = x[rows.start, joint] if value is None else value
        return x

    return changed


def test_faults_are_at_their_samples_and_told_with_their_share():
    none = faults_of()
    assert none.notes == () and not none.posture.any() and not none.torque.any()
    held = faults_of(tau=put(slice(300, 330), 1, None))
    assert held.notes == ("log: torque of b is frozen for 3%",)
    assert np.flatnonzero(held.torque[:, 1]).tolist() == list(range(300, 330))
    assert not held.torque[:, 0].any() and not held.posture.any()
    short = faults_of(tau=put(slice(300, 319), 1, None))
    assert short.notes == ()
    full = faults_of(tau=lambda x: np.clip(x, -9.0, [3.0, 9.0]))
    at = full.torque[:, 0]
    assert full.notes == (f"log: torque of a is saturated for {at.mean():.0%}",)
    assert 0.2 < at.mean() < 0.4 and not full.torque[:, 1].any()
    frozen = faults_of(q=put(slice(400, 440), 0, None))
    assert frozen.notes == ("log: position of a is frozen for 4%",)
    assert np.flatnonzero(frozen.posture).tolist() == list(range(400, 440))
