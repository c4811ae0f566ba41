"""Doubts about made-up logs, word for word; coverage and fits by plain sums."""

import warnings
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from arms import random_arm
from pendulum import pendulum, swings, with_torque
from scipy.optimize import nnls

from hybrid.dynamics import inverse_dynamics
from hybrid.dynamics.regressor import regressor
from hybrid.errors import HybridWarning, RecordingError
from hybrid.inspect import check_recordings, inspect_recording
from hybrid.inspect.coverage import coverage_of, excitation_of
from hybrid.inspect.doubt import Doubt, raise_or_warn
from hybrid.inspect.glitches import doubts_of_rows
from hybrid.inspect.inspection import clock_of
from hybrid.inspect.masses import MassColumns, smooth_sign, unit_masses
from hybrid.inspect.physics import (
    _others,
    _Readings,
    doubts_of_magnitude,
    doubts_of_physics,
)
from hybrid.inspect.positions import doubts_of_positions
from hybrid.inspect.samples import (
    doubts_of_samples,
    encoder_step,
    large_step,
    resolution,
)
from hybrid.inspect.scale import doubts_of_scale, scales
from hybrid.inspect.speeds import doubts_of_speed_limits, speeds_confirm_clock
from hybrid.inspect.state import State, filtered_state
from hybrid.recording import Recording
from hybrid.robot import Robot

T = np.arange(0.0, 5.0, 0.01)
WAVE = np.sin(2.0 * T) + 0.3 * np.sin(7.0 * T)
BOTH = np.stack([WAVE, 0.8 * np.cos(3.0 * T)], axis=1)


def log(q=BOTH, t=None, **channels) -> Recording:
    t = 0.01 * np.arange(len(q)) if t is None else t
    return Recording(t, q, joints=("a", "b")[: q.shape[1]], source="log", **channels)


def put(x, at, value):
    x = x.copy()
    x[at] = value
    return x


HELD = put(BOTH, np.s_[100:111], BOTH[110])


def lines(doubts):
    return [(d.severity, d.joints, d.line) for d in doubts]


# --- samples --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("recording", "says", "evidence"),
    [
        (log(BOTH[:100], np.linspace(0, 1, 100)), [], None),
        (
            log(BOTH[:99], np.linspace(0, 1.2, 99)),
            [("error", (), "too short: 99 samples in 1.2 s; valid are 100 samples and "
              "1 s or more")],
            99,
        ),
        (
            log(BOTH[:200], np.linspace(0, 0.9, 200)),
            [("error", (), "too short: 200 samples in 0.9 s; valid are 100 samples and "
              "1 s or more")],
            200,
        ),
        (
            log(put(BOTH, (7, 1), -3e9)),
            [("error", (1,), "q2 (b), row 8 (data rows count from 1): -3e+09; valid "
              "are numbers up to 1e+09")],
            -3e9,
        ),
        (log(t=0.9 * np.arange(500)), [], None),
        (
            log(t=6e7 * np.arange(500)),
            [("error", (), "t: the median step is 6e+07 s: no arm is logged so rarely; "
              "valid are seconds")],
            6e7,
        ),
        (
            log(t=4.0 * np.arange(500)),
            [("error", (), "t: the median step is 4 s: time looks to be in "
              "milliseconds; valid are seconds")],
            4.0,
        ),
        (
            log(0.0003 * BOTH),
            [("error", (), "q: no joint moves more than "
              f"{0.0003 * np.ptp(WAVE):.2g} rad; valid is a log in which the arm moves "
              "by 0.001 rad or more")],
            0.0003 * np.ptp(WAVE),
        ),
        (
            log(put(BOTH, np.s_[:, 1], 0.3)),
            [("warning", (1,), "q2 (b) is constant")],
            np.nan,
        ),
        (log(put(BOTH, np.s_[:, 1], 0.3), v=put(BOTH, np.s_[:, 1], 0.0)), [], None),
        (log(put(BOTH, np.s_[:, 1], 0.3), command=put(BOTH, np.s_[:, 1], 1)), [], None),
        (
            log(v=put(BOTH, np.s_[:, 1], 0.0)),
            [("warning", (1,), "v2 (b) is constant while the joint moves")],
            np.nan,
        ),
        (
            log(command=put(BOTH, np.s_[:, 0], 0.0)),
            [("warning", (0,), "command1 (a) is constant while the joint moves")],
            np.nan,
        ),
        # a load moves a held joint
        (log(BOTH * [1.0, 0.05], command=put(BOTH, np.s_[:, 1], 0.0)), [], None),
        (
            log(tau=put(BOTH, np.s_[:, 1], 0.25)),
            [("error", (1,), "tau2 (b) is constant (0.25); valid is a torque that was "
              "measured"),
             ("warning", (1,), "tau2 (b), row 1 (data rows count from 1): frozen for "
              "500 samples")],
            np.nan,
        ),
        (
            log(tau=np.clip(BOTH, -9.0, [9.0, 0.6])),
            [("warning", (1,), "tau2 (b) stays at 0.6 for "
              f"{np.mean(BOTH[:, 1] >= 0.6):.1%}: saturated?")],
            np.mean(BOTH[:, 1] >= 0.6),
        ),
        (
            log(tau=np.clip(BOTH, [-0.9, -9.0], 9.0)),
            [("warning", (0,), "tau1 (a) stays at -0.9 for "
              f"{np.mean(WAVE <= -0.9):.1%}: saturated?")],
            np.mean(WAVE <= -0.9),
        ),
        (
            log(tau=put(BOTH, np.s_[100:120, 1], 0.33)),
            [("warning", (1,), "tau2 (b), row 101 (data rows count from 1): frozen for "
              "20 samples")],
            20,
        ),
        (log(tau=put(BOTH, np.s_[100:119, 1], 0.33)), [], None),
        (log(HELD, tau=put(BOTH, np.s_[100:120, 1], 0.33)), [], None),
        (
            log(put(BOTH, np.s_[45:65, 1], BOTH[45, 1])),
            [("warning", (1,), "q2 (b), row 46 (data rows count from 1): frozen for "
              "20 samples")],
            20,
        ),
        (log(put(BOTH, np.s_[45:64, 1], BOTH[45, 1])), [], None),
        (
            log(HELD, tau=HELD),
            [("warning", (), "all channels repeat for 11 samples from row 101 (data "
              "rows count from 1): did the log stop?")],
            11,
        ),
        (log(put(HELD, 100, BOTH[100]), tau=HELD), [], None),
    ],
)  # fmt: skip
def test_samples_that_no_arm_makes_are_told_in_words(recording, says, evidence):
    found = list(doubts_of_samples(recording))
    assert lines(found) == says
    if says:
        np.testing.assert_allclose(
            found[0].evidence, np.nan if evidence is None else evidence
        )


