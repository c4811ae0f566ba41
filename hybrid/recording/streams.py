"""Build one recording from several streams (topics), each with its own clock.

The stream with torques and the most channels becomes the recording. If it has no
command, the command of another stream is interpolated to its clock.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid.errors import RecordingError
from hybrid.recording.assignment import Assignment
from hybrid.recording.build import build_recording
from hybrid.recording.mapping import Map, Mapping, read_mapping
from hybrid.recording.reading import Reading
from hybrid.recording.recording import Recording
from hybrid.recording.table import LogTable, NoJointsError
from hybrid.recording.units import seconds


def recording_of(
    tables: tuple[LogTable, ...],
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
) -> Recording:
    """Build the recording of a log's streams; options as in :func:`read_all`."""
    mapping = read_mapping(map)
    tables = tuple(x for x in tables if x.name == mapping.topic) or tables
    main = _best(tables, joints, mapping, torque) if len(tables) > 1 else tables[0]
    reading = Assignment(main, joints, mapping, torque).reading()
    recording = build_recording(main, reading, torque=torque)
    for table in tables if recording.command is None else ():
        if table is not main:
            all_topics = replace(mapping, topic="")
            other = Assignment(table, recording.joints, all_topics, False)
            if commanded := other.command_reading():
                return _with_command(recording, main, table, commanded)
    return recording


def _best(
    tables: tuple[LogTable, ...],
    joints: tuple[str, ...] | None,
    mapping: Mapping,
    torque: bool,
) -> LogTable:
    """Choose a stream: first by torques, then by joint states, then by channels."""
    good: list[tuple[tuple[bool, bool, int], LogTable]] = []
    bad = list[RecordingError]()
    for table in tables:
        try:
            reading = Assignment(table, joints, mapping, torque).reading(quiet=True)
        except RecordingError as error:
            bad.append(error)
        else:
            found = reading.channels
            rank = ("tau" in found, table.preset == "joint_state", len(found))
            good.append((rank, table))
    if not good:
        raise min(bad, key=lambda error: isinstance(error, NoJointsError))
    best = max(rank for rank, _ in good)
    first, *more = (table for rank, table in good if rank == best)
    if more:
        raise RecordingError(
            f"{first.source}: joints in several topics: "
            f"{', '.join(table.name for table in (first, *more))}; valid is --map "
            "FILE.yaml with topic: and one of them"
        )
    return first


def _with_command(
    recording: Recording, main: LogTable, table: LogTable, commanded: Reading
) -> Recording:
    """Add a command of another stream, interpolated to the clock of the recording.

    The first command also holds before its time, and the last one after its time.
    """
    time, *used = commanded.columns
    wanted = tuple(u.index for u in commanded.columns)
    blocks = table.load(wanted)
    columns = {k: np.concatenate([block[k] for block in blocks]) for k in wanted}
    start = main.load((0,))[0][0][0]
    # Both clocks count nanoseconds of the same epoch.
    at = seconds(columns[time.index] - start, "ns")[0] + recording.t[0]
    reading = recording.reading
    assert reading is not None
    if len(at) < 2 or at[-1] < recording.t[0] or at[0] > recording.t[-1]:
        note = f"command of {table.name}: at other times than the joints"
        return replace(recording, reading=replace(reading, notes=(note,)))
    command = np.stack(
        [np.interp(recording.t, at, columns[u.index] * u.factor) for u in used], axis=1
    )
    share = np.mean((recording.t >= at[0]) & (recording.t <= at[-1]))
    note = (
        f"command of {table.name}, interpolated; it covers {share:.0%} of the samples "
        "and is held before and after"
    )
    columns_read = (*reading.columns, *used)
    reading = replace(reading, columns=columns_read, notes=(*reading.notes, note))
    return replace(recording, command=command, reading=reading)
