"""Time stamps in whole units of time lose no digit on the way to seconds."""

import numpy as np
import pytest

from hybrid.recording.units import seconds


@pytest.mark.parametrize(("unit", "per"), [("ns", 10**9), ("us", 10**6), ("ms", 1000)])
def test_whole_stamps_are_the_nearest_numbers_of_seconds(unit, per):
    """0.3 s, and not 0.30000000000000004 s."""
    stamps = np.arange(40) * (per // 10)
    found, named = seconds(stamps, unit)
    assert named == unit
    np.testing.assert_array_equal(found, np.arange(40) / 10)
    epoch = 1_700_000_000 * per
    found, _ = seconds(stamps + epoch, unit)
    np.testing.assert_array_equal(found, np.arange(40) / 10)


def test_minutes_are_sixty_seconds():
    found, _ = seconds(np.array([0.0, 0.5, 2.0]), "min")
    np.testing.assert_allclose(found, [0.0, 30.0, 120.0])
