"""Servos from logs of command and position: found, doubted, written, refused."""

import json
import re
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from arms import MODELS, random_arm
from hypothesis import given
from hypothesis import strategies as st

from hybrid.cli import main
from hybrid.dynamics import inverse_dynamics
from hybrid.errors import HybridWarning, RecordingError, RobotError
from hybrid.recording import Recording, read, write
from hybrid.report.servo import servos_table
from hybrid.robot import Robot
from hybrid.servo import fit_servo
from hybrid.servo.drive import NAMES, QUANTITIES, Drive, known_masses
from hybrid.servo.model import bristles, heights
from hybrid.servo.noise import Noise, resolution
from hybrid.servo.problem import Problem
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch, stretches_of, without_torque
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
ONE = re.sub(
    r'<body name="lower".*?</body>|<position name="b".*?/>', "", ARM, flags=re.S
)
SLACK = """<joint name="shoulder/play" axis="0 1 0" limited="true" armature="0.0004"
    range="-{0} {0}" solreflimit="0.002 1" solimplimit="0.99 0.999 1e-3"/>"""
TABLE = 0.12  # m
ON_TABLE = ARM.replace(
    "<worldbody>",
    f'<worldbody><geom type="plane" pos="0 0 {TABLE}" size="1 1 1" condim="1"/>',
)
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


def log(
    seed: int,
    seconds: float = 10.0,
    delay: float = 0.0,
    dead: float = 0.0,
    low: bool = False,
    play: float = 0.0,
    arm: str = ARM,
    **changed,
) -> Recording:
    """A log by MuJoCo's own friction and servos at 1 ms, with a coarse encoder.

    A low one is on a table, on which the elbow's link comes down. Half of a gap behind
    the shoulder's motor is ``play``; its encoder is on the link.
    """
    text = ON_TABLE if low else arm
    if play:
        text = text.replace('armature="0.02"/>', f'armature="0.02"/>{SLACK}')
    model = mujoco.MjModel.from_xml_string(text.format(play))
    joints = ("shoulder", "elbow")[: model.nu]
    own = [model.joint(x).qposadr[0] for x in joints]
    for name, value in changed.items():
        getattr(model, name)[:] = value
    model.actuator_biasprm[:, 1] = -model.actuator_gainprm[:, 0]
    if not low:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    command, parts = commands(seed, seconds), round(1 / RATE / model.opt.timestep)
    command = (command + low * np.array([1.3, 0.7]))[:, : model.nu]
    command[:, 0] -= 0.6 * (play > 0)  # upright: the load changes its sign
    data = mujoco.MjData(model)
    data.qpos[own] = command[0]
    t, q = np.arange(len(command)) / RATE, []
    now = t[:, None] + np.arange(parts) * model.opt.timestep - delay
    last = np.clip(np.floor(now * RATE + 1e-6).astype(int), 0, None)
    asked = command[last]  # a servo holds its last command
    for goals_of_sample in asked:
        q.append(data.qpos[own])
        q[-1][0] += data.qpos[1] if play else 0.0
        for goal in goals_of_sample:
            data.ctrl[:] = goal
            if dead:
                data.ctrl[0] -= np.clip(data.ctrl[0] - data.qpos[0], -dead, dead)
            if play:
                data.ctrl[0] -= data.qpos[1]
            mujoco.mj_step(model, data)
    measured = np.round(np.array(q) / TICK) * TICK
    return Recording(t, measured, command=command, joints=joints, source=f"log {seed}")


def commanded(seed: int, seconds: float) -> Recording:
    """A log of an arm that is where it is asked to be, with a coarse encoder."""
    command, joints = commands(seed, seconds), ("shoulder", "elbow")
    t, q = np.arange(len(command)) / RATE, np.round(command / TICK) * TICK
    return Recording(t, q, command=command, joints=joints, source=f"log {seed}")


@cache
def found(folder, stiffness: float = 1.0, delay: float = 0.0):
    """A fit of two logs; the elbow's servo may be softer than its file says."""
    kp = np.array([25.0, 20.0 * stiffness])
    gain = np.zeros((2, 10))
    gain[:, 0] = kp
    logs = [log(k, 4.0, delay, actuator_gainprm=gain) for k in range(2)]
    return fit_servo(arm(folder), logs)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("servo")


