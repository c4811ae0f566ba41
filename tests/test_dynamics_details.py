"""Gradients of the dynamics, stacked columns, and the tape of operations, in detail."""

import numpy as np
import pytest
from arms import MODELS, random_arm, random_states

from hybrid.dynamics import (
    Law,
    RigidBody,
    inverse_dynamics,
    regressor,
    regressor_gradient,
    torque_gradient,
)
from hybrid.dynamics.base import inertial_labels
from hybrid.dynamics.stacked import (
    effect_gains,
    rich_motion,
    stacked_base,
    stacked_columns,
)
from hybrid.dynamics.tape import OPERATIONS, Tape
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.gravity_tilt import GravityTilt
from hybrid.effects.spring import Spring
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.errors import HybridError
from hybrid.robot import Robot
from hybrid.signals import Motion

STEP = 1e-6
SEEDS = (1, 3, 7, 14)  # of arms with both kinds of joints, and of one slide


def slopes(function, states):
    """Central differences of a sum over joints j by q_j, v_j and a_j, (3, N, n)."""
    out = np.zeros((3, *states[0].shape))
    for kind in range(3):
        for j in range(states[0].shape[1]):
            ends = []
            for sign in (1, -1):
                moved = [x.copy() for x in states]
                moved[kind][:, j] += sign * STEP
                ends.append(function(*moved))
            out[kind, :, j] = (ends[0] - ends[1]) / (2 * STEP)
    return out


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gradient_of_weighted_columns_is_that_of_differences(seed):
    """Of arms with turning and sliding joints on oblique axes."""
    robot = random_arm(seed)
    states = random_states(robot.size, 6, seed)
    shape = (6, robot.size, 10 * robot.size)
    weight = np.random.default_rng(seed).normal(size=shape)

    def total(q, v, a):
        return (weight * regressor(robot.chain, q, v, a)).sum(axis=(1, 2))

    found = regressor_gradient(robot.chain, *states, weight)
    expected = slopes(total, states)
    for part, slope in zip(found, expected, strict=True):
        np.testing.assert_allclose(part, slope, atol=1e-6 * (1 + np.abs(slope).max()))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gradient_of_one_joints_torque_is_that_of_differences(seed):
    robot = random_arm(seed)
    states = random_states(robot.size, 12, seed)
    joint = np.arange(12) % robot.size
    inertial = robot.chain.inertial

    def torque(q, v, a):
        return inverse_dynamics(robot.chain, inertial, q, v, a)[np.arange(12), joint]

    found = torque_gradient(robot.chain, *states, inertial, joint)
    expected = slopes(torque, states)
    for part, slope in zip(found, expected, strict=True):
        np.testing.assert_allclose(part, slope, atol=1e-6 * (1 + np.abs(slope).max()))


def test_gradients_of_many_blocks_are_those_of_each_sample():
    robot = random_arm(SEEDS[0])
    states = random_states(robot.size, 5000)
    weight = np.random.default_rng(0).normal(size=(5000, robot.size, 10 * robot.size))
    whole = regressor_gradient(robot.chain, *states, weight)
    for here in (slice(4090, 4100), slice(4995, 5000)):
        part = regressor_gradient(robot.chain, *(x[here] for x in states), weight[here])
        for x, y in zip(whole, part, strict=True):
            np.testing.assert_allclose(x[here], y, rtol=1e-12, atol=1e-12)


def motion_at(robot, samples=30, seed=0):
    q, v, a = random_states(robot.size, samples, seed)
    t = 0.01 * np.arange(samples)
    return Motion(t, q, v, a, 0 * q, np.ones(samples, bool), joints=robot.joints)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_weight_of_links_is_their_torque_at_rest(seed):
    robot = random_arm(seed)
    motion = motion_at(robot)
    body = RigidBody(robot.chain, motion)
    zero = np.zeros_like(motion.q)
    gravity = robot.chain.gravity
    at_rest = inverse_dynamics(robot.chain, robot.chain.inertial, motion.q, zero, zero)
    np.testing.assert_allclose(body.weight(gravity), at_rest, atol=1e-9)
    np.testing.assert_allclose(body.weight(2 * gravity), 2 * at_rest, atol=1e-9)
    np.testing.assert_array_equal(body.gravity, gravity)
    links = [body.link_columns(link) for link in range(robot.size)]
    assert "columns" not in vars(body)  # those of all links stay in memory
    columns = body.columns
    for link, own in enumerate(links):
        assert own.shape == (30, robot.size, 10)
        np.testing.assert_array_equal(own, columns[:, :, 10 * link : 10 * link + 10])
    np.testing.assert_allclose(
        columns @ robot.chain.inertial.ravel(), body.load, atol=1e-9
    )


