"""The corrected simulator: what MJCF can say of it, and the model with the rest."""

import warnings
from dataclasses import replace
from functools import cache

import diagnosed
import mujoco
import numpy as np
import pytest
from arms import MODELS
from coarse import Plant, simulate
from scipy.interpolate import CubicSpline
from simulated import arm
from test_simulator_file import CUBE

from hybrid.diagnosis.answer.fixed import (
    MODEL,
    SIMULATOR,
    fixed_model,
    fixed_simulator,
    write_fixed,
)
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.measure import measure_gap, split, unseen_samples
from hybrid.dynamics import RigidBody
from hybrid.effects import effect_classes
from hybrid.errors import HybridWarning
from hybrid.exports import build_simulator
from hybrid.exports.simulator.plan import plan
from hybrid.files import atomic_folder
from hybrid.identification import DynamicModel
from hybrid.plant import Noise, random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot
from hybrid.robot.mjcf import knee_slope

EXACT = {
    "coulomb": {}, "viscous": {}, "nonlinear_viscous": {}, "spring": {"preload": 2.0},
    "torque_offset": {}, "torque_gain": {}, "saturation": {"limit": 2.0, "loss": 1.0},
    "actuator_lag": {"time": 0.02}, "transmission_coupling": {}, "gravity_tilt": {},
    "torque_ripple": {"sine": 2.0, "periods": 3.0},
    "stribeck": {"level": 2.0, "velocity": 0.3},
    "stiffening_spring": {"stiffness": 2.0, "rest": 0.3, "knee": 0.5},
}  # fmt: skip
NEARLY = (
    "asymmetric_friction",
    "friction_lag",
    "load_friction",
    "presliding",
    "thermal_friction",
)
NOT = ("encoder_offset", "delay")


def effect_of(name, **values):
    robot, cls = arm("planar"), effect_classes()[name]
    joints = (1,) if cls.scope == "joint" else (0, 1)
    return cls.typical(joints, joint_scales(robot), **values)


@cache
def motion_of(effect_id):
    """A noise-free recording of an arm with an effect; and the gap of its simulator."""
    robot, rng = arm("planar"), np.random.default_rng(4)
    whole = random_fourier(robot, duration=3.5, rate=500.0, seed=rng)
    parts = {x: getattr(whole, x)[whole.t <= 2.0] for x in ("t", "q", "v", "a")}
    reference = replace(whole, **parts)
    effects = [effect_of(effect_id, **EXACT.get(effect_id, {}))] if effect_id else []
    plant = Plant(robot, effects, nominal=robot, noise=Noise.none(robot.size))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # it saturates
        logs = plant.run([reference], seed=rng)
        return logs[0], measure_gap(robot, logs, cutoff=40.0), effects


def written(gap, robot, effects):
    made = build_simulator(robot, effects, motions=gap.motions)
    model = mujoco.MjModel.from_xml_string(made.text.decode())
    # Dry friction as hard as the plant's, also where the file's own is softer; but not
    # what rises to a level, which MuJoCo says by its softness.
    dry = ~np.isfinite(knee_slope(model))
    hard = (2 * model.opt.timestep, 1.0)
    model.dof_solref[dry], model.dof_solimp[dry, :2] = hard, 0.9999
    model.tendon_solref_fri[:], model.tendon_solimp_fri[:, :2] = hard, 0.9999
    return model, made.notes


def left_behind(model, log, start=1.0, seconds=0.5):
    """RMS of what a simulator departs from a log under the log's own torque, rad."""
    data = mujoco.MjData(model)
    joints = [model.joint(name).dofadr[0] for name in arm("planar").joints]
    torque, q = CubicSpline(log.t, log.tau), CubicSpline(log.t, log.q)
    data.qpos[joints], data.qvel[joints] = q(start), q(start, 1)
    own = model.actuator_actadr[: len(joints)]  # of the drives; bristles come after
    data.act[own[own >= 0]] = torque(start)[own >= 0]
    off = []
    for k in range(round(seconds / model.opt.timestep)):
        t = start + k * model.opt.timestep
        data.ctrl[:] = torque(t + model.opt.timestep / 2)
        off.append(data.qpos[joints] - q(t))
        mujoco.mj_step(model, data)
    return float(np.sqrt(np.mean(np.square(off))))


@cache
def left_behind_without_effects():
    log, gap, _ = motion_of(None)
    return left_behind(written(gap, arm("planar"), [])[0], log)


@pytest.mark.parametrize("name", EXACT)
def test_what_mjcf_can_express_repeats_the_motion_of_the_plant(name):
    log, gap, effects = motion_of(name)
    robot = arm("planar")
    before = left_behind(written(gap, robot, [])[0], log)
    model, notes = written(gap, robot, effects)
    assert notes == ()
    floor = left_behind_without_effects()
    assert before > 2 * floor, "the effect shows in motion"
    assert left_behind(model, log) < max(0.1 * before, 1.1 * floor)


