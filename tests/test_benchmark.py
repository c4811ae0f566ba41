"""The blind benchmark: plants are sealed, physical, and scored as they should be."""

import json
from dataclasses import replace

import numpy as np
import pytest
from blind.baselines import baselines, by_sysid
from blind.case import STRATA, Case, plan
from blind.draw import command_effects, draw, torque_effects
from blind.generate import generate
from blind.independent import INDEPENDENT
from blind.measures import MEASURES, Ratio, confusion, size
from blind.motions import having, motion_error
from blind.robots import complete, load_arm, off_by
from blind.run import code_digest, read_open, read_rows, run_cases
from blind.score import Named, covered, score
from blind.size import Rig
from blind.strangers import STRANGERS
from blind.sysid import SysidFit, fit_sysid
from blind.tables import by_robot, targets_table, write_benchmark
from diagnosed import RIPPLE, STRIBECK, planar
from distributed import LocalCluster
from hypothesis import given
from hypothesis import strategies as st

from hybrid.diagnosis.diagnose import examine
from hybrid.effects import JointState, effect_classes
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridError, IdentificationError
from hybrid.plant import Noise, Plant, random_fourier, simulate
from hybrid.robot import Robot
from hybrid.robot.spatial import central_inertia

PLANAR = "models/planar.xml"


@pytest.fixture(scope="module")
def arm():
    return load_arm(PLANAR)


@pytest.fixture(scope="module")
def rig(arm):
    rng = np.random.default_rng(0)
    motion = random_fourier(arm, duration=6, rate=250, seed=rng)
    return Rig.build(arm, motion, Noise.typical(arm), rng)


def truth(*effects):
    return {
        "effects": [
            {
                "effect": name,
                "means": name,
                "joints": list(joints),
                "scope": "joint",
                "values": {"level": 1.0},
                "sizes": [size],
            }
            for name, joints, size in effects
        ]
    }


def row(stratum, true, named, **more):
    content = {
        "key": f"a-{stratum}", "arm": "a", "robot": "a.xml", "stratum": stratum,
        "index": 0, "seed": 0, "verdict": "explained", "cpu_s": 1.0, "covered": [0, 0],
        "where": [], "truth": truth(*true), **score(truth(*true), named),
    }  # fmt: skip
    recipe = {"noise": 1.0, "off": 0.0, "recordings": 4, "integrator": "euler"}
    content["truth"]["recipe"] = recipe
    methods = ("ranking", "stepwise", "stlsq", "fixed")
    content["baselines"] = {m: score(truth(*true), []) for m in methods}
    return content | more


# Cases


def test_a_plan_holds_each_stratum_in_its_part_from_the_start_on():
    for count in (50, 200):
        cases = plan(["a.xml", "b.xml"], count, seed=0)
        for name, part in STRATA.items():
            assert sum(c.stratum == name for c in cases) == pytest.approx(
                part * count, abs=1.0
            )
    assert len({c.key for c in cases}) == len(cases)


def test_a_stratum_that_is_none_is_refused():
    with pytest.raises(HybridError, match="valid are single"):
        plan(["a.xml"], 3, seed=0, strata=["singles"])


def test_every_card_falls_once_before_any_falls_twice():
    deck = list("abcdefg")
    dealt = [Case("a.xml", "single", k, 3).deal(deck) for k in range(14)]
    assert sorted(dealt[:7]) == sorted(dealt[7:]) == list(range(7))
    assert dealt[:7] != dealt[7:]


def test_library_effects_are_dealt_with_or_without_a_trace_in_torque_never_both():
    assert not set(torque_effects()) & set(command_effects())
    assert not (set(STRANGERS) | set(INDEPENDENT)) & set(effect_classes())


# Robots


@pytest.mark.study
@given(st.floats(0.0, 0.05), st.integers(0, 99))
def test_a_file_that_is_a_little_off_stays_physical(share, seed):
    robot = Robot.load("models/coman_like.xml")
    real = off_by(robot, share, np.random.default_rng(seed))
    for link, other in zip(robot.chain.inertial, real.chain.inertial, strict=True):
        (mass, _, _), (now, _, about) = central_inertia(link), central_inertia(other)
        assert abs(now / mass - 1) <= share + 1e-12
        a, b, c = np.linalg.eigvalsh(about)
        assert a > 0 and a + b >= c * (1 - 1e-9)  # a body of positive density


