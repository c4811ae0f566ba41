"""Every effect keeps its promises; the laws obey physics."""

import re
import string
import sys
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop import Loop, commanded_torque

from hybrid.dynamics import RigidBody
from hybrid.effects import (
    Effect,
    JointEffect,
    JointState,
    Port,
    Quantity,
    Scale,
    effect_at,
    effect_class,
    effect_classes,
    effect_from_dict,
    effects_from_file,
    effects_from_text,
    registry,
)
from hybrid.errors import EffectError
from hybrid.plant import Noise, Plant, Reference, random_fourier
from hybrid.plant.arm import build_arm
from hybrid.robot import Robot
from hybrid.signals import Motion, motion_from_recording

EFFECTS = effect_classes()
NAMES = ("base", "shoulder", "elbow")
SCALES = (Scale(60.0, 2.0), Scale(60.0, 2.0), Scale(30.0, 2.0))
# Rotors are left to the armature effect.
ARM = """<mujoco><compiler angle="radian"/><worldbody><body>
  <joint name="base" axis="0 0 1" range="-2 2" limited="true"/>
  <inertial pos="0.05 0 0.1" mass="4" diaginertia=".05 .05 .03"/>
  <body pos="0 0 0.2">
    <joint name="shoulder" axis="0 1 0" range="-1.5 1.5" limited="true"/>
    <inertial pos="0.2 0 0.05" mass="3" diaginertia=".01 .05 .05"/>
    <body pos="0.4 0 0" euler="0.3 0 0">
      <joint name="elbow" axis="0 1 0" range="-1.8 1.8" limited="true"/>
      <inertial pos="0.15 0.02 0" mass="1.5" diaginertia=".004 .02 .02"/></body></body>
</body></worldbody></mujoco>"""

# What has to be there for a plant to have the effect at all.
NEEDS = {
    "asymmetric_friction": "coulomb",
    "backlash": "armature",
    "elasticity": "armature",
}
# Gains that are usually 0 are tried as well, and a limit that is reached; SI units.
RICHER = {
    "contact": {"moment_x": 2.0, "moment_y": -3.0, "moment_z": 1.5},
    "payload": {"mx": 0.1, "my": -0.05, "Ixx": 0.05, "Iyy": 0.06, "Izz": 0.04},
    "saturation": {"limit": 11.0},
    "spring": {"preload": 2.0},
    "threshold_friction": {"rising": 1.0, "quadratic": 0.5, "cubic": 0.2},
    "torque_ripple": {"cosine": -0.6},
}
SUDDEN = {"stribeck", "encoder_eccentricity"}  # change much within a millisecond
UNITS = {"", "N", "kg", "m", "s", "rad", "turn", "°C", "K"}


@cache
def robot() -> Robot:
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(ARM)
        return Robot.load(path)


@cache
def reference() -> Reference:
    rng = np.random.default_rng(3)
    return random_fourier(robot(), duration=4.0, rate=500, seed=rng)


def log_of(*effects):
    """Motion and what the rigid body does not explain of its torque, without noise."""
    step = 0.0005 if any(e.id in SUDDEN for e in effects) else 0.001
    plant = Plant(robot(), effects, noise=Noise.none(3), step=step)
    (log,) = plant.run([reference()], seed=np.random.default_rng(0))
    motion = motion_from_recording(log, cutoff=np.inf)
    body = RigidBody(robot().chain, motion)
    return motion, body, motion.tau - body.load


@cache
def clean_log():
    return log_of()


def joints_for(cls: type[Effect]) -> tuple[int, ...]:
    return {"joint": (1,), "coupling": (1, 2), "arm": (0, 1, 2)}[cls.scope]


def typical(name: str, **values: float) -> Effect:
    cls = effect_class(name)
    return cls.typical(joints_for(cls), SCALES, **values)


def moving(motion, effect):
    """Samples on which direction of motion is beyond doubt.

    Differences over nine samples smear a reversal, and a plant sticks at a law's jump.
    They smear the jolt of a contact, too.
    """
    v = motion.v[:, list(effect.joints)]
    speeds = np.abs(np.column_stack([v, v.sum(axis=1)]))
    on = motion.mask & (speeds.min(axis=1) > 0.05)
    if effect.id == "contact":
        start = effect.values["start"]
        end = start + effect.values["duration"]
        on &= (abs(motion.t - start) > 0.02) & (abs(motion.t - end) > 0.02)
    return on


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def smooth_motion(samples=200, seed=0):
    t = 0.01 * np.arange(samples)
    rng = np.random.default_rng(seed)
    size, omega, phase = rng.uniform(0.5, 2.0, (3, 3))
    angle = omega * t[:, None] + phase
    q, v = size * np.sin(angle), size * omega * np.cos(angle)
    a, ok = -(omega**2) * q, np.ones(samples, dtype=bool)
    return Motion(t, q, v, a, 90 * np.roll(q, 1, axis=1), ok, 25 + 0 * q, NAMES)


