"""Robot files: every way to write an arm down gives the arm that MuJoCo simulates."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.errors import HybridWarning, RobotError
from hybrid.robot import Robot
from hybrid.robot.library import robot_file
from hybrid.robot.spatial import central_inertia, inertial_about

MODELS = Path(__file__).parents[1] / "models"
LIMITS = ("q_min", "q_max", "v_max", "a_max", "tau_max", "damping", "frictionloss")

# Arms that nobody here modelled: joints of the arm, whether a gripper forks off.
PUBLIC_ARMS = {
    "ur5": (6, False),
    "ur10": (6, False),
    "panda": (7, True),
    "xarm7": (7, False),
    "z1": (7, False),
}


@pytest.fixture(scope="module", params=PUBLIC_ARMS)
def public(request):
    path = robot_file(request.param)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        return path, Robot.load(path)


def rigid(model):
    """The model without friction, limits and contact."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_damping[:] = 0
    return model


def torque_in_mujoco(model, q, v, a):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()


def torque_in_pinocchio(model, q, v, a):
    """Inverse dynamics with scalar joints; rotors are in the model's armature."""
    return pin.rnea(model, model.createData(), q, v, a)


def states(n, *, seed=0, count=10):
    rng = np.random.default_rng(seed)
    return [
        (rng.uniform(-np.pi, np.pi, n), rng.normal(size=n), rng.normal(size=n))
        for _ in range(count)
    ]


# MuJoCo asks for some mass everywhere: massless links get a speck of it.
SPECK = 1e-7


def assert_same_torque(ours, theirs, relative=1e-9):
    size = max(1.0, np.abs(theirs).max())
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=relative * size)


def saved(tmp_path, body, *, around="", name="arm.xml"):
    path = tmp_path / name
    path.write_text(
        f"<mujoco><compiler angle='radian'/>{around}"
        f"<worldbody>{body}</worldbody></mujoco>"
    )
    return path


def assert_chain_moves_like(path, robot):
    """Robot.load of an MJCF against MuJoCo's reading of the same file."""
    own = rigid(mujoco.MjModel.from_xml_path(str(path)))
    built = rigid(robot.mujoco_spec().compile())
    for q, v, a in states(robot.size):
        truth = torque_in_mujoco(own, q, v, a)
        assert_same_torque(torque_in_pinocchio(robot.pinocchio(), q, v, a), truth)
        assert_same_torque(torque_in_mujoco(built, q, v, a), truth, SPECK)


# --- arms nobody here modelled ------------------------------------------------------


@pytest.mark.parametrize("name", PUBLIC_ARMS)
def test_a_public_arm_loads_whole(name):
    size, forks = PUBLIC_ARMS[name]
    if forks:
        with pytest.warns(HybridWarning, match="held where the file has them .*finger"):
            robot = Robot.load(name)
    else:
        robot = Robot.load(name)
    assert robot.size == size
    assert np.isfinite(robot.q_min).all() and (robot.q_min < robot.q_max).all()


def test_a_public_arm_has_the_torque_that_pinocchio_reads_from_its_file(public):
    path, robot = public
    tree = pin.buildModelFromUrdf(str(path))
    frozen = [j for j, name in enumerate(tree.names) if j and name not in robot.joints]
    # (pinocchio cannot reduce the Z1, which names a joint like a link: nothing to do.)
    theirs = pin.buildReducedModel(tree, frozen, pin.neutral(tree)) if frozen else tree
    ours = robot.pinocchio()
    for q, v, a in states(robot.size):
        truth = torque_in_pinocchio(theirs, q, v, a)
        assert_same_torque(torque_in_pinocchio(ours, q, v, a), truth)


def test_a_public_arm_simulates_like_its_chain(public):
    _, robot = public
    built, ours = rigid(robot.mujoco_spec().compile()), robot.pinocchio()
    for q, v, a in states(robot.size):
        truth = torque_in_pinocchio(ours, q, v, a)
        assert_same_torque(torque_in_mujoco(built, q, v, a), truth, SPECK)


def test_chosen_joints_are_kept_in_the_order_of_the_chain_and_the_rest_freezes():
    path = robot_file("ur5")
    chosen = ("elbow_joint", "shoulder_lift_joint")
    held = "shoulder_pan_joint; wrist_1_joint … wrist_3"
    with pytest.warns(HybridWarning, match=held):
        robot = Robot.load(path, joints=chosen)
    assert robot.joints == ("shoulder_lift_joint", "elbow_joint")
    whole = Robot.load(path)
    for q, v, a in states(2):
        wide = np.zeros((3, 6))
        wide[:, 1:3] = q, v, a
        truth = torque_in_pinocchio(whole.pinocchio(), *wide)[1:3]
        assert_same_torque(torque_in_pinocchio(robot.pinocchio(), q, v, a), truth)


