"""Columns of a table -> a recording in SI, block by block."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording.decide import Decision
from hybrid.recording.reading import Used
from hybrid.recording.recording import Recording
from hybrid.recording.table import LogTable
from hybrid.recording.units import seconds


def built(table: LogTable, decision: Decision, *, torque: bool) -> Recording:
    """The recording of a table, each of whose numbers is held once.

    Args:
        table: Named columns.
        decision: Which of them is what.
        torque: Whether torques must be there.

    Raises:
        RecordingError: The samples are not a valid recording.
    """
    reading, time = decision.reading, decision.time
    clock, channels = _samples(table, decision)
    if time.index < 0:  # no clock, but a rate
        t, unit = clock * time.factor, "s"
    else:
        t, unit = seconds(clock, time.unit)
    time = replace(time, unit=unit, stated=time.stated or unit != "s")
    used, notes = [time], list(reading.notes)
    for channel, group in decision.channels.items():
        x = channels[channel]
        # How ROS says that something was not measured.
        if channel != "q" and x.size and np.isnan(x).all():
            notes.append(f"{channel} holds no number")
            del channels[channel]
            continue
        used += group
    if torque and "tau" not in channels:
        raise RecordingError(f"{table.place}: no torques: tau holds no number")
    reading = replace(reading, columns=tuple(used), notes=tuple(notes))
    return Recording(
        t=t,
        joints=decision.joints,
        source=table.source,
        reading=reading,
        **channels,  # type: ignore[arg-type]
    )


def _samples(
    table: LogTable, decision: Decision
) -> tuple[NDArray[Any], dict[str, Array]]:
    """The clock as in the file, shape (N,), and channels in SI, shape (N, n).

    Where a map gives a rate in place of a clock, rows are counted.
    """
    columns = (u.index for u in decision.reading.columns if u.index >= 0)
    blocks = table.load(tuple(dict.fromkeys(columns)))
    sizes = [next(iter(block.values())).size for block in blocks]
    channels = {
        name: np.empty((sum(sizes), len(group)))
        for name, group in decision.channels.items()
    }
    clocks, at, time = [np.arange(sum(sizes), dtype=float)], 0, decision.time
    if time.index >= 0:
        clocks = [block[time.index] for block in blocks]
        for clock in clocks:
            _check_numbers(clock, time, table)
    for size in sizes:
        block = blocks.pop(0)  # and nobody holds it any more
        for name, group in decision.channels.items():
            _fill(channels[name][at : at + size], block, group, table)
        at += size
    return np.concatenate(clocks), channels


def _fill(
    values: Array,
    block: dict[int, NDArray[Any]],
    used: tuple[Used, ...],
    table: LogTable,
) -> None:
    """Put a block's samples of a channel, in SI, into their rows, shape (N, n)."""
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
