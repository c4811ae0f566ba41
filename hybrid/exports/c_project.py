"""Write the C export: header, example, and build file."""

from pathlib import Path
from typing import Any

import numpy as np

from hybrid.exports.c_code import c_header, c_number
from hybrid.model.dynamic_model import DynamicModel
from hybrid.model.program import Program
from hybrid.names import c_identifier

_EXAMPLE = """\
/* Compute the torque of one state, and compare it with that of Python. */
#include "{p}.h"

#include <stdio.h>

int main(void)
{{
    {p}_state state;
    const {p}_real q[{n}] = {{{q}}};
    const {p}_real v[{n}] = {{{v}}};
    const {p}_real a[{n}] = {{{a}}};
    const double expected[{n}] = {{{tau}}};
    const char *const unit[{n}] = {{{unit}}};
    {p}_real tau[{n}], variance[{n}];
    double worst = 0.0;
    int j, status;

    {p}_start(&state, {P}_R(0.001));
    for (j = 0; j < {P}_JOINTS; j++) {{
        state.clamp[j] = {P}_R(INFINITY); /* to compare; leave this out on the arm */
    }}
    status = {p}_torque(&state, q, v, a, tau, variance);
    if (status == {P}_NOT_FINITE) {{
        printf("a number is not finite\\n");
        return 1;
    }}
    for (j = 0; j < {P}_JOINTS; j++) {{
        const double error = fabs((double)tau[j] - expected[j]);
        printf("joint %d: %.9g %s\\n", j + 1, (double)tau[j], unit[j]);
        worst = (error > worst) ? error : worst;
    }}
    printf("largest difference from Python: %.3g\\n", worst);
    return (worst < ((sizeof({p}_real) == 4U) ? 1e-2 : 1e-9)) ? 0 : 1;
}}
"""

_CMAKE = """\
# cmake -B build && cmake --build build && ctest --test-dir build
cmake_minimum_required(VERSION 3.16)
project({p} C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_STANDARD_REQUIRED ON)
set(CMAKE_C_EXTENSIONS OFF)
if(NOT CMAKE_BUILD_TYPE)
    set(CMAKE_BUILD_TYPE Release)
endif()
add_library({p} INTERFACE)
target_include_directories({p} INTERFACE ${{CMAKE_CURRENT_SOURCE_DIR}})
find_library(MATH m)
if(MATH)
    target_link_libraries({p} INTERFACE ${{MATH}})
endif()
enable_testing()
foreach(precision IN ITEMS double single)
    add_executable(example_${{precision}} example.c)
    target_link_libraries(example_${{precision}} PRIVATE {p})
    if(CMAKE_C_COMPILER_ID MATCHES "GNU|Clang")
        target_compile_options(example_${{precision}} PRIVATE
            -Wall -Wextra -Werror -pedantic -Wconversion)
    endif()
    add_test(NAME example_${{precision}} COMMAND example_${{precision}})
endforeach()
target_compile_definitions(example_single PRIVATE {P}_SINGLE)
"""


def write_c(model: DynamicModel, program: Program, digest: str, folder: Path) -> None:
    """Write ``<arm>.h``, ``example.c`` and ``CMakeLists.txt``."""
    robot = model.robot
    p = c_identifier(robot.name)
    header = c_header(program, robot, digest)
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.q_min), robot.q_min, -1.0)
    high = np.where(np.isfinite(robot.q_max), robot.q_max, 1.0)
    q = rng.uniform(low, high)[None]
    v, a = rng.uniform(-1.0, 1.0, (2, 1, robot.size))
    tau, _ = program.run(q, v, a)
    marks: dict[str, Any] = {"p": p, "P": p.upper(), "n": robot.size}
    for name, values in (("q", q), ("v", v), ("a", a)):
        marks[name] = ", ".join(c_number(float(x), p.upper()) for x in values[0])
    marks["tau"] = ", ".join(repr(float(x)) for x in tau[0])
    units = robot.chain.units("N·m")
    marks["unit"] = ", ".join(f'"{x.replace("·", " ")}"' for x in units)
    texts = {
        f"{p}.h": header,
        "example.c": _EXAMPLE.format(**marks),
        "CMakeLists.txt": _CMAKE.format(**marks),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
