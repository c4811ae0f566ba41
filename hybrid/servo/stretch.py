"""Continuous stretches of logs, the input of replays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RecordingError
from hybrid.recording import Recording, resample, unbroken

_SHORTEST = 2.0  # s: a servo settles in less
_CAUGHT_UP = 10.0  # s: a goal of limited speed has caught up with its command in less


@dataclass(frozen=True, eq=False)
class Stretch:
    """Command and position of N samples on a uniform clock.

    Attributes:
        step: Time between samples, [s].
        sent: Commanded position at B samples before the first and at all samples, shape
            (B + N, n), [rad]. A delay or a limited goal speed makes the first samples
            depend on earlier commands.
        q: Measured position, shape (N, n), [rad].
        v: Speed at the first sample, shape (n,), [rad/s].
        source: The log.
    """

    step: float
    sent: Array
    q: Array
    v: Array
    source: str = ""

    @property
    def command(self) -> Array:
        """Commanded position at the samples, shape (N, n), [rad]."""
        return self.sent[-len(self.q) :]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, [s]."""
        return self.step * (len(self.q) - 1)

    def cut(self, first: int, samples: int) -> Stretch:
        """A part of it: ``samples`` samples from index ``first`` on."""
        v = self.v
        if first:
            near = slice(max(first - 2, 0), first + 3)
            v = np.gradient(self.q[near], self.step, axis=0).mean(axis=0)
        q = self.q[first : first + samples]
        start = len(self.sent) - len(self.q) + first
        earliest = max(start - round(_CAUGHT_UP / self.step), 0)
        sent = self.sent[earliest : start + len(q)]
        return replace(self, sent=sent, q=q, v=v)

    def goals(self, delay: Array, pace: Array, parts: int) -> Array:
        """Goals of the servos at every physics step, shape (parts·(N − 1), n), [rad].

        A servo holds the last command that it received. Each joint's command acts later
        by its delay, shape (n,), [s], and its goal takes at least its pace, shape (n,),
        [s/rad]. Two samples are so many parts apart. A goal is the mean over its step,
        which changes steadily with the delay.
        """
        sent, samples, step = self.sent, len(self.q), self.step / parts
        steps, earlier = (samples - 1) * parts, len(sent) - samples
        out = np.empty((steps, sent.shape[1]))
        for j, (late, slow) in enumerate(zip(delay, pace, strict=True)):
            first = -earlier * parts if slow > 0 else 0
            at = np.arange(first, steps) / parts - late / self.step + earlier
            asked = _held(sent[:, j], at, parts)
            out[:, j] = (_slowed(asked, step / slow) if slow > 0 else asked)[-steps:]
        return out


def _held(sent: Array, at: Array, parts: int) -> Array:
    """Mean of held commands, shape (B,), over one of some parts of a sample.

    The part starts at ``at``, shape (K,), in samples since the first.
    """
    k = np.floor(at).astype(int)
    share = np.minimum((k + 1 - at) * parts, 1.0)
    now, later = (sent[np.clip(i, 0, len(sent) - 1)] for i in (k, k + 1))
    return np.asarray(share * now + (1.0 - share) * later)


def _slowed(asked: Array, most: float) -> Array:
    """Goals that follow what is asked, shape (K,), by no more than ``most`` a step."""
    if np.abs(np.diff(asked)).max() <= most:
        return asked
    followed, goal = asked.tolist(), float(asked[0])
    for k, x in enumerate(followed):
        followed[k] = goal = goal + min(max(x - goal, -most), most)
    return np.array(followed)


def without_torque(recordings: Sequence[Recording]) -> bool:
    """Say whether the logs have no torque.

    Raises:
        RecordingError: Only some logs have torque, or a log has neither torque nor
            command.
    """
    lacking = [x for x in recordings if not x.has_torque]
    if lacking and len(lacking) < len(recordings):
        raise RecordingError(
            f"{lacking[0].source}: no torque, but other recordings have it; valid are "
            "logs that all have torque, or none"
        )
    for x in lacking:
        _check_command(x, "neither torque nor command", "one of them")
    return bool(lacking)


def _check_command(
    recording: Recording, lacks: str = "no command", valid: str = "commanded positions"
) -> None:
    """Refuse a log without command, with the reasons why columns are not used."""
    if recording.command is None:
        aside = recording.reading.aside if recording.reading else ()
        reasons = "; ".join(dict.fromkeys(why for _, why in aside))
        raise RecordingError(
            f"{recording.source or 'recording'}: {lacks}"
            f"{f' (set aside: {reasons})' if reasons else ''}; valid are columns of "
            f"{valid} beside positions"
        )


def stretches_of(recordings: Sequence[Recording]) -> list[Stretch]:
    """Resample logs to uniform clocks, and split them at holes.

    Raises:
        RecordingError: A log has no command, or no stretch lasts two seconds.
    """
    found = []
    for recording in recordings:
        _check_command(recording)
        for piece in map(resample, unbroken(recording)):
            assert piece.command is not None
            step = piece.duration / (len(piece.t) - 1)
            start = np.zeros(piece.size)
            whole = Stretch(step, piece.command, piece.q, start, piece.source)
            moves = np.abs(piece.q[:3] - piece.q[0]).max() > 0
            found.append(whole.cut(2, len(piece.t)) if moves else whole)
    found = [x for x in found if x.duration >= _SHORTEST]
    if not found:
        raise RecordingError(
            f"no recording lasts {_SHORTEST:g} s; valid are longer ones"
        )
    return found


def chosen(stretches: Sequence[Stretch], seconds: float, each: float) -> list[Stretch]:
    """Choose parts in which the commands move most, as many of each log as possible.

    All last ``seconds`` together, and ``each`` its own time, [s].
    """
    parts: list[tuple[int, float, Stretch]] = []
    scale = np.array([x.command.std(axis=0) for x in stretches]).max(axis=0) + 1e-9

    def rest(part: Stretch) -> float:
        work = np.abs(np.diff(part.command, axis=0)).sum(axis=0) / scale
        return -float(np.sqrt(work).sum())

    for stretch in stretches:
        samples = round(each / stretch.step)
        starts = range(0, max(1, len(stretch.q) - samples // 2), samples)
        own = sorted((stretch.cut(first, samples) for first in starts), key=rest)
        parts += [(rank, rest(part), part) for rank, part in enumerate(own)]
    parts.sort(key=lambda triple: triple[:2])
    return [part for _, _, part in parts[: max(1, round(seconds / each))]]
