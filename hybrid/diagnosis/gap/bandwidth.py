"""The bandwidth of the torque that was logged, by a plain fit of the gap."""

import numpy as np

from hybrid.diagnosis.gap.background import background, usual_columns
from hybrid.diagnosis.gap.gap import Gap
from hybrid.regression.least_squares import pseudo_solve
from hybrid.signals.bandwidth import torque_bandwidth


def bandwidth(gap: Gap) -> float:
    """Frequency above which a filter has removed torque from the logs, [Hz], or inf."""
    # The model is a least-squares fit of links, rotors and friction to each joint.
    links = background(gap)[0][: gap.robot.size]
    measured, model = gap.measured, np.zeros_like(gap.left)
    for j, moving in enumerate(gap.moving.T):
        if not moving.any():
            continue
        X = np.hstack([x[j] for x in links if j in x] + usual_columns(gap, j))
        own = X[moving]
        model[:, j] = X @ pseudo_solve(own.T @ own, own.T @ measured[moving, j])
    logs = [gap.trajectory == k for k in range(len(gap.motions))]
    pairs = [(measured[own], model[own]) for own in logs]
    return torque_bandwidth(pairs, gap.rate, gap.cutoff)
