"""Simulators written from a model: loaded back, rolled out, completed by a callback."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arms import MODELS
from coarse import load_truth, simulate
from compiled_model import CompiledModel
from mujoco_inverse import file_inverse_dynamics
from simulated import motions, quiet
from test_export import full_model, model_of, motion_of

from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.payload import Payload
from hybrid.effects.presliding import Presliding
from hybrid.effects.stiffening_spring import StiffeningSpring
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError, RobotError
from hybrid.exports import export, missing_model, model_simulator
from hybrid.exports.simulator.check import file_torque
from hybrid.exports.simulator.simulator import build_simulator
from hybrid.identification.preparation import log_hash
from hybrid.plant import install
from hybrid.plant.joint_fields import split_effects
from hybrid.plant.lockstep import Lockstep
from hybrid.recording import read_all, write
from hybrid.robot import Robot


def declared(robot):
    """What a robot file declares, as effects."""
    kinds = (
        (Armature, "inertia", robot.chain.armature),
        (Coulomb, "level", robot.frictionloss),
        (Viscous, "coefficient", robot.damping),
    )
    return [
        cls((j,), {name: float(x)})
        for cls, name, values in kinds
        for j, x in enumerate(values)
    ]


def true_model():
    """The COMAN-like arm as it is."""
    _, plant = load_truth(MODELS / "coman_truth.yaml")
    model = model_of(plant.robot, [*plant.effects, *declared(plant.robot)])
    return model, plant


def rollout(folder, model, plant, *, complete):
    """Largest difference of an exported simulator from the plant, one second, [rad]."""
    mj = mujoco.MjModel.from_xml_path(str(folder / "coman_like.xml"))
    mj.opt.timestep, mj.opt.tolerance = plant.step, 1e-12
    mj.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    mj.dof_solref[:], mj.dof_solimp[:, :2] = (2 * plant.step, 1.0), 0.9999
    data, real = mujoco.MjData(mj), Lockstep(plant.arm, plant.effects, np.zeros((1, 6)))
    added = install(mj, data, model) if complete else None
    rng = np.random.default_rng(0)
    speed, size = rng.uniform(2, 6, 6), 0.2 * model.robot.tau_max
    worst = 0.0
    for k in range(round(1.0 / plant.step)):
        tau = size * (np.sin(speed * k * plant.step) - 3.0 * real.q[0])
        tau -= 0.05 * model.robot.tau_max * real.v[0]
        data.ctrl[:] = tau
        mujoco.mj_step(mj, data)
        real.step(tau[None])
        worst = max(worst, float(np.abs(data.qpos - real.q[0]).max()))
    if added is not None:
        assert added.left_out == ()
        added.remove()
    return worst


def test_an_exported_simulator_moves_as_the_plant_and_the_callback_adds_the_rest(
    tmp_path,
):
    model, plant = true_model()
    left_out = export(model, tmp_path, format="mjcf")
    assert any(text.startswith("friction of base (stribeck") for text in left_out)
    exported = rollout(tmp_path, model, plant, complete=False)
    completed = rollout(tmp_path, model, plant, complete=True)
    nominal = Robot.load(MODELS / "coman_like.xml")
    export(model_of(nominal, declared(nominal)), tmp_path / "nominal", format="mjcf")
    before = rollout(tmp_path / "nominal", model, plant, complete=False)
    assert exported < 0.9 * before
    assert completed < 0.01
    assert completed < exported / 10


def test_exported_c_beside_an_exported_simulator_moves_as_the_callback(tmp_path):
    model, plant = true_model()
    made = model_simulator(model, folder=tmp_path)
    made.write(tmp_path / "arm.xml")
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    mj.opt.timestep, mj.opt.integrator = plant.step, mujoco.mjtIntegrator.mjINT_EULER
    code = CompiledModel(missing_model(model, made), step=plant.step)
    index = [mj.joint(name).qposadr[0] for name in model.robot.joints]
    rng = np.random.default_rng(1)
    speed, size = rng.uniform(2, 6, 6), 0.3 * model.robot.tau_max

    def roll(step, data):
        for k in range(round(0.5 / plant.step)):
            data.ctrl[:] = size * np.sin(speed * k * plant.step)
            step(data)
            mujoco.mj_step(mj, data)
        return data.qpos[index].copy()

    def by_code(data):
        state = (x[index] for x in (data.qpos, data.qvel, data.qacc))
        data.qfrc_applied[index] = -code.predict(*state)

    alone = roll(lambda _: None, mujoco.MjData(mj))
    beside = roll(by_code, mujoco.MjData(mj))
    data = mujoco.MjData(mj)
    added = install(mj, data, model)
    called = roll(lambda _: None, data)
    added.remove()
    off = np.abs(beside - called).max()
    assert off < 3e-3  # rad, after half a second
    assert off < 0.25 * np.abs(alone - called).max()


RIPPLE = TorqueRipple((1,), {"sine": 0.6, "cosine": 0.3, "periods": 3.0})

HOSE = StiffeningSpring((1,), {"stiffness": 3.0, "rest": 0.2, "knee": 0.7})


@pytest.mark.parametrize(
    "effects",
    [
        [RIPPLE],
        [RIPPLE.at({"fastest": 1.0})],
        [LoadFriction((1,), {"coefficient": 0.2})],
        [HOSE],
        [Viscous((0,), {"coefficient": 3.0}), Coulomb((1,), {"level": 0.7})],
    ],
    ids=["ripple", "ripple that fades", "friction with load", "hose", "friction"],
)
def test_a_file_and_what_it_misses_are_the_model(effects, tmp_path):
    robot = Robot.load(MODELS / "planar.xml")
    model = model_of(robot, [*declared(robot), *effects])
    made = model_simulator(model, folder=tmp_path)
    made.write(tmp_path / "arm.xml")
    (motion,) = motions(robot, count=1, duration=6.0)
    file = file_torque(tmp_path / "arm.xml", model, motion)
    joints, fast = robot.joints, np.abs(motion.v).min(axis=1) > 0.05
    theirs = file_inverse_dynamics(tmp_path / "arm.xml", joints, motion, {})
    np.testing.assert_allclose(theirs[fast], file[fast], atol=1e-6)
    found = file + missing_model(model, made).predict(motion)
    off = np.abs(found - model.predict(motion))[fast]
    assert off.max() < 1e-6


def test_a_stiffening_spring_of_the_file_pulls_once_where_the_model_is_installed(
    tmp_path,
):
    robot = Robot.load(MODELS / "planar.xml")
    model = model_of(robot, [*declared(robot), HOSE])
    model_simulator(model, folder=tmp_path).write(tmp_path / "arm.xml")
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data, pulls = mujoco.MjData(mj), []
    data.qpos[1] = 1.1
    for installed in (False, True):
        added = install(mj, data, model) if installed else None
        mujoco.mj_forward(mj, data)
        pulls.append(float(data.qfrc_passive[1]))
        if added:
            added.remove()
    bent = 1.1 - 0.2
    assert pulls == pytest.approx(2 * [-3.0 * bent * (1.0 + (bent / 0.7) ** 2)])


def test_friction_with_a_memory_holds_a_joint_in_a_running_simulation():
    """A push below the level bends the asperities and moves nothing else."""
    robot = Robot.load(MODELS / "planar.xml")
    mj = mujoco.MjModel.from_xml_path(robot.path)
    mj.opt.gravity[:], mj.dof_frictionloss[:], mj.dof_damping[:] = 0.0, 0.0, 0.5
    law = {"level": 2.0, "distance": 0.01}
    slow = Viscous((1,), {"coefficient": 20.0})  # so that it does not overshoot
    model = model_of(robot, [Presliding((1,), law), slow])
    data, moved = mujoco.MjData(mj), []
    for held in (True, False):
        mujoco.mj_resetData(mj, data)
        added = install(mj, data, model) if held else None
        data.ctrl[1] = 1.0
        mujoco.mj_step(mj, data, 1000)
        moved.append(data.qpos[1])
        if added:
            added.remove()
    # It settles where half the level is reached: 1 − exp(−x/δ) = ½.
    assert moved[0] == pytest.approx(0.01 * np.log(2.0), rel=0.2)
    assert moved[1] > 0.2


def test_friction_with_load_is_that_of_the_load_behind_the_ripple(tmp_path):
    """A drive that delivers the model's torque accelerates the arm as it was asked."""
    robot = Robot.load(MODELS / "planar.xml")
    effects = [
        *declared(robot),
        LoadFriction((1,), {"coefficient": 0.2}),
        TorqueRipple((1,), {"sine": 0.6, "cosine": 0.3, "periods": 3.0}),
    ]
    model = model_of(robot, effects)
    export(model, tmp_path, format="mjcf")
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "planar.xml"))
    mj.opt.tolerance, mj.opt.iterations = 0.0, 100
    data, motion = mujoco.MjData(mj), motion_of(robot, 1)
    added = install(mj, data, model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = (
        motion.q[0], np.sign(motion.v[0]), model.predict(
            replace(motion, v=np.sign(motion.v))
        )[0],
    )  # fmt: skip
    for _ in range(40):  # the load is that of the step before
        mujoco.mj_forward(mj, data)
    added.remove()
    np.testing.assert_allclose(data.qacc, motion.a[0], atol=1e-6)


def test_bristles_of_a_file_push_nothing_beside_the_callback(tmp_path):
    """Neither by their level nor by their damping, whatever the file gives them."""
    bristles = (
        "<dcmotor joint='elbow' input='none' motorconst='0' resistance='1' "
        "lugre='1e4 3.0 0.5 0.9 0.2'/>"
    )
    text = (MODELS / "planar.xml").read_text()
    text = text.replace("</actuator>", f"{bristles}</actuator>")
    (tmp_path / "arm.xml").write_text(text)
    model = model_of(quiet(Robot.load, tmp_path / "arm.xml")[0])
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(mj)
    data.qvel[1] = 0.1

    def push():
        mujoco.mj_forward(mj, data)
        return data.actuator_force[-1]

    before = push()
    added = install(mj, data, model)
    assert abs(push()) < 1e-9 < 1e-3 < abs(before)
    added.remove()
    assert push() == before


def test_the_callback_is_gone_when_it_is_removed(tmp_path):
    model, _ = true_model()
    export(model, tmp_path, format="mjcf")
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "coman_like.xml"))
    data = mujoco.MjData(mj)
    data.qpos[:] = 0.3
    mujoco.mj_forward(mj, data)
    plain = data.qfrc_passive.copy()
    added = install(mj, data, model)
    mujoco.mj_forward(mj, data)
    assert np.abs(data.qfrc_passive - plain).max() > 0.1
    added.remove()
    mujoco.mj_forward(mj, data)
    np.testing.assert_array_equal(data.qfrc_passive, plain)


