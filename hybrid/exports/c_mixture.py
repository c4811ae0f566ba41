"""Gaussian mixtures in C: tables, and one function that reads them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.gmr import FARTHEST, GaussianMixtureRegression

_FUNCTION = """
/* A Gaussian mixture conditioned on its inputs; matrices row by row, the whitening of
 * each component as its lower triangle. */
typedef struct {{
    int components, inputs;
    const {p}_real *offset, *scale, *whitening, *centre, *gain;
    const {p}_real *mean, *variance, *weight;
    {p}_real prior, bound, fade_start, fade_end;
}} {p}_gmr;

static inline {p}_real {p}_gmr_at(const {p}_gmr *g, const {p}_real *x,
    {p}_real *variance)
{{
    {p}_real z[{inputs}], distance[{components}], output[{components}];
    {p}_real nearest = 0, near = 0, total = 0, mean = 0, spread = 0, trust, doubt;
    int at = 0, k, r, i;
    for (i = 0; i < g->inputs; i++) {{
        z[i] = (x[i] - g->offset[i]) / g->scale[i];
        z[i] = {P}_M(fmax)(-{reach}, {P}_M(fmin)(z[i], {reach}));
    }}
    for (k = 0; k < g->components; k++) {{
        distance[k] = 0;
        output[k] = g->mean[k];
        for (r = 0; r < g->inputs; r++) {{
            {p}_real w = -g->centre[(k * g->inputs) + r];
            for (i = 0; i <= r; i++) {{
                w += g->whitening[at] * z[i];
                at++;
            }}
            distance[k] += w * w;
            output[k] += g->gain[(k * g->inputs) + r] * w;
        }}
        if ((k == 0) || (distance[k] < nearest)) {{
            nearest = distance[k];
        }}
    }}
    for (k = 0; k < g->components; k++) {{
        const {p}_real closeness = {P}_M(exp)({half} * (nearest - distance[k]));
        near += closeness;
        distance[k] = g->weight[k] * closeness;  /* from here on: its share */
        total += distance[k];
        mean += distance[k] * output[k];
    }}
    mean = {P}_M(fmax)(-g->bound, {P}_M(fmin)(mean / total, g->bound));
    for (k = 0; k < g->components; k++) {{
        const {p}_real off = output[k] - mean;
        spread += distance[k] * (g->variance[k] + (off * off));
    }}
    nearest -= {P}_R(2) * {P}_M(log)(near);
    trust = (g->fade_end - nearest) / (g->fade_end - g->fade_start);
    trust = {P}_M(fmax)({P}_R(0), {P}_M(fmin)(trust, {P}_R(1)));
    trust *= trust * ({P}_R(3) - ({P}_R(2) * trust));
    doubt = {P}_R(1) - trust;
    *variance = (trust * ((spread / total) + (doubt * mean * mean)))
        + (doubt * g->prior);
    return trust * mean;
}}
"""


def mixture_function(
    mixtures: Sequence[GaussianMixtureRegression], marks: Mapping[str, Any]
) -> str:
    """The function, with room for the largest of some mixtures."""
    P = marks["P"]
    return _FUNCTION.format(
        **marks,
        inputs=max(m.inputs for m in mixtures),
        components=max(m.components for m in mixtures),
        half=f"{P}_R(0.5)",
        reach=f"{P}_R({FARTHEST!r})",
    )


def mixture_tables(
    k: int, mixture: GaussianMixtureRegression, marks: Mapping[str, Any]
) -> Iterator[str]:
    """The numbers of part k of an arm's remainder."""
    p, P, c = marks["p"], marks["P"], mixture.conditional
    tables: dict[str, Array] = {
        "offset": mixture.input_offset,
        "scale": mixture.input_scale,
        "whitening": lower_triangles(c.whitening),
        "centre": c.centre,
        "gain": c.gain[:, 0],
        "mean": c.output_mean[:, 0],
        "variance": c.output_variance[:, 0],
        "weight": np.exp(c.log_weight - c.log_weight.max()),
    }
    yield from number_tables(k, tables, marks)
    single = (mixture.prior_variance[0], mixture.bound[0], *mixture.fade)
    fields = [f"{mixture.components}, {mixture.inputs}"]
    fields += [f"{p}_part_{k}_{x}" for x in tables]
    fields += [f"{P}_R({float(x)!r})" for x in single]
    yield f"static const {p}_gmr {p}_part_{k} = {{\n    "
    yield ",\n    ".join(fields) + "};\n"


def lower_triangles(matrices: Array) -> Array:
    """Lower triangles, row by row, of matrices of shape (K, d, d)."""
    rows, columns = np.tril_indices(matrices.shape[1])
    return np.asarray(matrices[:, rows, columns])


def number_tables(
    k: int, tables: Mapping[str, Array], marks: Mapping[str, Any]
) -> Iterator[str]:
    """Arrays of part k, by name."""
    p, P = marks["p"], marks["P"]
    yield "\n"
    for name, values in tables.items():
        numbers = [f"{P}_R({x!r})" for x in values.ravel().tolist()]
        text = ",\n    ".join(
            ", ".join(numbers[i : i + 3]) for i in range(0, len(numbers), 3)
        )
        yield f"static const {p}_real {p}_part_{k}_{name}[{values.size}] = {{\n"
        yield f"    {text}}};\n"
