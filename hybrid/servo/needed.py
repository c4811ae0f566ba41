"""Which numbers of the file cannot stay, whatever the others are.

One number after the other goes back to the file's, the others following along the
posterior, see :meth:`Estimate.back`, as long as replays of motion that was not fitted
miss by no more than a step of the encoder besides: e'² ≤ e² + step². Models are never
exact, and a posterior that is as narrow as an encoder is fine must not make causes of
what a model leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.servo.drive import Drive
from hybrid.servo.fit import DriveEstimate
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch


def missed(
    simulator: ServoSimulator, logs: Sequence[Stretch], drives: Sequence[Drive | None]
) -> Array:
    """RMS error of replays, shape (len(drives), n), [rad]."""
    found = []
    for moved in simulator.replay(logs, drives):
        errors = [q - x.q for q, x in zip(moved, logs, strict=True)]
        found.append(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
    return np.asarray(np.nan_to_num(np.array(found), nan=np.inf))


def needed(
    simulator: ServoSimulator,
    logs: Sequence[Stretch],
    prior: Drive,
    found: DriveEstimate,
    step: Array,
) -> NDArray[np.bool_]:
    """Numbers that differ from the file's, (len(QUANTITIES), n).

    Args:
        simulator: Replays.
        logs: Motion that was not fitted.
        prior: Numbers of the file.
        found: The fit.
        step: Step of the encoder, shape (n,), [rad].
    """
    (best,) = missed(simulator, logs, [found.drive])
    bound = np.sqrt(best**2 + step**2)
    while found.free.any():
        places = np.argwhere(found.free).tolist()
        tried = [found.back(prior, k, j) for k, j in places]
        over = (missed(simulator, logs, tried) / bound).max(axis=1)
        # Joints hardly move each other: one number of each goes back at a time.
        cheapest: dict[int, int] = {}
        for i in np.argsort(over).tolist():
            if over[i] <= 1.0:
                cheapest.setdefault(places[i][1], places[i][0])
        if not cheapest:
            break
        first = next(iter(cheapest.items()))
        for several in (list(cheapest.items()), [first]):
            then = found
            for j, k in several:
                then = then.without(prior, k, j)
            (together,) = missed(simulator, logs, [then.drive])
            if (together <= bound).all():
                break
        found = then
    return found.free
