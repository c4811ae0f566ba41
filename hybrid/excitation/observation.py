"""The whitened and scaled observation matrix of a motion, with its gradient.

Only combinations of the inertial parameters are identifiable. The condition number of a
motion depends on which parameters are chosen to represent them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import qr, solve_triangular

from hybrid.arrays import Array, Index
from hybrid.dynamics import (
    BaseParameters,
    effect_gains,
    inverse_dynamics,
    regressor,
    regressor_gradient,
    stacked_base,
)
from hybrid.effects import Effect, JointEffect, JointState, effects_from_text
from hybrid.errors import ExcitationError
from hybrid.excitation.path import Path
from hybrid.plant.noise import Noise
from hybrid.plant.scale import joint_scales
from hybrid.robot.chain import Chain
from hybrid.robot.robot import Robot

# Dry friction is smoothed within this speed, since a step has no gradient.
TURNING_SPEED = 0.02  # rad/s
_STEP = 1e-5  # relative, for finite differences
FIRST = "first independent columns"
PIVOTED = "columns by pivoted QR"
# What a fit of a log has beside the rigid body; published condition numbers have none.
FITTED = "armature,torque_offset,coulomb,viscous"


@dataclass(frozen=True, eq=False)
class Observation:
    """The observation matrix of an arm with some effects.

    A row is the torque of one joint at one time per unit of every unknown. Rows are
    whitened by the noise, W = Ω^(−1/2) Y, and columns are scaled.
    """

    chain: Chain
    effects: tuple[JointEffect, ...]  # whose gains are unknown
    base: BaseParameters  # of all inertial parameters and gains
    whitening: Array  # L⁻¹ of the noise covariance L Lᵀ, shape (n, n), [1/(N·m)]
    scale: Array  # unit in which each unknown is counted, shape (b,)

    @property
    def size(self) -> int:
        """Number of unknowns b."""
        return self.base.size

    @cached_property
    def gains(self) -> tuple[tuple[int, int], ...]:
        """Effect and gain of each column after the 10n inertial ones."""
        return effect_gains(self.effects)

    def matrix(self, path: Path, *, turning_speed: float = TURNING_SPEED) -> Array:
        """The observation matrix of a motion of N samples, shape (N, n, b).

        Dry friction is smoothed within a speed, [rad/s]; 0 is a step.
        """
        Y = regressor(self.chain, path.q, path.v, path.a)
        if self.gains:
            Y = np.concatenate([Y, self._effects(path, turning_speed)], axis=2)
        return np.asarray(self.whitening @ Y.take(self.base.kept, axis=2) * self.scale)

    def gram(self, path: Path, *, turning_speed: float = TURNING_SPEED) -> Array:
        """Information of a motion, Wᵀ W, shape (b, b)."""
        W = self.matrix(path, turning_speed=turning_speed).reshape(-1, self.size)
        return np.asarray(W.T @ W)

    def gradient(self, path: Path, weight: Array) -> tuple[Array, Array, Array]:
        """Derivatives of ``sum(weight * matrix(path))`` by q, v and a, (N, n) each."""
        links = 10 * self.chain.size
        every = np.zeros((*path.q.shape, links + len(self.gains)))
        every[:, :, list(self.base.kept)] = self.whitening.T @ weight * self.scale
        seed, own = every[:, :, :links], np.zeros((3, *path.q.shape))
        if self.gains:
            own, load = self._effects_gradient(path, every[:, :, links:])
            seed += load[:, :, None] * self.chain.inertial.ravel()
        by = regressor_gradient(self.chain, path.q, path.v, path.a, seed)
        return by[0] + own[0], by[1] + own[1], by[2] + own[2]

    def with_structure(
        self, effects: Sequence[JointEffect], sizes: Array
    ) -> Observation:
        """Append the columns of effects that the fit leaves out.

        Gains whose columns depend on the present ones are left out. Each is counted in
        one of the ``sizes``.
        """
        every = (*self.effects, *effects)
        base = stacked_base(self.chain, every, effect_gains(every))
        first = 10 * self.chain.size + len(self.gains)
        more = sizes[[k - first for k in base.kept[self.size :]]]
        return replace(
            self, effects=every, base=base, scale=np.append(self.scale, more)
        )

    @cached_property
    def _laws(self) -> list[_Law]:
        """The laws of the effects, each for all of its joints."""
        ends = np.cumsum([len(e.gains) for e in self.effects])
        kinds = dict.fromkeys(map(type, self.effects))
        each = ([k for k, e in enumerate(self.effects) if type(e) is x] for x in kinds)
        return [_Law([self.effects[k] for k in own], ends[own]) for own in each]

    def _signals(self, path: Path) -> Array:
        """Position, speed, acceleration and load of the joints, shape (4, N, n)."""
        motion = path.q, path.v, path.a
        load = inverse_dynamics(self.chain, self.chain.inertial, *motion)
        return np.stack([*motion, load])

    def _effects(self, path: Path, turning_speed: float) -> Array:
        """Columns of the effects, not whitened, shape (N, n, gains)."""
        out, signals = np.zeros((*path.q.shape, len(self.gains))), self._signals(path)
        for law in self._laws:
            found = law.torque(signals[:, :, law.joints], turning_speed)
            out[:, law.joints[:, None], law.columns] = found
        return out

    def _effects_gradient(self, path: Path, weight: Array) -> tuple[Array, Array]:
        """Derivatives by (q, v, a), shape (3, N, n), and by the load, shape (N, n)."""
        signals = self._signals(path)
        by = np.zeros(signals.shape)
        for law in self._laws:
            state = signals[:, :, law.joints]
            largest = np.abs(state).max(axis=1)
            size = _STEP * np.where(largest > 0.0, largest, 1.0)  # (4, k)
            step = np.eye(4)[:, :, None, None] * size[:, None, :]  # by signal, of each
            ends = np.stack([state[:, None] + step, state[:, None] - step], axis=1)
            after, before = law.torque(ends, TURNING_SPEED)
            own = weight[:, law.joints[:, None], law.columns]
            slopes = (own * (after - before)).sum(axis=-1) / (2 * size[:, None, :])
            for k, j in enumerate(law.joints):
                by[:, :, j] += slopes[:, :, k]
        return by[:3], by[3]


class _Law:
    """One law of a joint's state, at k ``joints``, with ``columns`` of gains (k, p)."""

    def __init__(self, effects: Sequence[JointEffect], ends: Index) -> None:
        first = effects[0]
        self._law = first.law
        self._shapes = {
            x.name: np.array([e.values[x.name] for e in effects]) for x in first.shapes
        }
        self.joints = np.array([e.joints[0] for e in effects])
        self.columns = ends[:, None] + np.arange(-len(first.gains), 0)

    def torque(self, signals: Array, turning_speed: float) -> Array:
        """Torque per unit of each gain, (..., N, k, p), of signals (4, ..., N, k)."""
        q, v, a, load = signals
        sign = np.tanh(v / turning_speed) if turning_speed > 0 else np.sign(v)
        t = np.broadcast_to(np.arange(float(q.shape[-2]))[:, None], q.shape)
        found = self._law(JointState(t, q, v, a, sign, load), **self._shapes)
        return np.stack([np.broadcast_to(x, q.shape) for x in found], axis=-1)


