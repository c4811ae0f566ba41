"""What a flexible regression could still take from a residual: the unexplained part.

It knows no physics. It has groups of functions: smooth ones of position, speed,
acceleration, load and time, the same for each direction, products, other joints, lags,
waves over position and lines over time. Group after group is taken in as long as the
squares fall on samples that it was not fitted on. What it recovers is structure that a
model has missed; what it leaves is taken for noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.gap import Gap
from hybrid.diagnose.ripples import ripple_orders
from hybrid.robot.chain import Array
from hybrid.signals.filters import butterworth

_KNOTS = 14
_COARSE = 6
_SLOW = 0.3  # of the cut-off
_RIDGES = (1e-3, 3e-2, 1.0)
_MOST_GROUPS = 6
_WAVES = 3
_WAVY = ("position waves", "lines in time")
_MOST_FOLDS = 0.6
_PICKED = _WAVES * 2 * np.log(400)  # the largest of so many squares of noise


def recoverable(
    gap: Gap, joint: int, left: Array, rows: NDArray[np.intp], noise: float
) -> tuple[float, float, str, Array]:
    """Squares of a residual that a flexible regression recovers on held-out folds.

    Args:
        gap: The gap.
        joint: The joint.
        left: Its residual under some model, shape (R,), [N·m].
        rows: Samples of the gap that these are, shape (R,).
        noise: Square that one chosen function recovers from noise, [N²·m²].

    Returns:
        Recovered sum of squares, on every fold and on most of them only, [N²·m²];
        what the first function is of, or nothing where none helps; and what is left
        but for the former, shape (R,), [N·m].
    """
    fold = gap.fold[rows]
    folds = [fold == f for f in np.unique(fold)]
    groups = {name: x[rows] for name, x in _groups(gap, joint)}
    grams = {n: np.stack([x[f].T @ x[f] for f in folds]) for n, x in groups.items()}
    rest, first = left, ""
    sure_rest: Array | None = None
    total = {True: 0.0, False: 0.0}
    for _ in range(_MOST_GROUPS):
        groups |= _waves(gap, joint, rest, rows)
        for name in _WAVY:
            x = groups[name]
            grams[name] = np.stack([x[f].T @ x[f] for f in folds])
        # What every fold shows comes first, and counts as if there were nothing else.
        best = {everywhere: ("", rest, 0.0) for everywhere in (True, False)}
        for name, x in groups.items():
            gained, w = _cross_validated(
                grams[name], np.stack([x[f].T @ rest[f] for f in folds]), len(rows)
            )
            # Waves were picked out of hundreds with all folds in view.
            chance = _PICKED * noise if name in _WAVY else 0.0
            everywhere = bool(np.all(gained > 0))
            sure = _recurring(gained) - chance
            if sure > best[everywhere][2]:
                fitted = np.empty_like(rest)
                for k, f in enumerate(folds):
                    fitted[f] = x[f] @ w[k]
                best[everywhere] = name, fitted, sure
        least = 0.002 * float(rest @ rest)
        everywhere = best[True][2] > least
        chosen, fitted, worth = best[everywhere]
        if worth <= least:
            break
        if not everywhere and sure_rest is None:
            sure_rest = rest
        total[everywhere] += worth
        first = first or chosen
        rest = rest - fitted
    return total[True], total[False], first, rest if sure_rest is None else sure_rest


def _recurring(gained: Array) -> float:
    """Squares gained on folds, less the most of one where not all of them gain."""
    if np.all(gained > 0):
        return float(gained.sum())
    if np.mean(gained > 0) < _MOST_FOLDS:
        return 0.0
    return float(gained.sum() - gained.max())


def _cross_validated(G: Array, c: Array, samples: int) -> tuple[Array, Array]:
    """Squares gained on each fold (F,), and the weights for it from the others."""
    whole, moment = G.sum(axis=0), c.sum(axis=0)
    size = np.diag(np.diag(whole) + 1e-12 * samples)
    best, weights = np.full(len(G), -np.inf), np.zeros_like(c)
    for ridge in _RIDGES:
        w = np.linalg.solve(whole - G + ridge * size, (moment - c)[:, :, None])[..., 0]
        gained = 2 * np.einsum("fk,fk->f", w, c) - np.einsum("fk,fkl,fl->f", w, G, w)
        if gained.sum() > best.sum():
            best, weights = gained, w
    return best, weights


def _groups(gap: Gap, joint: int) -> Iterator[tuple[str, Array]]:
    """Named groups of functions at every sample, shape (M, d) each."""
    # Derivatives of positions hold their noise, and so does the residual.
    m = replace(gap.sampled, a=_slow(gap, gap.sampled.a))
    load = _slow(gap, gap.load[:, joint])
    q, v, a = m.q[:, joint], m.v[:, joint], m.a[:, joint]
    slow = 0.02 * np.abs(v).max() + 1e-12
    sign = np.tanh(v / slow)
    along = {
        "position": _hats(q, 2 * _KNOTS),
        "speed": _hats(np.sign(v) * np.sqrt(np.abs(v)), 2 * _KNOTS),
        "acceleration": _hats(a, _KNOTS),
        "load": _hats(load, _KNOTS),
        "time": _hats(m.t, 2 * _KNOTS),
    }
    yield from along.items()
    yield "direction and position", sign[:, None] * _hats(q, _KNOTS)
    yield "direction and load", sign[:, None] * _hats(load, _KNOTS)
    yield "direction and acceleration", sign[:, None] * _hats(a, _KNOTS)
    yield "speed and time", v[:, None] * _hats(m.t, _KNOTS)
    yield "speed and position", _products(_hats(q, _COARSE), _hats(v, _COARSE))
    yield "load and position", _products(_hats(q, _COARSE), _hats(load, _COARSE))
    for k in range(gap.robot.size):
        if k != joint:
            other = f"joint {gap.robot.joints[k]}"
            yield f"position of {other}", _hats(m.q[:, k], _KNOTS)
            yield f"speed of {other}", _hats(m.v[:, k], _KNOTS)
            yield f"acceleration of {other}", _hats(m.a[:, k], _KNOTS)
            both = np.stack([q * m.q[:, k], v * m.v[:, k], sign * m.q[:, k]], axis=1)
            yield f"position with that of {other}", both
            far = _products(_hats(q, 4), _hats(m.q[:, k], 4))
            yield f"posture with {other}", far
    side = np.tanh(load / (0.02 * np.abs(load).max() + 1e-12))
    with_past = {
        "speed": _slow(gap, v), "acceleration": a, "load": load, "direction": sign,
        "side of the load": side,
    }  # fmt: skip
    for name, x in with_past.items():
        past = [np.roll(x, s) - x for s in (1, 2, 4, 8, 16, 32)]
        yield f"past of {name}", np.stack(past, axis=1)


def _slow(gap: Gap, x: Array) -> Array:
    """Signals without the upper part of the band, shape (M, ...)."""
    parts = [x[gap.trajectory == k] for k in range(len(gap.motions))]
    cutoff = _SLOW * gap.cutoff
    return np.concatenate([butterworth(p, rate=gap.rate, cutoff=cutoff) for p in parts])


def _waves(
    gap: Gap, joint: int, rest: Array, rows: NDArray[np.intp]
) -> dict[str, Array]:
    """Strongest waves of a residual over position and over time."""
    m = gap.sampled
    q, v, t = m.q[rows, joint], m.v[rows, joint], m.t[rows]
    orders = ripple_orders(rest, q, v, gap.cutoff, _WAVES)
    angles = [k * q for k in orders]
    full = np.zeros(int(rows.max()) + 1)
    full[rows] = rest
    power = np.abs(np.fft.rfft(full)) ** 2
    frequency = np.fft.rfftfreq(len(full), 1.0 / gap.rate)
    power[frequency < 0.5] = 0.0
    lines = frequency[np.argsort(-power)[:_WAVES]]
    tones = [2 * np.pi * f * t for f in lines]
    return {
        "position waves": _pairs(angles, len(rows)),
        "lines in time": _pairs(tones, len(rows)),
    }


def _pairs(angles: list[Array], rows: int) -> Array:
    if not angles:
        return np.zeros((rows, 1))
    return np.stack([f(x) for x in angles for f in (np.sin, np.cos)], axis=1)


def _hats(x: Array, count: int) -> Array:
    """Linear hat functions over the range of x, shape (M, count)."""
    low, high = np.quantile(x, [0.002, 0.998])
    place = np.clip((x - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    hats = 1.0 - np.abs(place[:, None] - np.arange(count))
    return np.asarray(np.maximum(hats, 0.0))


def _products(a: Array, b: Array) -> Array:
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)
