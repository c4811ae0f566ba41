"""A joint that twists moves everything beyond it, and every joint feels that."""

from dataclasses import replace

import numpy as np
import pytest
from coarse import Plant, simulate
from pendulum import pendulum
from scipy.integrate import solve_ivp
from simulated import arm, motions

from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.dynamics import RigidBody, inverse_dynamics
from hybrid.effects.elasticity import Elasticity
from hybrid.plant import Noise, random_fourier
from hybrid.signals import Motion

STIFF = {"compliance": 1e-4, "damping": 0.02}


def torque_with_twist(robot, motion, joint, compliance):
    """Torque of the links where they really are, θ − c·τ."""
    chain, twist = robot.chain, np.zeros_like(motion.q)
    for _ in range(3):  # to third order
        speed = np.gradient(twist, motion.t, axis=0)
        rush = np.gradient(speed, motion.t, axis=0)
        tau = inverse_dynamics(
            chain, chain.inertial, motion.q + twist, motion.v + speed, motion.a + rush
        )
        twist[:, joint] = -compliance * tau[:, joint]
    return tau


@pytest.mark.parametrize("joint", [0, 1])
def test_columns_are_first_order_at_every_joint_of_the_arm(joint):
    robot = arm("planar")
    (motion,) = motions(robot, count=1, rate=200.0)
    motion = replace(motion, v=np.gradient(motion.q, motion.t, axis=0))
    body = RigidBody(robot.chain, motion)
    columns = Elasticity((joint,)).columns(motion, body)
    assert columns.shape == (len(motion.t), 2, 1)
    inside = slice(20, -20)
    left = []
    for compliance in (1e-5, 5e-6):
        change = torque_with_twist(robot, motion, joint, compliance) - body.load
        first_order = compliance * columns[:, :, 0]
        left.append(np.abs(change - first_order)[inside].max(axis=0))
        assert (left[-1] < 0.1 * np.abs(change)[inside].max(axis=0)).all()
    # What is left is of second order: a quarter at half the compliance.
    np.testing.assert_allclose(left[1] / left[0], 0.25, atol=0.02)


def test_it_reaches_every_joint_but_acts_on_one():
    effect = Elasticity((1,), {"compliance": 1e-4})
    assert effect.joints == (1,)
    assert effect.reaches(3) == (0, 1, 2)


@pytest.mark.parametrize(("compliance", "damping"), [(1e-4, 5.0), (5e-5, 5.0)])
def test_a_link_swings_by_its_inertia_wherever_the_arm_is(compliance, damping):
    """Two fifths of the gap are left at most; of a mean inertia, more than half."""
    robot = arm("coman_like")
    effect = Elasticity((1,), {"compliance": compliance, "damping": damping})
    plant = Plant(robot, [effect], nominal=robot, noise=Noise.none(robot.size))
    gap = measure_gap(robot, simulate(plant, trajectories=2, duration=4.0, seed=3))
    rest = gap.left.copy()
    for j, columns in gap.columns(effect).items():
        rest[:, j] -= columns @ effect.gain_values
    for j in (1, 2):
        here = gap.moving[:, j]
        left = np.linalg.norm(gap.left[here, j])
        assert np.linalg.norm(rest[here, j]) < 0.4 * left


def test_a_spring_too_soft_for_its_load_bends_it_by_no_more_than_finite():
    robot = arm("coman_like")
    (motion,) = motions(robot, count=1, rate=200.0)
    soft = Elasticity((1,), {"compliance": 1.0})
    columns = soft.columns(motion, RigidBody(robot.chain, motion))
    assert np.abs(columns).max() < 1e6


def test_a_link_without_inertia_follows_its_load_at_once():
    robot = arm("planar")
    bare = robot.chain.inertial.copy()
    bare[1] = 0.0
    chain = replace(robot.chain, inertial=bare)
    (motion,) = motions(robot, count=1, rate=200.0)
    columns = Elasticity((1,), {"compliance": 1e-3}).columns(
        motion, RigidBody(chain, motion)
    )
    assert np.isfinite(columns).all()


