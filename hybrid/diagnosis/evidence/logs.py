"""Logs as they are diagnosed: one clock, what a writer did taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from hybrid.diagnosis.evidence.convention import Convention, find_convention
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
) -> tuple[Convention, list[Recording | Motion], Gap, Gap]:
    """How logs were written, and they and their gap with that taken back.

    Args:
        robot: The simulator as it stands.
        recordings: Logs of the real arm.
        cutoff: Cut-off of everything filtered, [Hz]; from the spectrum if not given.
        clocks: Whether torque may be late by the same time at every joint.

    Returns:
        How they were written; the logs and the gap with that taken back; and the gap
        with the log taken at its word where torque in it is late.
    """
    gap = measure_gap(robot, recordings, cutoff=cutoff)
    logged = find_convention(gap, recordings, clocks=clocks)
    if not logged:
        return logged, list(recordings), gap, gap
    explicit = partial(logged.explicit, robot)
    shifted = [logged.in_step(x) for x in recordings]
    gap = measure_gap(robot, shifted, cutoff=cutoff, correct=explicit)
    as_logged = gap
    if logged.clocks:
        as_logged = measure_gap(robot, recordings, cutoff=gap.cutoff, correct=explicit)
    return logged, shifted, gap, as_logged


def since_first(
    recordings: Sequence[Recording | Motion],
) -> list[Recording | Motion]:
    """The same by a clock that starts with the first of them.

    Loggers count from anywhere; what warms up or happens once is told by this clock.
    """
    start = min((float(x.t[0]) for x in recordings), default=0.0)
    return [replace(x, t=x.t - start) for x in recordings]
