"""What a fleet says of series: changes at a stated rate of false alarms, and limits."""

from datetime import date

import numpy as np
import pytest

from hybrid.fleets.changes import Level, changes, crossing, level, threshold
from hybrid.fleets.fleet import fleet_from_rows
from hybrid.fleets.plan import ArmPlan, Plan
from hybrid.fleets.pooling import pooled

WEEKS, DAYS = 26, 7.0
T = 739000.0 + DAYS * np.arange(WEEKS)


def fleet_of(values, std, warm=None, load=None, limits=None, **options):
    """What a fleet says of values and their standard deviations, (arms, series, T)."""
    names = [f"a{k}" for k in range(len(values))]
    rows = [
        {
            "arm": names[a], "period": f"{t:02d}",
            "day": date.fromordinal(int(T[t])).isoformat(), "joint": f"j{k}",
            "parameter": "coulomb.level", "unit": "N·m", "status": "ok", "reason": None,
            "change": values[a, k, t], "std": std[a, k, t], "baseline": 1.0,
            "baseline_std": 0.1, "residual": 1.0,
            "temperature": np.nan if warm is None else warm[a, t],
            "load": 1.0 if load is None else load[a, t],
        }
        for a, k, t in np.ndindex(*values.shape)
    ]  # fmt: skip
    more = {"group": "g", "limits": limits or {}}
    arms = tuple(ArmPlan(name, "logs", "arm.xml", **more) for name in names)
    return fleet_from_rows(Plan(arms, **options), rows)


@pytest.mark.parametrize("unlike", ["periods", "arms"])
def test_noise_that_is_not_as_its_standard_deviations_say_raises_no_alarms(unlike):
    rng = np.random.default_rng(5)
    arms, series = 25, 9
    noise = rng.standard_normal((arms, series, WEEKS))
    far = np.exp(0.3 * rng.standard_normal(noise.shape))
    found = (
        fleet_of(noise, far)
        if unlike == "periods"
        else fleet_of(noise * far[:, :, :1], np.ones_like(noise))
    )
    # 25 arms of 6 months: 1.5 are stated; more than 5 would be one case in 200.
    assert sum(len(x.changes) for x in found.alarms) <= 5


def test_the_rate_of_false_alarms_is_the_users():
    noise = np.random.default_rng(6).standard_normal((10, 9, WEEKS))
    one, many = (
        sum(len(x.changes) for x in fleet_of(noise, np.ones_like(noise), **x).alarms)
        for x in ({}, {"false_alarms": 40.0})
    )
    # 60 arm-months: 24 are stated, with a standard deviation of 5.
    assert one <= 5
    assert 12 <= many <= 39


def test_noise_alone_raises_no_more_alarms_than_one_in_a_hundred_arm_months():
    series, arms = 9, 25
    limit = threshold(WEEKS, DAYS, series, 1.0)
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((arms * series, WEEKS))
    count = sum(len(list(changes(T, y, np.ones(WEEKS), limit=limit))) for y in noise)
    # 25 arms of 6 months: 1.5 are stated; more than 5 would be one case in 200.
    assert count <= 5


def test_more_parameters_that_are_watched_need_surer_alarms():
    assert threshold(WEEKS, DAYS, 35, 1.0) > threshold(WEEKS, DAYS, 9, 1.0) > 3.0


@pytest.mark.parametrize("week", [6, 15])
def test_a_step_is_dated_and_measured(week):
    noise = np.random.default_rng(week).standard_normal(WEEKS)
    y = 0.1 * (noise + 6.0 * (np.arange(WEEKS) >= week))
    (x,) = changes(T, y, np.full(WEEKS, 0.1), limit=4.0)
    assert x.kind == "step"
    assert x.earliest <= T[week] <= x.latest
    assert T[week] <= x.alarm <= T[week] + 21
    assert abs(x.size - 0.6) < 3 * x.std


