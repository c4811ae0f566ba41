"""Parts of the fit of servos, each against a formula or a law worked out here."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arms import planar_of_xacro
from pendulum import pendulum

from hybrid.dynamics import inverse_dynamics
from hybrid.errors import HybridError, HybridWarning, RecordingError, RobotError
from hybrid.recording import Recording
from hybrid.report.servo import gap_table, servos_table, write_servo_page
from hybrid.robot import Robot
from hybrid.servo.drive import NAMES, QUANTITIES, Drive
from hybrid.servo.fit import _clips, _notes, _problem, _result, _unsaid, fit_servo
from hybrid.servo.model import (
    bristles,
    dampings,
    declared_spec,
    install,
    servo_spec,
    springs,
    stops,
)
from hybrid.servo.moves import probed
from hybrid.servo.noise import Noise, inexactness, resolution, usual_error
from hybrid.servo.problem import Estimate, Problem
from hybrid.servo.servo_fit import ServoFinding, ServoFit, ServoReplay
from hybrid.servo.simulator import ServoSimulator, converged, missed
from hybrid.servo.start import best_start, first_guess
from hybrid.servo.stretch import Stretch, chosen, stretches_of
from hybrid.servo.write import write_servos

ROBOT = replace(
    pendulum(2), kp=np.array([25.0, 20.0]), kd=np.array([0.6, 0.4]),
    damping=np.array([0.4, 0.3]), frictionloss=np.array([0.3, 0.2]),
    stiffness=np.array([0.0, 3.0]), springref=np.array([0.0, 0.4]),
    tau_max=np.array([60.0, 30.0]),
)  # fmt: skip
FILE = Drive.declared(ROBOT)
STEP = 0.02


# --- noise ----------------------------------------------------------------------------


def memory(parts) -> float:
    """Sokal's integrated autocorrelation of stretches of one joint, by plain sums."""
    size = max(map(len, parts))
    sums = [
        sum(float(x[k:] @ x[: max(len(x) - k, 0)]) for x in parts) for k in range(size)
    ]
    tau = [1.0 + 2.0 * sum(sums[1 : k + 1]) / sums[0] for k in range(1, size)]
    windows = [x for k, x in enumerate(tau, 1) if k > 5.0 * x]
    return max(1.0, windows[0] if windows else max(tau))


def coloured(phi: float, size: int, seed: int) -> np.ndarray:
    x, shocks = np.zeros(size), np.random.default_rng(seed).normal(size=size)
    for k in range(1, size):
        x[k] = phi * x[k - 1] + shocks[k]
    return x


def test_correlated_errors_count_as_fewer():
    """An alternating error counts as often as a white one, one that drifts as once."""
    sizes = (300, 211)
    laws = [
        lambda k, n: 1e-3 * coloured(0.8, n, k),
        lambda k, n: (-1.0) ** np.arange(n),
    ]
    laws += [lambda k, n: 0.2 + 1e-3 * np.arange(n), lambda k, n: np.zeros(n)]
    parts = [np.stack([law(k, n) for law in laws], axis=1) for k, n in enumerate(sizes)]
    floor, inexact = np.array([1e-4, 1e-4, 1e-4, 0.5]), np.array([0.0, 0.1, 0.0, 2.0])
    usual = np.append(usual_error(np.concatenate(parts))[:3], 0.5)
    count = [
        memory([np.clip(x[:, j], -3 * usual[j], 3 * usual[j]) for x in parts])
        for j in range(3)
    ]
    assert count[0] > 5.0 and count[1] == 1.0 and count[2] > 100.0
    found = Noise.of(parts, floor, inexact)
    expected = 1.0 / (usual**2 * np.array([*count, 1.0]) + inexact)
    np.testing.assert_allclose(found.weight, expected, rtol=1e-9)
    np.testing.assert_allclose(found.far, 3.0 * usual)
    raised = Noise.of(parts, 0.5 + 0 * floor, inexact)
    np.testing.assert_allclose(raised.far[0], 1.5)
    np.testing.assert_allclose(raised.weight[0], 1.0 / (0.25 * count[0]), rtol=1e-9)


def test_an_outlier_counts_as_three_usual_errors():
    """u² = (999 + 9 u²)/1000, however far the outlier."""
    errors = np.ones((1000, 2))
    errors[7] = 100.0, -30.0
    np.testing.assert_allclose(usual_error(errors), np.sqrt(999 / 991), rtol=1e-7)


def test_laws_are_wrong_by_a_part_of_the_servo_s_error_and_clocks_by_a_millisecond():
    t = STEP * np.arange(400)
    parts = []
    for phase in (0.0, 1.0):
        q = np.stack([np.sin(3 * t + phase), 0.3 * np.cos(5 * t + phase)], axis=1)
        lag = np.stack([0.1 * np.cos(2 * t) + 0.2, coloured(0.5, 400, 3)], axis=1)
        parts.append(Stretch(STEP, q + lag, q, np.zeros(2)))
    found = inexactness(parts)
    for j in range(2):
        error = [x.command[:, j] - x.q[:, j] for x in parts]
        law = [0.03 * (x - np.concatenate(error).mean()) for x in error]
        clock = [1e-3 * np.gradient(x.q[:, j], STEP) for x in parts]
        both = (np.concatenate(x).var() * memory(x) for x in (law, clock))
        assert found[j] == pytest.approx(sum(both), rel=1e-9)


def test_rounding_of_numbers_is_no_step_of_an_encoder():
    rng, tick = np.random.default_rng(0), 2e-3
    q = tick * rng.integers(-100, 100, (300, 3)) + 1e-9 * rng.normal(size=(300, 3))
    q[:, 2] = 0.5
    q[:, 1] *= 3.0
    parts = [Stretch(STEP, x, x, np.zeros(3)) for x in (q[:150], q[150:])]
    expected = np.array([tick, 3 * tick, 0.0]) / np.sqrt(12.0)
    np.testing.assert_allclose(resolution(parts), expected, rtol=1e-4)


# --- stretches ------------------------------------------------------------------------


