"""Base parameters: as many as theory says, the same torque, and readable names."""

import re
from functools import cache

import numpy as np
import pytest
from arms import MODELS, PUBLIC_ARMS, public_arm, random_arm, random_states
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.dynamics import regressor
from hybrid.dynamics.base import base_parameters, inertial_labels
from hybrid.effects import effect_class
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.robot.spatial import inertial_about

# Base parameters of the links alone, and of links and rotors together. A rotor that
# turns a link about an axis nothing else can turn it about is lost in that link: the
# first one always, the second where its axis is at right angles to a vertical first.
SIZES = {
    "ur10": (36, 36 + 4),
    "panda": (43, 43 + 5),
    "xarm7": (43, 43 + 5),
    "z1": (43, 43 + 5),
    "coman_like.xml": (36, 36 + 4),
    "scara.xml": (4, 4 + 1),
    "planar.xml": (6, 6 + 1),
}
MILLIMETRE = """<mujoco><compiler angle="radian"/><worldbody><body>
  <joint name="first" axis="0 0 1"/>
  <inertial pos="0.1 0 0" mass="3" diaginertia=".01 .02 .02"/>
  <body pos="0.0005 0 0"><joint name="second" axis="0 0 1"/>
    <inertial pos="0.2 0 0" mass="2" diaginertia=".01 .02 .02"/></body>
</body></worldbody></mujoco>"""


@cache
def arm(name: str) -> Robot:
    return public_arm(name) if name in PUBLIC_ARMS else Robot.load(MODELS / name)


def problem_of(robot, *effect_ids):
    effects = [
        effect_class(name)((j,)) for name in effect_ids for j in range(robot.size)
    ]
    return build_problem(robot.chain, effects)


def assert_same_torque_from_fewer(robot, base):
    """Kept columns times base values are all columns times standard values."""
    n = robot.size
    Y = regressor(robot.chain, *random_states(n, 200)).reshape(-1, 10 * n)
    for values in np.random.default_rng(4).normal(size=(5, 10 * n)):
        tau = Y @ values
        reduced = Y[:, list(base.kept)] @ (base.mapping @ values)
        np.testing.assert_allclose(reduced, tau, rtol=0, atol=1e-9 * np.abs(tau).max())


@pytest.mark.parametrize("name", SIZES)
def test_the_number_of_base_parameters_is_that_of_theory(name):
    robot = arm(name)
    links, with_rotors = SIZES[name]
    assert problem_of(robot).size == links
    assert problem_of(robot, "armature").size == with_rotors


@pytest.mark.parametrize("name", SIZES)
def test_base_parameters_give_the_torque_of_all_parameters(name):
    robot = arm(name)
    assert_same_torque_from_fewer(robot, problem_of(robot).base)


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_so_they_do_for_random_chains(seed):
    robot = random_arm(seed)
    assert_same_torque_from_fewer(robot, problem_of(robot).base)


def test_links_half_a_millimetre_apart_keep_their_small_factors(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MILLIMETRE)
    robot = Robot.load(path)
    base = problem_of(robot).base
    assert_same_torque_from_fewer(robot, base)
    factors = np.abs(base.mapping[base.mapping != 0])
    assert factors.min() == pytest.approx(0.0005**2)


def test_the_first_rotor_of_the_ur10_is_lost_in_the_first_link():
    base = problem_of(arm("ur10"), "armature").base
    assert base.dropped["armature.inertia[shoulder_pan_joint]"] == "Izz_1"
    assert base.dropped["armature.inertia[shoulder_lift_joint]"] == "Iyy_2"
    lost = base.names[base.kept_labels.index("Izz_1")]
    assert "armature.inertia[shoulder_pan_joint]" in lost
    assert "armature.inertia[elbow_joint]" in base.kept_labels


def test_what_never_moves_a_torque_is_dropped_without_a_partner():
    # Of the first link of an arm on a vertical axis only Izz turns.
    dropped = problem_of(arm("ur10")).base.dropped
    silent = {label for label, partners in dropped.items() if not partners}
    names = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz")
    assert {f"{name}_1" for name in names} <= silent
    assert dropped["Izz_3"] and "Izz_1" not in dropped


def test_kept_and_dropped_parameters_are_all_there_are():
    base = problem_of(arm("panda"), "armature", "viscous").base
    assert sorted([*base.kept_labels, *base.dropped]) == sorted(base.labels)


