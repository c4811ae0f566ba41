"""Plain numbers of servos sought by CMA-ES, on stretches of logs."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from hybrid.robot import Robot
from hybrid.servo.drive import NAMES, PLAIN, Drive
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch


def by_cma(
    robot: Robot, parts: Sequence[Stretch], seconds: float, seed: int
) -> tuple[Drive, float]:
    """Servos after some seconds of processor time, and how many.

    Stiffness, damping, friction, rotor and offset of every servo, and one delay.
    """
    import cma

    simulator, start = ServoSimulator(robot), Drive.declared(robot)
    rows = [NAMES.index(name) for name in PLAIN if name != "delay"]
    center, unit = start.coordinates, start.spread[rows]

    def drive(x: np.ndarray) -> Drive:
        y = center.copy()
        y[rows] = center[rows] + unit * x[1:].reshape(len(rows), -1)
        return start.moved(y).at(delay=abs(x[0]) * 0.05)

    begun, options = time.process_time(), {"seed": seed, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.zeros(1 + unit.size), 0.5, options)
    measured = np.concatenate([x.q for x in parts])
    while time.process_time() < begun + seconds:
        tried = search.ask()
        replays = simulator.replay(parts, [drive(x) for x in tried])
        errors = [np.concatenate(own) - measured for own in replays]
        search.tell(tried, [np.nan_to_num(x**2, nan=9.0).mean() for x in errors])
    return drive(search.result.xbest), time.process_time() - begun