@pytest.mark.study
def test_a_soft_servo_is_found_where_it_is(folder):
    fit = found(folder, stiffness=0.6)
    first = fit.findings[0]
    assert (first.effect, first.joint) == ("controller_gain", "elbow")
    assert first.interval[0] < 12.0 * 1.1 and first.interval[1] > 12.0 / 1.1
    assert first.file == pytest.approx(20.0)
    assert not any(x.joint == "shoulder" and x.worth > TICK for x in fit.findings)
    assert fit.after[1] < 0.35 * fit.before[1]
    assert (fit.after < 4 * TICK).all()


@pytest.mark.study
def test_a_second_fit_starts_from_the_file_that_the_first_one_wrote(folder, tmp_path):
    """It started from usual servos, and found the same gap once more."""
    fit = found(folder, stiffness=0.6)
    fit.save(tmp_path / "fixed.xml")
    gain = np.zeros((2, 10))
    gain[:, 0] = 25.0, 12.0
    logs = [log(k, 6.0, actuator_gainprm=gain) for k in range(2)]
    again = fit_servo(Robot.load(tmp_path / "fixed.xml"), logs)
    assert not any("declares no servo" in x for x in again.notes)
    np.testing.assert_allclose(again.before, fit.after, rtol=0.05)
    assert all(x.worth < TICK for x in again.findings), again.findings


@pytest.mark.study
def test_an_arm_like_its_file_has_nothing_worth_a_step_of_the_encoder(folder):
    fit = found(folder)
    assert all(x.worth < TICK for x in fit.findings), fit.findings
    assert (fit.before < 4 * TICK).all()


@pytest.mark.study
def test_a_late_command_is_found_with_its_delay(folder):
    fit = found(folder, delay=0.06)
    late = {x.joint: x for x in fit.findings if x.effect == "command_latency"}
    assert set(late) == {"shoulder", "elbow"}
    for x in late.values():
        assert x.value == pytest.approx(0.06, abs=0.006)
    assert (fit.after < 0.35 * fit.before).all()


@pytest.mark.study
def test_a_limit_of_torque_far_below_that_of_the_file_is_found(folder):
    limits = np.array([[-4.0, 4.0], [-0.6, 0.6]])
    logs = [log(k, seconds=4.0, actuator_forcerange=limits) for k in range(2)]
    fit = fit_servo(arm(folder), logs)
    (stall,) = (x for x in fit.findings if x.joint == "elbow" and x.quantity == "stall")
    assert stall.value == pytest.approx(0.6, rel=0.1)
    assert fit.after[1] < 0.5 * fit.before[1]


UNLIMITED = re.sub(' forcerange="[^"]*"', "", ARM)


@pytest.mark.study
def test_a_servo_whose_file_has_no_limit_of_torque_has_none(tmp_path):
    """Joints without weight tell nothing of the torque that their drives can give."""
    text = UNLIMITED.replace('axis="0 1 0"', 'axis="0 0 1"').replace("0.02", "0.3")
    path, gain = tmp_path / "arm.xml", np.zeros((2, 10))
    path.write_text(text)
    gain[:, 0] = 25.0, 20.0
    logs = [log(k, 4.0, arm=text, actuator_gainprm=gain) for k in range(2)]
    fit = fit_servo(Robot.load(path), logs)
    assert (fit.before < 2 * TICK).all() and not fit.findings
    assert ("stall, N·m", "none", "none") in servos_table(fit).rows


@pytest.mark.study
def test_a_file_says_a_dead_band_as_far_as_it_can(folder):
    logs = [log(k, seconds=4.0, dead=0.05) for k in range(2)]
    fit = fit_servo(arm(folder), logs)
    assert ("dead_band", "shoulder") in {(x.quantity, x.joint) for x in fit.findings}
    assert fit.drive["dead_band"][0] == pytest.approx(0.05, rel=0.2)
    assert (fit.written["dead_band"] == 0.0).all()
    (said,) = (x for x in fit.notes if "no place for the dead band of shoulder" in x)
    less = re.search(r"by ([\d.]+) instead of ([\d.]+) mrad", said)
    assert less is not None and float(less[1]) > float(less[2])
    assert float(less[2]) == pytest.approx(1000 * fit.after[0], abs=0.06)


