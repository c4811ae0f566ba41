"""The link from command to torque: latency and gains of a servo, and nothing else."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arms import LIFT
from coarse import Plant, simulate
from loop import Loop, commanded_torque
from simulated import arm

from hybrid.diagnosis.answer.command import command_link
from hybrid.diagnosis.answer.fixed import MODEL, SIMULATOR, write_fixed
from hybrid.diagnosis.answer.links import COMMAND_TO_TORQUE, merged_links
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.answer.words import verdict_lines
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.controller_gain import ControllerGain
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.elasticity import Elasticity
from hybrid.effects.encoder_eccentricity import EncoderEccentricity
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_gain import TorqueGain
from hybrid.identification import DynamicModel
from hybrid.plant import Noise
from hybrid.report.diagnosis import render_diagnosis
from hybrid.robot import Robot

LATE = CommandLatency((0,), {"time": 0.012})
SOFT = ControllerGain((1,), {"stiffness": -0.3, "damping": 0.25})


_KEPT = {}


def logged(*effects, integrator="implicitfast", control_rate=1000.0):
    """A robot file that declares its servos, and logs of the arm with effects."""
    key = (repr(effects), integrator, control_rate)
    if key not in _KEPT:
        plant = Plant(
            arm("planar"), effects, integrator=integrator, control_rate=control_rate
        )
        recordings = simulate(plant, trajectories=4, duration=4.0, seed=1)
        _KEPT[key] = declared(plant), recordings
    return _KEPT[key]


def declared(plant):
    return replace(plant.robot, kp=plant.servo.kp, kd=plant.servo.kd)


def link_of(robot, recordings, **options):
    gap = measure_gap(robot, recordings)
    return command_link(gap, recordings, np.random.default_rng(0), **options)


def undeclared(robot):
    none = np.full(robot.size, np.nan)
    return replace(robot, kp=none, kd=none)


def values(finding):
    return {(p.joint, p.name): p for p in finding.parameters}


def test_a_late_command_is_found_at_its_joint_even_without_declared_gains():
    robot, recordings = logged(LATE)
    for known in (robot, undeclared(robot)):
        (found,) = link_of(known, recordings).findings
        assert (found.effect, found.joints) == ("command_latency", robot.joints[:1])
        (time,) = found.parameters
        assert time.value == pytest.approx(0.012, abs=2e-4)
        assert 0 < time.interval[1] - time.interval[0] < 1e-3
        assert found.shrink["torque"].interval[0] > 0.2


def test_wrong_gains_are_found_where_gains_are_declared():
    robot, recordings = logged(SOFT)
    (found,) = link_of(robot, recordings).findings
    assert (found.effect, found.joints) == ("controller_gain", robot.joints[1:2])
    for name, truth in SOFT.values.items():
        parameter = values(found)[robot.joints[1], name]
        half = (parameter.interval[1] - parameter.interval[0]) / 2
        assert abs(parameter.value - truth) < 2 * half < 0.2
    assert link_of(undeclared(robot), recordings).findings == ()


@pytest.mark.study
@pytest.mark.parametrize("damping", [0.0, -0.4])
def test_noise_of_the_speed_is_no_lack_of_damping(damping):
    """Noise in a signal makes the gain on it seem lower than it is."""
    usual = Noise.typical(arm("planar"))
    noise = replace(
        usual,
        speed_std=30.0 * usual.speed_std,
        torque_covariance=0.09 * usual.torque_covariance,
    )
    effects = [ControllerGain((0,), {"damping": damping})] if damping else []
    plant = Plant(arm("planar"), effects, noise=noise)
    for seed in (1, 2):
        recordings = simulate(plant, trajectories=4, duration=5.0, seed=seed)
        found = [e.joints for e in link_of(declared(plant), recordings).effects]
        assert found == ([(0,)] if damping else [])


@pytest.mark.parametrize("effect", [None, LATE])
def test_a_coarse_encoder_is_no_wrong_gain(effect):
    """Shifts of the torque and gains of a servo may stand for noise of its position."""
    robot, recordings = logged(*([effect] if effect else []))
    step = 1.5e-3
    coarse = [replace(r, q=step * np.round(r.q / step), v=None) for r in recordings]
    found = {f.effect for f in link_of(robot, coarse).findings}
    assert found <= ({effect.id} if effect else set())


@pytest.mark.study
@pytest.mark.parametrize("noise", [5e-5, 1e-4])
def test_noise_of_a_position_is_no_lack_of_damping_beside_a_shift(noise, tmp_path):
    """Torque logged early makes up for damping; both together let less noise pass."""
    path = tmp_path / "lift.xml"
    path.write_text(LIFT)
    plant = Plant(Robot.load(path), [], noise=Noise.none(2))
    rng, noisy = np.random.default_rng(1), []
    for x in simulate(plant, trajectories=2, duration=20.0, seed=3):
        q = x.q + noise * rng.standard_normal(x.q.shape)
        tau = x.tau + 0.003 * np.abs(x.tau).max(0) * rng.standard_normal(x.tau.shape)
        noisy.append(replace(x, q=q, tau=tau, v=None))
    gap = measure_gap(declared(plant), noisy, cutoff=12.9)
    assert command_link(gap, noisy, np.random.default_rng(0)).findings == ()


@pytest.mark.study
def test_intervals_of_gains_hold_the_truth():
    inside = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = dict(zip(("stiffness", "damping"), rng.uniform(0.1, 0.4, 2) *
                         rng.choice([-1, 1], 2), strict=True))  # fmt: skip
        usual = Noise.typical(arm("planar"))
        noise = replace(usual, speed_std=10.0 * usual.speed_std)
        plant = Plant(arm("planar"), [ControllerGain((0,), truth)], noise=noise)
        recordings = simulate(plant, trajectories=4, duration=5.0, seed=seed)
        (found,) = link_of(declared(plant), recordings).findings
        inside += [
            x.interval[0] <= truth[x.name] <= x.interval[1] for x in found.parameters
        ]
    assert np.mean(inside) > 0.9


def test_latency_and_gains_of_one_joint_are_told_apart():
    robot, recordings = logged(LATE, replace(SOFT, joints=(0,)))
    link = link_of(robot, recordings)
    assert {f.effect for f in link.findings} == {"command_latency", "controller_gain"}
    assert sum(f.share for f in link.findings) == pytest.approx(1.0)
    late, soft = (e.values for e in link.effects)
    assert late["time"] == pytest.approx(0.012, abs=3e-4)
    assert soft["stiffness"] == pytest.approx(-0.3, abs=0.05)


@pytest.mark.study
@pytest.mark.parametrize("effect", [LATE, SOFT])
def test_an_effect_left_out_of_the_library_is_not_named(effect):
    robot, recordings = logged(effect)
    link = link_of(robot, recordings, without=(effect.id,))
    assert effect.id not in {f.effect for f in link.findings}


OTHERS = [
    (),
    (Delay((0,), {"time": 0.008}),),
    (ActuatorLag((0,), {"time": 0.01}),),
    (TorqueGain((1,), {"gain": 0.15}),),
    (Stribeck((0,), {"level": 1.5, "velocity": 0.1}), Coulomb((1,), {"level": 2.0})),
    (EncoderEccentricity((0,), {"sine": 0.01, "cosine": 0.005}),),
    (Elasticity((1,), {"compliance": 2e-4}),),
]


@pytest.mark.study
@pytest.mark.parametrize("effects", OTHERS)
def test_effects_elsewhere_are_no_fault_of_the_servo(effects):
    assert link_of(*logged(*effects)).findings == ()


@pytest.mark.study
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_how_a_plant_is_integrated_or_sampled_is_no_fault_of_the_servo(integrator):
    robot, recordings = logged(integrator=integrator, control_rate=500.0)
    assert link_of(robot, recordings).findings == ()


@pytest.mark.study
@pytest.mark.parametrize("channel", ["q", "tau"])
def test_a_channel_logged_late_is_no_latency_of_commands(channel):
    robot, recordings = logged()
    late = 5  # samples, 10 ms
    shifted = []
    for x in recordings:
        old = {n: getattr(x, n)[late:] for n in ("t", "q", "v", "tau", "command")}
        old[channel] = getattr(x, channel)[:-late]
        shifted.append(replace(x, **old))
    assert "command_latency" not in {f.effect for f in link_of(robot, shifted).findings}


def test_nothing_is_said_without_commands_or_of_another_kind_of_servo():
    robot, recordings = logged(LATE)
    bare = [replace(x, command=None) for x in recordings]
    assert link_of(robot, bare).findings == ()
    rng = np.random.default_rng(0)
    # A controller with hidden inputs: most of its torque follows no law of ours.
    hidden = np.cumsum(rng.standard_normal(recordings[0].tau.shape), axis=0)
    strange = [replace(x, tau=x.tau + 2 * hidden) for x in recordings]
    assert link_of(robot, strange).findings == ()


@pytest.mark.parametrize("feeds", [False, True])
def test_the_law_is_that_of_the_simulated_loop(feeds):
    """Torque made by the loop's own equation, without any plant."""
    robot, recordings = logged()
    gap = measure_gap(robot, recordings)
    rows = []
    for x, motion in zip(recordings, gap.motions, strict=True):
        v_ref = np.gradient(x.command, x.t, axis=0)
        feed = motion.tau * 0.0
        seen = replace(gap, motions=(motion,))
        assert seen.robot is robot
        loop = Loop(x.t, x.command, v_ref if feeds else 0 * v_ref, feed,
                    x.q, motion.v, robot.kp, robot.kd)  # fmt: skip
        rows.append(replace(x, tau=commanded_torque(loop, [LATE])))
    (found,) = link_of(undeclared(robot), rows).findings
    assert found.joints == robot.joints[:1]
    assert found.parameters[0].value == pytest.approx(0.012, abs=3e-4)


