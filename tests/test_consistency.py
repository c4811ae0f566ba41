"""Physical consistency: what comes out could be built, and still fits the data."""

from dataclasses import replace
from functools import cache

import clarabel
import numpy as np
import pytest
from arms import MODELS, public_arm, random_arm
from coarse import simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import data_of

from hybrid.dynamics import inverse_dynamics
from hybrid.dynamics.pseudo_inertia import (
    inertial_from_pseudo,
    is_consistent,
    nominal_bodies,
    pseudo_inertia,
)
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import IdentificationError
from hybrid.exports import export
from hybrid.identification import identify
from hybrid.identification.consistency import physically_consistent
from hybrid.identification.preparation import motions_from_logs
from hybrid.regression.cross_products import accumulate
from hybrid.regression.problem import build_problem
from hybrid.report.fit import effects_table
from hybrid.robot import Robot
from hybrid.robot.spatial import inertial_about
from hybrid.signals import Motion

KINDS = (Armature, Viscous, Coulomb, TorqueOffset)
ARMS = ("coman_like", "ur10", "panda", "kr300", "desktop")
SEEDS = range(6)


@cache
def arm(name):
    """An arm from a file, or one of another size: 35 or 1/100 of the mass of a UR10."""
    if name == "coman_like":
        return Robot.load(MODELS / "coman_like.xml")
    if name not in ("kr300", "desktop"):
        return public_arm(name)
    mass, length = (35.0, 2.0) if name == "kr300" else (0.01, 0.2)
    chain = public_arm("ur10").chain
    scale = mass * np.array([1.0, *[length] * 3, *[length**2] * 6])
    chain = replace(
        chain,
        translation=chain.translation * length,
        inertial=chain.inertial * scale,
    )
    return replace(public_arm("ur10"), chain=chain)


@cache
def problem_of(name):
    n = arm(name).size
    return build_problem(arm(name).chain, [E((j,)) for E in KINDS for j in range(n)])


def some_links(chain, rng, spread=0.3):
    """Physical links unlike the nominal ones, but of their size."""
    root = np.linalg.cholesky(nominal_bodies(chain, chain.inertial))
    root = root @ (np.eye(4) + spread * rng.normal(size=(chain.size, 4, 4)))
    return inertial_from_pseudo(root @ root.transpose(0, 2, 1))


def some_motion(chain, rng, samples):
    """Twenty seconds of five harmonics up to 3 rad/s."""
    t = np.linspace(0.0, 20.0, samples)
    w = 0.2 * np.pi * np.arange(1, 6)[:, None, None]
    size = rng.normal(size=(5, 1, chain.size))
    angle = w * t[:, None] + rng.uniform(0, 2 * np.pi, (5, 1, chain.size))
    v = (size * np.cos(angle)).sum(axis=0)
    q, a = (
        (size / w * np.sin(angle)).sum(axis=0),
        -(size * w * np.sin(angle)).sum(axis=0),
    )
    scale = 3.0 / np.abs(v).max(axis=0)
    mask = np.ones(samples, dtype=bool)
    return Motion(t, q * scale, v * scale, a * scale, 0 * q, mask, joints=chain.joints)


def torque_of(problem, inertial, gains, motion):
    """Torque of links and of the gains of four effects, shapes (n, 10) and (4, n)."""
    q, v, a = motion.q, motion.v, motion.a
    tau = inverse_dynamics(problem.chain, inertial, q, v, a)
    for gain, column in zip(gains, (a, v, np.sign(v), np.ones_like(v)), strict=True):
        tau += gain * column
    return tau


def some_gains(inertial, rng):
    size = inertial[:, 0].sum() / 30 * np.array([[0.02], [0.5], [0.3], [0.1]])
    return size * rng.uniform(0.5, 1.5, (4, len(inertial)))


def experiment(problem, seed, *, samples=600, noise=0.0):
    """Truth (links, gains, unknowns) and cross-products of one noisy motion."""
    rng = np.random.default_rng(seed)
    inertial = some_links(problem.chain, rng)
    gains = some_gains(inertial, rng)
    motion = some_motion(problem.chain, rng, samples)
    tau = torque_of(problem, inertial, gains, motion)
    size = np.sqrt((tau**2).mean(axis=0))
    motion = replace(motion, tau=tau + noise * size * rng.normal(size=tau.shape))
    products = crossed(problem, motion)
    theta = problem.base.mapping @ np.concatenate([inertial.ravel(), gains.ravel()])
    A, b = products.normal(np.diag(size**-2.0))
    return (inertial, gains, theta), products, A, b