def test_wear_is_a_trend_whose_limit_is_foreseen():
    noise = np.random.default_rng(1).standard_normal(WEEKS)
    y = noise + 0.05 * np.maximum(T - T[8], 0.0)
    (x,) = changes(T, y, np.ones(WEEKS), limit=4.0)
    assert x.kind == "trend"
    assert abs(x.size - 0.05) < 3 * x.std
    now = level(T, y, np.ones(WEEKS), x)
    median, early, late = crossing(now, 10.0)
    true = (10.0 - 0.05 * (T[-1] - T[8])) / 0.05
    assert early < true < late
    assert early < median < late


def test_a_temperature_that_explains_a_trend_leaves_no_alarm():
    warm = np.linspace(20.0, 30.0, WEEKS)
    y = 2.0 * (warm - 20.0) + np.random.default_rng(0).standard_normal(WEEKS)
    assert not list(changes(T, y, np.ones(WEEKS), limit=4.0, x=warm))
    assert list(changes(T, y, np.ones(WEEKS), limit=4.0))


def test_pooling_makes_estimates_better_and_names_the_arm_that_is_unlike():
    rng = np.random.default_rng(0)
    true = rng.normal(5.0, 0.3, 30)
    y = true + rng.normal(0.0, 0.5, 30)
    y[7], true[7] = 12.0, 12.0
    value, unlike = pooled(y, np.full(30, 0.5))
    assert np.flatnonzero(unlike).tolist() == [7]
    assert value[7] == 12.0
    rest = np.arange(30) != 7
    error = np.abs(value - true)[rest]
    assert (error**2).mean() < 0.7 * (np.abs(y - true)[rest] ** 2).mean()


def test_a_series_stands_at_its_mean_by_weights_or_on_its_line():
    """As Gauss has it: of independent values, and of a line through them."""
    rng = np.random.default_rng(2)
    s = rng.uniform(0.1, 0.4, WEEKS)
    y = 3.0 + 0.02 * (T - T[-1]) + s * rng.standard_normal(WEEKS)
    now = level(T, y, s, None)
    assert now.value == pytest.approx(np.average(y, weights=s**-2))
    assert now.std == pytest.approx(np.sum(s**-2) ** -0.5)
    line, covariance = np.polyfit(T - T[-1], y, 1, w=1 / s, cov="unscaled")
    assert now.slope == pytest.approx(line[0])
    assert now.slope_std == pytest.approx(np.sqrt(covariance[0, 0]))
    (trend,) = changes(T, y + 0.3 * np.maximum(T - T[5], 0), s, limit=4.0)
    after = T >= trend.day
    then = level(T, y, s, trend)
    x = T[after] - T[-1]
    known, spread = np.polyfit(x, y[after], 1, w=1 / s[after], cov="unscaled")
    assert (then.slope, then.value) == pytest.approx(tuple(known))
    assert (then.slope_std, then.std) == pytest.approx(tuple(np.sqrt(np.diag(spread))))
    assert then.covariance == pytest.approx(spread[0, 1])


def test_a_limit_is_crossed_when_the_line_says():
    sure = Level(2.0, 1e-9, 0.1, 1e-9, 0.0)
    assert crossing(sure, 5.0) == pytest.approx((30.0,) * 3, rel=1e-4)
    falls = Level(2.0, 1e-9, -0.1, 1e-9, 0.0)
    assert crossing(falls, 5.0) == pytest.approx((70.0,) * 3, rel=1e-4)
    assert crossing(Level(6.0, 1e-9, 0.1, 1e-9, 0.0), 5.0) == (0.0, 0.0, 0.0)
    never = crossing(Level(0.0, 0.1, 0.0, 1e-9, 0.0), 5.0)
    assert min(never) > 1e6
    median, early, late = crossing(Level(2.0, 0.3, 0.1, 0.01, 0.0), 5.0)
    assert early < median < late and median == pytest.approx(30.0, rel=0.05)


