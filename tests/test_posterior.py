"""The score of explanations and the moves of their search, on exact pendulums."""

import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import NOISE, gap_of, pendulum, swings, with_torque

from hybrid.diagnosis.answer import fixed
from hybrid.diagnosis.answer.findings import fitted_values
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.noise import floored, whitened_power
from hybrid.diagnosis.evidence.noise_model import NoiseModel
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.explanations.belief import Belief, beliefs
from hybrid.diagnosis.explanations.explanation import explain, shares
from hybrid.diagnosis.explanations.posterior import Posterior
from hybrid.diagnosis.explanations.refit import (
    _profile_range,
    _reported,
    _set_noise_of_residual,
    refit,
    solve_all,
)
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.measure import measure_gap, split
from hybrid.effects import effect_classes
from hybrid.effects.contact import Contact
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.payload import Payload
from hybrid.effects.presliding import Presliding
from hybrid.effects.saturation import Saturation
from hybrid.effects.spring import Spring
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.effects.viscous import Viscous

RUBS, DRAGS = Coulomb((0,), {"level": 1.0}), Viscous((0,), {"coefficient": 0.8})
ASKEW = TorqueOffset((0,), {"level": -1.0})
SLIPS = Stribeck((0,), {"level": 1.0, "velocity": 0.5})
BOTH = (RUBS, Coulomb((1,), {"level": 0.7}))
BRISTLES = Presliding((0,), {"level": 1.0, "distance": 0.05})
LARGE = TorqueOffset((1,), {"level": 5.0})
FEW = ("coulomb", "viscous", "torque_offset")
CAUSE = 7.0  # nats, odds against a cause at a place


def search(*effects, size=1, library=FEW):
    """A search that has not run, with a small library."""
    known = gap_of(*effects, size=size)
    return Search(
        known, split(known), [x for x in effect_classes() if x not in library]
    )


def cause(at, effect):
    return at.cause(candidate(at.gap, effect))


def places(at):
    return {c.place for c in at.causes}


@pytest.mark.parametrize(
    ("effects", "size"), [((RUBS, ASKEW), 1), ((RUBS, DRAGS, ASKEW), 1), (BOTH, 2)]
)
def test_all_causes_of_a_gap_are_found_and_no_other(effects, size):
    at = search(*effects, size=size)
    found = at.run()
    assert places(at) == {(e.id, e.joints) for e in effects}
    assert at.whole == found == at.known
    assert [b.cause for b in at.beliefs] == found
    assert all(b.probability > 0.9 and b.worth > 10 for b in at.beliefs)
    # It is at its best: nothing is worth adding, and nothing can be spared.
    now = at.score(found)
    assert all(x.worth < 0.5 for x in at.proposals(found))
    for own in found:
        assert at.score([c for c in found if c is not own]) < now


@pytest.mark.study
def test_a_sound_arm_has_no_cause():
    at = search()
    assert at.run() == [] and at.beliefs == [] and at.whole == []


@pytest.mark.parametrize("effects", [(), (RUBS,), (DRAGS,)])
def test_what_may_be_added_raises_the_score_by_what_it_promises(effects):
    at = search(*BOTH, size=2)
    at.causes = [cause(at, e) for e in effects]
    now, found = at.score(at.causes), at.proposals(at.causes)
    assert [x.worth for x in found] == sorted((x.worth for x in found), reverse=True)
    for x in found:
        gained = at.score([*at.causes, x.cause]) - now
        if x.candidate is None:  # less what a rough law leaves out
            assert gained >= x.worth - 1e-6
        else:
            assert gained == pytest.approx(x.worth, abs=1e-6)
            assert x.place not in places(at)


def test_the_cause_of_a_candidate_is_made_once():
    at = search(RUBS)
    size = at.evidence.size
    made = cause(at, RUBS)
    assert cause(at, RUBS) is made and at.evidence.size == size + 1
    wide = at.cause(replace(made.candidate, prior_factor=10.0))
    assert wide is not made and wide.cost == pytest.approx(made.cost + np.log(10.0))


def test_friction_that_drives_is_no_cause():
    """A prior that ends at zero is twice as dense above it."""
    for level, sign in ((0.5, 1.0), (-0.5, -1.0)):
        at = search(Coulomb((0,), {"level": level}))
        rubs = cause(at, RUBS)
        one, none = (at.evidence.solve(at.columns(x)) for x in ([rubs], []))
        assert one.of(rubs.index) == pytest.approx(level, rel=0.02)
        gained = at.score([rubs]) - at.score([]) + at.odds(rubs)
        unbounded = one.evidence - none.evidence
        assert unbounded > 100.0
        if sign > 0:
            assert gained == pytest.approx(unbounded + np.log(2.0))
        else:
            assert gained < 10.0


