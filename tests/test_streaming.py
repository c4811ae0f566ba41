"""The window of a stream: its length, its bandwidth, and what makes it useless."""

import numpy as np
import pytest

from hybrid.errors import RecordingError
from hybrid.signals.streaming import LocalPolynomial

RATE = 200.0


@pytest.mark.parametrize("group", [1, 2, 5])
@pytest.mark.parametrize("half", [5, 10, 31])
def test_a_window_passes_two_and_a_half_cutoffs(half, group):
    """Schafer's law of its bandwidth: (n + 1)/(3.2 m − 4.6) of half the rate."""
    for more in (-0.45, 0.0, 0.45):
        bandwidth = RATE / 2 * 5 / (3.2 * (half + (group - 1) / 2 + more) - 4.6)
        found = LocalPolynomial(RATE, bandwidth / 2.5, group)
        assert found.margin == half
        assert found.span == pytest.approx((2 * half + group - 1) / RATE)


def test_a_window_has_three_samples_on_either_side_and_a_rate_of_five_cutoffs():
    assert LocalPolynomial(RATE, 39.9, 7).margin == 3
    for cutoff in (40.0, 0.0, -1.0):
        with pytest.raises(RecordingError, match="200 Hz; valid for a cut-off of"):
            LocalPolynomial(RATE, cutoff)
    with pytest.raises(RecordingError, match="a rate above 200 Hz"):
        LocalPolynomial(RATE, 40.0)


def test_what_a_fourth_order_leaves_of_a_fifth_is_at_right_angles_to_it():
    t = np.arange(60) / RATE
    window = LocalPolynomial(RATE, 8.0)
    powers, _ = window.windows(t)
    fifth = (10 * t)[:, None] ** 5
    left = window.residual(powers, fifth, window.fit(window.moments(powers, fifth)))
    assert powers.shape[1] == 5 and np.abs(left).max() > 1e-4
    np.testing.assert_allclose(powers @ left, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("stretch", "nominal"), [(0.79, False), (0.81, True), (1.24, True), (1.26, False)]
)
def test_a_window_is_nominal_up_to_a_quarter_longer(stretch, nominal):
    window = LocalPolynomial(RATE, 8.0)
    powers, found = window.windows(stretch * np.arange(60) / RATE)
    assert (found == nominal).all()
    ends = 1.0 if not nominal else stretch  # another window has uniform times
    np.testing.assert_allclose(powers[:, 1, [0, -1]], [[-ends, ends]] * len(powers))


def test_a_residual_is_spread_over_two_and_a_half_samples_or_an_eighth():
    """Of samples of one size as many are spread; a second small one adds a part."""
    for margin, sizes, spread in (
        (10, (1, 1), False), (10, (1, 1, 1), True), (4, (1,), False),
        (4, (1, 0.28), True), (4, (1, 0.22), False), (10, (1, 1, 0.54), True),
        (10, (1, 1, 0.5), False),
    ):  # fmt: skip
        window = LocalPolynomial(RATE, RATE / (3.2 * margin - 4.6))
        assert window.margin == margin
        residual = np.zeros((2, 2 * margin + 1, 1))
        residual[0, 2 : 2 + len(sizes), 0] = sizes
        residual[1] = 1.0
        assert window.has_no_outlier(3e-4 * residual)[:, 0].tolist() == [spread, True]