def test_an_arm_without_rotors_and_friction_gets_usual_ones(arm):
    bare = load_arm("models/planar.urdf")
    full = complete(bare)
    assert (full.chain.armature > 0).all()
    assert (full.damping + full.frictionloss > 0).all()
    assert complete(full).damping == pytest.approx(full.damping)


def test_an_unknown_arm_is_refused_with_those_that_are_known():
    with pytest.raises(HybridError, match="valid are files and .*scara, .*ur10, "):
        load_arm("no_such_arm")


# Effects


def state(**parts):
    shape = np.shape(parts["q"])
    zero = {k: np.zeros(shape) for k in ("t", "q", "v", "a", "load", "sign")}
    fields = JointState.__dataclass_fields__
    content = {k: np.array(x) for k, x in {**zero, **parts}.items() if k in fields}
    rest = {k: None for k in fields if k not in content}
    return JointState(**content, **rest)


def test_a_cable_gives_back_all_the_energy_it_takes():
    cable = STRANGERS["cable_pull"]((0, 1), {"level": 2.0, "turns": 1.7})
    turn = np.linspace(0, 2 * np.pi, 2001)
    q = np.stack([0.3 + np.sin(turn), np.cos(turn)], axis=1)
    torque = cable.resist(state(q=q), np.zeros_like(q), 0.001)
    work = np.trapezoid(torque, q, axis=0).sum()
    assert abs(work) < 1e-4 * np.abs(torque).max()


def test_load_hysteresis_loses_energy_on_every_cycle_and_is_bounded():
    gear = STRANGERS["load_hysteresis"]((0,), {"level": 1.0, "reach": 0.5})
    t = np.arange(0, 4, 0.001)
    load, torque = 2 * np.sin(2 * np.pi * t), np.empty_like(t)
    for k, (now, x) in enumerate(zip(t, load, strict=True)):
        at = np.array([[x]])
        seen = state(q=at, t=np.full((1, 1), now), load=at)
        torque[k] = gear.resist(seen, at, 0.001).item()
    assert np.abs(torque).max() <= 1.0
    assert np.trapezoid(torque[1000:2000], load[1000:2000]) > 0.1


def test_soft_saturation_is_linear_below_its_limit_and_flat_far_above():
    values = {"loss": 1.0, "limit": 2.0}
    iron = INDEPENDENT["soft_saturation"]((0,), values)
    tau = np.array([-200.0, -0.2, 0.0, 0.2, 200.0])
    assert iron.deliver(tau) == pytest.approx([-2.0, -0.2, 0.0, 0.2, 2.0], rel=1e-3)


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("dahl_friction", lambda v, load: 2.0),
        ("lorentz_friction", lambda v, load: 2.0 / (1.0 + (v / 0.05) ** 2)),
        ("tooth_friction", lambda v, load: 2.0 * load),
    ],
)
def test_bristles_hold_slide_and_take_energy(name, full):
    law, step, load = INDEPENDENT[name]((0,), {"level": 2.0}), 0.001, 3.0

    def torque(speed):
        out, q = [], 0.0
        for k, v in enumerate(speed):
            q += v * step
            now = state(q=[[q]], v=[[v]], load=[[load]], t=[[k * step]], a=[[0.0]])
            out.append(law.resist(now, np.zeros((1, 1)), step).item())
        return np.array(out)

    slid = torque(np.full(400, -0.02))
    assert slid[-1] == pytest.approx(-full(0.02, load), rel=1e-3)
    held = torque(np.r_[np.full(400, 0.02), np.zeros(400)])
    assert held[-1] == pytest.approx(held[399], rel=0.1)
    swing = 0.1 * np.sin(2 * np.pi * np.arange(2000) * step)
    assert torque(swing) @ swing * step > 0.0


def test_a_wobbly_disc_shows_the_speed_of_the_position_it_shows():
    disc = INDEPENDENT["wobbly_disc"]((0,), {"level": 0.03, "phase": 0.7})
    q, h = np.linspace(-3.0, 3.0, 50), 1e-6
    shown, speed = disc.sense(q, np.full_like(q, 2.0))
    later, _ = disc.sense(q + 2.0 * h, np.full_like(q, 2.0))
    assert speed == pytest.approx((later - shown) / h, rel=1e-6)
    plain = effect_classes()["encoder_eccentricity"]
    first = {"sine": 0.03 * np.cos(0.7), "cosine": -0.03 * np.sin(0.7)}
    assert shown == pytest.approx(plain((0,), first).sense(q, q)[0], abs=0.03**2)