@pytest.mark.study
def test_both_links_make_one_diagnosis(tmp_path):
    robot, recordings = logged(LATE, Stribeck((1,), {"level": 1.5, "velocity": 0.1}))
    result = examine(robot, recordings)
    diagnosis = with_motion_gap(result, np.random.default_rng(0)).diagnosis
    shares = [f.share for f in diagnosis.findings]
    assert sum(shares) == pytest.approx(1.0)
    assert shares == sorted(shares, reverse=True)
    assert diagnosis.verdict == "explained"
    late = next(f for f in diagnosis.findings if f.effect == "command_latency")
    assert set(late.shrink) == {"torque"}  # a replay is driven by torque
    units = [r.unit for r in diagnosis.where if r.variable == "link"]
    assert COMMAND_TO_TORQUE in units
    assert sum(r.share for r in diagnosis.where if r.variable == "link") < 1.0 + 1e-6
    assert "Command latency" in "\n".join(verdict_lines(diagnosis))
    assert "Command latency" in render_diagnosis(replace(result, diagnosis=diagnosis))
    notes = write_fixed(result, tmp_path)
    assert any("delay commands by 12 ms" in note for note in notes)
    assert "delay commands" in (tmp_path / SIMULATOR).read_text()
    ids = [e.id for e in DynamicModel.load(tmp_path / MODEL).effects]
    assert "command_latency" in ids


