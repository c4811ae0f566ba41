"""Whole diagnoses of exact pendulums, each number of which can be worked out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import NOISE, RATE, pendulum, swings, with_torque

from hybrid.diagnosis.answer.command import Link
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Region
from hybrid.diagnosis.answer.findings import finding_of
from hybrid.diagnosis.answer.links import merged_links
from hybrid.diagnosis.answer.motion_gap import (
    motion_shrink,
    rollout_agrees,
    with_motion_gap,
)
from hybrid.diagnosis.answer.regions import locate
from hybrid.diagnosis.answer.replay import Replay, simulated_positions
from hybrid.diagnosis.diagnose import diagnose, examine
from hybrid.diagnosis.gap.measure import measure_gap, split, unseen_samples
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import effect_classes
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.encoder_eccentricity import EncoderEccentricity
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.payload import Payload
from hybrid.effects.presliding import Presliding
from hybrid.effects.spring import Spring
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.recording import Recording

CUTOFF = 10.0  # Hz
LEFT = NOISE * np.sqrt(2 * CUTOFF / RATE)  # of white noise, below the cut-off
FEW = ("coulomb", "viscous", "torque_offset", "delay", "command_latency")
FEW += ("controller_gain",)
ASKEW, RUBS = TorqueOffset((0,), {"level": -1.0}), Coulomb((1,), {"level": 0.7})
SLIPS = Stribeck((0,), {"level": 3.0, "velocity": 1.0})
WAVES = TorqueRipple((0,), {"sine": 8.0, "cosine": 0.0, "periods": 3.0})
BRISTLES = Presliding((0,), {"level": 1.0, "distance": 0.05})


def logs(*effects, size=2, **options):
    return [
        with_torque(m, effects, NOISE, k) for k, m in enumerate(swings(size, **options))
    ]


def examined(recordings, *, library=FEW, robot=None):
    without = [x for x in effect_classes() if x not in library]
    size = recordings[0].q.shape[1]
    return examine(robot or pendulum(size), recordings, cutoff=CUTOFF, without=without)


def only(findings, effect):
    (found,) = (x for x in findings if x.effect == effect)
    return found


@pytest.mark.study
def test_of_a_sound_arm_the_noise_is_left():
    found = examined(logs()).diagnosis
    assert (found.verdict, found.unexplained) == ("no_gap", 0.0)
    assert found.findings == found.where == found.events == ()
    assert found.warnings == found.doubts == ()
    assert found.rms == pytest.approx([LEFT, LEFT], rel=0.15)
    assert found.noise_floor == pytest.approx([LEFT, LEFT], rel=0.25)
    assert found.units == ("N·m", "N·m")
    size = [np.sqrt(np.mean([m.tau[:, j] ** 2 for m in logs()])) for j in (0, 1)]
    assert np.array(found.relative) * size == pytest.approx(found.rms, rel=0.1)
    for each in (found.unseen.before, found.unseen.after, found.unseen.noise):
        assert each == pytest.approx([LEFT, LEFT], rel=0.3)


def test_two_causes_are_told_with_their_joints_sizes_and_shares():
    result = examined(logs(ASKEW, RUBS))
    found = result.diagnosis
    assert found.verdict == "explained" and found.unexplained < 0.05
    askew, rubs = (only(found.findings, x) for x in ("torque_offset", "coulomb"))
    assert (askew.joints, rubs.joints) == (("hinge_0",), ("hinge_1",))
    for f, truth in ((askew, -1.0), (rubs, 0.7)):
        (level,) = f.parameters
        assert level.joint == f.joints[0] and level.determined
        low, high = level.interval
        assert low < truth < high and high - low < 0.3
        assert low + high == pytest.approx(2 * level.value)
        fall = f.shrink["torque"]
        assert fall.before == pytest.approx(abs(truth), rel=0.1)
        assert fall.after < 3 * LEFT
        assert fall.removed == pytest.approx(1 - fall.after / fall.before)
        assert fall.interval[0] <= fall.removed <= fall.interval[1] <= 1.0
    assert askew.share + rubs.share == pytest.approx(1.0)
    assert list(found.findings) == sorted(found.findings, key=lambda f: -f.share)
    np.testing.assert_allclose(found.rms, [1.0, 0.7], rtol=0.1)
    np.testing.assert_allclose(found.unseen.before, [1.0, 0.7], rtol=0.1)
    assert max(found.unseen.after) < 3 * LEFT
    assert {x.id for x in result.effects} == {"torque_offset", "coulomb"}
    assert result.delays == () and result.command == ()
    about = {(r.joint, r.variable) for r in found.where}
    assert ("hinge_1", "direction") not in about  # dry friction has both
    assert {r.joint for r in found.where} == {"hinge_0", "hinge_1"}


def test_an_effect_out_of_the_library_is_unexplained():
    found = examined(logs(SLIPS, size=1), library=("torque_offset",)).diagnosis
    assert (found.verdict, found.findings) == ("unexplained", ())
    assert found.unexplained == 1.0 and max(found.rms) > 5 * LEFT
    assert found.unseen.ceiling[0] < 0.5 * found.unseen.before[0]


@pytest.mark.study
def test_part_of_a_gap_may_be_explained():
    both = logs(SLIPS, RUBS)
    found = examined(both, library=("coulomb", "torque_offset")).diagnosis
    assert found.verdict in ("explained", "partly_explained")
    assert 0.0 < found.unexplained < 0.7
    assert "hinge_1" in {j for f in found.findings for j in f.joints}


@pytest.mark.study
def test_shapes_are_told_with_their_ends():
    result = examined(logs(BRISTLES, size=1), library=("presliding",))
    (found,) = result.diagnosis.findings
    level, distance = found.parameters
    assert level.interval[0] < 1.0 < level.interval[1]
    assert distance.interval[0] < 0.05 < distance.interval[1]
    assert 0.01 < distance.interval[1] - distance.interval[0] < 0.1 or (
        distance.interval[1] - distance.interval[0] < 0.02
    )
    assert distance.determined and distance.unit == "rad"
    (effect,) = result.effects
    assert effect.std["distance"] > 0 and effect.std["level"] > 0


@pytest.mark.study
def test_a_lightened_link_of_a_file_is_no_cause_but_is_said():
    light = pendulum(2).chain.inertial.copy()
    light[1] /= 1.6
    found = examined(logs(), robot=pendulum(2).with_inertial(light)).diagnosis
    assert not found.findings and found.background > 0.1
    assert any("off by about" in x for x in found.doubts)


@pytest.mark.study
def test_numbers_of_a_file_that_are_far_off_are_said_and_no_silence():
    """A link that is a quarter heavier, where no effect may say so."""
    light = pendulum(4).chain.inertial.copy()
    light[2] /= 1.25
    for robot, right in (
        (pendulum(4).with_inertial(light), False),
        (pendulum(4), True),
    ):
        found = examined(logs(size=4), library=("coulomb", "viscous"), robot=robot)
        found = found.diagnosis
        if right:
            assert found.verdict == "no_gap" and not found.doubts
        else:
            assert found.verdict == "unexplained"
            (said,) = found.doubts
            assert "masses and inertias of the file are off by about 5%" in said


def test_torque_of_another_clock_is_taken_back_and_named():
    late = []
    for m in logs(ASKEW, seconds=6.0):
        tau = np.column_stack([np.interp(m.t - 0.034, m.t, x) for x in m.tau.T])
        late.append(replace(m, tau=tau))
    result = examined(late)
    found = result.diagnosis
    delay, askew = (only(found.findings, x) for x in ("delay", "torque_offset"))
    assert delay.joints == ("hinge_0", "hinge_1") and askew.joints == ("hinge_0",)
    assert [v.value for v in delay.parameters] == pytest.approx([0.034] * 2, abs=1e-3)
    assert delay.share + askew.share == pytest.approx(1.0)
    assert [e.id for e in result.delays] == ["delay", "delay"]
    assert any("late at every joint" in x for x in found.warnings)
    assert delay.shrink["torque"].after < 0.2 * delay.shrink["torque"].before
    for f in with_motion_gap(result, np.random.default_rng(0)).diagnosis.findings:
        assert f.shrink["motion"].removed > 0.8


def test_a_gap_larger_than_the_torque_is_explained():
    """A spring swings the rod: a file without it is worse than no torque."""
    balance = Spring((0,), {"stiffness": 20.0})
    found = examined(logs(balance, size=1), library=("spring", "viscous")).diagnosis
    assert found.relative[0] > 1.0
    (spring,) = found.findings
    assert (found.verdict, spring.effect) == ("explained", "spring")
    low, high = spring.parameters[0].interval
    assert low < 20.0 < high
    assert found.unlike == "" and found.doubts == ()


@pytest.mark.study
def test_dry_friction_is_no_play_and_no_spring():
    found = examined(logs(RUBS), library=("coulomb", "backlash", "elasticity"))
    (f,) = found.diagnosis.findings
    assert (f.effect, f.joints) == ("coulomb", ("hinge_1",))


def test_an_arm_that_hardly_moves_tells_nothing():
    few = logs(size=1, count=1, seconds=2.0)
    found = examined(few).diagnosis
    assert (found.verdict, found.unexplained) == ("not_excited", 1.0)
    assert any("too few to name a cause" in x for x in found.doubts)


class TestCommand:
    """Servos that do not do what they are thought to do."""

    KP, KD = 80.0, 6.0

    def served(self, *, stiffness=1.0, damping=1.0, late=0.0):
        """Logs whose command asks for the torque that they have."""
        rng, found = np.random.default_rng(1), []
        kp, kd = stiffness * self.KP, damping * self.KD
        for k, m in enumerate(swings(1, count=4, seconds=6.0)):
            exact = with_torque(m, [WAVES], 0.0, k)
            # The command that makes kp (c − q) + kd (c' − v) this torque.
            pull = exact.tau[:, 0]
            off = np.zeros(len(m.t))
            parts = 20
            fine = np.interp(
                np.arange(parts * len(m.t)) / parts, np.arange(len(m.t)), pull
            )
            x, step = pull[0] / kp, 1.0 / RATE / parts
            for i in range(len(fine)):
                if i % parts == 0:
                    off[i // parts] = x
                x += step * (fine[i] - kp * x) / kd
            command = np.interp(m.t + late, m.t, m.q[:, 0] + off)[:, None]
            noisy = exact.tau + 1e-3 * rng.standard_normal(exact.tau.shape)
            keep = slice(20, -20)
            found.append(
                Recording(m.t[keep], m.q[keep], tau=noisy[keep],
                          command=command[keep], joints=m.joints, source=m.source)
            )  # fmt: skip
        return found

    def link(self, **changed):
        """The diagnosis, and what it says of the servo beside the ripple."""
        servo = replace(pendulum(), kp=np.array([self.KP]), kd=np.array([self.KD]))
        library = (*FEW, "torque_ripple")
        found = examined(self.served(**changed), robot=servo, library=library)
        findings = found.diagnosis.findings
        assert "torque_ripple" in {f.effect for f in findings}
        rest = [f for f in findings if f.effect != "torque_ripple"]
        return found.diagnosis, rest

    @pytest.mark.study
    def test_one_that_does_is_none(self):
        assert self.link()[1] == []

    @pytest.mark.study
    def test_a_soft_one_is_told_by_how_much(self):
        found, (f,) = self.link(stiffness=0.8)
        assert (f.effect, f.joints) == ("controller_gain", ("hinge_0",))
        values = {v.name: v for v in f.parameters}
        low, high = values["stiffness"].interval
        assert low - 0.01 < -0.2 < high + 0.01
        assert abs(values["damping"].value) < 0.1
        assert found.verdict == "explained"
        (region,) = (r for r in found.where if r.unit == "command to torque")
        assert (region.joint, region.variable) == ("hinge_0", "link")
        assert f.shrink["torque"].after < 0.2 * f.shrink["torque"].before

    def test_a_late_command_is_told_by_its_time(self):
        found, (f,) = self.link(late=0.03)
        assert f.effect == "command_latency" and found.verdict == "explained"
        (time,) = f.parameters
        assert time.value == pytest.approx(0.03, abs=0.002)


@pytest.fixture(scope="module")
def rubbing():
    return examined(logs(RUBS, seconds=5.0))


@pytest.fixture(scope="module")
def run(rubbing):
    return Replay(rubbing.scored)


class TestMotion:
    """The gap in motion: a simulator run along what was measured."""

    def test_it_falls_with_what_was_found(self, rubbing):
        rng = np.random.default_rng(0)
        found = with_motion_gap(rubbing, rng).diagnosis
        (f,) = found.findings
        motion = f.shrink["motion"]
        assert motion.horizon_s == 0.5 and motion.unit == "rad"
        assert motion.after < 0.1 * motion.before and motion.removed > 0.9
        assert motion.removed == pytest.approx(1 - motion.after / motion.before)
        assert motion.interval[0] <= motion.removed <= motion.interval[1]
        assert not any("do not take it" in x for x in found.warnings)

    def test_windows_are_of_motions_that_nothing_was_learnt_from(self, run):
        replay, gap = run, run.scored.gap
        learn = split(gap)
        assert [m.source for m in replay.motions] == ["swing 3"]
        assert unseen_samples(gap, learn).sum() == len(replay.motions[0].t)
        assert replay.windows.samples == round(0.5 * gap.rate)
        starts = replay.windows.sample
        assert (np.diff(starts) >= replay.windows.samples).all() and starts[0] == 0

    def test_a_term_that_is_there_agrees(self, run):
        replay, rng = run, np.random.default_rng(0)
        assert rollout_agrees(replay, 0, rng) is True
        off = [np.sqrt(replay.squares_of(x).mean()) for x in ((), replay.effects)]
        assert off[1] < 0.1 * off[0]
        assert motion_shrink(replay, [0], rng).removed > 0.9
        pick = replay.windows_with([0])
        assert len(pick) > 3 and (np.diff(pick) > 0).all()

    def test_the_courses_keep_to_the_motion_where_all_is_known(self, rubbing):
        before, after = simulated_positions(rubbing.scored)
        q = rubbing.scored.gap.sampled.q
        assert before.shape == after.shape == q.shape
        known = np.isfinite(after).all(axis=1)
        assert known.mean() > 0.8
        off = [np.abs(x - q)[known].mean() for x in (before, after)]
        assert off[1] < 0.2 * off[0]

    def test_what_moves_less_like_the_arm_is_denied(self, rubbing, run, monkeypatch):
        """Of effects between motor and link; others explain torque all the same."""
        monkeypatch.setattr("hybrid.diagnosis.answer.motion_gap.Replay", lambda _: run)
        said = {"coulomb": False}
        for shows, denied in ((False, False), (True, True)):
            monkeypatch.setattr(Coulomb, "shows_in_motion", shows)
            monkeypatch.setattr(
                "hybrid.diagnosis.answer.motion_gap.rollout_agrees",
                lambda *_: said["coulomb"],
            )
            found = with_motion_gap(rubbing, np.random.default_rng(0)).diagnosis
            assert any("do not take it" in x for x in found.warnings) == denied
            assert (found.verdict == "partly_explained") == denied
            assert (found.unexplained > 0.9) == denied
        for answer in (None, True):
            said["coulomb"] = answer
            found = with_motion_gap(rubbing, np.random.default_rng(0)).diagnosis
            assert not any("do not take it" in x for x in found.warnings)


@pytest.mark.study
def test_a_diagnosis_ends_with_what_to_run_next_where_two_are_alike():
    """A payload of the last link and a heavier link: an arm by itself cannot tell."""
    without = [x for x in effect_classes() if x not in ("payload", "coulomb")]
    held = Payload((0, 1), {"mass": 0.8, "mz": -0.48, "Ixx": 0.29, "Iyy": 0.29})
    found = diagnose(pendulum(2), logs(held), cutoff=CUTOFF, without=without)
    (f,) = found.findings
    assert f.effect == "payload"
    values = {v.name: v for v in f.parameters}
    assert abs(values["mz"].value + 0.48) < 0.05


class TestWhere:
    """Regions of a gap that is put where one wants it."""

    @staticmethod
    def placed(at, size=1.0):
        """Where a pendulum's gap lies that is this at some samples, noise elsewhere."""
        gap = measure_gap(pendulum(), logs(size=1, seconds=6.0), cutoff=CUTOFF)
        m = gap.sampled
        left = gap.left + size * at(m, gap)[:, None]
        return locate(
            replace(gap, left=left), np.array([LEFT]), np.random.default_rng(0)
        )

    @pytest.mark.parametrize(
        ("variable", "at", "low", "high"),
        [
            ("direction", lambda m, gap: m.v[:, 0] > 0, 0.0, 1.0),
            ("position", lambda m, gap: m.q[:, 0] > 0.4, 0.4, np.inf),
            ("position", lambda m, gap: m.q[:, 0] < -0.4, -np.inf, -0.4),
            ("speed", lambda m, gap: np.abs(m.v[:, 0]) < 1.0, 0.0, 1.0),
            ("load", lambda m, gap: gap.load[:, 0] > 5.0, 5.0, np.inf),
            ("time", lambda m, gap: (m.t > 2.0) & (m.t < 4.0), 2.0, 4.0),
        ],
    )
    def test_it_is_told_in_the_variable_that_it_is_of(self, variable, at, low, high):
        found = self.placed(at)
        whole = next(r for r in found if r.variable == "link")
        assert whole.share == pytest.approx(1.0) and whole.joint == "hinge_0"
        region = next(r for r in found if r.variable == variable)
        assert region.low >= low - 0.21 and region.high <= high + 0.21
        assert region.share > 0.6 and region.interval[0] <= region.share

    def test_it_is_told_in_the_band_that_it_swings_in(self):
        found = self.placed(lambda m, gap: np.sin(2 * np.pi * 3.0 * m.t))
        region = next(r for r in found if r.variable == "frequency")
        assert (region.low, region.high, region.unit) == (2.0, 5.0, "Hz")
        assert region.share > 0.8

    def test_of_noise_alone_nothing_is_told(self):
        assert self.placed(lambda m, gap: 0 * m.t) == ()


