"""The diagnosis of a robot file that declares no friction, or too much of it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse import Plant, simulate
from simulated import arm

from hybrid.diagnosis.answer.fixed import SIMULATOR, write_fixed
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.evidence.convention import Convention, find_convention
from hybrid.diagnosis.gap.background import dry_friction
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.dynamics import inverse_dynamics
from hybrid.effects.presliding import Presliding
from hybrid.recording import Recording
from hybrid.robot import Robot

RATE = 250.0  # Hz
LEVEL, DAMPING, ROTOR = np.array([[1.5, 0.8], [0.6, 0.3], [0.2, 0.1]])
SLOW = np.array([0.0, 0.8])  # N·m more at low speed
TOO_MUCH, BARE = arm("planar"), replace(
    arm("planar"),
    chain=replace(arm("planar").chain, armature=np.zeros(2)),
    damping=np.zeros(2),
    frictionloss=np.zeros(2),
)  # fmt: skip
USUAL = {(x, BARE.joints) for x in ("coulomb", "viscous", "armature")}


@cache
def logs(more=0.0, seed=0):
    """Moves from rest to rest of an arm whose friction is full from 2 mrad/s on."""
    rng = np.random.default_rng(seed)
    return [recording(rng, more) for _ in range(4)]


def offset(level):
    """The same with an offset of the torque of the second joint."""
    return [replace(x, tau=x.tau + [0.0, level]) for x in logs()]


def recording(rng, more):
    s = np.linspace(0, 1, round(1.5 * RATE))
    rise = np.concatenate([s**3 * (10 - 15 * s + 6 * s**2), np.ones(round(0.2 * RATE))])
    at = rng.uniform(-1.2, 1.2, (8, 2))
    moves = zip(at[:-1], at[1:], strict=True)
    q = np.concatenate([a + np.outer(rise, b - a) for a, b in moves])
    t = np.arange(len(q)) / RATE
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)
    tau = inverse_dynamics(BARE.chain, BARE.chain.inertial, q, v, a)
    tau += np.tanh(v / 2e-3) * (LEVEL + more * SLOW * np.exp(-((v / 0.1) ** 2)))
    tau += DAMPING * v + ROTOR * a + 0.03 * rng.standard_normal(q.shape)
    q = q + 1e-5 * rng.standard_normal(q.shape)
    return Recording(t, q, tau=tau, joints=BARE.joints)


def named(result):
    return {(f.effect, f.joints) for f in result.diagnosis.findings}


class TestNoFriction:
    def test_dry_friction_is_read_from_the_gap(self):
        gap = measure_gap(BARE, logs())
        np.testing.assert_allclose(dry_friction(gap), LEVEL, rtol=0.1)

    @pytest.mark.study
    @pytest.mark.parametrize("seed", [0, 1])
    def test_friction_that_goes_softly_through_rest_is_no_presliding(self, seed):
        assert named(examine(BARE, logs(seed=seed))) == USUAL

    @pytest.mark.study
    def test_what_is_more_at_low_speed_is_found_beside_it(self):
        found = examine(BARE, logs(more=1.0))
        assert named(found) == USUAL | {("stribeck", BARE.joints[1:])}

    @pytest.mark.study
    @pytest.mark.parametrize("effect", ["torque_gain", "asymmetric_friction"])
    def test_what_is_small_beside_it_is_found(self, effect):
        """If it is more than laws are inexact by, which are large here."""
        more = {
            "torque_gain": lambda tau, v: 0.15 * tau,
            "asymmetric_friction": lambda tau, v: 0.1 * np.abs(np.tanh(v / 2e-3)),
        }[effect]
        faulty = []
        for x in logs():
            v, tau = np.gradient(x.q, x.t, axis=0), x.tau.copy()
            tau[:, 1] += more(tau, v)[:, 1]
            faulty.append(replace(x, tau=tau))
        result = examine(BARE, faulty)
        (found,) = (f for f in result.diagnosis.findings if f.joints != BARE.joints)
        assert effect in found.alternatives and found.joints == BARE.joints[1:]
        assert named(result) == USUAL | {(found.effect, found.joints)}

    @pytest.mark.parametrize("late", [0, 1])
    def test_how_late_torque_is_logged_is_told_beside_a_rotor(self, late):
        shifted = [replace(x, tau=np.roll(x.tau, late, axis=0)) for x in logs()]
        found = find_convention(measure_gap(BARE, shifted), shifted)
        assert found == Convention(late=pytest.approx(late / RATE))


class TestTooMuchFriction:
    @pytest.mark.study
    def test_it_is_found_with_its_sign(self):
        diagnosis = examine(TOO_MUCH, logs()).diagnosis
        assert diagnosis.verdict == "explained"
        assert {(f.effect, f.joints) for f in diagnosis.findings} == USUAL
        truth = {
            "level": LEVEL - TOO_MUCH.frictionloss,
            "coefficient": DAMPING - TOO_MUCH.damping,
            "inertia": ROTOR - TOO_MUCH.chain.armature,
        }
        for finding in diagnosis.findings:
            for x in finding.parameters:
                expected = truth[x.name][BARE.joints.index(x.joint)]
                assert expected < 0
                assert x.value == pytest.approx(expected, abs=0.1)

    @pytest.mark.study
    def test_what_is_small_beside_such_friction_is_found(self):
        found = examine(TOO_MUCH, offset(0.05)).diagnosis
        assert "torque_offset" in {x for f in found.findings for x in f.alternatives}
        assert not any("masses and inertias" in x for x in found.doubts)

    @pytest.mark.study
    def test_without_laws_of_friction_it_is_unknown_and_the_file_is_doubted(self):
        """Numbers of the file that are so far off are no background."""
        friction = "viscous", "coulomb", "armature"
        found = examine(TOO_MUCH, offset(0.05), without=friction).diagnosis
        assert found.verdict == "unexplained" and not found.findings
        assert any("numbers of the file at" in x for x in found.doubts)


@pytest.mark.study
def test_presliding_in_place_of_declared_friction_is_one_finding():
    declared = replace(arm("planar"), frictionloss=np.array([0.8, 0.4]))
    real = replace(declared, frictionloss=np.array([0.0, 0.4]))
    law = Presliding((0,), {"level": 0.8, "distance": 0.02})
    plant = Plant(real, [law], nominal=declared)
    result = examine(declared, simulate(plant, trajectories=4, duration=6.0, seed=1))
    assert {t.place[0] for t in result.scored.terms} == {"presliding", "coulomb"}
    (finding,) = result.diagnosis.findings
    assert (finding.effect, finding.alternatives) == ("presliding", ("presliding",))
    assert "takes the place of the coulomb friction" in finding.sentence
    values = {v.name: v.value for v in finding.parameters}
    assert values["level"] == pytest.approx(0.8, rel=0.1)
    assert values["coulomb level"] == pytest.approx(-0.8, rel=0.1)
    assert finding.share == pytest.approx(1.0)


SPRUNG = replace(
    arm("planar"), stiffness=np.array([12.0, 4.0]), springref=np.array([0.5, -0.3])
)


def sprung(**real):
    """Result for an arm whose file declares springs that the arm has in part."""
    plant = Plant(replace(SPRUNG, **real), [], nominal=SPRUNG)
    return examine(SPRUNG, simulate(plant, trajectories=4, duration=4.5, seed=1))


@pytest.mark.study
def test_a_spring_that_the_file_declares_is_no_cause():
    assert sprung().diagnosis.verdict == "no_gap"


@pytest.mark.study
def test_a_declared_spring_that_is_not_there_is_found_with_its_sign():
    (finding,) = sprung(stiffness=np.array([12.0, 0.0])).diagnosis.findings
    assert (finding.effect, finding.joints) == ("spring", ("elbow",))
    values = {x.name: x.value for x in finding.parameters}
    assert values["stiffness"] == pytest.approx(-4.0, rel=0.05)
    assert values["preload"] == pytest.approx(4.0 * -0.3, rel=0.05)


@pytest.mark.study
def test_a_declared_spring_that_is_too_soft_is_mended_in_the_file(tmp_path):
    result = sprung(stiffness=np.array([24.0, 4.0]))
    assert [f.effect for f in result.diagnosis.findings] == ["spring"]
    write_fixed(result, tmp_path)
    fixed = Robot.load(tmp_path / SIMULATOR)
    np.testing.assert_allclose(fixed.stiffness, [24.0, 4.0], rtol=0.05)
    np.testing.assert_allclose(fixed.springref, [0.5, -0.3], rtol=0.05)