@pytest.mark.study
def test_play_of_a_gear_is_found_and_measured(folder):
    logs = [log(k, seconds=6.0, play=0.03) for k in range(2)]
    fit = fit_servo(arm(folder), logs)
    first = fit.findings[0]
    assert (first.effect, first.joint) == ("backlash", "shoulder")
    assert first.value == pytest.approx(0.03, rel=0.1)
    assert fit.after[0] < 0.4 * fit.before[0]
    assert any("no place for the play of shoulder" in x for x in fit.notes)


@pytest.mark.study
def test_a_number_known_to_be_right_is_never_fitted(folder):
    gain = np.zeros((2, 10))
    gain[:, 0] = 25.0, 12.0
    logs = [log(k, seconds=4.0, actuator_gainprm=gain) for k in range(2)]
    k = NAMES.index("stiffness")
    fit = fit_servo(arm(folder), logs, without=[(k, 0), (k, 1)])
    for drive in (fit.drive, fit.plain_drive, fit.written):
        assert drive["stiffness"] == pytest.approx([25.0, 20.0])
    assert "controller_gain" not in {x.effect for x in fit.findings}
    rows = servos_table(replace(fit, std=np.full_like(fit.std, 1.2))).rows
    assert {"mass", "stall, N·m"} <= {name for name, *_ in rows}
    assert "e+" not in " ".join(cell for _, *cells in rows for cell in cells)


def test_the_step_of_an_encoder_shows_though_a_log_was_resampled():
    logs = stretches_of([commanded(k, 8.0) for k in range(3)])
    between = replace(logs[2], q=logs[2].q + 1e-5 * np.arange(len(logs[2].q))[:, None])
    found = resolution([*logs[:2], between])
    assert found == pytest.approx(np.full(2, TICK / np.sqrt(12.0)))


def test_errors_last_as_many_seconds_at_any_rate():
    weights = []
    for rate in (50.0, 400.0):
        t = np.arange(0.0, 5.0, 1 / rate)
        errors = [np.sin(2 * np.pi * 0.1 * t + x)[:, None] for x in range(3)]
        weights.append(rate * Noise.of(errors, np.zeros(1), np.zeros(1)).weight)
    assert weights[0] == pytest.approx(weights[1], rel=0.05)


def replay(robot, stretch, **changed) -> np.ndarray:
    """What declared servos with some other numbers make of a stretch, (N, 2)."""
    drive = Drive.declared(robot).at(**changed)
    ((q,),) = ServoSimulator(robot, step=0.002).replay([stretch], [drive])
    return q


def steady(goal: np.ndarray, start: np.ndarray, seconds: float = 3.0) -> Stretch:
    """A command that stays, (2,), [rad], from rest."""
    count = round(seconds * RATE)
    command, q = np.tile(goal, (count, 1)), np.tile(start, (count, 1))
    return Stretch(1 / RATE, command, q, np.zeros(2))


def test_a_clock_that_is_a_little_slow_takes_no_more_steps(robot):
    whole = steady(np.zeros(2), np.zeros(2))
    for step in (0.02, 0.02006):
        (run,) = ServoSimulator(robot).runs([replace(whole, step=step)], [None])
        assert run.parts == 4
        assert run.model.opt.timestep == pytest.approx(step / 4)


def test_a_servo_does_nothing_within_its_dead_band(robot):
    down, tipped = np.array([np.pi, 0.0]), np.array([np.pi + 0.08, 0.0])
    free = replay(robot, steady(tipped, down), coulomb=1e-3)
    dead = replay(robot, steady(tipped, down), coulomb=1e-3, dead_band=0.1)
    assert abs(free[-1, 0] - tipped[0]) < 0.02
    # The softest spring there is, of 1e-6 N·m/rad, pulls at the bristles.
    assert np.abs(dead - down).max() < 1e-6 * np.pi / 1.0


def ramp(start: float, end: float, seconds: float = 4.0) -> Stretch:
    """A command that moves the shoulder of a stretched arm evenly, from rest."""
    count = round(seconds * RATE)
    command = np.zeros((count, 2))
    command[:, 0] = np.linspace(start, end, count)
    return Stretch(1 / RATE, command, np.tile(command[0], (count, 1)), np.zeros(2))


