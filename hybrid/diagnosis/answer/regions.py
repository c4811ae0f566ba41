"""Find where the gap lies: at which joint, under which conditions, at which frequency.

The excess is the sum of squares above noise, in units of each joint's noise. For each
joint and variable the densest range is reported: its excess is farthest above the
excess that its share of the joint's samples would have.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.diagnosis import Region
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import seconds

TORQUE_TO_MOTION = "torque to motion"

_RESAMPLES = 1000
_FALSE_ALARM = 0.05  # probability, of all regions together
_NOISE_ERROR = 0.05  # relative, of the estimate of the noise
_FEWEST_SECONDS = 0.2  # in a bin
_MOST_BINS = 10
# Edges of bins of variables over decades: speed [rad/s], time [s], frequency [Hz].
_ROUND = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_FIRST_BAND = 0.5  # Hz, its end


@dataclass(frozen=True)
class _Histogram:
    """Excess and samples of a joint in the bins of one variable."""

    # Each sample counts in all bands of frequency, by their share of the noise.

    joint: int
    variable: str
    unit: str
    edges: Array  # (K + 1,)
    excess: Array  # by block of time and bin, (B, K)
    samples: Array  # the same


@dataclass(frozen=True)
class _Test:
    """Significance test of an excess."""

    draws: NDArray[np.int64]  # how often a block is in each resample, (R, B)
    limit: float  # critical value, [standard deviations], for all regions together
    correlated: float  # samples per independent sample

    def exceeds(self, excess: float, samples: float) -> bool:
        """Whether an excess is significant, and above the error of the noise."""
        # The variance of a squared standard normal variable is 2.
        chance = self.limit * np.sqrt(2 * samples * self.correlated)
        return bool(excess > max(chance, _NOISE_ERROR * samples))


def locate(gap: Gap, noise: Array, rng: np.random.Generator) -> tuple[Region, ...]:
    """Find the parts of the gap with more excess than their share of the samples.

    A joint as a whole is the variable ``link``. Noise, whose RMS has shape (n,), [N·m],
    is assumed to be white up to the cut-off. The excess is significant at 5 % for all
    regions together; the largest lead over the share of samples comes first.
    """
    histograms = list(_histograms(gap, np.maximum(noise, 1e-12)))
    whole = [c for c in histograms if c.variable == "link"]
    if not whole:
        return ()
    squares = np.concatenate([c.excess for c in whole], axis=1).sum(axis=1)  # (B,)
    visits, blocks = sum(c.samples.sum() for c in whole), len(squares)
    # Number of tests: every range of neighbouring bins.
    ranges = sum(c.excess.shape[1] * (c.excess.shape[1] + 1) // 2 for c in histograms)
    test = _Test(
        rng.multinomial(blocks, np.full(blocks, 1 / blocks), _RESAMPLES),
        -float(ndtri(_FALSE_ALARM / ranges)),
        gap.rate / (2 * _band(gap)),
    )
    if not test.exceeds(squares.sum(), visits):
        return ()
    drawn = test.draws @ squares
    some = drawn > 0  # no share of blocks in which the arm stands
    found = []
    for x in histograms:
        best = _densest(x, test)
        if best is None:
            continue
        inside = x.excess[:, best].sum(axis=1)
        # Chance leaves less than the noise elsewhere, and a share of more than 1.
        share = float(np.clip(inside.sum() / squares.sum(), 0.0, 1.0))
        shares = np.clip((test.draws @ inside)[some] / drawn[some], 0.0, 1.0)
        low, high = np.quantile(shares, [0.025, 0.975]).tolist()
        start, end = x.edges[[best.start, best.stop]].tolist()
        joint, ends = gap.robot.joints[x.joint], (low, high)
        region = Region(joint, x.variable, start, end, x.unit, share, ends)
        found.append((share - float(x.samples[:, best].sum() / visits), region))
    return tuple(region for _, region in sorted(found, key=lambda x: -x[0]))


def _densest(histogram: _Histogram, test: _Test) -> slice | None:
    """Neighbouring bins with the largest lead over their share of the samples."""
    # None if the lead is not significant, or if it covers all bins.
    excess, samples = histogram.excess.sum(axis=0), histogram.samples.sum(axis=0)
    if histogram.variable == "link":
        return slice(0, 1) if test.exceeds(excess[0], samples[0]) else None
    mean = excess.sum() / samples.sum()
    sums = np.concatenate([[0.0], np.cumsum(excess - mean * samples)])
    gained = np.triu(sums[None, :] - sums[:, None], 1)
    first, last = np.unravel_index(int(gained.argmax()), gained.shape)
    best = slice(int(first), int(last))
    if last - first >= len(excess) or gained[first, last] <= 0:
        return None
    over = test.exceeds(excess[best].sum(), samples[best].sum())
    over &= test.exceeds(gained[first, last], samples[best].sum())
    # Significant over blocks of time as well, not in a single one.
    inside, visited = test.draws @ histogram.excess, test.draws @ histogram.samples
    means = inside.sum(axis=1) / np.maximum(visited.sum(axis=1), 1e-12)
    lead = (inside[:, best] - means[:, None] * visited[:, best]).sum(axis=1)
    return best if over and np.quantile(lead, 0.025) > 0 else None


def _histograms(gap: Gap, noise: Array) -> Iterator[_Histogram]:
    """Excess of every joint over every variable, in bins with enough samples."""
    block, blocks = seconds(gap), int(seconds(gap).max()) + 1
    fewest = _FEWEST_SECONDS * gap.rate
    for i in range(gap.robot.size):
        rows = np.flatnonzero(gap.moving[:, i])
        if len(rows) < fewest:
            continue
        excess = (gap.left[rows, i] / noise[i]) ** 2 - 1.0
        for variable, unit, x, edges in _variables(gap, i, rows):
            edges = _merged_edges(edges, x, fewest)
            size = len(edges) - 1
            place = np.clip(np.searchsorted(edges, x, "right") - 1, 0, size - 1)
            at = block[rows] * size + place
            squares, samples = (
                np.bincount(at, x, blocks * size).reshape(-1, size).astype(np.float64)
                for x in (excess, None)
            )
            yield _Histogram(i, variable, unit, edges, squares, samples)
        yield _bands(gap, i, noise[i], rows, block[rows], blocks)


def _variables(
    gap: Gap, i: int, rows: Index
) -> Iterator[tuple[str, str, Array, Array]]:
    """Name and unit of each variable, its values at the samples and edges of bins."""
    m = gap.sampled
    angle, force = (gap.robot.chain.unit_at([i], x) for x in ("rad", "N·m"))
    speed, since = np.abs(m.v[rows, i]), time_since_reversal(gap, i)[rows]
    yield "link", TORQUE_TO_MOTION, np.zeros(len(rows)), np.array([0.0, 1.0])
    yield "speed", f"{angle}/s", speed, _decade_edges(speed)
    yield "direction", "", np.sign(m.v[rows, i]), np.array([-1.0, 0.0, 1.0])
    yield "position", angle, m.q[rows, i], _even_edges(m.q[rows, i])
    yield "load", force, gap.load[rows, i], _even_edges(gap.load[rows, i])
    yield "time_since_reversal", "s", since, _decade_edges(since)
    yield "time", "s", m.t[rows], _even_edges(m.t[rows])
    if m.temperature is not None:
        temperature = m.temperature[rows, i]
        yield "temperature", "°C", temperature, _even_edges(temperature)


def time_since_reversal(gap: Gap, joint: int) -> Array:
    """Time since a joint's last reversal, or since its log began, shape (M,), [s]."""
    v = gap.sampled.v[:, joint]
    turned = np.ones(len(v), dtype=bool)
    turned[1:] = (v[1:] * v[:-1] <= 0) | (np.diff(gap.trajectory) != 0)
    at = np.arange(len(v))
    return np.asarray((at - np.maximum.accumulate(np.where(turned, at, 0))) / gap.rate)