def reached(effect):
    return list(effect.reaches(3))


# Between motion and torque an effect on the command leaves no trace.
IN_TORQUE = [n for n, cls in EFFECTS.items() if cls.port is not Port.COMMAND]
IN_COMMAND = [n for n in EFFECTS if n not in IN_TORQUE]


# --- the conformance test -----------------------------------------------------------


@pytest.mark.parametrize("name", EFFECTS)
class TestEveryEffect:
    def test_it_says_who_it_is_and_what_to_do_about_it(self, name):
        cls = EFFECTS[name]
        snake = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        assert cls.id == name == snake
        in_file = [c.id for c in EFFECTS.values() if c.__module__ == cls.__module__]
        assert cls.__module__.rsplit(".")[-1] in in_file
        assert isinstance(cls.port, Port) and cls.scope in ("joint", "coupling", "arm")
        assert cls.gains, "an effect that no number switches on cannot be fitted"
        assert cls.equation.startswith("τ") and cls.__doc__
        assert re.search(r"\d{4}|doi 10\.", cls.source)
        fields = [field for _, field, _, _ in string.Formatter().parse(cls.sentence)]
        assert set(fields) - {None} <= {"joints"}
        assert "joints" in fields or cls.scope == "arm"
        assert cls.sentence.endswith(".") and cls.remedy.endswith(".")

    def test_its_parameters_have_units_bounds_and_a_usual_size_between(self, name):
        cls = EFFECTS[name]
        quantities = (*cls.gains, *cls.shapes)
        assert len({x.name for x in quantities}) == len(quantities)
        for x in quantities:
            assert x.lower < x.upper and x.lower <= x.typical <= x.upper
            symbols = re.split(r"[·/()\d²³]+", x.unit)
            assert set(symbols) <= UNITS, x.unit
        assert any(g.typical for g in cls.gains)

    def test_its_columns_are_torque_per_unit_of_each_gain(self, name):
        effect, motion = typical(name), smooth_motion()
        body = RigidBody(robot().chain, motion)
        columns = effect.columns(motion, body)
        assert columns.shape == (200, len(reached(effect)), len(effect.gains))
        assert np.isfinite(columns).all()
        assert (np.abs(columns).max(axis=(0, 1)) > 0).all() == (name in IN_TORQUE)
        if effect.steep:  # its columns are made at the gain it has
            return
        other = effect.at({g.name: 3.0 + k for k, g in enumerate(effect.gains)})
        np.testing.assert_array_equal(other.columns(motion, body), columns)
        torque = effect.torque(motion, body)
        assert torque.shape == (200, len(reached(effect)))
        if effect.reports or effect.observes:
            assert not torque.any()
        else:
            np.testing.assert_allclose(torque, columns @ effect.gain_values)
        off = effect.at({g.name: 0.0 for g in effect.gains})
        assert not off.torque(motion, body).any()

    def test_it_loads_back_equal_from_a_description_and_from_text(self, name):
        import json

        effect = typical(name, **RICHER.get(name, {}))
        known = effect.at({}, std={effect.gains[0].name: 0.25})
        content = json.loads(json.dumps(known.as_dict(NAMES), allow_nan=False))
        assert effect_from_dict(content, NAMES) == known
        values = ";".join(f"{key}={x!r}" for key, x in effect.values.items())
        at = "+".join(NAMES[j] for j in effect.joints)
        where = "" if effect.scope == "arm" else f":{at}"
        assert effects_from_text(f"{name}{where}({values})", NAMES, SCALES) == [effect]
        number = "" if effect.scope == "arm" else f":{at}".replace(at, _numbers(effect))
        assert effects_from_text(f"{name}{number}", NAMES, SCALES) == [typical(name)]

    def test_wrong_values_and_joints_are_refused(self, name):
        cls, joints = EFFECTS[name], joints_for(EFFECTS[name])
        known = ", ".join(x.name for x in (*cls.gains, *cls.shapes))
        with pytest.raises(
            EffectError, match=f"no parameter colour; valid are {known}"
        ):
            cls(joints, {"colour": 1.0})
        for bad in (np.nan, np.inf):
            with pytest.raises(EffectError, match="not a finite number"):
                cls(joints, {cls.gains[0].name: bad})
        for shape in cls.shapes:
            if shape.per == (0, 0):
                with pytest.raises(EffectError, match=f"{shape.name} .*valid is"):
                    cls(joints, {shape.name: 2 * shape.upper + 1})
        for wrong in ((), (1, 1), (-1,)):
            with pytest.raises(EffectError, match="joint"):
                cls(wrong)


