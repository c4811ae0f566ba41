"""Kinematic calibration: known arms recovered, efficiency, outliers, what is hidden."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import MODELS, planar_of_xacro, public_arm, random_arm, random_states
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import studied
from mh6 import steps_from_dh
from scipy.spatial.transform import Rotation

import hybrid
from hybrid.arrays import Array
from hybrid.calibration import (
    Measurements,
    calibrate,
    choose_poses,
    cross_validate,
    random_poses,
)
from hybrid.calibration.calibrate import build_setup
from hybrid.calibration.geometry import (
    chain_from_values,
    geometry_from_chain,
)
from hybrid.calibration.model import KinematicModel
from hybrid.calibration.solve import solve
from hybrid.calibration.steps import follow, start
from hybrid.dynamics import inverse_dynamics
from hybrid.errors import CalibrationError
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

NOISE = 5e-5  # m and rad
KINDS = ("pose", "position", "reflectors", "distance")


@cache
def coman() -> Robot:
    return Robot.load(MODELS / "coman_like.urdf")


def flange(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Pose of the last link by walking the chain itself."""
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    for k in range(chain.size):
        p = p + R @ chain.translation[k]
        R = R @ chain.rotation[k]
        if chain.revolute[k]:
            R = R @ Rotation.from_rotvec(q[:, k, None] * chain.axis[k]).as_matrix()
        else:
            p = p + (R @ chain.axis[k]) * q[:, k, None]
    return R, p


