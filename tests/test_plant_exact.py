"""A simulated arm against equations of motion that are solved here."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from mujoco_inverse import file_inverse_dynamics
from pendulum import pendulum, swings
from scipy.integrate import solve_ivp

from hybrid.dynamics import RigidBody
from hybrid.effects import JointState
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.armature import Armature
from hybrid.effects.contact import Contact
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.elasticity import Elasticity
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.friction_lag import FrictionLag
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.spring import Spring
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.thermal_friction import ThermalFriction
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError, HybridWarning
from hybrid.plant import Noise, Plant, Reference, simulate
from hybrid.plant.arm import build_arm, inverse_dynamics
from hybrid.plant.joint_fields import (
    coupled_rows,
    curves,
    effects_of_fields,
    soft_springs,
    split_effects,
    with_curves,
)
from hybrid.plant.laws import Laws
from hybrid.plant.lockstep import Lockstep
from hybrid.plant.noise import rated_torque
from hybrid.plant.plant import _ratio
from hybrid.plant.reference import limits
from hybrid.plant.rollout import Windows, rollout
from hybrid.plant.servo import Servo
from hybrid.signals import Motion

# Of the pendulum: link with rotor [kg·m²], and weight with the rod level [N·m].
LINK, ROTOR, WEIGHT = 0.24, 0.05, 0.6 * 9.81


def started(effects, q, step=2e-4, robot=None, time=0.0):
    robot = robot or pendulum(1)
    arm = build_arm(robot, effects, step=step, integrator="euler")
    return Lockstep(arm, effects, np.array(q), time=time)


def test_an_elastic_joint_with_laws_on_either_side_moves_as_two_masses_do():
    k, d, drag, pull = 150.0, 0.4, 0.8, 20.0
    effects = [
        Elasticity((0,), {"compliance": 1 / k, "damping": d}),
        Viscous((0,), {"coefficient": drag}),
        NonlinearViscous((0,), {"quadratic": 0.3, "cubic": 0.0}),
        Spring((0,), {"stiffness": pull, "preload": 2.0}),
    ]
    for torque in (9.0, -4.0):
        state = started(effects, [[0.3], [-0.5]])
        q0 = state._datas[0].qpos.copy()
        # At the start the spring balances the weight alone.
        assert k * (q0[1]) == pytest.approx(-WEIGHT * np.sin(q0[0] + q0[1]), abs=1e-3)

        def law(t, x, torque=torque):
            motor, link, v, w = x
            twist = k * (motor - link) + d * (v - w)
            drive = torque - drag * v - 0.3 * v * abs(v) - twist
            weight = WEIGHT * np.sin(link) + pull * link + 2.0
            return v, w, drive / ROTOR, (twist - weight) / LINK

        start = [q0[0], q0[0] + q0[1], 0.0, 0.0]
        exact = solve_ivp(
            law, (0.0, 0.2), start, rtol=1e-9, atol=1e-9, dense_output=True
        )
        state.step(np.full((2, 1), torque), 500)
        motor, _, v, w = exact.sol(0.1)
        assert state.q[0, 0] == pytest.approx(motor, abs=1e-3)
        assert state.v[0, 0] == pytest.approx(v, abs=0.01)
        state.step(np.full((2, 1), torque), 500)
        motor, link, v, w = exact.sol(0.2)
        assert state.q[0, 0] == pytest.approx(motor, abs=1e-3)
        twist = k * (motor - link) + d * (v - w)
        assert state.load[0, 0] == pytest.approx(twist, abs=0.1)
        assert abs(state.q[0, 0] - 0.3) > 0.01 and state.q[0, 0] != state.q[1, 0]


def test_a_drive_that_lags_delivers_its_torque_by_and_by():
    """With gravity off, acceleration is torque over inertia."""
    time, step, arm = 0.03, 1e-3, pendulum(2)
    arm = replace(arm, chain=replace(arm.chain, gravity=np.zeros(3)))
    lag = [ActuatorLag((1,), {"time": time})]
    state = started(lag, [[0.0, 0.0]], step, arm)
    asked = np.array([[0.0, 2.0]])
    state.step(0 * asked)
    loads = []
    for _ in range(60):
        state.step(asked)
        loads.append(state.load[0, 1] + ROTOR * state.a[0, 1])
    decay = time / (time + step)
    expected = 2.0 * (1 - decay ** np.arange(1, 61))
    np.testing.assert_allclose(loads, expected, atol=1e-6)
    assert abs(state.q[0, 0]) > 1e-3  # the first joint is moved by the second only


def test_a_push_at_the_tip_is_its_force_times_its_arm():
    values = {"force_x": 3.0, "force_z": -2.0, "moment_y": 0.5, "start": 1.0}
    push = [Contact((0, 1), {**values, "duration": 0.5})]
    arm = pendulum(2)
    for time, on in ((0.9, 0.0), (1.2, 1.0), (1.6, 0.0)):
        state = started(push, [[0.4, -0.9]], 1e-3, arm, time=time)
        state.step(np.zeros((1, 2)))
        zero = np.zeros((1, 2))
        left = inverse_dynamics(arm, np.array([[0.4, -0.9]]), zero, state.a)[0]
        # The second frame is 0.6 m below the first; the wrench is what the arm exerts.
        x, z = -0.6 * np.sin(0.4), -0.6 * np.cos(0.4)
        moment = z * 3.0 - x * -2.0 + 0.5
        np.testing.assert_allclose(left, [-on * moment, -on * 0.5], atol=1e-6)


def test_a_joint_at_rest_that_is_let_go_has_the_friction_of_its_way():
    """Down is the other way than up: the level of one is not that of the other."""
    robot = replace(pendulum(1), frictionloss=np.array([3.0]))
    for q, way in ((0.9, -1.0), (-0.9, 1.0)):
        state = started([Coulomb((0,), {"level": 1.0})], [[q]], 1e-3, robot)
        state.step(np.zeros((1, 1)), 150)
        weight = WEIGHT * np.sin(abs(q))
        assert np.sign(state.v[0, 0]) == way and abs(state.v[0, 0]) > 0.05
        inertia = LINK + ROTOR
        assert abs(state.v[0, 0]) == pytest.approx(
            0.15 * (weight - 4.0) / inertia, rel=0.05
        )


def test_laws_of_one_kind_are_summed_joint_by_joint():
    rng = np.random.default_rng(0)
    effects = [
        NonlinearViscous((0,), {"quadratic": 0.5, "cubic": 0.0}),
        NonlinearViscous((2,), {"quadratic": 0.7, "cubic": 0.2}),
        NonlinearViscous((2,), {"quadratic": 0.1, "cubic": 0.0}),
        Coulomb((1,), {"level": 2.0}),
        Coulomb((2,), {"level": 3.0}), Spring((2,), {"stiffness": 4.0, "preload": 0.0}),
        Spring((0,), {"stiffness": 0.0, "preload": 5.0}),
        TorqueOffset((1,), {"level": 0.25}),
    ]  # fmt: skip
    q, v, a, load = rng.normal(size=(4, 2, 3))
    motor = JointState(0 * q, q, v, a, np.sign(v), load)
    link = replace(motor, q=q + 0.5)
    laws = Laws(effects, 2, 3)
    assert len(laws) >= 4
    for _ in range(2):  # nothing is kept
        laws.evaluate(motor, link)
    drag = v * np.abs(v) * [0.5, 0.0, 0.8] + v**3 * [0.0, 0.0, 0.2]
    np.testing.assert_allclose(laws.drive, drag + [0.0, 0.25, 0.0])
    np.testing.assert_allclose(laws.dry, np.sign(v) * [0.0, 2.0, 3.0])
    expected = (q + 0.5) * [0.0, 0.0, 4.0] + [5.0, 0.0, 0.0]
    np.testing.assert_allclose(laws.link, expected)


def test_a_law_that_is_infinite_where_no_joint_has_it_does_nothing_there(monkeypatch):
    def law(state, **_):
        infinite = np.full(2, np.inf)
        return [np.divide(1.0, state.q, out=infinite, where=state.q != 0), state.q]

    monkeypatch.setattr(Spring, "law", staticmethod(law))
    spring = Spring((1,), {"stiffness": 3.0, "preload": 0.0})
    q = np.array([0.0, 2.0])
    state = JointState(*[q] * 6)
    laws = Laws([spring], 1, 2)
    laws.evaluate(state, state)
    assert laws.link.tolist() == [[0.0, 1.5]]


@pytest.mark.parametrize("effects", [[], [Viscous((0,), {"coefficient": 0.8})]])
def test_physics_steps_of_a_held_torque_are_those_of_as_many_calls(effects):
    torque, start = np.array([[3.0], [-5.0]]), [[0.4], [-0.9]]
    together, apart = (started(effects, start) for _ in "ab")
    for substeps in (4, 3):
        together.step(torque, substeps)
        for _ in range(substeps):
            apart.step(torque)
        for name in ("q", "v", "a", "load"):
            one, other = getattr(together, name), getattr(apart, name)
            np.testing.assert_array_equal(one, other)


def test_a_simulation_that_runs_away_names_its_time():
    state = started([], [[0.0]], 1e-3, time=2.0)
    with pytest.raises(HybridError, match=r"diverges at 2\.0\d\d s"):
        state.step(np.array([[4e4]]), 60)


# --- replays --------------------------------------------------------------------------


WINDOWS = Windows(np.array([0, 1, 1]), np.array([0, 50, 130]), 15)


@pytest.mark.parametrize(
    "effects",
    [
        [],
        [Viscous((1,), {"coefficient": 0.9}), Coulomb((0,), {"level": 0.5})],
        [TorqueGain((0,), {"gain": 0.3})],
        [TorqueGain((1,), {"gain": -0.2}), Delay((0,), {"time": 0.004})],
        [EncoderOffset((1,), {"offset": 0.15})],
    ],
)
def test_a_replay_under_the_torque_of_a_motion_is_that_motion(effects):
    robot, logs = pendulum(2), []
    drag, level = np.zeros(2), np.zeros(2)
    for e in effects:
        drag[e.joints] += e.values.get("coefficient", 0.0)
        level[e.joints] += e.values.get("level", 0.0)
    for m in swings(2, count=2, seconds=2.0, widest=0.3):
        tau = m.tau + drag * m.v + level * np.tanh(m.v / 1e-3)
        q = m.q.copy()
        for e in effects:
            j = list(e.joints)
            if e.reports:
                tau[:, j] = e.report(m.t, tau[:, j])
            q[:, j] += e.values.get("offset", 0.0)
        logs.append(replace(m, q=q, tau=tau))
    found = rollout(robot, effects, logs, WINDOWS, step=0.002)
    assert found.shape == (16, 3, 2)
    for b, (m, k) in enumerate(zip(WINDOWS.motion, WINDOWS.sample, strict=True)):
        np.testing.assert_array_equal(found[0, b], logs[m].q[k])
        moved = np.ptp(logs[m].q[k : k + 16], axis=0)
        off = np.abs(found[:, b] - logs[m].q[k : k + 16]).max(axis=0)
        assert (off < 0.02 * moved + 1e-3).all(), off


@pytest.mark.parametrize(
    "friction",
    [
        ThermalFriction((1,), {"cold": 3.0, "time_constant": 50.0, "warm_up": 0.3}),
        FrictionLag((1,), {"coefficient": 3.0, "time": 0.4}),
    ],
)
def test_a_replay_that_starts_late_remembers_as_much_as_the_arm(friction):
    robot, logs = pendulum(2), []
    for m in swings(2, count=2, seconds=2.0, widest=0.3):
        tau = m.tau.copy()
        tau[:, [1]] += friction.torque(m, RigidBody(robot.chain, m))
        logs.append(replace(m, tau=tau))
    found = rollout(robot, [friction], logs, WINDOWS, step=0.002)
    for b, (m, k) in enumerate(zip(WINDOWS.motion, WINDOWS.sample, strict=True)):
        moved = np.ptp(logs[m].q[k : k + 16], axis=0)
        off = np.abs(found[:, b] - logs[m].q[k : k + 16]).max(axis=0)
        assert (off < 0.02 * moved + 1e-3).all(), off


def test_heat_stays_when_the_clock_does_not_run_on():
    gear = ThermalFriction((0,), {"cold": 6.0, "warm_up": 0.05})
    laws, one = Laws([gear], 1, 1), np.ones((1, 1))
    state = JointState(0 * one, one, one, one, one, one)
    heats = []
    for step in (np.inf, 0.1, 0.0, -0.1, 0.1):
        laws.evaluate(state, state, step)
        heats.append(laws.remembered[0][0].item())
    np.testing.assert_allclose(heats, [0.0, 2.0, 2.0, 2.0, 4.0])


@pytest.mark.parametrize(
    ("values", "pushed"),
    [
        ({"start": 0.0}, [True, False, False]),
        ({"start": 0.5}, [False, True, False]),
        ({"start": 0.5, "recording": 4}, [False] * 3),
        ({"start": 1.3, "recording": 5}, [False, False, True]),
        ({"start": 0.0, "recording": 5}, [False] * 3),
    ],
)
def test_a_replay_is_pushed_at_its_own_time_and_in_its_own_recording(values, pushed):
    logs = swings(1, count=2, seconds=2.0, widest=0.3)
    logs = [replace(m, number=4 + k) for k, m in enumerate(logs)]
    push = Contact((0,), {"moment_y": 5.0, "duration": 0.1} | values)
    with_it, without = (
        rollout(pendulum(1), effects, logs, WINDOWS, step=0.002)
        for effects in ([push], [])
    )
    moved = np.abs(with_it - without).max(axis=(0, 2)) > 1e-4
    np.testing.assert_array_equal(moved, pushed)


def test_a_replay_that_runs_away_ends_and_others_go_on():
    robot, (m,) = pendulum(1), swings(1, count=1, seconds=1.0)
    wild = replace(m, tau=m.tau + 2e4)
    both = Windows(np.array([0, 1]), np.array([3, 3]), 10)
    found = rollout(robot, [], [m, wild], both, step=0.005)
    assert np.isnan(found[-1, 1, 0]) and np.isfinite(found[0, 1, 0])
    alone = rollout(
        robot, [], [m], Windows(np.array([0]), np.array([3]), 10), step=0.005
    )
    np.testing.assert_allclose(found[:, 0], alone[:, 0])


def test_a_replay_of_an_elastic_arm_at_rest_stays_at_rest():
    robot, t = pendulum(1), np.arange(0.0, 1.0, 0.01)
    spring = Elasticity((0,), {"compliance": 0.01, "damping": 0.2})
    state = started([spring], [[0.7]])
    twist = float(state._datas[0].qpos[1])
    q = np.full((100, 1), 0.7)
    tau = np.full((100, 1), WEIGHT * np.sin(0.7 + twist))
    log = Motion(t, q, 0 * q, 0 * q, tau, np.ones(100, dtype=bool), joints=robot.joints)
    one = Windows(np.array([0]), np.array([90]), 8)
    found = rollout(robot, [spring], [log], one)
    np.testing.assert_allclose(found[:, 0, 0], 0.7, atol=5e-4)


# --- servo, noise, references ---------------------------------------------------------


@pytest.mark.parametrize(
    ("rated", "period", "lag", "kp", "kd"),
    [
        # 8 Hz at the inertia of rotor and link
        (60.0, 1e-3, 0.0, (16 * np.pi) ** 2 * 0.29, 2 * 16 * np.pi * 0.29),
        # as stiff as 5 % of the rated torque in 0.02 rad
        (1e3, 1e-3, 0.0, 2500.0, 2 * np.sqrt(2500 * 0.29)),
        # no faster than the drive, and as stiff as that
        (60.0, 1e-3, 0.05, 150.0, 2 * 20 * 0.375),
        (10.0, 1e-3, 0.05, 20.0**2 * 0.29, 2 * 20 * 0.29),
        # no more damping than half of what a sampled servo bears
        (60.0, 0.02, 0.0, 16 * np.pi * 0.29 / 0.04, 0.29 / 0.02),
        (3e3, 0.01, 0.0, 16 * np.pi * 0.29 / 0.02, 0.29 / 0.01),
    ],
)
def test_a_servo_is_tuned_to_inertia_friction_lag_and_period(
    rated, period, lag, kp, kd
):
    robot = replace(pendulum(1), tau_max=np.array([rated]))
    arm = build_arm(robot, [], step=1e-3, integrator="euler")
    servo = Servo.tuned(arm, robot, period=period, lag=np.array([lag]))
    assert servo.kp == pytest.approx([kp]) and servo.kd == pytest.approx([kd])
    assert servo.limit == pytest.approx([rated]) and servo.feedforward is robot


def test_a_servo_of_two_joints_is_tuned_to_the_stretched_arm():
    robot = replace(pendulum(2), tau_max=np.array([6.0, 3.0]))
    arm = build_arm(robot, [], step=1e-3, integrator="euler")
    servo = Servo.tuned(arm, robot, period=1e-3, lag=np.zeros(2))
    stretched = LINK + (LINK + 2 * 0.6**2 + 2 * 0.6 * 0.6) + ROTOR
    inertia = servo.kd / (2 * 16 * np.pi)
    assert 0.9 * stretched < inertia[0] <= stretched
    assert inertia[1] == pytest.approx(LINK + ROTOR)
    np.testing.assert_allclose(servo.kp, (16 * np.pi) ** 2 * inertia)


def test_a_plan_is_the_reference_and_the_torque_of_the_known_arm():
    t = np.linspace(0.0, 1.0, 101)
    q, v, a = np.sin(t)[:, None], np.cos(t)[:, None], -np.sin(t)[:, None]
    reference = Reference(t, q, v, a)
    assert reference.rate == pytest.approx(100.0)
    servo = Servo(np.ones(1), np.ones(1), np.ones(1), pendulum(1))
    at = np.array([-0.5, 0.123, 0.8, 1.5])
    place, speed, torque = servo.plan(reference, at)
    np.testing.assert_allclose(place[:, 0], np.sin([0.0, 0.123, 0.8, 1.0]), atol=1e-8)
    np.testing.assert_allclose(
        speed[:, 0], [0, np.cos(0.123), np.cos(0.8), 0], atol=1e-6
    )
    inside = place[:, 0]
    expected = -(LINK + ROTOR) * inside + WEIGHT * np.sin(inside)
    np.testing.assert_allclose(torque[:, 0], expected, atol=1e-3)
    _, _, none = replace(servo, feedforward=None).plan(reference, at)
    assert none.shape == (4, 1) and not none.any()


def hold(q, duration=0.3):
    t, one = np.linspace(0.0, duration, 11), np.ones((11, len(q)))
    return Reference(t, one * q, 0 * one, 0 * one)


def test_a_drive_at_its_limit_is_told_with_its_share_of_the_time():
    """Of two motions one hangs at rest, and the other falls."""
    robot = replace(pendulum(1), tau_max=np.array([2.0]))
    servo = Servo(np.array([400.0]), np.array([20.0]), np.array([2.0]))
    plant = Plant(robot, noise=Noise.none(1), servo=servo)
    with pytest.warns(HybridWarning, match="for 50% of the time"):
        falling, hanging = plant.run([hold([1.3]), hold([0.0], 0.2)])
    assert len(falling.t) == 151 and len(hanging.t) == 101
    np.testing.assert_allclose(falling.tau, 2.0)
    np.testing.assert_allclose(hanging.q, 0.0, atol=1e-6)
    assert falling.command == pytest.approx(np.full((151, 1), 1.3))
    assert hanging.source.endswith("pendulum, trajectory 2")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plant.run([hold([0.0], 0.1)])


def test_a_plant_has_its_own_effects_noise_and_rate():
    plant = Plant(pendulum(1), noise=Noise.none(1))
    for more in (
        {"effects": [Viscous((0,), {"coefficient": 1.0})]},
        {"noise": Noise.none(1)},
        {"log_rate": 100.0},
    ):
        with pytest.raises(HybridError, match="its own effects, noise and rates"):
            simulate(plant, trajectories=1, duration=2.0, **more)


def test_usual_noise_is_half_a_percent_of_the_rating_and_shared_by_neighbours():
    robot = replace(pendulum(3), tau_max=np.array([100.0, 60.0, 20.0]))
    noise = Noise.typical(robot)
    std = np.array([0.5, 0.3, 0.1])
    shared = np.array([[1, 0.4, 0.16], [0.4, 1, 0.4], [0.16, 0.4, 1]])
    np.testing.assert_allclose(noise.torque_covariance, np.outer(std, std) * shared)
    np.testing.assert_allclose(noise.position_resolution, 2 * np.pi / 2**19)
    np.testing.assert_allclose(noise.speed_std, 1e-3)
    assert not noise.position_std.any() and noise.correlation_time == 0.002


def test_a_missing_rating_is_twice_the_weight():
    bare = replace(pendulum(2), tau_max=np.array([np.inf, 5.0]))
    found = rated_torque(bare)
    most = 2 * (2 * 9.81 * (0.3 + 0.6 + 0.3))
    assert 0.8 * most < found[0] <= most and found[1] == 5.0
    light = replace(pendulum(1), tau_max=np.array([np.inf]))
    light = replace(light, chain=replace(light.chain, gravity=np.zeros(3)))
    assert rated_torque(light) == pytest.approx([1.0])


def test_missing_limits_lie_beside_those_that_a_file_has():
    inf = np.inf
    robot = replace(
        pendulum(4), q_min=np.array([-inf, -1.0, -inf, 5.0]),
        q_max=np.array([inf, inf, -4.0, inf]), v_max=np.array([inf, 1.0, 2.5, inf]),
        a_max=np.array([inf, 4.0, inf, 6.0]),
    )  # fmt: skip
    low, high, v_max, a_max = limits(robot)
    np.testing.assert_allclose(low, [-np.pi, -1.0, -4.0 - np.pi, 5.0])
    np.testing.assert_allclose(high, [np.pi, np.pi, -4.0, 5.0 + np.pi])
    np.testing.assert_allclose(v_max, [2.0, 1.0, 2.5, 2.0])
    np.testing.assert_allclose(a_max, [10.0, 4.0, 10.0, 6.0])


# --- fields of joints -----------------------------------------------------------------


def along(effects, q, v, a):
    """Sum of the laws at one joint, (N,)."""
    state = JointState(0 * q, q, v, a, np.sign(v), 0 * q)
    total = np.zeros_like(q)
    for e in effects:
        shapes = {s.name: e.values[s.name] for s in e.shapes}
        terms = e.law(state, **shapes)
        total += sum(g * x for g, x in zip(e.gain_values, terms, strict=True))
    return total


@pytest.mark.parametrize("seed", range(4))
def test_fields_and_what_is_left_make_the_torque_of_all_effects(seed):
    rng = np.random.default_rng(seed)
    c, d, level, stiff, rotor = rng.uniform(-0.3, 1.0, 5)
    effects = [
        Viscous((1,), {"coefficient": c}), Viscous((1,), {"coefficient": 0.2}),
        NonlinearViscous((1,), {"quadratic": rng.uniform(-1, 1), "cubic": d}),
        Coulomb((1,), {"level": level}), Armature((1,), {"inertia": rotor}),
        Spring((1,), {"stiffness": stiff, "preload": rng.normal()}),
        Stribeck((1,), {"level": 0.4, "velocity": 0.1, "exponent": 2.0}),
    ]  # fmt: skip
    fields = ("armature", "damping", "quadratic", "cubic", "frictionloss")
    fields += ("stiffness", "preload")
    values, rest = split_effects(effects, fields, 2)
    q, v, a = rng.normal(size=(3, 50))
    own = {name: x[1] for name, x in values.items()}
    assert all(x[0] == 0.0 for x in values.values())
    torque = (
        own["armature"] * a + own["damping"] * v + own["quadratic"] * v * np.abs(v)
        + own["cubic"] * v**3 + own["frictionloss"] * np.sign(v)
        + own["stiffness"] * q + own["preload"]
    )  # fmt: skip
    np.testing.assert_allclose(
        torque + along(rest, q, v, a), along(effects, q, v, a), atol=1e-12
    )
    for name in set(fields) - {"preload", "quadratic"}:
        assert own[name] >= 0.0
    speed = np.linspace(0.0, 5.0, 400)
    slope = own["damping"] + own["quadratic"] * speed + own["cubic"] * speed**2
    assert slope.min() > -1e-9
    again = list(effects_of_fields({k: x for k, x in values.items() if k != "preload"}))
    np.testing.assert_allclose(
        along(again, q, v, a), torque - own["preload"], atol=1e-12
    )


def test_curves_of_a_file_are_friction_of_its_joints():
    robot = replace(
        pendulum(3), knee=np.array([0.0, 2.0, 0.0]), knee_speed=np.array([0, 0.5, 0.0]),
        ripple=np.array([[2, 0.3, -0.4, 7.0]]), falling=np.array([[0, 0.6, 0.2]]),
    )  # fmt: skip
    q, v = np.linspace(-1, 1, 9), np.linspace(-1.5, 1.5, 9)
    knee, ripple, fall = curves(robot)
    assert (knee.joints, ripple.joints, fall.joints) == ((1,), (2,), (0,))
    np.testing.assert_allclose(along([knee], q, v, v), 2.0 * np.clip(v / 0.5, -1, 1))
    wave = 0.3 * np.sin(7 * q) - 0.4 * np.cos(7 * q)
    np.testing.assert_allclose(along([ripple], q, v, v), wave, atol=1e-12)
    fallen = 0.6 * np.exp(-((v / 0.2) ** 2)) * np.sign(v)
    np.testing.assert_allclose(along([fall], q, v, v), fallen, atol=1e-12)
    own, rest = with_curves(robot, [fall], True)
    assert rest == [] and own.falling.tolist() == [[0, 0.6, 0.2]]
    np.testing.assert_array_equal(own.knee, robot.knee)
    own, rest = with_curves(robot, [fall], False)
    assert [e.joints for e in rest] == [(0,), (1,)] and not own.knee.any()
    assert own.falling.shape == (0, 3)
    # Beside other friction of its joint a curve is fitted with that.
    for other, left in ((0, [(0,), (0,)]), (1, [(1,), (1,)]), (2, [(2,)])):
        odd = Stribeck((other,), {"level": 0.1, "velocity": 0.1, "exponent": 1.0})
        own, rest = with_curves(robot, [fall, odd], True)
        assert sorted(e.joints for e in rest) == left
        assert len(own.falling) == (other != 0) and own.knee[1] == 2.0 * (other != 1)


def test_couplings_are_summed_by_pairs_and_none_is_negative():
    names = ("inertia", "viscous", "coulomb")

    def coupling(pair, *gains):
        return TransmissionCoupling(pair, dict(zip(names, gains, strict=True)))

    rows, rest = coupled_rows([
        coupling((0, 1), 0.2, 0.3, 0.1), coupling((1, 0), 0.1, -0.5, 0.0),
        coupling((1, 2), -0.1, -0.2, -0.3),
    ])  # fmt: skip
    np.testing.assert_allclose(rows, [[0, 1, 0.3, 0.0, 0.1]])
    assert [(e.joints, list(np.round(e.gain_values, 9))) for e in rest] == [
        ((0, 1), [0.0, -0.2, 0.0]), ((1, 2), [-0.1, -0.2, -0.3]),
    ]  # fmt: skip
    assert coupled_rows([])[0].shape == (0, 5)


def test_a_preload_is_a_spring_that_relaxes_elsewhere():
    values = {
        "stiffness": np.array([0.0, 2.0, 0.0]),
        "preload": np.array([0, 3.0, 4.0]),
    }
    stiffness, relaxed = soft_springs(values["stiffness"], values["preload"])
    np.testing.assert_allclose(stiffness, [0.0, 2.0, 1e-9])
    np.testing.assert_allclose(-stiffness * relaxed, values["preload"])


FILE = """<mujoco><compiler angle="radian"/><worldbody><body name="l">
<joint name="a" axis="0 1 0" armature=".05" damping=".4" frictionloss=".3"
 range="-.1 .1" limited="true"/>