@pytest.mark.filterwarnings("ignore::hybrid.errors.HybridWarning")
def test_a_finger_that_another_follows_is_no_joint_of_the_arm():
    names = [f"panda_joint{k}" for k in range(1, 8)] + ["panda_finger_joint1"]
    with pytest.raises(RobotError, match="'panda_finger_joint2' follows joint"):
        Robot.load("panda", joints=tuple(names))


# --- what MJCF can say --------------------------------------------------------------

SOLID = "<geom type='box' size='.1 .05 .03' pos='.04 .02 -.01' euler='.3 .2 .1'/>"


def test_bodies_without_joints_are_welded_to_their_link(tmp_path):
    path = saved(
        tmp_path,
        f"<body pos='0 0 .3' quat='.9 .1 .3 .2'>{SOLID}"
        f"<body name='a' pos='.1 0 0'><joint name='one' axis='0 1 1'/>{SOLID}"
        f"<body pos='.2 .1 0' euler='.5 0 1'>{SOLID}"
        f"<body pos='.1 0 .3'><joint name='two' axis='1 0 0'/>{SOLID}"
        f"<body pos='0 .1 0' euler='0 .7 0'>{SOLID}</body>"
        "</body></body></body></body>",
    )
    assert_chain_moves_like(path, Robot.load(path))


def test_two_joints_of_one_body_follow_each_other(tmp_path):
    path = saved(
        tmp_path,
        "<body euler='.3 .1 0'><joint name='slide' type='slide' axis='1 0 1' ref='.2'/>"
        "<joint name='turn' axis='0 1 0' pos='.1 .2 .3' ref='-.7' armature='.3'/>"
        f"<joint name='roll' axis='1 0 0' pos='0 -.1 0'/>{SOLID}</body>",
    )
    robot = Robot.load(path)
    assert robot.joints == ("slide", "turn", "roll")
    assert robot.chain.revolute.tolist() == [False, True, True]
    assert robot.chain.armature.tolist() == [0, 0.3, 0]
    assert_chain_moves_like(path, robot)


def random_arm(seed, links):
    """MJCF of a random arm: any pose, joint kind, anchor and reference."""
    rng = np.random.default_rng(seed)

    def numbers(values):
        return " ".join(map(repr, map(float, np.atleast_1d(values))))

    body, end = "", ""
    for link in range(links):
        joints = "".join(
            f"<joint name='j{link}_{k}' type='{rng.choice(['hinge', 'slide'])}' "
            f"axis='{numbers(rng.normal(size=3))}' pos='{numbers(rng.normal(size=3))}' "
            f"ref='{numbers(rng.normal())}' armature='{numbers(rng.uniform())}'/>"
            for k in range(1 if link == 0 else rng.integers(3))
        )
        body += (
            f"<body pos='{numbers(rng.normal(size=3))}' "
            f"quat='{numbers(rng.normal(size=4))}'>{joints}"
            f"<geom type='ellipsoid' size='{numbers(rng.uniform(0.05, 0.2, 3))}' "
            f"pos='{numbers(rng.normal(size=3))}' "
            f"quat='{numbers(rng.normal(size=4))}'/>"
        )
        end += "</body>"
    gravity = numbers(rng.normal(scale=9.8, size=3))
    return body + end, f"<option gravity='{gravity}'/>"


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), links=st.integers(1, 4))
def test_any_mjcf_arm_moves_as_mujoco_moves_it(tmp_path_factory, seed, links):
    body, option = random_arm(seed, links)
    path = saved(tmp_path_factory.mktemp("arm"), body, around=option)
    assert_chain_moves_like(path, Robot.load(path))