def test_a_part_knows_ten_seconds_of_earlier_commands():
    command = np.arange(2000.0)[:, None]
    whole = Stretch(STEP, command, -command, np.array([7.0]), "log")
    assert whole.duration == pytest.approx(1999 * STEP)
    first = whole.cut(0, 100)
    assert first.v == [7.0] and len(first.sent) == 100
    late = whole.cut(900, 100)
    assert (late.source, late.duration) == ("log", pytest.approx(99 * STEP))
    np.testing.assert_array_equal(late.sent[:, 0], np.arange(400.0, 1000.0))
    again = late.cut(50, 20)
    np.testing.assert_array_equal(again.sent[:, 0], np.arange(450.0, 970.0))
    np.testing.assert_array_equal(again.q[:, 0], -np.arange(950.0, 970.0))
    np.testing.assert_allclose(again.v, [-1.0 / STEP])


def test_a_log_starts_at_its_speed_and_stretches_of_two_seconds_count():
    t = STEP * np.arange(301)
    q = np.stack([0.5 * t, np.sin(t)], axis=1)
    log = Recording(t, q, command=q + 0.1, joints=("a", "b"), source="log")
    (found,) = stretches_of([log])
    assert (found.step, found.source) == (pytest.approx(STEP), "log")
    np.testing.assert_allclose(found.q, q[2:], atol=1e-9)
    np.testing.assert_allclose(found.command, q[2:] + 0.1, atol=1e-9)
    np.testing.assert_allclose(found.sent, q + 0.1, atol=1e-9)
    np.testing.assert_allclose(found.v, [0.5, np.cos(t[2])], atol=1e-3)
    rest = replace(log, q=np.where(t[:, None] < 0.1, q[0], q), command=q)
    (still,) = stretches_of([rest])
    assert len(still.q) == 301 and (still.v == 0.0).all()
    held = np.r_[0:201, 230:300]  # 4 s, a hole, and 1.4 s
    holed = replace(log, t=t[held], q=q[held], command=q[held])
    with pytest.warns(HybridWarning, match="taken as 2 recordings"):
        (long,) = stretches_of([holed])
    assert long.duration == pytest.approx(198 * STEP)


def test_parts_are_those_of_most_motion_of_every_log_in_turn():
    """Each joint's motion is compared with its own range; the root favours both."""
    t = STEP * np.arange(500)
    logs = []
    for name, sizes in (("a", (3.0, 1.0)), ("b", (1.5, 2.5))):
        pace = np.where(t < 5.0, *sizes)
        q = np.sin(np.cumsum(pace) * STEP)[:, None] * [1.0, 0.01]
        logs.append(Stretch(STEP, q, q, np.zeros(2), name))

    def names(seconds):
        parts = chosen(logs, seconds, 5.0)
        first = [x.q[0, 0] == 0.0 or len(x.sent) == len(x.q) for x in parts]
        return [(x.source, bool(k)) for x, k in zip(parts, first, strict=True)]

    assert names(1.0) == [("a", True)]
    assert names(10.0) == [("a", True), ("b", False)]
    assert names(20.0) == [("a", True), ("b", False), ("b", True), ("a", False)]
    (short,) = chosen([logs[0].cut(0, 100)], 5.0, 5.0)
    assert len(short.q) == 100


# --- the model ------------------------------------------------------------------------


def torques(robot, drive, q, v, z, goal):
    """Torque of drive, friction, damping and springs at a joint, and bristles' pace.

    As the module of the drive states them, without inertia and weight.
    """
    share = robot.kd / (robot.kd + robot.damping)
    servo, joint = share * drive["damping"], (1 - share) * drive["damping"]
    asked = drive["stiffness"] * (goal - q) - servo * v
    motor = np.clip(asked, -drive["stall"], drive["stall"])
    sigma = drive["coulomb"] / drive["presliding"]
    level = drive["coulomb"] + drive["stiction"] * np.exp(
        -((v / drive["stribeck_speed"]) ** 2)
    )
    pace = v - sigma * np.abs(v) * z / level
    friction = sigma * z + np.sqrt(sigma * drive["armature"]) * pace
    declared = robot.stiffness * (q - robot.springref) + drive["spring"] * (
        q - robot.springref
    )
    return motor - joint * v - friction - declared + drive["offset"]


def test_a_servo_s_torque_is_that_of_its_law():
    rng = np.random.default_rng(0)
    drive = FILE.at(
        damping=[1.5, 0.9], stiction=[0.2, 0.1], stribeck_speed=[0.3, 0.2],
        presliding=[2e-3, 1e-3], offset=[0.7, -0.4], spring=[0.0, 2.0],
        armature=[0.06, 0.04], stall=[12.0, 9.0], stiffness=[30.0, 22.0],
    )  # fmt: skip
    model = servo_spec(ROBOT, FILE).compile()
    install(model, ROBOT, drive, mujoco.MjData(model))
    model.opt.timestep = 1e-7  # the bristles have no time to move
    data = mujoco.MjData(model)
    limited = 0
    for _ in range(20):
        q, v, goal = rng.uniform(-0.8, 0.8, (3, 2))
        z = 1e-3 * rng.uniform(-1, 1, 2)
        data.qpos[:], data.qvel[:], data.act[:], data.ctrl[:] = q, v, z, goal
        mujoco.mj_forward(model, data)
        found = data.qfrc_actuator + data.qfrc_passive
        expected = torques(ROBOT, drive, q, v, z, goal)
        # The softest spring there is holds the offset of the first joint.
        np.testing.assert_allclose(found, expected, atol=2e-4)
        limited += (np.abs(drive["stiffness"] * (goal - q)) > drive["stall"]).sum()
    assert limited > 3
    np.testing.assert_allclose(model.dof_armature, drive["armature"])
    assert not model.dof_frictionloss.any() and not model.actuator_forcelimited.any()


def test_servos_of_the_file_are_position_servos_with_its_numbers():
    half = replace(ROBOT, kd=np.array([0.6, np.nan]), q_min=np.array([-1.0, -np.inf]))
    model = declared_spec(half).compile()
    data = mujoco.MjData(model)
    for goal, q, v in (
        ([0.4, -0.3], [0.1, 0.2], [0.5, -0.7]),
        ([9.0, -9.0], [0, 0], 0),
    ):
        data.ctrl[:], data.qpos[:], data.qvel[:] = goal, q, v
        mujoco.mj_forward(model, data)
        asked = half.kp * (np.array(goal) - q) - [0.6, 0.0] * np.ones(2) * v
        limited = np.clip(asked, -half.tau_max, half.tau_max)
        np.testing.assert_allclose(data.qfrc_actuator, limited, atol=1e-12)
    assert model.jnt_limited.all()
    np.testing.assert_allclose(model.jnt_range, [[-1.0, 2.0], [-100.0, 2.0]])


