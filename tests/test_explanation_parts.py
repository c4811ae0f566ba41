"""Steps of a search with scores that are stated; laws, shares and beliefs by hand."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import NOISE, RATE, gap_of

from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.explanations import account as account_module
from hybrid.diagnosis.explanations import belief as belief_module
from hybrid.diagnosis.explanations.account import Account, _slow_share, account
from hybrid.diagnosis.explanations.belief import (
    Belief,
    _independent,
    _limit,
    beliefs,
    is_known,
)
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.explanations.joint_laws import (
    joint_laws,
    lagged_differences,
    low_passed,
    smooth_features,
    smooth_sign,
    waves,
)
from hybrid.diagnosis.explanations.proposals import Proposal
from hybrid.diagnosis.explanations.refit import _model_variance, _names
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.explanations.servo_fit import _inverse, _least, _solve
from hybrid.diagnosis.explanations.transmission_laws import (
    _derivative,
    _with_lags,
    transmission_laws,
)
from hybrid.diagnosis.gap.measure import split
from hybrid.diagnosis.prior import Prior
from hybrid.effects import effect_classes
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.presliding import Presliding
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.signals.filters import butterworth


def cause(name, joint=0, *, known=True, rough=0.0):
    plain = SimpleNamespace(shapes=())
    made = SimpleNamespace(place=(name, (joint,)), effect=plain) if known else None
    return Cause((name, (joint,)), np.array([hash(name) % 97]), 10.0, made, rough)


A, B, C = cause("a"), cause("b"), cause("c", 1)
LAW = cause("speed", known=False, rough=0.1)


class Steps(Search):
    """A search whose scores and losses are those of sets of causes by their names."""

    def __init__(self, scores, losses=None, found=()):
        self._checked, self.file_error, self.library_only = {}, 0.02, False
        self.evidence = SimpleNamespace(noise=np.ones(2))
        self.scores, self.losses, self.found = scores, losses or {}, found
        self.causes, self._certain, self.beliefs, self.once = [], [], [], []
        self.prior, self.said, self.pooled = Prior(), [], []
        self._progress = lambda text, *_: self.said.append(text)
        joints = SimpleNamespace(joints=("hip", "knee"), size=2)
        self.gap = SimpleNamespace(robot=joints)
        self.pool = SimpleNamespace(
            add_ripples=lambda x: self.pooled.append("ripples"),
            add_contacts=lambda x: self.pooled.append("contacts"),
        )

    def score(self, causes):
        return self.scores["".join(sorted(c.place[0] for c in causes))]

    def held_out_losses(self, causes):
        names = "".join(sorted(c.place[0] for c in causes))
        return np.atleast_2d(self.losses.get(names, (-self.score(causes),) * 2))

    def is_isolated(self, cause, causes):
        return cause in self.once

    def columns(self, causes):
        return np.concatenate([np.zeros(0, int), *(c.index for c in causes)])

    def proposals(self, causes, own=None):
        self.asked = own
        there = {c.place for c in causes if c is not own}
        return [x for x in self.found if x.place not in there]


def proposal(made, worth):
    return Proposal(made, worth)


# --- single steps ---------------------------------------------------------------------


@pytest.mark.parametrize(("score", "taken"), [(10.4, False), (10.6, True)])
def test_causes_are_taken_that_gain_half_a_nat(score, taken):
    at = Steps({"": 10.0, "a": score})
    assert at._take([A]) == taken and at.causes == [A] * taken


@pytest.mark.parametrize(
    ("loss", "taken"), [((0.9, 0.9), True), ((0.9, 1.0), False), ((1.1, 0.1), False)]
)
def test_causes_are_taken_that_lower_both_losses(loss, taken):
    at = Steps({"": 0.0, "a": 9.0}, {"": (1.0, 1.0), "a": loss})
    assert at._take([A]) == taken and at.causes == [A] * taken
    at.causes = []
    assert at.is_cross_validated([A]) == taken
    at.once = [A]
    assert at.is_cross_validated([A])
    at.once, at.scores["ab"] = [B], -2.0
    assert not at.is_cross_validated([A, B])


@pytest.mark.parametrize(("last", "taken"), [(1.1, True), (1.4, False)])
def test_an_exchange_lowers_the_loss_by_more_than_its_standard_error(last, taken):
    """One fold falls by 0.8, and one rises."""
    folds = np.array([[1.0, 1.0], [1.0, 1.0]])
    other = np.array([[0.2, 0.2], [last, last]])
    losses = {"": folds, "a": folds, "b": other}
    at = Steps({"": 0.0, "a": 0.0, "b": 9.0}, losses)
    at.causes = [A]
    assert at.is_cross_validated([B]) == taken
    at.causes = []
    assert at.is_cross_validated([B])  # odds speak against more causes already


def test_what_a_new_cause_makes_superfluous_is_removed_weakest_first():
    scores = {"": 0.0, "a": 5.0, "b": 30.0, "c": 1.0}
    scores |= {"ab": 29.0, "bc": 30.5, "ac": 6.0, "abc": 29.5}
    at = Steps(scores)
    at.causes = [A]
    assert at._take([A, B, C])
    assert at.causes == [B, C]  # without the first the score rises by one
    scores["bc"] = 29.9  # then the third is spare as well
    at.causes = [A, B, C]
    at._remove()
    assert at.causes == [B]
    at.causes, at._certain = [A, B, C], [A, C]
    at._remove()
    assert at.causes == [A, B, C]  # what is certain stays, and the second is needed


def test_a_cause_of_no_worth_at_all_may_stay():
    at = Steps({"": 0.0, "a": 0.0})
    at.causes = [A]
    at._remove()
    assert at.causes == [A]


def test_a_rough_law_may_explain_its_part_of_another_cause():
    """A tenth of its torque is a hundredth of its evidence."""
    rough = cause("a", rough=0.1)
    at = Steps({"": 0.0, "a": 1000.0, "b": 500.0, "ab": 1009.0})
    assert at._rough_errors([rough], B) == pytest.approx(0.01 * 1000.0)
    at.causes = [rough, B]
    at._remove()
    assert at.causes == [rough]
    at.scores["ab"] = 1011.0
    at.causes = [rough, B]
    at._remove()
    assert at.causes == [rough, B]
    assert at._rough_errors([A], B) == 0.0 and at._rough_errors([], B) == 0.0


@pytest.mark.parametrize(
    ("law", "other", "counts"), [(0.2, 0.1, True), (0.1, 0.1, False), (0.1, 0.2, False)]
)
def test_an_unknown_law_counts_against_what_is_less_rough(law, other, counts):
    strange = replace(LAW, rough=law)
    at = Steps({"": 0.0, "speed": 100.0})
    found = at._rough_errors([strange], cause("b", rough=other))
    assert found == pytest.approx(law**2 * 100.0 * counts)
    # Against another unknown law it always does.
    against = at._rough_errors([strange], cause("time", known=False, rough=other))
    assert against == pytest.approx(law**2 * 100.0)


def test_the_rougher_of_two_laws_decides():
    one, two = cause("a", rough=0.1), cause("c", rough=0.2)
    at = Steps({"": 0.0, "a": 60.0, "c": 90.0, "ac": 100.0})
    assert at._rough_errors([one, two], B) == pytest.approx(max(0.1, 0.04 * 40.0))


def test_the_best_proposal_that_is_good_for_both_scores_is_added():
    at = Steps(
        {"": 0.0, "a": 9.0, "b": 8.0, "c": 7.0}, {"": (1, 1), "a": (2, 2), "b": (0, 0)},
        [proposal(A, 9.0), proposal(B, 8.0), proposal(C, 7.0)],
    )  # fmt: skip
    assert at._add() and at.causes == [B]
    assert at.said == ["cause 1: b at hip"] and at.pooled == ["ripples", "contacts"]
    none = Steps({"": 0.0, "a": 9.0}, found=[proposal(A, 0.5)])
    assert not none._add() and none.causes == []
    # A cause after which others go is an improvement only if something is gained.
    even = Steps({"": 0.0, "a": 10.0, "b": 10.6, "ab": 10.6}, {}, [proposal(B, 0.6)])
    even.causes = [A]
    even.losses = {"a": (1, 1), "ab": (0, 0), "b": (0, 0)}
    even.scores["b"] = 10.45
    even._rough_errors = lambda causes, other: 5.0 * (other is A)
    assert not even._add() and even.causes == [B]


def test_a_cause_is_exchanged_for_one_of_the_two_best():
    scores = {"": 0.0, "a": 5.0, "b": 9.0, "c": 20.0}
    at = Steps(scores, {"a": (1, 1), "b": (0, 0), "c": (0, 0)})
    at.causes = [A]
    at.found = [proposal(A, 5.0), proposal(B, 9.0), proposal(C, 20.0)]
    assert at._exchange(A) and at.causes == [B] and at.asked is A
    at.scores["b"] = 5.4
    at.causes, at.found = [A], [proposal(B, 5.3), proposal(B, 5.4), proposal(C, 20.0)]
    assert not at._exchange(A) and at.causes == [A]


@pytest.mark.parametrize(("worth", "taken"), [(-1.0, True), (-3.0, False)])
def test_shapes_beside_an_exchanged_cause_adapt_to_it(worth, taken):
    """A proposal within the odds of a cause may still be better than it looks."""
    law = SimpleNamespace(shapes=(1,), repeats="")
    shaped = SimpleNamespace(effect=law, place=("s", (0,)))
    near = replace(cause("s"), candidate=shaped)
    better = replace(near, place=("t", (0,)))
    scores = {"s": 0.0, "as": 5.0, "bs": worth, "bt": 9.0, "b": 0.0, "t": 0.0}
    at = Steps(scores, {"as": (1, 1), "bt": (0, 0)}, [proposal(B, worth)])
    at.refine = lambda base, c: (c, 0.0)
    at.cause = lambda c: better
    at.causes = [near, A]
    assert at._exchange(A) == taken
    assert at.causes == ([B, better] if taken else [near, A])
    at.causes, at._certain = [near, A], [near]  # what is certain stays as it is
    assert not at._exchange(A) and at.causes == [near, A]


def test_a_cause_that_lowers_the_score_is_removed():
    for alone, stays in ((5.0, True), (5.1, False)):
        at = Steps({"": alone, "a": 5.0})
        at.causes = [A]
        assert at._exchange(A) == (not stays)
        assert at.causes == [A] * stays


# --- the search -----------------------------------------------------------------------


def test_a_search_knows_its_effects_and_its_unknown_laws():
    at = Steps({})
    at.rigid, at.causes = np.array([100, 101]), [LAW, A, B]
    assert at.known == [A, B] and [t.candidate for t in at.terms] == [
        A.candidate, B.candidate,
    ]  # fmt: skip
    np.testing.assert_array_equal(at.background, [100, 101, *LAW.index])
    np.testing.assert_array_equal(at.base(), [*at.background, *A.index, *B.index])
    assert at.placed(at.terms[0]) == ("a", "hip") and at.placed(C)[1] == "knee"


def test_an_exchange_is_tried_again_where_something_near_has_changed():
    at = Steps({})
    at.causes = [A, B, C]
    before, settings = at._neighbours(A), at._settings
    at.causes = [A, B]
    assert at._neighbours(A) == before != at._neighbours(C)
    at.library_only = True
    assert at._neighbours(A) != before
    at.causes, at.library_only = [A], False
    assert at._neighbours(A) != before
    at.evidence.noise = np.array([1.0, 2.0])
    assert at._settings != settings
    at.evidence.noise, at.file_error = np.ones(2), 0.05
    assert at._settings != settings


class Files(Steps):
    """A search whose score and losses depend on the error of the file alone."""

    def __init__(self, worth, losses=None):
        super().__init__({"": 0.0, "a": 0.0})
        self.worth, self.by_error = worth, losses or {}
        self.numbers, self.set = np.array([0]), []
        self.file_error = 0.02
        self.now = 0.02
        self.evidence = SimpleNamespace(scale_prior=self._scale)

    def _scale(self, numbers, error):
        assert numbers is self.numbers
        self.now = error

    def score(self, causes):
        return self.worth.get(self.now, -50.0) + super().score(causes)

    def held_out_loss(self, causes):
        return np.array(self.by_error.get(self.now, (-self.now,) * 2))

    def file_error_odds(self, error):
        return 10.0 * (error > 0.02)

    def set_file_error(self, error):
        self.set.append(error)
        self.file_error = self.now = error


@pytest.mark.parametrize(("worth", "chosen"), [(10.4, 0.02), (10.6, 0.2), (30.0, 0.2)])
def test_the_error_of_the_file_is_the_most_probable_one(worth, chosen):
    at = Files({0.02: 0.0, 0.2: worth})
    assert at._fit_file_error() == (chosen != 0.02)
    assert at.file_error == at.now == chosen
    assert at.set == ([chosen] if chosen != 0.02 else [])


@pytest.mark.parametrize("error", [0.01, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0])
def test_errors_of_the_file_are_tried_from_a_hundredth_to_five(error):
    at = Files({error: 99.0}, {error: (-9.0, -9.0)})
    assert at._fit_file_error() and at.file_error == error


def test_a_larger_error_of_the_file_has_to_lower_both_losses():
    for loss, better in (((0.9, 0.9), True), ((0.9, 1.0), False)):
        at = Files({0.02: 0.0, 0.2: 99.0}, {0.02: (1.0, 1.0), 0.2: loss})
        assert at._fit_file_error() == better


def test_a_large_error_of_the_file_gives_way_to_one_cause():
    for score, better in ((-10.6, False), (-9.4, True)):
        at = Files({0.02: 0.0, 0.2: 0.0}, {0.2: (1.0, 1.0), 0.02: (0.5, 0.5)})
        at.file_error = at.now = 0.2
        at.scores["a"], at.found = score, [proposal(A, 1.0), proposal(B, 99.0)]
        assert at._exchange_file_error() == better
        assert at.causes == [A] * better and at.now == (0.02 if better else 0.2)
    at.by_error[0.02], at.causes = (1.0, 0.5), []
    at.file_error = at.now = 0.2
    assert not at._exchange_file_error() and at.now == 0.2
    at.file_error = 0.02
    assert not at._exchange_file_error()


def believed(cause, *options, probability=0.9, limit=None):
    return Belief(cause, 5.0, tuple(options), probability, limit)


def sized(made, parameters, worth=1.0):
    made.candidate.effect = SimpleNamespace(gains=[0] * parameters, shapes=[])
    return Proposal(made, worth)


def test_a_law_at_its_limit_is_the_law_that_it_has_become():
    own, other = Proposal(A, 1.0), Proposal(B, 1.0)
    limit = believed(A, (own, 0.9), (other, 0.01), limit="b")
    assert limit.become is B
    assert believed(A, (own, 0.5), (other, 0.5)).become is None
    elsewhere = believed(A, (own, 0.9), (Proposal(C, 1.0), 0.01), limit="c")
    assert elsewhere.become is None  # at another joint it is not
    at, gains = Steps({}), {}
    at.unseen_gain = lambda causes: {c: gains.get(c, 1.0) for c in causes}
    at.causes, at.beliefs = [A, C], [limit, believed(C, (Proposal(C, 1.0), 1.0))]
    assert at._replace_limits() and at.causes == [B, C]
    at.causes, gains[B] = [A, C], 0.0  # it has to help on unseen motion as well
    assert not at._replace_limits() and at.causes == [A, C]
    gains.clear()
    at.causes, at.beliefs = [A], [believed(A, (own, 0.5), (other, 0.5))]
    assert not at._replace_limits() and at.causes == [A]
    # Of two causes that become the same law only one does.
    at.causes = [A, C]
    at.beliefs = [limit, believed(C, (own, 0.5), (other, 0.4), limit="b")]
    assert at._replace_limits() and at.causes == [B, C]


class Laws:
    """Unknown laws that are open."""

    def __init__(self, *laws):
        self.all = laws

    def open(self, causes):
        return [x for x in self.all if x not in causes]


def test_the_least_probable_effect_is_replaced_by_an_unknown_law():
    at = Steps({"ab": 0.0, "bspeed": 9.0, "b": 1.0, "speed": 2.0, "c": 0.0})
    at.scores |= {"": -9.0, "cspeed": 9.0, "bcspeed": 9.0, "bspeedtime": 9.0}
    far = cause("time", 1, known=False)
    at.laws = Laws(LAW, far)
    given = []

    def best_law(laws, base, whole, less, rough):
        given.append(list(laws))
        return proposal(laws[0], 1.0)

    at.best_law = best_law
    at.causes = [A, C]
    at.scores |= {"cspeed": 9.0, "c": 1.0, "speed": 2.0}
    at.beliefs = [believed(A, probability=0.5), believed(C, probability=0.51)]
    assert at._replace_improbable()
    assert at.causes == [C, LAW] and at.refused == {A.place} and at._certain == []
    assert given == [[LAW]]  # the laws of its joint
    at.beliefs = [believed(C, probability=0.51)]
    assert not at._replace_improbable()
    at.beliefs = [believed(C, probability=0.99, limit="")]
    at.laws = Laws()
    assert at._replace_improbable() and at.causes == [LAW]
    assert at.refused == {A.place, C.place}


# --- beliefs --------------------------------------------------------------------------


def test_the_probability_of_no_cause_is_one_of_them():
    options = {x.place: x for x in (sized(A, 1, 2.0), sized(B, 1, 1.0))}
    found = Belief.of(A, 2.0, options, 0.95)
    whole = 1.0 + np.exp(2.0) + np.exp(1.0)
    (own, p), (other, q) = found.alternatives
    assert (own.place, other.place) == (A.place, B.place)
    assert (p, q) == (pytest.approx(np.exp(2) / whole), pytest.approx(np.e / whole))
    assert found.probability == pytest.approx(1 - 1 / whole)


def test_alternatives_come_by_their_probability_after_the_cause_itself():
    worth = {A: 1.0, B: 0.5, C: 2.0}
    options = {made.place: sized(made, 1, x) for made, x in worth.items()}
    found = Belief.of(A, 2.0, options, 0.95)
    assert [x.place for x, _ in found.alternatives] == [A.place, C.place, B.place]


def test_a_belief_is_what_the_score_falls_by_with_its_alternatives():
    at = Steps({"": 0.0, "a": 20.0, "c": 5.0, "ac": 25.0, "aspeed": 21.0, "abc": 26.0})
    at.causes = [A, C]
    # Another effect at the other joint raises the score beside it: no alternative.
    beside = cause("b", 1)
    at.found = [sized(A, 1, 20.0), sized(B, 1, 19.0), sized(beside, 1, 18.0)]
    at.is_cross_validated = lambda causes: False
    at.gap = SimpleNamespace(columns=lambda effect: {0: np.zeros((2, 1))})
    first, second = beliefs_of(at)
    assert (first.cause, first.worth) == (A, 20.0)
    assert (second.cause, second.worth) == (C, 5.0)
    places = [x.place for x, _ in first.alternatives]
    assert places == [A.place, B.place]


def test_what_scores_more_and_foretells_worse_is_as_probable():
    at = Steps({"": 0.0, "a": 20.0})
    at.causes, at.found = [A], [sized(A, 1, 20.0), sized(B, 1, 40.0)]
    for kept in (True, False):
        at.is_cross_validated = lambda causes, kept=kept: kept
        (belief,) = beliefs_of(at)
        (own, p), (other, q) = belief.alternatives
        assert (own.place, other.place) == (A.place, B.place)
        assert (p < 1e-6) if kept else (p == q)


def test_the_law_that_a_cause_has_become_takes_its_place_however_improbable():
    at = Steps({"": 0.0, "a": 20.0})
    at.causes, at.found = [A], [proposal(A, 20.0), proposal(B, 10.0)]
    (usual,), (limit,) = beliefs_of(at), beliefs_of(at, limit=B.place[0])
    assert [x.place for x, _ in usual.alternatives] == [A.place]
    assert [x.place for x, _ in limit.alternatives] == [A.place, B.place]
    assert limit.become.place == B.place


def test_effects_that_only_priors_tell_apart_are_equals():
    """Their costs differ by as much as their worth does; a law costs nothing here."""
    at = Steps({"": 0.0, "a": 20.0})
    dear = replace(cause("b"), cost=A.cost + 10.0)
    below, above = (proposal(dear, x) for x in (6.9, 7.1))  # one to 19, and to 22
    alike, law = proposal(cause("c"), 6.9), proposal(LAW, 20.0)
    for found, equals in ((below, []), (above, ["b"]), (alike, []), (law, [])):
        at.causes, at.found = [A], [proposal(A, 20.0), found]
        (belief,) = beliefs_of(at)
        assert [c.place[0] for c in belief.equals] == equals
    assert [x.place[0] for x, _ in belief.alternatives] == ["a", "speed"]


def beliefs_of(at, limit=None):
    """Beliefs of a search whose laws are at a limit or not."""
    with pytest.MonkeyPatch.context() as m:
        m.setattr(belief_module, "_limit", lambda *_: limit)
        return beliefs(at)


def test_a_proposal_at_another_joint_that_adds_to_a_cause_is_beside_it():
    at = Steps({"a": 5.0, "ac": 6.0, "ab": 9.0})
    at.causes = [A]
    assert _independent(at, A, proposal(C, 1.0))
    assert not _independent(at, A, proposal(B, 1.0))  # at its own joint
    assert not _independent(at, A, proposal(C, 0.0))
    at.scores["ac"] = 5.0
    assert not _independent(at, A, proposal(C, 1.0))


def test_a_law_at_the_end_of_a_range_is_another_unless_it_is_far_better(monkeypatch):
    gap = gap_of()
    law = candidate(gap, Presliding((0,), {"level": 1.0, "distance": 0.05}))
    made = Cause(law.place, np.zeros(1, int), 0.0, law)
    worth = {}

    def gain(evidence, base, c):
        return worth[c.effect.values["distance"]]

    monkeypatch.setattr(belief_module, "gain", gain)
    at = SimpleNamespace(
        gap=gap, evidence=None, columns=lambda rest: None,
        model_error_odds=lambda c: 3.0,
    )  # fmt: skip
    end, other = law.effect.at_limit(gap.scales[0])
    for own, found in ((12.9, other), (13.1, None)):
        worth.update({0.05: own, end.values["distance"]: 10.0})
        assert _limit(at, made, []) == found
    assert _limit(at, LAW, []) is None
    drag = candidate(gap, Viscous((0,)))
    assert _limit(at, replace(made, candidate=drag), []) is None


def test_all_known_causes_of_a_joint_are_weighed_against_its_unknown_laws():
    """The joint is that with most of the torque of a cause."""
    near, far = cause("speed", 0, known=False), cause("time", 1, known=False)
    torque = {A.index[0]: (2.0, 1.0), B.index[0]: (1.0, 2.0)}
    at = Steps(
        {"abtime": 30.0, "bspeedtime": 31.0, "abspeed": 12.0, "aspeedtime": 20.0}
    )
    at.causes = [A, B, near, far]
    at.evidence = SimpleNamespace(
        solve=lambda index: SimpleNamespace(of=lambda own: own),
        fitted_squares=lambda own, gains: np.array(torque[own[0]]),
    )
    assert not is_known(at, A) and not is_known(at, B)
    # Either alone is worth less than the unknown law, both together more.
    torque[B.index[0]] = (2.0, 1.0)
    at.scores["speedtime"] = 3.0
    assert is_known(at, A) and is_known(at, B)


# --- accounts -------------------------------------------------------------------------


def test_an_account_has_what_is_explained_and_what_is_missed():
    found = Account(
        before=np.array([10.0, 5.0, 1.0]), after=np.array([4.0, 5.5, 1.0]),
        ceiling=np.array([1.0, 3.5, 2.0]), noise=np.ones(3), depends=("", "", ""),
    )  # fmt: skip
    np.testing.assert_allclose(found.explained, [6.0, 0.0, 0.0])
    np.testing.assert_allclose(found.missed, [3.0, 2.0, 0.0])
    assert found.unknown == pytest.approx(5.0 / 11.0)
    none = replace(found, before=found.ceiling, after=found.ceiling)
    assert none.unknown == 0.0


def test_an_account_is_of_all_joints_with_what_does_not_recur(monkeypatch):
    left = {0: [100.0, 50.0], 1: [60.0, 50.0], 2: [20.0, 40.0]}
    measured = np.array([2.0, 3.0])
    monkeypatch.setattr(account_module, "_slow_share", lambda s: np.array([0.0, 0.4]))
    at = SimpleNamespace(
        causes=[A, LAW], known=[A],
        gap=SimpleNamespace(robot=SimpleNamespace(size=2)),
        noise=SimpleNamespace(measured=measured), columns=len,
        evidence=SimpleNamespace(
            count=np.array([10, 0]),
            solve=lambda index: SimpleNamespace(of=lambda own: own),
            squares=lambda index, gains: np.array(left[gains]) * measured,
        ),
    )  # fmt: skip
    found = account(at)
    np.testing.assert_allclose(found.before, [100.0, 50.0])
    np.testing.assert_allclose(found.after, [60.0, 50.0])
    np.testing.assert_allclose(found.ceiling, [20.0, 0.6 * 40.0])
    np.testing.assert_allclose(found.noise, [20.0 * 2.0 / 10.0, 24.0 * 3.0])
    assert found.depends == ("speed", "what does not recur")
    less = account(at, np.array([15.0, 30.0]))
    np.testing.assert_allclose(less.ceiling, [15.0, 24.0])


@pytest.mark.parametrize(("lower", "counts"), [(1.9, False), (2.1, True)])
def test_what_is_too_slow_for_noise_is_a_third_of_the_residual(lower, counts):
    """Lines at 1 Hz and 8 Hz, in a band of 10 Hz whose upper half ends at 8.5 Hz."""
    t = np.arange(1000) / 50.0
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 8.0 * t)
    # 100 lines below 5 Hz have 100/70 of the upper ones in noise.
    size = np.sqrt((lower / 2.0 * 0.33 + 100 / 70) / (1 - lower / 2.0 * 0.33))
    at = SimpleNamespace(
        gap=SimpleNamespace(rate=50.0, cutoff=10.0), prior=Prior(), causes=[],
        columns=lambda causes: None,
        evidence=SimpleNamespace(
            residuals=lambda index: [size * slow + fast, np.zeros(0)],
            rows=[np.arange(1000), np.arange(0)],
        ),
    )  # fmt: skip
    share = lower / 2.0 * 0.33
    np.testing.assert_allclose(_slow_share(at), [share * counts, 0.0], atol=1e-9)


@cache
def searched():
    """A search of two joints with few effects, which has not run."""
    known = gap_of(
        Coulomb((0,), {"level": 1.0}), Viscous((1,), {"coefficient": 0.5}), size=2
    )
    few = ("coulomb", "viscous", "torque_offset")
    return Search(known, split(known), [x for x in effect_classes() if x not in few])


def test_what_is_left_without_causes_is_in_units_of_noise():
    """Squares of the torque of dry friction of one, and of noise."""
    at = searched()
    laws = Coulomb((0,)), Viscous((1,))
    at.causes = [at.cause(candidate(at.gap, x)) for x in laws]
    found = account(at)
    at.causes = []
    count = at.evidence.count
    # The links may take a part of it.
    assert 0.3 < found.before[0] * at.noise.measured[0] / count[0] < 1.1
    assert (found.after < 0.01 * count).all()
    np.testing.assert_array_equal(found.after, found.ceiling)
    noise = NOISE**2 * 2 * at.gap.cutoff / RATE
    np.testing.assert_allclose(found.noise, noise, rtol=0.5)


def test_what_was_refused_is_not_proposed():
    at = searched()
    every = {x.place for x in at.proposals([])}
    assert ("viscous", (1,)) in every
    at.refused = frozenset([("viscous", (1,))])
    assert ("viscous", (1,)) not in {x.place for x in at.proposals([])}
    at.refused = frozenset()
    assert any(x.candidate is None for x in at.proposals([]))
    at.library_only = True
    assert all(x.candidate is not None for x in at.proposals([]))
    at.library_only = False
    assert len([x for x in at.proposals([]) if x.candidate]) <= 6


def test_errors_of_known_laws_count_against_unknown_ones():
    at = searched()
    base = at.columns([])
    laws = at.laws.open([])
    plain = at.best_law(laws, [], base, base[:0], {})
    joint = plain.place[1][0]
    less = at.best_law(laws, [], base, base[:0], {joint: 1.0})
    if less.place == plain.place:
        assert less.worth == pytest.approx(plain.worth - 1.0)
    far = at.best_law(laws, [], base, base[:0], {joint: 1e6})
    assert far.place[1] != plain.place[1]


# --- explanations ---------------------------------------------------------------------


def explained(places, gains, becomes=(), learnt=None, scale=1.0):
    """An explanation with a column for each term, beside one of the background."""

    def effect(k):
        return SimpleNamespace(becomes=dict(becomes).get(k))

    terms = tuple(
        SimpleNamespace(place=x, candidate=SimpleNamespace(effect=effect(k)))
        for k, x in enumerate(places)
    )
    index = np.arange(10, 11 + len(places))
    columns = np.eye(len(index))

    def residuals(given, known):
        return [scale * (10.0 - columns @ known)]

    evidence = SimpleNamespace(residuals=residuals, rows=[np.array([0, 1, 49, 50, 99])])
    own = tuple(np.array([x]) for x in index[1:])
    gap = SimpleNamespace(rate=50.0, fold=np.zeros(100))
    return Explanation(
        gap, terms, evidence, index, np.array([0.5, *gains]), own, learnt
    )


def test_a_term_contributes_its_columns_times_its_gains():
    x = explained([("a", (0,)), ("b", (0,))], [2.0, 3.0])
    np.testing.assert_array_equal(x.rigid, [10])
    np.testing.assert_array_equal(x.without(0), [0.5, 0.0, 3.0])
    np.testing.assert_array_equal(x.without(0, 1), [0.5, 0.0, 0.0])
    np.testing.assert_allclose(x.after[0], [9.5, 8.0, 7.0])
    np.testing.assert_allclose(x.before[0], [9.5, 10.0, 10.0])
    np.testing.assert_allclose(x.contribution(1)[0], [0.0, 0.0, 3.0])
    assert x.named == ("a", "b") and x.members("b") == [1] and x.members("c") == []
    assert x.blocks(0).tolist() == [0, 0, 0, 1, 1]


@pytest.mark.parametrize(
    ("fall", "gain", "instead"),
    [(-1.0, 0.71, True), (-1.0, 0.69, False), (1.0, 2.0, False), (-1.0, -2.0, False)],
)
def test_a_declared_law_that_is_reduced_is_reported_under_what_takes_its_place(
    fall, gain, instead
):
    becomes = {1: ("velocity", "upper", "a")}
    x = explained([("a", (0,)), ("b", (0,))], [fall, gain], becomes)
    assert x.named == (("b", "b") if instead else ("a", "b"))
    assert x.members("b") == ([0, 1] if instead else [1])
    apart = explained([("a", (1,)), ("b", (0,))], [fall, gain], becomes)
    assert apart.named == ("a", "b")


@pytest.mark.parametrize(("scale", "seen"), [(0.15, True), (0.13, False)])
def test_what_hardly_acts_on_test_samples_is_seen_where_it_was_learnt(scale, seen):
    """Two hundredths of its squares: 0.14 of its torque."""
    learnt = explained([("a", (0,))], [2.0])
    x = explained([("a", (0,))], [2.0], learnt=learnt, scale=scale)
    assert (x.where_seen([0]) is x) == seen
    assert learnt.where_seen([0]) is learnt


# --- laws of signals ------------------------------------------------------------------


def test_a_smooth_sign_is_half_way_at_a_hundredth():
    x = np.array([-1.0, -0.02, 0.0, 0.02, 1.0])
    found = smooth_sign(x)
    np.testing.assert_allclose(found, [-1.0, -np.tanh(1), 0.0, np.tanh(1), 1.0])
    assert not smooth_sign(np.zeros(3)).any()


def test_lags_reach_no_further_back_than_the_begin_of_a_log():
    gap = SimpleNamespace(trajectory=np.repeat([0, 1], [40, 40]))
    x = np.arange(80.0) ** 2
    found = lagged_differences(gap, x)
    assert found.shape == (80, 6)
    for k, lag in enumerate((1, 2, 4, 8, 16, 32)):
        for row in (0, 5, 39, 40, 41, 79):
            first = 40 * (row >= 40)
            assert found[row, k] == x[max(row - lag, first)] - x[row]
    both = _with_lags(gap, x)
    np.testing.assert_array_equal(both, np.column_stack([x, found]))


def test_a_smooth_law_is_a_gaussian_process_of_a_long_and_a_short_length():
    """At the knots its covariance is the mean of two squared exponentials."""
    x = np.linspace(-3.0, 5.0, 10001)
    for count in (5, 9):
        features = smooth_features(x, count)
        ends = np.quantile(x, [0.002, 0.998])
        knots = np.linspace(*ends, count)
        at = features[np.searchsorted(x, knots - 1e-9)]
        apart = np.subtract.outer(np.arange(count), np.arange(count)) / (count - 1)
        kernel = (np.exp(-2.0 * apart**2) + np.exp(-50.0 * apart**2)) / 2
        np.testing.assert_allclose(at @ at.T, kernel, atol=0.02)
        # Linear between them, and constant beyond the ends.
        middle = features[np.searchsorted(x, (knots[1] + knots[2]) / 2)]
        np.testing.assert_allclose(middle, (at[1] + at[2]) / 2, atol=0.01)
        np.testing.assert_array_equal(features[0], features[5])
    assert np.isfinite(smooth_features(np.ones(10), 5)).all()
    # Modes of less than a thousandth of the strongest one are left out.
    assert smooth_features(x, 40).shape[1] < 40


def test_signals_are_filtered_log_by_log():
    gap = SimpleNamespace(
        trajectory=np.repeat([0, 1], [100, 80]), motions=[0, 1], rate=50.0
    )
    x = np.random.default_rng(0).standard_normal(180)
    found = low_passed(gap, x, 5.0)
    for rows in (slice(0, 100), slice(100, 180)):
        expected = butterworth(x[rows], rate=50.0, cutoff=5.0)
        np.testing.assert_allclose(found[rows], expected)
    slope = _derivative(gap, np.column_stack([np.arange(180.0) ** 2, x]))
    inner = np.r_[1:99, 101:179]
    np.testing.assert_allclose(slope[inner, 0], 50.0 * 2 * np.arange(180.0)[inner])
    assert slope[99, 0] == 50.0 * (99**2 - 98**2)


def test_waves_are_the_strongest_lines_over_time_and_position():
    gap = gap_of(count=1, seconds=20.0)
    rows = np.arange(len(gap.left))
    t = gap.sampled.t
    left = sum(a * np.sin(2 * np.pi * f * t) for a, f in ((3, 2.0), (2, 4.5), (1, 0.6)))
    left = left + 9.0 * np.sin(2 * np.pi * 0.25 * t)  # too slow
    (where, over_position), (when, over_time) = waves(gap, 0, left, rows)
    assert (where, when) == ("waves of position", "waves in time")
    assert over_position.shape[1] <= 6 and over_time.shape[1] == 6
    for k, f in enumerate((2.0, 4.5, 0.6)):
        sine, cosine = over_time[:, 2 * k], over_time[:, 2 * k + 1]
        np.testing.assert_allclose(sine, np.sin(2 * np.pi * f * t), atol=1e-6)
        np.testing.assert_allclose(cosine, np.cos(2 * np.pi * f * t), atol=1e-6)


def test_a_twist_moves_every_drive_before_it():
    gap = gap_of(size=2, count=2)
    names = dict(transmission_laws(gap, 1))
    assert set(names) == {"twist with load", "twist with position"}
    for columns in names.values():
        assert sorted(columns) == [0, 1]
        assert columns[0].shape == columns[1].shape
        assert len(columns[0]) == len(gap.left)


# --- small fits -----------------------------------------------------------------------


def test_lengths_of_zero_have_no_inverse():
    np.testing.assert_array_equal(_inverse(np.array([2.0, 0.0, 1e-3])), [0.5, 0, 1e3])


def test_least_squares_are_those_of_columns_of_any_size():
    rng = np.random.default_rng(0)
    X, gains = rng.standard_normal((30, 3)) * [1e-6, 1.0, 1e6], [1e6, -2.0, 3e-6]
    np.testing.assert_allclose(_least(X, X @ gains), gains)
    X[:, 1] = 0.0
    np.testing.assert_allclose(_least(X, X @ gains), [1e6, 0.0, 3e-6], atol=1e-9)


def test_squares_are_solved_from_cross_products():
    rng = np.random.default_rng(1)
    signals = rng.standard_normal((2, 50, 9))
    G = np.einsum("kmi,kmj->kij", signals, signals)
    columns, target = np.eye(9)[:, :3], np.eye(9)[7]
    squares, x = _solve(G, columns, target)
    for k in range(2):
        A, y = signals[k] @ columns, signals[k] @ target
        expected, (rest,), *_ = np.linalg.lstsq(A, y)
        np.testing.assert_allclose(x[k], expected, rtol=1e-6)
        assert squares[k] == pytest.approx(rest)


def test_values_have_errors_of_their_law_and_times_of_a_sample():
    gap = SimpleNamespace(period=0.02, motions=[SimpleNamespace(temperature=None)])
    law = Stribeck((0,), {"level": 2.0, "velocity": 0.3})
    names = _names(gap, law)
    assert names == ["level", "velocity", "exponent"]
    inexact = [law.inexact.get(x, 0.0) * law.values[x] for x in names]
    np.testing.assert_allclose(_model_variance(gap, law), np.square(inexact))
    timed = next(
        x for x in effect_classes().values()
        if any(s.unit == "s" and not s.whole for s in x.shapes) and x.scope == "joint"
    )((0,))  # fmt: skip
    variance = _model_variance(gap, timed)
    shapes = timed.shapes_along(gap.motions)
    for k, s in enumerate(shapes, len(timed.gains)):
        own = timed.inexact.get(s.name, 0.0) * timed.values[s.name]
        time = 0.02**2 / 12.0 if s.unit == "s" else 0.0
        assert variance[k] == pytest.approx(own**2 + time)
    offset = TorqueOffset((0,), {"level": 1.0})
    assert _model_variance(gap, offset).shape == (1,)


def test_laws_of_a_joint_are_of_each_signal_and_of_pairs_of_them():
    gap = gap_of(size=2, count=2)
    found = dict(joint_laws(gap, 1))
    assert list(found) == [
        "position", "speed", "acceleration", "load", "time", "direction and position",
        "direction and load", "direction and acceleration", "speed and time",
        "speed and position", "load and position", "speed of hinge_0",
        "acceleration of hinge_0", "position of hinge_0", "past of speed",
        "past of load", "past of direction", "past of side",
    ]  # fmt: skip
    m = gap.sampled
    v, q = m.v[:, 1], m.q[:, 1]
    root = np.sign(v) * np.sqrt(np.abs(v))
    np.testing.assert_allclose(found["speed"], smooth_features(root, 28))
    np.testing.assert_allclose(found["position"], smooth_features(q, 28))
    np.testing.assert_allclose(found["time"], smooth_features(m.t, 28))
    slow = low_passed(gap, m.a[:, 1], 3.0)
    np.testing.assert_allclose(found["acceleration"], smooth_features(slow, 14))
    turned = smooth_sign(v)[:, None] * smooth_features(q, 14)
    expected = low_passed(gap, turned, 10.0)
    np.testing.assert_allclose(found["direction and position"], expected)
    aged = v[:, None] * smooth_features(m.t, 14)
    np.testing.assert_allclose(found["speed and time"], aged)
    one, other = smooth_features(q, 6), smooth_features(v, 6)
    both = np.einsum("ti,tj->tij", one, other).reshape(len(q), -1)
    np.testing.assert_allclose(found["speed and position"], both)
    past = lagged_differences(gap, low_passed(gap, v, 3.0))
    np.testing.assert_allclose(found["past of speed"], low_passed(gap, past, 10.0))
    beside = smooth_features(m.v[:, 0], 14)
    np.testing.assert_allclose(found["speed of hinge_0"], beside)


def test_laws_of_load_and_of_other_joints_are_of_slow_signals():
    gap = gap_of(size=2, count=2)
    found, m = dict(joint_laws(gap, 1)), gap.sampled
    load = low_passed(gap, gap.load[:, 1], 3.0)
    sign, side = smooth_sign(m.v[:, 1]), smooth_sign(gap.load[:, 1])
    own, other = (low_passed(gap, m.a[:, j], 3.0) for j in (1, 0))

    def both(x, y, count):
        pairs = smooth_features(x, count), smooth_features(y, count)
        return np.einsum("ti,tj->tij", *pairs).reshape(len(x), -1)

    def filtered(x):
        return low_passed(gap, x, 10.0)

    expected = {
        "load": smooth_features(load, 14),
        "direction and load": filtered(sign[:, None] * smooth_features(load, 14)),
        "direction and acceleration": filtered(
            sign[:, None] * smooth_features(own, 14)
        ),
        "load and position": both(m.q[:, 1], load, 6),
        "acceleration of hinge_0": smooth_features(other, 14),
        "position of hinge_0": both(m.q[:, 1], m.q[:, 0], 4),
        "past of load": filtered(lagged_differences(gap, load)),
        "past of direction": filtered(lagged_differences(gap, sign)),
        "past of side": filtered(lagged_differences(gap, side)),
    }
    for name, law in expected.items():
        np.testing.assert_allclose(found[name], law, err_msg=name)


def test_a_twist_is_of_the_link_s_angle_speed_and_acceleration():
    """The torque of a link that is off by an angle, as the slopes say it."""
    gap = gap_of(size=2, count=1)
    found = dict(transmission_laws(gap, 1))["twist with position"]
    x = low_passed(gap, smooth_features(gap.sampled.q[:, 1], 8), 5.0)
    changes = x, _derivative(gap, x), _derivative(gap, _derivative(gap, x))
    ((_, body, sampler),) = list(gap)
    slopes = [s[:: sampler.factor] for s in body.slopes(1)]
    for j in (0, 1):
        torque = sum(s[:, j, None] * c for s, c in zip(slopes, changes, strict=True))
        np.testing.assert_allclose(found[j], torque)
    load = low_passed(gap, gap.load[:, 1], 5.0)
    side = np.tanh(load / np.sqrt(np.mean(load**2)))
    y = np.hstack([
        low_passed(gap, _with_lags(gap, side), 10.0), _with_lags(gap, load),
    ])  # fmt: skip
    changes = y, _derivative(gap, y), _derivative(gap, _derivative(gap, y))
    found = dict(transmission_laws(gap, 1))["twist with load"]
    torque = sum(s[:, 1, None] * c for s, c in zip(slopes, changes, strict=True))
    np.testing.assert_allclose(found[1], torque, rtol=1e-6, atol=1e-9)