@pytest.mark.study
def test_a_late_command_explains_an_arm_without_any_other_gap():
    robot, recordings = logged(LATE)
    result = examine(robot, recordings)
    assert [f.effect for f in result.diagnosis.findings] == ["command_latency"]
    assert result.diagnosis.verdict == "explained"
    assert result.diagnosis.unexplained == 0.0
    nothing = replace(result.diagnosis, findings=(), verdict="unexplained")
    nothing = replace(nothing, unexplained=1.0)
    gap = result.gap
    link = command_link(gap, recordings, np.random.default_rng(0))
    both = merged_links(nothing, result.account, gap, link, np.random.default_rng(0))
    assert both.verdict == "partly_explained"
    assert 0.0 <= both.unexplained < 1.0


SERVOS = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/>
<geom size="0.1"/><body pos="1 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1"/>
<body pos="1 0 0"><joint name="c" axis="0 1 0"/><geom size="0.1"/></body></body></body>
</worldbody><actuator>{}</actuator></mujoco>"""


def load(tmp_path, actuators):
    path = tmp_path / "arm.xml"
    path.write_text(SERVOS.format(actuators))
    return Robot.load(path)


def test_servo_gains_are_read_from_mjcf_at_the_joint(tmp_path):
    robot = load(
        tmp_path,
        '<position joint="a" kp="50" kv="4"/>'
        '<position joint="b" kp="10" gear="3"/><velocity joint="b" kv="2"/>'
        '<motor joint="c"/>',
    )
    np.testing.assert_allclose(robot.kp, [50.0, 90.0, np.nan])
    np.testing.assert_allclose(robot.kd, [4.0, 2.0, np.nan])
    again = Robot.from_dict(robot.as_dict())
    np.testing.assert_array_equal(again.kp, robot.kp)
    assert again.fingerprint() == robot.fingerprint()


def test_declared_gains_are_those_that_mujoco_pulls_with(tmp_path):
    general = '<general joint="b" gear="2" biastype="affine" gainprm="7" '
    actuators = general + 'biasprm="0 -7 -0.5"/><position joint="a" kp="3" kv="1"/>'
    robot = load(tmp_path, actuators)
    model = mujoco.MjModel.from_xml_path(robot.path)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:], data.qvel[:] = rng.standard_normal((2, 3))
    mujoco.mj_forward(model, data)
    pulled = -robot.kp * data.qpos - robot.kd * data.qvel
    np.testing.assert_allclose(pulled[:2], data.qfrc_actuator[:2])
    assert np.isnan(pulled[2])
