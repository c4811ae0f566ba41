"""How far the motion gap shrinks when an effect is added to the simulator."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse import Plant
from simulated import arm

from hybrid.diagnosis.answer import replay as replaying
from hybrid.diagnosis.answer.motion_gap import (
    motion_shrink,
    rollout_agrees,
    step_warning,
)
from hybrid.diagnosis.answer.replay import HORIZONS, Replay, windows_of
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.explanations.explanation import explain
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.measure import measure_gap, split
from hybrid.effects import effect_classes
from hybrid.plant import Noise, random_fourier
from hybrid.plant.rollout import Windows, rollout
from hybrid.plant.scale import joint_scales

# At the elbow; what the arm as a whole has at its usual joints.
EFFECTS = [
    "actuator_lag", "armature", "backlash", "coulomb", "delay", "elasticity",
    "encoder_eccentricity", "encoder_offset", "gravity_tilt", "load_friction",
    "payload", "presliding", "saturation", "spring", "torque_gain", "torque_ripple",
    "transmission_coupling",
]  # fmt: skip
# So large that they show in the motion of an arm that gravity does not load.
LARGE = {
    "backlash": {"half_width": 0.01},
    "elasticity": {"compliance": 0.01},
    "saturation": {"limit": 2.0},
}


def effect_of(name, joint=1, **values):
    robot, cls = arm("planar"), effect_classes()[name]
    joints = (joint,) if cls.scope == "joint" else (0, 1)
    return cls.typical(joints, joint_scales(robot), **LARGE.get(name, {}) | values)


@cache
def logs(effects, noisy=False, trajectories=4, fundamental=None):
    robot, rng = arm("planar"), np.random.default_rng(4)
    references = [
        random_fourier(
            robot, duration=6.0, rate=500.0, seed=rng, fundamental=fundamental
        )
        for _ in range(trajectories)
    ]
    noise = None if noisy else Noise.none(robot.size)
    present = [effect_of(name) for name in effects]
    plant = Plant(robot, present, nominal=robot, noise=noise)
    return tuple(plant.run(references, seed=rng))


@cache
def explained(effects, terms, noisy=False, trajectories=4, fundamental=None):
    """An explanation with some terms, fitted; no search."""
    recordings = logs(effects, noisy, trajectories, fundamental)
    gap = measure_gap(arm("planar"), recordings, cutoff=40.0)
    learn = split(gap)
    search = Search(gap, learn, without=list(effect_classes()))
    search.evidence.scale_prior(search.background, 0.003)
    search.causes = [search.cause(candidate(gap, effect_of(name))) for name in terms]
    return explain(search)


def as_it_stands(scored):
    """Without any correction of the simulator's own numbers."""
    return replace(scored, gains=np.zeros_like(scored.gains))


def error(replay, effects):
    return float(np.median(np.sqrt(replay.squares_of(effects).mean(axis=1))))


def test_the_true_plant_repeats_its_motion_under_its_own_torque():
    replay = Replay(as_it_stands(explained((), ())))
    swing = np.ptp(np.concatenate([m.q for m in replay.motions]), axis=0).max()
    assert error(replay, []) < 3e-4 * swing


@pytest.mark.study
@pytest.mark.parametrize("name", EFFECTS)
def test_the_true_effect_removes_the_motion_gap(name):
    replay = Replay(as_it_stands(explained((name,), ())))
    before, after = error(replay, []), error(replay, [effect_of(name)])
    still = error(Replay(as_it_stands(explained((), ()))), [])
    assert before > 2 * still, "the effect shows in motion"
    assert after - still < 0.1 * before


def test_a_replay_starts_with_a_spring_where_it_swings():
    """Not where its load alone would hold it, which may be worse than no spring."""
    swung = as_it_stands(explained(("elasticity",), (), fundamental=1.0))
    replay = Replay(swung)
    assert error(replay, [effect_of("elasticity")]) < 0.5 * error(replay, [])


@pytest.mark.study
@pytest.mark.parametrize("name", ["coulomb", "payload", "torque_ripple"])
def test_a_fitted_effect_removes_nine_tenths_on_motions_it_was_not_fitted_on(name):
    replay = Replay(explained((name,), (name,)))
    s = motion_shrink(replay, [0], np.random.default_rng(0))
    assert s.horizon_s == 0.5
    assert s.removed == pytest.approx(1 - s.after / s.before)
    assert s.removed > 0.9
    assert s.interval[0] <= s.removed <= s.interval[1]
    assert rollout_agrees(replay, 0, np.random.default_rng(0)) is True
    assert step_warning(replay) == []