<inertial pos="0 0 -.3" mass="2" diaginertia=".06 .06 .01"/></body>
<body name="m"><joint name="other" axis="0 1 0"/>
<inertial pos="0 0 -.3" mass="2" diaginertia=".06 .06 .01"/></body></worldbody>
<actuator><dcmotor joint="a" input="none" motorconst="0" resistance="1"
 lugre="1e4 0 0.5 0.9 0.2"/></actuator></mujoco>"""


def test_inverse_dynamics_of_a_file_has_all_its_friction_in_steady_sliding(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(FILE)
    (m,) = swings(1, count=1, seconds=1.0)
    found = file_inverse_dynamics(path, ["a"], m, {"other": 0.4})
    q, v, a = m.q, m.v, m.a
    level = 0.5 + 0.4 * np.exp(-((v / 0.2) ** 2))
    expected = (LINK + ROTOR) * a + WEIGHT * np.sin(q) + 0.4 * v
    expected += (0.3 + level) * np.sign(v)
    fast = np.abs(v[:, 0]) > 0.05
    np.testing.assert_allclose(found[fast], expected[fast], atol=1e-3)


@pytest.mark.parametrize("step", [-0.001, 0.0, 9e-7, 0.011])
def test_a_step_is_from_a_microsecond_to_ten_milliseconds(step):
    with pytest.raises(HybridError, match="valid is 1e-6 to 0.01 s"):
        build_arm(pendulum(1), [], step=step, integrator="euler")
    for valid in (1e-6, 0.01):
        arm = build_arm(pendulum(1), [], step=valid, integrator="euler")
        assert arm.model.opt.timestep == valid


def test_a_rate_divides_another_however_slow_it_is():
    for slower in (0.5, 1.0, 2.0, 10.0):
        _ratio("log_rate", 10.0, slower)
    for slower in (0.0, -10.0, 0.3, 20.0):
        with pytest.raises(HybridError, match=f"log_rate is {slower:g} Hz, 10 Hz div"):
            _ratio("log_rate", 10.0, slower)


def test_a_simulation_starts_at_time_zero_unless_told():
    arm = build_arm(pendulum(1), [], step=0.001, integrator="euler")
    for options, start in (({}, 0.0), ({"time": 3.0}, 3.0)):
        made = Lockstep(arm, [], np.zeros((2, 1)), **options)
        assert [data.time for data in made._datas] == [start] * 2


def test_a_joint_goes_the_way_of_its_speed_or_at_rest_of_its_net_torque():
    state = started([], [[0.0]] * 5)
    state.v = np.array([[1.0], [-0.1], [0.0], [0.0], [0.0]])
    state._net_torque = np.array([[-5.0], [5.0], [-5.0], [5.0], [0.0]])
    motor, link = state._states()
    assert motor is link and motor.sign[:, 0].tolist() == [1.0, -1.0, -1.0, 1.0, 1.0]
