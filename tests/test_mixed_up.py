"""A log whose columns are in another order, or count the other way, names no cause."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import MODELS
from hybrid.diagnose.mixed_up import mixed_up
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.diagnose.diagnose import examine
from hybrid.diagnose.measure import measure_gap
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.payload import Payload
from hybrid.plant import Plant, simulate
from hybrid.robot import Robot

_LIMITED = Robot.load(MODELS / "coman_like.xml")
FREE = np.full(_LIMITED.size, np.inf)
# Positions beyond a joint's limits are refused before anything is asked.
ROBOT = replace(_LIMITED, q_min=-FREE, q_max=FREE)
CHANNELS = pytest.mark.parametrize(
    ("words", "which"),
    [
        ("the columns", {}),
        ("the positions", {"torque": False}),
        ("the torques", {"position": False}),
    ],
)


def logs(*effects):
    plant = Plant(_LIMITED, effects, nominal=_LIMITED)
    return simulate(plant, trajectories=2, duration=5.0, seed=1)


@cache
def usual():
    """Logs of an arm that lacks a little."""
    return logs(Coulomb((1,), {"level": 3.0}))


def read(recordings, order, sign, *, position=True, torque=True):
    """Logs with columns in another order and sign."""
    return [
        replace(
            x,
            q=sign * x.q[:, order] if position else x.q,
            tau=sign * x.tau[:, order] if torque else x.tau,
            v=None,
        )
        for x in recordings
    ]


def swap(a, b):
    order = np.arange(ROBOT.size)
    order[[a, b]] = b, a
    return order


def flip(a):
    return np.where(np.arange(ROBOT.size) == a, -1.0, 1.0)


@pytest.mark.parametrize("pair", [(0, 2), (1, 2), (2, 4)])
@CHANNELS
def test_two_joints_that_are_swapped_are_said_to_be(words, which, pair):
    swapped = read(usual(), swap(*pair), flip(None), **which)
    a, b = (ROBOT.joints[j] for j in pair)
    said = mixed_up(measure_gap(ROBOT, swapped))
    assert said.startswith(f"{words} of {a} and {b} seem to be swapped")


@CHANNELS
def test_a_joint_that_counts_the_other_way_round_is_said_to(words, which):
    turned = read(usual(), np.arange(ROBOT.size), flip(2), **which)
    said = mixed_up(measure_gap(ROBOT, turned))
    assert said.startswith(f"{words} of {ROBOT.joints[2]} seem to count the other")


def test_such_a_log_names_no_cause():
    swapped = read(usual(), swap(1, 2), flip(None))
    diagnosis = examine(ROBOT, swapped).diagnosis
    assert diagnosis.verdict == "unexplained" and diagnosis.findings == ()
    assert any("seem to be swapped" in x for x in diagnosis.warnings)


@pytest.mark.filterwarnings("ignore:the drive of")  # is at its limit: a gap as well
@given(
    mass=st.floats(0.1, 3.0),
    level=st.floats(0.0, 20.0),
    joint=st.integers(0, ROBOT.size - 1),
)
@settings(max_examples=8)
def test_no_gap_however_large_is_taken_for_that(mass, level, joint):
    arm = tuple(range(ROBOT.size))
    sizes = {"mass": 1.0, "mz": 0.1, "Ixx": 0.012, "Iyy": 0.012, "Izz": 0.002}
    load = Payload(arm, {name: mass * x for name, x in sizes.items()})
    recordings = logs(load, Coulomb((joint,), {"level": level}))
    assert mixed_up(measure_gap(ROBOT, recordings)) is None
