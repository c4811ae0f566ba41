"""What a robot file declares is in the arm's torque, or the file is refused by name."""

import warnings
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from arms import MODELS
from coarse import Plant, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import arm

from hybrid.dynamics import inverse_dynamics
from hybrid.errors import HybridWarning, RobotError
from hybrid.exports import model_simulator
from hybrid.identification import identify
from hybrid.robot import Robot
from hybrid.robot.chain import Chain
from hybrid.robot.geometry import capsules_from_robot

SOLID = "<inertial mass='2' pos='.1 .02 .03' diaginertia='.02 .03 .04'/>"
MORE = "<geom type='box' size='.05 .03 .02' pos='.02 0 .01'/>"


def mjcf(first="", second="", *, after="", world="", option="", link=SOLID) -> str:
    """Two hinges; ``after`` stands behind the world, ``world`` in it."""
    return (
        f"<mujoco><compiler angle='radian'/>{option}<worldbody>{world}"
        f"<body name='upper'><joint name='a' axis='0 1 0' {first}/>{SOLID}"
        f"<body name='lower' pos='.3 0 0'><joint name='b' axis='0 1 .2' {second}/>"
        f"{link}</body></body></worldbody>{after}</mujoco>"
    )


def model_of(text) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(text)


def load(text, **options) -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # held joints
        return Robot.load(model_of(text), **options)


def refusal(text, **options) -> str:
    with pytest.raises(RobotError) as caught:
        load(text, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def states(n, count=20):
    rng = np.random.default_rng(0)
    return rng.uniform(-1.5, 1.5, (3, count, n))


def torque(robot, q, v, a):
    """The arm's torque as all verbs compute it, without dry friction."""
    chain = replace(robot.chain, armature=np.zeros(robot.size))
    return inverse_dynamics(chain, chain.inertial, q, v, a) + robot.joint_torque(
        q, v, a
    )


def torque_in_mujoco(model, q, v, a, joints, start=None):
    """MuJoCo's own torque at some joints, without contact, limits and dry friction."""
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
    model.dof_frictionloss[:] = model.tendon_frictionloss[:] = 0
    data = mujoco.MjData(model)
    index = [model.joint(name).id for name in joints]
    dofs, at = model.jnt_dofadr[index], model.jnt_qposadr[index]
    found = []
    for k in range(len(q)):
        data.qpos[:] = model.qpos0 if start is None else start
        data.qpos[at], data.qvel[dofs], data.qacc[dofs] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[dofs])
    return np.array(found)


def assert_as_mujoco(text, robot, start=None):
    q, v, a = states(robot.size)
    truth = torque_in_mujoco(model_of(text), q, v, a, robot.joints, start)
    np.testing.assert_allclose(torque(robot, q, v, a), truth, rtol=0, atol=1e-9)
    spec = robot.mujoco_spec().compile()
    again = torque_in_mujoco(spec, q, v, a, robot.joints)
    np.testing.assert_allclose(again, truth, rtol=0, atol=1e-9)


def hose(numbers, length=".4", coef=-2.0, joint="b", name="t"):
    """A tendon that pulls as a stiffening spring."""
    return (
        f"<tendon><fixed name='{name}' stiffness='{numbers}' springlength='{length}'>"
        f"<joint joint='{joint}' coef='{coef}'/></fixed></tendon>"
    )


SPRING = "stiffness='30' springref='.4'"
MOTOR = (
    "<actuator><motor joint='b' gear='20' armature='1e-4' damping='1e-3'/></actuator>"
)
MODELLED = {
    "springs": mjcf(SPRING, "stiffness='5' damping='.3' frictionloss='.2'"),
    "a reference": mjcf(SPRING + " ref='.7'", "ref='-.3'"),
    "friction in a curve": mjcf("damping='.5 .2 .1'", "damping='0 0 .3'"),
    "rotors and geared motors": mjcf("armature='.3'", after=MOTOR),
    "no weight": mjcf(option="<option><flag gravity='disable'/></option>"),
    "no springs": mjcf(SPRING, option="<option><flag spring='disable'/></option>"),
    "no dampers": mjcf(
        "damping='.5 .2'", option="<option><flag damper='disable'/></option>"
    ),
    "a tendon without force": mjcf(
        after="<tendon><fixed name='t'><joint joint='a' coef='1'/></fixed></tendon>"
    ),
    "a rotor on the sum of two joints": mjcf(
        after="<tendon><fixed armature='.3' damping='.5' frictionloss='.2'>"
        "<joint joint='b' coef='-.5'/><joint joint='a' coef='-.5'/></fixed></tendon>"
    ),
    "a hose": mjcf(SPRING, "ref='-.3'", after=hose("3 0 2")),
    "two hoses": mjcf(after=hose("3 0 2") + hose("1 0 .3", joint="a", name="u")),
    "no hose": mjcf(
        option="<option><flag spring='disable'/></option>", after=hose("3 0 2")
    ),
    "an equality that is off": mjcf(
        after="<equality><joint joint1='a' joint2='b' active='false'/></equality>"
    ),
}