def test_a_score_of_few_degrees_has_to_be_larger_to_be_as_seldom():
    """The same share of noise passes: that of Student's law and of the normal one."""
    y = 0.9 * (np.arange(WEEKS) >= 12.0)
    s = np.full(WEEKS, 0.25)
    ((sure,), few) = (
        list(changes(T, y, s, limit=5.0, degrees=x)) for x in (np.inf, 5.0)
    )
    assert sure.score > 5.0 and few == []
    # Five deviations of the normal law are 31.8 of Student's with five degrees.
    (unsure,) = changes(T, 4.0 * y, s, limit=5.0, degrees=5.0)
    assert unsure.score > 31.8
    assert list(changes(T, 3.0 * y, s, limit=5.0, degrees=5.0)) == []


def alone(arms=1):
    """Noise of some arms, and its standard deviation, (arms, 1, T)."""
    noise = np.random.default_rng(7).standard_normal((arms, 1, WEEKS))
    return 0.1 * noise, np.full((arms, 1, WEEKS), 0.1)


STEP = 1.0 * (np.arange(WEEKS) >= 13)


def test_what_all_arms_share_is_of_none_of_them():
    """Season, say: it is told once, of all arms together, and dated."""
    noise, std = alone(8)
    found = fleet_of(noise + STEP, std)
    assert not any(x.changes for x in found.states)
    said = [x for x in found.shared if "all arms together" in x]
    assert len(said) == 1 and "j0, coulomb.level" in said[0]
    assert f"N·m on {date.fromordinal(int(T[13])).isoformat()}" in said[0]
    assert any("no log has a temperature" in x for x in found.shared)
    few = fleet_of(noise[:3] + STEP, std[:3])
    assert all(len(x.changes) == 1 for x in few.states)


def test_one_arm_that_changes_is_the_one():
    noise, std = alone(8)
    noise[3] += STEP
    found = fleet_of(noise, std)
    (alarm,) = found.alarms
    assert alarm.arm == "a3" and alarm.unlike
    (change,) = alarm.changes
    assert change.kind == "step" and change.size == pytest.approx(1.0, abs=0.2)
    assert [x.arm for x in found.states if x.unlike] == ["a3"]


@pytest.mark.parametrize("arms", [1, 8])
def test_what_temperature_explains_is_no_change(arms):
    """By its own slope of one arm, by that of all in a fleet."""
    noise, std = alone(arms)
    rng = np.random.default_rng(1)
    warm = 30.0 + 5.0 * STEP + rng.standard_normal((arms, WEEKS))
    found = fleet_of(noise + 0.2 * (warm - 30.0)[:, None], std, warm=warm)
    assert not any(x.changes for x in found.states)
    for x in found.states if arms > 1 else ():  # at the usual temperature
        assert x.level.value == pytest.approx(0.2 * (warm.mean() - 30.0), abs=0.2)
    told = fleet_of(noise + 0.2 * (warm - 30.0)[:, None], std)
    unsure = ["which is not logged" in x.confounded for x in told.states]
    assert any(unsure) == (arms == 1)


@pytest.mark.parametrize(("moves", "said"), [(2.0, True), (0.0, False)])
def test_a_change_of_load_at_the_same_time_is_said(moves, said):
    noise, std = alone()
    rng = np.random.default_rng(2)
    load = 5.0 + 0.05 * rng.standard_normal((1, WEEKS)) + moves * STEP
    (x,) = fleet_of(noise + STEP, std, load=load).states
    assert x.changes and ("load" in x.confounded) == said


@pytest.mark.parametrize(
    ("limits", "most"),
    [
        ({}, np.inf), ({"coulomb.level": 0.5}, 0.5), ({"coulomb": "80%"}, 0.8),
        ({"coulomb": 0.3, "coulomb.level": "10%"}, 0.1), ({"viscous": 0.1}, np.inf),
    ],
)  # fmt: skip
def test_a_limit_is_a_number_or_a_part_of_the_baseline(limits, most):
    noise, std = alone()
    (x,) = fleet_of(noise + 0.02 * np.arange(WEEKS), std, limits=limits).states
    assert x.limit == pytest.approx(most)
    median, early, late = x.crossing
    assert early <= median <= late
    assert (median < np.inf) == (most < np.inf)
