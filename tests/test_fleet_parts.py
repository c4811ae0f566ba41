"""Statistics of a fleet by their formulas, and the logs of a plan by their dates."""

import json
import subprocess
import sys
from datetime import date
from types import SimpleNamespace

import numpy as np
import pytest

from hybrid.errors import HybridError
from hybrid.fleets.changes import _change, _first_alarm, _scores, _shapes
from hybrid.fleets.plan import (
    ArmPlan,
    Plan,
    Unit,
    _day,
    _fingerprint,
    _resolved,
    opened,
    periods,
    plan_from_dict,
)
from hybrid.fleets.pooling import _mean_and_spread, _p_value, pooled
from hybrid.fleets.run import answers
from hybrid.fleets.scatter import (
    Scatter,
    _differences,
    _moderated,
    calibrated_std,
    moderated,
)
from hybrid.report.fleet import lead_sentence

# --- pooling --------------------------------------------------------------------------


def test_a_spread_is_what_the_noise_of_arms_does_not_explain():
    """Equal weights: squares of 1 and 9 about the mean, less one of noise."""
    y, s = np.array([0.0, 2.0, 4.0, 10.0]), np.ones(4)
    mean, spread, error = _mean_and_spread(y, s)
    square = (16.0 + 4.0 + 0.0 + 36.0) / 3 - 1.0
    assert mean == 4.0 and spread == pytest.approx(np.sqrt(square))
    assert error == pytest.approx(np.sqrt((1.0 + square) / 4))
    mean, spread, error = _mean_and_spread(y, 100.0 * s)
    assert (mean, spread, error) == (4.0, 0.0, pytest.approx(50.0))
    heavy = _mean_and_spread(np.array([0.0, 1.0]), np.array([1.0, 0.5]))
    assert heavy[0] == pytest.approx(4.0 / 5.0) and heavy[1] == 0.0
    assert heavy[2] == pytest.approx(5.0**-0.5)


def test_an_arm_is_compared_with_all_others():
    y, s = np.array([0.0, 0.0, 0.0, 0.0, 5.0]), np.full(5, 1.0)
    p = _p_value(y, s, np.arange(5), 4)
    from scipy.stats import t

    assert p == pytest.approx(2 * t.sf(5.0 / np.sqrt(0.25 + 1.0), 3))
    assert _p_value(y, s, np.array([0, 4]), 4) == pytest.approx(
        2 * t.sf(5.0 / np.sqrt(2.0), 1)
    )


@pytest.mark.parametrize("s", [np.ones(4), np.array([0.5, 1.0, 2.0, 3.0])])
def test_arms_are_drawn_to_the_mean_by_how_unsure_they_are(s):
    y = np.array([0.0, 2.0, 4.0, 10.0])
    value, unlike = pooled(y, s)
    mean, spread, _ = _mean_and_spread(y, s)
    weight = spread**2 / (spread**2 + s * s)
    np.testing.assert_allclose(value, weight * y + (1 - weight) * mean)
    assert not unlike.any()
    value, unlike = pooled(
        np.array([0.0, 0.1, -0.1, 0.05, -0.05, 50.0]), 0.1 * np.ones(6)
    )
    assert unlike.tolist() == [False] * 5 + [True]
    assert value[5] == 50.0


# --- scatter --------------------------------------------------------------------------


def test_differences_leave_out_what_is_missing():
    y = np.array([1.0, np.nan, 4.0, 9.0, 2.0])
    s = np.array([3.0, 1.0, 4.0, np.nan, 3.0])
    differences, size = _differences(y, s)
    assert differences.tolist() == [3.0, -2.0] and size.tolist() == [5.0, 5.0]


