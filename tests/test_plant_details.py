"""Parts of the plant by themselves: references, servos, noise, and what they refuse."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from pendulum import pendulum
from simulated import arm

from hybrid.dynamics import inverse_dynamics
from hybrid.effects import JointState
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.errors import ExcitationError, HybridError
from hybrid.excitation import Limits
from hybrid.plant import Noise, Reference, random_fourier
from hybrid.plant.arm import build_arm
from hybrid.plant.install import install
from hybrid.plant.laws import Laws
from hybrid.plant.lockstep import Lockstep
from hybrid.plant.rollout import Windows
from hybrid.plant.servo import Servo
from hybrid.robot import Robot

RATE, SAMPLES = 500.0, 100_000


def torque_noise(memory: float, covariance) -> np.ndarray:
    zero = np.zeros(2)
    noise = Noise(np.array(covariance), zero, zero, zero, correlation_time=memory)
    still = {x: np.zeros((SAMPLES, 2)) for x in ("q", "v", "tau")}
    rng = np.random.default_rng(0)
    return noise.apply(still, rate=RATE, rng=rng)["tau"]


@pytest.mark.parametrize("memory", [0.0, 0.004])
@pytest.mark.parametrize(
    "covariance",
    [[[4.0, 0.9], [0.9, 0.25]], [[4.0, 1.0], [1.0, 0.25]], [[4.0, 0.0], [0.0, 0.0]]],
)
def test_torque_noise_has_its_covariance_and_forgets_in_its_time(memory, covariance):
    """Also where two joints share all of it, or one has none."""
    tau = torque_noise(memory, covariance)
    np.testing.assert_allclose(np.cov(tau.T), covariance, rtol=0.03, atol=0.02)
    lagged = tau[1:, 0] @ tau[:-1, 0] / (tau[:, 0] @ tau[:, 0])
    expected = np.exp(-1 / (RATE * memory)) if memory else 0.0
    assert lagged == pytest.approx(expected, abs=0.02)
    assert np.std(tau[:20, 0]) > 0.5  # it is there from the first sample on


@pytest.mark.parametrize(
    "covariance",
    [[[1.0, 0.2], [0.1, 1.0]], [[1e-6, 2e-7], [1e-7, 1e-6]], [[1.0, 2.0], [2.0, 1.0]]],
)
def test_a_covariance_that_is_none_is_refused_at_any_size(covariance):
    with pytest.raises(HybridError, match="symmetric and positive semidefinite"):
        torque_noise(0.0, covariance)


def test_rounding_of_a_covariance_is_no_asymmetry():
    tau = torque_noise(0.0, [[1e6, 2e5 + 1e-5], [2e5, 1e6]])
    np.testing.assert_allclose(np.cov(tau.T), [[1e6, 2e5], [2e5, 1e6]], rtol=0.1)


def reference(**changed) -> Reference:
    t = np.arange(0.0, 1.0, 0.01)
    rest = np.zeros((len(t), 2))
    return Reference(**{"t": t, "q": rest, "v": rest, "a": rest, **changed})


def fourier(**changed) -> Reference:
    return random_fourier(arm("planar"), **{"duration": 6.0, "rate": 100.0, **changed})


ONE, WRONG = np.ones(2), np.array([1.0, -1.0])
LIMITS = {x: ONE for x in ("high", "speed", "acceleration", "torque", "jerk")}


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: reference(t=np.zeros((100, 1))), "needs t of shape"),
        (lambda: reference(q=np.zeros(100)), "needs t of shape"),
        (lambda: reference(v=np.zeros((99, 2))), "reference v needs finite samples"),
        (lambda: reference(a=np.full((100, 2), np.nan)), "reference a needs finite"),
        (lambda: reference(t=0.5 + np.arange(100)), "uniform from t = 0"),
        (lambda: reference(t=np.arange(100.0) ** 2), "uniform from t = 0"),
        (lambda: fourier(rate=0.0), "rate is 0 Hz"),
        (lambda: fourier(rate=np.inf), "rate is inf Hz"),
        (lambda: fourier(duration=-1.0), "duration is -1 s"),
        (lambda: fourier(duration=np.nan), "duration is nan s"),
        (lambda: fourier(fill=1.1), "fill is 1.1"),
        (lambda: fourier(order=2), "order is 2"),
        (lambda: Servo(ONE, WRONG, ONE), "servo kd needs one value, 0 or above"),
        (lambda: Servo(ONE, ONE, np.ones(3)), "servo limit needs one value"),
        (lambda: Noise(np.eye(2), WRONG, ONE, ONE), "position_resolution needs 2"),
        (lambda: Noise(np.eye(2), ONE, ONE, np.ones(3)), "speed_std needs 2 values"),
        (lambda: Noise(np.eye(2), ONE, ONE, ONE, -1.0), "correlation_time is 0 s"),
    ],
)
def test_what_no_plant_can_have_is_refused_in_one_line(make, says):
    with pytest.raises(HybridError, match=says) as error:
        make()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"low": np.ones(3)}, "high needs one value for each joint"),
        ({"torque": np.array([1.0, np.nan])}, "torque needs one value"),
        ({"speed": np.array([1.0, 0.0])}, "speed must be above 0"),
        ({"low": ONE}, "low must be below high"),
        ({"speed": np.array([1.0, np.inf])}, "positions and speeds must be finite"),
        ({"low": np.array([-np.inf, 0.0])}, "positions and speeds must be finite"),
    ],
)
def test_limits_that_limit_nothing_are_refused(changed, says):
    with pytest.raises(ExcitationError, match=says):
        Limits(**{"low": -ONE, **LIMITS, **changed})


@pytest.mark.parametrize("declared", ["damping", "frictionloss", "stiffness"])
def test_the_load_in_a_step_is_what_the_links_need(declared):
    """Not what rotor, damping, friction and spring of the joint take before them."""
    robot = replace(pendulum(2), **{declared: np.array([0.8, 0.5])})
    bare = robot.chain
    arm_ = build_arm(robot, [], step=1e-3, integrator="euler")
    state = Lockstep(arm_, [], np.array([[0.6, -0.4], [0.2, 0.9]]))
    for k in range(50):
        q, v = state.q.copy(), state.v.copy()
        state.step(np.array([[9.0, -4.0], [3.0, 6.0 * (k > 20)]]))
        needed = inverse_dynamics(bare, bare.inertial, q, v, state.a)
        np.testing.assert_allclose(state.load, needed, atol=1e-6)
    assert np.abs(state.v).max() > 0.1


def test_friction_below_its_width_is_that_at_its_width_in_a_plant():
    """A fit's line through rest would not stick; a steep fall in it never was seen."""
    values = {"coulomb_positive": 2.0, "coulomb_negative": 3.0, "falling_steep": 29.0}
    shapes = {"threshold": 0.12, "width": 0.09}
    laws = Laws([ThresholdFriction((0,), values | shapes)], 1, 1)
    dry = {}
    for v in (-0.2, -0.09, -1e-3, 1e-3, 0.09, 0.2):
        one, zero = np.array([[v]]), np.zeros((1, 1))
        state = JointState(zero, zero, one, zero, np.sign(one), zero)
        laws.evaluate(state, state)
        dry[v] = float(laws.dry[0, 0])
    assert dry[0.2] == pytest.approx(2.0) and dry[-0.2] == pytest.approx(-3.0)
    assert dry[1e-3] == dry[0.09] == pytest.approx(2.0 + 29.0 * 0.25**2)
    assert dry[-1e-3] == dry[-0.09] == pytest.approx(-3.0 - 29.0 * 0.25**2)


