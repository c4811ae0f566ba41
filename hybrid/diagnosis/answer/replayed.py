"""What a diagnosis does to motion: the simulator replayed with the effects found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hybrid.diagnosis.answer.motion import motion_shrink, rollout_agrees, step_warning
from hybrid.diagnosis.answer.replay import Replay
from hybrid.diagnosis.answer.result import Result
from hybrid.effects import effect_class
from hybrid.errors import HybridError

_LOST = 1.0  # rad; a replay that is so far off tells nothing
_ASTRAY = "replayed, the simulator leaves the motion with or without {}"
_NO_REPLAY = (
    "too few stretches of a tenth of a second, of those kept for scoring, to replay "
    "{}: its shrinkage in motion is not known"
)


def replayed(
    result: Result,
    rng: np.random.Generator,
    *,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """A result with the gap in motion: the simulator replayed from measured states.

    What lies between motor and link, or is of clocks, explains nothing if the simulator
    with it moves less like the arm.

    Args:
        result: A diagnosis in torque.
        rng: Draws of the bootstrap.
        progress: Called with what is being done.
    """
    if not result.effects:
        return result
    (progress or (lambda _: None))("replaying the simulator")
    diagnosis = result.diagnosis
    replay, found = Replay(result.scored), []
    notes: list[str] = []
    denied = 0.0
    lost: list[str] = []
    unseen: list[str] = []
    try:
        for f in diagnosis.findings:
            members = result.scored.members(f.effect)
            once = result.scored.where_seen(members) is not result.scored
            late = [e for e in result.late if e.id == f.effect]
            # A replay is driven by torque: what lies before it plays no part.
            apart = not late and (once or not members)
            shrink = None if apart else motion_shrink(replay, members, rng, late=late)
            if shrink is None:
                unseen += [] if apart else [f.effect]
            elif shrink.after >= _LOST:
                lost.append(f.effect)
            else:
                f = replace(f, shrink={**f.shrink, "motion": shrink})
            found.append(f)
            if effect_class(f.effect).shows_in_motion and any(
                rollout_agrees(replay, k, rng) is False for k in members
            ):
                denied += f.share
                notes.append(
                    f"{f.effect} explains torque, but the simulator with it does not "
                    "move more like the arm: do not take it for the cause"
                )
        halved = step_warning(replay)
    except HybridError as error:
        notes.append(f"no replay: {error}")
        found, halved = list(diagnosis.findings), None
    if lost:
        notes.append(_ASTRAY.format(", ".join(lost)))
    if unseen:
        notes.append(_NO_REPLAY.format(", ".join(unseen)))
    notes += [halved] if halved else []
    if denied and diagnosis.verdict == "explained":
        left = max(diagnosis.unexplained, min(denied, 1.0))
        diagnosis = replace(diagnosis, verdict="partly_explained", unexplained=left)
    diagnosis = replace(
        diagnosis,
        findings=tuple(found),
        warnings=(*diagnosis.warnings, *notes),
    )
    return replace(result, diagnosis=diagnosis)
