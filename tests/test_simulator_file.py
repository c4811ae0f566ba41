"""The user's own robot file with what was found: only that changes, and it runs."""

import re
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from arms import MODELS
from coarse import Plant, simulate
from mujoco_inverse import file_inverse_dynamics
from simulated import motions, quiet
from test_export import model_of

from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.dynamics import RigidBody
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.armature import Armature
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.controller_gain import ControllerGain
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.elasticity import Elasticity
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.payload import LinkInertia
from hybrid.effects.saturation import Saturation
from hybrid.effects.spring import Spring
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.effects.viscous import Viscous
from hybrid.errors import EffectError, HybridError, RobotError
from hybrid.exports import build_simulator
from hybrid.exports.simulator.check import file_torque
from hybrid.exports.simulator.friction import approximate_friction, curve
from hybrid.exports.simulator.plan import plan
from hybrid.plant import install
from hybrid.plant.joint_fields import declared_effects
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator

CUBE = """v 0 0 0
v .1 0 0
v 0 .1 0
v 0 0 .1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
ARM = """<mujocoinclude>
  <worldbody>
    <body name="base">
      <geom type="box" size=".1 .1 .1"/>
      <body name="upper" pos="0 0 .2" euler="0 90 0">
        <joint name="a" class="stiff" axis="0 1 0" range="-90 90" ref="10"/>
        <geom type="mesh" mesh="cube" rgba="1 0 0 1"/>
        <body name="lower" pos=".3 0 0">
          <inertial pos=".1 0 0" mass="1.5" diaginertia=".01 .02 .02" quat="1 .1 0 0"/>
          <joint name="b" axis="0 1 0" damping=".3"/>  <!-- the elbow -->
          <geom name="shin" type="capsule" size=".02 .1"/>
          <body name="tool" pos=".2 0 0"><geom type="sphere" size=".03" mass=".2"/>
            <body name="finger"><joint name="grip" type="slide" axis="0 0 1"/>
              <geom type="box" size=".01 .01 .02"/></body>
          </body>
          <site name="tip" pos=".2 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujocoinclude>
"""
SCENE = """<!-- my scene -->
<mujoco model="mine">
  <compiler angle="degree" meshdir="meshes"/>
  <option timestep=".002"/>
  <default><default class="stiff"><joint armature=".02" frictionloss=".1"/></default>
  </default>
  <asset><mesh name="cube" file="cube.obj"/></asset>
  <include file="arm.xml"/>
  <contact><exclude body1="base" body2="upper"/></contact>
  <actuator>
    <position name="servo" joint="a" kp="50" kv="2" gear="2" ctrlrange="-1 1"/>
    <motor name="motor" joint="b"/>
  </actuator>
  <sensor><jointpos joint="a"/></sensor>
  <keyframe><key name="home" qpos=".1 .2 0" qvel="0 .3 0"/></keyframe>
</mujoco>
"""
KEPT = (
    "nbody", "ngeom", "nmesh", "nsite", "nsensor", "nkey", "nexclude", "nu",
)  # fmt: skip


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """An arm in a scene with a mesh, an include, a gripper and a keyframe."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "meshes").mkdir()
    (folder / "meshes" / "cube.obj").write_text(CUBE)
    (folder / "arm.xml").write_text(ARM)
    (folder / "scene.xml").write_text(SCENE)
    robot, _ = quiet(Robot.load, folder / "scene.xml", joints=("a", "b"))
    return robot


def read_again(folder, made, robot):
    """MuJoCo's model and the arm of what was written into a folder."""
    file = folder / "sim.xml"
    made.write(file)
    again, _ = quiet(Robot.load, file, joints=robot.joints)
    return mujoco.MjModel.from_xml_path(str(file)), again


def torque(robot, motion):
    """Torque that an arm's own numbers ask for, shape (N, n)."""
    model = model_of(robot, declared_effects(robot))
    return model.predict(motion)


def test_nothing_found_leaves_every_byte_but_the_place_of_meshes(own, tmp_path):
    here = build_simulator(own)
    assert here.text == here.original and here.diff() == ""
    there = build_simulator(own, folder=tmp_path / "out")
    (new,) = [x for x in there.diff().splitlines() if x.startswith("+ ")]
    assert "<compiler" in new


def test_only_what_was_found_changes_and_the_scene_still_runs(own, tmp_path):
    heavier = LinkInertia((0, 1), {"mass": 0.4, "mx": 0.05, "Iyy": 0.01, "Izz": 0.01})
    effects = [
        heavier,
        Coulomb((1,), {"level": 0.7}),
        Viscous((0,), {"coefficient": 2}),
    ]
    made = build_simulator(own, effects, folder=tmp_path)
    changed = [x for x in made.diff().splitlines() if x[:1] == "+" and x[:3] != "+++"]
    assert len(changed) == 4, made.diff()  # meshes, joint a, and inertia and joint of b
    assert b"<!-- the elbow -->" in made.text and b"<!-- my scene -->" in made.text
    model, again = read_again(tmp_path, made, own)
    before = mujoco.MjModel.from_xml_path(own.path)
    assert [getattr(model, x) for x in KEPT] == [getattr(before, x) for x in KEPT]
    mujoco.mj_step(model, mujoco.MjData(model))
    expected = own.chain.inertial[1] + heavier.gain_values
    np.testing.assert_allclose(again.chain.inertial[1], expected, atol=1e-12)
    assert again.frictionloss[1] == 0.7 and again.damping[0] == 2.0
    assert (tmp_path / "sim.diff").read_text().startswith("--- a/sim.xml")


def test_a_link_that_becomes_light_takes_from_all_of_its_bodies(own, tmp_path):
    inertial = own.chain.inertial.copy()
    inertial[1] *= 0.1  # less than the tool alone weighs
    made = build_simulator(own.with_inertial(inertial), folder=tmp_path)
    _, again = read_again(tmp_path, made, own)
    np.testing.assert_allclose(again.chain.inertial, inertial, atol=1e-12)


