"""Reference motions say what is too short for them."""

import numpy as np
import pytest
from simulated import arm

from hybrid.errors import HybridError
from hybrid.plant import random_fourier


def test_a_motion_too_short_for_its_harmonics_is_refused_with_what_is_valid():
    for duration, rate, order, fewest in ((0.01, 500, 5, 20), (0.05, 200, 8, 32)):
        with pytest.raises(
            HybridError,
            match=f"{duration:g} s at {rate} Hz is too short for {order} harmonics; "
            f"valid are {fewest} samples or more",
        ):
            random_fourier(
                arm("planar"),
                duration=duration,
                rate=rate,
                order=order,
                seed=np.random.default_rng(0),
            )


def test_the_shortest_motion_is_one_that_stays_within_the_limits():
    robot = arm("planar")
    motion = random_fourier(
        robot, duration=20 / 500, rate=500, seed=np.random.default_rng(0)
    )
    assert len(motion.t) == 21
    assert (np.abs(motion.v).max(axis=0) <= robot.v_max).all()
    assert (np.abs(motion.q[[0, -1]]) <= np.pi).all()