def test_a_boxcar_delays_a_ramp_by_its_half():
    t = np.arange(0.0, 1.0, 0.002)
    log = INDEPENDENT["boxcar_log"]((1,), {"level": 0.01})
    tau = np.stack([np.ones_like(t), 5.0 + 3.0 * t], axis=1)
    told = log.measure(t, {"tau": tau})["tau"]
    assert told[20:, 1] == pytest.approx(5.0 + 3.0 * (t[20:] - 0.01), abs=1e-9)
    assert told[0, 1] == pytest.approx(5.0) and np.all(told[:, 0] == 1.0)


def test_drives_lose_what_their_laws_say():
    tau = np.array([-50.0, -0.01, 0.0, 0.01, 50.0])
    drop = INDEPENDENT["brush_drop"]((0,), {"level": 2.0}).deliver(tau)
    assert drop == pytest.approx([-48.0, 0.01, 0.0, -0.01, 48.0], rel=1e-2)
    weak = INDEPENDENT["magnet_loss"]((0,), {"level": 0.2, "limit": 10.0})
    assert weak.deliver(tau) == pytest.approx(0.8 * tau / np.hypot(1.0, tau / 50.0))


def test_a_hose_pulls_back_and_harder_when_far():
    hose = INDEPENDENT["stiffening_hose"]((0,), {"level": 3.0, "rest": 0.5})
    pulls = [
        hose.resist(state(q=[[q]], v=[[0.0]], load=[[0.0]], t=[[0.0]]), 0, 0).item()
        for q in (0.4, 0.5, 0.6, 4.5)
    ]
    assert pulls[:3] == pytest.approx([-0.3, 0.0, 0.3], rel=1e-3)
    assert pulls[3] == pytest.approx(12.0 * np.sinh(1.0))


@pytest.mark.study
@pytest.mark.parametrize("name", ["coulomb", "torque_ripple", "cogging_motor"])
def test_a_drawn_effect_has_the_size_asked_for_within_its_bounds(rig, name):
    effect = draw(name, rig, 2.0, np.random.default_rng(1))
    assert effect is not None
    assert rig.sizes(effect).max() == pytest.approx(2.0, rel=0.1)


@pytest.mark.study
def test_an_effect_that_would_have_to_be_absurd_is_not_made(rig):
    gain = effect_classes()["torque_gain"]((0,), {"gain": 0.1})
    assert rig.plausible(gain)
    assert rig.scaled(gain, 1e4) is None


@pytest.mark.study
@pytest.mark.parametrize("name", ["contact", "saturation", "deadzone"])
def test_a_number_of_something_is_not_drawn(name, rig):
    for seed in range(4):
        effect = draw(name, rig, None, np.random.default_rng(seed))
        chosen = {x.name: x.typical for x in effect.shapes if x.whole}
        assert chosen
        assert {k: effect.values[k] for k in chosen} == chosen


def test_an_effect_of_the_command_is_drawn_though_it_leaves_no_trace(rig):
    name = command_effects()[0]
    effect = draw(name, rig, None, np.random.default_rng(0))
    assert effect is not None and effect.id == name


def test_an_effect_is_no_background_and_no_absurdity(rig):
    classes, friction = effect_classes(), rig.robot.frictionloss[0]
    uneven = classes["asymmetric_friction"]((0,), {"level": 0.9 * friction})
    assert rig.plausible(uneven)
    assert not rig.plausible(uneven.at({"level": -1.1 * friction}))
    background = classes["coulomb"]((0,), {"level": 0.05 * friction})
    assert not rig.plausible(background)
    mass = rig.robot.chain.inertial[1, 0]
    lump = classes["link_inertia"]((0, 1), {"mass": 0.4 * mass})
    assert rig.plausible(lump)
    assert not rig.plausible(lump.at({"mass": 0.6 * mass}))


