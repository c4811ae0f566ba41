"""Held-out errors of a model and of its simpler versions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array, Mask
from hybrid.errors import RecordingError, warn
from hybrid.files import write_json
from hybrid.identification.preparation import (
    checked_logs,
    log_hash,
    motions_from_logs,
    standing_speed,
)
from hybrid.model.dynamic_model import DynamicModel, check_same_arm
from hybrid.recording import Recording
from hybrid.regression.data import check_torque
from hybrid.robot import Robot
from hybrid.shown import Shown, plain
from hybrid.signals import Motion, Sampler
from hybrid.signals.bandwidth import FILTERED, torque_bandwidth

_LINEAR = ("LS", "WLS", "IRLS", "rigid")


def fair_bar(rms: Mapping[str, Array]) -> str:
    """Name of the best fit of rigid body and linear friction alone, else of the first.

    Plain least squares have an arbitrary error on unseen motion where the logs hardly
    determine a parameter; the prior of the robot file holds such parameters. Models
    have an RMS torque error by name, shape (n,) each, [N·m].
    """
    linear = [name for name in rms if name in _LINEAR]
    return min(linear or list(rms)[:1], key=lambda name: float(np.nanmean(rms[name])))


@dataclass(frozen=True)
class ValidationRow:
    """Errors of one model.

    Attributes:
        name: Name of the model.
        rms: RMS of measured less predicted torque, shape (n,), [N·m]; NaN at a joint
            that stands all the time.
        relative: RMS over the RMS of the measured torque itself, shape (n,).
    """

    name: str
    rms: Array
    relative: Array

    @property
    def mean(self) -> float:
        """Mean RMS over the joints that move, [N·m]."""
        return float(np.nanmean(self.rms))


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Shown):
    """Errors of models on recordings that none of them was fitted on.

    Attributes:
        robot: Name of the arm.
        joints: Its joints.
        units: Units of their torques: N·m, or N at a joint that slides.
        rows: Models, from the simplest to the complete one.
        noise_floor: RMS of the noise of the torque, at most the least error of all
            models, shape (n,), [N·m].
        sources: Names of the recordings.
        samples: Number of moving samples, of the joint with most.
        seconds: Duration of the recordings, [s].
    """

    robot: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[ValidationRow, ...]
    noise_floor: Array | None
    sources: tuple[str, ...]
    samples: int
    seconds: float

    @property
    def reference(self) -> ValidationRow:
        """The best fit of linear terms alone, see :func:`fair_bar`."""
        rows = {row.name: row for row in self.rows}
        return rows[fair_bar({name: row.rms for name, row in rows.items()})]

    @property
    def reduction(self) -> float:
        """Share by which the last model lowers the mean RMS of the reference."""
        return 1.0 - self.rows[-1].mean / self.reference.mean

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        rows = [vars(row) | {"mean": row.mean} for row in self.rows]
        own = vars(self) | {"rows": rows, "reduction": self.reduction}
        return dict(plain(own))

    def save(self, path: str | Path) -> None:
        """Write the errors as JSON."""
        write_json(path, self.as_dict())


@typed
def validate(
    model: DynamicModel,
    recordings: Sequence[Recording | Motion],
    *,
    robot: Robot | None = None,
    standing: Array | None = None,
) -> Validation:
    """Errors of a model and its simpler versions on recordings it has not seen.

    The error is that of the torque from :func:`predict`, at the rate of the log, as its
    logger shows it.
    Samples at which a joint stands still are left out for that joint.

    Args:
        model: Model from :func:`~hybrid.identification.identify`.
        recordings: Logs, or motions made from logs; masked samples are left out.
        robot: The user's arm; checked to be the arm of the model.
        standing: Speed below which a joint stands, shape (n,), [rad/s]; that of the
            identification by default.

    Raises:
        ModelFileError: The model is of another arm.
        RecordingError: A recording does not fit the arm.

    Warns:
        HybridWarning: The model was identified from a recording, or the torque of one
            was low-pass filtered before it was logged.
    """
    if robot is not None:
        check_same_arm(model, robot)
    logs = checked_logs(model.robot, recordings)
    motions, _ = motions_from_logs(logs, model.cutoff)
    check_torque(motions)
    warn_of_own_logs(model, logs)
    slowest = slowest_moving(model, motions) if standing is None else standing
    size = np.maximum(rms_torque(motions, slowest), 1e-300)
    rows, floors = list[ValidationRow](), list[Array]()
    filters = loggers(model, motions)
    filtered = any(x.cutoff < np.inf for x in filters)  # which leaves no noise
    for name, one in {**model.simpler, model.stage: model}.items():
        left = residuals(motions, one.predict, filters)
        error = rms_torque(left, slowest)
        rows.append(ValidationRow(name, error, error / size))
        floor = None if filtered else noise_floor(left, model.cutoff)
        floors += [] if floor is None else [floor, error]
    return Validation(
        robot=model.robot.name,
        joints=model.robot.joints,
        units=model.robot.chain.units("N·m"),
        rows=tuple(rows),
        noise_floor=np.fmin.reduce(floors) if floors else None,
        sources=tuple(m.source for m in motions),
        samples=int(_moving(motions, slowest).sum(axis=0).max()),
        seconds=float(sum(m.t[-1] - m.t[0] for m in motions)),
    )


def slowest_moving(model: DynamicModel, motions: Sequence[Motion]) -> Array:
    """Speed below which a joint stands, shape (n,), [rad/s]: that of the model."""
    identified = np.size(model.standing) > 0
    return model.standing if identified else standing_speed(motions)


def _moving(motions: Sequence[Motion], slowest: Array) -> Mask:
    """Samples that count and at which a joint moves, shape (N, n)."""
    each = [(np.abs(m.v) > slowest) & m.mask[:, None] for m in motions]
    return np.concatenate(each)


def rms_torque(motions: Sequence[Motion], slowest: Array) -> Array:
    """RMS torque of each joint while it moves, (n,), [N·m]; NaN if it never does."""
    moving = _moving(motions, slowest)
    squares = np.where(moving, np.concatenate([m.tau for m in motions]), 0.0) ** 2
    count = moving.sum(axis=0)
    mean = squares.sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(mean), np.nan)


def residuals(
    motions: Sequence[Motion],
    predict: Callable[[Motion], Array],
    filters: Sequence[Callable[[Array], Array]],
) -> list[Motion]:
    """Motions with the torque, (N, n), [N·m], that a prediction leaves as logged."""
    return [
        replace(m, tau=m.tau - seen(predict(m)))
        for m, seen in zip(motions, filters, strict=True)
    ]


def loggers(model: DynamicModel, motions: Sequence[Motion]) -> list[Sampler]:
    """What each logger shows of a torque, (N, n), [N·m]; it may have filtered it.

    Warns:
        HybridWarning: One has.
    """
    found = list[Sampler]()
    for m in motions:
        band = torque_bandwidth([(m.tau, model.predict(m))], m.rate, model.cutoff)
        found.append(Sampler(m.rate, band, 1))
        if band < np.inf:
            warn(f"{m.source or 'recording'}: {FILTERED.format(band)}")
    return found


def warn_of_own_logs(model: DynamicModel, logs: Sequence[Recording | Motion]) -> None:
    """Warn of each log that a model was identified from."""
    for source in (x.source for x in logs if log_hash(x) in model.logs):
        warn(
            f"{source}: the model was identified from this log, so this is no "
            "validation; valid are other logs"
        )


def noise_floor(motions: Sequence[Motion], cutoff: float) -> Array | None:
    """RMS of white noise in the torque that a model leaves, shape (n,), [N·m].

    It is found from the power far above the cut-off of columns and torque, [Hz], and
    None if the sampling rate is too low. Links have no power there, but the steps of
    dry friction, ripple and resonance may have.
    """
    power = []
    for motion in motions:
        edge = 3.0 * cutoff
        if edge > 0.4 * motion.rate:
            return None
        high = motion.tau - Sampler(motion.rate, edge, 1)(motion.tau)
        density = high[motion.mask].var(axis=0) / (motion.rate / 2 - edge)
        power.append(density * motion.rate / 2)
    return np.asarray(np.sqrt(np.mean(power, axis=0)))


@typed
def predict(model: DynamicModel, recording: Recording) -> Array:
    """Torque that a model predicts along a recording, shape (N, n), [N·m].

    Its rows and columns are those of the recording. Positions are filtered and
    differentiated as for the identification.

    Args:
        model: The model.
        recording: Log of the arm; it needs no torque. One with gaps is predicted
            between them, see :func:`~hybrid.inspect.check_recordings`, and rows that
            are left out there are NaN.

    Raises:
        RecordingError: The recording does not fit the arm, or has no torque although
            an effect of the model depends on it.
    """
    logs = checked_logs(model.robot, [recording])
    motions, _ = motions_from_logs(logs, model.cutoff)
    out = np.full(recording.q.shape, np.nan)
    for motion in motions:
        tau, step = model.predict(motion), 1.0 / motion.rate
        if not np.isfinite(tau).all():
            why = "no torque, but an effect of the model depends on the torque measured"
            if recording.has_torque:
                why = (
                    "the model predicts a torque that is not finite: its numbers are "
                    "none"
                )
            raise RecordingError(f"{recording.source or 'recording'}: {why}")
        first, end = np.searchsorted(
            recording.t, [motion.t[0] - step / 2, motion.t[-1] + step / 2]
        )
        rows = slice(int(first), int(end))
        at = recording.t[rows]
        if not np.array_equal(at, motion.t):  # it was resampled
            tau = np.column_stack([np.interp(at, motion.t, x) for x in tau.T])
        out[rows] = tau
    joints = model.robot.joints
    named = sorted(recording.joints) == sorted(joints)
    order = [joints.index(x) for x in recording.joints] if named else slice(None)
    return np.asarray(out[:, order])
