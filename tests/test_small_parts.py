"""Small parts by themselves: laws of one joint, limits, scaling, geometry, searches."""

import os
import re
from dataclasses import replace

import numpy as np
import pytest
from arms import random_arm, random_states
from coarse import Plant
from pendulum import pendulum
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from hybrid.dynamics.pseudo_inertia import (
    inertial_from_pseudo,
    is_consistent,
    nominal_bodies,
    pseudo_inertia,
    stacked,
    unstacked,
)
from hybrid.effects import JointState
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.errors import HybridWarning
from hybrid.excitation import multisine
from hybrid.excitation.clearance import ends_in_world
from hybrid.identification.friction import _columns, _knots, _maps, _shapes
from hybrid.identification.remainder import _best_inputs, _candidates
from hybrid.plant import random_fourier
from hybrid.plant.noise import Noise
from hybrid.plant.reference import limits
from hybrid.regression.least_squares import _bounded_solve
from hybrid.robot.geometry import Capsules
from hybrid.threads import cores

# --- the arm as its file says ---------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "at", "torque"),
    [
        ({"stiffness": 3.0, "springref": 0.5}, (1.5, 0.0), 3.0),
        ({"stiffness": 3.0, "springref": 0.5}, (0.0, 9.0), -1.5),
        ({"damping": 2.0}, (0.0, -1.5), -3.0),
        ({"quadratic": 2.0}, (0.0, -3.0), -18.0),
        ({"cubic": 2.0}, (0.0, -3.0), -54.0),
        ({"knee": 4.0, "knee_speed": 0.5}, (0.0, 0.25), 2.0),
        ({"knee": 4.0, "knee_speed": 0.5}, (0.0, -2.0), -4.0),
        ({}, (1.0, 1.0), 0.0),
    ],
)
def test_each_field_of_a_joint_pulls_by_its_law(fields, at, torque):
    """Numbers by hand; the other joint has nothing and feels nothing."""
    own = {name: np.array([0.0, x]) for name, x in fields.items()}
    robot = replace(pendulum(2), **own)
    q, v = (np.array([[0.3, x]]) for x in at)
    found = robot.joint_torque(q, v, 0.0 * q)
    np.testing.assert_allclose(found, [[0.0, torque]], atol=1e-12)
    a = np.array([[2.0, -4.0]])  # rotors of 0.05 kg·m²
    np.testing.assert_allclose(
        robot.joint_torque(q, v, a), found + [[0.1, -0.2]], atol=1e-12
    )


def test_a_ripple_of_a_file_repeats_with_its_period():
    robot = replace(pendulum(2), ripple=np.array([[1.0, 0.3, 0.4, 2.0]]))
    q = np.array([[0.2, 0.0], [0.2, np.pi / 4], [0.2, np.pi / 2], [0.2, np.pi]])
    found = robot.joint_torque(q, 0 * q, 0 * q)
    np.testing.assert_allclose(found[:, 1], [0.4, 0.3, -0.4, 0.4], atol=1e-12)
    np.testing.assert_array_equal(found[:, 0], 0.0)


@pytest.mark.parametrize(
    ("stated", "filled"),
    [
        ((-np.inf, np.inf), (-np.pi, np.pi)),
        ((-0.5, 0.7), (-0.5, 0.7)),
        ((-0.5, np.inf), (-0.5, np.pi)),
        ((4.0, np.inf), (4.0, 4.0 + np.pi)),
        ((-np.inf, -4.0), (-4.0 - np.pi, -4.0)),
        ((-np.inf, 0.7), (-np.pi, 0.7)),
    ],
)
def test_limits_that_a_file_lacks_lie_beside_those_that_it_has(stated, filled):
    low, high = (np.array([x]) for x in stated)
    unknown = np.array([np.inf])
    robot = replace(pendulum(), q_min=low, q_max=high, v_max=unknown)
    found = limits(robot)
    assert (found[0][0], found[1][0]) == pytest.approx(filled)
    assert (found[2][0], found[3][0]) == (2.0, 10.0)


# --- links ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_a_pseudo_inertia_is_the_second_moment_of_its_points(seed):
    rng = np.random.default_rng(seed)
    mass, at = rng.uniform(0.1, 2.0, 5), rng.normal(size=(5, 3))
    ones = np.hstack([at, np.ones((5, 1))])
    inertia = sum(
        m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(mass, at, strict=True)
    )
    order = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    link = np.array([mass.sum(), *(mass @ at), *inertia[order]])
    J = pseudo_inertia(link)
    np.testing.assert_allclose(J, (mass[:, None] * ones).T @ ones, atol=1e-12)
    np.testing.assert_allclose(inertial_from_pseudo(J), link, atol=1e-12)
    np.testing.assert_allclose(unstacked(stacked(J)), J, atol=1e-12)
    assert stacked(J) @ stacked(J) == pytest.approx((J * J).sum())
    assert stacked(np.diag([1.0, 2.0, 3.0, 4.0])).tolist() == [
        1.0, 0.0, 2.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 4.0,
    ]  # fmt: skip


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])  # m
@pytest.mark.parametrize("mass", [1e-3, 1.0, 1e3])  # kg
def test_what_can_be_built_does_not_depend_on_units(mass, size):
    units = mass * size ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    cube = np.array([6.0, 0.6, 0, 0, 1.0, 0, 1.06, 0, 0, 1.06])
    rod = np.array([2.0, 0, 0, -0.6, 0.24, 0, 0.24, 0, 0, 0.0])
    point = np.array([1.0, 0.1, 0, 0, 0, 0, 0.01, 0, 0, 0.01])
    assert is_consistent(np.array([cube, rod, point]) * units).all()
    heavier = cube * [1, 1, 1, 1, 1, 1, 1, 1, 1, 2.2]  # more than the other two
    outside = cube * [1, 40, 1, 1, 1, 1, 1, 1, 1, 1]
    assert not is_consistent(
        np.array([heavier, outside, -cube, 0 * cube]) * units
    ).any()


