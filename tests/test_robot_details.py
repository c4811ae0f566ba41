"""A robot's own torque: rotor, friction and spring at each joint."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum
from scipy.spatial.transform import Rotation

from hybrid.robot import Robot
from hybrid.robot.build import simulable

ZERO = np.zeros((9, 2))
X = np.random.default_rng(0).uniform(-2.0, 2.0, (9, 2))


@pytest.mark.parametrize(
    ("declared", "at", "expected"),
    [
        ({"damping": [0.5, 2.0]}, (ZERO, X, ZERO), X * [0.5, 2.0]),
        ({"quadratic": [0.3, 0.0]}, (ZERO, X, ZERO), X * np.abs(X) * [0.3, 0.0]),
        ({"cubic": [0.0, 0.2]}, (ZERO, X, ZERO), X**3 * [0.0, 0.2]),
        ({"stiffness": [3.0, 0.0]}, (X, ZERO, ZERO), X * [3.0, 0.0]),
        (
            {"stiffness": [3.0, 2.0], "springref": [0.4, -0.1]},
            (X, ZERO, ZERO), (X - [0.4, -0.1]) * [3.0, 2.0],
        ),
        (
            {"knee": [0.7, 0.0], "knee_speed": [0.5, 0.0]},
            (ZERO, X, ZERO), 0.7 * np.clip(X / 0.5, -1, 1) * [1.0, 0.0],
        ),
        ({}, (ZERO, ZERO, X), 0.05 * X),
        ({}, (X, X, ZERO), ZERO),
    ],
)  # fmt: skip
def test_a_joint_takes_what_its_file_declares(declared, at, expected):
    robot = replace(pendulum(2), **{name: np.array(x) for name, x in declared.items()})
    np.testing.assert_allclose(robot.joint_torque(*at), expected, atol=1e-12)


def test_a_ripple_of_a_file_turns_with_its_joint():
    robot = replace(pendulum(2), ripple=np.array([[1.0, 0.3, -0.2, 5.0]]))
    expected = 0.3 * np.sin(5 * X[:, 1]) - 0.2 * np.cos(5 * X[:, 1])
    found = robot.joint_torque(X, ZERO, ZERO)
    np.testing.assert_allclose(found[:, 1], expected, atol=1e-12)
    assert not found[:, 0].any()


@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_rounding_of_a_flat_link_is_mended_by_little_and_a_wrong_one_stays(size):
    """Of a plate the largest moment is the sum of the others, to the last digit."""
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    for excess in (-1e-2, 1e-9, 1e-2):
        moments = size * np.array([1.0, 2.0, 3.0 + excess])
        inertia = turn @ np.diag(moments) @ turn.T
        mass, center, found = simulable(2.0, np.ones(3), inertia)
        after = np.linalg.eigvalsh(found)
        assert mass == 2.0 and center.tolist() == [1.0, 1.0, 1.0]
        if excess == 1e-9:
            assert after[2] <= after[0] + after[1]
            lifted = moments + 2 * size * excess  # twice what is too much
            np.testing.assert_allclose(after, lifted, rtol=1e-14)
        else:
            np.testing.assert_array_equal(found, inertia)


@pytest.mark.parametrize(
    ("mass", "place"),
    [(1486.0, "25.1 33 8.5"), (105.2, "3.5 34.8 25.3"), (1329.7, "-37.7 -30.1 13.6")],
)
def test_a_point_mass_far_from_its_joint_is_physical(mass, place, tmp_path):
    """Its inertia about the joint has rounding errors, which are not its own."""
    (tmp_path / "crane.urdf").write_text(
        '<robot name="crane"><link name="base"/><link name="load"><inertial>'
        f'<origin xyz="{place}" rpy="0.3 0.2 0.1"/><mass value="{mass}"/>'
        '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>'
        '<joint name="turn" type="continuous"><parent link="base"/>'
        '<child link="load"/></joint></robot>'
    )
    chain = Robot.load(tmp_path / "crane.urdf").chain
    at = np.array(place.split(), dtype=float)
    assert chain.inertial[0, 4] == pytest.approx(mass * (at[1] ** 2 + at[2] ** 2))
