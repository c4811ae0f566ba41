"""What an identification makes of poor data, torque constants and unphysical links."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse import Plant
from simulated import arm, motions, quiet, with_torque

from hybrid.dynamics import inverse_dynamics
from hybrid.dynamics.pseudo_inertia import is_consistent
from hybrid.effects.backlash import Backlash
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.elasticity import Elasticity
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning, IdentificationError, RecordingError
from hybrid.identification import identify, predict, validate
from hybrid.plant import random_fourier
from hybrid.recording import Recording
from hybrid.robot import Robot

RIGID = {"stages": ("rigid",)}


def logs(robot, effects=(), *, count=2, duration=6.0, seed=0, fill=0.7):
    rng = np.random.default_rng(seed)
    references = [
        random_fourier(robot, duration=duration, rate=1000, seed=rng, fill=fill)
        for _ in range(count)
    ]
    return Plant(robot, effects).run(references, seed=rng)


@cache
def scara_logs():
    return logs(arm("scara"), count=3)


@cache
def pendulum() -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        path = arm("planar").path
        return Robot.load(path, joints=("shoulder",))


# --- the cut-off ----------------------------------------------------------------------


@pytest.mark.parametrize("cutoff", [1e-9, 0.1, -1.0, 0.0, np.nan])
def test_a_cutoff_too_low_for_the_recordings_is_refused(cutoff):
    with pytest.raises(IdentificationError, match=r"valid is 0.5 Hz or more .* 6 s"):
        identify(arm("scara"), scara_logs(), cutoff=cutoff, **RIGID)


def test_the_lowest_cutoff_that_is_valid_leaves_samples_to_fit():
    fit, _ = quiet(identify, arm("scara"), scara_logs(), cutoff=0.5, **RIGID)
    assert np.isfinite(fit.estimate.theta).all()


# --- torque that was not measured -----------------------------------------------------


def test_a_log_without_torque_can_be_predicted_but_not_fitted():
    robot, (log, *rest) = arm("scara"), scara_logs()
    fit, _ = quiet(identify, robot, rest, **RIGID)
    silent = Recording(t=log.t, q=log.q, v=log.v, joints=log.joints, source="log.csv")
    assert not silent.has_torque
    assert np.array_equal(predict(fit.model, silent), predict(fit.model, log))
    for use in (lambda x: identify(robot, x), lambda x: validate(fit.model, x)):
        with pytest.raises(RecordingError, match="log.csv: no torque; .*; fit_servo"):
            use([silent])


# --- excitation -----------------------------------------------------------------------


def test_a_poor_motion_is_said_to_be_poor_and_what_it_leaves_open():
    """Both joints stay within a degree: what gravity does looks like an offset."""
    robot = arm("planar")
    rng = np.random.default_rng(0)
    poor = []
    for motion in motions(robot, count=2):
        q, v, a = (0.01 * x for x in (motion.q, motion.v, motion.a))
        tau = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a)
        tau += 0.01 * rng.normal(size=tau.shape)
        poor.append(replace(motion, q=q, v=v, a=a, tau=tau))
    fit, said = quiet(identify, robot, poor, cutoff=20.0, **RIGID)
    assert fit.condition > 100
    (sentence,) = [text for text in said if "excites the arm poorly" in text]
    assert sentence in fit.warnings
    assert "torque_offset.level[elbow]" in sentence
    assert sentence.endswith("move shoulder, elbow farther, or faster")


def test_a_rich_motion_is_not_complained_of():
    fit, said = quiet(identify, arm("scara"), scara_logs(), **RIGID)
    assert fit.condition < 100 and said == [] and fit.warnings == ()


# --- the torque constant --------------------------------------------------------------


@pytest.mark.study
def test_the_wrong_torque_constant_of_one_drive_shows_through_the_coupling():
    """What moves the elbow pushes on the shoulder, whose constant is right."""
    true = TorqueGain((1,), {"gain": 0.2})
    robot = arm("coman_like")
    found = logs(robot, [true, Coulomb((1,), {"level": 3.0})], count=3)
    more = {"effects": [TorqueGain((1,))], **RIGID}
    fit, _ = quiet(identify, robot, found[:2], **more)
    (gain,) = [e for e in fit.model.effects if e.id == "torque_gain"]
    assert gain.values["gain"] == pytest.approx(0.2, abs=4 * gain.std["gain"])
    assert gain.std["gain"] < 0.005
    plain, _ = quiet(identify, robot, found[:2], **RIGID)
    assert fit.held_out["IRLS"][1] < 0.5 * plain.held_out["IRLS"][1]
    (dry,) = [e for e in fit.model.effects if e.id == "coulomb" and e.joints == (1,)]
    assert dry.values["level"] == pytest.approx(3.0 + robot.frictionloss[1], rel=0.02)
    # What is predicted is what the log shows, friction times the constant included.
    with_gain, without = (
        validate(f.model, found[2:]).rows[-1].rms[1] for f in (fit, plain)
    )
    assert with_gain < 0.5 * without


def test_a_torque_constant_that_cannot_be_known_is_not_given_a_number():
    """A single joint: twice the inertia or half the constant, nobody can tell."""
    robot = pendulum()
    found = logs(robot, [TorqueGain((0,), {"gain": 0.2})])
    fit, _ = quiet(identify, robot, found, effects=[TorqueGain((0,))], **RIGID)
    (gain,) = [e for e in fit.model.effects if e.id == "torque_gain"]
    assert gain.values["gain"] == 0.0 and not gain.std
    assert any(
        text.startswith("torque_gain.gain[shoulder] cannot be told from")
        for text in fit.unidentifiable
    )


def test_one_of_the_torque_constants_of_all_drives_is_left_open():
    robot = arm("planar")
    every = [TorqueGain((j,), {"gain": 0.2}) for j in range(2)]
    asked = [TorqueGain((j,)) for j in range(2)]
    fit, _ = quiet(identify, robot, logs(robot, every), effects=asked, **RIGID)
    (text,) = [x for x in fit.unidentifiable if x.startswith("torque_gain")]
    assert "torque_gain.gain[shoulder]" in text
    assert "only their combination is known" in text


# --- links that could be built --------------------------------------------------------


@pytest.fixture(scope="module")
def consistent():
    """Few noisy samples, from which plain least squares asks for impossible links."""
    robot = arm("coman_like")
    effects = [Viscous((j,), {"coefficient": 2.0}) for j in range(6)]
    found = logs(robot, effects, count=4, duration=4.0)
    fit, said = quiet(identify, robot, found[:1], consistent=True, **RIGID)
    return fit, said, found[1:]


def test_consistent_links_have_positive_mass_and_obey_the_triangle_inequality(
    consistent,
):
    fit, _, _ = consistent
    links = fit.model.inertial
    assert links.shape == (6, 10) and is_consistent(links).all()
    for mass, mx, my, mz, xx, xy, yy, xz, yz, zz in links:
        c = np.array([mx, my, mz]) / mass
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about = about - mass * (c @ c * np.eye(3) - np.outer(c, c))
        a, b, c = np.linalg.eigvalsh(about)
        assert mass > 0 and a > 0 and a + b >= c * (1 - 1e-9)


def test_links_and_base_parameters_of_a_consistent_fit_predict_the_same(consistent):
    fit, _, (log, *_) = consistent
    by_links = predict(fit.model, log)
    of_links = fit.model.base.mapping[:, :60] @ fit.model.inertial.ravel()
    rigid = [k for k, c in enumerate(fit.model.base.kept) if c < 60]
    size = np.abs(fit.model.base.values).max()
    np.testing.assert_allclose(
        of_links[rigid], fit.model.base.values[rigid], atol=1e-12 * size
    )
    by_base = predict(replace(fit.model, inertial=None), log)
    np.testing.assert_allclose(
        by_links, by_base, rtol=0, atol=1e-8 * np.abs(by_base).max()
    )


def test_what_consistency_costs_stands_beside_the_other_stages(consistent):
    fit, said, rest = consistent
    assert list(fit.held_out) == ["LS", "WLS", "IRLS", "rigid", "+ consistent"]
    rows = {row.name: row for row in validate(fit.model, rest).rows}
    assert rows["+ consistent"].mean < 1.02 * rows["IRLS"].mean
    costly = np.mean(fit.held_out["+ consistent"] / fit.held_out["rigid"]) > 1.01
    assert any("raise the held-out error" in text for text in said) is bool(costly)


def test_data_that_want_impossible_links_are_told_from_noise():
    """A link of negative mass: no physical one moves like it."""
    robot = arm("planar")
    inertial = robot.chain.inertial.copy()
    inertial[1] = -inertial[1]
    found = [
        with_torque(m, inverse_dynamics(robot.chain, inertial, m.q, m.v, m.a))
        for m in motions(robot, count=2)
    ]
    fit, said = quiet(identify, robot, found, cutoff=20.0, consistent=True, **RIGID)
    assert is_consistent(fit.model.inertial).all()
    assert any("the data contradict them" in text for text in said)


# --- little data ----------------------------------------------------------------------


def test_recordings_of_three_seconds_still_make_four_folds():
    robot = arm("scara")
    short = logs(robot, count=1, duration=3.0)
    fit, _ = quiet(identify, robot, short, stages=("rigid", "remainder"))
    assert np.isfinite(fit.held_out["+ remainder"]).all()


def test_a_motion_that_is_masked_altogether_is_left_out():
    robot = arm("planar")
    good, bad = (with_torque(m, m.a) for m in motions(robot, count=2))
    masked = replace(bad, mask=np.zeros(len(bad.t), dtype=bool))
    both, _ = quiet(identify, robot, [good, masked], cutoff=20.0, **RIGID)
    alone, _ = quiet(identify, robot, [good], cutoff=20.0, **RIGID)
    assert np.array_equal(both.estimate.theta, alone.estimate.theta)
    with pytest.raises(IdentificationError, match="no usable sample"):
        identify(robot, [masked], cutoff=20.0, **RIGID)


@pytest.mark.study
@pytest.mark.parametrize("law", [Backlash, Elasticity])
def test_play_and_softness_that_an_arm_does_not_have_are_not_found(law):
    """Gains stay in their bounds while the problem is made linear about them."""
    robot, recordings = arm("planar"), logs(arm("planar"), count=4)
    asked = [law((j,)) for j in range(robot.size)]
    without, found = (
        quiet(identify, robot, recordings, effects=x, **RIGID)[0] for x in ([], asked)
    )
    gain, *_ = law.gains
    gains = [x.values[gain.name] for x in found.model.effects if x.id == law.id]
    assert len(gains) == 2 and all(0 <= x < gain.typical / 3 for x in gains)
    assert (found.held_out["rigid"] < 1.3 * without.held_out["rigid"]).all()
