"""Numbers of serialised messages of ROS, at the places that their definition gives."""

import struct

import numpy as np
import pytest

from hybrid.errors import RecordingError
from hybrid.recording.formats import cdr
from hybrid.recording.formats.cdr import LayoutError, layout_of
from hybrid.recording.formats.topic import Topic, _words

KINDS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h",
    "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q",
    "float32": "f", "float64": "d",
}  # fmt: skip


def plain(kind):
    return 1, (kind, 0)


def listed(inner, count=None):
    return (4, (inner, 0)) if count is None else (3, (inner, count))


STATE = {
    "a/State": ([], [
        ("flag", plain("uint8")), ("header", (2, "a/Header")),
        ("name", listed(plain("string"))), ("position", listed(plain("float64"))),
        ("pair", listed(plain("int16"), 2)), ("mode", plain("int32")),
    ]),
    "a/Header": ([], [("stamp", (2, "builtin/Time")), ("frame_id", plain("string"))]),
}  # fmt: skip


class Message:
    """A serialised message that grows field by field."""

    def __init__(self, ros2=True, big=False):
        self.ros2, self.order = ros2, ">" if big else "<"
        self.raw = bytes([0, 0 if big else 1, 0, 0]) if ros2 else b""

    def put(self, kind, *values):
        size = struct.calcsize(KINDS[kind])
        for x in values:
            if self.ros2:
                self.raw += bytes(-(len(self.raw) - 4) % size)
            self.raw += struct.pack(self.order + KINDS[kind], x)
        return self

    def text(self, text):
        ending = b"\0" if self.ros2 else b""
        content = text.encode() + ending
        self.put("uint32", len(content)).raw += content
        return self


def state(names=("a", "elbow"), position=(0.5, -2.0), stamp=(3, 7), **kind):
    message = Message(**kind).put("uint8", 9).put("int32", stamp[0])
    message.put("uint32", stamp[1]).text("base").put("uint32", len(names))
    for name in names:
        message.text(name)
    message.put("uint32", len(position)).put("float64", *position)
    return message.put("int16", -4, 5).put("int32", 11).raw


@pytest.mark.parametrize("kind", [{}, {"big": True}, {"ros2": False}])
def test_numbers_and_texts_are_where_they_were_put(kind):
    raw = state(**kind)
    layout = layout_of(raw, "a/State", STATE, ros2=kind.get("ros2", True))
    assert layout.texts == {
        ("header", "frame_id"): "base", ("name", 0): "a", ("name", 1): "elbow",
    }  # fmt: skip
    messages = np.frombuffer(raw, np.uint8)[None]
    found = {path: layout.values(messages, path)[0] for path in layout.numbers}
    assert found == {
        ("flag",): 9, ("header", "stamp", "sec"): 3, ("header", "stamp", "nanosec"): 7,
        ("position", 0): 0.5, ("position", 1): -2.0, ("pair", 0): -4, ("pair", 1): 5,
        ("mode",): 11,
    }  # fmt: skip
    assert layout.length == len(raw) and layout.fits(messages).all()


