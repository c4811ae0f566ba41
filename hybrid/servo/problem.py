"""The most probable servo parameters, by Gauss–Newton on replays.

    J(x) = Σ_j w_j Σ_k ρ(e_jk) + ½ Σ ((x − x_file) / s)²

e is replayed less measured position; w and ρ are of :class:`hybrid.servo.noise.Noise`.

A servo moves mainly its own joint. One replay therefore gives the derivative by one
quantity at all joints, and each joint chooses its own step length. Masses and the like
change all joints and are varied one by one. So are all parameters for the covariance.

A law that is not quite that of the arm fits each log best by other parameters. The
posterior does not know, and narrows with every log. To its covariance is added that
between logs, by the pull of each on the parameters. A log that sets a parameter almost
alone pulls little, since the fit follows it: pulls are scaled by this leverage (CR2).

Source: Bell and McCaffrey 2002, Survey Methodology 28, 169 (leverage).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.servo.drive import LOGARITHMIC, QUANTITIES, Drive
from hybrid.servo.noise import Noise, inexactness, resolution, usual_error
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch

_ENDS = 5e-3  # relative decrease of the cost below which a fit ends
_DAMPINGS = (0.01, 1.0, 100.0)  # Levenberg–Marquardt
_LARGEST = 1.0  # step of a logarithm; of other values in prior deviations
_LEAST = 1e-4  # rad: resolution of an encoder without visible steps
_FEW = 3  # logs: of fewer, parts are compared
_KEPT = 64 * 2**20  # bytes of replays in the cache
_PROBE = np.array([q.probe for q in QUANTITIES])[:, None]
SHARED = np.array([q.shared for q in QUANTITIES])

Place = tuple[int, int]  # quantity and joint


@dataclass(frozen=True, eq=False)
class Estimate:
    """Servos of which some parameters differ from the file: an explanation of logs."""

    x: Array  # coordinates, (len(QUANTITIES), n)
    free: Mask  # which of them are fitted, P of them
    errors: Array  # replay errors over all stretches, (M, n), [rad]
    causes: Mask  # which parameters differ from the file, (len(QUANTITIES), n)
    # For a cause (quantity, joint), quantities that fit as well in its place.
    equals: Mapping[Place, tuple[int, ...]] = field(default_factory=dict)
    # Evidence lost when one cause goes back to the file, [nats], once it is computed.
    losses: Mapping[Place, float] = field(default_factory=dict)

    @cached_property
    def usual(self) -> Array:
        """RMS error without outliers, shape (n,), [rad]."""
        return usual_error(self.errors)


@dataclass(frozen=True, eq=False)
class Problem:
    """Logs to fit, and the prior."""

    simulator: ServoSimulator
    stretches: Sequence[Stretch]  # logs
    prior: Drive  # servos of the robot file
    resting: Mask  # joints that no log moves, (n,)
    reached: Array  # least and largest position in any log, (2, n), [rad]
    # Lowest height of each centre of mass in any log, NaN if no command went lower,
    # (n,), [m].
    touched: Array | float = np.nan
    _known: dict[bytes, Array] = field(default_factory=dict)

    def over(self, stretches: Sequence[Stretch]) -> Problem:
        """A copy with other stretches."""
        return replace(self, stretches=stretches, _known={})

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Lower bound of the RMS error [rad], and error of the laws [rad²], (n,)."""
        floor = np.maximum(resolution(self.stretches), _LEAST)
        return floor, inexactness(self.stretches)

    def noise(self, errors: Array) -> Noise:
        """Estimate the noise from the errors of a good replay, shape (M, n), [rad]."""
        ends = np.cumsum([len(x.q) for x in self.stretches])
        return Noise.of(np.split(errors, ends[:-1]), *self._limits)

    @property
    def step(self) -> Array:
        """Unit of a step: 1 for logarithms, else the prior deviation, (·, n)."""
        return np.where(LOGARITHMIC, 1.0, self.prior.spread)

    def errors(self, points: Sequence[Array]) -> list[Array]:
        """Replay errors at some coordinates, shape (M, n) each, [rad]."""
        drives = {x.tobytes(): self.prior.moved(x) for x in points}
        new = {key: x for key, x in drives.items() if key not in self._known}
        if new:
            measured = np.concatenate([x.q for x in self.stretches])
            found = self.simulator.replay(self.stretches, list(new.values()))
            for key, q in zip(new, found, strict=True):
                errors = np.concatenate(q) - measured
                self._known[key] = np.nan_to_num(errors, nan=1e3)
        out = [self._known[x.tobytes()] for x in points]
        while out and len(self._known) * out[0].nbytes > _KEPT:
            del self._known[next(iter(self._known))]
        return out

    def at(self, x: Array, free: Mask) -> Estimate:
        """An estimate at given coordinates, of which all that are free differ."""
        return Estimate(x, free, self.errors([x])[0], free)

    def off(self, x: Array, free: Mask) -> Array:
        """Negative log prior of each joint, up to a constant, shape (n,)."""
        z = np.where(free, (x - self.prior.coordinates) / self.prior.spread, 0.0)
        return np.asarray(0.5 * (z**2).sum(axis=0))

    def cost(self, found: Estimate, noise: Noise) -> Array:
        """Negative log posterior of each joint, up to a constant, shape (n,)."""
        return noise.cost(found.errors) + self.off(found.x, found.free)

    def slopes(self, found: Estimate, *, each: bool = False) -> Array:
        """Derivative of the replay errors by every free coordinate, (P, M, n).

        With ``each`` one parameter changes at a time, and its effect on all joints
        counts.
        """
        alone = SHARED | each
        probes = one_by_one(np.where(found.free, _PROBE * self.step, 0.0), alone)
        moved = self.errors([found.x + x for x in probes])
        out = np.zeros((*found.free.shape, *found.errors.shape))
        for probe, after in zip(probes, moved, strict=True):
            change = after - found.errors
            for k, j in np.argwhere(probe).tolist():
                seen = slice(None) if alone[k] else j
                out[k, j, :, seen] = change[:, seen] / probe[k, j]
        return np.asarray(out[found.free])

    def normal(
        self, found: Estimate, slopes: Array, noise: Noise, spread: Array | None = None
    ) -> tuple[Array, Array]:
        """Gauss–Newton matrix and gradient of the cost, by the slopes at an estimate.

        ``spread`` are other prior deviations, shape (len(QUANTITIES), n).
        """
        spread = self.prior.spread if spread is None else spread
        weight = noise.weights(found.errors)
        flat = slopes.reshape(len(slopes), weight.size)
        matrix = (flat * weight.ravel()) @ flat.T
        gradient = flat @ (weight * found.errors).ravel()
        inverse = 1.0 / spread[found.free] ** 2
        matrix += np.diag(inverse)
        away = (found.x - self.prior.coordinates)[found.free]
        return matrix, gradient + inverse * away

    def fitted(self, start: Estimate, noise: Noise | None, turns: int) -> Estimate:
        """Fit the free parameters in at most ``turns`` Gauss–Newton steps.

        Without noise, weights of errors are estimated anew before each step.
        """
        found = start
        for _ in range(turns if start.free.any() else 0):
            own = noise or self.noise(found.errors)
            before = self.cost(found, own)
            found = self._step(found, own)
            if (before - self.cost(found, own) < _ENDS * before).all():
                break
        return found

    def _step(self, found: Estimate, noise: Noise) -> Estimate:
        """The best of several damped Gauss–Newton steps, at each joint."""
        matrix, gradient = self.normal(found, self.slopes(found), noise)
        most, tried = (_LARGEST * self.step)[found.free], []
        for damping in _DAMPINGS:
            damped = matrix + damping * np.diag(np.diagonal(matrix))
            y = found.x.copy()
            y[found.free] += np.clip(-np.linalg.solve(damped, gradient), -most, most)
            tried.append(self.prior.moved(y).coordinates)
        ends = [
            replace(found, x=y, errors=e)
            for y, e in zip(tried, self.errors(tried), strict=True)
        ]
        costs = np.array([self.cost(x, noise) for x in [found, *ends]])
        points = np.array([found.x, *tried])
        mixed = np.take_along_axis(points, costs.argmin(axis=0)[None, None, :], 0)[0]
        ends.append(replace(found, x=mixed, errors=self.errors([mixed])[0]))
        return min([found, *ends], key=lambda x: float(self.cost(x, noise).sum()))

    def covariance(self, found: Estimate, noise: Noise) -> Array:
        """Covariance of the free parameters, shape (P, P).

        It is that of the posterior, and that between logs, or parts of one or two.
        """
        slopes = self.slopes(found, each=True)
        matrix, gradient = self.normal(found, slopes, noise)
        covariance = np.asarray(np.linalg.inv(matrix))
        names: list[object] = [x.source for x in self.stretches]
        if len(set(names)) < _FEW:
            names = list(range(len(names)))
        blocks = np.unique(np.array(names), return_inverse=True)[1]
        count = int(blocks.max()) + 1
        if count == 1:
            return covariance
        of = np.repeat(blocks, [len(x.q) for x in self.stretches])
        root, weight = np.linalg.cholesky(covariance), noise.weights(found.errors)
        between = np.zeros_like(covariance)
        for k in range(count):
            own = of == k
            flat = slopes[:, own].reshape(len(slopes), -1)
            weighed = flat * weight[own].ravel()
            pull = weighed @ found.errors[own].ravel() - gradient / count
            share, way = np.linalg.eigh(root.T @ weighed @ flat.T @ root)
            # Of what one log alone knows, no other log says how it varies.
            left = np.sqrt(np.maximum(1.0 - share, 1.0 / count))
            moved = root @ way @ (way.T @ root.T @ pull / left)
            between += np.outer(moved, moved)
        return covariance + between


def one_by_one(changes: Array, alone: Mask) -> list[Array]:
    """Split changes, (len(QUANTITIES), n), so that only one quantity changes in each.

    It changes at all joints or, where it is ``alone``, (len(QUANTITIES),), at one.
    """
    parts = []
    for k, row in enumerate(changes):
        for own in np.diag(row) if alone[k] else [row]:
            if own.any():
                parts.append(np.zeros_like(changes))
                parts[-1][k] = own
    return parts
