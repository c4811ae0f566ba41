"""True arms for ``advice.py``: how they are recorded, and run what is advised."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from hybrid import Effect, Recording, Robot
from hybrid.diagnosis.advice.menu import with_payload
from hybrid.diagnosis.answer.diagnosis import Advice
from hybrid.diagnosis.answer.result import Result
from hybrid.diagnosis.diagnose import examine
from hybrid.effects import effect_classes
from hybrid.plant import Plant, random_fourier
from hybrid.plant.reference import Reference
from hybrid.plant.scale import joint_scales

MODEL = Path(__file__).parents[1] / "models" / "coman_like.xml"
# Effect, joint and size, relative to the usual, that a short motion leaves in doubt.
CASES = (("spring", 2, 0.6), ("spring", 5, 0.3), ("counterbalance", 5, 0.3),
         ("asymmetric_friction", 3, 0.6), ("torque_offset", 3, 0.3),
         ("coulomb", 0, 0.15), ("coulomb", 1, 0.4), ("load_friction", 1, 0.3),
         ("torque_gain", 5, 0.6), ("viscous", 5, 0.6),
         ("thermal_friction", 5, 0.8))  # fmt: skip
FILL, SECONDS, RATE, WARM = 0.3, 10.0, 250.0, 1200.0


def true_effect(robot: Robot, effect_id: str, joint: int, size: float) -> Effect:
    """An effect of which a short and slow motion may show too little."""
    cls = effect_classes()[effect_id]
    usual = cls.typical((joint,), joint_scales(robot))
    return usual.at({g.name: size * usual.values[g.name] for g in cls.gains})


def recorded(robot: Robot, true: Effect, rng: np.random.Generator) -> list[Recording]:
    """One short and slow motion of the true arm."""
    short = random_fourier(robot, duration=SECONDS, rate=RATE, seed=rng, fill=FILL)
    return Plant(robot, [true], nominal=robot, log_rate=RATE).run([short], seed=rng)


def class_at(result: Result, joint: str) -> set[str]:
    """Ids that the diagnosis cannot tell apart at a joint."""
    found = (f for f in result.diagnosis.findings if joint in f.joints)
    return {x for f in found for x in f.alternatives}


def repeated(
    robot: Robot, true: Effect, logs: list[Recording], advice: Advice, folder: Path
) -> Result:
    """The diagnosis after the true arm has run what was advised, as it says."""
    table = np.loadtxt(folder / advice.file, delimiter=",", skiprows=1)
    ask = Reference(table[:, 0], *np.split(table[:, 1:], 3, axis=1))
    carried = re.search(r"([\d.e-]+) kg", advice.experiment)
    if carried:  # to be diagnosed alone, by a simulator that has the mass
        robot, logs = with_payload(robot, float(carried[1])), []
    warm = WARM if "warm" in advice.experiment else 0.0
    if true.id == "thermal_friction":
        left = np.exp(-warm / true.values["time_constant"])
        true = true.at({"cold": left * true.values["cold"]})
    new = Plant(robot, [true], nominal=robot, log_rate=RATE).run(
        [ask], seed=np.random.default_rng(1)
    )
    return examine(robot, [*logs, *(replace(x, t=x.t + warm) for x in new)])