def test_a_learned_torque_is_felt_in_the_simulation(tmp_path):
    model = replace(full_model(), effects=())
    export(model, tmp_path, format="mjcf")
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "coman_like.xml"))
    data = mujoco.MjData(mj)
    data.qpos[:], data.qvel[:] = 0.2, 0.5
    added = install(mj, data, model)
    mujoco.mj_forward(mj, data)
    added.remove()
    expected = model.remainder.predict(data.qpos[None], data.qvel[None])[0]
    np.testing.assert_allclose(data.qfrc_passive, -expected, atol=1e-12)


@pytest.mark.parametrize("kind, suffix", [("mjcf", "xml"), ("urdf", "urdf")])
def test_a_robot_file_loads_back_with_the_identified_numbers(tmp_path, kind, suffix):
    model, plant = true_model()
    exact = [e for e in model.effects if e.id in ("armature", "coulomb", "viscous")]
    model = replace(model, effects=tuple(exact))
    left_out = export(model, tmp_path, format=kind)
    assert all(x.endswith("of the MJCF file") for x in left_out)
    assert len(left_out) == (kind == "urdf")
    found, _ = quiet(Robot.load, tmp_path / f"coman_like.{suffix}")
    robot = plant.robot
    assert found.joints == robot.joints
    total = {name: np.zeros(6) for name in ("armature", "damping", "frictionloss")}
    total |= split_effects(model.effects, tuple(total), 6)[0]
    np.testing.assert_allclose(found.chain.armature, total["armature"], rtol=1e-12)
    np.testing.assert_allclose(found.frictionloss, total["frictionloss"], rtol=1e-12)
    np.testing.assert_allclose(found.damping, total["damping"], rtol=1e-12)
    for name in ("q_min", "q_max", "v_max", "a_max", "tau_max"):
        np.testing.assert_allclose(getattr(found, name), getattr(robot, name), 1e-12)
    motion = motion_of(robot, 50)
    rigid = model_of(robot).predict(motion)
    again = model_of(found).predict(motion)
    np.testing.assert_allclose(again, rigid, rtol=0, atol=1e-11 * np.abs(rigid).max())


