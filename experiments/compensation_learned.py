"""The same learner for whatever a model of the arm leaves; it prints nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid import DynamicModel, Recording
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.signals import motion_from_recording


def learned(model: DynamicModel, logs: list[Recording]) -> DynamicModel:
    """The model with a mixture for each joint, over nearby positions and its speed."""
    motions = [motion_from_recording(log, cutoff=model.cutoff) for log in logs]
    rows = [np.flatnonzero(m.mask)[::5] for m in motions]
    q, v, rest = (
        np.concatenate(parts)
        for parts in zip(
            *(
                (m.q[k], m.v[k], (m.tau - model.predict(m))[k])
                for m, k in zip(motions, rows, strict=True)
            ),
            strict=True,
        )
    )
    parts, n = [], model.robot.size
    for j in range(n):
        near = tuple(k for k in (j - 1, j, j + 1) if 0 <= k < n)
        part = JointRemainder(j, near, (j,), None)  # type: ignore[arg-type]
        fitted = fit_gmr(part.inputs(q, v), rest[:, j : j + 1], components=8, seed=0)
        parts.append(replace(part, regression=fitted))
    return replace(model, remainder=ArmRemainder(n, tuple(parts)), inertial=None)
