"""Servos from logs of command and position: found, doubted, written, refused."""

import json
import re
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from arms import MODELS
from hypothesis import given
from hypothesis import strategies as st

from hybrid.cli import main
from hybrid.errors import RecordingError
from hybrid.recording import Recording, write
from hybrid.robot import Robot
from hybrid.servo import Drive, fit_servo
from hybrid.servo.drive import NAMES, QUANTITIES
from hybrid.servo.simulator import ServoSimulator, bristles
from hybrid.servo.start import first_guess
from hybrid.servo.stretch import chosen, stretches_of
from hybrid.servo.write import write_servos

ARM = """<mujoco model="two">
  <!-- kept as it is -->
  <compiler angle="radian"/>
  <option timestep="0.001"/>
  <worldbody>
    <body name="upper" pos="0 0 0.3">
      <joint name="shoulder" axis="0 1 0" damping="0.4" frictionloss="0.15"
             armature="0.02"/>
      <inertial pos="0 0 0.1" mass="0.6" diaginertia="0.002 0.002 0.0005"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02"/>
      <body name="lower" pos="0 0 0.2">
        <joint name="elbow" axis="0 1 0" damping="0.3" frictionloss="0.08"
               armature="0.01"/>
        <inertial pos="0 0 0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.16" size="0.015"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="a" joint="shoulder" kp="25" kv="0.6" forcerange="-4 4"/>
    <position name="b" joint="elbow" kp="20" kv="0.4" forcerange="-2 2"/>
  </actuator>
</mujoco>
"""
TICK = 2 * np.pi / 4096
RATE = 50.0


@cache
def arm(folder) -> Robot:
    path = folder / "arm.xml"
    path.write_text(ARM)
    return Robot.load(path)


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Robot:
    return arm(tmp_path_factory.mktemp("arm"))


def commands(seed: int, seconds: float) -> np.ndarray:
    """Tones and steps about a bent pose, shape (N, 2), [rad]."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / RATE)
    tones = sum(
        rng.uniform(0.1, 0.4, 2)
        * np.sin(
            2 * np.pi * rng.uniform(0.1, 1.0, 2) * t[:, None] + rng.uniform(0, 6, 2)
        )
        for _ in range(2)
    )
    steps = rng.uniform(-0.08, 0.08, (int(seconds), 2))[(t // 1.0).astype(int)]
    ease = np.minimum(t, 1.0)[:, None]
    return np.array([0.6, -0.5]) + ease * np.where(t[:, None] % 10 < 6, tones, steps)


def log(seed: int, seconds: float = 20.0, delay: float = 0.0, **changed) -> Recording:
    """A log by MuJoCo's own friction and servos at 1 ms, with a coarse encoder."""
    model = mujoco.MjModel.from_xml_string(ARM)
    for name, value in changed.items():
        getattr(model, name)[:] = value
    model.actuator_biasprm[:, 1] = -model.actuator_gainprm[:, 0]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    command, parts = commands(seed, seconds), round(1 / RATE / model.opt.timestep)
    data = mujoco.MjData(model)
    data.qpos[:] = command[0]
    t, q = np.arange(len(command)) / RATE, []
    for k in range(len(command)):
        q.append(data.qpos.copy())
        for i in range(parts):
            now = t[k] + i * model.opt.timestep - delay
            data.ctrl[:] = [np.interp(now, t, x) for x in command.T]
            mujoco.mj_step(model, data)
    measured = np.round(np.array(q) / TICK) * TICK
    joints = ("shoulder", "elbow")
    return Recording(t, measured, command=command, joints=joints, source=f"log {seed}")


@cache
def found(folder, stiffness: float = 1.0, delay: float = 0.0):
    """A fit of four logs; the elbow's servo may be softer than its file says."""
    kp = np.array([25.0, 20.0 * stiffness])
    gain = np.zeros((2, 10))
    gain[:, 0] = kp
    logs = [log(k, delay=delay, actuator_gainprm=gain) for k in range(4)]
    return fit_servo(arm(folder), logs)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("servo")


def test_a_soft_servo_is_found_where_it_is(folder):
    fit = found(folder, stiffness=0.6)
    first = fit.findings[0]
    assert (first.effect, first.joint) == ("controller_gain", "elbow")
    assert first.interval[0] < 12.0 * 1.1 and first.interval[1] > 12.0 / 1.1
    assert first.file == pytest.approx(20.0)
    assert not any(x.joint == "shoulder" and x.worth > TICK for x in fit.findings)
    assert fit.after[1] < 0.35 * fit.before[1]
    assert (fit.after < 4 * TICK).all()


def test_an_arm_like_its_file_has_nothing_worth_a_step_of_the_encoder(folder):
    fit = found(folder)
    assert all(x.worth < TICK for x in fit.findings), fit.findings
    assert (fit.before < 4 * TICK).all()


def test_a_late_command_is_found_with_its_delay(folder):
    fit = found(folder, delay=0.06)
    late = {x.joint: x for x in fit.findings if x.effect == "command_latency"}
    assert set(late) == {"shoulder", "elbow"}
    for x in late.values():
        assert x.value == pytest.approx(0.06, abs=0.006)
    assert (fit.after < 0.35 * fit.before).all()


def test_the_first_guess_is_within_a_factor_of_two(robot):
    guess = first_guess(robot, stretches_of([log(0), log(1)]))
    assert guess["stiffness"] == pytest.approx([22.0, 22.0], rel=0.5)
    damping = np.array([1.0, 0.7])
    assert (guess["damping"] > damping / 2).all()
    assert (guess["damping"] < damping * 2).all()


