"""Exports, number by number: the clock of the C code, every field of a robot file."""

import json
import re
import sys
from dataclasses import replace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from arms import LIFT, MODELS, public_arm
from compiled_model import CompiledModel
from simulated import quiet
from test_export import compiled, full_model, model_of, motion_of

from hybrid.effects.armature import Armature
from hybrid.effects.backlash import Backlash
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.gravity_tilt import GravityTilt
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.presliding import Presliding
from hybrid.effects.spring import Spring
from hybrid.effects.thermal_friction import ThermalFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError, ModelFileError
from hybrid.exports import export, read_manifest
from hybrid.exports.c_code import c_number
from hybrid.model.program import program_from_model
from hybrid.plant.joint_fields import split_effects
from hybrid.robot import Robot
from hybrid.signals import Motion


def planar():
    return Robot.load(MODELS / "planar.xml")


def spun(robot, samples=400, step=0.01):
    """Every joint turns evenly: only the clock changes."""
    t = np.arange(samples) * step
    q, v = np.zeros((2, samples, robot.size))
    v = v + 1.0
    return Motion(t, q, v, 0 * q, np.full_like(q, np.nan), np.ones(samples, bool))


# --- the clock ------------------------------------------------------------------------


def test_the_clock_of_the_c_code_goes_on_by_one_step_a_call(tmp_path):
    robot = planar()
    warm = ThermalFriction((0,), {"cold": 3.0, "time_constant": 5.0, "warm_up": 7.0})
    model, motion = model_of(robot, [warm]), spun(robot)
    export(model, tmp_path, format="c")
    given = motion.q, motion.v, motion.a
    _, tau, _ = compiled(tmp_path, "planar", 2)(*given, keep=True)
    np.testing.assert_allclose(tau, model.predict(motion), rtol=0, atol=1e-12)
    # Of the friction of cold oil as much is left after four seconds as the law says.
    rigid = model_of(robot).predict(motion)
    left = (tau - rigid)[[0, -1], 0]
    loss = 0.01 * np.exp(-np.arange(399) * 0.01 / 5.0).sum()  # (rad/s)² s
    expected = np.exp(-3.99 / 5.0) / (1.0 + loss / 7.0)
    assert left[1] / left[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("step", [0.001, 0.02])
def test_a_compiled_model_has_the_clock_of_its_step(step):
    robot = planar()
    warm = ThermalFriction((1,), {"cold": 2.0, "time_constant": 6.0})
    model, motion = model_of(robot, [warm]), spun(robot, 200, step)
    fast = CompiledModel(model, step=step)
    first = fast.predict(motion.q, motion.v, motion.a)
    np.testing.assert_allclose(first, model.predict(motion), rtol=0, atol=1e-12)
    later = fast.predict(motion.q[:1], motion.v[:1], motion.a[:1])
    assert later[0, 1] < first[-1, 1]
    fast.start()
    again = fast.predict(motion.q, motion.v, motion.a)
    np.testing.assert_array_equal(again, first)


def test_a_program_takes_its_time_from_the_caller():
    robot = planar()
    program = program_from_model(
        model_of(robot, [ThermalFriction((0,), {"cold": 3.0, "time_constant": 5.0})])
    )
    zero, one = np.zeros((1, 2)), np.ones((1, 2))
    plain = program_from_model(model_of(robot)).run(zero, one, zero)[0]
    for t in (0.0, 7.0):
        left = (program.run(zero, one, zero, t=t)[0] - plain)[0, 0]
        assert left == pytest.approx(3.0 * np.exp(-t / 5.0))
    assert "t" in program.uses


def test_samples_of_many_blocks_are_worked_out_as_one():
    model = full_model()
    motion = motion_of(model.robot, 5000)
    program = program_from_model(model)
    tau, memory = program.run(motion.q, motion.v, motion.a)
    assert memory.shape == (5000, 0)
    for k in (0, 2047, 2048, 4999):
        here = slice(k, k + 1)
        one, _ = program.run(motion.q[here], motion.v[here], motion.a[here])
        np.testing.assert_allclose(tau[k], one[0], rtol=1e-12)


def test_memory_is_named_by_effect_and_joint_and_starts_anew_without_a_past():
    robot = full_model().robot
    effects = [
        Presliding((j,), {"level": 3.0, "distance": 0.05}) for j in (1, 4)
    ]  # fmt: skip
    program = program_from_model(model_of(robot, effects))
    assert [x.split(":")[0] for x in program.memory_names] == [
        name for j in (2, 5) for name in [f"presliding {j}"] * len(Presliding.memory)
    ]
    rng = np.random.default_rng(0)
    q = rng.normal(size=(3, 6))
    zero = np.zeros_like(q)
    _, past = program.run(q, zero, zero)
    assert past.shape == (3, len(program.memory_names))
    moved, _ = program.run(q + 0.01, zero, zero, memory=past)
    anew, _ = program.run(q + 0.01, zero, zero)
    assert np.abs(moved - anew)[:, [1, 4]].min() > 0.01
    np.testing.assert_allclose(moved[:, [0, 2, 3, 5]], anew[:, [0, 2, 3, 5]])


# --- names and numbers ----------------------------------------------------------------


@pytest.mark.parametrize("x", [1 / 3, -1e-300, 6.02214076e23, 0.0])
def test_a_number_is_written_to_the_last_bit(x):
    text = c_number(x, "P")
    assert float(re.fullmatch(r"P_R\((.*)\)", text)[1]) == x


# --- MJCF -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def springy(tmp_path_factory):
    """A spring and bent friction at one joint of the planar arm, as MuJoCo reads it."""
    folder = tmp_path_factory.mktemp("springy")
    robot = replace(planar(), path="")
    effects = [
        Spring((1,), {"stiffness": 7.5, "preload": 0.25}),
        NonlinearViscous((1,), {"quadratic": 0.5, "cubic": 0.125}),
    ]
    left_out = export(model_of(robot, effects), folder, format="mjcf")
    return robot, mujoco.MjModel.from_xml_path(str(folder / "planar.xml")), left_out


def test_a_spring_is_the_joints_stiffness_and_where_that_is_relaxed(springy):
    _, mj, left_out = springy
    stiffness = np.asarray(mj.jnt_stiffness).reshape(2, -1)[:, 0]
    np.testing.assert_array_equal(stiffness, [0.0, 7.5])
    np.testing.assert_allclose(mj.qpos_spring[1], -0.25 / 7.5)
    ignored = "quadratic and cubic damping of elbow, which it ignores"
    assert left_out == (f"for MJX on JAX: {ignored}",)


def test_friction_that_bends_is_the_polynomial_of_the_joints_damping(springy):
    _, mj, _ = springy
    data = mujoco.MjData(mj)

    def passive(speed):
        data.qpos[:], data.qvel[:] = mj.qpos_spring, [0.0, speed]
        mujoco.mj_forward(mj, data)
        return -data.qfrc_passive.copy()

    for speed in (-2.0, 0.5, 3.0):
        bent = 0.5 * speed * abs(speed) + 0.125 * speed**3
        np.testing.assert_allclose(passive(speed), [0.0, bent], atol=1e-12)


def test_limits_of_position_torque_and_speed_are_in_the_file(springy):
    robot, mj, _ = springy
    assert mj.jnt_limited.all() and mj.jnt_actfrclimited.all()
    np.testing.assert_allclose(mj.jnt_range, np.c_[robot.q_min, robot.q_max], 1e-5)
    np.testing.assert_allclose(mj.jnt_actfrcrange, np.c_[-robot.tau_max, robot.tau_max])
    for name, values in (
        ("velocity_limit", robot.v_max),
        ("acceleration_limit", robot.a_max),
    ):
        np.testing.assert_allclose(mj.numeric(name).data, values, 1e-5)


def test_a_motor_of_unit_gear_moves_each_joint(springy):
    robot, mj, _ = springy
    assert [mj.actuator(k).name for k in range(mj.nu)] == list(robot.joints)
    data = mujoco.MjData(mj)
    data.ctrl[:] = [0.3, -0.7]
    mujoco.mj_forward(mj, data)
    np.testing.assert_allclose(data.qfrc_actuator, [0.3, -0.7])


def unlimited(robot):
    free = np.full(robot.size, np.inf)
    limits = dict.fromkeys(("q_max", "v_max", "a_max", "tau_max"), free)
    return replace(robot, q_min=-free, path="", **limits)


@pytest.mark.parametrize("kind, suffix", [("mjcf", "xml"), ("urdf", "urdf")])
def test_an_arm_without_limits_gets_none(tmp_path, kind, suffix):
    robot = unlimited(planar())
    export(model_of(robot), tmp_path, format=kind)
    found, _ = quiet(Robot.load, tmp_path / f"planar.{suffix}")
    for name in ("q_min", "q_max", "v_max", "a_max", "tau_max"):
        np.testing.assert_array_equal(getattr(found, name), getattr(robot, name))


def test_a_limit_on_one_side_is_no_limit(tmp_path):
    robot = planar()
    robot = replace(robot, q_max=np.array([np.inf, 1.5]), path="")
    export(model_of(robot), tmp_path / "m", format="mjcf")
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "m" / "planar.xml"))
    assert mj.jnt_limited.tolist() == [0, 1]
    export(model_of(robot), tmp_path / "u", format="urdf")
    root = ElementTree.parse(tmp_path / "u" / "planar.urdf").getroot()
    assert [j.get("type") for j in root.iter("joint") if j.get("type")] == [
        "continuous",
        "revolute",
    ]


