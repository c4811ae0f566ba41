"""The command line: every verb, every exit code, and nothing half-written."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import warnings
from argparse import ArgumentTypeError
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from arms import MODELS

from hybrid import __version__
from hybrid.cli import main
from hybrid.cli.shared import options
from hybrid.effects import effect_classes, registry
from hybrid.errors import HybridWarning
from hybrid.identification import DynamicModel, predict, validate
from hybrid.identification.three_stage import STAGES
from hybrid.plant import simulate
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording, read, read_all, write
from hybrid.recording.mapping import PRESETS
from hybrid.regression.least_squares import ESTIMATORS
from hybrid.robot import Robot

PLANAR = str(MODELS / "planar.xml")
HEAVY = "torch mujoco pinocchio sklearn scipy matplotlib numpy".split()
VERBS = ("simulate", "identify", "validate", "predict", "effects")
EVERY_VERB = tuple(sys.modules["hybrid.cli"]._VERBS)
SHORT, LONGER = "--trajectories 1 --duration 1", "--trajectories 1 --duration 2"
LIFT = """
<mujoco><worldbody><body>
<joint name='turn' axis='0 1 0' range='-1 1' actuatorfrcrange='-20 20'/>
<inertial pos='.1 0 .1' mass='2' diaginertia='.02 .02 .02'/><body pos='0 0 .2'>
<joint name='lift' type='slide' axis='1 0 0' range='-.4 .4' actuatorfrcrange='-99 99'/>
<inertial pos='.1 0 0' mass='2' diaginertia='.02 .02 .02'/></body></body></worldbody>
</mujoco>"""


def run(command: str) -> None:
    assert main(command.split()) == 0


@dataclass(frozen=True)
class Chain:
    """Files of one run from simulation to prediction on the planar arm."""

    folder: Path

    @property
    def fit(self) -> Path:
        return self.folder / "fit"

    @property
    def log(self) -> Path:
        return self.folder / "held_out" / "trajectory_1.npz"

    @property
    def model(self) -> Path:
        return self.folder / "model.json"

    @property
    def tau(self) -> np.ndarray:
        """The predicted columns: time, shoulder, elbow."""
        return np.loadtxt(self.folder / "tau.csv", delimiter=",", skiprows=1)

    def results(self, verb: str) -> dict:
        return json.loads((self.folder / f"{verb}.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def chain(tmp_path_factory) -> Chain:
    x = Chain(tmp_path_factory.mktemp("chain"))
    simulate = f"simulate --robot {PLANAR} --effects stribeck:elbow,spring:1"
    more = f"--json {x.folder}/simulate.json"
    run(f"{simulate} --trajectories 2 --duration 4 --out {x.fit} {more}")
    run(f"{simulate} {LONGER} --seed 1 --format npz --out {x.log.parent}")
    more = f"--effects spring:1 --json {x.folder}/identify.json"
    run(f"identify --robot {PLANAR} --recordings {x.fit} --out {x.model} {more}")
    more = f"--json {x.folder}/validate.json"
    run(f"validate --robot {PLANAR} --model {x.model} --recordings {x.log} {more}")
    more = f"--out {x.folder}/tau.csv --json {x.folder}/predict.json"
    run(f"predict --model {x.model} --recording {x.log} {more}")
    return x


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder with its content, hidden ones too."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def without_progress(err: str) -> str:
    """What is written to standard error besides progress, which depends on time."""
    return re.sub(r"(?m)^\d+ s: .*\n", "", err)


def complaint(capsys, command: str, *, code: int = 2) -> str:
    """The one line that a command fails with, besides progress."""
    capsys.readouterr()
    assert main(command.split()) == code
    out, err = capsys.readouterr()
    err = without_progress(err)
    assert out == "" and "Traceback" not in err
    assert err.startswith("error: ") and err.endswith("\n"), err
    assert len(err.splitlines()) == 1, err
    return err


class TestChain:
    """simulate -> identify -> validate -> predict"""

    def test_simulate_writes_recordings_and_their_truth(self, chain):
        recordings = read_all(chain.fit)
        truth = json.loads((chain.fit / "truth.json").read_text("utf-8"))
        assert [len(x.t) for x in recordings] == [2001, 2001]
        assert recordings[0].joints == ("shoulder", "elbow")
        assert truth["joints"] == ["shoulder", "elbow"]
        stribeck, spring = truth["effects"]
        assert (stribeck["effect"], stribeck["joints"]) == ("stribeck", ["elbow"])
        assert stribeck["values"]["level"] == pytest.approx(0.03 * 30.0)
        assert (spring["effect"], spring["joints"]) == ("spring", ["shoulder"])
        assert np.shape(truth["inertial"]) == (2, 10)
        assert np.shape(truth["torque_covariance"]) == (2, 2)

    def test_simulate_says_the_same_in_json(self, chain):
        truth = json.loads((chain.fit / "truth.json").read_text("utf-8"))
        content = chain.results("simulate")
        files = content.pop("recordings")
        assert content == truth
        assert [x["file"] for x in files] == ["trajectory_1.csv", "trajectory_2.csv"]
        assert files[0]["sha256"] == options.sha256(chain.fit / "trajectory_1.csv")

    def test_identify_finds_what_was_simulated(self, chain):
        content = chain.results("identify")
        names = [x["name"] for x in content["held_out"]]
        assert names[:3] == ["LS", "WLS", "IRLS"]
        found = {
            x["effect"]: x for x in content["effects"] if x["joints"][0] != "elbow"
        }
        true = json.loads((chain.fit / "truth.json").read_text("utf-8"))["effects"][1]
        spring = found["spring"]
        error = abs(spring["values"]["stiffness"] - true["values"]["stiffness"])
        assert error < 4 * spring["std"]["stiffness"]
        assert spring["units"]["stiffness"] == "N·m/rad"

    def test_identify_describes_every_unknown_in_json(self, chain):
        content = chain.results("identify")
        assert set(content) == {
            "provenance", "robot", "joints", "stage", "cutoff", "held_out", "left_out",
            "unidentifiable", "warnings", "converged", "rounds", "condition", "sigma",
            "effects", "unknowns",
        }  # fmt: skip
        assert any("armature.inertia[shoulder]" in x for x in content["unidentifiable"])
        for unknown in content["unknowns"]:
            low, high = unknown["interval"]
            assert low <= unknown["value"] <= high

    def test_validate_is_the_public_function(self, chain):
        model = DynamicModel.load(chain.model)
        expected = validate(model, [read(chain.log)]).as_dict()
        content = chain.results("validate")
        content.pop("provenance")
        assert content == expected
        assert 0.0 < content["reduction"] < 1.0

    def test_predict_is_the_public_function(self, chain):
        model = DynamicModel.load(chain.model)
        recording = read(chain.log)
        header = (chain.folder / "tau.csv").read_text("utf-8").splitlines()[0]
        assert header.replace('"', "") == "time,tau_shoulder,tau_elbow"
        table = chain.tau
        np.testing.assert_array_equal(table[:, 0], recording.t)
        np.testing.assert_array_equal(table[:, 1:], predict(model, recording))
        content = chain.results("predict")
        assert set(content) == {"provenance", "robot", "joints", "samples", "rms"}
        assert content["samples"] == len(recording.t)

    @pytest.mark.parametrize("verb", VERBS[:4])
    def test_json_says_how_the_results_came_about(self, chain, verb):
        provenance = chain.results(verb)["provenance"]
        assert provenance["command"] == verb
        assert provenance["hybrid"] == __version__
        assert ("seed" in provenance) is (verb in ("simulate", "identify"))
        files = {x["file"]: x["sha256"] for x in provenance["inputs"]}
        expected = {
            "simulate": {"planar.xml"},
            "identify": {"planar.xml", "trajectory_1.csv", "trajectory_2.csv"},
            "validate": {
                "planar.xml", "model.json", "trajectory_1.npz",
            },
            "predict": {"model.json", "trajectory_1.npz"},
        }  # fmt: skip
        assert set(files) == expected[verb]
        assert all(len(digest) == 64 for digest in files.values())
        # The same run in another folder gives the same record.
        assert str(chain.folder) not in json.dumps(provenance)

    def test_identify_shows_errors_unknowns_and_effects(self, chain, tmp_path, capsys):
        run(
            f"identify --robot {PLANAR} --recordings {chain.fit} --stages rigid "
            f"--effects spring:1 --out {tmp_path}/m.json"
        )
        out = capsys.readouterr().out
        assert "Cross-validated RMS torque error on planar, N·m" in out
        assert all(stage in out for stage in ("LS", "WLS", "IRLS"))
        assert "armature.inertia[shoulder] cannot be told from" in out
        assert "stiffness" in out and " ± " in out and "N·m/rad" in out
        assert f"model: {tmp_path}/m.json" in out

    def test_validate_shows_the_table_and_the_reduction(self, chain, capsys):
        run(f"validate --model {chain.model} --recordings {chain.log}")
        out = capsys.readouterr().out
        assert "noise floor" in out
        said = r"([\d.]+)% less mean RMS than \w+, (\S+) instead of (\S+) N·m"
        less, error, plain = map(float, re.search(said, out).groups())
        assert less == pytest.approx(100 * (1 - error / plain), abs=0.1)
        assert not any(line.endswith(" ") for line in out.splitlines())

    def test_a_narrow_terminal_loses_no_digit(self, chain, capsys, monkeypatch):
        monkeypatch.setenv("COLUMNS", "30")
        run(f"validate --model {chain.model} --recordings {chain.log}")
        assert "…" not in capsys.readouterr().out


class TestSimulate:
    def test_the_same_seed_gives_the_same_files(self, tmp_path):
        for name in ("one", "two"):
            run(
                f"simulate --robot {PLANAR} --effects torque_ripple {SHORT} --seed 3 "
                f"--out {tmp_path}/{name}"
            )
        run(f"simulate --robot {PLANAR} {SHORT} --seed 4 --out {tmp_path}/no")
        one, two, other = (tree(tmp_path / name) for name in ("one", "two", "no"))
        assert set(one) == {"trajectory_1.csv", "truth.json"}
        assert one == two
        assert one["trajectory_1.csv"] != other["trajectory_1.csv"]

    def test_every_format_holds_the_same(self, tmp_path):
        simulate, logs = f"simulate --robot {PLANAR} {SHORT}", []
        for kind in ("csv", "parquet", "npz"):
            run(f"{simulate} --format {kind} --out {tmp_path}/{kind}")
            logs.append(read(tmp_path / kind / f"trajectory_1.{kind}").channels)
        for same in logs[1:]:
            for name, values in logs[0].items():
                np.testing.assert_array_equal(values, same[name])

    def test_effects_add_to_those_of_a_truth(self, tmp_path):
        robot = shutil.copy(PLANAR, tmp_path)
        truth = tmp_path / "truth.yaml"
        truth.write_text(
            f"robot: {Path(robot).name}\n"
            "effects:\n  - {effect: coulomb, joints: [elbow], values: {level: 0.5}}\n"
        )
        run(
            f"simulate --robot {truth} --effects viscous:1 {SHORT} --out {tmp_path}/out"
        )
        content = json.loads((tmp_path / "out" / "truth.json").read_text("utf-8"))
        assert [x["effect"] for x in content["effects"]] == ["coulomb", "viscous"]
        files = [x["file"] for x in content["provenance"]["inputs"]]
        assert files == ["truth.yaml", "planar.xml"]

    def test_it_warns_of_recordings_that_are_not_of_the_run(self, tmp_path, capsys):
        run(f"simulate --robot {PLANAR} {SHORT} --format npz --out {tmp_path}")
        assert capsys.readouterr().err == ""
        run(f"simulate --robot {PLANAR} {SHORT} --out {tmp_path}")
        warning = capsys.readouterr().err
        assert warning.startswith("warning: ") and "trajectory_1.npz" in warning

    def test_the_joints_of_the_arm_can_be_chosen(self, tmp_path):
        run(f"simulate --robot {PLANAR} --joints elbow {SHORT} --out {tmp_path}")
        assert read(tmp_path / "trajectory_1.csv").joints == ("elbow",)

    def test_usual_sizes_are_those_of_the_joint(self):
        shoulder, elbow = joint_scales(Robot.load(PLANAR))
        assert (shoulder.torque, elbow.torque) == (80.0, 30.0)
        assert shoulder.speed == pytest.approx(np.pi)


class TestIdentifyAndPredict:
    def test_the_same_seed_gives_the_same_model(self, chain, tmp_path):
        for name in ("one", "two"):
            (tmp_path / name).mkdir()
            run(
                f"identify --robot {PLANAR} --recordings {chain.fit} --stages rigid "
                f"--out {tmp_path}/{name}/model.json --json {tmp_path}/{name}/fit.json"
            )
        one, two = (tree(tmp_path / name) for name in ("one", "two"))
        assert set(one) == {"model.json", "fit.json"}
        assert one == two

    def test_settings_reach_the_fit(self, chain, tmp_path):
        run(
            f"identify --robot {PLANAR} --recordings {chain.fit}/*_1.csv "
            f"{chain.fit}/trajectory_2.csv --stages rigid --estimator ls --cutoff 7 "
            f"--robust --seed 5 --out {tmp_path}/m.json --json {tmp_path}/fit.json"
        )
        content = json.loads((tmp_path / "fit.json").read_text("utf-8"))
        assert content["cutoff"] == DynamicModel.load(tmp_path / "m.json").cutoff == 7
        assert content["provenance"]["seed"] == 5
        assert content["provenance"]["settings"] == {
            "joints": None, "hold": {}, "map": None, "known_mass": {}, "gpu": False,
            "estimator": "ls",
            "stages": ["rigid"], "effects": "", "cutoff": 7, "robust": True,
            "consistent": False,
        }  # fmt: skip

    @pytest.mark.parametrize("suffix", ["parquet", "npz"])
    def test_predictions_come_in_other_formats(self, chain, tmp_path, suffix):
        path = tmp_path / f"tau.{suffix}"
        run(f"predict --model {chain.model} --recording {chain.log} --out {path}")
        if suffix == "npz":
            table = dict(np.load(path))
        else:
            from pyarrow import parquet

            found = parquet.read_table(path)
            table = {name: found[name].to_numpy() for name in found.column_names}
        assert list(table) == ["time", "tau_shoulder", "tau_elbow"]
        np.testing.assert_array_equal(np.stack(list(table.values()), axis=1), chain.tau)

    def test_a_prediction_has_the_clock_it_was_made_on(self, chain, tmp_path, capsys):
        recording = read(chain.log)
        kept = np.delete(np.arange(len(recording.t)), [200, 201])  # a short gap
        gappy = {name: x[kept] for name, x in recording.channels.items()}
        log = Recording(recording.t[kept], **gappy, joints=recording.joints)
        write(log, tmp_path / "log.csv")
        run(
            f"predict --model {chain.model} --recording {tmp_path}/log.csv --out "
            f"{tmp_path}/tau.csv"
        )
        assert capsys.readouterr().err.startswith("warning: ")
        t = np.loadtxt(tmp_path / "tau.csv", delimiter=",", skiprows=1)[:, 0]
        np.testing.assert_allclose(np.diff(t), recording.t[1] - recording.t[0])

    def test_a_prediction_needs_time_and_positions_only(self, chain, tmp_path):
        log = read(chain.log)
        silent = Recording(t=log.t, q=log.q, joints=log.joints)
        write(silent, tmp_path / "log.csv")
        run(
            f"predict --model {chain.model} --recording {tmp_path}/log.csv --out "
            f"{tmp_path}/tau.csv --json {tmp_path}/predict.json"
        )
        table = np.loadtxt(tmp_path / "tau.csv", delimiter=",", skiprows=1)
        np.testing.assert_array_equal(table, chain.tau)
        content = json.loads((tmp_path / "predict.json").read_text("utf-8"))
        assert content["rms"] is None

    def test_a_stage_that_is_left_out_is_said_once(self, tmp_path, capsys):
        """An arm without noise or friction has nothing to learn."""
        scara = MODELS / "scara.xml"
        run(f"simulate --robot {scara} {LONGER} --out {tmp_path}/logs")
        capsys.readouterr()
        run(
            f"identify --robot {scara} --recordings {tmp_path}/logs --stages "
            f"rigid,remainder --out {tmp_path}/m.json --json {tmp_path}/fit.json"
        )
        out, err = capsys.readouterr()
        assert (out + err).count("remainder: no regression") == 1
        content = json.loads((tmp_path / "fit.json").read_text("utf-8"))
        assert [x in err for x in content["warnings"]] == [True]

    def test_poor_excitation_is_one_plain_sentence(self, chain, tmp_path, capsys):
        arm = Robot.load(PLANAR)
        (poor,) = simulate(arm, trajectories=1, duration=5.0, fill=0.02)
        write(poor, tmp_path / "log.csv")
        capsys.readouterr()
        run(
            f"identify --robot {PLANAR} --recordings {tmp_path}/log.csv --stages rigid "
            f"--out {tmp_path}/m.json"
        )
        out, err = capsys.readouterr()
        assert "excites the arm poorly" not in out
        assert err.count("excites the arm poorly") == 1
        assert "hardly determined; move" in err

    def test_consistent_links_are_saved_and_shown(self, chain, tmp_path, capsys):
        run(
            f"identify --robot {PLANAR} --recordings {chain.fit} --stages rigid "
            f"--consistent --out {tmp_path}/m.json"
        )
        assert "+ consistent" in capsys.readouterr().out
        inertial = DynamicModel.load(tmp_path / "m.json").inertial
        assert inertial.shape == (2, 10) and (inertial[:, 0] > 0).all()


def test_without_a_verb_the_help_is_shown(capsys):
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 2
    assert "hybrid demo" in capsys.readouterr().out


def test_an_export_names_the_files_of_its_own_format(chain, tmp_path, capsys):
    for kind in ("json", "c"):
        run(f"export --model {chain.model} --format {kind} --out {tmp_path}")
    first, second = capsys.readouterr().out.split("planar as c")
    assert "manifest.json, model.json" in first
    assert "planar.h" in second and "model.json" not in second
    assert (tmp_path / "model.json").exists()


def test_another_file_of_the_robots_name_beside_a_model_is_told(
    chain, tmp_path, capsys
):
    (tmp_path / "model.json").write_bytes(chain.model.read_bytes())
    (tmp_path / "planar.xml").write_text(LIFT, "utf-8")
    export = f"export --model {tmp_path}/model.json --out {tmp_path}/out"
    assert main([*export.split(), "--format", "mjcf"]) == 2
    said = capsys.readouterr().err
    assert "planar.xml: " in said and "it was found beside" in said
    assert "--robot FILE names another" in said and not (tmp_path / "out").exists()
    run(f"{export} --format c")  # which takes nothing of it


class TestSlidingJoints:
    """Their units are m and N wherever a table or a file states one."""

    def test_inspect_identify_validate_and_effects_name_metres(self, tmp_path, capsys):
        robot, model = tmp_path / "lift.xml", tmp_path / "model.json"
        robot.write_text(LIFT, "utf-8")
        run(
            f"simulate --robot {robot} --effects viscous --duration 4 "
            f"--trajectories 2 --out {tmp_path}/logs"
        )
        logs, record = tmp_path / "logs", tmp_path / "record.json"
        capsys.readouterr()
        run(f"inspect {logs} --robot {robot}")
        said = capsys.readouterr().out
        assert re.search(r"q_lift +q lift +m \(assumed\)", said)
        assert re.search(r"tau_turn +tau turn +N·m \(assumed\)", said)
        lift = next(x for x in said.splitlines() if x.startswith(" lift "))
        assert re.search(r" m .* m/s .* m .* N ", lift) and "rad" not in lift
        run(
            f"identify --robot {robot} --recordings {logs} --stages rigid --out {model}"
            f" --json {record}"
        )
        said = capsys.readouterr().out
        assert "turn   lift, N    mean" in said
        assert re.search(r"lift +viscous +coefficient .* N·s/m\n", said)
        unknowns = json.loads(record.read_text("utf-8"))["unknowns"]
        units = {x["label"]: x["unit"] for x in unknowns}
        assert units["coulomb.level[lift]"] == "N"
        assert units["coulomb.level[turn]"] == "N·m"
        run(f"effects stribeck --robot {robot}")
        said = capsys.readouterr().out
        assert re.search(r"lift +velocity +m/s ", said)
        assert re.search(r"turn +velocity +rad/s ", said)


class TestEffects:
    def test_all_effects_are_listed(self, capsys, monkeypatch):
        monkeypatch.setenv("COLUMNS", "200")  # no equation is broken over lines
        run("effects")
        out = capsys.readouterr().out
        for cls in effect_classes().values():
            assert cls.id in out and cls.port.value in out
            assert cls.equation in out
        assert "level [N·m], velocity [rad/s], exponent" in out
        assert "{joints}" not in out

    def test_one_effect_is_told_in_full(self, capsys):
        run("effects stribeck")
        out = capsys.readouterr().out
        stribeck = effect_classes()["stribeck"]
        for text in (stribeck.equation, stribeck.source, stribeck.remedy):
            assert text in out
        assert "rated torque" in out and "0.001 to 1" in out

    def test_a_robot_that_cannot_be_shown_is_refused_at_once(self, capsys):
        assert main("effects stribeck --robot no.xml".split()) == 2
        shown = capsys.readouterr()
        assert shown.out == "" and "no.xml" in shown.err
        assert "name it" in complaint(capsys, f"effects --robot {PLANAR}")

    def test_json_holds_what_every_effect_states(self, tmp_path):
        run(f"effects --json {tmp_path}/effects.json")
        content = json.loads((tmp_path / "effects.json").read_text("utf-8"))
        assert set(content) == {"provenance", "effects"}
        assert [x["effect"] for x in content["effects"]] == list(effect_classes())
        for item in content["effects"]:
            assert set(item) == {
                "effect", "port", "scope", "equation", "source", "sentence", "remedy",
                "gains", "shapes",
            }  # fmt: skip
            assert {"name", "unit", "typical", "lower", "upper"} <= set(
                item["gains"][0]
            )


OWN = """
from hybrid.effects import JointEffect, Port, Quantity

