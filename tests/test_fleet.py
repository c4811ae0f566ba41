"""Fleets: plans, units that may hang or die, changes with a stated false-alarm rate."""

import json
import os
import signal
import warnings
from dataclasses import replace
from datetime import date, timedelta
from functools import cache
from pathlib import Path

import fsspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from arms import MODELS
from distributed import LocalCluster

from hybrid.cli import main
from hybrid.effects import effects_from_text
from hybrid.errors import HybridError
from hybrid.fleets import fleet
from hybrid.fleets import worker as workers
from hybrid.fleets.estimate import deviations, with_payload
from hybrid.fleets.plan import TRACK, periods, plan_from_dict
from hybrid.fleets.unit import answer
from hybrid.identification import identify
from hybrid.model.model_file import content_from_model
from hybrid.plant import Plant, simulate
from hybrid.plant.scale import joint_scales
from hybrid.recording import write
from hybrid.report.fleet import prometheus_text, write_fleet_pages
from hybrid.robot import Robot

SCARA = MODELS / "scara.xml"
HELD = "payload(mass=0.8;mx=0.16;mz=0;Ixx=0.002;Iyy=0.04;Izz=0.04)"


@cache
def logs(effects="", count=3, seed=0):
    """Cheap logs of a SCARA with effects its file does not know."""
    robot = Robot.load(SCARA)
    more = effects_from_text(effects, robot.joints, joint_scales(robot))
    plant = Plant(robot, more, step=0.002, control_rate=250.0, log_rate=50.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return simulate(plant, trajectories=count, duration=6, seed=seed)


@cache
def baseline():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return identify(Robot.load(SCARA), logs(), stages=("rigid",)).model


def folder_of_arms(tmp_path, arms=1, weeks=2):
    found = iter(logs(count=8, seed=4))
    for a in range(arms):
        for week in range(weeks):
            day = date(2026, 1, 5) + timedelta(7 * week)
            write(next(found), tmp_path / "logs" / f"arm{a}" / f"{day}.parquet")
    return plan_from_dict({"robot": str(SCARA), "arms": str(tmp_path / "logs")})


def found(rows, joint, parameter):
    return next(x for x in rows if (x.joint, x.parameter) == (joint, parameter))


@pytest.mark.parametrize(
    ("effect", "joint", "parameter", "size"),
    [
        ("coulomb:1(level=0.4)", "shoulder", "coulomb.level", 0.4),
        (HELD, "arm", "payload.mass", 0.8),
    ],
)
def test_a_change_is_found_where_it_is(effect, joint, parameter, size):
    before, after = (
        deviations(baseline(), logs(x, seed=9), TRACK, tool=(0.2, 0.0, 0.0))
        for x in ("", effect)
    )
    gap = found(after, joint, parameter).change - found(before, joint, parameter).change
    std = found(after, joint, parameter).std
    assert abs(gap - size) < 2 * std
    others = [
        abs(x.change - y.change) / x.std
        for x, y in zip(after, before, strict=True)
        if (x.joint, x.parameter) != (joint, parameter)
    ]
    assert gap / std > max(others)


def test_other_noise_on_the_same_motion_leaves_the_standard_deviations_alike():
    log, rng = logs(seed=9)[0], np.random.default_rng(0)
    std = []
    for _ in range(8):
        tau = log.tau + 0.5 * rng.standard_normal(log.tau.shape)
        rows = deviations(baseline(), [replace(log, tau=tau)], TRACK)
        std.append([x.std for x in rows])
    assert np.log(std).std(axis=0).max() < 0.05


def test_a_payload_that_the_arm_was_told_of_is_no_change():
    (effect,) = effects_from_text(
        HELD, ("shoulder", "elbow"), joint_scales(Robot.load(SCARA))
    )
    told, loaded = effect.gain_values.tolist(), logs(HELD, seed=9)
    rows = deviations(with_payload(baseline(), told), loaded, TRACK)
    x = found(rows, "arm", "payload.mass")
    assert abs(x.change) < 2 * x.std
    assert x.baseline == 0.8


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory):
    """Two arms of which one has a log that is none: the plan, by two processes."""
    folder = tmp_path_factory.mktemp("fleet")
    plan = replace(folder_of_arms(folder, arms=2), track=("coulomb",))
    (folder / "logs" / "arm1" / "2026-01-12.parquet").write_bytes(b"no log")
    return plan, folder, fleet(plan, folder / "out", workers=2)


