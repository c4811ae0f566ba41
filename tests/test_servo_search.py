"""Which numbers of servos are wrong, where replays are linear in them and cheap."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum
from scipy.stats import multivariate_normal

from hybrid.servo.drive import NAMES, QUANTITIES, Drive
from hybrid.servo.evidence import Curvature, evidence
from hybrid.servo.fit import _findings, _split
from hybrid.servo.moves import probed, promising
from hybrid.servo.noise import Noise, usual_error
from hybrid.servo.problem import SHARED, Problem
from hybrid.servo.search import Search
from hybrid.servo.stretch import Stretch

ROBOT = replace(
    pendulum(2), kp=np.array([25.0, 20.0]), kd=np.array([0.6, 0.4]),
    damping=np.array([0.4, 0.3]), frictionloss=np.array([0.3, 0.2]),
)  # fmt: skip
FILE = Drive.declared(ROBOT)
FREE = np.ones((len(NAMES), 2), dtype=bool)
NOISE, SAMPLES, STEP = 1e-3, 250, 0.02
COST = 5.0  # nats, of one parameter more


class Linear:
    """Replays that miss, at each joint, a signal of its own for each of its numbers.

    A mass shows at both joints. Signals of the second stretch are others.
    """

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        shape = (2, len(NAMES), SAMPLES, 2)
        self.signals = 0.05 * rng.standard_normal(shape)
        self.path = np.cumsum(0.01 * rng.standard_normal((2, SAMPLES, 2)), axis=1)
        self.cross = 0.05 * rng.standard_normal((2, SAMPLES, 2))

    def moved(self, which, drive):
        off = drive.coordinates - FILE.coordinates
        own = np.einsum("kj,ktj->tj", off, self.signals[which])
        mass = off[NAMES.index("mass"), ::-1] * self.cross[which]
        return self.path[which] + own + mass

    def replay(self, stretches, drives):
        return [[self.moved(int(x.source) % 2, d) for x in stretches] for d in drives]


def problem(truth, *, seed=0, count=1):
    """Logs of servos, replayed by the same law."""
    law, rng, found = Linear(seed), np.random.default_rng(seed + 1), []
    for k in range(count):
        q = law.moved(k, truth) + NOISE * rng.standard_normal((SAMPLES, 2))
        found.append(Stretch(STEP, law.path[k], q, np.zeros(2), str(k)))
    reached = np.array([q.min(axis=0), q.max(axis=0)])
    return Problem(law, found, FILE, np.zeros(2, dtype=bool), reached)


def searched(truth, allowed=FREE, told=False):
    whole = problem(truth, count=2)
    fitted, aside = (whole.over([x]) for x in whole.stretches)
    free = np.isin(NAMES, ("stiffness", "damping", "coulomb"))[:, None] & allowed
    plain = fitted.fitted(fitted.at(FILE.coordinates, free), None, 4)
    return Search(fitted, plain, aside if told else None, allowed)


def causes(found):
    return {(NAMES[k], j) for k, j in np.argwhere(found.causes)}


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"stiffness": [15.0, 20.0]},
        {"damping": [1.0, 0.25], "offset": [0.0, 2.0]},
        {"delay": [0.04, 0.04]},
        {"mass": [1.0, 1.5]},
        {"coulomb": [0.3, 0.6], "zero": [0.08, 0.0]},
    ],
)
def test_the_numbers_that_are_wrong_are_found_and_no_others(changed):
    truth = FILE.at(**changed)
    wrong = {
        (name, j) for name in changed for j in (0, 1) if truth[name][j] != FILE[name][j]
    }
    best = searched(truth).best()
    assert causes(best) == wrong
    for name, j in wrong:
        found = best.x[NAMES.index(name), j]
        right = truth.coordinates[NAMES.index(name), j]
        assert found == pytest.approx(right, abs=0.02)
    assert set(best.losses) == {(NAMES.index(name), j) for name, j in wrong}
    assert all(x > 3.0 for x in best.losses.values())
    assert usual_error(best.errors) == pytest.approx([NOISE, NOISE], rel=0.3)


def test_a_number_that_may_not_differ_does_not():
    allowed = FREE.copy()
    allowed[NAMES.index("stiffness")] = False
    best = searched(FILE.at(stiffness=[15.0, 20.0]), allowed).best()
    k = NAMES.index("stiffness")
    assert (best.x[k] == FILE.coordinates[k]).all()
    assert ("stiffness", 0) not in causes(best)


def test_what_the_parts_set_aside_deny_is_not_taken():
    search = searched(FILE.at(stiffness=[15.0, 20.0]), told=True)
    search.met.append(search.plain)
    noise = search.noise
    k = NAMES.index("stiffness")
    none = np.zeros_like(FREE)
    right, wrong = none.copy(), none.copy()
    right[k, 0] = wrong[k, 1] = True
    truth, denied = (FILE.at(stiffness=x) for x in ([15.0, 20.0], [25.0, 40.0]))
    file = search.file()
    good = search.of(truth.coordinates, right)
    bad = search.problem.at(denied.coordinates, wrong)
    gain = search.gain(file, [good, bad], noise)
    assert gain[0, 0] > 10.0 and gain[1, 1] < -10.0


def test_numbers_that_move_alike_are_named_together():
    """Where two numbers have one signal, either may be the cause."""
    search = searched(FILE.at(offset=[1.5, 0.0]))
    law = search.problem.simulator
    a, b = NAMES.index("offset"), NAMES.index("spring")
    law.signals[:, b] = law.signals[:, a]
    search.problem._known.clear()
    best = search.best()
    (at,) = ((k, j) for k, j in np.argwhere(best.causes))
    assert at[0] in (a, b) and at[1] == 0
    assert best.equals[tuple(at)] == ((b if at[0] == a else a),)


def test_the_cost_is_that_of_noise_and_of_distance_from_the_file():
    made = problem(FILE)
    x = FILE.at(stiffness=[30.0, 20.0], offset=[0.5, 0.0]).coordinates
    free = np.zeros_like(FREE)
    free[NAMES.index("stiffness"), 0] = free[NAMES.index("offset"), 0] = True
    at = made.at(x, free)
    noise = Noise(np.array([1e4, 2e4]), np.array([0.1, 0.2]))
    z = [np.log(30 / 25) / 2.0, 0.5 / (0.05 * FILE.stall[0])]
    prior = [0.5 * (z[0] ** 2 + z[1] ** 2), 0.0]
    np.testing.assert_allclose(made.off(x, free), prior)
    np.testing.assert_allclose(made.cost(at, noise), noise.cost(at.errors) + prior)


def test_noise_counts_in_full_near_zero_and_less_far_away():
    noise = Noise(np.array([1e4]), np.array([0.1]))
    small, large = np.full((1, 1), 1e-3), np.full((1, 1), 1.0)
    assert noise.cost(small) == pytest.approx([0.5 * 1e4 * 1e-6], rel=1e-3)
    assert noise.cost(large) == pytest.approx([50.0 * np.log(101.0)])
    assert noise.weights(large)[0, 0] == pytest.approx(1e4 / 101.0)
    step = 1e-7
    slope = (noise.cost(large + step) - noise.cost(large - step)) / (2 * step)
    assert slope == pytest.approx(noise.weights(large)[0] * large[0], rel=1e-4)
    wide = noise.reaching(np.array([0.2]))
    assert wide.far == pytest.approx([0.6]) and wide.weight == noise.weight
    other = Noise(np.array([1e5]), np.array([0.05]))
    for less in (noise.least(other), other.least(noise)):
        assert (less.weight, less.far) == (other.weight, other.far)


def test_slopes_and_normal_equations_are_those_of_the_law():
    made = problem(FILE)
    free = np.zeros_like(FREE)
    k, m = NAMES.index("stiffness"), NAMES.index("mass")
    free[k] = free[m] = True
    at, law = made.at(FILE.coordinates, free), made.simulator
    found = made.slopes(at)
    expected = np.zeros((4, SAMPLES, 2))
    for row, j in enumerate((0, 1)):
        expected[row, :, j] = law.signals[0, k, :, j]
        expected[2 + row, :, j] = law.signals[0, m, :, j]
        expected[2 + row, :, 1 - j] = law.cross[0, :, 1 - j]
    assert SHARED[m] and not SHARED[k]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    noise = Noise(np.array([1e4, 1e4]), np.array([1e3, 1e3]))
    matrix, gradient = made.normal(at, found, noise)
    X = expected.reshape(4, -1)
    prior = np.diag(1 / FILE.spread[free] ** 2)
    np.testing.assert_allclose(matrix, 1e4 * X @ X.T + prior, rtol=1e-6)
    np.testing.assert_allclose(gradient, 1e4 * X @ at.errors.ravel(), rtol=1e-5)
    np.testing.assert_allclose(
        made.covariance(at, noise), np.linalg.inv(matrix), rtol=1e-4
    )


def test_intervals_hold_what_differs_between_logs():
    """They narrowed with every log, though each log had another offset."""
    rng, k = np.random.default_rng(5), NAMES.index("offset")
    own = np.zeros_like(FREE)
    own[k, 0] = True
    away, size = [], 0.05
    for seed in range(60):
        made = problem(FILE, count=2, seed=seed)
        logs = []
        for i in range(12):
            x = made.stretches[i % 2]
            drive = FILE.at(offset=[size * rng.standard_normal(), 0.0])
            q = made.simulator.moved(i % 2, drive)
            q += NOISE * rng.standard_normal(q.shape)
            logs.append(replace(x, q=q, source=str(i)))
        many = made.over(logs)
        found = many.fitted(many.at(FILE.coordinates, own), None, 8)
        noise = many.noise(found.errors)
        std = float(np.sqrt(many.covariance(found, noise)[0, 0]))
        narrow = many.normal(found, many.slopes(found, each=True), noise)[0][0, 0]
        away.append((abs(found.x[k, 0]) / std, abs(found.x[k, 0]) * narrow**0.5, std))
    inside, before, _ = np.mean(np.array(away) < [1.96, 1.96, np.inf], axis=0)
    assert 0.88 <= inside and before < 0.8
    assert np.median(away, axis=0)[2] < 3 * size / 12**0.5


def test_a_fit_ends_where_least_squares_does():
    truth = FILE.at(stiffness=[15.0, 30.0], offset=[0.5, -0.5])
    made = problem(truth)
    free = np.isin(NAMES, ("stiffness", "offset"))[:, None] & FREE
    found = made.fitted(made.at(FILE.coordinates, free), None, 8)
    np.testing.assert_allclose(found.x[free], truth.coordinates[free], atol=0.01)
    assert (found.x[~free] == FILE.coordinates[~free]).all()
    assert usual_error(found.errors) == pytest.approx([NOISE, NOISE], rel=0.2)


def test_a_fit_keeps_what_is_known_of_its_explanation(monkeypatch):
    """A step that mixed the best ones of the joints forgot it, at an SO-101."""
    truth = FILE.at(stiffness=[15.0, 30.0], offset=[0.5, -0.5])
    made = problem(truth)
    free = np.isin(NAMES, ("stiffness", "offset"))[:, None] & FREE
    at, told = (NAMES.index("offset"), 0), {(NAMES.index("offset"), 0): 7.0}
    start = made.at(FILE.coordinates, free)
    own = np.zeros_like(free)
    own[at] = True
    start = replace(start, causes=own, equals={at: (3,)}, losses=told)
    # Of the start and of two steps, each the best one of a joint; then of both mixed.
    costs = iter([(9, 9), (0, 5), (5, 0), (9, 9), (0, 5), (5, 0), (0, 0)])
    monkeypatch.setattr(Problem, "cost", lambda *_: np.array(next(costs)))
    monkeypatch.setattr("hybrid.servo.problem._DAMPINGS", (0.0, 1.0))
    found = made._step(start, made.noise(start.errors))
    assert not np.array_equal(found.x, start.x) and next(costs, None) is None
    assert (found.causes == own).all()
    assert found.equals == start.equals and found.losses == told


def test_evidence_is_that_of_the_whole_covariance():
    """Of a linear law the Laplace approximation is exact: one joint, one number."""
    made = problem(FILE.at(stiffness=[24.0, 20.0]))
    k = NAMES.index("stiffness")
    own = np.zeros_like(FREE)
    own[k, 0] = True
    noise = Noise(np.full(2, NOISE**-2), np.full(2, 1e3))
    search = Search(made, made.at(FILE.coordinates, own), None, own)
    without = search.of(FILE.coordinates, np.zeros_like(own))
    with_it = search.of(FILE.coordinates, own, 8)
    gain = evidence(made, with_it, noise) - evidence(made, without, noise)
    x, errors = made.simulator.signals[0, k, :, 0], without.errors[:, 0]
    spread = QUANTITIES[k].spread
    laws = [
        multivariate_normal(
            np.zeros(SAMPLES), NOISE**2 * np.eye(SAMPLES) + s**2 * np.outer(x, x)
        ).logpdf(errors)
        for s in (spread, 0.03 * spread)
    ]
    assert gain[0] == pytest.approx(laws[0] - laws[1] - COST, abs=0.2)
    assert gain[1] == pytest.approx(0.0, abs=1e-6)


def test_findings_are_told_by_what_they_are_worth_on_other_motion():
    truth = FILE.at(stiffness=[15.0, 20.0], offset=[0.0, 3.0])
    search = searched(truth)
    best = search.best()
    std = np.full(FREE.shape, 0.01)
    (other,) = problem(truth, count=1, seed=0).stretches
    found = _findings(ROBOT, search.problem, best, std, [other])
    assert [(x.quantity, x.joint) for x in found] == [
        ("offset", "hinge_1"), ("stiffness", "hinge_0"),
    ]  # fmt: skip
    soft, law = found[1], search.problem.simulator
    assert (soft.effect, soft.unit, soft.file) == ("controller_gain", "N·m/rad", 25.0)
    assert soft.value == pytest.approx(15.0, rel=0.02)
    ends = np.exp(np.log(soft.value) + 0.0196 * np.array([-1, 1]))
    assert soft.interval == pytest.approx(tuple(ends))
    assert soft.probability > 0.99
    signal = np.log(25 / 15) * law.signals[0, NAMES.index("stiffness"), :, 0]
    assert soft.worth == pytest.approx(np.sqrt(np.mean(signal**2)) - NOISE, rel=0.1)
    off = found[0]
    assert off.interval == pytest.approx((off.value - 0.0196, off.value + 0.0196))
    assert off.worth > soft.worth
    # The file is not wrong in a number that the logs do not tell from its own.
    std[NAMES.index("stiffness"), 0] = 1.0
    found = _findings(ROBOT, search.problem, best, std, [other])
    assert [x.quantity for x in found] == ["offset"]


def test_one_log_in_four_is_kept_aside_or_the_end_of_each():
    logs = problem(FILE, count=2).stretches * 3
    names = [replace(x, source=str(k)) for k, x in enumerate(logs)]
    learn, unseen = _split(names)
    assert [x.source for x in unseen] == ["2"]
    assert [x.source for x in learn] == ["0", "1", "3", "4", "5"]
    learn, unseen = _split(names[:2])
    assert [len(x.q) for x in learn] == [175, 175] and len(unseen) == 2
    np.testing.assert_array_equal(unseen[1].q, names[1].q[175:])


def sharp(truth, resting=False):
    """Logs, the file's servos with damping free, and an expansion about them."""
    made = problem(truth)
    made = replace(made, resting=np.full(2, resting))
    noise = Noise(np.full(2, NOISE**-2), np.full(2, 1e3))
    free = np.zeros_like(FREE)
    free[NAMES.index("damping")] = not resting
    found = made.at(FILE.coordinates, free)
    return made, found, Curvature.of(made, found, noise), noise