def test_a_plausible_link_keeps_what_is_known_and_has_some_width():
    chain = pendulum(2).chain
    known = np.array([[6.0, 0.6, 0, 0, 1.0, 0, 1.06, 0, 0, 1.06], [0.0] * 10])
    found = nominal_bodies(chain, known)
    assert np.linalg.eigvalsh(found).min() > 0
    np.testing.assert_allclose(found[0], pseudo_inertia(known[0]), atol=1e-12)
    lost = inertial_from_pseudo(found[1])
    # As wide as a quarter of the length that counts, 0.3 of 0.6 m, and of water.
    width = 0.3 * 0.6 / 4
    assert lost[0] == pytest.approx(1000.0 * width**3)
    np.testing.assert_allclose(lost[1:4], 0.0, atol=1e-12)
    rod = nominal_bodies(
        chain, np.array([[2.0, 0, 0, -0.6, 0.24, 0, 0.24, 0, 0, 0]] * 2)
    )
    np.testing.assert_allclose(rod[0][3], [0.0, 0.0, -0.6, 2.0], atol=1e-12)
    assert np.linalg.eigvalsh(rod).min() > 0


@pytest.mark.parametrize("seed", range(4))
def test_capsules_go_with_their_links(seed):
    chain = random_arm(seed).chain
    (q,), rng = random_states(chain.size, 1, seed)[:1], np.random.default_rng(seed)
    link = np.repeat(np.arange(-1, chain.size), 2)
    ends = rng.normal(size=(len(link), 2, 3))
    names = tuple("abcdefghijklmn"[: len(link)])
    found = ends_in_world(chain, Capsules(link, ends, np.ones(len(link)), names), q)
    R, p, places = np.eye(3), np.zeros(3), {-1: (np.eye(3), np.zeros(3))}
    for k in range(chain.size):
        R, p = R @ chain.rotation[k], p + R @ chain.translation[k]
        along = q[0, k] * chain.axis[k]
        if chain.revolute[k]:
            R = R @ Rotation.from_rotvec(along).as_matrix()
        else:
            p = p + R @ along
        places[k] = R, p
    for c, k in enumerate(link):
        turned, at = places[int(k)]
        np.testing.assert_allclose(found[0, c], ends[c] @ turned.T + at, atol=1e-9)


# --- fits -----------------------------------------------------------------------------


@pytest.mark.parametrize("least", [-np.inf, 0.0, 2.0])
@pytest.mark.parametrize("seed", range(6))
def test_least_squares_with_bounds_is_that_of_scipy(seed, least):
    """Bounds of some, of most, and bounds that all are held at."""
    rng = np.random.default_rng(seed)
    X, y = rng.normal(size=(30, 5)), rng.normal(size=30)
    lower = np.where(rng.random(5) < 0.7, rng.normal(0.0, 0.3, 5), -np.inf)
    lower = np.maximum(lower, least)
    found = _bounded_solve(X.T @ X, X.T @ y, lower)
    right = lsq_linear(X, y, (lower, np.inf), tol=1e-14).x
    np.testing.assert_allclose(found, right, atol=1e-6)
    assert (found >= lower).all()


def test_hats_between_speeds_hold_a_friction_law_at_each_of_them():
    knots = 2.0 * _knots()
    v = np.concatenate([knots[1:], -knots[1:]])
    columns = _columns(v, 2.0)
    sign, still = np.sign(v), 0 * v
    for shares, found in zip(_shapes(), _maps() @ columns_of(columns), strict=True):
        state = JointState(still, still, v, still, sign, still)
        shapes = {name: 2.0 * share for name, share in shares.items()}
        law = ThresholdFriction.law(state, fastest=2.0, **shapes)
        np.testing.assert_allclose(found[: len(law)], np.stack(law), atol=1e-9)
    between = np.array([0.3, -1.1, 1.999, -0.004])
    hats = _columns(between, 2.0)[: 2 * len(knots)]
    both = np.concatenate([knots, knots])
    np.testing.assert_allclose(both @ hats, between, atol=1e-12)  # straight in between
    np.testing.assert_allclose(hats.sum(axis=0), np.sign(between), atol=1e-12)


