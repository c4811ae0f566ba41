"""Frozen and saturated channels: found where they are, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hybrid.diagnosis.gap.faults import find_faults
from hybrid.inspect import check_recordings
from hybrid.recording import Recording
from hybrid.robot import Robot

T = np.arange(0.0, 10.0, 0.004)


def log(noise=1e-5, seed=0):
    """Two joints that move, one of them through its turning points slowly."""
    rng = np.random.default_rng(seed)
    q = np.stack([np.sin(T), np.sin(0.4 * T)], axis=1)
    tau = np.stack([5 * np.cos(T), 3 * np.sign(np.cos(0.4 * T)) + q[:, 1]], axis=1)
    q = q + noise * rng.standard_normal(q.shape)
    tau = tau + 0.05 * rng.standard_normal(tau.shape)
    return Recording(t=T, q=q, tau=tau)


@given(
    seed=st.integers(0, 1000),
    encoder=st.sampled_from([1e-6, 1e-4, 1e-3]),
    torque=st.sampled_from([1e-3, 0.05, 0.3]),
)
@settings(max_examples=25)
@example(seed=87, encoder=1e-6, torque=0.3)  # holds its highest level for a second
def test_a_sound_log_has_none_however_coarse_its_sensors(seed, encoder, torque):
    sound = log(seed=seed)
    q = encoder * np.round(sound.q / encoder)
    tau = torque * np.round(sound.tau / torque)
    found = find_faults(replace(sound, q=q, tau=tau))
    assert not found.posture.any()
    assert found.notes == ()


def test_an_arm_that_waits_has_none():
    moves = log(noise=0.0)
    waits = T > 6.0
    q, tau = moves.q.copy(), moves.tau.copy()
    q[waits], tau[waits] = q[waits][0], 1.0
    assert find_faults(replace(moves, q=q, tau=tau)).torque.sum() == 0


@pytest.mark.filterwarnings("error::hybrid.errors.HybridWarning")
@pytest.mark.parametrize("ticks", [1, 3])
def test_a_joint_at_rest_is_not_frozen_though_its_encoder_ticks(ticks):
    tick, ticked = 1e-4, np.random.default_rng(2).random(len(T)) < 0.003
    q = log().q.copy()
    q[:, 1] = 0.3 + tick * np.where(np.cumsum(ticked) % 2, ticks, 0)
    q[100:105, 1] += tick
    at_rest = replace(log(), q=q)
    assert find_faults(at_rest).notes == ()
    robot = Robot.load(MODELS / "planar.xml")
    check_recordings([replace(at_rest, joints=robot.joints)], robot)


def test_a_frozen_torque_is_found():
    tau = log().tau.copy()
    tau[1000:1500, 1] = tau[1000, 1]
    found = find_faults(replace(log(), tau=tau))
    np.testing.assert_array_equal(np.flatnonzero(found.torque[:, 1]), range(1000, 1500))
    assert not found.torque[:, 0].any()
    assert found.notes == ("torque of joint_2 is frozen for 20%",)


def test_a_frozen_torque_of_a_coarse_sensor_is_found():
    sound = log(seed=1)
    tau = 0.3 * np.round(sound.tau / 0.3)
    tau[500:1500, 1] = tau[500, 1]
    found = find_faults(replace(sound, tau=tau))
    assert found.torque[500:1500, 1].all() and not found.torque[:, 0].any()


def test_a_frozen_encoder_spoils_every_joint():
    q = log().q.copy()
    q[500:1250, 0] = q[500, 0]
    found = find_faults(replace(log(), q=q))
    np.testing.assert_array_equal(np.flatnonzero(found.posture), range(500, 1250))
    assert "position of joint_1 is frozen" in found.notes[0]


@pytest.mark.parametrize("limit", [2.0, 4.0])
def test_a_saturated_torque_is_found(limit):
    tau = log().tau.copy()
    tau[:, 0] = np.clip(tau[:, 0], -limit, limit)
    found = find_faults(replace(log(), tau=tau))
    np.testing.assert_array_equal(found.torque[:, 0], np.abs(tau[:, 0]) == limit)
    assert "saturated" in found.notes[0]


def test_a_leap_of_torque_on_the_way_is_left_out_and_told():
    sound = log()
    leap = np.flatnonzero(np.diff(np.sign(np.sin(T))) != 0)[1]  # at full speed
    tau = sound.tau.copy()
    tau[leap:, 0] += 6.0
    found = find_faults(replace(sound, tau=tau))
    assert {leap - 1, leap} == {*np.flatnonzero(found.posture)}
    (note,) = found.notes
    assert "jumps" in note and f"{T[leap - 1]:.3g} s" in note
    assert find_faults(sound).notes == ()  # dry friction turns at rest
