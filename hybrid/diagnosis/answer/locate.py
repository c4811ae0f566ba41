"""Where the gap lies: which joint, under which conditions, in which frequency band.

Squares count in units of each joint's noise, less the noise itself. Of each joint and
variable the range is reported in which this excess is densest: the one with the largest
excess over what its share of the joint's samples would bring.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Region
from hybrid.diagnosis.answer.intervals import BLOCK_SECONDS
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.units import units

TORQUE_TO_MOTION = "torque to motion"

_RESAMPLES = 1000
_FALSE_ALARM = 0.05  # of all regions together
_NEGLIGIBLE = 0.05  # of the noise, by which its estimate may be off
_FEWEST_SECONDS = 0.2  # in a bin
_MOST_BINS = 10
# Ends of bins of what varies over decades: speed [rad/s], time [s], frequency [Hz].
_ROUND = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_SLOWEST = 0.5  # Hz, the end of the first band


@dataclass(frozen=True)
class _Cut:
    """A joint's excess and samples, dealt over the bins of one variable.

    Attributes:
        joint: The joint.
        variable: What the bins are ranges of.
        unit: Its unit.
        edges: Their ends, shape (K + 1,).
        excess: Squares over the noise floor, by block of time, shape (B, K), [1].
        samples: Number of samples, shape (B, K); where bins are bands of frequency,
            each sample counts in all of them, by their part of the noise.
    """

    joint: int
    variable: str
    unit: str
    edges: Array
    excess: Array
    samples: Array


@dataclass(frozen=True)
class _Test:
    """What an excess is held against.

    Attributes:
        draws: How often each block of time counts in each resample, shape (R, B).
        limit: Standard deviations above which one of all regions is not chance.
        alike: Samples for an independent one.
    """

    draws: NDArray[np.int64]
    limit: float
    alike: float

    def exceeds(self, excess: float, samples: float) -> bool:
        """Whether squares are above those of noise, and by enough to matter.

        The square of white noise that passed the filter scatters by √2, and repeats
        itself over as many samples as the filter is slower than the clock.
        """
        chance = self.limit * np.sqrt(2 * samples * self.alike)
        return bool(excess > max(chance, _NEGLIGIBLE * samples))


def locate(gap: Gap, noise: Array, rng: np.random.Generator) -> tuple[Region, ...]:
    """Parts of the gap that hold more of it than their share of the samples.

    The joint as a whole is the link of the chain from torque to motion, where torque is
    compared. Noise is taken to be white up to the cut-off.

    Args:
        gap: The gap.
        noise: RMS of each joint that no model could remove, shape (n,), [N·m].
        rng: Draws of the bootstrap over blocks of time.

    Returns:
        Regions above the noise floor, at 5 % for all of them together; largest excess
        over their share of the samples first. Nothing where there is no gap.
    """
    cuts = list(_cuts(gap, np.maximum(np.asarray(noise, dtype=float), 1e-12)))
    whole = [c for c in cuts if c.variable == "link"]
    if not whole:
        return ()
    squares = np.concatenate([c.excess for c in whole], axis=1).sum(axis=1)  # (B,)
    visits = sum(c.samples.sum() for c in whole)
    blocks = len(squares)
    # As many ranges might be picked.
    ranges = sum(c.excess.shape[1] * (c.excess.shape[1] + 1) // 2 for c in cuts)
    test = _Test(
        rng.multinomial(blocks, np.full(blocks, 1 / blocks), _RESAMPLES),
        float(norm.isf(_FALSE_ALARM / ranges)),
        gap.rate / (2 * _band(gap)),
    )
    if not test.exceeds(squares.sum(), visits):
        return ()
    drawn = test.draws @ squares
    found = []
    for cut in cuts:
        best = _densest(cut, test)
        if best is None:
            continue
        inside = cut.excess[:, best].sum(axis=1)
        share = float(inside.sum() / squares.sum())
        low, high = np.quantile((test.draws @ inside) / drawn, [0.025, 0.975])
        lead = share - float(cut.samples[:, best].sum() / visits)
        region = Region(
            gap.robot.joints[cut.joint], cut.variable,
            float(cut.edges[best.start]), float(cut.edges[best.stop]), cut.unit,
            share, (float(low), float(high)),
        )  # fmt: skip
        found.append((lead, region))
    found.sort(key=lambda x: -x[0])
    return tuple(region for _, region in found)


def _densest(cut: _Cut, test: _Test) -> slice | None:
    """Bins next to each other with the largest excess over their share of samples.

    Nothing where it is not significant, or where the excess is the same everywhere.
    """
    excess, samples = cut.excess.sum(axis=0), cut.samples.sum(axis=0)
    if cut.variable == "link":
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
    # Over blocks of time, too: what one block shows is no property of the region.
    inside, visited = test.draws @ cut.excess, test.draws @ cut.samples
    means = inside.sum(axis=1) / np.maximum(visited.sum(axis=1), 1e-12)
    lead = (inside[:, best] - means[:, None] * visited[:, best]).sum(axis=1)
    return best if over and np.quantile(lead, 0.025) > 0 else None


def _cuts(gap: Gap, noise: Array) -> Iterator[_Cut]:
    """Every joint over every variable, with the bins that the samples visit."""
    seconds = gap.trajectory * 1e6 + gap.sampled.t // BLOCK_SECONDS
    block: Index = np.unique(seconds, return_inverse=True)[1]
    blocks = int(block.max()) + 1
    fewest = _FEWEST_SECONDS * gap.rate
    for i in range(gap.robot.size):
        rows = np.flatnonzero(gap.moving[:, i])
        if len(rows) < fewest:
            continue
        excess = (gap.left[rows, i] / noise[i]) ** 2 - 1.0
        for variable, unit, x, edges in _variables(gap, i, rows):
            edges = _visited(edges, x, fewest)
            size = len(edges) - 1
            place = np.clip(np.searchsorted(edges, x, "right") - 1, 0, size - 1)
            at = block[rows] * size + place
            squares, samples = (
                np.bincount(at, x, blocks * size).reshape(-1, size).astype(np.float64)
                for x in (excess, None)
            )
            yield _Cut(i, variable, unit, edges, squares, samples)
        yield _bands(gap, i, noise[i], rows, block[rows], blocks)


def _variables(
    gap: Gap, i: int, rows: Index
) -> Iterator[tuple[str, str, Array, Array]]:
    """Name, unit, values at the samples and edges of bins of each variable."""
    m = gap.sampled
    angle, force = units(gap.robot, [i])
    speed, since = np.abs(m.v[rows, i]), time_since_reversal(gap, i)[rows]
    yield "link", TORQUE_TO_MOTION, np.zeros(len(rows)), np.array([0.0, 1.0])
    yield "speed", f"{angle}/s", speed, _upto(speed)
    yield "direction", "", np.sign(m.v[rows, i]), np.array([-1.0, 0.0, 1.0])
    yield "position", angle, m.q[rows, i], _even(m.q[rows, i])
    yield "load", force, gap.load[rows, i], _even(gap.load[rows, i])
    yield "time_since_reversal", "s", since, _upto(since)
    yield "time", "s", m.t[rows], _even(m.t[rows])
    if m.temperature is not None:
        warm = m.temperature[rows, i]
        yield "temperature", "°C", warm, _even(warm)


def time_since_reversal(gap: Gap, joint: int) -> Array:
    """Time since a joint last turned round, or since its log began, shape (M,), [s]."""
    v = gap.sampled.v[:, joint]
    turned = np.ones(len(v), dtype=bool)
    turned[1:] = (v[1:] * v[:-1] <= 0) | (np.diff(gap.trajectory) != 0)
    at = np.arange(len(v))
    return np.asarray((at - np.maximum.accumulate(np.where(turned, at, 0))) / gap.rate)


def _bands(
    gap: Gap, i: int, noise: float, rows: Index, block: Index, blocks: int
) -> _Cut:
    """The gap in bands of frequency; noise is shared out by their width."""
    band = _band(gap)
    edges = np.array([0.0, *(b for b in _ROUND if _SLOWEST <= b < 0.8 * band), band])
    part = np.diff(edges) / band
    power = np.empty((len(gap.left), len(part)))
    for r in np.unique(gap.trajectory):
        own = gap.trajectory == r
        x = np.where(gap.moving[own, i], gap.left[own, i], 0.0) / noise
        # What passes above the cut-off belongs to the last band.
        place = np.searchsorted(
            edges[1:-1], np.fft.rfftfreq(len(x), 1 / gap.rate), "right"
        )
        lines = np.fft.rfft(x) * (place == np.arange(len(part))[:, None])
        power[own] = np.fft.irfft(lines, len(x)).T ** 2
    excess = [np.bincount(block, e, blocks) for e in (power[rows] - part).T]
    samples = np.outer(np.bincount(block, minlength=blocks), part)
    return _Cut(i, "frequency", "Hz", edges, np.stack(excess, axis=1), samples)


def _band(gap: Gap) -> float:
    """Frequency up to which there is noise, [Hz]."""
    return min(gap.cutoff, gap.rate / 2)


def _upto(x: Array) -> Array:
    """Round edges from zero to the first one above all values."""
    inner = [e for e in _ROUND if e < x.max()]
    return np.array([0.0, *inner, *_ROUND[len(inner) : len(inner) + 1]])


def _visited(edges: Array, x: Array, fewest: float) -> Array:
    """The edges without those that leave too few values between them."""
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


def _even(x: Array) -> Array:
    """Round edges over the range of x, at most so many bins."""
    low, high = float(x.min()), float(x.max())
    span = max(high - low, 1e-6)
    decade = 10 ** np.floor(np.log10(span / _MOST_BINS))
    sizes = decade * np.array([1.0, 2.0, 5.0, 10.0])
    step = next(float(s) for s in sizes if span / s <= _MOST_BINS - 1 or s == sizes[-1])
    first, last = np.floor(low / step), np.floor(high / step) + 1
    return np.asarray(np.arange(first, last + 1) * step)