def observe(
    chain: Chain,
    effects: Sequence[Effect] = (),
    *,
    covariance: Array | None = None,
) -> Observation:
    """The observation matrix of an arm with some effects.

    Args:
        chain: The arm.
        effects: Effects whose gains are unknown as well; laws of one joint's state.
        covariance: Covariance of the torque noise between joints, shape (n, n),
            [N²·m²]; by default the unit matrix.

    Raises:
        ExcitationError: A shape does not fit, the covariance is not positive, or an
            effect is no law of one joint's state.
    """
    laws = tuple(e for e in effects if isinstance(e, JointEffect))
    if others := [e.id for e in effects if not isinstance(e, JointEffect)]:
        raise ExcitationError(
            f"{others[0]} has no law of one joint's state, and a motion can be "
            "designed for such effects only"
        )
    base = stacked_base(chain, effects, effect_gains(effects))
    noise = np.eye(chain.size) if covariance is None else np.asarray(covariance)
    if noise.shape != (chain.size, chain.size):
        raise ExcitationError(f"covariance needs shape {(chain.size, chain.size)}")
    try:
        lower = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError as error:
        raise ExcitationError("the noise covariance must be positive") from error
    whitening = solve_triangular(lower, np.eye(chain.size), lower=True)
    return Observation(chain, laws, base, whitening, np.ones(base.size))


def usual_observation(robot: Robot) -> Observation:
    """That of a fit: rigid body, rotors, offsets and friction, with usual noise."""
    effects = effects_from_text(FITTED, robot.joints, joint_scales(robot))
    noise = Noise.typical(robot).torque_covariance
    return observe(robot.chain, effects, covariance=noise)


def rigid_columns(chain: Chain, H: Array) -> dict[str, list[int]]:
    """Choices of base columns among the 10n of the regressor, by name.

    ``first independent columns`` goes from base to tip and keeps each column that does
    not depend on those before, the same for every motion. ``columns by pivoted QR``
    always takes the largest remaining one of the observation matrix H, (rows, 10n).
    """
    kept = [*stacked_base(chain, (), ()).kept]
    _, order = qr(H, mode="r", pivoting=True)
    return {FIRST: kept, PIVOTED: order[: len(kept)].tolist()}


def rigid_conditions(chain: Chain, path: Path) -> dict[str, float]:
    """Condition number of a motion for each choice of base columns, in SI units."""
    H = regressor(chain, path.q, path.v, path.a).reshape(-1, 10 * chain.size)
    chosen = rigid_columns(chain, H).items()
    return {name: float(np.linalg.cond(H[:, columns])) for name, columns in chosen}