def test_a_scatter_is_of_squared_differences_that_are_clipped():
    s = np.full((2, 5), np.sqrt(0.5))  # differences of variance one
    y = np.array([[0.0, 1, 0, 1, 0], [0.0, 1, 0, 100, 100]])
    found = Scatter.of(y, s)
    # The median size is one: no difference counts as more than 3 · 1.4826.
    most = (3 * 1.4826) ** 2
    np.testing.assert_allclose(found.square, [1.0, (1 + 1 + most + 0) / 4])
    np.testing.assert_allclose(found.freedom, [4 * 2 / 3] * 2)
    np.testing.assert_allclose(found.shares, [0.5, 0.5])
    assert found.fleet == pytest.approx(found.square.mean())
    none = Scatter.of(np.zeros((1, 1)), np.ones((1, 1)))
    assert (none.square[0], none.freedom[0]) == (0.0, 0.0) and none.fleet == 1e-18


def test_the_variance_of_an_arm_is_between_its_own_and_the_fleet_s():
    x = Scatter(np.array([1.0, 3.0]), np.array([6.0, 2.0]))
    assert x.fleet == pytest.approx(0.75 * 1.0 + 0.25 * 3.0)
    for variation in (0.0, 0.5):
        found = _moderated(x, variation)
        prior = 2.0 / (variation + 2.0 / np.array([2.0, 6.0]))
        np.testing.assert_allclose(found.freedom, x.freedom + prior)
        mean = (x.freedom * x.square + prior * 1.5) / found.freedom
        np.testing.assert_allclose(found.square, mean)
    # The squares of arms vary by (1/3)² and 1 about the mean, of which noise is less.
    (found,) = moderated([x])
    share = np.array([0.75, 0.25])
    excess = ((x.square / 1.5 - 1) ** 2 - (1 - share) * 2.0 / x.freedom).sum()
    expected = _moderated(x, max(0.0, excess / (1 - share).sum()))
    np.testing.assert_allclose(found.square, expected.square)
    np.testing.assert_allclose(found.freedom, expected.freedom)


def test_stated_deviations_count_by_what_differences_say_of_them():
    """Where differences go with them, they stay; else they are those of the arm."""
    rng = np.random.default_rng(0)
    s = np.exp(rng.choice([-2.0, 2.0], (8, 200)))
    right = s * rng.standard_normal(s.shape)
    wrong = rng.standard_normal(s.shape)
    (true,), (same,) = calibrated_std([(right, s)]), calibrated_std([(wrong, s)])
    usual = np.exp(np.log(s).mean(axis=1, keepdims=True))

    def exponent(x):
        return np.mean(np.log(x / usual) / np.log(s / usual))

    assert exponent(true) == pytest.approx(1.0, abs=0.1)
    assert exponent(same) == pytest.approx(0.0, abs=0.1)
    # Without any data it is a half.
    (half,) = calibrated_std([(np.zeros((1, 2)), np.array([[1.0, 4.0]]))])
    np.testing.assert_allclose(half, [[2.0 * 0.5**0.5, 2.0 * 2**0.5]])


# --- changes --------------------------------------------------------------------------