def _numbers(effect):
    return "+".join(str(j + 1) for j in effect.joints)


@cache
def known_log(name):
    """An effect, and the log of a plant that has it; what it needs is taken off."""
    effect = typical(name, **RICHER.get(name, {}))
    needed = [typical(NEEDS[name])] if name in NEEDS else []
    motion, body, rest = log_of(*needed, effect)
    for other in needed:
        rest[:, list(other.joints)] -= other.torque(motion, body)
    return effect, motion, body, rest


@pytest.mark.parametrize("name", IN_TORQUE)
def test_the_plant_does_what_the_columns_say(name):
    effect, motion, body, rest = known_log(name)
    expected = effect.columns(motion, body) @ effect.gain_values
    on = moving(motion, effect)
    assert on.sum() > 500
    left = np.delete(rest, reached(effect), axis=1)
    found, expected = rest[on][:, reached(effect)], expected[on]
    # 2 % for what is true to first order only (delay, elasticity) and for laws at the
    # simulator's instants; 1e-3 N·m for its step, five times what a plant without
    # effects leaves.
    assert rms(found - expected) < 0.02 * rms(expected) + 1e-3
    size = np.vdot(expected, found) / np.vdot(expected, expected)
    assert size == pytest.approx(1.0, abs=0.02)
    assert not left.size or rms(left[on]) < 1e-3


@pytest.mark.parametrize("name", IN_TORQUE)
def test_a_linear_fit_with_the_true_shapes_finds_every_gain(name):
    effect, motion, body, rest = known_log(name)
    on = moving(motion, effect)
    columns = effect.columns(motion, body)[on].reshape(-1, len(effect.gains))
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    _, size, axes = np.linalg.svd(columns / scale, full_matrices=False)
    # Gains that this motion does not tell apart have no value to be found.
    hidden = (axes[size < 1e-3 * size[0]] ** 2).sum(axis=0) > 1e-6
    assert not hidden.all()
    found, *_ = np.linalg.lstsq(columns / scale, rest[on][:, reached(effect)].ravel())
    found, true = (found / scale)[~hidden], effect.gain_values[~hidden]
    upper = np.array([g.scaled(SCALES[1]).upper for g in effect.gains])[~hidden]
    assert (np.abs(found - true) < 0.02 * np.abs(true) + 1e-4 * upper).all()


@pytest.mark.parametrize("name", IN_TORQUE)
def test_nothing_of_an_effect_is_found_on_a_clean_plant(name):
    effect = typical(name, **RICHER.get(name, {}))
    motion, body, rest = clean_log()
    expected = effect.columns(motion, body) @ effect.gain_values
    on = moving(motion, effect)
    size = np.vdot(expected[on], rest[on][:, reached(effect)])
    assert abs(size) < 0.02 * np.vdot(expected[on], expected[on])


# Sizes at which the first order is no longer enough.
LARGE = {
    "actuator_lag": {"time": 0.04},
    "backlash": {"half_width": 0.01},
    "delay": {"time": 0.04},
    "encoder_eccentricity": {"sine": 0.05, "cosine": -0.04},
    "encoder_offset": {"offset": 0.15},
}


def test_effects_on_signals_are_exact_where_their_columns_are_first_order():
    for name, values in LARGE.items():
        effect = typical(name, **values)
        needed = [typical(NEEDS[name])] if name in NEEDS else []
        motion, body, rest = log_of(*needed, effect)
        true = effect.observe(motion, body)
        torque = RigidBody(robot().chain, true).load
        for other in needed:
            torque[:, list(other.joints)] += other.torque(motion, body)
        if effect.reports:
            j = list(effect.joints)
            torque[:, j] = effect.report(motion.t, torque[:, j])
        on = moving(motion, effect)
        assert rms((motion.tau - torque)[on]) < 0.01 * rms(rest[on]) + 5e-4


# --- between command and torque -----------------------------------------------------


@cache
def closed_loop(name):
    """The loop as the controller thinks it is, the torque logged, and the residual."""
    # Without feed-forward there is something left for the servo to do.
    servo = Plant(robot(), noise=Noise.none(3)).servo
    servo = replace(servo, feedforward=None)
    plant = Plant(robot(), [typical(name)], noise=Noise.none(3), servo=servo)
    (log,) = plant.run([reference()], seed=np.random.default_rng(0))
    plan = servo.plan(reference(), log.t)
    np.testing.assert_allclose(plan[0], log.command, atol=1e-12)
    motion = motion_from_recording(log, cutoff=np.inf)
    rest = motion.tau - RigidBody(robot().chain, motion).load
    loop = Loop(log.t, *plan, log.q, log.v, servo.kp, servo.kd)
    return loop, log.tau, rest[motion.mask]


