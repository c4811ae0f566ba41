"""What a fleet does with one arm's logs: periods, units, a body at the tool."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import NOISE, pendulum, swings, with_torque

from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.payload import Payload
from hybrid.errors import HybridError
from hybrid.fleets import store as stores
from hybrid.fleets.estimate import (
    _noise_weights,
    _payload_covariance,
    _posterior,
    _prior,
    deviations,
    followed,
)
from hybrid.fleets.fleet import Fleet
from hybrid.fleets.plan import ArmPlan, Plan, periods, read_plan
from hybrid.fleets.store import Store, run_plan
from hybrid.fleets.worker import LATE, LOST, REFUSED
from hybrid.identification import DynamicModel
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem
from hybrid.report.fleet import diagnoses_table, fleet_tables

DAYS = {"2026-01-05": "W02", "2026-01-06": "W02", "2026-02-02": "W06"}


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "logs").mkdir()
    for day in DAYS:
        (tmp_path / "logs" / f"{day}.csv").write_text("log")
    return ArmPlan("a", str(tmp_path / "logs"), "arm.xml")


@pytest.mark.parametrize(
    ("period", "names"),
    [
        ("week", ["2026-W02", "2026-W06"]),
        ("month", ["2026-01", "2026-02"]),
        ("day", list(DAYS)),
        ("log", [f"{x}.csv" for x in DAYS]),
    ],
)
def test_logs_are_put_together_by_their_period(arm, period, names):
    found = periods(arm, period)
    assert list(found) == names
    logs = [x for own in found.values() for x in own]
    assert [day for day, _, _ in logs] == list(DAYS)
    assert all(path.endswith(f"{day}.csv") for day, path, _ in logs)


def test_a_log_without_a_date_is_a_log_and_no_week(arm, tmp_path):
    (tmp_path / "logs" / "one.csv").write_text("log")
    assert "one.csv" in periods(arm, "log")
    with pytest.raises(HybridError, match="no date in its name"):
        periods(arm, "week")
    with pytest.raises(HybridError, match="no log in"):
        periods(replace(arm, logs=str(tmp_path / "nothing")), "log")


@pytest.fixture
def known(monkeypatch):
    """A baseline that is there, and workers whose answers are made up."""
    base = SimpleNamespace(key="base", text="{}", reason="")
    monkeypatch.setattr(stores, "_baselines", lambda *_: {"a": base})
    asked, said = [], {"rows": [{"joint": "j", "change": 1.0}]}

    def answers(client, units, limit):
        for unit, message, text in units:
            asked.append((unit, message, text, limit))
            yield unit, dict(said)

    monkeypatch.setattr(stores, "answers", answers)
    return SimpleNamespace(base=base, asked=asked, said=said)


def run(arm, folder, **options):
    told = []
    plan = Plan((arm,), **options)
    return run_plan(
        plan, Store(folder / "done"), None, lambda text, _: told.append(text)
    ), told


def test_each_period_is_asked_once_and_kept(arm, tmp_path, known):
    rows, told = run(arm, tmp_path)
    assert [(x["arm"], x["period"], x["day"]) for x in rows] == [
        ("a", "2026-W02", "2026-01-05"), ("a", "2026-W06", "2026-02-02"),
    ]  # fmt: skip
    assert all(x["change"] == 1.0 and x["std"] is None for x in rows)
    assert told == ["1 of 2 periods", "2 of 2 periods"]
    (unit, message, text, limit), _ = known.asked
    assert [path[-14:] for path, _ in unit.logs] == ["2026-01-05.csv", "2026-01-06.csv"]
    assert message["task"] == "period" and message["logs"] == [x for x, _ in unit.logs]
    assert "baseline" not in message and text == "{}" and limit == 600.0
    again, told = run(arm, tmp_path)
    assert again == rows and told == [] and len(known.asked) == 2
    (tmp_path / "logs" / "2026-02-03.csv").write_text("one more")
    run(arm, tmp_path)
    assert [unit.period for unit, *_ in known.asked[2:]] == ["2026-W06"]


def test_a_diagnosis_is_a_unit_of_its_own(arm, tmp_path, known):
    run(arm, tmp_path, diagnose=True)
    tasks = [(unit.period, message["task"]) for unit, message, *_ in known.asked]
    assert sorted(tasks) == [
        (week, task)
        for week in ("2026-W02", "2026-W06")
        for task in ("diagnosis", "period")
    ]


def test_a_diagnosis_that_failed_is_a_verdict_with_its_reason(arm, tmp_path, known):
    known.said.clear()
    known.said.update(failed=REFUSED, reason="logs/a_b.csv: no torques")
    rows, _ = run(arm, tmp_path, diagnose=True)
    table = diagnoses_table(Fleet(rows, (), (), 1.0, 1.0))
    assert table.rows == (("a", "2026-W06", "refused", "logs/a_b.csv: no torques"),)


def test_each_column_of_a_fleet_s_tables_has_a_name():
    """They are the keys of the JSON file."""
    for table in fleet_tables(Fleet([], (), (), 1.0, 1.0)).values():
        assert all(table.header)


@pytest.mark.parametrize(
    ("failed", "again"), [(REFUSED, False), (LATE, False), (LOST, True)]
)
def test_what_failed_is_said_and_asked_again_only_if_that_was_no_fault_of_logs(
    arm, tmp_path, known, failed, again
):
    known.said.clear()
    known.said.update(failed=failed, reason="so it is")
    rows, _ = run(arm, tmp_path, period="month")
    assert [(x["status"], x["reason"]) for x in rows] == [(failed, "so it is")] * 2
    known.asked.clear()
    run(arm, tmp_path, period="month")
    assert len(known.asked) == (2 if again else 0)
    longer, _ = run(arm, tmp_path, period="month", time_limit=900.0)
    assert len(longer) == 2
    known.asked.clear()
    run(arm, tmp_path, period="month", time_limit=1200.0)
    assert len(known.asked) == (2 if failed in (LATE, LOST) else 0)


def test_without_a_baseline_all_periods_are_refused(arm, tmp_path, known):
    known.base.text, known.base.reason = None, "no model"
    rows, _ = run(arm, tmp_path)
    assert [(x["status"], x["reason"]) for x in rows] == [(REFUSED, "no model")] * 2
    assert known.asked == []


# --- deviations -----------------------------------------------------------------------


def model(size=2) -> DynamicModel:
    problem = build_problem(pendulum(size).chain, [])
    base = problem.base.with_values(
        problem.base.mapping @ pendulum(size).chain.inertial.ravel()
    )
    rotors = tuple(Armature((j,), {"inertia": 0.05}) for j in range(size))
    return DynamicModel(pendulum(size), base, effects=rotors, cutoff=10.0)


def test_a_body_at_the_tool_has_its_mass_there_and_moments_of_its_size():
    tool, mass, off = np.array([0.2, -0.3, 0.4]), 2.0, 0.05
    second = _payload_covariance(model(), mass, tool) / mass**2  # means of products
    assert second[0, 0] == pytest.approx(1.0)
    np.testing.assert_allclose(second[0, 1:4], tool, atol=0.01)
    x, y, z = tool**2 + off**2
    about = [y + z + off**2, 0.06, x + z + off**2, -0.08, 0.12, x + y + off**2]
    np.testing.assert_allclose(second[0, 4:], about, atol=0.02)
    spread = np.diag(second)[1:4] - tool**2
    np.testing.assert_allclose(spread, off**2, atol=0.006)
    assert np.linalg.eigvalsh(second).min() > -1e-12


def test_without_a_tool_a_body_is_at_the_middle_of_the_last_link():
    second = _payload_covariance(model(), 1.0, ())
    np.testing.assert_allclose(second[0, 1:4], [0.0, 0.0, -0.3], atol=0.01)
    light = model()
    links = light.robot.chain.inertial.copy()
    links[-1] = 0.0
    bare = replace(light, robot=light.robot.with_inertial(links))
    np.testing.assert_allclose(
        _payload_covariance(bare, 1.0, ())[0, 1:4], 0.0, atol=0.01
    )


def test_links_are_known_to_a_twentieth_or_as_the_baseline_says():
    """And effects to their usual size at each joint."""
    known = model(2)
    effects = followed(("coulomb", "torque_gain.gain"), 2)
    prior = _prior(known, [0, 2], effects, ())
    values, scales = known.base.values[[0, 2]], joint_scales(known.robot)
    sizes = [
        gain.spread or abs(gain.typical)
        for effect, _ in effects
        for gain in (g.scaled(scales[effect.joints[0]]) for g in effect.gains)
    ]
    std = np.array([*np.abs(0.05 * values), *sizes])
    np.testing.assert_allclose(prior, np.diag(std**2))
    assert (std[2:] > 0).all() and len(std) == 2 + 2 + 2
    stated = np.diag(np.arange(1.0, len(known.base.values) + 1.0))
    prior = _prior(replace(known, covariance=stated), [0, 2], effects, ())
    np.testing.assert_allclose(np.diag(prior)[:2], [1.0, 3.0])


def test_a_posterior_is_that_of_regression_with_a_prior():
    rng = np.random.default_rng(0)
    prior = np.diag([4.0, 0.25])
    X = rng.standard_normal((400, 1, 2))
    y = X @ np.array([1.5, -0.4]) + 0.3 * rng.standard_normal((400, 1))
    part = np.concatenate([X, y[:, :, None]], axis=2)
    part[350:] = np.nan  # at rest
    X, y = X[:350, 0], y[:350, 0]
    theta, covariance, rms = _posterior([part[:200], part[200:]], prior)
    power, weight = _noise_weights((y - X @ theta)[:, None])
    H = np.linalg.inv(prior) + weight[0] * X.T @ X
    np.testing.assert_allclose(covariance, np.linalg.inv(H), rtol=1e-3)
    np.testing.assert_allclose(
        theta, np.linalg.solve(H, weight[0] * X.T @ y), rtol=1e-3
    )
    assert power[0] == pytest.approx(0.09, rel=0.2)
    left = np.mean((y - X @ theta) ** 2) / np.mean(y**2)
    assert rms[0] == pytest.approx(np.sqrt(left), rel=1e-3)


def test_of_a_joint_at_rest_nothing_is_told():
    power, weight = _noise_weights(np.full((50, 1), np.nan))
    assert power.tolist() == [1.0] and weight.tolist() == [0.0]


@pytest.mark.parametrize(
    ("effect", "parameter", "joint", "size"),
    [
        (Coulomb((1,), {"level": 0.6}), "coulomb.level", "hinge_1", 0.6),
        (
            Payload((0, 1), {"mass": 0.5, "mz": -0.3, "Ixx": 0.18, "Iyy": 0.18}),
            "payload.mass", "arm", 0.5,
        ),
    ],
)  # fmt: skip
def test_a_change_is_told_by_its_size_where_it_is(effect, parameter, joint, size):
    def rows(effects):
        logs = [with_torque(m, effects, NOISE, k) for k, m in enumerate(swings(2))]
        track = ("coulomb", "viscous.coefficient", "payload.mass")
        found = deviations(model(), logs, track, tool=(0.0, 0.0, -0.6))
        return {(x.joint, x.parameter): x for x in found}

    before, after = rows(()), rows((effect,))
    assert set(before) == {
        *((f"hinge_{j}", x) for j in (0, 1)
          for x in ("coulomb.level", "viscous.coefficient")),
        ("arm", "payload.mass"),
    }  # fmt: skip
    for key, x in after.items():
        moved, std = x.change - before[key].change, x.std
        expected = size if key == (joint, parameter) else 0.0
        assert abs(moved - expected) < 4 * std + 1e-3, key
    assert after[joint, parameter].std < 0.2
    for sound in before.values():
        assert sound.residual == pytest.approx(1.0, abs=0.1)
        assert np.isnan(sound.temperature) and sound.load > 1.0


def test_only_what_is_named_is_followed():
    found = followed(("coulomb", "spring.stiffness", "payload.mass"), 2)
    assert [(e.id, e.joints, names) for e, names in found] == [
        ("coulomb", (0,), ("level",)), ("coulomb", (1,), ("level",)),
        ("spring", (0,), ("stiffness",)), ("spring", (1,), ("stiffness",)),
        ("payload", (0, 1), ("mass",)),
    ]  # fmt: skip
    with pytest.raises(HybridError, match="has no gain 'size'"):
        followed(("coulomb.size",), 2)
    with pytest.raises(HybridError, match="of pairs of joints"):
        followed(("transmission_coupling",), 2)


# --- plans ----------------------------------------------------------------------------


def test_paths_of_a_plan_start_where_it_lies(tmp_path):
    (tmp_path / "arm.xml").touch()
    (tmp_path / "plan.yaml").write_text(
        "robot: arm.xml\nperiod: day\nfalse_alarms: 2\ntool: [0, 0, 0.1]\n"
        "arms:\n  b: {logs: b/logs, payload: 0.5, group: old}\n"
        "  a: {logs: {2026-01-05: a.csv}, baseline: base.json, robot: ur5}\n"
        "  c: {logs: 's3://store/c', limits: {coulomb: 50%}, baseline: 2026-W02}\n"
    )
    plan = read_plan(tmp_path / "plan.yaml")
    a, b, c = plan.arms
    assert (a.name, b.name, c.name) == ("a", "b", "c")
    assert (plan.period, plan.false_alarms, plan.days) == ("day", 2, 1.0)
    assert b.logs == str(tmp_path / "b" / "logs") and c.logs == "s3://store/c"
    assert b.robot == str(tmp_path / "arm.xml") and a.robot == "ur5"
    assert (b.payload, b.tool, b.group) == ((0.5,), (0.0, 0.0, 0.1), "old")
    assert (a.group, c.group) == ("ur5", "arm.xml")
    assert a.baseline == str(tmp_path / "base.json") and b.baseline == "first"
    assert c.baseline == "2026-W02" and c.limits == {"coulomb": "50%"}
    assert list(map(str, a.logs.values())) == ["a.csv"]


def test_a_folder_of_folders_is_a_plan(tmp_path):
    for name in "ab":
        (tmp_path / "cell" / name).mkdir(parents=True)
    (tmp_path / "cell" / "notes.txt").write_text("no arm")
    (tmp_path / "ur5.xml").touch()
    plan = read_plan(tmp_path / "cell", robot=tmp_path / "ur5.xml")
    assert [x.name for x in plan.arms] == ["a", "b"]
    assert {Path(x.robot).name for x in plan.arms} == {"ur5.xml"}
    assert [Path(x.logs).name for x in plan.arms] == ["a", "b"]
    with pytest.raises(HybridError, match="needs --robot"):
        read_plan(tmp_path / "cell")


def test_of_what_is_no_plan_eighty_characters_are_shown(tmp_path):
    (tmp_path / "plan.xml").write_text(f"<mujoco{3000 * 'x'}/>")
    with pytest.raises(
        HybridError, match="'<mujocox{72}, not a table; valid are keys arms"
    ):
        read_plan(tmp_path / "plan.xml")


@pytest.mark.parametrize(
    ("more", "line"),
    [
        ("false_alarms: 0", "false_alarms is 0; valid is a number above 0"),
        ("time_limit: true", "time_limit is True"),
        ("time_limit: x", "time_limit is 'x'"),
        ("period: year", "valid are day, week, month, log"),
        ("diagnose: 1", "diagnose is true or false"),
        ("speed: 1", "unknown 'speed'"),
        ("tool: [1, 2]", "tool 2; valid are up to 10, and 3 or none"),
        ("payload: a", "payload, tool and limits are numbers"),
        ("limits: {coulomb: much}", "payload, tool and limits are numbers"),
        ("track: [coulomb.size]", "has no gain 'size'"),
        ("track: [rust]", "rust"),
        ("robot: none.xml", "arm a: .*none.xml: no such robot file"),
    ],
)
def test_a_plan_says_what_is_not_valid(tmp_path, more, line):
    (tmp_path / "arm.xml").touch()
    robot = "" if more.startswith("robot") else "robot: arm.xml\n"
    text = f"{robot}arms: {{a: {{logs: x}}}}\n{more}\n"
    (tmp_path / "plan.yaml").write_text(text)
    with pytest.raises(HybridError, match=line):
        read_plan(tmp_path / "plan.yaml")


def test_one_of_the_first_four_periods_becomes_the_baseline():
    logs = {
        f"2026-W0{k}": [(f"2026-01-0{k}", f"{k}.csv", f"is {k}")] for k in range(1, 7)
    }
    arm = ArmPlan("a", "logs", "arm.xml", joints=("x", "y"), map="ur")
    unit, message = stores._baseline_unit(arm, logs)
    assert message == {
        "task": "baseline", "robot": "arm.xml", "joints": ["x", "y"], "map": "ur",
        "periods": [[f"2026-W0{k}", [f"{k}.csv"]] for k in (1, 2, 3, 4)],
    }  # fmt: skip
    assert unit.logs == tuple((f"{k}.csv", f"is {k}") for k in (1, 2, 3, 4))
    own, message = stores._baseline_unit(replace(arm, baseline="2026-W05"), logs)
    assert [name for name, _ in message["periods"]] == ["2026-W05"]
    assert own.key != unit.key
    with pytest.raises(HybridError, match="valid are 'first', a model's .json, or a"):
        stores._baseline_unit(replace(arm, baseline="2026-W09"), logs)
