"""Design of excitation motions, with verified limits and predicted standard errors."""

import csv
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array
from hybrid.errors import ExcitationError
from hybrid.excitation.constraints import Constraint, Limits, MotionLimits, TorqueLimits
from hybrid.excitation.criteria import Condition, Criterion, DOptimal, gram_condition
from hybrid.excitation.expected_error import ExpectedError
from hybrid.excitation.families import Fourier
from hybrid.excitation.observation import (
    Observation,
    observe,
    rigid_conditions,
    usual_observation,
)
from hybrid.excitation.path import Family, Path, Trajectory, uniform
from hybrid.excitation.program import MotionProgram
from hybrid.excitation.solver import PENALTY, solve
from hybrid.files import atomic_folder, atomic_path, write_json
from hybrid.plant.reference import Reference
from hybrid.robot.robot import Robot
from hybrid.shown import Shown

DESIGN = "design.json"
# Power of the criterion and iterations: for each start, then for the best of them. A
# large power too early leads to a worse minimum.
_EXPLORE = (4.0, 80)
_POLISH = ((4.0, 80), (16.0, 100), (64.0, 200))
_MARGIN = 1e-3  # of every limit
_REPAIRS, _REPAIR_ITERATIONS = 7, 60
_ROUNDING = 1e-4  # an excess below is a rounding error