def test_a_held_joint_stays_at_its_reference_or_where_it_is_told_to(tmp_path):
    path = saved(
        tmp_path,
        f"<body><joint name='one' axis='0 1 0' ref='.4'/>{SOLID}"
        "<body pos='.3 0 0'><joint name='two' axis='1 1 0' pos='0 .1 0' ref='.9'/>"
        "<joint name='far' type='slide' axis='0 0 1' ref='.3'/>"
        f"{SOLID}<body pos='0 0 .3'><joint name='three' axis='0 1 0'/>{SOLID}"
        "</body></body></body>",
    )
    whole = Robot.load(path)
    for held, still in (({}, (0.9, 0.3)), ({"far": -0.1}, (0.9, -0.1))):
        with pytest.warns(HybridWarning, match="one, three; other joints.*two … far"):
            robot = Robot.load(path, joints=("one", "three"), held=held)
        for q, v, a in states(2):
            wide = np.zeros((3, 4))
            wide[:, [0, 3]] = q, v, a
            wide[0, 1:3] = still
            truth = torque_in_pinocchio(whole.pinocchio(), *wide)[[0, 3]]
            assert_same_torque(torque_in_pinocchio(robot.pinocchio(), q, v, a), truth)


def test_degrees_and_defaults_are_read_as_mujoco_reads_them(tmp_path):
    path = tmp_path / "arm.mjcf"
    path.write_text(
        "<mujoco><default><joint damping='2' frictionloss='3' armature='4'/></default>"
        "<custom><numeric name='velocity_limit' data='5'/></custom><worldbody><body>"
        f"<joint range='-90 45'/>{SOLID}</body></worldbody></mujoco>"
    )
    robot = Robot.load(path)
    assert robot.joints == ("joint_1",)  # nameless in the file
    np.testing.assert_allclose(robot.q_min, -np.pi / 2)
    np.testing.assert_allclose(robot.q_max, np.pi / 4)
    assert (robot.damping, robot.frictionloss, robot.v_max) == (2, 3, 5)
    assert robot.chain.armature == 4
    assert np.isinf(robot.a_max) and np.isinf(robot.tau_max)


@pytest.mark.parametrize(
    ("joint", "motor", "limit"),
    [
        ("", "<motor joint='j' gear='50' forcerange='-2 2'/>", 100),
        ("", "<motor joint='j' gear='-50' ctrlrange='-1 2'/>", 100),
        ("", "<position joint='j' kp='9' ctrlrange='-1 1'/>", np.inf),
        ("actuatorfrcrange='-7 5'", "<motor joint='j' forcerange='-8 8'/>", 7),
        ("", "", np.inf),
    ],
)
def test_rated_torque_is_the_tightest_range_at_the_joint(tmp_path, joint, motor, limit):
    path = tmp_path / "arm.xml"
    path.write_text(
        f"<mujoco><worldbody><body><joint name='j' {joint}/>{SOLID}</body></worldbody>"
        f"<actuator>{motor}</actuator></mujoco>"
    )
    assert Robot.load(path).tau_max == limit


# --- what URDF can say --------------------------------------------------------------


def urdf(tmp_path, joint, *, extra="", head="<robot name='arm'>"):
    path = tmp_path / "arm.urdf"
    inertia = "<inertia ixx='.2' iyy='.3' izz='.4' ixy='.01' ixz='.02' iyz='.03'/>"
    inertial = (
        f"<inertial><origin xyz='.1 .2 .3'/><mass value='2'/>{inertia}</inertial>"
    )
    path.write_text(
        f"{head}<link name='a'/><link name='b'>{inertial}</link>{joint}{extra}</robot>"
    )
    return path


ENDS = "<parent link='a'/><child link='b'/><axis xyz='0 0 1'/>"
LIMIT = "<limit effort='9' velocity='2' lower='-1' upper='1' {}/>"


def test_rotors_and_accelerations_come_from_drakes_tags_declared_or_not(tmp_path):
    limit = LIMIT.format("drake:acceleration='7'")
    joint = f"<joint name='j' type='revolute'>{ENDS}{limit}</joint>"
    drive = (
        "<transmission name='t'><joint name='j'/><actuator name='m'>"
        "<drake:rotor_inertia value='1e-4'/><drake:gear_ratio value='100'/>"
        "</actuator></transmission>"
    )
    for space in ("", " xmlns:drake='https://drake.mit.edu/'"):
        head = f"<robot name='arm'{space}>"
        robot = Robot.load(urdf(tmp_path, joint, extra=drive, head=head))
        assert robot.a_max == 7
        assert robot.chain.armature == pytest.approx(1.0)
        rotor = robot.pinocchio()
        torque = torque_in_pinocchio(rotor, *np.array([[0.0], [0.0], [1.0]]))
        izz = 0.4 + 2 * (0.1**2 + 0.2**2)
        assert torque == pytest.approx(izz + 1.0)