def test_stiffening_springs_of_a_file_are_kept_replaced_and_read_again(tmp_path):
    robot, cls = arm("coman_like"), effect_classes()["stiffening_spring"]
    first, second = (
        cls((j,), {"stiffness": 3.0, "rest": -0.4, "knee": 0.8}) for j in (1, 3)
    )
    once = _built_and_read(robot, [first, second], tmp_path / "a.xml")
    np.testing.assert_allclose(once.stiffening[:, 0], [1, 3])
    np.testing.assert_allclose(once.stiffening[:, 1:], 2 * [[3.0, -0.4, 0.8]])
    assert build_simulator(once).diff("a.xml") == ""
    more = _built_and_read(once, [first], tmp_path / "b.xml")
    assert more.stiffening[:, 0].tolist() == [1, 3, 1]
    less = replace(more, stiffening=more.stiffening[1:])
    again = _built_and_read(less, [], tmp_path / "c.xml")
    np.testing.assert_allclose(again.stiffening, less.stiffening)
    q, none = np.linspace(-1.0, 1.0, 7)[:, None] * np.ones(6), np.zeros((7, 6))
    slope = [again.joint_torque(q + h, none, none) for h in (1e-6, -1e-6)]
    difference = (slope[0] - slope[1]) / 2e-6
    np.testing.assert_allclose(again.position_slope(q), difference, atol=1e-6)


def _built_and_read(robot, effects, path):
    made = build_simulator(robot, effects, folder=path.parent)
    assert made.notes == ()
    made.write(path)
    return Robot.load(path, joints=robot.joints)


def test_a_gear_that_twists_becomes_a_spring_behind_the_motor():
    _, gap, _ = motion_of(None)
    model, notes = written(
        gap, arm("planar"), [effect_of("elasticity", compliance=0.01)]
    )
    behind = model.joint(f"{arm('planar').joints[1]}/deflection")
    assert notes == ()
    assert model.jnt_stiffness[behind.id] == pytest.approx(100.0)


@pytest.mark.parametrize("name", NEARLY)
def test_friction_that_mjcf_lacks_is_replaced_and_said_to_be_where_it_misses(name):
    log, gap, effects = motion_of(name)
    robot = arm("planar")
    model, notes = written(gap, robot, effects)
    start = f"friction of {robot.joints[1]} ({name}): "
    (fitted,) = plan(robot, effects, "mjcf", gap.motions).friction
    missed = fitted.missed > 1e-3 * fitted.torque or name == "thermal_friction"
    assert [x.startswith(start) for x in notes] == [True] * missed
    assert left_behind(model, log) < 0.8 * left_behind(written(gap, robot, [])[0], log)


@pytest.mark.parametrize("name", NOT)
def test_what_has_no_place_in_mjcf_is_only_listed(name):
    _, gap, effects = motion_of(name)
    model, (note,) = written(gap, arm("planar"), effects)
    plain, _ = written(gap, arm("planar"), [])
    assert note.startswith(f"{name} of {arm('planar').joints[1]} (")
    for field in ("dof_damping", "dof_frictionloss", "dof_armature", "body_mass"):
        np.testing.assert_array_equal(getattr(model, field), getattr(plain, field))


