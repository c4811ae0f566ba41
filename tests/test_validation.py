"""Scores on held-out motion: of what, over which samples, and how they are kept."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from coarse import simulate
from simulated import arm, quiet

from hybrid.dynamics import inverse_dynamics, stacked_base
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.viscous import Viscous
from hybrid.errors import (
    HybridWarning,
    IdentificationError,
    ModelFileError,
    RecordingError,
)
from hybrid.identification import DynamicModel, identify, predict, validate
from hybrid.identification.validation import noise_floor
from hybrid.plant import random_fourier
from hybrid.recording import Recording
from hybrid.report.output import plain
from hybrid.report.table import table_from_validation
from hybrid.signals import Sampler, motion_from_recording


@pytest.fixture(scope="module")
def logs():
    return simulate(arm("planar"), trajectories=4, duration=6, seed=1)


@pytest.fixture(scope="module")
def fit(logs):
    return quiet(identify, arm("planar"), logs[:3])[0]


def test_rows_go_from_the_plainest_model_to_the_fullest(fit, logs):
    found = validate(fit.model, logs[3:])
    names = [row.name for row in found.rows]
    assert names[:3] == ["LS", "WLS", "IRLS"] and names[-1] == fit.model.stage
    assert len(set(names)) == len(names)
    assert found.joints == ("shoulder", "elbow") and found.robot == "planar"
    linear = [row.mean for row in found.rows if not row.name.startswith("+")]
    assert found.reduction == 1 - found.rows[-1].mean / min(linear)


def test_errors_are_compared_with_a_fit_that_survives_poor_excitation():
    """Small strokes hardly tell masses: plain least squares fail on large ones."""
    robot = arm("coman_like")
    near = replace(robot, q_min=0.05 * robot.q_min, q_max=0.05 * robot.q_max)
    small = simulate(near, trajectories=2, duration=4, seed=2)
    fit, warnings = quiet(identify, robot, small, stages=("rigid",))
    assert any("excites the arm poorly" in x for x in warnings)
    found = validate(fit.model, simulate(robot, trajectories=2, duration=4, seed=1))
    plain = min(row.mean for row in found.rows if row.name in ("LS", "WLS", "IRLS"))
    assert plain > 3 * found.rows[-1].mean
    assert (found.reference.name, found.reduction) == ("rigid", 0.0)
    assert table_from_validation(found).header[-1] == "vs rigid"


def test_a_log_that_the_model_was_identified_from_is_no_validation(fit, logs, tmp_path):
    fit.model.save(tmp_path / "model.json")
    loaded = DynamicModel.load(tmp_path / "model.json")
    with pytest.warns(HybridWarning, match=f"{logs[2].source}: .* this is no valid"):
        validate(loaded, [logs[2], logs[3]])
    validate(loaded, [replace(logs[2], tau=1.1 * logs[2].tau), logs[3]])


def test_a_log_that_is_given_twice_counts_once(fit, logs):
    """A copy in another fold would be no motion that the fit has not seen."""
    copy = replace(logs[0], source="copy")
    twice, warnings = quiet(identify, arm("planar"), [*logs[:3], copy])
    assert f"copy: the same log as {logs[0].source}; it counts once" in warnings
    np.testing.assert_array_equal(twice.estimate.theta, fit.estimate.theta)
    assert twice.model.logs == fit.model.logs


def test_the_other_part_of_a_log_is_a_validation(logs):
    motion = motion_from_recording(logs[0], cutoff=20.0)
    early = motion.t - motion.t[0] < 4.0
    fitting, scoring = (
        replace(motion, mask=motion.mask & use) for use in (early, ~early)
    )
    chosen = [fitting, *logs[1:3]]
    fit, _ = quiet(identify, arm("planar"), chosen, cutoff=10.0, stages=("rigid",))
    validate(fit.model, [scoring])
    with pytest.warns(HybridWarning, match="this is no valid"):
        validate(fit.model, [fitting])


def test_scores_are_those_of_predicted_and_measured_torque(fit, logs):
    """Worked out here by hand: predict at the rate of the log, take moving samples."""
    model, cutoff = fit.model, fit.model.cutoff
    motion = motion_from_recording(logs[3], cutoff=2 * cutoff)
    found = validate(model, logs[3:])
    moving = (np.abs(motion.v) > model.standing) & motion.mask[:, None]
    measured = np.where(moving, logs[3].tau, np.nan)
    for row in found.rows:
        each = model if row.name == model.stage else model.simpler[row.name]
        rms = np.sqrt(np.nanmean((measured - predict(each, logs[3])) ** 2, axis=0))
        np.testing.assert_allclose(row.rms, rms, rtol=1e-10)
        size = np.sqrt(np.nanmean(measured**2, axis=0))
        np.testing.assert_allclose(row.relative, rms / size, rtol=1e-10)
        assert row.mean == pytest.approx(rms.mean())
    assert found.samples == moving.sum(axis=0).max()
    assert found.seconds == pytest.approx(6.0)


def test_samples_at_which_a_joint_stands_do_not_count(fit, logs):
    """A brake holds with any torque: what it shows there changes no score."""
    motion = motion_from_recording(logs[3], cutoff=np.inf)
    model = replace(fit.model, cutoff=np.inf, simpler={})
    standing = np.array([0.2, 0.3])
    spoiled = np.where(np.abs(motion.v) <= standing, 1e6, motion.tau)
    before = validate(model, [motion], standing=standing)
    after = validate(model, [replace(motion, tau=spoiled)], standing=standing)
    np.testing.assert_array_equal(before.rows[-1].rms, after.rows[-1].rms)
    assert before.samples < validate(model, [motion]).samples


def test_masked_samples_do_not_count(fit, logs):
    motion = motion_from_recording(logs[3], cutoff=np.inf)
    model = replace(fit.model, cutoff=np.inf, simpler={})
    some = replace(motion, mask=motion.mask & (motion.t < 3.0))
    tau = np.where(some.mask[:, None], motion.tau, 1e6)
    found, expected = (validate(model, [m]) for m in (replace(some, tau=tau), some))
    np.testing.assert_array_equal(found.rows[-1].rms, expected.rows[-1].rms)


def test_the_truth_leaves_nothing_but_the_noise():
    robot = arm("planar")
    log = simulate(robot, trajectories=1, duration=4, seed=0)[0]
    truth = quiet(identify, robot, [log, log], stages=("rigid",))[0].model
    friction = [Viscous((j,), {"coefficient": 2.0}) for j in range(2)]
    friction += [Coulomb((j,), {"level": 1.0}) for j in range(2)]
    motion = motion_from_recording(log, cutoff=20.0)
    rigid = truth.base.with_values(
        truth.base.mapping[:, :20] @ robot.chain.inertial.ravel()
    )
    truth = replace(truth, base=rigid, effects=tuple(friction), simpler={})
    tau = inverse_dynamics(
        robot.chain, robot.chain.inertial, motion.q, motion.v, motion.a
    )
    tau += 2.0 * motion.v + np.sign(motion.v)
    exact = validate(truth, [replace(motion, tau=tau)])
    assert exact.rows[-1].rms.max() < 1e-9
    noise = np.random.default_rng(0).normal(size=tau.shape)
    noisy = validate(truth, [replace(motion, tau=tau + noise)])
    np.testing.assert_allclose(noisy.rows[-1].rms, noisy.noise_floor, rtol=0.15)


def test_steps_of_dry_friction_are_no_noise(fit, logs):
    """Joints that turn back often make power at all frequencies."""
    motion = motion_from_recording(logs[3], cutoff=20.0)
    friction = [Coulomb((j,), {"level": 5.0}) for j in range(2)]
    model = replace(fit.model, effects=tuple(friction), remainder=None, simpler={})
    tau = model.predict(motion)
    noise = 0.1 * np.random.default_rng(0).normal(size=tau.shape)
    floor = validate(model, [replace(motion, tau=tau + noise)]).noise_floor
    np.testing.assert_allclose(floor, [0.1, 0.1], rtol=0.1)


def test_a_bad_model_does_not_raise_the_noise_floor(fit, logs):
    noise = 0.5 * np.random.default_rng(0).normal(size=logs[3].tau.shape)
    log = replace(logs[3], tau=logs[3].tau + noise)
    ripples = [TorqueRipple((j,), {"cosine": 9.0, "periods": 500.0}) for j in range(2)]
    good = replace(fit.model, simpler={"good": replace(fit.model, simpler={})})
    bad = replace(good, effects=(*good.effects, *ripples))
    found, best = (validate(x, [log]) for x in (bad, good))
    np.testing.assert_allclose(found.noise_floor, best.noise_floor, rtol=1e-9)
    assert found.rows[-1].mean > 2 * found.rows[0].mean
    assert all((found.noise_floor <= row.rms).all() for row in found.rows)


def test_a_joint_at_rest_has_no_error_and_does_not_count(logs):
    """It tells nothing of friction; encoders repeat their value to the last digit."""
    held = np.array([1.0, 0.0])
    still = [replace(x, q=held * x.q + 0.3, v=held * x.v) for x in logs]
    fit, warnings = quiet(identify, arm("planar"), still[:3], stages=("rigid",))
    assert any("elbow farther" in x for x in warnings)
    assert fit.condition == np.inf
    for rms in fit.held_out.values():
        assert np.isfinite(rms[0]) and np.isnan(rms[1])
    found = validate(fit.model, still[3:])
    assert found.rows[-1].mean == found.rows[-1].rms[0]
    table = table_from_validation(found)
    assert {row[2] for row in table.rows[:-1]} == {"–"}
    assert plain(found.as_dict())["rows"][0]["rms"][1] is None


@pytest.mark.parametrize("cutoff", [10.0, 40.0])
def test_the_noise_floor_is_that_of_white_noise_at_the_rate_of_the_log(logs, cutoff):
    rng = np.random.default_rng(0)
    motion = motion_from_recording(logs[3], cutoff=100.0)
    noise = rng.normal(size=(20, *motion.tau.shape)) * [0.5, 0.1]
    motions = [replace(motion, tau=motion.tau + e) for e in noise]
    smooth = Sampler(motion.rate, 20.0, 1)(motion.tau)
    motions = [replace(motion, tau=smooth + e) for e in noise]
    np.testing.assert_allclose(noise_floor(motions, cutoff), [0.5, 0.1], rtol=0.1)


def test_a_log_that_was_filtered_has_no_noise_floor(fit, logs):
    """Its filter has removed the noise above its band: a floor of 1e-8 was said."""
    smooth = [
        replace(x, tau=Sampler(x.rate, 2.0, 1)(x.tau), v=None) for x in logs
    ]  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        assert validate(fit.model, smooth).noise_floor is None


def test_a_torque_that_is_not_finite_is_refused_with_its_cause(fit, logs, monkeypatch):
    """Numbers of a file may be so large that torque is none."""
    nothing = np.full_like(logs[0].tau, np.nan)
    monkeypatch.setattr(DynamicModel, "predict", lambda self, motion: nothing)
    with pytest.raises(RecordingError, match="predicts a torque that is not finite"):
        predict(fit.model, logs[0])
    with pytest.raises(RecordingError, match="no torque, but an effect of the model"):
        predict(fit.model, replace(logs[0], tau=np.zeros(0)))


def test_a_slow_log_has_no_noise_floor(fit, logs):
    motion = motion_from_recording(logs[3], cutoff=20.0)
    assert noise_floor([motion], motion.rate / 6) is None
    assert validate(fit.model, [motion]).as_dict()["noise_floor"] is not None


def test_the_results_are_plain_json(fit, logs):
    found = validate(fit.model, logs[3:])
    content = json.loads(json.dumps(found.as_dict()))
    assert content["joints"] == ["shoulder", "elbow"]
    assert [row["name"] for row in content["rows"]] == [r.name for r in found.rows]
    for row, expected in zip(content["rows"], found.rows, strict=True):
        assert row["rms"] == expected.rms.tolist()
        assert row["relative"] == expected.relative.tolist()
        assert row["mean"] == expected.mean
    assert content["reduction"] == found.reduction
    assert content["samples"] == found.samples and content["seconds"] == found.seconds
    assert len(content["sources"]) == 1


def test_prediction_needs_no_torque_of_the_log(fit, logs):
    log = logs[3]
    blind = replace(log, tau=log.tau + 5.0)
    np.testing.assert_array_equal(predict(fit.model, log), predict(fit.model, blind))


def test_another_arm_and_other_joints_are_refused(fit, logs):
    with pytest.raises(ModelFileError, match="the model is of joints"):
        validate(fit.model, logs[3:], robot=arm("coman_like"))
    renamed = replace(logs[3], joints=("left", "right"))
    with pytest.raises(RecordingError, match="missing joints"):
        validate(fit.model, [renamed])
    with pytest.raises(IdentificationError, match="no recording"):
        validate(fit.model, [])


def test_a_model_without_a_speed_of_standing_takes_that_of_the_log(fit, logs):
    bare = validate(replace(fit.model, standing=np.zeros(0)), logs[3:])
    whole = validate(fit.model, logs[3:])
    rows = zip(bare.rows, whole.rows, strict=True)
    assert all(a.mean == pytest.approx(b.mean, rel=0.05) for a, b in rows)


def test_a_lag_does_not_show_the_noise_of_positions():
    """Its change is that of the torque in the band in which lags are fitted."""
    robot = arm("planar")
    base = stacked_base(robot.chain, (), ())
    base = base.with_values(base.mapping @ robot.chain.inertial.ravel())
    rng = np.random.default_rng(3)
    clean = random_fourier(robot, duration=6.0, rate=2000.0, seed=rng)
    q = clean.q + 1e-5 * rng.standard_normal(clean.q.shape)
    log = Recording(clean.t, q, joints=robot.joints)
    plain = DynamicModel(robot, base, cutoff=10.0)
    lags = tuple(ActuatorLag((j,), {"time": 0.03}) for j in range(2))
    lagging = replace(plain, effects=lags)
    exact = plain.predict(clean)
    exact += 0.03 * np.gradient(exact, clean.t, axis=0)
    pairs = (lagging, exact), (plain, exact), (plain, plain.predict(clean))
    with_lag, without, noise = (
        np.sqrt(np.mean((predict(model, log) - true)[400:-400] ** 2, axis=0))
        for model, true in pairs
    )
    assert np.all(with_lag < 1.2 * noise) and np.all(noise < 0.2 * without)
