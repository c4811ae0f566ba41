"""Build a recording in SI units from the columns of a table, block by block."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording.reading import Reading, Used
from hybrid.recording.recording import Recording
from hybrid.recording.table import LogTable
from hybrid.recording.units import seconds


def build_recording(table: LogTable, reading: Reading, *, torque: bool) -> Recording:
    """Build the recording of a table; no number is in memory twice."""
    time, groups, notes = reading.time, reading.channels, list(reading.notes)
    clock, channels = _samples(table, time, groups)
    if time.index < 0:  # no clock, but a rate
        t, unit = clock * time.factor, "s"
    else:
        t, unit = seconds(clock, time.unit)
    used = [replace(time, unit=unit, stated=time.stated or unit != "s")]
    for channel, group in groups.items():
        x = channels[channel]
        # ROS writes NaN for what was not measured.
        if channel != "q" and x.size and np.isnan(x).all():
            notes.append(f"{channel} holds no number")
            del channels[channel]
        else:
            used += group
    if torque and "tau" not in channels:
        raise RecordingError(f"{table.place}: no torques: tau holds no number")
    return Recording(
        t=t,
        joints=tuple(u.joint for u in groups["q"]),
        source=table.source,
        reading=replace(reading, columns=tuple(used), notes=tuple(notes)),
        **channels,  # type: ignore[arg-type]
    )


def _samples(
    table: LogTable, time: Used, groups: dict[str, tuple[Used, ...]]
) -> tuple[NDArray[Any], dict[str, Array]]:
    """Clock of the file, shape (N,), and channels in SI, shape (N, n).

    If a map gives a rate in place of a clock, the clock counts rows.
    """
    columns = [time.index] * (time.index >= 0)
    columns += [u.index for group in groups.values() for u in group]
    blocks = table.load(tuple(dict.fromkeys(columns)))
    sizes = [next(iter(block.values())).size for block in blocks]
    channels = {k: np.empty((sum(sizes), len(group))) for k, group in groups.items()}
    clocks, at = [np.arange(sum(sizes), dtype=float)], 0
    if time.index >= 0:
        clocks = [block[time.index] for block in blocks]
        for clock in clocks:
            _check_numbers(clock, time, table)
    for size in sizes:
        block = blocks.pop(0)  # its memory is free after this step
        for name, group in groups.items():
            _fill(channels[name][at : at + size], block, group, table)
        at += size
    return np.concatenate(clocks), channels


def _fill(
    values: Array,
    block: dict[int, NDArray[Any]],
    used: tuple[Used, ...],
    table: LogTable,
) -> None:
    """Write a block's samples of a channel, in SI, into ``values``, shape (N, n)."""
    for k, u in enumerate(used):
        x = block[u.index]
        _check_numbers(x, u, table)
        if len(x) != len(values):
            raise RecordingError(
                f"{table.place}: {u.channel}{k + 1} ({u.joint}) has {len(x)} rows; "
                f"valid are {len(values)}, as many as there are times"
            )
        values[:, k] = x
        if u.factor != 1.0:
            values[:, k] *= u.factor
        if u.offset:
            values[:, k] += u.offset


def _check_numbers(x: NDArray[Any], used: Used, table: LogTable) -> None:
    kinds = "fiuM" if used.channel == "t" else "fiu"
    if x.ndim != 1 or x.dtype.kind not in kinds:
        raise RecordingError(
            f"{table.place}: {used.label} has shape {x.shape} and type {x.dtype}; "
            "valid are numbers, (N,) or (N, n)"
        )
