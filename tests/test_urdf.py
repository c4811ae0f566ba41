"""URDF files are read as pinocchio reads them, and what is none is refused by name."""

import sys
import warnings

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.errors import HybridError, HybridWarning, RobotError
from hybrid.robot import Robot
from hybrid.robot.geometry import capsules_from_robot
from hybrid.robot.library import _examples

CLOSE = 1e-12  # of the largest torque


def load(path) -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        return Robot.load(path)


def torque_of_the_whole_file(model, robot, q, v, a):
    """Pinocchio's torque at the arm's joints; all others are where the arm holds them.

    A continuous joint has two coordinates there.
    """
    position, speed, acceleration = pin.neutral(model), *np.zeros((2, model.nv))

    def put(name, angle):
        j = model.getJointId(name)
        at, two = model.idx_qs[j], [np.cos(angle), np.sin(angle)]
        position[at : at + model.nqs[j]] = two if model.nqs[j] == 2 else angle

    for name, angle in robot.held.items():
        put(name, angle)
    for name, angle in zip(robot.joints, q, strict=True):
        put(name, angle)
    dofs = [model.idx_vs[model.getJointId(name)] for name in robot.joints]
    speed[dofs], acceleration[dofs] = v, a
    return pin.rnea(model, model.createData(), position, speed, acceleration)[dofs]


def assert_read_as_pinocchio_reads_it(model, robot, relative=CLOSE):
    n, dofs = robot.size, [model.idx_vs[model.getJointId(x)] for x in robot.joints]
    states = np.random.default_rng(0).uniform(-2.0, 2.0, (3, 5, n))
    own = robot.pinocchio()
    own.armature[:] = 0.0
    rows = states.transpose(1, 0, 2)
    theirs = np.array([torque_of_the_whole_file(model, robot, *x) for x in rows])
    ours = np.array([pin.rnea(own, own.createData(), *x) for x in rows])
    size = max(1.0, np.abs(theirs).max())
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=relative * size)
    np.testing.assert_array_equal(robot.damping, model.damping[dofs])
    np.testing.assert_array_equal(robot.frictionloss, model.upperDryFrictionLimit[dofs])
    for ours, theirs in (
        (robot.v_max, model.upperVelocityLimit),
        (robot.tau_max, model.upperEffortLimit),
    ):
        none = theirs[dofs] <= 0
        np.testing.assert_array_equal(np.where(none, np.inf, theirs[dofs]), ours)
    for name, low, high in zip(robot.joints, robot.q_min, robot.q_max, strict=True):
        j = model.getJointId(name)
        at = model.idx_qs[j]
        theirs = model.lowerPositionLimit[at], model.upperPositionLimit[at]
        endless = model.nqs[j] == 2 or theirs == (0, 0)
        assert (low, high) == ((-np.inf, np.inf) if endless else theirs)


# --- every file of a collection -----------------------------------------------------

EXAMPLES = _examples()
# No serial arm: no inertia where something moves, no body that could be, no joint.
REFUSED = {"human", "romeo_laas_small", "iris_simple", "quadrotor_base"}


@pytest.mark.skipif(not EXAMPLES, reason="needs example-robot-data")
@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - REFUSED))
def test_an_arm_of_a_collection_has_the_torque_and_the_limits_of_its_file(name):
    model = pin.buildModelFromUrdf(str(EXAMPLES[name]))
    assert_read_as_pinocchio_reads_it(model, load(EXAMPLES[name]))


@pytest.mark.skipif(not EXAMPLES, reason="needs example-robot-data")
@pytest.mark.parametrize("name", sorted(REFUSED & set(EXAMPLES)))
def test_a_file_of_a_collection_without_an_arm_is_refused(name):
    with pytest.raises(RobotError, match="no inertia|no physical|no movable"):
        load(EXAMPLES[name])


# --- any tree -----------------------------------------------------------------------


