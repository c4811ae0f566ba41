"""The plant obeys mechanics, realises every effect, and logs what it says."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest
from arms import public_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.effects import Effect, Port, effect_class
from hybrid.errors import EffectError, HybridError, RobotError
from hybrid.plant import Noise, Plant, Reference, load_truth, random_fourier, simulate
from hybrid.plant.arm import build_arm, inverse_dynamics
from hybrid.plant.lockstep import Lockstep
from hybrid.plant.reference import limits
from hybrid.plant.servo import Servo
from hybrid.robot import Robot

HINGE = """<mujoco><compiler angle="radian"/><worldbody><body>
  <joint name="turn" axis="{axis}" armature="0.3" range="-2 2" limited="true"/>
  <inertial pos="0.5 0 0" mass="2" diaginertia=".01 .02 .02"/>
</body></worldbody></mujoco>"""
TWO_LINKS = """<mujoco><compiler angle="radian"/><worldbody><body>
  <joint name="shoulder" axis="0 1 0" armature="0.2"/>
  <inertial pos="0.2 0 0.05" mass="3" diaginertia=".01 .05 .05"/>
  <body pos="0.4 0 0"><joint name="elbow" axis="0 1 0" armature="0.1"/>
    <inertial pos="0.15 0.02 0" mass="1.5" diaginertia=".004 .02 .02"/></body>
