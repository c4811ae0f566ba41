"""Expected torque error, on future motions, of a model fitted to a designed motion.

The arm is y = X θ + Z φ + noise. Every fit has the columns X. The structure Z is what
an arm may also have; its gains φ, in their usual sizes, are independent with unit
variance. G is the information of [X Z] in the designed motion, and M the second moment
of the columns over future motions. The mean square error e is, for two extreme fits:

    least squares on X      e = tr(M_XX C) + tr(Bᵀ M B),  C = G_XX⁻¹,  B = [−C G_XZ; I]
    all columns, with prior e = tr(M (G/ρ + Λ)⁻¹),        Λ = diag(0, I)

ρ is the variance that no column describes, in units of the noise variance. In the first
fit the structure causes a bias (Box and Draper 1959, doi
10.1080/01621459.1959.10501525), which is smallest if the motion has the positions and
speeds of the future ones. In the second the structure is estimated (Chaloner and
Verdinelli 1995, doi 10.1214/ss/1177009939). The criterion is the geometric mean of both
errors over all joints, so it does not depend on the size of a joint's torque.
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
from hybrid.excitation.criteria import Criterion, spectrum
from hybrid.excitation.observation import Observation
from hybrid.excitation.path import Path
from hybrid.plant.scale import joint_scales
from hybrid.robot.robot import Robot

_STRIBECK_SPEEDS = (0.01, 0.03, 0.1, 0.3)  # of the joint's rated speed
_PERIODS = (1.0, 2.0, 3.0, 4.0, 7.0, 20.0)  # of ripple, in a turn
_UNMODELLED = 10.0  # ρ, for example ripple of about three times the sensors' noise
_WEAK_PRIOR = 1e-9  # prior precision of a gain of X, which keeps the inverse finite


@dataclass(frozen=True, eq=False)
class ExpectedError(Criterion):
    """Expected RMS torque error on future motions [N·m], geometric mean over joints."""

    observation: Observation  # columns X of the fit, then columns Z of the structure
    fitted: int  # number of columns X
    moments: Array  # M of each joint over future motions, shape (n, b, b), [(N·m)²]

    @classmethod
    def of(
        cls, robot: Robot, observation: Observation, usage: Sequence[Path]
    ) -> ExpectedError:
        """Build the criterion for the structure that arms usually have."""
        wide = observation.with_structure(*typical_structure(robot))
        whole = Path.joined(usage)
        coloured = np.linalg.inv(wide.whitening)
        Y = np.swapaxes(coloured @ wide.matrix(whole), 0, 1)  # (n, N, b)
        moments = np.swapaxes(Y, 1, 2) @ Y / len(whole.t)
        return cls(wide, observation.size, np.asarray(moments))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`~hybrid.excitation.criteria.Criterion`; smooth as it is."""
        few, by_few = self._least_squares_error(gram)
        every, by_every = self._posterior_error(gram)
        return 0.5 * (few + every), 0.5 * (by_few + by_every)

    def _least_squares_error(self, gram: Array) -> tuple[float, Array]:
        """Mean logarithm of the RMS error of least squares on X, derivative by G."""
        k = self.fitted
        eigenvalues, vectors = spectrum(gram[:k, :k])
        C = (vectors / eigenvalues) @ vectors.T
        A = C @ gram[:k, k:]
        B = np.vstack([-A, np.eye(A.shape[1])])
        squares = np.array(
            [(M[:k, :k] * C).sum() + ((M @ B) * B).sum() for M in self.moments]
        )
        M = self._weighted(squares)
        by_A = -C @ (M @ B)[:k]
        slope = np.zeros_like(gram)
        slope[:k, :k] = -C @ M[:k, :k] @ C - by_A @ A.T - A @ by_A.T
        slope[:k, k:], slope[k:, :k] = by_A, by_A.T
        return 0.5 * float(np.log(squares).mean()), slope

    def _posterior_error(self, gram: Array) -> tuple[float, Array]:
        """Mean logarithm of the RMS error of the fit of [X Z], derivative by G."""
        known = np.arange(len(gram)) >= self.fitted
        C = np.linalg.inv(
            gram / _UNMODELLED + np.diag(np.where(known, 1.0, _WEAK_PRIOR))
        )
        squares = np.tensordot(self.moments, C, 2)
        slope = -C @ self._weighted(squares) @ C / _UNMODELLED
        return 0.5 * float(np.log(squares).mean()), slope

    def _weighted(self, squares: Array) -> Array:
        """Derivative of the mean logarithm of the RMS errors by C, shape (b, b)."""
        weights = 0.5 / len(squares) / squares
        return np.asarray(np.tensordot(weights, self.moments, 1))


def typical_structure(robot: Robot) -> tuple[list[JointEffect], Array]:
    """Effects that joints may have besides inertia, dry and viscous friction.

    The array has the usual size of each of their gains.
    """
    scales = joint_scales(robot)
    effects: list[JointEffect] = []
    for j, scale in enumerate(scales):
        most = Stribeck.shapes[0].upper
        stribeck_speeds = [min(x * scale.speed, most) for x in _STRIBECK_SPEEDS]
        effects += [
            NonlinearViscous.typical((j,), scales),
            AsymmetricFriction.typical((j,), scales),
            LoadFriction.typical((j,), scales),
            *(Stribeck.typical((j,), scales, velocity=x) for x in stribeck_speeds),
            *(TorqueRipple.typical((j,), scales, periods=x) for x in _PERIODS),
        ]
    sizes = []
    for effect in effects:
        for gain in effect.gains:
            # Gains of one unit, as a sine and a cosine, have one size.
            same_unit = [g.name for g in effect.gains if g.unit == gain.unit]
            sizes.append(max(abs(effect.values[name]) for name in same_unit))
    return effects, np.array(sizes)