def crossed(problem, motion):
    """Cross-products of all samples of a motion."""
    return accumulate(problem, data_of([motion]))


def rms(products, theta):
    """Residual of each joint, shape (n,)."""
    squares = np.diag(products.residual_products(theta)).clip(0)
    return np.sqrt(squares / products.samples)


# --- pseudo-inertia -------------------------------------------------------------------


def test_pseudo_inertia_is_the_second_moment_of_the_mass():
    """A box with half of its mass in the upper third, cut into cells."""
    sides, density = np.array([0.3, 0.2, 0.6]), lambda z: np.where(z > 0.2, 2.0, 0.5)
    line = (np.arange(60) + 0.5) / 60
    at = np.stack(np.meshgrid(*[s * line for s in sides]), axis=-1).reshape(-1, 3)
    mass = density(at[:, 2])
    point = np.column_stack([at, np.ones(len(at))])
    integral = (mass[:, None] * point).T @ point
    center = mass @ at / mass.sum()
    arms = at - center
    about = np.eye(3) * (mass @ (arms**2).sum(axis=1)) - (mass[:, None] * arms).T @ arms
    J = pseudo_inertia(inertial_about(mass.sum(), center, about))
    np.testing.assert_allclose(J, integral, rtol=1e-12, atol=1e-9 * mass.sum())


@pytest.mark.parametrize("mass, radius", [(0.1, 0.01), (5.0, 0.1), (400.0, 0.8)])
def test_a_solid_sphere_has_a_fifth_of_m_r_squared_each_way(mass, radius):
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    J = pseudo_inertia(inertial_about(mass, np.zeros(3), inertia))
    third = mass * radius**2 / 5
    np.testing.assert_allclose(J, np.diag([third, third, third, mass]), rtol=1e-14)


def test_pseudo_inertia_is_linear_and_invertible():
    x, y = np.random.default_rng(0).normal(size=(2, 3, 5, 10))
    np.testing.assert_allclose(inertial_from_pseudo(pseudo_inertia(x)), x, atol=1e-14)
    np.testing.assert_allclose(
        pseudo_inertia(x + 2 * y), pseudo_inertia(x) + 2 * pseudo_inertia(y), atol=1e-14
    )


seeds = st.integers(0, 2**32 - 1)
sizes = st.floats(-3.0, 3.0).map(lambda x: 10.0**x)


@settings(max_examples=60)
@given(seed=seeds, points=st.integers(1, 9), mass=sizes, length=sizes)
def test_any_set_of_point_masses_is_physical(seed, points, mass, length):
    rng = np.random.default_rng(seed)
    masses = mass * rng.uniform(0.1, 1.0, points)
    body = sum(
        inertial_about(m, length * rng.normal(size=3), np.zeros((3, 3))) for m in masses
    )
    assert is_consistent(body)
    assert not is_consistent(-body)


@settings(max_examples=60)
@given(seed=seeds, excess=st.floats(1e-6, 10.0), mass=sizes, length=sizes)
def test_no_body_breaks_the_triangle_inequality(seed, excess, mass, length):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    moments = rng.uniform(0.1, 1.0, 3)
    moments[2] = moments[0] + moments[1]
    for more, physical in ((-1e-6, True), (excess, False)):
        principal = moments * [1, 1, 1 + more] * mass * length**2
        center = 0.3 * length * rng.normal(size=3)
        body = inertial_about(mass, center, turn @ np.diag(principal) @ turn.T)
        assert is_consistent(body) == physical


def test_negative_mass_and_a_centre_beyond_the_mass_are_not_physical():
    body = inertial_about(2.0, np.array([0.1, 0.0, 0.2]), 0.01 * np.eye(3))
    weightless, far = body.copy(), body.copy()
    weightless[0], far[1:4] = -1e-3, 5 * far[1:4]
    np.testing.assert_array_equal(
        is_consistent(np.array([body, weightless, far, np.zeros(10)])),
        [True, False, False, False],
    )


# --- nominal bodies -------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", sorted(set(ARMS) - {"panda"})
)  # it has one that is not
def test_physical_links_of_a_robot_file_are_taken_as_they_are(name):
    chain = arm(name).chain
    bodies = inertial_from_pseudo(nominal_bodies(chain, chain.inertial))
    scale = np.abs(chain.inertial).max(axis=1, keepdims=True)
    np.testing.assert_allclose(bodies / scale, chain.inertial / scale, atol=1e-12)