def test_a_continuous_joint_has_no_position_limit_and_one_coordinate(tmp_path):
    joint = f"<joint name='j' type='continuous'>{ENDS}</joint>"
    robot = Robot.load(urdf(tmp_path, joint))
    assert (robot.q_min, robot.q_max) == (-np.inf, np.inf)
    assert robot.pinocchio().nq == 1


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_limits_of_zero_are_none(tmp_path, kind):
    """Exporters of CAD write them where none was given."""
    none = "<limit lower='0' upper='0' effort='0' velocity='0'/>"
    robot = Robot.load(
        urdf(tmp_path, f"<joint name='j' type='{kind}'>{ENDS}{none}</joint>")
    )
    assert (robot.q_min, robot.q_max) == (-np.inf, np.inf)
    assert (robot.v_max, robot.tau_max) == (np.inf, np.inf)


def test_a_prismatic_joint_carries_the_weight_of_its_link(tmp_path):
    joint = f"<joint name='j' type='prismatic'>{ENDS}{LIMIT.format('')}</joint>"
    robot = Robot.load(urdf(tmp_path, joint))
    assert not robot.chain.revolute[0]
    torque = torque_in_pinocchio(robot.pinocchio(), *np.zeros((3, 1)))
    assert torque == pytest.approx(2 * 9.81)


# --- what cannot be read ------------------------------------------------------------


