"""Parts of the identification by themselves, on made-up numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pendulum import RATE, pendulum, swings, with_torque
from simulated import data_of

from hybrid.effects import JointState
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.spring import Spring
from hybrid.effects.viscous import Viscous
from hybrid.identification.consistency import physically_consistent
from hybrid.identification.friction import fit_friction
from hybrid.identification.identification import Identification
from hybrid.identification.partial_regression import PartialRegression
from hybrid.identification.preparation import (
    decimated_motion,
    linear_effects,
    prepare,
    products_at_best_cutoff,
    summed_squares,
)
from hybrid.identification.remainder import _candidates
from hybrid.recording import Recording
from hybrid.regression.cross_products import accumulate
from hybrid.regression.data import check_torque, fastest, visited
from hybrid.regression.least_squares import pseudo_solve
from hybrid.regression.prior import _UNKNOWN_SIZE, link_std
from hybrid.regression.problem import build_problem

seeds = st.integers(0, 10_000)


@given(seed=seeds, rank=st.integers(1, 5))
@example(seed=370, rank=4)  # two columns are nearly one: later pivots are rounding
@settings(max_examples=30)
def test_what_the_data_leave_open_is_zero_in_units_of_the_columns(seed, rank):
    """The shortest solution of the normal equations, with columns of unit length."""
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((20, rank)) @ rng.standard_normal((rank, 5))
    X *= np.exp(rng.normal(0.0, 3.0, 5))
    y = rng.standard_normal(20)
    size = np.linalg.norm(X, axis=0)
    expected = np.linalg.lstsq(X / size, y, rcond=1e-7)[0] / size
    found = pseudo_solve(X.T @ X, X.T @ y)
    np.testing.assert_allclose(found * size, expected * size, atol=1e-6)


def test_a_column_that_is_zero_has_no_gain():
    A, b = np.diag([4.0, 0.0]), np.array([2.0, 0.0])
    np.testing.assert_allclose(pseudo_solve(A, b), [0.5, 0.0])


@given(seed=st.integers(0, 1000), rounding=st.integers(0, 1000))
@settings(max_examples=30)
def test_a_column_of_rounding_errors_has_no_gain(seed, rounding):
    """Else its noise would be fitted, another one on each processor."""
    rng = np.random.default_rng(seed)
    X, y = 10.0 * rng.standard_normal((50, 4)), rng.standard_normal(50)
    noise = 1e-15 * np.random.default_rng(rounding).standard_normal((50, 1))
    both = np.hstack([X, noise])
    found = pseudo_solve(both.T @ both, both.T @ y)
    assert found[4] == 0.0
    np.testing.assert_allclose(found[:4], pseudo_solve(X.T @ X, X.T @ y), rtol=1e-9)


def regression(seed=0, gain=(0.0, 0.0), joints=1):
    """Terms of one joint, a wave beside them, and data of others that know a term."""
    rng = np.random.default_rng(seed)
    columns, wave = rng.standard_normal((3, 400)), rng.standard_normal((2, 400))
    columns[0] += wave[0]
    y = np.array([1.0, -2.0, 0.5]) @ columns + np.array(gain) @ wave
    y = y + 0.1 * rng.standard_normal(400)
    A, b = np.zeros((4, 3, 3)), np.zeros((4, 3))
    if joints > 1:
        X = rng.standard_normal((4, 100, 3))
        A = np.einsum("fmi,fmj->fij", X, X)
        b = np.einsum("fij,j->fi", A, np.array([1.0, -2.0, 0.5]))
    return PartialRegression((A, b), np.arange(3), columns, y), wave, (A, b)


@pytest.mark.parametrize("joints", [1, 2])
def test_the_gains_of_a_wave_are_those_beside_all_other_terms(joints):
    part, wave, (A, b) = regression(gain=(0.3, -0.2), joints=joints)
    X = np.vstack([part.columns, wave])
    H, h = X @ X.T, X @ part.residual
    H[:3, :3] += A.sum(axis=0)
    h[:3] += b.sum(axis=0)
    expected = np.linalg.solve(H, h)
    gains, _, _, rest = part._fitted(wave)
    np.testing.assert_allclose(gains, expected[3:], rtol=1e-5)
    np.testing.assert_allclose(rest, part.residual - expected @ X, atol=1e-4)
    less = part.with_wave(wave)
    np.testing.assert_allclose(
        less.residual, part.residual - expected[3:] @ wave, atol=1e-4
    )
    # It is a term now, beside which another one has the gains of both together.
    other = np.cos(np.outer([1.0, 2.0], np.arange(400)))
    X = np.vstack([part.columns, wave, other])
    H, h = X @ X.T, X @ part.residual
    H[:3, :3] += A.sum(axis=0)
    h[:3] += b.sum(axis=0)
    both = np.linalg.solve(H, h)
    np.testing.assert_allclose(less._fitted(other)[0], both[5:], atol=1e-5)


def test_squares_on_a_fold_are_by_terms_of_the_others():
    part, wave, _ = regression(gain=(0.3, -0.2))
    fold = np.arange(400) // 50 % 4
    before, after = part.cross_validated(wave[None], fold)
    for k in range(4):
        own, rest = fold == k, fold != k
        for X, found in (
            (part.columns, before),
            (np.vstack([part.columns, wave]), after[0]),
        ):
            gains = np.linalg.lstsq(X[:, rest].T, part.residual[rest])[0]
            residual = part.residual[own] - gains @ X[:, own]
            assert found[k] == pytest.approx(residual @ residual, rel=1e-4)
    assert after.sum() < before.sum()


def test_a_joint_that_stands_throughout_a_fold_has_no_squares_there():
    part, wave, _ = regression(gain=(0.3, -0.2))
    before, after = part.cross_validated(wave[None], np.arange(400) // 50 % 3)
    assert before[3] == after[0, 3] == 0 < after[0, :3].min()


@pytest.mark.parametrize(("gain", "there"), [((0.1, 0.05), True), ((0.0, 0.0), False)])
def test_a_wave_shows_where_noise_seldom_makes_as_much(gain, there):
    block = np.arange(400) // 10
    found = [
        part.is_significant(wave, block, 0.01)
        for part, wave, _ in (regression(seed, gain) for seed in range(12))
    ]
    assert sum(found) >= 11 if there else sum(found) <= 1
    part, wave, _ = regression(gain=gain)
    assert not part.is_significant(
        wave, np.zeros(400, dtype=int), 0.01
    )  # one block tells none
    assert not part.is_significant(part.columns[:2], block, 0.01)  # it is there already


def data(**options):
    motions = [
        with_torque(m, [Coulomb((1,), {"level": 0.5})], 0.05, k)
        for k, m in enumerate(swings(2, **options))
    ]
    return prepare(motions, 10.0)


def test_samples_at_rest_count_for_nothing():
    motions = swings(2, count=2)
    still = [
        replace(m, q=m.q * [1, 0], v=m.v * [1, 0], a=m.a * [1, 0]) for m in motions
    ]
    known = prepare(still, 10.0)
    residual = [np.ones_like(m.q) for m in known.motions]
    squares = known.squares(residual).sum(axis=0)
    moving = sum(np.count_nonzero(known.moves(m)[:, 0]) for m in known.motions)
    assert squares.tolist() == [moving, 0.0]
    assert known.moving.tolist() == [moving, 1.0]  # the mean over none is zero
    assert [s.torque > 0 and s.speed > 0 for s in known.scales] == [True, True]
    assert known.scales[1].speed == known.standing[1] > 0
    assert known.resting.tolist() == [False, True]


def test_whole_recordings_make_folds_or_quarters_of_the_motion():
    many, few = data(count=5), data(count=2)
    assert [set(f.tolist()) for f in many.folds] == [{0}, {1}, {2}, {3}, {0}]
    for fold, m in zip(few.folds, few.motions, strict=True):
        assert set(fold.tolist()) == {0, 1, 2, 3} and (np.diff(fold) >= 0).all()
        moves = few.moves(m).any(axis=1)
        count = np.bincount(fold[moves])
        assert np.ptp(count) <= 1


def test_blocks_lie_in_one_fold_each_and_are_many():
    for known in (data(count=2), data(count=5)):
        fold = np.concatenate(known.folds)
        block = np.concatenate(known.blocks)
        assert len(np.unique(block)) >= 48
        assert set(np.unique(block)) == set(range(block.max() + 1))
        for k in np.unique(block):
            assert len(set(fold[block == k])) == 1


def test_ranges_are_those_of_samples_that_count():
    (m, *_) = swings(2, count=1)
    q, v = m.q.copy(), m.v.copy()
    q[7], v[7] = 100.0, -100.0
    mask = np.arange(len(m.t)) != 7
    seen = visited([replace(m, q=q, v=v, mask=mask)])
    np.testing.assert_array_equal(seen["q_min"], np.min(m.q[mask], axis=0))
    np.testing.assert_array_equal(seen["q_max"], np.max(m.q[mask], axis=0))
    np.testing.assert_array_equal(seen["v_max"], np.abs(m.v[mask]).max(axis=0))
    np.testing.assert_array_equal(fastest([m, replace(m, v=3 * m.v)]), 3 * fastest([m]))
    check_torque([m])


def test_an_outlying_block_counts_as_three_usual_ones():
    squares = np.ones((9, 2))
    squares[4, 0] = 100.0
    plain, robust = summed_squares(squares, False), summed_squares(squares, True)
    assert plain.tolist() == [108.0, 9.0]
    assert 9.0 < robust[0] < 50.0 and robust[1] == 9.0


@pytest.mark.parametrize(("rate", "kept"), [(1000.0, 8), (100.0, 1)])
def test_motions_are_thinned_to_a_dozen_samples_a_period(rate, kept):
    t = np.arange(0.0, 4.0, 1 / rate)
    tone = np.sin(2 * np.pi * 8.0 * t)[:, None]
    (m, *_) = swings(1, count=1)
    motion = replace(
        m, t=t, q=tone, v=tone, a=tone, tau=tone, mask=np.ones(len(t), dtype=bool)
    )
    found = decimated_motion(motion, 10.0)
    assert len(found.t) == -(-len(t) // kept)
    inside = slice(20, -20)
    np.testing.assert_allclose(found.tau[inside], found.q[inside], atol=0.02)
    assert decimated_motion(motion, np.inf) is motion


def test_a_joint_is_offered_its_own_state_and_that_of_its_neighbours():
    own = (2,)
    assert _candidates(2, 5) == [(own, own), ((1, 2, 3), own), (own, (1, 2, 3))]
    assert _candidates(0, 2)[1] == ((0, 1), (0,))
    assert _candidates(1, 2)[2] == ((1,), (0, 1))


def test_links_do_not_depend_on_the_units_that_data_are_weighed_in():
    robot = pendulum(2)
    problem = build_problem(robot.chain, [])
    A, b = accumulate(problem, data()).normal(np.eye(2))
    found = [physically_consistent(problem, w * A, w * b).inertial for w in (1.0, 1e-6)]
    np.testing.assert_allclose(found[0], found[1], atol=1e-4)


def test_the_terms_of_a_plain_model_are_those_of_drives_and_of_the_file():
    plain = linear_effects(pendulum(2))
    assert [(e.id, e.joints) for e in plain] == [
        (kind, (j,))
        for kind in ("armature", "torque_offset", "coulomb", "viscous")
        for j in (0, 1)
    ]
    springy = replace(pendulum(2), stiffness=np.array([0.0, 3.0]))
    own = [(e.id, e.joints) for e in linear_effects(springy)]
    assert ("torque_offset", (1,)) not in own and ("torque_offset", (0,)) in own
    assert ("spring", (1,)) in own and len(own) == len(plain)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_the_cutoff_is_halved_where_torque_is_noisy_and_kept_where_not(noise):
    rng, logs = np.random.default_rng(0), []
    for m in swings(1, count=4, seconds=12.0):
        exact = with_torque(m, ())
        # Noise of a period of torque, that no model of the motion has.
        shake = noise * np.sin(2 * np.pi * 6.0 * m.t + rng.uniform(0, 6))[:, None]
        q = m.q + 1e-6 * rng.standard_normal(m.q.shape)
        logs.append(Recording(m.t, q, tau=exact.tau + shake, joints=m.joints))
    first = prepare(logs, None).cutoff
    problem = build_problem(pendulum().chain, linear_effects(pendulum()))
    products = products_at_best_cutoff(logs, problem, robust=True)
    assert (products.total == accumulate(problem, products.data).total).all()
    halvings = np.log2(first / (found := products.data.cutoff))
    assert halvings == pytest.approx(round(halvings)) and 0 <= halvings <= 3
    assert found >= 3.0 * 4 / 12.0 and first <= RATE / 2


@pytest.mark.parametrize("seconds", [20.0, 300.0])
def test_cross_products_are_in_a_hundred_blocks_at_most(seconds):
    robot = pendulum()
    motions = [with_torque(m, ()) for m in swings(count=2, seconds=seconds)]
    data = data_of(motions, cutoff=10.0, standing=0.0)
    products = accumulate(build_problem(robot.chain, []), data)
    assert 10 <= len(products.blocks) <= 100
    assert len(products.blocks) > 60 or seconds < 100.0


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_friction_of_each_direction_is_fitted_to_its_own(direction):
    known = prepare([with_torque(m, (), 0.0) for m in swings(seconds=8.0)], 10.0)
    rng, rest = np.random.default_rng(0), []
    for m in known.motions:
        v = m.v[:, 0]
        dry = np.where(direction * v > 0, 2.0, 1.0) * np.sign(v) + 0.3 * v
        rest.append(dry + 0.02 * rng.standard_normal(len(v)))
    load = [np.zeros(len(m.t)) for m in known.motions]
    (found, *_) = fit_friction(known, 0, rest, load)
    v = np.linspace(-6, 6, 41)
    v = v[np.abs(v) > 1.0]
    zero = np.zeros_like(v)
    at = JointState(zero, zero, v, zero, np.sign(v), zero)
    law = np.stack(found.law(at, **found.shape_values)).T @ found.gain_values
    expected = np.where(direction * v > 0, 2.0, 1.0) * np.sign(v) + 0.3 * v
    np.testing.assert_allclose(law, expected, atol=0.1)


def test_link_parameters_are_as_unsure_as_their_unit_and_size_say():
    """A mass, a mass at a distance, and one at its square."""
    found = link_std(pendulum(2).chain)
    mass, moment, inertia = found[:, 0], found[:, 1:4], found[:, 4:]
    size = moment / mass[:, None]
    np.testing.assert_allclose(size, size[:, :1] * np.ones(3))
    np.testing.assert_allclose(inertia, mass[:, None] * size[:, :1] ** 2 * np.ones(6))
    assert (0.1 < size).all() and (size < 1.0).all() and (mass >= 2.0).all()


def test_friction_that_the_user_gave_is_replaced_at_no_joint_of_its_own():
    stage = Identification.__new__(Identification)
    stage.extra, may = (Coulomb((0,)),), stage._is_friction
    assert not may(Coulomb((0,)))
    assert may(Coulomb((1,)))
    assert may(Viscous((0,)))
    assert not may(Spring((1,)))


def test_friction_is_fitted_again_until_a_round_gains_nothing():
    costs = iter([8.0, 5.0, 5.0, 4.0, 3.0])
    stage = Identification.__new__(Identification)
    stage.best = SimpleNamespace(squares=np.array([[9.0]]))
    stage.solver = SimpleNamespace(cost=np.sum)
    stage._friction_candidates = lambda _: [{0: []}]
    stage._lag_candidates = lambda _: []
    stage._fitted = lambda *_: SimpleNamespace(squares=np.array([[next(costs)]]))
    stage.friction_stage()
    assert stage.best.squares == 5.0 and next(costs) == 4.0


def test_a_link_of_unknown_size_at_the_base_is_as_unsure_as_one_of_a_metre():
    robot = pendulum(1)
    point = replace(robot.chain, inertial=np.array([[2.0] + 9 * [0.0]]))
    std = link_std(point)[0]
    np.testing.assert_allclose(std[1:4] / std[0], _UNKNOWN_SIZE)
    np.testing.assert_allclose(std[4:] / std[0], _UNKNOWN_SIZE**2)
    assert std[0] > 2.0
