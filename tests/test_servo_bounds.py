"""Numbers of servos: what a file leaves open, how it is believed, what is fitted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.errors import RecordingError
from hybrid.plant.noise import rated_torque
from hybrid.recording import Recording
from hybrid.servo import fit
from hybrid.servo.drive import NAMES, QUANTITIES, Drive
from hybrid.servo.model import file_step, heights, lay_ground, servo_spec
from hybrid.servo.problem import Problem
from hybrid.servo.stretch import Stretch, stretches_of

BARE = replace(
    pendulum(2), tau_max=np.full(2, np.inf), q_min=np.full(2, -np.inf),
    q_max=np.full(2, np.inf),
)  # fmt: skip
STATED = replace(
    pendulum(2), kp=np.array([25.0, 20.0]), kd=np.array([0.6, 0.4]),
    damping=np.array([0.4, 0.3]), frictionloss=np.array([0.3, 0.2]),
    tau_max=np.array([60.0, 30.0]),
)  # fmt: skip
FILE = Drive.declared(STATED)
STEP = 0.02


# --- what a file leaves open ----------------------------------------------------------


def test_a_servo_without_numbers_has_the_usual_rated_torque():
    bare = replace(BARE, chain=replace(BARE.chain, armature=np.zeros(2)))
    found, stall = Drive.declared(bare), rated_torque(bare)
    assert (stall > 9.81 * 2.0 * 0.5 * 0.6).all()  # carries the outer rod
    np.testing.assert_allclose(found["stall"], 1e4 * stall)  # no limit that acts
    assert found.unlimited.all() and not FILE.unlimited.any()
    np.testing.assert_allclose(found.stall, stall)
    np.testing.assert_allclose(found["stiffness"], stall / 0.1)
    for name in ("damping", "coulomb", "armature"):  # nothing has no logarithm
        np.testing.assert_allclose(found[name], 1e-4 * stall)
    np.testing.assert_allclose(found["stribeck_speed"], 0.05)
    np.testing.assert_allclose(found["presliding"], 1e-3)
    np.testing.assert_array_equal(found["lower"], [-100.0, -100.0])
    np.testing.assert_array_equal(found["upper"], [100.0, 100.0])
    for name in ("mass", "sign"):
        np.testing.assert_array_equal(found[name], 1.0)
    for name in ("offset", "zero", "delay", "play", "spring", "stiction", "pace"):
        assert not found[name].any()
    light = BARE.with_inertial(1e-6 * BARE.chain.inertial)
    np.testing.assert_array_equal(Drive.declared(light).stall, [1.0, 1.0])


def test_a_link_reaches_as_far_as_its_joints_and_slides_together():
    """Its centre of mass is 0.3 m behind its joint, which is 0.6 m behind the last."""
    np.testing.assert_allclose(Drive.declared(BARE)["ground"], [-0.3, -0.9])
    chain = replace(BARE.chain, revolute=np.array([False, True]))
    for low, high in ((-0.5, 0.2), (-0.2, 0.5)):
        ends = {"q_min": np.array([low, -2.0]), "q_max": np.array([high, 2.0])}
        slide = replace(BARE, chain=chain, **ends)
        np.testing.assert_allclose(Drive.declared(slide)["ground"], [-0.8, -1.4])
    endless = replace(BARE, chain=chain)
    np.testing.assert_allclose(Drive.declared(endless)["ground"], [-0.3, -0.9])


def test_a_step_that_no_file_states_is_two_milliseconds():
    assert file_step(replace(BARE, timestep=np.nan)) == 0.002
    assert file_step(replace(BARE, timestep=0.004)) == 0.004


@pytest.mark.parametrize("down", [[0.0, 0.0, -9.81], [0.0, 9.81, 0.0]])
def test_the_ground_is_a_millimetre_below_the_reach_of_the_arm(down):
    robot = replace(BARE, chain=replace(BARE.chain, gravity=np.array(down)))
    spec = servo_spec(robot, Drive.declared(robot))
    lay_ground(spec, robot)
    model = spec.compile()
    up = -np.array(down) / 9.81
    np.testing.assert_allclose(model.geom_pos[0], -0.901 * up, atol=1e-9)
    turn = np.zeros(9)
    import mujoco

    mujoco.mju_quat2Mat(turn, model.geom_quat[0])
    np.testing.assert_allclose(turn.reshape(3, 3)[:, 2], up, atol=1e-9)
    assert model.ngeom == 3 and not model.geom_conaffinity[1:].any()
    np.testing.assert_allclose(model.geom_size[1:, 0], 1e-3)
    np.testing.assert_allclose(model.geom_pos[1:], [[0, 0, -0.3]] * 2, atol=1e-9)
    q = np.array([[0.0, 0.0], [np.pi, 0.0]])
    if down[2]:
        np.testing.assert_allclose(heights(robot, q), [[-0.3, -0.9], [0.3, 0.9]])
    none = replace(robot, chain=replace(robot.chain, gravity=np.zeros(3)))
    spec = servo_spec(none, Drive.declared(none))
    lay_ground(spec, none)
    assert spec.compile().ngeom == 0


# --- how far it is believed -----------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "usual"),
    [
        ("stiffness", 25.0 * np.e**2), ("damping", 1.0 * np.e**2),
        ("coulomb", 0.3 * np.e**2), ("stiction", 3.0), ("stribeck_speed", 0.05 * np.e),
        ("presliding", 1e-3 * np.e**2), ("armature", 0.05 * np.e**2),
        ("stall", 60.0 * np.e), ("offset", -3.0), ("zero", 0.05), ("delay", 0.03),
        ("spring", 18.0), ("dead_band", 0.02), ("play", 0.02), ("load_friction", 0.1),
        ("quadratic", 6.0), ("pace", 1.0), ("lower", -1.5), ("upper", 2.5),
        ("mass", np.exp(0.3)), ("roll", 0.05), ("pitch", -0.05), ("ground", -0.1),
    ],
)  # fmt: skip
def test_a_number_that_is_off_by_its_usual_error_costs_half_a_nat(name, usual):
    """Torques are counted in stall torques of the joint, here 60 N·m."""
    made = Problem(None, [], FILE, np.zeros(2, dtype=bool), np.zeros((2, 2)))
    free = np.isin(NAMES, name)[:, None] & np.array([True, False])
    values = FILE[name].copy()
    values[0] = usual
    cost = made.off(FILE.at(**{name: values}).coordinates, free)
    np.testing.assert_allclose(cost, [0.5, 0.0], rtol=1e-9)


def test_numbers_stay_where_they_have_a_meaning():
    far = FILE.moved(FILE.coordinates - 1e4)
    for name in (
        "stiction", "delay", "spring", "dead_band", "play", "load_friction",
        "quadratic", "pace",
    ):  # fmt: skip
        np.testing.assert_array_equal(far[name], 0.0)
    np.testing.assert_array_equal(far["sign"], -1.0)
    np.testing.assert_array_equal(far["presliding"], 3e-4)
    for name in ("offset", "zero", "lower", "upper", "roll", "ground"):
        np.testing.assert_allclose(far[name], FILE[name] - 1e4)
    for way in (-1.0, 1.0):
        ends = FILE.moved(FILE.coordinates + way * 1e4)
        for name in ("stiffness", "damping", "coulomb", "stall", "mass"):
            np.testing.assert_allclose(ends[name], np.exp(way * 20.0))


class Curved:
    """Replays that are off by the square of each number's change, in units of steps."""

    def replay(self, stretches, drives):
        unit = np.where([[q.positive] for q in QUANTITIES], 1.0, FILE.spread)
        off = [((d.coordinates - FILE.coordinates) / unit) ** 2 for d in drives]
        return [[x.q + y.sum(axis=0) for x in stretches] for y in off]


