"""Measure the gap in motion, by simulation without and with each finding."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Finding, Shrink
from hybrid.diagnosis.answer.findings import changed_joints, interval
from hybrid.diagnosis.answer.replay import Replay
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.answer.words import effect_words, effects_listed
from hybrid.effects import Effect, effect_class
from hybrid.errors import HybridError
from hybrid.progress import Progress, silent

_DIVERGED = 1.0  # rad; a larger motion error has no meaning
_STEP_ERROR = 0.1  # of the motion error without findings
_ASTRAY = (
    "in replays the simulator leaves the motion, with {} or without: its shrinkage in "
    "motion is not known"
)
_NO_REPLAY = (
    "too few stretches of a tenth of a second, of those kept for scoring, to replay "
    "{}: its shrinkage in motion is not known"
)
_FILTERED = (
    "no replay: torque that was low-pass filtered does not move a simulator as the "
    "drives moved the arm"
)
_DENIED = (
    "{} explains torque, but the simulator with it does not move more like the arm: "
    "do not take it for the cause"
)
_HALVED = (
    "replayed at half the step of {:g} ms, the motion error differs by {:.0%}; take "
    "its shrinkage as a rough figure"
)


def with_motion_gap(
    result: Result, rng: np.random.Generator, *, progress: Progress | None = None
) -> Result:
    """Add the gap in motion to each finding."""
    # A finding that should show in motion, such as an elasticity or a delay, is doubted
    # if the simulator with it moves less like the arm.
    if not result.effects:
        return result
    if result.gap.torque_is_filtered:
        return replace(result, diagnosis=_noted(result.diagnosis, [_FILTERED]))
    (progress or silent)("replaying the simulator", 0.85)
    try:
        diagnosis = _in_motion(result, Replay(result.scored), rng)
    except HybridError as error:
        diagnosis = _noted(result.diagnosis, [f"no replay: {error}"])
    return replace(result, diagnosis=diagnosis)


def _in_motion(result: Result, replay: Replay, rng: np.random.Generator) -> Diagnosis:
    found, denied = list[Finding](), list[Finding]()
    diverged, unknown = list[str](), list[str]()
    for f in result.diagnosis.findings:
        members = result.scored.members(f.effect)
        delays = [e for e in result.delays if e.id == f.effect]
        once = result.scored.where_seen(members) is not result.scored
        # The measured torque drives the simulation: controller effects do not show.
        if delays or (members and not once):
            shrink = motion_shrink(replay, members, rng, delays=delays)
            if shrink is None:
                unknown.append(f.effect)
            elif max(shrink.before, shrink.after) >= _DIVERGED:
                diverged.append(f.effect)
            else:
                f = replace(f, shrink={**f.shrink, "motion": shrink})
        found.append(f)
        if effect_class(f.effect).shows_in_motion and any(
            rollout_agrees(replay, k, rng) is False for k in members
        ):
            denied.append(f)
    diagnosis = replace(result.diagnosis, findings=tuple(found))
    share = sum(f.share for f in denied)
    if share and diagnosis.verdict == "explained":
        left = max(diagnosis.unexplained, min(share, 1.0))
        diagnosis = replace(diagnosis, verdict="partly_explained", unexplained=left)
    notes = [_DENIED.format(effect_words(f.effect)) for f in denied]
    for words, effects in ((_ASTRAY, diverged), (_NO_REPLAY, unknown)):
        notes += [words.format(effects_listed(effects, "and"))] if effects else []
    return _noted(diagnosis, [*notes, *step_warning(replay)])


def _noted(diagnosis: Diagnosis, notes: Sequence[str]) -> Diagnosis:
    return replace(diagnosis, warnings=(*diagnosis.warnings, *notes))


def motion_shrink(
    replay: Replay,
    members: Sequence[int],
    rng: np.random.Generator,
    *,
    delays: Sequence[Effect] = (),
) -> Shrink | None:
    """Compare motion errors without and with some terms, all others present.

    In place of ``members`` there may be delays of the log's torque, which are no terms.

    Returns:
        RMS over joints and time, [rad]; median over the windows in which the terms act.
        None if there are too few windows.
    """
    if replay.horizon is None:
        return None
    joints, before, after = _errors(replay, members, delays)
    whole, left = float(np.median(before)), float(np.median(after))
    ends = interval(lambda k: _removed(before[k], after[k]), len(before), rng)
    part, chain = float(_removed(before, after)), replay.scored.gap.robot.chain
    unit = chain.unit_at(joints, "rad")
    return Shrink(whole, left, part, ends, replay.horizon, unit)


def rollout_agrees(replay: Replay, term: int, rng: np.random.Generator) -> bool | None:
    """Whether a term lowers the motion error; None if its 95 % interval holds zero."""
    if replay.horizon is None:
        return None
    _, before, after = _errors(replay, [term])
    ratio = np.log(np.maximum(before, 1e-12) / np.maximum(after, 1e-12))
    low, high = interval(lambda k: ratio[k].mean(axis=1), len(ratio), rng)
    return True if low > 0 else False if high < 0 else None


def step_warning(replay: Replay) -> list[str]:
    """A warning if half the physics step changes the motion error."""
    if replay.horizon is None:
        return []
    step, joints = replay.step, range(replay.scored.gap.robot.size)
    whole, half = (
        np.array([
            np.median(_rms(replay.squares_of(effects, step=x), joints))
            for effects in ((), replay.effects)
        ])
        for x in (step, step / 2)
    )  # fmt: skip
    change = float(np.abs(half - whole).max())
    if change <= _STEP_ERROR * whole[0]:
        return []
    return [_HALVED.format(1e3 * step, change / whole[0])]


def _errors(
    replay: Replay, members: Sequence[int], delays: Sequence[Effect] = ()
) -> tuple[list[int], Array, Array]:
    """Joints, and motion errors without and with a finding, (W',), [rad]."""
    # Of the joints that it changes and the windows in which its terms act. Delays are
    # put back into the log, and act in all windows.
    scored, windows = replay.scored, replay.windows_with(members)
    joints = [j for e in delays for j in e.joints]
    joints = joints or changed_joints(scored, scored.left(scored.without(*members)))
    without = [e for k, e in enumerate(replay.effects) if k not in members]
    without += [e.at({g.name: -e.values[g.name] for g in e.gains}) for e in delays]
    before, after = (
        _rms(replay.squares_of(x), joints)[windows] for x in (without, replay.effects)
    )
    return joints, before, after


def _rms(squares: Array, joints: Sequence[int]) -> Array:
    """RMS over joints and time in each window, shape (W,), [rad]."""
    return np.asarray(np.sqrt(squares[:, list(joints)].mean(axis=1)))


def _removed(before: Array, after: Array) -> Array:
    """Removed part of the median over windows, shape (...,)."""
    whole, left = np.median(before, axis=-1), np.median(after, axis=-1)
    return np.asarray(1.0 - left / np.maximum(whole, 1e-300)) * (whole > 0)