@pytest.mark.parametrize("name", IN_COMMAND)
def test_an_effect_on_the_command_shows_between_command_and_torque(name):
    effect = typical(name)
    loop, tau, rest = closed_loop(name)
    (j,) = effect.joints
    assert rms(rest) < 1e-3
    inside = slice(50, -50)
    without, gap = (
        rms((commanded_torque(loop, effects) - tau)[inside, j])
        for effects in ((), (effect,))
    )
    assert gap < 0.05 * without
    others = np.delete(commanded_torque(loop) - tau, j, axis=1)[inside]
    assert rms(others) < 0.02 * rms(tau)


@pytest.mark.parametrize("name", IN_COMMAND)
def test_a_fit_of_commanded_torque_finds_the_gains(name):
    effect = typical(name)
    loop, tau, _ = closed_loop(name)
    zero, (j,) = effect.at({g.name: 0.0 for g in effect.gains}), effect.joints
    found = zero
    for _ in range(5):  # Gauss-Newton: the latency is not quite linear
        predicted = commanded_torque(loop, [found])[50:-50, j]
        columns = np.stack([
            commanded_torque(loop, [found.at({g.name: found.values[g.name] + 1e-3})])[
                50:-50, j
            ] - predicted
            for g in effect.gains
        ], axis=1) / 1e-3  # fmt: skip
        step, *_ = np.linalg.lstsq(columns, tau[50:-50, j] - predicted)
        found = found.at({
            g.name: found.values[g.name] + x
            for g, x in zip(effect.gains, step, strict=True)
        })  # fmt: skip
    np.testing.assert_allclose(found.gain_values, effect.gain_values, rtol=0.05)


def test_an_effect_elsewhere_leaves_the_loop_alone():
    loop, _, _ = closed_loop(IN_COMMAND[0])
    elsewhere = [typical(name) for name in IN_TORQUE]
    np.testing.assert_array_equal(
        commanded_torque(loop, elsewhere), commanded_torque(loop)
    )


# --- friction takes energy ----------------------------------------------------------

speeds = st.floats(-10, 10)
loads = st.floats(-200, 200)
DISSIPATIVE = (
    "coulomb", "viscous", "stribeck", "load_friction", "threshold_friction",
    "nonlinear_viscous",
)  # fmt: skip


def state_of(v, load=0.0, q=0.0):
    v = np.atleast_1d(np.asarray(v, dtype=float))
    unit = np.ones_like(v)
    return JointState(0 * unit, q * unit, v, 0 * unit, np.sign(v), load * unit)


def torque_of(effect, v, **state):
    terms = effect.law(state_of(v, **state), **effect.shape_values)
    return sum(
        gain * np.broadcast_to(term, np.shape(np.atleast_1d(v)))
        for gain, term in zip(effect.gain_values, terms, strict=True)
    )


@pytest.mark.parametrize("name", DISSIPATIVE)
@given(v=speeds, load=loads, part=st.floats(0, 1), data=st.data())
def test_friction_never_drives(name, v, load, part, data):
    effect = typical(name)
    positive = {
        g.name: data.draw(st.floats(0, 1)) * g.scaled(SCALES[1]).upper
        for g in effect.gains
    }
    effect = effect.at(positive)
    assert torque_of(effect, v, load=load)[0] * v >= 0


DRY = [n for n, cls in EFFECTS.items() if getattr(cls, "dry", False)]


@pytest.mark.parametrize("name", DRY)
def test_a_dry_law_vanishes_at_rest_in_a_fit_and_holds_in_a_plant(name):
    effect = typical(name)
    assert torque_of(effect, 0.0, load=50.0) == 0
    # A plant says which way a standing joint is pushed; it leaves out any width.
    zero, one = np.zeros(1), np.ones(1)
    pushed = JointState(zero, zero, zero, zero, one, 50.0 * one)
    shapes = {key: 0.0 if key == "width" else x for key, x in _shapes(effect)}
    terms = effect.law(pushed, **shapes)
    pairs = zip(effect.gain_values, terms, strict=True)
    assert sum(gain * np.squeeze(term) for gain, term in pairs) > 0


def _shapes(effect):
    return effect.shape_values.items()


@given(v=speeds, load=loads)
def test_friction_that_is_the_same_both_ways_is_odd(v, load):
    for name in (
        "coulomb",
        "viscous",
        "stribeck",
        "load_friction",
        "nonlinear_viscous",
    ):
        forth, back = (torque_of(typical(name), x, load=load) for x in (v, -v))
        np.testing.assert_allclose(forth, -back, rtol=1e-14)


def test_asymmetry_adds_to_one_direction_what_it_takes_from_the_other():
    asymmetric = typical("asymmetric_friction", level=2.0)
    np.testing.assert_array_equal(torque_of(asymmetric, [-3.0, 0.0, 3.0]), [2, 0, 2])