@pytest.mark.study
def test_cogging_of_mujocos_motor_is_the_ripple_of_the_library(arm):
    """Two implementations of one law move an arm alike."""
    motor = INDEPENDENT["cogging_motor"](
        (1,), {"level": 0.2, "poles": 8.0, "phase": 0.6}
    )
    ours = effect_classes()["torque_ripple"](
        (1,), {"sine": -0.2 * np.cos(0.6), "cosine": -0.2 * np.sin(0.6), "periods": 8.0}
    )
    motion = random_fourier(arm, duration=3, rate=250, seed=np.random.default_rng(2))
    quiet = {"nominal": arm, "noise": Noise.none(arm.size)}

    def torque(*effects):
        plant = Plant(arm, effects, **quiet)
        return plant.run([motion], seed=np.random.default_rng(0))[0].tau

    gap = torque(ours) - torque()
    assert np.sqrt((gap[:, 1] ** 2).mean()) == pytest.approx(0.14, rel=0.2)
    assert np.abs(torque(motor) - torque(ours)).max() < 0.05 * np.abs(gap).max()


# The seal


@pytest.mark.study
def test_the_open_folder_tells_nothing_and_a_case_is_always_the_same(tmp_path):
    case = Case(PLANAR, "single", 4, 7)
    for name in "ab":
        generate(case, tmp_path / name / "open", tmp_path / name / "sealed")
    sealed = json.loads((tmp_path / "a" / "sealed" / "truth.json").read_text())
    (effect,) = sealed["effects"]
    visible = sorted((tmp_path / "a" / "open").iterdir())
    assert not any(effect["effect"].encode() in x.read_bytes() for x in visible)
    first, second = (read_open(tmp_path / name / "open") for name in "ab")
    assert first[2] == ()
    assert first[0].chain.inertial == pytest.approx(load_arm(PLANAR).chain.inertial)
    for x, y in zip(first[1], second[1], strict=True):
        assert np.array_equal(x.tau, y.tau)
    unseen = list((tmp_path / "a" / "sealed").glob("*.npz"))
    assert len(unseen) == 2


@pytest.mark.study
def test_an_effect_left_out_of_the_library_is_what_the_question_says(tmp_path):
    case = Case(PLANAR, "withheld", 1, 0)
    generate(case, tmp_path / "open", tmp_path / "sealed")
    sealed = json.loads((tmp_path / "sealed" / "truth.json").read_text())
    _, _, without = read_open(tmp_path / "open")
    assert without == tuple(e["effect"] for e in sealed["effects"])


@pytest.mark.study
def test_a_plant_without_effects_is_no_alarm_and_is_not_answered_twice(tmp_path):
    log, case = tmp_path / "cases.jsonl", Case(PLANAR, "none", 1, 0)
    (first,) = run_cases([case], log)
    assert first["named"] == [] and first["declared"]
    assert set(first["baselines"]) >= {"ranking", "stepwise", "stlsq", "fixed"}
    told = []
    assert run_cases([case], log, tell=told.append) == [read_rows(log)[case.key]]
    assert told == []


def stand_in(answer):
    """A child that is no process of its own."""

    class Child:
        def __init__(self, module):
            assert module == "blind.run"

        def ask(self, question, limit):
            return answer(json.loads(question))

        def end(self):
            pass

    return Child


def test_an_answer_of_other_code_is_none(tmp_path, monkeypatch):
    log, case = tmp_path / "cases.jsonl", Case(PLANAR, "none", 1, 0)
    log.write_text(json.dumps({"key": case.key, "code": "another"}) + "\n")
    answered = stand_in(lambda question: {"key": case.key})
    monkeypatch.setattr("hybrid.fleets.worker.Child", answered)
    told = []
    (row,) = run_cases([case], log, tell=told.append)
    assert told == [row] and row["code"] == code_digest()


def test_cases_go_to_workers_and_one_without_an_answer_counts_as_crashed(
    tmp_path, monkeypatch
):
    cases = [Case(PLANAR, "none", k, 0) for k in range(5)]

    def answer(question):
        case = Case(**question["case"])
        if case.index == 3:
            raise TimeoutError
        return {"key": case.key}

    monkeypatch.setattr("hybrid.fleets.worker.Child", stand_in(answer))
    with LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        processes=False,
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        address = cluster.scheduler_address
        rows = run_cases(cases, tmp_path / "x.jsonl", scheduler=address)
    assert [x["key"] for x in rows] == [x.key for x in cases]
    (crashed,) = (x for x in rows if "crashed" in x)
    assert crashed["index"] == 3 and crashed["crashed"].startswith("late: no result")