@pytest.mark.parametrize("name", ["planar", "scara", "coman_like"])
@pytest.mark.parametrize("kind, suffix", [("mjcf", "xml"), ("urdf", "urdf")])
def test_what_a_file_can_say_comes_back_to_the_last_digits(
    tmp_path, name, kind, suffix
):
    robot = Robot.load(MODELS / f"{name}.{suffix}")
    n, links = robot.size, 1.07 * robot.chain.inertial
    effects = [
        cls((j,), {gain: 0.1 + 0.01 * j})
        for j in range(n)
        for cls, gain in ((Armature, "inertia"), (Viscous, "coefficient"),
                          (Coulomb, "level"))
    ]  # fmt: skip
    if kind == "mjcf":
        effects += [
            NonlinearViscous((0,), {"quadratic": -0.05, "cubic": 0.02}),
            Spring((1,), {"stiffness": 3.0, "preload": 0.5}),
            TorqueOffset((0,), {"level": -0.4}),
        ]
    new = robot.with_inertial(links)
    made = build_simulator(new, effects, kind=kind, folder=tmp_path)
    assert made.notes == () and made.rest == ()
    made.write(tmp_path / f"arm.{suffix}")
    again = Robot.load(tmp_path / f"arm.{suffix}")
    (motion,) = motions(robot, count=1, duration=5.0)
    wanted = model_of(new, [*declared_effects(robot), *effects]).predict(motion)
    off = np.abs(torque(again, motion) - wanted).max(axis=0)
    assert (off < 1e-6 * np.abs(wanted).max(axis=0)).all(), off


def test_a_curve_of_friction_is_fitted_and_what_is_left_is_said():
    robot = Robot.load(MODELS / "planar.xml")
    curve = [
        Stribeck((1,), {"level": 0.8, "velocity": 0.3}),
        Viscous((1,), {"coefficient": 0.6}),
        NonlinearViscous(
            (1,), {"quadratic": -0.2}
        ),  # bends down: by itself not a field
    ]
    moved = motions(robot, count=2, seed=3)
    made = build_simulator(robot, curve, motions=moved)
    (fitted,), (note,) = plan(robot, curve, "mjcf", moved).friction, made.notes
    assert note.startswith("friction of elbow (stribeck")
    assert f"leaves {fitted.missed:.3g} of" in note
    wanted = [*declared_effects(robot), *curve]
    left = []
    for motion in moved:
        truth = model_of(robot, wanted).predict(motion)
        left.append(truth - torque(made.robot, motion))
        whole = model_of(made.robot, [*declared_effects(made.robot), *made.rest])
        np.testing.assert_allclose(whole.predict(motion), truth, atol=1e-9)
    rms = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))
    np.testing.assert_allclose(rms, [0.0, fitted.missed], rtol=1e-6, atol=1e-9)
    plain = build_simulator(robot, [], motions=moved)
    dropped = [
        model_of(robot, curve).predict(m) - torque(plain.robot, m) for m in moved
    ]
    assert rms[1] < 0.3 * np.sqrt(np.mean(np.concatenate(dropped)[:, 1] ** 2))


def test_friction_of_a_file_takes_energy_at_every_speed():
    robot = Robot.load(MODELS / "planar.xml")
    steep = [Viscous((1,), {"coefficient": 4.0}),
             NonlinearViscous((1,), {"quadratic": -3.0})]  # fmt: skip
    found = build_simulator(robot, steep, motions=motions(robot, count=1)).robot
    v = np.linspace(-30, 30, 999)[:, None] * np.ones(2)
    power = (found.joint_torque(0 * v, v, 0 * v) + found.frictionloss * np.sign(v)) * v
    assert power.min() >= -1e-9


def test_friction_beyond_the_logs_does_not_run_away():
    """A cubic that fits slow logs would be 310 N.m of friction at full speed."""
    robot = Robot.load(MODELS / "planar.xml")
    slow = [
        replace(m, v=0.2 * m.v / np.abs(m.v).max(axis=0))
        for m in motions(robot, count=2)
    ]
    values = {"quadratic": -150.0, "cubic": 500.0, "fastest": 0.2}
    found = [Viscous((1,), {"coefficient": 20.0}), NonlinearViscous((1,), values)]
    made = build_simulator(robot, found, motions=slow).robot
    top = np.array([[0.0, robot.v_max[1]]])
    friction = made.joint_torque(0 * top, top, 0 * top)[0, 1] + made.frictionloss[1]
    endless = values["quadratic"] * top[0, 1] ** 2 + values["cubic"] * top[0, 1] ** 3
    # Tangent at 0.2 rad/s: 20 N.m.s/rad.
    assert 0.5 < friction / (20.0 * top[0, 1]) < 2.0 < endless / (20.0 * top[0, 1])


def test_drives_change_where_the_file_has_them(own, tmp_path):
    effects = [
        TorqueGain((0,), {"gain": 0.25}), CommandLatency((0,), {"time": 0.013}),
        ControllerGain((0,), {"stiffness": 0.2, "damping": -0.5}),
        ActuatorLag((1,), {"time": 0.03}), Saturation((1,), {"loss": 1, "limit": 4.0}),
    ]  # fmt: skip
    made = build_simulator(own, effects, folder=tmp_path)
    assert made.notes == ()
    model, again = read_again(tmp_path, made, own)
    assert model.actuator(0).name == "servo"
    np.testing.assert_allclose(again.kp[0], 1.2 / 1.25 * own.kp[0])
    np.testing.assert_allclose(again.kd[0], 0.5 / 1.25 * own.kd[0])
    np.testing.assert_allclose(model.actuator_ctrlrange[0], [-1, 1])
    assert model.actuator_delay[0] == pytest.approx(0.013)
    assert model.actuator_dynprm[1, 0] == 0.03
    np.testing.assert_allclose(model.actuator_forcerange[1], [-4, 4])


