"""Write a program as one C99 header without allocation or recursion, needing only libm.

The code follows MISRA C where it stays readable: braces everywhere, no side effects in
expressions, loops of fixed length, and a returned status.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from hybrid import __version__
from hybrid.dynamics import Law
from hybrid.errors import HybridError
from hybrid.model.program import Program
from hybrid.names import c_comment, c_identifier
from hybrid.robot import Robot

# Operations of a tape on {0}, {1} and {2}.
_OPERATIONS = {
    "add": "{0} + {1}", "subtract": "{0} - {1}", "multiply": "{0} * {1}",
    "divide": "{0} / {1}", "negative": "-{0}", "power": "{P}_M(pow)({0}, {1})",
    "less": "({0} < {1}) ? {P}_R(1) : {P}_R(0)",
    "less_equal": "({0} <= {1}) ? {P}_R(1) : {P}_R(0)",
    "greater": "({0} > {1}) ? {P}_R(1) : {P}_R(0)",
    "greater_equal": "({0} >= {1}) ? {P}_R(1) : {P}_R(0)",
    "where": "({0} > {P}_R(0.5)) ? {1} : {2}",
    "minimum": "({0} < {1}) ? {0} : {1}", "maximum": "({0} > {1}) ? {0} : {1}",
    "sign": "({0} > {P}_R(0)) ? {P}_R(1) : (({0} < {P}_R(0)) ? -{P}_R(1) : {P}_R(0))",
    "absolute": "{P}_M(fabs)({0})", "sqrt": "{P}_M(sqrt)({0})",
    "exp": "{P}_M(exp)({0})", "log": "{P}_M(log)({0})", "sin": "{P}_M(sin)({0})",
    "cos": "{P}_M(cos)({0})", "tanh": "{P}_M(tanh)({0})",
}  # fmt: skip

_HEADER = """\
/* Drive torque of {robot}, from positions, speeds and accelerations.
 *
 * Joints in order, with units and limits of position, speed and torque:
{joints}
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

#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || \\
    (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))
#error "fast math removes the checks for numbers that are not finite; leave it out"
#endif

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

/* What {p}_torque returns: NOT_FINITE, or else the sum of the others. */
#define {P}_OK 0
#define {P}_NOT_FINITE (-1)   /* an input or a torque is; nothing was written */
#define {P}_OUT_OF_RANGE 1    /* a position or a speed is beyond the joint's limits */
#define {P}_CLAMPED 2         /* a torque was beyond its limit, and is that limit now */

/* Limits of each joint, in its units; INFINITY where the arm's file states none. */
{limits}

/* State of the model between calls. The caller owns one for each arm; {p}_start sets
 * it. */
typedef struct {{
    {p}_real step;  /* time between calls [s] */
    double t;     /* time since the start [s] */
    int known;      /* whether there was a call before */
    {p}_real clamp[{n}];  /* limit of each torque, 0 or more: INFINITY for none */
{memory}}} {p}_state;

/* Reset the state: the arm is assumed to have been at rest or at constant speed.
 * Torques are limited to the rated ones; write other limits into clamp afterwards. */
static inline void {p}_start({p}_state *s, {p}_real step)
{{
    int j;
    s->step = step;
    s->t = 0.0;
    s->known = 0;
    for (j = 0; j < {n}; j++) {{
        s->clamp[j] = {p}_tau_max[j];
    }}
{forget}}}
"""

_TORQUE = """
/* Torque tau for positions q, speeds v and accelerations a, and the variance of its
 * learned part (NaN at joints where nothing was learned; may be NULL).
 *
 * Returns {P}_OK, {P}_NOT_FINITE (and then writes nothing), or a sum of
 * {P}_OUT_OF_RANGE and {P}_CLAMPED. */
static inline int {p}_torque({p}_state *s, const {p}_real q[{n}],
    const {p}_real v[{n}], const {p}_real a[{n}], {p}_real tau[{n}],
    {p}_real variance[{n}])
{{
    {p}_real out[{n}];
    {p}_real spread[{n}];
{room}    int outside = {P}_OK;
    int clamped = {P}_OK;
    int j;
    for (j = 0; j < {n}; j++) {{
        if (!isfinite(q[j]) || !isfinite(v[j]) || !isfinite(a[j]) ||
            !(s->clamp[j] >= {P}_R(0))) {{
            return {P}_NOT_FINITE;
        }}
        if ((q[j] < {p}_q_min[j]) || (q[j] > {p}_q_max[j]) ||
            ({P}_M(fabs)(v[j]) > {p}_v_max[j])) {{
            outside = {P}_OUT_OF_RANGE;
        }}
        spread[j] = {P}_R(NAN);
    }}
{lines}
{outputs}
    for (j = 0; j < {n}; j++) {{
        if (!isfinite(out[j])) {{
            return {P}_NOT_FINITE;
        }}
        if ({P}_M(fabs)(out[j]) > s->clamp[j]) {{
            out[j] = (out[j] > {P}_R(0)) ? s->clamp[j] : -s->clamp[j];
            clamped = {P}_CLAMPED;
        }}
    }}
{kept}    for (j = 0; j < {n}; j++) {{
        tau[j] = out[j];
        if (variance != NULL) {{
            variance[j] = spread[j];
        }}
    }}
    s->t += (double)s->step;
    s->known = 1;
    return outside + clamped;
}}