# --- URDF -----------------------------------------------------------------------------


def joint_rotors(root):
    """Rotor inertia by joint, as text."""
    return {
        x.find("joint").get("name"): x.find(
            "actuator/{http://drake.mit.edu}rotor_inertia"
        ).get("value")
        for x in root.findall("transmission")
    }


def test_a_urdf_holds_every_number_to_the_last_bit(tmp_path):
    robot = replace(public_arm("panda"), path="")
    effects = [
        kind((k,), {name: share * (k + 1)})
        for k in range(robot.size)
        for kind, name, share in (
            (Viscous, "coefficient", 0.1), (Coulomb, "level", 0.2),
            (Armature, "inertia", 0.3),
        )
    ]  # fmt: skip
    assert export(model_of(robot, effects), tmp_path, format="urdf") == ()
    root = ElementTree.parse(tmp_path / f"{robot.name}.urdf").getroot()
    joints = [j for j in root.iter("joint") if j.find("limit") is not None]
    links = root.findall("link")
    for k, joint in enumerate(joints):
        assert joint.get("name") == robot.joints[k]
        assert joint.find("parent").get("link") == links[k].get("name")
        assert joint.find("child").get("link") == links[k + 1].get("name")
        limit, dynamics = joint.find("limit"), joint.find("dynamics")
        assert float(limit.get("lower")) == robot.q_min[k]
        assert float(limit.get("upper")) == robot.q_max[k]
        assert float(limit.get("effort")) == robot.tau_max[k]
        assert float(limit.get("velocity")) == robot.v_max[k]
        assert float(dynamics.get("damping")) == 0.1 * (k + 1)
        assert float(dynamics.get("friction")) == 0.2 * (k + 1)
        rotor = joint_rotors(root)[robot.joints[k]]
        assert float(rotor) == 0.3 * (k + 1)
    assert links[0].find("inertial") is None
    masses = [float(x.find("inertial/mass").get("value")) for x in links[1:]]
    np.testing.assert_array_equal(masses, robot.chain.inertial[:, 0])
    found, _ = quiet(Robot.load, tmp_path / f"{robot.name}.urdf")
    np.testing.assert_allclose(found.chain.inertial, robot.chain.inertial, atol=1e-12)
    np.testing.assert_allclose(found.chain.rotation, robot.chain.rotation, atol=1e-12)