def test_a_time_that_no_clock_has_is_told():
    first, *_ = doubts_of_samples(log(t=8192.0 * np.arange(500) - 2e19))
    says = ("error", (), "t: -2e+19 s; valid are times up to 1e+19 s")
    assert lines([first]) == [says]


def test_one_joint_that_moves_among_three_is_told():
    for size, told in ((2, False), (3, True)):
        q = np.zeros((500, size))
        q[:, 1], q[:, 0] = WAVE, 1e-5 * WAVE
        if size == 3:
            q[:, 2] = 1e-5 * WAVE
        recording = Recording(T, q, joints=("a", "b", "c")[:size], source="log")
        found = list(doubts_of_samples(recording))
        assert [d.text for d in found] == ["only q2 (b) moves"] * told
        assert [d.evidence for d in found] == [1] * told


def test_a_resampled_position_tells_no_step_of_an_encoder():
    """Its smallest change is chance: 1e-10 rad of encoders of 1e-3 rad were said."""
    coarse = np.round(WAVE / 1e-3) * 1e-3
    assert encoder_step(coarse) == pytest.approx(1e-3)
    t = np.arange(len(WAVE))
    between = np.interp(t[:-1] + 0.37 * np.sin(t[:-1]) ** 2, t, coarse)
    assert encoder_step(between) == np.inf and encoder_step(WAVE) == np.inf


def test_steps_of_a_column():
    x = np.array([1.0, 2.0, 2.0, 2.0, 5.0, 5.0, 4.0, 4.0, 4.0])
    assert resolution(x) == 1.0 and resolution(np.ones(3)) == np.inf
    assert resolution(np.ones(3), 0.01) == 0.01 and resolution(0.5 * x, 0.1) == 0.1
    assert encoder_step(x) == 1.0 and encoder_step(np.ones(3)) == np.inf
    steps = np.r_[0.0, np.cumsum(np.arange(1.0, 201.0))]
    assert large_step(steps) == pytest.approx(np.quantile(np.arange(1.0, 201.0), 0.99))
    assert large_step(np.zeros(50)) == 0.01


# --- rows -----------------------------------------------------------------------------


def test_a_jump_is_told_with_the_positions_on_either_side():
    for step, what in (
        (0.4, "logs put together?"),
        (-2 * np.pi - 0.09, "a turn of the encoder is not counted"),
        (2 * np.pi + 0.15, "logs put together?"),
    ):
        x = put(WAVE, np.s_[200:], WAVE[200:] + step)
        (doubt,) = doubts_of_rows(log(np.stack([BOTH[:, 1], x], axis=1)))
        assert doubt.line == (
            f"q2 (b), row 201 (data rows count from 1): jumps from {x[199]:.6g} to "
            f"{x[200]:.6g} within a sample: {what}; valid are positions as the joint "
            "passed them"
        )
        assert doubt.rows and doubt.is_error and doubt.joints == (1,)
        assert doubt.evidence == pytest.approx(abs(x[200] - x[199]))


def test_rest_on_one_side_of_a_jump_is_another_fault():
    rest = np.where(T < 2.0, 0.1, 0.1 + 0.4 + WAVE - WAVE[200])
    assert not list(doubts_of_rows(log(rest[:, None])))
    steady = put(WAVE, np.s_[200:], WAVE[200:] + 0.4)
    assert len(list(doubts_of_rows(log(steady[:, None])))) == 1


def test_two_jumps_in_a_row_are_a_fast_motion():
    x = put(WAVE, np.s_[200:], WAVE[200:] + 0.8)
    x = put(x, np.s_[203:], x[203:] + 0.8)
    assert not any("jumps" in d.text for d in doubts_of_rows(log(x[:, None])))