def test_gains_of_a_servo_that_is_none_are_said(own):
    made = build_simulator(own, [ControllerGain((1,), {"stiffness": 0.2})])
    assert made.notes == ("gains of a servo of b, whose actuator has no place",)


def test_a_gear_that_twists_is_a_joint_behind_the_motor(own, tmp_path):
    effects = [
        Armature((1,), {"inertia": 0.05}),
        Elasticity((1,), {"compliance": 0.01}),
    ]
    made = build_simulator(own, effects, folder=tmp_path)
    model, again = read_again(tmp_path, made, own)
    behind = model.joint("b/deflection")
    assert made.notes == () and behind.stiffness[0] == pytest.approx(100.0)
    np.testing.assert_allclose(model.key_qpos[0], [0.1, 0.2, 0, 0])
    np.testing.assert_allclose(model.key_qvel[0], [0, 0.3, 0, 0])
    np.testing.assert_allclose(again.chain.inertial, own.chain.inertial, atol=1e-12)


def test_a_coupled_rotor_is_a_tendon(own, tmp_path):
    values = {"inertia": 0.01, "viscous": 0.2, "coulomb": 0.1}
    made = build_simulator(own, [TransmissionCoupling((0, 1), values)], folder=tmp_path)
    made.write(tmp_path / "sim.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "sim.xml"))
    assert model.ntendon == 1 and model.tendon_armature[0] == 0.01
    again = Robot.load(tmp_path / "sim.xml")
    assert again.coupled.tolist() == [[0, 1, 0.01, 0.2, 0.1]]
    (coupling,) = [e for e in declared_effects(again) if len(e.joints) == 2]
    assert coupling.values == values
    assert Robot.from_dict(again.as_dict()).coupled.tolist() == again.coupled.tolist()


def test_a_coupled_rotor_of_an_arm_without_a_file_is_dry_at_any_speed(tmp_path):
    robot = replace(Robot.load(MODELS / "planar.xml"), path="")
    rotor = [TransmissionCoupling((0, 1), {"coulomb": 2.0})]
    build_simulator(robot, rotor).write(tmp_path / "sim.xml")
    (motion,) = motions(robot, count=1, duration=1.0)
    apart = motion.v[:, :1] * [1.0, -1.0] + np.array([0.0, 0.01])  # rad/s
    motion, model = replace(motion, v=apart), SimpleNamespace(robot=robot)
    dry = file_inverse_dynamics(tmp_path / "sim.xml", robot.joints, motion, {})
    dry -= file_torque(robot, model, motion)
    moving = np.abs(motion.v).min(axis=1) > 0.05
    np.testing.assert_allclose(dry[moving], 2.0, atol=1e-6)


def test_a_coupled_rotor_keeps_its_friction_beside_the_callback(own, tmp_path):
    coupling = TransmissionCoupling((0, 1), {"coulomb": 0.1})
    build_simulator(own, [coupling], folder=tmp_path).write(tmp_path / "sim.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "sim.xml"))
    added = install(
        model,
        mujoco.MjData(model),
        SimpleNamespace(robot=own, effects=(coupling,), remainder=None),
    )
    kept = model.tendon_frictionloss.tolist()
    added.remove()
    assert kept == [0.1]


def test_a_coupled_rotor_of_the_file_takes_the_change(own, tmp_path):
    first = TransmissionCoupling((0, 1), {"inertia": 0.01, "viscous": 0.2})
    build_simulator(own, [first], folder=tmp_path).write(tmp_path / "sim.xml")
    text = (tmp_path / "sim.xml").read_text()
    for number, halved in (("0.01", "0.04"), ("0.2", "0.8")):  # at half the length
        text = text.replace(f'"{number}"', f'"{halved}"')
    (tmp_path / "sim.xml").write_text(text.replace('coef="1.0"', 'coef="0.5"'))
    again = Robot.load(tmp_path / "sim.xml")
    np.testing.assert_allclose(again.coupled, [[0, 1, 0.01, 0.2, 0.0]])
    change = {"inertia": 0.02, "viscous": -0.3, "coulomb": 0.4}
    made = build_simulator(again, [TransmissionCoupling((1, 0), change)])
    np.testing.assert_allclose(made.robot.coupled, [[0, 1, 0.03, 0.0, 0.4]])
    (below,) = made.rest  # which MuJoCo would refuse
    assert below.values["viscous"] == pytest.approx(-0.1)
    assert "viscous -0.1" in made.notes[-1]
    made.write(tmp_path / "new.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml")).ntendon == 1


def test_a_twisting_gear_without_rotor_is_refused(own):
    with pytest.raises(EffectError, match="needs a rotor"):
        build_simulator(own, [Elasticity((1,), {"compliance": 0.01})])


def test_a_file_of_another_arm_is_refused(own):
    other = replace(own, path=str(MODELS / "planar.xml"))
    with pytest.raises(RobotError):
        build_simulator(other)


def test_an_unknown_kind_is_refused(own):
    with pytest.raises(HybridError, match="valid are mjcf, urdf"):
        build_simulator(own, kind="sdf")


def test_a_urdf_becomes_an_mjcf_with_its_shapes(tmp_path):
    robot = Robot.load(MODELS / "planar.urdf")
    made = build_simulator(robot, [Coulomb((0,), {"level": 0.5})], folder=tmp_path)
    model, again = read_again(tmp_path, made, robot)
    assert model.ngeom > 0 and model.nu == 2
    (motion,) = motions(robot, count=1, duration=5.0)
    np.testing.assert_allclose(
        RigidBody(again.chain, motion).load, RigidBody(robot.chain, motion).load,
        atol=1e-9,
    )  # fmt: skip
    assert again.frictionloss[0] == robot.frictionloss[0] + 0.5


def test_an_mjcf_becomes_a_urdf_with_its_tree_and_shapes(own, tmp_path):
    made = build_simulator(own, [Coulomb((0,), {"level": 0.5})], kind="urdf",
                           folder=tmp_path)  # fmt: skip
    made.write(tmp_path / "arm.urdf")
    (note,) = made.notes
    assert "actuators (2), sites (1), sensors (1), keyframes (1)" in note
    again, _ = quiet(Robot.load, tmp_path / "arm.urdf", joints=own.joints)
    np.testing.assert_allclose(again.chain.inertial, own.chain.inertial, atol=1e-12)
    for name in ("rotation", "translation", "axis", "armature"):
        np.testing.assert_allclose(
            getattr(again.chain, name), getattr(own.chain, name), atol=1e-12
        )
    np.testing.assert_allclose(again.q_max, own.q_max)
    assert again.frictionloss[0] == own.frictionloss[0] + 0.5
    spec = mujoco.MjSpec.from_file(str(tmp_path / "arm.urdf"))
    spec.compiler.discardvisual = spec.compiler.fusestatic = False
    shown, before = spec.compile(), mujoco.MjModel.from_xml_path(own.path)
    assert shown.ngeom == before.ngeom + 2  # a capsule is a cylinder and two balls
    assert shown.nmesh == 1
    assert {before.body(b).name for b in range(1, before.nbody)} <= {
        shown.body(b).name for b in range(shown.nbody)
    }


def test_a_joint_without_limits_is_not_held_by_limits_of_zero(own, tmp_path):
    build_simulator(own, kind="urdf").write(tmp_path / "arm.urdf")
    limits = ElementTree.parse(tmp_path / "arm.urdf").getroot().findall(".//limit")
    assert limits and all(
        float(x.get(name)) > 0 for x in limits for name in ("effort", "velocity")
    )
    again, _ = quiet(Robot.load, tmp_path / "arm.urdf", joints=own.joints)
    for name in ("v_max", "a_max", "tau_max"):
        np.testing.assert_array_equal(getattr(again, name), getattr(own, name))
    assert np.isinf(own.v_max).all()


def test_boxes_keep_their_size_and_what_mujoco_hides_is_not_seen(tmp_path):
    text = (MODELS / "planar.xml").read_text()
    for name, group in (("upper_link_1", 2), ("upper_link_2", 3)):
        text = text.replace(f'name="{name}"', f'name="{name}" group="{group}"')
    (tmp_path / "arm.xml").write_text(text)
    robot = Robot.load(tmp_path / "arm.xml")
    build_simulator(robot, kind="urdf").write(tmp_path / "arm.urdf")
    model = mujoco.MjModel.from_xml_path(robot.path)
    root = ElementTree.parse(tmp_path / "arm.urdf").getroot()
    assert len(root.findall(".//collision")) == model.ngeom
    assert len(root.findall(".//visual")) == model.ngeom - 1  # group 3 is hidden
    boxes = {x.get("size") for x in root.findall(".//box")}
    own = 2.0 * model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_BOX]
    assert sorted(boxes) == sorted(" ".join(map(repr, x)) for x in own.tolist())