def test_friction_below_zero_is_cut_and_said():
    _, gap, _ = motion_of("coulomb")
    robot = arm("planar")
    wrong = effect_of("viscous", coefficient=-10 * robot.damping[1])
    model, notes = written(gap, robot, [wrong])
    assert model.dof_damping.min() >= 0
    (note,) = notes
    assert note.startswith(f"friction of {robot.joints[1]} (viscous): dry")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The corrected simulator of a diagnosed arm."""
    path = tmp_path_factory.mktemp("fixed")
    return path, write_fixed(diagnosed.planar(), path)


def load(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        return Robot.load(path, joints=arm("planar").joints)


def test_both_files_load_and_say_what_the_simulator_lacks(folder):
    path, notes = folder
    mujoco.MjModel.from_xml_path(str(path / SIMULATOR))
    robot, model = load(path / SIMULATOR), DynamicModel.load(path / MODEL)
    assert robot.joints == arm("planar").joints
    np.testing.assert_allclose(robot.q_max, arm("planar").q_max, rtol=1e-5)
    np.testing.assert_allclose(robot.v_max, arm("planar").v_max, rtol=1e-5)
    np.testing.assert_allclose(robot.tau_max, arm("planar").tau_max, rtol=1e-5)
    found = {e.id for e in diagnosed.planar().effects}
    assert found <= {e.id for e in model.effects}
    ripples = [e for e in model.effects if e.id == "torque_ripple"]
    assert robot.ripple[:, 3].tolist() == [e.values["periods"] for e in ripples] != []
    head = (path / SIMULATOR).read_text(encoding="utf-8").split("-->")[0]
    assert all(note in head for note in notes)


def test_the_model_predicts_what_the_findings_explain(folder):
    path, _ = folder
    gap, model = diagnosed.planar().gap, DynamicModel.load(path / MODEL)
    before, after = np.zeros(2), np.zeros(2)
    for k, (motion, _, sampler) in enumerate(gap):
        own = gap.trajectory == k
        left = gap.left[own] - sampler(model.predict(motion) - motion.tau)
        use = gap.moving[own]
        before += np.where(use, gap.left[own] ** 2, 0.0).sum(axis=0)
        after += np.where(use, left**2, 0.0).sum(axis=0)
    count = gap.moving.sum(axis=0)
    floor = np.array(diagnosed.planar().diagnosis.noise_floor)
    assert np.all(np.sqrt(after / count) < 0.6 * np.sqrt(before / count))
    np.testing.assert_allclose(np.sqrt(after / count), floor, rtol=0.1)


def test_the_written_links_are_the_fitted_ones(folder):
    path, _ = folder
    result = diagnosed.planar()
    robot, (own, _) = load(path / SIMULATOR), fixed_simulator(result)
    for motion in result.gap.motions:
        np.testing.assert_allclose(
            RigidBody(robot.chain, motion).load,
            RigidBody(own.chain, motion).load,
            rtol=1e-4,
            atol=1e-4,
        )


def test_nothing_found_leaves_the_simulator_as_it_stands(tmp_path):
    bare = replace(diagnosed.planar(), effects=())
    assert write_fixed(bare, tmp_path) == ()
    robot, original = load(tmp_path / SIMULATOR), bare.gap.robot
    for name in ("damping", "frictionloss"):
        np.testing.assert_allclose(getattr(robot, name), getattr(original, name))
    np.testing.assert_allclose(
        robot.chain.inertial, original.chain.inertial, rtol=1e-5, atol=1e-7
    )


def test_the_model_of_a_plain_simulator_has_its_torque():
    _, gap, _ = motion_of("coulomb")
    model = fixed_model(gap, gap.robot, ())
    for motion, _, _ in gap:
        np.testing.assert_allclose(model.predict(motion), motion.tau, atol=1e-9)


def test_a_folder_that_is_moved_when_it_is_whole_still_finds_its_meshes(tmp_path):
    plain = (MODELS / "planar.xml").read_text()
    mesh = '<asset><mesh name="cup" file="cup.obj"/></asset><worldbody>'
    shown = '<geom type="mesh" mesh="cup" contype="0" conaffinity="0"/>'
    own = tmp_path / "arm" / "planar.xml"
    (own.parent / "meshes").mkdir(parents=True)
    (own.parent / "meshes" / "cup.obj").write_text(CUBE)
    text = plain.replace("<worldbody>", mesh + shown, 1)
    own.write_text(text.replace("<compiler ", '<compiler meshdir="meshes" ', 1))
    bare = replace(diagnosed.planar(), effects=())
    robot = replace(bare.gap.robot, path=str(own))
    bare = replace(bare, gap=replace(bare.gap, robot=robot))
    out = tmp_path / "some" / "where"
    with atomic_folder(out) as folder:
        write_fixed(bare, folder, home=out)
    fixed, before = (
        mujoco.MjModel.from_xml_path(str(x)) for x in (out / "sim_fixed.xml", own)
    )
    assert (fixed.nmesh, fixed.ngeom) == (before.nmesh, before.ngeom)
    data = mujoco.MjData(fixed)
    mujoco.mj_step(fixed, data)
    assert np.isfinite(data.qpos).all()


@pytest.mark.study
def test_the_gap_of_the_repaired_simulator_is_that_of_the_written_file(tmp_path):
    """Of a file with placeholders for links, whose best numbers are not physical."""
    true = arm("coman_like")
    robot = true.with_inertial(0.1 * true.chain.inertial)
    plant = Plant(true, [], nominal=robot, noise=Noise.typical(true))
    logs = simulate(plant, trajectories=4, duration=5.0, seed=3)
    result = examine(robot, logs)
    model = fixed_model(result.gap, *fixed_simulator(result))
    held_out = unseen_samples(result.gap, split(result.gap))
    modelled = np.concatenate([take(model.predict(m)) for m, _, take in result.gap])
    for j, said in enumerate(result.diagnosis.unseen.after):
        rows = held_out & result.gap.moving[:, j]
        left = (result.gap.measured - modelled)[rows, j]
        assert np.sqrt(np.mean(left**2)) < 1.12 * said