@given(v=st.floats(0.001, 10))
def test_stribeck_friction_falls_from_its_level_to_nothing(v):
    effect = typical("stribeck", level=2.0, velocity=0.05)
    slow, fast = torque_of(effect, [v, 1.1 * v])
    assert 2.0 >= slow >= fast >= 0
    at_velocity = torque_of(effect, 0.05)[0]
    assert at_velocity == pytest.approx(2.0 / np.e)


@given(v=st.floats(-5, 5))
def test_stribeck_friction_of_endless_velocity_is_coulomb_friction(v):
    (stribeck,) = effect_class("stribeck").law(state_of(v), velocity=1e9, exponent=2.0)
    (coulomb,) = effect_class("coulomb").law(state_of(v))
    np.testing.assert_allclose(stribeck, coulomb, atol=1e-12)


# --- threshold friction -------------------------------------------------------------

GAINS = [g.name for g in effect_class("threshold_friction").gains]


@st.composite
def threshold_frictions(draw):
    threshold = draw(st.floats(0.01, 5.0))
    return typical(
        "threshold_friction",
        threshold=threshold,
        width=draw(st.floats(0.0, 0.5)) * threshold,
        **{name: draw(st.floats(0.0, 3.0)) for name in GAINS},
    )


@settings(max_examples=200)
@given(effect=threshold_frictions())
def test_threshold_friction_has_no_jump(effect):
    knee, width = effect.values["threshold"], effect.values["width"]
    corners = [knee, -knee]
    if width > 1e-6:  # at width 0 the jump at standstill is meant
        corners += [0.0, width, -width]
    step = 1e-9 * min([1.0, knee, *([width] if width > 1e-6 else [])])
    # Steepest: full level over the width, or over λ, and the cubic at 5 rad/s.
    slope = 20 / max(width, 1e-6) + 10 / knee + 300
    for v in corners:
        below, above = torque_of(effect, [v - step, v + step])
        assert abs(above - below) <= 3 * slope * step + 1e-12


@given(effect=threshold_frictions(), v=st.floats(0.0, 8.0))
def test_each_direction_of_threshold_friction_has_its_own_level(effect, v):
    positive, negative = (
        effect.values[f"coulomb_{side}"] for side in ("positive", "negative")
    )
    swapped = effect.at({"coulomb_positive": negative, "coulomb_negative": positive})
    np.testing.assert_allclose(torque_of(effect, v), -torque_of(swapped, -v))


@pytest.mark.parametrize(
    ("gain", "slope", "curvature"),
    [("falling", -1, 0), ("falling_steep", -1, 1), ("rising", 1, 0)],
)
def test_below_the_threshold_friction_falls_or_rises_and_settles_there(
    gain, slope, curvature
):
    effect = typical("threshold_friction").at(dict.fromkeys(GAINS, 0.0) | {gain: 2.0})
    knee, width = effect.values["threshold"], effect.values["width"]
    below = torque_of(effect, np.linspace(width, knee, 50))
    assert (np.sign(np.diff(below)) == slope).all()
    bend = np.diff(below, 2)
    assert (bend > 0).all() if curvature else np.abs(bend).max() < 1e-12
    above = torque_of(effect, np.linspace(knee, 5 * knee, 50))
    np.testing.assert_allclose(above, 2.0 if slope > 0 else 0.0, atol=1e-12)


def test_within_its_width_the_level_of_threshold_friction_is_a_straight_line():
    effect = typical("threshold_friction", width=0.01)
    effect = effect.at(dict.fromkeys(GAINS, 0.0) | {"coulomb_positive": 3.0})
    v = np.linspace(0, 0.01, 11)
    np.testing.assert_allclose(torque_of(effect, v), 300.0 * v, atol=1e-12)


@given(effect=threshold_frictions(), data=st.data())
def test_above_the_threshold_friction_is_a_level_and_a_rising_cubic(effect, data):
    v = effect.values["threshold"] * data.draw(st.floats(1.0, 5.0))
    x = effect.values
    level = x["coulomb_positive"] + x["rising"]
    expected = level + x["viscous"] * v + x["quadratic"] * v**2 + x["cubic"] * v**3
    assert torque_of(effect, v)[0] == pytest.approx(expected)


# --- the others ---------------------------------------------------------------------


@given(q=st.floats(-6, 6), turns=st.integers(-3, 3), periods=st.integers(1, 300))
def test_ripple_repeats_as_often_as_it_says(q, turns, periods):
    effect = typical("torque_ripple", sine=0.6, cosine=0.8, periods=periods)
    period = 2 * np.pi / periods
    once, later = (torque_of(effect, 0.0, q=x) for x in (q, q + turns * period))
    np.testing.assert_allclose(once, later, atol=1e-9)
    assert abs(once[0]) <= 1.0 + 1e-12


