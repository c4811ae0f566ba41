"""Models like an identified one, as likely as the recordings leave them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.pseudo_inertia import (
    inertial_from_pseudo,
    nominal_bodies,
    pseudo_inertia,
)
from hybrid.effects import Effect
from hybrid.errors import HybridError
from hybrid.model.dynamic_model import DynamicModel

_THIN = 1e-6  # smallest width of a drawn link, as a share of the usual one, squared


def sample(
    model: DynamicModel, n: int, seed: int | np.random.Generator = 0
) -> tuple[DynamicModel, ...]:
    """Draw models from the posterior of an identified one.

    Base parameters and linear gains are drawn together, by their covariance; gains that
    it does not have by their own standard deviation. Links that could not be built
    become the nearest that could, and friction below zero is none.

    Args:
        model: An identified model with links that could be built.
        n: How many.
        seed: Seed or generator.

    Raises:
        HybridError: The model has no such links, or was saved without a covariance.
    """
    if model.inertial is None or not model.covariance.size:
        raise HybridError(
            "ranges need links that could be built and how sure their numbers are; "
            "identify again with consistent=True, on the command line --consistent"
        )
    factor = _factor(model.covariance)
    spread = _spread(model)
    rng = np.random.default_rng(seed)
    return tuple(_draw(model, factor, spread, rng) for _ in range(n))


def _draw(
    model: DynamicModel, factor: Array, spread: Array, rng: np.random.Generator
) -> DynamicModel:
    assert model.inertial is not None
    rigid = np.array(model.base.kept) < 10 * model.robot.size
    change = factor @ rng.standard_normal(factor.shape[1])
    inertial = model.inertial + (spread @ change[rigid]).reshape(-1, 10)
    names = [label for k, label in enumerate(model.base.kept_labels) if not rigid[k]]
    gains = dict(zip(names, change[~rigid], strict=True))
    effects = tuple(_moved(model, e, gains, rng) for e in model.effects)
    links = _physical(model, inertial)
    return replace(model, inertial=links, effects=effects, simpler={})


def _physical(model: DynamicModel, inertial: Array) -> Array:
    """Links that could be built: no principal part of a pseudo-inertia below zero."""
    assert model.inertial is not None
    root = np.linalg.cholesky(nominal_bodies(model.robot.chain, model.inertial))
    inverse = np.linalg.inv(root)
    X = inverse @ pseudo_inertia(inertial) @ inverse.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(X)
    X = (vectors * np.maximum(values, _THIN)[:, None]) @ vectors.transpose(0, 2, 1)
    found = inertial_from_pseudo(root @ X @ root.transpose(0, 2, 1))
    there = np.any(model.inertial, axis=1, keepdims=True)
    return np.where(there, found, model.inertial)


def _moved(
    model: DynamicModel,
    effect: Effect,
    gains: dict[str, float],
    rng: np.random.Generator,
) -> Effect:
    joints = "+".join(model.robot.joints[j] for j in effect.joints)
    least = dict(zip((g.name for g in effect.gains), effect.least_gains, strict=True))
    values = {}
    for name, low in least.items():
        label = f"{effect.id}.{name}[{joints}]"
        change = gains.get(label, effect.std.get(name, 0.0) * rng.standard_normal())
        if change:
            values[name] = max(effect.values[name] + change, min(low, 0.0))
    return effect.at(values)


def _spread(model: DynamicModel) -> Array:
    """Change of link parameters per change of base ones, shape (10n, rigid).

    Of all that have the torque, that which changes parameters least, of their size.
    """
    assert model.inertial is not None
    count = 10 * model.robot.size
    rigid = np.array(model.base.kept) < count
    M = model.base.mapping[rigid][:, :count]
    size = np.abs(model.inertial).max(axis=0, initial=1e-3)
    scaled = M * np.tile(size, model.robot.size)
    return np.asarray(np.tile(size, model.robot.size)[:, None] * np.linalg.pinv(scaled))


def _factor(covariance: Array) -> Array:
    """A matrix whose product with its transpose is the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
