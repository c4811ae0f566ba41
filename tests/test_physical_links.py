"""Physical links of a diagnosis: the most probable ones, beside all other gains."""

from types import SimpleNamespace

import numpy as np
from arms import MODELS
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.diagnosis.evidence.evidence import Solution
from hybrid.diagnosis.explanations.physical import is_physical, solve_physical
from hybrid.effects.payload import LinkInertia
from hybrid.robot import Robot

CHAIN = Robot.load(MODELS / "planar.xml").chain
N = CHAIN.inertial.size
COUNT = N + 3
INDEX = np.arange(COUNT)


def problem(seed, size):
    """Evidence of errors of links, and three other gains; its optimum is known."""
    rng = np.random.default_rng(seed)
    scale = np.append(np.abs(CHAIN.inertial.ravel()) + 0.02, np.ones(3))
    root = rng.normal(size=(COUNT, COUNT + 5)) / scale[:, None]
    precision = 1e-2 / scale**2
    P, best = root @ root.T + np.diag(precision), size * scale * rng.normal(size=COUNT)
    b = P @ best

    def loss(gains):
        return 0.5 * gains @ P @ gains - b @ gains

    return SimpleNamespace(
        solve=lambda index: Solution(index, best, 0.0, scale, (np.eye(COUNT), False)),
        normal=lambda index: (root @ root.T, b), precision=precision, loss=loss,
    )  # fmt: skip


def links(gains, change=0.0):
    return CHAIN.inertial + gains[:N].reshape(-1, 10) + change


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.sampled_from([0.001, 0.3, 2.0]))
def test_no_physical_links_and_other_gains_are_more_probable(seed, size):
    evidence, rng = problem(seed, size), np.random.default_rng(seed)
    best = evidence.solve(INDEX).gains
    found = solve_physical(evidence, CHAIN, INDEX, ()).gains
    assert is_physical(links(found))
    if is_physical(links(best)):
        np.testing.assert_array_equal(found, best)
    # The objective is convex, as are physical links: no step towards others lowers it.
    least, scale = evidence.loss(found), evidence.precision**-0.5
    tolerance = 1e-4 * (least - evidence.loss(best)) + 1e-9
    for _ in range(20):
        other = np.append(
            0.2 * CHAIN.inertial.ravel() * rng.normal(), rng.normal(size=3)
        )
        other[:N] += 0.01 * scale[:N] * rng.normal(size=N)
        if is_physical(links(other)):
            step = found + 1e-3 * (other - found)
            assert evidence.loss(step) >= least - tolerance


def test_an_effect_on_a_link_counts_as_a_part_of_it():
    """Links that its mass makes physical stay as they are most probable."""
    evidence = problem(3, 0.0)
    best = evidence.solve(INDEX).gains
    best[:N] = -1.5 * CHAIN.inertial.ravel()
    heavier = LinkInertia((1,))
    assert len(heavier.gains) == 10
    index = np.arange(N + 10)
    more = np.append(best[:N], CHAIN.inertial[1])
    wider = SimpleNamespace(
        solve=lambda index: Solution(index, more, 0.0, more, (np.eye(N + 10), False)),
        normal=lambda index: (np.eye(N + 10), more), precision=np.zeros(N + 10),
    )  # fmt: skip
    found = solve_physical(wider, CHAIN, index, [(heavier, index[N:])]).gains
    change = np.zeros_like(CHAIN.inertial)
    change[1] = found[N:]
    assert is_physical(links(found, change))
    assert not is_physical(links(more))
    # Either the errors or the effect may give way, and both do by as much.
    np.testing.assert_allclose(
        found[10:N] - more[10:N], found[N:] - more[N:], rtol=1e-3, atol=1e-5
    )