@pytest.mark.parametrize("name", MODELLED)
def test_what_is_modelled_gives_the_torque_of_mujoco(name):
    assert_as_mujoco(MODELLED[name], load(MODELLED[name]))


@settings(max_examples=20)
@given(numbers=st.lists(st.floats(0, 40), min_size=8, max_size=8))
def test_any_springs_and_dampers_give_the_torque_of_mujoco(numbers):
    text = mjcf(
        "stiffness='{}' springref='{}' damping='{} {}'".format(*numbers[:4]),
        "stiffness='{}' ref='{}' damping='{} 0 {}'".format(*numbers[4:]),
    )
    robot = load(text)
    q, v, a = states(2)
    truth = torque_in_mujoco(model_of(text), q, v, a, robot.joints)
    np.testing.assert_allclose(torque(robot, q, v, a), truth, rtol=1e-9, atol=1e-9)


def test_a_spring_gives_back_the_energy_that_it_takes():
    robot = load(mjcf(SPRING))
    phase = np.linspace(0, 2 * np.pi, 2001)
    q = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    still = np.zeros_like(q)
    pull = robot.joint_torque(q, still, still)
    work = np.sum((pull[1:] + pull[:-1]) / 2 * np.diff(q, axis=0))
    assert abs(work) < 1e-9
    stored = 0.5 * 30 * ((q[500, 0] - 0.4) ** 2 - (q[0, 0] - 0.4) ** 2)
    half = np.sum((pull[1:501] + pull[:500]) / 2 * np.diff(q[:501], axis=0))
    assert half == pytest.approx(stored, rel=1e-9)


def test_friction_of_a_file_resists_either_way_alike():
    robot = load(mjcf("damping='.5 .2 .1' frictionloss='.3'"))
    v = np.array([[0.7, 0.2]])
    zero = np.zeros_like(v)
    back = robot.joint_torque(zero, -v, zero)
    np.testing.assert_allclose(back, -robot.joint_torque(zero, v, zero))


def test_dry_friction_of_a_common_rotor_follows_the_sum_of_the_speeds():
    robot = load(MODELLED["a rotor on the sum of two joints"])
    friction = robot.dry_friction(np.array([[2.0, -1.0], [1.0, -2.0]]))
    np.testing.assert_allclose(friction, [[0.1, 0.1], [-0.1, -0.1]])


def test_a_common_rotor_of_the_file_is_simulated_and_identified():
    planar = Robot.load(MODELS / "planar.xml")
    robot = replace(planar, coupled=np.array([[0, 1, 0.1, 1.0, 0.5]]))
    logs = simulate(robot, trajectories=3, duration=5.0, seed=0)
    model = identify(robot, logs, stages=("rigid",)).model
    (rotor,) = [e for e in model.effects if e.joints == (0, 1)]
    assert rotor.values["viscous"] == pytest.approx(1.0, rel=0.1)
    assert rotor.values["coulomb"] == pytest.approx(0.5, rel=0.1)


def test_a_rotor_on_the_difference_of_two_joints_is_refused():
    rotor = f"<fixed name='t' armature='.1'>{ELASTIC}</fixed>"
    text = mjcf(after=f"<tendon>{rotor}</tendon>")
    assert "tendon 't' acts on the arm and is not modelled" in refusal(text)


def test_weight_that_the_file_takes_off_every_link_is_off_the_drives():
    text = mjcf().replace("<body name", "<body gravcomp='.75' name")
    with pytest.warns(HybridWarning, match="gravcomp of the file takes 75% of"):
        robot = Robot.load(model_of(text))
    np.testing.assert_allclose(robot.chain.gravity, [0, 0, -9.81 / 4])
    assert_as_mujoco(text, robot)


