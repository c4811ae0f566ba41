"""How far a gap shrinks in motion: the simulator replayed from measured states.

Unstable postures let any model depart sooner or later, so that windows are short, the
same on both sides, and compared by their medians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Shrink
from hybrid.diagnosis.answer.replay import Replay
from hybrid.diagnosis.gap.units import units
from hybrid.effects import Effect

_RESAMPLES = 400
_BYPRODUCT = 0.05  # of the largest fall in torque; joints below are merely touched
_STEP_MATTERS = 0.1  # of the motion error before


def motion_shrink(
    replay: Replay,
    members: Sequence[int],
    rng: np.random.Generator,
    *,
    horizon: float | None = None,
    late: Sequence[Effect] = (),
) -> Shrink | None:
    """Motion error with everything but some terms, and with them, where they act.

    Args:
        replay: Windows of the motions kept for scoring.
        members: Indices of the terms; all of them for what they do together.
        rng: Draws of the bootstrap.
        horizon: One of ``HORIZONS``, [s]; that of the replay by default.
        late: By how much the log's torque was late before all else: no terms.

    Returns:
        Median of the RMS over joints and time, [rad], before and after, over the
        windows in which the terms act; nothing if too few windows are that long.

    Raises:
        EffectError: An effect cannot be simulated.
    """
    horizon = horizon or replay.horizon
    if horizon is None or not replay.has(horizon):
        return None
    joints, pick = _main_joints(replay, members), replay.where(members, horizon)
    without = replay.squares(replay.all_terms - set(members))
    if late:
        joints, pick = [j for e in late for j in e.joints], replay.fit(horizon)
        again = [e.at({"time": -e.values["time"]}) for e in late]
        without = replay.squares_of([*replay.effects, *again])
    before, after = (
        replay.error(squares, joints, horizon)[pick]
        for squares in (without, replay.squares(replay.all_terms))
    )
    blocks = replay.blocks(pick, horizon)
    draws = [_removed(before[drawn], after[drawn]) for drawn in _resampled(blocks, rng)]
    low, high = np.quantile(draws, [0.025, 0.975]) if blocks.max() else (0.0, 1.0)
    return Shrink(
        float(np.median(before)),
        float(np.median(after)),
        _removed(before, after),
        (float(low), float(high)),
        horizon,
        units(replay.scored.gap.robot, joints)[0],
    )


def rollout_agrees(
    replay: Replay,
    term: int,
    rng: np.random.Generator,
    *,
    instead: Sequence[Effect] | None = None,
) -> bool | None:
    """Whether a term lowers the motion error, as it does lower the torque's.

    Args:
        replay: Windows of the motions kept for scoring.
        term: Index of the term.
        rng: Draws of the bootstrap.
        instead: What to compare the term with; by default the simulator without it.
            With rivals, ``True`` means that the term replays better than they do.

    Returns:
        True or False where 95 % of the resampled windows say so at the longest horizon
        that is not longer than half a second; nothing where they do not.
    """
    if (horizon := replay.horizon) is None:
        return None
    rest = replay.all_terms - {term}
    without = replay.squares(rest)
    if instead is not None:
        others = [replay.effects[k] for k in sorted(rest)]
        without = replay.squares_of([*others, *instead])
    joints, pick = _main_joints(replay, [term]), replay.where([term], horizon)
    before, after = (
        np.maximum(replay.error(squares, joints, horizon)[pick], 1e-12)
        for squares in (without, replay.squares(replay.all_terms))
    )
    fall, blocks = np.log(before / after), replay.blocks(pick, horizon)
    if blocks.max() == 0:
        return None
    draws = [np.mean(fall[drawn]) for drawn in _resampled(blocks, rng)]
    low, high = np.quantile(draws, [0.025, 0.975])
    return True if low > 0 else False if high < 0 else None


def step_warning(replay: Replay) -> str | None:
    """A warning if the replay at half the step says something else."""
    if (horizon := replay.horizon) is None:
        return None
    joints, fits = range(replay.scored.gap.robot.size), replay.fit(horizon)

    def error(terms: Iterable[int], step: float) -> float:
        squares = replay.squares(terms, step=step)
        return float(np.median(replay.error(squares, joints, horizon)[fits]))

    step = replay.step
    before = error((), step)
    changes = [
        abs(error(terms, step / 2) - error(terms, step))
        for terms in {frozenset[int](), replay.all_terms}
    ]
    if max(changes) <= _STEP_MATTERS * before:
        return None
    return (
        f"replayed at half the step of {1e3 * step:g} ms, the motion error differs by "
        f"{max(changes) / before:.0%}; take its shrinkage as a rough figure"
    )


def _main_joints(replay: Replay, members: Sequence[int]) -> list[int]:
    """Joints whose torque the terms are about; others they merely touch."""
    noise = replay.scored.evidence.noise
    parts = [replay.scored.contribution(k) for k in members]
    fall = np.array(
        [sum(p[i] @ p[i] for p in parts) / noise[i] for i in range(len(noise))]
    )
    return np.flatnonzero(fall >= _BYPRODUCT * fall.max(initial=0.0)).tolist()


def _removed(before: Array, after: Array) -> float:
    whole = np.median(before)
    return float(1.0 - np.median(after) / whole) if whole > 0 else 0.0


def _resampled(
    blocks: NDArray[np.intp], rng: np.random.Generator
) -> Iterator[NDArray[np.intp]]:
    """Indices of windows, drawn block by block."""
    members = [np.flatnonzero(blocks == b) for b in range(blocks.max() + 1)]
    for _ in range(_RESAMPLES):
        drawn = rng.integers(len(members), size=len(members))
        yield np.concatenate([members[b] for b in drawn])