def test_one_and_two_workers_write_the_same_and_a_rerun_does_nothing_twice(
    tmp_path, two_arms, asked
):
    plan, folder, found = two_arms
    fleet(plan, tmp_path, workers=1)
    whole = (folder / "out" / "fleet.parquet").read_bytes()
    assert (tmp_path / "fleet.parquet").read_bytes() == whole
    (refused,) = found.refused
    assert (refused["arm"], refused["status"]) == ("arm1", "refused")
    assert str(folder / "logs" / "arm1" / "2026-01-12.parquet") in refused["reason"]
    assert 'hybrid_fleet_refused_periods{arm="arm1"} 1' in prometheus_text(found)
    before = len(asked.asked)
    fleet(plan, folder / "out", workers=1)
    assert (folder / "out" / "fleet.parquet").read_bytes() == whole
    assert len(asked.asked) == before > 0


def test_the_report_leads_to_the_page_of_every_arm(tmp_path, two_arms):
    page = write_fleet_pages(tmp_path, two_arms[2], provenance={}).read_text()
    assert "<h1>Fleet: no arm changed</h1>" in page
    for arm in ("arm0", "arm1"):
        assert f'<a href="arms/{arm}.html">{arm}</a>' in page
        assert arm in (tmp_path / "arms" / f"{arm}.html").read_text()


def question(*logs, **options):
    """What a worker is asked about logs of a period of the arm of the baseline."""
    return {
        "task": "period", "model": json.dumps(content_from_model(baseline())),
        "track": list(TRACK), "payload": [], "tool": [], "map": None,
        "logs": list(map(str, logs)),
    } | options  # fmt: skip


def test_logs_in_a_store_are_found_and_fetched_and_give_the_same_rows(tmp_path):
    path = tmp_path / "2026-01-05.parquet"
    write(logs()[0], path)
    store = fsspec.filesystem("memory")
    store.put(str(path), "/fleet/cell/2026-01-05.parquet")
    try:
        plan = plan_from_dict({"robot": str(SCARA), "arms": "memory://fleet"})
        (arm,) = plan.arms
        ((week, [(day, there, _)]),) = periods(arm, "week").items()
        assert (arm.name, week, day) == ("cell", "2026-W02", "2026-01-05")
        rows = [answer(question(x)) for x in (path, there, path.as_uri())]
    finally:
        store.rm("/fleet", recursive=True)
    assert len({json.dumps(x) for x in rows}) == 1
    assert len(rows[0]["rows"]) == 9
    missing = answer(question("memory://nowhere/2026-01-05.csv"))
    assert missing["failed"] == "lost"  # a store that does not answer is asked again


def test_a_diagnosis_says_what_has_changed_since_the_baseline(tmp_path):
    files = [tmp_path / f"{k}.parquet" for k in range(3)]
    for path, log in zip(files, logs("coulomb:1(level=0.6)", seed=9), strict=True):
        write(log, path)
    verdict, *findings = answer(question(*files, task="diagnosis"))["rows"]
    assert (verdict["status"], verdict["reason"]) == ("verdict", "explained")
    assert [(x["joint"], x["parameter"]) for x in findings] == [("shoulder", "coulomb")]


def test_a_child_that_was_killed_is_replaced_and_one_that_hangs_is_ended():
    start = {"task": "baseline", "robot": str(SCARA), "joints": [], "map": None}
    try:
        none = workers.ask({**start, "periods": []}, None, 60.0)
        (killed,) = workers._children.values()
        killed.process.kill()
        assert workers.ask({**start, "periods": []}, None, 60.0) == none
        (hangs,) = workers._children.values()
        os.kill(hangs.process.pid, signal.SIGSTOP)
        found = workers.ask({**start, "periods": []}, None, 1.0)
        assert found == {"failed": "late", "reason": "no result within 1 s"}
        assert hangs.process.poll() is not None
    finally:
        workers.end_children()


def test_a_child_that_does_not_load_in_time_is_killed(monkeypatch):
    started, popen = [], workers.subprocess.Popen

    def sleeps(command, **options):
        words = [command[0], "-c", "import time; time.sleep(60)"]
        started.append(popen(words, **options))
        return started[0]

    monkeypatch.setattr(workers, "_START", 0.1)
    monkeypatch.setattr(workers.subprocess, "Popen", sleeps)
    assert workers.ask({}, None, 1.0)["failed"] == workers.LATE
    (child,) = started
    assert child.returncode is not None and child.stdout.closed


class Here:
    """A child that is no process of its own, to count what it is asked."""

    asked: list[str] = []

    def __init__(self, module):
        assert module == "hybrid.fleets.unit"

    def ask(self, question, limit):
        self.asked.append(json.loads(question)["task"])
        return answer(json.loads(question))

    def end(self):
        pass


@pytest.fixture
def asked(monkeypatch):
    monkeypatch.setattr(workers, "Child", Here)
    monkeypatch.setattr(Here, "asked", [])
    return Here


def stored_periods(out):
    """Rows of every period that is stored."""
    found = [json.loads(x.read_text()) for x in out.rglob("*.json")]
    return [x for x in found if isinstance(x, list)]