def test_a_row_that_comes_again_is_no_repeated_log():
    q = put(BOTH, np.s_[300], BOTH[1])
    again = [d for d in doubts_of_rows(log(q, tau=2.0 * q)) if "repeats" in d.text]
    assert again == []


def test_held_rows_are_told_with_their_number_and_what_is_held():
    held = np.repeat(BOTH[:120], 4, axis=0)
    every = log(held, tau=np.repeat(BOTH[:120], 4, axis=0))
    (doubt,) = (d for d in doubts_of_rows(every) if "holds" in d.text)
    assert doubt.line == (
        "every channel holds each sample for 4 rows; valid is one row for each sample: "
        "keep every 4th"
    )
    assert doubt.evidence == 4 and doubt.is_error and doubt.rows
    (doubt,) = (
        d for d in doubts_of_rows(log(held, tau=BOTH[:480])) if "holds" in d.text
    )
    assert doubt.text == "q holds each sample for 4 rows"
    for rows, some in ((2, 200), (3, 160)):
        x = log(np.repeat(BOTH[:some], rows, axis=0))
        assert any("holds" in d.text for d in doubts_of_rows(x)) == (rows == 3)
    few = log(np.repeat(BOTH[:50], 4, axis=0))
    assert not any("holds" in d.text for d in doubts_of_rows(few))
    # one new value in five comes at another time
    rng = np.random.default_rng(0)
    loose = np.repeat(np.arange(120), rng.choice([4, 5], 120, p=[0.8, 0.2]))
    assert not any("holds" in d.text for d in doubts_of_rows(log(BOTH[loose])))


# --- positions ------------------------------------------------------------------------


def test_positions_in_another_unit_or_order_or_outside_are_told():
    arm = pendulum(2)  # ±2 rad
    arm = replace(arm, q_min=np.array([-2.0, -0.5]), q_max=np.array([2.0, 3.0]))
    arm = replace(arm, chain=replace(arm.chain, joints=("a", "b")))

    def said(q):
        return lines(doubts_of_positions(log(q), arm))

    right = BOTH * [1.4, 1.0] + [0.0, 1.2]
    assert said(right) == [] and said(right + [0.0, 1.05]) == []
    peak = int(np.argmax(np.abs(right[:, 0])))
    largest = np.rad2deg(right[:, 0])[peak]
    ((severity, joints, line),) = said(np.rad2deg(right))
    assert (severity, joints) == ("error", (0, 1))
    top = int(np.argmax(right[:, 1]))
    if abs(np.rad2deg(right[top, 1])) > abs(largest):
        name, row, x, ends = "q2 (b)", top, np.rad2deg(right[top, 1]), "-0.5 to 3"
    else:
        name, row, x, ends = "q1 (a)", peak, largest, "-2 to 2"
    assert line == (
        f"{name}, row {row + 1} (data rows count from 1): {x:.6g} looks like degrees; "
        f"valid are rad within {ends}, or a label as 'q [deg]'"
    )
    assert "looks like milliradians" in said(1e3 * right)[0][2]
    assert "is far outside the limits" in said(1e6 * right)[0][2]
    turned = said(right[:, ::-1])
    assert [x[:2] for x in turned] == [("error", (1,))]
    assert turned[0][2].endswith(
        "but all positions fit if the columns are in the order b, a; valid is a, b"
    )
    over = put(right, np.s_[33, 1], -1.0)
    assert said(over) == [
        ("warning", (1,), "q2 (b), row 34 (data rows count from 1): -1 is outside the "
         "limits -0.5 to 3"),
    ]  # fmt: skip
    also = put(put(right, np.s_[33, 0], 2.5), np.s_[40, 1], 3.2)
    ((_, joints, line),) = said(also)
    assert joints == (0, 1) and line.endswith(
        "2.5 is outside the limits -2 to 2; so are q2 (b)"
    )
    free = replace(arm, q_min=np.full(2, -np.inf), q_max=np.full(2, np.inf))
    (many,) = doubts_of_positions(log(right * 1e6), free)
    assert many.severity == "warning" and not list(
        doubts_of_positions(log(right), free)
    )


def test_a_slide_in_millimetres_is_told():
    arm = pendulum(2)
    chain = replace(arm.chain, revolute=np.array([True, False]), joints=("a", "b"))
    arm = replace(arm, chain=chain, q_max=np.array([2.0, 0.5]), q_min=np.array([-2, 0]))
    q = BOTH * [1.0, 0.2] + [0.0, 0.3]
    assert not list(doubts_of_positions(log(q), arm))
    (doubt,) = doubts_of_positions(log(q * [1.0, 1000.0]), arm)
    assert "looks like millimetres; valid are m within 0 to 0.5" in doubt.line
    assert doubt.joints == (1,) and doubt.is_error
    assert doubt.evidence == pytest.approx(1000 * q[:, 1].max())


# --- motion ---------------------------------------------------------------------------


def state_of(q, v, a=None, tau=None, logged=None) -> State:
    none = np.zeros_like(q)
    a, tau = (none if x is None else x for x in (a, tau))
    return State(q, v, a, tau, logged)