@pytest.fixture(scope="module")
def slow():
    """A gap of an arm that moves slowly; its link swings faster than the log shows."""
    robot, rng = arm("planar"), np.random.default_rng(0)
    plant = Plant(robot, [Elasticity((0,), STIFF)], nominal=robot)
    slowly = {"duration": 20.0, "rate": 500.0, "order": 3, "fill": 0.5}
    references = [random_fourier(robot, seed=rng, **slowly)]
    return measure_gap(robot, plant.run(references, seed=np.random.default_rng(1)))


def test_a_swing_faster_than_the_log_shows_is_not_made_of_noise(slow):
    """Which is in the torque that columns are held against, too."""
    effect, up, down = Elasticity((0,), STIFF), 0.0, 0.0
    assert effect.frequency(slow.bodies[0]) == pytest.approx(19.2, abs=0.1)
    for j, columns in slow.columns(effect).items():
        here = slow.moving[:, j]
        up += columns[here, 0] @ slow.left[here, j]
        down += columns[here, 0] @ columns[here, 0]
    assert up / down == pytest.approx(STIFF["compliance"], rel=0.3)


@pytest.mark.parametrize("factor", [0.2, 1.0])
def test_its_compliance_is_that_of_its_columns_wherever_they_are_made(slow, factor):
    search = Search(slow)
    start = Elasticity((0,), {**STIFF, "compliance": factor * STIFF["compliance"]})
    found, _ = search.refine(search.background, candidate(slow, start))
    assert found.effect.values["compliance"] == pytest.approx(
        STIFF["compliance"], rel=0.5
    )


@pytest.mark.parametrize(
    ("compliance", "middle"), [(0.02, 0.0), (0.004, 0.0), (0.3, np.pi)]
)
def test_a_deflection_solves_its_equation_with_more_damping_at_the_start(
    compliance, middle
):
    """A spring that gravity would overcome keeps a tenth of its stiffness."""
    t = np.arange(0, 1.5, 0.001)
    wave = np.stack([np.sin(3 * t), 0.3 * np.sin(5 * t + 1.0)], axis=1)
    q = wave + [middle, 0.0]
    v = np.stack([3 * np.cos(3 * t), 1.5 * np.cos(5 * t + 1.0)], axis=1)
    a = wave * [-9.0, -25.0]
    motion = Motion(t, q, v, a, 0 * q, np.ones(len(t), dtype=bool))
    body = RigidBody(pendulum(2).chain, motion)
    G, C, M = (slope[:, 1] for slope in body.slopes(1))
    stiff = np.maximum(1 / compliance + G, 0.1 / compliance)
    ratio = 0.05 + 0.3 * np.exp(-t / 0.3)
    drag = 0.2 + 2 * ratio * np.sqrt(M.mean() / compliance) + C
    load = body.load[:, 1]

    def rate(time, state):
        m, c, k, f = (np.interp(time, t, x) for x in (M, drag, stiff, load))
        return [state[1], -(f + c * state[1] + k * state[0]) / m]

    start = [-load[0] / stiff[0], 0.0]
    exact = solve_ivp(rate, (0, t[-1]), start, t_eval=t, rtol=1e-7, atol=1e-10).y[0]
    law = Elasticity((1,), {"compliance": compliance, "damping": 0.2})
    found = law.observe(motion, body)
    size = np.abs(exact).max()
    np.testing.assert_allclose(found.q[:, 1] - q[:, 1], exact, atol=3e-3 * size)
    np.testing.assert_array_equal(found.q[:, 0], q[:, 0])
    speed = np.gradient(exact, t)
    inner = slice(5, -5)
    np.testing.assert_allclose(
        (found.v - v)[inner, 1], speed[inner], atol=1e-2 * np.abs(speed).max()
    )
    rush = np.gradient(speed, t)
    np.testing.assert_allclose(
        (found.a - a)[inner, 1], rush[inner], atol=2e-2 * np.abs(rush).max()
    )
