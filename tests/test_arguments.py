"""Arguments of other types are refused in one line that says what is valid."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import pytest
from simulated import arm

import hybrid
from hybrid.arguments import typed
from hybrid.errors import HybridError


class Caller(Protocol):
    def __call__(self, text: str) -> None: ...


@typed
def chosen(
    number: float = 0.0,
    whole: int = 0,
    yes: bool = False,
    path: str | Path = "",
    names: Sequence[str] = (),
    kinds: Sequence[Literal["a", "b"]] = (),
    sizes: Mapping[str, float] | None = None,
    call: Caller | None = None,
    array: np.ndarray | None = None,
    anything: Any = None,
) -> dict[str, Any]:
    return dict(locals())


RIGHT = (
    {"number": 3}, {"number": np.float32(3.0)}, {"whole": np.int64(3)}, {"yes": True},
    {"yes": np.True_}, {"path": Path("a")}, {"names": ["a"]}, {"names": {"a"}},
    {"sizes": {"a": 1}}, {"sizes": None}, {"call": print}, {"kinds": {"a"}},
    {"array": [1.0, 2.0]}, {"anything": True}, {"anything": 3},
)  # fmt: skip
WRONG = (
    ({"number": "3"}, "number is '3'; valid is float"),
    ({"number": True}, "number is True; valid is float"),
    ({"whole": 1.5}, "whole is 1.5; valid is int"),
    ({"yes": 1}, "yes is 1; valid is bool"),
    ({"path": 3}, "path is 3; valid is str | Path"),
    ({"names": [3]}, "names is [3]; valid is Sequence[str]"),
    ({"names": {"a": 1}}, "names is {'a': 1}; valid is Sequence[str]"),
    ({"kinds": ["c"]}, "kinds is ['c']; valid is some of 'a', 'b'"),
    ({"sizes": ["a"]}, "sizes is ['a']; valid is Mapping[str, float] | None"),
    ({"sizes": {"a": "b"}}, "sizes is {'a': 'b'}; valid is Mapping[str, float] | None"),
    ({"call": 3}, "call is 3; valid is Caller | None"),
)


@pytest.mark.parametrize("given", RIGHT, ids=str)
def test_what_fits_its_annotation_arrives_as_it_is(given):
    ((name, value),) = given.items()
    assert chosen(**given)[name] is value


@pytest.mark.parametrize(("given", "said"), WRONG, ids=str)
def test_what_does_not_fit_is_refused_with_what_is_valid(given, said):
    with pytest.raises(HybridError) as caught:
        chosen(**given)
    assert str(caught.value) == said


def test_one_value_is_a_list_of_one_and_an_iterator_is_not_read():
    assert chosen(names="abc")["names"] == ("abc",)
    assert list(chosen(names=iter(["a", "b"]))["names"]) == ["a", "b"]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: hybrid.identify(None), "missing a required argument: 'recordings'"),
        (lambda: hybrid.predict(None, None, sead=1), "keyword argument 'sead'"),
        (lambda: hybrid.export(None, "c", "x"), "too many positional arguments"),
    ],
)
def test_a_call_with_other_arguments_is_told_all_that_are_valid(call, said):
    with pytest.raises(TypeError, match=f"{said}; valid is \\w+\\(\\w+, ") as caught:
        call()
    assert "self" not in str(caught.value)


def test_arguments_with_a_name_stand_behind_a_star():
    with pytest.raises(TypeError, match=r"valid is predict\(model, recording\)$"):
        hybrid.predict()
    with pytest.raises(TypeError, match=r"\(paths, \*, joints=None, .*torque=True"):
        hybrid.read_recordings()


def test_an_argument_of_two_types_is_told_what_gives_each():
    with pytest.raises(HybridError, match=r"Robot.load\(.*\) or fit.model gives$"):
        hybrid.diagnose("arm.urdf", [])


CALLS: dict[str, Callable[[], Any]] = {
    "held": lambda: hybrid.Robot.load("planar", held=["x"]),
    "joints": lambda: hybrid.Robot.load("planar", joints=3),
    "cutoff": lambda: hybrid.identify(arm("planar"), [], cutoff="10"),
    "seed": lambda: hybrid.identify(arm("planar"), [], seed="a"),
    "effects": lambda: hybrid.simulate(arm("planar"), effects=3),
    "duration": lambda: hybrid.simulate(arm("planar"), duration=None),
    "map": lambda: hybrid.read_recordings("logs", map=3),
    "paths": lambda: hybrid.read_recordings(None),
    "table": lambda: hybrid.recording_from_table(3),
    "without": lambda: hybrid.diagnose(arm("planar"), [], without=3),
    "weighed": lambda: hybrid.diagnose(arm("planar"), [], known_mass=3),
    "progress": lambda: hybrid.diagnose(arm("planar"), [], progress=3),
    "known_mass": lambda: hybrid.fit_servo(arm("planar"), [], known_mass=3),
    "free": lambda: hybrid.calibrate(arm("planar"), None, free=3),
    "observation": lambda: hybrid.excite(arm("planar"), 3, None),
    "plan": lambda: hybrid.fleet(3, "out"),
    "folder": lambda: hybrid.export(None, 3, format="c"),
    "path": lambda: hybrid.DynamicModel.load(3),
    "rate": lambda: hybrid.OnlineIdentifier(arm("planar"), rate="fast"),
    "standing": lambda: hybrid.validate(None, [], standing="slow"),
    "model": lambda: hybrid.predict(3, None),
    "recording": lambda: hybrid.inspect_recording("log.csv"),
}


@pytest.mark.parametrize("name", CALLS)
def test_public_functions_refuse_other_types_in_one_line(name):
    with pytest.raises(HybridError, match="valid (is|are)") as caught:
        CALLS[name]()
    assert "\n" not in str(caught.value)
