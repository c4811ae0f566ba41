"""What links carry beyond what the robot file says."""

from types import SimpleNamespace

import numpy as np
import pytest
from coarse import Plant
from simulated import arm

from hybrid.effects import Scale, effect_class

LOAD = {"mass": 1.0, "mx": 0.1, "mz": 0.05, "Ixx": 0.05, "Iyy": 0.06, "Izz": 0.04}
PLACES = [("payload", (0, 1)), ("link_inertia", (1,)), ("link_inertia", (0,))]


@pytest.mark.parametrize("first", PLACES)
@pytest.mark.parametrize("second", PLACES)
def test_one_link_may_carry_several(first, second):
    """Mass and inertia of the plant are those of both."""
    effects = [effect_class(name)(joints, LOAD) for name, joints in (first, second)]
    robot = arm("planar")
    total = robot.chain.inertial.copy()
    for effect in effects:
        total[effect.joints[-1]] += effect.gain_values
    plain = Plant(robot.with_inertial(total)).arm.model
    loaded = Plant(robot, effects).arm.model
    assert loaded.body_mass.sum() == pytest.approx(plain.body_mass.sum())
    assert np.allclose(_mass_matrix(loaded), _mass_matrix(plain), rtol=1e-9)


def _mass_matrix(model):
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, -0.7]
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


@pytest.mark.parametrize(
    ("masses", "usual"), [([1.0, 3.0, 8.0], 3.0), ([0.0] * 3, 0.1)]
)
def test_a_payload_is_about_as_heavy_as_a_link_and_some_centimetres_away(masses, usual):
    """As a mass at a point whose coordinates have a standard deviation of 5 cm."""
    inertial = np.zeros((3, 10))
    inertial[:, 0] = masses
    law = effect_class("payload")((0, 1, 2))
    std, least = law.prior(SimpleNamespace(inertial=inertial), Scale(1.0, 1.0))
    x, y, z = np.random.default_rng(0).normal(0.0, 0.05, (3, 10_000))
    moments = y**2 + z**2, x * y, x**2 + z**2, x * z, y * z, x**2 + y**2
    sizes = np.sqrt(np.mean(np.square([x / x, x, y, z, *moments]), axis=1))
    np.testing.assert_allclose(std[:4] / usual, sizes[:4], rtol=0.05)
    assert (sizes[4:] < 2.0 * std[4:] / usual).all()
    assert (std[4:] / usual <= 2.0 * sizes[4:] * 1.05).all()
    own = {0, 4, 6, 9}  # the mass and the moments of inertia
    assert least.tolist() == [0.0 if k in own else -np.inf for k in range(10)]


def test_mass_centre_and_gyration_of_a_link_are_off_by_a_seventh_each():
    size = np.arange(20.0).reshape(2, 10)
    law = effect_class("link_inertia")((1,))
    std, least = law.prior(SimpleNamespace(size=size), Scale(1.0, 1.0))
    mass, length = np.random.default_rng(0).normal(1.0, 0.15, (2, 100_000))
    relative = [np.std(mass * length**k) for k in (0, 1, 2)]
    expected = np.repeat(relative, [1, 3, 6]) * size[1]
    np.testing.assert_allclose(std, expected, rtol=0.03)
    assert np.isneginf(least).all() and len(least) == 10
    assert list(type(law).places(3)) == [(0,), (0, 1), (0, 1, 2)]
    assert list(effect_class("payload").places(3)) == [(0, 1, 2)]
