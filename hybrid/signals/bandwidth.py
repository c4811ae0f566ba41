"""The bandwidth of a torque that its logger has low-pass filtered."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.signals.cutoff import power_spectrum
from hybrid.signals.motion import Motion

FILTERED = (
    "torque was low-pass filtered at about {:.2g} Hz before it was logged: models are "
    "compared through that filter, which hides faster effects"
)
_LEFT = 0.25  # of the model's power: a filter's gain is one half at its cut-off
_REMOVED = 0.01  # of the model's power: no noise or missing effect leaves so little
_NOTICED = 1e-4  # of the model's power, that a filter removes: 1 % of its RMS
_SECONDS = 4.0  # of a segment


def torque_bandwidth(
    pairs: Sequence[tuple[Array, Array]], rate: float, cutoff: float
) -> float:
    """Find the bandwidth of logged torque that a low-pass filter has smoothed.

    Any model of the arm, even a poor one, has torque at all frequencies of its
    friction. A filtered log has next to none above the filter's cut-off, whereas noise
    and effects that the model lacks add to it.

    Args:
        pairs: Logged torque of each log, and that of a model along it, (N, n) each,
            [N·m].
        rate: Samples per second, [Hz].
        cutoff: Highest frequency that counts, [Hz].

    Returns:
        Frequency at which the filter's gain is one half, [Hz]; infinity if the log is
        not filtered.
    """
    size = min(int(_SECONDS * rate), *(len(x) for x, _ in pairs))
    logged, modelled = (
        np.sum([power_spectrum(x, size) for x in each], axis=0)
        for each in zip(*pairs, strict=True)
    )
    f = np.fft.rfftfreq(size, 1.0 / rate)
    moves = np.any(modelled > 0, axis=0)
    if not moves.any():
        return np.inf
    seen = f <= cutoff
    logged, modelled = logged[seen][:, moves], modelled[seen][:, moves]
    f, ratio = f[seen], np.median(logged / np.maximum(modelled, 1e-300), axis=1)
    passed = np.flatnonzero(ratio >= _LEFT)
    if not len(passed) or np.median(ratio[3 * len(f) // 4 :]) >= _REMOVED:
        return np.inf
    missing = modelled[passed[-1] + 1 :].sum(axis=0) / modelled.sum(axis=0)
    if np.median(missing) < _NOTICED:
        return np.inf
    edge = slice(int(passed[-1]), int(passed[-1]) + 2)
    return float(np.interp(0.0, np.log(_LEFT / ratio[edge]), f[edge]))


def band_of(motions: Sequence[Motion], models: Sequence[Array], cutoff: float) -> float:
    """:func:`torque_bandwidth` of most logs, [Hz]; ``models`` have (N, n) for each.

    It is a property of the logger, for which masked samples count as well.
    """
    pairs = zip(motions, models, strict=True)
    each = [torque_bandwidth([(m.tau, x)], m.rate, cutoff) for m, x in pairs]
    return float(np.median(each))