def moves(made, found, about):
    changes, errors = probed(made, found.x, FREE, FILE.coordinates)
    return {
        (NAMES[m.k], m.j): m for m in promising(made, found, about, changes, errors)
    }


def test_what_a_number_promises_is_what_it_adds_where_replays_are_linear():
    truth = FILE.at(spring=[1.0, 0.0], damping=[0.5, 0.4], stiction=[0.0, 0.8])
    made, found, about, noise = sharp(truth)
    told = moves(made, found, about)
    none = np.zeros_like(FREE)
    before = evidence(made, replace(found, causes=none), noise)
    assert set(list(told)[:2]) == {("stiction", 1), ("spring", 0)}
    for name, j in (("spring", 0), ("stiction", 1)):
        causes, k = none.copy(), NAMES.index(name)
        causes[k, j] = True
        wide = replace(found, free=found.free | causes)
        gain = evidence(made, replace(wide, causes=causes), noise) - before
        move = told[name, j]
        assert move.gain == pytest.approx(gain[j], rel=1e-6) and gain[j] > 10.0
        assert gain[1 - j] == pytest.approx(0.0, abs=1e-6)
        for other in (name, "damping"):
            row = NAMES.index(other)
            assert move.x[row, j] == pytest.approx(truth.coordinates[row, j], abs=0.02)
            assert move.x[row, 1 - j] == found.x[row, 1 - j]
    assert all(m.gain > 0 for m in told.values())
    assert [m.gain for m in told.values()] == sorted(
        (m.gain for m in told.values()), reverse=True
    )


