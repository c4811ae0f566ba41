"""A simulated line of SCARAs: logs week by week, with faults that are known.

Every arm has its own friction, and moves otherwise each week. Viscous friction falls by
1 % per kelvin with a season, whose torque is added to the logs; faults are in the
plant. Physics runs at 500 Hz, drives at 250 Hz, logs at 50 Hz.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from hybrid.effects import Effect
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.payload import Payload
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning
from hybrid.files import write_json
from hybrid.plant import Plant, simulate
from hybrid.recording import Recording, write
from hybrid.robot import Robot

FIRST_DAY = date(2026, 1, 5)
# Relative change of Coulomb friction, of friction, of the torque constant; kilograms.
SIZES = {
    "wear": (0.1, 0.2, 0.4),
    "gearbox": (0.1, 0.2, 0.4),
    "drive": (0.05, 0.1, 0.2),
    "payload": (0.2, 0.4, 0.8),
}
_WEARS = 10  # weeks, until wear has its full size
_SPREAD = 0.1  # relative, of friction between arms
_PER_KELVIN, _SEASON, _MEAN = -0.01, 8.0, 22.0
_COLUMNS = {"wear": ("coulomb.level",), "drive": ("torque_gain.gain",),
            "gearbox": ("coulomb.level", "viscous.coefficient"),
            "payload": ("payload.mass",)}  # fmt: skip


@dataclass(frozen=True)
class Arm:
    """One arm and what happens to it; ``kind`` is empty if nothing does."""

    name: str
    kind: str = ""
    size: float = 0.0
    joint: int = 0
    week: int = 0

    def parameters(self, joints: tuple[str, ...]) -> set[tuple[str, str]]:
        """Joint and parameter that an alarm may name."""
        where = "arm" if self.kind == "payload" else joints[self.joint]
        return {(where, x) for x in _COLUMNS.get(self.kind, ())}


def line(healthy: int, each: int, weeks: int, seed: int) -> Iterator[Arm]:
    """Healthy arms, and some of each kind and size of fault in the middle weeks."""
    rng = np.random.default_rng(seed)
    for k in range(healthy):
        yield Arm(f"h{k:03d}")
    for kind, sizes in SIZES.items():
        for size in sizes:
            for k in range(each):
                week = int(rng.integers(weeks // 4, max(weeks // 2, 1) + 1))
                name = f"{kind}-{size:g}-{k}"
                yield Arm(name, kind, size, int(rng.integers(2)), week)


def record(robot: Robot, arm: Arm, weeks: int, folder: Path, seed: int) -> None:
    """Simulate one arm and write a log a week, with its truth beside."""
    digits = [ord(x) for x in arm.name]
    rng = np.random.default_rng([seed, *digits])
    own = rng.normal(0.0, _SPREAD, 2 * robot.size)
    warm = _MEAN + _SEASON * np.sin(2 * np.pi * np.arange(weeks) / 52 + 1.0)
    warm = warm + rng.normal(0, 1) + rng.normal(0, 1, weeks)
    states = [_state(arm, week) for week in range(weeks)]
    for state in dict.fromkeys(states):
        those = [week for week in range(weeks) if states[week] == state]
        effects = [*_friction(robot, own), *_fault(robot, arm, state)]
        plant = Plant(robot, effects, step=0.002, control_rate=250.0, log_rate=50.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HybridWarning)
            own_seed = int(rng.integers(2**31))  # noise of two arms is never the same
            logs = simulate(plant, trajectories=len(those), seed=own_seed)
        for week, log in zip(those, logs, strict=True):
            day = FIRST_DAY + timedelta(7 * week)
            write(_seasonal(robot, log, warm[week]), folder / f"{day}.parquet")
    write_json(folder.parent / f"{arm.name}.json", asdict(arm))


def _state(arm: Arm, week: int) -> float:
    """Size of the fault in a week."""
    if not arm.kind or week < arm.week:
        return 0.0
    if arm.kind == "wear":
        return arm.size * min(1.0, (week - arm.week + 1) / _WEARS)
    return arm.size


def _friction(robot: Robot, own: np.ndarray) -> list[Effect]:
    n, dry, wet = robot.size, robot.frictionloss, robot.damping
    return [
        *(Coulomb((j,), {"level": own[j] * dry[j]}) for j in range(n)),
        *(Viscous((j,), {"coefficient": own[n + j] * wet[j]}) for j in range(n)),
    ]


def _fault(robot: Robot, arm: Arm, size: float) -> list[Effect]:
    j = arm.joint
    if size == 0.0:
        return []
    if arm.kind == "drive":
        return [TorqueGain((j,), {"gain": size})]
    if arm.kind == "payload":
        per_kilogram = {"mass": 1.0, "mx": 0.2, "mz": -0.12, "Ixx": 0.0161,
                        "Iyy": 0.0566, "Izz": 0.0426, "Ixz": 0.024}  # fmt: skip
        values = {name: size * x for name, x in per_kilogram.items()}
        return [Payload(tuple(range(robot.size)), values)]
    found: list[Effect] = [Coulomb((j,), {"level": size * robot.frictionloss[j]})]
    if arm.kind == "gearbox":
        found.append(Viscous((j,), {"coefficient": -size * robot.damping[j]}))
    return found


def _seasonal(robot: Robot, log: Recording, warm: float) -> Recording:
    """The log with the viscous torque and the temperature of its week."""
    assert log.v is not None
    more = _PER_KELVIN * (warm - _MEAN) * robot.damping * log.v
    temperature = np.full_like(log.q, warm + 5.0)
    return replace(log, tau=log.tau + more, temperature=temperature)
