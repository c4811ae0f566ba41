"""The learned part of a model as ONNX nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.gmr import FARTHEST
from hybrid.errors import HybridError

if TYPE_CHECKING:
    from hybrid.exports.onnx_graph import Graph


def regression_nodes(graph: Graph, regression: object, x: str) -> tuple[str, str]:
    """Mean and variance, shape (N, 1) each, of one joint's regression.

    Args:
        graph: Where to add the nodes.
        regression: What was learned.
        x: Name of its inputs, shape (N, d).

    Raises:
        HybridError: It is of a kind that has no ONNX.
    """
    if isinstance(regression, GaussianMixtureRegression):
        return _mixture(graph, regression, x)
    kind = getattr(regression, "kind", type(regression).__name__)
    raise HybridError(
        f"a remainder of kind {kind} has no ONNX; valid is gmr, and the format "
        "torchscript takes every kind"
    )


def _mixture(
    graph: Graph, mixture: GaussianMixtureRegression, x: str
) -> tuple[str, str]:
    node, constant, c = graph.node, graph.constant, mixture.conditional
    z = _standardised(graph, x, mixture.input_offset, mixture.input_scale)
    w, distance = _distances(graph, z, c.whitening, c.centre)
    reply = graph.sum(node("Mul", w, constant(c.gain[:, 0])), 2, keepdims=0)
    reply = node("Add", reply, constant(c.output_mean[:, 0]))
    nearest, closeness = _closeness(graph, distance)
    weight = constant(np.exp(c.log_weight - c.log_weight.max()))
    share = node("Mul", closeness, weight)
    share = node("Div", share, graph.sum(share, 1))
    mean = graph.sum(node("Mul", share, reply), 1)
    mean = _within(graph, mean, -float(mixture.bound[0]), float(mixture.bound[0]))
    off = node("Sub", reply, mean)
    spread = node("Add", node("Mul", off, off), constant(c.output_variance[:, 0]))
    spread = graph.sum(node("Mul", share, spread), 1)
    trust = _trust(graph, nearest, closeness, mixture.fade)
    return _blended(graph, trust, mean, spread, mixture.prior_variance)


def _standardised(graph: Graph, x: str, offset: Array, scale: Array) -> str:
    z = graph.node("Sub", x, graph.constant(offset))
    z = graph.node("Div", z, graph.constant(scale))
    return _within(graph, z, -FARTHEST, FARTHEST)


def _distances(
    graph: Graph, z: str, whitening: Array, centre: Array
) -> tuple[str, str]:
    """Whitened inputs, shape (N, K, d), and squared distances, shape (N, K)."""
    node, constant = graph.node, graph.constant
    k, d = centre.shape
    w = node("MatMul", z, constant(whitening.reshape(k * d, d).T))
    w = node("Sub", w, constant(centre.reshape(1, k * d)))
    w = node("Reshape", w, constant([-1, k, d], np.int64))
    return w, graph.sum(node("Mul", w, w), 2, keepdims=0)


def _closeness(graph: Graph, distance: str) -> tuple[str, str]:
    """Smallest distance, shape (N, 1), and exponentials of half the others less it."""
    node, constant = graph.node, graph.constant
    nearest = node("ReduceMin", distance, constant([1], np.int64), keepdims=1)
    half = node("Mul", node("Sub", nearest, distance), constant([0.5]))
    return nearest, node("Exp", half)


def _trust(graph: Graph, nearest: str, closeness: str, fade: Array) -> str:
    node, constant = graph.node, graph.constant
    log = node("Log", graph.sum(closeness, 1))
    soft = node("Sub", nearest, node("Mul", log, constant([2.0])))
    start, end = (float(f) for f in fade)
    u = node("Div", node("Sub", constant([end]), soft), constant([end - start]))
    u = _within(graph, u, 0.0, 1.0)
    rise = node("Sub", constant([3.0]), node("Mul", u, constant([2.0])))
    return node("Mul", node("Mul", u, u), rise)


def _blended(
    graph: Graph, trust: str, mean: str, spread: str, prior: Array
) -> tuple[str, str]:
    """Mean and variance, handed over to the prior where they are not believed."""
    node, constant = graph.node, graph.constant
    doubt = node("Sub", constant([1.0]), trust)
    square = node("Mul", doubt, node("Mul", mean, mean))
    known = node("Mul", trust, node("Add", spread, square))
    unknown = node("Mul", doubt, constant(prior))
    return node("Mul", trust, mean), node("Add", known, unknown)


def _within(graph: Graph, x: str, low: float, high: float) -> str:
    x = graph.node("Min", x, graph.constant([high]))
    return graph.node("Max", x, graph.constant([low]))