</body></worldbody></mujoco>"""
HINGE_INERTIA = 0.3 + 0.02 + 2 * 0.5**2  # rotor and link, kg·m²
WEIGHT = 2 * 9.81 * 0.5  # N·m with the hinge's link horizontal


@cache
def load(text: str) -> Robot:
    return Robot.load(mujoco.MjModel.from_xml_string(text))


@pytest.fixture
def pendulum():
    return load(HINGE.format(axis="0 -1 0"))


@pytest.fixture
def turntable():
    return load(HINGE.format(axis="0 0 1"))


@pytest.fixture
def two_links():
    return load(TWO_LINKS)


def effect(name: str, *joints: int, **values: float) -> Effect:
    return effect_class(name)(joints or (0,), values)


def motions(robot: Robot, count: int = 1, duration: float = 1.5) -> list[Reference]:
    children = np.random.default_rng(5).spawn(count)
    return [
        random_fourier(robot, duration=duration, rate=500, seed=rng) for rng in children
    ]


def hold(q: list[float], duration: float = 1.0) -> Reference:
    t = np.linspace(0, duration, 11)
    zero = np.zeros((11, len(q)))
    return Reference(t, zero + np.array(q), zero, zero)


def run(robot, effects=(), references=None, **options):
    options = {"noise": Noise.none(robot.size), "step": 0.001} | options
    plant = Plant(robot, effects, **options)
    return plant.run(references or motions(robot), seed=np.random.default_rng(0))


@cache
def plain_log():
    """The two links without effects."""
    return run(load(TWO_LINKS))[0]


def residual(robot, recording):
    """Logged torque less rigid body and rotors; two samples lost at each end."""
    q, dt = recording.q, recording.t[1] - recording.t[0]
    v = (q[2:] - q[:-2]) / (2 * dt)
    a = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2
    return recording.tau[1:-1] - inverse_dynamics(robot, q[1:-1], v, a), v, q[1:-1]


def rms(x):
    return np.sqrt(np.mean(np.square(x), axis=0))


# Mechanics


@pytest.mark.parametrize(
    ("integrator", "step", "tolerance"),
    [("rk4", 0.0005, 1e-6), ("implicitfast", 0.0001, 1e-3), ("euler", 0.0001, 1e-3)],
)
def test_a_free_arm_keeps_its_energy(two_links, integrator, step, tolerance):
    free = Servo(kp=np.zeros(2), kd=np.zeros(2), limit=np.full(2, np.inf))
    (log,) = run(
        two_links,
        references=[hold([0.3, -0.5], 1.2)],
        servo=free,
        integrator=integrator,
        step=step,
    )
    energy = energies(two_links, log)
    swing = two_links.chain.inertial[:, 0].sum() * 9.81 * 0.4
    assert np.abs(log.v).max() > 3
    assert np.ptp(energy) < tolerance * swing


def energies(robot, log):
    model = robot.mujoco_spec().compile()
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(model)
    total = []
    for q, v in zip(log.q, log.v, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        total.append(data.energy.sum())
    return np.array(total)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"step": 0.0005},
        {"step": 0.00025, "control_rate": 500.0},
        {"step": 0.0005, "control_rate": 2000.0, "log_rate": 1000.0},
        {"integrator": "rk4"},
        {"integrator": "implicit"},
    ],
    ids=str,
)
def test_without_effects_inverse_dynamics_is_the_logged_torque(two_links, options):
    (log,) = run(two_links, **options)
    rest, _, _ = residual(two_links, log)
    assert (rms(rest) < 1e-3 * rms(log.tau)).all()


def test_declared_friction_stays_in_the_plant(two_links):
    lossy = replace(two_links, damping=np.array([2.0, 1.0]))
    (log,) = run(lossy)
    rest, v, _ = residual(lossy, log)
    np.testing.assert_allclose(rest, v * lossy.damping, atol=1e-3 * rms(log.tau).max())


def test_logged_speed_belongs_to_the_logged_position(two_links):
    (log,) = run(two_links, references=motions(two_links, duration=2.5))
    _, v, _ = residual(two_links, log)
    np.testing.assert_allclose(log.v[1:-1], v, atol=1e-4 * np.abs(v).max())


def test_the_arm_follows_its_command(two_links):
    (log,) = run(two_links, [effect("coulomb", 0, level=2.0)])
    assert np.abs(log.q - log.command).max() < 0.02


# Determinism


def test_the_same_seed_gives_identical_arrays(two_links):
    effects = [effect("coulomb", 1, level=0.5), effect("torque_ripple", 0, sine=0.3)]
    options = {"trajectories": 2, "duration": 0.6}
    first = simulate(two_links, effects, seed=3, **options)
    again = simulate(two_links, effects, seed=3, **options)
    other = simulate(two_links, effects, seed=4, **options)
    for one, two, three in zip(first, again, other, strict=True):
        for name in ("t", "q", "v", "tau", "command"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert np.abs(one.q - three.q).max() > 0.1


def test_a_trajectory_does_not_depend_on_its_companions(two_links):
    effects = [effect("stribeck", 0, level=2.0), effect("load_friction", 1)]
    long, short = motions(two_links, 1, 1.0)[0], motions(two_links, 2, 0.5)[1]
    together = run(two_links, effects, [long, short], noise=Noise.typical(two_links))
    alone = run(two_links, effects, [long], noise=Noise.typical(two_links))
    np.testing.assert_array_equal(together[0].tau, alone[0].tau)
    assert len(together[1].t) == 251 and len(together[0].t) == 501


# Dry friction


def ramp(slope: float, duration: float = 2.0) -> Reference:
    t = np.linspace(0, duration, 1001)
    q = slope * t[:, None]
    return Reference(t, q, np.zeros_like(q), np.zeros_like(q))


@pytest.mark.parametrize(
    ("effects", "direction", "expected"),
    [
        ({"coulomb": {"level": 5.0}}, -1, 5.0),
        ({"coulomb": {"level": 4.0}, "stribeck": {"level": 2.0}}, 1, 6.0),
        ({"coulomb": {"level": 5.0}, "asymmetric_friction": {"level": 1.0}}, 1, 6.0),
        ({"coulomb": {"level": 5.0}, "asymmetric_friction": {"level": 1.0}}, -1, 4.0),
        (
            {
                "threshold_friction": {
                    "coulomb_positive": 4.0,
                    "coulomb_negative": 4.0,
                    "falling": 2.0,
                }
            },
            1,
            6.0,
        ),
    ],
    ids=["coulomb", "stribeck", "asymmetric, up", "asymmetric, down", "threshold"],
)
def test_a_joint_sticks_below_the_level_and_breaks_away_at_it(
    turntable, effects, direction, expected
):
    soft = Servo(kp=np.full(1, 10.0), kd=np.zeros(1), limit=np.full(1, np.inf))
    friction = [effect(name, **values) for name, values in effects.items()]
    (log,) = run(turntable, friction, [ramp(0.5 * direction)], servo=soft)
    torque = direction * log.tau[:, 0]
    stuck = (torque < 0.98 * expected) & (log.t < 1.2)
    assert np.abs(log.q[stuck]).max() < 1e-4
    away = np.argmax(np.abs(log.v[:, 0]) > 0.0005)
    assert torque[away] == pytest.approx(expected, rel=0.02)


def test_a_stuck_joint_carries_its_weight_without_creeping(pendulum):
    loose = Servo(kp=np.zeros(1), kd=np.zeros(1), limit=np.full(1, np.inf))
    level = effect("coulomb", level=1.05 * WEIGHT)
    (log,) = run(pendulum, [level], [hold([0.0], 2.0)], servo=loose)
    assert np.abs(log.q).max() < 1e-4


def test_coulomb_friction_is_a_level_against_motion(two_links):
    (log,) = run(two_links, [effect("coulomb", 1, level=1.5)])
    rest, v, _ = residual(two_links, log)
    moving = np.abs(v[:, 1]) > 0.05
    np.testing.assert_allclose(rest[moving, 1], 1.5 * np.sign(v[moving, 1]), rtol=0.02)
    assert rms(rest[:, 0]) < 2e-3 * rms(log.tau[:, 0])


def test_asymmetry_takes_away_from_declared_friction(two_links):
    dry = replace(two_links, frictionloss=np.array([2.0, 1.0]))
    (log,) = run(dry, [effect("asymmetric_friction", 0, level=0.5)])
    rest, v, _ = residual(dry, log)
    v, rest = v[:, 0], rest[:, 0]
    np.testing.assert_allclose(rest[v > 0.05], 2.5, rtol=0.02)
    np.testing.assert_allclose(rest[v < -0.05], -1.5, rtol=0.02)


def test_load_friction_grows_with_the_transmitted_torque(two_links):
    (log,) = run(two_links, [effect("load_friction", coefficient=0.1)])
    rest, v, q = residual(two_links, log)
    bare = two_links.chain.armature * 0
    rigid = replace(two_links, chain=replace(two_links.chain, armature=bare))
    a = np.gradient(v, log.t[1:-1], axis=0)
    load = inverse_dynamics(rigid, q, v, a)[:, 0]
    moving = np.abs(v[:, 0]) > 0.05
    expected = 0.1 * np.abs(load) * np.sign(v[:, 0])
    error = (rest[:, 0] - expected)[moving]
    assert rms(error) < 0.02 * rms(expected)


# Other effects


def test_strong_damping_does_not_shake_a_light_link():
    """As on a wrist whose file knows of no rotor: it slows down in less than a step."""
    light = HINGE.replace('armature="0.3"', "").replace('mass="2"', 'mass="1e-3"')
    light = light.replace(".01 .02 .02", "1e-4 2e-4 2e-4")
    strong = effect("viscous", coefficient=3.0)
    arm = build_arm(
        load(light.format(axis="0 0 1")), [strong], step=1e-3, integrator="implicitfast"
    )
    state = Lockstep(arm, [strong], np.zeros((1, 1)))
    state.step(np.array([[6.0]]), substeps=500)
    assert state.v[0, 0] == pytest.approx(6.0 / 3.0, rel=1e-3)


def test_ripple_appears_at_its_spatial_frequency(turntable):
    (log,) = run(turntable, [effect("torque_ripple", sine=0.4, cosine=0.3, periods=12)])
    rest, _, q = residual(turntable, log)
    fits = {
        k: np.linalg.lstsq(np.hstack([np.sin(k * q), np.cos(k * q)]), rest[:, 0])
        for k in range(1, 30)
    }
    assert min(fits, key=lambda k: fits[k][1][0]) == 12
    np.testing.assert_allclose(fits[12][0], [0.4, 0.3], atol=0.005)


def test_gain_multiplies_the_reported_torque(two_links):
    (log,) = run(two_links, [effect("torque_gain", 0, gain=0.2)])
    rest, _, _ = residual(two_links, log)
    rigid = log.tau[1:-1] - rest
    assert rms(log.tau[1:-1, 0] - 1.2 * rigid[:, 0]) < 2e-3 * rms(rigid[:, 0])
    assert rms(rest[:, 1]) < 2e-3 * rms(rigid[:, 1])


def test_delay_reports_an_older_torque(two_links):
    (late,) = run(two_links, [effect("delay", 1, time=0.02)])
    prompt = plain_log()
    np.testing.assert_array_equal(late.q, prompt.q)
    np.testing.assert_array_equal(late.tau[:, 0], prompt.tau[:, 0])
    np.testing.assert_allclose(late.tau[10:, 1], prompt.tau[:-10, 1], atol=1e-12)


def test_payload_raises_the_holding_torque(pendulum):
    grip = effect("payload", mass=1.5, mx=1.2, Ixx=0.1, Iyy=1.1, Izz=1.1)
    (log,) = run(pendulum, [grip], [hold([0.0])])
    expected = WEIGHT + 9.81 * 1.2
    stiffness = Plant(pendulum, [grip]).servo.kp[0]
    sag = log.q[-1, 0]
    assert sag == pytest.approx(-9.81 * 1.2 / stiffness, rel=0.01)
    assert log.tau[-1, 0] == pytest.approx(expected * np.cos(sag), rel=1e-3)


# Elasticity


def test_an_elastic_joint_rings_at_its_resonance(turntable):
    stiffness, link, rotor = 800.0, HINGE_INERTIA - 0.3, 0.3
    twist = effect("elasticity", compliance=1 / stiffness, damping=0.0)
    arm = build_arm(turntable, [twist], step=0.0005, integrator="implicitfast")
    state = Lockstep(arm, [twist], np.zeros((1, 1)))
    state.step(np.full((1, 1), 5.0), 20)
    q = []
    for _ in range(4000):
        state.step(np.zeros((1, 1)))
        q.append(state.q[0, 0])
    t = 0.0005 * np.arange(4000)
    ringing = np.array(q) - np.polyval(np.polyfit(t, q, 1), t)
    rising = t[1:][(ringing[:-1] < 0) & (ringing[1:] >= 0)]
    measured = (len(rising) - 1) / (rising[-1] - rising[0])
    expected = np.sqrt(stiffness * (1 / rotor + 1 / link)) / (2 * np.pi)
    assert measured == pytest.approx(expected, rel=0.01)


def test_the_encoder_of_an_elastic_joint_sits_on_the_motor(pendulum):
    twist = effect("elasticity", compliance=0.002, damping=1.0)
    (log,) = run(pendulum, [twist], [hold([0.0])])
    sag = 0.002 * log.tau[-1, 0]
    assert abs(log.q[-1, 0]) < 0.1 * sag
    assert log.tau[-1, 0] == pytest.approx(WEIGHT * np.cos(sag), rel=1e-3)


def test_elastic_joints_start_in_equilibrium(pendulum):
    twist = effect("elasticity", compliance=0.002, damping=0.0)
    (log,) = run(pendulum, [twist], [hold([0.0])])
    assert np.ptp(log.tau) < 0.02 * WEIGHT


def test_friction_and_environment_act_on_their_sides_of_the_spring(pendulum):
    effects = [
        effect("elasticity", compliance=0.002, damping=1.0),
        effect("spring", stiffness=30.0, preload=4.0),
        effect("load_friction", coefficient=0.1),
    ]
    (log,) = run(pendulum, effects, [hold([0.0], 1.5)])
    load = log.tau[-1, 0]  # at rest friction takes anything up to its level
    link = log.q[-1, 0] - 0.002 * load
    weight = WEIGHT * np.cos(link) + 30.0 * link + 4.0
    assert load == pytest.approx(weight, rel=0.11)
    assert abs(log.v[-1, 0]) < 1e-5


def test_elasticity_without_a_rotor_is_refused():
    massless = load(HINGE.format(axis="0 0 1").replace('armature="0.3"', ""))
    with pytest.raises(EffectError, match="rotor"):
        Plant(massless, [effect("elasticity", compliance=0.001)])
    Plant(
        massless,
        [effect("elasticity", compliance=0.001), effect("armature", inertia=0.1)],
    )


# Backlash


def test_a_play_rests_on_the_side_that_its_load_pushes_it_to(pendulum):
    (log,) = run(pendulum, [effect("backlash", half_width=0.02)], [hold([0.0])])
    # The encoder sits on the motor; the link hangs lower, where its weight is less.
    assert abs(log.q[-1, 0]) < 0.002
    assert log.tau[-1, 0] == pytest.approx(WEIGHT * np.cos(0.02), rel=1e-4)
    assert np.ptp(log.tau) < 1e-3 * WEIGHT


def test_within_its_play_a_motor_moves_without_its_link(turntable):
    play = effect("backlash", half_width=0.05)
    arm = build_arm(turntable, [play], step=0.0005, integrator="implicitfast")
    state = Lockstep(arm, [play], np.zeros((1, 1)))
    state.step(np.full((1, 1), 1.0), 200)
    # The rotor alone, and the hundredth of it that the gear has, for a tenth second.
    free = 0.5 * (1.0 / 0.303) * 0.1**2
    assert state.q[0, 0] == pytest.approx(free, rel=0.006)
    assert state.load[0, 0] == 0
    state.step(np.full((1, 1), 1.0), 2000)
    state.step(np.full((1, 1), 1.0), 1)
    assert state.a[0, 0] == pytest.approx(1.0 / HINGE_INERTIA, rel=1e-3)
    assert state.load[0, 0] == pytest.approx(1 - 0.3 / HINGE_INERTIA, rel=1e-3)
    gap = arm.model.joint("turn/play").range
    np.testing.assert_allclose(gap, [-0.05, 0.05])


def test_a_gear_may_both_twist_and_have_play(pendulum):
    both = [
        effect("elasticity", compliance=0.002, damping=1.0),
        effect("backlash", half_width=0.02),
    ]
    (log,) = run(pendulum, both, [hold([0.0])])
    sag = 0.002 * WEIGHT + 0.02
    assert log.tau[-1, 0] == pytest.approx(WEIGHT * np.cos(sag), rel=1e-3)


def test_a_play_without_a_rotor_is_refused():
    massless = load(HINGE.format(axis="0 0 1").replace('armature="0.3"', ""))
    with pytest.raises(EffectError, match="backlash at 'turn' needs a rotor"):
        Plant(massless, [effect("backlash", half_width=0.001)])
    assert Plant(massless, [effect("backlash")]).arm.model.nv == 1


# Friction with a memory, contact, gravity


def test_a_joint_before_sliding_is_a_spring(turntable):
    friction = effect("presliding", level=5.0, distance=0.02)
    soft = Servo(kp=np.full(1, 1e3), kd=np.full(1, 40.0), limit=np.full(1, np.inf))
    (log,) = run(turntable, [friction], [ramp(0.02, 1.0)], servo=soft)
    q = log.q[:, 0]
    slow = log.t > 0.1
    expected = 5.0 * (1 - np.exp(-q / 0.02))
    np.testing.assert_allclose(log.tau[slow, 0], expected[slow], atol=0.1)
    assert 0.5 < q[-1] / 0.02 and np.diff(q).min() > -1e-6


def test_a_gear_warms_as_it_turns(turntable):
    values = {"cold": 4.0, "time_constant": 1e4, "warm_up": 0.5}
    friction = effect("thermal_friction", **values)
    (log,) = run(turntable, [friction], motions(turntable, duration=4.0))
    rest, v, _ = residual(turntable, log)
    heat = np.cumsum(v[:, 0] ** 2) * np.diff(log.t).mean()
    moving = np.abs(v[:, 0]) > 0.2 * np.abs(v).max()
    weight = rest[moving, 0] / v[moving, 0] / 4.0
    np.testing.assert_allclose(weight, 1.0 / (1.0 + heat[moving] / 0.5), atol=0.02)
    assert weight[0] > 0.9 > 0.5 > weight[-1]


def test_friction_of_a_plant_follows_its_speed_late(turntable):
    friction = effect("friction_lag", coefficient=4.0, time=0.1)
    (log,) = run(turntable, [friction], motions(turntable, duration=4.0))
    rest, v, _ = residual(turntable, log)
    step, u = np.diff(log.t).mean(), v[0, 0]
    late = [u := u + step / 0.1 * (x - u) for x in v[:, 0]]
    inner = slice(100, -100)
    np.testing.assert_allclose(rest[inner, 0], 4.0 * np.array(late)[inner], atol=0.1)
    assert np.abs(late - v[:, 0])[inner].max() > 0.2


def test_a_contact_pushes_for_its_time_only(pendulum):
    # Origin of the link's frame: the joint itself, so that a force has no lever.
    touch = effect("contact", moment_y=2.0, force_z=30.0, start=0.4, duration=0.3)
    (log,) = run(pendulum, [touch], [hold([0.0])])
    change = log.tau[:, 0] - WEIGHT * np.cos(log.q[:, 0])
    during = (log.t > 0.6) & (log.t < 0.7)
    np.testing.assert_allclose(change[during], -2.0, rtol=0.05)  # the axis is −y
    before = log.t < 0.4
    np.testing.assert_allclose(change[before], 0, atol=1e-3)
    first = log.t[np.argmax(np.abs(change) > 0.05)]
    assert 0.4 <= first < 0.41


def test_a_contact_in_one_recording_leaves_the_others_alone(pendulum):
    values = {"moment_y": 2.0, "start": 0.4, "duration": 0.3, "recording": 1}
    held = [hold([0.0])] * 3
    logs = run(pendulum, [effect("contact", **values)], held)
    plain = run(pendulum, [], held)
    changed = [np.abs(x.tau - y.tau).max() for x, y in zip(logs, plain, strict=True)]
    assert changed[1] > 1.0 and max(changed[0], changed[2]) < 1e-9


def test_a_tilted_base_turns_gravity(pendulum):
    pitch = effect("gravity_tilt", pitch=0.1)
    (log,) = run(pendulum, [pitch], [hold([0.0])])
    angle = 0.1 - log.q[-1, 0]  # the joint's axis is −y
    assert log.tau[-1, 0] == pytest.approx(WEIGHT * np.cos(angle), rel=1e-4)
    roll = run(pendulum, [effect("gravity_tilt", roll=0.1)], [hold([0.0])])[0]
    expected = WEIGHT * np.cos(0.1) * np.cos(roll.q[-1, 0])
    assert roll.tau[-1, 0] == pytest.approx(expected, rel=1e-4)


# Between command and torque, and encoders


def test_a_shifted_encoder_misleads_the_controller_too(pendulum):
    (log,) = run(pendulum, [effect("encoder_offset", offset=0.2)], [hold([0.5])])
    assert log.q[-1, 0] == pytest.approx(0.5, abs=0.02)
    true = log.q[-1, 0] - 0.2
    assert log.tau[-1, 0] == pytest.approx(WEIGHT * np.cos(true), rel=1e-3)


def test_late_commands_make_a_late_motion(two_links):
    (late,) = run(two_links, [effect("command_latency", k, time=0.05) for k in (0, 1)])
    prompt = plain_log()
    np.testing.assert_array_equal(late.command, prompt.command)
    np.testing.assert_allclose(late.q[50:], prompt.q[25:-25], atol=2e-4)


def test_a_softer_servo_sags_more(pendulum):
    stiff = replace(Plant(pendulum).servo, feedforward=None)
    sag = [
        run(pendulum, effects, [hold([0.0], 2.0)], servo=stiff)[0].q[-1, 0]
        for effects in ([], [effect("controller_gain", stiffness=-0.5, damping=-0.3)])
    ]
    assert sag[1] / sag[0] == pytest.approx(2.0, rel=0.02)


def test_a_servo_is_slower_than_its_drive(two_links):
    slow = [effect("actuator_lag", k, time=0.05) for k in (0, 1)]
    (log,) = run(two_links, slow)
    assert np.abs(log.q - log.command).max() < 0.1
    # The time constant of a filter in the log is no matter to the servo.
    seen = [effect("actuator_lag", k, time=-0.05) for k in (0, 1)]
    np.testing.assert_array_equal(
        Plant(two_links, seen).servo.kp, Plant(two_links).servo.kp
    )


@pytest.mark.parametrize("name", ["ur10", "panda"])  # files without rotors
def test_a_sampled_servo_damps_every_motion_of_all_joints_in_every_posture(name):
    plant, rng = Plant(public_arm(name)), np.random.default_rng(5)
    robot, period = plant.robot, 1 / plant.control_rate
    for q in rng.uniform(-np.pi, np.pi, (100, robot.size)):
        still = np.zeros((robot.size, robot.size))
        unit = np.eye(robot.size)
        at_rest = inverse_dynamics(robot, still + q, still, still)
        inertia = inverse_dynamics(robot, still + q, still, unit) - at_rest
        decay = np.linalg.eigvals(np.linalg.solve(inertia, np.diag(plant.servo.kd)))
        assert decay.real.max() * period < 1.5  # at 2 its sign alternates for ever


def test_a_drive_at_its_limit_cannot_carry_what_it_says(pendulum):
    # The log shows the command, which rises until the servo's own limit.
    weak = effect("saturation", loss=1.0, limit=0.8 * WEIGHT)
    (log,) = run(pendulum, [weak], [hold([0.0], 1.0)])
    assert log.q[-1, 0] < -0.5 and log.tau[-1, 0] > 0.9 * WEIGHT


# Noise


def test_the_encoder_rounds_to_its_steps():
    step = np.array([0.01, 0.0])
    noise = replace(Noise.none(2), position_resolution=step)
    q = np.random.default_rng(0).uniform(-1, 1, (1000, 2))
    out = noise.apply({"q": q, "v": q, "tau": q}, rate=500, rng=np.random.default_rng())
    counts = out["q"][:, 0] / 0.01
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(out["q"] - q).max() <= 0.005 + 1e-12
    np.testing.assert_array_equal(out["q"][:, 1], q[:, 1])


# References


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    duration=st.floats(1.0, 25.0),
    fill=st.floats(0.1, 1.0),
    order=st.integers(3, 8),
)
def test_a_random_motion_fills_its_limits_and_rests_at_both_ends(
    seed, duration, fill, order
):
    robot = bounded()
    x = random_fourier(
        robot, duration=duration, rate=200, seed=np.random.default_rng(seed),
        fill=fill, order=order,
    )  # fmt: skip
    low, high, fastest, strongest = limits(robot)
    middle, half = (low + high) / 2, (high - low) / 2
    room = np.abs(x.q - middle).max(axis=0) / half
    used = np.stack([
        np.ptp(x.q, axis=0) / (2 * half),
        np.abs(x.v).max(axis=0) / fastest,
        np.abs(x.a).max(axis=0) / strongest,
    ])  # fmt: skip
    assert (room <= fill + 1e-9).all() and (used <= fill + 1e-9).all()
    np.testing.assert_allclose(used.max(axis=0), fill, rtol=1e-6)
    ends = [0, -1]
    np.testing.assert_allclose(x.v[ends] / fastest, 0, atol=1e-9)
    np.testing.assert_allclose(x.a[ends] / strongest, 0, atol=1e-9)


def bounded() -> Robot:
    from hybrid.robot.chain import Chain

    chain = Chain(
        joints=("a", "b"),
        rotation=np.stack([np.eye(3)] * 2),
        translation=np.zeros((2, 3)),
        axis=np.tile([0.0, 0, 1], (2, 1)),
        revolute=np.ones(2, dtype=bool),
        inertial=np.tile([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 1], (2, 1)),
        gravity=np.array([0, 0, -9.81]),
        armature=np.zeros(2),
    )
    inf, zero = np.full(2, np.inf), np.zeros(2)
    return Robot(
        "bounded", chain, np.array([-1.0, -np.inf]), np.array([2.5, np.inf]),
        np.array([3.0, np.inf]), inf, zero, zero,
    )  # fmt: skip


def test_a_motion_is_slow_fast_and_reverses(two_links):
    (x,) = motions(two_links, duration=10.0)
    share = np.abs(x.v) / np.abs(x.v).max(axis=0)
    assert ((share < 0.2).mean(axis=0) > 0.08).all()
    assert ((share > 0.6).mean(axis=0) > 0.08).all()
    assert (np.count_nonzero(np.diff(np.sign(x.v[1:-1]), axis=0), axis=0) >= 2).all()


def test_position_speed_and_acceleration_of_a_motion_agree(two_links):
    (x,) = motions(two_links)
    dt = 1 / x.rate
    np.testing.assert_allclose(np.gradient(x.q, dt, axis=0)[1:-1], x.v[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(x.v, dt, axis=0)[1:-1], x.a[1:-1], atol=1e-2)
    q, v = x.at(x.t[3:-3] + 0.4 * dt)
    np.testing.assert_allclose(q[1:] - q[:-1], dt * (v[1:] + v[:-1]) / 2, atol=1e-5)
    _, outside = x.at(np.array([-1.0, x.t[-1] + 1]))
    np.testing.assert_array_equal(outside, 0)


# Clear refusals


class Wish(Effect):
    id: ClassVar[str] = "wish"
    port: ClassVar[Port] = Port.DRIVE
    gains: ClassVar[tuple] = ()

    def columns(self, motion, body):
        return np.zeros((len(motion.t), 1, 0))


def test_an_effect_that_no_plant_realises_is_refused(two_links):
    with pytest.raises(EffectError, match="wish cannot be simulated"):
        simulate(two_links, [Wish((0,))])
    with pytest.raises(EffectError, match="the arm has 2"):
        simulate(two_links, [effect("coulomb", 5, level=1.0)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integrator": "magic"}, "valid are euler"),
        ({"step": 1.0}, "step is 1 s"),
        ({"control_rate": 3000.0}, "control_rate is 3000 Hz"),
        ({"log_rate": 700.0}, "log_rate is 700 Hz"),
        ({"noise": Noise.none(3)}, "2 joints"),
    ],
)
def test_a_plant_refuses_what_it_cannot_be(two_links, options, message):
    with pytest.raises(HybridError, match=message):
        Plant(two_links, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trajectories": 0}, "trajectories is 0"),
        ({"fill": 2.0}, "fill is 2"),
    ],
)
def test_simulate_refuses_arguments_out_of_range(two_links, options, message):
    with pytest.raises(HybridError, match=message):
        simulate(two_links, **options)


def test_a_plant_refuses_motions_of_another_arm(two_links):
    with pytest.raises(HybridError, match="2 joints"):
        run(two_links, references=[hold([0.0])])


def test_a_diverging_simulation_stops_with_a_reason(turntable):
    mad = Servo(kp=np.zeros(1), kd=np.full(1, 1e6), limit=np.full(1, np.inf))
    with pytest.raises(HybridError, match="diverges at"):
        run(turntable, servo=mad)


# Truths

TRUTH = """
robot: arm.xml
inertial:
  - {joint: elbow, mass: 1.1, first_moment: 1.2, inertia: 0.9}
