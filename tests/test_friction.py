"""Stage two: the friction curve and the ripple that the rigid body leaves."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from coarse import load_truth, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import (
    arm,
    coloured,
    linear_problem,
    motions,
    quiet,
    stacked,
    with_torque,
)

from hybrid.effects import JointState, effect_class
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.identification import identify

FASTEST = 2.2  # rad/s, of the motions below
TRUTH = {
    "coulomb_positive": 1.5,
    "coulomb_negative": 1.1,
    "falling": 1.2,
    "viscous": 0.8,
    "quadratic": 0.3,
    "cubic": 0.05,
}


def curve(effects, joint, speed, *, load=0.0):
    """Torque of a joint's friction over speed, shape of ``speed``, [N·m]."""
    zero = np.zeros_like(speed)
    state = JointState(zero, zero, speed, zero, np.sign(speed), zero + load)
    total = np.zeros_like(speed)
    for effect in effects:
        if effect.joints == (joint,) and getattr(effect, "dry", False):
            laws = effect.law(state, **effect.shape_values)
            total += sum(
                gain * law for gain, law in zip(effect.gain_values, laws, strict=True)
            )
        elif effect.joints == (joint,) and effect.id == "viscous":
            total += effect.values["coefficient"] * speed
        elif effect.joints == (joint,) and effect.id == "torque_offset":
            total += effect.values["level"]
    return total


def logs(extra, *, seed=0, noise=0.05, memory=0.9, count=4, duration=10.0):
    """Motions of the planar arm with any torque on top of links and offsets."""
    robot = arm("planar")
    problem = linear_problem(robot)
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.5, 1.5, problem.size)
    for unknown, effect, _ in problem.gains:
        if problem.effects[effect].id != "torque_offset":
            theta[unknown] = 0.0
        else:
            theta[unknown] *= 0.2
    found = []
    for motion in motions(robot, count=count, duration=duration, rate=250, seed=seed):
        tau = stacked(problem, motion) @ theta + extra(motion)
        error = coloured(rng, len(tau), noise**2 * np.eye(2), memory)
        found.append(with_torque(motion, tau + error))
    return found


def friction(**laws):
    """Torque of effects at the shoulder, and linear friction at the elbow."""

    def torque(motion):
        tau = 0.5 * np.sign(motion.v) + 0.3 * motion.v
        effects = [effect_class(name)((0,), values) for name, values in laws.items()]
        tau[:, 0] = curve(effects, 0, motion.v[:, 0])
        return tau

    return torque


def fitted(extra, **options):
    stages = options.pop("stages", ("rigid", "friction"))
    fit, said = quiet(
        identify, arm("planar"), logs(extra, **options), stages=stages, cutoff=15.0
    )
    return fit, said


@pytest.fixture(scope="module")
def knee():
    """A threshold law at the shoulder: λ on no point of the search's grid."""
    return fitted(friction(threshold_friction=TRUTH | {"threshold": 0.31}))[0]


def found_at(fit, joint):
    (effect,) = [
        e
        for e in fit.model.effects
        if isinstance(e, ThresholdFriction) and e.joints == (joint,)
    ]
    return effect


# --- the friction curve ---------------------------------------------------------------


def test_the_threshold_is_found_within_the_search_grid(knee):
    assert found_at(knee, 0).values["threshold"] == pytest.approx(0.31, rel=0.36)


def test_the_curve_of_friction_is_recovered_at_every_speed(knee):
    speed = np.linspace(0.08, FASTEST, 100)
    speed = np.concatenate([-speed, speed])
    truth = [ThresholdFriction((0,), TRUTH | {"threshold": 0.31, "width": 0.0})]
    # An offset and a difference of the two levels are one thing: compare their sum.
    expected = curve(truth, 0, speed)
    found = curve(knee.model.effects, 0, speed)
    shift = np.mean(found - expected)
    np.testing.assert_allclose(found - shift, expected, rtol=0, atol=0.12)
    assert np.sqrt(np.mean((found - shift - expected) ** 2)) < 0.04


def test_a_law_that_is_exchanged_is_gone(knee):
    """A level and a slope beside a knee would share what is one friction."""
    at_shoulder = [e.id for e in knee.model.effects if e.joints == (0,)]
    assert "threshold_friction" in at_shoulder
    assert not {"coulomb", "viscous", "torque_offset"} & set(at_shoulder)
    kinds = [
        (e.id, e.joints, tuple(e.shape_values.items())) for e in knee.model.effects
    ]
    assert len(set(kinds)) == len(kinds)


def test_stribeck_friction_is_followed_by_a_law_of_another_shape():
    """The plant's curve is an exponential, which the fit's knee can only approach."""
    level = {"level": 1.5}
    stribeck = {"level": 1.2, "velocity": 0.15, "exponent": 2.0}
    laws = {"coulomb": level, "stribeck": stribeck, "viscous": {"coefficient": 0.8}}
    fit, _ = fitted(friction(**laws))
    effects = [effect_class(name)((0,), values) for name, values in laws.items()]
    speed = np.linspace(0.05, FASTEST, 200)
    found = curve(fit.model.effects, 0, speed) - curve(fit.model.effects, 0, -speed)
    np.testing.assert_allclose(found / 2, curve(effects, 0, speed), atol=0.15)
    linear = fit.model.simpler["IRLS"].effects
    plain = curve(linear, 0, speed) - curve(linear, 0, -speed)
    error = [np.abs(x / 2 - curve(effects, 0, speed)).max() for x in (plain, found)]
    assert error[1] < 0.3 * error[0]


