"""Results show themselves as tables, pictures and data frames; no name is markup."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from test_calibrate import coman, disturbed, measured

from hybrid import Recording, Robot, identify, inspect_recording, simulate, validate
from hybrid.calibration import calibrate, random_poses
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Finding, Unseen, Value
from hybrid.errors import HybridWarning
from hybrid.excitation import Condition, Fourier, design, observe
from hybrid.excitation.observation import usual_observation
from hybrid.identification import DynamicModel
from hybrid.plant import Noise


@pytest.fixture(scope="module")
def arm():
    return Robot.load("planar")


@pytest.fixture(scope="module")
def logs(arm):
    return simulate(arm, trajectories=2, duration=6.0)


@pytest.fixture(scope="module")
def fit(arm, logs):
    return identify(arm, logs, stages=("rigid",))


@pytest.fixture(scope="module")
def motions(arm):
    return design(
        arm, observe(arm.chain), Fourier(3, 0.2), seed=0,
        criterion=Condition(), starts=1,
    )  # fmt: skip


def test_a_fit_shows_the_error_of_every_stage_and_joint(fit):
    html = fit._repr_html_()
    assert '<th scope="col">shoulder</th>' in html
    assert '<th scope="row">IRLS</th>' in html


def test_everything_shows_itself_in_a_few_lines(arm, logs, fit, motions):
    """As at Python's prompt; long arrays are not shown."""
    assert repr(arm) == "<Robot planar: shoulder, elbow>"
    assert "6 s, 3,001 samples of q, tau" in repr(logs[0])
    assert "planar, rigid: " in repr(fit.model)
    assert "| IRLS |" in repr(fit) and "held" not in repr(fit)
    assert f"condition {motions.condition:.3g}" in repr(motions)
    shown = (arm, logs[0], fit.model, fit, motions, inspect_recording(logs[0], arm))
    assert max(len(repr(x)) for x in shown) < 2000


def test_a_fit_is_drawn_into_axes_that_are_given(fit):
    axes = Figure().subplots()
    assert fit.plot(axes) is axes
    drawn = sorted(bar.get_height() for bar in axes.patches)
    np.testing.assert_allclose(drawn, sorted(np.concatenate([*fit.held_out.values()])))


def test_a_frame_holds_every_unknown_within_its_interval(fit):
    frame = fit.to_frame()
    assert isinstance(frame, pd.DataFrame)
    assert tuple(frame["unknown"]) == fit.labels
    assert tuple(frame["combination"]) == fit.names
    assert ((frame["low"] <= frame["value"]) & (frame["value"] <= frame["high"])).all()


def test_a_validation_shows_the_error_of_every_model_and_joint(fit, logs, tmp_path):
    with pytest.warns(HybridWarning, match="no validation"):
        found = validate(fit.model, logs)
    assert "| rigid |" in repr(found) and "array" not in repr(found)
    frame = found.to_frame()
    assert len(frame) == len(found.rows) * 2 == len(found.plot().patches)
    assert list(frame["rms"][-2:]) == list(found.rows[-1].rms)
    found.to_html(tmp_path / "validation.html")
    found.save(tmp_path / "validation.json")
    content = json.loads((tmp_path / "validation.json").read_text("utf-8"))
    assert content["reduction"] == found.reduction


def test_a_saved_fit_loads_as_its_model(fit, tmp_path):
    fit.save(tmp_path / "model.json")
    assert DynamicModel.load(tmp_path / "model.json").effects == fit.model.effects


def test_a_design_shows_the_errors_to_expect_and_saves_its_motions(motions, tmp_path):
    assert list(motions.to_frame()["standard_error"]) == list(motions.standard_errors())
    assert f"condition {motions.condition:.3g}" in motions._repr_html_()
    assert len(motions.plot().lines) == 2
    motions.save(tmp_path / "motions")
    rows = (tmp_path / "motions" / "reference_1.csv").read_text().splitlines()
    assert rows[0].startswith("t,q_shoulder")


