"""Real arms: the whole pipeline beats plain least squares on held-out blocks.

The logs are not shipped. Put them into ``../shared/data`` beside the repository, or
name their folder in the environment variable ``HYBRID_DATA``.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from marks import studied
from simulated import quiet

from hybrid.effects import effect_class
from hybrid.identification import identify, validate
from hybrid.inspect import inspect_recording
from hybrid.recording import read_all
from hybrid.robot import Robot
from hybrid.signals import Sampler, motion_from_recording

BESIDE = Path(__file__).parents[2] / "shared" / "data"
DATA = Path(os.environ.get("HYBRID_DATA", BESIDE))
MOST_LOSS = 0.02


def blocks(name, *, seconds, cutoff, first=2):
    """An arm, two thirds of its log to fit, and every third block to score."""
    folder = DATA / name
    if not (folder / "robot.urdf").is_file():
        pytest.skip(f"no logs of {name}: set HYBRID_DATA to the folder that has them")
    robot, _ = quiet(Robot.load, folder / "robot.urdf")
    (log,), _ = quiet(read_all, [folder], joints=robot.joints)
    motion = motion_from_recording(log, cutoff=2 * cutoff)
    held_out = ((motion.t - motion.t[0]) // seconds).astype(int) % 3 == first
    fitting, scoring = (
        replace(motion, mask=motion.mask & use) for use in (~held_out, held_out)
    )
    return robot, fitting, scoring


def assert_better_than_least_squares(
    robot, fitting, scoring, slowest, *, cut, **options
):
    fit, _ = quiet(identify, robot, [fitting], **options)
    standing = np.full(robot.size, slowest)
    found, _ = quiet(validate, fit.model, [scoring], standing=standing)
    rows, best = {row.name: row for row in found.rows}, found.rows[-1]
    # Which of the two is better for a joint, the fit has to know without these blocks.
    ls = fit.held_out["LS"] < fit.held_out["WLS"]
    better = np.where(ls, rows["LS"].rms, rows["WLS"].rms)
    worse = best.rms > (1 + MOST_LOSS) * better
    # No rotor has a negative inertia: where plain least squares take one, they may win.
    rotors = [
        e.values["inertia"] for e in fit.model.simpler["WLS"].effects
        if e.id == "armature"
    ]  # fmt: skip
    assert not (worse & (np.array(rotors) >= 0)).any()
    assert (best.rms <= 1.3 * better).all()
    assert found.reduction > 0
    # Below the cut-off, where a torque is not mostly noise, more of it is explained.
    moving = (np.abs(scoring.v) > slowest) & scoring.mask[:, None]
    low = Sampler(scoring.rate, min(options["cutoff"], fit.model.band), 1)
    left = {
        name: np.where(moving, low(scoring.tau - model.predict(scoring)), np.nan)
        for name, model in (("LS", fit.model.simpler["LS"]), ("best", fit.model))
    }
    rms = {k: np.sqrt(np.nanmean(x**2, axis=0)) for k, x in left.items()}
    assert rms["best"].mean() <= (1 - cut) * rms["LS"].mean()
    return fit


@pytest.mark.parametrize("first", [0, *studied(1, 2)])
def test_ur10_at_125_hertz(first):
    """Its torque was filtered: plain least squares, too, see it through that filter."""
    robot, fitting, scoring = blocks(
        "ur10_salerno", seconds=1.0, cutoff=10.0, first=first
    )
    fit = assert_better_than_least_squares(
        robot, fitting, scoring, 0.02, cut=0.25, cutoff=10.0
    )
    # Sharp friction held against the smooth log left 0.83 to 0.90 N.m.
    found, _ = quiet(validate, fit.model, [scoring], standing=np.full(6, 0.02))
    assert found.rows[-1].mean < 0.75


def test_tx40_with_its_coupled_wrist():
    robot, fitting, scoring = blocks("tx40_figaroh", seconds=0.5, cutoff=50.0)
    wrist = effect_class("transmission_coupling")((4, 5))
    fit = assert_better_than_least_squares(
        robot, fitting, scoring, 0.05, cut=0.1, cutoff=50.0, effects=[wrist]
    )
    (found,) = [e for e in fit.model.effects if e.id == wrist.id]
    # Its inertia is known least: beyond 95 %, where the two frictions are beyond 99 %.
    sure = np.array([1.96, 2.6, 2.6])
    assert (found.gain_values > sure * np.array(list(found.std.values()))).all()


@pytest.mark.study
def test_seconds_of_a_right_log_are_not_refused():
    """Slow motion of some seconds is fitted well by any reading of its columns."""
    folder = DATA / "ur10_salerno"
    if not (folder / "robot.urdf").is_file():
        pytest.skip("no logs of ur10_salerno: set HYBRID_DATA to the folder of logs")
    robot, _ = quiet(Robot.load, folder / "robot.urdf")
    (log,), _ = quiet(read_all, [folder], joints=robot.joints)
    for first in np.arange(log.t[0], log.t[-1] - 2.6, 2.6):
        kept = (log.t >= first) & (log.t < first + 2.6)
        part = {key: x[kept] for key, x in log.channels.items()}
        said = inspect_recording(replace(log, t=log.t[kept], **part), robot).doubts
        assert not [x.line for x in said if x.is_error]
