"""The diagnosis: right cause, right joint, right size; and silence where it must be."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from arms import LIFT, MODELS
from coarse import Plant, simulate
from diagnosed import RIPPLE, STRIBECK, faultless, planar
from marks import studied
from simulated import arm, quiet

from hybrid.diagnosis.advice.advise import advise
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.answer.words import verdict_lines
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.evidence.contacts import Contacts
from hybrid.diagnosis.evidence.shapes import shape_derivatives, shape_units
from hybrid.diagnosis.gap.background import friction_near_rest, soft_friction
from hybrid.diagnosis.gap.measure import measure_gap, split, unseen_samples
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import effect_classes, effects_from_text
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.backlash import Backlash
from hybrid.effects.contact import Contact
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.counterbalance import Counterbalance
from hybrid.effects.delay import Delay
from hybrid.effects.encoder_eccentricity import EncoderEccentricity
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.payload import LinkInertia, Payload
from hybrid.effects.spring import Spring
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning, RecordingError
from hybrid.plant import Noise, Reference, random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import butterworth

FORCES = ("force_x", "force_y")
PUSH = {"force_x": 8.0, "force_y": -5.0, "start": 2.0, "duration": 0.8}


_KEPT = {}


def logs(effects, *, seed=1, duration=4.5, count=4, quiet=False):
    robot, key = arm("planar"), (repr(effects), seed, duration, count, quiet)
    if key not in _KEPT:
        noise = Noise.none(robot.size) if quiet else None
        plant = Plant(robot, effects, nominal=robot, noise=noise)
        found = simulate(plant, trajectories=count, duration=duration, seed=seed)
        _KEPT[key] = tuple(found)
    return robot, list(_KEPT[key])


def named(result):
    return {(f.effect, f.joints) for f in result.diagnosis.findings}


class TestShapes:
    @pytest.mark.parametrize("periods", [6.0, 40.0, 200.0])
    def test_the_change_with_the_order_of_a_ripple_is_its_derivative(self, periods):
        robot, recordings = logs([], count=1, quiet=True)
        gap = measure_gap(robot, recordings)
        ripple = TorqueRipple((1,), {"sine": 2.0, "cosine": 1.0, "periods": periods})
        near = [
            gap.columns(ripple.at({"periods": periods + x}))[1] @ ripple.gain_values
            for x in (-1e-3, 1e-3)
        ]
        (unit,), (nudge,) = shape_units(gap, ripple), shape_derivatives(gap, ripple)
        expected = (near[1] - near[0]) / 2e-3 * unit
        error = nudge[1][:, 0] - expected
        assert np.linalg.norm(error) < 0.05 * np.linalg.norm(expected)


class TestGap:
    def test_of_a_faultless_simulator_it_is_the_noise(self):
        result = faultless()
        assert result.diagnosis.verdict == "no_gap"
        rms, floor = result.diagnosis.rms, result.diagnosis.noise_floor
        np.testing.assert_allclose(rms, floor, rtol=0.1)

    @pytest.mark.study
    @pytest.mark.parametrize(
        "effect",
        [
            TorqueGain((0,), {"gain": 0.2}),
            Viscous((1,), {"coefficient": 0.3}),
            Delay((0,), {"time": 0.004}),
        ],
    )
    def test_of_one_effect_it_is_its_columns_times_its_gain(self, effect):
        robot, clean = logs([], quiet=True, duration=6.0)
        bare = measure_gap(robot, clean, cutoff=15.0)
        plant = Plant(robot, [effect], nominal=robot, noise=Noise.none(robot.size))
        logged = simulate(plant, trajectories=4, duration=6.0, seed=1)
        gap = measure_gap(robot, logged, cutoff=15.0)
        (j,), (gain,) = effect.joints, effect.gain_values
        here = gap.moving[:, j]
        shown = gap.columns(effect)[j][here, 0] * gain
        seen = gap.left[here, j]
        scale = np.sqrt(np.mean(shown**2))
        rest = np.sqrt(np.mean(bare.left[here, j] ** 2))
        assert np.sqrt(np.mean((seen - shown) ** 2)) < 0.1 * scale + 2 * rest

    def test_dry_friction_of_a_late_log_turns_as_sharply_as_any(self):
        """Columns of the lower half of the band keep what has no noise as it is."""
        robot = replace(arm("planar"), frictionloss=np.array([6.0, 2.0]))
        late = Delay((0,), {"time": 0.012})
        plant = Plant(robot, [late], nominal=robot, noise=Noise.none(robot.size))
        recordings = simulate(plant, trajectories=4, duration=6.0, seed=1)
        gap = measure_gap(robot, recordings, cutoff=20.0)
        here = gap.moving[:, 0]
        column, left = gap.columns(late)[0][here, 0], gap.left[here, 0]
        time = (column @ left) / (column @ column)
        assert time == pytest.approx(0.012, rel=0.15)

    @pytest.mark.parametrize("size", [0.0, 1.0])
    def test_an_encoders_error_acts_on_rotor_and_damping_too(self, size):
        """At no error columns are first order, at any other they make it up."""
        robot, clean = logs([], quiet=True)
        gap = measure_gap(robot, clean, cutoff=15.0)
        off = {"sine": 0.03, "cosine": -0.02}
        effect = EncoderEccentricity((0,), {k: size * x for k, x in off.items()})
        gains = np.array([*off.values()])
        # Far off the whole change; near, a hundredth of it.
        near = effect.at({k: (size or 0.01) * x for k, x in off.items()})
        parts = []
        for motion, body, sampler in gap:
            seen = near.observe(motion, body)
            after = simulated_torque(robot, seen, RigidBody(robot.chain, seen))
            parts.append(sampler(after - motion.tau) / (size or 0.01))
        expected = np.concatenate(parts)
        for j, columns in gap.columns(effect).items():
            error = columns @ gains - expected[:, j]
            part = 1e-6 if size else 0.01
            assert np.linalg.norm(error) < part * np.linalg.norm(expected[:, j])

    @pytest.mark.study
    @pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
    @pytest.mark.parametrize("duration", [5.0, 8.0])
    def test_of_any_number_of_logs_some_part_is_kept_for_scoring(self, count, duration):
        robot, recordings = logs([], count=count, duration=duration)
        gap = measure_gap(robot, recordings)
        learn = split(gap)
        unseen = unseen_samples(gap, learn)
        assert learn.mean() > 0.5
        assert 0.05 < unseen.mean() < 0.35

    def test_what_surrounds_a_fault_is_left_out_as_far_as_the_filter_carries_it(self):
        robot, clean = logs([], duration=6.0)
        tau = clean[0].tau.copy()
        tau[1000:1500, 0] = tau[1000, 0]
        sound = measure_gap(robot, clean, cutoff=15.0)
        spoilt = [replace(clean[0], tau=tau), *clean[1:]]
        gap = measure_gap(robot, spoilt, cutoff=15.0)
        used = np.flatnonzero((gap.trajectory == 0) & gap.moving[:, 0])
        time = clean[0].t[[999, 1500]]
        t = gap.sampled.t[used]
        assert np.all((t < time[0] - 0.5 / 15.0) | (t > time[1] + 0.5 / 15.0))
        # What is used is not touched by the fault.
        np.testing.assert_allclose(gap.left[used, 0], sound.left[used, 0], atol=0.05)
        assert gap.moving[:, 1].sum() == sound.moving[:, 1].sum()

    def test_declared_dry_friction_is_not_judged_where_it_turns_round(self):
        robot, clean = logs([])
        rubbing = replace(robot, frictionloss=np.array([0.5, 0.0]))
        gap = measure_gap(rubbing, clean, cutoff=15.0)
        v, rows = gap.sampled.v[:, 0], np.flatnonzero(gap.moving[:, 0])
        turns = np.flatnonzero(np.diff(np.sign(v)) != 0)
        assert len(turns) > 4
        nearest = np.abs(rows[:, None] - turns).min(axis=1)
        assert nearest.min() >= np.floor(0.6 / 15.0 * gap.rate)

    @pytest.mark.study
    def test_a_delay_is_not_lessened_by_noise_of_positions(self):
        robot, recordings = logs([Delay((0,), {"time": 0.01})], duration=10.0)
        (finding,) = examine(robot, recordings).diagnosis.findings
        assert "delay" in finding.alternatives
        assert abs(finding.parameters[0].value - 0.01) < 0.001

    @pytest.mark.study
    @pytest.mark.parametrize(("joint", "time"), [(0, -0.026), (1, 0.03)])
    def test_a_long_delay_is_all_delay_and_as_long_as_it_is(self, joint, time):
        robot, delay = arm("coman_like"), Delay((joint,), {"time": time})
        noise = Noise.typical(robot)
        plant = Plant(robot, [delay], nominal=robot, noise=noise)
        recordings = simulate(plant, trajectories=4, duration=5.0, seed=3)
        (finding,) = examine(robot, recordings).diagnosis.findings
        assert finding.effect == "delay"
        assert finding.parameters[0].value == pytest.approx(time, rel=0.05)

    @pytest.mark.study
    @pytest.mark.parametrize("time", [0.01, 0.03])
    @pytest.mark.parametrize("kind", [Delay, ActuatorLag])
    def test_a_log_comes_late_and_a_drive_lags(self, kind, time):
        """In a short time they do nearly the same."""
        robot, recordings = logs([kind((0,), {"time": time})], duration=10.0)
        (finding,) = examine(robot, recordings).diagnosis.findings
        told = {kind.id} if time > 0.02 else {Delay.id, ActuatorLag.id}
        assert {*finding.alternatives} == told

    @pytest.mark.parametrize("time", [0.02, *studied(0.005, 0.04)])
    def test_the_columns_of_a_lag_turn_round_where_dry_friction_does(self, time):
        robot, lag = arm("coman_like"), ActuatorLag((2,), {"time": time})
        quiet = {"nominal": robot, "noise": Noise.none(robot.size)}
        plant = Plant(robot, [lag], **quiet, step=0.0005)  # a tenth of the shortest lag
        gap = measure_gap(robot, simulate(plant, trajectories=2, duration=6.0, seed=1))
        column, here = gap.columns(lag)[2][:, 0], gap.moving[:, 2]
        found = column[here] @ gap.left[here, 2] / (column[here] @ column[here])
        assert found == pytest.approx(time, rel=0.012)

    @pytest.mark.study
    def test_a_drive_without_a_stated_limit_gives_what_the_logs_show(self):
        robot, recordings = logs([TorqueRipple((1,), {"sine": 3.0, "periods": 12.0})])
        free = replace(robot, tau_max=np.full(2, np.inf))
        result = examine(free, recordings)
        most = np.abs(result.gap.measured).max(axis=0)
        assert np.all([s.torque for s in result.gap.scales] >= most)
        assert named(result) == {("torque_ripple", ("elbow",))}

    @pytest.mark.study
    def test_a_law_of_slow_joints_is_as_large_as_that_of_fast_ones(self):
        """A file that states no limit of speed, of an arm that moves slowly."""
        robot = arm("planar")
        slow = replace(robot, v_max=np.full(2, 0.3))
        plant = Plant(slow, [NonlinearViscous((0,), {"quadratic": 20.0})], nominal=slow)
        recordings = simulate(plant, trajectories=2, duration=20.0, seed=1)
        result = examine(replace(robot, v_max=np.full(2, np.inf)), recordings)
        fastest = np.abs(result.gap.sampled.v).max(axis=0)
        assert np.all([s.speed for s in result.gap.scales] <= fastest)
        assert named(result) == {("nonlinear_viscous", ("shoulder",))}
        (law,) = result.effects
        assert law.values["fastest"] == pytest.approx(fastest[0], rel=0.05)

    @pytest.mark.parametrize("knee", [0.012, 0.014, 0.017, 0.02, 0.024])
    def test_dry_friction_that_is_full_from_any_low_speed_on_is_no_cause(self, knee):
        gap = faultless().gap
        columns, _ = friction_near_rest(gap)
        known = columns[0][0]  # of the shoulder's softened friction
        soft = soft_friction(gap, 0, [knee], [0.0])
        left = soft - known @ np.linalg.lstsq(known, soft)[0]
        assert np.linalg.norm(left) < 0.04 * np.linalg.norm(soft)

    @pytest.mark.study
    @pytest.mark.parametrize("count", [1, 2, 4, 5])
    def test_what_is_in_one_part_alone_is_learnt_from(self, count):
        robot, recordings = logs([], count=count, duration=10.0)
        gap = measure_gap(robot, recordings)
        usual = split(gap)
        large = replace(gap, left=np.where(usual[:, None], 1.0, 10.0) * gap.left)
        learn = split(large)
        part = gap.trajectory if count >= 4 else gap.fold * count + gap.trajectory
        alone = part == part[~usual][0]
        assert learn[alone].all() or len(np.unique(part[~usual])) > 1
        assert learn[~usual].any() and 0.5 < learn.mean() < 1.0
        small = replace(gap, left=np.where(usual[:, None], 1.0, 2.0) * gap.left)
        np.testing.assert_array_equal(split(small), usual)

    @pytest.mark.study
    def test_a_fault_in_the_last_log_alone_is_found(self):
        robot, recordings = logs([])
        push = np.where(np.abs(recordings[3].t - 3.0) < 0.5, 8.0, 0.0)
        tau = recordings[3].tau + np.array([1.0, 0.5]) * push[:, None]
        diagnosis = examine(robot, [*recordings[:3], replace(recordings[3], tau=tau)])
        (finding,) = diagnosis.diagnosis.findings
        assert finding.effect == "contact"
        assert any(
            "no held-out motion shows contact" in x for x in diagnosis.diagnosis.doubts
        )

    def test_fit_and_score_share_nothing(self):
        gap = planar().gap
        learn = split(gap)
        assert not {*gap.trajectory[learn]} & {*gap.trajectory[~learn]}
        robot, recordings = logs([], count=1, duration=20.0)
        single = measure_gap(robot, recordings)
        learn = split(single)
        scored = unseen_samples(single, learn)
        known, place = np.flatnonzero(learn), np.flatnonzero(scored)
        after = known[np.minimum(np.searchsorted(known, place), len(known) - 1)]
        before = known[np.searchsorted(known, place) - 1]
        apart = np.minimum(np.abs(after - place), np.abs(place - before))
        assert apart.min() >= 0.3 * single.rate

    @pytest.mark.study
    @pytest.mark.parametrize(("harder", "hum"), [(1.0, 3.0), (8.0, 0.6)])
    def test_a_contact_is_no_cause_of_as_much_without_it(self, harder, hum):
        push = Contact((0, 1), PUSH | {n: harder * PUSH[n] for n in FORCES})
        (robot, plain), (_, pushed) = (logs(x, duration=4.0) for x in ([], [push]))
        once = [pushed[0], *plain[1:]]
        contact = {("contact", robot.joints)}
        assert named(examine(robot, once)) == contact
        torque = hum * np.sin(4 * np.pi * plain[3].t)
        unseen = replace(plain[3], tau=plain[3].tau + torque[:, None])
        result = examine(robot, [*once[:3], unseen])
        if harder > hum:  # the unknown is small beside it
            assert named(result) == contact
        else:
            assert result.diagnosis.verdict == "unexplained"

    @pytest.mark.study
    def test_small_effects_are_found_where_much_is_logged(self):
        floor = faultless().diagnosis.noise_floor[1]
        ripple = TorqueRipple((1,), {"sine": 0.45 * floor, "periods": 3.0})
        robot, recordings = logs([ripple], duration=10.0, count=8)
        assert named(examine(robot, recordings)) == {("torque_ripple", ("elbow",))}

    @pytest.mark.study
    def test_recordings_may_be_stamped_by_a_clock_of_the_day(self):
        robot, recordings = logs([Contact((0, 1), PUSH)], duration=4.0)
        plain, late = (
            examine(robot, [replace(x, t=x.t + start) for x in recordings])
            for start in (0.0, 1.7e9)
        )
        assert named(late) == named(plain) == {("contact", ("shoulder", "elbow"))}
        pairs = (r.diagnosis.findings[0].parameters for r in (plain, late))
        for a, b in zip(*pairs, strict=True):
            assert b.value == pytest.approx(a.value, abs=1e-2)

    @pytest.mark.study
    def test_recordings_may_be_hours_apart(self):
        robot, recordings = logs([Viscous((1,), {"coefficient": 0.3})])
        apart = [replace(x, t=x.t + 1e5 * k) for k, x in enumerate(recordings)]
        assert named(examine(robot, apart)) == {("viscous", ("elbow",))}

    def test_a_log_without_torque_is_refused(self):
        robot, recordings = logs([])
        bare = replace(recordings[0], tau=np.full_like(recordings[0].tau, np.nan))
        with pytest.raises(RecordingError, match="no torque"):
            measure_gap(robot, [bare])


class TestCause:
    def test_both_effects_are_named_where_they_act(self):
        found = {(f.effect, f.joints) for f in planar().diagnosis.findings}
        assert found == {("torque_ripple", ("shoulder",)), ("stribeck", ("elbow",))}
        assert planar().diagnosis.verdict == "explained"
        assert planar().diagnosis.unexplained < 0.05

    def test_they_have_the_size_that_they_have(self):
        by_id = {e.id: e.values for e in planar().effects}
        ripple = by_id["torque_ripple"]
        for name in ("sine", "cosine", "periods"):
            assert ripple[name] == pytest.approx(RIPPLE.values[name], rel=0.1)
        level = by_id["stribeck"]["level"]
        assert level == pytest.approx(STRIBECK.values["level"], rel=0.25)

    def test_shares_add_up_to_one(self):
        assert sum(f.share for f in planar().diagnosis.findings) == pytest.approx(1.0)

    @pytest.mark.study
    def test_a_share_is_not_lost_to_what_the_file_declares(self):
        """Declared damping alone could take over, at the price of being far off."""
        damped = replace(arm("planar"), damping=np.array([6.0, 1.0]))
        effects = [Viscous((0,), {"coefficient": 3.0}), STRIBECK]
        plant = Plant(damped, effects, nominal=damped)
        recordings = simulate(plant, trajectories=4, duration=12.0, seed=4)
        first, second = examine(damped, recordings).diagnosis.findings
        assert (first.effect, second.effect) == ("viscous", "stribeck")
        assert first.share > 0.8

    def test_the_gap_falls_to_the_noise_on_unseen_motion(self):
        for f in planar().diagnosis.findings:
            shrink = f.shrink["torque"]
            assert shrink.interval[0] <= shrink.removed <= shrink.interval[1]
            # Much of Stribeck's torque is where declared friction turns round, which is
            # not judged: few of the blocks that are drawn again hold the rest.
            assert shrink.removed > 0.3
            assert shrink.interval[0] > (0.3 if f.effect == "torque_ripple" else 0)
            floor = planar().diagnosis.noise_floor
            joint = planar().diagnosis.joints.index(f.joints[0])
            assert shrink.after == pytest.approx(floor[joint], rel=0.15)

    @pytest.mark.study
    def test_placeholders_of_friction_are_too_much_friction(self):
        """Torque of an arm that hardly rubs is as small as its noise at times."""
        robot = arm("planar")
        dry, viscous = 0.05 * robot.tau_max, 0.1 * robot.tau_max
        file = replace(robot, frictionloss=dry, damping=viscous)
        rubs = replace(robot, frictionloss=0.075 * dry, damping=0.0075 * viscous)
        logs = simulate(Plant(rubs, nominal=file), trajectories=4, duration=10.0)
        found = examine(file, logs).diagnosis.findings
        both = ("shoulder", "elbow")
        assert {(f.effect, f.joints) for f in found} == {
            ("coulomb", both), ("viscous", both)
        }  # fmt: skip

    @pytest.mark.study
    def test_friction_that_is_most_of_the_torque_is_no_dead_zone(self):
        """Its torque has the sign of the speed, which a dead zone smooths over more."""
        robot = arm("scara")
        effects = effects_from_text(
            "coulomb:elbow(level=0.5),torque_ripple:shoulder",
            robot.joints,
            joint_scales(robot),
        )
        logs = simulate(Plant(robot, effects), trajectories=4, duration=10.0, seed=0)
        found = examine(robot, logs).diagnosis
        (friction,) = (f for f in found.findings if f.joints == ("elbow",))
        assert friction.effect == "coulomb"

    @pytest.mark.study
    def test_a_wrong_torque_constant_counts_friction_too(self):
        effect = TorqueGain((1,), {"gain": 0.2})
        robot, recordings = logs([Coulomb((1,), {"level": 1.0})])
        frictional = replace(robot, frictionloss=np.array([0.0, 1.0]))
        plant = Plant(frictional, [effect], nominal=frictional)
        recordings = simulate(plant, trajectories=4, duration=6.0, seed=2)
        result = examine(frictional, recordings)
        assert ("torque_gain", ("elbow",)) in named(result)

    def test_what_is_not_explained_elsewhere_is_unexplained(self):
        """The fourth recording is for scoring only: there friction is another."""
        robot, recordings = logs([Viscous((0,), {"coefficient": 4.0})])
        _, others = logs([Viscous((0,), {"coefficient": 7.0})])
        few = {"viscous", "coulomb", "armature", "torque_offset"}
        without = [*effect_classes().keys() - few]
        mixed = [*recordings[:3], others[3]]
        wrong = examine(robot, mixed, without=without).diagnosis
        assert wrong.verdict == "partly_explained"
        assert wrong.unexplained == pytest.approx((3 / 7) ** 2, rel=0.3)

    @pytest.mark.study
    def test_the_gains_are_within_their_intervals(self):
        """Eight noise seeds of a linear effect: one at most may miss at 95 %."""
        truth, hits = 0.25, 0
        for seed in range(8):
            effect = Viscous((1,), {"coefficient": truth})
            robot, recordings = logs([effect], seed=seed + 10, duration=3.0, count=3)
            result = examine(robot, recordings)
            values = [v for f in result.diagnosis.findings for v in f.parameters]
            (own,) = [v for v in values if v.name == "coefficient"]
            hits += own.interval[0] <= truth <= own.interval[1]
        assert hits >= 7

    @pytest.mark.study
    def test_a_time_is_known_no_better_than_the_clock(self):
        robot, recordings = logs([Delay((0,), {"time": 0.01})], duration=10.0)
        (finding,) = examine(robot, recordings).diagnosis.findings
        low, high = finding.parameters[0].interval
        step = np.median(np.diff(recordings[0].t))
        assert high - low > 3.9 * step / np.sqrt(12.0)

    @pytest.mark.study
    def test_a_link_may_be_far_off(self):
        """By a weight far out on it: its moments are off by many times the usual."""
        mass, centre = 0.45, np.array([0.13, -0.06, -0.11])
        moments = mass * ((centre @ centre) * np.eye(3) - np.outer(centre, centre))
        moments += 1e-3 * np.eye(3)
        order = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
        values = dict(
            zip(
                (g.name for g in LinkInertia.gains),
                [mass, *(mass * centre), *moments[order]],
                strict=True,
            )
        )
        robot = arm("coman_like")
        effect, noise = LinkInertia((0, 1, 2, 3), values), Noise.typical(robot)
        plant = Plant(robot, [effect], nominal=robot, noise=noise)
        recordings = simulate(plant, trajectories=4, duration=5.0, seed=3)
        (finding,) = examine(robot, recordings).diagnosis.findings
        assert finding.effect == "link_inertia"
        found = {p.name: p for p in finding.parameters if p.joint in robot.joints}
        for name, truth in values.items():
            low, high = found[name].interval
            assert low <= truth <= high
        assert found["mx"].value == pytest.approx(values["mx"], rel=0.02)

    @pytest.mark.study
    def test_what_motions_in_a_plane_do_not_tell_is_said_to_be_so(self):
        told = {"mass": 0.6, "mx": 0.06, "my": 0.03, "Izz": 0.015}
        rest = {"mz": 0.0, "Ixx": 0.006, "Ixy": -0.003, "Iyy": 0.01}
        robot, recordings = logs([Payload((0, 1), told | rest)])
        (finding,) = examine(robot, recordings).diagnosis.findings
        found = {v.name: v for v in finding.parameters}
        assert {k for k, v in found.items() if v.determined} == {*told}
        for name, value in told.items():
            assert found[name].interval[0] < value < found[name].interval[1]

    def test_a_dead_centre_is_told_within_half_a_turn(self):
        over = Counterbalance((0,), {"spring": 2.0, "dead_centre": 3.3})
        told = over.as_reported()
        assert told.values["dead_centre"] == pytest.approx(3.3 - 2 * np.pi)
        assert told.as_reported() is told

    @pytest.mark.study
    def test_what_repeats_once_per_turn_is_no_counterbalance(self):
        ripple = TorqueRipple((0,), {"sine": 2.0, "cosine": 3.0, "periods": 1.0})
        robot, recordings = logs([ripple])
        (finding,) = examine(robot, recordings).diagnosis.findings
        assert finding.effect == "torque_ripple"
        assert "counterbalance" in finding.alternatives

    @pytest.mark.study
    @pytest.mark.parametrize("width", [0.0, 0.03])
    def test_friction_that_differs_by_direction_is_told_as_an_offset_may_be(
        self, width
    ):
        """They differ at rest only, where no sample counts."""
        robot, recordings = logs([])
        shifted = []
        for x in recordings:
            v = np.gradient(x.q[:, 1], x.t)
            tau = x.tau.copy()
            tau[:, 1] += 0.4 * (np.abs(np.tanh(v / width)) if width else 1.0)
            shifted.append(replace(x, tau=tau))
        (finding,) = examine(robot, shifted).diagnosis.findings
        assert {*finding.alternatives} == {"torque_offset", "asymmetric_friction"}
        assert finding.joints == ("elbow",)

    @pytest.mark.study
    def test_a_notch_at_one_angle_is_no_ripple(self):
        """Nine orders evenly apart make it up, as they make up any law over a range."""
        robot, recordings = logs([])
        notched = []
        for x in recordings:
            y, tau = (x.q[:, 1] - 0.3) / 0.08, x.tau.copy()
            tau[:, 1] += 4.0 * y * np.exp(-0.5 * y**2)
            notched.append(replace(x, tau=tau))
        result = examine(robot, notched)
        assert result.diagnosis.verdict == "unexplained"
        assert result.diagnosis.where[0].joint == "elbow"

    @pytest.mark.study
    def test_three_logs_are_as_good_as_four(self):
        robot, recordings = logs([STRIBECK], count=3)
        assert named(examine(robot, recordings)) == {("stribeck", robot.joints[1:2])}

    @pytest.mark.study
    @pytest.mark.parametrize(
        ("effect", "alike"),
        [
            (
                TorqueOffset((1,), {"level": 2.0}),
                {"torque_offset", "asymmetric_friction"},
            ),
            (
                Spring((1,), {"stiffness": 0.005, "preload": 2.0}),
                {"torque_offset", "asymmetric_friction"},
            ),
            (Spring((1,), {"stiffness": 0.05, "preload": 2.0}), {"spring"}),
        ],
    )
    def test_a_law_with_a_gain_that_is_not_needed_is_no_alternative(
        self, effect, alike
    ):
        (finding,) = examine(*logs([effect])).diagnosis.findings
        assert {*finding.alternatives} == alike


class TestSilence:
    @pytest.mark.study
    @pytest.mark.parametrize("seed", range(4))
    def test_no_cause_is_named_without_a_gap(self, seed):
        robot, recordings = logs([], seed=20 + seed, duration=3.0)
        assert examine(robot, recordings).diagnosis.verdict == "no_gap"

    @pytest.mark.study
    @pytest.mark.parametrize("lag", [0.0, 0.005])
    def test_two_solvers_that_differ_at_rest_are_no_cause(self, lag):
        """Without noise, what their ways through dry friction leave is all there is."""
        robot = Robot.load(MODELS / "scara.xml")
        effects = [ActuatorLag((1,), {"time": lag})] if lag else []
        plant = Plant(robot, effects, nominal=robot, noise=Noise.none(2))
        found = examine(robot, simulate(plant, trajectories=4, duration=6.0, seed=1))
        expected = {("actuator_lag", robot.joints[1:])} if lag else set()
        assert named(found) == expected

    @pytest.mark.study
    def test_an_effect_out_of_the_library_is_unexplained(self):
        robot, recordings = logs([RIPPLE])
        diagnosis = examine(robot, recordings, without=["torque_ripple"]).diagnosis
        assert diagnosis.verdict == "unexplained"
        assert diagnosis.findings == ()
        whole = [r for r in diagnosis.where if r.variable == "link"]
        assert {r.joint for r in whole} == {"shoulder"}

    @pytest.mark.study
    def test_torque_that_wanders_at_random_is_no_noise(self):
        """It never recurs, so that no regression on other motions knows it."""
        robot, recordings = logs([], duration=8.0)
        rng, wandering = np.random.default_rng(0), []
        for recording in recordings:
            rate = 1.0 / np.median(np.diff(recording.t))
            steps = rng.standard_normal(len(recording.t))
            slow = butterworth(steps, rate=rate, cutoff=4.0)
            tau = recording.tau.copy()
            tau[:, 1] += 0.05 * np.std(tau[:, 1]) / np.std(slow) * slow
            wandering.append(replace(recording, tau=tau))
        diagnosis = examine(robot, wandering).diagnosis
        assert diagnosis.verdict == "unexplained"
        assert diagnosis.findings == ()
        whole = [r for r in diagnosis.where if r.variable == "link"]
        assert {r.joint for r in whole} == {"elbow"}

    def test_one_joint_moving_is_not_enough(self):
        robot, recordings = logs([STRIBECK])
        q = recordings[0].q.copy()
        rng = np.random.default_rng(0)
        q[:, 0] = q[0, 0] + 1e-6 * rng.standard_normal(len(q))
        diagnosis = examine(robot, [replace(recordings[0], q=q, v=None)]).diagnosis
        assert diagnosis.verdict == "not_excited"
        assert "shoulder does not move" in diagnosis.not_excited
        assert diagnosis.findings == ()

    def test_two_seconds_are_not_enough(self):
        robot, recordings = logs([STRIBECK], duration=2.0, count=1)
        diagnosis = examine(robot, recordings).diagnosis
        assert diagnosis.verdict == "not_excited"
        assert diagnosis.unexplained == 1.0
        assert any("3 s or more" in w for w in diagnosis.doubts)

    @pytest.mark.study
    def test_another_arm_is_doubted(self):
        _, recordings = logs([STRIBECK])
        robot = arm("planar")
        other = replace(
            robot, chain=replace(robot.chain, gravity=-2.5 * robot.chain.gravity)
        )
        found, said = quiet(examine, other, recordings)
        assert found.diagnosis.verdict == "partly_explained"
        assert found.diagnosis.unlike.startswith("gravity of the file")
        assert any("is the arm mounted otherwise" in w for w in found.diagnosis.doubts)
        assert any("the file's links leave" in w for w in said)

    @pytest.mark.study
    def test_a_frozen_channel_is_no_cause(self):
        robot, recordings = logs([STRIBECK])
        tau = recordings[0].tau.copy()
        tau[len(tau) // 3 :, 0] = tau[len(tau) // 3, 0]
        spoilt = [replace(recordings[0], tau=tau), *recordings[1:]]
        with pytest.warns(HybridWarning, match="frozen"):
            result = examine(robot, spoilt)
        assert named(result) == {("stribeck", ("elbow",))}
        assert any("frozen" in w for w in result.diagnosis.warnings)

    def test_a_log_whose_position_is_frozen_nearly_throughout_is_no_cause(self):
        robot, recordings = logs([STRIBECK], count=1)
        q = recordings[0].q.copy()
        q[len(q) // 25 : -len(q) // 50, 0] = q[len(q) // 25, 0]
        with pytest.warns(HybridWarning, match="frozen"):
            diagnosis = examine(robot, [replace(recordings[0], q=q, v=None)]).diagnosis
        assert diagnosis.verdict == "not_excited" and diagnosis.findings == ()
        assert any("frozen for 9" in x for x in diagnosis.warnings)

    @pytest.mark.study
    def test_a_log_that_is_frozen_throughout_does_no_harm_to_others(self):
        robot, recordings = logs([STRIBECK])
        q = recordings[0].q.copy()
        q[1:-1, 0] = q[len(q) // 2, 0]
        with pytest.warns(HybridWarning, match="frozen"):
            result = examine(
                robot, [replace(recordings[0], q=q, v=None), *recordings[1:]]
            )
        assert named(result) == {("stribeck", ("elbow",))}
        with pytest.warns(HybridWarning, match="frozen"):
            alone = examine(robot, [replace(recordings[0], q=q, v=None)]).diagnosis
        assert alone.verdict == "not_excited" and alone.findings == ()


@pytest.mark.study
def test_friction_of_a_drive_with_another_gain_is_that_of_the_joint():
    """The drive reports 70 % of its torque, and so of its friction."""
    robot, recordings = logs([Viscous((1,), {"coefficient": 2.0})])
    part = np.array([1.0, 0.7])
    told = [replace(x, tau=x.tau * part) for x in recordings]
    found = examine(robot, told).diagnosis
    values = {p.name: p for f in found.findings for p in f.parameters}
    assert {f.effect for f in found.findings} == {"viscous", "torque_gain"}
    for name, true in (("coefficient", 2.0), ("gain", -0.3)):
        low, high = values[name].interval
        assert low < true < high and values[name].value == pytest.approx(true, rel=0.1)


class TestEvents:
    @pytest.mark.study
    def test_contacts_at_times_of_their_own_in_three_of_four_recordings_are_found(self):
        robot, free = logs([])
        starts, recordings, torques = {0: 2.2, 2: 1.6, 3: 0.9}, list(free), []
        for k, start in starts.items():
            up = -9.0 if k else 9.0  # it would hardly turn a joint otherwise
            push = {"force_x": 12.0, "force_z": up, "start": start, "duration": 0.7}
            touching = logs([Contact((0, 1), push)], count=k + 1)[1][k]
            recordings[k] = touching
            during = (touching.t > start) & (touching.t < start + 0.7)
            torques.append((touching.tau - free[k].tau)[during, 0].mean())
        found = examine(robot, recordings).diagnosis
        assert [f.effect for f in found.findings] == ["contact"]
        assert found.verdict == "explained"
        starts = starts.values()
        for event, start, torque in zip(found.events, starts, torques, strict=True):
            assert event.start == pytest.approx(start, abs=0.02)
            assert event.end == pytest.approx(start + 0.7, abs=0.03)
            assert event.torque[0] == pytest.approx(torque, rel=0.05, abs=0.1)

    @pytest.mark.study
    def test_a_contact_is_found_by_its_time(self):
        push = {"force_x": 12.0, "force_z": -9.0, "start": 2.2, "duration": 0.7}
        robot, recordings = logs([Contact((0, 1), push)], duration=6.0)
        (finding,) = examine(robot, recordings).diagnosis.findings
        assert finding.effect == "contact" and finding.joints == robot.joints
        values = {p.name: p for p in finding.parameters}
        assert values["start"].value == pytest.approx(2.2, abs=0.02)
        assert values["duration"].value == pytest.approx(0.7, abs=0.03)
        assert finding.shrink["torque"].removed > 0.8

    @pytest.mark.study
    def test_a_contact_that_happened_once_is_said_to_be_unchecked(self):
        push = {"force_x": 20.0, "force_z": -20.0, "start": 1.6, "duration": 0.3}
        robot, recordings = logs([Contact((0, 1), push)], count=1, duration=12.0)
        diagnosis = examine(robot, recordings).diagnosis
        assert [f.effect for f in diagnosis.findings] == ["contact"]
        assert any("no held-out motion shows contact" in w for w in diagnosis.doubts)

    @pytest.mark.study
    @pytest.mark.parametrize("number", [0, 1])
    def test_a_contact_in_one_of_several_recordings_is_found_there(self, number):
        robot, recordings = logs([], duration=8.0)
        _, touching = logs([Contact((0, 1), PUSH)], duration=8.0)
        recordings = list(recordings)
        recordings[number] = touching[number]
        (finding,) = examine(robot, recordings).diagnosis.findings
        values = {p.name: p.value for p in finding.parameters}
        assert finding.effect == "contact" and values["recording"] == number
        assert values["start"] == pytest.approx(PUSH["start"], abs=0.02)
        assert values["duration"] == pytest.approx(PUSH["duration"], abs=0.03)

    @staticmethod
    def strongest(more, count=2):
        """Contacts in noise and more, of shape (M, 2) in units of its deviation."""
        gap = faultless().gap
        floor = np.array(faultless().diagnosis.noise_floor)
        noise = np.random.default_rng(3).standard_normal(gap.left.shape)
        left = floor * (butterworth(noise, rate=gap.rate, cutoff=gap.cutoff) + more)
        rows = [np.arange(len(left))] * 2
        found = Contacts(gap, Contact).strongest(list(left.T), rows, floor**2, count)
        return [c.values for c in found]

    def test_no_contact_is_seen_where_there_is_none(self):
        assert self.strongest(0.0) == []
        assert faultless().diagnosis.findings == ()

    @pytest.mark.parametrize("seed", range(4))
    def test_a_burst_of_noise_is_no_contact(self, seed):
        gap = faultless().gap
        burst = gap.sampled.t - gap.sampled.t.min()
        burst = np.exp(-(((burst - 3.0) / 0.4) ** 2)) * (gap.trajectory == 1)
        noise = np.random.default_rng(seed).standard_normal(gap.left.shape)
        noise = butterworth(noise, rate=gap.rate, cutoff=gap.cutoff)
        assert self.strongest(8.0 * burst[:, None] * noise) == []

    def test_what_acts_at_low_speed_only_is_no_contact(self):
        gap = faultless().gap
        v = np.abs(gap.sampled.v)
        slow = v < 0.09 * v.max(axis=0)
        early = np.arange(len(v))[:, None] < 100
        fast = 20.0 * (early & ~slow)
        assert self.strongest(fast, 1)[0]["start"] < 100 / gap.rate
        assert self.strongest(fast + 20.0 * slow, 1) == self.strongest(fast, 1)


@cache
def turned(offset, friction=0.0):
    """A plant with a turned encoder at the elbow, and logs with shoulders at rest."""
    robot, rng = arm("coman_like"), np.random.default_rng(3)
    effects = [EncoderOffset((2,), {"offset": offset})]
    effects += [Viscous((5,), {"coefficient": friction})] * (friction > 0)
    plant = Plant(robot, effects, log_rate=250.0)
    moving = np.isin(robot.joints, ("elbow", "wrist_3"))
    references = []
    for _ in range(2):
        r = random_fourier(robot, duration=6.0, rate=250.0, seed=rng, fill=0.3, order=3)
        q, v, a = (
            np.where(moving, x, y) for x, y in ((r.q, r.q[:1]), (r.v, 0.0), (r.a, 0.0))
        )
        references.append(Reference(r.t, q, v, a))
    return plant, plant.run(references, seed=rng)


@pytest.mark.study
@pytest.mark.filterwarnings("ignore::hybrid.errors.HybridWarning")  # joints at rest
def test_the_motion_that_is_advised_tells_at_which_of_two_joints_it_is(tmp_path):
    robot, (plant, recordings) = arm("coman_like"), turned(0.02)
    rng = np.random.default_rng(1)
    advice = advise(examine(robot, recordings), rng, directory=tmp_path)
    both = "encoder offset at shoulder or encoder offset at elbow"
    (telling,) = (x for x in advice if both in x.experiment)
    table = np.loadtxt(tmp_path / telling.file, delimiter=",", skiprows=1)
    table = table[table[:, 0] < 6.0]  # which is enough
    asked = Reference(table[:, 0], *np.split(table[:, 1:], 3, axis=1))
    more = plant.run([asked], seed=rng)
    assert named(examine(robot, [*recordings, *more])) == {
        ("encoder_offset", ("elbow",))
    }


@pytest.mark.study
@pytest.mark.parametrize(("joint", "gain"), [(0, 0.15), (1, 0.15), (1, -0.2)])
def test_a_gain_that_is_not_known_is_no_saturation(joint, gain):
    """A limit below nearly all torques, and a dead zone below it, make up a gain."""
    robot, recordings = logs([TorqueGain((joint,), {"gain": gain})])
    result = examine(robot, recordings, without=[TorqueGain.id])
    assert result.diagnosis.findings == ()


@pytest.mark.study
def test_a_log_with_holes_counts_as_several():
    robot, recordings = logs([Viscous((0,), {"coefficient": 1.0})], count=2)
    first, *rest = recordings
    kept = (first.t < 2.0) | (first.t > 2.4)
    holed = Recording(
        first.t[kept], **{name: x[kept] for name, x in first.channels.items()}
    )
    with pytest.warns(HybridWarning, match="taken as 2 recordings"):
        result = examine(robot, [holed, *rest])
    assert len(result.gap.motions) == 3
    assert named(result) == {("viscous", robot.joints[:1])}


class TestDrives:
    """Drives that are asked for more than they give, by a controller of their own."""

    @staticmethod
    def log(deliver, seed):
        """Joint log of a pendulum under PD control through a drive, 1 kHz, 8 s."""
        robot = arm("planar")
        rng = np.random.default_rng(seed)
        reference = random_fourier(robot, duration=8.0, rate=1000.0, seed=rng)
        model = robot.mujoco_spec().compile()
        model.opt.timestep = 0.0005
        data = mujoco.MjData(model)
        data.qpos[:] = reference.q[0]
        full = np.zeros((2, 2))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        kp, kd = 900.0 * np.diag(full), 48.0 * np.diag(full)
        v = np.gradient(reference.q, 0.001, axis=0)
        q, tau = np.zeros((2, *reference.q.shape))
        for k, (target, speed) in enumerate(zip(reference.q, v, strict=True)):
            q[k] = data.qpos
            tau[k] = kp * (target - data.qpos) + kd * (speed - data.qvel)
            data.qfrc_applied[:] = deliver(tau[k])
            mujoco.mj_step(model, data, 2)
        q += 1e-5 * rng.standard_normal(q.shape)
        tau += 0.01 * tau.std(axis=0) * rng.standard_normal(tau.shape)
        return Recording(reference.t, q, tau=tau, joints=robot.joints)

    def named_of(self, deliver):
        recordings = [self.log(deliver, seed) for seed in range(4)]
        (finding,) = examine(arm("planar"), recordings).diagnosis.findings
        return finding, {p.name: p.value for p in finding.parameters}

    @pytest.mark.study
    @pytest.mark.filterwarnings("ignore:.*times the rating")  # it winds up
    @pytest.mark.parametrize("part", [0.8, 0.5, 0.4])
    def test_what_clips_is_a_saturation_at_its_limit(self, part):
        limit = part * np.abs(self.log(lambda x: x, 0).tau[:, 1]).max()
        bounds = np.array([np.inf, limit])
        finding, values = self.named_of(lambda x: np.clip(x, -bounds, bounds))
        assert finding.effect == "saturation" and finding.joints == ("elbow",)
        assert values["limit"] == pytest.approx(limit, rel=0.03)
        assert values["loss"] == pytest.approx(1.0, abs=0.05)
        assert set(values) == {"loss", "limit"}

    @pytest.mark.study
    def test_what_passes_nothing_small_is_a_dead_zone_of_its_width(self):
        width = np.array([0.0, 0.1 * np.abs(self.log(lambda x: x, 0).tau[:, 1]).max()])
        finding, values = self.named_of(
            lambda x: np.sign(x) * np.maximum(np.abs(x) - width, 0.0)
        )
        assert finding.effect == "deadzone" and finding.joints == ("elbow",)
        assert values["width"] == pytest.approx(width[1], rel=0.03)
        assert set(values) == {"width"}


class TestMakeshifts:
    @staticmethod
    def played():
        """An arm, and its logs with play in the first joint."""
        robot = Robot.load(MODELS / "scara.xml")
        play = Backlash((0,), {"half_width": 0.0007})
        plant = Plant(robot, [play], nominal=robot)
        return robot, simulate(plant, trajectories=4, duration=8.0, seed=3)

    @pytest.mark.study
    def test_two_effects_that_undo_one_another_are_not_named(self):
        """A payload and a delay made up for play if nothing else might."""
        blind = examine(*self.played(), without=["backlash"]).diagnosis
        assert blind.verdict == "unexplained" and blind.findings == ()

    @pytest.mark.study
    def test_play_is_named_with_its_width(self):
        robot, recordings = self.played()
        (finding,) = examine(robot, recordings).diagnosis.findings
        assert (finding.effect, finding.joints) == ("backlash", robot.joints[:1])
        assert finding.parameters[0].value == pytest.approx(0.0007, rel=0.15)


@pytest.mark.study
def test_units_are_those_of_a_joint_that_slides(tmp_path):
    """Friction of a lift is a force, and the replay misses it by metres."""
    path = tmp_path / "lift.xml"
    path.write_text(LIFT)
    robot = Robot.load(path)
    plant = Plant(robot, [Viscous((1,), {"coefficient": 40.0})], nominal=robot)
    recordings = simulate(plant, trajectories=4, duration=4.0, seed=1)
    result = with_motion_gap(examine(robot, recordings), np.random.default_rng(0))
    (finding,) = result.diagnosis.findings
    (value,) = finding.parameters
    assert value.unit == "N·s/m"
    assert value.interval[0] < 40.0 < value.interval[1]
    assert {k: s.unit for k, s in finding.shrink.items()} == {
        "torque": "N", "motion": "m",
    }  # fmt: skip
    assert result.diagnosis.units == ("N·m", "N")
    assert "\u00a0N (noise" in "\n".join(verdict_lines(result.diagnosis))
