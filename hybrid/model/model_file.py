"""Model files: JSON with a hash of the content.

Arrays are stored as bytes in base64, so that each is one line and is read bitwise
equal. Every value is checked when a file is read.
"""

from __future__ import annotations

import hashlib
import json
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid import __version__
from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics import BaseParameters
from hybrid.effects import Effect, Scale, effect_from_dict
from hybrid.errors import HybridError, ModelFileError
from hybrid.files import read_json, write_json
from hybrid.names import name_fault
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

if TYPE_CHECKING:
    from hybrid.model.dynamic_model import DynamicModel

SCHEMA = "hybrid.model/2"
_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError)
_FARTHEST = 1e3  # largest value of a parameter, over its largest plausible value


def write_model(model: DynamicModel, path: Path) -> None:
    """See :meth:`hybrid.model.dynamic_model.DynamicModel.save`."""
    if path.suffix != ".json":
        raise ModelFileError(f"{path}: a model is saved as .json")
    try:
        content = content_from_model(model)
        _read(type(model), dict(content))  # refuse what could not be read again
    except (ValueError, HybridError) as error:
        raise ModelFileError(f"{path}: not saved, {error}") from error
    write_json(path, content)


def content_from_model(model: DynamicModel) -> dict[str, Any]:
    """JSON-ready content of a saved model; ``sha256`` is the hash of all the rest."""
    content = {
        "schema": SCHEMA,
        "version": __version__,
        "robot": model.robot.as_dict(),
        "fingerprint": model.robot.fingerprint(),
        **_content(model),
        "simpler": {name: _content(each) for name, each in model.simpler.items()},
        "logs": list(model.logs),
    }
    return {"sha256": content_digest(content), **content}


def read_model(kind: type[DynamicModel], path: Path) -> DynamicModel:
    """See :meth:`hybrid.model.dynamic_model.DynamicModel.load`."""
    try:
        return _read(kind, read_json(path))
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    except HybridError as error:
        raise ModelFileError(f"{path}: {error}") from error
    except json.JSONDecodeError as error:
        if path.suffix.lower() in (".xml", ".urdf"):
            raise ModelFileError(
                f"{path}: a robot file, not a saved model; valid is the .json that "
                "identify writes; diagnose scores a robot file on logs"
            ) from error
        raise ModelFileError(f"{path}: damaged, no JSON ({error})") from error
    except _DAMAGE as error:
        raise ModelFileError(f"{path}: not a saved model ({error!r})") from error


def _read(kind: type[DynamicModel], content: Any) -> DynamicModel:
    if not isinstance(content, dict):
        raise ModelFileError(
            f"is {content!r:.80}, not a saved model; valid is what identify writes"
        )
    if content.get("schema") != SCHEMA:
        found = content.get("schema", "none")
        raise ModelFileError(f"schema is {found!r}, valid is {SCHEMA}")
    if content.pop("sha256") != content_digest(content):
        raise ModelFileError(
            "damaged or edited: its sha256 is not that of its content; identify again"
        )
    robot = Robot.from_dict(content["robot"])
    if content["fingerprint"] != robot.fingerprint():
        raise ModelFileError(
            f"fingerprint is {content['fingerprint']!r}, but that of its robot is "
            f"{robot.fingerprint()}: it is of another arm"
        )
    simpler = {name: _model(kind, robot, x) for name, x in content["simpler"].items()}
    for fault in filter(None, map(name_fault, simpler)):
        raise ModelFileError(f"simpler model: {fault}")
    logs = content.get("logs", [])  # older files have none
    if not (isinstance(logs, list) and all(isinstance(x, str) for x in logs)):
        raise ModelFileError("logs is no list of hashes")
    return replace(_model(kind, robot, content), simpler=simpler, logs=tuple(logs))