def test_an_effect_at_every_joint_is_as_probable_as_one_and_then_at_each_or_not():
    """The prior of all: that of one cause, and two possibilities for each joint."""
    at = search(*BOTH, size=2)
    causes = [cause(at, e) for e in BOTH]
    cost = sum(CAUSE + price(e) for e in BOTH)
    saved = cost - (CAUSE + 2 * np.log(2.0))
    assert at.kind_discount(causes) == pytest.approx(saved)
    assert at.kind_discount(causes[:1]) == 0.0
    assert at.kind_discount([causes[0], cause(at, DRAGS)]) == 0.0
    assert at.kind_discount([*causes, causes[0]]) == pytest.approx(saved)


def test_a_coupling_has_one_place_fewer_than_joints_and_an_arm_one():
    """All kinds are as probable: each of few places is more so."""
    at = search(*BOTH, size=3)
    one, every = zip(
        *(
            at._kind_odds(at._places(x))
            for x in (Coulomb, TransmissionCoupling, Payload)
        ),
        strict=True,
    )
    assert one == pytest.approx([CAUSE, CAUSE + np.log(2 / 3), CAUSE - np.log(3)])
    assert every == pytest.approx([CAUSE + k * np.log(2.0) for k in (3, 2, 1)])


def test_what_a_term_is_worth_is_the_evidence_lost_without_it():
    at = search(RUBS, ASKEW)
    at.causes = [cause(at, RUBS), cause(at, ASKEW)]
    for k, term in enumerate(at.terms):
        rest = [c for c in at.causes if c is not at.causes[k]]
        fall = at.score(at.causes) - at.score(rest)
        lost = fall + at.odds(at.causes[k]) - price(term.candidate.effect)
        bounded = np.log(2.0) * (term.candidate.effect.id == "coulomb")
        assert at.loss(term) == pytest.approx(lost - bounded)
        assert at.placed(term) == (term.place[0], "hinge_0")
    assert len(at.base()) == len(at.rigid) + 2


def test_each_kind_is_as_probable_as_any_other_whatever_its_places():
    """Friction of each joint, a payload of the arm, and a coupling of neighbours."""
    at = search(RUBS, size=4)
    laws = RUBS, Payload((0, 1, 2, 3)), TransmissionCoupling((0, 1))
    costs = [cause(at, x).cost - price(x) for x in laws]
    places = [len(list(type(x).places(4))) for x in laws]
    assert places == [4, 1, 3]
    odds = np.exp(-np.array(costs)) * places
    np.testing.assert_allclose(odds, 4 * np.exp(-CAUSE))


def test_a_prior_of_another_size_costs_the_logarithm_of_how_far_off_it_is():
    at = search(RUBS)
    usual = candidate(at.gap, RUBS)
    tenth, one, ten = (
        at.cause(replace(usual, prior_factor=w)) for w in (0.1, 1.0, 10.0)
    )
    assert ten.cost - one.cost == pytest.approx(np.log(10.0))
    assert tenth.cost == pytest.approx(ten.cost)
    assert one.cost == pytest.approx(CAUSE + price(RUBS))
    std = at.evidence.precision[[one.index[0], ten.index[0]]] ** -0.5
    assert std[1] / std[0] == pytest.approx(10.0)


def test_no_law_is_worth_more_than_it_is_inexact_by():
    """A law that is off by 3 % leaves 9e-4 of its squares, and an unknown one 0.01."""
    at = search(RUBS)
    whole = (
        at.evidence.weighted_squares(at.rigid, at.evidence.solve(at.rigid).gains)[0] / 2
    )
    known, law = cause(at, DRAGS), at.laws.all[0]
    assert at.model_error_odds(known) == pytest.approx(9e-4 * whole, rel=1e-6)
    assert at.model_error_odds(law) == pytest.approx(0.01 * whole, rel=1e-6)
    assert at.odds(known) == pytest.approx(known.cost + at.model_error_odds(known))


def test_a_cause_gives_way_to_what_explains_more_in_its_place():
    at = search(RUBS)
    wrong = cause(at, DRAGS)
    at.causes = [wrong]
    assert at._exchange(wrong)
    assert places(at) == {("coulomb", (0,))}
    (right,) = at.causes
    assert not at._exchange(right) and at.causes == [right]


