"""Single steps of the search of servos, with evidence that is stated."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.servo import search as module
from hybrid.servo.drive import NAMES, Drive
from hybrid.servo.moves import Move
from hybrid.servo.noise import Noise
from hybrid.servo.problem import Estimate
from hybrid.servo.search import Search

ROBOT = replace(
    pendulum(2), kp=np.array([25.0, 20.0]), kd=np.array([0.6, 0.4]),
    damping=np.array([0.4, 0.3]), frictionloss=np.array([0.3, 0.2]),
)  # fmt: skip
FILE = Drive.declared(ROBOT)
NONE = np.zeros((len(NAMES), 2), dtype=bool)
STIFF, DAMP, OFFSET, MASS = (
    NAMES.index(x) for x in ("stiffness", "damping", "offset", "mass")
)
NOISE = Noise(np.ones(2), np.full(2, 1e3))


def made(*places, x=0.0, **more):
    """An estimate with some causes, with all coordinates the same."""
    causes = NONE.copy()
    for at in places:
        causes[at] = True
    x = np.full(NONE.shape, float(x))
    return Estimate(x, causes.copy(), np.ones((3, 2)), causes, **more)


def names(what):
    return sorted((NAMES[k], j) for k, j in np.argwhere(what.causes).tolist())


class Stated(Search):
    """A search whose evidence is stated by its causes; for each joint a number."""

    def __init__(self, worth, aside=None):
        self.worth, self.aside, self.met, self.said = worth, aside, [], []
        self.progress = lambda text, *_: self.said.append(text)
        self.noise, self.fitted, self.plain = NOISE, [], made()
        self.problem = None
        self.shapes, self.allowed = module._SHAPES & ~NONE, ~module._SHAPES & ~NONE

    def evidence(self, problem, what, noise):
        return np.array(self.worth(names(what)), dtype=float)

    def of(self, x, causes, turns=2):
        self.fitted.append(turns)
        return replace(made(), x=x.copy(), free=causes.copy(), causes=causes)

    def run(self, step, *given):
        with pytest.MonkeyPatch.context() as m:
            m.setattr(module, "evidence", self.evidence)
            return getattr(self, step)(*given)


def sums(**worth):
    """Evidence of each joint that is the sum of those of its causes."""

    def of(causes):
        total = [0.0, 0.0]
        for name, j in causes:
            total[j] += worth.get(f"{name}_{j}", 0.0)
        return total

    return of


# --- gains ----------------------------------------------------------------------------


class Aside:
    """Parts set aside, with errors by coordinates."""

    def errors(self, points):
        return [np.full((1, 2), float(x[0, 0])) for x in points]


def test_a_gain_is_the_evidence_beyond_that_of_now():
    search = Stated(sums(stiffness_0=7.0, damping_1=3.0))
    tried = [made((STIFF, 0)), made((DAMP, 1)), made((STIFF, 0), (DAMP, 1))]
    gain = search.run("gain", made((DAMP, 1)), tried, NOISE)
    np.testing.assert_allclose(gain, [[7.0, -3.0], [0.0, 0.0], [7.0, 0.0]])


@pytest.mark.parametrize(("off", "harm"), [(1.41, 0.0), (1.5, 1.125)])
def test_what_costs_more_than_a_nat_on_parts_set_aside_has_that_loss(off, harm):
    """The best explanation so far misses by nothing: the cost is half a square."""
    search = Stated(sums(stiffness_0=7.0, damping_1=-9.0), Aside())
    search.met = [made(x=4.0), made(x=0.0), made(x=3.0)]
    gain = search.run("gain", made(), [made((STIFF, 0), (DAMP, 1), x=off)], NOISE)
    first = -harm if harm else 7.0
    np.testing.assert_allclose(gain, [[first, -9.0]], rtol=1e-5)
    # Where the evidence itself falls by more, that counts.


# --- mixing ---------------------------------------------------------------------------


def test_each_joint_is_as_in_the_trial_that_it_gains_by():
    search = Stated(sums(stiffness_0=7.0, damping_1=3.0))
    tried = [made((STIFF, 0), x=5.0), made((DAMP, 1), x=6.0)]
    mixed = search.run("_mixed", made(), tried, np.array([0, 1]), NOISE)
    assert names(mixed) == [("damping", 1), ("stiffness", 0)]
    assert (mixed.x == [5.0, 6.0]).all()
    one = search.run("_mixed", made(), tried, np.array([0, -1]), NOISE)
    assert names(one) == [("stiffness", 0)] and (one.x == [5.0, 0.0]).all()
    assert search.run("_mixed", made(), tried, np.array([-1, -1]), NOISE) is None


def test_joints_that_lose_or_gain_least_wait():
    def worth(causes):
        both = {"stiffness", "damping"} <= {x for x, _ in causes}
        own = sums(stiffness_0=7.0, damping_1=3.0)(causes)
        return [own[0], -1.0] if both else own

    tried = [made((STIFF, 0)), made((DAMP, 1))]
    search = Stated(worth)
    mixed = search.run("_mixed", made(), tried, np.array([0, 1]), NOISE)
    assert names(mixed) == [("stiffness", 0)] and search.fitted == [2, 2]
    none = Stated(sums(stiffness_0=-7.0, damping_1=-3.0))
    assert none.run("_mixed", made(), tried, np.array([0, 1]), NOISE) is None

    def apart(causes):  # one gains, at more of a cost of the other
        return [2.0, -3.0] if ("stiffness", 0) in causes else [0.0, 0.0]

    assert Stated(apart).run("_mixed", made(), tried, np.array([0, -1]), NOISE) is None


# --- growing --------------------------------------------------------------------------


def grown(worth, trials, now=None, shared=False):
    """One cause more at each joint, of single trials of a stated worth."""
    search = Stated(worth)
    search._trials = lambda now: [
        [Move(k, j, 1.0, np.full(NONE.shape, 1.0 + n)) for k, j in trial]
        for n, trial in enumerate(trials)
    ]
    search.problem = SimpleNamespace(
        cost=lambda found, noise: np.array([found.x[0, 0], found.x[0, 1]])
    )
    return search.run("_wider", now or made()), search


def test_the_best_cause_of_each_joint_is_added_if_it_is_clear():
    trials = [[(STIFF, 0), (STIFF, 1)], [(DAMP, 0), (DAMP, 1)]]
    worth = sums(stiffness_0=10.0, damping_0=8.0, stiffness_1=2.5, damping_1=2.6)
    after, search = grown(worth, trials)
    assert names(after) == [("damping", 1), ("stiffness", 0)]
    assert search.fitted[:2] == [4, 4]
    # A fifth of the best gain may come from the other joint.
    worth = sums(stiffness_0=10.0, damping_0=8.0, stiffness_1=1.9, damping_1=1.8)
    assert names(grown(worth, trials)[0]) == [("stiffness", 0)]
    assert grown(sums(stiffness_0=-1.0), trials)[0] is None
    assert grown(worth, [])[0] is None


def test_what_moves_all_joints_is_taken_if_it_gains_more_than_any_alone():
    trials = [[(MASS, 0)], [(STIFF, 0)]]
    for alone, first in ((4.9, "mass"), (5.1, "stiffness")):

        def worth(causes, alone=alone):
            found = {x for x, _ in causes}
            return [alone * ("stiffness" in found), 0.0] if "mass" not in found else [
                2.0, 3.0,
            ]  # fmt: skip

        after, _ = grown(worth, trials)
        assert names(after) == [(first, 0)]


def test_numbers_that_fit_within_three_nats_are_named_as_equal():
    """Costs are here the coordinates: those of the second trial are one more."""
    trials = [[(STIFF, 0)], [(DAMP, 0)]]
    worth = sums(stiffness_0=10.0, damping_0=9.0)
    after, search = grown(worth, trials)
    assert after.equals == {(STIFF, 0): (DAMP,)}
    for cost, equal in ((3.9, (DAMP,)), (4.1, ())):
        search.problem.cost = lambda found, noise, c=cost: np.array(
            [1.0 if found.x[0, 0] == 1.0 else c, 0.0]
        )
        assert search.run("_wider", made()).equals == {(STIFF, 0): equal}


def test_a_search_grows_until_nothing_is_gained_or_for_eight_rounds():
    search = Stated(sums())
    steps = [made((STIFF, 0)), made((STIFF, 0), (DAMP, 1)), None]
    search._wider = lambda now: steps.pop(0)
    first, last = made(), steps[1]
    assert search.grown(first) is last
    assert search.met == [first, search.met[1], last] and len(search.met) == 3
    assert search.said == [
        "servos: 0 causes, round 1", "servos: 1 causes, round 2",
        "servos: 2 causes, round 3",
    ]  # fmt: skip
    for rounds, count in ((8, 8), (1, 1)):
        endless = Stated(sums())
        endless._wider = lambda now: made()
        endless.grown(made(), *([] if rounds == 8 else [rounds]))
        assert len(endless.said) == count and len(endless.met) == 1 + count


def test_one_that_moves_all_joints_is_tried_and_then_two_of_each_joint(monkeypatch):
    moves = [
        Move(k, j, gain, np.zeros(NONE.shape))
        for k, j, gain in (
            (DAMP, 0, 9.0), (MASS, 0, 8.0), (STIFF, 0, 7.0), (MASS, 1, 6.0),
            (OFFSET, 1, 5.0), (OFFSET, 0, 4.0),
        )
    ]  # fmt: skip
    search = Stated(sums())
    search.problem = SimpleNamespace(noise=lambda errors: NOISE)
    monkeypatch.setattr(module, "probed", lambda *_: ([], []))
    monkeypatch.setattr(module, "Curvature", SimpleNamespace(of=lambda *_: None))
    monkeypatch.setattr(module, "promising", lambda *_: moves)
    found = [[(m.k, m.j) for m in trial] for trial in search._trials(made())]
    assert found == [[(MASS, 0)], [(DAMP, 0), (OFFSET, 1)], [(STIFF, 0)]]


# --- pruning --------------------------------------------------------------------------


def test_the_least_important_cause_of_each_joint_is_dropped_first():
    search = Stated(sums())
    losses = {
        (STIFF, 0): 2.0, (DAMP, 0): 1.0, (OFFSET, 1): 2.9, (DAMP, 1): 3.1,
    }  # fmt: skip
    assert search._weakest(losses, {}) == [(DAMP, 0), (OFFSET, 1)]
    assert search._weakest(losses, {(DAMP, 0): 1.0}) == [(STIFF, 0), (OFFSET, 1)]
    assert search._weakest({(DAMP, 1): 3.1}, {}) == []
    with_mass = {**losses, (MASS, 1): 0.5}
    assert search._weakest(with_mass, {}) == [(MASS, 1)]
    later = {**losses, (MASS, 1): 1.5}
    assert search._weakest(later, {}) == [(DAMP, 0)]


def pruned(worth, losses, places, shared=()):
    """Causes that are left, of stated losses."""
    search = Stated(worth)

    def without(now, noise):
        here = [tuple(x) for x in np.argwhere(now.causes).tolist()]
        return {x: losses[x] for x in here}, {x: np.full(NONE.shape, 0.5) for x in here}

    search._without_one = without
    return search.run("pruned", made(*places, equals={"kept": ()})), search


def test_causes_whose_absence_gains_are_dropped_until_none_does():
    worth = sums(stiffness_0=10.0, damping_0=-1.0, offset_1=-2.0, damping_1=5.0)
    losses = {(STIFF, 0): 11.0, (DAMP, 0): -1.0, (OFFSET, 1): -2.0, (DAMP, 1): 6.0}
    found, search = pruned(worth, losses, list(losses))
    assert names(found) == [("damping", 1), ("stiffness", 0)]
    assert found.losses == {(STIFF, 0): 11.0, (DAMP, 1): 6.0}
    assert found.equals == {"kept": ()}
    assert (found.x == 0.5).any()
    assert search.said[0] == "servos: 4 causes, fewer"


def test_a_cause_that_is_tried_and_missed_stays_with_its_true_loss():
    """By the linear guess it loses little; fitted anew, it is needed."""
    worth = sums(stiffness_0=10.0, damping_1=4.0)
    found, _ = pruned(worth, {(STIFF, 0): 2.0, (DAMP, 1): 1.0}, [(STIFF, 0), (DAMP, 1)])
    assert names(found) == [("damping", 1), ("stiffness", 0)]
    assert found.losses == {(STIFF, 0): 10.0, (DAMP, 1): 4.0}


def test_what_moves_all_joints_is_dropped_by_the_sum_of_what_they_gain():
    for second, stays in ((-3.0, False), (-1.0, True)):

        def worth(causes, second=second):
            return [2.0, second] if causes else [0.0, 0.0]

        found, _ = pruned(worth, {(MASS, 0): 0.5}, [(MASS, 0)])
        assert names(found) == ([("mass", 0)] if stays else [])
        assert dict(found.losses) == ({(MASS, 0): 1.0} if stays else {})


def test_an_explanation_is_fitted_with_the_shapes_of_friction_and_no_sign():
    given = {}

    class Fits:
        def at(self, x, free):
            given["free"] = free
            return replace(made(), errors=np.array([[1e3, 0.0]]))

        def fitted(self, start, noise, turns):
            given.update(far=noise.far, turns=turns)
            return replace(start, x=start.x + 1.0)

    search = Stated(sums())
    search.problem = Fits()
    causes = NONE.copy()
    causes[STIFF, 0] = causes[NAMES.index("sign"), 1] = True
    found = Search.of(search, np.zeros(NONE.shape), causes, 3)
    assert (found.x == 1.0).all() and found.causes is causes and given["turns"] == 3
    np.testing.assert_array_equal(given["far"], [3e3, 1e3])
    free = {(NAMES[k], j) for k, j in np.argwhere(given["free"]).tolist()}
    shapes = {(x, j) for x in ("stribeck_speed", "presliding") for j in (0, 1)}
    assert free == shapes | {("stiffness", 0)}
