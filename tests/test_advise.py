"""What to run next, and whether that tells explanations apart."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import diagnosed
import numpy as np
import pytest
from coarse import Plant
from simulated import arm

from hybrid.diagnosis.advice import advise as advise_module
from hybrid.diagnosis.advice.advise import Plan, advise
from hybrid.diagnosis.advice.menu import Experiment, Menu, concatenated, gap_along
from hybrid.diagnosis.advice.separation import (
    Discrimination,
    Outlook,
    decimated,
    fit_rival,
    joined,
    required_evidence,
)
from hybrid.diagnosis.answer.diagnosis import Advice
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.evidence.candidates import candidates
from hybrid.diagnosis.evidence.refine import gain
from hybrid.diagnosis.explanations.search import Search
from hybrid.effects import effect_classes
from hybrid.plant import random_fourier
from hybrid.plant.reference import Reference
from hybrid.plant.scale import joint_scales

RATE = 250.0


def effect_of(name, joint, size):
    cls = effect_classes()[name]
    usual = cls.typical((joint,), joint_scales(arm("planar")))
    return usual.at({g.name: size * usual.values[g.name] for g in cls.gains})


@cache
def plant_with(name, joint, size):
    robot = arm("planar")
    return Plant(robot, [effect_of(name, joint, size)], nominal=robot, log_rate=RATE)


@cache
def poorly_recorded(name, joint, size):
    """One short and slow motion of a planar arm with an effect, and its diagnosis."""
    rng = np.random.default_rng([0, joint, sum(map(ord, name))])
    short = random_fourier(arm("planar"), duration=8.0, rate=RATE, seed=rng, fill=0.3)
    logs = plant_with(name, joint, size).run([short], seed=rng)
    return examine(arm("planar"), logs), logs


def class_at(result, joint):
    """Ids that cannot be told apart at a joint."""
    name = result.gap.robot.joints[joint]
    found = [f.alternatives for f in result.diagnosis.findings if name in f.joints]
    return {x for ids in found for x in ids}


def read_reference(path, most=np.inf):
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table = table[table[:, 0] < most]
    return Reference(table[:, 0], *np.split(table[:, 1:], 3, axis=1))


@pytest.mark.study
def test_the_advised_experiment_splits_the_class(tmp_path):
    before, logs = poorly_recorded("load_friction", 0, 0.3)
    rivals_before = class_at(before, 0) - {"load_friction"}
    assert "coulomb" in rivals_before
    rng = np.random.default_rng(1)
    advised = advise(before, rng, directory=tmp_path)
    promised = {x for advice in advised for x in advice.splits} - {"load_friction"}
    assert rivals_before <= promised
    assert all("load_friction" in advice.splits for advice in advised)
    ask = read_reference(tmp_path / advised[0].file, most=15.0)  # half is enough
    new = plant_with("load_friction", 0, 0.3).run([ask], seed=rng)
    after = class_at(examine(arm("planar"), [*logs, *new]), 0)
    assert "load_friction" in after
    assert not after & promised


@pytest.mark.study
def test_friction_that_may_fall_when_warm_gets_an_experiment_that_shows_it():
    result, _ = poorly_recorded("viscous", 0, 0.5)
    assert "thermal_friction" in class_at(result, 0)
    advised = advise(result, np.random.default_rng(0))
    (advice,) = [x for x in advised if "thermal_friction" in x.splits]
    assert advice.separation > -np.log(1.0 - result.search.prior.in_class)


def pair():
    """Two explanations of the same recordings, and the search that they are from."""
    result, _ = poorly_recorded("load_friction", 0, 0.3)
    (term,) = [t for t in result.search.terms if t.place[1] == (0,)]
    own = fit_rival(result.search, term, term.candidate)
    (other, *_) = next(x for t, x in result.rivals.items() if t.index is term.index)
    return result, own, fit_rival(result.search, term, other)


def fast(result, seed=0):
    rng = np.random.default_rng(seed)
    path = random_fourier(arm("planar"), duration=5.0, rate=RATE, seed=rng, fill=0.8)
    return path, gap_along(result.gap, Experiment("a fast motion", path))


def outlook(result, ahead):
    """What the recordings of a result and a motion would say together."""
    return Discrimination(result.search, ahead, result.gap)


def test_separation_knows_no_order_and_none_from_itself():
    result, first, second = pair()
    view = outlook(result, fast(result)[1])
    there = view.separation(first, second)
    assert there == pytest.approx(view.separation(second, first))
    assert view.separation(first, first) == pytest.approx(0.0, abs=1e-6)
    assert max(view.contrast(first, first)) <= 1e-6
    told = view.contrast(first, second)
    assert view.contrast(second, first) == pytest.approx(told[::-1])


def test_separation_is_in_units_of_noise_and_grows_with_time(monkeypatch):
    result, first, second = pair()
    path, ahead = fast(result)
    once = outlook(result, ahead).separation(first, second)
    twice = gap_along(result.gap, Experiment("twice", concatenated([path, path])))
    assert once < outlook(result, twice).separation(first, second) < 1.5 * once
    evidence = result.search.evidence
    monkeypatch.setattr(evidence, "noise", 4.0 * evidence.noise)
    assert outlook(result, ahead).separation(first, second) < once


@pytest.fixture
def white():
    """The search's noise white, as strong as it is slow: as an outlook takes it."""
    search = poorly_recorded("load_friction", 0, 0.3)[0].search
    search.evidence.set_covariances(search.evidence.noise[:, None])
    yield
    search.evidence.set_covariances(search.noise.covariances)


