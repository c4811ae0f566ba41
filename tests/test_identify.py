"""From recordings to a model: better at every stage, and near a truth that is known."""

from dataclasses import replace

import numpy as np
import pytest
from coarse import simulate
from simulated import arm, coman, quiet

from hybrid.diagnosis.diagnose import diagnose
from hybrid.effects import JointState, effect_class
from hybrid.errors import (
    HybridError,
    IdentificationError,
    RecordingError,
)
from hybrid.identification import identify, validate
from hybrid.plant.scale import joint_scales
from hybrid.regression.least_squares import ESTIMATORS
from hybrid.signals import motion_from_recording

# Mean RMS of the published three stages: 9.53 N·m by least squares, 6.14 at the end.
PUBLISHED_CUT = 0.356


@pytest.fixture(scope="module")
def rows():
    return {row.name: row for row in coman().validation.rows}


# --- the COMAN-like truth, on motion that no stage has seen ---------------------------


def test_each_stage_lowers_the_held_out_error(rows):
    means = [row.mean for row in rows.values()]
    names = ["LS", "WLS", "IRLS", "rigid", "+ friction", "+ ripple"]
    assert list(rows)[:6] == names
    assert rows["IRLS"].mean < rows["LS"].mean
    assert means[2:] == sorted(means[2:], reverse=True)
    assert rows["+ friction"].mean < 0.9 * rows["IRLS"].mean
    assert rows["+ ripple"].mean < 0.9 * rows["+ friction"].mean


def test_the_whole_cuts_the_error_by_more_than_published():
    assert coman().validation.reduction > PUBLISHED_CUT


def test_no_joint_is_worse_than_by_least_squares(rows):
    assert (list(rows.values())[-1].rms < 1.02 * rows["LS"].rms).all()


def test_cross_validation_foretells_the_error_on_new_motion(rows):
    held_out = coman().fit.held_out
    for name in ("LS", "IRLS", "+ friction", "+ ripple"):
        assert held_out[name].mean() == pytest.approx(rows[name].mean, rel=0.35)


def test_no_stage_raises_the_cross_validated_error():
    scale = coman().fit.held_out["LS"]
    errors = [np.mean(x / scale) for x in list(coman().fit.held_out.values())[2:]]
    assert errors == sorted(errors, reverse=True)


def test_what_does_not_help_is_left_out_and_said_so():
    fit = coman().fit
    assert (fit.model.remainder is None) == any("remainder" in x for x in fit.left_out)
    for text in fit.left_out:
        assert any(text in said for said in coman().said)


def friction_of(effects, joint, v):
    """Torque of a joint that depends on its own speed alone, shape of ``v``."""
    zero = np.zeros_like(v)
    state = JointState(zero, zero, v, zero, np.sign(v), zero)
    total = np.zeros_like(v)
    for e in effects:
        if e.joints == (joint,) and hasattr(e, "law") and "ripple" not in e.id:
            laws = e.law(state, **e.shape_values)
            total += sum(g * x for g, x in zip(e.gain_values, laws, strict=True))
    return total


@pytest.mark.parametrize("joint", range(6))
def test_the_true_friction_curve_is_recovered(joint):
    """Dry, viscous, Stribeck, quadratic, cubic and asymmetric parts, as one curve."""
    robot, model = coman().robot, coman().fit.model
    fastest = model.range["v_max"][joint]
    speed = np.linspace(0.05, 0.9, 60) * fastest
    v = np.concatenate([-speed, speed])
    truth = friction_of(coman().plant.effects, joint, v)
    truth += robot.damping[joint] * v + robot.frictionloss[joint] * np.sign(v)
    error = friction_of(model.effects, joint, v) - truth
    assert np.sqrt(np.mean(error**2)) < 0.08 * np.sqrt(np.mean(truth**2))


def true_ripples():
    return {
        (e.joints[0], e.values["periods"]): e.values
        for e in coman().plant.effects
        if e.id == "torque_ripple"
    }


def test_every_true_ripple_is_found_and_no_other():
    found = {
        (e.joints[0], e.values["periods"])
        for e in coman().fit.model.effects
        if e.id == "torque_ripple"
    }
    assert found == set(true_ripples())


def test_sizes_of_ripples_lie_in_their_intervals():
    for effect in coman().fit.model.effects:
        if effect.id == "torque_ripple":
            truth = true_ripples()[effect.joints[0], effect.values["periods"]]
            for name in ("sine", "cosine"):
                assert abs(effect.values[name] - truth[name]) < 3.5 * effect.std[name]


# --- an arm that is what the linear model says ----------------------------------------


