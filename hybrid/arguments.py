"""Refuse a call with wrong arguments, and say what is valid."""

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache, wraps
from inspect import Signature, isclass, signature
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from reprlib import repr as short
from types import UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as hints_of

import numpy as np

from hybrid.errors import HybridError

P = ParamSpec("P")
R = TypeVar("R")
_LISTS = Sequence, Collection, Iterable, tuple, list
_KINDS: dict[Any, Any] = {
    float: Real, int: Integral, Path: PathLike, np.ndarray: object, Any: object,
}  # fmt: skip
_MADE_BY = {
    "Robot": "Robot.load('arm.urdf')",
    "Recording": "read_recordings('logs')",
    "DynamicModel": "fit.model",
    "Measurements": "hybrid.calibration.read_measurements",
    "Effect": "effects_from_text('stribeck:elbow', robot.joints, joint_scales(robot))",
}


def typed(function: Callable[P, R]) -> Callable[P, R]:
    """A function that refuses arguments of other types than its annotations say.

    A single value stands for a list of one.

    Raises:
        HybridError: An argument is of another type; the message says what is valid.
        TypeError: An argument is missing or unknown; the message lists all of them.
    """
    parameters, hints = signature(function), cache(lambda: hints_of(function))

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            given = parameters.bind(*args, **kwargs)
        except TypeError as error:
            call = f"{function.__name__}{_plain(parameters)}"
            raise TypeError(f"{error}; valid is {call}") from None
        for name, value in given.arguments.items():
            hint = hints().get(name, Any)
            if _fits(value, hint):
                continue
            if not _fits([value], hint):
                plain = value is None or isinstance(value, (str, Real, Iterable))
                shown = short(value) if plain else f"a {type(value).__name__}"
                raise HybridError(f"{name} is {shown}; valid is {_words(hint)}")
            given.arguments[name] = (value,)
        return function(*given.args, **given.kwargs)

    return checked


def _plain(call: Signature) -> Signature:
    """A signature as a caller writes it, without types."""
    return Signature([
        x.replace(annotation=x.empty)
        for name, x in call.parameters.items()
        if name not in ("self", "cls")
    ])  # fmt: skip


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a type; an iterator is not read."""
    origin, inner = get_origin(hint) or hint, get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, x) for x in inner)
    if origin is Literal:
        return value in inner
    if origin is Mapping:
        pairs = [*value.items()] if isinstance(value, Mapping) else [None]
        return all(x and all(map(_fits, x, inner)) for x in pairs)
    if origin in _LISTS:
        alien = isinstance(value, (str, Mapping)) or not isinstance(value, Iterable)
        items = value if isinstance(value, Collection) else ()
        return not alien and all(_fits(x, inner[0]) for x in items)
    if not isclass(origin) or getattr(origin, "_is_protocol", False):
        return callable(value) or "__call__" not in vars(origin)
    if isinstance(value, (bool, np.bool_)):
        return origin in (bool, object, Any)
    return isinstance(value, _KINDS.get(origin, origin))


def _words(hint: Any) -> str:
    """A type as a signature states it, and what gives one."""
    words = hint.__name__ if isclass(hint) else re.sub(r"(\w+\.)+", "", str(hint))
    words = re.sub(r"Literal\[(.*?)\]", r"\1", words)
    words = re.sub(r"^\w+\[('.*')\]$", r"some of \1", words)
    sources = [x for kind, x in _MADE_BY.items() if re.search(rf"\b{kind}\b", words)]
    return f"{words}, as {' or '.join(sources)} gives" if sources else words
