"""Warnings point to the line of the user that asked for what they are about."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arms import MODELS
from pendulum import pendulum, swings

from hybrid.calibration.calibrate import Calibration, calibrate
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.steps import FixedStep, free_frame
from hybrid.errors import HybridWarning, RobotError
from hybrid.identification import validate
from hybrid.identification.preparation import log_hash
from hybrid.model import DynamicModel
from hybrid.recording import Recording, read_all
from hybrid.recording.clock import resample, unbroken
from hybrid.recording.read import recording_from_table
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot

PLANAR = (MODELS / "planar.xml").read_text()


def log(t):
    q = np.sin(t)[:, None]
    return Recording(t, q, tau=q)


def said(ask, words):
    """Where the one warning with some words points to."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        ask()
    (own,) = [
        x for x in found
        if issubclass(x.category, HybridWarning) and words in str(x.message)
    ]  # fmt: skip
    return own.filename


def file(tmp_path, text, name="arm.xml"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_of_a_clock():
    t = 0.01 * np.arange(300.0)
    t[150] += 0.005
    assert said(lambda: resample(log(t)), "irregular clock") == __file__
    t[150:] += 1.0
    assert said(lambda: unbroken(log(t)), "taken as 2 recordings") == __file__


def test_of_a_table_and_a_folder(tmp_path):
    t = np.arange(100.0)
    table = {"t": t, "q1": np.sin(t), "tau1": t, "note": t}
    assert said(lambda: recording_from_table(table), "ignored columns") == __file__
    rows = "\n".join(f"{k},{k % 7},{k}" for k in range(99))
    file(tmp_path, f"t,q1,tau1\n{rows}\n", "a.csv")
    file(tmp_path, f"t,x,y\n{rows}\n", "b.csv")
    assert said(lambda: read_all(tmp_path), "left out") == __file__


def test_of_a_robot_file(tmp_path):
    negative = file(tmp_path, PLANAR.replace('damping="', 'damping="-'))
    assert said(lambda: Robot.load(negative), "shoulder' is -") == __file__


def test_of_a_validation_on_the_log_of_the_fit():
    robot, (m, *_) = pendulum(1), swings(1, count=1, seconds=2.0)
    problem = build_problem(robot.chain, [])
    model = DynamicModel(robot, problem.base, standing=np.zeros(1), logs=(log_hash(m),))
    assert said(lambda: validate(model, [m]), "this is no validation") == __file__


def test_of_a_calibration(monkeypatch, tmp_path):
    import importlib

    module = importlib.import_module("hybrid.calibration.calibrate")
    unsettled = SimpleNamespace(converged=False, iterations=7)
    monkeypatch.setattr(module, "solve", lambda *_, **__: unsettled)
    robot = pendulum(2)
    q = np.random.default_rng(0).uniform(-1, 1, (4, robot.size))
    data = Measurements(q, np.zeros((4, 1, 3)), None)
    assert said(lambda: calibrate(robot, data), "not settled after 7") == __file__

    def lost(*_, **__):
        raise RobotError("no meshes")

    made = replace(pendulum(1), path="somewhere/arm.xml")
    monkeypatch.setattr(module, "write_placements", lambda *_: None)
    monkeypatch.setattr(module.Robot, "load", lost)
    own = SimpleNamespace(setup=SimpleNamespace(robot=made), robot=made)
    path = tmp_path / "new.xml"
    words = "refers to files beside arm.xml; move it there"
    assert said(lambda: Calibration.save(own, path), words) == __file__


def test_of_stations_only_those_that_were_found_have_moved():
    nominal = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    places = [FixedStep(np.eye(3), x) for x in nominal]
    stations = [
        (place, *free_frame(f"station_{k}", turns=False))
        for k, place in enumerate(places, 1)
    ]
    own = SimpleNamespace(
        setup=SimpleNamespace(
            model=SimpleNamespace(stations=stations), robot=SimpleNamespace(size=2)
        ),
        solution=SimpleNamespace(values=lambda: {"station_2_y": 0.5}),
    )
    own._frame = lambda steps: Calibration._frame(own, steps)
    expected = nominal + [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]
    np.testing.assert_array_equal(Calibration.stations.fget(own), expected)


def test_poses_that_tell_nothing_have_an_observability_of_zero():
    from hybrid.calibration.calibrate import observability_index

    assert observability_index(np.zeros((4, 2)), 2) == 0.0
    assert observability_index(np.eye(3), 4) == pytest.approx(0.5)