def test_a_joint_without_a_limit_may_move_at_fifty():
    arm = replace(pendulum(2), v_max=np.array([np.inf, 2.0]))
    chain = replace(arm.chain, revolute=np.array([True, False]), joints=("a", "b"))
    arm = replace(arm, chain=chain)
    for fastest, said in (
        ([49.0, 5.9], []),
        ([51.0, 6.1], [
            ("warning", (0,), "q1 (a) moves at 51 rad/s: positions look to be in "
             "degrees, or the clock is too fast; valid are speeds up to 50 rad/s"),
            ("warning", (1,), "q2 (b) moves at 6.1 m/s: positions look to be in "
             "degrees, or the clock is too fast; valid are speeds up to 2 m/s"),
        ]),
    ):  # fmt: skip
        v = np.outer(np.linspace(-1, 0.5, 500), fastest)
        found = list(doubts_of_speed_limits(log(), arm, state_of(BOTH, v)))
        assert lines(found) == said
        assert [d.evidence for d in found] == pytest.approx(fastest[: len(said)])
    v = np.outer(np.linspace(-1, 0.5, 500), [151.0, 17.9])
    found = list(doubts_of_speed_limits(log(), arm, state_of(BOTH, v)))
    assert [d.severity for d in found] == ["error", "warning"]
    assert not list(doubts_of_speed_limits(log(), None, state_of(BOTH, v)))


def test_speeds_confirm_a_clock_within_a_tenth():
    v = np.gradient(BOTH, 0.01, axis=0)
    for factor in (0.9, 0.95, 1.05, 1.11):
        state = state_of(BOTH, v, logged=factor * v)
        assert speeds_confirm_clock(state) == (1 / 1.1 < factor < 1.1)
    assert not speeds_confirm_clock(state_of(BOTH, v))
    assert not speeds_confirm_clock(state_of(0.004 * BOTH, v, logged=v))


def asked(arm, factor=1.0, more=0.0) -> State:
    rng, t = np.random.default_rng(0), np.arange(0.0, 8.0, 0.02)[:, None]
    w = rng.uniform(1.0, 5.0, (2, 1, arm.size))
    q = 0.8 * np.sin(w * t).sum(axis=0)
    v, a = (
        0.8 * (w * np.cos(w * t)).sum(axis=0),
        -0.8 * (w**2 * np.sin(w * t)).sum(axis=0),
    )
    tau = inverse_dynamics(arm.chain, arm.chain.inertial, q, v, a)
    tau += arm.chain.armature * a
    return State(q, v, a, factor * tau + more)


def test_a_scale_is_that_of_the_links_beside_friction_and_an_offset():
    arm = pendulum(2)
    state = asked(arm, np.array([1.7, 0.6]))
    drag = 2.0 * state.v + 1.5 * smooth_sign(state.v) + 3.0
    found = scales(arm, replace(state, tau=state.tau + drag))
    np.testing.assert_allclose(found, [1.7, 0.6], rtol=1e-9)
    # A rotor that the file lacks is fitted beside the links, one that it has is not.
    bare = replace(arm, chain=replace(arm.chain, armature=np.array([0.0, 0.05])))
    state = asked(bare)
    more = state.a * [5.0, 0.0]
    np.testing.assert_allclose(
        scales(bare, replace(state, tau=state.tau + more)), 1.0, rtol=1e-9
    )
    hum = np.random.default_rng(1).normal(size=state.tau.shape)
    weak = replace(state, tau=0.2 * state.tau + hum * state.tau.std(axis=0))
    assert np.isnan(scales(bare, weak)).all()


def test_inertia_alone_is_no_scale_where_the_file_has_no_rotor():
    """A rotor that it lacks would explain all of it."""
    arm = pendulum(1)
    none = {"gravity": np.zeros(3), "armature": np.zeros(1)}
    arm = replace(arm, chain=replace(arm.chain, **none))
    assert np.isnan(scales(arm, asked(arm, 2.0))).all()
    rotor = replace(arm, chain=replace(arm.chain, armature=np.ones(1)))
    np.testing.assert_allclose(scales(rotor, asked(rotor, 2.0)), [2.0])


def scale_doubts(arm, factor):
    state = asked(arm, np.array(factor))
    recording = Recording(
        0.02 * np.arange(400), state.q, tau=state.tau, joints=arm.joints
    )
    return list(doubts_of_scale(recording, arm, state))