class Hose(JointEffect):
    id = "hose"
    port = Port.ENVIRONMENT
    gains = (Quantity("level", "N·m", 0.05, 0.0, 1.0, per=(1, 0)),)
    equation = "τ = k · sin q"
    source = "made up"
    sentence = "A hose pulls on {joints}."
    remedy = "Take it off."

    @staticmethod
    def law(state, **shapes):
        import numpy as np
        return (np.sin(state.q),)
"""


class TestOwnEffects:
    @pytest.fixture
    def own(self, tmp_path, monkeypatch) -> Path:
        monkeypatch.setattr(registry, "_added", {})
        path = tmp_path / "mine.py"
        path.write_text(OWN, "utf-8")
        return path

    def test_they_take_part_in_every_verb(self, own, tmp_path, capsys, monkeypatch):
        with_own = f"--effects-from {own}"
        logs, model = tmp_path / "logs", tmp_path / "m.json"
        run(f"effects hose {with_own}")
        run(
            f"simulate --robot {PLANAR} --effects hose:elbow --duration 3 "
            f"--trajectories 2 --out {logs} {with_own}"
        )
        run(
            f"identify --robot {PLANAR} --recordings {logs} --stages rigid --effects "
            f"hose:elbow --out {model} {with_own} --json {tmp_path}/fit.json"
        )
        run(f"validate --model {model} --recordings {logs} {with_own}")
        log = logs / "trajectory_1.csv"
        to_predict = f"predict --model {model} --recording {log}"
        run(f"{to_predict} --out {tmp_path}/tau.csv {with_own}")
        content = json.loads((tmp_path / "fit.json").read_text("utf-8"))
        assert content["provenance"]["inputs"][0]["file"] == "mine.py"
        hose = next(x for x in content["effects"] if x["effect"] == "hose")
        assert hose["values"]["level"] == pytest.approx(1.5, abs=0.5)

        monkeypatch.setattr(registry, "_added", {})
        text = complaint(capsys, f"{to_predict} --out {tmp_path}/no.csv")
        assert "no effect 'hose'" in text and "--effects-from" in text

    @pytest.mark.parametrize("code", ["x = 1", "1 / 0", "def"])
    def test_a_file_with_a_mistake_is_refused(self, own, capsys, code):
        own.write_text(code, "utf-8")
        assert "mine.py" in complaint(capsys, f"effects --effects-from {own}")


BAD_ARGUMENTS = {
    "no-such-verb": "simulate",
    "simulate": "--robot, --out",
    "simulate --robot {R} --out {OUT} --sead 3": "unknown --sead 3",
    "simulate --robot {R} --out {OUT} --seed -1": "whole number from 0",
    "simulate --robot {R} --out {OUT} --seed 1.5": "whole number from 0",
    "simulate --robot {R} --out {OUT} --trajectories 0": "whole number from 1",
    "simulate --robot {R} --out {OUT} --duration nan": "number above 0",
    "simulate --robot {R} --out {OUT} --duration 0.001": "samples",
    "simulate --robot {R} --out {OUT} --trajectories 100000000": "valid are up to",
    "simulate --robot {R} --out {OUT} --duration 1e9": "duration 1e+09 x rate",
    "excite --robot {R} --out {OUT} --duration 1e9": "duration 1e+09 x joints 2",
    "excite --robot {R} --out {OUT} --rate 1e9": "rate 1e+09 are 4e+10 numbers",
    "excite --robot {R} --out {OUT} --order 100000": "coefficients 400000 are",
    "simulate --robot {R} --out {OUT} --format xls": "csv",
    "simulate --robot {R} --out {OUT} --joints ,": "names between commas",
    "identify --robot {R} --recordings {FIT} --out {OUT}.json --cutoff x": "above 0",
}
BAD_ROBOTS = {
    "simulate --robot none.xml --out {OUT}": "none.xml: no such robot file",
    "simulate --robot {FIT}/truth.json --out {OUT}": ".urdf, .xml, .mjcf",
    "simulate --robot {DAMAGED} --out {OUT}": "damaged",
    "simulate --robot {DAMAGED}.yaml --out {OUT}": "damaged",
    "simulate --robot {R} --joints wrist --out {OUT}": "valid are shoulder, elbow",
    "identify --robot none.xml --recordings {FIT} --out {OUT}.json": "none.xml",
}
BAD_EFFECTS = {
    "simulate --robot {R} --effects stribek --out {OUT}": "stribeck, ",
    "simulate --robot {R} --effects stribeck:wrist --out {OUT}": "shoulder, elbow",
    "simulate --robot {R} --effects stribeck( --out {OUT}": "cannot read 'stribeck('",
    "simulate --robot {R} --effects coulomb(x=1) --out {OUT}": "valid are level",
    "simulate --robot {R} --effects coulomb:1(level=-3) --out {OUT}": "0 or more",
    "identify --robot {R} --recordings {FIT} --effects x --out {OUT}.json": "stribeck",
    "effects stribek": "stribeck",
    "effects --effects-from none.py": "none.py",
}
BAD_CHOICES = {
    "identify --robot {R} --recordings {FIT} --out {OUT}.json --estimator ml": "irls",
    "identify --robot {R} --recordings {FIT} --out {OUT}.json --stages soft": "rigid",
}
BAD_RECORDINGS = {
    "identify --robot {R} --recordings {OUT} --out {OUT}.json": "no recordings there",
    "identify --robot {COMAN} --recordings {FIT} --out {OUT}.json": "missing joints",
    "identify --robot {R} --recordings {DAMAGED}.csv --out {OUT}.json": "damaged",
    "validate --model {MODEL} --recordings {OUT}/*.csv": "no recordings there",
    "validate --model {MODEL} --recordings {DAMAGED}.npz": "damaged",
    "predict --model {MODEL} --recording {FIT} --out {OUT}.csv": ".parquet",
    "predict --model {MODEL} --recording {OUT}.csv --out {OUT}.csv": "no such file",
}
BAD_MODELS = {
    "validate --model {OUT}.json --recordings {FIT}": "out.json: cannot be read",
    "validate --model {FIT}/truth.json --recordings {FIT}": "schema",
    "validate --model {DAMAGED} --recordings {FIT}": "damaged",
    "validate --model {COMAN} --recordings {FIT}": "a robot file, not a saved model",
    "validate --model {LIST} --recordings {FIT}": "is [1, 2], not a saved model",
    "validate --model {EDITED} --recordings {FIT}": "edited.json: damaged or edited",
    "validate --model {CUT} --recordings {FIT}": "cut.json: damaged",
    "validate --robot {COMAN} --model {MODEL} --recordings {FIT}": "of joints shoulder",
    "validate --robot {SCARA} --model {MODEL} --recordings {FIT}": "another arm",
    "predict --model {EDITED} --recording {LOG} --out {OUT}.csv": "edited",
}
BAD_OUTPUTS = {
    "simulate --robot {R} --out {FILE}": "no folder",
    "simulate --robot {R} --out {FILE}/below": "no folder",
    "simulate --robot {R} --out /proc/d": "error: /proc/d/",
    "demo --out /proc/d": "error: /proc/d/model.json: cannot be written",
    "simulate --robot {R} --out {OUT} --json {OUT}/truth.json": "another output",
    "identify --robot {R} --recordings {FIT} --out {OUT}.txt": ".json",
    "identify --robot {R} --recordings {FIT} --out {FILE}/m.json": "no folder",
    "identify --robot {R} --recordings {FIT} --out {OUT}.json --json {OUT}.json": "out",
    "identify --robot {R} --recordings {FIT} --out {OUT}.json --json {FIT}": "a folder",
    "validate --model {MODEL} --recordings {FIT} --json {MODEL}": "an input",
    "predict --model {MODEL} --recording {LOG} --out {LOG}": "an input",
    "predict --model {MODEL} --recording {LOG} --out {OUT}.xls": ".csv, .parquet, .npz",
    "effects --json {FILE}/effects.json": "no folder",
}
BAD = [
    *BAD_ARGUMENTS.items(), *BAD_ROBOTS.items(), *BAD_EFFECTS.items(),
    *BAD_CHOICES.items(), *BAD_RECORDINGS.items(), *BAD_MODELS.items(),
    *BAD_OUTPUTS.items(),
]  # fmt: skip


@pytest.fixture(scope="module")
def places(chain, tmp_path_factory) -> dict[str, object]:
    """What the commands above name; all of it copies, and no command writes."""
    tmp_path = tmp_path_factory.mktemp("places")
    shutil.copytree(chain.folder, tmp_path, dirs_exist_ok=True)
    model = (tmp_path / "model.json").read_text("utf-8")
    edited = model.replace("true", "false", 1)
    (tmp_path / "edited.json").write_text(edited, "utf-8")
    (tmp_path / "cut.json").write_text(model[: len(model) // 2], "utf-8")
    (tmp_path / "list.json").write_text("[1, 2]", "utf-8")
    damaged = tmp_path / "damaged.xml"
    for suffix in ("", ".csv", ".npz", ".yaml"):
        Path(f"{damaged}{suffix}").write_bytes(b"<mujoco>\x00[{\xff")
    return {
        "R": PLANAR, "COMAN": MODELS / "coman_like.xml",
        "SCARA": MODELS / "scara.xml", "FIT": tmp_path / "fit",
        "LOG": tmp_path / "fit" / "trajectory_1.csv",
        "MODEL": tmp_path / "model.json", "EDITED": tmp_path / "edited.json",
        "CUT": tmp_path / "cut.json", "DAMAGED": damaged,
        "LIST": tmp_path / "list.json",
        "FILE": tmp_path / "tau.csv", "OUT": tmp_path / "out",
    }  # fmt: skip


class TestBadInput:
    @pytest.mark.parametrize(("command", "words"), BAD)
    def test_it_is_one_line_that_says_what_is_valid(
        self, places, capsys, command, words
    ):
        before = tree(places["OUT"].parent)
        text = complaint(capsys, command.format(**places))
        assert words in text
        assert tree(places["OUT"].parent) == before

    def test_a_disk_that_fails_is_bad_input_too(
        self, chain, tmp_path, capsys, monkeypatch
    ):
        def full(*_):
            raise OSError(28, "No space left on device")  # as a write says it

        monkeypatch.setitem(sys.modules["hybrid.recording.write"].WRITERS, ".csv", full)
        text = complaint(
            capsys,
            f"predict --model {chain.model} --recording {chain.fit}/trajectory_1.csv "
            f"--out {tmp_path}/tau.csv",
        )
        assert text == f"error: {tmp_path}/tau.csv: No space left on device\n"
        assert tree(tmp_path) == {}

    def test_an_error_of_the_program_is_one_line_and_can_be_looked_into(
        self, capsys, monkeypatch
    ):
        def broken():
            raise ValueError("two\nlines")

        monkeypatch.delenv("HYBRID_DEBUG", raising=False)
        monkeypatch.setattr(sys.modules["hybrid.effects"], "effect_classes", broken)
        text = complaint(capsys, "effects", code=1)
        assert "ValueError: two lines" in text and "HYBRID_DEBUG" in text
        monkeypatch.setenv("HYBRID_DEBUG", "1")
        with pytest.raises(ValueError, match="two"):
            main(["effects"])


def test_a_pipe_is_refused_before_anything_is_shown(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    assert main(f"effects --json {tmp_path}/pipe".split()) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and "pipe: is a device or pipe" in shown.err


class TestInterrupt:
    """Ctrl-C"""

    def test_while_working_nothing_is_written(
        self, chain, tmp_path, capsys, monkeypatch
    ):
        def interrupted(*_, **__):
            raise KeyboardInterrupt

        monkeypatch.setattr(
            sys.modules["hybrid.identification"], "identify", interrupted
        )
        text = complaint(
            capsys,
            f"identify --robot {PLANAR} --recordings {chain.fit} --out "
            f"{tmp_path}/new/m.json",
            code=130,
        )
        assert "interrupted" in text
        assert list(tmp_path.iterdir()) == []

    def test_while_writing_the_old_file_stays(
        self, chain, tmp_path, capsys, monkeypatch
    ):
        def half(columns, path):
            path.write_text("time,tau_sh")
            raise KeyboardInterrupt

        monkeypatch.setitem(sys.modules["hybrid.recording.write"].WRITERS, ".csv", half)
        out = tmp_path / "tau.csv"
        out.write_text("old")
        complaint(
            capsys,
            f"predict --model {chain.model} --recording {chain.fit}/trajectory_1.csv "
            f"--out {out}",
            code=130,
        )
        assert tree(tmp_path) == {"tau.csv": b"old"}

    def test_a_termination_while_writing_leaves_nothing(
        self, tmp_path, capsys, monkeypatch
    ):
        def terminated(*_):
            signal.raise_signal(signal.SIGTERM)

        monkeypatch.setattr(
            sys.modules["hybrid.plant.simulate"], "write_json", terminated
        )
        before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
        try:
            simulate = f"simulate --robot {PLANAR} {SHORT} --out {tmp_path}/logs"
            assert "terminated" in complaint(capsys, simulate, code=143)
        finally:
            signal.signal(signal.SIGTERM, before)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("is_new", [False, True])
    def test_a_folder_of_recordings_is_of_one_run(
        self, tmp_path, capsys, monkeypatch, is_new
    ):
        def interrupted(*_):
            raise KeyboardInterrupt

        simulate = f"simulate --robot {PLANAR} {SHORT} --out {tmp_path}/logs"
        if not is_new:
            run(f"{simulate}")
        before = tree(tmp_path)
        monkeypatch.setattr(
            sys.modules["hybrid.plant.simulate"], "write_json", interrupted
        )
        complaint(capsys, f"{simulate} --seed 1", code=130)
        assert tree(tmp_path) == before
        assert (tmp_path / "logs").exists() is not is_new


def test_a_warning_is_one_line_and_said_once(capsys, monkeypatch):
    def warned():
        for text in ("the same", "the same", "two\nlines"):
            warnings.warn(text, HybridWarning, stacklevel=1)
        return {}

    monkeypatch.setattr(sys.modules["hybrid.effects"], "effect_classes", warned)
    run("effects")
    assert capsys.readouterr().err == "warning: the same\nwarning: two lines\n"


def test_help_names_every_stage_estimator_and_verb(capsys):
    for args, words in (
        (["identify", "--help"], (*STAGES, *ESTIMATORS)),
        (["inspect", "--help"], PRESETS),
        (["--help"], VERBS),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(args)
        assert stopped.value.code == 0
        out = capsys.readouterr().out
        assert all(word in out for word in words)
        assert "example" in out or "hybrid simulate --robot" in out


@pytest.mark.parametrize("verb", EVERY_VERB)
def test_every_verb_has_help_with_examples(verb, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([verb, "--help"])
    assert stopped.value.code == 0
    out = capsys.readouterr().out
    assert f"\n  hybrid {verb}" in out and "--json FILE" in out


def test_the_version_is_shown(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out == f"hybrid {__version__}\n"


def test_numbers_and_names_are_read():
    assert options.positive("2.5") == 2.5
    assert options.whole("0") == 0
    assert options.names("a, b") == ("a", "b")
    for reader, text in ((options.positive, "inf"), (options.count, "0")):
        with pytest.raises(ArgumentTypeError):
            reader(text)


class TestProcess:
    """As a process of its own"""

    def test_help_is_fast_and_imports_nothing_heavy(self):
        code = (
            "import sys, time; start = time.perf_counter()\n"
            "from hybrid.cli import main\n"
            "try: main(['--help'])\n"
            "except SystemExit: pass\n"
            f"print('took', time.perf_counter() - start)\n"
            f"print('loaded', *(set({HEAVY}) & set(sys.modules)))"
        )
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        *_, took, loaded = done.stdout.splitlines()
        assert loaded.strip() == "loaded"
        assert float(took.split()[1]) < 1.0

    def test_its_exit_code_and_streams_are_those_of_main(self):
        def command(word: str) -> tuple[int, str, str]:
            run = [sys.executable, "-m", "hybrid", word]
            done = subprocess.run(run, capture_output=True, text=True, timeout=60)
            return done.returncode, done.stdout, done.stderr

        assert command("--version") == (0, f"hybrid {__version__}\n", "")
        code, out, err = command("effect")
        assert (code, out) == (2, "") and len(err.splitlines()) == 1

    def test_a_reader_that_has_enough_is_no_error(self):
        process = subprocess.Popen(
            [sys.executable, "-m", "hybrid", "effects"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        process.stdout.close()
        assert process.stderr.read() == b""
        process.stderr.close()
        assert process.wait(timeout=60) == 141
