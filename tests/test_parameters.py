"""Parameters and quantities: units, bounds and sizes."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid.effects import Quantity, Scale
from hybrid.errors import HybridError
from hybrid.parameters import Parameter

numbers = st.floats(-1e6, 1e6)
sizes = st.floats(0.01, 1e4)


def test_a_parameter_knows_its_unit_bounds_and_uncertainty():
    level = Parameter("level", 2.0, 0.0, 5.0, "N·m", std=0.1)
    assert (level.value, level.unit, level.std) == (2.0, "N·m", 0.1)
    assert math.isnan(Parameter("level", 2.0).std)


@pytest.mark.parametrize("value", [-0.1, 5.1, math.nan, math.inf])
def test_a_value_outside_its_bounds_is_refused_with_the_bounds(value):
    with pytest.raises(HybridError, match="'level'.*valid is 0 to 5 N·m"):
        Parameter("level", value, 0.0, 5.0, "N·m")


@given(lower=numbers, width=st.floats(0, 1e6), part=st.floats(0, 1))
def test_every_value_within_the_bounds_is_accepted(lower, width, part):
    upper = lower + width
    value = min(max(lower + part * width, lower), upper)
    assert Parameter("x", value, lower, upper).value == value


def test_an_unbounded_unestimated_parameter_is_valid_json():
    content = Parameter("x", 1.5).as_dict()
    assert json.loads(json.dumps(content, allow_nan=False)) == {
        "name": "x", "value": 1.5, "lower": None, "upper": None, "unit": "", "std": None
    }  # fmt: skip


@given(torque=sizes, speed=sizes)
def test_sizes_are_multiples_of_rated_torque_and_speed(torque, speed):
    damping = Quantity("viscous", "N·m·s/rad", 0.05, 0.0, 1.0, per=(1, -1))
    scaled = damping.scaled(Scale(torque, speed))
    assert scaled.typical == pytest.approx(0.05 * torque / speed)
    assert scaled.upper == pytest.approx(torque / speed)
    assert (scaled.lower, scaled.per, scaled.unit) == (0.0, (0, 0), "N·m·s/rad")
    assert scaled.scaled(Scale(7.0, 3.0)) == scaled


def test_a_quantity_in_si_units_has_one_size_for_all_joints():
    time = Quantity("time", "s", 0.005, -0.05, 0.05)
    assert time.scaled(Scale(150.0, 3.0)) == time