def content_digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of the content without the hash itself, independent of its layout."""
    text = json.dumps(content, allow_nan=False, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _content(model: DynamicModel) -> dict[str, Any]:
    base, learned = model.base, model.remainder
    return {
        "cutoff": model.cutoff if np.isfinite(model.cutoff) else None,
        "base": {
            "labels": list(base.labels),
            "units": list(base.units),
            "kept": list(base.kept),
            "names": list(base.names),
            "values": base.values.tolist(),
            "mapping": _packed(base.mapping),
        },
        "effects": [effect.as_dict(model.robot.joints) for effect in model.effects],
        "standing": model.standing.tolist(),
        "range": {name: x.tolist() for name, x in model.range.items()},
        "inertial": None if model.inertial is None else model.inertial.tolist(),
        "remainder": learned
        and {
            "parts": learned.as_dict(),
            "arrays": {name: _packed(x) for name, x in learned.arrays().items()},
        },
        **({"covariance": _packed(model.covariance)} if model.covariance.size else {}),
        **({"band": model.band} if np.isfinite(model.band) else {}),
    }


def _packed(x: Array) -> dict[str, Any]:
    text = b64encode(np.asarray(x, dtype="<f8").tobytes()).decode("ascii")
    return {"shape": list(x.shape), "float64": text}


def _unpacked(name: str, content: Mapping[str, Any]) -> Array:
    """Inverse of :func:`_packed`."""
    shape = tuple(map(_whole, content["shape"]))
    numbers = b64decode(content["float64"], validate=True)
    count = int(np.prod(shape, dtype=object))
    if 8 * count != len(numbers) or min(shape, default=0) < 0:
        raise ModelFileError(f"{name} has {len(numbers)} bytes for shape {shape}")
    return np.frombuffer(numbers, "<f8").reshape(shape)


def _model(kind: type[DynamicModel], robot: Robot, content: Any) -> DynamicModel:
    n, learned, cutoff = robot.size, content["remainder"], content["cutoff"]
    remainder = None
    if learned is not None:
        arrays = {name: _array(name, x) for name, x in learned["arrays"].items()}
        remainder = ArmRemainder.from_dict(n, learned["parts"], arrays)
        _check_joints(remainder)
    band = content.get("band")
    for name, x in (("cutoff", cutoff), ("band", band)):
        if x is not None and not 0 < _real(x) < np.inf:
            raise ModelFileError(f"{name} is {x}, valid is a number above 0 or none")
    links, standing = content["inertial"], content["standing"]
    base, seen = _base(robot, content["base"]), _range(content["range"], n)
    fastest = seen.get("v_max", np.zeros(n))
    return kind(
        robot=robot,
        base=base,
        effects=tuple(_effect(e, robot, fastest) for e in content["effects"]),
        remainder=remainder,
        cutoff=np.inf if cutoff is None else cutoff,
        standing=_array("standing", standing, (n,) if standing else (0,), 0.0),
        range=seen,
        inertial=None if links is None else _array("inertial", links, (n, 10)),
        covariance=_covariance(content.get("covariance"), base.size),
        band=np.inf if band is None else band,
    )


def _covariance(content: Any, size: int) -> Array:
    """Covariance of the base values; older files have none."""
    if content is None:
        return np.zeros((0, 0))
    found = _array("covariance", content, (size, size))
    if (np.diag(found) < 0).any():
        raise ModelFileError("covariance has a variance below 0")
    return found


def _range(content: Mapping[str, Any], n: int) -> dict[str, Array]:
    lowest = {"v_max": 0.0}
    found = {
        k: _array(f"range.{k}", x, (n,), lowest.get(k)) for k, x in content.items()
    }
    if {"q_min", "q_max"} <= set(found) and (found["q_min"] > found["q_max"]).any():
        raise ModelFileError("range.q_min is above range.q_max")
    return found


def _base(robot: Robot, content: Any) -> BaseParameters:
    labels, units = (tuple(map(str, content[key])) for key in ("labels", "units"))
    kept, p = tuple(map(_whole, content["kept"])), len(labels)
    if len(units) != p or p < 10 * robot.size:
        raise ModelFileError(f"base parameters have {p} labels and {len(units)} units")
    if not (len(set(kept)) == len(kept) and all(0 <= k < p for k in kept)):
        raise ModelFileError(f"kept parameters are not different ones below {p}")
    mapping = _array("mapping", content["mapping"], (len(kept), p))
    values = _array("values", content["values"], (len(kept),))
    return BaseParameters(labels, units, kept, mapping, values)


def _effect(content: Any, robot: Robot, fastest: Array) -> Effect:
    """An effect whose values are plausible at the arm's speeds.

    A fit finds them at speeds up to the fastest in its data, shape (n,), [rad/s], which
    may be far below those of the robot file.
    """
    for x in (*content["values"].values(), *content["std"].values()):
        _real(x)
    effect = effect_from_dict(content, robot.joints)
    if not all(0 <= x < np.inf for x in effect.std.values()):
        raise ModelFileError(f"{effect.id}: std is {dict(effect.std)}")
    scales = [
        [Scale(max(x.torque, 1.0), s) for s in (max(x.speed, 1.0), v) if s > 0]
        for x, v in zip(joint_scales(robot), fastest.tolist(), strict=True)
    ]
    for quantity in (*effect.gains, *effect.shapes):
        sized = [quantity.scaled(x) for j in effect.joints for x in scales[j]]
        most = _FARTHEST * max(abs(x) for q in sized for x in (q.lower, q.upper))
        if abs(effect.values[quantity.name]) > most:
            raise ModelFileError(
                f"{effect.id}: {quantity.name} is {effect.values[quantity.name]:g} "
                f"{quantity.unit}, valid is up to {most:g}"
            )
    return effect


def _check_joints(remainder: ArmRemainder) -> None:
    if len({part.joint for part in remainder.parts}) < len(remainder.parts):
        raise ModelFileError("a joint has two remainders")
    for part in remainder.parts:
        for j in (part.joint, *part.positions, *part.speeds):
            if not 0 <= j < remainder.size:
                raise ModelFileError(f"a remainder uses joint {j} of {remainder.size}")


def _real(x: Any) -> float:
    if isinstance(x, bool) or not isinstance(x, (int, float)):
        raise ModelFileError(f"{x!r} is no number")
    return float(x)


def _whole(x: Any) -> int:
    if isinstance(x, bool) or not isinstance(x, int):
        raise ModelFileError(f"{x!r} is no whole number")
    return x


def _array(
    name: str,
    content: Any,
    shape: tuple[int, ...] | None = None,
    lowest: float | None = None,
) -> Array:
    """Lists of numbers, or a packed array, with shape and values checked."""
    x = _unpacked(name, content) if isinstance(content, dict) else np.array(content)
    x = x.astype(float) if x.dtype.kind in "if" else x
    if x.dtype == float and not np.isfinite(x).all():
        raise ModelFileError(f"{name} holds NaN or infinity; valid are finite numbers")
    if x.shape != (shape or x.shape) or x.dtype != float:
        raise ModelFileError(
            f"{name} has shape {x.shape}; valid are numbers of shape {shape}"
        )
    if lowest is not None and (x < lowest).any():
        raise ModelFileError(f"{name} is {x.min():g}; valid is {lowest:g} or more")
    return x
