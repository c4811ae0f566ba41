"""Laws that no library has of where a link lies beside its encoder.

Play, a soft gear, an encoder off its centre: the link of a joint is elsewhere than the
encoder says, by an unknown function of the motion. All drives that move it feel that,

    δτ = ∂τ/∂q φ + ∂τ/∂v dφ/dt + ∂τ/∂a d²φ/dt².
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.explanations.unknown import filtered, past, smooth
from hybrid.diagnosis.gap.gap import Columns, Gap

_CALM = 0.5  # of the cut-off, for what is differentiated twice
_KNOTS = 8


def twists(gap: Gap, joint: int) -> Iterator[tuple[str, Columns]]:
    """What the place of a joint's link is a law of, and its torque per feature."""
    # The load holds the noise of positions, and so does the residual.
    load = filtered(gap, gap.load[:, joint], _CALM * gap.cutoff)
    q = gap.sampled.q[:, joint]
    slopes = [
        np.stack(body.slopes(joint))[:, :: sampler.factor] for _, body, sampler in gap
    ]
    slope = np.concatenate(slopes, axis=1)  # (3, M, n)
    side = np.tanh(load / (np.sqrt(np.mean(load**2)) + 1e-12))
    features = {
        "load": np.hstack([
            filtered(gap, _and_past(gap, side), gap.cutoff),
            _and_past(gap, load),
        ]),
        "position": filtered(gap, smooth(q, _KNOTS), _CALM * gap.cutoff),
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


def _and_past(gap: Gap, x: Array) -> Array:
    return np.column_stack([x, past(gap, x)])


def _derivative(gap: Gap, x: Array) -> Array:
    """Per second, shape (M, d), in each recording."""
    parts = [x[gap.trajectory == k] for k in range(len(gap.motions))]
    return np.concatenate([np.gradient(p, 1.0 / gap.rate, axis=0) for p in parts])