@pytest.mark.parametrize(
    ("name", "part"),
    [("stiffness", 0.05), ("zero", 0.05), ("mass", 0.05), ("play", 0.25)],
)
def test_a_derivative_is_taken_over_a_small_part_of_a_step(name, part):
    """The slope of a square from zero on is the part itself."""
    q = np.zeros((5, 2))
    log = Stretch(STEP, q, q, np.zeros(2))
    made = Problem(Curved(), [log], FILE, np.zeros(2, dtype=bool), np.zeros((2, 2)))
    free = np.isin(NAMES, name)[:, None] & np.array([True, False])
    (slope,) = made.slopes(made.at(FILE.coordinates, free))
    unit = 1.0 if name in ("stiffness", "mass") else FILE.spread[NAMES.index(name), 0]
    np.testing.assert_allclose(slope[:, 0], part / unit, rtol=1e-6)


# --- what is fitted -------------------------------------------------------------------


@pytest.mark.parametrize(("samples", "kept"), [(100, False), (102, True)])
def test_a_log_lasts_for_two_seconds(samples, kept):
    t = STEP * np.arange(samples)
    q = np.zeros((samples, 1))
    log = Recording(t, q, command=q, joints=("a",))
    if not kept:
        with pytest.raises(RecordingError, match="lasts 2 s"):
            stretches_of([log])
    else:
        assert len(stretches_of([log])) == 1


@pytest.mark.parametrize(
    ("steps", "rests"),
    [
        ((0.0, 1.0, 2.5), True), ((0.0, 1.0, 2.0, 3.5), False),
        ((0.0, 0.01, 0.06, 0.09), True), ((0.0, 0.01, 0.06, 0.11), False),
    ],
)  # fmt: skip
def test_a_joint_rests_within_three_steps_of_its_encoder_or_a_milliradian(
    monkeypatch, steps, rests
):
    """Of ten milliradians here; those of the other joint are fine."""
    monkeypatch.setattr(fit, "best_start", lambda simulator, logs, guess, prior: guess)
    monkeypatch.setattr(fit, "converged", lambda simulator, *_: simulator)
    t = STEP * np.arange(200)
    q = np.stack([np.sin(t), 0.01 * np.array(steps)[np.arange(200) % len(steps)]], 1)
    log = Stretch(STEP, q + 0.1, q, np.zeros(2))
    made, _ = fit._problem(SimpleNamespace(robot=STATED), [log], FILE)
    assert made.resting.tolist() == [False, rests]
