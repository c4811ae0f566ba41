"""Learned remainders of the joints of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.gmr import GaussianMixtureRegression, check_matrix
from hybrid.dynamics import Law, Tape
from hybrid.errors import ModelFileError


@dataclass(frozen=True)
class JointRemainder:
    """Remainder of one joint's torque as a function of some positions and speeds.

    Attributes:
        joint: Index of the joint.
        positions: Joints whose position is an input.
        speeds: Joints whose speed is an input.
        regression: Regression from these inputs, positions first, to one torque.
    """

    joint: int
    positions: tuple[int, ...]
    speeds: tuple[int, ...]
    regression: GaussianMixtureRegression

    def inputs(self, q: Array, v: Array) -> Array:
        """Inputs of the regression from the state of the arm, shape (N, d)."""
        return np.concatenate([q[:, self.positions], v[:, self.speeds]], axis=1)


@dataclass(frozen=True)
class ArmRemainder:
    """Remainders of the joints; zero for joints without one.

    Attributes:
        size: Number of joints n.
        parts: At most one remainder for each joint.
    """

    size: int
    parts: tuple[JointRemainder, ...]

    def predict(self, q: Array, v: Array) -> Array:
        """Mean torque at some positions and speeds, shape (N, n), [N·m]."""
        check_matrix("state", np.concatenate([q, v], axis=1), 2 * self.size)
        return self._law.along((q, v))

    @cached_property
    def _law(self) -> Law:
        """All mixtures as one compiled function of positions and speeds."""
        tape, n = Tape(), self.size
        names = tuple(f"{x}[{j}]" for x in "qv" for j in range(n))
        given = [tape.input(name) for name in names]
        mean, _ = self.at_instant(given[:n], given[n:])
        return Law(tape, tuple(mean), names)

    def at_instant(
        self, q: Sequence[Any], v: Sequence[Any]
    ) -> tuple[list[Any], list[Any]]:
        """Mean [N·m] and variance [(N·m)²] of each torque, by arithmetic on scalars.

        The variance of a joint without a remainder is NaN. Positions and speeds of all
        joints are numbers, arrays, or symbols of a tape.
        """
        mean, variance = [0.0] * self.size, [np.nan] * self.size
        for part in self.parts:
            seen = [*(q[j] for j in part.positions), *(v[j] for j in part.speeds)]
            mean[part.joint], variance[part.joint] = part.regression.at_instant(seen)
        return mean, variance

    def as_dict(self) -> list[dict[str, object]]:
        """JSON-ready description; the numbers are in :meth:`arrays`."""
        return [
            {
                "kind": part.regression.kind,
                "joint": part.joint,
                "positions": list(part.positions),
                "speeds": list(part.speeds),
            }
            for part in self.parts
        ]

    def arrays(self) -> dict[str, Array]:
        """All numbers, by ``remainder.<index>.<name>``."""
        return {
            f"remainder.{k}.{name}": value
            for k, part in enumerate(self.parts)
            for name, value in part.regression.arrays().items()
        }

    @classmethod
    def from_dict(
        cls,
        size: int,
        content: Sequence[Mapping[str, object]],
        arrays: Mapping[str, Array],
    ) -> ArmRemainder:
        """The remainder from the results of :meth:`as_dict` and :meth:`arrays`.

        Raises:
            ModelFileError: The description or the numbers are damaged.
        """
        parts = []
        for k, item in enumerate(content):
            prefix = f"remainder.{k}."
            named = (x for x in arrays if x.startswith(prefix))
            own = {x.removeprefix(prefix): arrays[x] for x in named}
            try:
                kind, valid = str(item["kind"]), GaussianMixtureRegression.kind
                if kind != valid:
                    raise ModelFileError(
                        f"remainder {k} is of kind {kind[:40]!r}; valid is {valid}"
                    )
                regression = GaussianMixtureRegression.from_arrays(own)
                joint = int(str(item["joint"]))
                positions, speeds = (
                    tuple(int(j) for j in item[key])  # type: ignore[attr-defined]
                    for key in ("positions", "speeds")
                )
            except (KeyError, TypeError, ValueError) as error:
                raise ModelFileError(f"remainder {k} is damaged: {error!r}") from error
            if len(positions) + len(speeds) != regression.inputs:
                raise ModelFileError(f"remainder {k}: inputs do not match its numbers")
            parts.append(JointRemainder(joint, positions, speeds, regression))
        return cls(size, tuple(parts))
