"""Unit, usual size and bounds of every parameter: what saved models and users rely on.

Bounds decide what a fit may find and what a file may hold; the usual size is what the
plant gets where nothing is said, and the prior of a fit. A change here is one of the
format, and belongs into the changelog.
"""

import sys
from functools import cache

import numpy as np
import pytest
from pendulum import pendulum, swings

from hybrid.dynamics import RigidBody
from hybrid.effects import effect_class, effect_classes
from hybrid.effects.quantity import Quantity, Scale

# Effect, parameter, usual size, bounds, what these are multiples of (rated torque τ and
# speed v of the joint), unit; "inner" is of the fit alone, "whole" a number of things.
TABLE = """
actuator_lag          time              0.005    -0.05    0.05     1     s
armature              inertia           0.02     0        0.5      τ/v   kg·m²
asymmetric_friction   level             0.015    -0.2     0.2      τ     N·m
backlash              half_width        0.001    0        0.01     1     rad
command_latency       time              0.01     0        0.2      1     s
contact               force_x           10       -500     500      1     N
contact               force_y           10       -500     500      1     N
contact               force_z           10       -500     500      1     N
contact               moment_x          1        -100     100      1     N·m
contact               moment_y          1        -100     100      1     N·m
contact               moment_z          1        -100     100      1     N·m
contact               start             1        0        1e+09    1     s
contact               duration          0.5      0.01     1e+09    1     s
contact               rise              0        0        1        1     -
contact               recording         -1       -1       1e+06    1     - whole
controller_gain       stiffness         -0.2     -0.9     5        1     -
controller_gain       damping           -0.2     -0.9     5        1     -
coulomb               level             0.04     0        0.3      τ     N·m
counterbalance        spring            0.05     0        5        τ     N·m
counterbalance        preload           0.1      -5       5        τ     N·m
counterbalance        dead_centre       0        -4       4        1     rad
counterbalance        crank_ratio       0.3      0.01     0.95     1     -
deadzone              width             0.02     0        0.3      τ     N·m
deadzone              onset             0.005    0.0005   0.3      τ     N·m inner
deadzone              total             0        0        1        1     - inner whole
delay                 time              0.005    -0.05    0.05     1     s
elasticity            compliance        0.01     0        0.5      1/τ   rad/(N·m)
elasticity            damping           0.02     0        1        τ/v   N·m·s/rad
encoder_eccentricity  sine              0.004    -0.05    0.05     1     rad
encoder_eccentricity  cosine            0.002    -0.05    0.05     1     rad
encoder_offset        offset            0.01     -0.2     0.2      1     rad
friction_lag          coefficient       0.05     0        1        τ/v   N·m·s/rad
friction_lag          time              0.05     0.005    0.5      1     s
gravity_tilt          roll              0.02     -0.2     0.2      1     rad
gravity_tilt          pitch             0.01     -0.2     0.2      1     rad
load_friction         coefficient       0.1      0        0.6      1     -
nonlinear_viscous     quadratic         0.02     -0.5     0.5      τ/v²  N·m·s²/rad²
nonlinear_viscous     cubic             0.005    -0.5     0.5      τ/v³  N·m·s³/rad³
nonlinear_viscous     fastest           1000     0.0001  1000    1     rad/s whole
payload               mass              2        0        50       1     kg
payload               mx                0        -20      20       1     kg·m
payload               my                0        -20      20       1     kg·m
payload               mz                0.2      -20      20       1     kg·m
payload               Ixx               0.022    0        20       1     kg·m²
payload               Ixy               0        -10      10       1     kg·m²
payload               Iyy               0.022    0        20       1     kg·m²
payload               Ixz               0        -10      10       1     kg·m²
payload               Iyz               0        -10      10       1     kg·m²
payload               Izz               0.002    0        20       1     kg·m²
presliding            level             0.04     0        0.3      τ     N·m
presliding            distance          0.005    1e-05    0.2      1     rad
saturation            loss              0.5      0        1        1     -
saturation            limit             0.3      0.02     2        τ     N·m
saturation            total             0        0        1        1     - inner whole
spring                stiffness         0.05     -2       2        τ     N·m/rad
spring                preload           0        -2       2        τ     N·m
stiffening_spring     stiffness         0.05     0        2        τ     N·m/rad
stiffening_spring     rest              0        -3.2     3.2      1     rad
stiffening_spring     knee              2        0.3      20       1     rad
stribeck              level             0.03     0        0.3      τ     N·m
stribeck              velocity          0.05     0.001    1        1     rad/s
stribeck              exponent          2        0.5      3        1     -
thermal_friction      cold              0.04     0        1        τ/v   N·m·s/rad
thermal_friction      time_constant     300      5        10000    1     s
thermal_friction      warm_up           30       0.1      1000     v²    rad²/s
thermal_friction      temperature_scale 20       5        100      1     K
threshold_friction    coulomb_positive  0.04     0        0.5      τ     N·m
threshold_friction    coulomb_negative  0.04     0        0.5      τ     N·m
threshold_friction    falling           0.01     0        0.5      τ     N·m
threshold_friction    falling_steep     0.01     0        0.5      τ     N·m
threshold_friction    rising            0        0        0.5      τ     N·m
threshold_friction    viscous           0.05     0        1        τ/v   N·m·s/rad
threshold_friction    quadratic         0        0        1        τ/v²  N·m·s²/rad²
threshold_friction    cubic             0        0        1        τ/v³  N·m·s³/rad³
threshold_friction    threshold         0.2      0.0001   100      1     rad/s
threshold_friction    width             0.002    0        10       1     rad/s
threshold_friction    fastest           1000     0.0001   1000     1     rad/s whole
torque_gain           gain              0.1      -0.5     0.5      1     -
torque_offset         level             0.02     -0.3     0.3      τ     N·m
torque_ripple         sine              0.02     -0.15    0.15     τ     N·m
torque_ripple         cosine            0        -0.15    0.15     τ     N·m
torque_ripple         periods           20       1        1000     1     1/turn
torque_ripple         fastest           1000     0.0001   1000     1     rad/s whole
transmission_coupling inertia           0.01     0        0.5      τ/v   kg·m²
transmission_coupling viscous           0.02     0        1        τ/v   N·m·s/rad
transmission_coupling coulomb           0.02     0        0.3      τ     N·m
viscous               coefficient       0.05     0        1        τ/v   N·m·s/rad
"""
PER = {
    "1": (0, 0), "τ": (1, 0), "1/τ": (-1, 0), "τ/v": (1, -1), "τ/v²": (1, -2),
    "τ/v³": (1, -3), "v²": (0, 2),
}  # fmt: skip
ROWS = [line.split() for line in TABLE.strip().splitlines()]