def test_a_cause_that_explains_nothing_gives_way_to_nothing():
    at = search(RUBS)
    spare = cause(at, ASKEW)
    at.causes = [cause(at, RUBS), spare]
    assert at._exchange(spare) and places(at) == {("coulomb", (0,))}
    at.causes = [cause(at, RUBS), cause(at, ASKEW), cause(at, DRAGS)]
    at._remove()
    assert places(at) == {("coulomb", (0,))}


def test_an_effect_is_at_a_place_once_and_what_repeats_a_few_times():
    at = search(RUBS, library=(*FEW, "contact"))
    at.causes = [cause(at, RUBS)]
    ranked = at.ranked(at.columns(at.causes))
    assert {"viscous", "torque_offset"} <= {c.place[0] for c, _ in ranked}
    assert ("coulomb", (0,)) not in {c.place for c, _ in ranked}
    assert ("coulomb", (0,)) in {c.place for c, _ in at.ranked(at.rigid)}
    contact = replace(at.causes[0], place=("contact", (0,)))
    ripple = replace(at.causes[0], place=("torque_ripple", (0,)))
    for often, most in ((ripple, 3), (contact, 3 * len(at.gap.motions))):
        few, many = ([often] * k for k in (most - 1, most))
        assert at.taken(few) == set() and at.taken(many) == {often.place}


def test_a_law_that_no_library_has_is_unknown_and_its_stand_ins_are_known():
    at = search(SLIPS, library=("viscous", "torque_offset"))
    at.run()
    (law,) = at.causes
    assert law.candidate is None and law.place[1] == (0,)
    assert at.known == [] and at.terms == [] and len(at.background) > len(at.rigid)
    before = at.score([])
    at.substitute_unknown_laws()
    assert all(c.candidate is not None for c in at.causes)
    assert at.score(at.causes) >= before
    assert at.whole == [law]


def test_a_law_is_never_the_same_twice_and_there_are_few_at_a_joint():
    at = search(SLIPS)
    laws = at.laws.all
    assert len({x.place for x in laws}) == len(laws) > 10
    assert at.laws.open([]) == laws
    assert laws[0] not in at.laws.open(laws[:1])
    assert len(at.laws.open(laws[:2])) == len(laws) - 2
    assert at.laws.open(laws[:3]) == []
    assert at.laws.open([cause(at, e) for e in (RUBS, DRAGS, ASKEW)]) == laws


def test_the_columns_of_a_law_are_those_that_its_evidence_is_of():
    at = search(SLIPS)
    for law in at.laws.all:
        columns = at.columns_of(law)
        again = at.evidence.trial(
            at.rigid,
            columns,
            at.evidence.precision[law.index] ** -0.5,
            np.full(len(law.index), -np.inf),
        )
        kept = at.evidence.solve(np.concatenate([at.rigid, law.index])).evidence
        assert again.worth >= kept - at.evidence.solve(at.rigid).evidence - 1e-6


def test_an_unknown_law_is_three_percent_of_the_rated_torque_at_nine_nats():
    """And a line among many at those of its choice besides: three waves of a law."""
    at = search(SLIPS)
    (rows,), (scale,) = at.evidence.rows, at.gap.scales
    picked = set()
    for law in at.laws.all:
        std = at.evidence.precision[law.index] ** -0.5
        torque = at.laws.columns(law)[0][rows] * std
        rms = np.sqrt(np.mean(np.sum(torque**2, axis=1)))
        assert rms == pytest.approx(0.03 * scale.torque)
        assert law.rough == 0.1
        if law.cost != 9.0:
            assert law.cost == pytest.approx(9.0 + 3 * np.log(len(rows)))
            picked.add(law.place[0])
    assert picked == {x for x, _ in at.laws._waves} != set()


def test_an_unknown_law_is_as_strong_as_it_has_to_be_at_a_cost():
    """Its size is a guess: where it is far stronger or weaker, so is its prior."""
    ratios = []
    for level in (1.0, 5.0, 50.0):
        effect = SLIPS.at({"level": level})
        at = search(effect)
        (law,) = (x for x in at.laws.all if x.place[0] == "speed")
        wide = at.laws.widened(at.rigid, law)
        std = [at.evidence.precision[x.index[0]] ** -0.5 for x in (law, wide)]
        ratios.append(std[1] / std[0])
        odds = abs(np.log(ratios[-1]))
        assert wide.cost - law.cost == pytest.approx(odds)
        assert (wide is law) == (odds == 0.0)
        scores = [at.score([x]) for x in (law, wide)]
        assert scores[1] >= scores[0] - 1e-9
    assert ratios == pytest.approx([0.1, 1.0, 10.0])