@pytest.mark.parametrize("where", [(0.5, 0.9), (-0.5, -0.9)])
def test_play_does_nothing_while_the_load_keeps_the_link_on_one_side(robot, where):
    tight, loose = (replay(robot, ramp(*where), play=x) for x in (0.0, [0.03, 0.0]))
    np.testing.assert_allclose(loose, tight, atol=2e-3)


def test_a_link_falls_through_its_gap_where_its_load_changes_sign(robot):
    """Upright in between; the servo on the link takes back some of what it fell."""
    tight, loose = (replay(robot, ramp(-0.4, 0.4), play=x) for x in (0.0, [0.03, 0.0]))
    ahead = loose[:, 0] - tight[:, 0]
    assert 0.015 < ahead.max() < 2 * 0.03 and ahead.min() > -0.01
    np.testing.assert_allclose(loose[-1], tight[-1], atol=5e-3)


def gravity_torque(robot, q, gravity=None) -> np.ndarray:
    """Torque that holds the arm, (N, 2), [N·m]."""
    g = robot.chain.gravity if gravity is None else gravity
    chain = replace(robot.chain, gravity=g)
    return inverse_dynamics(chain, chain.inertial, q, 0 * q, 0 * q)


def test_friction_of_load_lags_a_slow_servo_by_its_share_of_the_weight(robot):
    slow = ramp(0.9, 1.2)
    plain, worn = (replay(robot, slow, load_friction=x) for x in (0.0, [0.3, 0.0]))
    late = slice(len(plain) // 2, None)
    share = 0.3 * np.abs(gravity_torque(robot, plain)[late, 0]) / 25.0
    np.testing.assert_allclose((plain - worn)[late, 0], share, rtol=0.05)


def test_curved_damping_lags_a_servo_by_the_square_of_its_speed(robot):
    fast = ramp(-0.5, 1.5, 2.0)  # 1 rad/s
    plain, curved = (replay(robot, fast, quadratic=x) for x in (0.0, [0.5, 0.0]))
    lighter = gravity_torque(robot, plain) - gravity_torque(robot, curved)
    drag = 25.0 * (plain - curved) + lighter
    v, before = (np.gradient(x, 1 / RATE, axis=0) for x in (curved, plain))
    expected = 0.5 * v * np.abs(v) + (0.4 + 0.6) * (v - before)
    np.testing.assert_allclose(drag[-30:, 0], expected[-30:, 0], rtol=0.03)


@pytest.mark.parametrize("name", ["roll", "pitch"])
def test_an_arm_on_a_tilted_base_sags_under_the_gravity_of_that_base(robot, name):
    goal = np.array([0.4, 0.3])
    drive = Drive.declared(robot).at(**{name: 0.15})
    q = replay(robot, steady(goal, goal), coulomb=1e-4, **{name: 0.15})[-1]
    down = drive.tilt.turned(robot.chain.gravity)
    assert np.linalg.norm(down) == pytest.approx(9.81)
    angle = np.arccos(down @ robot.chain.gravity / 9.81**2)
    assert angle == pytest.approx(0.15)
    torque = drive["stiffness"] * (goal - q)
    held = gravity_torque(robot, q[None], down)[0]
    np.testing.assert_allclose(torque, held, atol=1e-3)


def test_a_batch_of_replays_is_each_of_them(robot):
    drive = Drive.declared(robot)
    drives = [drive.at(**x) for x in (
        {}, {"play": [0.03, 0.0]}, {"dead_band": 0.02}, {"play": [0.0, 0.02]},
        {"play": 0.01, "dead_band": [0.02, 0.0]}, {"load_friction": [0.2, 0.0]},
        {"load_friction": 0.1, "dead_band": 0.02}, {"quadratic": 0.2}, {"roll": 0.1},
        {"dead_band": [0.02, 0.0], "zero": 0.1}, {"sign": [1.0, -1.0]},
    )]  # fmt: skip
    moving = replace(ramp(0.3, -0.2, 1.0), v=np.array([0.3, 0.0]))
    stretches = [ramp(-0.4, 0.4, 0.6), moving]
    every = ServoSimulator(robot).replay(stretches, drives)
    for one, found in zip(drives, every, strict=True):
        (alone,) = ServoSimulator(robot).replay(stretches, [one])
        for x, y, stretch in zip(found, alone, stretches, strict=True):
            np.testing.assert_allclose(x, y, rtol=0, atol=1e-12)
            assert x.shape == stretch.q.shape and (x[0] == stretch.q[0]).all()


def test_slopes_move_no_number_that_is_not_fitted(robot):
    none = np.zeros(2, dtype=bool)
    problem = Problem(
        ServoSimulator(robot), [ramp(-0.4, 0.4)], Drive.declared(robot), none,
        np.zeros((2, 2)),
    )  # fmt: skip
    free = np.zeros((len(NAMES), 2), dtype=bool)
    free[NAMES.index("play"), 1] = True
    found = problem.at(problem.prior.coordinates, free)
    (together,), (alone,) = (problem.slopes(found, each=x) for x in (False, True))
    np.testing.assert_allclose(together[:, 1], alone[:, 1], rtol=0, atol=1e-12)


def test_a_joint_goes_no_further_than_its_stop(robot):
    start, goal = np.array([0.5, 0.0]), np.array([1.5, 0.0])
    q = replay(robot, steady(goal, start), upper=np.array([0.9, 3.0]))
    assert q[-1, 0] == pytest.approx(0.9, abs=0.02)
    assert replay(robot, steady(goal, start))[-1, 0] > 1.3


def test_a_link_goes_no_lower_than_the_ground(robot):
    start, goal = np.array([1.2, 0.0]), np.array([2.2, 0.3])
    above = replay(robot, steady(goal, start), ground=np.array([-1.0, 0.15]))
    assert heights(robot, above)[-1, 1] == pytest.approx(0.15, abs=1e-3)
    assert heights(robot, replay(robot, steady(goal, start)))[-1, 1] < 0.12


def test_heights_are_those_of_the_simulator():
    for seed in range(5):
        other = random_arm(seed)
        model = other.mujoco_spec().compile()
        data, rng = mujoco.MjData(model), np.random.default_rng(seed)
        data.qpos[:] = rng.uniform(-1, 1, other.size)
        mujoco.mj_kinematics(model, data)
        up = -other.chain.gravity / np.linalg.norm(other.chain.gravity)
        seen = heights(other, data.qpos[None])[0]
        assert seen == pytest.approx(data.xipos[1:] @ up, abs=1e-9)


@pytest.mark.study
def test_a_table_that_a_link_comes_down_on_is_found(robot):
    logs = [log(k, 6.0, low=True) for k in range(3)]
    fit = fit_servo(robot, logs)
    (touched,) = (x for x in fit.findings if x.quantity == "ground")
    assert (touched.effect, touched.joint) == ("contact", "elbow")
    # The centre of mass is halfway down a capsule of 1.5 cm, which slopes.
    assert TABLE + 0.015 < touched.value < TABLE + 0.015 + 0.08
    assert (fit.after < 0.5 * fit.plain).any()
    assert any("the written file has no ground" in x for x in fit.notes)


def test_a_goal_moves_no_faster_than_its_pace():
    goal, none = np.array([0.6, -0.5]), np.zeros(2)
    jump = steady(goal, goal - 0.4)
    jump.command[0] -= 0.4
    for parts in (1, 4):
        ramp, other = jump.goals(none, np.array([2.0, 0.0]), parts).T
        assert np.diff(ramp).max() == pytest.approx(0.5 / RATE / parts)
        assert ramp[0] == pytest.approx(goal[0] - 0.4)
        assert ramp[-1] == pytest.approx(goal[0])
        assert (other[parts:] == goal[1]).all()


@pytest.mark.parametrize(
    ("delay", "goals"),
    [
        (0.0, [1, 1, 3, 3]),
        (0.5, [1, 1, 1, 3]),  # of a part: half a sample
        (0.25, [1, 1, 2, 3]),  # a goal is the mean over its part
        (1.5, [1, 1, 1, 1]),
    ],
)
def test_a_servo_holds_the_last_command_that_it_received(delay, goals):
    """Replays led a held command by half a sample, which was added to the delay."""
    sent = np.array([[1.0], [3.0], [7.0]])
    held = Stretch(1 / RATE, sent, sent, np.zeros(1))
    found = held.goals(np.array([delay / RATE]), np.zeros(1), 2)
    np.testing.assert_allclose(found[:, 0], goals, atol=1e-9)


@pytest.mark.parametrize("changed", [{"pace": 2.5}, {"delay": 0.3}])
def test_a_part_of_a_log_starts_with_the_goals_that_the_whole_has_there(changed):
    """A slow or late goal is still behind where a part begins."""
    command = commands(0, 12.0)
    whole = Stretch(1 / RATE, command, command, np.zeros(2))
    law = {"delay": 0.0, "pace": 0.0} | changed
    each = [np.full(2, law[name]) for name in ("delay", "pace")]
    long, first = whole.goals(*each, 2), 400
    short = whole.cut(first, 100).goals(*each, 2)
    assert np.abs(short[0] - command[first]).max() > 0.02
    np.testing.assert_allclose(short, long[2 * first :][: len(short)], atol=1e-9)


@pytest.mark.study
def test_a_joint_that_counts_the_other_way_is_found(robot):
    """Of two parallel axes either: both together mirror the arm, and it moves alike."""
    way, logs = np.array([1.0, -1.0]), [log(k, 6.0) for k in range(2)]
    logs = [replace(x, q=way * x.q, command=way * x.command) for x in logs]
    fit = fit_servo(robot, logs)
    assert [x.quantity for x in fit.findings] == ["sign"]
    assert (fit.after < 4 * TICK).all()


def test_axes_that_point_the_other_way_mirror_the_arm(robot):
    """Both axes of the arm are parallel: mirrored, it is itself."""
    goal, start = np.array([0.6, -0.5]), np.array([0.3, -0.2])
    plain = replay(robot, steady(goal, start))
    turned = replay(robot, steady(-goal, -start))
    assert turned == pytest.approx(-plain, abs=1e-9)
    assert replay(robot, steady(goal, start), sign=-1.0) == pytest.approx(plain)


def test_motion_tells_torques_only_as_multiples_of_masses(robot):
    """Twice the mass and twice every torque move alike."""
    drive, stretch = Drive.declared(robot), stretches_of([commanded(3, 3.0)])[0]
    names = ("stiffness", "damping", "coulomb", "armature", "stall")
    twice = drive.at(mass=2.0, **{x: 2 * drive[x] for x in names})
    a, b = ServoSimulator(robot).replay([stretch], [drive, twice])
    assert np.abs(a[0] - b[0]).max() < 1e-6


def test_a_known_mass_sets_the_scale_of_other_links_too(robot):
    assert known_masses(robot, {}) == pytest.approx([1.0, 1.0])
    assert known_masses(robot, {"elbow": 0.6}) == pytest.approx([2.0, 2.0])
    both = known_masses(robot, {"elbow": 0.6, "shoulder": 0.6})
    assert both == pytest.approx([1.0, 2.0])
    with pytest.raises(RobotError, match="valid are shoulder, elbow"):
        known_masses(robot, {"wrist": 1.0})
    with pytest.raises(RobotError, match="above 0"):
        known_masses(robot, {"elbow": -1.0})


def test_masses_stops_and_axes_are_written_where_they_differ(robot, tmp_path):
    drive = Drive.declared(robot).at(mass=np.array([1.0, 1.5]))
    drive = drive.at(upper=np.array([1.2, 100.0]), sign=np.array([1.0, -1.0]))
    write_servos(robot, drive, tmp_path / "fixed.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    assert model.body_mass[1:] == pytest.approx([0.6, 0.45])
    assert model.jnt_limited[0] and model.jnt_range[0, 1] == pytest.approx(1.2)
    assert model.jnt_axis == pytest.approx(np.array([[0, 1, 0], [0, -1, 0]]))


def test_a_written_file_moves_as_the_servos_that_were_found(folder, tmp_path):
    robot = arm(folder)
    soft = {"stiffness": [25.0, 12.0], "stiction": [0.02, 0.05], "offset": 0.03}
    more = {"delay": 0.06, "quadratic": 0.3, "roll": 0.1, "pitch": -0.1}
    drive = Drive.declared(robot).at(**soft, **more)
    write_servos(robot, drive, tmp_path / "fixed.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    # The file's delays are filled with the first command, as of an arm at rest.
    whole = stretches_of([log(9, seconds=3.0)])[0]
    stretch = replace(whole, sent=whole.command)
    parts = round(stretch.step / model.opt.timestep)
    ours = ServoSimulator(robot, step=model.opt.timestep)
    ((expected,),) = ours.replay([stretch], [drive])
    for k in range(model.nu):
        held = np.full(int(model.actuator_history[k, 0]), stretch.command[0, k])
        if held.size:
            mujoco.mj_initCtrlHistory(model, data, k, None, held)
    data.qpos[:], data.qvel[:] = stretch.q[0], stretch.v
    data.ctrl[:] = stretch.command[0]
    mujoco.mj_forward(model, data)
    data.act[:] = bristles(
        drive, stretch, stretch.command[0], data.qfrc_bias - data.qfrc_spring
    )
    moved = [data.qpos.copy()]
    for command in stretch.command[:-1]:
        data.ctrl[:] = command
        for _ in range(parts):
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


@pytest.mark.study
def test_a_joint_that_never_moves_keeps_the_numbers_of_the_file(robot):
    logs = []
    for k in range(2):
        x = log(k, seconds=5.0)
        q, command = x.q.copy(), x.command.copy()
        q[:, 1], command[:, 1] = q[0, 1], command[0, 1]
        logs.append(replace(x, q=q, command=command))
    fit = fit_servo(robot, logs)
    assert fit.resting == ("elbow",)
    declared = Drive.declared(robot)
    for name in NAMES:
        assert fit.drive[name][1] == pytest.approx(declared[name][1])
    assert not any(x.joint == "elbow" for x in fit.findings)


def test_a_part_starts_at_the_speed_that_the_arm_has_there():
    t = 0.1 * np.arange(12)
    q = np.stack([0.5 * t**2, 1.0 - 2.0 * t], axis=1)
    whole = Stretch(0.1, q, q, np.array([0.0, -2.0]))
    for first in (0, 3, 6):
        part = whole.cut(first, 4)
        np.testing.assert_array_equal(part.q, q[first : first + 4])
        np.testing.assert_allclose(part.v, [t[first], -2.0], atol=1e-12)


def test_a_servo_of_which_a_file_says_nothing_holds_the_arm_anywhere(robot):
    unknown = np.full(2, np.nan)
    bare = replace(robot, tau_max=np.full(2, np.inf), kp=unknown, kd=unknown)
    drive, chain = Drive.declared(bare), bare.chain
    q, still = np.random.default_rng(0).uniform(-3, 3, (200, 2)), np.zeros((200, 2))
    weight = np.abs(inverse_dynamics(chain, chain.inertial, q, still, still))
    # Twice the largest of a hundred postures; two hundred others may reach further.
    assert (drive.stall > 1.9 * weight.max(axis=0)).all()
    assert (drive.stall < 20.0 * weight.max(axis=0)).all()
    # ... and sags by less than three degrees under half of what it can hold.
    assert (0.5 * drive.stall / drive["stiffness"] < np.deg2rad(3.0)).all()


def test_a_log_without_command_is_refused(robot):
    with pytest.raises(RecordingError, match=": no command; valid are columns of comm"):
        fit_servo(robot, [replace(commanded(0, 3.0), command=None)])


def test_a_log_whose_torque_is_a_current_is_told_so(tmp_path, robot):
    labels = ["time", *(f"{x}_{j}" for x in ("q", "tau") for j in robot.joints)]
    rows = np.hstack([np.arange(3.0)[:, None], np.ones((3, 2 * robot.size))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=",".join(labels),
               comments="")  # fmt: skip
    with pytest.warns(HybridWarning, match="ignored columns"):
        log = read(tmp_path / "a.csv", map="ur_driver", torque=False)
    with pytest.raises(RecordingError, match="nor command .*torque_constant is needed"):
        without_torque([log])


COUNT = 2 * len(QUANTITIES)


@given(st.lists(st.floats(0.01, 100.0), min_size=COUNT, max_size=COUNT))
def test_coordinates_lead_back_to_the_numbers(numbers):
    values = np.array(numbers).reshape(len(QUANTITIES), 2)
    least = np.array([[x.least] for x in QUANTITIES])
    drive = Drive(np.maximum(values, least), np.ones(2))
    values = drive.values
    assert drive.moved(drive.coordinates).values == pytest.approx(values)


def asked_of(folder, text=ARM, **changed):
    """Options of a verb with an arm and two short logs, which are written."""
    (folder / "arm.xml").write_text(text)
    for k in range(2):
        write(log(k, seconds=3.0, arm=text, **changed), folder / "logs" / f"{k}.csv")
    return ["--robot", str(folder / "arm.xml"), "--recordings", str(folder / "logs")]


@pytest.mark.study
def test_identify_writes_a_simulator_and_numbers(tmp_path, capsys):
    fixed, numbers = tmp_path / "fixed.xml", tmp_path / "fit.json"
    asked = asked_of(tmp_path)
    code = main(["identify", *asked, "--out", str(fixed), "--json", str(numbers)])
    assert code == 0, capsys.readouterr().err
    mujoco.MjModel.from_xml_path(str(fixed))
    content = json.loads(numbers.read_text())
    assert {x["joint"] for x in content["gap"]} == {"shoulder", "elbow"}
    assert content["schema"] == "hybrid.servo/1"
    assert content["scale"] == "masses of the file"


def test_diagnose_finds_a_soft_servo_and_writes_it_at_the_scale_of_a_known_mass(
    tmp_path, capsys
):
    gain, heavier = np.zeros((1, 10)), 1.5 * np.array([[0.002, 0.002, 0.0005]])
    gain[:, 0] = 15.0
    link = {"body_mass": [0.0, 0.9], "body_inertia": np.vstack([np.zeros(3), heavier])}
    asked = asked_of(tmp_path, ONE, actuator_gainprm=gain, **link)
    out, scale = tmp_path / "found", ["--known-mass", "shoulder=0.9"]
    assert main(["diagnose", *asked, *scale, "--out", str(out)]) == 0
    twice = json.loads((out / "diagnosis.json").read_text())
    assert twice["scale"] == ["shoulder"]
    soft = twice["findings"][0]
    assert (soft["effect"], soft["joint"]) == ("controller_gain", "shoulder")
    assert soft["file"] == pytest.approx(25.0)
    assert soft["interval"][0] < 15.0 * 1.1 and soft["interval"][1] > 15.0 / 1.1
    (gap,) = twice["gap"]
    assert gap["after"] < min(0.35 * gap["before"], 4 * TICK)
    fixed_mass = mujoco.MjModel.from_xml_path(str(out / "sim_fixed.xml")).body_mass
    assert fixed_mass[1] == pytest.approx(0.9)
    names = {path.name for path in out.iterdir()}
    assert names == {"report.html", "diagnosis.json", "sim_fixed.xml"}
    assert "mrad" in capsys.readouterr().out


def test_logs_of_which_some_lack_torque_are_refused(folder, tmp_path, capsys):
    x = commanded(0, 4.0)
    write(x, tmp_path / "a.csv")
    write(replace(x, tau=np.ones_like(x.q)), tmp_path / "b.csv")
    asked = ["identify", "--robot", arm(folder).path, "--recordings", str(tmp_path)]
    assert main([*asked, "--out", str(tmp_path / "x.xml")]) == 2
    assert "no torque, but other recordings have it" in capsys.readouterr().err
    (tmp_path / "a.csv").unlink()
    scaled = [*asked, "--known-mass", "elbow=1", "--out", str(tmp_path / "x.json")]
    assert main(scaled) == 2
    assert "these logs have torque" in capsys.readouterr().err
    write(x, tmp_path / "a.csv")
    (tmp_path / "b.csv").unlink()
    assert main([*asked, "--out", str(tmp_path / "x.json")]) == 2
    assert ".xml" in capsys.readouterr().err


def test_friction_of_a_passive_motor_becomes_that_of_the_servo(tmp_path):
    motor = (
        '<actuator><dcmotor name="falls" joint="elbow" input="none" motorconst="0" '
        'resistance="1" lugre="1e4 0 0 0.2 0.3"/></actuator></mujoco>'
    )
    (tmp_path / "arm.xml").write_text(ARM.replace("</mujoco>", motor))
    robot = Robot.load(tmp_path / "arm.xml")
    drive = Drive.declared(robot)
    np.testing.assert_allclose(drive["stiction"], [0.0, 0.2])
    assert drive["stribeck_speed"][1] == pytest.approx(0.3)
    write_servos(robot, drive, tmp_path / "fixed.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "fixed.xml"))
    np.testing.assert_allclose(
        model.actuator_biasprm[:, 4].sum(), (drive["coulomb"] + drive["stiction"]).sum()
    )
