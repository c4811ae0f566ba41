"""Nonlinear friction of one joint: threshold, width and non-negative coefficients.

The law is linear in its coefficients once threshold λ and width are given, and nearly
all of it is straight between a few speeds. Its columns at every pair on a grid are thus
sums of the same few hat functions of speed, which are filtered and multiplied once; the
search over λ is a search over small non-negative least-squares problems.

Source: Lawson and Hanson 1974, doi 10.1137/1.9781611971217 (non-negative least
squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, eigh
from scipy.optimize import nnls

from hybrid.arrays import Array
from hybrid.effects import Effect, JointState
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.identification.data import FOLDS, Data
from hybrid.regression.cross_products import sampled_chunks
from hybrid.signals import Motion, Sampler

_THRESHOLDS = 16
_WIDTHS = (0.0, 0.01, 0.04)  # of the joint's highest speed
_SMALLEST_THRESHOLD = 0.01  # of the joint's highest speed
_SMOOTH = 3  # columns of powers of speed
_COLUMNS = len(ThresholdFriction.gains)


@dataclass(frozen=True)
class _Grid:
    """Thresholds and widths, and the speeds between which their laws are straight."""

    fastest: float

    @cached_property
    def shapes(self) -> list[dict[str, float]]:
        """Every pair whose width is below its threshold."""
        ratios = np.geomspace(_SMALLEST_THRESHOLD, 1.0, _THRESHOLDS)
        return [
            {"threshold": x * self.fastest, "width": w * self.fastest}
            for w in _WIDTHS
            for x in ratios
            if w < x
        ]

    @cached_property
    def knots(self) -> Array:
        """Speeds from zero to the highest, shape (K,), [rad/s]."""
        found = {x for shape in self.shapes for x in shape.values()} | {self.fastest}
        return np.array(sorted(found))

    def columns(self, state: JointState) -> Array:
        """Hats of each direction, powers of speed, and load; shape (2K + 4, N)."""
        speed = abs(state.v)
        at = np.clip(np.searchsorted(self.knots, speed) - 1, 0, len(self.knots) - 2)
        step = np.diff(self.knots)[at]
        share = np.clip((speed - self.knots[at]) / step, 0.0, 1.0)
        count, samples = len(self.knots), np.arange(len(speed))
        hats = np.zeros((2 * count, len(speed)))
        row = at + np.where(state.v < 0, count, 0)
        hats[row, samples] = state.sign * (1.0 - share)
        hats[row + 1, samples] = state.sign * share
        smooth = [state.sign * speed**k for k in range(1, _SMOOTH + 1)]
        return np.concatenate([hats, smooth, LoadFriction.law(state)])

    @cached_property
    def maps(self) -> list[Array]:
        """Columns of the law at each pair, and of load, from :meth:`columns`."""
        zero, count = np.zeros(len(self.knots)), len(self.knots)
        dry = _COLUMNS - _SMOOTH
        found = []
        for shapes in self.shapes:
            hats = np.zeros((dry, 2 * count))
            for k, sign in enumerate((1.0, -1.0)):
                v = sign * np.maximum(self.knots, 1e-9 * self.fastest)
                state = JointState(zero, zero, v, zero, np.sign(v), zero)
                law = ThresholdFriction.law(state, fastest=self.fastest, **shapes)
                hats[:, k * count : (k + 1) * count] = sign * np.stack(law[:dry])
            found.append(block_diag(hats, np.eye(_SMOOTH + 1)))
        return found


def fit_friction(
    data: Data, joint: int, rest: Sequence[Array], load: Sequence[Array]
) -> tuple[Effect, ...]:
    """Friction of one joint from what the rigid body leaves of its torque.

    Args:
        data: Motions with folds.
        joint: The joint.
        rest: Torque less everything but friction, shape (N,) for each motion, [N·m].
        load: Torque transmitted to the link, shape (N,) for each motion, [N·m].

    Returns:
        Threshold friction, and load friction where it lowers the error on folds that
        were left out.
    """
    grid = _Grid(max(float(np.abs(m.v[m.mask, joint]).max()) for m in data.motions))
    sums = _products(data, joint, rest, load, grid)
    found: list[tuple[float, Array, dict[str, float]]] = []
    for shapes, mapping in zip(grid.shapes, grid.maps, strict=True):
        own = block_diag(mapping, np.eye(1))
        products = own @ sums @ own.T
        for rows in (np.arange(_COLUMNS), np.arange(_COLUMNS + 1)):
            error, coefficients = _cross_validated(products, rows)
            found.append((error, coefficients, shapes))
    _, coefficients, shapes = min(found, key=lambda x: x[0])
    names = [g.name for g in ThresholdFriction.gains]
    values = _canonical(dict(zip(names, coefficients.tolist(), strict=False)))
    shapes = {**shapes, "fastest": grid.fastest}
    effects: tuple[Effect, ...] = (ThresholdFriction((joint,), values | shapes),)
    if len(coefficients) > _COLUMNS and coefficients[-1] > 0:
        effects += (LoadFriction((joint,), {"coefficient": coefficients[-1]}),)
    return effects


def _canonical(values: dict[str, float]) -> dict[str, float]:
    """The same law without a falling and a rising part that cancel to a level."""
    both = min(values["falling"], values["rising"])
    change = {"falling": -both, "rising": -both}
    change |= {"coulomb_positive": both, "coulomb_negative": both}
    return {name: x + change.get(name, 0.0) for name, x in values.items()}


def _products(
    data: Data, joint: int, rest: Sequence[Array], load: Sequence[Array], grid: _Grid
) -> Array:
    """Cross-products of [columns, rest] of each fold, shape (F, rows, rows)."""
    size = 2 * len(grid.knots) + _SMOOTH + 2
    sums = np.zeros((FOLDS, size, size))
    for motion, fold, y, carried in zip(
        data.motions, data.folds, rest, load, strict=True
    ):
        sampler = Sampler.for_rate(motion.rate, data.cutoff)
        few = slice(None, None, sampler.factor)
        moves, own = data.moves(motion)[few, joint], fold[few]

        def rows(
            here: slice, m: Motion = motion, y: Array = y, load: Array = carried
        ) -> Array:
            q, v, a = (x[here, joint] for x in (m.q, m.v, m.a))
            state = JointState(m.t[here], q, v, a, np.sign(v), load[here])
            return np.concatenate([grid.columns(state), y[None, here]])

        for first, D, _ in sampled_chunks(rows, len(motion.t), sampler):
            here = slice(first, first + D.shape[1])
            for k in np.unique(own[here]):
                part = D[:, moves[here] & (own[here] == k)]
                sums[k] += part @ part.T
    return sums


def _cross_validated(sums: Array, rows: NDArray[np.intp]) -> tuple[float, Array]:
    """Squares left on folds by coefficients from the others; those from all folds."""
    total = sums.sum(axis=0)
    folds = [s for s in sums if s[-1, -1] > 0]
    left = [_squares(s, rows, _nonnegative(total - s, rows)) for s in folds]
    return sum(left), _nonnegative(total, rows)


def _nonnegative(sums: Array, rows: NDArray[np.intp]) -> Array:
    """Non-negative least-squares coefficients of some rows."""
    G, c = sums[np.ix_(rows, rows)], sums[rows, -1]
    size = np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = eigh(G / size / size[:, None])
    keep = values > 1e-12 * values[-1]
    root = np.sqrt(values[keep])
    target = (vectors[:, keep].T @ (c / size)) / root
    coefficients, _ = nnls(root[:, None] * vectors[:, keep].T, target)
    return np.asarray(coefficients / size)


def _squares(sums: Array, rows: NDArray[np.intp], coefficients: Array) -> float:
    """Sum of squares that coefficients leave."""
    left = np.append(-coefficients, 1.0)
    rows = np.append(rows, len(sums) - 1)
    return float(max(left @ sums[np.ix_(rows, rows)] @ left, 0.0))