#endif
"""

_KEPT = """\
    for (j = 0; j < {size}; j++) {{
        if (!isfinite(keep[j])) {{
            return {P}_NOT_FINITE;
        }}
    }}
    for (j = 0; j < {size}; j++) {{
        s->memory[j] = keep[j];
    }}
"""

_FORGET = """\
    for (j = 0; j < {size}; j++) {{
        s->memory[j] = {P}_R(0);
    }}
"""
LIMITS = ("q_min", "q_max", "v_max", "tau_max")


def c_header(program: Program, robot: Robot, digest: str) -> str:
    """Write the header."""
    p, n, size = c_identifier(robot.name), robot.size, len(program.memory)
    marks: dict[str, Any] = {"p": p, "P": p.upper(), "n": n, "size": size}
    slots = [f"     * {i}: {name}" for i, name in enumerate(program.memory_names)]
    memory = "\n".join(["    /*", *slots, f"     */\n    {p}_real memory[{size}];\n"])
    head = _HEADER.format(
        **marks,
        robot=c_comment(robot.name),
        joints="\n".join(_joint(robot, k) for k in range(n)),
        digest=digest,
        version=__version__,
        fingerprint=robot.fingerprint(),
        limits="\n".join(_limits(robot, name, marks) for name in LIMITS),
        memory=memory if size else "",
        forget=_FORGET.format(**marks) if size else "",
    )
    lines, outputs = _statements(program, marks)
    body = _TORQUE.format(
        **marks,
        room=f"    {p}_real keep[{size}];\n" if size else "",
        lines=lines,
        outputs=outputs,
        kept=_KEPT.format(**marks) if size else "",
    )
    return head + body


def _joint(robot: Robot, k: int) -> str:
    """Line of a joint in the comment at the top."""
    units = (robot.chain.unit_at([k], x) for x in ("rad", "rad/s", "N·m"))
    q, v, tau = (x.replace("·", " ") for x in units)
    low, high, speed, most = (float(getattr(robot, name)[k]) for name in LIMITS)
    return (
        f" *   {k + 1} {c_comment(robot.joints[k])}: {low:.6g} to {high:.6g} {q}, "
        f"{speed:.6g} {v}, {most:.6g} {tau}"
    )


def _limits(robot: Robot, name: str, marks: dict[str, Any]) -> str:
    p, P, n = marks["p"], str(marks["P"]), marks["n"]
    numbers = [c_number(float(x), P, finite=False) for x in getattr(robot, name)]
    return f"static const {p}_real {p}_{name}[{n}] = {{\n    {_wrapped(numbers)}}};"


def _wrapped(numbers: Sequence[str]) -> str:
    return ",\n    ".join(
        ", ".join(numbers[i : i + 3]) for i in range(0, len(numbers), 3)
    )


def _statements(program: Program, marks: dict[str, Any]) -> tuple[str, str]:
    """Lines that compute every operation, and lines that set the outputs."""
    p, P = marks["p"], str(marks["P"])
    lines: list[str] = []

    def text(x: str | float) -> str:
        return x if isinstance(x, str) else c_number(float(x), P)

    def put(template: str, *given: str | float) -> str:
        name, value = f"x{len(lines)}", template.format(*map(text, given), P=P)
        lines.append(f"    const {p}_real {name} = {value};")
        return name

    law = Law(program.tape, program.results, program.inputs)
    found = law.by({name: partial(put, x) for name, x in _OPERATIONS.items()})
    results = found(*(_input(name, P) for name in program.inputs))
    sizes = {"out": program.torque, "spread": program.variance, "keep": program.memory}
    targets = [(name, j) for name, x in sizes.items() for j in range(len(x))]
    outputs = [
        f"    {name}[{j}] = {text(x)};"
        for (name, j), x in zip(targets, results, strict=True)
        if name != "spread" or isinstance(x, str)  # nothing was learned of a joint
    ]
    return "\n".join(lines), "\n".join(outputs)


def _input(name: str, P: str) -> str:
    """An input of the tape in C; the time is always in double precision."""
    if name[0] in "qva":
        return name
    return f"s->{name}" if name[:6] in ("memory", "step") else f"{P}_R(s->{name})"


def c_number(x: float, P: str, *, finite: bool = True) -> str:
    """Write a number in C with all digits.

    Raises:
        HybridError: It is NaN, or infinite although it must be ``finite``.
    """
    if math.isfinite(x):
        return f"{P}_R({x!r})"
    if finite or math.isnan(x):
        raise HybridError(f"the model has the number {x}; valid are finite ones")
    return f"{P}_R({'-' if x < 0 else ''}INFINITY)"