@pytest.mark.parametrize("time", [0.02, -0.013])
def test_a_delay_shifts_the_phase_of_a_sine(time):
    t, omega = np.linspace(0, 4, 4001), 2 * np.pi * 1.5
    torque = np.stack([np.sin(omega * t), 3 * np.cos(omega * t)], axis=1)
    late = typical("delay", time=time).report(t, torque)
    inside = slice(50, -50)
    basis = np.stack([np.sin(omega * t), np.cos(omega * t)], axis=1)[inside]
    (s, c), _, _, _ = np.linalg.lstsq(basis, late[inside, 0])
    assert np.arctan2(-c, s) == pytest.approx(omega * time, abs=1e-4)
    np.testing.assert_allclose(late[inside, 1], 3 * np.cos(omega * (t - time))[inside],
                               atol=1e-3)  # fmt: skip
    held = torque[max(0, round(-time / 0.001))]  # there is nothing before the log
    np.testing.assert_allclose(late[0], held, atol=1e-12)


def test_a_delay_reports_a_linear_map():
    t, delay = np.linspace(0, 1, 200), typical("delay", time=0.0123)
    x, y = np.random.default_rng(0).normal(size=(2, 200, 3))
    both = delay.report(t, 2 * x - 5 * y)
    np.testing.assert_allclose(both, 2 * delay.report(t, x) - 5 * delay.report(t, y))


def test_the_gain_of_a_drive_multiplies_what_it_reports():
    effect = typical("torque_gain", gain=0.25)
    np.testing.assert_allclose(effect.deliver(np.array([10.0, -5.0])), [8.0, -4.0])


def test_an_unphysical_payload_is_refused_by_the_plant():
    for values, message in (({"mass": 0.0}, "above 0"), ({"mx": 3.0}, "no body of")):
        with pytest.raises(EffectError, match=message):
            Plant(robot(), [typical("payload", **values)])


def test_values_that_a_fit_finds_are_refused_where_it_finds_them():
    def made(text):
        return effects_from_text(text, NAMES, SCALES, gains=False)

    assert made("stribeck:elbow(velocity=0.1)")[0].values["velocity"] == 0.1
    with pytest.raises(EffectError, match="the fit finds level; valid are no values"):
        made("coulomb:elbow(level=3)")
    with pytest.raises(EffectError, match="the fit finds .*; valid are values of"):
        made("stribeck:elbow(level=3)")


def test_a_changed_link_loads_every_joint_below_it():
    (effect,) = effects_from_text("link_inertia:elbow", NAMES, SCALES)
    assert effect.joints == (0, 1, 2)
    assert effects_from_text("link_inertia:shoulder", NAMES, SCALES)[0].joints == (0, 1)


def test_coupled_joints_feel_the_speed_of_each_other():
    effect = typical("transmission_coupling", inertia=0.0, viscous=2.0, coulomb=0.0)
    motion = smooth_motion()
    torque = effect.torque(motion, RigidBody(robot().chain, motion))
    both = 2.0 * (motion.v[:, 1] + motion.v[:, 2])
    np.testing.assert_allclose(torque, np.stack([both, both], axis=1))
    assert (torque * motion.v[:, 1:]).sum(axis=1).min() >= 0
    with pytest.raises(EffectError, match="two joints, not 1"):
        effects_from_text("transmission_coupling:elbow", NAMES, SCALES)


def test_a_coupling_below_zero_is_none_in_the_plant():
    """A fit may end a little below; MuJoCo takes no such tendon."""
    below = typical("transmission_coupling", inertia=-1e-3, coulomb=-0.1)
    model = build_arm(robot(), [below], step=1e-3, integrator="implicitfast").model
    assert model.tendon_armature[0] == model.tendon_frictionloss[0] == 0.0
    assert model.tendon_damping[0] == pytest.approx(below.values["viscous"])


def test_an_elastic_joint_needs_a_rotor_and_a_stiff_one_is_rigid():
    with pytest.raises(EffectError, match="'shoulder' needs a rotor"):
        Plant(robot(), [typical("elasticity")])
    rigid = Plant(robot(), [typical("elasticity", compliance=0.0)])
    assert rigid.arm.model.nv == 3


# --- text ---------------------------------------------------------------------------


def test_an_effect_without_joints_is_at_every_joint_at_its_usual_size():
    effects = effects_from_text("stribeck:elbow,torque_ripple", NAMES, SCALES)
    assert [(e.id, e.joints) for e in effects] == [
        ("stribeck", (2,)), ("torque_ripple", (0,)), ("torque_ripple", (1,)),
        ("torque_ripple", (2,)),
    ]  # fmt: skip
    assert effects[0].values["level"] == pytest.approx(0.03 * SCALES[2].torque)
    assert effects[1].values["sine"] == 2 * effects[3].values["sine"]