def test_stops_and_springs_stay_where_they_are_when_the_log_counts_otherwise():
    drive = FILE.at(
        lower=[-0.5, -1.0], upper=[1.5, 0.3], zero=[0.1, -0.2], sign=[1.0, -1.0]
    )
    np.testing.assert_allclose(stops(drive), [[-0.6, 1.4], [-0.1, 1.2]])
    stiffness, relaxed = springs(ROBOT, drive.at(offset=[0.0, 0.6], spring=[1.0, 0.0]))
    np.testing.assert_allclose(stiffness, [1.000001, 3.0])
    np.testing.assert_allclose(relaxed, [-0.1, -0.4 + 0.2 + 0.6 / 3.0], atol=1e-12)
    servo, joint = dampings(replace(ROBOT, kd=np.array([0.6, np.nan])), FILE)
    np.testing.assert_allclose(servo, [0.6, 0.0])
    np.testing.assert_allclose(joint, [0.4, FILE["damping"][1]])


def test_bristles_of_a_slow_joint_hold_it_and_those_of_a_fast_one_slide():
    drive = FILE.at(stiction=[0.2, 0.1], dead_band=[0.01, 0.0])
    k, sigma, weight = drive["stiffness"], drive.bristle, np.array([0.3, -0.1])

    def bend(goal, v, stall=drive["stall"]):
        start = Stretch(STEP, np.zeros((2, 2)), np.full((2, 2), 0.2), np.array(v))
        return bristles(drive.at(stall=stall), start, np.array(goal), weight) * sigma

    rest = [k[0] * 0.005 - 0.3, k[1] * -0.01 + 0.1]
    np.testing.assert_allclose(bend([0.215, 0.19], [0.04, -0.04]), rest)
    held = [0.5, -0.3]  # no more than coulomb and stiction
    np.testing.assert_allclose(bend([1.2, -0.8], [0.0, 0.0]), held)
    weak = [0.1 - 0.3, -0.1 + 0.1]
    np.testing.assert_allclose(bend([1.2, -0.8], [0, 0], 0.1), weak, atol=1e-12)
    np.testing.assert_allclose(bend([1.2, -0.8], [-0.06, 0.06]), [-0.3, 0.2])


# --- replays --------------------------------------------------------------------------


class Stands:
    """A simulator whose replays are off by a constant in multiples of the step."""

    def __init__(self, off, step=0.0):
        self.off, self.step = off, step

    def with_step(self, step):
        return Stands(self.off, step)

    def replay(self, stretches, drives):
        return [[x.q + self.off * self.step for x in stretches] for _ in drives]


@pytest.mark.parametrize(
    ("off", "floor", "step"),
    [
        (0.0, 1e-6, 5e-3),
        (1.0, 2.6e-3, 5e-3),  # from 5 to 2.5 ms replays change by 2.5e-3
        (1.0, 2.4e-3, 2.5e-3),
        (1.0, 1.2e-3, 1.25e-3),
        (1.0, 1e-5, 0.625e-3),
    ],
)
def test_the_physics_steps_as_long_as_replays_do_not_change(off, floor, step):
    q = np.random.default_rng(0).normal(size=(50, 2))
    logs = [Stretch(STEP, q, q, np.zeros(2))] * 2
    found = converged(Stands(np.array([off, 0.0])), logs, FILE, np.full(2, floor))
    assert found.step == pytest.approx(step)


def test_a_replay_that_misses_by_far_needs_no_short_step():
    q = np.zeros((50, 2))
    at = {0.005: 1.0, 0.0025: 1.029, 0.00125: 1.03, 0.000625: 1.03}

    class Far:
        def __init__(self, step=0.0):
            self.step, self.with_step = step, Far

        def replay(self, stretches, drives):
            return [[x.q + at[self.step] for x in stretches] for _ in drives]

    log = Stretch(STEP, q, q, np.zeros(2))
    assert converged(Far(), [log], FILE, np.full(2, 1e-6)).step == 0.005
    at[0.0025] = 1.06
    assert converged(Far(), [log], FILE, np.full(2, 1e-6)).step == 0.0025


def test_what_a_replay_misses_is_an_rms_over_all_logs():
    class Off:
        def replay(self, stretches, drives):
            return [[x.q + d for x in stretches] for d in drives]

    logs = [
        Stretch(STEP, x, x, np.zeros(2)) for x in (np.zeros((30, 2)), np.ones((10, 2)))
    ]
    wave = np.array([3.0, np.nan])
    found = missed(Off(), logs, [np.array([0.5, -0.25]), wave])
    np.testing.assert_allclose(found, [[0.5, 0.25], [3.0, np.inf]])


def test_a_replay_starts_in_the_state_of_its_stretch():
    goal = 0.3 * np.sin(4.0 * STEP * np.arange(17)[:, None]) * [1.0, -1.0]
    short = Stretch(STEP, goal, goal, np.array([0.3, 0.0]))
    (run,) = ServoSimulator(ROBOT).runs([short], [FILE])
    assert run.parts == 4 and run.model.opt.timestep == pytest.approx(0.005)
    np.testing.assert_allclose(run.state[:5], [0.0, *short.q[0], *short.v])


# --- the start ------------------------------------------------------------------------


def balanced(robot, stiffness, damping, coulomb, armature, offset) -> list[Stretch]:
    """Slow motion, with the commands that make the servo balance it."""
    t, found = STEP * np.arange(600)[:, None], []
    for phase in (0.0, 2.0):
        w = np.array([1.7, 2.9])
        q = 0.5 * np.sin(w * t + phase) + 0.2 * np.sin(1.31 * w * t)
        v = 0.5 * w * np.cos(w * t + phase) + 0.2 * 1.31 * w * np.cos(1.31 * w * t)
        a = -(w**2) * (
            0.5 * np.sin(w * t + phase) + 0.2 * 1.31**2 * np.sin(1.31 * w * t)
        )
        rest = 0 * q
        weight = inverse_dynamics(robot.chain, robot.chain.inertial, q, rest, rest)
        asked = weight + damping * v + coulomb * np.tanh(v / 0.02) + armature * a
        found.append(Stretch(STEP, q + (asked - offset) / stiffness, q, v[0]))
    return found