def test_numbers_of_a_file_that_are_farther_off_are_less_probable():
    at = search(*BOTH, size=2)
    assert at.file_error_odds(0.02) == 0.0
    # A factor of two is one deviation.
    assert at.file_error_odds(0.01) == pytest.approx(0.5)
    links = CAUSE + 2 * np.log(2.0)  # each of both may be another one then
    assert at.file_error_odds(0.08) == pytest.approx(0.5 * 2.0**2 + links)
    at.set_file_error(0.5)
    assert at.reported_file_error == 0.5
    at.set_file_error(0.01)
    assert at.reported_file_error == 0.05


def test_a_link_that_is_heavier_than_its_file_says_is_told():
    """Of the file's numbers, those of the link that is off."""
    logs = [with_torque(m, (), NOISE, k) for k, m in enumerate(swings(2))]
    light = pendulum(2).chain.inertial.copy()
    light[1] /= 1.5
    robot = pendulum(2).with_inertial(light)
    for arm, told in ((robot, True), (pendulum(2), False)):
        known = measure_gap(arm, logs, cutoff=10.0)
        at = Search(known, split(known), list(effect_classes()))
        at.set_file_error(0.02)
        assert (1 in at.doubtful_joints([])) == bool(at.doubtful_joints([])) == told


def test_noise_is_at_most_what_an_explanation_leaves():
    at = search(RUBS)
    at.causes = [cause(at, RUBS)]
    at.update_noise(at.causes)
    true = at.noise.measured.copy()
    at.noise.measured *= 100.0
    at.evidence.covariances[0] *= 100.0
    assert at.update_noise(at.causes)
    np.testing.assert_allclose(at.noise.measured, true, rtol=0.3)
    assert not at.update_noise(at.causes)


def test_of_noise_that_is_an_upper_bound_the_most_probable_part_counts():
    at = search(RUBS)
    index, least = at.columns([cause(at, RUBS)]), at.evidence.covariances[0]
    at.noise = NoiseModel(at.evidence, replace(at.prior, solver_error=1e-6))
    at.noise.law_errors[:] = 0.0
    for factor in (1.0, 4.0, 16.0):
        at.evidence.covariances = [factor * least]
        at.noise.apply(at.rigid)
        found = at.evidence.solve(index)
        (squares,) = at.evidence.weighted_squares(index, found.gains)
        # The noise of the upper band is added to all bands: squares are below one.
        own = factor * least, floored(factor * least, at.gap.cutoff / at.gap.rate)
        count = len(at.evidence.rows[0]) * whitened_power(*own[::-1])
        free = count - at.evidence.determined(found, 0)
        scale = np.geomspace(1e-3, 1.0, 3000)  # of the noise
        likely = -0.5 * (free * np.log(scale) + squares / scale - squares)
        gain = at.noise.gain_if_lower(found)
        assert gain == pytest.approx(likely.max(), rel=0.05, abs=0.1)
    assert gain > 100.0


def test_errors_of_laws_stay_however_little_is_left():
    at = search(RUBS)
    index, before = at.columns([cause(at, RUBS)]), np.inf
    at.evidence.covariances = [16.0 * x for x in at.evidence.covariances]
    for error in (0.0, 0.1, 0.3, 1.0):
        at.noise.law_errors[:] = error
        at.noise.apply(at.rigid)
        gain = at.noise.gain_if_lower(at.evidence.solve(index))
        assert 0.0 <= gain < before
        before = max(gain, 1e-9)
    assert gain == 0.0  # nearly all noise is that of laws


def test_a_cause_lowers_the_squares_on_samples_that_nothing_was_learnt_from():
    at = search(RUBS, ASKEW)
    at.causes = [cause(at, e) for e in (RUBS, ASKEW, DRAGS)]
    falls = [at.unseen_gain(at.causes)[c] for c in at.causes]
    assert falls[0] > 50 and falls[1] > 50 and abs(falls[2]) < 5
    assert at.unseen_gain([]) == {}
    assert at.is_cross_validated(at.causes) is False or abs(falls[2]) < 5
    at.causes = []
    assert at.is_cross_validated([cause(at, RUBS)])


def test_a_cause_has_to_help_on_recordings_that_were_not_learnt_from():
    """Friction of the first three recordings, which the fourth does not have."""
    for effects, there in (((RUBS,) * 3 + (None,), False), ((RUBS,) * 4, True)):
        logs = [
            with_torque(m, [e] if e else (), NOISE, k)
            for k, (m, e) in enumerate(zip(swings(), effects, strict=True))
        ]
        known = measure_gap(pendulum(), logs, cutoff=10.0)
        others = [x for x in effect_classes() if x not in FEW]
        at = Search(known, split(known), others)
        at.run()
        assert (("coulomb", (0,)) in places(at)) == there


