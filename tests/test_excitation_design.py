"""The course of a design: starts, refinements, repairs, and motions one by one."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.errors import ExcitationError
from hybrid.excitation import Condition, Design, DOptimal, Fourier, Limits, observe
from hybrid.excitation import design as make
from hybrid.excitation.path import Trajectory
from hybrid.excitation.solver import Optimum


@pytest.fixture
def module():
    import importlib

    return importlib.import_module("hybrid.excitation.design")


@dataclass(frozen=True)
class Asked:
    """A problem whose motions exceed their limits by what is said, check by check."""

    excess: tuple[float, ...]
    seen: list
    power: float = 1.0
    margin: float = 1e-3

    def verified(self, x):
        self.seen.append(("check", float(x[0]), self.margin))
        checks = sum(step[0] == "check" for step in self.seen)
        return {"far": self.excess[checks - 1], "near": -1.0}


def solving(monkeypatch, module, found):
    """Minimisations that end as is said, start by start."""

    def solve(program, x, *, iterations, curvature=None, penalty=5.0):
        program.seen.append(("solve", program.power, iterations, penalty))
        known = None if curvature is None else curvature[0, 0]
        assert (known is None) == (sum(s[0] == "solve" for s in program.seen) <= 3)
        value, excess = found(float(x[0]))
        return Optimum(x, value, excess, np.full((1, 1), x[0]))

    monkeypatch.setattr(module, "solve", solve)


def test_the_best_start_is_refined_in_three_steps_and_checked(monkeypatch, module):
    """An excess costs five times its size, and above a hundredth it comes last."""
    outcome = {1.0: (0.3, 0.0), 2.0: (0.1, 0.009), 3.0: (-9.0, 0.011)}
    solving(monkeypatch, module, outcome.__getitem__)
    asked = Asked((0.0,), [])
    points = [np.array([x]) for x in outcome]
    x, excess = module.best_point(asked, points)
    assert x == 2.0 and excess == {"far": 0.0, "near": -1.0}
    assert asked.seen == [
        *[("solve", 4.0, 80, 5.0)] * 3, ("solve", 4.0, 80, 5.0),
        ("solve", 16.0, 100, 5.0), ("solve", 64.0, 200, 5.0), ("check", 2.0, 1e-3),
    ]  # fmt: skip


@pytest.mark.parametrize(("left", "factor"), [(0.9e-4, 1.0), (1.1e-4, 10.0)])
def test_a_motion_beyond_a_limit_is_repaired_by_more_margin(
    monkeypatch, module, left, factor
):
    """And by a higher price, where the limit was exceeded on the grid of the design."""
    solving(monkeypatch, module, lambda _: (0.0, left))
    asked = Asked((0.01, 0.005, -1e-9), [])
    points = [np.array([x]) for x in (1.0, 2.0, 3.0)]
    module.best_point(asked, points)
    repairs = [x for x in asked.seen[6:] if x[0] == "solve"]
    assert repairs == [("solve", 64.0, 60, 5.0 * factor**k) for k in (1, 2)]
    margins = []
    solve = module.solve

    def noting(program, x, **options):
        margins.append(program.margin)
        return solve(program, x, **options)

    monkeypatch.setattr(module, "solve", noting)
    again = Asked((0.01, 0.005, -1e-9), [])
    module.best_point(again, points)
    np.testing.assert_allclose(margins[-2:], [1e-3 + 0.012, 1e-3 + 0.018])


def test_after_seven_repairs_a_motion_is_given_up(monkeypatch, module):
    solving(monkeypatch, module, lambda _: (0.0, 0.0))
    points = [np.array([x]) for x in (1.0, 2.0, 3.0)]
    module.best_point(Asked((0.02,) * 6 + (0.0,), []), points)
    with pytest.raises(ExcitationError, match="exceeds the far by 2 %. Valid"):
        module.best_point(Asked((0.02,) * 7 + (0.0,), []), points)


# --- one by one -----------------------------------------------------------------------


def test_a_motion_worse_than_the_last_again_is_replaced_by_it(monkeypatch, module):
    """The worst excess of each limit is that of the motions that are kept."""
    seen = observe(pendulum(1).chain)
    family = Fourier(2, 0.5)
    large, small = np.array([0.0, 1.0, 0.5]), np.array([0.0, 0.01, 0.0])
    found = iter([
        (large, {"a": -0.2, "b": -0.1}), (small, {"a": 0.5, "b": 0.5}),
        (1.1 * large, {"a": -0.3, "b": -0.05}),
    ])  # fmt: skip
    given = []

    def best_point(program, points):
        given.append(len(points))
        return next(found)

    monkeypatch.setattr(module, "best_point", best_point)
    limits = Limits.of(pendulum(1))
    program = module.MotionProgram(
        seen, DOptimal(), family, (), limits, np.zeros((seen.size, seen.size)),
        20.0, 1.0, 1e-3,
    )  # fmt: skip
    chosen, worst = module._one_by_one(program, 3, 2, np.random.default_rng(0))
    first, again, last = (x.coefficients for x in chosen)
    np.testing.assert_array_equal(first, program.coefficients(large))
    np.testing.assert_array_equal(again, first)
    np.testing.assert_array_equal(last, program.coefficients(1.1 * large))
    assert given == [2, 3, 3]  # from the last motion, too
    assert worst == {"a": -0.2, "b": -0.05}


def test_a_design_of_which_nothing_is_said_has_one_motion_of_four_starts(
    monkeypatch, module
):
    asked = []

    class Enough(Exception):
        pass

    def one_by_one(program, count, starts, rng):
        asked.append((program.rate, program.margin, count, starts, rng.random()))
        raise Enough

    monkeypatch.setattr(module, "_one_by_one", one_by_one)
    robot = pendulum(1)
    with pytest.raises(Enough):
        make(robot, observe(robot.chain), Fourier(2, 0.5), criterion=Condition())
    usual = np.random.default_rng(0).random()
    assert asked == [(20.0, 1e-3, 1, 4, usual)]


def two_motions():
    robot = replace(pendulum(1), name="rod")
    seen, family = observe(robot.chain), Fourier(2, 0.5)
    motions = tuple(
        Trajectory(family, np.array([[0.1], [x], [0.3]])) for x in (1.0, 0.4)
    )
    t = np.linspace(0.0, 2.0, 41)
    grams = tuple(seen.gram(x.path(t), turning_speed=0.0) for x in motions)
    return Design(robot, seen, Condition(), motions, grams, 20.0, 3.0, {"a": -0.1})


def test_motions_are_written_at_two_hundred_samples_a_second(tmp_path):
    files = two_motions().save(tmp_path / "out", more={"why": "a test"})
    assert [len(x.read_text().splitlines()) for x in files] == [402, 402]


def test_figures_of_a_design_are_those_of_its_information():
    found = two_motions()
    G = found.grams[0] + found.grams[1]
    np.testing.assert_allclose(found.gram, G)
    assert found.log_det == pytest.approx(np.log(np.linalg.det(G)))
    np.testing.assert_allclose(
        found.singular_values, np.sqrt(np.linalg.eigvalsh(G))[::-1]
    )
    assert found.condition == pytest.approx(np.sqrt(np.linalg.cond(G)))
    errors = np.sqrt(np.diag(np.linalg.inv(G))) * found.observation.scale
    np.testing.assert_allclose(found.standard_errors(), errors)
    # The mean axis of an ellipsoid is a root of its volume.
    volume = [np.linalg.det(x) ** (-0.5 / len(G)) for x in (found.grams[0], G)]
    np.testing.assert_allclose(found.additions, [1.0, 1 - volume[1] / volume[0]])
    content = found.as_dict()
    assert content["design_rate"] == 20.0 and content["criterion"] == "Condition"
    assert SimpleNamespace(**content).excess == {"a": -0.1}
