"""Poses, first guesses and weights of the kinematic calibration, in detail."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS, random_arm
from scipy.spatial.transform import Rotation
from scipy.stats import beta
from scipy.stats import f as fisher
from scipy.stats import t as student
from test_calibrate import coman, disturbed, flange, measured

from hybrid.calibration import calibrate
from hybrid.calibration.alignment import _linear, _nearest_rotation, _stations, align
from hybrid.calibration.calibrate import (
    _group,
    build_setup,
    observability_index,
)
from hybrid.calibration.covariance import clustered_covariance
from hybrid.calibration.geometry import chain_from_values, geometry_from_chain
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.model import KinematicModel
from hybrid.calibration.outliers import OUTSIDE, misfit
from hybrid.calibration.poses import (
    _gain,
    choose_poses,
    random_poses,
)
from hybrid.calibration.steps import Frame, Step, follow, free_frame, start
from hybrid.dynamics import inverse_dynamics
from hybrid.errors import CalibrationError
from hybrid.robot import Robot


def turned(angle, axis=2):
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()


# --- poses ----------------------------------------------------------------------------


def test_as_many_poses_are_needed_as_tell_the_parameters_and_one_more():
    q = random_poses(coman(), 30, np.random.default_rng(0))
    # A position tells three numbers of 27 parameters.
    assert len(choose_poses(coman(), q, 10)) == 10
    with pytest.raises(CalibrationError, match="9 poses; valid are 10, .* 27 .* to 30"):
        choose_poses(coman(), q, 9)
    with pytest.raises(CalibrationError, match="31 poses"):
        choose_poses(coman(), q, 31)
    with pytest.raises(CalibrationError, match="valid are position and pose"):
        choose_poses(coman(), q, 10, kind="distance")
    assert list(choose_poses(coman(), q, 30)) == list(range(30))


def test_random_poses_are_spread_over_the_limits_and_over_a_turn_without_any():
    robot = coman()
    free = np.full(robot.size, np.inf)
    open_ = replace(robot, q_max=np.where(np.arange(6) == 2, np.inf, robot.q_max))
    q = random_poses(open_, 4000, np.random.default_rng(0))
    low, high = robot.q_min.copy(), robot.q_max.copy()
    low[2], high[2] = -np.pi, np.pi
    assert (q >= low).all() and (q <= high).all()
    np.testing.assert_allclose(q.min(axis=0), low, atol=0.01 * np.ptp(q))
    np.testing.assert_allclose(q.max(axis=0), high, atol=0.01 * np.ptp(q))
    chain = replace(robot.chain, revolute=np.arange(6) != 1)
    slides = replace(robot, chain=chain, q_min=-free)
    with pytest.raises(CalibrationError, match="linear joint 'shoulder' has no limits"):
        random_poses(slides, 5, np.random.default_rng(0))


def test_the_gain_of_a_pose_is_the_growth_of_the_determinant():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(6, 3, 4))
    information = np.eye(4) + J[0].T @ J[0]
    expected = [
        np.linalg.slogdet(information + x.T @ x)[1] - np.linalg.slogdet(information)[1]
        for x in J
    ]
    np.testing.assert_allclose(_gain(information, J), expected)


def test_observability_is_the_mean_axis_of_the_information_over_root_poses():
    J = np.diag([2.0, 8.0, 4.0])
    found = observability_index(J, 9)
    assert found == pytest.approx((2 * 8 * 4) ** (1 / 3) / 3)


# --- first guesses --------------------------------------------------------------------


def test_the_nearest_rotation_is_a_rotation_and_leaves_one_alone():
    R = turned(0.7) @ turned(-0.3, 0)
    np.testing.assert_allclose(_nearest_rotation(R), R, atol=1e-12)
    np.testing.assert_allclose(_nearest_rotation(5 * R), R, atol=1e-12)
    mirrored = _nearest_rotation(np.diag([1.0, 1.0, -0.1]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_stations_are_found_from_points_in_space_and_in_a_plane():
    rng = np.random.default_rng(0)
    station = np.array([[1.0, -2.0, 1.5], [0.3, 2.0, 2.5]])
    points = rng.normal(size=(30, 3))
    d = np.linalg.norm(points[:, None] - station, axis=2)
    d[3, 0] = np.nan
    np.testing.assert_allclose(_stations(points, d), station, atol=1e-9)
    flat = points * [1, 1, 0] + [0, 0, 0.4]
    d = np.linalg.norm(flat[:, None] - station, axis=2)
    found = _stations(flat, d)
    np.testing.assert_allclose(found[:, :2], station[:, :2], atol=1e-9)
    np.testing.assert_allclose(
        np.abs(found[:, 2] - 0.4), station[:, 2] - 0.4, atol=1e-9
    )


def frames(count=20):
    q = random_poses(coman(), count, np.random.default_rng(3))
    R, p = flange(coman().chain, q)
    return q, R, p, Frame(R, p)


@pytest.mark.parametrize("far", [1.0, 30.0])
@pytest.mark.parametrize(("base", "tool"), [(True, True), (True, False), (False, True)])
def test_frames_of_an_exact_arm_are_guessed_exactly(base, tool, far):
    q, R, p, frame = frames()
    B, b = (turned(0.8) @ turned(0.5, 1), far * np.array([1.0, -2.0, 0.5]))
    X, x = (turned(-0.6, 0), np.array([0.1, 0.05, 0.2]))
    if not base:
        B, b = np.eye(3), np.zeros(3)
    if not tool:
        X, x = np.eye(3), np.zeros(3)
    seen, turn = (p + R @ x) @ B.T + b, B @ R @ X
    measurements = Measurements(q, seen[:, None], turn)
    place, (end,), stations = align(frame, measurements, base=base, tool=tool)
    np.testing.assert_allclose(place.rotation, B, atol=1e-9)
    np.testing.assert_allclose(place.translation, b, atol=1e-9)
    np.testing.assert_allclose(end.rotation, X, atol=1e-9)
    np.testing.assert_allclose(end.translation, x, atol=1e-9)
    assert stations.shape == (0, 3)


def test_nothing_unknown_is_guessed():
    _, _, p, frame = frames()
    M, offsets = _linear(frame, p[:, None], base=False, tool=False)
    np.testing.assert_array_equal(M, np.eye(3))
    assert not offsets.any() and offsets.shape == (1, 3)


# --- parameters -----------------------------------------------------------------------


def test_parameters_have_their_group_unit_and_place():
    units = {
        "base_x": "m", "base_rx": "rad", "tool_rz": "rad", "tool_z": "m",
        "reflector_2_y": "m", "station_1_x": "m", "scale": "",
        "theta_shoulder": "rad", "a_arm": "m", "alpha_arm": "rad",
        "compliance_arm": "rad/(N·m)", "d_arm": "m", "beta_arm": "rad",
        "compliance_slide": "m/N",
    }  # fmt: skip
    arm = (
        Step(2, True, parameter="theta_shoulder"),
        Step(0, False, parameter="a_arm"),
        Step(0, True, parameter="alpha_arm"),
        Step(2, False, parameter="d_arm"),
        Step(1, True, parameter="beta_arm"),
        Step(2, True, parameter="compliance_arm", load=0),
        Step(2, False, parameter="compliance_slide", load=1),
    )
    tools = (free_frame("tool"), free_frame("reflector_2", turns=False))
    stations = (free_frame("station_1", turns=False),)
    model = KinematicModel((*free_frame("base"), *arm), tools, stations)
    assert {x: model.units[x] for x in units} == units
    groups = {
        "base_x": "base", "tool_rz": "tool", "reflector_2_y": "tool",
        "station_1_x": "base", "theta_elbow": "geometry", "a_elbow": "geometry",
        "scale": "scale", "compliance_elbow": "compliance",
    }  # fmt: skip
    assert {x: _group(x) for x in groups} == groups
    q = random_poses(coman(), 30, np.random.default_rng(0))
    labels = build_setup(coman(), measured(coman().chain, q, "pose")).labels
    kinds = list(dict.fromkeys(label.split("_")[0] for label in labels))
    assert kinds == ["base", "tool", "theta", "a", "alpha", "d", "beta"]


def test_parallel_axes_have_a_second_angle_in_place_of_a_shift():
    geometry = geometry_from_chain(coman().chain)
    assert geometry.parallel == (False, True, True, False, False, False)
    names = [s.parameter for s in geometry.steps if getattr(s, "parameter", "")]
    assert "beta_elbow" in names and "d_shoulder" not in names
    assert "beta_shoulder" not in names and "d_base" in names
    planar = geometry_from_chain(Robot.load(MODELS / "planar.xml").chain)
    assert planar.parallel == (True, False)


# --- weights --------------------------------------------------------------------------


def test_noise_of_each_kind_is_found_beside_the_estimates():
    q = random_poses(coman(), 80, np.random.default_rng(3))
    data = measured(disturbed(coman().chain), q, "pose")
    rng = np.random.default_rng(5)
    noisy = replace(data, position=data.position + 2e-4 * rng.normal(size=(80, 1, 3)))
    turns = Rotation.from_rotvec(1e-3 * rng.normal(size=(80, 3))).as_matrix()
    noisy = replace(noisy, rotation=turns @ data.rotation)
    found = calibrate(coman(), noisy)
    assert found.solution.noise["position"] == pytest.approx(2e-4, rel=0.15)
    assert found.solution.noise["orientation"] == pytest.approx(1e-3, rel=0.15)
    assert len(found.solution.rejected) <= 2
    assert found.solution.iterations < 40  # it settles, and stops
    # Poses are independent: fewer than they are the degrees of a variance, not rows.
    assert (found.solution.degrees < 80).all() and (found.solution.degrees > 20).all()
    low, high = found.solution.interval(0.9)
    middle, half = (low + high) / 2, (high - low) / 2
    np.testing.assert_allclose(middle, found.solution.x, atol=1e-12)
    inside = student.cdf(half / found.solution.std, found.solution.degrees)
    np.testing.assert_allclose(inside, 0.95, rtol=1e-9)


def test_noise_is_what_is_left_over_the_freedom_that_is_left():
    q = random_poses(coman(), 30, np.random.default_rng(3))
    data = measured(disturbed(coman().chain), q, "position", noise=1e-3)
    found = calibrate(coman(), data, robust=False)
    left = found.errors(data)["position"]
    solution = found.solution
    expected = np.sqrt((left**2).sum() / (90 - len(solution.x)))
    assert solution.noise["position"] == pytest.approx(expected, rel=1e-6)


def linear(rows=4, poses=9, size=5):
    """Derivatives, the part of noise that is left as residual, pose of each row."""
    rng = np.random.default_rng(0)
    J = rng.normal(size=(rows * poses, size)) * rng.uniform(0.1, 3, (rows * poses, 1))
    left = np.eye(len(J)) - J @ np.linalg.solve(J.T @ J, J.T)
    return J, left, np.repeat(np.arange(poses), rows)


def test_variances_have_no_bias_and_spread_like_chi_squares_of_their_degrees():
    """A variance is eᵀMe of independent noise e: mean trace M, variance 2 trace M²."""
    J, left, pose = linear(3, 6, 4)
    e = np.eye(len(J))

    def variances(noise):
        return np.diagonal(clustered_covariance(J, left @ noise, pose)[0])

    M = [[(variances(a + b) - variances(a - b)) / 4 for a in e] for b in e]
    degrees = clustered_covariance(J, left[0], pose)[1]
    for k, quadratic in enumerate(np.moveaxis(np.array(M), -1, 0)):
        mean = np.linalg.inv(J.T @ J)[k, k]
        assert np.trace(quadratic) == pytest.approx(mean)
        assert degrees[k] == pytest.approx(mean**2 / np.sum(quadratic**2))


def test_what_one_pose_alone_tells_has_the_noise_of_its_kind():
    J, _, pose = linear()
    alone = np.zeros((len(J), 2))
    alone[:2] = [[2.0, 0.5], [0.0, 1.0]]
    both = np.hstack([J, alone])
    left = np.eye(len(J)) - both @ np.linalg.pinv(both)
    residual = left @ np.random.default_rng(1).normal(size=len(J))
    covariance, degrees = clustered_covariance(both, residual, pose)
    fitted, others = clustered_covariance(J[2:], residual[2:], pose[2:])
    np.testing.assert_allclose(covariance[:5, :5], fitted, rtol=1e-6)
    np.testing.assert_allclose(degrees[:5], others, rtol=1e-6)
    noise = np.linalg.inv(alone[:2].T @ alone[:2])
    assert (np.diagonal(covariance)[5:] > np.diagonal(noise)).all()
    # Of nothing else, its noise is as well known as that of all rows together.
    apart = np.hstack([np.where(np.arange(len(J))[:, None] < 2, 0.0, J), alone])
    covariance, degrees = clustered_covariance(apart, residual, pose)
    np.testing.assert_allclose(np.diagonal(covariance)[5:], np.diagonal(noise))
    np.testing.assert_allclose(degrees[5:], len(J) - 7)


def test_a_unit_fits_as_badly_whether_it_was_fitted_or_left_out():
    """The deletion residual: what a fit does to its own points cancels out."""
    J, _, _ = linear(3, 12, 4)
    y = np.random.default_rng(2).normal(size=len(J))
    y[:3] += 4.0
    found = []
    for rows in (slice(0, None), slice(3, None)):
        x, *_ = np.linalg.lstsq(J[rows], y[rows], rcond=None)
        left = J @ x - y
        freedom = len(J[rows]) - 4
        noise = np.sqrt(left[rows] @ left[rows] / freedom)
        kept = np.arange(12) >= rows.start / 3
        found.append(
            misfit(
                left.reshape(12, 3) / noise,
                J.reshape(12, 3, 4),
                np.linalg.inv(J[rows].T @ J[rows]),
                kept,
                freedom,
            )[0]
        )
    assert (found[0] > 1) == (found[1] > 1)
    # Both are the same number on scales of their own: Fisher's and beta's.
    f = 33 - 4
    size = found[1] ** 2 * fisher.isf(OUTSIDE, 3, f)
    square = found[0] ** 2 * 32 * beta.isf(OUTSIDE, 1.5, 29 / 2)
    assert size == pytest.approx(square / 3 / ((32 - square) / 29))


def test_errors_count_the_bending_where_it_was_fitted():
    q = random_poses(coman(), 50, np.random.default_rng(3))
    chain, still = coman().chain, np.zeros((50, 6))
    held = inverse_dynamics(chain, chain.inertial, q, still, still)
    seen = measured(chain, q - 3e-5 * held, "pose")
    free = ("base", "tool", "geometry", "compliance")
    found = calibrate(coman(), replace(seen, q=q), free=free)
    assert max(x.max() for x in found.errors(replace(seen, q=q)).values()) < 1e-9


# --- rows of a geometry ---------------------------------------------------------------


def parallel_arm():
    """Axes in parallel, apart, and twice on one line, and one across."""
    chain = random_arm(1).chain
    n = 5
    axis = np.array([[0.0, 1.0, 0.0]] * 4 + [[1.0, 0.0, 0.0]])
    shift = np.array(
        [[0, 0, 0.1], [0.3, 0, 0.2], [0, 0.4, 0], [0.2, 0.1, 0], [0.1] * 3]
    )
    return replace(
        chain,
        joints=tuple("abcde"),
        rotation=np.tile(np.eye(3), (n, 1, 1)),
        translation=np.array(shift),
        axis=axis,
        revolute=np.ones(n, dtype=bool),
        inertial=np.tile(chain.inertial[:1], (n, 1)),
        armature=np.zeros(n),
    )


def test_rows_lead_where_an_arm_of_parallel_axes_does_in_every_posture():
    chain = parallel_arm()
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (20, chain.size))
    geometry = geometry_from_chain(chain)
    here = follow(start(q), geometry.steps, q, {})
    R, p = flange(chain, q)
    np.testing.assert_allclose(here.origin, p, atol=1e-9)
    np.testing.assert_allclose(here.rotation, R, atol=1e-9)
    same = chain_from_values(chain, geometry, {})
    np.testing.assert_allclose(same.translation, chain.translation, atol=1e-9)
    np.testing.assert_allclose(same.rotation, chain.rotation, atol=1e-9)
