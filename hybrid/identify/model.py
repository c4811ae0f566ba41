"""The product of identification: a sum of terms that predicts joint torque."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import hybrid
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics import BaseParameters, RigidBody
from hybrid.effects import Effect, effect_from_dict
from hybrid.errors import ModelFileError
from hybrid.files import atomic_path, write_json
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion

SCHEMA = "hybrid.model/1"


@dataclass(frozen=True)
class DynamicModel:
    """Drive torque = rigid body + effects + learned remainder.

    Attributes:
        robot: The arm.
        base: Base inertial parameters with their values.
        effects: Effects with their values.
        remainder: What was learned of the rest, or None.
        cutoff: Cut-off up to which it was identified, [Hz].
        standing: Speed below which a joint counts as standing, shape (n,), [rad/s].
        range: Lowest and highest position and speed seen in fitting, by name
            (``q_min``, ``q_max``, ``v_max``), each of shape (n,).
        inertial: Physically consistent link parameters, shape (n, 10), or None.
        simpler: Models of the earlier stages and plainer estimators, by name, for
            comparison.
    """

    robot: Robot
    base: BaseParameters
    effects: tuple[Effect, ...] = ()
    remainder: ArmRemainder | None = None
    cutoff: float = np.inf
    standing: Array = field(default_factory=lambda: np.zeros(0))
    range: Mapping[str, Array] = field(default_factory=dict)
    inertial: Array | None = None
    simpler: Mapping[str, DynamicModel] = field(default_factory=dict)

    @property
    def stage(self) -> str:
        """Name of the last stage that this model went through."""
        if self.remainder is not None:
            return "+ remainder"
        kinds = {effect.id for effect in self.effects}
        if "torque_ripple" in kinds:
            return "+ ripple"
        return "+ friction" if "threshold_friction" in kinds else "rigid"

    @cached_property
    def _inertial(self) -> Array:
        n = self.robot.size
        return self.base.standard()[: 10 * n].reshape(n, 10)

    def body(self, motion: Motion) -> RigidBody:
        """The identified rigid body along a motion."""
        return RigidBody(self.robot.chain, motion, self._inertial)

    def predict(self, motion: Motion) -> Array:
        """Drive torque along a motion, as the log would show it.

        Args:
            motion: N samples of position, speed and acceleration.

        Returns:
            Torque, shape (N, n), [N·m].
        """
        for effect in self.effects:
            motion = effect.observe(motion, self.body(motion))
        body = self.body(motion)
        tau = body.load.copy()
        for effect in self.effects:
            tau[:, effect.joints] += effect.torque(motion, body)
        for effect in self.effects:
            if effect.reports:
                joints = list(effect.joints)
                tau[:, joints] = effect.report(motion.t, tau[:, joints])
        if self.remainder is not None:
            tau += self.remainder.predict(motion.q, motion.v)
        return tau

    def without_remainder(self) -> DynamicModel:
        """The physical terms alone."""
        return replace(self, remainder=None)

    def save(self, path: str | Path) -> None:
        """Write ``path`` (JSON) and, beside it, the arrays (``.safetensors``).

        Raises:
            ModelFileError: The path does not end in ``.json``.
        """
        from safetensors.numpy import save_file

        path = Path(path)
        if path.suffix != ".json":
            raise ModelFileError(f"{path}: a model is saved as .json")
        arrays: dict[str, Array] = {}
        content = {
            "schema": SCHEMA,
            "version": hybrid.__version__,
            "arrays": path.with_suffix(".safetensors").name,
            "robot": self.robot.as_dict(),
            "fingerprint": self.robot.fingerprint(),
            **self._content("", arrays),
            "simpler": {
                name: model._content(f"{name}/", arrays)
                for name, model in self.simpler.items()
            },
        }
        with atomic_path(path.with_suffix(".safetensors")) as temporary:
            save_file({k: np.ascontiguousarray(x) for k, x in arrays.items()}, temporary)
        write_json(path, content)

    def _content(self, prefix: str, arrays: dict[str, Array]) -> dict[str, Any]:
        """JSON-ready terms; the numbers go into ``arrays`` under ``prefix``."""
        own = {"mapping": self.base.mapping, "values": self.base.values}
        own |= {"standing": self.standing, "cutoff": np.array([self.cutoff])}
        own |= {f"range.{name}": x for name, x in self.range.items()}
        if self.inertial is not None:
            own["inertial"] = self.inertial
        if self.remainder is not None:
            own |= self.remainder.arrays()
        arrays |= {prefix + name: value for name, value in own.items()}
        return {
            "base": {
                "labels": list(self.base.labels),
                "units": list(self.base.units),
                "kept": list(self.base.kept),
                "names": list(self.base.names),
                "values": [float(x) for x in self.base.values],
            },
            "effects": [effect.as_dict(self.robot.joints) for effect in self.effects],
            "remainder": self.remainder and self.remainder.as_dict(),
        }

    @classmethod
    def load(cls, path: str | Path) -> DynamicModel:
        """Read what :meth:`save` wrote.

        Raises:
            ModelFileError: The files are missing, damaged or of another version.
            EffectError: The model has an effect that is not known here.
        """
        path = Path(path)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content.get("schema") != SCHEMA:
                found = content.get("schema", "none")
                raise ModelFileError(f"{path}: schema is {found}, valid is {SCHEMA}")
            arrays = _read_arrays(path, content)
            robot = Robot.from_dict(content["robot"])
            simpler = {
                name: cls._from_content(robot, item, f"{name}/", arrays)
                for name, item in content["simpler"].items()
            }
            model = cls._from_content(robot, content, "", arrays)
            return replace(model, simpler=simpler)
        except OSError as error:
            raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ModelFileError(f"{path}: not a saved model ({error!r})") from error

    @classmethod
    def _from_content(
        cls, robot: Robot, content: Any, prefix: str, arrays: dict[str, Array]
    ) -> DynamicModel:
        own = {k[len(prefix) :]: x for k, x in arrays.items() if k.startswith(prefix)}
        base = content["base"]
        described = content["remainder"]
        return cls(
            robot=robot,
            base=BaseParameters(
                tuple(base["labels"]),
                tuple(base["units"]),
                tuple(base["kept"]),
                own["mapping"],
                own["values"],
            ),
            effects=tuple(effect_from_dict(e, robot.joints) for e in content["effects"]),
            remainder=(
                None
                if described is None
                else ArmRemainder.from_dict(robot.size, described, own)
            ),
            cutoff=float(own["cutoff"][0]),
            standing=own["standing"],
            range={k[6:]: x for k, x in own.items() if k.startswith("range.")},
            inertial=own.get("inertial"),
        )


def _read_arrays(path: Path, content: Mapping[str, Any]) -> dict[str, Array]:
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    beside = path.with_name(Path(content["arrays"]).name)
    try:
        arrays: dict[str, Array] = load_file(beside)
    except FileNotFoundError as error:
        raise ModelFileError(f"{beside}: missing; it belongs to {path.name}") from error
    except SafetensorError as error:
        raise ModelFileError(f"{beside}: damaged ({error})") from error
    return arrays


def check_same_arm(model: DynamicModel, robot: Robot) -> None:
    """Refuse a model of another arm.

    Raises:
        ModelFileError: Joints or kinematics differ.
    """
    if model.robot.joints != robot.joints:
        raise ModelFileError(
            f"the model is of joints {', '.join(model.robot.joints)}, "
            f"the robot file has {', '.join(robot.joints)}"
        )
    if model.robot.fingerprint() != robot.fingerprint():
        raise ModelFileError(
            f"the model is of another arm ({model.robot.name}); its kinematics differ "
            f"from {robot.name}"
        )