def _bands(
    gap: Gap, i: int, noise: float, rows: Index, block: Index, blocks: int
) -> _Histogram:
    """Excess of a joint in bands of frequency, each with noise by its width."""
    band = _band(gap)
    inner = (b for b in _ROUND if _FIRST_BAND <= b < 0.8 * band)
    edges = np.array([0.0, *inner, band])
    part = np.diff(edges) / band
    power = np.empty((len(gap.left), len(part)))
    for r in np.unique(gap.trajectory):
        own = gap.trajectory == r
        x = np.where(gap.moving[own, i], gap.left[own, i], 0.0) / noise
        # The last band includes what passes above the cut-off.
        place = np.searchsorted(
            edges[1:-1], np.fft.rfftfreq(len(x), 1 / gap.rate), "right"
        )
        lines = np.fft.rfft(x) * (place == np.arange(len(part))[:, None])
        power[own] = np.fft.irfft(lines, len(x)).T ** 2
    excess = [np.bincount(block, e, blocks) for e in (power[rows] - part).T]
    samples = np.outer(np.bincount(block, minlength=blocks), part)
    return _Histogram(i, "frequency", "Hz", edges, np.stack(excess, axis=1), samples)


def _band(gap: Gap) -> float:
    """Bandwidth of the noise, [Hz]."""
    return min(gap.cutoff, gap.rate / 2)


def _decade_edges(x: Array) -> Array:
    """Edges 1, 2, 5, 10, ... from zero to the first one above all values."""
    inner = [e for e in _ROUND if e < x.max()]
    return np.array([0.0, *inner, *_ROUND[len(inner) : len(inner) + 1]])


def _merged_edges(edges: Array, x: Array, fewest: float) -> Array:
    """Edges of bins that are merged until each holds enough values."""
    kept, count = [float(edges[0])], 0
    for edge, size in zip(edges[1:], np.histogram(x, edges)[0], strict=True):
        count += int(size)
        if count >= fewest:
            kept.append(float(edge))
            count = 0
    if len(kept) == 1:
        kept.append(float(edges[-1]))
    kept[-1] = float(edges[-1])
    return np.array(kept)


def _even_edges(x: Array) -> Array:
    """Equidistant round edges over the range of x, for at most ten bins."""
    low, high = float(x.min()), float(x.max())
    span = max(high - low, 1e-6)
    decade = 10 ** np.floor(np.log10(span / _MOST_BINS))
    sizes = decade * np.array([1.0, 2.0, 5.0, 10.0])
    step = next(float(s) for s in sizes if span / s <= _MOST_BINS - 1 or s == sizes[-1])
    first, last = np.floor(low / step), np.floor(high / step) + 1
    return np.asarray(np.arange(first, last + 1) * step)
