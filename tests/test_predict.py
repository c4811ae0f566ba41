"""Torque worked out fast: the same numbers as the plain formulas give."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import public_arm, random_arm
from hypothesis import given
from hypothesis import strategies as st
from test_export import full_model, mixture, model_of, motion_of

from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.dynamics import Law, Tape, inverse_dynamics, regressor
from hybrid.dynamics.law import sine_cosine
from hybrid.effects import effect_class, effect_classes
from hybrid.plant.scale import joint_scales


def first(motion, count):
    names = ("t", "q", "v", "a", "tau", "mask")
    return replace(motion, **{x: getattr(motion, x)[:count] for x in names})


def one_by_one(model, motion):
    """Rigid body, effect after effect, joint after joint."""
    body = model.body(motion)
    tau = regressor(body.chain, motion.q, motion.v, motion.a) @ body.inertial.ravel()
    for effect in model.effects:
        tau[:, effect.reaches(tau.shape[1])] += effect.torque(motion, body)
    for part in model.remainder.parts if model.remainder else ():
        x = part.inputs(motion.q, motion.v)
        tau[:, part.joint] += part.regression.predict(x)[:, 0]
    return tau


@pytest.mark.parametrize("samples", [1, 5, 300])
def test_a_model_predicts_the_sum_of_its_terms(samples):
    model, motion = full_model(), motion_of(full_model().robot, samples)
    expected = one_by_one(model, motion)
    scale = 1e-12 * np.abs(expected).max()
    np.testing.assert_allclose(model.predict(motion), expected, rtol=0, atol=scale)


@pytest.mark.parametrize("name", sorted(effect_classes()))
def test_every_effect_adds_its_torque(name):
    robot, cls = full_model().robot, effect_class(name)
    joints = {"joint": (1,), "coupling": (3, 4), "arm": tuple(range(6))}[cls.scope]
    effect = cls.typical(joints, joint_scales(robot))
    motion = motion_of(robot, 60)
    motion = replace(motion, tau=40.0 * np.sin(motion.q), temperature=30 + motion.q)
    model = model_of(robot, [effect, effect_class("viscous")((0,), {"coefficient": 1})])
    if effect.observes or effect.reports:
        seen = effect.observe(motion, model.body(motion))
        expected = one_by_one(model, seen)
        mine = list(effect.joints)
        expected[:, mine] = effect.report(motion.t, expected[:, mine])
    else:
        expected = one_by_one(model, motion)
    np.testing.assert_allclose(model.predict(motion), expected, rtol=0, atol=1e-11)


def test_a_law_that_only_arrays_know_counts_as_it_is():
    class Smooth(effect_class("viscous")):
        id = "smooth"

        @staticmethod
        def law(state, **shapes):
            return (np.arctan(10.0 * state.v),)

    robot = full_model().robot
    model = model_of(robot, [Smooth((2,), {"coefficient": 3.0})])
    for samples in (1, 40):
        motion = motion_of(robot, samples)
        np.testing.assert_allclose(
            model.predict(motion), one_by_one(model, motion), atol=1e-11
        )


@pytest.mark.parametrize("robot", [*map(random_arm, range(8)), public_arm("panda")])
def test_inverse_dynamics_is_regressor_times_parameters(robot):
    motion, chain = motion_of(robot, 100), robot.chain
    rng = np.random.default_rng(0)
    chain = replace(chain, gravity=rng.normal(size=3))
    inertial = rng.normal(size=chain.inertial.shape)  # no body: linear all the same
    expected = regressor(chain, motion.q, motion.v, motion.a) @ inertial.ravel()
    for samples in (100, 2):
        q, v, a = (x[:samples] for x in (motion.q, motion.v, motion.a))
        found = inverse_dynamics(chain, inertial, q, v, a)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(
            found, expected[:samples], rtol=0, atol=1e-12 * scale
        )


def test_no_samples_have_no_torque():
    model = full_model()
    assert model.predict(first(motion_of(model.robot, 1), 0)).shape == (0, 6)


@cache
def mixtures_of(seed):
    """Parts of different widths, on an arm of three joints."""
    rng = np.random.default_rng(seed)
    parts = []
    for joint, (d, k) in enumerate([(2, 7), (3, 1), (4, 12)]):
        positions = tuple(int(j) for j in rng.choice(3, d - 1, replace=False))
        part = mixture(seed + joint, d, k)
        parts.append(JointRemainder(joint, positions, (joint,), part))
    return ArmRemainder(3, tuple(parts))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("samples", [1, 200])
def test_joints_together_learn_what_each_learns_alone(seed, samples):
    remainder, rng = mixtures_of(10 * seed), np.random.default_rng(seed)
    size = 10 ** rng.uniform(-1, 1.5, (2, samples, 1))  # in, around and far outside
    q, v = rng.normal(size=(2, samples, 3)) * size
    found = remainder.predict(q, v)
    for part in remainder.parts:
        alone = part.regression.predict(part.inputs(q, v))[:, 0]
        np.testing.assert_allclose(found[:, part.joint], alone, rtol=0, atol=1e-12)


@given(st.floats(1e3, 1e308), st.integers(0, 5))
def test_joints_together_fall_silent_far_away(distance, channel):
    state = np.zeros((1, 6))
    state[0, channel] = distance
    remainder = mixtures_of(0)
    found = remainder.predict(state[:, :3], state[:, 3:])
    for part in remainder.parts:
        if channel in (*part.positions, 3 + part.joint):
            assert found[0, part.joint] == 0.0


def test_a_mixture_that_hardly_fades_is_right_far_away():
    remainder = mixtures_of(0)
    parts = [
        replace(p, regression=replace(p.regression, fade=np.array([2e4, 4e4])))
        for p in remainder.parts
    ]
    wide = ArmRemainder(3, tuple(parts))
    q, v = np.full((1, 3), 40.0), np.zeros((1, 3))
    expected = [p.regression.predict(p.inputs(q, v))[0, 0] for p in parts]
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(wide.predict(q, v)[0], expected, rtol=1e-12)


@pytest.mark.parametrize("size", [1.0, 100.0, 1e5])
def test_sine_and_cosine_are_right_to_the_last_bits(size):
    x = np.random.default_rng(0).uniform(-size, size, 100_000)
    x = np.concatenate([x, np.pi * np.arange(-8, 9) / 2])
    for found, expected in zip(sine_cosine(x), (np.sin(x), np.cos(x)), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=5e-16)


def test_a_law_gives_the_same_for_numbers_and_arrays():
    def formulas(x, y):
        return (
            np.where(x > 0.1, np.sin(x) * np.cos(x), -y) + np.sign(y) * abs(x),
            np.clip(x / y, -2.0, 3.0), np.tanh(x) - np.exp(-(y**2)),
            np.sqrt(abs(y)) ** 1.5, np.minimum(x, y) * np.log(abs(x)), np.cos(y), x,
            7.5,
        )  # fmt: skip

    tape = Tape()
    results = formulas(tape.input("x"), tape.input("y"))
    law = Law(tape, results, ("x", "y"))
    states = np.random.default_rng(0).normal(size=(300, 2))
    many = law.along((states,))
    assert (many[:, -1] == 7.5).all() and (many[:, -2] == states[:, 0]).all()
    for row, state in zip(many, states, strict=True):
        np.testing.assert_allclose(law.at(state.tolist()), row, rtol=1e-14, atol=1e-15)
    for column, value in zip(many.T, formulas(*states.T), strict=True):
        np.testing.assert_allclose(column, value, rtol=1e-14, atol=1e-15)


def test_a_law_gives_infinity_where_python_would_raise():
    tape = Tape()
    law = Law(tape, (np.exp(tape.input("x")), 1.0 / tape.input("x")), ("x",))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy says that something overflows
        assert law.at([1000.0])[0] == np.inf
        assert law.at([0.0])[1] == np.inf


def test_temperature_is_not_forgotten():
    robot = full_model().robot
    model = model_of(robot, [effect_class("thermal_friction")((1,), {"cold": 5.0})])
    motion = motion_of(robot, 1)
    warm = replace(motion, temperature=np.full((1, 6), 80.0))
    cold = model.predict(motion)[0, 1] - model.body(motion).load[0, 1]
    hot = model.predict(warm)[0, 1] - model.body(warm).load[0, 1]
    assert abs(hot) < 0.2 * abs(cold)
