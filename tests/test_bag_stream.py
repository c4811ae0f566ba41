"""A large bag: it is held once, in any number of blocks, and images stay packed."""

import weakref

import numpy as np
import pytest
from logs import ARM, START, Messages, bag, states, truth
from rosbags.rosbag2 import StoragePlugin

from hybrid.errors import HybridWarning
from hybrid.recording import build, read
from hybrid.recording.build import recording_of
from hybrid.recording.formats import stream
from hybrid.recording.formats.stream import Stream
from hybrid.recording.table import LogTable


@pytest.fixture
def small_blocks(monkeypatch):
    """Blocks so small that a short log needs many."""
    monkeypatch.setattr(stream, "BLOCK", 900)


def filled(rows: int, step: int) -> tuple[Stream, np.ndarray]:
    """A stream of positions and torques of six joints, taken step by step."""
    labels = tuple(f"{word}{k}" for word in ("q", "tau") for k in range(1, 7))
    made, x = Stream(labels), np.arange(rows)
    for k in range(0, rows, step):
        part = x[k : k + step]
        values = [part + 0.01 * column for column in range(12)]
        made.add(10**9 * part, part, values)
    return made, x


def table_of(made: Stream) -> LogTable:
    clock, headed = made.clock()
    assert headed
    return LogTable(
        "bag", ("time", *made.labels), lambda used: made.take(used, clock), "ns"
    )


@pytest.mark.parametrize(("rows", "step"), [(1, 1), (7, 7), (8, 3), (500, 64)])
def test_rows_come_back_in_order_whatever_the_blocks(small_blocks, rows, step):
    made, x = filled(rows, step)
    clock, _ = made.clock()
    blocks = made.take((0, 1, 12), clock)
    for place, offset in ((1, 0.0), (12, 0.11)):
        column = np.concatenate([block[place] for block in blocks])
        assert np.array_equal(column, x + offset)
    assert np.array_equal(np.concatenate([b[0] for b in blocks]), 10**9 * x)
    assert rows < 500 or len(blocks) > 3


@pytest.mark.parametrize("stamp", [0, 5])
def test_one_message_without_a_stamp_has_the_time_of_the_recorder(stamp):
    made = Stream(("q1",))
    made.add(np.array([stamp]), np.array([7]), [np.zeros(1)])
    clock, own = made.clock()
    assert (clock.tolist(), own) == (([5], True) if stamp else ([7], False))


def test_a_block_is_dropped_as_soon_as_its_rows_are_in_the_recording(
    small_blocks, monkeypatch
):
    made, x = filled(500, 64)
    table = table_of(made)
    blocks = [weakref.ref(block) for block in made._blocks]
    alive, fill = [], build._fill

    def spied(*args):
        alive.append(sum(block() is not None for block in blocks))
        fill(*args)

    monkeypatch.setattr(build, "_fill", spied)
    recording = recording_of((table,))
    assert np.allclose(recording.tau[:, 5], x + 0.11)
    assert alive == [k for k in range(len(blocks), 0, -1) for _ in ("q", "tau")]


def test_chunks_of_images_alone_are_never_unpacked(tmp_path):
    messages = Messages()
    picture = messages.types["sensor_msgs/msg/CompressedImage"]
    noise = np.random.default_rng(0).integers(0, 255, 1_200_000).astype(np.uint8)
    late = START + 10**12
    images = [
        ("/camera", late + k, picture(messages.header(late + k), "jpeg", noise))
        for k in range(2)
    ]
    path = bag(
        tmp_path / "bag", states(messages) + images, messages, StoragePlugin.MCAP, True
    )
    (file,) = path.glob("*.mcap")
    data, at, chunks = bytearray(file.read_bytes()), 8, []
    while at + 9 < len(data):
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        chunks += [(at, length)] if data[at] == 6 else []
        at += 9 + length
    start, length = chunks[-1]  # one image; the one before it ends the joint states
    assert len(chunks) == 2
    data[start + 1000 : start + length] = bytes(length - 1000)
    (tmp_path / "log.mcap").write_bytes(data)
    assert np.allclose(read(tmp_path / "log.mcap", joints=ARM).q, truth().q)


def test_columns_that_are_ignored_are_told_for_the_chosen_stream_alone():
    t = np.arange(20.0)

    def stream(name, *labels):
        return LogTable(
            "bag", ("time", *labels), lambda used: [{k: t + k for k in used}],
            name=name,
        )  # fmt: skip

    full = stream("/full", "q1", "tau1", "hum")
    bare = stream("/bare", "q1", "humidity")
    with pytest.warns(HybridWarning) as warned:
        recording_of((bare, full))
    assert [str(x.message) for x in warned] == ["bag (/full): ignored columns: hum"]