def test_a_unit_is_shared_by_most_joints_and_a_tool_is_not():
    arm = pendulum(3)
    assert scale_doubts(arm, [2.9, 1.0, 1 / 2.9]) == []
    assert scale_doubts(arm, [5.0, 5.0, 1.0]) == []  # of a unit all are larger
    (more,) = scale_doubts(arm, [5.0, 6.0, 5.0])
    assert (more.severity, more.joints, more.channel) == ("warning", (), "tau")
    assert more.text == "tau is 5 times what the robot file's links ask for"
    assert more.evidence == pytest.approx(5.0)
    (less,) = scale_doubts(arm, [0.2, 1.0, 0.25])
    assert "tau is 0.225 times" in less.text and "a motor current in A" in less.text
    assert less.remedy.endswith("ask for 5, 1, 4 N·m/A at the joints")
    (wrong,) = scale_doubts(arm, [0.02, 0.03, 0.02])
    assert wrong.is_error and "of the motor side of a gear 1:50" in wrong.text
    (lone,) = scale_doubts(arm, [1.0, 0.08, 1.0])
    assert (lone.severity, lone.joints) == ("error", (1,))
    assert lone.text.startswith("tau2 (hinge_1) is 0.08 times what the robot file's")
    assert lone.remedy == "valid are N·m at the joint"
    assert scale_doubts(arm, [1.0, 0.12, 1.0]) == []
    (current,) = scale_doubts(arm, [0.25, 0.2, 0.2])
    assert current.remedy.endswith(
        "the file's links ask for 4, 5, 5 N·m/A at the joints"
    )
    assert scale_doubts(pendulum(1), [0.05])[0].severity == "warning"


def test_torque_far_above_the_rating_is_told_where_a_joint_s_scale_is_not_known():
    arm = replace(pendulum(2), tau_max=np.array([2.0, 0.0]))
    tau = np.random.default_rng(0).normal(size=(500, 2))
    tau *= [19.9, 1e4] / np.abs(tau).max(axis=0)
    v = np.gradient(BOTH, 0.01, axis=0)
    none = replace(arm, chain=replace(arm.chain, inertial=0 * arm.chain.inertial))
    state = state_of(BOTH, v, np.gradient(v, 0.01, axis=0), tau)
    assert not list(doubts_of_scale(log(tau=tau), none, state))
    tau[9, 0] = -20.4
    (doubt,) = doubts_of_scale(log(tau=tau), none, replace(state, tau=tau))
    assert "torque above 10 times the rating (tau1 (a) 20.4 of 2)" in doubt.text
    assert doubt.joints == (0,) and doubt.evidence == pytest.approx(10.2)
    assert doubt.severity == "warning"
    assert not list(doubts_of_scale(log(), none, state))


def test_one_joint_in_another_unit_is_told_beside_joints_in_the_right_one():
    arm = replace(pendulum(3), tau_max=np.full(3, 50.0))
    assert scale_doubts(arm, [1.0, 1.0, 1.0]) == []
    (doubt,) = scale_doubts(arm, [1.0, 1e3, 1.0])
    assert doubt.joints == (1,) and "in milliamps?" in doubt.text


# --- masses ---------------------------------------------------------------------------


@pytest.mark.parametrize("arm", [random_arm(3), pendulum(2), pendulum(1)])
def test_masses_are_points_at_a_link_s_origin_and_on_either_side_of_it(arm):
    lengths = np.linalg.norm(arm.chain.translation, axis=1)
    inertial = arm.chain.inertial
    for j, each in enumerate(unit_masses(arm.chain).transpose(0, 2, 1)):
        assert each.shape == (7, 10)
        far = np.linalg.norm(inertial[j, 1:4]) / inertial[j, 0]
        ahead = lengths[j + 1] if j + 1 < arm.size else 0.0
        reach = max(far, ahead, 0.25 * (lengths.sum() or 1.0))
        points = reach * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
        for parameters, p in zip(each, points, strict=True):
            J = p @ p * np.eye(3) - np.outer(p, p)
            expected = [1.0, *p, J[0, 0], J[0, 1], J[1, 1], J[0, 2], J[1, 2], J[2, 2]]
            np.testing.assert_allclose(parameters, expected, atol=1e-12)


@pytest.mark.parametrize("rounds", [1, 2])
def test_what_masses_leave_of_a_torque_is_that_of_weighted_least_squares(rounds):
    """With a tenth of an offset counted as residual."""
    arm = pendulum(2)
    state = asked(arm)
    rng = np.random.default_rng(4)
    tau = state.tau + rng.normal(size=state.tau.shape) * [2.0, 0.4] + [3.0, -0.5]
    state = replace(state, tau=tau)
    spring = {"stiffness": np.array([0.0, 1.0]), "springref": np.array([0.7, 0.3])}
    masses = unit_masses(arm.chain)
    Y = regressor(arm.chain, state.q, state.v, state.a)  # (M, n, 10n)
    fit = MassColumns(replace(arm, **spring), state, masses, Y)
    order, factor = np.array([0, 1]), np.array([1.0, 2.0])
    found = fit.residual(order, factor, rounds=rounds)
    M = len(state.q)
    rigid = np.concatenate(
        [Y[:, :, 10 * j : 10 * j + 10] @ masses[j] for j in (0, 1)], 2
    )
    dry = np.tanh(state.v / (0.02 * np.abs(state.v).max(axis=0)))
    rest = state.q - [state.q[:, 0].mean(), 0.3]
    one = np.ones_like(dry)
    drive = np.stack([state.a, state.v, dry, rest, one, -one], axis=2)
    A = np.zeros((2, M, 14 + 12))
    for j in (0, 1):
        A[j, :, :14], A[j, :, 14 + 6 * j : 20 + 6 * j] = rigid[:, j], drive[:, j]
    size, share = factor**2 * tau.var(axis=0), np.ones(2)
    for _ in range(rounds):
        rows, right = [], []
        for j in (0, 1):
            penalty = np.zeros((2, 26))
            penalty[[0, 1], [18 + 6 * j, 19 + 6 * j]] = 0.1
            scale = 1.0 / np.sqrt(size[j] * share[j])
            rows += [scale * A[j] / np.sqrt(M), scale * penalty]
            right += [scale * factor[j] * tau[:, j] / np.sqrt(M), np.zeros(2)]
        theta = nnls(np.vstack(rows), np.concatenate(right))[0]
        left = [
            ((factor[j] * tau[:, j] - A[j] @ theta) ** 2).mean()
            + 0.01 * (theta[18 + 6 * j : 20 + 6 * j] ** 2).sum()
            for j in (0, 1)
        ]
        share = np.array(left) / size
    np.testing.assert_allclose(found, share, rtol=1e-4)
    np.testing.assert_allclose(
        fit.explained, np.stack([x @ theta for x in A], axis=1), atol=0.02
    )


