"""A parameter of many arms: what they share, what explains it, what changed along."""

from datetime import date

import numpy as np
import pytest

from hybrid.fleets.changes import changes
from hybrid.fleets.series import Series

WEEKS = 26
DAYS = 739000.0 + 7.0 * np.arange(WEEKS)
LATE = np.arange(WEEKS) >= 13


def series(y, std=0.1, warm=np.nan, load=1.0, baseline=1.0, dated=True) -> Series:
    """A series of values (arms, T); all else a number, or of the same shape."""
    full = [np.broadcast_to(x, y.shape) for x in (std, warm, load, baseline)]
    names = "std", "temperature", "load", "baseline"
    return Series([
        {
            "arm": f"a{a:02d}", "period": f"{t:02d}", "change": y[a, t],
            "day": date.fromordinal(int(DAYS[t])).isoformat() if dated else "",
            "joint": "elbow", "parameter": "coulomb.level", "unit": "N·m",
            **{name: x[a, t] for name, x in zip(names, full, strict=True)},
        }
        for a, t in np.ndindex(*y.shape)
    ])  # fmt: skip


def states(known: Series, limit=4.0, limits=None):
    freedom = np.full(len(known.arms), np.inf)
    own = dict.fromkeys(known.arms, limits or {})
    return list(known.states("g", freedom, limit, own))


def warmed(slopes, spread=0.05):
    """Temperatures of arms, and values that follow them with each arm's slope."""
    rng = np.random.default_rng(0)
    warm = 30.0 + spread * rng.standard_normal((len(slopes), WEEKS))
    warm[:, 3] = np.nan
    levels = np.arange(len(slopes))[:, None] * 1.0
    return warm, levels, np.asarray(slopes)[:, None] * np.nan_to_num(warm - 30.0)


def test_a_slope_that_arms_agree_on_is_taken_away():
    slopes = 1.0 + 0.1 * np.linspace(-1.0, 1.0, 25)
    warm, levels, y = warmed(slopes)
    y[:, 3] += 0.2  # where nobody knows the temperature
    known = series(levels + y, warm=warm)
    known.remove_common()
    rest = slopes[:, None] - 1.0
    seen = np.isfinite(warm)
    left = levels + rest * (warm - 30.0) + (np.nanmean(warm) - 30.0)
    np.testing.assert_allclose(known.y[seen], left[seen], atol=0.02)
    assert np.ptp(known.y, axis=1).max() < 0.5 * np.ptp(y, axis=1).min()


@pytest.mark.parametrize("around", [1.0, 0.0])
def test_a_slope_is_one_if_arms_differ_less_than_it_is_sure(around):
    slopes = around + np.linspace(-2.0, 2.0, 25)
    warm, levels, y = warmed(slopes)
    known = series(levels + y, warm=warm)
    known.remove_common()
    moved = np.abs(known.y - levels - y).max()
    assert moved == pytest.approx(0.15 * around, abs=0.05)


@pytest.mark.parametrize(("arms", "shared"), [(5, 1.0), (4, 0.0)])
def test_what_five_arms_do_together_is_common_and_four_may_be_chance(arms, shared):
    season = np.where(LATE, 1.0, 0.0)
    known = series(np.arange(arms)[:, None] + np.tile(season, (arms, 1)))
    known.remove_common()
    assert np.ptp(known.common) == pytest.approx(shared)
    np.testing.assert_allclose(np.ptp(known.y, axis=1), 1.0 - shared, atol=1e-12)


def test_periods_of_few_arms_tell_nothing_common():
    y = np.arange(8.0)[:, None] + np.where(LATE, 1.0, 0.0)
    y[3:, 20] = np.nan
    known = series(y)
    known.remove_common()
    assert known.common[20] == 0.0
    assert known.y[0, 20] == pytest.approx(known.y[0, 19] + 1.0)


@pytest.mark.parametrize(("limit", "said"), [(9.5, 1), (10.8, 0)])
def test_a_median_of_arms_is_as_sure_as_the_law_of_medians_says(limit, said):
    """A step by 1 σ of 25 arms: its score is 1/(√(π/2)·√(1/25)·√(2/13)) = 10.2."""
    known = series(np.tile(0.1 * LATE, (25, 1)))
    known.remove_common()
    found = list(known.shared(limit))
    assert len(found) == said
    day = date.fromordinal(int(DAYS[13])).isoformat()
    assert all(f"+0.1 N·m on {day}" in x for x in found)


def test_a_common_step_in_logs_without_dates_is_told_by_the_log():
    known = series(np.tile(0.1 * LATE, (25, 1)), dated=False)
    known.remove_common()
    (said,) = known.shared(5.0)
    assert "+0.1 N·m on log 13;" in said


def test_a_common_trend_is_told_by_the_month():
    wear = 0.01 * np.maximum(DAYS - DAYS[8], 0.0)
    known = series(np.tile(wear, (25, 1)))
    known.remove_common()
    (said,) = known.shared(5.0)
    day = date.fromordinal(int(DAYS[8])).isoformat()
    assert f"+0.304 N·m a month since {day}" in said


