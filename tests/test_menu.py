"""The safe menu: every experiment is there, within limits, and clear of the links."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum import gap_of
from simulated import arm

from hybrid.diagnosis.advice.menu import Menu, gap_along
from hybrid.dynamics import RigidBody, inverse_dynamics
from hybrid.errors import ExcitationError


def recorded():
    """A gap of the planar arm."""
    return replace(gap_of(size=2, count=1), robot=arm("planar"))


@cache
def menu_of(name, seed=0):
    return Menu(arm(name), np.random.default_rng(seed), rate=100.0)


def keeps_the_limits(robot, reference, carrying):
    """Whether a motion is within the file's limits, from rest to rest."""
    r = reference
    tau = inverse_dynamics(carrying.chain, carrying.chain.inertial, r.q, r.v, r.a)
    tau += robot.chain.armature * r.a + robot.damping * r.v
    tau = np.abs(tau) + robot.frictionloss
    still = np.abs(np.stack([r.v[0], r.v[-1]])).max() < 1e-6
    return still and all(
        (
            (r.q >= robot.q_min - 1e-9).all(),
            (r.q <= robot.q_max + 1e-9).all(),
            (np.abs(r.v) <= robot.v_max + 1e-9).all(),
            (np.abs(r.a) <= robot.a_max + 1e-9).all(),
            (tau <= robot.tau_max + 1e-9).all(),
        )
    )


@pytest.mark.parametrize("name", ["planar", "coman_like", "scara"])
def test_every_experiment_of_the_menu_is_there_and_safe(name):
    robot, menu = arm(name), menu_of(name)
    found = menu.about(1)
    begins = (
        "one path of all joints at 0.5, 1 and 2", "a ladder of speeds",
        "small reversals", "moves between poses", "a multisine", "a fast random",
        "a random motion of all joints again when the drives are warm",
        "a random motion of all joints twice, the second time with the gains",
        "a random motion of all joints with a known mass",
    )  # fmt: skip
    for begin in begins:
        assert sum(x.name.startswith(begin) for x in found) == 1, begin
    for experiment in found:
        r = experiment.reference
        assert keeps_the_limits(robot, r, experiment.arm(robot)), experiment.name
        np.testing.assert_allclose(r.q[0], r.q[-1], atol=1e-6)
        every = menu.clearance.distance(r.q[::20])
        assert every.min() > 0.005, experiment.name


@pytest.mark.study
@settings(max_examples=8)
@given(
    seed=st.integers(0, 2**31),
    part=st.floats(0.2, 1.0),
    weak=st.floats(0.3, 2.0),
)
def test_a_menu_is_safe_on_whatever_arm(seed, part, weak):
    whole = arm("planar")
    middle, half = (whole.q_min + whole.q_max) / 2, (whole.q_max - whole.q_min) / 2
    robot = replace(
        whole,
        q_min=middle - part * half,
        q_max=middle + part * half,
        v_max=part * whole.v_max,
        tau_max=weak * whole.tau_max,
    )
    menu = Menu(robot, np.random.default_rng(seed), rate=50.0)
    for experiment in menu.about(seed % 2):
        carrying = experiment.arm(robot)
        assert keeps_the_limits(robot, experiment.reference, carrying), experiment.name


def test_links_that_come_too_close_are_refused():
    menu = menu_of("coman_like")
    (move, *_) = [x for x in menu.about(1) if "poses" in x.name]
    least = menu.clearance.distance(move.reference.q).min()
    assert menu.checked(move.reference) is move.reference
    strict = Menu(arm("coman_like"), np.random.default_rng(0), rate=100.0)
    strict.clearance = replace(menu.clearance, margin=1.05 * least)
    with pytest.raises(ExcitationError, match="closeness"):
        strict.checked(move.reference)


def test_along_an_experiment_with_a_mass_the_simulator_carries_it():
    (carry,) = [x for x in menu_of("planar").of_all_joints if x.mass > 0]
    ahead = gap_along(recorded(), carry)
    bare = RigidBody(arm("planar").chain, ahead.motions[0]).load
    assert np.abs(ahead.bodies[0].load - bare).max() > 0.1
