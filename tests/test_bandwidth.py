"""Torque that its logger has low-pass filtered is compared through that filter."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from coarse import simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, filtfilt, lfilter
from simulated import arm, quiet

from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.diagnose import examine
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.viscous import Viscous
from hybrid.exports.simulator.check import gaps
from hybrid.identification import identify, validate
from hybrid.identification.preparation import motions_from_logs
from hybrid.inspect import inspect_recording
from hybrid.model import DynamicModel
from hybrid.online import OnlineIdentifier, Sample
from hybrid.plant import random_fourier
from hybrid.report.fit import excerpt_figure
from hybrid.signals.bandwidth import torque_bandwidth

RATE, BAND = 250.0, 2.5
LEVEL = 4.0  # N.m, of dry friction that the simulator lacks


def friction(duration=20.0, seed=0):
    """Friction along a slow motion, which has all frequencies, shape (N, 2)."""
    robot = arm("planar")
    motion = random_fourier(robot, duration=duration, rate=RATE, seed=seed)
    return 3.0 * np.sign(motion.v) + 2.0 * motion.v


@settings(max_examples=20, deadline=None)
@given(band=st.floats(1.5, 6.0), order=st.integers(3, 6), seed=st.integers(0, 9))
def test_the_bandwidth_of_any_steep_filter_is_found(band, order, seed):
    """Its frequency of gain one half, run forward and backward."""
    torque = friction(seed=seed)
    filtered = filtfilt(*butter(order, band, fs=RATE), torque, axis=0)
    found = torque_bandwidth([(filtered, torque)], RATE, 20.0)
    # A gain of 1/√2 in each of both passes.
    assert found == pytest.approx(band, rel=0.15)


@pytest.mark.parametrize(
    "logged",
    [
        lambda x, rng: x,
        lambda x, rng: x + 0.05 * rng.standard_normal(x.shape),
        lambda x, rng: lfilter([0.1], [1.0, -0.9], x, axis=0),  # a lag of first order
        lambda x, rng: np.tanh(3.0 * x),  # friction that rises gradually
        lambda x, rng: 0.2 * x,
    ],
)
def test_other_torque_is_not_filtered(logged):
    torque = friction()
    seen = logged(torque, np.random.default_rng(0))
    assert torque_bandwidth([(seen, torque)], RATE, 20.0) == np.inf


def test_smooth_torque_is_not_filtered():
    """Differentiated positions are rough, where the torque of a right log is not."""
    rng = np.random.default_rng(0)
    smooth = random_fourier(arm("planar"), duration=20.0, rate=RATE, seed=1).a
    rough = smooth + 1e-3 * smooth.std() * rng.standard_normal(smooth.shape)
    assert torque_bandwidth([(smooth, rough)], RATE, 20.0) == np.inf


def test_what_a_model_lacks_is_no_filter():
    torque = friction()
    known = 2.0 * np.gradient(torque, axis=0)
    assert torque_bandwidth([(torque, torque + known)], RATE, 20.0) == np.inf
    assert torque_bandwidth([(torque, 0 * torque)], RATE, 20.0) == np.inf


@cache
def filtered_logs(count=4):
    """Logs of an arm with dry friction, whose torque was filtered."""
    robot = arm("planar")
    truth = [Coulomb((0,), {"level": LEVEL}), Viscous((1,), {"coefficient": 0.5})]
    logs = simulate(robot, truth, trajectories=count, duration=9.0, seed=3)
    b, a = butter(4, BAND, fs=logs[0].rate)
    return [replace(x, tau=filtfilt(b, a, x.tau, axis=0)) for x in logs]


@cache
def rigid_fit():
    """A fit to three of these logs, and what it warned of."""
    return quiet(identify, arm("planar"), filtered_logs()[:3], stages=("rigid",))


def load_model_again(model):
    with TemporaryDirectory() as folder:
        model.save(Path(folder) / "model.json")
        return DynamicModel.load(Path(folder) / "model.json")


@pytest.mark.study
def test_identification_finds_the_friction_behind_a_filter():
    robot, logs = arm("planar"), filtered_logs()
    fit, told = rigid_fit()
    plain, _ = quiet(identify, robot, logs[:3], stages=("rigid",), cutoff=BAND)
    found = {(e.id, e.joints): e.values for e in fit.model.effects}
    declared = float(robot.frictionloss[0])
    level = found["coulomb", (0,)]["level"] - declared
    assert level == pytest.approx(LEVEL, rel=0.05)
    rows, said = quiet(validate, fit.model, logs[3:])
    assert load_model_again(fit.model).band == fit.model.band < 1.2 * BAND
    tracker = OnlineIdentifier.from_model(fit.model, rate=logs[3].rate)
    changes = [
        tracker.update(Sample(float(t), q, tau))
        for t, q, tau in zip(logs[3].t, logs[3].q, logs[3].tau, strict=True)
    ]
    assert not any(changes)
    assert np.all(tracker.error < 0.1 * LEVEL)
    for texts in (told, said):
        assert any("low-pass filtered at about 2." in text for text in texts)
    assert rows.rows[-1].relative.max() < 0.02
    assert np.all(fit.held_out["IRLS"] <= 1.1 * plain.held_out["IRLS"])


def test_a_picture_shows_models_as_the_logger_does():
    """Sharp friction drawn over smooth torque would look like an error of the model."""
    fit, _ = rigid_fit()
    figure = excerpt_figure(fit.model, filtered_logs()[3])
    residuals = [x for x in figure.axes if "residual" in x.get_ylabel()]
    most = [np.abs(line.get_ydata()).max() for x in residuals for line in x.lines]
    assert len(most) >= 2 and max(most) < 0.25 * LEVEL


def test_an_export_is_compared_with_a_log_as_it_is_validated():
    fit, _ = rigid_fit()
    model, log = fit.model, filtered_logs()[3]
    (motion,), _ = motions_from_logs([log], model.cutoff)
    still = replace(motion, v=motion.v * [1.0, 0.0])
    rows, _ = quiet(validate, model, [log])
    whole, told = quiet(gaps, model, model.robot, [motion])
    np.testing.assert_allclose(whole["model"], rows.rows[-1].rms)
    assert "low-pass filtered at about 2." in told[0]
    found, _ = quiet(gaps, model, model.robot, [still])
    assert np.isfinite(found["exported"]).tolist() == [True, False]


def test_an_inspection_tells_a_filter():
    log = filtered_logs()[0]
    (doubt,) = inspect_recording(log, arm("planar")).doubts
    assert not doubt.is_error and "filtered at about 2." in doubt.text
    plain = simulate(arm("planar"), trajectories=1, duration=12.0, seed=3)
    assert inspect_recording(plain[0], arm("planar")).doubts == ()


def test_a_diagnosis_finds_the_friction_behind_a_filter():
    """Sharp friction beside smooth torque looks like any friction but dry one."""
    result = examine(arm("planar"), filtered_logs())
    moved = with_motion_gap(result, np.random.default_rng(0)).diagnosis
    assert "no replay" in moved.warnings[-1]
    found = {(f.effect, f.joints) for f in result.diagnosis.findings}
    assert found == {("coulomb", ("shoulder",)), ("viscous", ("elbow",))}
    assert result.gap.cutoff == pytest.approx(BAND, rel=0.15)
    (level,) = result.diagnosis.findings[0].parameters
    assert level.interval[0] < LEVEL < level.interval[1]
    assert any("filtered at about" in text for text in result.diagnosis.warnings)


@pytest.mark.study
def test_repeats_of_a_healthy_arm_show_no_change_behind_a_filter():
    robot, logs = arm("planar"), filtered_logs()
    fit, _ = quiet(identify, robot, logs[:2], stages=("rigid",))
    again = examine(fit.model, logs[2:])
    assert again.diagnosis.verdict == "no_gap"
    worn = Coulomb((1,), {"level": 2.0})
    b, a = butter(4, BAND, fs=logs[0].rate)
    more = [
        replace(x, tau=x.tau + filtfilt(b, a, friction_of(worn, x), axis=0))
        for x in logs[2:]
    ]
    found = examine(fit.model, more).diagnosis.findings
    assert [(f.effect, f.joints) for f in found] == [("coulomb", ("elbow",))]


def friction_of(effect, log):
    """Torque of dry friction along a log, shape (N, n)."""
    v = np.gradient(log.q, log.t, axis=0)
    return effect.values["level"] * np.sign(v) * (np.arange(2) == effect.joints[0])


@pytest.mark.study
def test_a_push_is_found_behind_a_filter():
    """At the rate of such a gap a sample is longer than a chunk of time."""
    first, *rest = filtered_logs()
    since = first.t - first.t[0]
    share = np.where(np.abs(since - 6.3) < 0.3, np.cos((since - 6.3) * np.pi / 0.6), 0)
    b, a = butter(4, BAND, fs=first.rate)
    torque = filtfilt(b, a, share[:, None] * np.array([9.0, 6.0]), axis=0)
    logs = [replace(first, tau=first.tau + torque), *rest]
    (event,) = examine(arm("planar"), logs).diagnosis.events
    assert event.start < 6.3 < event.end and event.end - event.start < 1.2