@pytest.fixture(scope="module")
def linear():
    """Fits of an arm with linear friction, its truth, and the logs of the first."""
    robot = arm("coman_like")
    fits = []
    for seed in range(2):
        logs = simulate(robot, trajectories=3, duration=6, seed=seed)
        fits.append(quiet(identify, robot, logs, stages=("rigid",))[0])
    base = fits[0].model.base
    declared = {
        "armature.inertia": robot.chain.armature,
        "viscous.coefficient": robot.damping,
        "coulomb.level": robot.frictionloss,
    }
    truth = np.zeros(len(base.labels))
    truth[:60] = robot.chain.inertial.ravel()
    for k, label in enumerate(base.labels[60:], 60):
        name, joint = label.rstrip("]").split("[")
        truth[k] = declared.get(name, np.zeros(6))[robot.joint_index(joint)]
    return fits, base.mapping @ truth


def test_the_truth_lies_within_its_intervals(linear):
    """Another integrator, step and law of dry friction than the fit's made the data."""
    fits, truth = linear
    inside = []
    for fit in fits:
        low, high = fit.estimate.interval()
        inside.append((low <= truth) & (truth <= high))
    assert np.mean(inside) > 0.92


def test_friction_and_the_large_inertias_are_known_to_a_few_percent(linear):
    fits, truth = linear
    names = ("viscous", "coulomb", "Izz_1", "mx_2", "Izz_2", "mx_3", "mz_3")
    for k, label in enumerate(fits[0].labels):
        if label.startswith(names) and abs(truth[k]) > 0.1:
            for fit in fits:
                assert fit.estimate.theta[k] == pytest.approx(truth[k], rel=0.05)


def test_fits_say_what_no_motion_can_tell(linear):
    fit = linear[0][0]
    assert any(
        x.startswith("armature.inertia[base] cannot be told from Izz_1")
        for x in fit.unidentifiable
    )
    assert "armature.inertia[base]" not in fit.labels
    assert len(fit.names) == len(fit.labels) == len(fit.units) == len(linear[1])
    assert fit.converged and fit.condition < 1000


# --- the interface --------------------------------------------------------------------


@pytest.fixture(scope="module")
def logs():
    return simulate(arm("planar"), trajectories=4, duration=6, seed=0)


@pytest.fixture(scope="module")
def two_stages(logs):
    """A fit, and what it warned of."""
    return quiet(identify, arm("planar"), logs, stages=("rigid", "friction"))


def test_friction_that_lags_is_found_at_its_joint_alone(two_stages):
    assert not any(e.id == "friction_lag" for e in two_stages[0].model.effects)
    robot = arm("planar")
    law = effect_class("friction_lag").typical((1,), joint_scales(robot), time=0.15)
    law = law.at({"coefficient": 3.0 * law.values["coefficient"]})
    late = simulate(robot, [law], trajectories=4, duration=6, seed=0)
    fit, _ = quiet(identify, robot, late, stages=("rigid", "friction"))
    (found,) = [e for e in fit.model.effects if e.id == "friction_lag"]
    assert found.joints == (1,)
    assert found.values["coefficient"] == pytest.approx(law.values["coefficient"], 0.1)
    assert 0.1 < found.values["time"] < 0.22  # of five that are tried
    noise = two_stages[0].held_out["+ friction"][1]
    assert fit.held_out["+ friction"][1] == pytest.approx(noise, rel=0.05)
    assert fit.held_out["rigid"][1] > 1.5 * noise


def test_equal_data_give_equal_models(logs, two_stages):
    first = two_stages[0]
    second, _ = quiet(identify, arm("planar"), logs, stages=("rigid", "friction"))
    np.testing.assert_array_equal(first.estimate.theta, second.estimate.theta)
    assert first.model.effects == second.model.effects


def test_motions_and_their_masks_are_taken_as_they_are(logs):
    """A user may leave samples out; what is masked does not count."""
    chosen = [motion_from_recording(x, cutoff=40.0) for x in logs]
    chosen = [replace(m, mask=m.mask & (m.t % 1.0 < 0.7)) for m in chosen]
    spoiled = [replace(m, tau=np.where(m.mask[:, None], m.tau, 1e3)) for m in chosen]
    options = {"stages": ("rigid",), "cutoff": np.inf}
    found, expected = (
        quiet(identify, arm("planar"), x, **options)[0] for x in (spoiled, chosen)
    )
    np.testing.assert_array_equal(found.estimate.theta, expected.estimate.theta)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_the_estimator_is_the_best_up_to_the_one_asked_for(logs, estimator):
    robot = arm("planar")
    fit, _ = quiet(identify, robot, logs, estimator=estimator, stages=("rigid",))
    assert list(fit.held_out) == ["LS", "WLS", "IRLS", "rigid"]
    off = fit.estimate.weight - np.diag(np.diag(fit.estimate.weight))
    if estimator != "irls":  # no covariance across joints
        assert not off.any()
    if estimator == "ls":  # all joints alike
        assert np.ptp(np.diag(fit.estimate.weight)) == 0
    better = np.minimum(fit.held_out["LS"], fit.held_out["WLS"])
    assert (fit.held_out["rigid"] <= 1.02 * better).all()


