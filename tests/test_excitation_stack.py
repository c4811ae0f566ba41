"""Motions that are chosen as a set."""

from functools import cache

import numpy as np
import pytest
from arms import MODELS

from hybrid.excitation import Condition, Fourier, Limits, design, observe
from hybrid.excitation.constraints import MotionLimits
from hybrid.excitation.path import uniform
from hybrid.excitation.program import MotionProgram
from hybrid.robot import Robot

PLANAR = Robot.load(MODELS / "planar.xml")
OBSERVATION = observe(PLANAR.chain)


def stack(count: int) -> MotionProgram:
    limits = Limits.of(PLANAR)
    b = OBSERVATION.size
    return MotionProgram(
        OBSERVATION,
        Condition(),
        Fourier(3, 0.2),
        (MotionLimits(limits, PLANAR.joints),),
        limits,
        np.eye(b),
        20.0,
        4.0,
        1e-3,
        count,
    )


@cache
def chosen(together: bool):
    return design(
        PLANAR, OBSERVATION, Fourier(3, 0.2), seed=np.random.default_rng(0),
        criterion=Condition(), trajectories=2, starts=2, together=together,
    )  # fmt: skip


def test_objective_and_conditions_have_exact_slopes():
    program, rng = stack(3), np.random.default_rng(1)
    x, direction = program.random(rng), rng.normal(size=program.random(rng).shape)
    step = 1e-6 * direction
    _, slope = program.objective(x)
    change = program.objective(x + step)[0] - program.objective(x - step)[0]
    assert change / 2e-6 == pytest.approx(slope @ direction, rel=1e-5)
    values, slopes = program.conditions(x)
    later, _ = program.conditions(x + step)
    np.testing.assert_allclose(later - values, slopes @ step, atol=1e-9)
    assert program.excess(x) == pytest.approx(values.max())


def test_the_order_of_the_motions_does_not_matter():
    program = stack(3)
    x = program.random(np.random.default_rng(2))
    turned = np.roll(x.reshape(3, -1), 1, axis=0).ravel()
    assert program.objective(turned)[0] == pytest.approx(program.objective(x)[0])
    assert program.excess(turned) == program.excess(x)


@pytest.mark.study
def test_a_set_is_better_than_motions_one_after_the_other():
    assert chosen(True).condition < chosen(False).condition


def test_each_motion_of_a_set_keeps_the_limits():
    found, limits = chosen(True), Limits.of(PLANAR)
    assert len(found.trajectories) == 2 and max(found.excess.values()) <= 0
    for trajectory in found.trajectories:
        path = trajectory.path(uniform(5.0, 1000.0))
        assert (path.q >= limits.low).all() and (path.q <= limits.high).all()
        assert (np.abs(path.v) <= limits.speed).all()
    assert found.condition == Condition().value(np.asarray(sum(found.grams)))