def test_meshes_of_a_urdf_are_where_those_of_the_mjcf_were(own, tmp_path):
    build_simulator(own, kind="urdf", folder=tmp_path).write(tmp_path / "arm.urdf")
    spec = mujoco.MjSpec.from_file(str(tmp_path / "arm.urdf"))
    spec.compiler.discardvisual = spec.compiler.fusestatic = False
    corners = []
    for model in (mujoco.MjModel.from_xml_path(own.path), spec.compile()):
        data = mujoco.MjData(model)
        names = [model.joint(j).name for j in range(model.njnt)]
        data.qpos[model.jnt_qposadr[[names.index(x) for x in own.joints]]] = 0.3, -0.7
        mujoco.mj_kinematics(model, data)
        (g, *_) = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
        corners.append(
            data.geom_xpos[g] + model.mesh_vert @ data.geom_xmat[g].reshape(3, 3).T
        )
    np.testing.assert_allclose(*(np.sort(x, axis=0) for x in corners), atol=1e-6)


def test_torque_of_a_file_is_that_of_its_arm_in_any_format():
    robot = Robot.load(MODELS / "planar.xml")
    (motion,) = motions(robot, count=1, duration=3.0)
    model = SimpleNamespace(robot=robot)
    ours, by_mjcf, by_urdf = (
        file_torque(x, model, motion)
        for x in (robot, MODELS / "planar.xml", str(MODELS / "planar.urdf"))
    )
    np.testing.assert_allclose(by_mjcf, ours, atol=1e-9)
    np.testing.assert_allclose(by_urdf, ours, atol=1e-9)
    file = MODELS / "planar.xml"
    by_mujoco = file_inverse_dynamics(file, robot.joints, motion, {})
    moving = np.abs(motion.v) > 0.05
    np.testing.assert_allclose(by_mujoco[moving], ours[moving], atol=1e-6)


NAMELESS = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
  <body><joint name="turns" axis="0 1 0" damping=".2" range="-90 90"/>
    <geom type="capsule" fromto="0 0 0 .3 0 .1" size=".02"/>
    <body pos=".3 0 .1" euler="20 10 0"><joint name="bends" axis="0 1 0"/>
      <geom type="box" size=".02 .05 .1" pos="0 .2 0"/>
  </body></body></worldbody></mujoco>"""


def with_actuator(text):
    """An arm without names of its bodies, and with an actuator."""
    return NAMELESS.replace("</mujoco>", f"<actuator>{text}</actuator></mujoco>")


def edited(text, tmp_path, robot=None, effects=()):
    """The file of an arm, and MuJoCo's model of it, before and with some changes."""
    (tmp_path / "arm.xml").write_text(text)
    own = Robot.load(tmp_path / "arm.xml")
    build_simulator(robot(own) if robot else own, effects).write(tmp_path / "new.xml")
    names = ("arm.xml", "new.xml")
    return [mujoco.MjModel.from_xml_path(str(tmp_path / x)) for x in names]


