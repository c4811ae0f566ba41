"""The torque error that a motion leaves on the motions the arm will run.

The arm is y = X θ + Z φ + noise: columns X that every fit has, and structure Z whose
gains φ, in their usual sizes, are independent of unit variance. After a motion with the
information G of [X Z], what is the mean square error e over the motions to come, whose
columns have the second moment M? A fit may know as little as X, or all:

    least squares on X      e = tr(M_XX C) + tr(Bᵀ M B),  C = G_XX⁻¹,  B = [−C G_XZ; I]
    all columns, with prior e = tr(M (G/ρ + Λ)⁻¹),        Λ = diag(0, I)

with the variance ρ, in that of the noise, of what no column describes. In the first the
structure misleads the fit (Box and Draper 1959, doi 10.1080/01621459.1959.10501525),
least where the motion has the positions and speeds of those to come; in the second it
has to be found (Chaloner and Verdinelli 1995, doi 10.1214/ss/1177009939). Condition
numbers and determinants know of neither. The criterion is the geometric mean of both
over all joints, in which no joint's size counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import JointEffect
from hybrid.effects.asymmetric_friction import AsymmetricFriction
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.excitation.criteria import spectrum
from hybrid.excitation.observation import Observation
from hybrid.excitation.path import Path
from hybrid.plant.scale import joint_scales
from hybrid.robot.robot import Robot

# Friction may fall within any part of the joint's speed, and torque repeat with any
# number of periods a turn.
_FALLS = (0.01, 0.03, 0.1, 0.3)
_REST = 10.0  # ρ: ripple of teeth and the like, of three times the sensors' noise
_VAGUE = 1e-9  # prior precision of a gain of X, which keeps the inverse finite
_PERIODS = (1.0, 2.0, 3.0, 4.0, 7.0, 20.0)


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """Expected RMS torque error on the motions to come, geometric mean over joints.

    Attributes:
        observation: Columns of the fit, and behind them those of the structure.
        fitted: Number of columns of the fit, X.
        moments: Mean product of every two columns over the motions to come, for each
            joint, shape (n, b, b), [(N·m)²].
    """

    observation: Observation
    fitted: int
    moments: Array

    @classmethod
    def of(
        cls, robot: Robot, observation: Observation, usage: Sequence[Path]
    ) -> ExpectedError:
        """Build the criterion for the structure that arms usually have.

        Args:
            robot: The arm.
            observation: Columns of the fit.
            usage: Motions like those to come.
        """
        wide = observation.with_structure(*usual_structure(robot))
        whole = Path.joined(usage)
        coloured = np.linalg.inv(wide.whitening)
        Y = np.swapaxes(coloured @ wide.matrix(whole), 0, 1)  # (n, N, b)
        moments = np.swapaxes(Y, 1, 2) @ Y / len(whole.t)
        return cls(wide, observation.size, np.asarray(moments))

    def value(self, gram: Array) -> float:
        """See :class:`~hybrid.excitation.criteria.Criterion`; in [N·m]."""
        return float(np.exp(self.smooth(gram, 1.0)[0]))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`~hybrid.excitation.criteria.Criterion`; smooth as it is."""
        (few, by_few), (every, by_every) = self._of_few(gram), self._of_all(gram)
        return 0.5 * (few + every), 0.5 * (by_few + by_every)

    def _of_few(self, gram: Array) -> tuple[float, Array]:
        """Mean logarithm of the RMS error of least squares on X, derivative by G."""
        k = self.fitted
        eigenvalues, vectors = spectrum(gram[:k, :k])
        C = (vectors / eigenvalues) @ vectors.T
        A = C @ gram[:k, k:]
        B = np.vstack([-A, np.eye(A.shape[1])])
        squares = np.array(
            [(M[:k, :k] * C).sum() + ((M @ B) * B).sum() for M in self.moments]
        )
        M = self._weighed(squares)
        by_A = -C @ (M @ B)[:k]
        slope = np.zeros_like(gram)
        slope[:k, :k] = -C @ M[:k, :k] @ C - by_A @ A.T - A @ by_A.T
        slope[:k, k:], slope[k:, :k] = by_A, by_A.T
        return 0.5 * float(np.log(squares).mean()), slope

    def _of_all(self, gram: Array) -> tuple[float, Array]:
        """Mean logarithm of the RMS error of the fit of all, derivative by G."""
        known = np.arange(len(gram)) >= self.fitted
        C = np.linalg.inv(gram / _REST + np.diag(np.where(known, 1.0, _VAGUE)))
        squares = np.tensordot(self.moments, C, 2)
        slope = -C @ self._weighed(squares) @ C / _REST
        return 0.5 * float(np.log(squares).mean()), slope

    def _weighed(self, squares: Array) -> Array:
        """Derivative of the mean logarithm of the RMS errors by C, shape (b, b)."""
        weights = 0.5 / len(squares) / squares
        return np.asarray(np.tensordot(weights, self.moments, 1))


def usual_structure(robot: Robot) -> tuple[list[JointEffect], Array]:
    """What a joint may do beside inertia, dry and viscous friction, and usual sizes.

    Returns:
        Effects of every joint, and the usual size of each of their gains.
    """
    scales = joint_scales(robot)
    effects: list[JointEffect] = []
    for j, scale in enumerate(scales):
        most = Stribeck.shapes[0].upper
        falls = [min(x * scale.speed, most) for x in _FALLS]
        effects += [
            NonlinearViscous.typical((j,), scales),
            AsymmetricFriction.typical((j,), scales),
            LoadFriction.typical((j,), scales),
            *(Stribeck.typical((j,), scales, velocity=x) for x in falls),
            *(TorqueRipple.typical((j,), scales, periods=x) for x in _PERIODS),
        ]
    sizes = []
    for effect in effects:
        for gain in effect.gains:
            # A sine and a cosine are of one size, whichever of them is the usual one.
            alike = [g.name for g in effect.gains if g.unit == gain.unit]
            sizes.append(max(abs(effect.values[name]) for name in alike))
    return effects, np.array(sizes)