def test_weight_that_the_drives_carry_for_the_user_is_on_the_drives():
    text = mjcf("actuatorgravcomp='true'", "actuatorgravcomp='true'")
    text = text.replace("<body name", "<body gravcomp='1' name")
    robot = load(text)
    np.testing.assert_allclose(robot.chain.gravity, [0, 0, -9.81])
    assert_as_mujoco(text, robot)


ELASTIC = "<joint joint='a' coef='1'/><joint joint='b' coef='-1'/>"
SITE = "<site name='wall' pos='0 0 1'/>"
REFUSED = {
    "tendon 't'": mjcf(
        after=f"<tendon><fixed name='t' stiffness='3'>{ELASTIC}</fixed></tendon>"
    ),
    "tendon 'quadratic'": mjcf(after=hose("3 1 2", name="quadratic")),
    "tendon 'slack'": mjcf(after=hose("3 0 2", length=".1 .3", name="slack")),
    "tendon 'cubic'": mjcf(after=hose("0 0 2", name="cubic")),
    "tendon 'rope'": mjcf(
        world=SITE,
        link=SOLID + "<site name='tip' pos='.3 0 0'/>",
        after="<tendon><spatial name='rope' damping='2'><site site='wall'/>"
        "<site site='tip'/></spatial></tendon>",
    ),
    "equality 'pair'": mjcf(
        after="<equality><joint name='pair' joint1='a' joint2='b'/></equality>"
    ),
    "equality 'loop'": mjcf(
        after="<equality><connect name='loop' body1='lower' anchor='.1 0 0'/>"
        "</equality>"
    ),
    "gravcomp of body 'lower'": mjcf().replace(
        "<body name='lower'", "<body gravcomp='1' name='lower'"
    ),
    "the fluid of option": mjcf(option="<option density='1000'/>"),
    "nonlinear stiffness of joint 'a'": mjcf("stiffness='1 2'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_modelled_is_refused_by_its_name(name):
    assert f"{name} acts on the arm and is not modelled" in refusal(REFUSED[name])


def test_what_acts_on_held_joints_alone_is_no_reason_to_refuse():
    fingers = "".join(
        f"<body name='{x}'><joint name='{x}' type='slide' axis='0 1 0'/>{SOLID}</body>"
        for x in ("left", "right")
    )
    text = mjcf(
        link=SOLID + fingers,
        after="<equality><joint joint1='left' joint2='right'/></equality>",
    )
    robot = load(text)
    assert robot.joints == ("a", "b")
    assert_as_mujoco(text, robot)
    assert "equality 0 acts on the arm" in refusal(text, joints=("a", "b", "left"))


# --- links without a body -----------------------------------------------------------


MESHES = "<asset><mesh name='m' file='gone.stl'/><texture name='p' type='2d' "
MESHES += "file='gone.png'/><hfield name='h' file='gone.png' size='1 1 1 1'/></asset>"
SHELL = "<geom type='mesh' mesh='m'/>"


def saved(tmp_path, text, name="arm.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_meshes_are_not_needed_where_links_have_inertias(tmp_path):
    floor = "<geom type='hfield' hfield='h'/>"
    bare = mjcf(link=SOLID)
    meshed = mjcf(link=SOLID + SHELL, option=MESHES, world=floor)
    robot = Robot.load(saved(tmp_path, meshed))
    assert_as_mujoco(bare, robot)
    spec = Robot.load(mujoco.MjSpec.from_string(meshed))
    np.testing.assert_array_equal(spec.chain.inertial, robot.chain.inertial)


def test_a_scene_loads_without_the_meshes_of_what_it_includes(tmp_path):
    saved(tmp_path, mjcf(link=SOLID + SHELL, option=MESHES))
    scene = "<mujoco><include file='arm.xml'/></mujoco>"
    robot = Robot.load(saved(tmp_path, scene, "scene.xml"))
    assert_as_mujoco(mjcf(), robot)


def test_an_inertia_that_a_missing_mesh_would_have_to_give_is_refused(tmp_path):
    text = mjcf(link=SHELL, option=MESHES)
    with pytest.raises(RobotError) as caught:
        Robot.load(saved(tmp_path, text))
    assert "link 'lower' has no inertia of its own, and its mesh 'gone.stl'" in str(
        caught.value
    )
    light = mjcf(link=MORE + SHELL.replace("/>", " mass='0'/>"), option=MESHES)
    robot = Robot.load(saved(tmp_path, light))
    assert_as_mujoco(mjcf(link=MORE), robot)


def urdf(*, mass="2", inertia=("1", "1", "1"), extra="", tags="") -> str:
    ixx, iyy, izz = inertia
    body = "" if mass is None else (
        f"<inertial><mass value='{mass}'/><inertia ixx='{ixx}' iyy='{iyy}' izz='{izz}' "
        "ixy='0' ixz='0' iyz='0'/></inertial>"
    )  # fmt: skip
    own = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0'"
    own += " iyz='0'/></inertial>"
    limit = "<limit effort='9' velocity='2' lower='-1' upper='1'/><axis xyz='0 1 0'/>"
    return (
        f"<robot name='r'><link name='base'/><link name='upper'>{own}</link>"
        f"<link name='lower'>{body}</link>"
        "<joint name='a' type='revolute'><parent link='base'/><child link='upper'/>"
        f"{limit}</joint><joint name='b' type='revolute'><parent link='upper'/>"
        f"<child link='lower'/><origin xyz='.3 0 0'/>{limit}{tags}</joint>{extra}"
        "</robot>"
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"mass": None}, "link 'lower' moves and has no inertia"),
        ({"mass": "-1"}, "link 'lower' has no physical inertia (mass -1 kg"),
        ({"inertia": ("1", "1", "3")}, "link 'lower' has no physical inertia"),
        ({"inertia": ("-1", "1", "1")}, "link 'lower' has no physical inertia"),
        ({"mass": "nan"}, "value of mass in 'inertial' is 'nan'"),
    ],
)
def test_a_link_that_could_not_be_built_is_refused_by_its_name(
    tmp_path, wrong, message
):
    with pytest.raises(RobotError) as caught:
        Robot.load(saved(tmp_path, urdf(**wrong), "arm.urdf"))
    assert message in str(caught.value)