@pytest.mark.parametrize("lost", [slice(0, 10), slice(4, 10)])
@pytest.mark.parametrize("name", ARMS)
def test_links_without_inertia_become_bodies_of_their_size(name, lost):
    chain, inertial = arm(name).chain, arm(name).chain.inertial.copy()
    inertial[:, lost] = 0.0
    J = nominal_bodies(chain, inertial)
    assert (np.linalg.eigvalsh(J)[:, 0] > 0).all()
    heavier = J[:, 3, 3].sum() / chain.inertial[:, 0].sum()
    assert 0.02 < heavier < 50


# --- the semidefinite program ---------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_clean_data_of_a_physical_arm_give_its_base_parameters_back(name):
    problem = problem_of(name)
    for seed in SEEDS[:2]:
        (_, _, theta), _, A, b = experiment(problem, seed)
        found = physically_consistent(problem, A, b)
        assert found.converged and found.loss < 1e-10
        error = np.linalg.norm(found.theta - theta) / np.linalg.norm(theta)
        assert error < 1e-5
        # In torque, where no small parameter hides behind a large one.
        change = found.theta - theta
        assert change @ A @ change < 1e-10 * (theta @ A @ theta)
        assert is_consistent(found.inertial).all()


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), noise=st.sampled_from([0.0, 0.2]))
def test_any_chain_gets_links_that_could_be_built(seed, noise):
    robot = random_arm(seed)
    problem = build_problem(robot.chain, [Viscous((0,))])
    rng = np.random.default_rng(seed)
    motion = some_motion(robot.chain, rng, 300)
    q, v, a = motion.q, motion.v, motion.a
    tau = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a)
    tau = tau + noise * np.abs(tau).mean(axis=0) * rng.normal(size=tau.shape)
    products = crossed(problem, replace(motion, tau=tau))
    A, b = products.normal(np.eye(robot.size))
    found = physically_consistent(problem, A, b)
    assert is_consistent(found.inertial).all()
    assert found.loss < (0.5 if noise else 1e-8)


def test_the_unknowns_are_those_of_the_links_and_gains_handed_out():
    problem = problem_of("coman_like")
    _, _, A, b = experiment(problem, 1, noise=0.2)
    found = physically_consistent(problem, A, b)
    # The rotor of the first joint is dropped: it is beside the first link.
    assert "armature.inertia[base]" in problem.base.dropped
    first = found.inertial.size
    columns = [*range(first), *found.beside]
    links = [*found.inertial.ravel(), *found.beside.values()]
    links = problem.base.mapping[:, columns] @ links
    size = np.abs(links).max()
    np.testing.assert_allclose(
        found.theta[problem.rigid], links[problem.rigid], rtol=0, atol=1e-14 * size
    )
    gains = np.zeros((4, problem.chain.size))
    motion = some_motion(problem.chain, np.random.default_rng(5), 50)
    kept = {c: u for u, c in enumerate(problem.base.kept)}
    for k in range(gains.size):
        if first + k in kept:
            gains.flat[k] = found.theta[kept[first + k]]
        gains.flat[k] += found.beside.get(first + k, 0.0)
    tau = torque_of(problem, found.inertial, gains, motion)
    residual = rms(crossed(problem, replace(motion, tau=tau)), found.theta)
    assert residual.max() < 1e-6 * np.abs(tau).max()


@pytest.mark.parametrize("name", ARMS)
def test_a_rotor_heavier_than_its_link_leaves_the_links_physical(name):
    """It cannot be told from its link, which has no room for it."""
    problem = problem_of(name)
    rng = np.random.default_rng(0)
    inertial, motion = (
        some_links(problem.chain, rng),
        some_motion(problem.chain, rng, 600),
    )
    gains = some_gains(inertial, rng)
    gains[0, 1] += 20.0 * inertial[1, [4, 6, 9]].max()
    joint = problem.chain.joints[1]
    assert f"armature.inertia[{joint}]" in problem.base.dropped
    tau = torque_of(problem, inertial, gains, motion)
    products = crossed(problem, replace(motion, tau=tau))
    weight = np.diag(1.0 / (tau**2).mean(axis=0))
    found = physically_consistent(problem, *products.normal(weight))
    assert found.converged and found.loss < 1e-10
    assert is_consistent(found.inertial).all()


