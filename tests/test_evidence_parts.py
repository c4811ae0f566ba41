"""Evidence by its parts: chunks of time, contacts, grids of shapes, gains and times."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import gap_of, pendulum, swings

from hybrid.diagnosis.evidence import noise_model
from hybrid.diagnosis.evidence.candidates import (
    Candidate,
    Term,
    _axis,
    _grid,
    candidate,
    candidates,
    gain_grid,
    nominal,
    same_columns,
    scale_of,
    usual,
    with_gains,
)
from hybrid.diagnosis.evidence.contacts import Contacts, _Clock, _Stretch, _stretches
from hybrid.diagnosis.evidence.convention import Convention
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.logs import since_first
from hybrid.diagnosis.evidence.noise import (
    Noise,
    autocovariance,
    floored,
    low_frequency_excess,
    noise_bound,
    without_events,
)
from hybrid.diagnosis.evidence.noise_model import (
    NoiseModel,
    _dimensions,
    _flexible,
    _least_noise,
    _ridge,
    estimate_noise,
)
from hybrid.diagnosis.evidence.pool import Pool
from hybrid.diagnosis.evidence.refine import (
    add_shape_derivatives,
    fit_shift,
    gain,
    refine,
    scan_gain,
)
from hybrid.diagnosis.evidence.ripples import ripple_orders
from hybrid.diagnosis.evidence.shapes import Range, fit_shapes, price
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.diagnosis.prior import Prior
from hybrid.effects import Quantity, effect_classes
from hybrid.effects.backlash import Backlash
from hybrid.effects.contact import Contact
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.deadzone import Deadzone
from hybrid.effects.delay import Delay
from hybrid.effects.payload import LinkInertia
from hybrid.effects.presliding import Presliding
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.viscous import Viscous
from hybrid.recording import Recording
from hybrid.signals import autocorrelation_time

# --- contacts -------------------------------------------------------------------------


def test_sums_are_over_the_samples_of_each_chunk():
    number, recording = np.array([3, 3, 4, 3, 4, 6]), np.array([0, 0, 0, 1, 1, 1])
    clock = _Clock.cut(number, recording)
    assert clock.chunk.tolist() == [0, 0, 1, 2, 3, 4]
    assert clock.number.tolist() == [3, 4, 3, 4, 6]
    assert clock.recording.tolist() == [0, 0, 1, 1, 1]
    x = np.arange(12.0).reshape(6, 2)
    found = clock.sums(np.array([0, 1, 3, 5]), x[[0, 1, 3, 5]])
    np.testing.assert_array_equal(found, [[2, 4], [0, 0], [6, 7], [0, 0], [10, 11]])
    square = clock.sums(np.array([4]), np.ones((1, 2, 3)))
    assert square.shape == (5, 2, 3) and square.sum() == square[3].sum() == 6.0


STD = np.array([20.0] * 3 + [2.0] * 3)  # N, N·m: twice the typical gains of a contact


def one_push(pushed, *, chunks=30, strength=1.0, rest=0.0):
    """Products of a force along x in some chunks, of 20 N prior deviation.

    ``rest`` is the share of the squares of each pushed chunk that it does not explain.
    """
    clock = _Clock(np.zeros(0, int), np.arange(chunks) + 5, np.zeros(chunks, int))
    gram, moment, power = (np.zeros((chunks, *x)) for x in ((6, 6), (6,), ()))
    gram[:, 0, 0] = 0.01
    moment[pushed, 0] = 0.01 * strength
    power[pushed] = 0.01 * strength**2 / (1.0 - rest)
    unit = STD[:, None] * STD
    return clock, gram * unit, moment * STD, power, np.zeros(chunks)


def test_the_best_stretch_is_the_one_that_is_pushed_with_its_evidence():
    found = _stretches(*one_push(range(10, 16), strength=50.0))
    best = max(found)
    assert (best.first, best.length, best.recording) == (5 + 10, 6, 0)
    A, b = 1.0 + 400.0 * 0.06, 20.0 * 0.06 * 50.0
    assert best.gain == pytest.approx(0.5 * b**2 / A - 0.5 * np.log(A) - np.log(6))
    # A third of all at most, and eight of each length.
    assert {s.length for s in found} == {2, 3, 4, 6, 8}
    assert all(sum(s.length == k for s in found) == 8 for k in (2, 3, 4, 6, 8))


def test_a_contact_does_not_go_on_where_no_sample_is_used():
    """The last six pushed chunks are followed by a hole of the samples."""
    clock, *sums = one_push(range(10, 16), strength=50.0)
    for x in sums:
        x[16:] = 0.0
    best = max(_stretches(clock, *sums))
    assert (best.first, best.length) == (5 + 10, 6)


@pytest.mark.parametrize(("rest", "is_one"), [(0.0, True), (0.18, True), (0.4, False)])
def test_a_contact_is_most_of_what_happens_meanwhile(rest, is_one):
    """Half of its RMS may be left, as a push by hand is not constant."""
    best = max(_stretches(*one_push(range(10, 16), strength=50.0, rest=rest)))
    assert (best.gain > 0.0) == is_one


def test_a_moment_has_a_prior_of_a_tenth():
    clock, gram, moment, power, count = one_push(range(0))
    gram[:, 5, 5], moment[3:5, 5] = 4.0 * 2.0, 2.0 * 3.0
    power[3:5] = 4.5
    best = max(_stretches(clock, gram, moment, power, count))
    assert (best.first, best.length) == (5 + 3, 2)
    A, b = 1.0 + 4.0 * 4.0, 2.0 * 6.0
    force = 1.0 + 400.0 * 0.02
    expected = 0.5 * b**2 / A - 0.5 * np.log(A) - 0.5 * np.log(force) - np.log(2)
    assert best.gain == pytest.approx(expected)


def test_a_stretch_has_no_hole():
    clock, *sums = one_push(range(10, 14), strength=50.0)
    broken = replace(clock, number=clock.number + (np.arange(30) >= 12))
    best = max(_stretches(broken, *sums))
    assert best.length == 2


@pytest.mark.parametrize(
    ("first", "length", "meets"),
    [(4, 2, True), (2, 2, True), (1, 2, False), (9, 3, True), (10, 3, False)],
)
def test_stretches_meet_where_they_share_a_chunk_or_an_end(first, length, meets):
    one, other = _Stretch(1.0, 4, 5, 0), _Stretch(1.0, first, length, 0)
    assert one.meets(other) == other.meets(one) == meets


def pushed_gap(recordings, *, first=1.0, seconds=0.6, force=30.0):
    """A gap of noise, and a push against the last link in some recordings."""
    gap = gap_of(size=2)
    rng = np.random.default_rng(0)
    left = 0.02 * rng.standard_normal(gap.left.shape)
    push = gap.columns(Contact((0, 1), {"start": 0.0, "duration": 1e6}))
    t = gap.sampled.t
    during = (t >= first - 1e-9) & (t < first + seconds - 1e-9)
    during &= np.isin(gap.trajectory, recordings)
    for j in (0, 1):
        left[:, j] += during * (push[j][:, 0] * force)
    return replace(gap, left=left)


@pytest.mark.parametrize(("recordings", "number"), [([2], 2), ([0, 1, 2, 3], -1)])
def test_a_push_is_found_in_its_recording_or_in_all_of_them(recordings, number):
    gap = pushed_gap(recordings)
    rows = [np.flatnonzero(x) for x in gap.moving.T]
    left = [gap.left[r, j] for j, r in enumerate(rows)]
    found = Contacts(gap, Contact).strongest(left, rows, np.full(2, 0.02**2), 3)
    for best, rise in zip(found[:2], (0.0, 0.5), strict=True):
        values = best.values
        assert values["recording"] == number and best.joints == (0, 1)
        # It is half as strong at both ends of a stretch.
        assert values["start"] + values["duration"] / 2 == pytest.approx(1.3, abs=0.051)
        assert (1 - rise / 2) * values["duration"] == pytest.approx(0.6, abs=0.11)
        assert values["rise"] == rise
    assert (
        len(Contacts(gap, Contact).strongest(left, rows, np.full(2, 0.02**2), 1)) == 2
    )
    none = [0.02 * np.random.default_rng(1).standard_normal(len(x)) for x in left]
    assert Contacts(gap, Contact).strongest(none, rows, np.full(2, 0.02**2), 3) == []


def test_slow_samples_say_nothing_of_a_contact():
    gap = gap_of(size=2)
    v = np.abs(gap.sampled.v)
    np.testing.assert_array_equal(Contacts(gap, Contact)._fast, v > 0.1 * v.max(axis=0))
    assert len(Contacts(gap, Contact)._clocks) == 2
    assert (
        len(Contacts(gap_of(count=1), Contact)._clocks) == 1
    )  # all of it is one recording


# --- candidates -----------------------------------------------------------------------


def test_a_shape_of_whole_numbers_is_tried_at_each_and_others_within_their_range():
    whole = Quantity("k", "", 2.0, 1.0, 4.0, whole=True)
    assert _axis(whole, 7).tolist() == [1.0, 2.0, 3.0, 4.0]
    plain = Quantity("x", "s", 1.0, 0.0, 8.0)
    np.testing.assert_allclose(_axis(plain, 3), [2.0, 4.0, 6.0])
    wide = Quantity("x", "s", 1.0, 0.01, 100.0)
    np.testing.assert_allclose(_axis(wide, 3), [0.1, 1.0, 10.0])


def test_what_a_motion_suggests_is_tried_within_the_range():
    class Suggested(Presliding):
        @classmethod
        def suggested(cls, motions, j):
            return {"distance": 1e9}

    gap = gap_of()
    *grid, last = _grid(Suggested, (0,), gap)
    assert len(grid) == 7
    bounds = Suggested.shapes[0].scaled(gap.scales[0])
    assert last.values["distance"] == bounds.upper
    plain = list(_grid(Presliding, (0,), gap))
    assert len(plain) == 7
    ratio = np.diff(np.log([e.values["distance"] for e in plain]))
    np.testing.assert_allclose(ratio, np.log(bounds.upper / bounds.lower) / 8)


def test_the_usual_effects_are_at_every_joint_and_none_that_is_left_out():
    gap = gap_of(size=2)
    places = [c.place for c in usual(gap)]
    assert ("coulomb", (0,)) in places and ("viscous", (1,)) in places
    assert len(places) == 2 * len({x for x, _ in places})
    less = [c.place for c in usual(gap, without=("coulomb",))]
    assert less == [x for x in places if x[0] != "coulomb"]
    kinds = {x.id for x in effect_classes().values() if x.usual}
    assert {x for x, _ in places} == kinds
    ids = {c.effect.id for c in candidates(gap, without=("coulomb",))}
    assert "coulomb" not in ids and "viscous" in ids


def test_a_prior_is_of_the_numbers_of_the_file_and_of_the_last_joint():
    rubs = replace(pendulum(2), frictionloss=np.array([0.0, 0.7]))
    gap = measure_gap(rubs, swings(2), cutoff=10.0)
    assert candidate(gap, Coulomb((1,))).lower == pytest.approx([-0.7])
    assert candidate(gap, Coulomb((0,))).lower == pytest.approx([0.0])
    known = nominal(rubs)
    assert known.frictionloss is rubs.frictionloss
    assert scale_of(gap, Contact((0, 1))) == gap.scales[1]
    assert candidate(gap, Coulomb((1,))).place == ("coulomb", (1,))
    term = Term(candidate(gap, Coulomb((1,))), np.array([3]))
    assert term.place == ("coulomb", (1,))


def test_bounds_follow_the_shapes_and_stay_where_the_file_sets_them():
    rubs = replace(pendulum(1), frictionloss=np.array([0.7]))
    gap = measure_gap(rubs, swings(1), cutoff=10.0)
    zone = Deadzone((0,), {"onset": 1.0})
    first = candidate(gap, zone)
    later = first.at(zone.at({"onset": 2.0}))
    assert (first.lower, later.lower) == ([0.8], [1.6])
    assert later.std is first.std and later.effect.values["onset"] == 2.0
    dry = candidate(gap, Coulomb((0,)))
    assert dry.at(Coulomb((0,), {"level": 1.0})).lower == pytest.approx([-0.7])
    link = candidate(gap, LinkInertia((0,)))
    assert np.isneginf(link.at(link.effect).lower).all()


def test_gains_are_given_to_effects_but_to_steep_ones():
    wave = with_gains(TorqueRipple((0,), {"periods": 3.0}), [1.0, 2.0])
    assert (wave.values["sine"], wave.values["cosine"]) == (1.0, 2.0)
    play = Backlash((0,), {"half_width": 0.01})
    assert with_gains(play, [1.0]) is play
    gap = gap_of(size=1)
    steep = Candidate(play, np.ones(1), np.zeros(1))
    np.testing.assert_array_equal(steep.fixed_gains(gap), [0.01])
    assert Candidate(wave, np.ones(2), np.zeros(2)).fixed_gains(gap) is None


def test_columns_are_the_same_where_joints_and_values_are():
    x = np.ones((3, 1))
    assert same_columns({0: x, 1: x}, {0: x.copy(), 1: x})
    assert not same_columns({0: x}, {1: x}) and not same_columns({0: x}, {0: x, 1: x})
    assert not same_columns({0: x, 1: x}, {0: x, 1: 2 * x})


# --- the pool -------------------------------------------------------------------------


LIBRARY = ("coulomb", "torque_ripple", "contact", "presliding", "backlash")


def pool_of(gap, library=LIBRARY):
    without = [x for x in effect_classes() if x not in library]
    return Pool(Evidence(gap), without)


def periods(pool, joint=0):
    return [
        t.candidate.effect.values["periods"]
        for t in pool.tried
        if t.place == ("torque_ripple", (joint,))
    ]


def test_ripples_are_added_by_their_strength_once_and_up_to_twenty_four():
    waves = TorqueRipple((0,), {"sine": 2.0, "cosine": 0.0, "periods": 9.0})
    pool = pool_of(gap_of(waves))
    assert periods(pool) == [1.0]
    none = np.zeros(0, dtype=np.intp)
    pool.add_ripples(none, 1)
    assert periods(pool) == [1.0, 9.0]
    pool.add_ripples(none, 1)
    assert periods(pool) == [1.0, 9.0]
    pool.add_ripples(none)
    assert len(periods(pool)) == 4  # two of three are new
    assert pool._ripples(0, range(1, 60))[-1].effect.values["periods"] < 60
    assert len(pool._ripples(0, range(100, 160))) == 24 - 4
    silent = pool_of(gap_of(waves), ("coulomb",))
    silent.add_ripples(none)
    assert periods(silent) == [] and silent._ripples(0, [1]) == []


def test_contacts_are_added_once_and_only_where_the_library_has_them():
    gap = pushed_gap([2])
    pool = pool_of(gap, ("coulomb", "contact"))
    before, none = len(pool.tried), np.zeros(0, dtype=np.intp)
    pool.evidence.noise[:] = 0.02**2
    pool.add_contacts(none)
    added = pool.tried[before:]
    assert 1 <= len(added) <= 2 and {t.place for t in added} == {("contact", (0, 1))}
    pool.add_contacts(none)
    assert len(pool.tried) == before + len(added)
    without = pool_of(gap, ("coulomb",))
    without.add_contacts(none)
    assert len(without.tried) == before


def test_shapes_that_do_not_change_the_columns_are_tried_once():
    pool = pool_of(gap_of())
    shapes = candidates(pool.gap, pool.without)
    assert len([t for t in pool.tried if t.place[0] == "presliding"]) == 7
    assert len(pool.tried) == len(shapes) + 1  # and the ripple of order one
    before = len(pool.tried)
    pool._add([shapes[0], shapes[0]])
    assert len(pool.tried) == before + 1


def test_candidates_are_ranked_by_what_they_gain_less_their_price():
    pool = pool_of(gap_of(Coulomb((0,), {"level": 1.0})))
    pool.evidence.noise[:] = 0.02**2
    base = np.zeros(0, dtype=np.intp)
    ranked = pool.ranked(base)
    worths = [x for _, x in ranked]
    assert worths == sorted(worths, reverse=True)
    assert len({c.place for c, _ in ranked}) == len(ranked)
    (dry,) = [(c, x) for c, x in ranked if c.place[0] == "coulomb"]
    assert dry[1] == pytest.approx(gain(pool.evidence, base, dry[0]))
    best = max(
        gain(pool.evidence, base, t.candidate)
        for t in pool.tried
        if t.place[0] == "presliding"
    )
    (bristles,) = [x for c, x in ranked if c.place[0] == "presliding"]
    assert bristles == pytest.approx(best)
    less = pool.ranked(base, taken=[("coulomb", (0,))])
    assert ("coulomb", (0,)) not in {c.place for c, _ in less}
    assert len(less) == len(ranked) - 1


def best_of_grid(evidence, finer):
    """The best play of a grid of widths, which is finer than that of the search."""
    none = np.zeros(0, dtype=np.intp)
    grid = gain_grid(Backlash.gains[0].scaled(evidence.gap.scales[0]))
    fine = np.geomspace(grid[0], grid[-1], finer * (len(grid) - 1) + 1)
    each = [candidate(evidence.gap, Backlash((0,), {"half_width": x})) for x in fine]
    return max(each, key=lambda c: gain(evidence, none, c))


# --- fits of shapes and gains ---------------------------------------------------------


def test_a_shape_is_fitted_and_a_candidate_is_worth_what_it_adds():
    true = Presliding((0,), {"level": 1.0, "distance": 0.05})
    evidence, none = Evidence(gap_of(true)), np.zeros(0, dtype=np.intp)
    evidence.noise[:] = 0.02**2 / 5.0
    start = candidate(evidence.gap, true.at({"distance": 0.04}))
    found, worth = refine(evidence, none, start)
    assert found.effect.values["distance"] == pytest.approx(0.05, rel=0.03)
    assert worth == pytest.approx(gain(evidence, none, found))
    assert worth > gain(evidence, none, start)
    exact = gain(evidence, none, replace(start, effect=true))
    assert worth >= exact - 0.5
    columns = evidence.gap.columns(found.effect)
    trial = evidence.trial(none, columns, found.std, found.lower)
    assert gain(evidence, none, found) == pytest.approx(trial.worth - price(true))
    assert found.prior_factor == trial.prior_factor


def test_the_width_of_play_is_scanned_between_those_of_the_grid():
    gap = gap_of(Coulomb((0,), {"level": 0.3}))
    evidence, none = Evidence(gap), np.zeros(0, dtype=np.intp)
    evidence.noise[:] = 0.02**2
    coarse, fine = (best_of_grid(evidence, finer) for finer in (1, 8))
    found = scan_gain(evidence, none, coarse)
    assert gain(evidence, none, found) >= gain(evidence, none, fine) - 0.1
    below, above, *_ = gain_grid(Backlash.gains[0].scaled(gap.scales[0]))
    ratio = found.effect.values["half_width"] / coarse.effect.values["half_width"]
    assert below / above < ratio < above / below
    refined, worth = refine(evidence, none, coarse)
    assert worth == pytest.approx(gain(evidence, none, refined))
    assert worth >= gain(evidence, none, found) - 1e-9


def late_evidence(late):
    logs = []
    for m in swings():
        tau = np.interp(m.t - late, m.t, m.tau[:, 0])[:, None]
        logs.append(replace(m, tau=tau))
    evidence = Evidence(measure_gap(pendulum(), logs, cutoff=10.0))
    evidence.noise[:] = 0.01
    return evidence


@pytest.mark.parametrize(
    ("late", "start", "found"),
    [(0.02, 0.012, 0.02), (0.02, 0.008, 0.016), (0.02, 0.05, 0.025)],
)
def test_a_time_is_sought_from_half_to_twice_its_own(late, start, found):
    evidence, none = late_evidence(late), np.zeros(0, dtype=np.intp)
    shifted = fit_shift(evidence, none, Delay((0,), {"time": start}))
    assert shifted.values["time"] == pytest.approx(found, rel=0.03)


def test_a_shape_has_its_derivative_among_the_columns():
    evidence = Evidence(gap_of())
    law = Stribeck((0,), {"level": 1.0, "velocity": 0.3})
    index = add_shape_derivatives(evidence, law)
    assert index.tolist() == [0, 1]
    np.testing.assert_allclose(evidence.precision, 0.3**-2.0)
    assert add_shape_derivatives(evidence, Coulomb((0,))).shape == (0,)
    assert evidence.size == 2


def test_a_search_of_one_shape_stays_within_a_fifth_of_its_range():
    gap = gap_of()
    law = Presliding((0,), {"level": 1.0, "distance": 0.02})
    bounds = Range(Presliding.shapes[0].scaled(gap.scales[0]))
    own = bounds.normalised(0.02)
    for way, end in ((1.0, own + 0.2), (-1.0, own - 0.2)):
        best, worth = fit_shapes(law, lambda e, w=way: w * e.values["distance"], gap)
        found = bounds.normalised(best.values["distance"])
        assert found == pytest.approx(min(max(end, 0.0), 1.0), abs=0.01)
        assert worth == way * best.values["distance"]


# --- noise ----------------------------------------------------------------------------


def test_an_autoregressive_process_is_whitened_by_its_last_sample():
    """Covariance ρᵏ: each sample less ρ times the one before, over √(1 − ρ²)."""
    rho, follows = 0.6, np.array([False, True, True, False, True])
    noise = Noise(4.0 * rho ** np.arange(4.0), follows)
    x = np.array([2.0, 1.0, -1.0, 6.0, 4.0])
    own = 2.0 * np.sqrt(1 - rho**2)
    expected = [1.0, (1 - 1.2) / own, (-1 - 0.6) / own, 3.0, (4 - 3.6) / own]
    np.testing.assert_allclose(noise.whiten(x), expected, atol=1e-12)


def test_an_autocovariance_knows_of_holes():
    x, row = np.array([1.0, 2.0, 3.0, 4.0]), np.array([10, 11, 13, 14])
    # Lag 1: 1·2 and 3·4; lag 2: 2·3; lag 3: 1·3 and 2·4; over four samples.
    np.testing.assert_allclose(
        autocovariance(x, row, 3), [30 / 4, 14 / 4, 6 / 4, 11 / 4]
    )


def test_a_floor_is_the_mean_density_of_the_upper_half_of_the_band():
    white = np.array([2.0, 0.0, 0.0])
    np.testing.assert_allclose(floored(white, 0.2), [4.0, 0.0, 0.0])
    some = np.array([2.0, 1.0])
    f = 0.2 * np.linspace(0.5, 0.85, 20)
    more = np.mean(2.0 + 2 * 0.5 * np.cos(2 * np.pi * f))
    np.testing.assert_allclose(floored(some, 0.2), [2.0 + more, 1.0])
    # Where there is none, a millionth remains.
    slow = np.cos(np.zeros(2))
    assert floored(slow * [1.0, -1.0], 0.1)[0] == pytest.approx(1.0 + 1e-6, rel=0.5)


def test_of_a_residual_without_noise_all_numbers_are_finite():
    assert floored(np.zeros(3), 0.2)[0] > 0.0
    gap = gap_of(count=2)
    still = replace(gap, left=np.zeros_like(gap.left))
    evidence = Evidence(still)
    (index,) = evidence.add([gap.columns(Viscous((0,)))], [np.ones(1)])
    estimate_noise(evidence, index)
    assert np.isfinite(evidence.covariances[0]).all() and evidence.noise[0] > 0.0


def test_an_event_is_eight_times_the_usual_power_of_half_a_second():
    row = np.arange(100)
    for times, kept in ((7.9, True), (8.1, False)):
        x = np.ones(100)
        x[20:25] = np.sqrt(times)
        assert without_events(x, row, 10.0)[20:25].all() == kept
        assert without_events(x, row, 10.0)[:20].all()
    assert without_events(np.zeros(0), np.zeros(0, int), 10.0).shape == (0,)


def test_squares_beyond_noise_are_those_of_the_lower_half_of_the_band():
    """Tones on lines of the spectrum: what each has is known."""
    row, t = np.arange(1000), np.arange(1000) / 100.0
    low, high = np.sin(2 * np.pi * 3.0 * t), np.sin(2 * np.pi * 14.0 * t)
    # Half of 20 Hz has 100 lines, from there to 85 % are 70.
    found = low_frequency_excess(2.0 * low + high, row, 100.0, 20.0)
    assert found == pytest.approx(4.0 * 500.0 - 100 * 500.0 / 70.0)
    beyond = np.sin(2 * np.pi * 18.0 * t)  # 0.9 of the cut-off
    assert low_frequency_excess(low + beyond, row, 100.0, 20.0) == pytest.approx(500.0)
    bound = noise_bound(2.0 * low + high, row, 100.0, 20.0)
    assert bound == pytest.approx(200 * 500.0 / 70.0 / 1000.0)
    assert low_frequency_excess(low[:3], row[:3], 100.0, 20.0) == 0.0
    assert noise_bound(low[:3], row[:3], 100.0, 20.0) == 0.0
    constant = low_frequency_excess(np.ones(1000), row, 100.0, 20.0)
    assert constant == pytest.approx(1000.0)


def test_samples_of_a_band_count_by_its_width():
    def evidence(samples, cutoff, rate):
        gap = SimpleNamespace(cutoff=cutoff, rate=rate)
        return SimpleNamespace(rows=[np.arange(samples)], gap=gap)

    assert _dimensions(evidence(100, 10.0, 50.0), 0) == pytest.approx(40.0)
    assert _dimensions(evidence(100, 40.0, 50.0), 0) == 100.0
    assert _dimensions(evidence(1, 1.0, 50.0), 0) == 1.0


def test_two_simulators_differ_by_two_thousandths_of_the_torque():
    measured = np.array([[3.0], [-4.0], [99.0]])
    gap = SimpleNamespace(measured=measured)
    evidence = SimpleNamespace(rows=[np.array([0, 1])], gap=gap)
    assert _least_noise(evidence, 0, 5.0) == pytest.approx(0.002**2 * 12.5 * 5.0)
    gap.measured = np.zeros((3, 1))
    assert _least_noise(evidence, 0, 5.0) == 1e-12


def test_a_ridge_is_added_to_the_diagonal():
    A, b = np.array([[4.0, 1.0], [1.0, 3.0]]), np.array([1.0, 2.0])
    expected = np.linalg.solve(A + 0.5 * np.eye(2), b)
    np.testing.assert_allclose(_ridge(A.copy(), b, 0.5), expected)


def test_errors_of_laws_and_simulators_are_parts_of_the_gap_and_of_the_torque():
    """White signals, which are their own memory."""
    rng = np.random.default_rng(1)
    left = rng.standard_normal((400, 1))
    measured = 50.0 + 20.0 * rng.standard_normal((400, 1))
    gap = SimpleNamespace(
        robot=SimpleNamespace(size=1), left=left, moving=np.ones((400, 1), dtype=bool),
        measured=measured, fold=np.arange(400) // 100, rate=100.0, cutoff=50.0,
        trajectory=np.zeros(400, dtype=int), subtracted=None,
    )  # fmt: skip
    evidence = Evidence(gap)
    evidence.noise[:] = 0.5
    evidence.covariances = [np.r_[0.5, np.zeros(16)]]
    none = np.zeros(0, dtype=np.intp)
    found = []
    for subtracted in (None, 3.0 * rng.standard_normal((400, 1))):
        gap.subtracted = subtracted
        model = NoiseModel(evidence, Prior())
        model.measured[:] = 0.5
        model.apply(none)
        found.append(evidence.noise[0])
        assert model.covariances[0].shape == (17,)
        errors = 0.03**2 * autocovariance(left[:, 0], np.arange(400), 16)
        if subtracted is not None:
            more = autocovariance(subtracted[:, 0], np.arange(400), 16)
            errors = errors + 0.1**2 * more
        whole = evidence.covariances[0] + errors
        torque = measured[:, 0] - measured.mean()
        memory = autocorrelation_time(torque, np.arange(400))
        whole[0] += errors[0] + 0.002**2 * np.mean(torque**2) * memory
        np.testing.assert_allclose(model.covariances[0], floored(whole, 0.5))
    law, solver = 0.03**2 * np.mean(left**2), 0.002**2 * np.var(measured)
    assert found[0] == pytest.approx(0.5 + law + solver, rel=5e-3)
    real = 0.1**2 * np.mean(gap.subtracted**2)
    assert found[1] - found[0] == pytest.approx(real, rel=0.4)
    assert evidence.covariances[0][0] == 0.5  # as it was estimated


def test_errors_of_a_large_gap_do_not_hide_a_small_cause_in_other_recordings():
    """A law acts in one recording only, and a small one in both."""
    rng = np.random.default_rng(3)
    recording = np.repeat([0, 1], 400)
    large = 100.0 * rng.standard_normal(800) * (recording == 0)
    small = rng.standard_normal(800)
    left = (large + 0.5 * small + 0.1 * rng.standard_normal(800))[:, None]
    gap = SimpleNamespace(
        robot=SimpleNamespace(size=1), left=left, measured=left, subtracted=None,
        moving=np.ones((800, 1), dtype=bool), fold=np.arange(800) // 100,
        trajectory=recording, rate=100.0, cutoff=50.0,
    )  # fmt: skip
    evidence = Evidence(gap)
    columns = [{0: x[:, None]} for x in (large, small)]
    one, other = evidence.add(columns, [np.ones(1), np.ones(1)])
    evidence.noise[:] = 0.1**2
    evidence.covariances = [np.r_[0.1**2, np.zeros(16)]]
    model = NoiseModel(evidence, Prior())
    model.apply(np.zeros(0, dtype=np.intp))

    def worth():
        both = evidence.solve(np.concatenate([one, other])).evidence
        return both - evidence.solve(one).evidence

    law, solver = (x**2 * np.mean(left**2) for x in (0.03, 0.002))
    usual = 0.1**2 + 2 * law + solver
    here = [0.1**2 + solver + 2 * 0.03**2 * np.mean(left[recording == k] ** 2)
            for k in (0, 1)]  # fmt: skip
    expected = np.sqrt(here / usual)[recording, None]
    np.testing.assert_allclose(model.sizes, expected, rtol=0.02)
    assert worth() > 100.0
    evidence.set_covariances(model.covariances)  # the same noise in both
    assert worth() < 20.0


def lowered(rng, std, fitted):
    """Noise variance that some columns of noise leave of white noise of one."""
    count = 400
    left = rng.standard_normal((count, 1))
    gap = SimpleNamespace(
        robot=SimpleNamespace(size=1), left=left, measured=left, subtracted=None,
        moving=np.ones((count, 1), dtype=bool), fold=np.arange(count) // 50,
        trajectory=np.zeros(count, dtype=int), rate=100.0, cutoff=50.0,
    )  # fmt: skip
    evidence = Evidence(gap)
    X = rng.standard_normal((count, fitted))
    (index,) = evidence.add([{0: X}], [np.full(fitted, std)])
    evidence.covariances = [np.r_[9.0, np.zeros(16)]]
    evidence.noise[:] = 9.0
    none = np.zeros(0, dtype=np.intp)
    model = NoiseModel(evidence, Prior())
    model.apply(none)
    model.lower(none, index)
    return evidence.covariances[0][0]


@pytest.mark.parametrize(("std", "fitted"), [(1e3, 160), (1e3, 80), (1e-6, 160)])
def test_noise_is_what_is_left_for_each_sample_that_no_gain_fits(std, fitted):
    """Gains of flat priors fit a sample each, those of narrow ones none."""
    rng = np.random.default_rng(2)
    found = [lowered(rng, std, fitted) for _ in range(10)]
    assert np.mean(found) == pytest.approx(1.0, abs=0.1)


def test_noise_is_not_lower_where_gains_fit_nearly_every_sample():
    rng = np.random.default_rng(3)
    assert min(lowered(rng, 1e3, 345) for _ in range(5)) > 1.0


# --- ripples, conventions and clocks --------------------------------------------------


def test_waves_that_the_filter_stops_are_no_orders():
    q = np.linspace(0.0, 40.0, 6000)
    v = np.full(6000, 2 * np.pi)  # one turn a second: order k has k Hz
    left = np.sin(30 * q) + 0.5 * np.sin(12 * q)
    assert ripple_orders(left, q, v, 100.0, 2).tolist() == [30, 12]
    assert ripple_orders(left, q, v, 100.0, 1).tolist() == [30]
    assert ripple_orders(left, q, v, 14.0, 1).tolist() == [12]
    weak = np.sin(30 * q) + 0.1 * np.sin(12 * q)
    assert ripple_orders(weak, q, v, 100.0, 40).tolist()[0] == 30
    # Beside a peak no order is one, however strong.
    found = ripple_orders(np.sin(30.4 * q), q, v, 100.0, 5).tolist()
    assert 30 in found and 31 not in found


def test_a_convention_is_told_in_milliseconds():
    assert not Convention() and Convention().notes == ()
    assert Convention(late=0.004) and Convention(step=0.002)
    (late,) = Convention(late=0.004).notes
    assert late == (
        "torque is logged 4 ms late at every joint, as by a simulation that steps "
        "before it logs: corrected"
    )
    (step,) = Convention(step=0.002).notes
    assert "implicit step of 2 ms: corrected" in step
    both = Convention(late=0.03, step=0.002, std=1e-4)
    assert both.clocks and "all other results are for the log without" in both.notes[0]
    assert "logged 30 ms late" in both.notes[0] and len(both.notes) == 2


def test_a_log_is_shifted_by_its_delay_and_its_command_with_it():
    t = np.arange(0.0, 1.0, 0.01)
    x = np.stack([t, 2 * t], axis=1)
    log = Recording(t, x, tau=3 * x, command=4 * x, joints=("a", "b"))
    moved = Convention(late=0.025).shift(log)
    inner = t < 0.96
    np.testing.assert_allclose(moved.tau[inner], 3 * (x + [0.025, 0.05])[inner])
    np.testing.assert_allclose(moved.command[inner], 4 * (x + [0.025, 0.05])[inner])
    np.testing.assert_array_equal(moved.tau[-2:], log.tau[-2:])
    np.testing.assert_array_equal(moved.q, log.q)
    clocks = Convention(late=0.025, std=1e-3).shift(log)
    np.testing.assert_array_equal(clocks.command, log.command)
    np.testing.assert_allclose(clocks.tau, moved.tau)
    assert Convention(step=0.01).shift(log) is log
    bare = Convention(late=0.025).shift(replace(log, command=None))
    assert bare.command is None


def test_a_motion_is_corrected_for_damping_speed_and_what_is_missing_at_its_end():
    robot = replace(pendulum(), kd=np.array([3.0]), kp=np.array([10.0]))
    (m, *_) = swings(count=1)
    mask = np.ones(len(m.t), dtype=bool)
    mask[100] = False
    m = replace(m, mask=mask)
    found = Convention(late=0.025, step=0.01).correct(robot, m)
    np.testing.assert_allclose(found.tau, m.tau - 0.01 * 3.0 * m.a)
    np.testing.assert_allclose(found.v, m.v + 0.0125 * m.a)
    # 2.5 samples at 100 Hz: three are missing, and what they reach is masked.
    lost = np.flatnonzero(~found.mask).tolist()
    assert lost == [97, 100, *range(len(m.t) - 3, len(m.t))]
    clocks = Convention(late=0.025, step=0.01, std=1e-3).correct(robot, m)
    np.testing.assert_allclose(clocks.v, m.v + 0.005 * m.a)
    free = Convention(step=0.01).correct(replace(robot, kd=np.array([np.nan])), m)
    np.testing.assert_array_equal(free.tau, m.tau)
    np.testing.assert_array_equal(free.mask, mask)


def test_time_begins_with_the_first_recording():
    (m, *_) = swings(count=1)
    logs = [replace(m, t=m.t + x) for x in (7.0, 5.0, 11.0)]
    starts = [x.t[0] for x in since_first(logs)]
    assert starts == pytest.approx([2.0, 0.0, 6.0]) and since_first([]) == []


def test_gains_of_a_kept_evidence_are_of_its_columns():
    """A prior that is set anew is forgotten by no factor that was kept."""
    rng = np.random.default_rng(2)
    gap = gap_of(Viscous((0,), {"coefficient": 0.5}))
    evidence = Evidence(gap)
    drag, rest = evidence.add(
        [gap.columns(Viscous((0,))), gap.columns(TorqueOffset((0,)))],
        [np.ones(1), np.zeros(1)],
    )
    assert evidence.precision.tolist() == [1.0, 1e24]
    columns = {0: rng.standard_normal((len(gap.left), 1))}
    ask = columns, np.ones(1), np.array([-np.inf])
    before = evidence.trial(drag, *ask)
    evidence.scale_prior(drag, 1e-6)
    after = evidence.trial(drag, *ask)
    fresh = Evidence(gap)
    fresh.add([gap.columns(Viscous((0,)))], [np.array([1e-6])])
    assert after.worth == pytest.approx(fresh.trial(drag, *ask).worth)
    assert abs(after.worth - before.worth) > 0.1
    evidence.scale_prior(drag, 2.0)
    assert evidence.precision[0] == pytest.approx(0.25)
    solved = evidence.solve(np.concatenate([drag, rest]))
    assert evidence.prior_squares(solved, drag) == pytest.approx(
        solved.gains[0] ** 2 / 4.0
    )
    assert evidence.add([], []) == []


def test_a_flexible_fit_leaves_more_than_it_shows_by_its_degrees_of_freedom(
    monkeypatch,
):
    """Of orthonormal columns a ridge takes 1/(1 + ridge) of a degree each."""
    monkeypatch.setattr(noise_model, "_RIDGES", (0.25,))
    rng = np.random.default_rng(0)
    columns = np.linalg.qr(rng.normal(size=(40, 5)))[0].T
    gap = rng.normal(size=40)
    evidence = SimpleNamespace(
        base_columns=lambda *_: (None, columns),
        left=[gap],
        fold_edges=lambda _: [(0, 20), (20, 40)],
        rows=[np.arange(40)],
        gap=SimpleNamespace(cutoff=25.0, rate=100.0),
    )
    left, _, _ = _flexible(evidence, 0, np.arange(5))
    shown = gap - columns.T @ (columns @ gap) / 1.25
    np.testing.assert_allclose(left, shown / (1.0 - (5 / 1.25) / 20.0), rtol=1e-9)