def test_a_payload_becomes_part_of_the_last_link(tmp_path):
    robot = Robot.load(MODELS / "coman_like.xml")
    values = {"mass": 2.0, "mz": 0.2, "Ixx": 0.03, "Iyy": 0.03, "Izz": 0.01}
    model = model_of(robot, [Payload(tuple(range(6)), values)])
    assert export(model, tmp_path, format="mjcf") == ()
    found = Robot.load(tmp_path / "coman_like.xml")
    motion = motion_of(robot, 50)
    expected = model.predict(motion)
    np.testing.assert_allclose(
        model_of(found).predict(motion), expected, atol=1e-11 * np.abs(expected).max()
    )


def test_friction_is_split_into_what_a_joint_has_fields_for_and_the_rest():
    values = {"coulomb_positive": 3.0, "coulomb_negative": 2.0, "viscous": 4.0}
    law = ThresholdFriction((1,), {**values, "falling": 0.5, "width": 0.0})
    fields, rest = split_effects([law], ("frictionloss", "damping"), 3)
    np.testing.assert_array_equal(fields["frictionloss"], [0.0, 2.0, 0.0])
    np.testing.assert_array_equal(fields["damping"], [0.0, 4.0, 0.0])
    assert rest[0].values["coulomb_positive"] == 1.0
    assert rest[0].values["coulomb_negative"] == rest[0].values["viscous"] == 0.0
    assert rest[0].values["falling"] == 0.5
    fields, rest = split_effects([law.at({"width": 0.01})], tuple(fields), 3)
    assert fields["frictionloss"][1] == 0.0 and fields["damping"][1] == 4.0
    assert rest[0].values["coulomb_negative"] == 2.0