def test_a_spring_is_no_stronger_than_its_drive():
    """A torque that a spring explains, but for its strength, is left."""
    arm, rest = pendulum(1), asked(pendulum(1))
    none = replace(arm.chain, inertial=0 * arm.chain.inertial, gravity=np.zeros(3))
    tau = 5.0 * (rest.q - rest.q.mean())
    Y = regressor(none, rest.q, rest.v, rest.a)
    travel = np.abs(rest.q - rest.q.mean()).max()
    left = []
    for most in (6.0, 2.5):
        state, rated = replace(rest, tau=tau), np.array([most * travel])
        arm = replace(arm, tau_max=rated)
        fit = MassColumns(arm, state, np.zeros((1, 10, 7)), Y)
        left.append(fit.residual(np.array([0]), np.ones(1))[0])
        slope = np.polyfit(rest.q[:, 0], fit.explained[:, 0], 1)[0]
        assert slope == pytest.approx(min(most, 5.0), rel=0.15)
    assert left[0] == pytest.approx(1e-3) and left[1] > 0.1


def test_torque_columns_are_told_apart_by_what_each_joint_leaves():
    arm = pendulum(2)
    state = asked(arm)
    Y = regressor(arm.chain, state.q, state.v, state.a)
    fit = MassColumns(arm, state, unit_masses(arm.chain), Y)
    pairs = fit.residual_of_pairs()
    assert np.diagonal(pairs) == pytest.approx(1e-3) and pairs[1, 0] > 0.01
    own, rest = fit._columns[1], state.tau[:, 0]
    own = own[own.any(axis=1)]
    columns = own.T / np.linalg.norm(own, axis=1)
    left = rest - columns @ np.linalg.lstsq(columns, rest, rcond=1e-4)[0]
    assert pairs[1, 0] == pytest.approx((left**2).mean() / rest.var(), rel=0.05)
    assert len(own) == 10  # of 13, masses on the axis give no torque


@pytest.mark.parametrize("seed", [0, 1])
def test_a_torque_without_its_sign_is_told_at_its_joint(seed):
    arm = pendulum(2)
    state = asked(arm, more=0.02 * np.random.default_rng(seed).normal(size=(400, 2)))
    tau = state.tau.copy()
    tau[:, seed] = np.abs(tau[:, seed])
    recording = Recording(0.02 * np.arange(400), state.q, tau=tau, joints=arm.joints)
    (doubt,) = doubts_of_magnitude(recording, arm, replace(state, tau=tau))
    assert doubt.joints == (seed,) and doubt.is_error and doubt.evidence > 1.7
    assert f"tau{seed + 1} (hinge_{seed}) looks like the magnitude" in doubt.text
    assert doubt.remedy == "valid is a torque with its sign"
    whole = replace(recording, tau=state.tau)
    assert not list(doubts_of_magnitude(whole, arm, state))
    far = replace(recording, tau=tau + 0.2 * tau.max(axis=0))
    assert not list(doubts_of_magnitude(far, arm, replace(state, tau=far.tau)))


def test_a_joint_without_torque_has_no_variance_that_signs_could_change():
    """It warned of a division by zero."""
    arm = pendulum(2)
    state = asked(arm)
    tau = np.abs(state.tau) * [0.0, 1.0]
    recording = Recording(0.02 * np.arange(400), state.q, tau=tau, joints=arm.joints)
    found = doubts_of_magnitude(recording, arm, replace(state, tau=tau))
    assert {x.joints for x in found} <= {(1,)}


def test_links_of_a_file_leave_what_another_law_of_friction_leaves():
    """Three thousandths of the variance at least; any masses leave a thousandth."""
    arm = pendulum(2)
    chain, state = arm.chain, asked(arm)
    log = _Readings(
        arm, state, {"any": unit_masses(chain), "file": chain.inertial[:, :, None]}
    )
    for masses, least in (("any", 1e-3), ("file", 3e-3)):
        for rounds in (1, 2):
            left = log.residual(log.written, masses, rounds=rounds)
            np.testing.assert_allclose(left, least, rtol=1e-6)
    for blocks in (2, 4, 8):
        assert (log.residual(log.written, "file", blocks=blocks) >= 3e-3).all()
        assert log.residual(log.written, "any", blocks=blocks).min() < 2.9e-3


