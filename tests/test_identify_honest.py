"""What an identification says of itself holds on logs that it has not seen."""

import numpy as np
import pytest
from marks import studied
from simulated import arm, quiet
from test_friction import logs, ripples

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
