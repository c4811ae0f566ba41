"""Registry of all effects: files of this folder, entry points, and a user's file."""

import importlib
import importlib.util
import pkgutil
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.metadata import entry_points
from inspect import isabstract
from pathlib import Path
from types import ModuleType
from typing import Any

from hybrid.effects.effect import Effect, Port
from hybrid.effects.quantity import Scale
from hybrid.errors import EffectError
from hybrid.names import printable

_ENTRY_POINT_GROUP = "hybrid.effects"
_STATED = ("id", "port", "gains", "equation", "source", "sentence", "remedy")
_added: dict[str, type[Effect]] = {}


def effect_classes() -> Mapping[str, type[Effect]]:
    """Effect classes by id, in alphabetical order."""
    return dict(sorted((_shipped() | _added).items()))


@cache
def _shipped() -> dict[str, type[Effect]]:
    found: dict[str, type[Effect]] = {}
    for info in pkgutil.iter_modules([str(Path(__file__).parent)]):
        found |= _classes_in(importlib.import_module(f"{__package__}.{info.name}"))
    for point in entry_points(group=_ENTRY_POINT_GROUP):
        where = f"entry point {point.name} = {point.value}"
        found |= _loaded(where, point.load, found)
    return found


def _loaded(
    where: str, load: Callable[[], Any], known: Mapping[str, type[Effect]]
) -> dict[str, type[Effect]]:
    """Effects of a module, or one effect class, by id.

    Raises:
        EffectError: It cannot be loaded, defines no effect, or an id exists already.
    """
    try:
        found = _classes_in(load())
    except EffectError as error:
        raise EffectError(f"{where}: {error}") from error
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise EffectError(f"{where}: {reason}") from error
    if not found:
        raise EffectError(f"{where}: defines no concrete subclass of hybrid.Effect")
    if taken := sorted(found.keys() & known.keys()):
        # Saved models name effects by id, so the meaning of an id must not change.
        raise EffectError(f"{where}: {', '.join(taken)} exists already; rename it")
    return found


def _classes_in(target: ModuleType | type[Effect]) -> dict[str, type[Effect]]:
    """Effects that a module defines, or one effect class, by id."""
    whole = isinstance(target, ModuleType)
    found = [
        item
        for item in (vars(target).values() if whole else [target])
        if isinstance(item, type)
        and issubclass(item, Effect)
        and not isabstract(item)
        and (not whole or item.__module__ == target.__name__)
    ]
    for cls in found:
        missing = [name for name in _STATED if not hasattr(cls, name)]
        if missing:
            raise EffectError(f"{cls.__name__} does not state {', '.join(missing)}")
    return {cls.id: cls for cls in found}


def effects_from_file(path: str | Path) -> tuple[str, ...]:
    """Add the effects that a user's own Python file defines; returns their ids.

    The file is code that the user chose to run; data files never name one.

    Raises:
        EffectError: The file is missing or fails, or defines no effect, an incomplete
            effect, or an existing id.
    """
    path = Path(path)
    if not path.is_file():
        raise EffectError(f"{path}: no such file of effects")
    found = _loaded(str(path), lambda: _module(path), _shipped())
    _added.update(found)
    return tuple(found)


def _module(path: Path) -> ModuleType:
    name = f"hybrid_user_effects_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise EffectError("not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def effect_class(effect_id: str) -> type[Effect]:
    """The class of an effect.

    Raises:
        EffectError: There is no effect of this id.
    """
    known = effect_classes()
    if effect_id not in known:
        raise EffectError(
            f"no effect {effect_id!r}; valid are {', '.join(sorted(known))} "
            "(effects of your own: --effects-from FILE.py)"
        )
    return known[effect_id]


def effect_at(port: Port, *, shifts: bool) -> type[Effect]:
    """The effect at a port that shifts a signal in time, or that does not.

    It is the library's own, whatever a user adds there.
    """
    known = _shipped().values()
    return next(x for x in known if x.port is port and x.shifts == shifts)


def effect_from_dict(content: Mapping[str, Any], names: Sequence[str]) -> Effect:
    """The effect that :meth:`Effect.as_dict` described, given the arm's joint names.

    Raises:
        EffectError: The effect, a joint or a parameter is unknown.
    """
    try:
        cls = effect_class(content["effect"])
        joints = [_index(name, names) for name in content["joints"]]
        values = dict(content.get("values", {}))
        return cls(tuple(joints), values, dict(content.get("std", {})))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise EffectError(f"not an effect: {content!r} ({error!r})") from error


def effects_from_text(
    text: str, names: Sequence[str], scales: Sequence[Scale], *, gains: bool = True
) -> list[Effect]:
    """Effects from the text of the command line, at their usual size.

    ``stribeck:elbow,torque_ripple`` is Stribeck friction at the elbow and ripple at
    every joint; ``payload(mass=3)`` sets a value, ``transmission_coupling:5+6`` names
    two joints, ``coulomb:1,coulomb:2(level=4;…)`` several. Without ``gains``, values
    of shapes alone may be set.

    Raises:
        EffectError: The text does not parse, names what does not exist, sets what may
            not be set, or gives a quantity a sign that it cannot have.
    """
    effects: list[Effect] = []
    for item in filter(None, (part.strip() for part in text.split(","))):
        match = re.fullmatch(r"(\w+)(?::([^()]+))?(?:\(([^()]*)\))?", item)
        if match is None:
            raise EffectError(
                f"cannot read {item!r}; valid is effect[:joint[+joint]][(name=value;…)]"
            )
        effect_id, joints, assignments = match.groups()
        values = _values(assignments or "", item)
        cls = effect_class(effect_id)
        given = [] if gains else [g.name for g in cls.gains if g.name in values]
        if given:
            shapes = ", ".join(s.name for s in cls.shapes)
            raise EffectError(
                f"{item!r}: the fit finds {given[0]}; valid are "
                f"{f'values of {shapes}' if shapes else 'no values'}"
            )
        for group in _groups(cls, joints, names):
            effects.append(cls.typical(group, scales, **values))
        for x in (*cls.gains, *cls.shapes):
            value = values.get(x.name, 0.0)
            if x.lower >= 0 and not value >= 0:
                raise EffectError(
                    f"{item!r}: {x.name} is {value:g}; valid is 0 or more"
                )
    return effects


def _values(text: str, item: str) -> dict[str, float]:
    values = {}
    for assignment in filter(None, (part.strip() for part in text.split(";"))):
        name, _, number = assignment.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError as error:
            raise EffectError(f"{item!r}: {assignment!r} is not name=number") from error
    return values


def _groups(
    cls: type[Effect], text: str | None, names: Sequence[str]
) -> list[tuple[int, ...]]:
    """Joint tuples of the instances to make."""
    everything = tuple(range(len(names)))
    if cls.scope == "arm":
        if text is not None:
            raise EffectError(
                f"{cls.id} is of the whole arm; leave out ':{printable(text)}'"
            )
        return [everything]
    if text is None:
        if cls.scope == "coupling":
            pair = "+".join(names[-2:])
            raise EffectError(f"{cls.id} needs its joints, e.g. {cls.id}:{pair}")
        return [(j,) for j in everything]
    joints = tuple(_index(name.strip(), names) for name in text.split("+"))
    return [joints] if cls.scope == "coupling" else [(j,) for j in joints]


def _index(name: str, names: Sequence[str]) -> int:
    if name in names:
        return list(names).index(name)
    if str(name).isdigit() and 1 <= int(name) <= len(names):
        return int(name) - 1
    raise EffectError(
        f"no joint {name!r}; valid are {', '.join(names)} or 1 to {len(names)}"
    )