def test_values_and_spaces_are_read():
    text = " coulomb:1+3( level = 4 ; ) , viscous:elbow(coefficient=1e-1),"
    one, two, three = effects_from_text(text, NAMES, SCALES)
    assert (one.joints, two.joints, three.joints) == ((0,), (2,), (2,))
    assert (one.values["level"], three.values["coefficient"]) == (4.0, 0.1)
    assert effects_from_text("", NAMES, SCALES) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("magic", r"no effect 'magic'; valid are actuator_lag, .*viscous"),
        ("coulomb:knee", "no joint 'knee'; valid are base, shoulder, elbow or 1 to 3"),
        ("coulomb:0", "no joint '0'"),
        ("coulomb:4", "no joint '4'"),
        ("coulomb(height=1)", "no parameter height; valid are level"),
        ("coulomb(level=high)", "'level=high' is not name=number"),
        ("coulomb(level)", "not name=number"),
        ("coulomb(level=inf)", "finite"),
        ("coulomb:", "cannot read 'coulomb:'; valid is effect"),
        ("coulomb(level=1", "cannot read"),
        ("coulomb level=1", "cannot read"),
        ("stribeck(velocity=9)", "velocity is 9 rad/s, valid is 0.001 to 1"),
        ("transmission_coupling", "transmission_coupling:shoulder.elbow"),
        ("payload:elbow", "whole arm; leave out ':elbow'"),
        ("payload:\u2028\x1b[2J", r"leave out ':\\u2028\\x1b\[2J'"),
    ],
)
def test_text_with_a_mistake_is_refused_with_what_is_valid(text, message):
    with pytest.raises(EffectError, match=message) as error:
        effects_from_text(text, NAMES, SCALES)
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    "content",
    [
        {"joints": ["base"], "values": {}},
        {"effect": "coulomb"},
        {"effect": "coulomb", "joints": 3},
        {"effect": "coulomb", "joints": [1.5]},
        {"effect": "coulomb", "joints": ["knee"]},
        {"effect": "coulomb", "joints": ["base"], "values": {"level": "high"}},
        {"effect": "coulomb", "joints": ["base"], "values": {"level": None}},
        {"effect": "coulomb", "joints": ["base"], "values": 3},
        {"effect": ["coulomb"], "joints": ["base"]},
        ["coulomb"],
    ],
    ids=str,
)
def test_a_damaged_description_is_refused(content):
    with pytest.raises(EffectError):
        effect_from_dict(content, NAMES)


# --- effects of a user's own --------------------------------------------------------