def link(name, inertial="") -> str:
    return f"<link name='{name}'>{inertial}</link>"


def joint(name, parent, child, kind="revolute", inner="") -> str:
    limit = "<limit effort='9' velocity='2' lower='-1' upper='1'/>"
    return (
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/>"
        f"<child link='{child}'/>{limit if kind != 'fixed' else ''}{inner}</joint>"
    )


def robot_of(*parts) -> str:
    return f"<robot name='r'>{''.join(parts)}</robot>"


def numbers(values) -> str:
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))


def origin(rng) -> str:
    if rng.uniform() < 0.2:
        return ""
    xyz, rpy = map(numbers, rng.normal(size=(2, 3)))
    return f"<origin xyz='{xyz}' rpy='{rpy}'/>"


def inertial(rng) -> str:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    a, b, c = rng.uniform(0.01, 0.1, 3)
    about = turn @ np.diag([a + b, b + c, c + a]) @ turn.T
    words = " ".join(
        f"i{'xyz'[r]}{'xyz'[c]}='{numbers(about[r, c])}'"
        for r in range(3)
        for c in range(r, 3)
    )
    mass = f"<mass value='{numbers(rng.uniform(0.1, 3.0))}'/>"
    return f"<inertial>{origin(rng)}{mass}<inertia {words}/></inertial>"


def random_tree(seed, size) -> str:
    """Links on any of those before them, by joints of any kind and any axis."""
    rng = np.random.default_rng(seed)
    parts = [link("l0", inertial(rng))]
    for k in range(1, size + 1):
        kind = rng.choice(["revolute", "continuous", "prismatic", "fixed"])
        inner = origin(rng)
        if rng.uniform() < 0.8:
            inner += f"<axis xyz='{numbers(rng.normal(size=3))}'/>"
        damping, friction = map(numbers, rng.uniform(size=2))
        inner += f"<dynamics damping='{damping}' friction='{friction}'/>"
        parts.append(link(f"l{k}", inertial(rng)))
        name, parent = f"j{rng.integers(10**6)}_{k}", f"l{rng.integers(k)}"
        kind = "revolute" if k == 1 else str(kind)
        parts.append(joint(name, parent, f"l{k}", kind, inner))
    return robot_of(*rng.permutation(parts))


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 7))
def test_any_tree_is_read_as_pinocchio_reads_it(tmp_path_factory, seed, size):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(random_tree(seed, size))
    assert_read_as_pinocchio_reads_it(pin.buildModelFromUrdf(str(path)), load(path))


# --- what is no tree ----------------------------------------------------------------