@pytest.mark.parametrize("mass", [-1.0, np.nan])
def test_a_link_of_mujocos_model_that_could_not_be_built_is_refused(mass):
    model = model_of(mjcf())
    model.body("lower").mass[:] = mass
    with pytest.raises(RobotError, match="link 'lower' has no physical inertia"):
        Robot.load(model)


def test_rounded_inertias_of_a_thin_rod_are_a_body(tmp_path):
    rod = urdf(inertia=("0.333333", "0.333334", "0.0000005"))
    robot = Robot.load(saved(tmp_path, rod, "arm.urdf"))
    assert robot.mujoco_spec().compile().nv == 2


# --- couplings and springs of URDF --------------------------------------------------


def test_a_joint_that_follows_another_is_refused_in_the_arm_and_held_off_it(tmp_path):
    tags = "<mimic joint='a' multiplier='-2' offset='.1'/>"
    path = saved(tmp_path, urdf(tags=tags), "arm.urdf")
    for joints in (("a", "b"), ("a",), None):
        with (
            pytest.raises(RobotError, match="follows joint 'a'"),
            warnings.catch_warnings(action="ignore", category=HybridWarning),
        ):
            Robot.load(path, joints=joints)


def test_a_follower_stands_where_the_held_joint_before_it_has_it(tmp_path):
    tags = "<mimic joint='b' multiplier='-2' offset='.1'/>"
    mount = "<joint name='c' type='revolute'><parent link='base'/><child link='tool'/>"
    mount += "<axis xyz='0 1 0'/><limit effort='9' velocity='2' lower='-1' upper='1'/>"
    body = urdf().split("<link name='upper'>")[1].split("</link>")[0]
    extra = f"{mount}{tags}</joint><link name='tool'>{body}</link>"
    extra += f"{mount.replace(chr(39) + 'c', chr(39) + 'd').replace('base', 'tool')}"
    extra = extra.replace("child link='tool'/>", "child link='tip'/>").replace(
        "child link='tip'/>", "child link='tool'/>", 1
    )
    extra += f"</joint><link name='tip'>{body}</link>"
    path = saved(tmp_path, urdf(extra=extra), "arm.urdf")
    with pytest.warns(HybridWarning, match="the arm is d; .* b at 0.3"):
        robot = Robot.load(path, joints=("d",), held={"b": 0.3})
    assert robot.held["c"] == pytest.approx(-0.5)
    turn = robot.chain.rotation[0]
    assert np.arctan2(turn[0, 2], turn[0, 0]) == pytest.approx(-0.5)