def disturbed(chain: Chain, seed: int = 0) -> Chain:
    """Every joint frame moved by millimetres and milliradians in all six directions."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(2e-3 * rng.normal(size=(chain.size, 3))).as_matrix()
    shift = 1e-3 * rng.normal(size=(chain.size, 3))
    return replace(
        chain, rotation=chain.rotation @ turn, translation=chain.translation + shift
    )


def measured(
    chain: Chain,
    q: Array,
    kind: str,
    *,
    noise: float = 0.0,
    outliers: float = 0.0,
    seed: int = 0,
) -> Measurements:
    """What an instrument anywhere sees of unknown points on the flange."""
    place = np.random.default_rng(99)
    B, b = Rotation.random(rng=place).as_matrix(), 2 * place.normal(size=3)
    X, x = Rotation.random(rng=place).as_matrix(), 0.15 * place.normal(size=(3, 3))
    stations = 2 * place.normal(size=(3, 3))
    rng = np.random.default_rng(seed)
    size = noise * np.where(rng.random(len(q)) < outliers, 100.0, 1.0)
    R, p = flange(chain, q)
    points = p[:, None] + (R[:, None] @ x[:, :, None])[..., 0]  # (N, 3, 3)
    if kind == "distance":
        d = np.linalg.norm(points[:, :1] - stations, axis=-1)
        d = d + size[:, None] * rng.normal(size=d.shape)
        return Measurements(q, np.zeros((len(q), 0, 3)), None, d)
    seen = points @ B.T + b
    seen = seen + size[:, None, None] * rng.normal(size=seen.shape)
    if kind == "reflectors":
        return Measurements(q, seen)
    if kind == "position":
        return Measurements(q, seen[:, :1])
    turn = Rotation.from_rotvec(size[:, None] * rng.normal(size=(len(q), 3)))
    return Measurements(q, seen[:, :1], turn.as_matrix() @ B @ R @ X)


def geometry_of(labels: tuple[str, ...]) -> Array:
    """Which labels belong to the arm; those of frames depend on the first guess."""
    frames = ("base", "tool", "reflector", "station")
    return np.array([not label.startswith(frames) for label in labels])


@pytest.mark.parametrize(
    ("name", "kind"),
    [*(("ur10", kind) for kind in KINDS), ("panda", "pose"), ("panda", "distance"),
     ("z1", "position"), ("z1", "reflectors")],
)  # fmt: skip
def test_noise_free_measurements_give_the_arm_back(name, kind):
    # Random errors in all six directions of every joint frame: what the parameters
    # could not express would stay as an error on poses left out.
    robot = public_arm(name)
    chain = disturbed(robot.chain)
    q = np.random.default_rng(1).uniform(-2, 2, (90, robot.size))
    data = measured(chain, q, kind)
    found = calibrate(robot, data.at(np.arange(60)))
    assert found.solution.converged
    assert found.solution.iterations <= (20 if robot.size == 6 else 25)
    for error in found.errors(data.at(np.arange(60, 90))).values():
        assert error.max() < 1e-9
    assert not found.solution.rejected


@pytest.mark.parametrize("seed", range(12))
def test_rows_walk_as_their_chain_and_changed_rows_as_the_chain_made_from_them(seed):
    chain = random_arm(seed).chain
    geometry = geometry_from_chain(chain)
    q = random_states(chain.size, 5)[0]
    rng = np.random.default_rng(seed)
    labels = follow(start(q), geometry.steps, q, {}).twists
    values = {label: 0.05 * rng.normal() for label in labels}
    # Without changes, the rows are those of the chain itself.
    changed = chain_from_values(chain, geometry, values)
    for arm, corrections in ((chain, {}), (changed, values)):
        end = follow(start(q), geometry.steps, q, corrections)
        R, p = flange(arm, q)
        np.testing.assert_allclose(end.rotation, R, atol=1e-12)
        np.testing.assert_allclose(end.origin, p, atol=1e-12)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), kind=st.sampled_from(KINDS))
def test_derivatives_agree_with_finite_differences(seed, kind):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2, 2, (6, 6))
    data = measured(coman().chain, q, kind)
    setup = build_setup(coman(), data, free=("base", "tool", "geometry", "scale"))
    x = 0.1 * rng.normal(size=len(setup.labels))
    way = rng.normal(size=len(x))
    h = 1e-6

    def blocks(at):
        return setup.model.blocks(data, setup.labels, at)

    ahead, here, behind = blocks(x + h * way), blocks(x), blocks(x - h * way)
    for b, a, c in zip(here, ahead, behind, strict=True):
        slope = (a.residual - c.residual) / (2 * h)
        np.testing.assert_allclose(b.jacobian @ way, slope, atol=1e-7)


def test_derivatives_agree_with_pinocchio():
    import pinocchio as pin

    robot = public_arm("ur10")
    model = robot.pinocchio()
    data = model.createData()
    q = random_states(robot.size, 4)[0]
    steps = geometry_from_chain(robot.chain).steps
    end = follow(start(q), steps, q, {})
    for n in range(len(q)):
        pin.computeJointJacobians(model, data, q[n])
        expected = pin.getJointJacobian(
            model, data, robot.size, pin.LOCAL_WORLD_ALIGNED
        )
        for k, joint in enumerate(robot.joints):
            moves, turns = np.split(end.twists[f"theta_{joint}"][n], 2)
            np.testing.assert_allclose(turns, expected[3:, k], atol=1e-12)
            moves = moves + np.cross(turns, end.origin[n])
            np.testing.assert_allclose(moves, expected[:3, k], atol=1e-12)


@pytest.mark.parametrize("outliers", [0.05, *studied(0.0)])
def test_errors_stay_within_a_fifth_of_the_cramer_rao_bound(outliers):
    q = random_poses(coman(), 50, np.random.default_rng(3))
    chain = disturbed(coman().chain)
    exact = calibrate(coman(), measured(chain, q, "position"), robust=False)
    arm = geometry_of(exact.solution.labels)
    J = exact.solution.jacobian * exact.solution.noise["position"] / NOISE
    bound = np.diagonal(np.linalg.inv(J.T @ J))[arm]
    errors, inside = [], []
    for seed in range(12):
        data = measured(chain, q, "position", noise=NOISE, outliers=outliers, seed=seed)
        found = calibrate(coman(), data)
        assert found.solution.labels == exact.solution.labels
        errors.append((found.solution.x - exact.solution.x)[arm])
        low, high = (limit[arm] for limit in found.solution.interval())
        truth = exact.solution.x[arm]
        inside.append(((low <= truth) & (truth <= high)).mean())
    ratio = np.sqrt(np.mean(np.array(errors) ** 2 / bound))
    assert 0.9 < ratio < 1.2
    assert 0.92 < np.mean(inside) < 0.97


def coverage(kind, poses, seeds, *, shared=0.0):
    """Share of corrections of the arm that lie in their intervals, and what was lost.

    Args:
        kind: What is measured.
        poses: How many; other ones for each seed.
        seeds: Number of calibrations.
        shared: Noise of the joints' positions, which all points of a pose have [rad].
    """
    rng, chain = np.random.default_rng(0), disturbed(coman().chain)
    many = measured(chain, random_poses(coman(), 150, rng), kind)
    truth = calibrate(coman(), many, robust=False).solution.values()
    inside, rejected = [], 0
    for seed in range(seeds):
        q = random_poses(coman(), poses, rng)
        turned = q + shared * rng.normal(size=q.shape)
        data = replace(measured(chain, turned, kind, noise=2e-5, seed=seed), q=q)
        found = calibrate(coman(), data)
        arm = geometry_of(found.solution.labels)
        for label, low, high in np.array(
            [found.solution.labels, *found.solution.interval()], dtype=object
        ).T[arm]:
            if label in truth:
                inside.append(low < truth[label] < high)
        rejected += len(found.solution.rejected)
    return np.mean(inside), rejected


@pytest.mark.study
def test_intervals_hold_where_the_points_of_a_pose_share_its_errors():
    inside, _ = coverage("reflectors", 40, 20, shared=1e-4)
    assert 0.92 < inside < 0.98


@pytest.mark.study
@pytest.mark.parametrize("kind", ["position", "distance"])
def test_few_good_poses_are_all_kept_and_their_intervals_hold(kind):
    inside, rejected = coverage(kind, 24, 15)
    assert 0.91 < inside < 0.99
    assert rejected <= 2


def test_outliers_are_named_and_good_measurements_are_not():
    q = random_poses(coman(), 60, np.random.default_rng(3))
    data = measured(disturbed(coman().chain), q, "pose", noise=NOISE)
    data.position[7] += [0.0, 0.02, 0.0]
    data.rotation[31] = (
        data.rotation[31] @ Rotation.from_rotvec([0.01, 0, 0]).as_matrix()
    )
    found = calibrate(coman(), data).solution.rejected
    assert {(x.pose, x.kind) for x in found} >= {(7, "position"), (31, "orientation")}
    assert len(found) <= 4
    assert next(x.size for x in found if x.pose == 7) == pytest.approx(0.02, rel=0.05)


def test_what_is_not_seen_is_left_out():
    q = random_poses(coman(), 60, np.random.default_rng(3))
    data = measured(disturbed(coman().chain), q, "reflectors")
    data.position[::3, 1] = np.nan
    data.position[5] = np.nan
    found = calibrate(coman(), data)
    assert all(error.max() < 1e-9 for error in found.errors(data).values())


def test_base_and_tool_hide_the_first_and_the_last_joint():
    q = random_poses(coman(), 40, np.random.default_rng(3))
    found = calibrate(coman(), measured(coman().chain, q, "pose"))
    # 4 parameters an axis, and 6 for the frame at the end: all that there are.
    assert len(found.solution.labels) == 30
    named = " ".join(found.unidentifiable)
    for label in ("theta_base", "d_base", "theta_wrist_3", "d_wrist_3"):
        assert f"{label}: joins" in named
    assert "d_shoulder: joins d_elbow, the axes are parallel" in named


def test_position_alone_hides_the_tools_orientation():
    q = random_poses(coman(), 40, np.random.default_rng(3))
    found = calibrate(coman(), measured(coman().chain, q, "position"))
    assert len(found.solution.labels) == 27
    assert not any(label.startswith("tool_r") for label in found.solution.labels)


def test_the_scale_of_distances_cannot_be_told_from_the_size_of_the_arm():
    q = random_poses(coman(), 60, np.random.default_rng(3))
    data = measured(coman().chain, q, "distance")
    found = calibrate(coman(), data, free=("base", "tool", "geometry", "scale"))
    assert any(line.startswith("scale: joins") for line in found.unidentifiable)
    # With the arm's size known, a meter that reads too long is found out.
    long = replace(data, distance=1.002 * data.distance)
    found = calibrate(coman(), long, free=("base", "tool", "scale"))
    assert found.solution.values()["scale"] == pytest.approx(0.002, abs=1e-9)


def test_gravity_bends_joints_by_their_compliance():
    q = random_poses(coman(), 60, np.random.default_rng(3))
    chain, still = coman().chain, np.zeros((60, 6))
    held = inverse_dynamics(chain, chain.inertial, q, still, still)
    compliance = np.array([0.0, 2e-5, 3e-5, 1e-4, 1e-4, 0.0])
    seen = measured(disturbed(chain), q - compliance * held, "pose")
    data = replace(seen, q=q)
    found = calibrate(coman(), data, free=("base", "tool", "geometry", "compliance"))
    values = found.solution.values()
    for k in range(1, 5):
        estimate = values[f"compliance_{coman().joints[k]}"]
        assert estimate == pytest.approx(compliance[k], rel=1e-6)
    assert "compliance_base: moves nothing measured" in found.unidentifiable
    rigid = calibrate(coman(), data)
    assert rigid.solution.noise["position"] > 1e-5


def test_known_frames_stay_where_they_are():
    q = random_poses(coman(), 40, np.random.default_rng(3))
    R, p = flange(disturbed(coman().chain), q)
    found = calibrate(
        coman(), Measurements(q, p[:, None], R), free=("geometry", "tool")
    )
    assert not any(label.startswith("base") for label in found.solution.labels)
    rotation, place = found.base
    np.testing.assert_array_equal(rotation, np.eye(3))
    np.testing.assert_array_equal(place, np.zeros(3))


def test_base_and_tool_frames_are_found():
    q = random_poses(coman(), 40, np.random.default_rng(3))
    place = np.random.default_rng(99)
    B, b = Rotation.random(rng=place).as_matrix(), 2 * place.normal(size=3)
    found = calibrate(
        coman(), measured(coman().chain, q, "pose"), free=("base", "tool")
    )
    rotation, origin = found.base
    np.testing.assert_allclose(rotation, B, atol=1e-9)
    np.testing.assert_allclose(origin, b, atol=1e-9)


def test_the_error_on_poses_left_out_falls_to_the_noise():
    q = random_poses(coman(), 60, np.random.default_rng(3))
    data = measured(disturbed(coman().chain), q, "position", noise=NOISE)
    errors = cross_validate(coman(), data, folds=3)
    assert len(errors.calibrated["position"]) == 60
    assert np.median(errors.nominal["position"]) > 1e-3
    assert np.median(errors.calibrated["position"]) < 4 * NOISE


def test_nothing_is_fitted_to_the_nominal_arm_where_frames_are_known():
    q = random_poses(coman(), 40, np.random.default_rng(3))
    R, p = flange(disturbed(coman().chain), q)
    nominal = flange(coman().chain, q)[1]
    data = Measurements(q, p[:, None], R)
    errors = cross_validate(coman(), data, free=("geometry",), folds=2)
    found, order = (
        errors.nominal["position"],
        np.argsort(np.arange(40) % 2, kind="stable"),
    )
    np.testing.assert_allclose(found, np.linalg.norm(p - nominal, axis=1)[order])
    with pytest.raises(CalibrationError, match="nothing is free"):
        calibrate(coman(), data, free=())


@pytest.mark.study
def test_chosen_poses_tell_more_than_random_ones():
    rng = np.random.default_rng(0)
    candidates = random_poses(coman(), 300, rng)
    chosen = choose_poses(coman(), candidates, 25)
    assert len(set(chosen)) == 25

    def volume(rows):
        data = measured(coman().chain, candidates[rows], "position")
        return calibrate(coman(), data, robust=False).observability

    # O₁ is a mean over the 27 axes of the confidence region.
    random = [volume(rng.permutation(300)[:25]) for _ in range(5)]
    assert (volume(chosen) / max(random)) ** 27 > 3


@pytest.mark.parametrize("file", ["coman_like.urdf", "coman_like.xml", "scara.xml"])
def test_the_calibrated_file_reads_back_as_the_calibrated_arm(file, tmp_path):
    robot = Robot.load(MODELS / file)
    q = np.random.default_rng(1).uniform(-2, 2, (50, robot.size))
    chain = disturbed(robot.chain)
    found = calibrate(robot, measured(chain, q, "pose"))
    found.save(tmp_path / file)
    read = Robot.load(tmp_path / file)
    for new, old in zip(
        flange(read.chain, q), flange(found.robot.chain, q), strict=True
    ):
        np.testing.assert_allclose(new, old, atol=1e-12)
    np.testing.assert_allclose(read.chain.inertial, robot.chain.inertial, atol=1e-12)


def test_an_arm_of_a_xacro_file_is_calibrated_as_its_urdf(tmp_path):
    pytest.importorskip("xacro")
    robot = planar_of_xacro(tmp_path)
    q = np.random.default_rng(1).uniform(-2, 2, (50, robot.size))
    found = calibrate(robot, measured(disturbed(robot.chain), q, "pose"))
    found.save(tmp_path / "new.urdf")
    new, old = Robot.load(tmp_path / "new.urdf").chain, found.robot.chain
    np.testing.assert_allclose(flange(new, q)[1], flange(old, q)[1], atol=1e-12)


def test_classical_rows_recover_the_errors_of_a_published_arm():
    half = np.pi / 2
    rows = [
        {"theta": 0.0, "d": 0.45, "a": 0.15, "alpha": -half},
        {"theta": -half, "a": 0.614, "alpha": 0.0, "beta": 0.0},
        {"theta": 0.0, "d": 0.0, "a": 0.155, "alpha": -half},
        {"theta": 0.0, "d": 0.64, "a": 0.0, "alpha": half},
        {"theta": 0.0, "d": 0.0, "a": 0.0, "alpha": -half},
        {"theta": 0.0, "d": 0.095, "a": 0.0, "alpha": 0.0},
    ]
    model = KinematicModel(steps_from_dh(rows), ((),))
    rng = np.random.default_rng(0)
    truth = 2e-3 * rng.normal(size=24)
    q = rng.uniform(-2, 2, (50, 6))
    end = model.frames(q, dict(zip(model.units, truth, strict=True)))[0]
    data = Measurements(q, end.origin[:, None], end.rotation)
    assert all(
        unit == ("m" if label[:2] in ("a_", "d_") else "rad")
        for label, unit in model.units.items()
    )
    found = solve(model, data, tuple(model.units))
    assert found.labels == tuple(model.units)
    np.testing.assert_allclose(found.x, truth, atol=1e-9)
    assert found.evaluations <= 20
    assert found.iterations <= 20


def test_too_few_poses_are_refused():
    q = random_poses(coman(), 8, np.random.default_rng(3))
    with pytest.raises(CalibrationError, match="24 numbers.*more than the 2[47]"):
        calibrate(coman(), measured(coman().chain, q, "position"))


def test_an_unknown_group_is_refused():
    q = random_poses(coman(), 40, np.random.default_rng(3))
    data = measured(coman().chain, q, "position")
    with pytest.raises(CalibrationError, match="cannot free links; valid are base"):
        calibrate(coman(), data, free=("links",))
    with pytest.raises(CalibrationError, match="positions of 6 joints; ur10 has|has 6"):
        calibrate(coman(), replace(data, q=q[:, :5]))


def test_calibrate_is_public():
    assert hybrid.calibrate is calibrate