@pytest.mark.study
def test_the_model_and_the_simulator_of_an_arm_have_its_heavy_rotor(tmp_path):
    robot = Robot.load(MODELS / "coman_like.xml")
    logs = simulate(robot, [Armature((1,), {"inertia": 1.0})], trajectories=4)
    fit = identify(robot, logs[:3], stages=["rigid"], consistent=True)
    model = fit.model
    assert not any("consistent links raise" in x for x in fit.warnings)
    assert is_consistent(model.inertial).all()
    (rotor,) = (e for e in model.effects if e.id == "armature" and e.joints == (1,))
    assert rotor.values["inertia"] > 0.8
    # How much of it is the link's no log tells: it is none of the effects found.
    rows = [row[:2] for row in effects_table(fit).rows]
    assert (robot.joints[1], "armature") not in rows
    assert (robot.joints[2], "armature") in rows
    # The base parameters and the links, each with the effects, are the same model.
    (motion,), _ = motions_from_logs(logs[3:], model.cutoff)
    tau = model.predict(motion)
    other = replace(model, inertial=None).predict(motion)
    np.testing.assert_allclose(tau, other, rtol=0, atol=1e-6 * np.abs(tau).max())
    export(model, tmp_path, format="mjcf")
    written = Robot.load(next(tmp_path.glob("*.xml")))
    assert written.chain.armature[1] == pytest.approx(rotor.values["inertia"])


def test_a_rotor_that_no_log_tells_from_its_link_is_that_of_the_file():
    """Actuators for Isaac Lab have the rotor, and a user's own file has the link."""
    robot = Robot.load(MODELS / "scara.xml")
    logs = simulate(robot, trajectories=4)
    model = identify(robot, logs, stages=["rigid"], consistent=True).model
    rotor = next(e for e in model.effects if e.id == "armature" and e.joints == (0,))
    assert rotor.values["inertia"] == pytest.approx(robot.chain.armature[0], rel=0.1)
    assert model.inertial[0, 9] == pytest.approx(robot.chain.inertial[0, 9], rel=0.1)


@pytest.mark.parametrize("name", ARMS)
def test_physics_costs_little_on_noisy_data_and_pays_on_new_motion(name):
    """Few noisy samples, where plain least squares asks for links nobody can build."""
    problem, held_out, lost = problem_of(name), [], []
    for seed in SEEDS:
        (inertial, gains, _), products, A, b = experiment(
            problem, seed, samples=300, noise=0.2
        )
        plain = solve_plain(A, b)
        found = physically_consistent(problem, A, b)
        assert found.converged and is_consistent(found.inertial).all()
        assert found.loss > 1e-7, "plain least squares was physical: no case"
        worse = rms(products, found.theta) / rms(products, plain) - 1
        lost.append(worse.max())
        motion = some_motion(problem.chain, np.random.default_rng(100 + seed), 300)
        tau = torque_of(problem, inertial, gains, motion)
        new = crossed(problem, replace(motion, tau=tau))
        held_out.append(np.mean(rms(new, found.theta) / rms(new, plain)))
    assert np.median(lost) < 0.04 and max(lost) < 0.1
    assert np.median(held_out) < 0.95
    assert max(held_out) < 1.05


def solve_plain(A, b):
    """Unconstrained optimum."""
    size = np.sqrt(np.diag(A))
    return np.linalg.lstsq(A / size / size[:, None], b / size, rcond=1e-13)[0] / size


def test_plain_least_squares_is_returned_where_it_is_physical():
    problem = problem_of("coman_like")
    _, products, A, b = experiment(problem, 0, samples=2000, noise=1e-4)
    found = physically_consistent(problem, A, b)
    plain = solve_plain(A, b)
    assert found.loss < 1e-10
    np.testing.assert_allclose(
        rms(products, found.theta), rms(products, plain), rtol=1e-4
    )
    assert np.linalg.norm(found.theta - plain) < 1e-3 * np.linalg.norm(plain)


@pytest.mark.parametrize("name", ARMS)
def test_mujoco_simulates_the_links(name):
    problem = problem_of(name)
    for noise in (0.0, 0.3):
        (inertial, *_), _, A, b = experiment(problem, 3, noise=noise)
        found = physically_consistent(problem, A, b)
        model = arm(name).with_inertial(found.inertial).mujoco_spec().compile()
        np.testing.assert_allclose(model.body_mass[1:], found.inertial[:, 0])
        assert (model.body_inertia[1:] > 0).all()
        # Links that the data do not see stay near the file instead of running away.
        assert 0.1 < found.inertial[:, 0].sum() / inertial[:, 0].sum() < 10


def test_gains_stay_at_or_above_their_bounds():
    problem = problem_of("coman_like")
    bounded = np.isfinite(problem.lower)
    touched = False
    for seed in SEEDS:
        (_, _, theta), _, A, b = experiment(problem, seed, noise=0.1)
        b = b - A @ np.where(bounded, 0.99 * theta, 0.0)  # hardly any friction left
        plain = solve_plain(A, b)
        touched |= bool((plain < problem.lower).any())
        found = physically_consistent(problem, A, b)
        assert (found.theta >= problem.lower).all()
    assert touched


