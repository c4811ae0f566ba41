"""Encoders and speeds of many kinds for the true motion of a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from hybrid.arrays import Array
from hybrid.recording import Recording

Kind = Callable[[Recording, Array, np.random.Generator], Array]

STEP = 2 * np.pi / 2**15  # rad, of an encoder of 15 bit
JITTER = 2e-4  # s: samples are taken that much earlier or later than they are stamped
NOISE = 1e-3  # rad/s, of a good speed
LATE = 0.005  # s


def encoder(log: Recording, rng: np.random.Generator) -> Array:
    """Positions in steps."""
    return np.round(log.q / STEP) * STEP


def jittering(log: Recording, rng: np.random.Generator) -> Array:
    """Positions at other times than the log says."""
    t = log.t + JITTER * rng.standard_normal(len(log.t))
    return np.stack([np.interp(t, log.t, x) for x in log.q.T], axis=1)


ENCODERS = {"15 bit": encoder, "stamps off by 0.2 ms": jittering}


def noisy(log: Recording, size: float, rng: np.random.Generator) -> Array:
    """True speed with white noise."""
    return log.v + size * rng.standard_normal(log.v.shape)


def slow(v: Array, log: Recording, cutoff: float) -> Array:
    """A signal that has passed a first-order filter."""
    past = np.exp(-2 * np.pi * cutoff / log.rate)
    return lfilter([1 - past], [1, -past], v, axis=0, zi=past * v[:1])[0]


def difference(log: Recording, q: Array) -> Array:
    """Backward differences of the measured position."""
    return np.diff(q, axis=0, prepend=q[:1]) * log.rate


def late(log: Recording, rng: np.random.Generator) -> Array:
    """True speed of a while ago, with noise."""
    v = [np.interp(log.t - LATE, log.t, x) for x in log.v.T]
    return noisy(replace(log, v=np.stack(v, axis=1)), NOISE, rng)


def stopping(log: Recording, rng: np.random.Generator) -> Array:
    """A good speed that is zero in the last tenth."""
    return noisy(log, NOISE, rng) * (log.t < log.t[0] + 0.9 * log.duration)[:, None]


SPEEDS: dict[str, Kind] = {
    "noise 1 mrad/s": lambda log, q, rng: noisy(log, NOISE, rng),
    "the same, 5 ms late": lambda log, q, rng: late(log, rng),
    "steps of 2 mrad/s": lambda log, q, rng: np.round(log.v / 2e-3) * 2e-3,
    "5 mrad/s, then 30 Hz filter": lambda log, q, rng: slow(
        noisy(log, 5 * NOISE, rng), log, 30.0
    ),
    "1 mrad/s, then 5 Hz filter": lambda log, q, rng: slow(
        noisy(log, NOISE, rng), log, 5.0
    ),
    "noise 100 mrad/s": lambda log, q, rng: noisy(log, 100 * NOISE, rng),
    "difference of position": lambda log, q, rng: difference(log, q),
    "the same, 40 Hz filter": lambda log, q, rng: slow(difference(log, q), log, 40.0),
    "a tenth too slow": lambda log, q, rng: 0.9 * noisy(log, NOISE, rng),
    "stops after nine tenths": lambda log, q, rng: stopping(log, rng),
    "of another joint": lambda log, q, rng: np.roll(log.v, 1, axis=1),
    "constant": lambda log, q, rng: np.ones_like(log.v),
}
