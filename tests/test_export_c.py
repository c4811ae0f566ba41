"""The exported header as a controller sees it: limits, clamp, status, compilers."""

import re
import shutil
import subprocess
import warnings
from dataclasses import replace

import numpy as np
import pytest
from arms import LIFT, MODELS, public_arm
from pendulum import pendulum
from test_export import full_model, model_of

from hybrid.effects import Scale
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.presliding import Presliding
from hybrid.effects.thermal_friction import ThermalFriction
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError
from hybrid.exports import export, read_manifest
from hybrid.exports.c_code import c_number
from hybrid.robot import Robot

PLANAR = MODELS / "planar.xml"
STRICT = (
    "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion",
    "-Wshadow", "-Wundef",
)  # fmt: skip
SANITISED = ("-fsanitize=undefined,address", "-fno-sanitize-recover=all")
MAIN = """#include "{p}.h"
#include <stdio.h>

int main(void)
{{
    static const double states[][{n}] = {{{states}}};
    const int count = (int)(sizeof(states) / sizeof(states[0]));
    {p}_state s;
    {p}_real given[3][{n}], tau[{n}], variance[{n}];
    int i, j, k;
    {p}_start(&s, {P}_R(0.01));
{before}
    for (k = 0; k < count; k += 3) {{
        for (i = 0; i < 3; i++)
            for (j = 0; j < {n}; j++)
                given[i][j] = {P}_R(states[k + i][j]);
        for (j = 0; j < {n}; j++)
            tau[j] = {P}_R(-77);
        printf("%d", {p}_torque(&s, given[0], given[1], given[2], tau, variance));
        for (j = 0; j < {n}; j++)
            printf(" %.17g", (double)tau[j]);
        printf(" %.17g\\n", s.t);
    }}
    return 0;
}}
"""


def compilers():
    return [
        pytest.param(
            name, marks=pytest.mark.skipif(not shutil.which(name), reason=name)
        )
        for name in ("gcc", "clang")
    ]


def literal(x) -> str:
    if np.isnan(x):
        return "NAN"
    return f"{'-' if x < 0 else ''}INFINITY" if np.isinf(x) else repr(float(x))


