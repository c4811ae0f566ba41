"""Rows of a log on either side of each bound, on positions written by hand."""

import numpy as np
import pytest

from hybrid.inspect.glitches import doubts_of_rows
from hybrid.recording import Recording


def said(x, word, tau=None):
    """Whether some doubt about the rows of one joint holds a word."""
    x = np.asarray(x, dtype=float)
    log = Recording(np.arange(len(x)) / 100.0, x[:, None], tau=tau, joints=("a",))
    return any(word in doubt.text for doubt in doubts_of_rows(log))


def jumped(size, *, near=0.01, rest=0.01, at=200, other=()):
    """Positions that jump among steps that are ``near``, and ``rest`` far from it."""
    steps = np.full(400, rest)
    steps[at - 20 : at + 20] = near
    steps[0] = min(steps[0], 1e-4)
    for distance, step in other:
        steps[at + distance] = step
    steps[at] = size
    return np.append(0.0, np.cumsum(steps))


@pytest.mark.parametrize(("size", "told"), [(0.095, False), (0.105, True)])
def test_a_jump_is_ten_times_any_step_nearby(size, told):
    assert said(jumped(size), "jumps") == told
    assert said(-jumped(size), "jumps") == told


@pytest.mark.parametrize("side", [-1, 1])
def test_steps_nearby_are_five_on_either_side(side):
    for distance in range(1, 7):
        x = jumped(0.5, other=[(side * distance, 0.06)])
        assert said(x, "jumps") == (distance > 5)


@pytest.mark.parametrize(("size", "told"), [(0.19, False), (0.21, True)])
def test_a_jump_is_twice_a_large_step_of_the_joint(size, told):
    assert said(jumped(size, near=0.005, rest=0.1), "jumps") == told


@pytest.mark.parametrize(("size", "told"), [(0.095, False), (0.105, True)])
def test_a_jump_of_a_joint_at_rest_is_ten_steps_of_its_encoder(size, told):
    steps = np.zeros(400)
    steps[50:60], steps[200] = 0.01, size
    assert said(np.cumsum(steps), "jumps") == told


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("rest", "told"), [(4, True), (5, False)])
def test_a_joint_that_rested_for_five_steps_was_frozen(side, rest, told):
    still = [(side * k, 0.0) for k in range(1, rest + 1)]
    assert said(jumped(0.5, other=still), "jumps") == told


def bent(size, *, near=0.001, rest=0.001, kink=None, left=0.0, count=400, at=200):
    """Positions of steady bends with one that is off by half of ``size``."""
    bends = np.full(count, rest)
    bends[at - 40 : at + 40] = near
    if kink:
        bends[at + 1 + kink[0]] += kink[1]
    speed = np.cumsum(bends)
    x = np.cumsum(speed - speed.mean())
    x[at + 1 :] -= left * size / 2
    x[at] -= size / 2
    return x


@pytest.mark.parametrize(("size", "told"), [(0.036, False), (0.040, True)])
def test_a_glitch_bends_ten_times_as_much_as_any_bend_nearby(size, told):
    """Its own bend, of 0.004, comes on top of twice its size."""
    assert said(bent(size - 0.001, near=0.004), "glitch") == told


@pytest.mark.parametrize(("size", "told"), [(0.038, False), (0.042, True)])
def test_a_glitch_bends_ten_times_as_much_as_the_joint_usually_does(size, told):
    assert said(bent(size, near=0.0, rest=0.004), "glitch") == told


@pytest.mark.parametrize("side", [-1, 1])
def test_bends_nearby_are_three_to_five_rows_away(side):
    for distance, told in ((2, True), (3, False), (4, False), (5, False), (6, True)):
        x = bent(0.2, kink=(side * distance, 0.03))
        assert said(x, "glitch") == told, distance


@pytest.mark.parametrize(("left", "told"), [(0.5, True), (0.62, False)])
def test_a_glitch_returns_by_more_than_half(left, told):
    """Else it is a step: neighbours bend by half of it, but for a fifth."""
    assert said(bent(0.4, left=left), "glitch") == told
    assert said(-bent(0.4, left=left), "glitch") == told


@pytest.mark.parametrize(("size", "told"), [(0.0018, False), (0.0023, True)])
def test_a_glitch_is_more_than_two_milliradians_of_bend(size, told):
    assert said(bent(size, near=0.0, rest=1e-7), "glitch") == told


@pytest.mark.parametrize(("rows", "told"), [(51, False), (52, True)])
def test_rows_are_held_fifty_times(rows, told):
    x = np.repeat(np.sin(0.1 * np.arange(rows)), 3)
    assert said(x, "holds each sample for 3 rows") == told


@pytest.mark.parametrize(("odd", "told"), [(8, True), (12, False)])
def test_nine_tenths_of_the_rows_are_held_alike(odd, told):
    counts = np.full(102, 4)
    counts[np.arange(odd) * 8 + 3] = 5
    assert said(np.repeat(np.sin(0.1 * np.arange(102)), counts), "holds") == told


@pytest.mark.parametrize(("rows", "told"), [(49, False), (50, True)])
def test_fifty_rows_that_come_again_are_a_repeated_log(rows, told):
    once = np.sin(0.1 * np.arange(120)) + 0.001 * np.arange(120)
    x = np.append(once, once[: rows + 1])
    assert said(x, "repeats its first rows", 2 * x[:, None]) == told


@pytest.mark.parametrize(("size", "told"), [(0.0008, False), (0.0012, True)])
def test_what_is_repeated_moves_by_a_milliradian(size, told):
    """After a first move of any size, and before another one."""
    slow = 0.5 + size * np.linspace(0.0, 1.0, 50)
    x = np.tile(np.concatenate([[0.0], slow, np.arange(1.0, 9.0)]), 2)
    assert said(x, "repeats its first rows", 2 * x[:, None]) == told