@pytest.mark.parametrize("lasts", [True, False])
def test_a_law_has_to_beat_its_simpler_one_on_recordings_kept_aside(lasts):
    """Presliding of the first three recordings, and dry friction in the fourth."""
    effects = BRISTLES, BRISTLES, BRISTLES, BRISTLES if lasts else RUBS
    logs = [
        with_torque(m, [e], NOISE, k)
        for k, (m, e) in enumerate(zip(swings(), effects, strict=True))
    ]
    known = measure_gap(pendulum(), logs, cutoff=10.0)
    library = "coulomb", "presliding"
    at = Search(known, split(known), [x for x in effect_classes() if x not in library])
    bristles = cause(at, BRISTLES)
    assert (at.unseen_gain([bristles])[bristles] > 0) == lasts


def test_a_cause_takes_the_place_of_a_large_error_of_the_file():
    """A file that is far off everywhere is less probable than one cause."""
    at = search(RUBS)
    typical = at.file_error
    assert not at._exchange_file_error()
    at.set_file_error(0.5)
    assert at._exchange_file_error()
    assert places(at) == {("coulomb", (0,))} and at.file_error == typical
    at = search()
    at.set_file_error(0.5)
    precision = at.evidence.precision.copy()
    assert not at._exchange_file_error()
    assert at.causes == [] and at.file_error == 0.5
    np.testing.assert_array_equal(at.evidence.precision[: len(precision)], precision)


def test_the_squares_elsewhere_are_those_of_the_residual():
    at = search(*BOTH, size=2)
    at.causes = [cause(at, e) for e in BOTH]
    test, gains = at.test, at.evidence.solve(at.columns(at.causes)).gains
    squares = test.squares(at.causes)
    for i in range(2):
        left = test.evidence.residual(i, test.columns(at.causes), gains)
        assert squares[i] == pytest.approx(left @ left, rel=1e-6)


def test_no_law_is_held_to_be_exact():
    """A gap that is larger asks for more evidence at its joint, and only there."""
    small, large = search(RUBS, size=2), search(RUBS, LARGE, size=2)
    more = [x.evidence.noise - x.noise.measured for x in (small, large)]
    assert np.all(more[0] > 0.0)
    least = small.prior.law_error**2 * 25.0  # of one sample that is like no other
    assert more[1][1] - more[0][1] > least
    assert abs(more[1][0] - more[0][0]) < 0.1 * (more[1][1] - more[0][1])


def test_nothing_is_counted_of_a_joint_without_samples():
    at = search(RUBS)
    assert at.test.count == pytest.approx([np.count_nonzero(at.test.use)], rel=0.1)
    still = [
        replace(m, q=m.q * [1, 0], v=m.v * [1, 0], a=m.a * [1, 0]) for m in swings(2)
    ]
    known = measure_gap(
        pendulum(2), [with_torque(m, (), NOISE) for m in still], cutoff=10.0
    )
    count = Search(known, split(known), list(effect_classes())).test.count
    assert count[0] > 100 and np.isnan(count[1])


def test_values_are_those_of_the_arm_within_their_intervals():
    at = search(RUBS, ASKEW)
    at.run()
    for effect in refit(at):
        truth = {"coulomb": RUBS, "torque_offset": ASKEW}[effect.id]
        for name, value in effect.values.items():
            off = abs(value - truth.values[name])
            assert off < 3 * effect.std[name] < 0.2


def test_values_are_off_by_as_much_as_their_intervals_say():
    """Neither the errors of laws in general nor those of simulators widen them."""
    off = []
    for seed in range(12):
        known = gap_of(RUBS, ASKEW, seed=seed)
        at = Search(known, split(known), [x for x in effect_classes() if x not in FEW])
        at.causes = [cause(at, RUBS), cause(at, ASKEW)]
        for effect, true in zip(refit(at), (RUBS, ASKEW), strict=True):
            error = effect.values["level"] - true.values["level"]
            off.append(error / effect.std["level"])
    assert 0.4 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_no_friction_that_is_reported_drives_its_joint():
    known = gap_of(RUBS.at({"level": -0.3}))
    at = Search(known, split(known), [x for x in effect_classes() if x not in FEW])
    at.causes = [cause(at, RUBS)]
    (found,) = refit(at)
    ((low, high),) = [x.interval for x in fitted_values(known, found)]
    assert found.values["level"] == 0.0 == low < high


