"""Logs with the errors of their logger corrected, and their gap."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.diagnosis.evidence.convention import Convention, find_convention
from hybrid.diagnosis.gap.bandwidth import bandwidth
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion


def measured(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    cutoff: float | None,
    *,
    clocks: bool,
    band: float | None = None,
) -> tuple[Convention, list[Recording | Motion], Gap, Gap]:
    """Find the logging convention, correct the logs, and measure their gap.

    ``clocks`` is whether torque may be late by the same time at every joint. Without a
    ``cutoff`` it is chosen from the spectrum of positions, and without the bandwidth of
    the logged torque, ``band``, that is found; both in [Hz].

    Returns:
        The convention; the corrected logs; the gap of the corrected logs; and the gap
        without the correction for torque that another clock stamped.
    """
    measure = partial(measure_gap, robot, cutoff=cutoff)
    gap = measure(recordings)
    band = bandwidth(gap) if band is None else band
    if band < np.inf:
        measure = partial(measure, band=band)
        gap = measure(recordings)
    logged = find_convention(gap, recordings, clocks=clocks)
    logged = replace(logged, bandwidth=band)
    if not logged:
        return logged, list(recordings), gap, gap
    correct = partial(logged.correct, robot)
    shifted = [logged.shift(x) for x in recordings]
    gap = measure(shifted, correct=correct)
    as_logged = gap
    if logged.clocks:
        as_logged = measure(recordings, correct=correct)
    return logged, shifted, gap, as_logged


def since_first(
    recordings: Sequence[Recording | Motion],
) -> list[Recording | Motion]:
    """Recordings with the time since the start of the first one."""
    start = min((float(x.t[0]) for x in recordings), default=0.0)
    return [replace(x, t=x.t - start) for x in recordings]
