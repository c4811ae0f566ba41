"""Detection of changes of one parameter of one arm, at a stated false-alarm rate.

The statistic is the generalised likelihood ratio of a step or ramp against a constant,
on all data up to each period (Siegmund and Venkatraman 1995, doi
10.1214/aos/1176324466): the largest squared score of the size of a step or ramp. The
threshold for the stated rate is found by simulation of noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.special import ndtr, stdtrit

from hybrid.arrays import Array, Index

Kind = Literal["step", "trend"]

MONTH = 30.4375  # d
_BEFORE, _AFTER = 3, 2  # fewest periods before and after a step
_FEWEST = _BEFORE + _AFTER
_LOOK_BACK = 52  # periods
_NOISE_PATHS = 20_000  # simulated for the threshold
_TAIL = 0.01  # probability below which quantiles are extrapolated
_LIKELIHOOD_RANGE = 3.84  # of twice the log likelihood, for a 95 % interval
_DRAWS = 2000


@dataclass(frozen=True)
class Change:
    """One change of one parameter.

    Attributes:
        kind: ``step``, or ``trend``: a ramp that began on ``day``.
        day: Time of the step or beginning of the ramp, [d] on the clock of the series.
        earliest: Lower end of the 95 % interval of ``day``.
        latest: Upper end of the 95 % interval of ``day``.
        alarm: Time of the detection, [d].
        size: Of a step, in the unit; of a trend, its slope in the unit per day.
        std: Standard deviation of the size.
        score: Size over its standard deviation.
    """

    kind: Kind
    day: float
    earliest: float
    latest: float
    alarm: float
    size: float
    std: float
    score: float


@dataclass(frozen=True)
class Level:
    """The value of a parameter in its last period.

    Attributes:
        value: Deviation from the baseline.
        std: Standard deviation of the value.
        slope: Trend since the last change, per day.
        slope_std: Standard deviation of the slope.
        covariance: Covariance of value and slope.
    """

    value: float
    std: float
    slope: float
    slope_std: float
    covariance: float


def _shapes(t: Array) -> tuple[Array, Index, int]:
    """Steps, then ramps, shape (N, shapes); their first periods; number of steps."""
    n = len(t)
    steps = np.arange(_BEFORE, n - _AFTER + 1)
    ramps = np.arange(0, n - _AFTER)
    H = np.hstack([
        (np.arange(n)[:, None] >= steps).astype(float),
        np.maximum(t[:, None] - t[ramps], 0.0),
    ])  # fmt: skip
    return H, np.concatenate([steps, ramps]), len(steps)


def _scores(t: Array, y: Array, s: Array, x: Array | None) -> tuple[Array, Array]:
    """Score of every step and ramp, and the standard deviation of its size.

    Values may be of one series, shape (N,), or of many, shape (N, series).
    """
    H, _, _ = _shapes(t)
    known = [np.ones(len(t))] if x is None else [np.ones(len(t)), x - x.mean()]
    Q, _ = np.linalg.qr(np.stack(known, axis=1) / s[:, None])
    H = H / s[:, None]
    own = np.linalg.norm(H, axis=0)
    H = H - Q @ (Q.T @ H)
    size = np.linalg.norm(H, axis=0)
    size = np.where(size > 1e-6 * own, size, np.inf)  # collinear with x: no score
    return ((y.T / s) @ H / size).T, 1.0 / size


def threshold(count: int, days: float, series: int, false_alarms: float) -> float:
    """Score above which an alarm is raised, after a count of periods of some days.

    ``series`` parameters of each arm are monitored, and ``false_alarms`` are expected
    in 100 arm-months.
    """
    count = int(np.clip(count, _FEWEST, _LOOK_BACK))
    rate = min(0.5, false_alarms / 100 * count * days / MONTH / series)
    highest = _largest_scores(count)
    quantile = np.quantile(highest, 1 - max(rate, _TAIL))
    excess = highest[highest > quantile].mean() - quantile  # the tail is exponential
    return float(np.sqrt(quantile + excess * np.log(max(rate, _TAIL) / rate)))


@lru_cache(maxsize=8)
def _largest_scores(count: int) -> Array:
    """Largest squared score of each simulated path of normal noise."""
    noise = np.random.default_rng(0).standard_normal((count, _NOISE_PATHS))
    t, highest = np.arange(count, dtype=float), np.zeros(_NOISE_PATHS)
    for n in range(_FEWEST, count + 1):
        z, _ = _scores(t[:n], noise[:n], np.ones(n), None)
        np.maximum(highest, (z**2).max(axis=0), out=highest)
    return highest


def changes(
    t: Array,
    y: Array,
    s: Array,
    *,
    limit: float,
    degrees: float = np.inf,
    x: Array | None = None,
) -> Iterator[Change]:
    """Changes of one series, in order of time.

    At days t of N periods it has the values y and their standard deviations s, with
    some degrees of freedom; the values may depend on a covariate x. ``limit`` is the
    score of an alarm, see :func:`threshold`.
    """
    # The limit of the same probability for scores with an estimated variance.
    limit = -float(stdtrit(max(degrees, 1.0), float(ndtr(-limit))))
    start = 0
    while True:
        alarm = _first_alarm(t, y, s, limit, x, start)
        if alarm is None:
            return
        # All data describe the change best, unless it has been reversed since.
        parts = slice(start, len(t)), slice(start, alarm + 1)
        each = [_change(*_part(t, y, s, x, k), float(t[alarm])) for k in parts]
        found = max(each, key=lambda change: abs(change.score))
        yield found
        if found.kind == "trend":
            return
        start = int(np.searchsorted(t, found.day))


def _part(
    t: Array, y: Array, s: Array, x: Array | None, part: slice
) -> tuple[Array, Array, Array, Array | None]:
    return t[part], y[part], s[part], None if x is None else x[part]


def _change(t: Array, y: Array, s: Array, x: Array | None, alarm: float) -> Change:
    """The step or ramp of largest score that began before an alarm."""
    z, std = _scores(t, y, s, x)
    _, begins, steps = _shapes(t)
    z = np.where(t[begins] <= alarm, z, 0.0)
    best = int(np.argmax(np.abs(z)))
    same_kind = (np.arange(len(z)) < steps) == (best < steps)
    near = t[begins[same_kind & (z**2 >= z[best] ** 2 - _LIKELIHOOD_RANGE)]]
    size = z[best] * std[best], std[best], z[best]
    days = t[begins[best]], near.min(), near.max(), alarm
    return Change("step" if best < steps else "trend", *map(float, (*days, *size)))


def _first_alarm(
    t: Array, y: Array, s: Array, limit: float, x: Array | None, start: int
) -> int | None:
    for n in range(start + _FEWEST, len(t) + 1):
        z, _ = _scores(*_part(t, y, s, x, slice(max(start, n - _LOOK_BACK), n)))
        if np.abs(z).max() > limit:
            return n - 1
    return None


def level(t: Array, y: Array, s: Array, last: Change | None) -> Level:
    """The last value of a series: of a constant, or of a trend after such a change."""
    here = t >= (last.day if last else -np.inf)
    t, y, s = t[here] - t[-1], y[here], s[here]
    X = np.stack([np.ones(len(t)), t], axis=1) / s[:, None]
    covariance = np.linalg.pinv(X.T @ X, hermitian=True)
    value, slope = covariance @ (X.T @ (y / s))
    std = np.sqrt(np.diag(covariance))
    if last is None or last.kind == "step":
        weight = s**-2 / (s**-2).sum()
        return Level(float(weight @ y), float((s**-2).sum() ** -0.5),
                     float(slope), float(std[1]), 0.0)  # fmt: skip
    return Level(*map(float, (value, std[0], slope, std[1], covariance[0, 1])))


def crossing(now: Level, limit: float) -> tuple[float, float, float]:
    """Days until a parameter passes a limit: median and 95 % interval; inf if never."""
    covariance = [[now.std**2, now.covariance], [now.covariance, now.slope_std**2]]
    value, slope = (
        np.random.default_rng(0)
        .multivariate_normal([now.value, now.slope], covariance, _DRAWS)
        .T
    )
    with np.errstate(divide="ignore"):
        days = (np.where(slope > 0, limit, -limit) - value) / slope
    days = np.where(np.abs(value) >= limit, 0.0, np.where(days > 0, days, np.inf))
    early, median, late = np.quantile(days, [0.025, 0.5, 0.975], method="nearest")
    return float(median), float(early), float(late)