@pytest.mark.parametrize(
    "effect",
    [
        TorqueGain((0,), {"gain": 0.3}),
        Delay((0,), {"time": 0.012}),
        EncoderOffset((0,), {"offset": 0.05}),
        EncoderEccentricity((1,), {"sine": 0.02, "cosine": 0.01}),
    ],
)
def test_columns_of_a_changed_signal_make_up_the_whole_change(effect):
    """They are linear near its gains only, and at these they are exact."""
    gap = measure_gap(pendulum(2), swings(2), cutoff=CUTOFF)
    columns, reached = gap.columns(effect, lower_band=False), effect.reaches(2)
    assert set(columns) == set(reached)
    change = []
    for m, _, sampler in gap:
        if effect.reports:
            own = m.tau[:, list(reached)]
            moved = effect.report(m.t, own) - own
        else:
            body = RigidBody(pendulum(2).chain, m)
            seen = effect.observe(m, body)
            tau = simulated_torque(
                pendulum(2), seen, RigidBody(pendulum(2).chain, seen)
            )
            moved = (tau - m.tau)[:, list(reached)]
        change.append(sampler(moved))
    for k, j in enumerate(reached):
        expected = np.concatenate(change)[:, k]
        np.testing.assert_allclose(
            columns[j] @ effect.gain_values,
            expected,
            atol=1e-6 * np.abs(expected).max(),
        )