@dataclass(frozen=True, eq=False, repr=False)
class Design(Shown):
    """Motions to run one after the other, and the information they bring.

    Attributes:
        robot: The arm.
        observation: The unknowns.
        criterion: The optimality criterion.
        trajectories: The motions.
        grams: Information of each motion on the design grid, shape (b, b).
        rate: Samples of the design grid per second, [Hz].
        value: Value of the criterion for all motions.
        excess: Largest relative excess over each limit in all motions, on a grid ten
            times finer than the design grid; 0 or below.
    """

    robot: Robot
    observation: Observation
    criterion: Criterion
    trajectories: tuple[Trajectory, ...]
    grams: tuple[Array, ...]
    rate: float
    value: float
    excess: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def gram(self) -> Array:
        """Information of all motions, shape (b, b)."""
        return np.asarray(sum(self.grams))

    @property
    def condition(self) -> float:
        """Condition number of the whitened observation matrix."""
        return gram_condition(self.gram)

    @cached_property
    def rigid_conditions(self) -> dict[str, float]:
        """Condition number of the rigid body alone, not whitened, by base columns."""
        t = uniform(self.trajectories[0].family.duration, self.rate)
        whole = Path.joined([x.path(t) for x in self.trajectories])
        return rigid_conditions(self.robot.chain, whole)

    @property
    def log_det(self) -> float:
        """Natural logarithm of the determinant of the whitened information."""
        return float(np.linalg.slogdet(self.gram)[1])

    @property
    def singular_values(self) -> Array:
        """Singular values of the observation matrix, largest first, shape (b,)."""
        return np.asarray(np.sqrt(np.linalg.eigvalsh(self.gram)[::-1]))

    def standard_errors(self) -> Array:
        """Predicted standard error of every unknown, in its own unit, shape (b,).

        It is for a log with as many independent samples as the design grid has.
        """
        variance = np.linalg.inv(self.gram).diagonal()
        return np.asarray(np.sqrt(variance) * self.observation.scale)

    @property
    def additions(self) -> Array:
        """Relative reduction of the mean axis of the confidence ellipsoid, by motion.

        Shape (T,); 1 for the first motion.
        """
        b = self.observation.size
        sums = np.cumsum(self.grams, axis=0)
        volumes = np.array([np.linalg.slogdet(x)[1] for x in sums])
        return np.append(1.0, 1.0 - np.exp(-np.diff(volumes) / (2 * b)))

    def save(
        self,
        folder: str | PathLike[str],
        *,
        rate: float = 200.0,
        more: Mapping[str, Any] | None = None,
    ) -> list[pathlib.Path]:
        """Write the motions as CSV files, which are returned, and ``design.json``.

        Args:
            folder: Folder of the files.
            rate: Samples of the motions per second, [Hz].
            more: JSON-ready content to add to ``design.json``.
        """
        folder = pathlib.Path(folder)
        paths = reference_paths(folder, len(self.trajectories))
        with atomic_folder(folder) as hidden:
            for path, trajectory in zip(paths, self.trajectories, strict=True):
                reference = trajectory.reference(rate)
                write_reference(hidden / path.name, reference, self.robot.joints)
            write_json(hidden / DESIGN, self.as_dict() | dict(more or {}))
        return paths

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready results."""
        base = self.observation.base
        return {
            "robot": self.robot.name,
            "joints": list(self.robot.joints),
            "criterion": type(self.criterion).__name__,
            "value": self.value,
            "condition": self.condition,
            "rigid_conditions": dict(self.rigid_conditions),
            "log_det": self.log_det,
            "singular_values": self.singular_values.tolist(),
            "unknowns": list(base.names),
            "standard_errors": self.standard_errors().tolist(),
            "additions": self.additions.tolist(),
            "design_rate": self.rate,
            "excess": dict(self.excess),
            "trajectories": [x.as_dict() for x in self.trajectories],
        }


@typed
def design(
    robot: Robot,
    observation: Observation | None = None,
    family: Family | None = None,
    *,
    seed: int | np.random.Generator = 0,
    criterion: Criterion | None = None,
    limits: Limits | None = None,
    constraints: Sequence[Constraint] = (),
    trajectories: int = 1,
    starts: int = 4,
    rate: float = 20.0,
    together: bool = False,
) -> Design:
    """Design motions that identify the parameters.

    Args:
        robot: The arm; its nominal torque stays within the limits.
        observation: The unknowns and the noise, see :func:`observe`. By default they
            are rigid body, rotors, offsets and friction with the noise of
            :meth:`.Noise.typical`; for :class:`Condition`, the rigid body alone.
        family: Family of motions; by default ten harmonics of 0.05 Hz, so 20 s.
        seed: Seed or generator of the random starts.
        criterion: Optimality criterion; by default the expected torque error on random
            motions of the family within the limits.
        limits: Limits of the joints; 80 % of the robot file's by default.
        constraints: Additional constraints, e.g. a distance between links.
        trajectories: Number of motions.
        starts: Random starts for each motion, or for the set; the best one is refined.
        rate: Samples of the design grid per second, [Hz].
        together: Optimise all motions together; by default one after the other. That
            takes longer and gives a better set, but its first motions alone are worse.

    Raises:
        ExcitationError: No motion within the limits was found; the message names the
            limits and joints that prevent it. Or the motions leave parameters open.
    """
    if min(trajectories, starts) < 1:
        raise ExcitationError("trajectories and starts need to be 1 or more")
    rng = np.random.default_rng(seed)
    if observation is None:
        plain = isinstance(criterion, Condition)
        observation = observe(robot.chain) if plain else usual_observation(robot)
    family = Fourier(10, 0.05) if family is None else family
    bounds = Limits.of(robot) if limits is None else limits
    kept = MotionLimits(bounds, robot.joints), TorqueLimits(robot, bounds.torque)
    measure = DOptimal() if criterion is None else criterion
    program = MotionProgram(
        observation, measure, family, (*kept, *constraints), bounds,
        known=np.zeros((observation.size, observation.size)),
        rate=rate, power=1.0, margin=_MARGIN,
    )  # fmt: skip
    if impossible := program.impossible():
        raise ExcitationError(
            f"no posture keeps the {', '.join(impossible[:4])}; valid are wider limits"
        )
    if criterion is None:
        measure = ExpectedError.of(robot, observation, program.usage(rng))
    if isinstance(measure, ExpectedError):
        wide = measure.observation
        nothing = np.zeros((wide.size, wide.size))
        program = replace(program, observation=wide, criterion=measure, known=nothing)
    if together:
        program = replace(program, count=trajectories)
        x, worst = best_point(program, [program.random(rng) for _ in range(starts)])
        found = tuple(map(program.trajectory, program.parts(x)))
    else:
        found, worst = _one_by_one(program, trajectories, starts, rng)
    grams = tuple(_gram(observation, x, rate) for x in found)
    seen = np.asarray(sum(_gram(program.observation, x, rate) for x in found))
    rank = np.linalg.matrix_rank(np.sum(grams, axis=0), hermitian=True)
    if rank < observation.size:
        raise ExcitationError(
            f"the motions tell {rank} of {observation.size} parameters; valid are "
            "longer motions, wider limits, or fewer effects"
        )
    return Design(
        robot, observation, measure, found, grams, rate, measure.value(seen), worst
    )


def _one_by_one(
    program: MotionProgram, count: int, starts: int, rng: np.random.Generator
) -> tuple[tuple[Trajectory, ...], dict[str, float]]:
    """Optimise motions one after the other; returns them and the largest excesses.

    Each search also starts from the previous motion. If a new motion is worse than a
    repetition of the previous one, that is repeated.
    """
    found: list[Trajectory] = []
    last, value = program.known, program.criterion.value
    worst: dict[str, float] = {}
    excess: dict[str, float] = {}
    for child in rng.spawn(count):
        points = [program.random(child) for _ in range(starts)]
        if found:
            points.append(program.point(found[-1]))
        x, new_excess = best_point(program, points)
        trajectory = program.trajectory(x)
        gram = _gram(program.observation, trajectory, program.rate)
        if found and value(program.known + gram) > value(program.known + last):
            trajectory, gram, new_excess = found[-1], last, excess
        found.append(trajectory)
        last, excess = gram, new_excess
        program = replace(program, known=program.known + gram)
        worst = {k: max(x, worst.get(k, -np.inf)) for k, x in excess.items()}
    return tuple(found), worst


def _gram(observation: Observation, trajectory: Trajectory, rate: float) -> Array:
    """Information of one motion on the design grid."""
    t = uniform(trajectory.family.duration, rate)
    return observation.gram(trajectory.path(t), turning_speed=0.0)


def best_point(
    program: MotionProgram, points: Sequence[Array]
) -> tuple[Array, dict[str, float]]:
    """The best optimum from several starts, and its excess over each limit.

    Raises:
        ExcitationError: No motion within the limits was found.
    """
    power, iterations = _EXPLORE
    smooth = replace(program, power=power)
    optima = [solve(smooth, x, iterations=iterations) for x in points]
    best = min(optima, key=lambda x: (x.excess > 0.01, x.value + PENALTY * x.excess))
    for power, iterations in _POLISH:
        sharp = replace(program, power=power)
        best = solve(sharp, best.x, iterations=iterations, curvature=best.curvature)
    margin, penalty = program.margin, PENALTY
    for _ in range(_REPAIRS):
        excess = program.verified(best.x)
        worst = max(excess.values())
        if worst <= 0:
            return best.x, excess
        if best.excess > _ROUNDING:
            penalty *= 10.0
        # Between the samples of the design grid a torque may be a little higher, or a
        # distance smaller.
        margin += 1.2 * worst
        best = solve(
            replace(sharp, margin=margin), best.x, iterations=_REPAIR_ITERATIONS,
            curvature=best.curvature, penalty=penalty,
        )  # fmt: skip
    raise ExcitationError(_infeasible(excess))


def _infeasible(excess: Mapping[str, float]) -> str:
    over = sorted(((x, name) for name, x in excess.items() if x > 0), reverse=True)
    named = ", ".join(f"{name} by {100 * x:.2g} %" for x, name in over[:4])
    return (
        f"no motion within the limits was found; the best one exceeds the {named}. "
        "Valid are wider limits or a longer motion"
    )


def reference_paths(folder: pathlib.Path, count: int) -> list[pathlib.Path]:
    """Files of the references of a design: ``reference_1.csv`` and so on."""
    return [folder / f"reference_{k + 1}.csv" for k in range(count)]


def write_reference(
    path: str | pathlib.Path, reference: Reference, joints: tuple[str, ...]
) -> None:
    """Write a reference: time [s], then q [rad], v [rad/s] and a [rad/s²].

    Columns are ``t``, ``q_<joint>``, ``v_<joint>``, ``a_<joint>``.
    """
    header = ["t", *(f"{x}_{name}" for x in "qva" for name in joints)]
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file, lineterminator="\n").writerow(header)
        rows = [reference.t, reference.q, reference.v, reference.a]
        np.savetxt(file, np.column_stack(rows), "%.10g", delimiter=",")
