"""What is not given is nothing: values of records that change no result."""

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.calibration.steps import Step, follow, start
from hybrid.model import DynamicModel
from hybrid.online import OnlineIdentifier
from hybrid.online.health import Health
from hybrid.recording.labels import Meaning, parse_label
from hybrid.recording.reading import Reading, Used
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator
from hybrid.robot.tree import Node, Tree


def test_an_arm_of_links_and_limits_has_no_servo_spring_or_friction():
    robot, x = pendulum(1), np.array([[-0.3], [0.7], [2.0]])
    assert not robot.joint_torque(x, x, 0 * x).any()
    assert not robot.dry_friction(x).any() and not robot.position_slope(x).any()
    assert np.isnan(robot.kp).all() and np.isnan(robot.kd).all()
    assert robot.kp.shape == robot.kd.shape == robot.a_max.shape == (1,)
    assert np.isinf(robot.a_max).all()
    again = Robot.from_dict(robot.as_dict())
    for name, width in (("ripple", 4), ("falling", 3), ("coupled", 5)):
        assert getattr(robot, name).shape == getattr(again, name).shape == (0, width)


def test_a_change_of_nothing_leaves_an_actuator_alone():
    change = {"gain": 1.3, "lag": 0.01, "limit": 5.0, "latency": 0.002}
    change |= {"stiffness": 0.7, "damping": 1.6}
    changed = Actuator().and_then(change)
    assert vars(changed) == change
    assert changed.and_then(vars(Actuator())) == changed


def test_a_frame_that_only_has_a_parent_is_that_parent():
    hinge = Node(-1, joint="a", axis=np.array([0.0, 0.0, 1.0]))
    body = Node(0, body=1, mass=2.0, center=np.ones(3), inertia=np.eye(3))
    tree = Tree("here", [hinge, body, Node(1), Node(2, body=2)])
    places, (frame,) = tree.places(("a",), {})
    for _, place in places:
        assert place.link == 0 and not place.position.any()
        np.testing.assert_array_equal(place.rotation, np.eye(3))
    assert not frame.position.any()
    chain = tree.chain(("a",), {}, np.zeros(3), np.zeros(1))
    assert chain.revolute.tolist() == [True] and chain.inertial[0, 0] == 2.0
    np.testing.assert_allclose(chain.inertial[0, 4:], [5.0, -2.0, 5.0, -2.0, -2.0, 5.0])
    held = Tree("here", [hinge, Node(0, joint="b", axis=np.array([1.0, 0, 0])), body])
    np.testing.assert_array_equal(held.places(("a",), {})[0][1][1].rotation, np.eye(3))


def test_a_step_of_a_chain_without_a_size_leads_nowhere():
    q = np.zeros((2, 1))
    for turns in (True, False):
        found = follow(start(q), [Step(1, turns)], q, {})
        assert not found.origin.any()
        np.testing.assert_array_equal(found.rotation, np.tile(np.eye(3), (2, 1, 1)))


def test_a_stream_without_samples_is_well():
    health = Health(stated_rate=100.0, rate=100.0)
    assert health.summary == "0 of 0 samples used"
    assert health.ok and health.problems == ()
    assert Health().rate_is_right and Health().ok and Health().problems == ()
    assert not Health(stated_rate=1.0).rate_is_right


@pytest.mark.parametrize(
    ("lost", "rate", "problems"),
    [
        (0.01, 100.0, ()), (0.0, 104.9, ()), (0.0, 95.1, ()),
        (0.0101, 100.0, ("1% of the last second's samples are lost",)),
        (0.0, 105.1, ("samples come at 105.1 Hz, not at 100 Hz",)),
        (0.5, 94.9, ("samples come at 94.9 Hz, not at 100 Hz",
                     "50% of the last second's samples are lost")),
    ],
)  # fmt: skip
def test_a_stream_is_not_well_above_one_lost_sample_in_a_hundred_or_off_its_rate(
    lost, rate, problems
):
    health = Health(lost=lost, rate=rate, stated_rate=100.0)
    assert health.problems == problems and health.ok == (not problems)


def test_all_counts_of_a_stream_are_told():
    counts = {
        "not_finite": 2, "implausible": 3, "repeated": 4, "late": 5, "jumped": 6,
        "missing": 7, "restarts": 8,
    }  # fmt: skip
    assert Health(received=1020, used=1000, **counts).summary == (
        "1,000 of 1,020 samples used, 2 not finite, 3 implausible, 4 repeated, 5 late, "
        "6 jumped, 7 missing, 8 restarts"
    )


def test_a_column_is_in_si_units_and_at_no_place_if_nothing_is_said():
    column = Used(0, "q", "q", "a", "rad")
    reading = Reading("csv", "", "", (column,))
    assert (reading.time.factor, reading.time.offset) == (1.0, 0.0)
    assert not reading.time.stated and reading.as_dict()["aside"] == []
    assert parse_label("q1").index == Meaning().index == -1


def test_a_model_of_base_parameters_alone_has_the_torque_of_its_links():
    robot = pendulum(1)
    problem = build_problem(robot.chain, [], inertial=robot.chain.inertial)
    model = DynamicModel(robot, problem.base)
    assert model.standing.shape == (0,) and model.covariance.shape == (0, 0)
    assert (
        model.stage == "rigid" and repr(model) == "<DynamicModel of pendulum, rigid: >"
    )


@pytest.mark.parametrize("stated", [True, False])
def test_a_tracked_model_stands_where_it_stood_or_below_a_hundredth_of_its_speed(
    stated,
):
    robot = pendulum(1)
    problem = build_problem(robot.chain, [])
    own = np.array([0.37]) if stated else np.zeros(0)
    model = DynamicModel(robot, problem.base, standing=own, cutoff=5.0)
    tracker = OnlineIdentifier.from_model(model, rate=250.0)
    expected = 0.37 if stated else 0.01 * robot.v_max[0]
    np.testing.assert_allclose(tracker.model.standing, expected)