def columns_of(columns):
    """Columns, and two more that the maps pass on: load and torque."""
    return np.vstack([columns, np.zeros((2, columns.shape[1]))])


@pytest.mark.parametrize(
    ("law", "inputs"),
    [
        (lambda q, v: 0.0, None),
        (lambda q, v: 2.0 * np.sin(3.0 * q[:, 1]), ((1,), (1,))),
        (lambda q, v: 2.0 * q[:, 0] * q[:, 1], ((0, 1), (1,))),
        (lambda q, v: 2.0 * v[:, 0] * q[:, 1], ((1,), (0, 1))),
    ],
)
def test_a_remainder_looks_at_what_tells_most_and_at_nothing_in_noise(law, inputs):
    rng, count = np.random.default_rng(0), 1200
    q, v = rng.uniform(-1.0, 1.0, (2, count, 2))
    y = law(q, v) + 0.3 * rng.standard_normal(count)
    samples = q, v, y, np.arange(count) % 4
    assert _best_inputs(samples, _candidates(1, 2)) == inputs
    few = tuple(x[:150] for x in samples)
    assert _best_inputs(few, _candidates(1, 2)) is None


# --- signals --------------------------------------------------------------------------


@pytest.mark.parametrize("duration", [3.0, 8.0])
def test_the_tones_of_a_multisine_accelerate_a_joint_alike(duration):
    """Seen where it has faded in, after a second or a quarter: there it is pure."""
    x = multisine(pendulum(2), duration=duration, seed=1, rate=200.0)
    fade = min(1.0, duration / 4)
    pure = (x.t > fade) & (x.t < duration - fade)
    lines = np.arange(np.ceil(0.2 * duration), np.floor(5.0 * duration) + 1)
    seen = []
    for j in range(2):
        w = 2 * np.pi * lines[j::2] / duration
        angle = np.outer(x.t[pure], w)
        X = np.hstack([np.sin(angle), np.cos(angle)])
        c, *_ = np.linalg.lstsq(X, x.a[pure, j], rcond=None)
        np.testing.assert_allclose(X @ c, x.a[pure, j], atol=1e-6)
        sizes = np.hypot(*c.reshape(2, -1))
        late = (x.t > 0.82 * fade) & (x.t < 0.88 * fade)
        angle = np.outer(x.t[late], w)
        rises = np.hstack([np.sin(angle), np.cos(angle)]) @ c - x.a[late, j]
        assert np.abs(rises).max() > 1e-3 * sizes.mean()
        np.testing.assert_allclose(sizes, sizes.mean(), rtol=1e-4)
        seen += w.tolist()
    assert len(set(seen)) == len(lines)
    for y in (x.v, x.a):
        np.testing.assert_allclose(y[[0, -1]], 0.0, atol=1e-9)


def test_noise_that_joints_share_is_the_same_at_each():
    """Its covariance has rank one, which rounding makes a little less than that."""
    zero = np.zeros(3)
    shared = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    noise = replace(Noise.none(3), torque_covariance=shared)
    signals = {x: np.zeros((4000, 3)) for x in ("q", "v", "tau")}
    found = noise.apply(signals, rate=100.0, rng=np.random.default_rng(0))
    np.testing.assert_allclose(
        found["tau"], found["tau"][:, :1] * [1.0, 2.0, 3.0], atol=1e-6
    )
    assert found["tau"][:, 0].std() == pytest.approx(1.0, rel=0.05)
    for name in ("q", "v"):
        np.testing.assert_array_equal(found[name], zero + signals[name])


def test_a_drive_that_is_often_at_its_limit_is_named():
    robot = replace(pendulum(2), tau_max=np.array([60.0, 0.5]))
    reference = random_fourier(robot, duration=2.0, rate=100.0, order=3, seed=0)
    with pytest.warns(HybridWarning) as said:
        Plant(robot, []).run([reference], seed=np.random.default_rng(0))
    texts = [str(x.message) for x in said if "at its torque limit" in str(x.message)]
    assert [x.split("'")[1] for x in texts] == ["hinge_1"]


@pytest.mark.parametrize("times", [2, 3])
def test_the_share_of_time_at_a_limit_does_not_depend_on_the_number_of_motions(times):
    robot = replace(pendulum(2), tau_max=np.array([60.0, 0.5]))
    reference = random_fourier(robot, duration=2.0, rate=100.0, order=3, seed=0)
    said = []
    for references in ([reference], [reference] * times):
        with pytest.warns(HybridWarning, match="at its torque limit") as warned:
            Plant(robot, []).run(references, seed=np.random.default_rng(0))
        said.append(sorted({str(x.message) for x in warned}))
    assert said[0] == said[1]
    (share,) = re.findall(r"for (\d+)%", " ".join(said[0]))
    assert 5 < int(share) <= 100


def test_the_cores_of_a_process_are_counted_where_only_those_of_a_machine_are_known(
    monkeypatch,
):
    assert 1 <= cores() <= os.cpu_count()
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert cores() == os.cpu_count()
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert cores() == 1
