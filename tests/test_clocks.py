"""Torque stamped by another clock than position: late at every joint alike."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from blind.case import Case
from blind.run import make, read_open
from simulated import arm
from test_convention import EULER, STEP, raw_logs

from hybrid.diagnosis.answer.fixed import MODEL, write_fixed
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.evidence.convention import find_convention
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.delay import Delay
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.identification import DynamicModel
from hybrid.report.diagnosis import render_diagnosis
from hybrid.report.diagnosis_data import evidence_matrix, joint_curves

TIME = 0.007
GRIP = NonlinearViscous((2,), {"quadratic": 6.0})


def late_logs(time=TIME, rubs=False):
    """Logs of a loop of MuJoCo's own, whose torque is late; with friction, or not."""
    robot, logs = raw_logs("coman_like", EULER, False)
    found = []
    for x in logs:
        tau = x.tau.copy()
        if rubs:
            v = np.gradient(x.q[:, 2], x.t)
            tau[:, 2] += GRIP.values["quadratic"] * v * np.abs(v)
        tau = np.stack([np.interp(x.t - time, x.t, y) for y in tau.T], axis=1)
        found.append(replace(x, tau=tau, command=None))
    return robot, found


@pytest.mark.study
@pytest.mark.parametrize("time", [1.4 * STEP, TIME, 0.015])
def test_a_time_that_all_joints_share_is_measured(time):
    robot, logs = late_logs(time)
    found = find_convention(measure_gap(robot, logs), logs)
    assert found.clocks
    assert found.late == pytest.approx(time, abs=max(4 * found.std, 0.03 * time))
    off = find_convention(measure_gap(robot, logs), logs, clocks=False)
    assert not off.clocks


@pytest.mark.study
@pytest.mark.parametrize("rubs", [False, True])
def test_it_is_named_at_every_joint_with_whatever_else_is_there(rubs, tmp_path):
    """What else is there is late as well, so that it has to come first."""
    robot, logs = late_logs(rubs=rubs)
    result = with_motion_gap(examine(robot, logs), np.random.default_rng(0))
    diagnosis = result.diagnosis
    named = {f.effect: f for f in diagnosis.findings}
    assert set(named) == {"delay"} | ({GRIP.id} if rubs else set())
    assert diagnosis.verdict == "explained"
    late = named["delay"]
    assert late.joints == robot.joints
    assert sum(f.share for f in diagnosis.findings) == pytest.approx(1.0)
    assert 0 < late.share <= 1 - 0.05 * rubs
    for value in late.parameters:
        assert value.interval[0] < TIME < value.interval[1]
    torque, motion = late.shrink["torque"], late.shrink["motion"]
    assert torque.interval[0] > 0
    assert motion.removed > 0.5
    # The gap that is told is that of the log as it is.
    as_logged = measure_gap(robot, logs, cutoff=result.scored.gap.cutoff)
    moving = as_logged.moving
    rms = np.sqrt(np.sum(np.where(moving, as_logged.left, 0) ** 2, 0) / moving.sum(0))
    np.testing.assert_allclose(diagnosis.rms, rms, rtol=1e-3)  # but for the end
    page = render_diagnosis(result)
    assert "delay of torque that all joints share was removed before effects" in page
    cells = dict(evidence_matrix(result).rows)[Delay.id]
    assert [c.joints for c in cells] == list(robot.joints)
    assert all(c.named and min(c.alone, c.beside) > 1.0 for c in cells)
    _, today, after = np.array(joint_curves(result, 0)["time"], dtype=float)
    assert np.nanstd(after) < np.nanstd(today)
    write_fixed(result, tmp_path)
    written = DynamicModel.load(tmp_path / MODEL).effects
    assert sorted(e.joints[0] for e in written if e.id == Delay.id) == [*range(6)]
    if rubs:
        (value,) = (x for x in named[GRIP.id].parameters if x.name == "quadratic")
        assert value.interval[0] < GRIP.values["quadratic"] < value.interval[1]


@pytest.mark.study
def test_it_is_not_named_where_the_library_lacks_it():
    robot, logs = late_logs()
    result = examine(robot, logs, without=[Delay.id])
    assert not any(e.id == Delay.id for e in result.effects)
    assert all(f.effect != Delay.id for f in result.diagnosis.findings)


@pytest.mark.study
@pytest.mark.xfail(strict=True, reason="a late log is asked for before unknown laws")
def test_what_swings_along_is_no_late_log(tmp_path):
    """A mass that shakes is in no file; its torque seems 38 ms late at both joints."""
    case = Case(str(MODELS / "scara.xml"), "unknown", 0, 127)
    make(case, tmp_path, tmp_path / "open", tmp_path / "sealed")
    robot, logs, _ = read_open(tmp_path / "open")
    for k, x in enumerate(logs):
        early = {n: y[x.t < 5.0] for n, y in (x.channels | {"t": x.t}).items()}
        logs[k] = replace(x, **early)
    assert find_convention(measure_gap(robot, logs), logs).clocks
    diagnosis = examine(robot, logs).diagnosis
    assert diagnosis.verdict == "unexplained" and not diagnosis.findings


def test_joints_that_are_late_by_different_times_share_none():
    robot, logs = arm("coman_like"), []
    _, plain = late_logs(0.0)
    for x in plain:
        times = 0.004 * np.arange(1, 7)
        tau = [np.interp(x.t - s, x.t, y) for s, y in zip(times, x.tau.T, strict=True)]
        logs.append(replace(x, tau=np.stack(tau, axis=1)))
    assert not find_convention(measure_gap(robot, logs), logs)
