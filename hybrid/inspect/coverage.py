"""What a log can tell: which joints move, how far and fast, and which masses they feel.

Torque of N samples is taken as linear in base parameters, rotors and friction. With
the residual of each joint as its noise, ``C = (Wᵀ Σ⁻¹ W)⁻¹`` is the covariance of the
parameters; one is told if it differs from zero by two standard errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.base import base_parameters, inertial_labels
from hybrid.dynamics.regressor import regressor
from hybrid.dynamics.stacked import rich_motion
from hybrid.inspect.masses import CREEP, direction
from hybrid.inspect.samples import tick
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot.chain import Chain

_SURE = 1.96  # standard errors
_LATEST = 0.5  # s: no servo follows its command later
_DRIVES = ("Ia", "Fv", "Fc", "offset")


@dataclass(frozen=True)
class JointCoverage:
    """What one joint does in a log.

    Attributes:
        joint: Name.
        low: Lowest position, [rad or m].
        high: Highest position, [rad or m].
        fastest: Highest speed, [rad/s or m/s].
        moving: Share of the time in which it moves.
        resolution: Smallest step of its position, [rad or m]; infinite without one.
        torque: Lowest and highest torque, [N·m or N]; None without torque.
        lag: Time by which its position follows its command, [s]; None without one.
    """

    joint: str
    low: float
    high: float
    fastest: float
    moving: float
    resolution: float
    torque: tuple[float, float] | None
    lag: float | None


@dataclass(frozen=True)
class Excitation:
    """How well a log determines the masses and drives of an arm.

    Attributes:
        condition: Of the base columns, each of unit length, weighed by noise.
        names: All base parameters, drives included.
        untold: Those that do not differ from zero by two standard errors.
    """

    condition: float
    names: tuple[str, ...]
    untold: tuple[str, ...]


def coverage_of(recording: Recording, state: State) -> tuple[JointCoverage, ...]:
    """What every joint does in a log on a uniform clock."""
    fastest = np.abs(state.v).max(axis=0)
    moving = np.mean(np.abs(state.v) > CREEP * np.maximum(fastest, 1e-300), axis=0)
    found = []
    for j, joint in enumerate(recording.joints):
        q, lag, torque = recording.q[:, j], None, None
        if recording.has_torque:
            torque = float(recording.tau[:, j].min()), float(recording.tau[:, j].max())
        if recording.command is not None and np.ptp(recording.command[:, j]) > 0:
            most = round(_LATEST * recording.rate)
            lag = _lag(recording.command[:, j], q, most) / recording.rate
        pace = (float(fastest[j]), float(moving[j])) if np.ptp(q) > 0 else (0.0, 0.0)
        ends = float(q.min()), float(q.max())
        found.append(JointCoverage(joint, *ends, *pace, tick(q), torque, lag))
    return tuple(found)


def excitation_of(chain: Chain, state: State) -> Excitation:
    """How well samples determine base parameters, rotors and friction."""
    names, columns = _base_columns(chain, state)  # (n, M, b)
    n, samples = chain.size, len(state.q)
    stacked, tau = columns.reshape(n * samples, -1), state.tau.T.reshape(-1)
    rows = np.repeat(np.arange(n), samples)
    noise = np.ones(n)
    for _ in range(2):  # plain, then weighed by what each joint leaves
        weighed = stacked / noise[rows, None]
        theta = np.linalg.lstsq(weighed, tau / noise[rows], rcond=None)[0]
        rest = (tau - stacked @ theta).reshape(n, samples)
        size = np.sqrt((state.tau**2).mean(axis=0))
        noise = np.maximum(np.sqrt((rest**2).mean(axis=1)), 1e-6 * size + 1e-12)
    weighed = stacked / noise[rows, None]
    length = np.maximum(np.linalg.norm(weighed, axis=0), 1e-300)
    value = np.linalg.svd(weighed / length, compute_uv=False)
    inverse = np.linalg.pinv(weighed / length, rcond=1e-12)
    error = np.linalg.norm(inverse, axis=1) / length
    seen = length > 1e-9 * length.max()
    untold = ~seen | (np.abs(theta) < _SURE * error)
    condition = float(value[0] / max(value[-1], 1e-300)) if seen.all() else np.inf
    hidden = tuple(name for name, x in zip(names, untold, strict=True) if x)
    return Excitation(condition, names, hidden)


def _base_columns(chain: Chain, state: State) -> tuple[tuple[str, ...], Array]:
    """Names of base parameters, and their columns at each joint, (n, M, b)."""
    n = chain.size
    drives = [f"{x}_{k + 1}" for k in range(n) for x in _DRIVES]
    labels = [*inertial_labels(n)[0], *drives]
    rich = rich_motion(chain)
    # Rotors and friction first: links keep what only they can explain.
    order = [*range(10 * n, len(labels)), *range(10 * n)]
    stacked = _columns(chain, rich.q, rich.v, rich.a)[:, :, order]
    named = tuple(labels[k] for k in order)
    base = base_parameters(stacked.reshape(-1, len(order)), named, ("",) * len(order))
    kept = [order[k] for k in base.kept]
    return base.kept_labels, _columns(chain, state.q, state.v, state.a)[:, :, kept]


def _columns(chain: Chain, q: Array, v: Array, a: Array) -> Array:
    """Torque per unit of every inertial and drive parameter, shape (n, M, 14n)."""
    n, each = chain.size, np.arange(chain.size)
    drive = np.zeros((n, len(q), n, len(_DRIVES)))
    own = np.stack([a, v, direction(v), np.ones_like(v)], axis=-1)  # (M, n, 4)
    drive[each, :, each] = own.transpose(1, 0, 2)
    rigid = regressor(chain, q, v, a).transpose(1, 0, 2)
    return np.concatenate([rigid, drive.reshape(n, len(q), -1)], axis=2)


def _lag(command: Array, q: Array, most: int) -> int:
    """Samples, fewer than ``most``, by which a position follows its command best.

    That is where their difference varies least: Var(q_k − c_{k−lag}).
    """
    from scipy.signal import correlate

    x, y = command - command.mean(), q - q.mean()
    lags = np.arange(min(most, len(x) // 2))
    overlap = len(x) - lags

    def sums(late: Array, early: Array) -> Array:
        """Sums over the overlap of what follows and of what is followed."""
        return np.cumsum(late[::-1])[::-1][lags] + np.cumsum(early)[overlap - 1]

    products = correlate(y, x, mode="full")[len(x) - 1 :][lags]
    spread = (sums(y * y, x * x) - 2 * products) / overlap
    return int(np.argmin(spread - (sums(y, -x) / overlap) ** 2))
