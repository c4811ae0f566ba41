"""The verb: what a simulator lacks, from logs of the real arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.diagnose.attribute import Search
from hybrid.diagnose.diagnosis import Diagnosis, Finding, Verdict
from hybrid.diagnose.explanation import Explanation, explain, refit, shares, split
from hybrid.diagnose.findings import alternatives, findings, fitted_effects
from hybrid.diagnose.gap import Gap, measure_gap
from hybrid.diagnose.thresholds import Thresholds, thresholds
from hybrid.diagnose.verify import Account, account, check
from hybrid.effects import Effect
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Result:
    """A diagnosis with what it was made from, for report and export.

    Attributes:
        diagnosis: The answer.
        gap: The gap.
        search: The search, with the terms that may be named.
        scored: The same terms on samples that no step has seen.
        account: What is explained and missed, joint by joint.
        effects: The effects named, with fitted values.
    """

    diagnosis: Diagnosis
    gap: Gap
    search: Search
    scored: Explanation
    account: Account
    effects: tuple[Effect, ...]


def diagnose(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Say where a sim-to-real gap lies, what causes it, and how far it shrinks.

    Args:
        robot: The simulator as it stands today.
        recordings: Logs of the real arm: time, position and torque.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.
        without: Ids of effects to leave out of the library.
        seed: Seed of the bootstrap.
        progress: Called with what is being done.

    Raises:
        IdentificationError: There is no recording.
        RecordingError: A recording does not fit the arm.
    """
    return examine(
        robot,
        recordings,
        cutoff=cutoff,
        without=without,
        seed=seed,
        progress=progress,
    ).diagnosis


def examine(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    cutoff: float | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Result:
    """:func:`diagnose` with everything that led to the answer."""
    tell = progress or (lambda _: None)
    rng = np.random.default_rng(seed)
    limits = thresholds()
    tell("measuring the gap")
    gap = measure_gap(robot, recordings, cutoff=cutoff)
    learn = split(gap)
    tell("trying every effect at every joint")
    search = Search(gap, learn, without=without)
    search.run()
    tell("asking what is left")
    found = account(gap, search, limits)
    named = [t for t in search.terms if check(search, t, found).passes(limits)]
    kinds = [alternatives(search, t, limits) for t in named]
    if len(named) < len(search.terms):
        search.terms = named
        found = account(gap, search, limits)
    tell("scoring on motions that no step has seen")
    scored = explain(gap, search, learn)
    solution, own = refit(gap, search)
    effects = fitted_effects(named, solution, own)
    causes = findings(scored, effects, kinds, shares(scored, search, rng), rng)
    verdict, unexplained = _verdict(found, causes, limits)
    diagnosis = _diagnosis(gap, search, found, causes, verdict, unexplained)
    return Result(diagnosis, gap, search, scored, found, effects)


def _verdict(
    found: Account, effects: Sequence[Finding], limits: Thresholds
) -> tuple[Verdict, float]:
    """What it comes to, and the unexplained share of the explainable gap."""
    explained, missed = found.explained.sum(), found.missed.sum()
    share = float(missed / (explained + missed)) if explained + missed > 0 else 0.0
    if not effects:
        return ("unexplained", 1.0) if missed > 0 else ("no_gap", 0.0)
    if 1.0 - share >= limits.explained:
        return "explained", share
    return "partly_explained", share


def _diagnosis(
    gap: Gap,
    search: Search,
    found: Account,
    effects: Sequence[Finding],
    verdict: Verdict,
    unexplained: float,
) -> Diagnosis:
    rows, n = search.evidence.rows, gap.robot.size
    count = np.array([max(len(r), 1) for r in rows])
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    moving = np.maximum(gap.moving.sum(axis=0), 1)
    rms = np.sqrt(squares.sum(axis=0) / moving)
    measured = gap.sampled.tau + gap.left
    size = np.sqrt((np.where(gap.moving, measured, 0.0) ** 2).sum(axis=0) / moving)
    floor = np.sqrt(np.maximum(found.noise, 0.0) * search.evidence.noise / count)
    return Diagnosis(
        robot=gap.robot.name,
        joints=gap.robot.joints,
        rms=tuple(map(float, rms)),
        relative=tuple(float(a / b) if b > 0 else 0.0 for a, b in zip(rms, size)),
        noise_floor=tuple(map(float, floor)),
        where=(),
        findings=tuple(effects),
        verdict=verdict,
        unexplained=unexplained,
        background=search.off,
        not_excited=tuple(
            gap.robot.joints[i] for i in range(n) if len(rows[i]) < 50
        ),
    )
