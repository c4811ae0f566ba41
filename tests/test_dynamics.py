"""Batched dynamics agree with pinocchio and with the laws of mechanics."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from arms import MODELS, PUBLIC_ARMS, public_arm, random_arm, random_states
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hybrid.dynamics import RigidBody, inverse_dynamics, regressor, regressor_law
from hybrid.robot import Robot
from hybrid.signals import Motion

SHIPPED = ("coman_like.xml", "scara.xml", "planar.xml")
ARMS = [*PUBLIC_ARMS, *SHIPPED]
seeds = st.integers(0, 2**32 - 1)


@cache
def arm(name: str) -> Robot:
    return Robot.load(MODELS / name) if name in SHIPPED else public_arm(name)


def peer(robot):
    """The arm in pinocchio, without rotors: they are no part of the rigid body."""
    model = robot.pinocchio()
    model.armature[:] = 0.0
    return model, model.createData()


def motion_of(q, v, a):
    t = 0.01 * np.arange(len(q))
    return Motion(t, q, v, a, np.zeros_like(q), np.ones(len(q), dtype=bool))


def assert_close(ours, theirs, relative=1e-11):
    atol = relative * max(1.0, np.abs(theirs).max(initial=0.0))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=atol)


def assert_like_pinocchio(robot, q, v, a):
    model, data = peer(robot)
    rows = list(zip(q, v, a, strict=True))
    Y = np.array(
        [pin.computeJointTorqueRegressor(model, data, *x).copy() for x in rows]
    )
    # (pinocchio's Python face makes a vector of a matrix with one row.)
    n = robot.size
    assert_close(regressor(robot.chain, q, v, a), Y.reshape(len(q), n, 10 * n))
    tau = np.array([pin.rnea(model, data, *x).copy() for x in rows])
    assert_close(inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a), tau)


def potential_energy(chain, q):
    """−Σ gᵀ(m p + R mc), with poses as the docstring of Chain defines them."""
    pose, origin, energy = np.eye(3), np.zeros(3), 0.0
    for k in range(chain.size):
        origin = origin + pose @ chain.translation[k]
        pose = pose @ chain.rotation[k]
        if chain.revolute[k]:
            pose = pose @ Rotation.from_rotvec(chain.axis[k] * q[k]).as_matrix()
        else:
            origin = origin + pose @ chain.axis[k] * q[k]
        m, *mc = chain.inertial[k, :4]
        energy -= chain.gravity @ (m * origin + pose @ np.array(mc))
    return energy


# --- against pinocchio --------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_regressor_and_torque_of_a_known_arm_are_those_of_pinocchio(name):
    robot = arm(name)
    assert_like_pinocchio(robot, *random_states(robot.size, 40))


@settings(max_examples=20)
@given(seeds)
def test_so_are_those_of_random_chains_with_sliding_and_oblique_joints(seed):
    """Whatever their links are, the regressor times them is the torque; at rest this is
    the slope of the potential energy.
    """
    robot = random_arm(seed)
    chain, states = robot.chain, random_states(robot.size, 5, seed)
    assert_like_pinocchio(robot, *states)
    inertial = np.random.default_rng(seed).normal(size=(chain.size, 10))
    tau = inverse_dynamics(chain, inertial, *states)
    assert_close(regressor(chain, *states) @ inertial.ravel(), tau)
    q, h = states[0][:2], 1e-5 * np.eye(chain.size)
    slope = [
        [(potential_energy(chain, x + d) - potential_energy(chain, x - d)) for d in h]
        for x in q
    ]
    rest = inverse_dynamics(chain, chain.inertial, q, 0 * q, 0 * q)
    assert_close(np.array(slope) / 2e-5, rest, 1e-7)


@pytest.mark.parametrize("name", ARMS)
def test_response_is_the_derivative_of_the_torque_along_a_change(name):
    robot = arm(name)
    model, data = peer(robot)
    q, v, a = random_states(robot.size, 20)
    dq, dv, da = np.random.default_rng(1).normal(size=(3, 20, robot.size))
    joints = range(robot.size)
    expected = []
    for k in range(20):
        by_q, by_v, by_a = pin.computeRNEADerivatives(model, data, q[k], v[k], a[k])
        by_a = np.triu(by_a) + np.triu(by_a, 1).T  # pinocchio fills half of it
        expected.append(by_q @ dq[k] + by_v @ dv[k] + by_a @ da[k])
    body = RigidBody(robot.chain, motion_of(q, v, a))
    # Rounding of the torque, 1e-16, over a step of 1e-4 leaves ten digits.
    found = sum(body.response(j, dq[:, j], dv[:, j], da[:, j]) for j in joints)
    assert_close(found, np.array(expected), 1e-7)


@pytest.mark.parametrize("size", [1e-9, 1e6])
def test_response_is_linear_in_the_change_whatever_its_size(size):
    robot = arm("ur10")
    change = np.array(random_states(1, 10, 1))[:, :, 0]
    body = RigidBody(robot.chain, motion_of(*random_states(robot.size, 10)))
    once = body.response(2, *change)
    assert_close(body.response(2, *(size * change)) / size, once, 1e-7)
    assert not body.response(2, *(0 * change)).any()


# --- mechanics ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_power_is_the_rate_of_kinetic_and_potential_energy(name):
    robot = arm(name)
    model, data = peer(robot)
    rng = np.random.default_rng(2)
    dt = 1e-4
    t = dt * np.arange(400)[:, None]
    size, omega, phase = rng.uniform(0.5, 2.0, (3, 1, robot.size))
    q = size * np.sin(omega * t + phase)
    v = size * omega * np.cos(omega * t + phase)
    a = -(omega**2) * q
    energy = [
        pin.computeKineticEnergy(model, data, x, y)
        + pin.computePotentialEnergy(model, data, x)
        for x, y in zip(q, v, strict=True)
    ]
    power = (inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a) * v).sum(1)
    # Central differences err by dt²/6 of the third derivative.
    assert_close(np.gradient(np.array(energy), dt)[1:-1], power[1:-1], 1e-6)


def test_rotors_are_no_part_of_the_rigid_body():
    robot = arm("coman_like.xml")
    assert robot.chain.armature.any()
    q, v, a = random_states(robot.size, 5)
    model = robot.pinocchio()
    with_rotors = np.array(
        [pin.rnea(model, model.createData(), *x) for x in zip(q, v, a, strict=True)]
    )
    rigid = RigidBody(robot.chain, motion_of(q, v, a)).load
    assert_close(with_rotors - rigid, robot.chain.armature * a)


def test_a_body_uses_the_parameters_it_is_given():
    robot = arm("scara.xml")
    motion = motion_of(*random_states(robot.size, 5))
    heavy = RigidBody(robot.chain, motion, 3 * robot.chain.inertial)
    assert_close(heavy.load, 3 * RigidBody(robot.chain, motion).load)
    blocks = [heavy.link_columns(k) for k in range(robot.size)]
    np.testing.assert_array_equal(np.concatenate(blocks, axis=2), heavy.columns)


# --- batches ------------------------------------------------------------------------


BOUNDARIES = (0, 1, 2, 2047, 2048, 2049, 4095, 4096, 4097)


@pytest.mark.parametrize("samples", BOUNDARIES)
def test_the_number_of_samples_changes_no_sample(samples):
    robot = arm("planar.xml")
    chain, n = robot.chain, robot.size
    states = random_states(n, max(BOUNDARIES))
    some = [x[:samples] for x in states]
    whole = regressor(chain, *states)
    Y, tau = regressor(chain, *some), inverse_dynamics(chain, chain.inertial, *some)
    assert Y.shape == (samples, n, 10 * n) and tau.shape == (samples, n)
    # Not equal to the last bit: vector units round their remainders differently.
    assert_close(Y, whole[:samples], 1e-14)
    assert_close(tau, whole[:samples] @ chain.inertial.ravel(), 1e-13)
    if samples:
        ends = [0, samples - 1]
        assert_like_pinocchio(robot, *(x[ends] for x in some))
    body = RigidBody(chain, motion_of(*some))
    one = (x[:, 0] for x in some)
    assert body.response(0, *one).shape == (samples, n)


def test_some_entries_are_those_of_the_whole_regressor():
    robot = arm("planar.xml")
    states = random_states(robot.size, 50)
    which = (17, 3, 9, 10)
    some = regressor_law(robot.chain, which).along(states)
    whole = regressor(robot.chain, *states).reshape(50, -1)
    np.testing.assert_array_equal(some, whole[:, which])


def test_the_memory_layout_of_the_input_does_not_matter():
    robot = arm("planar.xml")
    states = random_states(robot.size, 100)
    turned = [np.asfortranarray(x) for x in states]
    strided = [np.repeat(x, 2, axis=0)[::2] for x in states]
    expected = regressor(robot.chain, *states)
    for other in (turned, strided):
        np.testing.assert_array_equal(regressor(robot.chain, *other), expected)
        assert all(np.isfinite(x).all() for x in other)


def test_inputs_are_left_as_they_were():
    robot = arm("planar.xml")
    states = random_states(robot.size, 10)
    before = [x.copy() for x in states]
    regressor(robot.chain, *states)
    inverse_dynamics(robot.chain, robot.chain.inertial, *states)
    for x, y in zip(states, before, strict=True):
        np.testing.assert_array_equal(x, y)
