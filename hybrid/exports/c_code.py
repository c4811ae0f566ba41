"""Write a program as one C99 header without allocation or recursion, needing only libm.

An example and a build file come with it.

The code follows MISRA C where it stays readable: braces everywhere, no side effects in
expressions, loops of fixed length, and a returned status.
"""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hybrid import __version__
from hybrid.arrays import Array
from hybrid.dynamics import Law
from hybrid.errors import HybridError, warn
from hybrid.exports.simulator.model import usual_motion
from hybrid.model.dynamic_model import DynamicModel
from hybrid.model.program import Program
from hybrid.names import c_comment, c_identifier
from hybrid.robot import Robot
from hybrid.templates import render_template

TEMPLATES = Path(__file__).parent / "templates"
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

LIMITS = ("q_min", "q_max", "v_max", "tau_max")


def write_c(model: DynamicModel, program: Program, digest: str, folder: Path) -> None:
    """Write ``<arm>.h``, ``example.c`` and ``CMakeLists.txt``."""
    robot, p = model.robot, c_identifier(model.robot.name)
    _warn_of_clamps(model, program)

    def numbers(x: Array, *, finite: bool = True) -> list[str]:
        return [c_number(float(y), p.upper(), finite=finite) for y in x]

    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.q_min), robot.q_min, -1.0)
    high = np.where(np.isfinite(robot.q_max), robot.q_max, 1.0)
    q = rng.uniform(low, high)[None]
    v, a = rng.uniform(-1.0, 1.0, (2, 1, robot.size))
    tau, _ = program.run(q, v, a)
    values, outputs = _statements(program, p.upper())
    content: dict[str, Any] = {
        "p": p,
        "P": p.upper(),
        "n": robot.size,
        "robot": c_comment(robot.name),
        "joints": [_joint(robot, k) for k in range(robot.size)],
        "digest": digest,
        "version": __version__,
        "fingerprint": robot.fingerprint(),
        "limits": {x: numbers(getattr(robot, x), finite=False) for x in LIMITS},
        "memory": program.memory_names,
        "values": values,
        "outputs": outputs,
        "q": numbers(q[0]),
        "v": numbers(v[0]),
        "a": numbers(a[0]),
        "tau": [repr(float(x)) for x in tau[0]],
        "unit": [f'"{x.replace("·", " ")}"' for x in robot.chain.units("N·m")],
    }
    for name in ("arm.h", "example.c", "CMakeLists.txt"):
        text = render_template(TEMPLATES / f"{name}.j2", **content)
        (folder / name.replace("arm", p)).write_text(text, encoding="utf-8")


def _warn_of_clamps(model: DynamicModel, program: Program) -> None:
    """Warn where slow motion of the logs' range is beyond the rating of the file."""
    motion, robot = usual_motion(model), model.robot
    tau, _ = program.run(motion.q, motion.v, np.zeros_like(motion.a))
    peak, unit = np.abs(tau).max(axis=0), robot.chain.units("N·m")
    over = [
        f"{robot.joints[j]} {peak[j]:.4g} of {robot.tau_max[j]:.4g} {unit[j]}"
        for j in np.flatnonzero(peak > robot.tau_max).tolist()
    ]
    if over and model.range:
        warn(
            "torque is clamped to the limits of the robot file, and goes beyond them "
            f"at positions and speeds of the logs: {', '.join(over)}; valid are the "
            "limits of the drives, in the file or in clamp"
        )


def _joint(robot: Robot, k: int) -> str:
    """What the comment at the top says of a joint."""
    units = (robot.chain.unit_at([k], x) for x in ("rad", "rad/s", "N·m"))
    q, v, tau = (x.replace("·", " ") for x in units)
    low, high, speed, most = (float(getattr(robot, name)[k]) for name in LIMITS)
    return (
        f"{c_comment(robot.joints[k])}: {low:.6g} to {high:.6g} {q}, "
        f"{speed:.6g} {v}, {most:.6g} {tau}"
    )


def _statements(program: Program, P: str) -> tuple[list[str], list[tuple[str, str]]]:
    """The values ``x0``, ``x1``, ... of all operations, and the outputs they set."""
    values: list[str] = []

    def text(x: str | float) -> str:
        return x if isinstance(x, str) else c_number(float(x), P)

    def put(template: str, *given: str | float) -> str:
        values.append(template.format(*map(text, given), P=P))
        return f"x{len(values) - 1}"

    law = Law(program.tape, program.results, program.inputs)
    found = law.by({name: partial(put, x) for name, x in _OPERATIONS.items()})
    results = found(*(_input(name, P) for name in program.inputs))
    sizes = {"out": program.torque, "spread": program.variance, "keep": program.memory}
    targets = [(name, j) for name, x in sizes.items() for j in range(len(x))]
    outputs = [
        (f"{name}[{j}]", text(x))
        for (name, j), x in zip(targets, results, strict=True)
        if name != "spread" or isinstance(x, str)  # nothing was learned of a joint
    ]
    return values, outputs


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