@pytest.mark.parametrize("arms", [1, 2])
def test_an_arm_among_few_stands_where_its_baseline_and_its_values_say(arms):
    y, s = 0.3 + 0.0 * np.ones((arms, WEEKS)), 0.1
    y[0, 5] = np.nan
    base = 2.0 + 3.0 * np.arange(arms)[:, None]
    found = states(series(y, std=s, baseline=base), limits={"coulomb": "50%"})
    for k, x in enumerate(found):
        count = WEEKS - (k == 0)
        assert x.pooled == pytest.approx(2.3 + 3.0 * k) and not x.unlike
        assert x.level.std == pytest.approx(0.1 / np.sqrt(count))
        assert x.baseline == pytest.approx(2.0 + 3.0 * k)
        assert x.limit == pytest.approx(0.5 * x.baseline)
        assert len(x.days) == len(x.values) == count
        assert x.score == 0.0 and x.changes == ()


def test_a_value_without_a_standard_deviation_is_left_out():
    y, s = np.zeros((1, WEEKS)), np.full((1, WEEKS), 0.1)
    y[0, 4], s[0, 4] = 5.0, np.nan
    (x,) = states(series(y, std=s))
    assert len(x.days) == WEEKS - 1 and x.values.max() == 0.0


@pytest.mark.parametrize("spread", [5.0, 0.5])
def test_the_temperature_of_an_arm_alone_explains_what_goes_with_it(spread):
    warm = 30.0 + spread * LATE[None]
    (told,) = states(series(0.5 * LATE[None], warm=warm))
    assert told.changes == () and told.confounded == ""
    (cold,) = states(series(0.5 * LATE[None], warm=0.0 * warm + 30.0))
    assert len(cold.changes) == 1 and cold.confounded == ""
    (unknown,) = states(series(0.5 * LATE[None]))
    assert len(unknown.changes) == 1 and "not logged" in unknown.confounded


def test_after_its_last_change_an_arm_stands_on_what_followed():
    y = np.select([LATE, np.arange(WEEKS) >= 6], [0.0, 1.0], 0.0)
    (x,) = states(series(y[None], std=0.4))
    assert [c.day for c in x.changes] == [DAYS[6], DAYS[13]]
    assert x.level.value == pytest.approx(0.0)
    assert x.score == pytest.approx(max(abs(c.score) for c in x.changes))


@pytest.mark.parametrize(("errors", "said"), [(3.3, False), (4.8, True)])
def test_load_changed_along_if_its_means_differ_by_four_standard_errors(errors, said):
    rng, std = np.random.default_rng(17), 0.05
    noise = rng.standard_normal(WEEKS)
    for own in (LATE, ~LATE):
        noise[own] = (noise[own] - noise[own].mean()) / noise[own].std(ddof=1)
    load = 5.0 + std * noise + errors * std * np.sqrt(2 / 13) * LATE
    (x,) = states(series(1.0 * LATE[None], load=load[None]))
    assert len(x.changes) == 1 and ("load" in x.confounded) is said


def squares(y, s, shape):
    """Weighed squares that a constant and a shape leave, and the fit of the shape."""
    X = np.stack([np.ones(len(y)), shape], axis=1) / s[:, None]
    c, rest, *_ = np.linalg.lstsq(X, y / s, rcond=None)
    return float(rest[0]), c[1], np.sqrt(np.linalg.inv(X.T @ X)[1, 1])


@pytest.mark.parametrize(("kind", "size"), [("step", 0.5), ("trend", 0.01)])
def test_a_change_is_the_fit_by_least_squares_and_its_dates_a_ratio_of_likelihoods(
    kind, size
):
    rng = np.random.default_rng(3)
    s = rng.uniform(0.08, 0.15, WEEKS)
    shapes = [
        (DAYS >= x).astype(float) if kind == "step" else np.maximum(DAYS - x, 0.0)
        for x in DAYS
    ]
    y = size * shapes[10] + s * rng.standard_normal(WEEKS)
    (x,) = changes(DAYS, y, s, limit=4.5)
    begins = range(3, WEEKS - 1) if kind == "step" else range(WEEKS - 2)
    known = {k: squares(y, s, shapes[k])[0] for k in begins if DAYS[k] <= x.alarm}
    best = min(known, key=known.get)
    assert x.kind == kind and x.day == DAYS[best]
    _, fit, std = squares(y, s, shapes[best])
    assert (x.size, x.std) == pytest.approx((fit, std))
    assert x.score == pytest.approx(fit / std)
    within = [k for k in known if known[k] - known[best] <= 3.84]
    assert (x.earliest, x.latest) == (DAYS[within[0]], DAYS[within[-1]])


def test_in_a_fleet_the_temperature_of_one_arm_alone_explains_nothing():
    """The slope is that of all arms; alone, each would have one of its own."""
    rng = np.random.default_rng(4)
    warm = 30.0 + rng.standard_normal((8, WEEKS))
    warm[3] = 30.0 + 5.0 * LATE
    y = np.zeros((8, WEEKS))
    y[3] = 0.5 * LATE
    many = series(y, warm=warm)
    many.remove_common()
    assert [len(x.changes) for x in states(many)] == [0] * 3 + [1] + [0] * 4
    few = series(y[2:4], warm=warm[2:4])
    few.remove_common()
    assert [len(x.changes) for x in states(few)] == [0, 0]