def test_the_c_code_lists_joints_and_limits_in_their_order(tmp_path):
    robot = planar()
    free = np.array([np.inf, 0.5])
    robot = replace(robot, q_min=-free, q_max=free, tau_max=np.array([0.25, np.inf]))
    export(model_of(robot), tmp_path, format="c")
    text = "".join(x.read_text() for x in sorted(tmp_path.rglob("planar.[ch]")))
    for k, joint in enumerate(robot.joints):
        low, high = (f"{x:.6g}" for x in (-free[k], free[k]))
        assert f" *   {k + 1} {joint}: {low} to {high} rad" in text
    for name, numbers in (
        ("q_min", ["-INFINITY", "-0.5"]),
        ("q_max", ["INFINITY", "0.5"]),
        ("tau_max", ["0.25", "INFINITY"]),
    ):
        field = re.search(rf"_{name}\[2\] = {{(.*?)}};", text, re.DOTALL)
        written = re.findall(r"PLANAR_R\((.*?)\)", field.group(1))
        assert written == numbers


def test_an_acceleration_limit_is_in_a_urdf_and_no_rotor_that_is_none(tmp_path):
    robot = planar()
    export(model_of(robot), tmp_path, format="urdf")
    text = (tmp_path / "planar.urdf").read_text()
    found = re.findall(r'drake:acceleration="(.*?)"', text)
    assert list(map(float, found)) == robot.a_max.tolist()
    assert "rotor_inertia" not in text


