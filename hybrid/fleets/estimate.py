"""Deviations of an arm's parameters from its baseline in one period.

``τ − τ_baseline = Y·δ + C·g + noise``: Y are the columns of the base inertial
parameters, with δ ~ N(0, covariance of the baseline). C are the columns of the tracked
effects, whose gains g have their usual size as standard deviation. The posterior of g
is a regularised least squares. Residuals are correlated in time: the number of samples
that count as one independent sample is their autocorrelation time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.linalg import block_diag

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.payload import Payload
from hybrid.effects.registry import effect_class
from hybrid.errors import HybridError
from hybrid.identification.preparation import checked_logs, prepare
from hybrid.model.dynamic_model import DynamicModel
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.regression.data import Data
from hybrid.robot.spatial import inertial_about
from hybrid.signals import Motion, autocorrelation_time
from hybrid.signals.bandwidth import band_of

_FROM_TOOL = 0.05  # m, distance of a payload's centre from the tool, and its size
_DRAWS = 400  # of the payload's centre
_RELATIVE_STD = 0.05  # of inertial parameters, if the baseline has no covariance
# Effects whose gains are estimated, with the names of the gains that are tracked.
Followed = Sequence[tuple[Effect, tuple[str, ...]]]
_PASSES = 3  # reweightings by the residuals


@dataclass(frozen=True)
class Deviation:
    """One parameter of one joint in one period.

    Attributes:
        joint: Name of the joint; ``arm`` for a parameter of the whole arm, whose
            residual, load and temperature are means over the joints.
        parameter: Effect and gain, as ``coulomb.level``.
        unit: SI unit.
        change: Deviation from the baseline.
        std: Standard deviation of the change, within the period.
        baseline: Value in the baseline; 0 if it has none.
        baseline_std: Standard deviation of the value in the baseline.
        residual: RMS residual over that of the baseline.
        load: RMS torque of the rigid body, [N·m].
        temperature: Mean drive temperature, [°C]; NaN if not logged.
    """

    joint: str
    parameter: str
    unit: str
    change: float
    std: float
    baseline: float
    baseline_std: float
    residual: float
    load: float
    temperature: float


def followed(track: Sequence[str], size: int) -> Followed:
    """Effects, or gains as ``effect.gain``, at each of n joints; see :data:`Followed`.

    Raises:
        HybridError: A name is unknown, or the effect has no gain of that name.
    """
    found = []
    for name in track:
        kind, _, gain = name.partition(".")
        cls = effect_class(kind)
        names = tuple(g.name for g in cls.gains)
        if gain and gain not in names:
            raise HybridError(
                f"track: {kind} has no gain {gain!r}; valid are {', '.join(names)}"
            )
        if cls.scope == "coupling":
            raise HybridError(f"track: {kind} is of pairs of joints; not followed")
        arm = cls.scope == "arm"
        places = [tuple(range(size))] if arm else [(j,) for j in range(size)]
        found += [(cls(place), (gain,) if gain else names) for place in places]
    return found


def with_payload(model: DynamicModel, payload: Sequence[float]) -> DynamicModel:
    """The baseline of an arm with a known payload.

    Its up to ten parameters are mass [kg], first moments [kg·m] and inertia [kg·m²]
    about the last joint's frame.
    """
    values = dict(zip((g.name for g in Payload.gains), payload, strict=False))
    held = Payload(tuple(range(model.robot.size)), values)
    return replace(model, effects=(*model.effects, held)) if values else model


def deviations(
    model: DynamicModel,
    recordings: Sequence[Recording],
    track: Sequence[str],
    tool: Sequence[float] = (),
) -> list[Deviation]:
    """Deviations of an arm from its baseline, from the logs of one period.

    Effects or gains are tracked, see :func:`followed`. A payload has the position of
    the tool in the last joint's frame, [m], or of the last link's centre of mass.

    Raises:
        HybridError: A log contradicts physics, or is too short.
    """
    robot, effects = model.robot, followed(track, model.robot.size)
    logs = checked_logs(robot, recordings)
    data = prepare(logs, model.cutoff if np.isfinite(model.cutoff) else None)
    expected = [model.predict(m) for m in data.motions]
    data = replace(data, band=band_of(data.motions, expected, data.cutoff))
    rigid = [k for k, c in enumerate(model.base.kept) if c < 10 * robot.size]
    pairs = zip(data.motions, expected, strict=True)
    parts = [_filtered_rows(model, rigid, effects, data, *x) for x in pairs]
    theta, covariance, residual = _posterior(parts, _prior(model, rigid, effects, tool))
    warm = [m.temperature for m in data.motions if m.temperature is not None]
    load = np.concatenate([model.body(m).load for m in data.motions])
    measured = (
        residual,
        np.sqrt((load**2).mean(axis=0)),
        np.concatenate(warm).mean(axis=0) if warm else np.full(robot.size, np.nan),
    )
    estimates = zip(theta, np.sqrt(np.diag(covariance)), strict=True)
    return list(_rows(model, effects, islice(estimates, len(rigid), None), measured))


def _rows(
    model: DynamicModel,
    effects: Followed,
    estimates: Iterator[tuple[float, float]],
    measured: Sequence[Array],
) -> Iterator[Deviation]:
    for effect, names in effects:
        place = effect.id, effect.joints
        own = next((e for e in model.effects if (e.id, e.joints) == place), None)
        values, std = (own.values, own.std) if own else ({}, {})
        where = model.robot.joints[effect.joints[0]]
        means = [float(x[list(effect.joints)].mean()) for x in measured]
        for gain, estimate in zip(effect.gains, estimates, strict=False):
            if gain.name in names:
                yield Deviation(
                    "arm" if effect.scope == "arm" else where,
                    f"{effect.id}.{gain.name}",
                    model.robot.chain.unit_at(effect.unit_joints, gain.unit),
                    *map(float, estimate),
                    *(float(x.get(gain.name, 0.0)) for x in (values, std)),
                    *means,
                )


def _prior(
    model: DynamicModel,
    rigid: Sequence[int],
    effects: Followed,
    tool: Sequence[float],
) -> Array:
    """Covariance of δ and g, shape (p, p)."""
    scales, values = joint_scales(model.robot), model.base.values[list(rigid)]
    blocks = [np.diag((_RELATIVE_STD * values) ** 2)]
    if model.covariance.size:
        blocks = [model.covariance[np.ix_(rigid, rigid)]]
    for effect, _ in effects:
        if isinstance(effect, Payload):
            blocks.append(_payload_covariance(model, effect.gains[0].typical, tool))
            continue
        sized = [g.scaled(scales[effect.joints[-1]]) for g in effect.gains]
        std = [g.spread or abs(g.typical) or abs(g.upper) for g in sized]
        blocks.append(np.diag(np.square(std)))
    return np.asarray(block_diag(*blocks))


def _payload_covariance(
    model: DynamicModel, mass: float, tool: Sequence[float]
) -> Array:
    """Covariance (10, 10) of the parameters of a body of some mass near the tool."""
    link = model.robot.chain.inertial[-1]
    center = np.array(tool) if len(tool) else link[1:4] / max(link[0], 1e-9)
    draws = np.random.default_rng(0).standard_normal((_DRAWS, 3))
    own = mass * _FROM_TOOL**2 * np.eye(3)
    each = np.array([inertial_about(mass, center + _FROM_TOOL * x, own) for x in draws])
    return np.asarray(each.T @ each / _DRAWS)


def _filtered_rows(
    model: DynamicModel,
    rigid: Sequence[int],
    effects: Followed,
    data: Data,
    motion: Motion,
    expected: Array,
) -> Array:
    """Filtered columns, then the residual, shape (M, n, p + 1); NaN at rest."""
    n, body = model.robot.size, model.body(motion)
    kept = [model.base.kept[k] for k in rigid]
    columns = [body.columns[:, :, kept]]
    for effect, _ in effects:
        wide = np.zeros((len(motion.t), n, len(effect.gains)))
        joints = list(effect.reaches(n))
        if effect.reports and effect.actuator:  # a gain of the whole torque
            wide[:, joints] = expected[:, joints, None]
        else:
            wide[:, joints] = effect.columns(motion, body)
        columns.append(wide)
    whole = np.concatenate([*columns, expected[:, :, None]], axis=2)
    sampler = data.sampler(motion.rate)
    out = sampler(whole.reshape(len(motion.t), -1)).reshape(-1, n, whole.shape[2])
    out[:, :, -1] = data.logged(motion) - out[:, :, -1]
    out[~data.moves(motion)[:: sampler.factor]] = np.nan
    return np.asarray(out)


def _posterior(parts: Sequence[Array], prior: Array) -> tuple[Array, Array, Array]:
    """Mean (p,), covariance (p, p), and RMS residual over that of the baseline (n,)."""
    p, n = len(prior), parts[0].shape[1]
    scale = np.sqrt(np.diag(prior))
    scale = np.where(scale > 0, scale, 1e-12)
    precision = np.linalg.pinv(prior / scale / scale[:, None], hermitian=True)
    A, b = np.zeros((n, p, p)), np.zeros((n, p))
    before, counts = np.zeros(n), np.zeros(n)
    for j in range(n):
        rows = np.concatenate([x[:, j] for x in parts])
        rows = rows[np.isfinite(rows[:, 0])]
        X, y = rows[:, :p] * scale, rows[:, p]
        A[j], b[j] = X.T @ X, X.T @ y
        before[j], counts[j] = y @ y, len(y)
    weight = counts / np.maximum(before, 1e-300)
    for _ in range(_PASSES):
        H = precision + np.tensordot(weight, A, axes=1)
        theta = np.linalg.solve(H, weight @ b)
        left = [x[:, :, p] - x[:, :, :p] @ (scale * theta) for x in parts]
        power, weight = _noise_weights(np.concatenate(left))
    H = precision + np.tensordot(weight, A, axes=1)
    theta = np.linalg.solve(H, weight @ b)
    covariance = np.asarray(np.linalg.inv(H), dtype=np.float64)
    rms: Array = np.sqrt(power * counts / np.maximum(before, 1e-300))
    return np.asarray(scale * theta), covariance * scale * scale[:, None], rms


def _noise_weights(left: Array) -> tuple[Array, Array]:
    """Mean square of a residual, and the weight of its samples, shape (n,) each."""
    power, weight = np.ones(left.shape[1]), np.zeros(left.shape[1])
    for j, own in enumerate(left.T):
        moves = np.flatnonzero(np.isfinite(own))
        if len(moves):
            power[j] = np.mean(own[moves] ** 2)
            lasts = autocorrelation_time(own[moves], moves)
            weight[j] = 1.0 / max(power[j] * lasts, 1e-300)
    return power, weight