def flat_arm(gravity: str) -> str:
    """Two links of length 0.5 m in the vertical plane x–z, turning about y."""
    return f"""<mujoco><compiler angle="radian"/><option gravity="{gravity}"/>
    <worldbody><body><joint name="a" axis="0 1 0"/>
      <inertial pos="0.2 0 0.03" mass="3" diaginertia=".01 .05 .05"/>
      <body pos="0.5 0 0"><joint name="b" axis="0 1 0"/>
        <inertial pos="0.15 0 -.02" mass="2" diaginertia=".01 .02 .02"/></body></body>
    </worldbody></mujoco>"""


# Link 2 hangs a length away from joint 1: Iyy_1 + l² m_2, mx_1 + l m_2, and its own.
FLAT = {"Iyy_1": {"Iyy_1": 1.0, "m_2": 0.25}, "mx_2": {"mx_2": 1}, "mz_2": {"mz_2": 1}}
FLAT |= {"Iyy_2": {"Iyy_2": 1.0}}
HUNG = {"mx_1": {"mx_1": 1.0, "m_2": 0.5}, "mz_1": {"mz_1": 1.0}}


@pytest.mark.parametrize(
    ("gravity", "expected"),
    [("0 0 0", FLAT), ("0 -9.81 0", FLAT), ("0 0 -9.81", FLAT | HUNG)],
    ids=["weightless", "turned on its side", "hanging"],
)
def test_a_flat_arm_has_the_base_parameters_of_the_textbook(
    tmp_path, gravity, expected
):
    path = tmp_path / "flat.xml"
    path.write_text(flat_arm(gravity))
    base = problem_of(Robot.load(path)).base
    # Which of several equivalent sets is chosen is free: compare what they span.
    rows = np.zeros((len(expected), len(base.labels)))
    for row, terms in zip(rows, expected.values(), strict=True):
        for label, factor in terms.items():
            row[base.labels.index(label)] = factor
    assert base.size == len(expected)
    both = np.vstack([rows, base.mapping])
    assert np.linalg.matrix_rank(both, tol=1e-9) == len(expected)


def test_friction_is_kept_and_merges_with_nothing():
    names = ("armature", "coulomb", "viscous", "torque_offset", "stribeck")
    robot = arm("ur10")
    base = problem_of(robot, *names).base
    lost = [label for label in base.dropped if "[" in label]
    assert all(label.startswith("armature") for label in lost)


def test_twice_the_same_effect_is_found_out():
    base = problem_of(arm("scara.xml"), "coulomb", "coulomb").base
    assert base.dropped["coulomb.level[shoulder]"] == "coulomb.level[shoulder]"


def test_a_fit_of_exact_torque_returns_the_base_values_of_the_truth():
    robot = arm("coman_like.xml")
    n = robot.size
    base = problem_of(robot).base
    Y = regressor(robot.chain, *random_states(n, 100)).reshape(-1, 10 * n)
    truth = robot.chain.inertial.ravel()
    found = np.linalg.lstsq(Y[:, list(base.kept)], Y @ truth)[0]
    np.testing.assert_allclose(found, base.mapping @ truth, atol=1e-9)
    standard = base.with_values(found).standard()
    np.testing.assert_allclose(Y @ standard, Y @ truth, atol=1e-8)


def test_a_body_that_turns_otherwise_but_loads_alike_has_the_same_base_values():
    # The first link may be any body with the same moment of inertia about its axis.
    robot = arm("ur10")
    base = problem_of(robot).base
    other = robot.chain.inertial.copy()
    turning = other[0, 9]
    other[0] = inertial_about(7.0, np.zeros(3), np.diag([turning, turning, turning]))
    before = base.mapping @ robot.chain.inertial.ravel()
    np.testing.assert_allclose(base.mapping @ other.ravel(), before, atol=1e-12)


@pytest.mark.parametrize("name", SIZES)
def test_names_can_be_read(name):
    base = problem_of(arm(name), "armature").base
    number = r"(?:\d+(?:\.\d+)?(?:e-\d+)?·)?"
    label = r"(?:m|m[xyz]|I[xyz]{2})_\d|armature\.inertia\[\w+\]"
    pattern = rf"(?:{label})(?: [+−] {number}(?:{label}))*"
    for text, kept in zip(base.names, base.kept_labels, strict=True):
        assert re.fullmatch(pattern, text), text
        assert text.split()[0] == kept
    assert len(set(base.names)) == base.size


def test_labels_and_units_belong_together():
    labels, units = inertial_labels(2)
    pairs = dict(zip(labels, units, strict=True))
    assert len(pairs) == 20
    assert (pairs["m_1"], pairs["my_2"], pairs["Ixy_2"]) == ("kg", "kg·m", "kg·m²")


