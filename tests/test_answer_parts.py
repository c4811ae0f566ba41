"""The answer by its parts: findings, events, regions, replays, verdicts, and files."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import gap_of, pendulum, with_torque

from hybrid.diagnosis import diagnose as diagnose_module
from hybrid.diagnosis.answer import command, events, motion_gap
from hybrid.diagnosis.answer.command import (
    _excess,
    _is_significant,
    _plausible,
    _Servo,
)
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Region, Shrink, Unseen
from hybrid.diagnosis.answer.events import contacts_in_motion, events_at_rest
from hybrid.diagnosis.answer.findings import (
    changed_joints,
    finding_of,
    findings,
    fitted_values,
    shrunk,
    torque_shrink,
)
from hybrid.diagnosis.answer.fixed import _servo_notes, fixed_model, fixed_simulator
from hybrid.diagnosis.answer.links import delay_finding
from hybrid.diagnosis.answer.motion_gap import (
    _in_motion,
    _removed,
    motion_shrink,
    with_motion_gap,
)
from hybrid.diagnosis.answer.regions import (
    _bands,
    _densest,
    _Histogram,
    _histograms,
    _Test,
    locate,
)
from hybrid.diagnosis.answer.replay import (
    Replay,
    _motions,
    _starts,
    simulated_positions,
    windows_of,
)
from hybrid.diagnosis.answer.simulator import corrected, scored_effects
from hybrid.diagnosis.answer.unseen import unseen
from hybrid.diagnosis.diagnose import _drop_improbable
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.convention import Convention
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.gap.measure import seconds
from hybrid.diagnosis.verdict import verdict_of
from hybrid.effects.armature import Armature
from hybrid.effects.backlash import Backlash
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.contact import Contact
from hybrid.effects.controller_gain import ControllerGain
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.payload import Payload
from hybrid.effects.presliding import Presliding
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError
from hybrid.statistics import interval_above


def rng():
    return np.random.default_rng(0)


# --- findings -------------------------------------------------------------------------


def scored(before, after, *, noise=(1.0, 1.0), rate=10.0):
    """An explanation of some joints, by its residuals without and with its terms."""
    size = len(after)
    rows = [np.arange(len(x)) for x in after]
    made = SimpleNamespace(
        gap=SimpleNamespace(robot=pendulum(size), fold=np.zeros(len(after[0]))),
        evidence=SimpleNamespace(noise=np.array(noise[:size]), rows=rows),
        before=before, after=after, blocks=lambda i: rows[i] // round(rate),
        learnt=None,
    )  # fmt: skip
    made.where_seen = lambda members: made
    return made


def test_joints_are_changed_by_a_twentieth_of_the_largest_change():
    """Of squares, in units of noise."""
    after = [np.zeros(10), np.zeros(10)]
    for size, joints in ((0.21, [0]), (0.23, [0, 1])):
        without = [np.full(10, 1.0), np.full(10, size)]
        assert changed_joints(scored(without, after), without) == joints
    quiet = scored(without, after, noise=(1.0, 0.01))
    assert changed_joints(quiet, [np.full(10, 1.0), np.full(10, 0.1)]) == [0, 1]
    assert changed_joints(quiet, after) == [0, 1]  # nothing is, and no joint is less


def test_the_torque_gap_shrinks_at_the_joints_that_a_finding_changes():
    after = [np.full(20, 1.0), np.full(20, 7.0)]
    without = [np.full(20, 3.0), np.full(20, 7.0)]
    found = torque_shrink(scored(without, after), without, rng())
    assert (found.before, found.after) == (3.0, 1.0)
    assert found.removed == pytest.approx(2 / 3) and found.unit == "N·m"
    assert found.interval == pytest.approx((2 / 3, 2 / 3)) and found.horizon_s is None
    both = [np.full(20, 3.0), np.full(20, 9.0)]
    found = torque_shrink(scored(both, after), both, rng())
    assert found.before == pytest.approx(np.sqrt(45.0)) and found.after == 5.0


def test_values_have_intervals_of_two_deviations_within_the_bounds_of_shapes():
    gap = gap_of(size=2)
    law = Presliding((1,), {"level": 0.5, "distance": 0.02})
    law = law.at({}, {"level": 0.1, "distance": 0.015})
    level, distance = fitted_values(gap, law)
    assert (level.joint, level.name, level.unit) == ("hinge_1", "level", "N·m")
    assert level.interval == pytest.approx((0.5 - 0.196, 0.5 + 0.196))
    bounds = Presliding.shapes[0].scaled(gap.scales[1])
    assert distance.interval == pytest.approx(
        (max(0.02 - 0.0294, bounds.lower), min(0.02 + 0.0294, bounds.upper))
    )
    assert level.determined
    (prior,) = candidate(gap, law).std
    for std, known in ((0.9 * prior, True), (1.1 * prior, False)):
        (level, _) = fitted_values(gap, law.at({}, {"level": std, "distance": 0.01}))
        assert level.determined == known
    # A gain far from zero is known, however small its prior was.
    far = law.at({"level": 10 * prior}, {"level": 2 * prior, "distance": 0.01})
    assert fitted_values(gap, far)[0].determined
    low, high = bounds.lower, bounds.upper
    wide = law.at({"distance": np.sqrt(low * high)}, {"distance": 1e3 * high})
    assert not fitted_values(gap, wide)[1].determined
    certain = fitted_values(gap, law.at({}, {"level": 0.1}))[1]
    assert certain.interval == (certain.value, certain.value) and certain.determined


@pytest.mark.parametrize("mean", [-1.0, 0.0, 0.5, 1.5, 1.8, 2.5, 6.0])
def test_the_interval_of_a_bounded_value_is_the_shortest_with_95_percent(mean):
    from scipy.stats import truncnorm

    least, std = 2.0, 0.3
    own = truncnorm(-mean, np.inf, loc=least + mean * std, scale=std)
    low, high = interval_above(least, least + mean * std, std)
    assert own.cdf(high) - own.cdf(low) == pytest.approx(0.95, abs=1e-5)
    ends = own.pdf([low + 1e-9, high])  # it is shortest if both ends are as likely
    assert low == least or ends[0] == pytest.approx(ends[1], rel=1e-6)
    assert ends[0] >= ends[1] * (1 - 1e-6)


def test_dry_friction_is_never_negative():
    gap = gap_of(size=2)
    rubs = Coulomb((1,), {"level": 0.5}).at({}, {"level": 0.3})
    ((low, high),) = [v.interval for v in fitted_values(gap, rubs)]
    assert low == 0.0 and 0.5 < high < 0.5 + 1.96 * 0.3
    offset = TorqueOffset((1,), {"level": 0.5}).at({}, {"level": 0.3})
    ((low, high),) = [v.interval for v in fitted_values(gap, offset)]
    assert (low, high) == pytest.approx((0.5 - 1.96 * 0.3, 0.5 + 1.96 * 0.3))


def test_values_of_an_arm_are_the_arms_and_of_couplings_of_both_joints():
    gap = gap_of(size=2)
    carried = Payload((0, 1), {"mass": 1.0}, {"mass": 0.1})
    assert {v.joint for v in fitted_values(gap, carried)} == {"arm"}
    mass = fitted_values(gap, carried)[0]
    assert (mass.name, mass.unit) == ("mass", "kg")


def test_a_finding_says_its_effect_joints_and_alternatives_once():
    found = finding_of(Coulomb, ["a", "b"], ("viscous", "coulomb", "viscous"), ())
    assert found.alternatives == ("coulomb", "viscous")
    assert "a and b" in found.sentence and found.remedy == Coulomb.remedy
    assert found.share == 1.0 and found.shrink == {}
    shrink = Shrink(1.0, 0.5, 0.5, (0.4, 0.6))
    assert finding_of(Coulomb, ["a"], (), (), shrink=shrink).shrink == {
        "torque": shrink
    }


def grouped(effects, kinds, names=None):
    """Findings of some terms with shares of 1, 2, 3 and so on."""
    gap = gap_of(size=2)
    left = [np.full(len(gap.left), 1.0)] * 2
    made = scored(left, left)
    made.gap, made.named = gap, names or tuple(e.id for e in effects)
    made.without = lambda *k: k
    made.left = lambda gains: left
    parts = np.arange(1.0, 1.0 + len(effects))
    return findings(made, effects, kinds, parts / parts.sum(), rng())


def test_terms_of_one_effect_are_one_finding_in_the_order_of_joints():
    effects = [
        Coulomb((1,), {"level": 2.0}), Viscous((0,), {"coefficient": 3.0}),
        Coulomb((0,), {"level": 1.0}),
    ]  # fmt: skip
    kinds = [{"coulomb": 0.9, "presliding": 0.08}, {"viscous": 1.0}, {"coulomb": 0.7}]
    dry, drag = grouped(effects, kinds)
    assert (dry.effect, dry.joints) == ("coulomb", ("hinge_0", "hinge_1"))
    assert [v.value for v in dry.parameters] == [1.0, 2.0]
    assert dry.alternatives == ("coulomb", "presliding")
    assert dry.chances == (pytest.approx(0.8), pytest.approx(0.04))
    assert (dry.probability, drag.probability) == (pytest.approx(0.84), 1.0)
    assert (dry.share, drag.share) == (pytest.approx(4 / 6), pytest.approx(2 / 6))


def test_a_term_in_place_of_an_unknown_law_is_no_finding():
    effects = [Coulomb((0,), {"level": 1.0}), Viscous((0,), {"coefficient": 3.0})]
    (only,) = grouped(effects, [{}, {"viscous": 1.0}])
    assert only.effect == "viscous"
    assert grouped(effects, [{}, {}]) == ()


def test_a_law_that_takes_the_place_of_the_files_says_so():
    effects = [Coulomb((0,), {"level": -1.0}), Presliding((0,), {"level": 1.2})]
    (found,) = grouped(
        effects, [{"coulomb": 1.0}, {"presliding": 0.9}], ("presliding",) * 2
    )
    assert found.effect == "presliding" and found.joints == ("hinge_0",)
    names = [v.name for v in found.parameters]
    assert names[-1] == "coulomb level" and names[0] == "level"
    assert found.sentence.endswith(
        "It takes the place of the coulomb friction that the file declares."
    )
    assert found.alternatives == ("presliding",) and found.share == 1.0


# --- events ---------------------------------------------------------------------------


class Standing(SimpleNamespace):
    """A gap whose motions are one, with a moment about the axes of all joints."""

    def __iter__(self):
        moment = np.tile(np.eye(6)[3], (*self.left.shape, 1))
        yield None, SimpleNamespace(wrench_columns=lambda last: moment), lambda x: x


def standing(left, *, mask=None, v=None, q=None, size=1, count=1, source="log"):
    """A gap of an arm that stands, 100 Hz, with a rated torque of 50 N·m."""
    rows = len(left)
    v = np.zeros((rows, size)) if v is None else v
    each = rows // count
    t = np.arange(rows) % each / 100.0
    return Standing(
        robot=pendulum(size), rate=100.0, left=left,
        sampled=SimpleNamespace(
            t=t, v=v, q=0 * v if q is None else q,
            mask=np.ones(rows, dtype=bool) if mask is None else mask
        ),
        scales=[SimpleNamespace(torque=50.0)] * size,
        trajectory=np.arange(rows) // each,
        motions=[SimpleNamespace(source=source)] * count,
    )  # fmt: skip


def noisy(rows=400, std=0.01, size=1):
    """Noise between two bounds, whose median size is that of normal noise."""
    even = np.linspace(-2.0, 2.0, rows) * std / 1.4826
    return np.tile(rng().permutation(even)[:, None], (1, size))


@pytest.mark.parametrize(("push", "told"), [(0.47, False), (0.53, True)])
def test_a_push_is_a_hundredth_of_the_rated_torque(push, told):
    left = noisy()
    left[200:220] += push
    found = events_at_rest(standing(left))
    assert len(found) == told
    if told:
        assert (found[0].start, found[0].end) == (2.0, 2.19)
        assert found[0].torque[0] == pytest.approx(push, abs=0.01)
        assert found[0].force[3] == pytest.approx(push, abs=0.01)


@pytest.mark.parametrize(("push", "told"), [(7.7, False), (8.4, True)])
def test_a_push_is_eight_deviations_of_the_holding_torque(push, told):
    left = noisy(std=1.0)
    left[200:210] = push
    assert len(events_at_rest(standing(left))) == told


@pytest.mark.parametrize(("samples", "told"), [(4, False), (5, True)])
def test_a_push_lasts_a_twentieth_of_a_second(samples, told):
    left = noisy()
    left[200 : 200 + samples] += 2.0
    assert len(events_at_rest(standing(left))) == told


@pytest.mark.parametrize(("pause", "count"), [(19, 1), (20, 2)])
def test_two_pushes_are_a_fifth_of_a_second_apart(pause, count):
    left = noisy()
    left[200:210] += 2.0
    left[210 + pause : 220 + pause] += 2.0
    assert len(events_at_rest(standing(left))) == count


@pytest.mark.parametrize(("speed", "rests"), [(0.0099, True), (0.011, False)])
def test_an_arm_rests_below_a_hundredth_of_a_radian_per_second(speed, rests):
    left = noisy(size=2)
    left[200:220] += 2.0
    v = np.zeros((400, 2))
    v[:, 1] = speed
    assert len(events_at_rest(standing(left, v=v, size=2))) == rests
    fast = np.zeros((400, 2))
    fast[:100, 1] = 3.0  # a hundredth of which is rest
    fast[100:, 1] = 0.029
    assert len(events_at_rest(standing(left, v=fast, size=2))) == 1


def test_a_push_needs_a_second_of_rest_in_its_own_log():
    left = noisy()
    left[200:220] += 2.0
    for rested, told in ((99, False), (100, True)):
        mask = np.zeros(400, dtype=bool)
        mask[150 : 150 + rested] = True
        assert len(events_at_rest(standing(left, mask=mask))) == told
    left = np.concatenate([noisy(), left])
    left[:400] += 30.0  # each log has a holding torque of its own
    (found,) = events_at_rest(standing(left, count=2, source=""))
    assert found.recording == "1" and found.start == 2.0


@pytest.mark.parametrize(("away", "told"), [(0.019, 1), (0.021, 0)])
def test_what_a_posture_lacks_all_the_time_is_no_push(away, told):
    left, q = noisy(), np.zeros((400, 1))
    left[250:] += 3.0
    q[250:] += away
    assert len(events_at_rest(standing(left, q=q))) == told
    left[300:320] += 2.0
    assert len(events_at_rest(standing(left, q=q))) == 1


def test_a_contact_at_a_time_of_one_log_is_of_that_log():
    touch = Contact((0,), {"start": 1.0, "duration": 0.5, "force_x": 2.0})
    for apart, name in ((100.0, "second"), (0.0, "each recording")):
        gap = standing(np.zeros((400, 1)), count=2)
        gap.motions = [SimpleNamespace(source=x) for x in ("first", "second")]
        gap.sampled.t[:200] -= apart
        wrenches = np.zeros((400, 1, 6))
        with pytest.MonkeyPatch.context() as m:
            m.setattr(events, "_wrenches", lambda gap, x=wrenches: x)
            (found,) = contacts_in_motion(gap, [touch])
        assert found.recording == name


# --- regions --------------------------------------------------------------------------


def histogram(excess, samples=None, variable="speed"):
    """Bins of one block of time for each row."""
    excess = np.asarray(excess, dtype=float)
    samples = 100.0 * np.ones_like(excess) if samples is None else samples
    edges = np.arange(excess.shape[1] + 1.0)
    return _Histogram(0, variable, "", edges, excess, np.asarray(samples))


EVERY = np.ones((1, 4), dtype=np.int64)  # each of four blocks once


def judged(limit=3.0, correlated=1.0):
    return _Test(np.tile(EVERY, (20, 1)), limit, correlated)


def test_an_excess_is_beyond_chance_and_the_error_of_the_noise():
    """Squares of 200 independent samples deviate by 20; a twentieth of them is 10."""
    test = judged()
    assert test.exceeds(61.0, 200.0) and not test.exceeds(59.0, 200.0)
    half = judged(correlated=4.0)
    assert half.exceeds(121.0, 200.0) and not half.exceeds(119.0, 200.0)
    many = judged(limit=0.1)
    assert many.exceeds(10.1, 200.0) and not many.exceeds(9.9, 200.0)


def test_the_densest_range_is_where_the_excess_is_above_its_mean():
    flat = np.full((4, 5), 10.0)
    peak = flat.copy()
    peak[:, 1:3] += 200.0
    assert _densest(histogram(peak), judged()) == slice(1, 3)
    assert _densest(histogram(flat), judged()) is None
    assert _densest(histogram(flat + 500.0), judged()) is None  # it is everywhere
    few = np.full((4, 5), 10.0)
    few[:, 4] += 200.0
    visits = np.full((4, 5), 100.0)
    visits[:, 4] = 1000.0  # it is where the joint mostly is
    found = _densest(histogram(few, visits), judged())
    assert found is None or found != slice(4, 5)


def test_an_excess_of_one_block_of_time_is_no_region():
    once = np.full((4, 5), 10.0)
    once[2, 1:3] += 4000.0
    draws = np.random.default_rng(0).multinomial(4, np.full(4, 0.25), 200)
    drawn = _Test(draws, 3.0, 1.0)
    assert _densest(histogram(once), drawn) is None
    often = np.full((4, 5), 10.0)
    often[:, 1:3] += 1000.0
    assert _densest(histogram(often), drawn) == slice(1, 3)


def test_a_link_is_a_region_if_it_has_an_excess_at_all():
    for excess, found in ((20.0, slice(0, 1)), (5.0, None)):
        one = histogram(np.full((4, 1), excess), np.full((4, 1), 50.0), "link")
        assert _densest(one, judged()) == found


def test_a_tone_is_in_its_band_with_all_its_squares():
    gap = gap_of(count=1, seconds=20.0)
    t = gap.sampled.t
    rows = np.flatnonzero(gap.moving[:, 0])
    left = 2.0 * np.sin(2 * np.pi * 3.0 * t)[:, None]
    gap = replace(gap, left=left, moving=np.ones_like(gap.moving))
    rows = np.arange(len(t))
    block = (t // 1.0).astype(int)
    found = _bands(gap, 0, 0.5, rows, block, block.max() + 1)
    np.testing.assert_allclose(found.edges, [0.0, 0.5, 1.0, 2.0, 5.0, 10.0])
    part = np.array([0.5, 0.5, 1.0, 3.0, 5.0]) / 10.0
    np.testing.assert_allclose(found.samples.sum(axis=0), part * len(t))
    excess = found.excess.sum(axis=0)
    squares = 4.0 * 2.0 * len(t)
    np.testing.assert_allclose(
        excess, [*(-part[:3] * len(t)), squares - part[3] * len(t), -part[4] * len(t)],
        atol=0.01 * squares,
    )  # fmt: skip
    assert found.excess.shape == (20, 5) and (found.variable, found.unit) == (
        "frequency", "Hz",
    )  # fmt: skip


def test_bins_hold_the_excess_of_their_samples():
    gap = gap_of(count=2, seconds=4.0, size=2)
    left = np.full_like(gap.left, 3.0)
    moving = gap.moving.copy()
    moving[:, 1] = False
    moving[:9, 1] = True  # less than a fifth of a second at 50 Hz
    gap = replace(gap, left=left, moving=moving)
    found = list(_histograms(gap, np.array([1.5, 1.0])))
    assert {x.joint for x in found} == {0}
    names = [x.variable for x in found]
    assert names == [
        "link", "speed", "direction", "position", "load", "time_since_reversal",
        "time", "frequency",
    ]  # fmt: skip
    count = moving[:, 0].sum()
    for x in found[:-1]:
        assert x.samples.sum() == count and len(x.samples) == 8
        np.testing.assert_allclose(x.excess, 3.0 * x.samples)
    assert found[2].samples.shape == (8, 2)
    units = [x.unit for x in found]
    assert units == ["torque to motion", "rad/s", "", "rad", "N·m", "s", "s", "Hz"]
    temperature = np.tile(np.linspace(20.0, 40.0, len(gap.left))[:, None], (1, 2))
    warm = replace(gap)
    warm.__dict__["sampled"] = replace(gap.sampled, temperature=temperature)
    assert "temperature" in {x.variable for x in _histograms(warm, np.ones(2))}


def test_no_region_is_told_of_an_arm_that_stands_or_has_no_gap():
    gap = gap_of(size=1)
    still = replace(gap, moving=np.zeros_like(gap.moving))
    assert locate(still, np.ones(1), rng()) == ()
    assert locate(gap, np.ones(1), rng()) == ()


# --- replay ---------------------------------------------------------------------------


def test_a_motion_error_is_at_most_half_a_turn_and_its_start_does_not_count():
    made = object.__new__(Replay)
    made._error = lambda *_: np.array([[[9.0]], [[1.0]], [[np.nan]], [[-50.0]]])
    found = made.squares_of((), step=1e-3)
    assert found == pytest.approx(np.array([[(1.0 + 2 * np.pi**2) / 3]]))


def test_windows_start_where_the_last_one_ends():
    one, two = np.ones(12, dtype=bool), np.ones(9, dtype=bool)
    two[3] = False
    assert _starts([one, two], 5).tolist() == [[0, 0], [0, 5]]
    assert _starts([one, two], 4).tolist() == [[0, 0], [0, 4], [1, 4]]
    assert _starts([one], 12).shape == (0, 2)


def test_windows_are_half_a_second_or_a_tenth_and_at_least_three():
    rate = 100.0
    for samples, horizon, count in ((152, 0.5, 3), (150, 0.1, 14), (30, None, 0)):
        found, windows = windows_of([np.ones(samples, dtype=bool)], rate)
        assert found == horizon and len(windows.motion) == count
        if horizon:
            assert windows.samples == round(horizon * rate)
    many, windows = windows_of([np.ones(5001, dtype=bool)], rate)
    assert len(windows.sample) == 24 and windows.sample[[0, -1]].tolist() == [0, 4950]
    assert (np.diff(windows.sample) >= 50).all()
    few, windows = windows_of([np.ones(32, dtype=bool)], 10.0)
    assert (few, windows.samples) == (0.5, 5)
    least, windows = windows_of([np.ones(7, dtype=bool)], 2.0)
    assert (least, windows.samples) == (0.5, 1)


def test_only_motions_of_the_same_rate_that_hold_wanted_samples_are_replayed():
    gap = gap_of(count=3)
    wanted = gap.trajectory != 1
    motions, usable, start = _motions(gap, wanted)
    size = len(gap.left) // 3
    assert start.tolist() == [0, 2 * size] and len(motions) == 2
    assert [m.sum() for m in usable] == [size, size]
    np.testing.assert_allclose(motions[1].tau, gap.measured[2 * size :])
    assert motions[0].rate == pytest.approx(gap.rate) and motions[0].asked is None


def test_positions_are_simulated_in_windows_and_nowhere_else(monkeypatch):
    from hybrid.diagnosis.answer import replay

    gap = gap_of(count=1)
    seen = []

    def rollout(robot, effects, motions, windows, *, step):
        seen.append((len(effects), step))
        q = np.full((windows.samples + 1, len(windows.motion), 1), float(len(seen)))
        return q if step < 1e-3 else np.nan * q

    monkeypatch.setattr(replay, "rollout", rollout)
    monkeypatch.setattr(replay, "corrected", lambda *_: (gap.robot, ("x",)))
    monkeypatch.setattr(replay, "scored_effects", lambda scored: ())
    plain, found = simulated_positions(SimpleNamespace(gap=gap))
    # Each diverges at the longest step.
    assert seen == [(0, 1e-3), (0, 3e-4), (1, 1e-3), (1, 3e-4)]
    assert plain.shape == gap.left.shape
    inside = 25 * ((len(plain) - 1) // 25) + 1
    assert (plain[:inside] == 2.0).all() and np.isnan(plain[inside:]).all()
    assert (found[:inside] == 4.0).all()


def test_the_removed_part_is_of_the_median_of_windows():
    before, after = np.array([2.0, 4.0, 9.0]), np.array([1.0, 3.0, 8.0])
    assert _removed(before, after) == pytest.approx(0.25)
    both = _removed(np.stack([before, 2 * before]), np.stack([after, after]))
    np.testing.assert_allclose(both, [0.25, 0.625])
    assert _removed(0 * before, after) == 0.0


class Replayed:
    """Squared motion errors of a delay that is taken back or not."""

    horizon, step = 0.5, 1e-3
    effects = (Coulomb((0,), {"level": 1.0}),)

    def __init__(self, before, after):
        self.before, self.after = before, after
        self.scored = SimpleNamespace(gap=SimpleNamespace(robot=pendulum(2)))

    def windows_with(self, members):
        assert members == []
        return np.arange(5)

    def squares_of(self, effects):
        if effects is self.effects:
            return np.tile([self.after**2, 99.0], (5, 1))
        self.given = effects
        return np.tile([self.before**2, 99.0], (5, 1))


def test_a_shared_delay_is_replayed_as_if_it_were_put_back():
    made = Replayed(0.4, 0.1)
    late = Delay((0,), {"time": 0.03})
    found = motion_shrink(made, [], rng(), delays=[late])
    assert (found.before, found.after) == (pytest.approx(0.4), pytest.approx(0.1))
    assert found.removed == pytest.approx(0.75) and found.horizon_s == 0.5
    first, again = made.given
    assert first is made.effects[0] and again.values["time"] == -0.03


def in_motion(shrink, *, agrees=None, effect="backlash", verdict="explained", **more):
    """A diagnosis with one finding whose shrinkage in motion is stated."""
    f = replace(
        finding_of(Backlash if effect == "backlash" else Coulomb, ["a"], (), ())
    )
    f = replace(f, share=0.4)
    diagnosis = Diagnosis(
        "arm", ("a",), (1.0,), (0.1,), (0.1,), (), (f,), verdict, 0.1, 0.02,
        warnings=("before",),
    )  # fmt: skip
    x = SimpleNamespace(members=lambda e: [0], learnt=None)
    x.where_seen = lambda members: x if more.get("seen", True) else None
    result = SimpleNamespace(diagnosis=diagnosis, scored=x, delays=())
    with pytest.MonkeyPatch.context() as m:
        m.setattr(motion_gap, "motion_shrink", lambda *_, **__: shrink)
        m.setattr(motion_gap, "rollout_agrees", lambda *_: agrees)
        m.setattr(motion_gap, "step_warning", lambda replay: ["step"])
        return _in_motion(result, None, rng())


def test_a_finding_has_its_shrinkage_in_motion():
    shrink = Shrink(0.4, 0.1, 0.75, (0.7, 0.8), 0.5, "rad")
    found = in_motion(shrink)
    assert found.findings[0].shrink["motion"] is shrink
    assert found.warnings == ("before", "step") and found.verdict == "explained"
    once = in_motion(shrink, seen=False)
    assert "motion" not in once.findings[0].shrink


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [(0.9, 0.99, False), (0.9, 1.0, True), (0.99, 0.1, False), (3.14, 0.1, True)],
)
def test_a_motion_error_of_a_radian_has_no_meaning(before, after, told):
    found = in_motion(Shrink(before, after, 0.5, (0.4, 0.6), 0.5, "rad"))
    assert ("motion" not in found.findings[0].shrink) == told
    assert any("leaves the motion, with backlash or without" in x for x in
               found.warnings) == told  # fmt: skip


def test_what_cannot_be_replayed_is_said():
    found = in_motion(None)
    assert any("too few stretches" in x and "backlash" in x for x in found.warnings)
    assert "motion" not in found.findings[0].shrink


@pytest.mark.parametrize(
    ("effect", "agrees", "verdict"),
    [
        ("backlash", False, "partly_explained"), ("backlash", None, "explained"),
        ("backlash", True, "explained"), ("coulomb", False, "explained"),
    ],
)  # fmt: skip
def test_what_should_show_in_motion_and_does_not_is_denied(effect, agrees, verdict):
    shrink = Shrink(0.4, 0.1, 0.75, (0.7, 0.8), 0.5, "rad")
    found = in_motion(shrink, agrees=agrees, effect=effect)
    denied = verdict != "explained"
    assert found.verdict == verdict
    assert found.unexplained == (0.4 if denied else 0.1)
    assert any("do not take it for the cause" in x for x in found.warnings) == denied


def test_without_effects_nothing_is_replayed_and_what_fails_is_a_warning(monkeypatch):
    diagnosis = SimpleNamespace()
    none = SimpleNamespace(effects=())
    assert with_motion_gap(none, rng()) is none

    def failing(scored):
        raise HybridError("it cannot be simulated")

    monkeypatch.setattr(motion_gap, "Replay", failing)
    monkeypatch.setattr(motion_gap, "_noted", lambda d, notes: (d, notes))
    monkeypatch.setattr(motion_gap, "replace", lambda r, diagnosis: diagnosis)
    gap = SimpleNamespace(torque_is_filtered=False)
    some = SimpleNamespace(effects=(1,), scored=None, diagnosis=diagnosis, gap=gap)
    told = []
    found = with_motion_gap(some, rng(), progress=lambda *x: told.append(x))
    assert found == (diagnosis, ["no replay: it cannot be simulated"])
    assert told == [("replaying the simulator", 0.85)]


# --- the corrected simulator ----------------------------------------------------------


def test_gains_are_those_of_the_terms_in_their_order():
    terms = tuple(
        SimpleNamespace(candidate=SimpleNamespace(effect=e))
        for e in (Presliding((0,)), Coulomb((1,)))
    )
    x = SimpleNamespace(
        gains=np.array([9.0, 9.0, 2.0, 3.0]), rigid=np.array([0, 1]), terms=terms,
        own=(np.array([2]), np.array([3])),
    )  # fmt: skip
    first, second = scored_effects(x)
    assert first.values["level"] == 2.0 and second.values["level"] == 3.0
    x.terms, x.own, x.gains = (), (), np.array([9.0, 9.0])
    assert scored_effects(x) == ()


def test_rotors_and_payloads_become_part_of_the_arm():
    robot = pendulum(2)
    x = SimpleNamespace(gap=SimpleNamespace(robot=robot), gains=None, rigid=())
    errors = np.zeros(22)
    heavier = Armature((1,), {Armature.gains[0].name: 0.02})
    carried = Payload((0, 1), {"mass": 0.5})
    rubs = Coulomb((0,), {"level": 1.0})
    found, rest = corrected(x, (heavier, carried, rubs), errors)
    assert rest == (rubs,)
    np.testing.assert_allclose(found.chain.armature, [0.05, 0.07])
    mass = found.chain.inertial[:, 0]
    np.testing.assert_allclose(mass, [2.0, 2.5])
    errors[-2:] = [-4.0, 2.0]  # parts of the rotors: none is below zero
    found, _ = corrected(x, (), errors)
    np.testing.assert_allclose(found.chain.armature, [0.0, 0.15])
    errors[:10] = 0.0
    x.gains, x.rigid = np.append(errors, 7.0), np.arange(22)
    again, _ = corrected(x, ())
    np.testing.assert_allclose(again.chain.armature, found.chain.armature)


def test_a_spring_behind_a_rotor_that_is_there_leaves_it():
    x = SimpleNamespace(gap=SimpleNamespace(robot=pendulum(1)))
    play = Backlash((0,), {"half_width": 0.01})
    found, (kept,) = corrected(x, (play,), np.zeros(11))
    assert kept is play and found.chain.armature[0] == 0.05


def test_settings_of_a_servo_are_noted_at_their_joint():
    robot = replace(pendulum(2), kp=np.array([80.0, 50.0]), kd=np.array([5.0, 2.0]))
    result = SimpleNamespace(
        gap=SimpleNamespace(robot=robot),
        command=(
            CommandLatency((0,), {"time": 0.012}),
            ControllerGain((1,), {"stiffness": -0.2, "damping": 0.5}),
        ),
        effects=(),
    )
    assert _servo_notes(result) == [
        "command_latency of hinge_0, delay commands by 12 ms",
        "controller_gain of hinge_1, use kp = 40 and kd = 3",
    ]
    assert fixed_simulator(result) == (robot, ())


def test_the_model_of_a_corrected_arm_has_its_links_friction_and_findings():
    gap = gap_of(size=2, count=1)
    heavy = pendulum(2).with_inertial(1.5 * pendulum(2).chain.inertial)
    rubs = replace(heavy, damping=np.array([0.3, 0.0]))
    model = fixed_model(gap, rubs, [Coulomb((1,), {"level": 2.0})])
    (m,) = gap.motions
    arm = with_torque(replace(m, tau=0 * m.tau), ()).tau
    rotor = 0.05 * m.a
    expected = 1.5 * (arm - rotor) + rotor
    expected[:, 0] += 0.3 * m.v[:, 0]
    expected[:, 1] += 2.0 * np.sign(m.v[:, 1])
    found = model.predict(m)
    fast = (np.abs(m.v) > 0.3).all(axis=1)
    np.testing.assert_allclose(found[fast], expected[fast], atol=1e-6)
    assert model.cutoff == gap.cutoff
    fastest = np.abs(gap.sampled.v[gap.sampled.mask]).max(axis=0)
    np.testing.assert_allclose(model.standing, 0.01 * fastest, rtol=0.05)


# --- a delay that all joints share ----------------------------------------------------


def test_a_shared_delay_explains_what_is_left_with_it():
    gap = gap_of(size=2, count=1)
    rows = [np.arange(0, 100), np.arange(50, 100)]
    after = [np.zeros(100), np.zeros(50)]
    logged = replace(gap, left=gap.left + [2.0, 1.0])
    moving = np.zeros_like(gap.moving)
    moving[:, 0] = True
    logged = replace(logged, moving=moving)
    x = SimpleNamespace(
        gap=gap, learnt=None, after=after, before=[x + 3.0 for x in after],
        evidence=SimpleNamespace(rows=rows, noise=np.array([4.0, 0.5])),
        blocks=lambda i: rows[i] // 50,
    )  # fmt: skip
    late = Convention(late=0.03, std=0.001)
    found, others = delay_finding(logged, x, late, rng())
    np.testing.assert_allclose(found.squares, [4.0 * 100 / 4.0, 1.0 * 50 / 0.5])
    assert others == pytest.approx(9.0 * 100 / 4.0 + 9.0 * 50 / 0.5)
    (finding,) = found.findings
    assert finding.joints == ("hinge_0",) and finding.share == 1.0
    (delay,) = found.effects
    std = np.hypot(0.001, Delay.inexact["time"] * 0.03)
    assert delay.values["time"] == 0.03 and delay.std["time"] == pytest.approx(std)
    assert finding.shrink["torque"].after == 0.0
    # Both joints change by as much in units of noise.
    rms = np.sqrt((4.0 * 100 + 1.0 * 50) / 150)
    assert finding.shrink["torque"].before == pytest.approx(rms)


def test_a_shared_delay_is_accounted_for_on_training_samples():
    gap = gap_of(size=1, count=1)
    logged = replace(gap, left=gap.left + 2.0)

    def of(samples, learnt=None):
        rows = [np.arange(samples)]
        return SimpleNamespace(
            gap=gap, learnt=learnt, after=[np.zeros(samples)],
            before=[np.ones(samples)], blocks=lambda i: rows[i] // 50,
            evidence=SimpleNamespace(rows=rows, noise=np.array([1.0])),
        )  # fmt: skip

    found, others = delay_finding(logged, of(10, of(100)), Convention(0.03), rng())
    assert found.squares.tolist() == [400.0] and others == 100.0
    worse = of(10)
    worse.after = [np.full(10, -3.0)]  # the delay makes less of it
    found, others = delay_finding(logged, worse, Convention(0.03), rng())
    assert found.squares.tolist() == [0.0] and others == 0.0


# --- between command and torque -------------------------------------------------------


def servo(joint=0, **fits):
    """A fitted servo, by the size of what each fit leaves."""

    def fit(size):
        return SimpleNamespace(
            left=np.full(10, size), residual=lambda log, x=size: np.full(10, x)
        )

    keys = {"none": (False, False), "late": (True, False), "free": (False, True)}
    made = {keys.get(k, (True, True)): fit(x) for k, x in fits.items()}
    log = SimpleNamespace(row=np.arange(10))
    both = (CommandLatency, ControllerGain)
    found = both if "none" in fits else both[1:]
    return _Servo(joint, log, log, made, found, (), noise=2.0, scale=False)


def test_the_best_fit_without_an_effect_is_the_one_without_it():
    own = servo(none=9.0, late=5.0, free=4.0, whole=1.0)
    assert own.without(CommandLatency).left[0] == 4.0
    assert own.without(ControllerGain).left[0] == 5.0
    assert own.without().left[0] == 1.0
    assert own.without(CommandLatency, ControllerGain).left[0] == 9.0
    assert own.decrease(own.without(ControllerGain), own.without()) == 5 * 24.0
    assert own.decrease(own.without(), own.without(ControllerGain)) == 0.0


def test_an_excess_is_above_noise_in_blocks_of_a_second():
    gap = SimpleNamespace(fold=np.zeros(25), rate=5.0, robot=SimpleNamespace(size=2))
    np.testing.assert_array_equal(seconds(gap), np.repeat(range(5), 5))
    found = _excess(gap, [servo(1, late=4.0, whole=1.0)])
    expected = np.zeros((5, 2))
    expected[:2, 1] = 5 * (16.0 / 2.0 - 1.0)
    np.testing.assert_allclose(found, expected)
    assert seconds(SimpleNamespace(fold=np.zeros(3), rate=0.2)).tolist() == [0, 1, 2]


@pytest.mark.parametrize(("stiffness", "told"), [(-0.003, True), (0.0019, False)])
def test_servo_gains_whose_intervals_all_hold_zero_are_not_told(stiffness, told):
    """Once a tenth of a per cent, 0 ± 0.2 %, was named on an arm that had none."""
    std = {"stiffness": 0.001, "damping": 0.03}
    found = ControllerGain((0,), {"stiffness": stiffness, "damping": 0.05}, std)
    assert _is_significant(found) == told


def test_gains_at_their_bounds_are_not_plausible():
    time = CommandLatency.gains[0]
    for value, fine in ((0.01, True), (time.lower, False), (time.upper, False)):
        assert _plausible(CommandLatency((0,), {"time": value})) == fine


def test_a_better_fit_has_evidence_and_leaves_less_on_held_out_samples(monkeypatch):
    def fit(left):
        return SimpleNamespace(residual=lambda log: np.full(4, np.sqrt(left / 4)))

    ratio = []
    monkeypatch.setattr(command, "log_likelihood_ratio", lambda *_: ratio[-1])
    for left, nat, better in ((0.98, 15, True), (0.995, 15, False), (0.98, 13, False)):
        ratio.append(nat)
        assert command._better(None, None, fit(1.0), fit(left)) == better


# --- unseen motions -------------------------------------------------------------------


def test_the_gap_unseen_is_an_rms_before_and_after_and_at_its_ceiling(monkeypatch):
    from hybrid.diagnosis.answer import unseen as module

    monkeypatch.setattr(module, "_least_squares", lambda search: np.array([9.0, -1.0]))
    squares = {"known": np.array([4.0, 16.0]), "all": np.array([1.0, 4.0])}
    squares["named"] = np.array([16.0, 16.0])
    monkeypatch.setattr(module, "_simulated", lambda search, causes: squares[causes])
    test = SimpleNamespace(
        count=np.array([4.0, np.nan]), squares=squares.__getitem__,
        evidence=SimpleNamespace(power=np.array([36.0, 1.0])),
    )  # fmt: skip
    search = SimpleNamespace(test=test, causes="known", whole="all")
    found = unseen(search, SimpleNamespace(noise=np.array([0.25, 4.0])), "named")
    assert isinstance(found, Unseen)
    firsts = [x[0] for x in (found.before, found.after, found.least_squares)]
    assert firsts == [3.0, 1.0, 1.5]
    assert found.ceiling[0] == 0.5 and found.noise == (0.5, 2.0)
    assert found.named[0] == 2.0 and np.isnan(found.named[1])
    assert np.isnan(found.before[1]) and np.isnan(found.least_squares[1])


# --- the verdict ----------------------------------------------------------------------


def verdict(explained, missed, causes=("f",), left=0.0, *, doubtful=False):
    explained, missed = np.array(explained, float), np.array(missed, float)
    found = Account(explained + missed, missed, 0 * missed, missed, ())
    unseen = on_unseen([1.0] * len(missed), [0.1] * len(missed))
    return verdict_of(found, causes, unseen, left, doubtful=doubtful)


def on_unseen(before, named, noise=0.1):
    """Torque on held-out motion, by joint."""
    none = (np.nan,) * len(before)
    return Unseen(tuple(before), none, none, none, (noise,) * len(before), tuple(named))


def test_a_gap_is_explained_where_nothing_is_missed():
    assert verdict([9.0, 1.0], [0.0, 0.0]) == ("explained", 0.0)
    assert verdict([9.0], [1.0], left=0.05) == ("explained", pytest.approx(0.1))
    assert verdict([9.0], [0.0], left=0.09) == ("explained", 0.09)
    assert verdict([9.0], [0.0], left=0.11) == ("partly_explained", 0.11)
    assert verdict([9.0], [0.0], doubtful=True) == ("partly_explained", 0.0)
    assert verdict([1.0], [9.0])[0] == "partly_explained"


def test_without_a_cause_a_gap_is_unexplained_if_anything_is_missed():
    assert verdict([0.0], [0.0], causes=()) == ("no_gap", 0.0)
    assert verdict([0.0], [1.0], causes=()) == ("unexplained", 1.0)
    assert verdict([0.0], [0.0], causes=(), doubtful=True) == ("unexplained", 1.0)


def test_causes_of_other_joints_do_not_explain_a_joint():
    """However small its gap beside theirs: it is above its noise."""
    for part, word in ((0.055, "partly_explained"), (0.045, "explained")):
        found = Account(np.array([1e4, 1.0]), np.array([0.0, 1.0]),
                        np.array([0.0, 1.0 - part]), np.ones(2), ())  # fmt: skip
        unseen = on_unseen([1.0, 1.0], [0.1, 0.1])
        assert verdict_of(found, ("f",), unseen, 0.0, doubtful=False)[0] == word
    mostly = verdict([1.0, 0.06], [0.0, 0.05])  # more of it is explained
    assert mostly[0] == "explained"


@pytest.mark.parametrize(
    ("before", "named", "word"),
    [
        (8.0, 8.0, "partly_explained"),
        (8.0, 7.0, "partly_explained"),
        (8.0, 5.0, "explained"),
        (0.14, 0.14, "explained"),  # as noise
        (np.nan, np.nan, "explained"),  # not moved there
    ],
)
def test_a_joint_without_a_cause_on_held_out_motion_is_not_explained(
    before, named, word
):
    """A large fault of it in training may hide what it lacks at all times."""
    found = Account(np.array([1e4, 1e4]), np.zeros(2), np.zeros(2), np.ones(2), ())
    unseen = on_unseen([20.0, before], [0.1, named])
    assert verdict_of(found, ("f",), unseen, 0.0, doubtful=False)[0] == word


def test_causes_that_unknown_laws_could_be_are_dropped(monkeypatch):
    """A likely alternative at another joint is said, and one at the same is a rival.

    So are effects that only priors tell from it, which nobody is told of.
    """

    one, two = (Made(x.place, x) for x in (Made(("a", (0,))), Made(("b", (1,)))))
    law = Made(("speed", (0,)))
    here, there, far = Made(("x", (0,))), Made(("y", (1,))), Made(("z", (1,)))
    options = [
        (SimpleNamespace(candidate=x), 0.5)
        for x in (one.candidate, here, there, far, None)
    ]
    term, equal = Made(("a", (0,))), Made(("w", (0,)))
    search = SimpleNamespace(
        beliefs=[
            SimpleNamespace(
                cause=one, worth=9.0, alternatives=options, equals=(here, equal)
            ),
            SimpleNamespace(cause=two, worth=1.0, alternatives=[], equals=()),
        ],
        causes=[law, one, two], terms=[term],
        gap=SimpleNamespace(robot=SimpleNamespace(joints=("hip", "knee"))),
    )  # fmt: skip
    monkeypatch.setattr(diagnose_module, "is_known", lambda search, cause: cause is one)
    doubts = []
    kinds, alike = _drop_improbable(search, doubts)
    assert search.causes == [law, one]
    assert kinds == {one: {"a": 0.5, "x": 0.5}}
    assert alike == {term: (here, there, equal)}
    assert doubts == [
        "a at hip may as well be y at knee: these motions cannot tell them apart"
    ]


@dataclass(frozen=True, eq=False)
class Made:
    """A cause, a candidate or a term at a place."""

    place: tuple
    candidate: object = None


# --- the diagnosis as data ------------------------------------------------------------


def test_a_region_is_written_with_its_range():
    region = Region("a", "speed", 0.0, 0.5, "rad/s", 0.6, (0.5, 0.8))
    shrink = {"torque": Shrink(1.0, 0.5, 0.5, (0.4, 0.6)),
              "motion": Shrink(0.1, 0.05, 0.5, (0.4, 0.6), 0.5, "rad")}  # fmt: skip
    f = replace(finding_of(Coulomb, ["a"], ("viscous",), ()), shrink=shrink)
    made = Diagnosis("arm", ("a",), (2.0,), (0.5,), (0.1,), (region,), (f,),
                     "explained", 0.1, 0.02, units=("N·m",))  # fmt: skip
    found = made.as_dict()
    assert found["schema"] == "hybrid.diagnosis/2" and found["unknown"] == 0.1
    (gap,) = found["gap"]
    assert (gap["joint"], gap["unit"], gap["rms"], gap["noise"]) == (
        "a", "N·m", 2.0, 0.1,
    )  # fmt: skip
    assert gap["explained_by"] == ["coulomb"] and gap["after"] is None
    (where,) = found["where"]
    assert where["region"] == {
        "variable": "speed", "low": 0.0, "high": 0.5, "unit": "rad/s",
    }  # fmt: skip
    assert where["share"] == 0.6 and "low" not in where
    (finding,) = found["findings"]
    assert finding["class"] == [
        {"effect": "coulomb", "probability": None},
        {"effect": "viscous", "probability": None},
    ]
    assert finding["probability"] is None
    assert "horizon_s" not in finding["shrink"]["torque"]
    assert finding["shrink"]["motion"]["horizon_s"] == 0.5


def test_of_the_squares_above_noise_what_no_finding_explains_is_unknown():
    squares = (9.0, 1.0), (5.0, 1.0), (4.0, 1.0), (4.0, 1.0), (1.0, 1.0), (6.0, 1.0)
    each = np.sqrt(squares).tolist()
    made = Diagnosis("arm", ("a", "b"), (3.0, 1.0), (0.5, 0.5), (1.0, 1.0), (), (),
                     "unexplained", 1.0, 0.02, unseen=Unseen(*each))  # fmt: skip
    first, second = made.as_dict()["gap"]
    assert first["unknown"] == pytest.approx((6 - 1) / (9 - 1))
    assert second["unknown"] is None  # nothing is above the noise
    assert (first["before"], first["ceiling"]) == (3.0, 2.0)


# --- more of servos and files ---------------------------------------------------------


def test_two_effects_of_a_servo_share_by_what_each_adds_alone_and_last():
    own = servo(none=9.0, late=5.0, free=4.0, whole=1.0)
    late, gains = own.share(CommandLatency), own.share(ControllerGain)
    assert late == pytest.approx(5 * ((16.0 - 1.0) + (81.0 - 25.0)) / 2)
    assert gains == pytest.approx(5 * ((25.0 - 1.0) + (81.0 - 16.0)) / 2)
    alone = servo(late=5.0, free=4.0, whole=1.0)
    assert alone.share(ControllerGain) == pytest.approx(5 * 24.0)


@pytest.mark.parametrize("scale", [False, True])
def test_a_finding_of_servos_is_of_their_joints_and_held_out_samples(scale):
    gap = gap_of(size=2, count=1)
    first, second = (
        replace(
            servo(j, none=9.0, late=5.0, free=4.0, whole=2.0),
            effects=(
                CommandLatency((j,), {"time": 0.01}, {"time": 0.001}),
                ControllerGain((j,), {"stiffness": -0.2, "damping": 0.1}),
            ),
        )
        for j in (0, 1)
    )
    servos = [first, replace(second, scale=scale)]
    found = command._finding(gap, servos, ControllerGain, 1000.0, rng())
    assert found.joints == ("hinge_0", "hinge_1")
    alike = ("controller_gain", "torque_gain") if scale else ("controller_gain",)
    assert found.alternatives == alike
    assert [v.value for v in found.parameters] == [-0.2, 0.1, -0.2, 0.1]
    assert found.share == pytest.approx(2 * first.share(ControllerGain) / 1000.0)
    fall = found.shrink["torque"]
    assert (fall.before, fall.after, fall.unit) == (5.0, 2.0, "N·m")
    late = command._finding(gap, servos, CommandLatency, 1000.0, rng())
    assert late.alternatives == ("command_latency",)
    assert late.shrink["torque"].before == 4.0


def test_a_time_without_end_is_searched_around_its_value():
    from hybrid.diagnosis.evidence.shapes import _near
    from hybrid.effects import Quantity

    clock = Quantity("start", "s", 1.0, 0.0, 1e9)
    assert (_near(clock, 5.0).lower, _near(clock, 5.0).upper) == (4.0, 6.0)
    assert (_near(clock, 0.4).lower, _near(clock, 0.4).upper) == (0.0, 1.4)
    plain = Quantity("x", "s", 1.0, 0.0, 1e4)
    assert _near(plain, 5.0) is plain


def test_links_that_cannot_exist_become_the_nearest_ones_that_can():
    """By the torque of the motions: what these do not feel may change freely."""
    from hybrid.diagnosis.evidence.evidence import Evidence
    from hybrid.diagnosis.gap.background import background
    from hybrid.dynamics.pseudo_inertia import is_consistent

    gap = gap_of(size=2, count=2)
    evidence = Evidence(gap)
    columns, sizes = background(gap)
    blocks = evidence.add(columns[:2], sizes[:2])
    evidence.noise[:] = 1e-4
    index = np.concatenate(blocks)
    x = SimpleNamespace(gap=gap, evidence=evidence, index=index, rigid=index)
    fine, _ = corrected(x, (), np.zeros(22))
    np.testing.assert_array_equal(fine.chain.inertial, pendulum(2).chain.inertial)
    errors = np.zeros(22)
    errors[4] = errors[9] = -0.3  # moments about x and z that are below zero
    assert not is_consistent(pendulum(2).chain.inertial + errors[:20].reshape(2, 10))[0]
    found, _ = corrected(x, (), errors)
    links = found.chain.inertial
    assert is_consistent(links).all()
    # No motion turns a link of this arm about x or z: torque hardly changes.
    change = (links - pendulum(2).chain.inertial).ravel()
    felt = np.concatenate(
        [sum(columns[k][i] @ change[10 * k : 10 * k + 10] for k in range(2)
             if i in columns[k]) for i in range(2)]
    )  # fmt: skip
    assert np.sqrt(np.mean(felt**2)) < 0.05 * np.sqrt(np.mean(gap.measured**2))


def test_replays_of_the_same_effects_are_simulated_once(monkeypatch):
    from hybrid.diagnosis.answer import replay

    made, ran = object.__new__(Replay), []
    made.scored, made.motions, made._errors = None, (), {}
    made.windows = SimpleNamespace(of=lambda motions: 0.0)
    made.effects = two = ("a", "b")

    def rollout(robot, effects, motions, windows, *, step):
        ran.append((tuple(effects), step))
        diverges = step > 3e-4 and len(effects) == 2
        return np.full((3, 1, 1), np.nan if diverges else 0.5)

    monkeypatch.setattr(replay, "corrected", lambda scored, effects: (None, effects))
    monkeypatch.setattr(replay, "rollout", rollout)
    assert made.step == 3e-4
    assert ran == [(two, 1e-3), (two, 3e-4)]
    assert made.squares_of(["b"]) == pytest.approx(np.array([[0.25]]))
    assert made.squares_of(two) == pytest.approx(np.array([[0.25]]))
    assert ran[2:] == [(("b",), 3e-4)]
    made.squares_of(["b"], step=1e-4)
    assert ran[3:] == [(("b",), 1e-4)]
    none = object.__new__(Replay)
    none.effects, none._error = two, lambda *_: np.array([[[np.nan]]])
    assert none.step == 1e-3


def test_windows_count_in_which_a_term_has_a_hundredth_of_the_most():
    from hybrid.plant.rollout import Windows

    rows = [np.arange(2, 14)]
    torque = np.zeros(12)
    torque[0:4], torque[4:8], torque[8:12] = 1.0, 0.11, 0.09  # samples 2 to 13
    made = object.__new__(Replay)
    made.scored = SimpleNamespace(
        gap=SimpleNamespace(fold=np.zeros(14)),
        evidence=SimpleNamespace(rows=rows, noise=np.array([2.0])),
        contribution=lambda k: [torque],
    )
    made._start = np.array([2])
    made.windows = Windows(np.zeros(3, int), np.array([0, 4, 8]), 4)
    assert made.windows_with([0]).tolist() == [0, 1]
    torque[8:12] = 0.3
    assert made.windows_with([0]).tolist() == [0, 1, 2]


def test_the_limit_of_a_test_is_for_every_range_of_neighbouring_bins(monkeypatch):
    from scipy.stats import norm

    from hybrid.diagnosis.answer import regions

    gap = gap_of(size=1, count=2, seconds=4.0)
    made = []

    class Told(_Test):
        def exceeds(self, excess, samples):
            made.append(self)
            return False

    monkeypatch.setattr(regions, "_Test", Told)
    assert locate(gap, np.ones(1), rng()) == ()
    (test,) = made
    bins = [x.excess.shape[1] for x in _histograms(gap, np.ones(1))]
    ranges = sum(k * (k + 1) // 2 for k in bins)
    assert test.limit == pytest.approx(norm.isf(0.05 / ranges))
    assert test.correlated == pytest.approx(gap.rate / 2 / gap.cutoff)
    assert test.draws.shape == (1000, 8) and (test.draws.sum(axis=1) == 8).all()


def test_a_shrinkage_is_resampled_over_blocks_of_time():
    squares = np.array([[40.0, 10.0, 60.0, 0.0], [10.0, 9.0, 1.0, 5.0]])
    found = shrunk(squares, 8, "N", rng())
    k = rng().integers(3, size=(400, 3))  # the block without a gap does not count
    before, after = (squares[i][k].sum(axis=1) for i in (0, 1))
    ends = np.quantile(1 - np.sqrt(after / before), [0.025, 0.975])
    assert found.interval == pytest.approx(tuple(ends))
    assert found.before == pytest.approx(np.sqrt(110.0 / 8)) and found.unit == "N"


def test_gains_beside_a_scale_of_torque_are_divided_by_it():
    robot = replace(pendulum(), kp=np.array([50.0]), kd=np.array([2.0]))
    fit = SimpleNamespace(
        law=SimpleNamespace(scaled=True), gains=np.array([0.8, 36.0, 2.0]),
        covariance=np.diag([1.0, 1.0, 0.01, 4.0, 0.04]),
    )  # fmt: skip
    error, std = command._gain_errors(fit, SimpleNamespace(robot=robot), 0)
    np.testing.assert_allclose(error, [36 / 40 - 1, 2 / 1.6 - 1])
    expected = [np.hypot(2.0 / 40, 0.9 * 0.1 / 0.8), np.hypot(0.2 / 1.6, 1.25 * 0.125)]
    np.testing.assert_allclose(std, expected)