def test_what_a_urdf_has_no_place_for_is_in_its_manifest(tmp_path):
    model, _ = true_model()
    left_out = export(model, tmp_path, format="urdf")
    assert any(x.startswith("friction of base (") for x in left_out)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert tuple(manifest["left_out"]) == left_out


def test_links_that_could_not_be_built_are_refused(tmp_path):
    model = replace(full_model(), inertial=None)
    with pytest.raises(HybridError, match="identify with consistent=True"):
        export(model, tmp_path / "new", format="mjcf")
    assert not (tmp_path / "new").exists()


def test_a_simulation_of_another_arm_is_refused():
    mj = mujoco.MjModel.from_xml_path(str(MODELS / "planar.xml"))
    with pytest.raises(HybridError, match="the simulation has no joint base"):
        install(mj, mujoco.MjData(mj), full_model())


def test_the_command_line_writes_the_file_it_is_given(tmp_path, monkeypatch):
    from hybrid.cli import main

    robot = Robot.load(MODELS / "planar.xml")
    model = model_of(robot, [Coulomb((0,), {"level": 0.5})])
    model.save(tmp_path / "model.json")
    given = ["--model", str(tmp_path / "model.json"), "--format", "mjcf"]
    monkeypatch.chdir(MODELS)  # a file of the model's name here is not the model's
    main(["export", *given, "--out", str(tmp_path / "bare")])
    main(["export", *given, "--robot", robot.path, "--out", str(tmp_path / "own")])
    bare, own = (
        mujoco.MjModel.from_xml_path(str(tmp_path / x / "planar.xml"))
        for x in ("bare", "own")
    )
    assert bare.ngeom == 0 and own.ngeom > 5
    np.testing.assert_array_equal(own.dof_frictionloss, [0.5, 0.0])
    assert (tmp_path / "own" / "planar.diff").stat().st_size > 0
    named = [*given, "--robot", "planar", "--out", str(tmp_path / "named")]
    assert main(["export", *named]) == 0
    missing = [*given, "--robot", str(tmp_path / "no.xml")]
    assert main(["export", *missing, "--out", str(tmp_path / "x")]) == 2


