"""Gates, costs and limits of the identification, just below and just above each."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import pendulum, swings, with_torque
from scipy.stats import norm

from hybrid.dynamics.pseudo_inertia import is_consistent
from hybrid.effects import JointState
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.errors import IdentificationError
from hybrid.identification.consistency import physically_consistent
from hybrid.identification.fit import poor_excitation
from hybrid.identification.friction import (
    _canonical,
    _columns,
    _knots,
    _maps,
    _shapes,
    fit_friction,
    held_out,
)
from hybrid.identification.gate import lowers
from hybrid.identification.identification import Identification
from hybrid.identification.preparation import (
    _folds,
    linear_effects,
    motions_from_logs,
    prepare,
    products_at_best_cutoff,
)
from hybrid.identification.remainder import _best_inputs, _ridge_error
from hybrid.identification.ripple import _best_orders, _ripple, in_band
from hybrid.identification.solver import Solver
from hybrid.recording import Recording
from hybrid.regression.cross_products import accumulate
from hybrid.regression.data import Data
from hybrid.regression.problem import build_problem
from hybrid.signals import motion_from_recording

# --- gate -----------------------------------------------------------------------------


@pytest.mark.parametrize("tried", [1, 16])
def test_a_gain_passes_above_what_noise_reaches_once_in_forty(tried):
    rng = np.random.default_rng(0)
    change = rng.standard_normal((50, 1))
    change -= change.mean()
    error = np.sqrt((change**2).sum())
    bound = norm.isf(0.025 / tried) * error / 50
    before = np.full((50, 1), 9.0)
    for share, passes in ((0.99, False), (1.01, True)):
        after = before - (change + share * bound)
        assert lowers(before, after, tried=tried).tolist() == [passes]
    assert not lowers(before, before + change + 1.01 * bound, tried=tried).any()


# --- cost -----------------------------------------------------------------------------


def solver(reference, robust=False):
    """A solver that compares with these squares of blocks."""
    made = Solver.__new__(Solver)
    made._robust, made.reference = robust, reference
    return made


def test_a_cost_is_the_mean_log_and_three_times_each_rise():
    reference = np.ones((10, 3))
    judge = solver(reference)
    level = np.log(np.array([0.5, 1.0, 2.0]))
    squares = np.exp(2 * level) * reference
    assert judge.cost(squares) == pytest.approx(
        (level + 3 * np.maximum(level, 0)).mean()
    )
    assert judge.cost(squares, harm=0.0) == pytest.approx(level.mean())
    np.testing.assert_allclose(judge.base, 10.0)
    # A fall by less than its standard error counts as a rise by the difference.
    change = np.where(np.arange(10) % 2, 0.5, -0.5)[:, None] * np.ones(3)
    scattered = 0.9 * (reference + change)
    error = np.sqrt(((0.5 * 0.1 * change) ** 2).sum(axis=0))[0]
    fall = 0.5 * np.log(0.9)
    expected = fall + 3 * max(fall + error, 0.0)
    assert judge.cost(scattered) == pytest.approx(expected)
    assert expected != fall


def test_errors_are_the_root_of_squares_over_the_moving_samples():
    judge = solver(np.ones((4, 2)))
    moving, resting = np.array([8.0, 2.0, 1.0]), np.array([False, False, True])
    judge._data = SimpleNamespace(moving=moving, resting=resting)
    np.testing.assert_allclose(judge.rms(np.full((4, 3), 4.5)), [1.5, 3.0, np.nan])


# --- preparation ----------------------------------------------------------------------


def log(seconds=4.0, size=1, seed=0):
    (m, *_) = swings(size, count=1, seconds=seconds, seed=seed)
    q = m.q + 1e-6 * np.random.default_rng(seed).standard_normal(m.q.shape)
    return Recording(m.t, q, tau=m.tau, joints=m.joints)


def test_a_recording_has_three_periods_of_the_cut_off():
    logs = [log(4.0), log(3.01)]
    motions, cutoff = motions_from_logs(logs, 1.001)
    assert cutoff == 1.001 and len(motions) == 2
    for given in (0.99, 0.0, float("nan")):
        with pytest.raises(
            IdentificationError, match="valid is 1 Hz or more .* of 3 s"
        ):
            motions_from_logs(logs, given)


def test_positions_are_filtered_at_twice_the_cut_off():
    recording = log()
    ((found, *_), _) = motions_from_logs([recording], 5.0)
    expected = motion_from_recording(recording, cutoff=10.0)
    for name in ("q", "v", "a", "tau"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_joint_stands_below_a_hundredth_of_its_highest_speed():
    motions = swings(2, count=4)
    known = prepare(motions, 10.0)
    fastest = np.max([np.abs(m.v).max(axis=0) for m in motions], axis=0)
    np.testing.assert_allclose(known.standing, 0.01 * fastest)
    moves = known.moves(motions[0])
    np.testing.assert_array_equal(moves, np.abs(motions[0].v) > 0.01 * fastest)


def test_quarters_are_of_the_samples_that_move_and_count():
    (m, *_) = swings(1, count=1, seconds=1.0)
    v = np.where(np.arange(100) < 20, 0.0, 1.0)[:, None]
    mask = np.arange(100) < 60
    ((fold),) = _folds([replace(m, v=v, mask=mask)], np.full(1, 0.5))
    assert np.ptp(np.bincount(fold[20:60])) <= 1
    assert (fold[:20] == 0).all() and (fold[60:] == 3).all()


def test_the_cut_off_of_motions_without_a_log_is_none():
    problem = build_problem(pendulum().chain, linear_effects(pendulum()))
    found = products_at_best_cutoff(swings(count=2), problem, robust=True)
    assert found.data.cutoff == np.inf


# --- remainder ------------------------------------------------------------------------


def test_inputs_are_of_use_where_they_lower_squares_by_a_hundredth():
    rng, own = np.random.default_rng(0), ((0,), ())
    q, noise = rng.uniform(-2, 2, (4000, 1)), rng.standard_normal(4000)
    fold = np.arange(4000) * 4 // 4000
    assert _best_inputs((q, 0 * q, noise, fold), [own]) is None
    for gain, of_use in ((0.05, False), (0.5, True)):
        y = noise + gain * np.sin(2 * q[:, 0])
        share = 1 - _ridge_error(q, y, fold) / (y @ y)
        assert (share > 0.01) == of_use
        found = _best_inputs((q, 0 * q, y, fold), [own])
        assert found == (own if of_use else None)


def test_nothing_is_learned_from_fewer_than_two_hundred_samples():
    q = np.linspace(-2, 2, 200)
    fold = np.arange(200) // 10 % 4
    y = np.sin(2 * q)
    assert _ridge_error(q[:, None], y, fold) < 0.01 * (y @ y)
    assert _ridge_error(q[1:, None], y[1:], fold[1:]) == np.inf


# --- ripple ---------------------------------------------------------------------------


def test_a_ripple_is_limited_to_the_speed_of_the_cut_off():
    ripple = TorqueRipple((0,), {"periods": 20.0, "fastest": 9.0})
    assert in_band(ripple, 10.0).values["fastest"] == pytest.approx(np.pi)
    assert in_band(ripple, 100.0).values["fastest"] == 9.0


@pytest.mark.parametrize(
    ("rate", "cutoff", "periods", "expected"),
    [(100.0, 10.0, 20, 2 * np.pi * 2.0), (100.0, 30.0, 20, 2 * np.pi * 1.5),
     (1000.0, 10.0, 2, 15.0)],
)  # fmt: skip
def test_a_ripple_acts_up_to_the_speed_that_samples_can_show(
    rate, cutoff, periods, expected
):
    pieces = [
        SimpleNamespace(sampler=SimpleNamespace(rate=r), v=np.array(v))
        for r, v in ((rate, [1.0, -15.0]), (2 * rate, [3.0]))
    ]
    found = _ripple(1, periods, pieces, cutoff)
    assert found.joints == (1,) and found.values["periods"] == periods
    assert found.values["fastest"] == pytest.approx(expected)


def piece(v, rate=1000.0):
    """Samples of a joint at given speeds, of which all count."""
    q = np.random.default_rng(1).uniform(0, 2 * np.pi, len(v))
    made = SimpleNamespace(
        q=q, v=v, use=np.ones(len(v), dtype=bool), refiltered=lambda x: x,
        sampler=SimpleNamespace(factor=1, rate=rate),
    )  # fmt: skip
    return made, q


@pytest.mark.parametrize(("slow", "offered"), [(110, True), (90, False)])
def test_an_order_is_offered_if_a_tenth_of_the_samples_show_it(slow, offered):
    v = np.where(np.arange(1000) < slow, 0.0, 1000.0)
    own, q = piece(v)
    found = _best_orders([own], [np.sin(2 * q)], 10.0)
    assert (1 in found and 2 in found) == offered and (offered or not found)
    assert not set(found) - set(range(1, 9))


def test_the_strongest_orders_are_offered_and_the_slowest_eight():
    own, q = piece(np.full(50_000, 0.01))
    noise = np.random.default_rng(0).standard_normal(len(q))
    slow = list(range(1, 9))
    by_chance = _best_orders([own], [noise], 10.0)
    assert by_chance[:8] == slow and len(by_chance) < 12
    strong = [20, 37, 90, 150, 222, 301, 399, 400]
    waves = sum(np.sin(k * q + k) for k in strong)
    found = _best_orders([own], [noise + waves], 10.0)
    assert found == slow + strong
    weaker = noise + waves + 0.5 * np.sin(55 * q)  # the ninth of them
    assert _best_orders([own], [weaker], 10.0) == found


# --- friction -------------------------------------------------------------------------


def test_every_law_of_the_grid_is_a_sum_of_hats_and_powers_of_speed():
    """Hats are straight between the speeds at which laws bend; one law is curved."""
    rng, fastest = np.random.default_rng(0), 3.0
    bends = fastest * _knots()[1:]
    v = np.concatenate([rng.uniform(-fastest, fastest, 200), [0.0], bends, -bends])
    columns, zero = _columns(v, fastest), np.zeros_like(v)
    state = JointState(zero, zero, v, zero, np.sign(v), zero)
    curved = [g.name for g in ThresholdFriction.gains].index("falling_steep")
    assert len(_shapes()) == len(_maps())
    for shapes, rows in zip(_shapes(), _maps(), strict=True):
        own = {name: fastest * x for name, x in shapes.items()}
        law = np.stack(ThresholdFriction.law(state, fastest=fastest, **own))
        found = rows[:-2, :-2] @ columns
        known = np.tile((np.abs(v) >= own["width"]) | (v == 0), (len(law), 1))
        known[curved, :200] = False
        np.testing.assert_allclose(found[known], law[known], rtol=1e-5, atol=1e-6)


def test_thresholds_go_from_a_hundredth_to_all_of_the_highest_speed():
    thresholds = np.unique([x["threshold"] for x in _shapes()])
    np.testing.assert_allclose(thresholds, np.geomspace(0.01, 1.0, 16))
    assert all(x["width"] < x["threshold"] for x in _shapes())
    for width, least in ((0.0, 0.01), (0.01, 0.0101), (0.04, 0.0401)):
        own = [x["threshold"] for x in _shapes() if x["width"] == width]
        assert len(own) == (thresholds >= least).sum()


def test_falling_and_rising_friction_cancel_where_both_are():
    values = {
        "coulomb_positive": 1.0, "coulomb_negative": 2.0, "falling": 0.5,
        "falling_steep": 0.3, "rising": 0.2, "viscous": 0.1,
    }  # fmt: skip
    expected = values | {"coulomb_positive": 1.2, "coulomb_negative": 2.2}
    found = _canonical(values)
    assert found == pytest.approx(expected | {"falling": 0.3, "rising": 0.0})


def test_held_out_squares_are_those_of_coefficients_of_the_other_folds():
    rng = np.random.default_rng(0)
    X, y = rng.uniform(0, 1, (4, 30, 2)), rng.uniform(0, 1, (4, 30))
    rows = np.concatenate([X, y[..., None]], axis=2)
    expected = 0.0
    for k in range(4):
        others = np.arange(4) != k
        theta = np.linalg.lstsq(X[others].reshape(-1, 2), y[others].ravel())[0]
        assert (theta > 0).all()
        expected += ((y[k] - X[k] @ theta) ** 2).sum()
    sums = np.swapaxes(rows, 1, 2) @ rows
    assert held_out(sums) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("gain", [0.0, 0.3])
def test_friction_of_the_load_is_found_where_it_is(gain):
    known = prepare([with_torque(m, (), 0.0) for m in swings(seconds=8.0)], 10.0)
    rng, rest, load = np.random.default_rng(0), [], []
    for m in known.motions:
        load.append(5.0 * np.sin(3 * m.t + m.q[:, 0]))
        dry = 1.0 + gain * np.abs(load[-1])
        noise = 0.02 * rng.standard_normal(len(m.t))
        rest.append(dry * np.sign(m.v[:, 0]) + 0.3 * m.v[:, 0] + noise)
    _, *more = fit_friction(known, 0, rest, load)
    sizes = [e.values["coefficient"] for e in more if isinstance(e, LoadFriction)]
    assert sum(sizes) == pytest.approx(gain, abs=0.02)


# --- links, excitation, stages --------------------------------------------------------


def normal(motions, effects=()):
    problem = build_problem(pendulum(2).chain, effects)
    known = prepare(motions, 10.0)
    return problem, *accumulate(problem, known).normal(np.eye(2))


def test_links_that_are_right_stay_and_wrong_ones_become_possible():
    problem, A, b = normal(swings(2))
    right = physically_consistent(problem, A, b)
    assert is_consistent(right.inertial).all() and right.loss < 1e-6
    best = np.linalg.lstsq(A, b, rcond=None)[0]
    np.testing.assert_allclose(right.theta, best, atol=1e-2 * np.abs(best).max())
    wrong = physically_consistent(problem, A, -A @ best)
    assert is_consistent(wrong.inertial).all() and wrong.loss > 1e-4
    for bad in (np.full_like(A, np.nan), np.zeros_like(A)):
        with pytest.raises(IdentificationError, match="nothing to fit"):
            physically_consistent(problem, bad, b)


def test_poor_motion_is_told_with_what_it_leaves_open_and_the_joints_to_move():
    problem, _, _ = normal(swings(2), [Coulomb((1,))])
    size = problem.size
    labels = problem.base.kept_labels
    assert poor_excitation(problem, np.eye(size)) is None
    pair = np.eye(size)
    for share, poor in ((0.99978, False), (0.99982, True)):  # (1 + s)/(1 − s) = 1e4
        pair[0, size - 1] = pair[size - 1, 0] = share
        text = poor_excitation(problem, pair)
        assert (text is not None) == poor
    assert "good is below 100" in text
    named = text.split("): ")[1].split(" are hardly")[0]
    assert set(named.split(", ")) == {labels[0], labels[-1]}
    assert "move hinge_0, hinge_1 farther" in text


def stage(file=1.0, model=1.0, base=1.0, effects=()):
    """An identification that is as good as its numbers say, at two joints."""
    one = np.ones((4, 2))
    judge = solver(base**2 * one)
    judge._data = SimpleNamespace(moving=np.full(2, 4.0))
    data = SimpleNamespace(
        motions=(None,), squares=lambda residual: residual[0]
    )  # fmt: skip
    return SimpleNamespace(
        data=data, solver=judge, best=SimpleNamespace(squares=model**2 * one),
        extra=effects, warnings=[], robot=pendulum(2),
        _file_residual=lambda _: file**2 * one,
    )  # fmt: skip


def test_a_model_worse_than_its_file_by_a_twentieth_is_refused():
    check = Identification._check_against_file
    check(stage(model=1.05, base=1.05))
    with pytest.raises(IdentificationError, match=r"by 6% on the mean .* are right$"):
        check(stage(model=1.06, base=1.06))
    with pytest.raises(IdentificationError, match="right, without coulomb or of more"):
        check(stage(model=2.0, effects=(Coulomb((0,)), Coulomb((1,)))))


def test_a_joint_worse_than_plain_least_squares_by_a_hundredth_is_warned_of():
    fine, worse = stage(model=1.009), stage(model=1.011)
    for made in (fine, worse):
        Identification._check_against_file(made)
    assert fine.warnings == []
    assert worse.warnings == [
        f"hinge_{j}: 1.1% worse on held-out samples than the better of plain and "
        "weighted least squares"
        for j in range(2)
    ]


def test_blocks_are_forty_eight_at_least():
    for count, each in ((1, 48), (5, 10), (48, 1), (60, 1)):
        motions = swings(1, count=1, seconds=10.0) * count
        fold = np.zeros(1000, dtype=int)
        known = Data(tuple(motions), (fold,) * count, 10.0, np.zeros(1))
        label = np.concatenate(known.blocks)
        assert len(np.unique(label)) == count * each
        assert np.ptp(np.bincount(label)) <= 1


# --- stages ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """A solution of which only the cost is known."""

    squares: float
    remainder: object = None
    effects: tuple = ()
    name: str = "start"


def ripples(monkeypatch, accepted):
    """A search for ripple in which some rounds are accepted; what it recorded."""
    found = iter(accepted)
    wave = TorqueRipple((0,), {"periods": 20.0, "fastest": 9.0})
    own = Coulomb((0,))
    made = Identification.__new__(Identification)
    made.best, made.solver = Found(9.0), SimpleNamespace(cost=float)
    made.data, made.seen, made.recorded = SimpleNamespace(cutoff=10.0), [], []
    made._replaceable = lambda best, j: [own]
    made._record_stage = made.recorded.append

    def with_accepted(best, options, fitted, *, tried):
        made.seen.append(tried)
        whole, slow = ([e.values.get("fastest") for e in x[0][1:]] for x in options)
        assert whole == [9.0] and slow == pytest.approx([np.pi])
        assert options[0][0][0] is options[1][0][0] is own
        new = next(found)
        return Found(best.squares - 1.0, name=new) if new else best

    where = "hybrid.identification.identification"
    monkeypatch.setattr(f"{where}.with_accepted", with_accepted)
    monkeypatch.setattr(f"{where}.find_ripples", lambda best: {0: [wave]})
    made.ripple_stage()
    return made


def test_ripple_is_looked_for_until_none_is_accepted_four_times_at_most(monkeypatch):
    nothing = ripples(monkeypatch, [None])
    assert nothing.recorded == [] and nothing.best.name == "start"
    twice = ripples(monkeypatch, ["a", "b", None])
    assert [x.name for x in twice.recorded] == ["start"] and twice.best.name == "b"
    assert twice.seen == [16] * 3  # orders that each is the best of
    assert len(ripples(monkeypatch, list("abcdef")).seen) == 4


def remainders(costs, remainder="learned"):
    """Rounds of a remainder at whose end the cost is as is said."""
    costs = iter(costs)
    made = Identification.__new__(Identification)
    made.best, made.settled, made.rounds = Found(next(costs)), True, 1
    made.left_out, made.recorded = [], []
    made.solver = SimpleNamespace(
        cost=float, with_effects=lambda start, effects, known: start
    )
    made._with_remainder = lambda _: (Found(next(costs), remainder), [])
    made._leave_out, made._record_stage = made.left_out.append, made.recorded.append
    made.remainder_stage()
    return made


def test_a_remainder_is_learned_until_a_round_gains_half_a_hundredth():
    settled = remainders([9.0, 5.0, 4.9951])
    assert (settled.rounds, settled.settled, settled.best.squares) == (2, True, 4.9951)
    assert len(settled.recorded) == 1 and settled.left_out == []
    more = remainders([9.0, 5.0, 4.9949, 4.9949])
    assert (more.rounds, more.settled, more.best.squares) == (3, True, 4.9949)
    endless = remainders([9.0, 8.0, 7.0, 6.0, 5.0])
    assert (endless.rounds, endless.settled, endless.best.squares) == (4, False, 5.0)
    for none in (remainders([9.0, 10.0]), remainders([9.0, 5.0], None)):
        assert none.best == Found(9.0) and none.settled
        assert none.left_out == ["remainder: no regression lowers the error"]
        assert none.recorded == []
