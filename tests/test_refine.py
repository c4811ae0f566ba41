"""The fit of one cause beside the numbers of the file: a time shift, and its ends."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pendulum import NOISE, pendulum, swings
from scipy.interpolate import CubicSpline

from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.refine import fit_shift
from hybrid.diagnosis.gap.background import background
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.delay import Delay


@cache
def beside_the_file(late):
    """Evidence of pendulums whose torque was logged late, and the file's columns."""
    logs = []
    for k, m in enumerate(swings()):
        tau = CubicSpline(m.t, m.tau)(m.t - late)
        noise = NOISE * np.random.default_rng(k).standard_normal(tau.shape)
        mask = (m.t > 0.1) & (m.t < m.t[-1] - 0.1)
        logs.append(replace(m, tau=tau + noise, mask=mask))
    evidence = Evidence(measure_gap(pendulum(), logs, cutoff=10.0))
    index = evidence.add(*background(evidence.gap))
    evidence.set_covariances([np.array([NOISE**2])])
    return evidence, np.concatenate(index)


@pytest.mark.parametrize("late", [0.02, -0.02])
@pytest.mark.parametrize("start", [0.6, 1.0, 1.8])
@pytest.mark.parametrize("lower_band", [None, False])
def test_a_time_is_found_from_near_it(late, start, lower_band):
    evidence, base = beside_the_file(late)
    near = Delay((0,), {"time": start * late})
    found = fit_shift(evidence, base, near, lower_band=lower_band)
    assert found.values["time"] == pytest.approx(late, rel=0.03)


@pytest.mark.parametrize(("start", "end"), [(0.006, 0.012), (0.048, 0.024)])
def test_a_time_is_sought_within_a_factor_of_two(start, end):
    evidence, base = beside_the_file(0.02)
    found = fit_shift(evidence, base, Delay((0,), {"time": start}))
    assert found.values["time"] == pytest.approx(end, rel=0.02)


def test_a_time_stays_within_its_bounds():
    """Torque is 45 ms late here; of 100 ms, a fit may say 50 at most."""
    evidence, base = beside_the_file(0.045)
    found = fit_shift(evidence, base, Delay((0,), {"time": 0.03}))
    assert found.values["time"] == pytest.approx(0.045, rel=0.03)
    evidence, base = beside_the_file(0.1)
    found = fit_shift(evidence, base, Delay((0,), {"time": 0.04}))
    assert found.values["time"] == pytest.approx(0.05, rel=0.01)
