"""The scale of torque, which drive gains leave in doubt and a known mass settles.

A gain that all drives share scales torque, friction and all masses found from torque.
Logs alone do not show it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hybrid.diagnosis.answer.diagnosis import Diagnosis, Finding, Value, listed
from hybrid.diagnosis.answer.words import number, value_cells
from hybrid.effects import Effect, effect_class
from hybrid.errors import IdentificationError, RobotError
from hybrid.model import DynamicModel
from hybrid.robot import Robot
from hybrid.servo.drive import known_masses
from hybrid.statistics import HALF_WIDTH

_DOUBT = (
    "Mass {} kg, 95% interval {}, to the scale of the logged torque. The interval "
    "allows all drive gains to be off by {:.0%} (standard deviation); without that it "
    "is {}. A weighed payload settles it: --known-mass JOINT=KG with --baseline."
)
_SETTLED = (
    "Mass and inertia are in true SI units, by the known mass. The files written keep "
    "the scale of the logged torque."
)
_NOT_ONE = (
    "the payload and one scale of torque do not explain the gap alone: the gains may "
    "differ from drive to drive, and the torque scale is then that of none"
)
_LINKS = "the links have {} times the masses of the file, by the known mass at {}"


def weighed(
    simulator: Robot | DynamicModel, known: Mapping[str, float]
) -> tuple[Robot | DynamicModel, list[str]]:
    """The simulator with known masses, by joint, [kg], and what to say of them.

    Torque shows masses by their ratios, so that a file is off by one factor: its links
    without a known mass are as far off as those with one. To a model a known mass is
    that of a payload, which does not change it.

    Raises:
        RobotError: There is no such joint, or the mass is not above 0.
    """
    if not known:
        return simulator, []
    if isinstance(simulator, DynamicModel):
        _check_payloads(simulator.robot, known)
        return simulator, []
    ratio = known_masses(simulator, known)
    ends = dict.fromkeys(number(float(x)) for x in (ratio.min(), ratio.max()))
    note = _LINKS.format(" to ".join(ends), listed([*known]))
    inertial = simulator.chain.inertial * ratio[:, None]
    return simulator.with_inertial(inertial), [note]


def _check_payloads(robot: Robot, known: Mapping[str, float]) -> None:
    for name, mass in known.items():
        if name not in robot.joints:
            valid = ", ".join(robot.joints)
            raise RobotError(
                f"known mass: the arm has no joint {name!r}; valid are {valid}"
            )
        if not 0 < mass < np.inf:
            raise RobotError(
                f"known mass: {mass:g} kg at {name}; valid are finite masses above 0"
            )


def in_doubt(diagnosis: Diagnosis) -> Diagnosis:
    """The same with intervals of masses that allow for an error of the drive gains."""
    return replace(diagnosis, findings=tuple(map(_doubted, diagnosis.findings)))


def _doubted(finding: Finding) -> Finding:
    law = effect_class(finding.effect)
    if law.weighed is None:
        return finding
    name, gain = law.weighed
    spread = effect_class(gain).gains[0].deviation
    values = [_scaled(law, v, 1.0, spread) for v in finding.parameters]
    notes = [
        _DOUBT.format(*value_cells(wide)[:2], spread, value_cells(v)[1])
        for v, wide in zip(finding.parameters, values, strict=True)
        if v.name == name
    ]
    return replace(finding, parameters=tuple(values), note=" ".join(notes))


def settled(
    diagnosis: Diagnosis, effects: Sequence[Effect], known: Mapping[str, float]
) -> Diagnosis:
    """The same with the scale of torque, and with masses in true units.

    Known are masses of what was mounted since the model was healthy on the link that a
    joint moves, by the joint's name, [kg].

    Raises:
        IdentificationError: The logs show no mass there, or hardly one.
    """
    each = [_scale(diagnosis, effects, *x) for x in known.items()]
    weights = np.array([1.0 / std**2 for _, std in each])
    scale = float(weights @ [x for x, _ in each] / weights.sum())
    std = float(weights.sum() ** -0.5)
    half = HALF_WIDTH * std
    found = [_in_true_units(f, scale, std / scale, known) for f in diagnosis.findings]
    alone = diagnosis.verdict == "explained" and len(found) == len(known)
    interval = scale - half, scale + half
    said = Value("arm", "torque scale", scale, "", interval, determined=alone)
    return replace(
        diagnosis,
        findings=tuple(found),
        torque_scale=said,
        doubts=diagnosis.doubts if alone else (_NOT_ONE, *diagnosis.doubts),
    )


def _scale(
    diagnosis: Diagnosis, effects: Sequence[Effect], joint: str, known: float
) -> tuple[float, float]:
    """Scale of torque by a known mass, and its standard deviation."""
    seen = {
        diagnosis.joints[e.joints[-1]]: (e.values[e.weighed[0]], e.std[e.weighed[0]])
        for e in effects if e.weighed
    }  # fmt: skip
    if joint not in seen:
        where = f"valid is {', '.join(seen)}" if seen else "they show none at all"
        raise IdentificationError(
            f"known mass: these logs show no mass that was mounted at {joint}; {where}"
        )
    found, std = seen[joint]
    if found <= HALF_WIDTH * std:
        raise IdentificationError(
            f"known mass: these logs show {number(found)} ± "
            f"{number(HALF_WIDTH * std)} kg at {joint}, too uncertain for a scale; "
            "valid are logs of more varied motion, or a larger mass"
        )
    return found / known, std / known


def _in_true_units(
    finding: Finding, scale: float, spread: float, known: Mapping[str, float]
) -> Finding:
    """The finding over the scale of torque, if that scales it."""
    law = effect_class(finding.effect)
    if law.weighed is None:
        return finding
    values = []
    for v in finding.parameters:
        mass = known.get(finding.joints[-1] if v.joint == "arm" else v.joint)
        if v.name == law.weighed[0] and mass is not None:
            values.append(replace(v, value=mass, interval=(mass, mass)))
        else:
            values.append(_scaled(law, v, scale, spread))
    return replace(finding, parameters=tuple(values), note=_SETTLED)


def _scaled(law: type[Effect], v: Value, scale: float, spread: float) -> Value:
    """A gain over a scale with a relative standard deviation; a shape as it is."""
    # Their errors are taken to be independent.
    if v.name not in {g.name for g in law.gains}:
        return v
    more = HALF_WIDTH * spread * v.value
    low, high = (float(np.hypot(v.value - x, more)) / scale for x in v.interval)
    value = v.value / scale
    return replace(v, value=value, interval=(value - low, value + high))