def test_the_first_guess_is_the_servo_that_balances_the_motion():
    law = {
        "stiffness": np.array([80.0, 40.0]), "damping": np.array([3.0, 1.0]),
        "coulomb": np.array([1.5, 0.6]), "armature": np.array([0.8, 0.3]),
        "offset": np.array([0.5, -0.3]),
    }  # fmt: skip
    guess = first_guess(ROBOT, balanced(ROBOT, **law), FILE)
    usual = 1.0 / np.median(1.0 / law["stiffness"])  # one stiffness for all joints
    for name, x in law.items():
        expected = x * usual / law["stiffness"]
        np.testing.assert_allclose(guess[name], expected, rtol=0.05, err_msg=name)
    heavy = FILE.at(mass=2.0)  # the same ratios, of twice the torques
    twice = first_guess(ROBOT, balanced(ROBOT, **law), heavy)
    np.testing.assert_allclose(twice["stiffness"], 2 * guess["stiffness"])
    np.testing.assert_allclose(twice["coulomb"], 2 * guess["coulomb"])


def test_a_first_guess_is_above_zero_and_the_file_s_where_nothing_has_weight():
    light = replace(
        ROBOT, chain=replace(ROBOT.chain, gravity=np.zeros(3)), kp=np.array([9.0, 21.0])
    )
    none = np.zeros(2)
    logs = balanced(light, np.full(2, 15.0), none - 1.0, none, none - 1.0, none)
    guess = first_guess(light, logs, Drive.declared(light))
    np.testing.assert_allclose(guess["stiffness"], 15.0)
    for name in ("damping", "armature"):
        np.testing.assert_allclose(guess[name], 1e-3 * 15.0)


def test_the_best_start_is_chosen_joint_by_joint():
    guess = FILE.at(stiffness=40.0, damping=3.0)

    class Known:
        """Replays miss by what a servo differs from the right one."""

        def __init__(self, right):
            self.right = right

        def replay(self, stretches, drives):
            off = [np.abs(d.values - self.right).sum(axis=0) for d in drives]
            return [[x.q + y for x in stretches] for y in off]

    damped = np.maximum(3.0 - 40.0 * np.array([0.02, 0.08]), 1e-3 * 40.0)
    right = guess.at(delay=[0.02, 0.08], damping=damped, stiffness=[40.0, 160.0]).values
    right[:, 1] = guess.at(delay=0.08, damping=damped[1], stiffness=160.0).values[:, 1]
    log = Stretch(STEP, np.zeros((9, 2)), np.zeros((9, 2)), np.zeros(2))
    found = best_start(Known(right), [log], guess, FILE)
    np.testing.assert_allclose(found.values, right)
    right[:, 0] = FILE.at(delay=0.1).values[:, 0]
    found = best_start(Known(right), [log], guess, FILE)
    np.testing.assert_allclose(found.values, right)
    np.testing.assert_array_equal(found.stall, FILE.stall)


# --- the search -----------------------------------------------------------------------


class Crossed:
    """Replays in which each number shows at the other joint too, by a tenth."""

    def __init__(self):
        rng = np.random.default_rng(1)
        self.signals = 0.05 * rng.standard_normal((len(NAMES), 100, 2))
        self.counted = []

    def replay(self, stretches, drives):
        self.counted.append(len(drives))
        out = []
        for drive in drives:
            off = drive.coordinates - FILE.coordinates
            own = np.einsum("kj,ktj->tj", off, self.signals)
            out.append([x.q + own + 0.1 * own[:, ::-1] for x in stretches])
        return out


def crossed(step=STEP):
    t = step * np.arange(100)[:, None]
    q = np.sin(3.0 * t) * [0.5, 0.3]
    stretch = Stretch(step, q + 0.1, q, np.zeros(2))
    reached = np.array([[-0.45, -0.3], [0.6, 0.3]])
    touched = np.array([np.nan, -0.2])
    none = np.zeros(2, dtype=bool)
    return Problem(Crossed(), [stretch], FILE, none, reached, touched)


def test_a_servo_moves_its_own_joint_or_is_varied_alone():
    made, free = crossed(), np.zeros((len(NAMES), 2), dtype=bool)
    k = NAMES.index("damping")
    free[k] = True
    law, at = made.simulator, made.at(FILE.coordinates, free)
    law.counted.clear()
    own = made.slopes(at)
    assert law.counted == [1]
    expected = np.zeros((2, 100, 2))
    for j in range(2):
        expected[j, :, j] = law.signals[k, :, j] + 0.1 * law.signals[k, :, 1 - j]
    np.testing.assert_allclose(own, expected, atol=1e-9)
    each = made.slopes(at, each=True)
    assert law.counted == [1, 2]
    for j in range(2):
        expected[j, :, j] = law.signals[k, :, j]
        expected[j, :, 1 - j] = 0.1 * law.signals[k, :, j]
    np.testing.assert_allclose(each, expected, atol=1e-9)
    made.slopes(at)  # what was replayed is known
    assert law.counted == [1, 2]


def test_a_replay_that_diverges_is_a_very_bad_one():
    class Lost:
        def replay(self, stretches, drives):
            return [[x.q * np.nan for x in stretches] for _ in drives]

    made = replace(crossed(), simulator=Lost())
    assert (made.errors([FILE.coordinates])[0] == 1e3).all()


