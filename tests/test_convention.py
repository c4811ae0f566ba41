"""Logs as MuJoCo loops write them: what is the log's is not held against the arm."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from arms import MODELS
from simulated import arm

from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.evidence.convention import Convention, find_convention
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.plant import random_fourier
from hybrid.recording import Recording
from hybrid.robot import Robot

STEP = 0.002
EULER, IMPLICIT_FAST = (
    mujoco.mjtIntegrator.mjINT_EULER,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
)
OWN = 2 * np.pi * 6.0  # rad/s, of the servos


@cache
def raw_logs(name, integrator, after, count=4, seed=1, offset=0.0):
    """A file with position servos, and logs of the very same model in a plain loop.

    Position is read before or after each step, torque after it.
    """
    path = str(MODELS / f"{name}.xml")
    robot, spec = arm(name), mujoco.MjSpec.from_file(path)
    plain = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(plain)
    mujoco.mj_forward(plain, data)
    inertia = np.zeros((plain.nv, plain.nv))
    mujoco.mj_fullM(plain, data, inertia)
    spec.option.timestep, spec.option.integrator = STEP, integrator
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint, own in zip(robot.joints, np.diag(inertia), strict=True):
        kp, kd = own * OWN**2, 1.6 * own * OWN
        servo = spec.add_actuator(
            name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.gainprm[0], servo.biasprm[:3] = kp, [0, -kp, -kd]
    model = spec.compile()
    kp, kd = -model.actuator_biasprm[:, 1], -model.actuator_biasprm[:, 2]
    shown = replace(robot, kp=kp, kd=kd, timestep=STEP)
    rng, logs = np.random.default_rng(seed), []
    for _ in range(count):
        wanted = random_fourier(robot, duration=6.0, rate=1 / STEP, seed=rng)
        data = mujoco.MjData(model)
        data.qpos[:] = wanted.q[0]
        for _ in range(250):
            data.ctrl[:] = wanted.q[0]
            mujoco.mj_step(model, data)
        q, tau = np.zeros((2, *wanted.q.shape))
        for k, command in enumerate(wanted.q):
            before = data.qpos.copy()
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
            q[k], tau[k] = data.qpos if after else before, data.qfrc_actuator
        q += 1e-5 * rng.standard_normal(q.shape)
        tau += 0.01 * tau.std(axis=0) * rng.standard_normal(tau.shape)
        tau[:, 0] += offset
        t = np.arange(len(q)) * STEP
        logs.append(Recording(t=t, q=q, tau=tau, command=wanted.q, joints=robot.joints))
    return shown, tuple(logs)


@pytest.mark.study
@pytest.mark.parametrize("name", ["coman_like", "scara"])
@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("integrator", [EULER, IMPLICIT_FAST])
def test_the_convention_of_a_loop_is_found(name, integrator, after):
    robot, logs = raw_logs(name, integrator, after)
    found = find_convention(measure_gap(robot, logs), logs)
    implicit = integrator == IMPLICIT_FAST
    assert found == Convention(STEP * after, STEP * implicit)


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.parametrize(
    "integrator, after", [(EULER, False), (EULER, True), (IMPLICIT_FAST, True)]
)
def test_a_faultless_simulation_has_no_gap(integrator, after, seed):
    robot, logs = raw_logs("coman_like", integrator, after, seed=seed)
    diagnosis = examine(robot, logs).diagnosis
    assert diagnosis.verdict == "no_gap"
    said = [w for w in diagnosis.warnings if "corrected" in w]
    assert len(said) == after + (integrator == IMPLICIT_FAST)


@pytest.mark.study
def test_a_fault_is_named_in_such_a_log():
    robot, logs = raw_logs("coman_like", IMPLICIT_FAST, True, offset=3.0)
    (finding,) = examine(robot, logs).diagnosis.findings
    assert "torque_offset" in finding.alternatives
    assert finding.joints == ("base",)


def test_one_late_joint_is_no_convention():
    robot, logs = raw_logs("coman_like", EULER, False)
    late = []
    for log in logs:
        tau = log.tau.copy()
        tau[1:, 1] = tau[:-1, 1]
        late.append(replace(log, tau=tau))
    assert not find_convention(measure_gap(robot, late), late)


def test_the_step_of_a_file_is_read_and_kept(tmp_path):
    robot = arm("coman_like")
    assert robot.timestep > 0
    assert Robot.from_dict(robot.as_dict()).timestep == robot.timestep
    assert np.isnan(Robot.load(MODELS / "coman_like.urdf").timestep)


@pytest.mark.parametrize("parts", [(1.3, 2.0, 6.0), (1.8, 2.0, 4.0)])
def test_a_heavier_last_link_is_no_convention(parts):
    """Its inertia is felt at each joint, about as the servos' damping would be."""
    robot, logs = raw_logs("scara", EULER, False)
    links, moments = robot.chain.inertial.copy(), np.repeat(parts, (1, 3, 6))
    light = robot.with_inertial(np.vstack([links[0], links[1] / moments]))
    assert not find_convention(measure_gap(light, logs), logs)