def test_a_stage_that_was_not_asked_for_does_not_run(logs):
    fit, said = quiet(identify, arm("planar"), logs, stages=("rigid",))
    assert fit.left_out == () and said == []
    assert fit.model.stage == "rigid" and fit.model.remainder is None


def test_prediction_is_the_sum_of_rigid_body_and_effects(logs, two_stages):
    fit, _ = two_stages
    motion = motion_from_recording(logs[0], cutoff=40.0)
    body = fit.model.body(motion)
    total = body.load.copy()
    for effect in fit.model.effects:
        total[:, effect.joints] += effect.torque(motion, body)
    np.testing.assert_allclose(fit.model.predict(motion), total, atol=1e-12)


@pytest.mark.study
def test_an_effect_of_the_users_is_fitted_along(logs):
    robot = arm("planar")
    own = effect_class("spring")
    truth = own((1,), {"stiffness": 3.0})
    data = simulate(robot, [truth], trajectories=4, duration=6, seed=5)
    fit, _ = quiet(identify, robot, data, effects=[own((1,))], stages=("rigid",))
    (found,) = [e for e in fit.model.effects if e.id == "spring"]
    assert abs(found.values["stiffness"] - 3.0) < 3.5 * found.std["stiffness"]
    # Its preload is an offset of torque, which is fitted at every joint already.
    assert any("spring.preload" in x for x in fit.unidentifiable)


def test_what_recordings_leave_open_is_named(logs):
    """Two seconds of one slow motion do not determine an arm."""
    robot = arm("coman_like")
    log = simulate(robot, trajectories=1, duration=3, seed=0, fill=0.05)
    fit, _ = quiet(identify, robot, log, stages=("rigid",))
    open_ = [x for x in fit.unidentifiable if "is held by the robot file" in x]
    assert len(open_) > 5


def test_bad_choices_are_refused_with_what_is_valid(logs):
    robot = arm("planar")
    with pytest.raises(HybridError, match="valid is 'ls', 'wls', 'irls'"):
        identify(robot, logs, estimator="ols")
    with pytest.raises(HybridError, match="valid is .*'rigid', 'friction'"):
        identify(robot, logs, stages=("rigid", "magic"))
    with pytest.raises(IdentificationError, match="no recording"):
        identify(robot, [])
    with pytest.raises(RecordingError, match="valid are 6"):
        identify(
            arm("coman_like"), [replace(x, joints=("joint_1", "joint_2")) for x in logs]
        )


@pytest.mark.parametrize(
    "verb", [identify, pytest.param(diagnose, marks=pytest.mark.study)]
)
def test_a_cutoff_above_half_the_rate_of_a_log_is_warned_of(logs, verb):
    _, warnings = quiet(verb, arm("planar"), logs[:1], cutoff=10_000.0)
    assert any("of 10000 Hz filters nothing" in x and "250 Hz" in x for x in warnings)


def test_a_stage_left_out_is_a_warning(two_stages):
    assert any("left out" in x for x in two_stages[1])


def test_robust_weights_shrug_off_a_contact():
    """A push of two seconds at both joints bends the plain fit, not the robust one."""
    robot = arm("planar")
    clean = simulate(robot, trajectories=5, duration=6, seed=4)
    push = ((clean[0].t > 3) & (clean[0].t < 5))[:, None] * np.array([24.0, 12.0])
    spoiled = [replace(clean[0], tau=clean[0].tau + push), *clean[1:4]]
    file = robot.with_inertial(1.3 * robot.chain.inertial)  # no help by itself
    error = {}
    for robust in (False, True):
        fit, _ = quiet(identify, file, spoiled, stages=("rigid",), robust=robust)
        error[robust] = validate(fit.model, clean[4:]).rows[-1].mean
    best, _ = quiet(identify, file, clean[:4], stages=("rigid",))
    best = validate(best.model, clean[4:]).rows[-1].mean
    assert error[False] > 1.05 * best
    assert error[True] < 1.02 * best