effects:
  - {effect: coulomb, joints: [elbow], values: {level: 0.5}}
noise:
  torque_std: [0.2, 0.1]
  torque_correlation: [[1, 0.5], [0.5, 1]]
  position_resolution: 1.0e-5
plant: {log_rate: 250}
"""


def truth(folder: Path, text: str = TRUTH) -> Path:
    """A file of a truth, beside the robot that it names."""
    (folder / "arm.xml").write_text(TWO_LINKS)
    (folder / "truth.yaml").write_text(text)
    return folder / "truth.yaml"


def test_a_truth_is_a_nominal_robot_and_a_plant_that_differs(tmp_path):
    path = truth(tmp_path)
    nominal, plant = load_truth(path)
    before, after = nominal.chain.inertial, plant.robot.chain.inertial
    np.testing.assert_array_equal(before[0], after[0])
    np.testing.assert_allclose(after[1, :4], before[1, :4] * [1.1, 1.2, 1.2, 1.2])
    np.testing.assert_allclose(
        plant.noise.torque_covariance, [[0.04, 0.01], [0.01, 0.01]]
    )
    assert plant.servo.feedforward is nominal
    (log,) = simulate(plant, trajectories=1, duration=1.0)
    assert len(log.t) == 251 and log.joints == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("robot: arm.xml", "", "no robot"),
        ("robot: arm.xml", "robot: none.xml", "no such robot"),
        ("inertial:", "inertia:", "unknown 'inertia'; valid are keys robot"),
        ("joint: elbow", "joint: knee", "no joint 'knee'"),
        ("mass: 1.1", "mass: -1", "above 0"),
        ("mass: 1.1", "weight: 1.1", "unknown 'weight'"),
        ("effect: coulomb", "effect: magic", "no effect 'magic'"),
        ("{level: 0.5}", "{height: 0.5}", "no parameter height"),
        ("torque_std: [0.2, 0.1]", "torque_std: [1, 2, 3]", "torque_std"),
        ("torque_std: [0.2, 0.1]", "torque_std: loud", "truth.yaml"),
        ("log_rate: 250", "rate: 250", "unknown 'rate'"),
        ("log_rate: 250", "log_rate: [", "not a readable YAML"),
    ],
)
def test_a_truth_with_a_mistake_is_refused_by_name(tmp_path, old, new, message):
    path = truth(tmp_path, TRUTH.replace(old, new))
    with pytest.raises(HybridError, match=message) as error:
        load_truth(path)
    assert "\n" not in str(error.value)
    assert isinstance(error.value, RobotError | EffectError | HybridError)


def test_a_missing_truth_is_refused(tmp_path):
    with pytest.raises(HybridError, match="not a readable YAML"):
        load_truth(tmp_path / "none.yaml")


def test_the_shipped_truth_moves_within_its_limits():
    models = Path(__file__).parents[1] / "models"
    nominal, plant = load_truth(models / "coman_truth.yaml")
    (log,) = simulate(replace(plant, step=0.001), trajectories=1, duration=2.0)
    assert log.joints == nominal.joints
    assert (np.abs(log.tau).max(axis=0) < nominal.tau_max).all()
    assert np.abs(log.q - log.command).max() < 0.05