def test_the_columns_may_have_any_units():
    robot = arm("scara.xml")
    Y = regressor(robot.chain, *random_states(robot.size, 100)).reshape(-1, 20)
    labels, units = inertial_labels(2)
    plain = base_parameters(Y, labels, units)
    factor = 10.0 ** np.random.default_rng(0).integers(-3, 4, 20)
    scaled = base_parameters(Y * factor, labels, units)
    assert scaled.kept == plain.kept
    rescaled = scaled.mapping * factor[list(scaled.kept), None] / factor
    np.testing.assert_allclose(rescaled, plain.mapping, atol=1e-9)


def test_no_samples_reveal_nothing():
    labels, units = inertial_labels(1)
    base = base_parameters(np.zeros((0, 10)), labels, units)
    assert base.size == 0 and base.names == ()
    assert base.mapping.shape == (0, 10) and set(base.dropped) == set(labels)


def test_two_ripples_of_one_joint_have_names_of_their_own():
    robot = arm("scara.xml")
    ripples = [TorqueRipple((0,), {"periods": k}) for k in (6.0, 11.5)]
    base = build_problem(robot.chain, ripples).base
    assert len(set(base.labels)) == len(base.labels)
    assert "torque_ripple.sine[shoulder, periods 11.5]" in base.labels


@pytest.mark.parametrize("scale", [1.0, 1e-4, 1e5])
@pytest.mark.parametrize(
    ("own", "kept"), [(1e-2, 3), (1e-3, 3), (1e-4, 3), (3e-6, 2), (1e-7, 2)]
)
def test_a_column_counts_from_a_hundred_thousandth_of_its_length_of_its_own(
    own, kept, scale
):
    """Whatever its unit; what is less would need data that much better."""
    x = np.linalg.qr(np.random.default_rng(0).normal(size=(40, 3)))[0]
    nearly = (x[:, 0] + x[:, 1]) / np.sqrt(2) + own * x[:, 2]
    stacked = np.column_stack([x[:, 0], x[:, 1], scale * nearly])
    base = base_parameters(stacked, ("a", "b", "c"), ("1",) * 3)
    assert base.kept == tuple(range(kept))
    if kept == 2:
        expected = scale * np.array([1.0, 1.0]) / np.sqrt(2)
        np.testing.assert_allclose(base.mapping[:, 2], expected, rtol=1e-5)
        assert base.dropped == {"c": "a, b"}


def test_an_axis_bent_by_a_thousandth_has_the_rotor_apart():
    """Two rotors on nearly one axis: the data can tell them where the columns do."""
    rng = np.random.default_rng(1)
    a = rng.normal(size=200)
    for bend, size in ((1e-3, 2), (1e-7, 1)):
        stacked = np.column_stack([a, a + bend * rng.normal(size=200)])
        base = base_parameters(stacked, ("I_1", "I_2"), ("kg·m²",) * 2)
        assert base.size == size


def test_a_combination_is_named_with_sign_and_factor_and_dropped_with_its_partners():
    x = np.eye(5)[:, :2]
    columns = [x[:, 0], x[:, 1], 2 * x[:, 0] - x[:, 1], 0 * x[:, 0], 1e-6 * x[:, 1]]
    base = base_parameters(np.column_stack(columns), tuple("abcde"), ("1",) * 5)
    assert base.kept == (0, 1) and base.kept_labels == ("a", "b")
    assert base.names == ("a + 2·c", "b − c")
    np.testing.assert_allclose(base.mapping[:, 4], [0.0, 1e-6])
    assert base.dropped == {"c": "a, b", "d": "", "e": "b"}
    values = base.with_values([3.0, 4.0])
    np.testing.assert_array_equal(values.standard(), [3.0, 4.0, 0.0, 0.0, 0.0])
    assert values.size == 2


def test_coefficients_of_rounding_are_none():
    """Columns that share nothing but the last bits are not said to be combined."""
    x = np.linalg.qr(np.random.default_rng(2).normal(size=(60, 4)))[0]
    mixed = x[:, 0] + 1e-12 * x[:, 1] + 1e-8 * x[:, 2]
    base = base_parameters(
        np.column_stack([x[:, 0], x[:, 1], x[:, 2], mixed]), tuple("abcd"), ("1",) * 4
    )
    column = base.mapping[:, 3]
    assert column[1] == 0.0 and column[2] == pytest.approx(1e-8, rel=1e-3)
