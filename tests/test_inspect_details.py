"""What single checks of a log say of made-up samples: rows, clocks, scales."""

import warnings

import numpy as np
import pytest
from simulated import arm

from hybrid.dynamics import inverse_dynamics
from hybrid.inspect.leaps import doubts_of_rows
from hybrid.inspect.samples import doubts_of_samples
from hybrid.inspect.scale import doubts_of_scale, scales
from hybrid.inspect.state import State
from hybrid.recording import Recording

T = np.arange(0.0, 5.0, 0.01)
SMOOTH = np.sin(2.0 * T) + 0.3 * np.sin(7.0 * T)


def log(x, t=T, tau=None) -> Recording:
    return Recording(t, x[:, None], tau=tau, joints=("a",), source="log")


def moved(rows, by: float):
    x = SMOOTH.copy()
    x[rows] += by
    return x


@pytest.mark.parametrize(
    ("x", "says"),
    [
        (SMOOTH, []),
        (moved(200, 0.3), ["glitch: "]),
        (moved(200, -0.3), ["glitch: "]),
        (moved([200, 300], 0.3), ["the first of 2"]),
        (moved(slice(200, None), 0.3), ["jumps from"]),
        (moved(slice(200, None), 2 * np.pi), ["a turn of the encoder"]),
        (np.repeat(SMOOTH[::5], 5), ["holds each sample for 5 rows"]),
    ],
)
def test_rows_that_no_arm_can_have_made_are_told(x, says):
    doubts = [d for d in doubts_of_rows(log(x)) if d.channel == "q"]
    texts = [d.text for d in doubts]
    assert len(texts) >= len(says) and bool(texts) == bool(says), texts
    assert all(any(word in text for text in texts) for word in says), texts


@pytest.mark.parametrize(
    ("rate", "unit", "name"),
    [
        (50.0, 1e3, "milliseconds"),
        (900.0, 1e3, "milliseconds"),
        (50.0, 1e6, "microseconds"),
        (15e3, 1e6, "microseconds"),
        (50.0, 1e9, "nanoseconds"),
        (15e3, 1e9, "nanoseconds"),
    ],
)
def test_a_clock_in_another_unit_is_told_at_every_usual_rate(rate, unit, name):
    t = np.arange(len(T)) / rate * unit
    clock = [d for d in doubts_of_samples(log(SMOOTH, t)) if d.channel == "t"]
    assert [name in d.text for d in clock] == [True]


def state_of(robot, factor=1.0) -> State:
    """What the links of the file ask for along a motion, times a factor."""
    rng, t = np.random.default_rng(0), np.arange(0.0, 10.0, 0.02)[:, None]
    w, phase = rng.uniform(1.0, 6.0, (2, 3, 1, robot.size))
    angle = w * t + phase
    q = np.sin(angle).sum(axis=0)
    v, a = (w * np.cos(angle)).sum(axis=0), (-(w**2) * np.sin(angle)).sum(axis=0)
    a_rotor = robot.chain.armature * a
    tau = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a) + a_rotor
    return State(q, v, a, factor * tau, None, np.full(robot.size, np.nan))


def said(factor) -> list[str]:
    robot = arm("planar")
    state = state_of(robot, factor)
    recording = Recording(0.02 * np.arange(len(state.q)), state.q, tau=state.tau)
    return [d.text for d in doubts_of_scale(recording, robot, state)]


@pytest.mark.parametrize("off", [0.5, 1.0, 2.0])
def test_torque_in_another_unit_is_told_by_its_scale(off):
    assert said(1.0) == []
    for factor, words in ((1e-3, "kN·m"), (1e3, "mN·m"), (1e-2, "gear 1:")):
        (text,) = said(off * factor)
        assert words in text and f"{off * factor:.3g} times" in text


def test_a_torque_that_is_zero_has_no_scale():
    robot = arm("planar")
    state = state_of(robot)
    state.tau[:, 1] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scales(robot, state)
    assert found[0] == pytest.approx(1.0, rel=0.05)
    assert np.isnan(found[1])