@pytest.mark.parametrize("head", ["", '<compiler inertiafromgeom="true"/>'])
def test_bodies_without_a_name_or_a_mass_of_their_own_take_new_ones(head, tmp_path):
    """Their links are those of their shapes, by MuJoCo's density, until then."""
    text = NAMELESS.replace("<worldbody>", f"{head}<worldbody>", 1)
    (tmp_path / "arm.xml").write_text(text)
    robot = Robot.load(tmp_path / "arm.xml")
    new = robot.with_inertial(1.3 * robot.chain.inertial)
    tilted = replace(new, chain=replace(new.chain, gravity=np.array([1.0, 0.0, -9.0])))
    spring = {"stiffness": np.array([3.0, 0.0]), "springref": np.array([0.4, 0.0])}
    changed = replace(tilted, damping=np.array([0.2, 0.7]), **spring)
    build_simulator(changed).write(tmp_path / "new.xml")
    again = Robot.load(tmp_path / "new.xml")
    for name in ("inertial", "gravity", "armature"):
        np.testing.assert_allclose(
            getattr(again.chain, name), getattr(changed.chain, name), atol=1e-12
        )
    for name in ("damping", "stiffness", "springref", "q_max", "frictionloss"):
        np.testing.assert_allclose(getattr(again, name), getattr(changed, name))


BARE = """<robot name="bare"><link name="base"/><link name="upper"><inertial>
  <origin xyz=".1 0 0"/><mass value="2"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".02"
  iyz="0" izz=".02"/></inertial></link>{}
  <joint name="first" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint>
  <joint name="second" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz=".3 0 0" rpy="0 .2 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="2"/></joint>
  <link name="tool"><inertial><mass value=".1"/><inertia ixx=".001" ixy="0" ixz="0"
    iyy=".001" iyz="0" izz=".001"/></inertial></link>
  <joint name="held" type="fixed"><parent link="lower"/><child link="tool"/></joint>
</robot>"""


@pytest.mark.parametrize(
    "link", ['<link name="lower"/>', '<link name="lower"><!-- nothing --></link>']
)
def test_a_link_of_a_urdf_that_only_holds_a_tool_takes_mass_rotor_and_friction(
    link, tmp_path
):
    (tmp_path / "arm.urdf").write_text(BARE.format(link))
    robot, _ = quiet(Robot.load, tmp_path / "arm.urdf")
    inertial = robot.chain.inertial.copy()
    inertial[1] = [1.5, 0.15, 0.0, 0.03, 0.01, 0.0, 0.03, -0.002, 0.0, 0.03]
    chain = replace(robot.chain, inertial=inertial, armature=np.array([0.2, 0.1]))
    dry = {"damping": np.array([0.3, 0.2]), "frictionloss": np.array([0.0, 0.4])}
    new = replace(robot, chain=chain, **dry)
    build_simulator(new, kind="urdf").write(tmp_path / "new.urdf")
    again, _ = quiet(Robot.load, tmp_path / "new.urdf")
    np.testing.assert_allclose(again.chain.inertial, inertial, atol=1e-12)
    np.testing.assert_allclose(again.chain.armature, [0.2, 0.1])
    for name, values in dry.items():
        np.testing.assert_allclose(getattr(again, name), values)


@pytest.mark.parametrize(
    ("actuator", "effect", "note"),
    [
        (
            "",
            ActuatorLag((0,), {"time": 0.02}),
            "drive of turns, which has no actuator",
        ),
        (
            '<general joint="turns" gaintype="affine" gainprm="1 0 0"/>',
            TorqueGain((0,), {"gain": 0.1}),
            "a change of the torque of turns, whose actuator has no place",
        ),
        (
            '<general joint="turns" dyntype="integrator" actrange="-1 1"/>',
            ActuatorLag((0,), {"time": 0.02}),
            "a lag of turns, whose actuator has no place",
        ),
    ],
)
def test_what_an_actuator_has_no_place_for_is_said(actuator, effect, note, tmp_path):
    (tmp_path / "arm.xml").write_text(with_actuator(actuator))
    made = build_simulator(Robot.load(tmp_path / "arm.xml"), [effect])
    assert any(note in x for x in made.notes), made.notes


def test_a_servo_that_inherits_its_range_keeps_it_with_other_gains(tmp_path):
    servo = '<position joint="turns" kp="20" kv="2" inheritrange="0.5"/>'
    softer = ControllerGain((0,), {"stiffness": -0.4, "damping": 0.5})
    old, new = edited(with_actuator(servo), tmp_path, None, [softer])
    np.testing.assert_allclose(new.actuator_ctrlrange, old.actuator_ctrlrange)
    np.testing.assert_allclose(new.actuator_gainprm[0, 0], 0.6 * 20.0)
    np.testing.assert_allclose(new.actuator_biasprm[0, :3], [0.0, -12.0, -3.0])


def test_changes_of_an_actuator_add_up_each_in_its_way():
    first = {"gain": 0.5, "limit": 10.0, "lag": 0.01, "damping": 3.0}
    then = {"gain": 0.5, "limit": 12.0, "lag": 0.02, "stiffness": 2.0, "latency": 0.1}
    both = Actuator(
        gain=0.25, lag=0.03, limit=10.0, latency=0.1, stiffness=2.0, damping=3.0
    )
    assert Actuator().and_then(first).and_then(then) == both
    assert Actuator().and_then(then).and_then(first) == both