def test_the_written_file_moves_as_the_servos_that_were_found(folder, tmp_path):
    fit = found(folder, delay=0.06)
    write_servos(fit.robot, fit.drive, tmp_path / "fixed.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    stretch = stretches_of([log(9, seconds=6.0)])[0]
    parts = round(stretch.step / model.opt.timestep)
    ours = ServoSimulator(fit.robot, step=model.opt.timestep)
    ((expected,),) = ours.replay([stretch], [fit.drive])
    for k in range(model.nu):
        held = np.full(int(model.actuator_history[k, 0]), stretch.command[0, k])
        if held.size:
            mujoco.mj_initCtrlHistory(model, data, k, None, held)
    data.qpos[:], data.qvel[:] = stretch.q[0], stretch.v
    data.ctrl[:] = stretch.command[0]
    mujoco.mj_forward(model, data)
    data.act[:] = bristles(fit.drive, stretch, stretch.command[0], data.qfrc_bias)
    moved = [data.qpos.copy()]
    for before, after in zip(stretch.command[:-1], stretch.command[1:], strict=True):
        for i in range(parts):
            data.ctrl[:] = before + (after - before) * i / parts
            mujoco.mj_step(model, data)
        moved.append(data.qpos.copy())
    assert np.abs(np.array(moved) - expected).max() < 1e-4


def test_only_joints_and_actuators_of_the_file_change(robot, tmp_path):
    drive = Drive.declared(robot)
    write_servos(robot, drive, tmp_path / "fixed.xml")
    edited = re.compile(r"<(joint|position|general) [^>]*>")
    written = (tmp_path / "fixed.xml").read_text()
    assert edited.sub("", written) == edited.sub("", ARM)
    assert "<!-- kept as it is -->" in written
    again = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    original = mujoco.MjModel.from_xml_string(ARM)
    assert (again.nu, again.ngeom) == (original.nu, original.ngeom)
    assert [again.actuator(k).name for k in range(2)] == ["a", "b"]


def test_servos_of_a_urdf_have_no_limit_but_that_of_the_drive(tmp_path):
    robot = Robot.load(MODELS / "coman_like.urdf")
    drive = Drive.declared(robot)
    write_servos(robot, drive, tmp_path / "fixed.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    assert not model.actuator_forcelimited.any()
    np.testing.assert_allclose(model.actuator_gainprm[:, 4], drive["stiffness"])
    np.testing.assert_allclose(model.dof_damping, drive["damping"])


def test_a_joint_that_never_moves_keeps_the_numbers_of_the_file(robot):
    logs = []
    for k in range(2):
        x = log(k)
        q, command = x.q.copy(), x.command.copy()
        q[:, 1], command[:, 1] = q[0, 1], command[0, 1]
        logs.append(replace(x, q=q, command=command))
    fit = fit_servo(robot, logs)
    assert fit.resting == ("elbow",)
    declared = Drive.declared(robot)
    for name in NAMES:
        assert fit.drive[name][1] == pytest.approx(declared[name][1])
    assert not any(x.joint == "elbow" for x in fit.findings)


def test_parts_come_from_all_logs_alike():
    parts = chosen(stretches_of([log(k, seconds=12.0) for k in range(3)]), 30.0, 5.0)
    assert [sum(p.source == f"log {k}" for p in parts) for k in range(3)] == [2, 2, 2]
    for part in parts:
        assert part.duration == pytest.approx(5.0, abs=3 / RATE)


def test_a_log_without_command_is_refused(robot):
    with pytest.raises(RecordingError, match="neither torque nor command"):
        fit_servo(robot, [replace(log(0), command=None)])


@given(st.lists(st.floats(0.01, 100.0), min_size=22, max_size=22))
def test_coordinates_lead_back_to_the_numbers(numbers):
    values = np.array(numbers).reshape(len(QUANTITIES), 2)
    drive = Drive(values, np.ones(2))
    assert drive.moved(drive.coordinates).values == pytest.approx(values)


def test_the_verbs_write_a_simulator_and_numbers(folder, tmp_path, capsys):
    for k in range(3):
        write(log(k, seconds=8.0), tmp_path / "logs" / f"{k}.csv")
    robot, logs = arm(folder).path, str(tmp_path / "logs")
    fixed, numbers = tmp_path / "fixed.xml", tmp_path / "fit.json"
    asked = ["--robot", robot, "--recordings", logs]
    code = main(["identify", *asked, "--out", str(fixed), "--json", str(numbers)])
    assert code == 0, capsys.readouterr().err
    mujoco.MjModel.from_xml_path(str(fixed))
    content = json.loads(numbers.read_text())
    assert {x["joint"] for x in content["gap"]} == {"shoulder", "elbow"}
    assert content["schema"] == "hybrid.servo/1"
    out = tmp_path / "found"
    assert main(["diagnose", *asked, "--out", str(out)]) == 0
    names = {path.name for path in out.iterdir()}
    assert names == {"report.html", "diagnosis.json", "sim_fixed.xml"}
    assert "mrad" in capsys.readouterr().out


def test_logs_of_which_some_lack_torque_are_refused(folder, tmp_path, capsys):
    x = log(0, seconds=4.0)
    write(x, tmp_path / "a.csv")
    write(replace(x, tau=np.ones_like(x.q)), tmp_path / "b.csv")
    asked = ["identify", "--robot", arm(folder).path, "--recordings", str(tmp_path)]
    assert main([*asked, "--out", str(tmp_path / "x.xml")]) == 2
    assert "no torque, but other recordings have it" in capsys.readouterr().err
    (tmp_path / "b.csv").unlink()
    assert main([*asked, "--out", str(tmp_path / "x.json")]) == 2
    assert ".xml" in capsys.readouterr().err