def message_of(path, **options):
    """The error's text, which is one line that names the file."""
    with pytest.raises(RobotError) as caught:
        Robot.load(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert path.name in text
    return text


def mjcf(body, around="") -> str:
    return f"<mujoco>{around}<worldbody>{body}</worldbody></mujoco>"


def hinge(inside=SOLID, kind="hinge", name="j") -> str:
    return f"<body><joint name='{name}' type='{kind}'/>{inside}</body>"


ONE_AXIS = "valid are joints that turn or slide along one axis"
LIMITED = "<custom><numeric name='velocity_limit' data='1 2'/></custom>"
NO_ARM = {
    "a missing file": ("gone.urdf", None, "no such robot file"),
    # MuJoCo would read it, without the limits of its joints.
    "URDF by the ending of MJCF": (
        "arm.xml", '<?xml version="1.0"?><!-- an arm --><robot name="arm"/>',
        "valid is the ending .urdf",
    ),
    "an unknown ending": ("arm.sdf", "<sdf/>", ".urdf, .xml, .mjcf"),
    "no mass": ("arm.xml", mjcf(hinge("")), "mass and inertia of moving bodies"),
    "a free body": ("arm.xml", mjcf(hinge(kind="free")), f"{ONE_AXIS}; joint 'j' is"),
    "a ball": ("arm.xml", mjcf(hinge(kind="ball")), f"{ONE_AXIS}; joint 'j' is"),
    "a body without a joint": (
        "arm.xml", mjcf(f"<body>{SOLID}</body>"), "no movable joint",
    ),
    "limits of two joints": (
        "arm.xml", mjcf(hinge(), LIMITED),
        "'velocity_limit' has 2 values, one for each of the 1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_ARM)
def test_what_is_no_arm_is_refused_in_one_line(tmp_path, name):
    file, text, words = NO_ARM[name]
    if text is not None:
        (tmp_path / file).write_text(text)
    assert words in message_of(tmp_path / file)


@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
@pytest.mark.parametrize("text", ["", "<robot", "<robot name='x'>", "\xff\x00", "<a/>"])
def test_a_broken_file_is_one_readable_line(tmp_path, name, text, capfd):
    path = tmp_path / name
    path.write_text(text, encoding="latin-1")
    assert "not a readable" in message_of(path)
    capfd.readouterr()  # the URDF parser has its own say on the error stream


@pytest.mark.parametrize("kind", ["floating", "planar", "fixed"])
def test_a_joint_of_several_axes_or_of_none_in_urdf_is_refused(tmp_path, kind):
    path = urdf(tmp_path, f"<joint name='root' type='{kind}'>{ENDS}</joint>")
    text = message_of(path)
    assert "no movable joint" in text and ONE_AXIS in text
    assert ("joint 'root' is" in text) == (kind != "fixed")


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        (("hip",), "no joint hip; valid are shoulder, elbow"),
        ((), "valid are shoulder, elbow"),
    ],
)
def test_joints_that_are_none_list_those_of_the_file(joints, words):
    assert words in message_of(MODELS / "scara.xml", joints=joints)


def test_joints_on_two_branches_are_refused(tmp_path):
    path = saved(tmp_path, hinge(name="left") + hinge(name="right"))
    assert "not on the way to" in message_of(path, joints=("left", "right"))


# --- the object ---------------------------------------------------------------------


@pytest.mark.parametrize("name", ["coman_like.xml", "coman_like.urdf", "scara.xml"])
def test_a_robot_survives_json_bit_for_bit(name):
    robot = Robot.load(MODELS / name)
    content = robot.as_dict()
    again = Robot.from_dict(json.loads(json.dumps(content, allow_nan=False)))
    assert again.as_dict() == content
    assert (again.name, again.joints, again.path) == (robot.name, robot.joints, name)
    for field in LIMITS:
        np.testing.assert_array_equal(getattr(again, field), getattr(robot, field))
    for field in vars(robot.chain).keys() - {"joints"}:
        ours, theirs = getattr(again.chain, field), getattr(robot.chain, field)
        np.testing.assert_array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype


def test_missing_limits_survive_json(tmp_path):
    robot = Robot.load(saved(tmp_path, f"<body><joint/>{SOLID}</body>"))
    again = Robot.from_dict(json.loads(json.dumps(robot.as_dict(), allow_nan=False)))
    assert (again.q_min, again.q_max) == (-np.inf, np.inf)
    assert np.isinf([again.v_max, again.a_max, again.tau_max]).all()
    assert again == robot and len({again, robot}) == 1
    assert replace(robot, damping=robot.damping + 1) != robot != "planar"


@pytest.mark.parametrize("damage", ["chain", "name", "tau_max"])
def test_a_damaged_description_is_refused(damage):
    content = Robot.load(MODELS / "scara.xml").as_dict()
    with pytest.raises(RobotError, match="not a saved robot"):
        Robot.from_dict({k: x for k, x in content.items() if k != damage})


def test_a_description_of_the_wrong_size_is_refused():
    content = Robot.load(MODELS / "scara.xml").as_dict()
    with pytest.raises(RobotError, match="damping needs one value for each"):
        Robot.from_dict(content | {"damping": [1.0]})


def test_a_fingerprint_tells_kinematics_apart_and_nothing_else():
    robot = Robot.load(MODELS / "coman_like.xml")
    heavier = robot.with_inertial(2 * robot.chain.inertial)
    assert heavier.fingerprint() == robot.fingerprint()
    np.testing.assert_array_equal(heavier.chain.inertial, 2 * robot.chain.inertial)
    assert Robot.load(MODELS / "scara.xml").fingerprint() != robot.fingerprint()
    content = robot.as_dict()
    content["chain"]["joints"] = content["chain"]["joints"][::-1]
    assert Robot.from_dict(content).fingerprint() != robot.fingerprint()
    content = robot.as_dict()
    content["chain"]["translation"][2][0] += 1e-4
    assert Robot.from_dict(content).fingerprint() != robot.fingerprint()


def test_a_joint_is_found_by_name_and_by_number():
    robot = Robot.load(MODELS / "coman_like.xml")
    assert robot.joint_index("elbow") == robot.joint_index("3") == 2
    assert robot.joint_index(3) == 2
    for wrong in ("hip", "0", "7", 0, -1):
        with pytest.raises(RobotError, match="valid are base, shoulder"):
            robot.joint_index(wrong)


def test_a_link_that_weighs_nothing_can_be_simulated():
    robot = Robot.load(MODELS / "coman_like.xml")
    inertial = robot.chain.inertial.copy()
    inertial[3] = 0
    light = robot.with_inertial(inertial)
    built, ours = rigid(light.mujoco_spec().compile()), light.pinocchio()
    for q, v, a in states(6):
        truth = torque_in_pinocchio(ours, q, v, a)
        assert_same_torque(torque_in_mujoco(built, q, v, a), truth, SPECK)


def test_a_link_of_negative_mass_cannot_be_simulated():
    robot = Robot.load(MODELS / "coman_like.xml")
    inertial = robot.chain.inertial.copy()
    inertial[3, 0] = -1
    with pytest.raises(RobotError, match="'wrist_1' has no physical inertia"):
        robot.with_inertial(inertial).mujoco_spec()


@given(seed=st.integers(0, 2**32 - 1))
def test_ten_parameters_go_back_to_mass_centre_and_central_inertia(seed):
    rng = np.random.default_rng(seed)
    mass, center = rng.uniform(0.1, 10), rng.normal(size=3)
    root = rng.normal(size=(3, 3))
    inertia = root @ root.T
    back = central_inertia(inertial_about(mass, center, inertia))
    for ours, theirs in zip(back, (mass, center, inertia), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-10)