def test_a_calibration_draws_each_correction_with_its_interval():
    arm = coman()
    q = random_poses(arm, 30, 0)
    places = measured(disturbed(arm.chain), q, "position", noise=1e-5)
    found = calibrate(arm, places)
    frame = found.to_frame()
    np.testing.assert_array_equal(frame["low"], found.solution.interval()[0])
    assert len(found.plot().get_xticks()) == len(frame)
    assert "<td>mm</td>" in found._repr_html_()


def test_an_inspection_shows_draws_and_saves_a_page(arm, logs, tmp_path):
    found = inspect_recording(logs[0], arm)
    assert "shoulder" in found._repr_html_()
    assert len(found.plot().lines) == arm.size
    assert list(found.to_frame()["joint"]) == list(arm.joints)
    found.to_html(tmp_path / "log.html")
    found.save(tmp_path / "log.json")
    assert json.loads((tmp_path / "log.json").read_text())["misleads"] is False
    assert "shoulder" in (tmp_path / "log.html").read_text(encoding="utf-8")


def test_every_result_writes_a_page_that_loads_nothing(fit, motions, tmp_path):
    for k, result in enumerate((fit, motions)):
        path = tmp_path / f"{k}.html"
        result.to_html(path)
        page = path.read_text(encoding="utf-8")
        assert "data:image/svg+xml" in page and "https://" not in page
        assert f"<h1>{repr(result).splitlines()[0]}</h1>" in page
        assert all(str(x) in page for x in result.to_frame()["unknown"])


def a_diagnosis(**more):
    found = Finding(
        "stribeck", ("b",), ("stribeck",), 0.8,
        (Value("b", "level", 2.0, "N·m", (1.5, 2.5)),), {}, "It sticks <b>.", "Oil it.",
        (0.97,), 0.97,
    )  # fmt: skip
    numbers = ((2.0, 1.0), (0.5, 0.2), (0.1, 0.1))
    return Diagnosis("arm", ("a", "b"), *numbers, (), (found,), "explained", 0.1, 0.05)


def test_a_diagnosis_shows_its_findings_and_draws_the_gap_of_each_joint(tmp_path):
    found = a_diagnosis()
    assert "It sticks &lt;b&gt;." in found._repr_html_()
    (row,) = found.to_frame().to_dict("records")
    assert (row["effect"], row["low"], row["high"]) == ("stribeck", 1.5, 2.5)
    assert row["probability"] == 0.97 and "97% probable" in found._repr_html_()
    heights = [bar.get_height() for bar in found.plot().patches]
    assert heights == [2.0, 1.0, 0.1, 0.1]
    unseen = Unseen(*[(1.0, 0.3)] * 6)
    assert len(replace(found, unseen=unseen).plot().patches) == 6
    found.save(tmp_path / "diagnosis.json")
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == found.as_dict()
    found.to_html(tmp_path / "diagnosis.html")
    assert "explained" in (tmp_path / "diagnosis.html").read_text(encoding="utf-8")


def test_a_data_frame_without_rows_has_its_columns(arm, logs):
    found = a_diagnosis()
    nothing = replace(found, findings=()).to_frame()
    assert list(nothing.columns) == list(found.to_frame().columns) and not len(nothing)
    stuck = inspect_recording(replace(logs[0], q=0 * logs[0].q), arm).to_frame()
    right = inspect_recording(logs[0], arm).to_frame()
    assert list(stuck.columns) == list(right.columns) and not len(stuck)


def test_a_name_with_markup_in_it_stays_text():
    t = np.linspace(0.0, 2.0, 400)
    q = np.stack([np.sin(3 * t), np.cos(2 * t)], axis=1)
    log = Recording(t, q, joints=("<script>", "b"))
    assert "<script>" not in inspect_recording(log)._repr_html_()


@pytest.mark.study
def test_motions_are_designed_for_a_robot_alone():
    found = design(Robot.load("planar"), starts=1)
    assert repr(found).startswith("1 motion of planar, condition ")
    assert found.trajectories[0].family == Fourier(10, 0.05)
    robot = found.robot
    assert found.observation.size == usual_observation(robot).size == 13
    noise = Noise.typical(robot).torque_covariance
    np.testing.assert_allclose(
        found.observation.whitening @ noise @ found.observation.whitening.T, np.eye(2),
        atol=1e-9,
    )  # fmt: skip