def test_each_number_is_probed_by_usual_changes():
    """Both ways and to the plain fit; a limit to where it would be felt."""
    made, x = crossed(), FILE.coordinates
    hint = FILE.at(damping=[2.0, 0.1], zero=[0.01, 0.02], spring=[0.5, 0.25])
    changes, errors = probed(
        made, x, np.ones((len(NAMES), 2), dtype=bool), hint.coordinates
    )
    assert len(errors) == len(changes)
    tried = {
        name: [c[k] for c in changes if c[k].any()] for k, name in enumerate(NAMES)
    }
    for c in changes:
        assert np.count_nonzero(c.any(axis=1)) == 1
    half, off = np.full(2, 0.5), np.log(hint["damping"] / FILE["damping"])
    spread = {q.name: s for q, s in zip(QUANTITIES, FILE.spread, strict=True)}
    fastest = np.quantile(
        np.abs(np.diff(made.stretches[0].command, axis=0)) / STEP, 0.98, axis=0
    )
    lone = np.eye(2)
    expected = {
        **{name: [half, -half] for name in ("stiffness", "coulomb", "armature")},
        **{
            name: [spread[name], 0.25 * spread[name]]
            for name in ("stiction", "dead_band")
        },
        "play": [*(0.25 * spread["play"] * lone)],
        "damping": [half, -half, off],
        "offset": [0.05 * FILE.stall, -0.05 * FILE.stall],
        "zero": [np.full(2, 0.05), np.full(2, -0.05), [0.01, 0.02]],
        "spring": [spread["spring"], 0.25 * spread["spring"], [0.5, 0.25]],
        "delay": [np.full(2, 0.03), np.full(2, 0.0075)],
        "stall": [np.full(2, -1.0), np.full(2, -2.0), np.full(2, -3.0)],
        "pace": [1.2 / fastest, 2.0 / fastest, 4.0 / fastest],
        # The second joint's command is beyond what it reached, the first's above only.
        "lower": [],
        "upper": [[0.0, 0.3 - 2.0]],
        "mass": [*(0.3 * lone), *(-0.3 * lone)],
        "sign": [*(-2.0 * lone)],
        "ground": [[0.0, -0.2 + far - FILE["ground"][1]] for far in (0.0, 0.01, 0.02)],
    }
    for name, rows in expected.items():
        assert len(tried[name]) == len(rows), name
        for found, row in zip(tried[name], rows, strict=True):
            np.testing.assert_allclose(found, row, atol=1e-12, err_msg=name)
    closed = np.zeros((len(NAMES), 2), dtype=bool)
    closed[NAMES.index("delay"), 1] = True
    changes, _ = probed(made, x, closed, hint.coordinates)
    assert [list(c[NAMES.index("delay")]) for c in changes] == [[0, 0.03], [0, 0.0075]]


# --- the result -----------------------------------------------------------------------


def finding(quantity="damping", joint="hinge_0", worth=1.0) -> ServoFinding:
    return ServoFinding(
        "viscous", joint, quantity, "N", 1.0, 2.0, (1.5, 2.5), 0.9, (), worth
    )


def result(**changed) -> ServoFit:
    known = {
        "robot": ROBOT, "drive": FILE.at(stiffness=[30.0, 20.0]), "written": FILE,
        "plain_drive": FILE, "std": 0.01 * np.arange(2.0 * len(NAMES)).reshape(-1, 2),
        "findings": (finding(), finding(), finding("delay")),
        "before": np.array([0.02, 0.01]), "plain": np.array([0.005, 0.004]),
        "after": np.array([0.001, 0.003]), "floor": np.array([4e-4, 5e-4]),
        "seconds": 12.0, "unseen": ("/logs/a.csv",), "asked": np.zeros((2, 2)),
        "motion": Stretch(STEP, np.zeros((9, 2)), np.zeros((9, 2)), np.zeros(2)),
        "resting": (), "scale": (),
        "notes": ("so",),
    }  # fmt: skip
    return ServoFit(**(known | changed))


def test_the_result_is_said_in_a_sentence():
    said = result().sentence
    assert "miss by 2.0 instead of 15.0 mrad (mean of joints that move)" in said
    assert "wrong in damping at hinge_0, delay at hinge_0." in said
    left = "Left without a known cause: 3.0 mrad at hinge_1 (encoder: 0.50)."
    assert said.endswith(left)
    both = result(after=np.array([0.002, 0.003])).sentence
    left = "3.0 mrad at hinge_1 (encoder: 0.50), 2.0 mrad at hinge_0 (encoder: 0.40)."
    assert both.endswith(left)
    quiet = result(after=np.array([0.001, 0.0019]), findings=()).sentence
    assert quiet.endswith("nothing stands out.") and "cause" not in quiet
    rests = result(resting=("hinge_1",))
    assert "miss by 1.0 instead of 20.0 mrad" in rests.sentence
    assert "cause" not in rests.sentence
    row = gap_table(rests).rows[-1]
    assert (row[0], row[1], row[3]) == ("mean of joints that move", "20.00", "1.00")


@pytest.mark.parametrize("count", [0, 4, 6])
def test_the_sentence_names_four_findings_and_counts_the_others(count):
    several = [finding(joint=f"j{k}") for k in range(count)]
    said = result(findings=tuple(several)).sentence
    assert [f"at j{k}" in said for k in range(6)] == [
        k < min(count, 4) for k in range(6)
    ]
    assert ("and 2 more" in said) == (count == 6) and said.count(" more") == (count > 4)


def test_servos_are_saved_as_mjcf_only(tmp_path):
    with pytest.raises(HybridError, match="fit.json: an arm with servos is saved as"):
        result().save(tmp_path / "fit.json")
    assert not [*tmp_path.iterdir()]


def test_the_first_screen_has_the_numbers_to_set(tmp_path):
    fit = result()
    t, nothing = np.arange(3.0), np.zeros((3, 2))
    replay = ServoReplay(t, nothing, nothing, nothing, nothing, "log.csv")
    write_servo_page(tmp_path / "a.html", fit, replay, fixed="new.xml", provenance={})
    page = (tmp_path / "a.html").read_text("utf-8")
    first = page[page.index("What to do") : page.index("How far replays miss")]
    assert "Simulate with new.xml" in first and "hinge_0" in first


def test_of_many_joints_without_a_cause_three_are_said():
    arm = pendulum(5)
    after = 1e-3 * np.array([5.0, 1.0, 4.0, 3.0, 6.0])
    said = result(
        robot=arm, before=after, after=after, floor=np.full(5, 1e-4), findings=()
    ).sentence
    places = [said.index(f"hinge_{j}") for j in (4, 0, 2)]
    assert places == sorted(places) and said.endswith(" and 2 more.")
    assert "hinge_1" not in said and "hinge_3" not in said


def test_all_numbers_are_shown_with_both_ends_of_their_intervals():
    """They had the upper half of a skew one, which led below zero."""
    std = np.zeros((len(NAMES), 2))
    for name in ("armature", "offset", "delay"):
        std[NAMES.index(name), 0] = 0.5
    drive = FILE.at(armature=0.03, offset=-0.2, delay=0.01, stiffness=1234.0)
    shown = servos_table(result(drive=drive, std=std))
    table = {name: cells for name, *cells in shown.rows}
    assert table["armature, kg·m²"] == ["0.03 (0.0113 … 0.0799)", "0.03"]
    assert table["offset, N·m"][0] == "-0.2 (-1.18 … 0.78)"
    assert table["delay, s"][0] == "0.01 (0 … 0.99)"
    assert table["stiffness, N·m/rad"] == ["1230", "1230"]
    assert "dead band" in shown.caption and "dead band, rad" not in table
    assert "delay" not in shown.caption
    zeros = shown.caption.removeprefix("Zero at every joint: ").split(", ")
    assert len(table) + len(zeros) == len(QUANTITIES)


