"""Dynamic models in files: JSON for what people read, safetensors for the numbers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid import __version__
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics import BaseParameters
from hybrid.effects import Effect, effect_from_dict
from hybrid.errors import HybridError, ModelFileError
from hybrid.files import atomic_path, write_json
from hybrid.identify.model import DynamicModel
from hybrid.robot import Robot
from hybrid.robot.chain import Array

SCHEMA = "hybrid.model/1"
_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, IndexError, HybridError)


def write_model(model: DynamicModel, path: Path) -> None:
    """See :meth:`hybrid.identify.model.DynamicModel.save`."""
    from safetensors.numpy import save

    if path.suffix != ".json":
        raise ModelFileError(f"{path}: a model is saved as .json")
    arrays: dict[str, Array] = {}
    own = _content(model, "", arrays)
    simpler = {
        name: _content(each, f"{name}/", arrays) for name, each in model.simpler.items()
    }
    numbers = save({name: np.ascontiguousarray(x) for name, x in arrays.items()})
    beside = path.with_suffix(".safetensors")
    with atomic_path(beside) as temporary:
        temporary.write_bytes(numbers)
    # If the program stops here, the hash tells that the numbers are not the old ones.
    content = {
        "schema": SCHEMA,
        "version": __version__,
        "arrays": beside.name,
        "arrays_sha256": hashlib.sha256(numbers).hexdigest(),
        "robot": model.robot.as_dict(),
        "fingerprint": model.robot.fingerprint(),
        **own,
        "simpler": simpler,
    }
    write_json(path, content)


def read_model(path: Path) -> DynamicModel:
    """See :meth:`hybrid.identify.model.DynamicModel.load`."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("schema") != SCHEMA:
            found = content.get("schema", "none")
            raise ModelFileError(f"schema is {found}, valid is {SCHEMA}")
        arrays = _read_arrays(path, content)
        robot = Robot.from_dict(content["robot"])
        model = _model(robot, content, "", arrays)
        simpler = {
            str(name): _model(robot, each, f"{name}/", arrays)
            for name, each in content["simpler"].items()
        }
        return replace(model, simpler=simpler)
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    except HybridError as error:
        raise ModelFileError(f"{path}: {error}") from error
    except _DAMAGE as error:
        raise ModelFileError(f"{path}: not a saved model ({error!r})") from error


def _content(
    model: DynamicModel, prefix: str, arrays: dict[str, Array]
) -> dict[str, Any]:
    """JSON-ready terms; the numbers go into ``arrays`` under ``prefix``."""
    base = model.base
    own = {"mapping": base.mapping, "values": base.values}
    own |= {"standing": model.standing, "cutoff": np.array([model.cutoff])}
    own |= {f"range.{name}": x for name, x in model.range.items()}
    if model.inertial is not None:
        own["inertial"] = model.inertial
    if model.remainder is not None:
        own |= model.remainder.arrays()
    arrays |= {prefix + name: value for name, value in own.items()}
    return {
        "base": {
            "labels": list(base.labels),
            "units": list(base.units),
            "kept": list(base.kept),
            "names": list(base.names),
            "values": [float(x) for x in base.values],
        },
        "effects": [effect.as_dict(model.robot.joints) for effect in model.effects],
        "remainder": None if model.remainder is None else model.remainder.as_dict(),
    }


def _model(
    robot: Robot, content: Any, prefix: str, arrays: Mapping[str, Array]
) -> DynamicModel:
    own = {k[len(prefix) :]: x for k, x in arrays.items() if k.startswith(prefix)}
    described = content["remainder"]
    remainder = None
    if described is not None:
        remainder = ArmRemainder.from_dict(robot.size, described, own)
        _check_joints(remainder)
    n, base = robot.size, _base(robot, content["base"], own)
    standing = own["standing"]
    return DynamicModel(
        robot=robot,
        base=base,
        effects=tuple(_effect(e, robot) for e in content["effects"]),
        remainder=remainder,
        cutoff=_cutoff(own),
        standing=_array(own, "standing", (n,)) if standing.size else standing,
        range={k[6:]: _array(own, k, (n,)) for k in own if k.startswith("range.")},
        inertial=_array(own, "inertial", (n, 10)) if "inertial" in own else None,
    )


def _base(robot: Robot, content: Any, own: Mapping[str, Array]) -> BaseParameters:
    labels, units = (tuple(map(str, content[key])) for key in ("labels", "units"))
    kept, p = tuple(map(int, content["kept"])), len(labels)
    if len(units) != p or p < 10 * robot.size:
        raise ModelFileError(f"base parameters have {p} labels and {len(units)} units")
    if not (len(set(kept)) == len(kept) and all(0 <= k < p for k in kept)):
        raise ModelFileError(f"kept parameters are not different ones below {p}")
    mapping = _array(own, "mapping", (len(kept), p))
    return BaseParameters(
        labels, units, kept, mapping, _array(own, "values", (len(kept),))
    )


def _effect(content: Any, robot: Robot) -> Effect:
    effect = effect_from_dict(content, robot.joints)
    if not all(isinstance(x, float) and x >= 0 for x in effect.std.values()):
        raise ModelFileError(f"{effect.id}: std is {dict(effect.std)}")
    return effect


def _check_joints(remainder: ArmRemainder) -> None:
    for part in remainder.parts:
        for j in (part.joint, *part.positions, *part.speeds):
            if not 0 <= j < remainder.size:
                raise ModelFileError(
                    f"the remainder looks at joint {j} of {remainder.size}"
                )
        if part.regression.outputs != 1:
            raise ModelFileError("a joint's remainder has more than one torque")


def _cutoff(own: Mapping[str, Array]) -> float:
    cutoff = own["cutoff"]
    if not (cutoff.shape == (1,) and cutoff[0] > 0):
        raise ModelFileError(f"cutoff is {cutoff}, valid is one number above 0")
    return float(cutoff[0])


def _array(own: Mapping[str, Array], name: str, shape: tuple[int, ...]) -> Array:
    """An array, if it is what it should be."""
    x = own[name]
    if x.shape != shape or x.dtype != np.float64 or not np.isfinite(x).all():
        raise ModelFileError(
            f"{name} has shape {x.shape} and type {x.dtype}; valid are finite numbers "
            f"of shape {shape} and type float64"
        )
    return x


def _read_arrays(path: Path, content: Mapping[str, Any]) -> dict[str, Array]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    beside = path.with_name(Path(content["arrays"]).name)
    try:
        numbers = beside.read_bytes()
    except FileNotFoundError as error:
        raise ModelFileError(f"{beside}: missing; it belongs to {path.name}") from error
    if hashlib.sha256(numbers).hexdigest() != content["arrays_sha256"]:
        raise ModelFileError(f"{beside}: damaged, or of another model than {path.name}")
    try:
        arrays: dict[str, Array] = load(numbers)
    except SafetensorError as error:
        raise ModelFileError(f"{beside}: damaged ({error})") from error
    return arrays
