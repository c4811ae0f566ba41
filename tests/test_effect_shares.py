"""By which share of its samples a log shows a clipping drive or a dead zone."""

import numpy as np
import pytest
from test_effect_laws import effect

from hybrid.effects import effect_class
from hybrid.signals import Motion

LIMIT, COUNT = 10.0, 1000


def drive(asked, delivered, v=1.0):
    """A log of one drive at a speed, by commanded and delivered torque."""
    asked, delivered, v = (
        np.broadcast_to(np.asarray(x, dtype=float), (COUNT,))[:, None].copy()
        for x in (asked, delivered, v)
    )
    mask = np.ones(COUNT, dtype=bool)
    t = 0.01 * np.arange(COUNT)
    return Motion(t, 0 * v, v, 0 * v, delivered, mask, asked=asked)


def some(count, value, other):
    return np.where(np.arange(COUNT) < count, value, other)


def clips(motion, limit=LIMIT):
    return effect("saturation", limit=limit, total=1.0).holds([motion])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drive_clips_within_a_fifth_of_its_limit_for_nine_tenths_of_the_time(sign):
    for off, same in ((0.19, True), (-0.19, True), (0.21, False), (-0.21, False)):
        assert clips(drive(sign * 20.0, sign * LIMIT * (1 + off))) == same
    for count, holds in ((100, True), (101, False)):
        assert clips(drive(sign * 20.0, sign * some(count, 20.0, LIMIT))) == holds


def test_samples_of_a_joint_that_hardly_moves_tell_nothing_of_its_drive():
    asked, delivered = some(600, 20.0, 0.0), some(600, 20.0, 0.0)
    assert clips(drive(asked, delivered, 4 * some(600, 0.049, 1.0)))
    assert not clips(drive(asked, delivered, 4 * some(600, 0.051, 1.0)))


def test_friction_that_the_file_lacks_is_found_below_the_limit_of_a_hundred_samples():
    """Of 14 asked for, 4 are lost in friction, and of 20 as well."""
    v = np.where(np.arange(COUNT) % 2, 1.0, -1.0)
    for count, found in ((100, True), (99, False)):
        asked = np.where(np.arange(COUNT) < count, 4.0, 20.0) * v
        delivered = np.where(np.arange(COUNT) < count, 0.0, LIMIT - 4.0) * v
        assert clips(drive(asked, delivered, v)) == found


def suggested(asked, delivered, count=COUNT):
    motion = drive(asked, delivered)
    motion.mask[count:] = False
    return effect_class("saturation").suggested([motion], 0)


def test_the_limit_of_a_drive_is_what_it_delivers_of_clearly_more():
    usual = {"limit": LIMIT, "total": 1.0}
    assert suggested(11.1, LIMIT) == usual and suggested(10.9, LIMIT) == {}
    assert suggested(-11.1, -LIMIT) == usual
    assert suggested(20.0, LIMIT, count=100) == usual
    assert suggested(20.0, LIMIT, count=99) == {}
    for count, found in ((100, usual), (99, {})):
        assert suggested(some(count, 20.0, 1.0), some(count, LIMIT, 1.0)) == found
    # A tenth of the time is above what is usually delivered.
    for count, found in ((90, usual), (110, {})):
        delivered = some(count, 20.0, LIMIT)
        asked = np.where(np.arange(COUNT) < 500, delivered, 15.0)
        assert suggested(asked, delivered) == found
    motion = drive(20.0, LIMIT)
    object.__setattr__(motion, "asked", None)
    assert effect_class("saturation").suggested([motion], 0) == {}


def is_dead(motion, **values):
    return effect("deadzone", onset=2.0, **values).holds([motion])


def test_torque_has_a_direction_if_it_is_above_the_onset_for_half_of_the_time():
    for count, is_so in ((501, True), (500, False)):
        part = some(count, 2.1, 1.9)
        for asked, tau in ((part, part), (part, 3.0), (3.0, part)):
            assert is_dead(drive(asked, tau)) == is_so
    # What is delivered at rest does not count.
    tau = some(600, 0.5, 2.1)
    assert is_dead(drive(tau, tau, 4 * some(600, 0.049, 1.0)))
    assert not is_dead(drive(tau, tau, 4 * some(600, 0.051, 1.0)))


def test_a_command_is_in_a_dead_zone_for_a_seventh_of_the_time_at_most():
    to_and_fro = np.where(np.arange(COUNT) % 2, 1.0, -1.0)

    def log(count, least=0.0, usual=10.0):
        return drive(some(count, 1.9, 2.0), some(count, least, usual), to_and_fro)

    assert is_dead(log(149), total=1.0) and not is_dead(log(150), total=1.0)
    assert not is_dead(log(0), total=1.0)
    # A fifth of the onset, or of the usual torque, may come through.
    for usual, most in ((10.0, 2.0), (1.0, 1.0)):
        assert is_dead(log(100, 0.199 * most, usual), total=1.0)
        assert not is_dead(log(100, 0.201 * most, usual), total=1.0)