def test_steps_have_three_periods_before_and_two_after_and_ramps_two_after():
    t = np.array([0.0, 1.0, 3.0, 4.0, 8.0, 9.0])
    H, begins, steps = _shapes(t)
    assert steps == 2 and begins.tolist() == [3, 4, 0, 1, 2, 3]
    np.testing.assert_array_equal(H[:, 0], [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(H[:, 3], np.maximum(t - 1.0, 0.0))


def test_a_score_is_the_size_over_its_deviation_by_least_squares():
    rng = np.random.default_rng(1)
    t, s = np.arange(8.0), rng.uniform(0.5, 2.0, 8)
    y, x = rng.standard_normal(8), rng.standard_normal(8)
    for covariate in (None, x):
        z, std = _scores(t, y, s, covariate)
        H, _, _ = _shapes(t)
        for k in range(H.shape[1]):
            known = [np.ones(8)] if covariate is None else [np.ones(8), x]
            X = np.stack([*known, H[:, k]], axis=1) / s[:, None]
            if np.linalg.matrix_rank(X) < X.shape[1]:
                continue
            covariance = np.linalg.inv(X.T @ X)
            size = (covariance @ X.T @ (y / s))[-1]
            assert std[k] == pytest.approx(np.sqrt(covariance[-1, -1]))
            assert z[k] == pytest.approx(size / std[k])
    both, _ = _scores(t, np.stack([y, 2 * y], axis=1), s, None)
    np.testing.assert_allclose(both[:, 1], 2 * both[:, 0])
    alike, std = _scores(t, y, s, (t >= 4).astype(float))
    assert alike[1] == 0.0 and std[1] == 0.0  # the step that the covariate is


def test_a_step_without_noise_is_told_with_its_day_and_size():
    t, s = 7.0 * np.arange(12), np.ones(12)
    y = np.where(t >= 35.0, 6.0, 0.0)
    found = _change(t, y, s, None, alarm=49.0)
    assert (found.kind, found.day, found.alarm) == ("step", 35.0, 49.0)
    assert found.size == pytest.approx(6.0)
    assert found.std == pytest.approx(np.sqrt(1 / 5 + 1 / 7))
    assert found.score == pytest.approx(6.0 / found.std)
    assert found.earliest <= 35.0 <= found.latest
    before = _change(t, y, s, None, alarm=28.0)
    assert before.day <= 28.0  # no later than its alarm
    # The first alarm is where the score first passes its limit.
    n = _first_alarm(t, y, s, 4.0, None, 0)
    scores = [np.abs(_scores(t[:k], y[:k], s[:k], None)[0]).max() for k in range(5, 13)]
    assert n == 5 + int(np.argmax(np.array(scores) > 4.0)) - 1
    assert _first_alarm(t, y, s, 99.0, None, 0) is None
    assert _first_alarm(t, y, s, 4.0, None, 5) is None  # all that is after it is even


# --- the logs of a plan ---------------------------------------------------------------


def test_a_day_is_the_last_date_in_a_path():
    assert _day("a/2025-01-02/b_2026-03-04.csv") == date(2026, 3, 4)
    assert _day("2026-01-31/2026-13-45.csv") == date(2026, 1, 31)
    assert _day("log_7.csv") is None


@pytest.mark.parametrize(
    ("period", "name"),
    [("day", "2027-01-03"), ("week", "2026-W53"), ("month", "2027-01")],
)
def test_a_week_may_be_of_the_year_before(tmp_path, period, name):
    (tmp_path / "log.csv").write_text("log")

    def names(day, period):
        return list(periods(ArmPlan("a", {day: tmp_path / "log.csv"}, ""), period))

    assert names("2027-01-03", period) == [name]
    assert names("2026-02-03", "week") == ["2026-W06"]


def test_a_table_of_dates_has_its_logs_on_these(tmp_path):
    for name in ("late", "early", "same"):
        (tmp_path / f"{name}.csv").write_text(name)
    table = {
        "2026-02-10": tmp_path / "late.csv", "2026-01-05": tmp_path / "early.csv",
    }  # fmt: skip
    arm = ArmPlan("a", table, "arm.xml")
    found = periods(arm, "month")
    assert list(found) == ["2026-01", "2026-02"]
    ((day, path, stamp),) = found["2026-01"]
    assert (day, path) == ("2026-01-05", str(tmp_path / "early.csv"))
    fs, root = opened(path)
    assert stamp == _fingerprint(fs, root) and len(stamp) == 16
    (tmp_path / "early.csv").write_text("another size")
    assert _fingerprint(fs, root) != stamp
    with pytest.raises(HybridError, match="no such log"):
        periods(ArmPlan("a", {"2026-01-05": tmp_path / "none.csv"}, "arm.xml"), "day")
    with pytest.raises(HybridError, match="arm a: no log in"):
        periods(ArmPlan("a", {}, "arm.xml"), "day")


def test_logs_are_in_the_order_of_their_days_and_hidden_ones_are_none(tmp_path):
    for name in ("b_2026-01-09.csv", "c_2026-01-05.csv", ".x_2026-01-01.csv"):
        (tmp_path / name).write_text(name)
    arm = ArmPlan("a", str(tmp_path), "arm.xml")
    assert list(periods(arm, "day")) == ["2026-01-05", "2026-01-09"]
    assert list(periods(arm, "log")) == ["c_2026-01-05.csv", "b_2026-01-09.csv"]
    both = periods(arm, "month")["2026-01"]
    assert [x[0] for x in both] == ["2026-01-09", "2026-01-05"]


def test_logs_of_one_day_are_in_the_order_of_their_names(tmp_path):
    table = {}
    for day, name in (("2026-01-05", "x/b.csv"), ("20260105", "y/a.csv")):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(name)
        table[day] = tmp_path / name
    assert list(periods(ArmPlan("a", table, "arm.xml"), "log")) == ["a.csv", "b.csv"]


def test_a_plan_has_defaults_for_all_arms_and_numbers_of_its_own(tmp_path):
    (tmp_path / "arm.xml").touch()
    content = {
        "robot": "arm.xml", "payload": 1.5, "period": "month", "time_limit": 60,
        "arms": {"b": {"logs": "x", "tool": [0, 0, 0.1]}, "a": {"logs": "s3://y/z"}},
    }  # fmt: skip
    plan = plan_from_dict(content, tmp_path)
    assert [x.name for x in plan.arms] == ["a", "b"] and plan.days == 30.4375
    first, second = plan.arms
    assert first.payload == second.payload == (1.5,) and second.tool == (0.0, 0.0, 0.1)
    assert first.logs == "s3://y/z" and second.logs == str(tmp_path / "x")
    assert first.robot == str(tmp_path / "arm.xml") and first.group == "arm.xml"
    assert plan.time_limit == 60
    assert [Plan((), period=x).days for x in ("day", "week", "log")] == [1.0, 7.0, 1.0]
    named = plan_from_dict({"robot": "ur10", "arms": {"a": {"logs": "x"}}}, tmp_path)
    assert named.arms[0].robot == "ur10"
    with pytest.raises(HybridError, match="no robot"):
        plan_from_dict({"arms": {"a": {"logs": "x"}}}, tmp_path)
    with pytest.raises(HybridError, match="valid are up to 10, and 3 or none"):
        plan_from_dict({**content, "payload": list(range(11))}, tmp_path)
    plan_from_dict({**content, "payload": list(range(10))}, tmp_path)
    assert _resolved("s3://a/b", tmp_path) == "s3://a/b"


def test_a_unit_is_known_by_all_of_its_inputs():
    own = Unit("a", "2026-W01", "2026-01-01", (("x.csv", "stamp"),), {"robot": "r"})
    same = Unit("a", "2026-W01", "2026-01-01", (("x.csv", "stamp"),), {"robot": "r"})
    assert own.key == same.key and len(own.key) == 32
    other = Unit("a", "2026-W01", "2026-01-01", (("x.csv", "other"),), {"robot": "r"})
    entry = Unit("a", "2026-W01", "2026-01-01", (("x.csv", "stamp"),), {"robot": "s"})
    assert len({own.key, other.key, entry.key}) == 3


def test_a_question_that_fails_is_answered_and_the_next_one_too():
    code = (
        "from hybrid.fleets.worker import serve\n"
        "serve(lambda asked: {'is': 1 // asked['by']})"
    )
    done = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    with done:
        told = [json.loads(done.stdout.readline())]
        for by in (0, 1):
            done.stdin.write(json.dumps({"by": by}) + "\n")
            done.stdin.flush()
            told.append(json.loads(done.stdout.readline() or "null"))
    ready, failed, right = told
    assert ready == {} and right == {"is": 1}
    assert failed["reason"].startswith("ZeroDivisionError: ")


@pytest.mark.parametrize(("arms", "told"), [(3, False), (4, True)])
def test_of_four_arms_one_may_be_unlike_the_others(arms, told):
    y = np.append(0.001 * np.arange(arms - 1.0), 900.0)
    _, unlike = pooled(y, np.full(arms, 0.01))
    assert unlike.tolist() == [False] * (arms - 1) + [told]


@pytest.mark.parametrize(
    ("count", "arms", "periods"), [(1, "1 arm", "1 period"), (2, "2 arms", "2 periods")]
)
def test_one_of_a_kind_is_singular(count, arms, periods):
    rows = [{"arm": f"arm_{k}"} for k in range(count)]
    each = {"alarms": (), "states": (), "arm_months": 3.0, "refused": rows}
    said = lead_sentence(SimpleNamespace(rows=rows, **each))
    assert said.startswith(f"{arms} over") and said.endswith(
        f" {periods} without a result."
    )


@pytest.mark.parametrize(("times", "told"), [(0.97, False), (1.03, True)])
def test_one_group_in_a_hundred_has_an_outlier_by_chance(times, told):
    """Of five arms each at a fifth of it, on both sides of Student's law."""
    from scipy.stats import t

    far = t.isf(0.01 / 5 / 2, 3) * np.sqrt(0.25 + 1.0)
    y = np.append(np.zeros(4), times * far)
    assert pooled(y, np.ones(5))[1].any() == told


def test_an_alarm_looks_back_over_a_year_of_weeks():
    """What was not a number at the begin spoils each score that it is in."""
    t = 7.0 * np.arange(80)
    y = 100.0 * (t >= t[20])
    y[0] = np.nan
    assert _first_alarm(t, y, np.ones(80), 4.0, None, 0) == 52


class Cluster:
    """A scheduler whose tasks end in their order, after some seconds for each job."""

    def __init__(self, seconds, threads=2):
        self.seconds, self.threads = seconds, threads
        self.sizes, self.models, self.tasks = [], [], []

    def nthreads(self):
        return {"one": self.threads - 1, "other": 1}

    def submit(self, function, first, *rest, **options):
        if function is str:
            self.models.append(first)
            return f"kept {first}"
        self.sizes.append(len(first))
        self.tasks.append((first, rest[0]))
        return len(self.tasks) - 1

    def completed(self, futures, with_results, raise_errors):
        waiting = list(futures)

        class Running:
            def update(self, more):
                waiting.extend(more)

            def __iter__(this):
                while waiting:
                    future = waiting.pop(0)
                    told, model = self.tasks[future]
                    found = [{"told": x, "model": model} for x in told]
                    yield future, (found, self.seconds * len(told))

        return Running()

    def answers(self, monkeypatch, jobs):
        monkeypatch.setattr("distributed.as_completed", self.completed)
        return list(answers(self, iter(jobs), 9.0))


@pytest.mark.parametrize(
    ("seconds", "size"), [(9.0, 1), (0.14, 2), (0.04, 7), (0.001, 32), (0.0, 32)]
)
def test_tasks_last_three_tenths_of_a_second_and_four_wait_for_each_thread(
    monkeypatch, seconds, size
):
    pytest.importorskip("distributed")
    cluster = Cluster(seconds)
    jobs = [(k, {"asked": k}, None) for k in range(8 + 3 * size)]
    found = cluster.answers(monkeypatch, jobs)
    assert cluster.sizes == [1] * 8 + [size] * 3
    assert [name for name, _ in found] == list(range(len(jobs)))
    assert all(x == {"told": {"asked": k}, "model": None} for k, x in found)


def test_jobs_of_one_task_have_one_baseline(monkeypatch):
    pytest.importorskip("distributed")
    cluster = Cluster(0.001, threads=1)
    arms = ["a"] * 6 + ["b"] * 3 + [None] * 2
    found = cluster.answers(monkeypatch, [(k, {}, x) for k, x in enumerate(arms)])
    assert cluster.models == ["a", "b"] and cluster.sizes == [1] * 4 + [2, 3, 2]
    assert [x["model"] for _, x in found] == [x and f"kept {x}" for x in arms]