@pytest.mark.parametrize(("fold", "trajectory"), [(2, 0), (3, 0), (1, 1), (2, 1)])
def test_what_is_far_larger_is_learnt_from_and_not_left_for_scoring(fold, trajectory):
    """Of two logs each in blocks: the larger part is no usual one, wherever it is."""
    folds, logs_of = np.tile(np.repeat(np.arange(8), 10), 2), np.repeat([0, 1], 80)
    left = np.where(np.arange(160) % 2, 1.0, -1.0)[:, None]
    here = (folds == fold) & (logs_of == trajectory)
    left[here] *= np.sqrt(15.0)
    gap = SimpleNamespace(
        fold=folds, trajectory=logs_of, left=left, moving=np.ones((160, 1), dtype=bool)
    )
    learn = split(gap)
    assert learn[here].all() and 0.6 < learn.mean() < 0.9


def test_regions_of_both_links_share_what_is_left():
    """Between command and torque a soft servo; between torque and motion an offset."""
    region = Region("hinge_0", "link", 0.0, 1.0, "torque to motion", 1.0, (0.9, 1.0))
    diagnosis = Diagnosis(
        "arm", ("hinge_0", "hinge_1"), (1.0, 1.0), (0.1, 0.1), (1.0, 1.0), (region,),
        (), "unexplained", 1.0, 0.02,
    )  # fmt: skip
    excess = np.zeros((10, 2))
    excess[:, 1] = 30.0
    late = finding_of(CommandLatency, ["hinge_1"], (), ())
    link = Link((late,), (), np.array([0.0, 600.0]), excess)
    left = np.tile([np.sqrt(2.0), 1.0], (100, 1))  # 100 in units of noise
    gap = SimpleNamespace(moving=np.ones((100, 2), dtype=bool), left=left)
    account = SimpleNamespace(explained=np.zeros(2), missed=np.array([200.0, 0.0]))
    found = merged_links(diagnosis, account, gap, link, np.random.default_rng(0))
    assert found.verdict == "partly_explained"
    assert found.unexplained == pytest.approx(200 / 800)
    assert [(r.joint, r.unit) for r in found.where] == [
        ("hinge_1", "command to torque"), ("hinge_0", "torque to motion"),
    ]  # fmt: skip
    assert [r.share for r in found.where] == pytest.approx([0.75, 0.25])
    assert found.where[1].interval == pytest.approx((0.225, 0.25))
    assert found.where[0].interval == pytest.approx((0.75, 0.75))
    (f,) = found.findings
    assert f.share == 1.0
    none = replace(link, findings=())
    assert merged_links(diagnosis, account, gap, none, None) is diagnosis
    first = replace(region, share=0.9, interval=(0.8, 1.0))
    of_both = merged_links(
        replace(diagnosis, where=(first, replace(first, share=0.01)), findings=(late,)),
        SimpleNamespace(explained=np.array([200.0, 0.0]), missed=np.zeros(2)),
        gap, link, np.random.default_rng(0),
    )  # fmt: skip
    sound = replace(diagnosis, verdict="no_gap", where=())
    alone = merged_links(sound, account, gap, link, np.random.default_rng(0))
    assert alone.verdict == "explained" and alone.where[0].share == 1.0
    shares = [r.share for r in of_both.where]
    assert shares == sorted(shares, reverse=True) and len(shares) == 3
    assert sum(f.share for f in of_both.findings) == pytest.approx(1.0)


@pytest.mark.study
def test_one_log_is_enough_if_it_is_long():
    found = examined(logs(ASKEW, size=2, count=1, seconds=16.0))
    (f,) = found.diagnosis.findings
    assert (f.effect, f.joints) == ("torque_offset", ("hinge_0",))
    (level,) = f.parameters
    assert level.interval[0] < -1.0 < level.interval[1] < 0.0
