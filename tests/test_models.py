"""The robot files that are shipped: MJCF and URDF are one arm, and a plausible one."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from hybrid.effects import effect_from_dict
from hybrid.robot import Robot
from hybrid.robot.spatial import central_inertia

MODELS = Path(__file__).parents[1] / "models"
ARMS = ("coman_like", "scara", "planar")
FIELDS = ("q_min", "q_max", "v_max", "a_max", "tau_max", "damping", "frictionloss")


@pytest.fixture(scope="module")
def build():
    """The script that writes the files; models/ is a folder of data, not a package."""
    spec = importlib.util.spec_from_file_location("models_build", MODELS / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", params=ARMS)
def arm(request):
    return request.param


@pytest.fixture(scope="module")
def both(arm):
    """MuJoCo's own reading of the MJCF, pinocchio's own reading of the URDF."""
    return (
        mujoco.MjModel.from_xml_path(str(MODELS / f"{arm}.xml")),
        pin.buildModelFromUrdf(str(MODELS / f"{arm}.urdf")),
    )


def states(model, n=20):
    rng = np.random.default_rng(0)
    for _ in range(n):
        yield rng.uniform(-np.pi, np.pi, model.nq), rng.normal(size=model.nv)


def in_mujoco(model, q, v):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    return data


def inertia_in_mujoco(model, data):
    """Joint-space inertia without rotors, which a URDF's rigid tree does not hold."""
    inertia = np.zeros((model.nv, model.nv))
    for column, unit in zip(inertia, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    return inertia - np.diag(model.dof_armature)


def test_the_committed_files_are_what_the_script_writes(build):
    written = build.documents()
    committed = {p.name for p in MODELS.iterdir() if p.suffix in {".xml", ".urdf"}}
    committed.remove("ur10.urdf")  # somebody else's, with its licence
    assert committed == set(written)
    for name, text in written.items():
        assert (MODELS / name).read_text(encoding="utf-8") == text, name


def test_mjcf_and_urdf_have_one_inertia_matrix(both):
    mjcf, urdf = both
    data = urdf.createData()
    for q, v in states(urdf):
        ours = inertia_in_mujoco(mjcf, in_mujoco(mjcf, q, v))
        pin.crba(urdf, data, q)
        theirs = np.triu(data.M) + np.triu(data.M, 1).T
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_mjcf_and_urdf_feel_one_gravity_and_one_coriolis_torque(both):
    mjcf, urdf = both
    data = urdf.createData()
    for q, v in states(urdf):
        for speed in (0 * v, v):
            ours = in_mujoco(mjcf, q, speed).qfrc_bias
            theirs = pin.nonLinearEffects(urdf, data, q, speed)
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_mjcf_and_urdf_have_one_flange_and_one_jacobian(both):
    mjcf, urdf = both
    data = urdf.createData()
    frame, site = urdf.getFrameId("flange", pin.BODY), mjcf.site("flange")
    for q, v in states(urdf):
        mine = in_mujoco(mjcf, q, v)
        linear, angular = np.zeros((3, mjcf.nv)), np.zeros((3, mjcf.nv))
        body = mjcf.site_bodyid[site.id]
        mujoco.mj_jac(mjcf, mine, linear, angular, mine.site(site.id).xpos, body)
        theirs = pin.computeFrameJacobian(urdf, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose([*linear, *angular], theirs, rtol=0, atol=1e-9)
        pin.updateFramePlacements(urdf, data)
        place = data.oMf[frame].translation
        np.testing.assert_allclose(mine.site("flange").xpos, place, rtol=0, atol=1e-9)


def test_both_files_declare_the_same_robot(arm):
    mjcf, urdf = (Robot.load(MODELS / f"{arm}{kind}") for kind in (".xml", ".urdf"))
    assert mjcf.name == urdf.name == arm
    assert mjcf.joints == urdf.joints
    assert mjcf.fingerprint() == urdf.fingerprint()
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(mjcf, name), getattr(urdf, name), name)
        assert np.isfinite(getattr(mjcf, name)).all()
    for name in ("armature", "inertial"):
        ours, theirs = getattr(mjcf.chain, name), getattr(urdf.chain, name)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def test_every_link_is_a_physical_body_without_symmetry(arm):
    for inertial in Robot.load(MODELS / f"{arm}.xml").chain.inertial:
        mass, center, inertia = central_inertia(inertial)
        assert mass > 0
        principal = np.linalg.eigvalsh(inertia)
        assert principal[0] > 0
        assert principal[0] + principal[1] > principal[2]
        # No exact zero that would make a parameter vanish.
        assert (np.abs(center) > 1e-5).all()
        assert (np.abs(inertia[np.triu_indices(3, 1)]) > 1e-7).all()


def test_a_solid_link_has_the_inertia_of_the_textbook(build):
    box = {"box": [[1, 0, 0], [0.2, 0.4, 0.6], 3.0]}
    mass, center, inertia = build.inertial([box])
    assert mass == 3.0
    np.testing.assert_allclose(center, [1, 0, 0])
    np.testing.assert_allclose(np.diag(inertia), [0.13, 0.10, 0.05])
    thin = {"tube": [[0, 0, 0], [0, 0, 2], 0.5, 0.5, 2.0]}
    mass, center, inertia = build.inertial([thin])
    np.testing.assert_allclose(center, [0, 0, 1])
    across = 2.0 * (0.25 / 2 + 4 / 12)  # a hoop stretched along its axis
    np.testing.assert_allclose(np.diag(inertia), [across, across, 0.5], atol=1e-9)


def test_a_link_of_two_halves_weighs_and_turns_like_the_whole(build):
    whole = {"box": [[0, 0, 0], [0.4, 0.2, 0.1], 2.0]}
    halves = [{"box": [[x, 0, 0], [0.2, 0.2, 0.1], 1.0]} for x in (-0.1, 0.1)]
    for one, other in zip(build.inertial([whole]), build.inertial(halves), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_named_solids_of_the_two_files_lie_at_the_same_place(arm, both):
    mjcf, urdf = both
    solids = pin.buildGeomFromUrdf(
        urdf, str(MODELS / f"{arm}.urdf"), pin.GeometryType.COLLISION
    )
    names = {mjcf.geom(g).name for g in range(mjcf.ngeom)}
    assert len(names - {""}) == mjcf.ngeom == solids.ngeoms
    data, solid_data = urdf.createData(), solids.createData()
    q, v = next(states(urdf))
    mine = in_mujoco(mjcf, q, v)
    pin.updateGeometryPlacements(urdf, data, solids, solid_data, q)
    ours = np.array([mine.geom(g).xpos for g in range(mjcf.ngeom)])
    theirs = np.array([pose.translation for pose in solid_data.oMg])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_the_arm_touches_nothing_at_home(both):
    mjcf, _ = both
    mujoco.mj_resetDataKeyframe(mjcf, data := mujoco.MjData(mjcf), 0)
    mujoco.mj_forward(mjcf, data)
    assert data.ncon == 0


def test_a_hand_folded_into_the_upper_arm_touches_it():
    mjcf = mujoco.MjModel.from_xml_path(str(MODELS / "coman_like.xml"))
    folded = np.radians([0, 90, 150, -90, 90, 0])
    assert in_mujoco(mjcf, folded, np.zeros(6)).ncon > 0


def test_the_coman_like_arm_is_of_its_class():
    mjcf = mujoco.MjModel.from_xml_path(str(MODELS / "coman_like.xml"))
    assert 25 <= mjcf.body_mass.sum() <= 30
    straight = in_mujoco(mjcf, np.radians([0, 0, 0, 90, 0, 0]), np.zeros(6))
    wrist = straight.body("wrist_3_link").xpos - straight.body("upper_arm_link").xpos
    assert np.hypot(wrist[0], wrist[2]) == pytest.approx(0.9, abs=0.01)


def test_rated_torques_hold_and_accelerate_the_arm_and_its_payload():
    robot = Robot.load(MODELS / "coman_like.xml")
    model = robot.pinocchio()
    payload = pin.Inertia(5.0, np.array([0, 0, 0.05]), 0.01 * np.eye(3))
    loaded = pin.Model(model)
    loaded.appendBodyToJoint(6, payload, pin.SE3.Identity())
    worst = np.radians([0, 0, 0, 90, 0, 0])
    rest, peak = np.zeros(6), robot.a_max * np.array([0, 1, 0, 0, 0, 0])
    for arm, a in ((loaded, rest), (model, peak)):
        torque = np.abs(pin.rnea(arm, arm.createData(), worst, rest, a))
        friction = robot.frictionloss
        assert (torque + friction < robot.tau_max).all()


@pytest.fixture(scope="module")
def truth():
    return yaml.safe_load((MODELS / "coman_truth.yaml").read_text(encoding="utf-8"))


def test_the_truth_names_effects_that_exist(truth):
    robot = Robot.load(MODELS / truth["robot"])
    effects = [effect_from_dict(item, robot.joints) for item in truth["effects"]]
    mixes = [{e.id for e in effects if e.joints == (j,)} for j in range(robot.size)]
    assert all(len(mix) >= 4 for mix in mixes)
    assert len({frozenset(mix) for mix in mixes}) == robot.size  # each its own


def test_the_truth_has_physical_links_of_realistic_error(truth):
    robot = Robot.load(MODELS / truth["robot"])
    assert [link["joint"] for link in truth["inertial"]] == list(robot.joints)
    kinds = ("mass", "first_moment", "inertia")
    factors = np.array([[link[k] for k in kinds] for link in truth["inertial"]])
    error = np.abs(factors - 1)
    assert (error >= 0.05 - 1e-12).all() and (error <= 0.20 + 1e-12).all()


def test_the_truth_has_dry_friction_of_3_to_5_percent_of_rated_torque(truth):
    robot = Robot.load(MODELS / truth["robot"])
    level = robot.frictionloss.copy()
    for item in truth["effects"]:
        if item["effect"] == "coulomb":
            level[robot.joint_index(item["joints"][0])] += item["values"]["level"]
    share = level / robot.tau_max
    assert (share >= 0.03).all() and (share <= 0.05).all()


def test_the_truth_has_noise_correlated_across_joints(truth):
    noise = truth["noise"]
    correlation = np.array(noise["torque_correlation"])
    assert len(noise["torque_std"]) == len(correlation) == 6
    np.testing.assert_array_equal(correlation, correlation.T)
    np.testing.assert_array_equal(np.diag(correlation), 1)
    assert np.linalg.eigvalsh(correlation)[0] > 0.1
    neighbours = np.diag(correlation, 1)
    assert (neighbours >= 0.3).all() and (neighbours <= 0.6).all()
    assert noise["position_resolution"] == 2 * np.pi / 2**19