def test_a_ball_joint_has_no_place_in_a_urdf(tmp_path):
    text = (MODELS / "planar.xml").read_text()
    ball = '<body><joint type="ball"/><geom size=".01"/></body></worldbody>'
    text = re.sub("<custom>.*</custom>", "", text, flags=re.DOTALL)
    text = re.sub("<keyframe>.*</keyframe>", "", text, flags=re.DOTALL)
    (tmp_path / "arm.xml").write_text(text.replace("</worldbody>", ball, 1))
    robot, _ = quiet(Robot.load, tmp_path / "arm.xml")
    with pytest.raises(RobotError, match="free or a ball"):
        build_simulator(robot, kind="urdf")


def test_a_xacro_file_is_expanded_and_edited(tmp_path):
    pytest.importorskip("xacro")
    text = (MODELS / "planar.urdf").read_text()
    (tmp_path / "arm.urdf.xacro").write_text(
        text.replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ', 1)
    )
    robot = Robot.load(tmp_path / "arm.urdf.xacro")
    for kind, suffix in (("urdf", "urdf"), ("mjcf", "xml")):
        made = build_simulator(robot, [Coulomb((0,), {"level": 0.5})], kind=kind)
        made.write(tmp_path / f"new.{suffix}")
        again = Robot.load(tmp_path / f"new.{suffix}", joints=robot.joints)
        assert again.frictionloss[0] == robot.frictionloss[0] + 0.5
    assert made.robot.path == robot.path and made.text.count(b"<geom") > 0


def test_friction_of_a_tendon_counts_as_often_as_it_pulls(tmp_path):
    text = (MODELS / "planar.xml").read_text()
    joint = '<joint name="elbow"'
    assert text.count(joint) == 1
    soft = f'{joint} solreffriction="0 -1"'  # its own rises, the tendon's is dry
    rope = '<fixed frictionloss="0.4"><joint joint="elbow" coef="-2"/></fixed>'
    text = text.replace(joint, soft).replace(
        "</mujoco>", f"<tendon>{rope}</tendon></mujoco>"
    )
    (tmp_path / "arm.xml").write_text(text)
    robot = Robot.load(tmp_path / "arm.xml")
    assert robot.knee[1] > 0
    assert robot.frictionloss[1] == pytest.approx(0.8)
    more = replace(robot, frictionloss=robot.frictionloss + [0.0, 0.4])
    build_simulator(more).write(tmp_path / "new.xml")
    again = Robot.load(tmp_path / "new.xml")
    assert again.frictionloss[1] == pytest.approx(1.2)
    assert again.knee[1] == robot.knee[1]


@pytest.mark.parametrize("dry", [0.0, 1.5])
def test_friction_that_rises_to_a_level_is_written_and_read_back(dry, tmp_path):
    robot = Robot.load(MODELS / "planar.xml")
    rising = {"rising": 2.0, "threshold": 0.2, "width": 0.0, "viscous": 0.4}
    rising |= {"coulomb_positive": dry, "coulomb_negative": 0.9 * dry}
    own = [*declared_effects(robot), ThresholdFriction((1,), rising)]
    bare = replace(robot, damping=0 * robot.damping, frictionloss=0 * robot.damping)
    bare = replace(bare, chain=replace(robot.chain, armature=0 * robot.damping))
    own = [e for e in own if e.joints != (1,) or e.id != "coulomb"]
    moved = motions(robot, count=2)
    made = build_simulator(bare, own, motions=moved, folder=tmp_path)
    made.write(tmp_path / "arm.xml")
    again = Robot.load(tmp_path / "arm.xml")
    assert again.knee[1] == pytest.approx(2.0, rel=0.05)
    assert again.frictionloss[1] == pytest.approx(0.95 * dry, abs=0.1)
    (friction,) = plan(bare, own, "mjcf", moved).friction
    assert friction.missed < 0.02 * friction.torque
    ours = torque(again, moved[0])[:, 1]
    theirs = file_inverse_dynamics(tmp_path / "arm.xml", robot.joints, moved[0], {})[
        :, 1
    ]
    moving = np.abs(moved[0].v[:, 1]) > 1e-3
    np.testing.assert_allclose(theirs[moving], ours[moving], atol=1e-6)
    # Nothing new: nothing changes, also where mass moves and softness has to.
    same = build_simulator(again)
    assert same.diff() == ""
    heavier = again.with_inertial(1.3 * again.chain.inertial)
    np.testing.assert_allclose(
        build_simulator(heavier).robot.knee_speed, again.knee_speed, rtol=1e-9
    )


@pytest.mark.parametrize("share", [0.4, 0.6, 0.8])
def test_friction_whose_slope_falls_and_rises_is_approximated(share):
    robot = Robot.load(MODELS / "planar.xml")
    moved = [(m, RigidBody(robot.chain, m)) for m in motions(robot, count=1)]
    fastest = np.abs(moved[0][0].v[:, 1]).max()
    w = share * fastest
    law = (
        Viscous((1,), {"coefficient": 2.0}),
        NonlinearViscous((1,), {"quadratic": -4.0 / w, "cubic": 2.0 / w**2}),
    )
    fields = ("frictionloss", "damping", "quadratic", "cubic")
    found = approximate_friction(law, {}, moved, fields)
    # Of nine curves, none has this law's own w; straight lines leave half of it.
    assert found.missed < 0.15 * found.torque
    plain = approximate_friction(law, {}, moved, fields[:2])
    assert plain.missed > 3 * found.missed
    v = np.linspace(-2 * fastest, 2 * fastest, 401)
    assert (curve(found.values, v) * v >= -1e-9).all()