def test_messages_of_one_layout_differ_in_their_numbers_only():
    raw = state()
    layout = layout_of(raw, "a/State", STATE, ros2=True)
    other = state(position=(8.0, 9.0), stamp=(4, 1))
    renamed = state(names=("b", "elbow"))
    messages = np.frombuffer(raw + other + renamed, np.uint8).reshape(3, -1)
    assert layout.fits(messages).tolist() == [True, True, False]
    np.testing.assert_array_equal(
        layout.values(messages[:2], ("position", 1)), [-2.0, 9.0]
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_number_is_aligned_to_its_size(kind):
    types = {"a/One": ([], [("first", plain("uint8")), ("x", plain(kind))])}
    raw = Message().put("uint8", 1).put(kind, 1).raw
    layout = layout_of(raw, "a/One", types, ros2=True)
    messages = np.frombuffer(raw, np.uint8)[None]
    assert layout.values(messages, ("x",)).tolist() == [1]
    assert layout.numbers["x",][0] == 4 + struct.calcsize(KINDS[kind])


def nested(depth):
    types = {f"a/L{k}": ([], [("inner", (2, f"a/L{k + 1}"))]) for k in range(depth)}
    return types | {f"a/L{depth}": ([], [("x", plain("float64"))])}


def test_messages_are_nested_twelve_deep_at_most():
    raw = Message().put("float64", 2.5).raw
    assert len(layout_of(raw, "a/L0", nested(12), ros2=True).numbers) == 1
    with pytest.raises(LayoutError, match="type a/L13 is not defined"):
        layout_of(raw, "a/L0", nested(13), ros2=True)


def test_a_message_that_does_not_fit_its_definition_is_refused(monkeypatch):
    def refused(raw, fields, words):
        with pytest.raises(LayoutError, match=words):
            layout_of(raw, "a/X", {"a/X": ([], fields)}, ros2=True)

    xs = [("x", listed(plain("uint8")))]
    whole = Message().put("uint32", 3).put("uint8", 1, 2, 3).raw
    assert len(layout_of(whole, "a/X", {"a/X": ([], xs)}, ros2=True).numbers) == 3
    refused(whole[:-1], xs, "beyond the end")
    refused(Message().put("uint32", 10**6).raw, xs, "1000000 numbers in x")
    refused(whole, [("x", plain("float128"))], "numbers of type float128, or too many")
    refused(Message().put("uint32", 2).raw + b"\xff\xff", [("x", plain("string"))],
            "not a whole a/X")  # fmt: skip
    monkeypatch.setattr(cdr, "MOST_NUMBERS", 2)
    refused(whole, xs, "3 numbers in x")
    four = [(f"x{k}", plain("uint8")) for k in range(4)]
    refused(whole, four, "of type uint8, or too many")
    assert len(layout_of(whole, "a/X", {"a/X": ([], four[:3])}, ros2=True).numbers) == 3


def test_an_entry_of_a_list_has_the_name_at_its_place_or_its_number():
    names = {(): {0: "a", 1: "b"}}
    assert _words(("position", 1), names) == ["position", "b"]
    assert _words(("position", 1), {}) == ["position[1]"]
    assert _words(("state", "position", 1), {}) == ["state", "position[1]"]
    assert _words(("values", 2), {}) == ["[2]"]
    assert _words(("joints", 1, "x"), names) == ["joints", "b", "x"]
    assert _words(("joints", 1, "x"), {}) is None
    own = {("joints", 1): {0: "effort"}}
    assert _words(("joints", 1, "values", 0), names | own) == ["joints", "b", "effort"]


def joint_states(*messages):
    topic = Topic("/arm", "a/State", STATE, True, "log.bag")
    for stamp, raw in messages:
        topic.add(stamp, raw)
    topic.decode()
    return list(topic.tables())


def loaded(table):
    """Each column by its label."""
    parts = table.load(tuple(range(len(table.labels))))
    return {
        label: np.concatenate([part[k] for part in parts]).tolist()
        for k, label in enumerate(table.labels)
    }


def test_messages_with_the_same_names_make_one_table_in_the_order_of_their_stamps():
    made = [(k, state(stamp=(k, 5), position=(0.1 * k, 1.0))) for k in (1, 2, 4)]
    other = [(3, state(names=("b", "c"), stamp=(3, 5)))]
    second, first = joint_states(*made[:2], *other, *made[2:])  # the shortest first
    found = loaded(first)
    assert found["/arm/__time"] == [k * 10**9 + 5 for k in (1, 2, 4)]
    assert found["/arm/position/a"] == pytest.approx([0.1, 0.2, 0.4])
    assert set(found) == {
        "/arm/__time", "/arm/position/a", "/arm/position/elbow", "/arm/pair/a",
        "/arm/pair/elbow",
    }  # fmt: skip
    assert first.note == second.note == "" and first.kind == "ROS (a/State)"
    assert "/arm/position/c" in loaded(second)


def test_numbers_of_a_list_named_values_alone_are_numbered():
    types = {"a/Values": ([], [("values", listed(plain("float64")))])}
    topic = Topic("/all", "a/Values", types, True, "log.bag")
    for stamp, x in ((5, 1.5), (6, 0.5)):
        topic.add(stamp, Message().put("uint32", 2).put("float64", x, 2.5).raw)
    topic.decode()
    (table,) = topic.tables()
    assert loaded(table) == {
        "/all/__time": [5, 6], "/all/[0]": [1.5, 0.5], "/all/[1]": [2.5, 2.5],
    }  # fmt: skip


def test_without_stamps_the_time_of_the_recorder_counts():
    (table,) = joint_states(*((10 * k, state(stamp=(0, 0))) for k in (1, 2)))
    assert loaded(table)["/arm/__time"] == [10, 20]
    assert table.note == "time is the recorder's, not the headers'"


def test_messages_of_two_hundred_kinds_are_read_and_of_no_more():
    made = [(k, state(names=(f"n{k:03d}", "b"))) for k in range(201)]
    assert len(joint_states(*made[:200])) == 200
    with pytest.raises(RecordingError, match="201 kinds of messages; valid are up"):
        joint_states(*made)


TRAJECTORY = {
    "a/Trajectory": ([], [
        ("header", (2, "a/Header")), ("joint_names", listed(plain("string"))),
        ("points", listed((2, "a/Point"))),
    ]),
    "a/Point": ([], [
        ("positions", listed(plain("float64"))), ("time_from_start", (2, "b/Duration")),
    ]),
    **STATE,
}  # fmt: skip


def trajectory(second, points, names=("a", "b")):
    message = Message().put("int32", second).put("uint32", 0).text("")
    message.put("uint32", len(names))
    for name in names:
        message.text(name)
    message.put("uint32", len(points))
    for after, position in points:
        message.put("uint32", len(position)).put("float64", *position)
        message.put("int32", int(after)).put("uint32", round(after % 1 * 1e9))
    return message.raw


def test_a_new_trajectory_replaces_what_is_left_of_the_last():
    topic = Topic("/go", "a/Trajectory", TRAJECTORY, True, "log.bag")
    for second, points, names in (
        (20, [(0.0, (5.0, 6.0)), (1.5, (7.0, 8.0))], ("a", "b")),
        (10, [(0.0, (1.0, 2.0)), (9.5, (3.0, 4.0)), (10.0, (0.0, 0.0)),
              (12.0, (0.0, 0.0))], ("a", "b")),
        (15, [(0.0, (9.0, 9.0))], ("x", "y")),
        (30, [(1.0, (1.5,)), (1.0, (4.0, 4.0))], ("a", "b")),
    ):  # fmt: skip
        topic.add(7, trajectory(second, points, names))
    topic.decode()
    (table,) = topic.tables()
    found = loaded(table)
    seconds = [10.0, 19.5, 20.0, 21.5, 31.0]
    assert found["/go/__time"] == [round(x * 1e9) for x in seconds]
    assert found["/go/command/positions/a"] == [1.0, 3.0, 5.0, 7.0, 1.5]
    np.testing.assert_array_equal(
        found["/go/command/positions/b"], [2.0, 4.0, 6.0, 8.0, np.nan]
    )