def test_a_spring_of_gazebos_tags_is_one_of_the_arm(tmp_path):
    tag = "<gazebo reference='b'><springStiffness>7</springStiffness>"
    tag += "<springReference>.2</springReference></gazebo>"
    robot = Robot.load(saved(tmp_path, urdf(extra=tag), "arm.urdf"))
    assert robot.stiffness.tolist() == [0, 7]
    still = np.zeros((1, 2))
    np.testing.assert_allclose(robot.joint_torque(still, still, still), [[0, -1.4]])


# --- objects, bases and trees -------------------------------------------------------


def test_a_model_of_mujoco_is_the_arm_of_its_file_and_stays_as_it_was(tmp_path):
    text = mjcf(SPRING, "frictionloss='.3'")
    path = saved(tmp_path, text)
    model, spec = model_of(text), mujoco.MjSpec.from_string(text)
    before = spec.to_xml()
    expected = Robot.load(path).as_dict() | {"path": "", "name": ""}
    assert Robot.load(model).as_dict() | {"name": ""} == expected
    assert Robot.load(spec).as_dict() | {"name": ""} == expected
    assert spec.to_xml() == before
    assert model.opt.disableflags == 0 and model.dof_frictionloss.any()


def test_a_model_of_pinocchio_is_the_arm_of_its_file(tmp_path):
    path = saved(tmp_path, urdf(), "arm.urdf")
    tree = pin.buildModelFromUrdf(str(path))
    assert Robot.load(tree).as_dict() == Robot.load(path).as_dict() | {"path": ""}
    free = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    with pytest.warns(HybridWarning, match="held where the file has them .root_joint"):
        robot = Robot.load(free)
    assert robot.joints == ("a", "b")


def test_a_link_of_pinocchio_that_has_no_name_is_refused_by_its_joint():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "a")
    with pytest.raises(RobotError, match="link 'a' moves and has no inertia"):
        Robot.load(model)
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    assert Robot.load(model).size == 1


def test_what_is_no_robot_says_what_is():
    with pytest.raises(RobotError, match=r"builtins.int is no robot; .*mujoco.MjModel"):
        Robot.load(3)


def test_a_base_that_floats_is_held_where_the_file_has_it():
    text = mjcf(SPRING).replace(
        "<body name='upper'>",
        "<body pos='0 0 1' euler='.3 .4 0'><freejoint name='root'/>"
        f"{SOLID}<body name='upper'>",
    )
    text = text.replace("</worldbody>", "</body></worldbody>")
    with pytest.warns(HybridWarning, match="held where the file has them .root"):
        robot = Robot.load(model_of(text))
    assert_as_mujoco(text, robot)


def two_arms() -> str:
    """A torso that slides, and two arms of two joints on it."""

    def arm(side, y):
        return (
            f"<body name='{side}' pos='0 {y} 0'><joint name='{side}_1' axis='0 1 0'/>"
            f"{SOLID}<body pos='.3 0 0'><joint name='{side}_2' axis='0 1 0' "
            f"stiffness='4'/>{SOLID}</body></body>"
        )

    return (
        "<mujoco><compiler angle='radian'/><worldbody><body name='torso' pos='0 0 1'>"
        f"<joint name='tilt' axis='0 1 0'/>{SOLID}"
        f"{arm('left', 0.2)}{arm('right', -0.2)}</body></worldbody></mujoco>"
    )


def test_the_first_of_two_arms_is_taken_and_the_other_one_named():
    with pytest.warns(HybridWarning, match="tilt, left_1, left_2; .*right_1 … right_2"):
        robot = Robot.load(model_of(two_arms()))
    assert robot.joints == ("tilt", "left_1", "left_2")


def test_an_arm_of_a_tree_moves_as_it_does_where_the_rest_is_held():
    text, held = two_arms(), {"tilt": 0.6, "left_2": -0.4}
    robot = load(text, joints=("right_1", "right_2"), held=held)
    start = np.zeros(5)
    model = model_of(text)
    for name, x in held.items():
        start[model.joint(name).qposadr] = x
    assert_as_mujoco(text, robot, start)
    assert Robot.from_dict(robot.as_dict()).held == held