@pytest.mark.parametrize("kind", ["mjcf", "urdf"])
@pytest.mark.parametrize("suffix", ["xml", "urdf"])
def test_a_file_of_another_arm_is_not_converted(tmp_path, kind, suffix):
    robot = Robot.load(MODELS / "planar.xml")
    path = tmp_path / f"planar.{suffix}"
    build_simulator(robot, kind="mjcf" if suffix == "xml" else "urdf").write(path)
    other = Robot.load(path)
    chain = replace(other.chain, translation=1.1 * other.chain.translation)
    with pytest.raises(RobotError, match="is of another arm"):
        build_simulator(replace(other, chain=chain), kind=kind)


@pytest.mark.parametrize("kind", ["mjcf", "urdf", "isaaclab"])
def test_the_command_line_refuses_a_file_of_another_arm(tmp_path, capsys, kind):
    from hybrid.cli import main

    robot = Robot.load(MODELS / "planar.xml")
    model_of(robot, [Coulomb((0,), {"level": 0.5})]).save(tmp_path / "model.json")
    given = ["--model", str(tmp_path / "model.json"), "--format", kind]
    given += ["--out", str(tmp_path / "out"), "--robot"]
    assert main(["export", *given, str(MODELS / "scara.xml")]) == 2
    assert "error: " in capsys.readouterr().err
    assert main(["export", *given, str(MODELS / "coman_like.xml")]) == 2
    assert main(["export", *given, str(MODELS / "planar.xml")]) == 0


def test_export_fits_to_the_recordings_it_is_given_and_shows_what_is_missed(
    tmp_path, capsys
):
    from hybrid.cli import main

    robot = Robot.load(MODELS / "planar.xml")
    curve = {"rising": 1.5, "threshold": 0.3, "viscous": 0.4, "width": 0.0}
    own = [e for e in declared(robot) if e.id == "armature"]
    law = ThresholdFriction((1,), curve)
    model = model_of(robot, [*own, law], standing=np.full(2, 0.01))
    model.save(tmp_path / "model.json")
    logs = simulate(
        replace(robot, damping=0 * robot.damping, frictionloss=0 * robot.damping),
        [law], trajectories=1, duration=4.0,
    )  # fmt: skip
    write(logs[0], tmp_path / "log.csv")
    given = ["export", "--model", str(tmp_path / "model.json"), "--robot", robot.path,
             "--recordings", str(tmp_path / "log.csv")]  # fmt: skip
    told = ["--json", str(tmp_path / "gap.json"), "--out", str(tmp_path / "sim")]
    assert main([*given, "--format", "mjcf", *told]) == 0
    out, err = capsys.readouterr()
    assert "torque missed, exported: " in out and "no validation" not in out + err
    (log,) = read_all([tmp_path / "log.csv"], joints=robot.joints)
    replace(model, logs=(log_hash(log),)).save(tmp_path / "model.json")
    assert main([*given, "--format", "mjcf", "--out", str(tmp_path / "again")]) == 0
    assert "this is no validation" in "".join(capsys.readouterr())
    gap = json.loads((tmp_path / "gap.json").read_text())["gap"]
    assert gap["exported"][1] < 1.2 * gap["model"][1] < 0.6 * gap["as it was"][1]
    assert main([*given, "--format", "c", "--out", str(tmp_path / "c")]) == 2
    assert "nothing of c is fitted to speeds" in capsys.readouterr().err
