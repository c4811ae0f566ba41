"""A kinematic chain as a product of rotations about and shifts along x, y or z.

All conventions of joint frames, such as the variants of Denavit-Hartenberg, are such
products. The derivative of the pose by any factor is the twist of that factor: Corke
2007, doi 10.1109/TRO.2007.896765.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid.arrays import Array

Values = Mapping[str, float]


@dataclass(frozen=True)
class FixedStep:
    """A constant factor: rotation (3, 3) and translation (3,), [m]."""

    rotation: Array
    translation: Array


@dataclass(frozen=True)
class Step:
    """A rotation about, or a shift along, one axis of the present frame.

    Its size is ``nominal`` + parameter · (load of joint ``load``) + q of joint
    ``joint``. Without ``load`` the parameter is not multiplied, without ``joint``
    nothing is added.
    """

    axis: int  # 0, 1 or 2 for x, y or z
    turns: bool  # False for a shift
    nominal: float = 0.0  # constant part, [rad or m]
    parameter: str = ""  # name of the unknown part; empty without one
    joint: int | None = None  # index of the joint whose position is added
    load: int | None = None  # index of the joint whose load multiplies the parameter

    @property
    def unit(self) -> str:
        """Unit of the parameter."""
        if self.load is None:
            return "rad" if self.turns else "m"
        return "rad/(N·m)" if self.turns else "m/N"


@dataclass(frozen=True)
class Frame:
    """The frame after a product of factors, for N samples."""

    rotation: Array  # shape (N, 3, 3)
    origin: Array  # shape (N, 3), [m]
    # Derivative by each parameter of the factors, by name: velocity of the point at the
    # first frame's origin, then rotation, shape (N, 6).
    twists: Mapping[str, Array] = field(default_factory=dict)


def start(q: Array) -> Frame:
    """The frame before the first factor, for samples of q, shape (N, n)."""
    return Frame(np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3)))


def follow(
    frame: Frame,
    steps: Sequence[FixedStep | Step],
    q: Array,
    values: Values,
    load: Array | None = None,
) -> Frame:
    """The frame after more factors, at joint positions q (N, n), [rad or m].

    Parameters without a value are zero. Each joint has a load, shape (N, n); without
    it, steps with a load are left out.
    """
    R, origin, twists = frame.rotation, frame.origin, dict(frame.twists)
    for step in steps:
        if isinstance(step, FixedStep):
            origin = origin + R @ step.translation
            R = R @ step.rotation
            continue
        if step.load is not None and load is None:
            continue
        axis = R[..., step.axis]
        rate = 1.0 if step.load is None or load is None else load[:, step.load]
        if step.parameter:
            way = axis * np.asarray(rate)[..., None]
            both = (np.cross(origin, way), way) if step.turns else (way, 0 * way)
            twists[step.parameter] = np.concatenate(both, axis=-1)
        size = np.full(len(q), step.nominal) + values.get(step.parameter, 0.0) * rate
        if step.joint is not None:
            size += q[:, step.joint]
        if step.turns:
            R = _turned(R, step.axis, size)
        else:
            origin = origin + axis * size[..., None]
    return Frame(R, origin, twists)


def _turned(R: Array, axis: int, angle: Array) -> Array:
    b, c = (axis + 1) % 3, (axis + 2) % 3
    sine, cosine = np.sin(angle)[..., None], np.cos(angle)[..., None]
    turned = R.copy()
    turned[..., b] = cosine * R[..., b] + sine * R[..., c]
    turned[..., c] = cosine * R[..., c] - sine * R[..., b]
    return turned


def free_frame(prefix: str, *, turns: bool = True) -> tuple[Step, ...]:
    """Three unknown shifts, then three unknown rotations: ``base_x`` to ``base_rz``."""
    names = ("x", "y", "z", "rx", "ry", "rz")[: 6 if turns else 3]
    return tuple(
        Step(k % 3, k > 2, parameter=f"{prefix}_{name}") for k, name in enumerate(names)
    )