BODY = "<inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' "
BODY += "iyz='0'/></inertial>"
A, B, C = (link(x, BODY) for x in "abc")
FAULTS = {
    "two links of a name": (robot_of(A, B, B, joint("j", "a", "b")), "<link> two have"),
    "a link without": (robot_of(A, B, "<link/>", joint("j", "a", "b")), "one has no"),
    "two joints of a name": (
        robot_of(A, B, C, joint("j", "a", "b"), joint("j", "b", "c")),
        "<joint> two have the name 'j'",
    ),
    "no such parent": (
        robot_of(A, B, joint("j", "gone", "b")),
        "joint 'j': there is no link 'gone'",
    ),
    "no parent": (
        robot_of(A, B, "<joint name='j' type='revolute'><child link='b'/></joint>"),
        "parent of 'joint j' has no link",
    ),
    "two parents": (
        robot_of(A, B, C, joint("j", "a", "c"), joint("k", "b", "c")),
        "link 'c' is the child of two joints",
    ),
    "two roots": (robot_of(A, B, C, joint("j", "a", "b")), "a parent: 'a', 'c'"),
    "no root": (
        robot_of(A, B, joint("j", "a", "b"), joint("k", "b", "a")),
        "without a parent: none",
    ),
    "a loop": (
        robot_of(A, B, C, joint("j", "b", "c"), joint("k", "c", "b")),
        "in a loop of joints",
    ),
    "no type": (
        robot_of(A, B, joint("j", "a", "b", kind="hinge")),
        "joint 'j' is of type 'hinge'; valid are revolute",
    ),
    "no limit": (
        robot_of(A, B, joint("j", "a", "b").replace("limit", "limits")),
        "joint 'j' is revolute and has no <limit>",
    ),
    "no axis": (
        robot_of(A, B, joint("j", "a", "b", inner="<axis xyz='0 0 0'/>")),
        "axis of joint 'j' has no direction",
    ),
    "two numbers": (
        robot_of(A, B, joint("j", "a", "b", inner="<origin xyz='1 2'/>")),
        "xyz of origin in 'joint j' has 2 numbers; valid are 3",
    ),
    "a word": (
        robot_of(A, B, joint("j", "a", "b", inner="<origin rpy='0 left 0'/>")),
        "rpy of origin in 'joint j' is 'left'; valid are finite numbers",
    ),
    "no mass": (
        robot_of(A, link("b", "<inertial/>"), joint("j", "a", "b")),
        "link 'b' has no physical inertia (mass nan kg",
    ),
    "a leader": (
        robot_of(A, B, joint("j", "a", "b", inner="<mimic/>")),
        "mimic of 'joint j' has no joint",
    ),
    "a spring": (
        robot_of(
            A, B, joint("j", "a", "b"),
            "<gazebo reference='j'><springStiffness>stiff</springStiffness></gazebo>",
        ),
        "springStiffness is 'stiff'",
    ),
    "xacro": (
        robot_of("<xacro:include filename='arm.xacro'/>", A, B, joint("j", "a", "b")),
        "it is xacro; name it .xacro, or run xacro on it",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_no_tree_of_joints_is_one_line_that_names_it(tmp_path, name):
    text, words = FAULTS[name]
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(RobotError) as caught:
        Robot.load(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


# --- without pinocchio --------------------------------------------------------------


@pytest.fixture
def without(monkeypatch):
    for name in ("pinocchio", "coal"):
        monkeypatch.setitem(sys.modules, name, None)


def test_urdf_and_its_plain_meshes_need_no_pinocchio(without):
    robot = load("ur10")
    assert robot.size == 6
    assert set(capsules_from_robot(robot).link) >= set(range(6))
    with pytest.raises(HybridError, match=r"pinocchio, .*'hybrid-arm\[pin\]'"):
        robot.pinocchio()


@pytest.mark.skipif(not EXAMPLES, reason="needs example-robot-data")
def test_other_meshes_name_the_extra_that_reads_them(without):
    line = r"\.dae, needs coal, .*'hybrid-arm\[pin\]'"
    with pytest.raises(HybridError, match=line):
        capsules_from_robot(load("kinova"))


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        (
            "<mesh filename='package://p/gone.stl'/>",
            "mesh 'package://p/gone.stl' is not there",
        ),
        ("<box size='1 1 1e308'/>", "'b_0' reaches 1000 m or more"),
    ],
)
def test_a_shape_that_is_gone_or_without_end_is_refused(tmp_path, shape, reason):
    shape = f"<collision><geometry>{shape}</geometry></collision>"
    text = robot_of(A, link("b", f"{BODY}{shape}"), joint("j", "a", "b"))
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(RobotError, match=reason):
        capsules_from_robot(Robot.load(path))


def test_friction_or_a_rotor_below_zero_is_warned_of(tmp_path):
    inner = "<dynamics damping='-0.5' friction='0.1'/>"
    path = tmp_path / "arm.urdf"
    path.write_text(robot_of(A, B, joint("j", "a", "b", inner=inner)))
    with pytest.warns(
        HybridWarning, match="damping of joint 'j' is -0.5, which drives"
    ):
        robot = Robot.load(path)
    assert robot.damping.tolist() == [-0.5]
