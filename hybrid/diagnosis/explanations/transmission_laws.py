"""Unknown laws of a transmission: the link differs from its encoder by an angle φ.

Examples are backlash, a soft gear, or an eccentric encoder. φ is an unknown function of
the motion, and changes the torque of all drives that move the link,

    δτ = ∂τ/∂q φ + ∂τ/∂v dφ/dt + ∂τ/∂a d²φ/dt².
"""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.explanations.joint_laws import (
    lagged_differences,
    low_passed,
    smooth_features,
)
from hybrid.diagnosis.gap.gap import Columns, Gap

_KNOTS = 8


def transmission_laws(gap: Gap, joint: int) -> Iterator[tuple[str, Columns]]:
    """Yield the name of each law, and its columns at all joints that φ reaches."""
    low = gap.lower_cutoff()
    # The load and the residual contain the same noise of positions.
    load = low_passed(gap, gap.load[:, joint], low)
    q = gap.sampled.q[:, joint]
    slopes = [
        np.stack(body.slopes(joint))[:, :: sampler.factor] for _, body, sampler in gap
    ]
    slope = np.concatenate(slopes, axis=1)  # (3, M, n)
    side = np.tanh(load / (np.sqrt(np.mean(load**2)) + 1e-12))
    features = {
        "load": np.hstack([
            low_passed(gap, _with_lags(gap, side), gap.cutoff),
            _with_lags(gap, load),
        ]),
        "position": low_passed(gap, smooth_features(q, _KNOTS), low),
    }  # fmt: skip
    for name, x in features.items():
        speed = _derivative(gap, x)
        changes = x, speed, _derivative(gap, speed)
        yield (
            f"twist with {name}",
            {
                j: sum(s[:, j, None] * c for s, c in zip(slope, changes, strict=True))
                for j in np.flatnonzero(slope.any(axis=(0, 1))).tolist()
            },
        )


def _with_lags(gap: Gap, x: Array) -> Array:
    return np.column_stack([x, lagged_differences(gap, x)])


def _derivative(gap: Gap, x: Array) -> Array:
    """Time derivative in each recording, shape (M, d)."""
    parts = [x[gap.trajectory == k] for k in range(len(gap.motions))]
    return np.concatenate([np.gradient(p, 1.0 / gap.rate, axis=0) for p in parts])