@pytest.mark.study
def test_a_full_disk_is_one_line_and_the_same_command_goes_on(
    tmp_path, capsys, monkeypatch, asked
):
    folder_of_arms(tmp_path)
    out, written = tmp_path / "out", []
    words = ["fleet", str(tmp_path / "logs"), "--robot", str(SCARA), "--out", str(out)]
    write_text = Path.write_text

    def on_a_disk_with_room_for_two(path, text, **options):
        count = write_text(path, text, **options)
        if out in path.parents:  # other libraries write their own files once
            written.append(count)
        if len(written) > 2:  # the baseline and one period
            path.write_bytes(b"torn")
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", on_a_disk_with_room_for_two)
        assert main([*words, "--workers", "1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()[-1:]
    assert line.startswith(f"error: {out}") and line.endswith("No space left on device")
    (done,) = stored_periods(out)
    assert len(done) == 9
    assert main([*words, "--workers", "1"]) == 0
    assert asked.asked == ["baseline", "period", "period", "period"]
    assert pq.read_table(out / "fleet.parquet").num_rows == 18


def on_a_cluster(plan, out, when="", what=None):
    """Run a plan on a cluster to which something happens in between."""
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address="127.0.0.1:0",  # another test may have the usual port
    ) as cluster:

        def tell(text, done=None):
            if when == text:
                what(cluster)

        return fleet(plan, out, scheduler=cluster.scheduler_address, progress=tell)


def test_a_scheduler_that_is_lost_is_one_line_and_another_goes_on(tmp_path, asked):
    plan, out = folder_of_arms(tmp_path, weeks=3), tmp_path / "out"
    with pytest.raises(HybridError, match="lost .* the same command goes on"):
        on_a_cluster(plan, out, "1 of 3 periods", LocalCluster.close)
    assert len(stored_periods(out)) == 1
    before = len(asked.asked)
    assert len(on_a_cluster(plan, out).states) == 9
    assert asked.asked[before:] == ["period", "period"]


def test_a_worker_that_is_lost_with_all_it_holds_is_made_up_for(tmp_path, asked):
    def another(cluster):
        (worker,) = cluster.workers.values()
        cluster.sync(worker.close, executor_wait=False)
        cluster.scale(2)

    plan = folder_of_arms(tmp_path, weeks=8)
    found = on_a_cluster(plan, tmp_path / "out", "1 of 8 periods", another)
    assert not found.refused
    assert found.arm_months == pytest.approx(8 * 7 / 30.4375)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ({"arms": {"a": {}}}, "arm a: no robot and no logs"),
        ({"arms": "nowhere", "robot": "scara.xml"}, "no such folder of arms"),
    ],
)
def test_a_plan_that_is_not_valid_is_refused_in_one_line(content, line):
    with pytest.raises(HybridError, match=line):
        plan_from_dict(content)


@pytest.mark.parametrize("library", ["distributed", "fsspec", "pyarrow"])
def test_without_the_extra_one_line_says_what_to_install(
    library, tmp_path, capsys, monkeypatch
):
    folder_of_arms(tmp_path, weeks=1)

    def find_spec(name):
        return None if name == library else True

    monkeypatch.setattr("hybrid.extras.find_spec", find_spec)
    words = ["fleet", str(tmp_path / "logs"), "--robot", str(SCARA)]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "pip install 'hybrid-arm[fleet]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_address_that_is_none_is_refused_in_one_line(tmp_path, capsys):
    folder_of_arms(tmp_path, weeks=1)
    words = ["fleet", str(tmp_path / "logs"), "--robot", str(SCARA)]
    assert main([*words, "--out", str(tmp_path / "out"), "--scheduler", "there"]) == 2
    assert "valid is an address" in capsys.readouterr().err


def test_a_log_without_a_date_is_refused_before_any_work(tmp_path, capsys):
    (tmp_path / "logs" / "arm").mkdir(parents=True)
    (tmp_path / "logs" / "arm" / "monday.csv").write_text("t\n", encoding="utf-8")
    words = ["fleet", str(tmp_path / "logs"), "--robot", str(SCARA)]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "monday.csv has no date in its name" in capsys.readouterr().err


def test_a_fleet_whose_logs_have_no_torque_ends_with_an_error(tmp_path, capsys, asked):
    """It ended well, though there was no result at all."""
    folder_of_arms(tmp_path)
    log = replace(logs(count=1)[0], tau=np.zeros(0))
    for path in (tmp_path / "logs" / "arm0").iterdir():
        write(replace(log, command=log.q), path)
    words = ["fleet", str(tmp_path / "logs"), "--robot", str(SCARA), "--workers", "1"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert "no period has a result: arm0, 2026-W02: " in line
    assert "valid are tau1" in line
    assert (tmp_path / "out" / "report.html").is_file()