def test_no_friction_that_is_written_drives_its_joint(monkeypatch):
    known = gap_of(RUBS.at({"level": -0.3}))
    at = Search(known, split(known), [x for x in effect_classes() if x not in FEW])
    at.causes = [cause(at, RUBS)]

    def give_way(evidence, chain, index, effects):
        free = evidence.solve(index)
        return replace(free, gains=free.gains - 0.01)

    monkeypatch.setattr(fixed, "solve_physical", give_way)
    result = SimpleNamespace(
        gap=known, search=at, effects=refit(at), scored=explain(at)
    )
    _, (written,) = fixed.fixed_simulator(result)
    assert written.values["level"] == 0.0


def test_the_interval_of_a_shape_is_that_of_all_that_fit_nearly_as_well():
    at = search(BRISTLES, library=("presliding",))
    at.run()
    (found,) = refit(at)
    assert abs(found.values["distance"] - 0.05) < 3 * found.std["distance"] < 0.01
    assert abs(found.values["level"] - 1.0) < 3 * found.std["level"] < 0.1
    evidence, solution, (own,) = solve_all(at)
    _set_noise_of_residual(evidence, solution)
    base = np.setdiff1d(solution.index, own)
    candidate_, steps = at.known[0].candidate, [-1.96, 0.0, 1.96]
    worth = []
    for x in steps:
        moved = found.at(
            {"distance": found.values["distance"] + x * found.std["distance"]}
        )
        columns = at.gap.columns(moved)
        worth.append(
            evidence.trial(base, columns, candidate_.std, candidate_.lower).worth
        )
    assert worth[1] - max(worth[0], worth[2]) > 1.0  # at its ends it fits worse


def test_what_each_explains_is_what_is_left_less_by_it():
    at = search(RUBS, ASKEW)
    at.run()
    scored, true = explain(at), {"coulomb": 1.0, "torque_offset": -1.0}
    for k, term in enumerate(scored.terms):
        torque = scored.contribution(k)[0]
        assert np.abs(torque).mean() == pytest.approx(1.0, rel=0.15)
        assert scored.named[k] == term.place[0]
        gains = scored.gains[np.isin(scored.index, scored.own[k])]
        assert gains == pytest.approx([true[term.place[0]]], rel=0.1)
    noise = np.std(scored.after[0])
    assert noise < 0.1 < np.std(scored.before[0])
    assert shares(at, np.random.default_rng(0)) == pytest.approx([0.5, 0.5], abs=0.1)
    assert len(scored.rigid) == len(scored.index) - 2


@pytest.mark.study
def test_a_shape_is_as_far_off_as_fits_nearly_as_well():
    """Within 1.92 nat of the best: its region of 95 %."""
    at = search(BRISTLES, library=("presliding",))
    (cause,) = at.run()
    evidence, solution, (own,) = solve_all(at)
    base, found = np.setdiff1d(solution.index, own), cause.candidate
    bends, best = found.effect.shapes[0], found.effect.values["distance"]
    width = np.log(bends.upper / bends.lower)
    values = best * np.exp(width * np.linspace(-0.015, 0.015, 61))
    worth = []
    for value in values:
        columns = at.gap.columns(found.effect.at({"distance": value}))
        worth.append(evidence.trial(base, columns, found.std, found.lower).worth)
    inside = np.array(worth) > max(worth) - 1.92
    assert not inside[0] and not inside[-1]
    region = np.abs(values - best)[inside].max()
    for std in (0.003, 0.006):  # from wherever it was drawn
        far = _profile_range(evidence, base, found, np.array([[std**2]]))
        assert far[-1] == pytest.approx(region, rel=0.2)


def test_a_late_torque_is_found_in_time():
    late = Delay((0,), {"time": 0.004})
    logs = []
    for k, m in enumerate(swings()):
        exact = with_torque(m, (), 0.0)
        tau = late.report(m.t, exact.tau)
        noise = NOISE * np.random.default_rng(k).standard_normal(tau.shape)
        logs.append(replace(exact, tau=tau + noise))
    known = measure_gap(pendulum(), logs, cutoff=10.0)
    others = [x for x in effect_classes() if x not in ("delay", "coulomb", "viscous")]
    at = Search(known, split(known), others)
    at.run()
    assert places(at) <= {("delay", (0,))}


