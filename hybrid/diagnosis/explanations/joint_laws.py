"""Unknown laws of a joint's torque: smooth functions of signals."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.ripples import ripple_orders
from hybrid.diagnosis.gap.gap import Gap
from hybrid.signals.filters import butterworth

_KNOTS = 14  # of a function of one signal
_COARSE = 6  # of a function of two signals, for each
_LENGTHS = 0.5, 0.1  # of the range, length scales of a law
_LEAST = 1e-3  # power of a mode over that of the strongest one
_SLOW = 0.3  # of the cut-off of positions
WAVES = 3  # sinusoids in a law
_SLOWEST = 0.5  # Hz, of a sinusoid in time


def joint_laws(gap: Gap, joint: int) -> Iterator[tuple[str, Array]]:
    """Yield the name of each law, and its features at every sample, shape (M, d)."""
    # Derivatives of positions and the residual contain the same noise.
    m = replace(gap.sampled, a=_slow(gap, gap.sampled.a))
    load = _slow(gap, gap.load[:, joint])
    q, v, a = m.q[:, joint], m.v[:, joint], m.a[:, joint]
    sign = smooth_sign(v)
    yield "position", smooth_features(q, 2 * _KNOTS)
    yield "speed", smooth_features(np.sign(v) * np.sqrt(np.abs(v)), 2 * _KNOTS)
    yield "acceleration", smooth_features(a, _KNOTS)
    yield "load", smooth_features(load, _KNOTS)
    yield "time", smooth_features(m.t, 2 * _KNOTS)
    for name, x in (("position", q), ("load", load), ("acceleration", a)):
        law = sign[:, None] * smooth_features(x, _KNOTS)
        yield f"direction and {name}", low_passed(gap, law, gap.cutoff)
    yield "speed and time", v[:, None] * smooth_features(m.t, _KNOTS)
    yield (
        "speed and position",
        _products(smooth_features(q, _COARSE), smooth_features(v, _COARSE)),
    )
    yield (
        "load and position",
        _products(smooth_features(q, _COARSE), smooth_features(load, _COARSE)),
    )
    for k in range(gap.robot.size):
        if k != joint:
            other = gap.robot.joints[k]
            yield f"speed of {other}", smooth_features(m.v[:, k], _KNOTS)
            yield f"acceleration of {other}", smooth_features(m.a[:, k], _KNOTS)
            yield (
                f"position of {other}",
                _products(smooth_features(q, 4), smooth_features(m.q[:, k], 4)),
            )
    side = smooth_sign(gap.load[:, joint])
    signals = {"speed": _slow(gap, v), "load": load, "direction": sign, "side": side}
    for name, x in signals.items():
        yield f"past of {name}", low_passed(gap, lagged_differences(gap, x), gap.cutoff)


def waves(
    gap: Gap, joint: int, left: Array, rows: Index
) -> Iterator[tuple[str, Array]]:
    """Yield the strongest sinusoids of a joint's residual, over position and time.

    ``left`` is the residual, [N·m], and ``rows`` are its samples of the gap, shape (R,)
    each. The sines and cosines are at every sample, shape (M, d).
    """
    m = gap.sampled
    q, v = m.q[:, joint], m.v[:, joint]
    orders = ripple_orders(left, q[rows], v[rows], gap.cutoff, WAVES)
    yield "waves of position", _pairs([float(k) * q for k in orders])
    full = np.zeros(len(q))
    full[rows] = left
    power = np.abs(np.fft.rfft(full)) ** 2
    frequency = np.fft.rfftfreq(len(full), 1.0 / gap.rate)
    power[frequency < _SLOWEST] = 0.0
    lines = frequency[np.argsort(-power)[:WAVES]]
    yield "waves in time", _pairs([2 * np.pi * f * m.t for f in lines])


def _pairs(angles: list[Array]) -> Array:
    return np.stack([f(x) for x in angles for f in (np.sin, np.cos)], axis=1)


def _slow(gap: Gap, x: Array) -> Array:
    """Signals in the lower part of the band, shape (M, ...)."""
    return low_passed(gap, x, gap.lower_cutoff(_SLOW))


def low_passed(gap: Gap, x: Array, cutoff: float) -> Array:
    """Low-pass filtered signals of each recording, shape (M, ...)."""
    parts = [x[gap.trajectory == k] for k in range(len(gap.motions))]
    return np.concatenate([butterworth(p, rate=gap.rate, cutoff=cutoff) for p in parts])


def smooth_sign(x: Array) -> Array:
    """Smooth sign of a signal, from −1 to 1, shape (M,)."""
    return np.asarray(np.tanh(x / (0.02 * np.abs(x).max() + 1e-12)))


def lagged_differences(gap: Gap, x: Array) -> Array:
    """Differences of earlier samples from the present one, shape (M, d)."""
    first = np.flatnonzero(np.diff(gap.trajectory, prepend=-1))[gap.trajectory]
    now = np.arange(len(x))
    steps = [x[np.maximum(now - s, first)] - x for s in (1, 2, 4, 8, 16, 32)]
    return np.stack(steps, axis=1)


def smooth_features(x: Array, count: int) -> Array:
    """Features of a smooth function over the range of x, shape (M, d).

    With independent gains of unit variance the function is a Gaussian process with a
    long and a short length scale, linear between some knots.

    Args:
        x: A signal, shape (M,).
        count: Number of knots.
    """
    low, high = np.quantile(x, [0.002, 0.998])
    place = np.clip((x - low) / max(high - low, 1e-12), 0.0, 1.0) * (count - 1)
    hats = np.maximum(1.0 - np.abs(place[:, None] - np.arange(count)), 0.0)
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / (count - 1)
    kernel = np.mean([np.exp(-0.5 * (apart / x) ** 2) for x in _LENGTHS], axis=0)
    power, modes = np.linalg.eigh(kernel)
    kept = power > _LEAST * power.max()
    return np.asarray(hats @ (modes[:, kept] * np.sqrt(power[kept])))


def _products(a: Array, b: Array) -> Array:
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)
