"""Simulated logs at half the work: a physics step as long as the controller's.

The other half is of use where laws change within a millisecond.
"""

from dataclasses import replace
from functools import partial

import hybrid.plant

STEP = 0.001  # s
Plant = partial(hybrid.plant.Plant, step=STEP)


def load_truth(path):
    """The nominal arm and the plant of a truth file."""
    nominal, plant = hybrid.plant.load_truth(path)
    return nominal, replace(plant, step=STEP)


def simulate(robot, effects=(), *, noise=None, log_rate=500.0, **options):
    """Random motions of an arm with effects, or of a plant as it is."""
    if isinstance(robot, hybrid.plant.Plant):
        return hybrid.plant.simulate(robot, **options)
    plant = Plant(robot, effects, noise=noise, log_rate=log_rate)
    return hybrid.plant.simulate(plant, **options)