def test_a_poor_robot_file_does_not_decide_what_the_data_see():
    problem = problem_of("ur10")
    (_, _, theta), products, A, b = experiment(problem, 0)
    _, noisy, noisy_A, noisy_b = experiment(problem, 0, noise=0.1)
    for nominal in (0.0, 10.0, 0.1):
        links = nominal * problem.chain.inertial
        poor = replace(problem, chain=replace(problem.chain, inertial=links))
        found = physically_consistent(poor, A, b)
        assert rms(products, found.theta).max() < 1e-3
        assert np.linalg.norm(found.theta - theta) < 1e-4 * np.linalg.norm(theta)
        found = physically_consistent(poor, noisy_A, noisy_b)
        worse = rms(noisy, found.theta) / rms(noisy, solve_plain(noisy_A, noisy_b))
        assert is_consistent(found.inertial).all() and worse.max() < 1.02


def test_without_data_on_some_joints_their_links_stay_nominal():
    """Only the last joint moves: the others are as the file has them."""
    problem = problem_of("coman_like")
    rng = np.random.default_rng(0)
    motion = some_motion(problem.chain, rng, 300)
    still = np.array([0, 0, 0, 0, 0, 1.0])
    motion = replace(motion, q=motion.q * still, v=motion.v * still, a=motion.a * still)
    links = problem.chain.inertial
    tau = torque_of(problem, links, some_gains(links, rng) * still, motion)
    products = crossed(problem, replace(motion, tau=tau))
    found = physically_consistent(problem, *products.normal(np.eye(6)))
    np.testing.assert_allclose(found.inertial[:5], links[:5], rtol=1e-3, atol=1e-5)
    rotors = {
        problem.effects[e].joints[0]: found.theta[u] for u, e, _ in problem.gains
        if problem.effects[e].id == "armature"
    } | {0: found.beside[60], 1: found.beside[61]}  # fmt: skip
    np.testing.assert_allclose(
        [rotors[j] for j in range(5)], problem.chain.armature[:5], rtol=1e-3
    )


def test_no_data_and_a_failed_solver_are_said_so(monkeypatch):
    problem = problem_of("coman_like")
    _, _, A, b = experiment(problem, 0, noise=0.1)
    with pytest.raises(IdentificationError, match="nothing to fit"):
        physically_consistent(problem, 0 * A, 0 * b)
    with pytest.raises(IdentificationError, match="not finite"):
        physically_consistent(problem, A, np.nan * b)
    make = clarabel.DefaultSettings

    def impatient():
        settings = make()
        settings.max_iter = 1
        return settings

    monkeypatch.setattr(clarabel, "DefaultSettings", impatient)
    with pytest.raises(IdentificationError, match="MaxIterations"):
        physically_consistent(problem, A, b)


def test_a_link_without_mass_is_a_blob_of_water_half_way_to_the_next_joint():
    chain = arm("coman_like").chain
    inertial = chain.inertial.copy()
    inertial[2] = 0.0
    ahead = chain.translation[3]
    width = np.linalg.norm(ahead) / 4
    (mass, *first, xx, xy, yy, xz, yz, zz) = inertial_from_pseudo(
        nominal_bodies(chain, inertial)[2]
    )
    assert mass == pytest.approx(1000.0 * width**3)
    np.testing.assert_allclose(np.array(first) / mass, ahead / 2)
    # About its centre it is as wide in every direction.
    c = ahead / 2
    offset = mass * (c @ c * np.eye(3) - np.outer(c, c))
    found = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - offset
    np.testing.assert_allclose(found, 2 * mass * width**2 * np.eye(3), atol=1e-12)


@pytest.mark.parametrize(("thin", "stays"), [(0.1, True), (1e-4, False)])
def test_a_flat_link_stays_and_one_without_any_width_becomes_a_blob(thin, stays):
    chain = arm("coman_like").chain
    width = np.linalg.norm(chain.translation[3]) / 4
    spread = width**2 * np.array([thin**2, 0.5, 2.0])
    body = np.diag([*spread, 1.0])
    inertial = chain.inertial.copy()
    inertial[2] = inertial_from_pseudo(body)
    found = nominal_bodies(chain, inertial)[2]
    expected = np.maximum(spread, found[0, 0]) if stays else np.full(3, width**2)
    np.testing.assert_allclose(np.diag(found)[:3], expected)
    assert found[0, 0] < (0.5 if stays else 1.1) * width**2