@pytest.mark.study
def test_a_spring_is_stiffer_than_its_file_says_by_so_much():
    springy = Spring((0,), {"stiffness": 3.0})
    at = search(springy, library=("spring", *FEW))
    at.run()
    (found,) = refit(at)
    assert found.id == "spring"
    assert abs(found.values["stiffness"] - 3.0) < 3 * found.std["stiffness"] < 0.5


@pytest.mark.parametrize(
    "effect",
    [
        Saturation((0,), {"loss": 0.6, "limit": 5.0, "total": 0.0}),
        Stribeck((0,), {"level": 2.0, "velocity": 0.3}),
    ],
)
def test_deviations_follow_a_law_to_the_one_that_is_reported(effect):
    """By its slopes, however they are changed: the delta method."""
    names = [x.name for x in (*effect.gains, *effect.shapes) if not x.whole]
    root = np.random.default_rng(0).normal(0.0, 1e-3, (len(names), len(names)))
    gap = SimpleNamespace(motions=[])
    found, law = _reported(gap, effect, root @ root.T), effect.as_reported()
    assert found.values == law.values

    def at(k, step):
        moved = effect.at({names[k]: effect.values[names[k]] + step}).as_reported()
        return np.array([moved.values[x] for x in names])

    step = 1e-5
    columns = [(at(k, step) - at(k, -step)) / (2 * step) for k in range(len(names))]
    J = np.array(columns).T
    expected = np.sqrt(np.diag(J @ root @ root.T @ J.T))
    np.testing.assert_allclose([found.std[x] for x in names], expected, rtol=1e-3)
    if law is not effect:
        assert found.std["loss"] == pytest.approx(
            np.linalg.norm(root[0]) / 1.6**2, rel=1e-3
        )


def test_shares_are_what_terms_add_in_any_order_and_sum_to_one():
    truth = TorqueOffset((0,), {"level": 2.0}), Coulomb((1,), {"level": 1.0})
    at = search(*truth, size=2)
    causes = [cause(at, e) for e in (*truth, Viscous((0,)))]
    parts = []
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        at.causes = [causes[k] for k in order]
        found = shares(at, np.random.default_rng(0))
        assert found.sum() == pytest.approx(1.0) and (found >= 0).all()
        parts.append(found[np.argsort(order)])
    np.testing.assert_allclose(parts, parts[:1] * 3, atol=0.05)
    assert parts[0][2] < 0.05 < parts[0][:2].min()


def test_what_is_left_at_once_and_what_is_seen_only_where_it_was_learnt():
    at = search(RUBS, ASKEW)
    at.run()
    scored = explain(at)
    for k in (0, 1):
        assert scored.where_seen([k]) is scored
        assert scored.members(scored.named[k]) == [k]
    gains = np.zeros_like(scored.learnt.gains)
    nowhere = replace(scored, gains=np.zeros_like(scored.gains))
    assert nowhere.where_seen([0]) is scored.learnt and not gains.any()
    block = scored.blocks(0)
    seconds = scored.evidence.rows[0] / at.gap.rate
    np.testing.assert_array_equal(block, seconds.astype(int))


def test_a_search_is_freed_with_its_last_use():
    """It holds all columns: hundreds of megabytes, which no cycle may keep alive."""
    at = search(RUBS)
    assert at.run()
    at.substitute_unknown_laws()
    at, alive = None, weakref.ref(at)
    assert alive() is None


def test_what_is_too_improbable_to_name_still_acts_in_the_simulator():
    at = search(RUBS, DRAGS)
    every = set(at.run())
    at.causes = [c for c in at.causes if c.place[0] == "coulomb"]
    at.substitute_unknown_laws()
    assert places(at) == {c.place for c in every}


def speed_law(at):
    (law,) = (x for x in at.laws.all if x.place == ("speed", (0,)))
    return at.laws.widened(at.columns([]), law)


def test_an_unknown_law_gives_way_to_several_effects_in_its_place():
    at = search(RUBS, DRAGS)
    at.causes = [speed_law(at)]
    at.run()
    assert places(at) == {("coulomb", (0,)), ("viscous", (0,))}


def test_effects_in_place_of_unknown_laws_leave_named_causes_alone():
    """Though the better law is among them."""
    at = search(RUBS, DRAGS, library=("presliding", *FEW))
    named = cause(at, Presliding((0,), {"level": 1.0, "distance": 0.002}))
    at.causes, at.whole = [named], [named, speed_law(at)]
    at.substitute_unknown_laws()
    assert named in at.causes and ("viscous", (0,)) in places(at)