def test_what_a_mass_promises_counts_at_all_joints():
    truth = FILE.at(mass=[1.0, 1.2])
    made, found, about, noise = sharp(truth, resting=True)
    move = moves(made, found, about)["mass", 1]
    causes, k = np.zeros_like(FREE), NAMES.index("mass")
    causes[k, 1] = True
    before = evidence(made, replace(found, causes=np.zeros_like(FREE)), noise)
    after = evidence(made, made.at(move.x, causes), noise)
    assert move.gain == pytest.approx((after - before).sum(), rel=1e-6)
    assert move.x[k, 1] == pytest.approx(np.log(1.2), abs=0.005)


def test_a_change_of_sign_is_taken_whole_and_costs_no_width():
    truth = FILE.at(sign=[1.0, -1.0])
    made, found, about, noise = sharp(truth, resting=True)
    move = moves(made, found, about)["sign", 1]
    assert move.x[NAMES.index("sign")].tolist() == [1.0, -1.0]
    after = noise.cost(made.at(truth.coordinates, found.free).errors)
    fall = (noise.cost(found.errors) - after).sum()
    assert move.gain == pytest.approx(fall - COST, rel=1e-6)
    weak = FILE.at(sign=[1.0, 0.9])  # of a whole change only a part would fit
    assert ("sign", 1) not in moves(*sharp(weak, resting=True)[:3])