def test_half_a_line_of_an_interrupted_run_is_run_again(tmp_path):
    log = tmp_path / "cases.jsonl"
    log.write_text('{"key": "a"}\n{"key": "b", "verd')
    assert set(read_rows(log)) == {"a"}


# Scores


def test_a_cause_is_right_at_its_joint_only():
    true = truth(("coulomb", ["elbow"], 1.0))
    right = score(true, [Named("coulomb", ("elbow",), ("coulomb",))])
    assert right["strict"] and right["localised"] and not right["false"]
    wrong = score(true, [Named("coulomb", ("wrist",), ("coulomb",))])
    assert not wrong["in_class"] and wrong["false"] == [["coulomb", "wrist"]]
    wide = score(true, [Named("coulomb", ("elbow", "wrist"), ("coulomb",))])
    assert wide["strict"] and wide["false"] == [["coulomb", "wrist"]]
    assert not wide["localised"]


def test_a_class_that_holds_the_truth_counts_but_not_strictly():
    true = truth(("delay", ["elbow"], 1.0))
    got = score(true, [Named("actuator_lag", ("elbow",), ("actuator_lag", "delay"))])
    assert got["in_class"] and not got["strict"] and got["class_size"] == 2


def test_an_equivalent_counts_only_where_the_effect_is_withheld():
    true = truth(("delay", ["elbow"], 1.0))
    got = score(true, [Named("actuator_lag", ("elbow",), ("actuator_lag",))])
    assert not got["in_class"] and got["declared"]
    other = score(true, [Named("spring", ("elbow",), ("spring",))])
    assert not other["declared"]
    assert score(true, [])["declared"]


def test_an_interval_covers_only_gains_named_at_their_joint():
    true = truth(("coulomb", ["elbow"], 1.0))

    def finding(joint, low, high):
        p = {"joint": joint, "name": "level", "interval": [low, high]}
        return {"effect": "coulomb", "parameters": [p]}

    assert covered(true, [finding("elbow", 0.9, 1.1)]) == (1, 1)
    assert covered(true, [finding("elbow", 1.1, 1.3)]) == (0, 1)
    assert covered(true, [finding("wrist", 0.9, 1.1)]) == (0, 0)


# Baselines and oracle


@pytest.mark.study
def test_a_fit_of_fixed_structure_names_the_numbers_that_changed():
    robot = load_arm(PLANAR)
    plant = Plant(robot, [Viscous((0,), {"coefficient": 2.0})], nominal=robot)
    logs = simulate(plant, trajectories=4, duration=6.0, seed=0)
    first = baselines(examine(robot, logs), logs[0])["fixed"][0]
    assert (first.effect, first.joints[0]) == ("viscous", robot.joints[0])


def test_a_peers_fit_names_numbers_whose_interval_excludes_the_file():
    names = (
        ("viscous", "base"),
        ("coulomb", "base"),
        ("coulomb", "tip"),
        ("payload", "tip"),
    )
    declared, half = np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 0.1)
    fit = SysidFit(names, declared + [0.2, 0.05, -0.5, 0.3], declared, half)
    found = [(x.effect, x.joints) for x in fit.named()]
    both = ("base", "tip")
    assert found == [("coulomb", ("tip",)), ("payload", both), ("viscous", ("base",))]


def test_a_peer_without_commands_says_so():
    robot = load_arm(PLANAR)
    log = simulate(Plant(robot, []), trajectories=1, duration=3.0, seed=0)[0]
    with pytest.raises(IdentificationError, match="commands, and servo gains"):
        fit_sysid(robot, replace(log, command=None))


def test_a_peer_that_fails_names_nothing():
    robot = load_arm(PLANAR)
    log = simulate(Plant(robot, []), trajectories=1, duration=3.0, seed=0)[0]
    assert by_sysid(robot, replace(log, command=None)) == ()


def test_the_motion_error_falls_as_far_as_with_the_truth():
    error = motion_error(planar(), [RIPPLE, STRIBECK])
    assert error.oracle < 0.5 * error.before
    assert error.share == pytest.approx(1.0, abs=0.1)
    nothing = replace(planar(), search=having(planar().search, []))
    assert motion_error(nothing, [RIPPLE, STRIBECK]).share == 0.0


