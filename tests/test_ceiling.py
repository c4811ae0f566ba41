"""The flexible regression: nothing in noise, and structure of any kind."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosed import faultless

from hybrid.diagnose.ceiling import recoverable


def gap_rows(joint):
    gap = faultless().gap
    return gap, np.flatnonzero(gap.moving[:, joint])


@pytest.mark.parametrize("seed", range(5))
def test_it_recovers_next_to_nothing_from_noise(seed):
    gap, rows = gap_rows(1)
    left = np.random.default_rng(seed).standard_normal(len(rows))
    squares, more, of, rest = recoverable(gap, 1, left, rows, 1.0)
    assert squares + more < 0.02 * len(rows)


@pytest.mark.parametrize(
    "law, about",
    [
        (lambda m, j: np.sign(m.v[:, j]) * m.q[:, j], "position"),
        (lambda m, j: np.sin(7 * m.q[:, j]), "position"),
        (lambda m, j: np.sin(23 * m.t), "time"),
        (lambda m, j: m.q[:, 0] * m.q[:, j], "joint"),
        (lambda m, j: np.exp(-np.abs(m.v[:, j]) / 0.1) * np.sign(m.v[:, j]), "speed"),
    ],
)
def test_it_recovers_what_depends_on_something(law, about):
    gap, rows = gap_rows(1)
    x = law(gap.sampled, 1)[rows]
    x = x / x.std()
    noise = np.random.default_rng(0).standard_normal(len(rows))
    squares, more, of, rest = recoverable(gap, 1, x + noise, rows, 1.0)
    assert squares > 0.6 * x @ x
    assert squares < 1.2 * x @ x
    assert about in of
    assert rest.std() < 1.2


def test_noise_of_positions_is_no_structure():
    # The same noise is in the residual and in the load that it may depend on.
    gap, rows = gap_rows(1)
    white = np.random.default_rng(0).standard_normal((len(gap.load) + 2, 2))
    noise = np.diff(white, 2, axis=0)  # as an acceleration has it
    noise *= 0.3 * gap.load.std(axis=0) / noise.std(axis=0)
    spoilt = replace(gap)
    spoilt.__dict__["load"] = gap.load + noise
    left = -noise[rows, 1]
    squares, more, of, rest = recoverable(
        spoilt, 1, left, rows, float(np.mean(left**2))
    )
    assert squares < 0.05 * left @ left


def test_structure_that_one_fold_hardly_shows_is_structure_still():
    """A recording may not go where it is: it gains nothing there, or loses a little."""
    gap, rows = gap_rows(1)
    x = np.sin(23 * gap.sampled.t[rows] + 1.0) * (gap.fold[rows] > 0)
    x = 0.5 * x / x.std()
    noise = np.random.default_rng(0).standard_normal(len(rows))
    squares, more, *_ = recoverable(gap, 1, x + noise, rows, 1.0)
    assert squares < 0.1 * x @ x
    assert more > 0.2 * x @ x


def test_what_one_fold_alone_has_is_no_structure():
    gap, rows = gap_rows(1)
    x = np.sin(7 * gap.sampled.q[rows, 1]) * (gap.fold[rows] == gap.fold[rows][0])
    noise = np.random.default_rng(0).standard_normal(len(rows))
    squares, more, *_ = recoverable(gap, 1, x + noise, rows, 1.0)
    assert squares + more < 0.1 * x @ x