@pytest.mark.parametrize("kind", ["xml", "urdf"])
def test_what_a_held_joint_carries_is_where_it_is_held(tmp_path, kind):
    ball = "<geom type='sphere' size='.05' mass='1'/>"
    body = f"<body><joint name='slide' type='slide' axis='1 0 0'/>{ball}</body>"
    text = mjcf(link=SOLID + body)
    if kind == "urdf":
        shape = "<collision><geometry><sphere radius='.05'/></geometry></collision>"
        link = urdf().split("<link name='upper'>")[1].split("</link>")[0]
        text = urdf(
            extra="<joint name='slide' type='prismatic'><parent link='lower'/>"
            "<child link='ball'/><axis xyz='1 0 0'/><limit effort='9' velocity='2' "
            f"lower='-1' upper='1'/></joint><link name='ball'>{link}{shape}</link>"
        )
    path = saved(tmp_path, text, f"arm.{kind}")
    with pytest.warns(HybridWarning, match="slide at 0.25"):
        robot = Robot.load(path, joints=("a", "b"), held={"slide": 0.25})
    (ends,) = capsules_from_robot(robot).ends
    np.testing.assert_allclose(ends, [[0.25, 0, 0]] * 2, atol=1e-12)


def test_a_joint_of_the_arm_or_of_none_cannot_be_held():
    for name in ("left_1", "hip"):
        with pytest.raises(
            RobotError, match=f"cannot hold {name}; valid are joints off"
        ):
            load(two_arms(), joints=("left_1", "left_2"), held={name: 0.1})


def test_an_arm_with_a_ball_in_it_is_refused_and_the_arm_behind_it_is_one():
    ball = "<body pos='.1 0 0'><joint name='hip' type='ball'/>"
    text = mjcf().replace("<body name='lower'", f"{ball}{SOLID}<body name='lower'")
    text = text.replace(
        "</body></body></worldbody>", "</body></body></body></worldbody>"
    )
    assert "joint 'hip' is a ball and lies within the arm (a, b)" in refusal(text)
    assert_as_mujoco(text, load(text, joints=("b",)))


def test_an_older_description_without_springs_reads_as_an_arm_without():
    robot = load(mjcf())
    content = robot.as_dict()
    for name in ("quadratic", "cubic", "stiffness", "springref", "held"):
        del content[name]
    assert Robot.from_dict(content).as_dict() == robot.as_dict()
    assert isinstance(robot.chain, Chain)


@pytest.mark.filterwarnings("ignore::hybrid.errors.HybridWarning")  # stages left out
def test_springs_and_curves_of_a_file_are_identified_and_exported(tmp_path):
    real = replace(
        arm("planar"),
        stiffness=np.array([12.0, 4.0]),
        springref=np.array([0.5, -0.3]),
        quadratic=np.array([0.0, 0.4]),
    )
    file = replace(real, stiffness=np.array([9.0, 5.0]))
    logs = simulate(Plant(real, [], nominal=real), trajectories=3, duration=5.0, seed=1)
    fit = identify(file, logs, stages=("rigid",), consistent=True)
    made = model_simulator(fit.model)
    assert not made.notes
    again = Robot.load(saved(tmp_path, made.text.decode()))
    np.testing.assert_allclose(again.stiffness, real.stiffness, rtol=0.02)
    np.testing.assert_allclose(again.springref, real.springref, atol=0.01)
    friction = again.joint_torque(again.springref, np.array([0.0, 1.0]), np.zeros(2))
    declared = real.joint_torque(real.springref, np.array([0.0, 1.0]), np.zeros(2))
    np.testing.assert_allclose(friction, declared, atol=0.1)
    left = model_simulator(fit.model, kind="urdf").notes
    assert not any(x.startswith("spring") for x in left)  # Gazebo has tags for them


def test_a_refusal_names_the_file_or_else_the_arm(tmp_path):
    text = REFUSED["equality 'pair'"].replace("<mujoco>", "<mujoco model='two'>")
    assert refusal(text).startswith("two: equality 'pair' acts")
    path = saved(tmp_path, text, "arm.xml")
    with pytest.raises(RobotError) as caught:
        Robot.load(path)
    assert str(caught.value).startswith(f"{path}: equality 'pair' acts")


def test_a_name_of_mjcf_that_is_not_utf_8_is_refused_with_its_file(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_bytes(mjcf().replace("'lower'", "'l\xf6wer'").encode("latin-1"))
    with pytest.raises(RobotError, match="arm.xml: .*not UTF-8"):
        Robot.load(path)