def test_friction_of_slow_logs_does_not_run_away_up_to_the_speed_limit(tmp_path):
    robot = Robot.load(MODELS / "planar.xml")
    limit = robot.v_max[1]
    slow = [replace(m, v=0.3 * m.v) for m in motions(robot, count=1)]
    seen = np.abs(slow[0].v[:, 1]).max()
    rises = ThresholdFriction(
        (1,), {"coulomb_positive": 1.0, "coulomb_negative": 1.0, "rising": 1.5,
               "viscous": 1.0, "threshold": 0.1 * seen, "width": 0.01 * seen,
               "fastest": seen},
    )  # fmt: skip
    load = LoadFriction((1,), {"coefficient": 0.2})
    made = build_simulator(robot, [rises, load], motions=slow, folder=tmp_path)
    made.write(tmp_path / "arm.xml")
    m = slow[0]
    still = replace(m, v=0 * m.v, a=0 * m.a)
    fast = replace(still, v=np.tile([0.0, limit], (len(m.t), 1)))
    with_friction, without = (
        file_inverse_dynamics(tmp_path / "arm.xml", robot.joints, x, {})[:, 1]
        for x in (fast, replace(fast, v=-fast.v))
    )
    file = np.mean(with_friction - without) / 2
    law = sum(
        e.torque(fast, RigidBody(robot.chain, still))[:, 0].mean()
        for e in (rises, load)
    )
    assert file == pytest.approx(law + robot.damping[1] * limit, rel=0.3)


def test_ripple_is_cogging_of_a_motor_that_nothing_commands(tmp_path):
    robot = Robot.load(MODELS / "planar.xml")
    waves = [
        TorqueRipple((1,), {"sine": 0.5, "cosine": -0.2, "periods": 7.0}),
        TorqueRipple((0,), {"sine": -0.4, "cosine": 0.3, "periods": 1.0}),
    ]
    made = build_simulator(robot, waves, folder=tmp_path)
    assert made.notes == () and made.rest == ()
    model, again = read_again(tmp_path, made, robot)
    assert model.nu == robot.size  # commands stay what they were
    (motion,) = motions(robot, count=1, duration=3.0)
    wanted = torque(robot, motion)
    for wave in waves:
        (j,) = wave.joints
        wanted[:, j] += wave.torque(motion, RigidBody(robot.chain, motion))[:, 0]
    np.testing.assert_allclose(torque(again, motion), wanted, atol=1e-9)
    theirs = file_inverse_dynamics(tmp_path / "sim.xml", robot.joints, motion, {})
    moving = (np.abs(motion.v) > 0.1).all(axis=1)
    np.testing.assert_allclose(theirs[moving], wanted[moving], atol=1e-6)
    # How the reader has it change with position.
    q = motion.q[::100]
    slope = (again.joint_torque(q + 1e-6, 0 * q, 0 * q)
             - again.joint_torque(q - 1e-6, 0 * q, 0 * q)) / 2e-6  # fmt: skip
    np.testing.assert_allclose(again.position_slope(q), slope, atol=1e-6)
    # Without it the file is what it was.
    bare = replace(again, ripple=np.zeros((0, 4)))
    assert b"dcmotor" not in build_simulator(bare).text
    assert build_simulator(again).diff() == ""


def test_a_spring_that_is_relaxed_elsewhere_is_written_and_no_other(tmp_path):
    text = NAMELESS.replace('damping=".2"', 'damping=".2" stiffness="3" springref="20"')

    def moved(own):
        assert own.springref[0] == pytest.approx(np.deg2rad(20.0))
        return replace(own, springref=own.springref + [0.1, 0.0])

    old, new = edited(text, tmp_path, moved)
    assert new.qpos_spring - old.qpos_spring == pytest.approx([0.1, 0.0])
    assert new.jnt_stiffness == pytest.approx([3.0, 0.0])
    same, again = edited(
        text, tmp_path, lambda own: replace(own, damping=own.damping * 2)
    )
    np.testing.assert_array_equal(again.qpos_spring, same.qpos_spring)
    text = (tmp_path / "new.xml").read_text()
    assert text.count("springref") == 1 and 'springref="20"' in text


def test_dry_friction_is_as_hard_as_a_step_lets_it_be(tmp_path):
    """Its time constant is two steps, the least that MuJoCo takes."""
    old, new = edited(NAMELESS, tmp_path, None, [Coulomb((0,), {"level": 0.4})])
    assert new.dof_frictionloss == pytest.approx([0.4, 0.0])
    assert new.dof_solref[0] == pytest.approx([2 * old.opt.timestep, 1.0])
    assert new.dof_solref[1] == pytest.approx(old.dof_solref[1])


def test_a_gain_multiplies_all_that_an_actuator_gives(tmp_path):
    """What it gives without a command, its stiffness and its damping."""
    drive = '<general joint="turns" gainprm="9" biastype="affine" biasprm="2 -9 -1"/>'
    gain = TorqueGain((0,), {"gain": 0.25})
    old, new = edited(with_actuator(drive), tmp_path, None, [gain])
    part = 1 / 1.25  # of the torque asked for, so that what is logged is it
    assert new.actuator_gainprm[0, 0] == pytest.approx(part * 9)
    assert new.actuator_biasprm[0, :3] == pytest.approx(part * np.array([2, -9, -1]))


def test_meshes_of_a_urdf_are_found_from_where_its_mjcf_will_stand(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "cube.obj").write_text(CUBE)
    shape = (
        '<collision><geometry><mesh filename="meshes/cube.obj"/></geometry></collision>'
    )
    bare = BARE.format('<link name="lower"/>')
    text = bare.replace("</inertial></link>", f"</inertial>{shape}</link>", 1)
    (tmp_path / "arm.urdf").write_text(text)
    robot, _ = quiet(Robot.load, tmp_path / "arm.urdf")
    (tmp_path / "out" / "deep").mkdir(parents=True)
    chain = replace(robot.chain, armature=np.array([0.1, 0.2]))
    made, _ = quiet(
        build_simulator, replace(robot, chain=chain), folder=tmp_path / "out" / "deep"
    )
    made.write(tmp_path / "out" / "deep" / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "deep" / "arm.xml"))
    assert model.nmesh == 1
    assert model.dof_armature[:2] == pytest.approx([0.1, 0.2])


FALLS = {"level": 1.2, "velocity": 0.15, "exponent": 2.0}