def test_an_improbable_effect_gives_way_to_an_unknown_law():
    at = search(RUBS, DRAGS)
    at.causes = causes = [cause(at, RUBS), cause(at, DRAGS)]
    at.beliefs = [Belief(causes[0], 9.0, (), 0.9), Belief(causes[1], 9.0, (), 0.2)]
    assert at._replace_improbable()
    (law,) = (c for c in at.causes if c.candidate is None)
    assert law.place[1] == (0,) and causes[1] not in at.causes
    at.beliefs = at.beliefs[:1]
    assert not at._replace_improbable()


def test_a_cause_at_another_joint_that_is_there_as_well_is_no_alternative():
    at = search(*BOTH, size=2)
    at.causes = [cause(at, RUBS)]
    (found,) = beliefs(at)
    assert all(x.place[1] == (0,) for x, _ in found.alternatives)
    assert found.probability > 0.9


def test_an_unknown_law_that_takes_a_place_leaves_causes_at_other_joints_alone():
    at = search(*BOTH, DRAGS, size=2)
    drags, rubs, other = (cause(at, e) for e in (DRAGS, *BOTH))
    tiny = cause(at, Viscous((1,), {"coefficient": 0.01}))
    at.causes = [drags, rubs, other, tiny]
    at.beliefs = [Belief(rubs, 9.0, (), 0.1)]
    assert at._replace_improbable()
    assert rubs not in at.causes and tiny in at.causes and other in at.causes
    assert ("coulomb", (0,)) in at.refused


# --- what happens at a time -----------------------------------------------------------


def push(start, duration, recording=-1.0):
    times = {"start": start, "duration": duration, "recording": recording}
    return Contact((0, 1), times)


@pytest.mark.parametrize(
    ("one", "two", "excludes"),
    [
        (push(1.0, 0.5), push(1.4, 0.5), True),
        (push(1.0, 0.5), push(1.6, 0.5), False),
        (push(1.0, 0.5, 0.0), push(1.2, 0.1, 1.0), False),
        (push(1.0, 0.5, 1.0), push(1.2, 0.1, 1.0), True),
        (push(1.0, 0.5, 1.0), push(1.2, 0.1), True),
        (push(1.0, 0.5), RUBS, False),
    ],
)
def test_an_arm_touches_one_thing_at_a_time(one, two, excludes):
    assert one.excludes(two) == two.excludes(one) == excludes


START, LASTS = 1.0, 0.6  # s


def pushed(more=lambda t: 0.0, force=30.0):
    """A posterior of four logs, a push by hand in one of them, and its cause.

    Args:
        more: Torque of both joints besides, by the time in that log, [N·m].
        force: Largest force of half a sine, [N].
    """
    gap = gap_of(size=2)
    t, here = gap.sampled.t, gap.trajectory == 1
    law = push(START, LASTS, 1.0)
    columns, left = gap.columns(law), gap.left.copy()
    phase = np.clip((t - START) / LASTS, 0.0, 1.0)
    for j in (0, 1):
        left[:, j] += force * np.sin(np.pi * phase) * columns[j][:, 0]
    left += np.where(here, more(t), 0.0)[:, None]
    at = Posterior(replace(gap, left=left))
    return at, at.cause(candidate(gap, law.at({"rise": 0.7})))


def beside(t):
    """A sinusoid before and after the push, and nothing meanwhile."""
    return np.where((t < START) | (t > START + LASTS), 20.0 * np.sin(9.0 * t), 0.0)


def test_a_push_by_hand_is_isolated():
    at, cause = pushed()
    assert at.is_isolated(cause, [cause])
    at, cause = pushed(lambda t: 20.0 * (t > 3.0))  # later
    assert at.is_isolated(cause, [cause])


def test_what_goes_on_before_and_after_is_not_isolated():
    at, cause = pushed(beside)
    assert not at.is_isolated(cause, [cause])


def test_a_force_of_another_shape_is_not_isolated():
    at, cause = pushed(lambda t: 20.0 * np.sin(40.0 * t) * (abs(t - 1.3) < 0.3))
    assert not at.is_isolated(cause, [cause])


def test_what_recurs_with_the_position_is_foretold():
    at, _ = pushed()
    _, rows = at.evidence.rows
    q, t = at.gap.sampled.q[rows, 1], at.gap.sampled.t[rows]
    then = (at.gap.trajectory[rows] == 1) & (abs(t - 1.3) < 0.3)
    assert at.laws.foretold(1, np.cos(2.0 * q), then) > 0.9
    once = np.where(then, 3.0, NOISE * np.sin(50.0 * t))
    assert at.laws.foretold(1, once, then) < 0.1