def test_the_fitted_curve_is_continuous_at_its_threshold(knee):
    effect = found_at(knee, 0)
    edge = effect.values["threshold"]
    either = np.array([edge * (1 - 1e-9), edge * (1 + 1e-9)])
    for sign in (-1, 1):
        low, high = curve([effect], 0, sign * either)
        assert low == pytest.approx(high, rel=1e-6)


@settings(max_examples=4)
@given(st.integers(0, 1000), st.floats(-3.0, 3.0), st.floats(-1.0, 1.0))
def test_friction_never_drives_whatever_the_torque_was(seed, level, slope):
    """Even where the torque asks for it: coefficients stay at or above zero."""

    def driving(motion):
        return level * np.sign(motion.v) + slope * motion.v

    fit, _ = fitted(driving, seed=seed, count=2, duration=6.0)
    speed = np.linspace(-FASTEST, FASTEST, 101)
    for effect in fit.model.effects:
        if isinstance(effect, ThresholdFriction):
            assert effect.gain_values.min() >= 0.0
            torque = curve([effect], effect.joints[0], speed)
            assert (torque * speed >= 0).all()


def test_a_joint_with_linear_friction_keeps_its_linear_law(knee):
    """The elbow has a level and a slope: no knee earns its place there."""
    at_elbow = {e.id for e in knee.model.effects if e.joints == (1,)}
    assert {"coulomb", "viscous"} <= at_elbow
    assert "threshold_friction" not in at_elbow


def test_friction_that_lowers_nothing_is_left_out_with_a_warning():
    plain = friction(coulomb={"level": 1.0}, viscous={"coefficient": 0.5})
    fit, said = fitted(plain)
    assert any("friction" in text for text in fit.left_out)
    assert any("left out friction" in text for text in said)
    np.testing.assert_array_equal(fit.held_out["+ friction"], fit.held_out["rigid"])


def test_friction_that_grows_with_the_load_is_told_from_the_rest():
    _, plant = load_truth(MODELS / "coman_truth.yaml")
    assert "load_friction" in {e.id for e in plant.effects}
    robot = arm("planar")
    effect = effect_class("load_friction")
    found = []
    for coefficient in (0.0, 0.12):
        recordings = simulate(
            robot,
            [effect((0,), {"coefficient": coefficient})] if coefficient else [],
            trajectories=4,
            duration=8,
            seed=2,
        )
        fit, _ = quiet(identify, robot, recordings, stages=("rigid", "friction"))
        values = [
            e.values["coefficient"]
            for e in fit.model.effects
            if isinstance(e, effect) and e.joints == (0,)
        ]
        found.append(values)
    assert found[0] == []
    assert found[1] == pytest.approx([0.12], rel=0.15)


# --- ripple ---------------------------------------------------------------------------

RIPPLE = ("rigid", "ripple")


def ripple(joint, periods, sine, cosine):
    def torque(motion):
        tau = 0.5 * np.sign(motion.v) + 0.3 * motion.v
        angle = periods * motion.q[:, joint]
        tau[:, joint] += sine * np.sin(angle) + cosine * np.cos(angle)
        return tau

    return torque


def ripples(fit):
    return [e for e in fit.model.effects if e.id == "torque_ripple"]


@pytest.mark.parametrize(
    ("joint", "periods"), [(0, 2), (0, 7), (1, 3), (1, 23), (1, 60)]
)
def test_a_ripple_is_found_with_its_order_and_size(joint, periods):
    fit, _ = fitted(ripple(joint, periods, 0.3, -0.2), stages=RIPPLE)
    (found,) = ripples(fit)
    assert found.joints == (joint,) and found.values["periods"] == periods
    for name, truth in (("sine", 0.3), ("cosine", -0.2)):
        assert abs(found.values[name] - truth) < 4 * found.std[name]
        assert found.std[name] < 0.05
    assert fit.held_out["+ ripple"][joint] < fit.held_out["IRLS"][joint]


def test_two_ripples_of_one_joint_are_told_apart():
    def both(motion):
        return ripple(0, 5, 0.3, 0.1)(motion) + ripple(0, 31, 0.0, 0.2)(motion)

    fit, _ = fitted(both, stages=RIPPLE)
    assert sorted(e.values["periods"] for e in ripples(fit)) == [5.0, 31.0]
    assert {e.joints for e in ripples(fit)} == {(0,)}


@pytest.mark.parametrize("memory", [0.0, 0.97])
def test_no_ripple_is_found_where_there_is_none(memory):
    """Four hundred orders are tried: noise alone must not pass for one of them."""
    found = []
    for seed in range(3):
        fit, _ = fitted(
            ripple(0, 1, 0.0, 0.0), stages=RIPPLE, seed=seed, noise=0.3, memory=memory
        )
        found += ripples(fit)
    assert found == []


def test_a_joint_that_stands_is_given_no_ripple():
    robot, rng = arm("planar"), np.random.default_rng(0)
    problem, found = linear_problem(robot), []
    for motion in motions(robot, count=2, duration=6.0, rate=250, seed=0):
        q, v, a = (x * [1.0, 0.0] for x in (motion.q, motion.v, motion.a))
        still = replace(motion, q=q, v=v, a=a)
        tau = stacked(problem, still) @ np.ones(problem.size)
        tau += coloured(rng, len(tau), 0.01 * np.eye(2), 0.0)
        found.append(with_torque(still, tau))
    fit, _ = quiet(identify, robot, found, stages=("rigid", "ripple"), cutoff=15.0)
    assert {e.joints for e in fit.model.effects if e.id == "torque_ripple"} <= {(0,)}
