"""What a log can tell: how each joint moves, and which parameters are identifiable.

Torque is linear in base parameters, rotor inertia and friction, with columns ``W``.
With the residual variance of each joint in ``Σ``, the covariance of the parameters is
``C = (Wᵀ Σ⁻¹ W)⁻¹``. A parameter is identifiable if it differs from zero by 1.96
standard errors.
"""

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.base import base_parameters, inertial_labels
from hybrid.dynamics.regressor import regressor
from hybrid.dynamics.stacked import rich_motion
from hybrid.inspect.masses import CREEP, smooth_sign
from hybrid.inspect.samples import resolution
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot.chain import Chain

_NORMAL = 1.96  # standard errors on either side of a 95 % interval
_LONGEST_LAG = 0.5  # s, of a servo behind its command
_MOST_ROWS = 100_000  # of a log that are compared at each lag
_DRIVES = ("Ia", "Fv", "Fc", "offset")


@dataclass(frozen=True)
class JointCoverage:
    """Motion and torque of one joint in a log.

    Attributes:
        joint: Name.
        low: Lowest position, [rad or m].
        high: Highest position, [rad or m].
        fastest: Highest speed, [rad/s or m/s].
        moving: Share of the time in which it moves.
        resolution: Smallest step of its position, [rad or m]; infinite if it rests.
        torque: Lowest and highest torque, [N·m or N]; None without torque.
        lag: Delay of its position behind its command, [s]; None without a command.
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
    """How well a log determines inertia, rotors and friction of an arm.

    Attributes:
        condition: Condition number of the whitened base columns, scaled to unit length.
        names: All base parameters, those of the drives included.
        untold: Parameters that do not differ from zero by 1.96 standard errors.
    """

    condition: float
    names: tuple[str, ...]
    untold: tuple[str, ...]


def coverage_of(recording: Recording, state: State) -> tuple[JointCoverage, ...]:
    """Motion and torque of every joint in a log on a uniform clock."""
    speed = np.abs(state.v) * (np.ptp(recording.q, axis=0) > 0)
    fastest = speed.max(axis=0).tolist()
    moving = np.mean(speed > CREEP * np.maximum(fastest, 1e-300), axis=0).tolist()
    most = round(_LONGEST_LAG * recording.rate)
    found = []
    for j, joint in enumerate(recording.joints):
        q, lag, torque = recording.q[:, j], None, None
        if recording.has_torque:
            torque = float(recording.tau[:, j].min()), float(recording.tau[:, j].max())
        if recording.command is not None and np.ptp(recording.command[:, j]) > 0:
            lag = _lag(recording.command[:, j], q, most) / recording.rate
        ends, pace = (float(q.min()), float(q.max())), (fastest[j], moving[j])
        found.append(JointCoverage(joint, *ends, *pace, resolution(q), torque, lag))
    return tuple(found)


def excitation_of(chain: Chain, state: State) -> Excitation:
    """Fit base parameters, rotors and friction; say which of them are identifiable."""
    names, columns = _base_columns(chain, state)  # (n, M, b)
    n, samples = chain.size, len(state.q)
    stacked, tau = columns.reshape(n * samples, -1), state.tau.T.reshape(-1)
    rows = np.repeat(np.arange(n), samples)
    noise = np.ones(n)  # standard deviation at each joint
    for _ in range(2):  # ordinary, then weighted least squares
        whitened = stacked / noise[rows, None]
        theta = np.linalg.lstsq(whitened, tau / noise[rows], rcond=None)[0]
        residual = (tau - stacked @ theta).reshape(n, samples)
        size = np.sqrt((state.tau**2).mean(axis=0))
        noise = np.maximum(np.sqrt((residual**2).mean(axis=1)), 1e-6 * size + 1e-12)
    whitened = stacked / noise[rows, None]
    length = np.maximum(np.linalg.norm(whitened, axis=0), 1e-300)
    singular = np.linalg.svd(whitened / length, compute_uv=False)
    inverse = np.linalg.pinv(whitened / length, rcond=1e-12)
    error = np.linalg.norm(inverse, axis=1) / length
    excited = length > 1e-9 * length.max()
    unknown = ~excited | (np.abs(theta) < _NORMAL * error)
    condition = np.inf
    if excited.all():
        condition = float(singular[0] / max(singular[-1], 1e-300))
    untold = tuple(name for name, x in zip(names, unknown, strict=True) if x)
    return Excitation(condition, names, untold)


def _base_columns(chain: Chain, state: State) -> tuple[tuple[str, ...], Array]:
    """Names of the base parameters, and their columns at each joint, (n, M, b)."""
    n = chain.size
    drives = [f"{x}_{k + 1}" for k in range(n) for x in _DRIVES]
    labels = [*inertial_labels(n)[0], *drives]
    rich = rich_motion(chain)
    # Of dependent columns the first is kept: rotors and friction before links.
    order = [*range(10 * n, len(labels)), *range(10 * n)]
    stacked = _columns(chain, rich.q, rich.v, rich.a)[:, :, order]
    named = tuple(labels[k] for k in order)
    base = base_parameters(stacked.reshape(-1, len(order)), named, ("",) * len(order))
    kept = [order[k] for k in base.kept]
    return base.kept_labels, _columns(chain, state.q, state.v, state.a)[:, :, kept]


def _columns(chain: Chain, q: Array, v: Array, a: Array) -> Array:
    """Torque per unit of each inertial and drive parameter, shape (n, M, 14n)."""
    n, each = chain.size, np.arange(chain.size)
    drive = np.zeros((n, len(q), n, len(_DRIVES)))
    own = np.stack([a, v, smooth_sign(v), np.ones_like(v)], axis=-1)  # (M, n, 4)
    drive[each, :, each] = own.transpose(1, 0, 2)
    rigid = regressor(chain, q, v, a).transpose(1, 0, 2)
    return np.concatenate([rigid, drive.reshape(n, len(q), -1)], axis=2)


def _lag(command: Array, q: Array, most: int) -> int:
    """The lag below ``most`` samples that minimises Var(q_k − command_{k−lag})."""
    samples = len(q)
    step = 1 + samples // _MOST_ROWS
    lags = range(min(most, samples // 2))
    spread = [np.var(q[k::step] - command[: samples - k : step]) for k in lags]
    return int(np.argmin(spread))
