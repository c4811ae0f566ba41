"""Errors over many runs, and the report of one identification."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from demo_report import write_identification
from study import Study

from hybrid import Robot, identify, simulate, validate
from hybrid.effects.coulomb import Coulomb
from hybrid.errors import HybridWarning
from hybrid.report import provenance

STAGES = ("LS", "published", "ours")


@pytest.fixture
def study():
    share = np.array([[1.0, 0.9, 0.5], [1.0, 1.1, 0.4], [1.0, 0.8, 0.25]])
    rms = share[:, :, None] * np.array([4.0, 2.0])  # (3 seeds, 3 stages, 2 joints)
    floor = np.tile([0.4, 0.2], (3, 1))
    published = {"LS": 8.0, "ours": 6.0}
    return Study(("shoulder", "elbow"), STAGES, rms, 0.1 * rms, floor, published)


def test_a_study_compares_every_run_with_its_own_first_stage(study):
    np.testing.assert_allclose(study.cut[:, 0], 0.0)
    np.testing.assert_allclose(study.cut[:, 2], [0.5, 0.6, 0.75])
    np.testing.assert_allclose(study.above_floor[:, 2], [5.0, 4.0, 2.5])


def test_the_table_of_a_study_shows_medians_spread_and_what_was_published(study):
    table = study.table()
    assert {len(row) for row in table.rows} == {len(table.header)}
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    last = rows["ours"]
    assert last["shoulder"] == "1.600"
    assert last["lowest–highest"] == "0.750–1.500"
    assert last["vs LS"] == "−60.0 %"
    assert last["least–most"] == "50.0 to 75.0 %"
    assert last["× floor"] == "4.00"
    assert last["published mean"] == "6.00 (−25.0 %)"
    assert rows["noise floor"]["mean"] == "0.300"
    assert "3 seeds" in table.caption


def test_the_figure_of_a_study_has_both_ways_down_and_three_dots_for_each_joint(study):
    way_down, joints = study.figure().axes
    lines = {line.get_label(): line.get_ydata() for line in way_down.lines}
    np.testing.assert_allclose(lines["published chain"], [100, 90])
    np.testing.assert_allclose(lines["our ladder"], [100, 40])
    dots = [line.get_ydata() for line in joints.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(dots, [[10, 10], [9, 9], [4, 4]])


def test_a_rung_that_a_run_left_out_has_the_errors_below_it():
    one = {"LS": np.ones(2), "+ ripple": np.full(2, 0.5), "ours": np.full(2, 0.4)}
    runs = [
        {"joints": ("a", "b"), "rms": rms, "relative": rms, "noise_floor": np.ones(2)}
        for rms in (one, {"LS": np.ones(2), "ours": np.full(2, 0.3)})
    ]
    study = Study.of(runs, {})
    assert study.stages == tuple(one)
    np.testing.assert_allclose(study.mean, [[1, 0.5, 0.4], [1, 1, 0.3]])


def test_plain_least_squares_is_the_better_of_both(study):
    weighted = replace(study, stages=("LS", "WLS", "ours"))
    np.testing.assert_allclose(weighted.plain, [2.7, 3.0, 2.4])
    np.testing.assert_allclose(weighted.cut[:, 2], 1 - study.mean[:, 2] / [2.7, 3, 2.4])


@pytest.mark.study
def test_the_report_of_an_identification_is_complete_and_says_how_to_repeat_it(
    tmp_path,
):
    robot = Robot.load("models/planar.xml")
    logs = simulate(robot, [Coulomb((0,), {"level": 3.0})], trajectories=3, duration=4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # short logs leave much open
        fit = identify(robot, logs[:2], stages=("rigid", "friction"))
    validation = validate(fit.model, logs[2:])
    made = provenance(command="make demo")
    text = write_identification(tmp_path, fit, validation, logs[2:], provenance=made)
    assert f"{validation.rows[-1].mean:.3g} N·m" in text
    page = (tmp_path / "index.html").read_text("utf-8")
    assert text in page and "make demo" in page and "http://" not in page.lower()
    results = json.loads((tmp_path / "results.json").read_text("utf-8"))
    assert results["validation"]["reduction"] == validation.reduction
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    assert pictures == ["errors.png", "friction.png", "torque.png"]
    assert (tmp_path / "model.json").exists()
