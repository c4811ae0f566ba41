"""What links carry beyond what the robot file says."""

import numpy as np
import pytest
from simulated import arm

from hybrid.effects import effect_class
from hybrid.plant import Plant

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