SIZES = [Scale(10.0, 2.0)] * 2


@cache
def acting(name):
    """The effect at its usual size, and its torque per unit of each gain."""
    cls, (motion, *_) = effect_class(name), swings(2, count=1, seconds=0.2)
    effect = cls.typical(next(cls.places(2)), SIZES)
    return effect, effect.columns(motion, RigidBody(pendulum(2).chain, motion))


@pytest.mark.parametrize("row", ROWS, ids=[f"{r[0]}-{r[1]}" for r in ROWS])
def test_a_parameter_has_its_documented_unit_size_and_bounds(row):
    name, parameter, typical, lower, upper, per, unit, *flags = row
    effect, columns = acting(name)
    (found,) = [q for q in (*effect.gains, *effect.shapes) if q.name == parameter]
    assert found.unit == ("" if unit == "-" else unit)
    numbers = (found.typical, found.lower, found.upper)
    assert numbers == (float(typical), float(lower), float(upper))
    assert found.per == PER[per]
    assert (found.inner, found.whole) == ("inner" in flags, "whole" in flags)
    size = 10.0 ** PER[per][0] * 2.0 ** PER[per][1]
    assert effect.values[parameter] == pytest.approx(size * float(typical))
    told = found.scaled(SIZES[effect.joints[-1]])
    assert (told.lower, told.upper) == pytest.approx(
        (size * float(lower), size * float(upper))
    )
    assert np.isfinite(columns).all() and columns.shape[2] == len(effect.gains)