OWN = '''
"""Drag of a hose."""
import numpy as np
from hybrid.effects import Effect, JointEffect, Port, Quantity

class HoseDrag(JointEffect):
    """Drag that grows with the root of speed."""

    id = "hose_drag"
    port = Port.ENVIRONMENT
    gains = (Quantity("drag", "N·m·s/rad", 0.05, 0.0, 1.0, per=(1, 0)),)
    equation = "τ = k · sgn v · √|v|"
    source = "measured 2024"
    sentence = "A hose drags at {joints}."
    remedy = "Remove the hose."

    @staticmethod
    def law(state, **shapes):
        return (state.sign * np.sqrt(np.abs(state.v)),)
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Writes a user's file; what it registers is forgotten after the test."""
    monkeypatch.setattr(registry, "_added", {})
    path = tmp_path / "hose.py"
    monkeypatch.setitem(sys.modules, "hybrid_user_effects_hose", None)

    def write(text):
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_users_effect_takes_part_like_any_other(own):
    assert effects_from_file(own(OWN)) == ("hose_drag",)
    assert "hose_drag" in effect_classes()
    (effect,) = effects_from_text("hose_drag:elbow", NAMES, SCALES)
    assert effect_from_dict(effect.as_dict(NAMES), NAMES) == effect
    motion, body, rest = log_of(effect)
    on, expected = moving(motion, effect), effect.torque(motion, body)[:, 0]
    assert rms(rest[on, 2] - expected[on]) < 0.02 * rms(expected[on])


def test_the_example_of_how_to_add_an_effect_is_one(own):
    guide = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    example = guide.partition("```python\n")[2].partition("```")[0]
    assert effects_from_file(own(example)) == ("quadratic_viscous",)
    effect = effect_class("quadratic_viscous")((1,), {"slope": 0.5})
    motion, body, _ = log_of(effect)
    v = motion.v[:, 1]
    np.testing.assert_allclose(effect.torque(motion, body)[:, 0], 0.5 * v * abs(v))


def test_a_users_effect_does_not_take_the_place_of_a_latency_or_of_servo_gains(own):
    servo = OWN.replace("Port.ENVIRONMENT", "Port.COMMAND").replace("hose", "aside")
    effects_from_file(own(servo))
    late = OWN.replace("hose", "a_late").replace(
        "    port", "    shifts = True\n    port"
    )
    effects_from_file(own(late.replace("Port.ENVIRONMENT", "Port.MEASUREMENT")))
    assert effect_at(Port.COMMAND, shifts=False).id == "controller_gain"
    assert effect_at(Port.COMMAND, shifts=True).id == "command_latency"
    assert effect_at(Port.MEASUREMENT, shifts=True).id == "delay"


def test_a_users_file_may_be_read_again_after_a_change(own):
    effects_from_file(own(OWN))
    effects_from_file(own(OWN.replace("0.05", "0.5")))
    assert effect_class("hose_drag").gains[0].typical == 0.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "defines no concrete subclass"),
        ("from hybrid.effects import Effect, JointEffect", "defines no concrete"),
        ("class Broken(:", "SyntaxError: .*line 1"),
        ("import no_such_module_at_all", "ModuleNotFoundError: .*no_such_module"),
        ("1 / 0", "ZeroDivisionError"),
        (OWN.replace('id = "hose_drag"', ""), "HoseDrag does not state id"),
        (OWN.replace('remedy = "Remove the hose."', ""), "HoseDrag does not state rem"),
        (OWN.replace('"hose_drag"', '"coulomb"'), "coulomb exists already"),
    ],
)
def test_a_users_file_with_a_mistake_is_refused_and_changes_nothing(own, text, message):
    before = dict(effect_classes())
    with pytest.raises(EffectError, match=f"hose.py: {message}") as error:
        effects_from_file(own(text))
    assert "\n" not in str(error.value)
    assert effect_classes() == before


def test_a_missing_file_of_effects_is_refused(tmp_path):
    with pytest.raises(EffectError, match="none.py: no such file of effects"):
        effects_from_file(tmp_path / "none.py")
    with pytest.raises(EffectError, match="no such file"):
        effects_from_file(tmp_path)
    notes = tmp_path / "effects.txt"
    notes.write_text("coulomb")
    with pytest.raises(EffectError, match="not a Python file"):
        effects_from_file(notes)


@pytest.fixture
def installed(own, tmp_path, monkeypatch):
    """Installs another package's file under an entry point, for one test."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "hose", raising=False)

    def install(text, value="hose"):
        own(text)
        point = EntryPoint("hoses", value, "hybrid.effects")
        monkeypatch.setattr(registry, "entry_points", lambda group: [point])
        registry._shipped.cache_clear()

    yield install
    monkeypatch.undo()
    sys.modules.pop("hose", None)
    registry._shipped.cache_clear()


@pytest.mark.parametrize("value", ["hose", "hose:HoseDrag"])
def test_an_installed_package_adds_its_effects(installed, value):
    installed(OWN, value)
    assert list(effect_classes()) == sorted([*EFFECTS, "hose_drag"])
    assert effects_from_text("hose_drag:elbow", NAMES, SCALES)[0].joints == (2,)


@pytest.mark.parametrize(
    ("text", "value", "message"),
    [
        ("1 / 0", "hose", "ZeroDivisionError"),
        (OWN, "hose:np", "no concrete subclass"),
        (OWN, "hose:Hose", "AttributeError"),
        (OWN, "not_there", "ModuleNotFoundError"),
        (OWN.replace('id = "hose_drag"', ""), "hose", "does not state id"),
        (OWN.replace('"hose_drag"', '"coulomb"'), "hose", "coulomb exists already"),
    ],
)
def test_an_installed_package_with_a_mistake_is_named(installed, text, value, message):
    installed(text, value)
    with pytest.raises(EffectError, match=f"hoses = {value}: .*{message}") as error:
        effect_classes()
    assert "\n" not in str(error.value)


def test_the_vocabulary_is_complete():
    expected = """
        actuator_lag armature asymmetric_friction backlash command_latency contact
        controller_gain coulomb counterbalance deadzone delay elasticity
        encoder_eccentricity encoder_offset friction_lag gravity_tilt link_inertia
        load_friction nonlinear_viscous payload presliding saturation spring
        stiffening_spring stribeck thermal_friction torque_gain torque_offset
        torque_ripple transmission_coupling viscous
    """
    assert set(expected.split()) <= set(EFFECTS)
    assert list(EFFECTS) == sorted(EFFECTS)


def test_the_classes_of_the_vocabulary_are_no_effects_themselves():
    assert Effect not in EFFECTS.values() and JointEffect not in EFFECTS.values()
    with pytest.raises(TypeError):
        Effect((0,))
    assert Quantity("x", "", 1.0, 0.0, 2.0).scaled(Scale(5.0, 2.0)).typical == 1.0