@pytest.mark.parametrize("links", [True, False])
def test_another_zero_is_asked_for_only_where_the_files_links_tell_it(links):
    """Masses that may be anywhere turn with their joint, as a contact shows."""
    arm = pendulum(2)
    state = asked(arm, more=0.02 * np.random.default_rng(0).normal(size=(400, 2)))
    masses = {"any": unit_masses(arm.chain)}
    if links:
        masses["file"] = arm.chain.inertial[:, :, None]
    shifts = {}
    for off in (0.0, np.pi / 2):
        logged = replace(state, q=state.q + [0.0, off])
        every = _others(_Readings(arm, logged, masses), True)
        shifts[off] = [x.shift.tolist() for x in every if np.any(x.shift)]
    assert shifts[0.0] == [] and ([0.0, -np.pi / 2] in shifts[np.pi / 2]) is links


def read_wrong(change, arm):
    state = asked(
        arm, more=0.02 * np.random.default_rng(0).normal(size=(400, arm.size))
    )
    state = change(state)
    t = 0.02 * np.arange(400)
    recording = Recording(t, state.q, tau=state.tau, joints=arm.joints)
    return list(doubts_of_physics(recording, arm, state))


def turned(state):
    return replace(state, tau=state.tau * [1.0, -1.0])


def swapped(state):
    return replace(state, tau=state.tau[:, ::-1])


def slowed(state):
    return replace(state, v=state.v * 4.0, a=state.a * 16.0)


@pytest.mark.parametrize(
    ("change", "says", "joints"),
    [
        (lambda s: s, None, ()),
        (turned, "tau2 (hinge_1) looks to count the other way round", (1,)),
        (swapped, "tau1 (hinge_0) and tau2 (hinge_1) look swapped", (0, 1)),
        (slowed, "time looks scaled by 1/4", ()),
        (lambda s: turned(slowed(s)), "the other way round", (1,)),
    ],
)
def test_a_log_that_is_read_wrong_is_told_by_what_masses_leave(change, says, joints):
    arm = pendulum(2)
    doubts = read_wrong(change, arm)
    assert bool(doubts) == (says is not None)
    if says:
        (doubt,) = [d for d in doubts if says in d.text]
        assert doubt.joints == joints and doubt.evidence > np.exp(0.5)


def test_speeds_that_confirm_a_clock_rule_out_another_one():
    def logged(state):
        slow = slowed(state)
        return replace(slow, logged=slow.v)

    assert not [d for d in read_wrong(logged, pendulum(2)) if d.channel == "t"]
    arm, state = pendulum(2), turned(asked(pendulum(2)))
    bare = Recording(0.02 * np.arange(400), state.q, joints=arm.joints)
    assert list(doubts_of_physics(bare, arm, state)) == []
    whole = replace(bare, tau=state.tau)
    assert list(doubts_of_physics(whole, None, state)) == []


# --- what a log covers ----------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.003, 0.3, 1.5, 5.0])
def test_identifiable_is_what_differs_from_zero_by_two_standard_errors(noise):
    """Of a pendulum: rotor with inertia, friction, offset, and its weight."""
    (m,) = (with_torque(m, (), noise) for m in swings(1, count=1, seconds=6.0))
    found = excitation_of(pendulum().chain, State(m.q, m.v, m.a, m.tau))
    q, v, a = m.q[:, 0], m.v[:, 0], m.a[:, 0]
    columns = {
        "Iyy_1": a, "mx_1": np.cos(q), "mz_1": np.sin(q),
        "viscous.coefficient[hinge_0]": v, "coulomb.level[hinge_0]": np.sign(v),
        "torque_offset.level[hinge_0]": np.ones_like(q),
    }  # fmt: skip
    X = np.stack(list(columns.values()), axis=1)
    unit = X / np.linalg.norm(X, axis=0)
    assert found.condition == pytest.approx(np.linalg.cond(unit), rel=1e-6)
    assert {x.split()[0] for x in found.names} == set(columns)
    theta, left = np.linalg.lstsq(X, m.tau[:, 0], rcond=None)[:2]
    error = np.sqrt(np.diagonal(np.linalg.inv(X.T @ X)) * left / len(X))
    unknown = np.abs(theta) < 1.96 * error
    assert {x.split()[0] for x in found.untold} == {
        name for name, x in zip(columns, unknown, strict=True) if x
    }


def test_a_joint_s_motion_torque_and_lag_are_those_of_its_columns():
    command = np.stack([np.interp(T + 0.05, T, WAVE), np.ones_like(T)], axis=1)
    recording = log(tau=3.0 * BOTH - 1.0, command=command)
    state = state_of(BOTH, np.gradient(BOTH, 0.01, axis=0))
    a, b = coverage_of(recording, state)
    assert (a.joint, b.joint) == ("a", "b")
    assert a.torque == (3 * WAVE.min() - 1, 3 * WAVE.max() - 1)
    assert a.lag == pytest.approx(0.05) and b.lag is None
    assert b.fastest == np.abs(state.v[:, 1]).max() and 0.98 < b.moving < 1.0
    bare = coverage_of(log(), state)
    assert [(x.torque, x.lag) for x in bare] == [(None, None)] * 2