@pytest.mark.study
def test_with_noise_the_gap_still_shrinks_and_windows_are_not_seen_in_fitting():
    scored = explained(("coulomb",), ("coulomb",), noisy=True)
    replay = Replay(scored)
    assert motion_shrink(replay, [0], np.random.default_rng(0)).removed > 0.8
    learn = split(scored.gap)
    seen = {
        m.source
        for r, m in enumerate(scored.gap.motions)
        if learn[scored.gap.trajectory == r].any()
    }
    assert seen.isdisjoint(m.source for m in replay.motions)


@pytest.mark.study
def test_blocks_of_one_log_are_replayed_where_none_was_learnt_from():
    scored = explained(("coulomb",), ("coulomb",), trajectories=1)
    replay, learn = Replay(scored), split(scored.gap)
    (motion,) = replay.motions
    assert len(motion.t) == len(learn)
    assert len(replay.windows.sample) >= 3
    for sample in replay.windows.sample:
        assert not learn[sample : sample + replay.windows.samples].any()


def test_terms_are_told_apart_by_what_each_removes():
    both = ("coulomb", "payload")
    replay, rng = Replay(explained(both, both)), np.random.default_rng(0)
    together = motion_shrink(replay, [0, 1], rng)
    assert together.removed > 0.95
    for k in (0, 1):
        assert motion_shrink(replay, [k], rng).removed > 0.8


@pytest.mark.study
def test_a_term_that_is_not_there_does_not_pass():
    replay = Replay(explained(("coulomb",), ("coulomb",)))
    wrong = effect_of("armature", inertia=2.0)
    rivals = [replay.effects[0]]
    assert rollout_agrees(replay, 0, np.random.default_rng(0)) is True
    assert error(replay, [*rivals, wrong]) > 3 * error(replay, rivals)


@pytest.mark.study
def test_only_windows_count_in_which_a_term_acts():
    scored = explained(("contact",), ("contact",))
    replay = Replay(scored)
    pick = replay.windows_with([0])
    t = [
        replay.motions[m].t[k] - replay.motions[m].t[0]
        for m, k in zip(
            replay.windows.motion[pick], replay.windows.sample[pick], strict=True
        )
    ]
    assert len(pick) < len(replay.windows.sample)
    assert all(0.4 < x < 1.6 for x in t)  # it lasts from 1 to 1.5 s


def test_a_replay_that_diverges_ends_as_lost():
    scored = as_it_stands(explained((), ()))
    replay = Replay(scored)
    wild = effect_of("spring", stiffness=-2e4)
    shown = rollout(arm("planar"), [wild], replay.motions, replay.windows)
    assert np.isnan(shown[-1]).any()
    assert np.isfinite(replay.squares_of([wild])).all()


@pytest.mark.study
@pytest.mark.parametrize(("stable", "chosen"), [(1.0, 1e-3), (2e-4, 1e-4), (0.0, 1e-3)])
def test_the_step_is_one_with_which_nothing_diverges(monkeypatch, stable, chosen):
    """If none is, that is not the step's fault."""

    def unstable(*given, step):
        shown = rollout(*given, step=step)
        return shown if step <= stable else np.full_like(shown, np.nan)

    monkeypatch.setattr(replaying, "rollout", unstable)
    replay = Replay(explained(("coulomb",), ("coulomb",)))
    assert replay.step == chosen
    lost = np.allclose(replay.squares_of(replay.effects), np.pi**2)
    assert lost == (stable == 0.0)


def test_short_stretches_are_replayed_for_a_tenth_of_a_second():
    rate = explained((), ()).gap.rate
    usable = np.arange(round(10 * rate)) % round(5 * rate) < 0.4 * rate  # twice 0.4 s
    horizon, windows = windows_of([usable], rate)
    assert horizon == HORIZONS[1] == 0.1
    inside = usable[windows.sample[:, None] + np.arange(windows.samples + 1)]
    assert inside.all()
    assert np.diff(windows.sample).min() >= windows.samples
    assert windows_of([usable[: round(0.25 * rate)]], rate)[0] is None


def test_windows_hold_the_last_sample_where_a_motion_ends():
    x = np.arange(5.0)[:, None]
    windows = Windows(np.array([0]), np.array([3]), 3)
    np.testing.assert_array_equal(windows.of([x])[:, 0, 0], [3.0, 4.0, 4.0, 4.0])
