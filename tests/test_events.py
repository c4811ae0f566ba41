"""Pushes on an arm that stands still."""

from dataclasses import replace

import numpy as np
from arms import MODELS
from coarse import Plant, simulate

from hybrid.diagnosis.answer.events import events_at_rest
from hybrid.diagnosis.answer.words import pushes, verdict_lines
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.dynamics import RigidBody
from hybrid.effects import effect_classes
from hybrid.plant import Noise
from hybrid.report.diagnosis import render_diagnosis
from hybrid.robot import Robot
from hybrid.signals import Motion

ROBOT = Robot.load(MODELS / "coman_like.xml")
FORCE = np.array([30.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def resting(recording, pushed, after=1.0):
    """A log that goes on for three seconds at rest, pushed for 0.8 s or not."""
    step = recording.t[1] - recording.t[0]
    t = recording.t[-1] + step * np.arange(1, round(3.0 / step) + 1)
    q = np.tile(recording.q[-1], (len(t), 1))
    still = Motion(t, q, 0 * q, 0 * q, 0 * q, np.ones(len(t), bool), None, ROBOT.joints)
    body = RigidBody(ROBOT.chain, still)
    start = recording.t[-1] + after
    during = (t > start) & (t < start + 0.8)
    wrench = np.outer(during * pushed, FORCE)
    tau = body.load + np.einsum("tij,tj->ti", body.wrench_columns(5), wrench)
    tau += np.random.default_rng(0).normal(0.0, 0.2, tau.shape)
    return replace(
        recording,
        t=np.concatenate([recording.t, t]),
        q=np.concatenate([recording.q, q]),
        tau=np.concatenate([recording.tau, tau]),
        v=None,
        command=None,
    )


def test_torque_that_settles_after_a_stop_is_no_push():
    """A real TX40 stops with 2 N·m that fade within half a second."""
    plant = Plant(ROBOT, [], nominal=ROBOT, noise=Noise.typical(ROBOT))
    logs = simulate(plant, trajectories=1, duration=4.0, seed=1)
    told = [
        len(events_at_rest(measure_gap(ROBOT, [resting(x, True, after)])))
        for x in logs for after in (0.0, 1.0)
    ]  # fmt: skip
    assert told == [0, 1]


def test_a_push_at_rest_is_told_with_time_torque_and_force():
    plant = Plant(ROBOT, [], nominal=ROBOT, noise=Noise.typical(ROBOT))
    logs = simulate(plant, trajectories=2, duration=4.0, seed=1)
    logs = [resting(x, pushed) for x, pushed in zip(logs, (True, False), strict=True)]
    few = {"coulomb", "viscous", "armature", "contact"}
    result = examine(ROBOT, logs, without=[*effect_classes().keys() - few])
    (event,) = result.diagnosis.events
    assert abs(event.start - 5.0) < 0.2 and abs(event.end - 5.8) < 0.2
    np.testing.assert_allclose(event.force[:3], FORCE[:3], atol=4.0)
    assert not events_at_rest(replace(result.gap, left=0 * result.gap.left))
    (line,) = pushes(result.diagnosis)
    assert line in render_diagnosis(result)
    assert any(line in x for x in verdict_lines(result.diagnosis))
    content = result.diagnosis.as_dict()["events"]
    assert content[0]["torque"] == list(event.torque)