@pytest.mark.study
def test_what_is_too_short_has_no_motion_error():
    robot = load_arm(PLANAR)
    plant = Plant(robot, [Viscous((0,), {"coefficient": 2.0})], nominal=robot)
    result = examine(robot, simulate(plant, trajectories=1, duration=4.0, seed=0))
    assert motion_error(result, [Viscous((0,), {"coefficient": 2.0})]) is None


# Measures


@given(st.integers(1, 400), st.data())
def test_wilsons_interval_holds_its_share_and_shrinks(total, data):
    hits = data.draw(st.integers(0, total))
    low, high = Ratio(hits, total).interval
    assert 0 <= low <= hits / total <= high <= 1
    more = Ratio(4 * hits, 4 * total).interval
    assert more[1] - more[0] < high - low


def test_wilsons_interval_solves_its_equation():
    """Its ends are the shares from which the one seen is 1.96 deviations away."""
    for end in Ratio(29, 30).interval:
        assert abs(29 / 30 - end) == pytest.approx(1.96 * np.sqrt(end * (1 - end) / 30))


def test_measures_count_what_they_say():
    named = Named("coulomb", ("j",), ("coulomb",))
    right = row("single", [("coulomb", ["j"], 3.0)], [named])
    small = row("single", [("coulomb", ["j"], 0.3)], [])
    silent = row("single", [("viscous", ["j"], 1.0)], [])
    alarm = row("none", [], [named])
    rows = [right, small, silent, alarm]
    measured = {m.name: m.of(rows) for m in MEASURES}
    assert measured["right cause first, in its class, ≥ 1×"] == Ratio(1, 2)
    assert measured["right cause first, 0.3×"] == Ratio(0, 1)
    assert measured["abstains, ≥ 1×"] == Ratio(1, 2)
    assert measured["false alarm, no effect at all"] == Ratio(1, 1)
    assert confusion(rows) == {
        ("coulomb", "coulomb"): 1, ("viscous", "nothing"): 1, ("nothing", "coulomb"): 1
    }  # fmt: skip
    assert size(small) == 0.3 and size(alarm) == 0.0


def test_a_small_effect_counts_as_shown_where_the_truth_has_evidence():
    rows = [
        row("single", [("coulomb", ["j"], 0.3)], named, shrinkage={"ahead": ahead})
        for ahead, named in (
            (6.0, []), (8.0, []), (0.0, [Named("coulomb", ("j",), ("coulomb",))]),
            (-5.0, [Named("viscous", ("j",), ("viscous",))]),
        )
    ]  # fmt: skip
    measured = {m.name: m.of(rows) for m in MEASURES}
    assert measured["right cause first, 0.3×"] == Ratio(1, 4)
    shown = "the same, where the truth shows in the recordings"
    assert measured[shown] == Ratio(1, 3)


def test_robots_never_tuned_on_are_apart_and_together():
    rows = [row("none", [], [], arm=arm) for arm in ("a", "b", "c")]
    groups = by_robot(rows, ["a"])
    assert list(groups) == ["a", "robots never tuned on", "b", "c"]
    assert len(groups["robots never tuned on"]) == 2
    assert len(targets_table(groups).header) == 6


def test_a_report_holds_tables_cases_and_the_confusion(tmp_path):
    rows = [
        row("single", [("coulomb", ["j"], 1.0)], []),
        {"key": "x", "arm": "a", "robot": "a", "stratum": "none", "index": 1, "seed": 0,
         "crashed": "ValueError: no"},
        {"key": "y", "arm": "a", "stratum": "none", "skipped": "too large"},
    ]  # fmt: skip
    how = {"command": "blind_diagnosis"}
    content = write_benchmark(rows, tmp_path, tuned=["a"], how=how)
    assert content["measures"]["a"]["abstains, ≥ 1×"] == [1, 1]
    assert "2 (1)" in (tmp_path / "tables.md").read_text()  # cases (crashes)
    cases = json.loads((tmp_path / "results.json").read_text())["cases"]
    assert [c["stratum"] for c in cases] == ["single", "none"]
    assert (tmp_path / "confusion.png").stat().st_size > 1000
