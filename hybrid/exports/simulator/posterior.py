"""Draw models from the posterior of an identified one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from hybrid.arrays import Array, Mask
from hybrid.dynamics.pseudo_inertia import (
    inertial_from_pseudo,
    nominal_bodies,
    pseudo_inertia,
)
from hybrid.dynamics.stacked import gain_labels
from hybrid.effects import Effect
from hybrid.errors import HybridError
from hybrid.model.dynamic_model import DynamicModel

_SURE = 1e-12  # smallest eigenvalue of the gains' correlation, of the largest
_THINNEST = 1e-6  # smallest squared width of a drawn link, relative to the nominal one


def sample(
    model: DynamicModel,
    n: int,
    seed: int | np.random.Generator = 0,
    *,
    links: bool = True,
) -> tuple[DynamicModel, ...]:
    """Draw models from the posterior of an identified one.

    Base parameters and linear gains are drawn from their joint covariance, other gains
    from their own standard deviations. A link that is not physical is replaced by the
    nearest one that is, and gains below their bounds, as negative friction, by the most
    probable ones within them: what all gains together say of the torque stays.

    Args:
        model: An identified model with physically consistent links.
        n: Number of models.
        seed: Seed or generator.
        links: Draw links; else all models have those of the model, and gains are drawn
            given these.

    Raises:
        HybridError: The model has no such links, or was saved without a covariance.
    """
    if model.inertial is None or not model.covariance.size:
        raise HybridError(
            "ranges need links that could be built and how sure their numbers are; "
            "identify again with consistent=True, on the command line --consistent"
        )
    if not links:
        model = replace(model, covariance=_given_links(model))
    values, vectors = np.linalg.eigh(model.covariance)
    factor = np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
    jacobian, bounded, rigid = _link_jacobian(model), _bounded(model), _rigid(model)
    names = np.array(model.base.kept_labels, dtype=object)[~rigid]
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(n):
        change = bounded(factor @ rng.standard_normal(factor.shape[1]))
        gains = dict(zip(names, change[~rigid], strict=True))
        effects = tuple(_changed(model, e, gains, rng) for e in model.effects)
        inertial = _physical(model, (jacobian @ change[rigid]).reshape(-1, 10))
        drawn.append(replace(model, inertial=inertial, effects=effects, simpler={}))
    return tuple(drawn)


def _rigid(model: DynamicModel) -> Mask:
    """Which base parameters are of the links, shape (b,)."""
    return np.array(model.base.kept) < 10 * model.robot.size


def _given_links(model: DynamicModel) -> Array:
    """Covariance of the gains if the links are known, which do not vary then."""
    C, rigid = model.covariance, _rigid(model)
    across = C[np.ix_(~rigid, rigid)]
    known = across @ np.linalg.pinv(C[np.ix_(rigid, rigid)], hermitian=True) @ across.T
    out = np.zeros_like(C)
    out[np.ix_(~rigid, ~rigid)] = C[np.ix_(~rigid, ~rigid)] - known
    return out


def _bounded(model: DynamicModel) -> Callable[[Array], Array]:
    """The most probable change of parameters near another one, shape (b,).

    It is the nearest with which all gains are within their bounds.
    """
    least = np.full(len(model.base.kept), -np.inf)
    at = {label: k for k, label in enumerate(model.base.kept_labels)}
    for effect in model.effects:
        labels = gain_labels(model.robot.joints, model.effects, effect)
        bounds = zip(effect.gains, effect.least_gains, labels, strict=True)
        for gain, low, label in bounds:
            if label in at:
                least[at[label]] = min(low, 0.0) - effect.values[gain.name]
    held = np.flatnonzero(np.isfinite(least))
    own = model.covariance[np.ix_(held, held)]
    size = np.sqrt(np.maximum(np.diagonal(own), 0.0))
    size[size == 0.0] = 1.0  # of what is certain
    values, vectors = np.linalg.eigh(own / np.outer(size, size))
    values = np.maximum(values, _SURE * values.max(initial=1.0))
    root = (vectors / np.sqrt(values)).T  # of the inverse correlation
    follow = (model.covariance[:, held] / size) @ root.T @ root
    lowest = least[held] / size

    def bounded(change: Array) -> Array:
        wanted = change[held] / size
        if (wanted >= lowest).all():
            return change
        above, _ = nnls(root, root @ (wanted - lowest))
        found = change + follow @ (lowest + above - wanted)
        found[held] = (lowest + above) * size
        return np.asarray(found)

    return bounded


def _physical(model: DynamicModel, change: Array) -> Array:
    """Change links, to physical ones, whose pseudo-inertia has positive eigenvalues."""
    assert model.inertial is not None
    root = np.linalg.cholesky(nominal_bodies(model.robot.chain, model.inertial))
    inverse = np.linalg.inv(root)
    X = inverse @ pseudo_inertia(model.inertial + change) @ inverse.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(X)
    X = (vectors * np.maximum(values, _THINNEST)[:, None]) @ vectors.transpose(0, 2, 1)
    found = inertial_from_pseudo(root @ X @ root.transpose(0, 2, 1))
    has_mass = np.any(model.inertial, axis=1, keepdims=True)
    return np.where(has_mass, found, model.inertial)


def _changed(
    model: DynamicModel,
    effect: Effect,
    gains: dict[str, float],
    rng: np.random.Generator,
) -> Effect:
    labels = gain_labels(model.robot.joints, model.effects, effect)
    values = {}
    for gain, low, label in zip(effect.gains, effect.least_gains, labels, strict=True):
        alone = effect.std.get(gain.name, 0.0) * rng.standard_normal()
        change = gains.get(label, alone)
        if change:
            values[gain.name] = max(effect.values[gain.name] + change, min(low, 0.0))
    return effect.at(values)


def _link_jacobian(model: DynamicModel) -> Array:
    """Change of link parameters per change of base parameters, shape (10n, rigid).

    It is the change with the least norm, relative to the size of the parameters.
    """
    assert model.inertial is not None
    M = model.base.mapping[_rigid(model)][:, : 10 * model.robot.size]
    size = np.abs(model.inertial).max(axis=0, initial=1e-3)
    size = np.tile(size, model.robot.size)
    return np.asarray(size[:, None] * np.linalg.pinv(M * size))
