"""Eccentricity of the encoder disc."""

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity, Scalar
from hybrid.signals import Motion

_PASSES = 8  # each reduces the error by the size of the eccentricity, a few per cent


class EncoderEccentricity(Effect):
    """The encoder's error repeats once a turn: q + s·sin q + c·cos q."""

    id = "encoder_eccentricity"
    port = Port.MEASUREMENT
    gains = (
        Quantity("sine", "rad", 0.004, -0.05, 0.05),
        Quantity("cosine", "rad", 0.002, -0.05, 0.05),
    )
    equation = "τ = rigid(q, v, a) with q_measured = q + s · sin q + c · cos q"
    source = "Sanchez-Brea and Morlanes 2008, doi 10.1088/0957-0233/19/11/115104"
    sentence = "The encoder of {joints} has an error that repeats once a turn."
    remedy = "Correct the position by the fitted sine, or centre the encoder disc."

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order; see :meth:`Effect.columns`; shape (N, n, 2)."""
        (j,), columns = self.joints, []
        q, v, a = motion.q[:, j], motion.v[:, j], motion.a[:, j]
        for unit in ({"sine": 1.0, "cosine": 0.0}, {"sine": 0.0, "cosine": 1.0}):
            error, slope, curvature = self.at(unit)._error(q)
            change = -error, -slope * v, -slope * a - curvature * v**2
            columns.append(body.response(j, *change))
        return np.stack(columns, axis=-1)

    def true_state(
        self, q: Scalar, v: Scalar, a: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """From q_measured = q + e(q) and its derivatives, by successive substitution.

        See :meth:`Instant.true_state`.
        """
        true = q
        for _ in range(_PASSES):
            true = q - self._error(true)[0]
        _, slope, curvature = self._error(true)
        speed = v / (1.0 + slope)
        return true, speed, (a - curvature * speed**2) / (1.0 + slope)

    def sense(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Position and speed that the encoder shows."""
        error, slope, _ = self._error(q)
        return q + error, v * (1.0 + slope)

    def _error(self, q: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Error at a true position, and its first two derivatives."""
        s, c = self.values["sine"], self.values["cosine"]
        sine, cosine = np.sin(q), np.cos(q)
        error = s * sine + c * cosine
        return error, s * cosine - c * sine, -error
