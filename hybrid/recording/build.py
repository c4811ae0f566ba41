"""Build one recording from the tables of a log, in SI units, block by block.

Each table (stream, topic) has its own clock. The one with torques and the most channels
becomes the recording. If it has no command, the command of another one is interpolated
to its clock.
"""

from dataclasses import replace

import numpy as np

from hybrid.arrays import AnyArray, Array
from hybrid.errors import RecordingError, warn
from hybrid.recording.assignment import Assignment, listed
from hybrid.recording.mapping import Map, Mapping, read_mapping
from hybrid.recording.reading import Reading, Used
from hybrid.recording.recording import Recording
from hybrid.recording.table import LogTable, NoJointsError, check_numbers
from hybrid.recording.units import seconds


def recording_of(
    tables: tuple[LogTable, ...],
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
) -> Recording:
    """Build the recording of a log's tables; options as in :func:`read_all`."""
    mapping = read_mapping(map)
    tables = tuple(x for x in tables if x.name == mapping.topic) or tables
    main, reading = _best(tables, joints, mapping, torque)
    _warn(main, reading)
    recording = _built(main, reading, torque=torque)
    all_topics = replace(mapping, topic="")
    for table in tables if recording.command is None else ():
        if table is main:
            continue
        other = Assignment(table, recording.joints, all_topics, False)
        try:
            commanded = other.reading(("command",))
        except RecordingError:  # of other joints
            continue
        if commanded.channels:
            return _with_command(recording, main, table, commanded)
    return recording


def _best(
    tables: tuple[LogTable, ...],
    joints: tuple[str, ...] | None,
    mapping: Mapping,
    torque: bool,
) -> tuple[LogTable, Reading]:
    """Choose a table: first by torques, then by joint states, then by channels."""
    good: dict[tuple[bool, bool, int], list[tuple[LogTable, Reading]]] = {}
    bad = list[RecordingError]()
    for table in tables:
        try:
            reading = Assignment(table, joints, mapping, torque).reading()
        except RecordingError as error:
            bad.append(error)
        else:
            found = reading.channels
            rank = ("tau" in found, table.preset == "joint_state", len(found))
            good.setdefault(rank, []).append((table, reading))
    if not good:
        raise min(bad, key=lambda error: isinstance(error, NoJointsError))
    best = good[max(good)]
    if len(best) > 1:
        names = ", ".join(table.name for table, _ in best)
        raise RecordingError(
            f"{best[0][0].source}: joints in several topics: {names}; valid is --map "
            "FILE.yaml with topic: and one of them"
        )
    return best[0]


def _warn(table: LogTable, reading: Reading) -> None:
    """Warn of columns that are not used, and of units that a dataset does not state."""
    home = table.home or table.place
    if reading.aside:
        labels = listed([label for label, _ in reading.aside])
        warn(f"{home}: ignored columns: {labels}")
    if reading.preset == "lerobot" and not reading.columns[1].stated:
        warn(
            f"{home}: units are not in a LeRobot dataset: positions are taken as "
            "radians; if they are degrees, use --map FILE.yaml with q: {unit: deg}, "
            "command: {unit: deg}"
        )


def _built(table: LogTable, reading: Reading, *, torque: bool) -> Recording:
    """Build the recording of one table; no number is in memory twice."""
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
) -> tuple[AnyArray, dict[str, Array]]:
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
            check_numbers(clock, time.label, table.place, timed=True)
    for size in sizes:
        block = blocks.pop(0)  # its memory is free after this step
        for name, group in groups.items():
            _fill(channels[name][at : at + size], block, group, table)
        at += size
    return np.concatenate(clocks), channels


def _fill(
    values: Array,
    block: dict[int, AnyArray],
    used: tuple[Used, ...],
    table: LogTable,
) -> None:
    """Write a block's samples of a channel, in SI, into ``values``, shape (N, n)."""
    for k, u in enumerate(used):
        x = block[u.index]
        check_numbers(x, u.label, table.place, timed=False)
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


def _with_command(
    recording: Recording, main: LogTable, table: LogTable, commanded: Reading
) -> Recording:
    """Add a command of another stream, interpolated to the clock of the recording.

    The first command also holds before its time, and the last one after its time.
    """
    used = commanded.columns[1:]
    # Column 0 of each table is its clock: nanoseconds of the same epoch.
    wanted = (0, *(u.index for u in used))
    blocks = table.load(wanted)
    columns = {k: np.concatenate([block[k] for block in blocks]) for k in wanted}
    own = main.load((0,))[0][0]
    at, t = ((x - own[0]) * 1e-9 for x in (columns[0], own))
    reading = recording.reading
    assert reading is not None
    if len(at) < 2 or at[-1] < t[0] or at[0] > t[-1]:
        note = f"command of {table.name}: at other times than the joints"
        return replace(
            recording, reading=replace(reading, notes=(*reading.notes, note))
        )
    command = np.stack(
        [np.interp(t, at, columns[u.index] * u.factor) for u in used], axis=1
    )
    share = np.mean((t >= at[0]) & (t <= at[-1]))
    note = (
        f"command of {table.name}, interpolated; it covers {share:.0%} of the samples "
        "and is held before and after"
    )
    columns_read = (*reading.columns, *used)
    reading = replace(reading, columns=columns_read, notes=(*reading.notes, note))
    return replace(recording, command=command, reading=reading)
