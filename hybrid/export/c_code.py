"""A program as one C99 header: no allocation, no recursion, no dependency but libm."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from hybrid.dynamics.tape import Operation, Symbol
from hybrid.export.c_remainder import function_name, remainder_code
from hybrid.export.program import Program

_INFIX = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/"}
_COMPARED = {"less": "<", "less_equal": "<=", "greater": ">", "greater_equal": ">="}
_FUNCTIONS = {
    "power": "pow", "absolute": "fabs", "sqrt": "sqrt", "exp": "exp", "log": "log",
    "sin": "sin", "cos": "cos", "tanh": "tanh",
}  # fmt: skip

_HEADER = """\
/* Drive torque of {robot}, from positions, speeds and accelerations.
 *
 * Joint order: {joints}
 * Model SHA-256: {digest}
 * Written by hybrid {version}. Do not edit: export the model again.
 *
 * C99, no allocation, no loop whose length depends on data. Define {P}_SINGLE before
 * the #include for single precision.
 */
#ifndef {P}_H
#define {P}_H

#include <math.h>
#include <stddef.h>

#ifdef {P}_SINGLE
typedef float {p}_real;
#define {P}_M(name) name##f
#else
typedef double {p}_real;
#define {P}_M(name) name
#endif
#define {P}_R(x) (({p}_real)(x))

#define {P}_JOINTS {n}
#define {P}_MODEL "{digest}"
#define {P}_ROBOT "{fingerprint}"

/* What the model remembers from one call to the next. Owned by the caller, one for each
 * arm; {p}_start sets it. */
typedef struct {{
    {p}_real step;  /* time between calls [s] */
    {p}_real t;     /* time since the start [s] */
    int known;      /* whether there was a call before */
{memory}}} {p}_state;

/* Start anew: the arm has stood, or moved evenly, until now. */
static inline void {p}_start({p}_state *s, {p}_real step)
{{
    s->step = step;
    s->t = 0;
    s->known = 0;
{forget}}}
"""

_TORQUE = """
/* Torque tau [N m] for q [rad], v [rad/s] and a [rad/s^2], and the variance [(N m)^2]
 * of its learned part (NaN at joints where nothing was learned; may be NULL).
 *
 * Returns 0; or -1 and writes nothing if a number is not finite. */
static inline int {p}_torque({p}_state *s, const {p}_real q[{n}],
    const {p}_real v[{n}], const {p}_real a[{n}], {p}_real tau[{n}],
    {p}_real variance[{n}])
{{
    int j;
    for (j = 0; j < {n}; j++) {{
        if (!isfinite(q[j]) || !isfinite(v[j]) || !isfinite(a[j]))
            return -1;
    }}
{lines}
{outputs}
    s->t += s->step;
    s->known = 1;
    return 0;
}}

#endif
"""


def c_name(robot: str) -> str:
    """The robot's name as a C identifier."""
    name = re.sub(r"\W", "_", robot, flags=re.ASCII).strip("_").lower()
    return name if name and not name[0].isdigit() else f"arm_{name}"


def c_header(
    program: Program, *, robot: str, fingerprint: str, digest: str, version: str
) -> str:
    """The header's text.

    Args:
        program: What to write.
        robot: Name of the arm; its functions start with it.
        fingerprint: Short hash of the arm's kinematics.
        digest: Hash of the model.
        version: Version of this package.

    Raises:
        HybridError: The learned remainder has no C.
    """
    p, n, size = c_name(robot), len(program.joints), len(program.memory)
    marks: dict[str, Any] = {"p": p, "P": p.upper(), "n": n}
    slots = [f"     * {i}: {name}" for i, name in enumerate(program.memory_names)]
    memory = "\n".join(["    /*", *slots, f"     */\n    {p}_real memory[{size}];\n"])
    forget = f"    for (int i = 0; i < {size}; i++)\n        s->memory[i] = 0;\n"
    head = _HEADER.format(
        **marks,
        robot=robot,
        joints=", ".join(program.joints),
        digest=digest,
        version=version,
        fingerprint=fingerprint,
        memory=memory if size else "",
        forget=forget if size else "",
    )
    remainder = ""
    if program.remainder is not None and program.remainder.parts:
        remainder = remainder_code(program.remainder, marks)
    body = _TORQUE.format(
        **marks,
        lines="\n".join(_lines(program, marks)),
        outputs="\n".join(_outputs(program, marks)),
    )
    return head + remainder + body


def _lines(program: Program, marks: dict[str, Any]) -> Iterator[str]:
    P = str(marks["P"])
    wanted = program.results if _has_remainder(program) else (
        *program.torque, *program.memory
    )  # fmt: skip
    for line in program.tape.needed(wanted):
        text = _expression(program.tape.lines[line], P)
        yield f"    const {marks['p']}_real x{line} = {text};"


def _expression(operation: Operation, P: str) -> str:
    name = operation.name
    if name == "input":
        text = str(operation.arguments[0])
        if text[0] in "qva":
            return text
        return f"{P}_R(s->known)" if text == "known" else f"s->{text}"
    x = [
        f"x{y}" if isinstance(y, int) else c_number(float(y), P)
        for y in operation.arguments
    ]
    one, zero = f"{P}_R(1)", f"{P}_R(0)"
    if name in _INFIX:
        return f"{x[0]} {_INFIX[name]} {x[1]}"
    if name in _COMPARED:
        return f"{x[0]} {_COMPARED[name]} {x[1]} ? {one} : {zero}"
    if name in _FUNCTIONS:
        return f"{P}_M({_FUNCTIONS[name]})({', '.join(x)})"
    return {
        "negative": "-{0}",
        "sign": f"{P}_R(({{0}} > 0) - ({{0}} < 0))",
        "minimum": "{0} < {1} ? {0} : {1}",
        "maximum": "{0} > {1} ? {0} : {1}",
        "where": f"{{0}} > {P}_R(0.5) ? {{1}} : {{2}}",
    }[name].format(*x)


def _outputs(program: Program, marks: dict[str, Any]) -> Iterator[str]:
    p, P, n = marks["p"], str(marks["P"]), len(program.joints)

    def value(x: Any) -> str:
        return f"x{x.line}" if isinstance(x, Symbol) else c_number(float(x), P)

    for j, x in enumerate(program.torque):
        yield f"    tau[{j}] = {value(x)};"
    yield "    if (variance != NULL) {"
    yield f"        for (j = 0; j < {n}; j++)\n            variance[j] = {P}_R(NAN);"
    yield "    }"
    for k, part in enumerate(program.remainder.parts if program.remainder else ()):
        seen = [*part.positions, *(n + j for j in part.speeds)]
        inputs = ", ".join(value(program.state[i]) for i in seen)
        yield "    {"
        yield f"        const {p}_real x[{len(seen)}] = {{{inputs}}};"
        yield f"        {p}_real spread;"
        law = function_name(part.regression)
        yield f"        tau[{part.joint}] += {p}_{law}(&{p}_part_{k}, x, &spread);"
        yield "        if (variance != NULL)"
        yield f"            variance[{part.joint}] = spread;"
        yield "    }"
    for i, x in enumerate(program.memory):
        yield f"    s->memory[{i}] = {value(x)};"


def _has_remainder(program: Program) -> bool:
    return program.remainder is not None and bool(program.remainder.parts)


def c_number(x: float, P: str) -> str:
    """A number as C writes it, to the last bit."""
    return f"{P}_R({x!r})"