@pytest.mark.parametrize("name", ["lower", "upper"])
def test_a_stop_is_sought_where_the_log_ends_and_not_on_the_way_there(name):
    """It failed: a stop on the way has no effect, from which no fit finds the end."""
    made, _, _, noise = sharp(FILE, resting=True)
    way = {"lower": -1.0, "upper": 1.0}[name]
    (command,) = (x.command for x in made.stretches)
    end = way * (way * command).max(axis=0) - 0.01 * way  # it was asked to go further
    k, short = NAMES.index(name), 0.8
    truth = FILE.at(**{name: FILE[name] + short * (end - FILE[name])})
    made = replace(problem(truth), reached=np.array([end, end]))
    found = made.at(FILE.coordinates, np.zeros_like(FREE))
    told = moves(made, found, Curvature.of(made, found, noise))
    for j in (0, 1):
        assert told[name, j].x[k, j] == pytest.approx(end[j], rel=1e-12)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ({"stiffness": [15.0, 20.0]}, [("mass", 1)]),
        ({"mass": [1.0, 1.5]}, [("damping", 0), ("offset", 1)]),
        ({"zero": [0.0, 0.08]}, [("zero", 0), ("mass", 0), ("mass", 1)]),
    ],
)
def test_causes_that_explain_nothing_are_dropped_and_no_others(right, wrong):
    truth = FILE.at(**right)
    search = searched(truth)
    known = {(n, j) for n in right for j in (0, 1) if truth[n][j] != FILE[n][j]}
    causes_ = np.zeros_like(FREE)
    for name, j in (*known, *wrong):
        causes_[NAMES.index(name), j] = True
    search.met.append(search.plain)
    found = search.pruned(search.of(truth.coordinates, causes_))
    assert causes(found) == known
    assert set(found.losses) == {(NAMES.index(n), j) for n, j in known}
    assert all(x > 10.0 for x in found.losses.values())
    for name, j in wrong:
        if (name, j) not in known:
            k = NAMES.index(name)
            assert found.x[k, j] == FILE.coordinates[k, j]


def test_a_limit_is_only_looked_for_where_it_would_be_felt():
    """Below that of the file; what it would be above is told by no replay."""
    for stall, told in (([90.0, 60.0], set()), ([40.0, 60.0], {("stall", 0)})):
        found = moves(*sharp(FILE.at(stall=stall), resting=True)[:3])
        assert {at for at in found if at[0] == "stall"} == told
