"""What to run next, and whether that tells explanations apart."""

from dataclasses import replace
from functools import cache

import diagnosed
import numpy as np
import pytest
from simulated import arm

from hybrid.diagnose.advise import advise, rivals
from hybrid.diagnose.diagnose import examine
from hybrid.diagnose.menu import Experiment, gap_along, joined, menu
from hybrid.diagnose.separation import contrast, fit_rival, separation
from hybrid.effects import effect_classes
from hybrid.plant import Plant, random_fourier
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
    short = random_fourier(arm("planar"), duration=8.0, rate=RATE, rng=rng, fill=0.3)
    logs = plant_with(name, joint, size).run([short], rng=rng)
    return examine(arm("planar"), logs), logs


def class_at(result, joint):
    """Ids that cannot be told apart at a joint."""
    name = result.gap.robot.joints[joint]
    found = [f.alternatives for f in result.diagnosis.findings if name in f.joints]
    return {x for ids in found for x in ids}


def read_reference(path):
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return Reference(table[:, 0], *np.split(table[:, 1:], 3, axis=1))


def test_the_advised_experiment_splits_the_class(tmp_path):
    before, logs = poorly_recorded("load_friction", 0, 0.3)
    rivals_before = class_at(before, 0) - {"load_friction"}
    assert {"coulomb", "presliding"} <= rivals_before
    rng = np.random.default_rng(1)
    advised = advise(before, rng, directory=tmp_path)
    promised = {x for advice in advised for x in advice.splits} - {"load_friction"}
    assert {"coulomb", "presliding"} <= promised
    assert all("load_friction" in advice.splits for advice in advised)
    ask = read_reference(tmp_path / advised[0].file)
    new = plant_with("load_friction", 0, 0.3).run([ask], rng=rng)
    after = class_at(examine(arm("planar"), [*logs, *new]), 0)
    assert "load_friction" in after
    assert not after & promised


def test_a_law_that_another_one_has_as_a_limit_is_not_promised_to_be_split():
    result, _ = poorly_recorded("viscous", 0, 0.5)
    assert "thermal_friction" in class_at(result, 0)  # warming up for ever
    advised = advise(result, np.random.default_rng(0))
    assert not any("thermal_friction" in x.splits for x in advised)


def pair():
    """Two explanations of the same recordings, and the search that they are from."""
    result, _ = poorly_recorded("delay", 0, 4.0)
    (term,) = [t for t in result.search.terms if t.place[1] == (0,)]
    own = fit_rival(result.search, term, term.candidate)
    ids = result.diagnosis.findings[0].alternatives[1:]
    (other, *_) = rivals(result.search, term, ids)
    return result, own, fit_rival(result.search, term, other)


def fast(result, seed=0):
    rng = np.random.default_rng(seed)
    path = random_fourier(arm("planar"), duration=5.0, rate=RATE, rng=rng, fill=0.8)
    return path, gap_along(result.gap, Experiment("a fast motion", path))


def test_separation_knows_no_order_and_none_from_itself():
    result, first, second = pair()
    noise, (_, ahead) = result.search.evidence.noise, fast(result)
    there = separation(ahead, noise, first, second)
    assert there == pytest.approx(separation(ahead, noise, second, first))
    assert separation(ahead, noise, first, first) == pytest.approx(0.0, abs=1e-6)
    assert contrast(result.search, ahead, first, first) == pytest.approx(0.0, abs=1e-6)


def test_separation_is_in_units_of_noise_and_grows_with_time():
    result, first, second = pair()
    noise, (path, ahead) = result.search.evidence.noise, fast(result)
    once = separation(ahead, noise, first, second)
    assert separation(ahead, 4 * noise, first, second) < once
    twice = gap_along(result.gap, Experiment("twice", joined([path, path])))
    assert once < separation(twice, noise, first, second) < 1.5 * once


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
    result = diagnosed.faultless()
    sound = replace(result.diagnosis, verdict="no_gap", findings=(), not_excited=())
    search = result.search
    bare = replace(result, diagnosis=sound, search=search)
    assert advise(bare, np.random.default_rng(0)) == ()


def test_what_is_unexplained_gets_an_experiment_about_its_joint():
    result = diagnosed.planar()
    account = replace(
        result.account,
        missed=np.array([0.0, 400.0]),
        depends=("", "direction and position"),
    )
    diagnosis = replace(result.diagnosis, verdict="unexplained", findings=())
    strange = replace(result, diagnosis=diagnosis, account=account)
    (advice,) = advise(strange, np.random.default_rng(0))
    assert arm("planar").joints[1] in advice.experiment
    assert advice.separation == pytest.approx(20.0)
    assert advice.splits == ()


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


@pytest.mark.parametrize("name", ["planar", "coman_like", "scara"])
def test_every_experiment_keeps_the_limits_and_ends_where_it_began_at_rest(name):
    robot = arm(name)
    found = list(menu(robot, 1, np.random.default_rng(0), rate=100.0))
    assert len(found) >= 5
    for experiment in found:
        r = experiment.reference
        assert np.all(r.q >= robot.q_min - 1e-9)
        assert np.all(r.q <= robot.q_max + 1e-9)
        assert np.all(np.abs(r.v) <= robot.v_max + 1e-9)
        np.testing.assert_allclose(r.v[[0, -1]], 0.0, atol=1e-6)
        np.testing.assert_allclose(r.q[0], r.q[-1], atol=1e-6)


def test_a_gap_along_an_experiment_is_of_the_simulator_and_empty():
    result = diagnosed.planar()
    path, ahead = fast(result)
    assert not ahead.left.any()
    assert ahead.rate == pytest.approx(RATE / round(RATE / ahead.rate))
    np.testing.assert_array_equal(ahead.motions[0].q, path.q)
    assert ahead.moving.any(axis=0).all()


def test_a_warm_drive_is_as_old_as_it_is_said_to_be():
    found = list(menu(arm("planar"), 0, np.random.default_rng(0), rate=100.0))
    (warm,) = [x for x in found if x.start > 0]
    ahead = gap_along(diagnosed.planar().gap, warm)
    assert ahead.motions[0].t[0] == warm.start