def test_what_is_told_is_what_a_search_on_all_data_would_find(white):
    """The recordings with one explanation's torque appended, fitted from scratch."""
    result, first, second = pair()
    search, ahead = result.search, fast(result)[1]
    told = outlook(result, ahead).contrast(first, second)
    new = Outlook(ahead, search.evidence.noise).torque(first)
    both = joined(result.gap, replace(ahead, left=new))
    use = np.append(search.learn, np.ones(len(new), dtype=bool))
    fresh = Search(both, use)
    fresh.evidence.set_covariances(search.evidence.noise[:, None])
    fresh.evidence.precision[fresh.rigid] = search.evidence.precision[search.rigid]
    best = gain(fresh.evidence, fresh.base(), first.candidate)
    _, other = fresh.refine(fresh.base(), second.candidate)
    expected = (best - other) / required_evidence(best)
    assert told[0] == pytest.approx(expected, rel=0.02, abs=0.02)


@pytest.mark.study
def test_decimated_motions_give_the_columns_of_all_samples():
    result = diagnosed.planar()
    gap = replace(result.gap, cutoff=RATE / 25)
    few, effect = decimated(gap), effect_of("viscous", 1, 1.0)
    assert len(few.motions[0].t) < len(gap.motions[0].t) / 3
    there, here = gap.columns(effect)[1], few.columns(effect)[1]
    inside = gap.sampled.mask
    np.testing.assert_allclose(
        here[inside], there[inside], atol=0.01 * np.abs(there).max()
    )


def test_every_candidate_has_columns_along_decimated_motions():
    gap = diagnosed.planar().gap
    few = decimated(gap)
    for c in {c.place: c for c in candidates(gap)}.values():
        for j, x in few.columns(c.effect).items():
            assert x.shape == (len(gap.left), len(c.std)), (c.place, j)


@pytest.mark.study
def test_laws_that_are_one_while_moving_are_never_apart():
    result, _ = poorly_recorded("torque_offset", 1, 0.3)
    assert {"torque_offset", "asymmetric_friction"} <= class_at(result, 1)
    advised = advise(result, np.random.default_rng(0))
    (advice,) = [x for x in advised if "torque_offset" in x.splits]
    assert set(advice.splits) == {"torque_offset", "asymmetric_friction"}
    assert advice.file == ""
    assert "brake" in advice.experiment


def test_nothing_is_written_without_a_folder():
    result, _ = poorly_recorded("load_friction", 0, 0.3)
    advised = advise(result, np.random.default_rng(0))
    assert advised
    assert all(x.file == "" for x in advised)


def test_a_simulator_without_fault_needs_no_experiment():
    result = diagnosed.planar()
    sound = replace(result.diagnosis, verdict="no_gap", findings=(), not_excited=())
    bare = replace(result, diagnosis=sound, rivals={})
    assert advise(bare, np.random.default_rng(0)) == ()


def unexplained(depends):
    """The advice for a planar arm whose elbow has something that no effect explains."""
    result = diagnosed.planar()
    after, ceiling = np.array([[100.0, 500.0], [100.0, 100.0]])
    account = replace(
        result.account, after=after, ceiling=ceiling, depends=("", depends)
    )
    diagnosis = replace(result.diagnosis, verdict="unexplained", findings=())
    strange = replace(result, diagnosis=diagnosis, account=account)
    (advice,) = advise(strange, np.random.default_rng(0))
    return advice


def test_what_is_unexplained_gets_an_experiment_about_its_joint():
    advice = unexplained("speed")
    assert advice.splits == ()
    assert arm("planar").joints[1] in advice.experiment
    assert advice.separation == pytest.approx(20.0)


