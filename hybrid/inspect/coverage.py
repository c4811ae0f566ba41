"""What a log can tell: how each joint moves, and which parameters are identifiable.

Torque is linear in base parameters, rotor inertia and friction, with columns ``W``.
With the residual variance of each joint in ``Σ``, times the number of successive
samples that tell the same, the covariance of the parameters is ``C = (Wᵀ Σ⁻¹ W)⁻¹``. A
parameter is identifiable if it differs from zero by 1.96 standard errors.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import effect_gains, stacked_base, stacked_columns
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.inspect.doubt import Doubt
from hybrid.inspect.masses import CREEP
from hybrid.inspect.samples import encoder_step
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot.chain import Chain
from hybrid.signals import Motion
from hybrid.signals.autocorrelation import autocorrelation_time
from hybrid.statistics import HALF_WIDTH

_RANK = 1e-9  # of the largest column or singular value: what is below is rounding
_BLIND = 0.01  # share of a parameter in directions without torque
_LONGEST_LAG = 0.5  # s, of a servo behind its command
_EARLY = 0.02  # s, by which a position clearly precedes its command


@dataclass(frozen=True)
class JointCoverage:
    """Motion and torque of one joint in a log.

    Attributes:
        joint: Name.
        units: Units of its position and of its torque.
        low: Lowest position, [rad or m].
        high: Highest position, [rad or m].
        fastest: Highest speed, [rad/s or m/s].
        moving: Share of the time in which it moves.
        resolution: Step of its encoder, [rad or m]; infinite if the log tells none.
        torque: Lowest and highest torque, [N·m or N]; None without torque.
        lag: Delay of its position behind its command, [s]; below zero if it precedes
            the command, and None without one.
    """

    joint: str
    units: tuple[str, str]
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


def coverage_of(
    recording: Recording, state: State, chain: Chain | None = None
) -> tuple[JointCoverage, ...]:
    """Motion and torque of every joint in a log on a uniform clock."""
    units = [("rad", "N·m")] * recording.size
    if chain is not None:
        units = list(zip(chain.units("rad"), chain.units("N·m"), strict=True))
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
        found.append(
            JointCoverage(joint, units[j], *ends, *pace, encoder_step(q), torque, lag)
        )
    return tuple(found)


def doubts_of_lags(joints: Sequence[JointCoverage]) -> Iterator[Doubt]:
    """Find positions that precede their command."""
    lags = [0.0 if x.lag is None else x.lag for x in joints]
    early = tuple(k for k, lag in enumerate(lags) if lag < -_EARLY)
    if early:
        names = ", ".join(joints[k].joint for k in early)
        most = -min(lags)
        text = f"{names}: q precedes the command, by up to {1000 * most:.0f} ms"
        remedy = "valid is the command that the drive follows, on the clock of q"
        yield Doubt("command", early, text, remedy, evidence=most)


def excitation_of(chain: Chain, state: State) -> Excitation:
    """Fit base parameters, rotors and friction; say which of them are identifiable."""
    names, columns = _base_columns(chain, state)  # (n, M, b)
    stacked = columns.reshape(-1, columns.shape[-1])
    theta, noise = _fit(columns, state.tau.T)
    whitened = stacked / np.repeat(noise, len(state.q))[:, None]
    length = np.maximum(np.linalg.norm(whitened, axis=0), 1e-300)
    resting = length < _RANK * length.max()
    singular, ways = np.linalg.svd(whitened / length, full_matrices=False)[1:]
    blind = singular < _RANK * singular[0]
    error = np.linalg.norm(ways.T / np.where(blind, np.inf, singular), axis=1) / length
    # Of parameters that act alike, the log has a combination only.
    alike = np.sum(ways[blind] ** 2, axis=0) > _BLIND
    unknown = resting | alike | (np.abs(theta) < HALF_WIDTH * error)
    condition = np.inf if (resting | blind).any() else float(singular[0] / singular[-1])
    untold = tuple(name for name, x in zip(names, unknown, strict=True) if x)
    return Excitation(condition, names, untold)


def _fit(columns: Array, tau: Array) -> tuple[Array, Array]:
    """Parameters, and the standard deviation of each joint's residual, (b,) and (n,).

    It is that of one sample, as if all were independent: larger than the residual's
    by the samples that tell the same, and by those that the parameters use up.
    """
    n, samples, size = columns.shape
    stacked, row = columns.reshape(n * samples, size), np.arange(samples)
    noise = np.ones(n)
    for _ in range(2):  # ordinary, then weighted least squares
        each = np.repeat(noise, samples)
        theta = np.linalg.lstsq(stacked / each[:, None], tau.ravel() / each)[0]
        residual = tau - columns @ theta
        power = np.sqrt((tau**2).mean(axis=1))
        rms = np.sqrt((residual**2).mean(axis=1))
        noise = np.maximum(rms, 1e-6 * power + 1e-12)
    memory = np.array([autocorrelation_time(x, row) for x in residual])
    left = 1 - size / np.sum(samples / memory)  # share of the independent samples
    one = noise * np.sqrt(memory / max(left, 1e-300))
    return np.asarray(theta, dtype=np.float64), np.asarray(one)


def _base_columns(chain: Chain, state: State) -> tuple[tuple[str, ...], Array]:
    """Names of the base parameters, and their columns at each joint, (n, M, b)."""
    laws = Armature, Viscous, Coulomb, TorqueOffset
    effects = [law((j,)) for j in range(chain.size) for law in laws]
    gains = effect_gains(effects)
    base, t = stacked_base(chain, effects, gains), np.arange(float(len(state.q)))
    motion = Motion(
        t, state.q, state.v, state.a, state.tau, np.ones(len(t), dtype=bool)
    )
    columns = stacked_columns(chain, effects, gains, motion)
    return base.kept_labels, columns[:, :, list(base.kept)].swapaxes(0, 1)


def _lag(command: Array, q: Array, most: int) -> int:
    """The lag within ``most`` samples that minimises Var(q_k − command_{k−lag})."""
    from scipy.signal import correlate

    samples = len(q)
    most = max(1, min(most, samples // 2))
    lags = np.array(sorted(range(1 - most, most), key=abs))
    late, early = np.maximum(lags, 0), np.maximum(-lags, 0)

    def overlap(x: Array, first: Array, behind: Array) -> Array:
        sums = np.append(0.0, np.cumsum(x))
        return np.asarray(sums[samples - behind] - sums[first])

    q, command, count = q - q.mean(), command - command.mean(), samples - np.abs(lags)
    mean = (overlap(q, late, early) - overlap(command, early, late)) / count
    squares = overlap(q**2, late, early) + overlap(command**2, early, late)
    squares -= 2 * correlate(q, command, method="fft")[samples - 1 + lags]
    return int(lags[np.argmin(squares / count - mean**2)])