@pytest.fixture
def falling(tmp_path):
    """An arm whose elbow has friction that falls, and its file."""
    robot = Robot.load(MODELS / "planar.xml")
    made = build_simulator(robot, [Stribeck((1,), FALLS)], folder=tmp_path)
    made.write(tmp_path / "arm.xml")
    return robot, made, tmp_path / "arm.xml"


def test_friction_that_falls_is_in_the_file_with_every_digit(falling):
    robot, made, file = falling
    again = Robot.load(file)
    assert made.notes == () and len(made.diff().splitlines()) <= 12
    np.testing.assert_array_equal(again.falling, [[1, 1.2, 0.15]])
    assert build_simulator(again).diff() == ""
    (effect,) = [e for e in declared_effects(again) if e.id == "stribeck"]
    assert effect.joints == (1,) and effect.values == FALLS
    motion = motions(robot, count=1)[0]
    theirs = file_inverse_dynamics(file, robot.joints, motion, {})
    moving = np.abs(motion.v) > 0.05  # where the file's own dry friction is not soft
    np.testing.assert_allclose(theirs[moving], torque(again, motion)[moving], atol=1e-6)
    bare = replace(again, falling=np.zeros((0, 3)))
    assert b"dcmotor" not in build_simulator(bare).text


@pytest.mark.parametrize("speed", [0.01, 0.1, 0.2, 1.0])
def test_bristles_that_slide_have_the_friction_of_the_law(falling, speed):
    model = mujoco.MjModel.from_xml_path(str(falling[2]))
    data, own = mujoco.MjData(model), model.actuator("elbow/falling_1").id
    for _ in range(round(1.0 / model.opt.timestep)):
        data.qvel[:] = 0.0, speed
        mujoco.mj_step(model, data)
    (law,) = Stribeck.law(SimpleNamespace(v=speed, sign=1.0), **FALLS)
    assert -data.actuator_force[own] == pytest.approx(FALLS["level"] * law, 0.01, 1e-9)


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_a_joint_breaks_loose_above_its_sliding_friction_and_stays_at_rest(
    falling, factor
):
    """Also at a longer step than that of the file."""
    model = mujoco.MjModel.from_xml_path(str(falling[2]))
    model.opt.gravity[:], model.opt.timestep = 0.0, factor * model.opt.timestep
    data, dry = mujoco.MjData(model), Robot.load(falling[2]).frictionloss[1]
    asked, seconds = 1.5 * (dry + FALLS["level"]), 3.0
    moved, at = [], []
    while data.time < seconds:
        data.qfrc_applied[1] = asked * data.time / seconds
        mujoco.mj_step(model, data)
        moved.append(abs(data.qvel[1]) > 0.05)
        at.append(data.qfrc_applied[1])
    assert at[moved.index(True)] == pytest.approx(dry + FALLS["level"], rel=0.1)
    data.qfrc_applied[:] = 0.0
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qvel, 0.0, atol=1e-3)


@pytest.mark.study
def test_a_file_with_friction_that_falls_lacks_nothing_of_an_arm_that_has_it(falling):
    robot, _, file = falling
    plant = Plant(robot, [Stribeck((1,), FALLS)])
    logs = simulate(plant, trajectories=2, duration=4.0, seed=3)
    before, after = (
        measure_gap(x, logs, cutoff=15.0) for x in (robot, Robot.load(file))
    )
    rms = [np.sqrt(np.mean(x.left[x.moving[:, 1], 1] ** 2)) for x in (before, after)]
    assert rms[1] < 0.6 * rms[0]
    found = examine(Robot.load(file), logs).diagnosis
    assert (found.verdict, found.findings) == ("no_gap", ())


def test_sliding_friction_of_a_passive_motor_is_dry_friction_of_its_joint(tmp_path):
    """A file that has LuGre friction of its own, and a keyframe of its bristles."""
    text = (MODELS / "planar.xml").read_text()
    motor = (
        '<actuator><dcmotor name="mine" joint="elbow" input="none" motorconst="0" '
        'resistance="1" gear="2" lugre="1e4 10 0.5 0.8 0.2" cogging="0.1 4 0"/>'
        '</actuator><keyframe><key name="bent" qpos="0 1" act="1e-5"/></keyframe>'
    )
    (tmp_path / "own.xml").write_text(text.replace("</mujoco>", motor + "</mujoco>"))
    before, robot = (
        Robot.load(x) for x in (MODELS / "planar.xml", tmp_path / "own.xml")
    )
    assert robot.frictionloss[1] == pytest.approx(before.frictionloss[1] + 1.0)
    np.testing.assert_allclose(robot.falling, [[1, 0.6, 0.1]])
    assert build_simulator(robot).diff() == ""
    made = build_simulator(robot, [Coulomb((1,), {"level": 0.3})])
    model = mujoco.MjModel.from_xml_string(made.text.decode())
    assert model.key("bent").act.shape == (1,)
    assert made.robot.frictionloss[1] == pytest.approx(robot.frictionloss[1] + 0.3)
    np.testing.assert_allclose(made.robot.falling, robot.falling)
    np.testing.assert_allclose(made.robot.ripple, robot.ripple)
    # Beside the callback it has none of its own: all is that of the model.
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "own.xml"))
    data, before = mujoco.MjData(mj), mj.actuator_dynprm.copy()
    own = SimpleNamespace(robot=robot, effects=(), remainder=None)
    installed = install(mj, data, own)
    data.qvel[:] = 1.0
    for _ in range(20):
        mujoco.mj_step(mj, data)
    np.testing.assert_allclose(data.actuator_force[-1], 0.0, atol=1e-9)
    # As a cell of a notebook that is run twice: the first one is gone.
    again = install(mj, data, own)
    installed.remove()
    np.testing.assert_array_equal(mj.actuator_dynprm[-1, 6], 0.0)
    again.remove()
    np.testing.assert_array_equal(mj.actuator_dynprm, before)
