"""Small neural networks in C: tables, and one function that reads them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hybrid.compensator import NetworkRegression
from hybrid.compensator.gmr import FARTHEST
from hybrid.compensator.network import LOG_VARIANCE
from hybrid.export.c_mixture import lower_triangles, number_tables
from hybrid.robot.chain import Array

_FUNCTION = """
/* Layers of tanh with two heads, for torque and the log of its variance; weights input
 * by input. Where it may be believed say components as those of a mixture. */
typedef struct {{
    int components, inputs, layers;
    const int *sizes;
    const {p}_real *offset, *scale, *whitening, *centre, *weight, *bias;
    {p}_real size, prior, bound, fade_start, fade_end;
}} {p}_network;

static inline {p}_real {p}_network_at(const {p}_network *g, const {p}_real *x,
    {p}_real *variance)
{{
    {p}_real z[{inputs}], from[{width}], to[{width}], distance[{components}];
    {p}_real nearest = 0, near = 0, mean, spread, trust, doubt;
    int at = 0, weight = 0, bias = 0, k, r, i;
    for (i = 0; i < g->inputs; i++) {{
        z[i] = (x[i] - g->offset[i]) / g->scale[i];
        z[i] = {P}_M(fmax)(-{reach}, {P}_M(fmin)(z[i], {reach}));
        from[i] = z[i];
    }}
    for (k = 0; k < g->layers; k++) {{
        const int size = g->sizes[k + 1];
        for (r = 0; r < size; r++) {{
            to[r] = g->bias[bias + r];
        }}
        for (i = 0; i < g->sizes[k]; i++) {{
            for (r = 0; r < size; r++) {{
                to[r] += g->weight[weight + r] * from[i];
            }}
            weight += size;
        }}
        bias += size;
        for (r = 0; r < size; r++) {{
            from[r] = (k < (g->layers - 1)) ? {P}_M(tanh)(to[r]) : to[r];
        }}
    }}
    for (k = 0; k < g->components; k++) {{
        distance[k] = 0;
        for (r = 0; r < g->inputs; r++) {{
            {p}_real w = -g->centre[(k * g->inputs) + r];
            for (i = 0; i <= r; i++) {{
                w += g->whitening[at] * z[i];
                at++;
            }}
            distance[k] += w * w;
        }}
        if ((k == 0) || (distance[k] < nearest)) {{
            nearest = distance[k];
        }}
    }}
    for (k = 0; k < g->components; k++) {{
        near += {P}_M(exp)({half} * (nearest - distance[k]));
    }}
    nearest -= {P}_R(2) * {P}_M(log)(near);
    trust = (g->fade_end - nearest) / (g->fade_end - g->fade_start);
    trust = {P}_M(fmax)({P}_R(0), {P}_M(fmin)(trust, {P}_R(1)));
    trust *= trust * ({P}_R(3) - ({P}_R(2) * trust));
    doubt = {P}_R(1) - trust;
    mean = {P}_M(fmax)(-g->bound, {P}_M(fmin)(g->size * from[0], g->bound));
    spread = {P}_M(fmax)({lowest}, {P}_M(fmin)(from[1], {highest}));
    spread = g->size * g->size * {P}_M(exp)(spread);
    *variance = (trust * (spread + (doubt * mean * mean))) + (doubt * g->prior);
    return trust * mean;
}}
"""


def network_function(
    networks: Sequence[NetworkRegression], marks: Mapping[str, Any]
) -> str:
    """The function, with room for the largest of some networks."""
    P = marks["P"]
    return _FUNCTION.format(
        **marks,
        inputs=max(n.inputs for n in networks),
        width=max(max(n.inputs, *map(len, _biases(n))) for n in networks),
        components=max(len(n.envelope.centre) for n in networks),
        half=f"{P}_R(0.5)",
        reach=f"{P}_R({FARTHEST!r})",
        lowest=f"{P}_R({LOG_VARIANCE[0]!r})",
        highest=f"{P}_R({LOG_VARIANCE[1]!r})",
    )


def _biases(network: NetworkRegression) -> list[Array]:
    return [bias for _, bias in network.layers]


def network_tables(
    k: int, network: NetworkRegression, marks: Mapping[str, Any]
) -> Iterator[str]:
    """The numbers of part k of an arm's remainder."""
    p, P, e = marks["p"], marks["P"], network.envelope
    weights, biases = zip(*network.layers, strict=True)
    tables: dict[str, Array] = {
        "offset": e.offset,
        "scale": e.scale,
        "whitening": lower_triangles(e.whitening),
        "centre": e.centre,
        "weight": np.concatenate([w.ravel() for w in weights]),
        "bias": np.concatenate(biases),
    }
    yield from number_tables(k, tables, marks)
    sizes = ", ".join(str(x) for x in (network.inputs, *(len(b) for b in biases)))
    yield f"static const int {p}_part_{k}_sizes[{len(biases) + 1}] = {{{sizes}}};\n"
    single = (network.scale[0], e.prior_variance[0], e.bound[0], *e.fade)
    fields = [f"{len(e.centre)}, {network.inputs}, {len(biases)}"]
    fields += [f"{p}_part_{k}_{x}" for x in ("sizes", *tables)]
    fields += [f"{P}_R({float(x)!r})" for x in single]
    yield f"static const {p}_network {p}_part_{k} = {{\n    "
    yield ",\n    ".join(fields) + "};\n"