def test_a_lift_slides_in_every_file(tmp_path):
    path = tmp_path / "lift.xml"
    path.write_text(LIFT)
    robot = Robot.load(path)
    for kind, suffix in (("mjcf", "xml"), ("urdf", "urdf")):
        export(model_of(robot), tmp_path / kind, format=kind)
        file = next((tmp_path / kind).glob(f"*.{suffix}"))
        found, _ = quiet(Robot.load, file)
        np.testing.assert_array_equal(found.chain.revolute, [True, False])
        np.testing.assert_allclose(found.q_max, robot.q_max)


def test_gravity_from_another_side_is_what_a_urdf_cannot_say(tmp_path):
    robot = planar()
    chain = replace(robot.chain, gravity=np.array([0.0, 0.0, -9.81]))
    upright = replace(robot, chain=chain)
    notes = export(model_of(upright), tmp_path / "a", format="urdf")
    assert not any("gravity" in x for x in notes)
    tilted = replace(robot, chain=replace(chain, gravity=np.array([1.0, 0.0, -9.7])))
    notes = export(model_of(tilted), tmp_path / "b", format="urdf")
    (text,) = [x for x in notes if "gravity" in x]
    assert text == "gravity 1.0 0.0 -9.7 m/s²"


def test_a_tilted_base_turns_gravity_in_the_file(tmp_path):
    robot = planar()
    names = [g.name for g in GravityTilt.gains]
    tilt = GravityTilt((0, 1), dict.fromkeys(names, 0.1))
    assert export(model_of(robot, [tilt]), tmp_path, format="mjcf") == ()
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "planar.xml"))
    _, change = tilt.rigid_change(2, robot.chain.gravity)
    assert np.abs(change).max() > 0.05
    np.testing.assert_allclose(mj.opt.gravity, robot.chain.gravity + change, rtol=1e-5)


def test_a_learned_part_is_named_with_its_joints(tmp_path):
    model = replace(full_model(), effects=())
    (text,) = export(model, tmp_path, format="mjcf")
    joints = [model.robot.joints[k] for k in (0, 3, 5)]
    assert text == f"learned remainder of {', '.join(joints)}"


