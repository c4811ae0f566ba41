"""Nonlinear friction of one joint: threshold, width and non-negative coefficients.

The law is linear in its coefficients once threshold λ and width are given. Every pair
on a fine grid is a set of columns in one dictionary, whose cross-products are
accumulated once; the search over λ is then a search over small non-negative
least-squares problems.

Source: Lawson and Hanson 1974, doi 10.1137/1.9781611971217 (non-negative least
squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import nnls

from hybrid.effects import Effect, JointState
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.identify.cross_products import moving_samples, sampled_chunks
from hybrid.identify.data import FOLDS, helps
from hybrid.robot.chain import Array
from hybrid.signals import Motion, Sampler

_THRESHOLDS = 16
_WIDTHS = (0.0, 0.01, 0.04)  # of the joint's highest speed
_SMALLEST_THRESHOLD = 0.01  # of the joint's highest speed
_WORTH = 0.01  # least relative fall of squares for load friction to stay


@dataclass(frozen=True)
class _Dictionary:
    """Columns of one joint for every threshold and width."""

    thresholds: Array
    widths: Array

    @property
    def shapes(self) -> list[tuple[float, float]]:
        return [(x, w) for w in self.widths for x in self.thresholds if w < x]

    def columns(self, state: JointState) -> Array:
        """All columns, the load column last; shape (8·shapes + 1, N)."""
        rows = [
            np.stack(ThresholdFriction.law(state, threshold=x, width=w))
            for x, w in self.shapes
        ]
        load = np.stack(LoadFriction.law(state))
        return np.concatenate([*rows, load])


def fit_friction(
    joint: int,
    motions: Sequence[Motion],
    rest: Sequence[Array],
    load: Sequence[Array],
    *,
    known: Sequence[Array] | None,
    cutoff: float,
    standing: float,
    folds: Sequence[NDArray[np.intp]],
) -> tuple[tuple[Effect, ...], Array]:
    """Friction of one joint from what the rigid body leaves of its torque.

    Args:
        joint: The joint.
        motions: Motions at full rate.
        rest: Torque less everything but friction, shape (N,) for each motion, [N·m].
        load: Torque transmitted to the link, shape (N,) for each motion, [N·m].
        known: Filtered torque already explained, shape (M,) for the decimated samples
            of each motion, [N·m], or None.
        cutoff: Cut-off of the filter of columns and torque, [Hz].
        standing: Speed below which the joint stands, [rad/s].
        folds: Fold of every sample, shape (N,) for each motion.

    Returns:
        Threshold friction, and load friction where it helps; and the squares left on
        each fold by coefficients from the others, shape (F,), [N²·m²].
    """
    fastest = max(float(np.abs(m.v[m.mask, joint]).max()) for m in motions)
    ratios = np.geomspace(_SMALLEST_THRESHOLD, 1.0, _THRESHOLDS)
    grid = _Dictionary(fastest * ratios, fastest * np.array(_WIDTHS))
    sums = _products(joint, motions, rest, load, known, grid, cutoff, standing, folds)
    own = [np.arange(8 * k, 8 * k + 8) for k in range(len(grid.shapes))]
    loaded = [np.append(rows, 8 * len(grid.shapes)) for rows in own]
    errors = np.array([[_cross_validated(sums, r) for r in x] for x in (own, loaded)])
    without, with_load = errors.sum(axis=2).argmin(axis=1)
    better = helps(errors[0, without], errors[1, with_load], _WORTH)
    k = int(with_load if better else without)
    coefficients = _nonnegative(sums.sum(axis=0), (loaded if better else own)[k])
    names = [g.name for g in ThresholdFriction.gains]
    shapes = dict(zip(("threshold", "width"), grid.shapes[k], strict=True))
    values = _canonical(dict(zip(names, coefficients, strict=False)))
    effects: tuple[Effect, ...] = (ThresholdFriction((joint,), values | shapes),)
    if better:
        effects += (LoadFriction((joint,), {"coefficient": coefficients[8]}),)
    return effects, errors[int(better), k]


def _canonical(values: dict[str, float]) -> dict[str, float]:
    """The same law without a falling and a rising part that cancel to a level."""
    both = min(values["falling"], values["rising"])
    change = {"falling": -both, "rising": -both}
    change |= {"coulomb_positive": both, "coulomb_negative": both}
    return {name: x + change.get(name, 0.0) for name, x in values.items()}


def _products(
    joint: int,
    motions: Sequence[Motion],
    rest: Sequence[Array],
    load: Sequence[Array],
    known: Sequence[Array] | None,
    grid: _Dictionary,
    cutoff: float,
    standing: float,
    folds: Sequence[NDArray[np.intp]],
) -> Array:
    """Cross-products of [columns, rest] of each fold, shape (F, rows, rows)."""
    size = 8 * len(grid.shapes) + 2
    sums = np.zeros((FOLDS, size, size))
    for r, motion in enumerate(motions):
        y, carried, fold = rest[r], load[r], folds[r]
        sampler = Sampler.for_rate(motion.rate, cutoff)
        moving = moving_samples(motion, sampler, np.full(motion.q.shape[1], standing))
        start = motion.t[0]

        def rows(
            part: Motion, y: Array = y, carried: Array = carried, start: float = start
        ) -> Array:
            first = round((part.t[0] - start) * part.rate)
            here = slice(first, first + len(part.t))
            v = part.v[:, joint]
            state = JointState(
                part.t, part.q[:, joint], v, part.a[:, joint], np.sign(v), carried[here]
            )
            return np.concatenate([grid.columns(state), y[None, here]])

        for first, D in sampled_chunks(rows, motion, sampler):
            here = slice(first, first + D.shape[1])
            if known is not None:
                D[-1] -= known[r][here]
            own = fold[:: sampler.factor][here]
            for k in np.unique(own):
                part = D[:, moving[here, joint] & (own == k)]
                sums[k] += part @ part.T
    return sums


def _cross_validated(sums: Array, rows: NDArray[np.intp]) -> Array:
    """Squares left on each fold by coefficients from the others, shape (F,)."""
    total = sums.sum(axis=0)
    return np.array([_squares(s, rows, _nonnegative(total - s, rows)) for s in sums])


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