def run(folder, name, states, *, compiler="cc", flags=(), before=""):
    """Status, torques and clock after each of the states (K, 3, n)."""
    n = states.shape[2]
    rows = ", ".join(
        "{" + ", ".join(map(literal, row)) + "}" for row in states.reshape(-1, n)
    )
    text = MAIN.format(p=name, P=name.upper(), n=n, states=rows, before=before)
    (folder / "main.c").write_text(text)
    command = [compiler, *STRICT, *flags, "-o", folder / "main", folder / "main.c"]
    done = subprocess.run([*command, "-lm"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    done = subprocess.run([folder / "main"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    return found[:, 0].astype(int), found[:, 1:-1], found[:, -1]


def hostile_states(n: int, count: int = 300) -> np.ndarray:
    """Numbers of every size and none, in every place, shape (count, 3, n)."""
    rng = np.random.default_rng(0)
    states = rng.normal(size=(count, 3, n)) * 10.0 ** rng.integers(-3, 3, (count, 3, 1))
    odd = [np.nan, np.inf, -np.inf, 1e200, -1e200, 1e308, 5e-324, -1e-310, 0.0, -0.0]
    where = rng.random(states.shape) < 0.3
    where[: count // 3] = False
    states[where] = rng.choice(odd, where.sum())
    return states


def models():
    ur10 = public_arm("ur10")
    effects = [
        Presliding((1,), {"level": 3.0, "distance": 0.02}),
        ActuatorLag((2,), {"time": 0.03}),
        ThermalFriction.typical((3,), [Scale(50.0, 3.0)] * 6),
    ]
    return {
        "mixtures": full_model(),
        "memory": model_of(ur10, effects),
    }


@pytest.mark.parametrize("compiler", compilers())
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("kind", ["mixtures", "memory"])
def test_no_input_breaks_it_or_brings_a_torque_that_is_none(
    tmp_path, compiler, single, kind
):
    model = models()[kind]
    name = model.robot.name
    export(model, tmp_path, format="c")
    flags = [*SANITISED, "-O0", *([f"-D{name.upper()}_SINGLE"] if single else [])]
    states = hostile_states(model.robot.size)
    status, tau, _ = run(tmp_path, name, states, compiler=compiler, flags=flags)
    wrong = ~np.isfinite(states).all(axis=(1, 2))
    assert (status[wrong] == -1).all()
    assert (tau[status == -1] == -77).all()  # nothing was written
    assert np.isfinite(tau).all()
    limit = np.append(model.robot.tau_max, 77.0)[: tau.shape[1]]
    done = status >= 0
    assert (np.abs(tau[done]) <= limit * (1 + 1e-6)).all()
    assert set(status) >= {-1, 1} and done[:100].all()


def test_a_torque_beyond_the_rated_one_is_that_one_and_the_status_says_so(tmp_path):
    robot = Robot.load(PLANAR)
    model = model_of(robot, [Viscous((0,), {"coefficient": 1000.0})])
    export(model, tmp_path, format="c")
    states = np.zeros((4, 3, 2))
    states[:, 1, 0] = [0.0, 1.0, -1.0, 1e3]
    status, tau, t = run(tmp_path, "planar", states)
    most = robot.tau_max[0]
    np.testing.assert_allclose(tau[1:, 0], [most, -most, most])
    assert list(status) == [0, 2, 2, 3]
    np.testing.assert_allclose(t, [0.01, 0.02, 0.03, 0.04])
    before = "    s.clamp[0] = {};"
    free = run(tmp_path, "planar", states, before=before.format("INFINITY"))[1]
    assert free[1, 0] > 900 and free[3, 0] > 9e5
    half = run(tmp_path, "planar", states, before=before.format("40.0"))[1]
    np.testing.assert_allclose(half[1:, 0], [40, -40, 40])
    for wrong in ("NAN", "-1.0"):
        assert (
            run(tmp_path, "planar", states, before=before.format(wrong))[0] == -1
        ).all()


def test_positions_and_speeds_beyond_their_limits_are_reported(tmp_path):
    robot = Robot.load(PLANAR)
    export(model_of(robot), tmp_path, format="c")
    states = np.zeros((5, 3, 2))
    states[1, 0, 1] = robot.q_max[1] + 0.1
    states[2, 0, 0] = robot.q_min[0] - 0.1
    states[3, 1, 1] = -robot.v_max[1] - 0.1
    states[4, 1, 1] = robot.v_max[1]
    assert list(run(tmp_path, "planar", states)[0]) == [0, 1, 1, 1, 0]


def test_a_torque_that_overflows_leaves_the_memory_as_it_was(tmp_path):
    effects = [
        Viscous((0,), {"coefficient": 1.0}),
        Presliding((1,), {"level": 3.0, "distance": 0.02}),
    ]
    model = model_of(Robot.load(PLANAR), effects)
    export(model, tmp_path, format="c")
    calm = np.array([[0.1, 0.2], [0.3, 0.4], [0.0, 0.0]])
    wild = np.array([[0.1, 0.2], [1e200, 1e200], [0.0, 0.0]])
    status, tau, t = run(tmp_path, "planar", np.array([calm, wild, calm]))
    assert list(status) == [0, -1, 0]
    _, plain, _ = run(tmp_path, "planar", np.array([calm, calm]))
    np.testing.assert_array_equal(tau[2], plain[1])
    np.testing.assert_allclose(t, [0.01, 0.01, 0.02])


def test_sliding_joints_have_units_of_their_own(tmp_path):
    path = tmp_path / "lift.xml"
    path.write_text(LIFT)
    export(model_of(Robot.load(path)), tmp_path / "out", format="c")
    header = (tmp_path / "out" / "lift.h").read_text()
    assert " *   1 turn: -2 to 2 rad, inf rad/s, inf N m\n" in header
    assert " *   2 lift: -0.2 to 0.2 m, inf m/s, inf N\n" in header
    units = read_manifest(tmp_path / "out")["units"]
    assert units["tau"] == ["N·m", "N"] and units["q"] == ["rad", "m"]
    command = ["cc", *STRICT, "example.c", "-o", "example", "-lm"]
    subprocess.run(command, cwd=tmp_path / "out", check=True)
    done = subprocess.run(["./example"], cwd=tmp_path / "out", capture_output=True)
    assert done.returncode == 0 and b"joint 2: " in done.stdout
    assert b" N\n" in done.stdout and b" N m\n" in done.stdout


@pytest.mark.parametrize("compiler", compilers())
@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_fast_math_is_refused(tmp_path, compiler, flag):
    export(model_of(Robot.load(PLANAR)), tmp_path, format="c")
    command = [compiler, flag, "-c", "example.c", "-o", "example.o"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode != 0
    assert "fast math removes the checks" in done.stderr


@pytest.mark.parametrize("compiler", compilers())
def test_the_example_is_clean_with_all_optimisation(tmp_path, compiler):
    export(full_model(), tmp_path, format="c")
    command = [compiler, *STRICT, *SANITISED, "-O3", "example.c", "-o", "x", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert subprocess.run(["./x"], cwd=tmp_path, capture_output=True).returncode == 0


def test_a_number_that_is_none_is_not_written():
    for x in (np.nan, np.inf):
        with pytest.raises(HybridError, match="valid are finite ones"):
            c_number(x, "P")
    assert c_number(-np.inf, "P", finite=False) == "P_R(-INFINITY)"


@pytest.mark.parametrize("rated", [30.0, 3.0])
def test_torques_that_the_logs_had_and_the_header_clamps_are_told(rated, tmp_path):
    robot = replace(pendulum(2), tau_max=np.array([1e3, rated]))
    seen = {"q_min": np.full(2, -1.5), "q_max": np.full(2, 1.5), "v_max": np.ones(2)}
    model = model_of(robot, range=seen)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        export(model, tmp_path, format="c")
    assert len(told) == (rated < 10)
    if told:
        assert re.search(r"beyond them .*: hinge_1 [\d.]+ of 3 N·m;", str(told[0]))
        assert "hinge_0" not in str(told[0])
