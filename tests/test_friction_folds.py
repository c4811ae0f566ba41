"""What friction is chosen by: squares on folds that its coefficients have not seen."""

import numpy as np
import pytest

from hybrid.identification import friction


def sums_of(slopes, level=0.0):
    """Cross-products of [column, torque] of folds whose torque is a slope times it."""
    x = np.linspace(1.0, 2.0, 5)
    return np.array([D @ D.T for D in (np.stack([x, a * x + level]) for a in slopes)])


def left_out(sums):
    """Squares on the folds left out, all together."""
    return float(friction.held_out(sums))


def test_each_fold_is_judged_by_coefficients_of_the_others():
    slopes = np.array([1.0, 2.0, 3.0, 4.0])
    size = (np.linspace(1.0, 2.0, 5) ** 2).sum()
    others = (slopes.sum() - slopes) / 3
    expected = size * ((slopes - others) ** 2).sum()
    assert left_out(sums_of(slopes)) == pytest.approx(expected)
    # Coefficients that have seen the fold would leave no more than this.
    seen = size * ((slopes - slopes.mean()) ** 2).sum()
    assert expected > 1.7 * seen


def test_what_holds_on_every_fold_leaves_nothing():
    assert left_out(sums_of([2.0, 2.0, 2.0, 2.0])) == pytest.approx(0.0, abs=1e-9)


def test_coefficients_below_zero_are_none():
    slopes = np.array([-1.0, -1.0, -1.0, -1.0])
    size = (np.linspace(1.0, 2.0, 5) ** 2).sum()
    assert left_out(sums_of(slopes)) == pytest.approx(4 * size)