def test_a_joint_that_did_not_move_shall_climb_a_ladder_of_speeds(tmp_path):
    result, name = diagnosed.planar(), arm("planar").joints[0]
    diagnosis = replace(
        result.diagnosis,
        verdict="explained",
        findings=(),
        not_excited=(f"{name} does not move",),
    )
    still = replace(result, diagnosis=diagnosis)
    (advice,) = advise(still, np.random.default_rng(0), directory=tmp_path)
    speed = np.abs(read_reference(tmp_path / advice.file).v[:, 0])
    assert name in advice.experiment
    assert speed.max() > 0.5 * arm("planar").v_max[0]


@cache
def menu():
    return Menu(arm("planar"), np.random.default_rng(0), rate=100.0)


class Foreseen:
    """What experiments tell, as stated: separation and contrast by their names."""

    def __init__(self, **told):
        self.told = told
        self.menu = menu()

    def about(self, joint):
        return self.menu.about(joint)

    def tell(self, experiment):
        told = [x for k, x in self.told.items() if k in experiment.name] or [(0, 0)]
        return SimpleNamespace(
            separation=lambda *_: 100.0 if any(told[0]) else 0.0,
            contrast=lambda *_: told[0],
        )


def rivals_named(*ids):
    named = [SimpleNamespace(id=x) for x in ids]
    return tuple(SimpleNamespace(effect=x, evidence=100.0) for x in named)


def choose(foreseen, *given):
    return advise_module.choose(foreseen, foreseen.tell, *given)


KINDS = ("times", "ladder", "reversals", "poses", "multisine", "fast", "mass", "warm")


@pytest.mark.parametrize("kind", KINDS)
def test_the_one_experiment_that_tells_is_advised(kind):
    pair = rivals_named("viscous", "thermal_friction")
    plan = choose(Foreseen(**{kind: (3.0, 3.0)}), (0,), pair, [])
    assert kind in plan.advice.experiment
    assert plan.advice.splits == ("viscous", "thermal_friction")


def test_no_one_has_to_fetch_a_weight_if_a_motion_does():
    pair = rivals_named("torque_gain", "payload")
    both = Foreseen(mass=(30.0, 30.0), multisine=(2.0, 2.0))
    assert "multisine" in choose(both, (0,), pair, []).advice.experiment


def test_an_experiment_that_is_run_anyway_is_taken_again():
    pair, chosen = rivals_named("coulomb", "stribeck"), []
    first = choose(Foreseen(ladder=(2.0, 2.0)), (0,), pair, chosen)
    both = Foreseen(ladder=(2.0, 2.0), multisine=(9.0, 9.0))
    both.menu = SimpleNamespace(about=lambda _: chosen)
    again = choose(both, (0,), rivals_named("coulomb", "deadzone"), chosen)
    assert again.experiment is first.experiment
    assert len(chosen) == 1


def test_what_can_only_be_shown_if_it_is_there_is_said_so():
    pair = rivals_named("viscous", "thermal_friction")
    plan = choose(Foreseen(warm=(0.1, 9.0)), (0,), pair, [])
    assert "it shows thermal friction" in plan.advice.experiment
    assert choose(Foreseen(warm=(0.9, 0.9)), (0,), pair, []) is None


def test_late_commands_are_told_from_wrong_gains_by_other_gains():
    result = diagnosed.planar()
    ids = ("controller_gain", "command_latency")
    finding = replace(result.diagnosis.findings[0], effect=ids[0], alternatives=ids)
    diagnosis = replace(result.diagnosis, verdict="explained", findings=(finding,))
    unsure = replace(result, diagnosis=replace(diagnosis, not_excited=()))
    (advice,) = advise(unsure, np.random.default_rng(0))
    assert advice.splits == ids
    assert "gains of the servo at half" in advice.experiment


def test_what_tells_the_same_effects_at_two_joints_is_said_once(monkeypatch):
    result = diagnosed.planar()
    (warm,) = [x for x in menu().of_all_joints if x.start]
    splits = ("viscous", "thermal_friction")
    plans = [Plan(Advice("run it", splits, x), warm) for x in (3.0, 9.0)]
    monkeypatch.setattr(advise_module, "_between", lambda *_: iter(plans))
    sound = replace(result.diagnosis, verdict="explained", not_excited=(), findings=())
    advised = advise(replace(result, diagnosis=sound), np.random.default_rng(0))
    assert [x.separation for x in advised] == [9.0]