def test_the_result_as_numbers():
    found = result().as_dict()
    assert found["gap"] == [
        {"joint": "hinge_0", "unit": "rad", "before": 0.02, "plain_fit": 0.005,
         "after": 0.001, "noise": 4e-4},
        {"joint": "hinge_1", "unit": "rad", "before": 0.01, "plain_fit": 0.004,
         "after": 0.003, "noise": 5e-4},
    ]  # fmt: skip
    (first, second), k = found["servos"], NAMES.index("delay")
    assert first["stiffness"]["value"] == 30.0 and second["stiffness"]["value"] == 20.0
    assert first["delay"]["std"] == pytest.approx(0.02 * k)
    assert second["delay"]["std"] == pytest.approx(0.02 * k + 0.01)
    assert first["stiffness"]["relative"] and not first["delay"]["relative"]
    assert found["unseen"] == ["a.csv"] and found["scale"] == "masses of the file"


def test_a_log_is_replayed_with_both_servos_over_its_longest_stretch():
    t = STEP * np.arange(400)
    q = 0.3 * np.sin(3.0 * t)[:, None] * [1.0, 0.5]
    keep = np.r_[0:120, 150:400]
    log = Recording(
        t[keep], q[keep][:, ::-1], command=q[keep][:, ::-1],
        joints=ROBOT.joints[::-1], source="log",
    )  # fmt: skip
    fit = result()
    with pytest.warns(HybridWarning, match="taken as 2 recordings"):
        found = fit.replayed(log)
        both = stretches_of([log.in_order(ROBOT.joints)])
    longest = max(both, key=lambda x: x.duration)
    assert len(found.t) == len(longest.q) > 240
    assert found.t[-1] == pytest.approx(longest.duration) and found.t[0] == 0.0
    simulator = ServoSimulator(ROBOT)
    for moved, drive in ((found.before, None), (found.after, fit.drive)):
        ((expected,),) = simulator.replay([longest], [drive])
        np.testing.assert_allclose(moved, expected)
    np.testing.assert_array_equal(found.q, longest.q)
    assert np.abs(found.before - found.after).max() > 1e-4


DEGREES = """<mujoco model="arm"><compiler angle="degree"/><option timestep="0.004"/>
<worldbody><body name="upper"><joint name="a" axis="0 1 0" ref="10" range="-90 80"
 damping="0.4" armature="0.02" stiffness="2" springref="5"/>
<inertial pos="0 0 0.1" mass="0.6" diaginertia="0.002 0.002 0.0005"/>
<body name="lower" pos="0 0 0.2"><joint name="b" axis="0 1 0" damping="0.3"
 armature="0.01"/>
<inertial pos="0 0 0.08" mass="0.3" diaginertia="0.001 0.001 0.0003"/>
</body></body></worldbody><actuator>
<position joint="a" kp="25" kv="0.6" forcerange="-4 4"/>
<position joint="b" kp="20" kv="0.4" forcerange="-2 2"/>{}</actuator></mujoco>"""


