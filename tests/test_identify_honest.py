"""What an identification says of itself holds on logs that it has not seen."""

import numpy as np
import pytest
from marks import studied
from simulated import arm, linear_problem, quiet
from test_friction import logs, ripples
from test_remainder import OPTIONS
from test_remainder import logs as logs_with_structure

from hybrid.identification import identify, validate


def linear(motion):
    """Dry and viscous friction, and nothing else."""
    return 0.5 * np.sign(motion.v) + 0.3 * motion.v


def rms(fit, recordings, stage):
    return {row.name: row.rms for row in validate(fit.model, recordings).rows}[stage]


@pytest.fixture(scope="module")
def little_data():
    """Held-out error against that on new and on old logs, of five seeds and joints."""
    new, old = [], []
    for seed in range(5):
        noise = {"noise": 0.3, "memory": 0.97, "count": 9, "duration": 4.0}
        found = logs(linear, seed=seed, **noise)
        fit, _ = quiet(
            identify, arm("planar"), found[:3], cutoff=15.0, stages=("rigid",)
        )
        new.append(fit.held_out["IRLS"] / rms(fit, found[3:], "IRLS"))
        fitted, _ = quiet(rms, fit, found[:3], "IRLS")
        old.append(fit.held_out["IRLS"] / fitted)
    return np.array(new), np.array(old)


def test_what_is_held_out_foretells_the_error_on_new_logs(little_data):
    assert np.mean(little_data[0]) == pytest.approx(1.0, abs=0.08)


def test_what_is_held_out_lies_above_the_error_that_was_fitted(little_data):
    """A score that has seen its own samples would be the fitted error itself."""
    assert np.mean(little_data[1]) > 1.07
    assert np.min(little_data[1]) > 1.0


@pytest.mark.parametrize(
    "tiny",
    [
        {"count": 2, "duration": 4.0, "memory": 0.5},
        *studied({"count": 1, "duration": 6.0, "memory": 0.9}),
    ],
)
def test_noise_on_little_data_passes_for_no_ripple(tiny):
    """Of four hundred orders one always fits a few seconds of noise well."""
    found = []
    for seed in range(20):
        recordings = logs(linear, seed=seed, noise=0.3, **tiny)
        fit, _ = quiet(
            identify, arm("planar"), recordings, cutoff=15.0, stages=("rigid", "ripple")
        )
        found += ripples(fit)
    assert len(found) <= 1


@pytest.fixture(scope="module")
def with_and_without():
    """The same logs, with torque that no effect describes, in two stages and in one."""
    recordings = logs_with_structure(0.8)
    planar = arm("planar")
    full, _ = quiet(identify, planar, recordings[:3], **OPTIONS)
    rigid, _ = quiet(
        identify, planar, recordings[:3], **{**OPTIONS, "stages": ("rigid",)}
    )
    return full, rigid, recordings[3:]


def test_links_are_fitted_anew_around_what_was_learned(with_and_without):
    """Structure that was taken for gravity and inertia before is not any more."""
    full, rigid, _ = with_and_without
    problem = linear_problem(arm("planar"))
    truth = np.random.default_rng(0).uniform(0.5, 1.5, problem.size)
    labels = problem.base.kept_labels
    links = [k for k, x in enumerate(labels) if x.startswith(("m", "I"))]
    assert len(links) == 6
    errors = []
    for fit in (rigid, full):
        values = dict(
            zip(fit.model.base.kept_labels, fit.model.base.values, strict=True)
        )
        errors.append(
            np.linalg.norm([values[labels[k]] / truth[k] - 1.0 for k in links])
        )
    assert errors[1] < 0.85 * errors[0]
    assert full.rounds > 1


def test_the_stages_before_are_kept_as_they_were(with_and_without):
    full, rigid, recordings = with_and_without
    for stage in ("LS", "WLS", "IRLS"):
        np.testing.assert_allclose(
            rms(full, recordings, stage), rms(rigid, recordings, stage), rtol=1e-9
        )
        np.testing.assert_allclose(full.held_out[stage], rigid.held_out[stage])
    elbow = {s: rms(full, recordings, s)[1] for s in ("IRLS", "+ remainder")}
    assert elbow["+ remainder"] < 0.75 * elbow["IRLS"]
    held_out = full.held_out["+ remainder"]
    # Of two thirds of the logs: not better than of all of them, and not much worse.
    unseen = rms(full, recordings, "+ remainder")
    assert (held_out > 0.95 * unseen).all() and held_out[1] < 0.5 * elbow["IRLS"]
