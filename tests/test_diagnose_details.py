"""Parts of the diagnosis by themselves, on a log without noise or made-up numbers."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from coarse import Plant, simulate
from simulated import arm, quiet

from hybrid.diagnosis.answer.command import _gain_errors
from hybrid.diagnosis.answer.diagnosis import Diagnosis
from hybrid.diagnosis.answer.events import events_at_rest
from hybrid.diagnosis.answer.findings import shrunk
from hybrid.diagnosis.answer.simulator import corrected
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.evidence.contacts import _Clock
from hybrid.diagnosis.evidence.shapes import shape_derivatives, shape_units
from hybrid.diagnosis.gap.background import background
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.dynamics import RigidBody
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.counterbalance import Counterbalance
from hybrid.effects.delay import Delay
from hybrid.effects.elasticity import Elasticity
from hybrid.effects.torque_gain import TorqueGain
from hybrid.errors import RecordingError
from hybrid.plant import Noise
from hybrid.plant.joint_fields import declared_effects
from hybrid.plant.rollout import _before_report
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.chain import INERTIAL_NAMES
from hybrid.signals import Motion, motion_from_recording


def quiet_motion(t, q) -> Motion:
    """An arm that stands."""
    zero = np.zeros_like(q)
    return Motion(t, q, zero, zero, zero, np.ones(len(t), dtype=bool))


@cache
def quiet_logs():
    robot = arm("planar")
    plant = Plant(robot, [], nominal=robot, noise=Noise.none(robot.size))
    return robot, simulate(plant, trajectories=1, duration=4.5, seed=1)


def test_at_the_end_of_a_range_the_change_is_that_to_what_lies_within():
    robot, recordings = quiet_logs()
    gap = measure_gap(robot, recordings)
    law = {"spring": 1.0, "preload": 0.5, "crank_ratio": 0.5}
    end = Counterbalance((1,), {**law, "dead_centre": 4.0})
    (before, now) = (
        gap.columns(end.at({"dead_centre": x}))[1] @ end.gain_values
        for x in (3.999, 4.0)
    )
    expected = (now - before) / 1e-3 * shape_units(gap, end)[0]
    error = shape_derivatives(gap, end)[0][1][:, 0] - expected
    assert np.linalg.norm(error) < 0.2 * np.linalg.norm(expected)  # one-sided


def test_declared_numbers_times_their_columns_are_the_torque_of_the_file():
    robot, recordings = quiet_logs()
    spring = {"stiffness": np.array([30.0, 5.0]), "springref": np.array([0.5, 0.0])}
    chain = replace(robot.chain, armature=np.zeros(2))
    sprung = replace(robot, chain=chain, frictionloss=np.zeros(2), **spring)
    gap = measure_gap(sprung, recordings)
    found = np.zeros_like(gap.left)
    for block, size in zip(*background(gap), strict=True):
        if len(size) == 1:
            ((j, column),) = block.items()
            found[:, j] += column[:, 0] * size[0]
    (m,) = gap.motions
    own = sprung.joint_torque(m.q, m.v, m.a)
    np.testing.assert_allclose(found, gap.samplers[0](own), atol=1e-9)


def test_of_a_joint_that_does_not_move_nothing_is_said_to_be_measured():
    found = Diagnosis(
        "arm", ("a", "b"), rms=(0.0, 2.0), relative=(0.0, 0.5), noise_floor=(0.0, 0.1),
        where=(), findings=(), verdict="no_gap", unexplained=0.0, background=0.01,
    ).as_dict()  # fmt: skip
    still, moving = found["gap"]
    for name, value in (("rms", 2.0), ("relative", 0.5), ("noise", 0.1)):
        assert (still[name], moving[name]) == (None, value)


def test_gains_of_a_servo_are_off_by_their_part_however_small_they_are():
    robot = replace(arm("planar"), kp=np.array([50.0, 0.2]), kd=np.array([0.5, 0.0]))
    gap, law = SimpleNamespace(robot=robot), SimpleNamespace(scaled=False)
    covariance = np.diag([1.0, 1.0, 25.0, 0.01])
    fit = SimpleNamespace(law=law, gains=[35.0, 0.6], covariance=covariance)
    off, std = _gain_errors(fit, gap, 0)
    np.testing.assert_allclose(off, [-0.3, 0.2])
    np.testing.assert_allclose(std, [0.1, 0.2])
    fit = SimpleNamespace(law=law, gains=[0.3, 0.6], covariance=covariance)
    np.testing.assert_allclose(
        _gain_errors(fit, gap, 1)[0], [0.5, 0.0]
    )  # it has no damping


def test_declared_numbers_are_corrected_by_their_relative_errors():
    robot = replace(arm("planar"), stiffness=np.array([0.0, 3.0]))
    declared = declared_effects(robot)
    change = 0.01 * np.arange(1.0, 1.0 + len(declared))
    scored = SimpleNamespace(gap=SimpleNamespace(robot=robot))
    found, rest = corrected(scored, (), np.concatenate([np.zeros(20), change]))
    assert rest == () and len(declared) == 7
    for effect, error in zip(declared, change, strict=True):
        (j,), field = effect.joints, next(iter(effect.fields.values()))
        before, after = (
            x.chain.armature if field == "armature" else getattr(x, field)
            for x in (robot, found)
        )
        assert after[j] == pytest.approx((1.0 + error) * before[j])
    assert found.stiffness[0] == 0.0
    np.testing.assert_array_equal(found.springref, robot.springref)
    np.testing.assert_array_equal(found.chain.inertial, robot.chain.inertial)


def test_a_spring_that_needs_a_rotor_gets_a_fiftieth_of_what_the_joint_moves():
    robot = arm("planar")
    bare = replace(robot, chain=replace(robot.chain, armature=np.array([0.5, 0.0])))
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    gap = SimpleNamespace(robot=bare, sampled=SimpleNamespace(q=q))
    spring = Elasticity((1,), {"compliance": 0.001, "damping": 0.1})
    scored = SimpleNamespace(gap=gap)
    found, (kept,) = corrected(scored, (spring,), np.zeros(20 + 5))
    assert kept is spring and found.chain.armature[0] == 0.5
    # The last joint moves its own link about its axis, z, whatever the posture.
    about_axis = robot.chain.inertial[1, INERTIAL_NAMES.index("Izz")]
    assert found.chain.armature[1] == pytest.approx(0.02 * about_axis)


def test_chunks_of_time_follow_each_other_within_a_recording():
    number, recording = np.array([0, 1, 2, 5, 6, 7, 7, 8]), np.repeat([0, 1], [6, 2])
    clock = _Clock.cut(number, recording)
    assert clock.unbroken(3).tolist() == [True, False, False, True, False, False]
    assert clock.unbroken(2).tolist() == [True, True, False, True, True, False, True]


def test_of_nothing_scored_no_gap_is_left():
    found = shrunk(np.zeros((2, 3)), 0, "N·m", np.random.default_rng(0))
    assert (found.before, found.after, found.removed) == (0.0, 0.0, 0.0)


def test_a_push_on_an_arm_that_only_stands_is_told():
    robot, t = arm("planar"), np.arange(0.0, 6.0, 0.005)
    rng, q = np.random.default_rng(0), np.tile([0.4, -0.8], (len(t), 1))
    held = RigidBody(robot.chain, quiet_motion(t, q)).load
    held = held + 0.05 * rng.standard_normal(held.shape)
    for first, last, push in ((2.0, 2.6, 5.0), (4.0, 4.3, -4.0)):
        held[(t >= first) & (t < last), 1] += push
    log = Recording(t, q, tau=held, joints=robot.joints, source="standing")
    events = events_at_rest(measure_gap(robot, [log], cutoff=20.0))
    assert [x.recording for x in events] == ["standing"] * 2
    times = [(x.start, x.end) for x in events]
    np.testing.assert_allclose(times, [(2.0, 2.6), (4.0, 4.3)], atol=0.05)
    np.testing.assert_allclose([x.torque[1] for x in events], [5, -4], rtol=0.15)


def test_a_log_with_one_stamp_that_is_off_is_measured_to_its_end():
    """A clock made even may end a rounding behind the last stamp."""
    robot, t = arm("planar"), 0.004 * np.arange(500)
    t[100] += 0.001
    q = np.tile([0.4, -0.8], (len(t), 1))
    log = Recording(t, q, tau=0 * q, joints=robot.joints)
    gap, told = quiet(measure_gap, robot, [log], cutoff=20.0)
    assert len(gap.motions[0].t) == len(t) and gap.motions[0].t[-1] >= t[-1]
    assert any("irregular clock" in x for x in told)


def test_a_slow_arm_moves():
    robot, (log,) = quiet_logs()
    slow = replace(log, t=50.0 * log.t, v=None, command=None)
    assert np.abs(np.diff(log.q, axis=0)).max() / (slow.t[1] - slow.t[0]) < 0.1
    gap = measure_gap(robot, [slow], cutoff=1.0)
    assert (gap.moving.mean(axis=0) > 0.5).all()


def test_motions_alone_need_a_cut_off_and_none_lets_through_more_than_the_log():
    robot, recordings = quiet_logs()
    motions = [motion_from_recording(x, cutoff=60.0) for x in recordings]
    with pytest.raises(RecordingError, match="valid is a cut-off besides"):
        measure_gap(robot, motions)
    for logs in (recordings, motions):
        gap = measure_gap(robot, logs, cutoff=np.inf)
        assert gap.cutoff == gap.rate / 2 and len(gap.left) == len(logs[0].t)


@pytest.mark.parametrize(
    "effect",
    [
        TorqueGain((0,), {"gain": 0.2}),
        Delay((0,), {"time": 0.004}),
        ActuatorLag((0,), {"time": 0.01}),
    ],
)
def test_the_torque_before_a_report_is_reported_as_the_logged_one(effect):
    t = np.arange(0.0, 3.0, 0.002)
    logged = (np.sin(5.0 * t) + 0.3 * np.cos(20.0 * t))[:, None]
    before = _before_report(effect, t, logged)
    assert effect.reports
    assert np.abs(before - logged).max() > 0.02
    off = np.abs(effect.report(t, before) - logged)[50:-50]
    assert off.max() < 1e-3


@pytest.mark.study
def test_a_joint_may_move_no_body_of_its_own():
    """Two hinges of one body, as a universal joint is written."""
    ball = '<geom size=".1" mass="1" pos=".2 0 0"/>'
    robot = Robot.load(
        mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><body><joint name="x" axis="1 0 0"/>'
            f'<joint name="y" axis="0 1 0"/>{ball}</body></worldbody></mujoco>'
        )
    )
    logs = simulate(robot, trajectories=2, duration=6.0)
    assert examine(robot, logs).diagnosis.verdict == "no_gap"