# --- stacked columns ------------------------------------------------------------------


def planar():
    return Robot.load(MODELS / "planar.xml")


def test_columns_of_effects_stand_where_they_act_and_have_names_and_units():
    robot = planar()
    effects = [
        Coulomb((1,)),
        Spring((0,)),
        TransmissionCoupling((0, 1)),
        GravityTilt((0, 1)),
        TorqueRipple((1,), {"periods": 5.0}),
        TorqueRipple((1,), {"periods": 7.0}),
    ]
    gains = effect_gains(effects, without=[(1, "preload"), (3, "roll")])
    assert gains == (
        (0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (3, 1), (4, 0), (4, 1), (5, 0), (5, 1),
    )  # fmt: skip
    motion = motion_at(robot)
    stacked = stacked_columns(robot.chain, effects, gains, motion)
    assert stacked.shape == (30, 2, 20 + 10)
    own = stacked[:, :, 20:]
    np.testing.assert_array_equal(own[:, 1, 0], np.sign(motion.v[:, 1]))
    np.testing.assert_array_equal(own[:, 0, 1], motion.q[:, 0])
    for joint, column in ((0, 0), (1, 1), (0, 6), (0, 9)):
        assert not own[:, joint, column].any()
    np.testing.assert_allclose(own[:, 1, 8], np.sin(7 * motion.q[:, 1]))
    base = stacked_base(robot.chain, effects, gains)
    labels, units = inertial_labels(2)
    assert base.labels[:20] == labels and base.units[:20] == units
    assert base.labels[20:26] == (
        "coulomb.level[elbow]",
        "spring.stiffness[shoulder]",
        "transmission_coupling.inertia[shoulder+elbow]",
        "transmission_coupling.viscous[shoulder+elbow]",
        "transmission_coupling.coulomb[shoulder+elbow]",
        "gravity_tilt.pitch[arm]",
    )
    # Two of one kind at one joint are told apart by their shapes.
    waves = ("sine", "cosine")
    names = [f"torque_ripple.{x}[elbow, periods {k}" for k in (5, 7) for x in waves]
    for label, name in zip(base.labels[26:], names, strict=True):
        assert label.startswith(name)
    assert base.units[20:25] == ("N·m", "N·m/rad", "kg·m²", "N·m·s/rad", "N·m")
    assert effect_gains([]) == ()


def test_a_rich_motion_is_one_motion_with_its_true_derivatives():
    motion = rich_motion(planar().chain)
    assert motion.q.shape == (600, 2) and motion.t[-1] == 20.0 and motion.mask.all()
    inner = slice(3, -3)
    for x, slope in ((motion.q, motion.v), (motion.v, motion.a)):
        differences = np.gradient(x, motion.t, axis=0)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(differences[inner], slope[inner], atol=0.02 * scale)
    assert np.ptp(motion.q, axis=0).min() > 1.0
    assert np.abs(motion.tau).mean() > 1e3  # beyond any limit
    assert (np.diff(motion.temperature, axis=0) > 0).all()
    np.testing.assert_array_equal(rich_motion(planar().chain).q, motion.q)


# --- the tape -------------------------------------------------------------------------


def run(tape, results, **given):
    """Values of results at given inputs, numbers or arrays."""
    law = Law(tape, tuple(results), tuple(given))
    arrays = np.stack([np.asarray(x, float) for x in given.values()], axis=-1)
    return law.along((arrays,)).T if arrays.ndim > 1 else law.at(arrays.tolist())


def test_every_operation_runs_as_numpy_does():
    x, y = np.array([0.3, 1.7, 0.9]), np.array([0.5, 0.2, 0.9])
    for name, function in OPERATIONS.items():
        tape = Tape()
        count = 3 if name == "where" else 2 if name in _TWO else 1
        symbols = [tape.input(letter) for letter in "xyz"[:count]]
        given = {"x": x, "y": y, "z": x - y}
        if name == "where":
            given["x"] = x > 0.5
        given = {letter: given[letter] for letter in "xyz"[:count]}
        (found,) = run(tape, [tape.apply(name, *symbols)], **given)
        np.testing.assert_allclose(found, function(*given.values()), rtol=1e-15)


_TWO = {
    "add", "subtract", "multiply", "divide", "power", "minimum", "maximum", "less",
    "less_equal", "greater", "greater_equal",
}  # fmt: skip


def test_arithmetic_of_symbols_and_numbers_from_either_side():
    tape = Tape()
    x = tape.input("x")
    formulas = {
        3.0: x + 1.0, 3.5: 1.5 + x, 0.5: x - 1.5, -0.5: 1.5 - x, 5.0: x * 2.5,
        10.0: 5.0 * x, 0.8: x / 2.5, 2.5: 5.0 / x, -2.0: -x, 2.0: abs(x),
        8.0: x**3, 2.0**1.5: x**1.5, 32.0: x**5, 4.0: x**2, 1.5: np.minimum(x, 1.5),
        2.25: np.maximum(x, 2.25), 1.75: np.clip(x, 0.0, 1.75), 2.3: np.clip(x, 2.3, 9),
    }  # fmt: skip
    found = run(tape, formulas.values(), x=2.0)
    np.testing.assert_allclose(found, list(formulas))
    truths = [x < 2.0, x <= 2.0, x > 2.0, x >= 2.0, x < 3, x > 1]
    assert [bool(b) for b in run(tape, truths, x=2.0)] == [0, 1, 0, 1, 1, 1]


def test_what_is_nothing_or_one_is_not_written_down():
    tape = Tape()
    x = tape.input("x")
    same = (x + 0.0, 0.0 + x, x * 1.0, 1.0 * x, x - 0.0, x / 1.0, x**1)
    assert {s.line for s in same} == {x.line} and len(tape.lines) == 1
    assert [x * 0.0, 0.0 * x, 0.0 / x] == [0.0, 0.0, 0.0] and len(tape.lines) == 1
    opposite = (-1.0 * x, x * -1.0, 0.0 - x, -x)
    assert len({s.line for s in opposite}) == 1 and len(tape.lines) == 2
    assert run(tape, [opposite[0]], x=3.0) == [-3.0]
    assert tape.apply("sin", 0.5) == np.sin(0.5)
    powers = [x**4, x**5]
    names = [tape.lines[p.line].name for p in powers]
    assert names == ["multiply", "power"]


def test_only_what_a_result_needs_is_run():
    tape = Tape()
    x, y = tape.input("x"), tape.input("y")
    unused = np.exp(y)
    wanted = np.sin(x) + 2.0
    lines = tape.needed([wanted, 7.0])
    assert unused.line not in lines and y.line not in lines
    assert lines == sorted(lines) and lines[-1] == wanted.line
    assert run(tape, [7.0, wanted], x=0.0) == [7.0, 2.0]
    assert tape.needed([3.0]) == []


def test_equal_numbers_of_other_kinds_are_other_lines():
    tape = Tape()
    x = tape.input("x")
    first = tape.apply("add", x, 2.0)
    assert tape.apply("add", x, 2).line == first.line
    assert tape.apply("add", x, x).line != first.line
    assert tape.input("x").line == x.line and tape.input("y").line != x.line


def test_what_cannot_be_written_down_is_refused():
    x = Tape().input("x")
    with pytest.raises(HybridError, match="add.reduce cannot be exported"):
        np.add.reduce(x)
    with pytest.raises(HybridError, match=r"numpy\.interp cannot be exported"):
        np.interp(x, [0, 1], [0, 1])
    with pytest.raises(HybridError, match="cannot branch"):
        _ = 1 if x else 0
