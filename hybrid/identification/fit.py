"""The result of an identification: model, uncertainty and undetermined parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid.arrays import Array
from hybrid.model.dynamic_model import DynamicModel
from hybrid.regression.intervals import Estimate, condition_number, weak_directions
from hybrid.regression.problem import Problem
from hybrid.shown import Shown

# Gautier and Khalil 1992, doi 10.1177/027836499201100408: motions that identify well
# have condition numbers below about a hundred.
GOOD_CONDITION = 100.0
_MOST_NAMED = 6  # unknowns in one sentence
_WEAK = 0.1  # share of an unknown in weak directions from which it is named


@dataclass(frozen=True, repr=False)
class Fit(Shown):
    """An identified model with its uncertainty.

    Attributes:
        model: The identified model.
        names: Full names of the unknowns of the linear part, length p.
        labels: Their short names, length p.
        units: Their units, length p.
        estimate: Values, covariance and residual covariance of the linear part. If
            the links were made physically consistent, only the values changed.
        held_out: RMS residual of each joint on held-out samples, by stage, shape (n,)
            each, [N·m]; NaN at a joint that stands all the time.
        condition: Condition number of the whitened, column-scaled columns of rigid
            body and linear friction: the quality of the excitation.
        converged: False if any iteration reached its limit.
        unidentifiable: Parameters that no motion, or not these recordings, determine,
            in words.
        left_out: Stages that did not lower the error, in words.
        warnings: All warnings, in words.
        rounds: Number of passes through the three stages.
    """

    model: DynamicModel
    names: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    estimate: Estimate
    held_out: Mapping[str, Array]
    condition: float
    converged: bool
    unidentifiable: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    rounds: int = 1

    def save(self, path: str | Path) -> None:
        """Write the model to a JSON file; :meth:`DynamicModel.load` reads it.

        Raises:
            ModelFileError: The path does not end in ``.json``.
        """
        self.model.save(path)

    @property
    def covariance(self) -> Array:
        """Covariance of the unknowns, shape (p, p)."""
        return self.estimate.covariance

    @property
    def sigma(self) -> Array:
        """Residual covariance across joints, shape (n, n), [N²·m²]."""
        return self.estimate.sigma


def unidentifiable(problem: Problem, estimate: Estimate) -> tuple[str, ...]:
    """Parameters that no motion identifies, then those that these logs do not."""
    base, rigid = problem.base, 10 * problem.chain.size
    found = []
    for label, joined in base.dropped.items():
        if base.labels.index(label) >= rigid:
            found.append(
                f"{label} cannot be told from {joined}: only their combination is known"
                if joined
                else f"{label} changes no torque"
            )
    labels = base.kept_labels
    found += [
        f"{labels[k]} is not determined by these recordings"
        for k in estimate.undetermined
    ]
    held = set(estimate.held) - set(estimate.undetermined)
    found += [
        f"{labels[k]} is held by the robot file: these recordings say less of it"
        for k in sorted(held)
    ]
    low, high = estimate.interval()
    unclear = (low < 0) & (high > 0)
    unclear[[*estimate.undetermined, *held]] = False
    found += [
        f"{labels[k]} cannot be told from zero" for k in problem.rigid if unclear[k]
    ]
    return tuple(found)


def poor_excitation(problem: Problem, A: Array) -> str | None:
    """A sentence that names parameters which the motion hardly excites, or None."""
    condition = condition_number(A)
    if condition <= GOOD_CONDITION:
        return None
    weak = (weak_directions(A, 1 / GOOD_CONDITION) ** 2).sum(axis=1)
    worst = [int(k) for k in np.argsort(-weak)[:_MOST_NAMED] if weak[k] > _WEAK]
    labels, joints = problem.base.kept_labels, problem.chain.joints
    of_gain = {u: problem.effects[e].joints[-1] for u, e, _ in problem.gains}
    moved = {of_gain.get(k, problem.base.kept[k] // 10) for k in worst}
    return (
        f"the motion excites the arm poorly (condition number "
        f"{condition:.3g}, good is below {GOOD_CONDITION:g}): "
        f"{', '.join(labels[k] for k in worst)} are hardly determined; move "
        f"{', '.join(joints[j] for j in sorted(moved))} farther, or faster"
    )