def test_every_parameter_is_documented():
    own = {(r[0], r[1]) for r in ROWS}
    for name, cls in effect_classes().items():
        # Effects of other tests' own may be there; a link has other numbers.
        if cls.__module__.startswith("hybrid.") and name != "link_inertia":
            assert {(name, q.name) for q in (*cls.gains, *cls.shapes)} <= own


FLAGS = {
    "steep": "backlash elasticity",
    "differentiates": "actuator_lag armature delay link_inertia payload",
    "shifts": "command_latency delay",
    "usual": "armature coulomb torque_offset viscous",
    "inborn": "armature link_inertia",
    "composite": "threshold_friction",
    "repeats": "contact torque_ripple",
    "shows_in_motion": "actuator_lag backlash delay elasticity",
    "warms": "thermal_friction",
    "dry": "asymmetric_friction coulomb load_friction stribeck threshold_friction",
}


@pytest.mark.parametrize("name", effect_classes())
def test_a_fit_treats_an_effect_as_it_says(name):
    """Which are scanned, begin a fit, may occur again, are sums of other laws."""
    effect, _ = acting(name)
    expected = {flag for flag, names in FLAGS.items() if name in names.split()}
    assert {flag for flag in FLAGS if getattr(effect, flag, False)} == expected
    rough = {"backlash": 0.4, "elasticity": 0.4}
    assert effect.rough == rough.get(name, 0.0)
    assert effect.exact_fields.items() <= effect.fields.items()
    distinct = {"contact": 10.0, "torque_ripple": 6.0, "thermal_friction": 4.0}
    assert effect.choices == distinct.get(name)
    inexact = {
        "backlash": {"half_width": 0.1},
        "controller_gain": {"damping": 0.03, "stiffness": 0.001},
        "delay": {"time": 0.03},
        "elasticity": {"compliance": 0.05, "damping": 0.5},
        "load_friction": {"coefficient": 0.01},
        "presliding": {"level": 0.01, "distance": 0.01},
        "saturation": {"limit": 0.005},
    }
    assert dict(effect.inexact) == inexact.get(name, {})


@pytest.mark.parametrize("name", effect_classes())
def test_a_law_is_known_without_a_simulator(name):
    """Which takes as long to load as all of the rest."""
    effect, _ = acting(name)
    assert not hasattr(sys.modules[type(effect).__module__], "mujoco")


def test_a_loss_may_be_large_and_an_order_of_ripple_moves_by_half_at_most():
    quantities = [
        (name, q)
        for name in effect_classes()
        for q in (*acting(name)[0].gains, *acting(name)[0].shapes)
    ]
    wide = {(name, q.name): q.spread for name, q in quantities if q.spread is not None}
    near = {(name, q.name): q.near for name, q in quantities if q.near is not None}
    assert wide == {("saturation", "loss"): 5.0}
    assert near == {("torque_ripple", "periods"): 0.5}


def test_a_prior_is_twice_the_usual_size_or_a_third_of_the_largest():
    assert Quantity("x", "", 0.5, -2.0, 3.0, spread=4.0).deviation == 4.0
    assert Quantity("x", "", -0.4, -2.0, 3.0).deviation == 0.8
    assert Quantity("x", "", 0.6, -2.0, 1.5).deviation == pytest.approx(2 / 3)
    assert Quantity("x", "", 0.0, -0.3, 1.5).deviation == pytest.approx(0.5)


def test_sizes_scale_with_torque_and_speed_of_the_joint():
    plain = Quantity("x", "", 0.5, -2.0, 3.0, spread=4.0)
    assert plain.scaled(Scale(10.0, 2.0)) == plain
    scaled = Quantity("x", "", 0.5, -2.0, 3.0, per=(1, -2), spread=4.0).scaled(
        Scale(10.0, 2.0)
    )
    assert scaled == Quantity("x", "", 1.25, -5.0, 7.5, spread=10.0)