def test_windows_are_cut_out_of_their_motions_and_end_with_their_last_sample():
    windows = Windows(np.array([0, 1, 1]), np.array([3, 0, 4]), 2)
    signals = [np.arange(9.0)[:, None], 100.0 + np.arange(6.0)[:, None]]
    found = windows.of(signals)[:, :, 0]
    np.testing.assert_array_equal(
        found.T, [[3, 4, 5], [100, 101, 102], [104, 105, 105]]
    )
    fine = [np.arange(17.0), 100.0 + np.arange(11.0)]  # twice as many a second
    found = windows.of(fine, 2)
    assert found.shape == (5, 3)
    np.testing.assert_array_equal(found[:, 0], [6, 7, 8, 9, 10])
    np.testing.assert_array_equal(found[:, 2], [108, 109, 110, 110, 110])
    np.testing.assert_array_equal(windows.first(signals)[:, 0], [3, 100, 104])


def test_noise_of_positions_and_speeds_is_normal_and_white():
    noise = Noise(
        np.zeros((2, 2)), np.zeros(2), np.array([0.1, 0.0]), np.array([0.0, 0.5])
    )
    signals = {x: np.ones((20_000, 2)) for x in ("q", "v", "tau")}
    found = noise.apply(signals, rate=100.0, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(found["tau"], 1.0)
    for name, std in (("q", [0.1, 0.0]), ("v", [0.0, 0.5])):
        off = found[name] - 1.0
        np.testing.assert_allclose(off.std(axis=0), std, rtol=0.02)
        tails = np.mean(np.abs(off) > 2 * np.array(std) + 1e-12, axis=0)
        np.testing.assert_allclose(tails, 0.0455 * (np.array(std) > 0), atol=0.004)
        together = np.mean(off[1:] * off[:-1], axis=0)
        np.testing.assert_allclose(together, 0.0, atol=0.02 * max(std) ** 2)


RISING = """<mujoco><option timestep="0.002"/><worldbody>
<body name="x"><joint name="a" axis="0 1 0" frictionloss="1" damping="0.2"
 solreffriction="0 -40" stiffness="2" springref="10"/><geom size="0.1" mass="1"/>
<body name="y"><joint name="b" axis="0 1 0" frictionloss="0.5"/>
<geom size="0.1" mass="1"/></body></body></worldbody>
<tendon><fixed name="c" frictionloss="0.3"><joint joint="a" coef="1"/></fixed>
</tendon></mujoco>"""


def test_friction_that_rises_is_dry_while_a_model_is_installed():
    model = mujoco.MjModel.from_xml_string(RISING)
    before = copy.deepcopy(model)
    known = SimpleNamespace(robot=Robot.load(before), effects=(), remainder=None)
    made = install(model, mujoco.MjData(model), known)
    np.testing.assert_allclose(model.dof_solref, [[0.004, 1.0], before.dof_solref[1]])
    np.testing.assert_allclose(model.dof_solimp[0, :2], 0.9999)
    np.testing.assert_array_equal(model.dof_solimp[0, 2:], before.dof_solimp[0, 2:])
    np.testing.assert_array_equal(model.dof_solimp[1], before.dof_solimp[1])
    # What the model does not have is no more in the file.
    for name in ("dof_frictionloss", "dof_damping", "jnt_stiffness"):
        assert not getattr(model, name).any()
    assert not model.tendon_frictionloss.any() and before.tendon_frictionloss.any()
    made.remove()
    for name in (
        "dof_solref", "dof_solimp", "dof_frictionloss", "dof_damping",
        "jnt_stiffness", "qpos_spring", "tendon_frictionloss",
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(model, name), getattr(before, name))