# --- what fields take, and the rest ---------------------------------------------------


def test_only_what_a_field_can_hold_goes_into_it():
    negative = Spring((0,), {"stiffness": -3.0, "preload": 0.0})
    fields, rest = split_effects([negative], ("stiffness",), 2)
    assert not fields["stiffness"].any() and rest == [negative]
    offset = TorqueOffset((1,), {"level": 2.0})
    fields, rest = split_effects([offset], ("stiffness",), 2)
    assert not fields["stiffness"].any() and rest == [offset]
    two = [Spring((1,), {"stiffness": x, "preload": 0.0}) for x in (1.0, 2.5)]
    fields, rest = split_effects(two, ("stiffness",), 2)
    assert fields["stiffness"].tolist() == [0.0, 3.5] and rest == []


# --- manifest -------------------------------------------------------------------------


def test_a_manifest_names_cutoff_effects_files_and_what_is_left_out(tmp_path):
    robot = planar()
    gap = Backlash((1,), {g.name: 0.1 for g in Backlash.gains})
    warm = ThermalFriction((0,), {"cold": 3.0, "time_constant": 5.0})
    model = model_of(robot, [warm, gap], cutoff=12.5)
    left_out = export(model, tmp_path, format="c")
    content = read_manifest(tmp_path)
    assert content["cutoff"] == 12.5
    assert [e["effect"] for e in content["effects"]] == ["thermal_friction", "backlash"]
    assert content["left_out"] == list(left_out) != []
    assert set(content["files"]) == {"planar.h", "example.c", "CMakeLists.txt"}
    free = replace(model, effects=(), cutoff=np.inf, robot=unlimited(robot))
    export(free, tmp_path / "free", format="json")
    content = read_manifest(tmp_path / "free")
    assert content["cutoff"] is None and content["limits"]["q_min"] == [None, None]
    assert content["units"]["q"] == "rad" and content["units"]["tau"] == "N·m"
    (tmp_path / "lift.xml").write_text(LIFT)
    export(model_of(Robot.load(tmp_path / "lift.xml")), tmp_path / "l", format="json")
    assert read_manifest(tmp_path / "l")["units"]["q"] == ["rad", "m"]


@pytest.mark.parametrize(
    ("change", "message"),
    [({"schema": "other"}, "export the model again"), (None, "not a manifest")],
)
def test_a_manifest_of_another_kind_is_refused(tmp_path, change, message):
    export(model_of(planar()), tmp_path, format="json")
    path = tmp_path / "manifest.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps([] if change is None else content | change))
    with pytest.raises(ModelFileError, match=message):
        read_manifest(tmp_path)


def test_a_file_that_is_gone_is_noticed(tmp_path):
    export(model_of(planar()), tmp_path, format="c")
    (tmp_path / "example.c").unlink()
    with pytest.raises(ModelFileError, match="example.c: missing"):
        read_manifest(tmp_path)
    with pytest.raises(ModelFileError, match="cannot be read"):
        read_manifest(tmp_path / "none")


def test_without_its_package_onnx_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(HybridError, match=r"pip install 'hybrid-arm\[export\]'"):
        export(model_of(planar()), tmp_path / "out", format="onnx")
    assert not (tmp_path / "out").exists()


def test_a_shape_that_does_not_fit_the_arm_is_refused():
    fast = CompiledModel(model_of(planar()))
    one = np.zeros((1, 2))
    assert fast.predict(one, one, one).shape == (1, 2)
    with pytest.raises(HybridError, match="valid is"):
        fast.predict(one, one[0], one)


def test_the_example_of_an_arm_without_limits_is_within_one_radian(tmp_path):
    export(model_of(unlimited(planar())), tmp_path, format="c")
    expected = np.random.default_rng(0).uniform(-1.0, 1.0, 2)
    text = (tmp_path / "example.c").read_text()
    for x in expected.tolist():
        assert c_number(x, "PLANAR") in text
