"""Parts of the diagnosis by themselves, on a log without noise or made-up numbers."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import arm

from hybrid.diagnosis.answer.command import _Servo
from hybrid.diagnosis.answer.diagnosis import Diagnosis
from hybrid.diagnosis.evidence.shapes import nudges, shape_units
from hybrid.diagnosis.gap.background import background
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.controller_gain import ControllerGain
from hybrid.effects.counterbalance import Counterbalance
from hybrid.plant import Noise, Plant, simulate


@cache
def quiet_logs():
    robot = arm("planar")
    plant = Plant(robot, [], nominal=robot, noise=Noise.none(robot.size))
    return robot, simulate(plant, trajectories=1, duration=4.5, seed=1)


def test_at_the_end_of_a_range_the_change_is_that_to_what_lies_within():
    robot, recordings = quiet_logs()
    gap = measure_gap(robot, recordings)
    law = {"spring": 1.0, "preload": 0.5, "crank_ratio": 0.5}
    end = Counterbalance((1,), {**law, "dead_centre": 4.0})
    (before, now) = (
        gap.columns(end.at({"dead_centre": x}))[1] @ end.gain_values
        for x in (3.999, 4.0)
    )
    expected = (now - before) / 1e-3 * shape_units(gap, end)[0]
    error = nudges(gap, end)[0][1][:, 0] - expected
    assert np.linalg.norm(error) < 0.2 * np.linalg.norm(expected)  # one-sided


def test_declared_numbers_times_their_columns_are_the_torque_of_the_file():
    robot, recordings = quiet_logs()
    spring = {"stiffness": np.array([30.0, 5.0]), "springref": np.array([0.5, 0.0])}
    chain = replace(robot.chain, armature=np.zeros(2))
    sprung = replace(robot, chain=chain, frictionloss=np.zeros(2), **spring)
    gap = measure_gap(sprung, recordings)
    found = np.zeros_like(gap.left)
    for block, size in zip(*background(gap), strict=True):
        if len(size) == 1:
            ((j, column),) = block.items()
            found[:, j] += column[:, 0] * size[0]
    (m,) = gap.motions
    own = sprung.joint_torque(m.q, m.v, m.a)
    np.testing.assert_allclose(found, gap.samplers[0](own), atol=1e-9)


def test_of_a_joint_that_does_not_move_nothing_is_said_to_be_measured():
    found = Diagnosis(
        "arm", ("a", "b"), rms=(0.0, 2.0), relative=(0.0, 0.5), noise_floor=(0.0, 0.1),
        where=(), findings=(), verdict="no_gap", unexplained=0.0, background=0.01,
    ).as_dict()  # fmt: skip
    gap = {"rms": [None, 2.0], "relative": [None, 0.5], "noise_floor": [None, 0.1]}
    assert {x: found["gap"][x] for x in gap} == gap


def test_two_effects_of_a_servo_share_what_they_explain_together():
    """Each by what it adds, alone and beside the other (Shapley)."""
    both = CommandLatency, ControllerGain
    sizes = {(False, False): 9.0, (True, False): 5.0, (False, True): 4.0}
    fits = {
        key: SimpleNamespace(left=np.full(10, size))
        for key, size in {**sizes, (True, True): 1.0}.items()
    }
    servo = _Servo(0, None, None, fits, both, (), noise=2.0, scale=False)
    late, off = map(servo.share, both)
    assert late + off == pytest.approx(5 * (9.0**2 - 1.0**2))
    assert late == pytest.approx(5 * ((4.0**2 - 1.0**2) + (9.0**2 - 5.0**2)) / 2)
    alone = replace(servo, found=both[:1])
    assert alone.share(both[0]) == pytest.approx(5 * (4.0**2 - 1.0**2))
    assert alone.share(both[1]) == 0.0