def test_a_clock_s_jitter_and_gaps_are_those_of_its_steps():
    steps = np.tile([0.009, 0.010, 0.010, 0.011], 50)
    steps[100], steps[150] = 0.03, 0.5
    t = np.r_[0.0, np.cumsum(steps)]
    clock = clock_of(Recording(t, np.zeros((len(t), 1)), joints=("a",)))
    filled = np.delete(steps, 150)
    assert clock.jitter == pytest.approx(filled.std() / 0.01)
    assert (clock.holes, clock.samples) == (1, 201)
    assert (clock.duration, clock.rate) == pytest.approx((t[-1], 100.0))
    assert clock.missing == pytest.approx(2 / 201)
    assert all(x < y for x, y in pairwise(t))


def test_a_state_is_the_filtered_log():
    recording = log(v=np.gradient(BOTH, 0.01, axis=0), tau=2.0 * BOTH)
    found = filtered_state(recording)
    assert len(found.q) == 300
    np.testing.assert_allclose(found.tau, 2.0 * found.q, atol=0.02)
    np.testing.assert_allclose(found.logged, found.v, atol=0.05)
    bare = filtered_state(replace(recording, v=None, tau=np.zeros(0)))
    assert bare.logged is None and not bare.tau.any()


def test_errors_are_raised_before_anything_is_warned_of():
    small, large = Doubt("q", (), "small", "mend it"), Doubt("q", (), "large")
    single = replace(large, severity="error", text="one row", rows=True)
    with pytest.warns(HybridWarning) as said:
        raise_or_warn([small, large], "a.csv")
    assert [str(x.message) for x in said] == ["a.csv: small; mend it", "a.csv: large"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RecordingError, match="^recording: one row$"):
            raise_or_warn([small, single], "")
    with pytest.warns(HybridWarning) as said:
        raise_or_warn([single, small], "x", rows=False)
    assert len(said) == 2
    wrong = replace(large, severity="error")
    with pytest.raises(RecordingError, match="x: large"):
        raise_or_warn([single, wrong], "x", rows=False)


# --- a whole inspection ---------------------------------------------------------------


def two_links() -> Robot:
    ball = '<geom size=".05" mass="{}" pos="{} 0 0"/>'
    return Robot.load(
        mujoco.MjModel.from_xml_string(
            '<mujoco><compiler angle="radian"/><worldbody><body>'
            f'<joint name="a" axis="0 1 0" range="-3 3"/>{ball.format(2, 0.2)}'
            '<body pos=".3 0 0"><joint name="b" axis="0 1 0" range="-3 3"/>'
            f"{ball.format(1, 0.2)}</body></body></worldbody></mujoco>"
        )
    )


def right_log(arm) -> Recording:
    t = 0.01 * np.arange(600)[:, None]
    w, phase = np.array([[2.0, 3.1], [5.3, 4.1]])[:, None], np.array([0.3, 1.1])
    q = 0.6 * np.sin(w * t + phase).sum(axis=0)
    v = 0.6 * (w * np.cos(w * t + phase)).sum(axis=0)
    a = -0.6 * (w**2 * np.sin(w * t + phase)).sum(axis=0)
    tau = inverse_dynamics(arm.chain, arm.chain.inertial, q, v, a)
    return Recording(t[:, 0], q, v=v, tau=tau, joints=arm.joints, source="log")


def test_an_error_in_samples_ends_the_checks_and_one_in_motion_does_not_hide_joints():
    arm = two_links()
    x = right_log(arm)
    found = inspect_recording(x, arm)
    assert found.doubts == () and len(found.joints) == 2 and not found.misleads
    assert found.excitation is not None and found.recording is not None
    broken = replace(x, q=put(x.q, np.s_[50, 0], x.q[50, 0] + 0.5), tau=x.tau[:, ::-1])
    samples = inspect_recording(broken, arm)
    assert samples.misleads and samples.joints == () and samples.excitation is None
    assert {d.channel for d in samples.doubts} == {"q"}
    fast = inspect_recording(replace(x, v=3.0 * x.v), arm)
    assert fast.misleads and len(fast.joints) == 2
    assert inspect_recording(replace(x, tau=np.zeros(0)), arm).excitation is None
    assert inspect_recording(x).excitation is None
    named = replace(x, q=x.q[:, ::-1], v=x.v[:, ::-1], tau=x.tau[:, ::-1])
    named = replace(named, joints=arm.joints[::-1])
    assert inspect_recording(named, arm).doubts == ()
    (checked,) = check_recordings([named], arm)
    np.testing.assert_allclose(checked.q, x.q)


def test_an_inspection_as_names_and_numbers():
    arm = two_links()
    x = right_log(arm)
    found = inspect_recording(x, arm).as_dict()
    assert found["source"] == "log" and found["channels"] == ["q", "tau", "v"]
    assert found["misleads"] is False and found["doubts"] == []
    assert [j["joint"] for j in found["joints"]] == ["a", "b"]
    assert found["clock"]["samples"] == 600 and found["reading"] is None
    assert found["excitation"]["names"] and found["excitation"]["condition"] > 1.0
