"""The course of a search and of a diagnosis: what is asked when, of stated answers."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import NOISE, pendulum, swings, with_torque

from hybrid.diagnosis import diagnose as diagnose_module
from hybrid.diagnosis.advice import advise as advise_module
from hybrid.diagnosis.advice.advise import Plan, _between
from hybrid.diagnosis.answer.diagnosis import Advice
from hybrid.diagnosis.diagnose import _Case, examine
from hybrid.diagnosis.explanations import search as search_module
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.posterior import Posterior
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.diagnosis.gap.servo import LATENCIES, laws, servo_logs
from hybrid.diagnosis.prior import Prior
from hybrid.effects.contact import Contact
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.torque_gain import TorqueGain
from hybrid.recording import Recording
from hybrid.signals.filters import butterworth


def cause(name, joint=0, *, known=True, repeats=""):
    effect = SimpleNamespace(repeats=repeats, reaches=lambda n: (joint,))
    made = SimpleNamespace(place=(name, (joint,)), effect=effect) if known else None
    return Cause((name, (joint,)), np.array([ord(name[0])]), 10.0, made)


A, B, C, LAW = cause("a"), cause("b"), cause("c", 1), cause("speed", known=False)


def named(causes):
    return "".join(sorted(c.place[0] for c in causes))


class Course(Search):
    """A search that writes down what it does; nothing is computed."""

    def __init__(self, causes=(), **answers):
        self.causes, self._certain, self.refused = list(causes), [], frozenset()
        self.prior, self.beliefs, self.did = Prior(), [], []
        self.file_error = 0.02
        self.library_only, self._checked, self.whole = False, {}, []
        self.evidence = SimpleNamespace(
            noise=np.ones(2), scale_prior=lambda numbers, x: self._do(f"prior {x}")
        )
        self.numbers = np.zeros(1, dtype=int)
        self.answers = answers

    def _do(self, what, *default):
        self.did.append(what)
        found = self.answers.get(what, default[0] if default else None)
        return found.pop(0) if isinstance(found, list) else found

    def score(self, causes):
        return self.answers["score"][named(causes)]

    def _add(self):
        return self._do("add", False)

    def _exchange(self, cause):
        done = self._do(f"exchange {cause.place[0]}", False)
        if not done:
            self._checked[cause] = self._neighbours(cause), self._settings
        return done

    def _fit_file_error(self):
        return self._do("fit", False)

    def _exchange_file_error(self):
        return self._do("exchange file", False)

    def update_noise(self, causes):
        return self._do("noise", False)

    def unseen_gain(self, causes):
        gains = self.answers.get("gains", {})
        return {c: gains.get(named(causes), {}).get(c.place[0], 1.0) for c in causes}

    def unseen_loss(self, causes):
        return np.array(self.answers.get("loss", {}).get(named(causes), (0.0, 0.0)))

    def held_out_loss(self, causes):
        return np.array(self.answers.get("held out", {}).get(named(causes), (5.0, 5.0)))

    def _remove(self):
        self._do("remove")


# --- one course -----------------------------------------------------------------------


def test_a_round_adds_and_exchanges_until_nothing_changes():
    tried = {"exchange a": [True, False, False]}
    at = Course([A, B], add=[True, True, False, False], **tried)
    at._improve()
    assert at.did[:5] == ["add", "add", "add", "exchange a", "exchange b"]
    # What was tried in vain is tried again only where something near has changed.
    assert at.did[5:] == ["add", "exchange a", "fit", "exchange file"]


class Exchange(Course):
    """A course with the exchange of a search, of stated proposals."""

    _exchange = Search._exchange

    def proposals(self, causes, own=None):
        self.did.append(f"proposals {own.place[0]}")
        return self.answers["proposals"]

    def is_cross_validated(self, causes):
        return False

    def _with_shapes_refitted(self, causes, new):
        return [*causes, new]


@pytest.mark.parametrize(("worth", "again"), [(94.0, 1), (92.0, 0)])
def test_other_noise_lets_a_cause_be_exchanged_where_another_one_is_near(worth, again):
    proposed = [SimpleNamespace(cause=B, worth=worth)]  # of 100 nats, and odds of 7
    score = {"": 0.0, "a": 100.0, "b": worth}
    at = Exchange([A], score=score, proposals=proposed)
    at._improve()
    at._improve()
    assert at.did.count("proposals a") == 1
    at.evidence.noise = at.evidence.noise / 2
    at._improve()
    assert at.did.count("proposals a") == 1 + again
    at.causes = [A, cause("d")]  # at the same joint
    at.answers["score"] = {"ad": 120.0, "d": 20.0, "a": 100.0, "bd": 30.0, "ab": 100.0}
    before = at.did.count("proposals a")
    at._improve()
    assert at.did.count("proposals a") == before + 1


def test_a_round_is_repeated_where_the_error_of_the_file_has_changed():
    at = Course([], fit=[True, False, False], **{"exchange file": [True, False]})
    at._improve()
    assert at.did == [
        "add", "fit", "add", "fit", "exchange file", "add", "fit", "exchange file",
    ]  # fmt: skip
    endless = Course([], fit=[True] * 9)
    endless._improve()
    assert endless.did == ["add", "fit"] * 4


def test_a_cause_that_is_gone_is_not_exchanged():
    at = Course([A, B])

    def exchange(cause):
        at.did.append(f"exchange {cause.place[0]}")
        at.causes = [A]
        return True

    at._exchange = exchange
    at._improve()
    assert "exchange b" not in at.did and at.did.count("exchange a") == 4


def test_a_search_has_converged_where_all_causes_help_and_nothing_is_set_anew():
    at = Course([A], noise=[True, False])
    at._improve = lambda most: at.did.append("improve")
    at._converge()
    assert at.did == ["improve", "noise", "improve", "noise"]


def test_a_search_for_few_causes_stops_at_one_more():
    at = Course([A, B], add=[True, True, True, False])
    add = at._add

    def grow():
        at.causes = [*at.causes, cause("xyz"[len(at.causes) - 2], len(at.causes))]
        return add()

    at._add = grow
    at._converge(most=3)
    assert named(at.causes) == "abxy" and at.did == ["add", "add"]
    at.did, at._add = [], lambda: False
    at._converge()  # all causes, and no further one
    assert [x for x in at.did if "exchange " in x and "file" not in x] == [
        "exchange a", "exchange b", "exchange x", "exchange y",
    ]  # fmt: skip


def test_causes_that_do_not_help_unseen_are_refused():
    gains = {"ab": {"b": 0.0}, "abc": {"b": -1.0, "c": -2.0}}
    at = Course([A, B], gains=gains)
    at._improve = lambda most: None
    at._converge()
    assert at.causes == [A] and at.refused == {B.place}
    at = Course([A, B, C], gains=gains)
    at._improve = lambda most: None
    at._converge()
    assert at.causes == [A] and at.refused == {B.place, C.place}
    certain = Course([A, B], gains=gains)
    certain._certain, certain._improve = [B], lambda most: None
    certain._converge()
    assert certain.causes == [A, B]


class Returning(Course):
    """A course that adds a cause wherever it is not refused."""

    def _add(self):
        new = [
            c for c in (A, B) if c not in self.causes and c.place not in self.refused
        ]
        self.causes = [*self.causes, *new]
        return bool(new)


@pytest.mark.parametrize(
    ("helps", "kept"), [([0.0, 1.0, 1.0], [A, B]), ([0.0, 0.0, 1.0], [A])]
)
def test_a_cause_that_failed_beside_another_noise_is_tried_once_more(helps, kept):
    at = Returning(noise=[True, True, False])
    at.unseen_gain = lambda causes: {c: helps.pop(0) if c is B else 1.0 for c in causes}
    at._converge()
    assert at.causes == kept
    assert at.refused == ({B.place} if kept == [A] else frozenset())


def run(causes, **answers):
    """Whether a search that found some causes starts anew from the usual ones."""
    at = Course(causes)
    at._converge = lambda most: at.did.append("converge")
    at._restart = lambda: at.did.append("restart")
    simple, improbable = answers.get("simple", [False]), answers.get("less", [False])
    at._replace_limits = lambda: at._do("limits") or simple.pop(0)
    at._replace_improbable = lambda: at._do("replace") or improbable.pop(0)
    with pytest.MonkeyPatch.context() as m:
        m.setattr(search_module, "beliefs", lambda s: s.did.append("beliefs") or [1])
        found = at.run()
    assert found == at.causes == at.whole and at.beliefs == [1]
    return at.did


def test_a_search_of_few_known_causes_is_done_and_others_start_anew():
    done = ["beliefs", "limits", "replace"]
    assert run([A, B, C]) == ["converge", *done]
    assert run([A, B, C, cause("d")]) == ["converge", "restart", *done]
    assert run([A, LAW]) == ["converge", "restart", *done]
    again = run([A], simple=[True, False, False], less=[True, False])
    assert again == [
        "converge", "beliefs", "limits", "beliefs", "limits", "replace",
        "beliefs", "limits", "replace",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("fresh", "error", "loss", "kept"),
    [
        (11.0, 0.02, (5.0, 5.0), "b"), (9.0, 0.02, (4.0, 4.0), "a"),
        (30.0, 0.2, (4.0, 5.0), "b"), (24.0, 0.2, (4.0, 4.0), "a"),
        (13.0, 0.02, (4.0, 9.0), "a"), (13.0, 0.02, (9.0, 4.0), "a"),
        (15.0, 0.02, (4.0, 9.0), "b"), (15.0, 0.02, (9.0, 4.0), "b"),
    ],
)  # fmt: skip
def test_the_more_probable_of_two_courses_is_kept_if_it_foretells(
    fresh, error, loss, kept
):
    """An error of the file of a fifth costs fifteen nats here."""
    at = Course([A], score={"a": 10.0, "b": fresh}, **{"held out": {"b": loss}})
    at.file_error_odds = lambda x: 15.0 * (x > 0.02)
    at.set_file_error = lambda x: setattr(at, "file_error", x)
    modes = []

    def converge():
        modes.append(at.library_only)
        at.causes, at.file_error = [B], error

    at._converge, at.refused = converge, frozenset([C.place])
    at._with_usual = lambda causes: [C, *causes]
    at._restart()
    assert named(at.causes) == kept and modes == [True, False]
    assert at.refused == ({C.place} if kept == "a" else set())
    assert at.library_only is False
    assert at.file_error == (0.02 if kept == "a" else error)
    courses = [f"prior {x}" for x in (error, 0.02, at.file_error)]
    assert at.did == ["fit", "noise", "remove", *courses]


@pytest.mark.parametrize(("causes", "goes_on"), [((A, B, C), 0), ((A, B, C, LAW), 1)])
def test_a_search_that_had_stopped_goes_on_where_its_end_is_kept(causes, goes_on):
    at = Course(causes, score={named(causes): 10.0, "z": 1.0})
    at.file_error_odds, at.set_file_error = lambda x: 0.0, lambda x: None
    at._with_usual, ends = lambda there: [], []

    def converge():
        ends.append(named(at.causes))
        if len(ends) <= 2:
            at.causes = [cause("z")]

    at._converge = converge
    at._restart()
    assert at.causes == list(causes)
    assert ends == ["", "z", *[named(causes)] * goes_on]


def test_unknown_laws_give_way_to_effects_that_help_unseen():
    at = Course([A, B, LAW], gains={"ab": {"b": 0.0}})
    at.whole = [A, B, LAW]
    at._converge = lambda: at.did.append("converge")
    at._with_usual = lambda causes: [*causes, C]
    at.answers["score"] = {"a": 1.0, "ac": 2.0}
    at.substitute_unknown_laws()
    assert at.causes == [A, C] and at._certain == [A] and at.library_only
    assert at.did == ["remove", "converge"]
    worse = Course([A, LAW], score={"a": 3.0, "ac": 2.0})
    worse.whole, worse._with_usual = [A, LAW], at._with_usual
    worse._converge = lambda: None
    worse.substitute_unknown_laws()
    assert worse.causes == [A]
    same = Course([A])
    same.whole = [A]
    same.substitute_unknown_laws()
    assert not same.did and same.library_only is False
    same._replaced = True  # an effect was dropped, and no unknown law took its place
    same._with_usual, same._converge = at._with_usual, lambda: None
    same.answers["score"] = {"a": 1.0, "ac": 2.0}
    same.substitute_unknown_laws()
    assert same.causes == [A, C] and same._certain == [A]


def test_usual_effects_are_tried_with_all_widths_of_their_prior(monkeypatch):
    @dataclass(frozen=True)
    class Usual:
        place: tuple
        prior_factor: float = 1.0

    listed = [Usual(("a", (0,))), Usual(("c", (1,)))]
    monkeypatch.setattr(search_module, "usual", lambda gap, without: listed)
    at = Course()
    at.gap, at.pool = None, SimpleNamespace(without=())
    at.cause = lambda c: (c.place[0], c.prior_factor)
    at.score = lambda causes: -abs(np.log10(causes[-1][1] / 3.0))
    assert at._with_usual([A]) == [A, ("c", 10.0**0.5)]
    assert at._with_usual([]) == [("a", 10.0**0.5), ("c", 10.0**0.5)]


# --- losses ---------------------------------------------------------------------------


class Losses(Posterior):
    """A posterior whose evidence is stated."""

    def __init__(self, **evidence):
        self.prior, self.rigid = Prior(), np.array([0, 1])
        self.evidence = SimpleNamespace(
            solve=lambda index: index, precision=np.ones(1),
            prior_squares=lambda solution, columns: 6.0, **evidence,
        )  # fmt: skip
        self.numbers, self._cache = np.zeros(1, int), {}
        self.pool, self.gap = SimpleNamespace(without=("viscous",)), None


def test_a_held_out_loss_is_half_of_the_squares_with_those_of_the_background():
    asked = []
    folds = np.array([[1.0, 7.0], [3.0, 3.0]])
    at = Losses(held_out_losses=lambda x: asked.append(x) or folds)
    np.testing.assert_allclose(at.held_out_loss([A]), [5.0, 8.0])
    np.testing.assert_allclose(at.held_out_loss([A]), [5.0, 8.0])
    assert len(asked) == 1  # it is kept
    at.evidence.precision = np.array([4.0])
    at.held_out_loss([A])
    assert len(asked) == 2  # but not for another error of the file


def test_an_unseen_loss_is_scaled_to_the_training_samples():
    at = Losses(noise=np.array([2.0, 4.0]), count=np.array([30, 10]))
    at.__dict__["test"] = SimpleNamespace(
        weighted_squares=lambda causes: np.array([3.0, 1.0]),
        squares=lambda causes: np.array([8.0, 8.0]),
        evidence=SimpleNamespace(count=np.array([15, 5])),
    )
    np.testing.assert_allclose(at.unseen_loss([]), [(4 * 2 + 6) / 2, (6 * 2 + 6) / 2])
    at.test.evidence.count = np.array([0, 0])
    np.testing.assert_allclose(at.unseen_loss([]), [(4 * 40 + 6) / 2] * 1 + [123.0])


def test_a_cause_helps_by_the_smaller_fall_also_against_its_simpler_law():
    at = Losses(noise=np.array([2.0]), count=np.array([20]))
    losses = {"a": (5.0, 5.0), "": (9.0, 8.0), "x": (7.0, 5.5), "ab": (2.0, 1.0)}
    losses |= {"b": (4.0, 4.5), "bx": (9.0, 9.0)}
    at.unseen_loss = lambda causes: np.array(losses[named(causes)])
    at._simpler = lambda c, rest: [cause("x")] if c is A else []
    at.test = SimpleNamespace(tests=lambda c, causes: True)
    at._falls = lambda causes: np.array([9.0])
    assert at.unseen_gain([A]) == {A: 0.5} and at.unseen_gain([]) == {}
    assert at.unseen_gain([A, B]) == {A: 2.0, B: 3.0}
    at.test.tests = lambda c, causes: False
    assert at.unseen_gain([A, B]) == {A: 2.0, B: 3.0}
    push, at.is_isolated = cause("a", repeats="recording"), lambda c, _: c is push
    assert at.unseen_gain([push, B]) == {push: np.inf, B: 3.0}
    at.is_isolated = lambda c, causes: False  # nothing tells that it is there
    assert at.unseen_gain([push, B]) == {push: 0.0, B: 3.0}
    at.is_isolated = lambda c, causes: c is push
    at.test.tests = lambda c, causes: True
    assert at.unseen_gain([push, B]) == {push: 2.0, B: 3.0}


def test_a_cause_helps_by_no_more_than_its_joints_fall_from_the_file_as_it_stands():
    at = Losses(noise=np.array([2.0]), count=np.array([20]))
    losses = {"a": (5.0, 5.0), "b": (6.0, 6.0), "ab": (2.0, 1.0)}
    at.unseen_loss = lambda causes: np.array(losses[named(causes)])
    at._simpler = lambda c, rest: []
    at.test = SimpleNamespace(tests=lambda c, causes: c is A)
    for falls, helps in ((-3.0, -3.0), (1.0, 1.0), (9.0, 4.0)):
        at._falls = lambda causes, x=falls: np.array([x])
        # What does not act on the test samples is not compared with the file there.
        assert at.unseen_gain([A, B]) == {A: helps, B: 3.0}


def test_the_fall_from_the_file_does_not_count_what_no_cause_explains():
    """Two joints: one with an event without a cause, for a tenth of the time."""
    rng = np.random.default_rng(0)
    before, event = rng.standard_normal((2, 1000)), np.arange(1000) // 100 == 4
    after = 2.0 * before
    before[0, event] += 100.0  # a tenth of it is fitted, at the cost of all the rest
    after[0, event] += 90.0
    after[1] /= 4.0
    at = Losses(noise=np.array([2.0, 4.0]), count=np.array([600, 600]))
    at.gap = SimpleNamespace(rate=100.0)
    at.test = SimpleNamespace(
        residuals=lambda causes: [*after],
        evidence=SimpleNamespace(
            rows=[np.arange(1000)] * 2, left=[*before], count=np.array([200, 200])
        ),
    )
    usual = before[0, ~event]
    expected = [-3 * usual @ usual, 0.75 * before[1] @ before[1]]
    expected = 3.0 * np.array(expected) / at.evidence.noise / 2
    np.testing.assert_allclose(at._falls([A]), expected)


def test_the_simpler_law_of_a_cause_is_made_unless_it_is_there():
    at = Losses()
    at.cause = lambda c: c.place
    at.gap = measure_gap(pendulum(), swings(count=1), cutoff=10.0)

    def law(becomes):
        effect = SimpleNamespace(becomes=becomes)
        return replace(A, candidate=SimpleNamespace(effect=effect, place=A.place))

    soft = law(("distance", "lower", "coulomb"))
    place = "coulomb", (0,)
    assert at._simpler(soft, []) == [place] == at._simpler(soft, [])
    there = replace(A, place=place)
    assert at._simpler(soft, [there]) == []
    assert at._simpler(law(None), []) == at._simpler(LAW, []) == []
    assert at._simpler(law(("x", "lower", "")), []) == []
    assert at._simpler(law(("x", "lower", "viscous")), []) == []  # left out


def test_values_are_reported_for_a_twentieth_of_an_error_at_least():
    at = Losses()
    for error, reported in ((0.01, 0.05), (0.05, 0.05), (0.1, 0.1)):
        at.file_error = error
        assert at.reported_file_error == reported


def test_what_depends_on_the_noise_is_forgotten_with_it():
    at = Losses()
    for lower in (False, True):
        at.noise = SimpleNamespace(lower=lambda rigid, columns, x=lower: x)
        at.done = []
        at._set_noise = lambda: at.done.append(1)
        assert at.update_noise([]) == lower and len(at.done) == lower


# --- signals of a servo ---------------------------------------------------------------


def commanded(count=2, seconds=6.0, late=0.05, size=1, seed=0):
    """Logs of swings whose command is the position by some time later."""
    found = []
    for k, m in enumerate(swings(size, count=count, seconds=seconds, seed=seed)):
        ahead = np.stack([np.interp(m.t + late, m.t, x) for x in m.q.T], axis=1)
        tau = with_torque(m, (), NOISE, k).tau
        found.append(
            Recording(m.t + 7.0 * k, m.q, tau=tau, command=ahead, joints=m.joints)
        )
    return found


def test_signals_of_a_servo_are_those_of_the_samples_of_the_gap():
    logs = commanded()
    gap = measure_gap(pendulum(), logs, cutoff=10.0)
    (log,) = servo_logs(gap, logs)
    assert (gap.moving[log.row, 0]).all() and (np.diff(log.row) > 0).all()
    since = gap.sampled.t[log.row] - np.array([0.0, 7.0])[gap.trajectory[log.row]]
    assert since.min() > 0.2  # before, no earlier command is known
    weight, q, v, a = log.own.T
    inner = (since > 0.5) & (since < 5.5)
    np.testing.assert_allclose(q[inner], gap.sampled.q[log.row, 0][inner], atol=2e-3)
    # A rod of 2 kg whose centre is at 0.3 m.
    still = 2.0 * 9.81 * 0.3 * np.sin(gap.sampled.q[log.row, 0])
    np.testing.assert_allclose(weight[inner], still[inner], atol=0.05)
    np.testing.assert_allclose(log.torque(log.t), gap.measured[log.row, 0], atol=1e-6)
    feed, command, speed = log.asked(log.t).T
    expected = np.concatenate([
        butterworth(x.command[:, 0], rate=100.0, cutoff=10.0) for x in logs
    ])  # fmt: skip
    rows = (
        np.round(gap.sampled.t[log.row] * 100 - 700 * gap.trajectory[log.row]).astype(
            int
        )
        + gap.trajectory[log.row] * 600
    )
    np.testing.assert_allclose(command[inner], expected[rows][inner], atol=0.01)
    # The command is what the position is 50 ms later, and so is its speed.
    later = log.asked(log.t - 0.05)
    np.testing.assert_allclose(later[inner, 1], q[inner], atol=0.01)
    np.testing.assert_allclose(later[inner, 2], v[inner], atol=0.1)
    # Logs follow each other without overlap; in each, time is that of its clock.
    for k in (0, 1):
        own = gap.trajectory[log.row] == k
        start = log.t[own] - since[own]
        np.testing.assert_allclose(start, start[0], atol=1e-9)
    assert log.t[gap.trajectory[log.row] == 1].min() > 6.0 + 0.2
    A = log.signals(0.0, 0.0)
    np.testing.assert_allclose(A[:, 2], command - q)
    assert (A[:, 6] == 1.0).all() and A.shape[1] == 9
    # Of the torque a little later, and its slope.
    B = log.signals(0.0, 0.002)
    np.testing.assert_allclose((B[:, 7] - A[:, 7]) / 0.002, A[:, 8], atol=25.0)
    np.testing.assert_allclose(log.drift(0.0)[:, 2], -log.asked(log.t, 1)[:, 1])


def test_without_a_command_or_motion_a_servo_tells_nothing():
    logs = commanded()
    gap = measure_gap(pendulum(), logs, cutoff=10.0)
    silent = [replace(x, command=None) for x in logs]
    assert servo_logs(gap, silent) == [None]
    half = [logs[0], silent[1]]
    (log,) = servo_logs(gap, half)
    assert (gap.trajectory[log.row] == 0).all()
    second = [silent[0], logs[1]]
    (log,) = servo_logs(gap, second)
    assert (gap.trajectory[log.row] == 1).all()
    few = np.zeros_like(gap.moving)
    since = gap.sampled.t - np.array([0.0, 7.0])[gap.trajectory]
    late = np.flatnonzero(since > 0.3)
    for count, none in ((69, True), (70, False)):
        few[:] = False
        few[late[:count]] = True
        (found,) = servo_logs(replace(gap, moving=few), logs)
        assert (found is None) == none


@pytest.mark.parametrize("part", [0.97, 0.99])
def test_torque_near_its_limit_is_no_law_of_a_servo(part):
    logs = commanded()
    gap = measure_gap(pendulum(), logs, cutoff=10.0)
    most = np.abs(gap.measured[gap.moving[:, 0], 0]).max()
    tight = replace(gap, robot=replace(pendulum(), tau_max=np.array([most / part])))
    (log,) = servo_logs(tight, logs)
    (whole,) = servo_logs(gap, logs)
    limit = 0.98 * most / part
    expected = np.abs(gap.measured[whole.row, 0]) <= limit
    np.testing.assert_array_equal(log.row, whole.row[expected])


def test_parts_of_a_servo_s_log_have_its_samples():
    logs = commanded(seconds=40.0)
    gap = measure_gap(pendulum(), logs, cutoff=10.0)
    (log,) = servo_logs(gap, logs)
    use = np.arange(len(gap.left)) % 3 == 0
    part = log.at(use[log.row])
    assert (part.row % 3 == 0).all() and len(part.row) == (log.row % 3 == 0).sum()
    np.testing.assert_array_equal(part.own, log.own[log.row % 3 == 0])
    step = len(log.row) // 2000
    assert step == 1 and log.thin.row.tolist() == log.row.tolist()
    twice = replace(
        log, row=np.tile(log.row, 2), t=np.tile(log.t, 2), own=np.tile(log.own, (2, 1))
    )
    k = len(twice.row) // 2000
    assert twice.thin.row.tolist() == twice.row[::k].tolist() and k >= 2
    assert LATENCIES[0] == 0.0 and 0.19 < LATENCIES[-1] < 0.2


def test_laws_are_of_every_feed_forward_with_the_speed_of_the_command_or_without():
    free = list(laws())
    assert len(free) == 2 * (1 + 2 + 2)
    assert sum(x.scaled for x in free) == 4
    assert all(x.columns.shape[1] == (5 if x.scaled else 4) for x in free)
    given = list(laws(80.0, 5.0))
    assert len(given) == 10
    for law in given:
        assert law.columns.shape[1] == (3 if law.scaled else 2)
        whole = law.columns[:, 0] if law.scaled else np.eye(9)[7] - law.target
        assert (whole[2], whole[4]) == (80.0, -5.0) and whole[3] in (0.0, 5.0)


# --- the course of a diagnosis --------------------------------------------------------


def course(*, too_little=None, healthy=None, verdict="explained", effects=()):
    """What a diagnosis is asked of in turn, with a case and answers that are stated."""
    told, asked = [], {}
    case = SimpleNamespace(
        as_logged="as logged", gap="gap", recordings="logs", without=("x",),
        too_little=too_little, healthy=healthy,
    )  # fmt: skip

    @dataclass(frozen=True)
    class Found:
        verdict: str
        noise_floor: tuple = (1.0, 2.0)
        where: tuple = ()
        sentence: str = ""
        findings: tuple = ()
        warnings: tuple = ()

    @dataclass(frozen=True)
    class Of:
        diagnosis: Found
        effects: tuple
        account: str = "account"
        command: tuple = ()

    def link(gap, logs, rng, *, without, distorted):
        asked.update(gap=gap, without=without, distorted=distorted)
        return SimpleNamespace(effects=("late",))

    with pytest.MonkeyPatch.context() as m:
        for name, answer in {
            "_explained": lambda case, tell, rng: Of(Found(verdict), effects),
            "locate": lambda gap, floor, rng: (gap, *floor),
            "command_link": link,
            "merged_links": lambda d, *rest: replace(d, where=("merged", *d.where)),
            "headline": lambda found: f"it is {found.verdict}",
        }.items():
            m.setattr(diagnose_module, name, answer)
        m.setattr(_Case, "of", lambda *given: case)
        found = examine(None, [], progress=lambda *x: told.append(x))
    return found, told, asked


def test_a_diagnosis_measures_explains_locates_and_asks_of_the_command():
    late = Delay((0,), {"time": 0.01}), TorqueGain((1,), {"gain": 0.1})
    found, told, asked = course(effects=(*late, Coulomb((0,), {"level": 1.0})))
    assert found.diagnosis.where == ("merged", "as logged", 1.0, 2.0)
    assert found.command == ("late",)
    assert found.diagnosis.sentence == f"it is {found.diagnosis.verdict}"
    assert asked == {"gap": "gap", "without": ("x",), "distorted": {0, 1}}
    parts = [x for _, x in told]
    assert parts == sorted(parts) and parts[0] == 0.0 < parts[1] and parts[2] < 1.0


def test_nothing_is_asked_of_logs_that_are_not_enough_or_of_a_healthy_model():
    found, told, asked = course(verdict="not_excited")
    assert found.diagnosis.where == () and [x for _, x in told] == [0.0]
    for given in ({"too_little": "?"}, {"healthy": "model"}):
        found, told, asked = course(**given)
        assert found.diagnosis.where == ("as logged", 1.0, 2.0) and not asked
        assert found.command == () and len(told) == 2


# --- rivals ---------------------------------------------------------------------------


class Kind:
    """A term or a candidate of an effect at a joint."""

    def __init__(self, name, joint, apart=None):
        effect = SimpleNamespace(id=name, told_apart=apart or {})
        self.effect, self.place = effect, (name, (joint,))
        self.candidate = self


def advised(rivals, plans):
    """Plans for some pairs, of stated choices; and what was fitted and asked."""
    fitted, asked = [], []

    def choose(menu, told, joints, both, chosen):
        asked.append((joints, both, id(chosen)))
        return plans.pop(0)

    result = SimpleNamespace(
        search="search", rivals=rivals,
        gap=SimpleNamespace(robot=SimpleNamespace(joints=("hip", "knee"))),
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as m:
        m.setattr(
            advise_module, "fit_rival",
            lambda search, term, c: fitted.append(c.place) or c.place,
        )  # fmt: skip
        m.setattr(advise_module, "choose", choose)
        m.setattr(advise_module, "_placed", lambda search, plan, both: ("placed", plan))
        found = list(_between(result, None, None))
    return found, fitted, asked


def test_each_pair_of_effects_that_explain_as_much_is_told_apart():
    one, two, there = Kind("a", 0), Kind("b", 0), Kind("c", 1)
    found, fitted, asked = advised({one: (two, there)}, ["first", "second"])
    assert found == ["first", ("placed", "second")]
    assert fitted == [("a", (0,)), ("b", (0,)), ("c", (1,))]  # its own once
    assert [x for x, _, _ in asked] == [(0,), (0, 1)]
    assert asked[0][2] == asked[1][2]  # what is chosen for a term is known
    none, _, _ = advised({one: (two,)}, [None])
    assert none == []


def test_six_pairs_are_told_apart_at_most():
    one = Kind("a", 0)
    found, _, asked = advised({one: [Kind(x, 0) for x in "bcdefghij"]}, list(range(9)))
    assert found == list(range(6)) and len(asked) == 6


def test_laws_with_the_same_torque_are_told_apart_by_hand():
    for first, second in (
        (Kind("b", 1, {"a": "push {joint}"}), Kind("a", 1)),
        (Kind("b", 1), Kind("a", 1, {"b": "push {joint}"})),
    ):
        (plan,), fitted, asked = advised({first: (second,)}, [])
        assert plan == Plan(Advice("push knee", ("a", "b"), 0.0)) or (
            plan.advice == Advice("push knee", ("a", "b"), 0.0)
        )
        assert not fitted and not asked and plan.experiment is None


@pytest.mark.parametrize(("starts", "some"), [((3.0,), True), ((1.0, 3.8, 6.6), False)])
def test_what_happens_during_most_of_the_test_is_no_event(starts, some):
    """There would be no motion left to test by."""
    touches = [
        Contact((0,), {"start": t, "duration": 0.8, "moment_y": 5.0 * (-1) ** k})
        for k, t in enumerate(starts)
    ]
    motions = [with_torque(m, (), NOISE, k) for k, m in enumerate(swings(seconds=9.0))]
    motions[3] = with_torque(motions[3], touches, NOISE, 3)
    gap = measure_gap(pendulum(), motions, cutoff=10.0)
    once = Search(gap, gap.trajectory < 3).happened_in_test()
    assert once.any() == some
    assert not once[gap.trajectory < 3].any()