def test_a_written_file_has_the_numbers_of_the_model_that_is_replayed(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(DEGREES.format(""))
    robot = Robot.load(path)
    drive = Drive.declared(robot).at(
        stiffness=[30.0, 22.0], damping=[1.5, 0.9], coulomb=[0.2, 0.1],
        stall=[3.0, 1.0], stiction=[0.05, 0.02], armature=[0.03, 0.04],
        offset=[0.2, -0.1],
        zero=[0.02, -0.03], spring=[0.0, 1.0], upper=[1.1, 0.9], sign=[1.0, -1.0],
        mass=[1.0, 1.5], delay=[0.0, 0.021],
    )  # fmt: skip
    write_servos(robot, drive, tmp_path / "new.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    model = servo_spec(robot, drive).compile()
    install(model, robot, drive, mujoco.MjData(model))
    for name in (
        "dof_damping", "dof_armature", "dof_frictionloss", "jnt_stiffness", "jnt_range",
        "qpos_spring", "jnt_axis", "body_mass", "body_inertia",
    ):  # fmt: skip
        ours, theirs = getattr(model, name), getattr(written, name)
        np.testing.assert_allclose(theirs, ours, atol=1e-9, err_msg=name)
    for name in ("gainprm", "biasprm", "dynprm"):
        ours, theirs = (getattr(x, f"actuator_{name}") for x in (model, written))
        np.testing.assert_allclose(theirs[:, :8], ours[:, :8], atol=1e-9, err_msg=name)
    np.testing.assert_allclose(written.actuator_delay, [0.0, 0.021])
    # 21 ms take six steps of 4 ms, and one more sample.
    assert written.actuator_history[:, 0].tolist() == [0, 7]
    assert written.qpos0 == pytest.approx([np.deg2rad(10) - 0.02, 0.03])
    assert written.opt.timestep == 0.004


@pytest.mark.parametrize("unit", ["degree", "radian"])
def test_a_written_file_declares_the_servos_that_were_written(tmp_path, unit):
    """Its DC motors were not read: a second diagnosis started at usual servos."""
    path, angles = tmp_path / "arm.xml", {"degree": "-90 80", "radian": "-1.6 1.4"}
    text = DEGREES.format("").replace('angle="degree"', f'angle="{unit}"')
    path.write_text(text.replace("-90 80", angles[unit]))
    robot = Robot.load(path)
    same = {
        "stiffness": [30.0, 22.0], "damping": [1.5, 0.9], "coulomb": [0.2, 0.1],
        "stall": [3.0, 1.0], "stiction": [0.05, 0.02], "armature": [0.03, 0.04],
        "presliding": [2e-3, 4e-3], "stribeck_speed": [0.1, 0.2], "delay": [0.0, 0.021],
        "quadratic": [0.0, 0.1],
    }  # fmt: skip
    drive = Drive.declared(robot).at(
        **same, offset=[0.2, -0.1], zero=[0.02, -0.03], spring=[0.0, 1.0],
        upper=[1.1, 0.9], sign=[1.0, -1.0], mass=[1.0, 1.5], pitch=[0.05, 0.0],
    )  # fmt: skip
    write_servos(robot, drive, tmp_path / "new.xml")
    again = Robot.load(tmp_path / "new.xml")
    for name, values in same.items():
        found = Drive.declared(again)[name]
        np.testing.assert_allclose(found, values, rtol=1e-9, err_msg=name)
    assert again == Robot.from_dict(again.as_dict())
    t = np.arange(0.0, 3.0, STEP)[:, None]
    command = 0.3 + 0.5 * np.sin(np.array([4.0, 6.0]) * t + [0.0, 1.0])
    stretch = Stretch(STEP, command, command, np.zeros(2))
    ((before,),) = ServoSimulator(robot).replay([stretch], [drive])
    ((after,),) = ServoSimulator(again).replay([stretch], [None])
    np.testing.assert_allclose(after, before, atol=1e-7)


def test_a_geared_motor_is_read_as_the_joint_has_it(tmp_path):
    path = tmp_path / "arm.xml"
    motor = (
        '<dcmotor joint="a" input="{}" gear="2" motorconst="0.5" resistance="2" '
        'controller="30 {} 3 0 0 36" lugre="41 0 1 1.5 0.2"/>'
    )
    start, _, rest = DEGREES.format("").partition('<position joint="a"')
    for kind, integral, expected in (
        ("pos", 0, (120.0, 12.0)),
        ("pos", 5, (np.nan, np.nan)),
        ("vel", 0, (np.nan, np.nan)),
    ):
        own = motor.format(kind, integral)
        path.write_text(start + own + rest.partition("/>")[2])
        robot = Robot.load(path)
        np.testing.assert_allclose((robot.kp[0], robot.kd[0]), expected)
        assert robot.tau_max[0] == pytest.approx(2 * 0.5 / 2 * 36)
        expected_friction = [[0, 2.0, 1.0, 0.1, 1 / 41 / 2]]
        np.testing.assert_allclose(robot.bristle, expected_friction)


@pytest.mark.parametrize("changed", [{}, {"zero": 0.1}, {"sign": -1.0}, {"lower": -1}])
def test_a_written_file_stops_where_the_replay_stops(tmp_path, changed):
    """It kept the range of the file where only the zero was another."""
    path = tmp_path / "arm.xml"
    path.write_text(DEGREES.format(""))
    robot = Robot.load(path)
    drive = Drive.declared(robot).at(**changed)
    write_servos(robot, drive, tmp_path / "new.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    np.testing.assert_allclose(written.jnt_range[0], stops(drive)[0], atol=1e-12)
    assert written.jnt_limited[0]


def test_a_joint_keeps_the_reference_that_it_inherits(tmp_path):
    """It lost that of a default class."""
    path, own = tmp_path / "arm.xml", DEGREES.format("").replace(' ref="10"', "")
    inherited = '<default><joint ref="10"/></default><worldbody>'
    path.write_text(own.replace("<worldbody>", inherited))
    robot = Robot.load(path)
    write_servos(robot, Drive.declared(robot).at(zero=0.1), tmp_path / "new.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert written.qpos0 == pytest.approx(np.deg2rad([10.0, 10.0]) - 0.1)


@pytest.mark.parametrize(
    "own", ['kp="25" ctrlrange="-1 0.5"', 'kp="50" gear="0.5" ctrlrange="-0.5 0.25"']
)
def test_a_file_clips_no_command_that_the_logs_have(tmp_path, own):
    """It kept its range, also where commands went farther or the zero was moved."""
    path, new = tmp_path / "arm.xml", tmp_path / "new.xml"
    text = DEGREES.format("").replace('kp="25"', own)
    path.write_text(text)
    robot = Robot.load(path)
    drive = Drive.declared(robot).at(zero=0.1, sign=-1.0)
    asked = np.array([[-0.6, -1.0], [0.8, 1.0]])  # [-0.5, 1] turned, less 0.1
    write_servos(robot, drive, new, asked)
    written = mujoco.MjModel.from_xml_path(str(new))
    np.testing.assert_allclose(written.actuator_ctrlrange[0], [-0.6, 0.9])
    assert written.actuator_ctrllimited.tolist() == [1, 0]
    assert _clips(robot, drive, asked) == []
    asked[1, 0] = 1.2
    write_servos(robot, drive, new, asked)
    assert not mujoco.MjModel.from_xml_path(str(new)).actuator_ctrllimited.any()
    (note,) = _clips(robot, drive, asked)
    assert "clips commands of a, which go from -0.6 to 1.2 rad" in note


def test_the_control_range_of_a_motor_clips_no_position(tmp_path):
    path, new = tmp_path / "arm.xml", tmp_path / "new.xml"
    start, _, rest = DEGREES.format("").partition('<position joint="a"')
    motor = '<motor joint="a" ctrlrange="-4 4"/>'
    path.write_text(start + motor + rest.partition("/>")[2])
    robot = Robot.load(path)
    write_servos(robot, Drive.declared(robot), new)
    assert not mujoco.MjModel.from_xml_path(str(new)).actuator_ctrllimited.any()


def test_a_joint_without_a_servo_gets_one_where_the_file_has_its_actuators(tmp_path):
    path, new = tmp_path / "arm.xml", tmp_path / "new.xml"
    text = DEGREES.format("")
    second = text.index('<position joint="b"')
    bare = text[:second] + text[text.index("</actuator>") :]
    path.write_text(bare)
    robot = Robot.load(path)
    drive = Drive.declared(robot).at(stiffness=[30.0, 22.0])
    write_servos(robot, drive, new)
    written = mujoco.MjModel.from_xml_path(str(new))
    joints = written.actuator_trnid[:, 0].tolist()
    assert sorted(joints) == [0, 1] and written.actuator("b").trnid[0] == 1
    assert written.actuator_gainprm[joints, 4] == pytest.approx([30.0, 22.0])
    none = bare[: bare.index("<actuator>")] + "</mujoco>"
    path.write_text(none)
    with pytest.raises(RobotError, match="no <actuator> section to put a servo into"):
        write_servos(Robot.load(path), drive, tmp_path / "other.xml")


def test_a_xacro_file_becomes_an_mjcf_file_with_the_servos(tmp_path):
    pytest.importorskip("xacro")
    robot = planar_of_xacro(tmp_path)
    drive = Drive.declared(robot).at(stiffness=[30.0, 22.0])
    write_servos(robot, drive, tmp_path / "new.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert sorted(written.actuator_gainprm[:, 4]) == pytest.approx([22.0, 30.0])


def test_the_logs_say_which_joints_rest_and_what_was_reached_and_touched():
    """A command below what was reached was stopped by something, or by nothing."""
    t = STEP * np.arange(150)
    q = np.stack([0.9 + 0.4 * np.sin(3 * t), 0.1 + 0 * t], axis=1)
    low = np.stack([0.2 + 0 * t, q[:, 1]], axis=1)  # rods hang at zero
    logs = [Stretch(STEP, x, q, np.zeros(2)) for x in (q, low)]
    made, start = _problem(ServoSimulator(ROBOT), logs, FILE)
    assert made.resting.tolist() == [False, True]
    np.testing.assert_array_equal(start[:, 1], FILE.coordinates[:, 1])
    np.testing.assert_allclose(made.reached, [q.min(axis=0), q.max(axis=0)])
    drop = [0.6 * np.cos(q[:, 0]), 0.6 * np.cos(q[:, 0]) + 0.6 * np.cos(q.sum(axis=1))]
    drop[0], drop[1] = drop[0] * 0.5, drop[1] - 0.3 * np.cos(q.sum(axis=1))
    np.testing.assert_allclose(made.touched, [-x.max() for x in drop], atol=1e-9)
    high, _ = _problem(ServoSimulator(ROBOT), [logs[0]], FILE)
    assert np.isnan(high.touched).all()
    still = replace(logs[0], q=0 * q)
    with pytest.raises(RecordingError, match="no joint moves"):
        _problem(ServoSimulator(ROBOT), [still], FILE)


def test_notes_say_what_logs_and_files_leave_open():
    none = np.zeros(2, dtype=bool)
    (plain,) = _notes(ROBOT, none, {})
    assert "rests on the masses of the file" in plain
    (known,) = _notes(ROBOT, none, {"hinge_1": 0.5})
    assert known.endswith("known mass: 0.5 kg behind hinge_1")
    chain = ROBOT.chain
    for less in ({"gravity": np.zeros(3)}, {"inertial": 0 * chain.inertial}):
        (light,) = _notes(replace(ROBOT, chain=replace(chain, **less)), none, {})
        assert "only ratios" in light
    bare = replace(ROBOT, kp=np.array([25.0, np.nan]))
    _, resting, assumed = _notes(bare, np.array([False, True]), {})
    assert resting == "no log moves hinge_1: their numbers are the file's"
    assert "declares no servo at some joints" in assumed


def test_what_a_file_cannot_say_is_said_with_what_that_costs():
    after, written = np.array([0.001, 0.002]), np.array([0.003, 0.0045])
    assert _unsaid(ROBOT, FILE, after, written) == []
    drive = FILE.at(dead_band=[0.0, 0.03], pace=[0.4, 0.0], ground=[-5.0, -0.25])
    ground, dead, pace = _unsaid(ROBOT, drive, after, written)
    assert "link of hinge_1" in ground and "is -0.250 m above" in ground
    assert "dead band of hinge_1, 0.03 rad:" in dead
    assert "by 4.5 instead of 2.0 mrad" in dead
    assert "pace of hinge_0, 0.4 s/rad:" in pace and "3.0 instead of 1.0" in pace
    (worn,) = _unsaid(ROBOT, FILE.at(load_friction=[0.0, 0.3]), after, written)
    assert "load friction of hinge_1, 0.3:" in worn


def test_a_file_of_which_every_number_is_right_is_only_replayed():
    """It failed: there was nothing to expand the evidence in."""
    t = STEP * np.arange(110)
    q = 0.3 * np.sin(3 * t)[:, None] * [1.0, 0.5]
    log = Recording(t, q, command=q + 0.05, joints=ROBOT.joints, source="log")
    every = [(k, j) for k in range(len(NAMES)) for j in (0, 1)]
    fit = fit_servo(ROBOT, [log], without=every)
    # Of one log, only what was held out is shown as unseen.
    shown = fit.replayed()
    assert shown.t[-1] == pytest.approx(fit.seconds) and shown.source == "log"
    np.testing.assert_allclose(shown.q[-1], q[-1])
    assert len(shown.q) < 0.4 * len(q)
    assert fit.findings == () and not fit.std.any()
    np.testing.assert_allclose(fit.drive.values, FILE.values, rtol=1e-12)
    np.testing.assert_allclose(fit.after, fit.plain)


def test_a_result_holds_the_servos_of_the_plain_fit_and_those_found_and_written(
    monkeypatch,
):
    def moved(by):
        free = np.zeros(FILE.values.shape, dtype=bool)
        return Estimate(FILE.coordinates + by, free, np.zeros((5, 2)), free)

    def replayed(simulator, stretches, drives):
        return [np.full(2, -1.0 if x is None else stiffness(x)) for x in drives]

    def stiffness(drive):
        return float(drive["stiffness"][0])

    plain, found, written = map(moved, (0.1, 0.2, 0.3))
    for name, stub in (("_written", lambda *_: written), ("missed", replayed),
                       ("_findings", lambda *_: ())):  # fmt: skip
        monkeypatch.setattr(f"hybrid.servo.fit.{name}", stub)
    problem = SimpleNamespace(
        errors=lambda points: [np.zeros((5, 2)) for _ in points],
        fitted=lambda start, *_: start,
        covariance=lambda *_: np.zeros((0, 0)),
        simulator=None, prior=FILE, stretches=[], resting=np.zeros(2, dtype=bool),
    )  # fmt: skip
    still = Stretch(STEP, np.zeros((9, 2)), np.zeros((9, 2)), np.zeros(2), source="log")
    search = SimpleNamespace(plain=plain, noise=None)
    fit = _result(ROBOT, {}, search, problem, found, [still], np.zeros((2, 2)))
    kp = float(FILE["stiffness"][0])
    drives = (fit.plain_drive, fit.drive, fit.written)
    expected = kp * np.exp([0.1, 0.2, 0.3])
    np.testing.assert_allclose([stiffness(x) for x in drives], expected)
    assert fit.before[0] == -1.0
    np.testing.assert_allclose([fit.plain[0], fit.after[0]], expected[:2])
