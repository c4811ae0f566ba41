"""Advice by its parts, on pendulums without geometry: each takes no time to check."""

import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from pendulum import gap_of, pendulum
from simulated import arm

from hybrid.diagnosis.advice import menu as menu_module
from hybrid.diagnosis.advice.advise import (
    Plan,
    _caution,
    _discrimination,
    _for_not_excited,
    _for_servos,
    _for_unexplained,
    _for_unforetold,
    _placed,
    choose,
)
from hybrid.diagnosis.advice.menu import (
    Experiment,
    Menu,
    concatenated,
    gap_along,
    with_payload,
)
from hybrid.diagnosis.advice.separation import (
    Discrimination,
    decimated,
    fit_rival,
    joined,
    required_evidence,
    tried_shapes,
)
from hybrid.diagnosis.answer.diagnosis import Advice
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.shapes import shape_derivatives
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.background import (
    background,
    friction_near_rest,
    sampling_delays,
)
from hybrid.diagnosis.gap.measure import split
from hybrid.dynamics import simulated_torque
from hybrid.effects import effect_classes
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.effects.viscous import Viscous
from hybrid.errors import ExcitationError, HybridError
from hybrid.plant.reference import Reference
from hybrid.robot.spatial import central_inertia

KEPT = "duration", "fill", "fundamental", "hold", "longest"


def path(seconds=4.0, rate=100.0, speed=1.0, size=1):
    """A sine wave of some speed."""
    t = np.arange(round(seconds * rate) + 1) / rate
    q, v, a = np.sin(t), np.cos(t), -np.sin(t)
    return Reference(t, *(np.tile(speed * x[:, None], (1, size)) for x in (q, v, a)))


@cache
def menu():
    slow = replace(pendulum(2), v_max=np.array([1.0, 1.0]))
    return Menu(slow, np.random.default_rng(0), rate=50.0)


# --- motions --------------------------------------------------------------------------


def test_motions_one_after_the_other_share_the_sample_where_they_meet():
    one, two = path(1.0), path(2.0)
    whole = concatenated([one, two, one])
    assert whole.t[-1] == pytest.approx(4.0) and len(whole.t) == 401
    np.testing.assert_allclose(np.diff(whole.t), 0.01)
    for name in "qva":
        parts = [getattr(x, name) for x in (one, two, one)]
        joined = np.concatenate([parts[0], parts[1][1:], parts[2][1:]])
        np.testing.assert_array_equal(getattr(whole, name), joined)
    assert concatenated([one]) is one


def test_a_motion_is_plain_where_nothing_has_to_be_prepared():
    plain = Experiment("x", path())
    assert plain.plain and plain.arm(pendulum()) is pendulum()
    assert not replace(plain, start=1200.0).plain and not replace(plain, mass=1.0).plain
    assert not replace(plain, gains=True).plain
    carried = replace(plain, mass=1.0).arm(pendulum())
    assert carried.chain.inertial[0, 0] == 3.0


def test_a_payload_is_a_point_at_the_centre_of_the_last_link():
    """The centre stays, and about it nothing is added."""
    x, y, z = centre = np.array([0.1, -0.2, 0.3])
    about = np.diag([0.02, 0.03, 0.04])
    own = about + 3.0 * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    six = own[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    inertial = pendulum(2).chain.inertial.copy()
    inertial[1] = [3.0, 3 * x, 3 * y, 3 * z, *six]
    heavy = with_payload(pendulum(2).with_inertial(inertial), 0.5).chain.inertial
    np.testing.assert_array_equal(heavy[0], inertial[0])
    mass, at, rest = central_inertia(heavy[1])
    assert mass == 3.5
    np.testing.assert_allclose(at, centre)
    np.testing.assert_allclose(rest, about, atol=1e-12)


def test_a_link_without_mass_carries_at_its_origin():
    inertial = pendulum(1).chain.inertial.copy()
    inertial[0] = 0.0
    heavy = with_payload(pendulum(1).with_inertial(inertial), 0.5).chain.inertial
    np.testing.assert_allclose(heavy[0], [0.5, *np.zeros(9)])


def menu_with(**known):
    """A menu for one joint, with some of its properties."""
    made = Menu(pendulum(), np.random.default_rng(0), rate=50.0)
    made.__dict__.update(known)
    return made


def test_an_envelope_of_an_arm_without_geometry_is_its_limits():
    envelope = menu_with()
    assert envelope.clearance is None
    assert envelope.limits.high == pytest.approx([1.6])  # 80 % of two radians
    slow, fast = path(speed=0.5), path(speed=9.0)
    assert envelope.checked(slow) is slow
    with pytest.raises(ExcitationError):
        envelope.checked(fast)


def test_the_first_safe_try_of_twelve_is_taken():
    envelope, tried = menu_with(), []

    def make(k):
        tried.append(k)
        return path(speed=0.5 if k == safe else 9.0)

    safe = 11
    assert envelope.first_safe(make).v[0, 0] == 0.5 and tried == list(range(12))
    safe, tried = 12, []
    with pytest.raises(ExcitationError):
        envelope.first_safe(make)
    assert tried == list(range(12))


def test_an_arm_with_a_payload_is_checked_with_it():
    envelope, slow = menu_with(), path(speed=0.5)
    heavy = with_payload(pendulum(), 60.0)
    with pytest.raises(ExcitationError, match="torque"):
        envelope.checked(slow, heavy)
    with pytest.raises(ExcitationError, match="torque"):
        envelope.first_safe(lambda _: slow, heavy)


def test_only_postures_that_differ_are_checked_and_the_closest_links_named():
    asked = []

    def excess(at):
        asked.append(len(at.t))
        return np.column_stack([at.q[:, 0] - limit, at.q[:, 0] - 2 * limit])

    clearance = SimpleNamespace(pairs=[(0, 1)], names=("a", "b"), excess=excess)
    envelope = menu_with(clearance=clearance)
    limit, slow = 0.6, path(speed=0.5)
    assert envelope.checked(slow) is slow
    limit = 0.4
    with pytest.raises(ExcitationError, match="^a; valid is a motion with more room"):
        envelope.checked(slow)
    # Half a radian to either side, in steps of a hundredth.
    assert asked[0] == len(np.unique(np.round(slow.q / 0.01))) < 100
    none = menu_with(clearance=SimpleNamespace(pairs=[], excess=None))
    assert none.checked(slow) is slow


def test_a_menu_is_of_a_joint_and_of_all_joints():
    about = menu().about(1)
    assert menu().about(1)[0] is about[0]  # made once
    assert [x.name for x in about[:2]] == [
        "a ladder of speeds of hinge_1, up and down", "small reversals of hinge_1",
    ]  # fmt: skip
    for experiment in about[:2]:
        v = experiment.reference.v
        assert not v[:, 0].any() and v[:, 1].any()
        assert experiment.reference.rate == pytest.approx(50.0, rel=1e-3)
    every = about[2:]
    assert every == menu().of_all_joints and len(every) == 7
    short, long = about[0].reference, menu().ladder(1)[0].reference
    assert short.t[-1] < long.t[-1]
    # The same speeds, each for half the time.
    np.testing.assert_allclose(short.v.max(), long.v.max(), rtol=0.05)


def test_the_prepared_experiments_say_what_they_need():
    *_, warm, halved, heavy = menu().of_all_joints
    assert (warm.start, warm.mass, warm.gains) == (1200.0, 0.0, False)
    assert "after 20 minutes of work" in warm.name
    assert (halved.start, halved.mass, halved.gains) == (0.0, 0.0, True)
    assert (heavy.start, heavy.mass, heavy.gains) == (0.0, 1.0, False)
    assert "a known mass of 1 kg at the last link" in heavy.name
    for experiment in (warm, halved, heavy):
        assert experiment.reference.t[-1] == pytest.approx(20.0, abs=0.1)


def test_a_payload_is_half_of_a_link_or_less_until_it_can_be_carried():
    """Each try is half of the one before, of the median link, to one digit."""
    for most, mass in ((np.inf, 1.0), (0.8, 0.5), (0.4, 0.2), (0.1, None)):
        made = Menu(pendulum(2), np.random.default_rng(0), rate=50.0)
        asked = []

        def if_safe(
            name, make, *, start=0.0, mass=0.0, gains=False, most=most, asked=asked
        ):
            asked.append(mass)
            return (Experiment(name, path(), start, mass, gains),) * (mass <= most)

        made._if_safe = if_safe
        found = made._prepared()
        assert [x.mass for x in found] == [0.0, 0.0, *([mass] if mass else [])]
        assert asked[2:] == [x for x in (1.0, 0.5, 0.2) if not mass or x >= mass]
    light = pendulum(2).with_inertial(0.0 * pendulum(2).chain.inertial)
    made = Menu(light, np.random.default_rng(0), rate=50.0)
    made._if_safe = lambda *_, **__: ("x",)
    assert made._prepared() == ("x", "x")


def test_an_experiment_that_is_not_safe_is_not_on_the_menu():
    weak = replace(pendulum(), tau_max=np.array([0.01]))
    assert Menu(weak, np.random.default_rng(0), rate=50.0).of_all_joints == ()


def test_tries_are_smaller_and_their_postures_are_within_the_range():
    sizes = []
    for k in (0, 1, 2):
        made = Menu(pendulum(2), np.random.default_rng(3), rate=50.0)
        sizes.append(np.ptp(made._path(10.0, 0.5, k).q))
    assert sizes[1] / sizes[0] == pytest.approx(0.85)
    assert sizes[2] / sizes[0] == pytest.approx(0.85**2)
    assert menu()._posture(0) is None
    some = np.array([menu()._random_posture(0.5) for _ in range(200)])
    # Limits of ±2 and 80 % of the range; half of this about the middle.
    assert 0.75 < np.abs(some).max() <= 0.8 + 1e-12
    np.testing.assert_array_equal(menu()._random_posture(0.0), [0.0, 0.0])


def test_poses_are_eight_and_the_first_again_or_at_least_four():
    for most, count in ((20, 9), (8, 9), (5, 6), (4, 5), (3, None)):
        made = Menu(pendulum(2), np.random.default_rng(0), rate=50.0)
        seen = []

        def checked(move, robot=None, most=most, seen=seen):
            # Two moves of each pose: to it, and from it to the first.
            if len(move.q) > 6:
                seen.append(1)
            if (len(seen) + 1) // 2 >= most:
                raise HybridError("no room")
            return move

        made.first_safe, made.checked = (lambda make: make(0)), checked
        if count is None:
            with pytest.raises(HybridError, match="too few poses"):
                made._poses()
            continue
        poses = made._poses()
        assert len(poses) == count
        np.testing.assert_array_equal(poses[0], poses[-1])
        np.testing.assert_array_equal(poses[0], [0.0, 0.0])
        assert np.abs(poses).max() <= 0.85 * 1.6


# --- a gap along a motion -------------------------------------------------------------


def test_a_gap_along_a_motion_leaves_out_its_ends_and_where_it_stands():
    known = replace(gap_of(size=2, noise=0.0), cutoff=10.0)
    ahead = gap_along(known, Experiment("x", path(6.0, 100.0, size=2)))
    (motion,) = ahead.motions
    assert ahead.cutoff == 10.0 and motion.rate == pytest.approx(100.0)
    inner = (motion.t > 0.2 - 1e-9) & (motion.t < motion.t[-1] - 0.2 + 1e-9)
    np.testing.assert_array_equal(motion.mask, inner)
    tau = simulated_torque(known.robot, motion, ahead.bodies[0])
    np.testing.assert_array_equal(motion.tau, tau)
    fastest = np.abs(known.sampled.v).max(axis=0)
    factor = ahead.samplers[0].factor
    moves = np.abs(motion.v[::factor]) > 0.01 * fastest
    kept = ahead.samplers[0].keep(motion.mask)
    np.testing.assert_array_equal(ahead.moving, moves & kept[:, None])
    assert ahead.left.shape == ahead.moving.shape and not ahead.left.any()
    assert not ahead.fold.any() and not ahead.trajectory.any()
    assert motion.temperature is None


@pytest.mark.parametrize("rate", [1000.0, 99.0, 20.0])
def test_a_gap_along_a_motion_has_as_many_samples_a_second_as_the_recordings(rate):
    known, t = gap_of(noise=0.0), np.linspace(0.0, 6.0, round(6 * rate) + 1)
    q, v, a = np.sin(t), np.cos(t), -np.sin(t)
    reference = Reference(t, *(x[:, None] for x in (q, v, a)))
    ahead = gap_along(known, Experiment("x", reference))
    assert ahead.cutoff == known.cutoff and ahead.period == known.period
    (motion,), rate = ahead.motions, known.motions[0].rate
    assert ahead.rate == pytest.approx(known.rate)
    assert motion.rate == pytest.approx(rate) and rate > known.rate
    assert 6.0 - 1.01 / rate < motion.t[-1] <= 6.0
    for seen, true in ((motion.q, np.sin), (motion.v, np.cos)):
        np.testing.assert_allclose(seen[:, 0], true(motion.t), atol=1e-5)
    np.testing.assert_allclose(motion.a[:, 0], -np.sin(motion.t), atol=1e-3)


def test_warm_drives_are_twenty_kelvin_above_the_log_and_cold_ones_as_at_its_start():
    known = gap_of(noise=0.0, count=1)
    (m,) = known.motions
    log = replace(m, temperature=np.linspace(25.0, 40.0, len(m.t))[:, None])
    known = replace(known, motions=(log,))
    hottest = known.sampled.temperature.max()
    for start, warm in ((0.0, 25.0), (1200.0, hottest + 20.0)):
        ahead = gap_along(known, Experiment("x", path(), start=start))
        assert ahead.motions[0].t[0] == start
        np.testing.assert_allclose(ahead.motions[0].temperature, warm)
        assert ahead.motions[0].temperature.shape == ahead.motions[0].q.shape


def test_decimated_motions_keep_the_samples_of_the_gap():
    gap = gap_of(size=2)
    few = decimated(gap)
    for m, (motion, _, sampler) in zip(few.motions, gap, strict=True):
        assert sampler.factor == 2
        np.testing.assert_array_equal(m.t, motion.t[::2])
    assert [len(b.load) for b in few.bodies] == [len(m.t) for m in few.motions]


def test_joined_gaps_have_the_columns_of_both():
    one = gap_of(Viscous((0,), {"coefficient": 0.5}), size=2)
    other = gap_along(one, Experiment("x", path(6.0, 100.0, size=2)))
    whole = joined(one, other)
    assert (whole.rate, whole.cutoff) == (one.rate, one.cutoff)
    for name in ("left", "moving", "fold"):
        both = np.concatenate([getattr(x, name) for x in (one, other)])
        np.testing.assert_array_equal(getattr(whole, name), both)
    assert np.unique(whole.trajectory).tolist() == [0, 1, 2, 3, 4]
    for effect in (Coulomb((1,)), TorqueGain((0,), {"gain": 0.1})):
        ((j, found),) = whole.columns(effect).items()
        both = np.concatenate([x.columns(effect)[j] for x in (one, other)])
        np.testing.assert_allclose(found, both, atol=1e-9)


# --- separation -----------------------------------------------------------------------


def two_laws(*kept):
    """A search whose causes are dry friction and an offset, and its two terms."""
    true = Coulomb((0,), {"level": 1.0}), TorqueOffset((0,), {"level": -1.0})
    gap, kept = gap_of(*true), {x.id for x in (*true, *kept)}
    found = Search(gap, split(gap), [x for x in effect_classes() if x not in kept])
    found.causes = [found.cause(candidate(gap, x)) for x in true]
    return found, found.terms


def test_rivals_are_apart_by_what_the_other_cannot_make_good():
    """The same as by all columns along the motion, written out."""
    search, (term, offset) = two_laws(Viscous, Stribeck)
    ahead = gap_along(search.gap, Experiment("x", path()))
    (rows,), noise = map(np.flatnonzero, ahead.moving.T), search.evidence.noise[0]
    blocks = [b for f in (background, friction_near_rest, sampling_delays)
              for b in f(ahead)[0]]  # fmt: skip
    blocks.append(ahead.columns(offset.candidate.effect))
    law, slow = Viscous((0,)), Stribeck((0,), {"velocity": 0.3})
    rivals, made = [], []
    for effect in (law, slow):
        rival = fit_rival(search, term, candidate(search.gap, effect))
        own = [ahead.columns(effect), *shape_derivatives(ahead, rival.effect)]
        X = np.hstack([x[0][rows] for x in (*blocks, *own)]) / np.sqrt(noise)
        rivals.append(rival)
        made.append((X, X @ rival.gains, rival.precision))
    difference, left = made[0][1] - made[1][1], []
    for X, _, precision in made:
        b = X.T @ difference
        left.append(
            difference @ difference - b @ np.linalg.solve(X.T @ X + precision, b)
        )
    view = Discrimination(search, ahead, None)
    apart = view.separation(*rivals)
    assert apart == pytest.approx(np.sqrt(min(left))) and apart > 1.0
    assert view.separation(*rivals[::-1]) == pytest.approx(apart)
    assert view.separation(rivals[0], rivals[0]) == pytest.approx(0.0, abs=1e-4)


def test_a_motion_says_more_together_with_the_recordings_than_alone():
    search, (term, _) = two_laws(Viscous)
    ahead = gap_along(search.gap, Experiment("x", path()))
    rivals = [
        fit_rival(search, term, candidate(search.gap, x((0,))))
        for x in (Coulomb, Viscous)
    ]
    alone, both = (
        Discrimination(search, ahead, x).contrast(*rivals) for x in (None, search.gap)
    )
    assert 1.0 < alone[0] < both[0] and 1.0 < alone[1]


@pytest.mark.parametrize(
    ("effect", "cost"),
    [(Coulomb((0,)), 0.0), (Stribeck((0,), {"velocity": 0.3}), 4.0)],
)
def test_a_rival_has_the_evidence_of_its_effect_beside_all_others(effect, cost):
    at, (term, other) = two_laws(Viscous)
    gap = at.gap
    found = fit_rival(at, term, candidate(gap, effect))
    base = np.concatenate([at.rigid, other.index])
    (own,) = at.evidence.add([gap.columns(effect)], [candidate(gap, effect).std])
    both = at.evidence.solve(np.concatenate([base, own]))
    alone = at.evidence.solve(base).evidence
    assert found.evidence == pytest.approx(both.evidence - alone - cost)
    (level,) = found.effect.gain_values
    assert level == pytest.approx(both.gains[-1]) and len(found.others) == 1
    np.testing.assert_allclose(found.prior, at.evidence.precision[base])
    shapes = len(effect.shapes)
    np.testing.assert_allclose(found.gains, [*both.gains, *np.zeros(shapes)])
    assert found.precision.shape == (len(base) + 1 + shapes,) * 2
    A, _ = at.evidence.normal(np.concatenate([base, own]))
    inner = found.precision[: len(A), : len(A)]
    prior = np.diag(at.evidence.precision[both.index])
    np.testing.assert_allclose(inner - A, prior, atol=1e-6)


def test_evidence_that_is_required_is_twenty_to_one_or_three_percent():
    assert required_evidence(0.0) == pytest.approx(np.log(20.0))
    assert required_evidence(90.0) == pytest.approx(np.log(20.0))
    assert required_evidence(1000.0) == pytest.approx(30.0)


def test_long_waves_are_tried_besides_those_that_a_search_tried():
    gap = gap_of()
    wave = candidate(gap, TorqueRipple((0,), {"periods": 40.0}))
    plain = candidate(gap, Coulomb((0,)))
    pool = SimpleNamespace(tried=[SimpleNamespace(candidate=x) for x in (plain, wave)])
    found = tried_shapes(SimpleNamespace(pool=pool))
    assert found[:2] == [plain, wave] and len(found) == 8
    assert [c.effect.values["periods"] for c in found[2:]] == [1, 2, 3, 4, 5, 6]
    assert all(c.std is wave.std for c in found[2:])


# --- the choice -----------------------------------------------------------------------


NAMED = ("one", "two", "three", "heavy")


def experiments():
    plain = [Experiment(x, path(10.0)) for x in NAMED[:3]]
    return [*plain, Experiment("heavy", path(), mass=1.0)]


class Foreseen:
    """Separations and contrasts by the name of an experiment."""

    def __init__(self, menu, **told):
        self.menu, self.told, self.asked = menu, told, []

    def about(self, joint):
        return self.menu

    def tell(self, experiment):
        size, *told = self.told.get(experiment.name, (0.0, 0.0, 0.0))

        def contrast(*_):
            self.asked.append(experiment.name)
            return told

        return SimpleNamespace(separation=lambda *_: size, contrast=contrast)


def chosen_of(foreseen, *given):
    return choose(foreseen, foreseen.tell, *given)


def named(name):
    return SimpleNamespace(id=name)


RIVALS = tuple(
    SimpleNamespace(effect=named(x), evidence=0.0) for x in ("coulomb", "viscous")
)


def test_the_most_telling_of_those_that_tell_is_chosen():
    listed, chosen = experiments(), []
    told = {"one": (9.0, 1.3, 1.4), "two": (8.0, 2.0, 1.5), "three": (7.0, 9.0, 1.1)}
    plan = chosen_of(Foreseen(listed, **told), (0,), RIVALS, chosen)
    assert plan.experiment is listed[1] and chosen == [listed[1]]
    assert plan.advice == Advice("run two (10 s)", ("coulomb", "viscous"), 8.0)


@pytest.mark.parametrize(("contrast", "enough"), [(1.19, False), (1.21, True)])
def test_the_required_evidence_is_exceeded_by_a_fifth(contrast, enough):
    foreseen = Foreseen(experiments(), one=(9.0, contrast, contrast))
    found = chosen_of(foreseen, (0,), RIVALS, [])
    assert (found is not None) == enough


@pytest.mark.parametrize(("size", "asked"), [(1.08, []), (1.11, ["one"])])
def test_an_experiment_that_separates_too_little_is_not_worked_out(size, asked):
    """Half its square is at most a fifth of log 20."""
    foreseen = Foreseen(experiments(), one=(size, 9.0, 9.0))
    chosen_of(foreseen, (0,), RIVALS, [])
    assert foreseen.asked == asked


def test_four_are_worked_out_and_the_rest_only_where_none_tells():
    many = [Experiment(f"x{k}", path()) for k in range(6)]
    told = {f"x{k}": (10.0 + k, 0.0, 0.0) for k in range(6)}
    foreseen = Foreseen([*many, Experiment("heavy", path(), mass=1.0)], **told)
    foreseen.told["heavy"] = (99.0, 5.0, 5.0)
    plan = chosen_of(foreseen, (0,), RIVALS, [])
    assert foreseen.asked == ["x5", "x4", "x3", "x2", "heavy"]
    assert plan.experiment.name == "heavy"
    foreseen.told["x3"], foreseen.asked = (13.0, 2.0, 2.0), []
    assert chosen_of(foreseen, (0,), RIVALS, []).experiment.name == "x3"
    assert "heavy" not in foreseen.asked


def test_what_is_advised_already_is_taken_first_if_it_is_plain():
    listed = experiments()
    told = {x: (9.0, 2.0, 2.0) for x in ("two", "heavy")} | {"one": (99.0, 9.0, 9.0)}
    chosen = [listed[1]]
    again = chosen_of(Foreseen(listed, **told), (0,), RIVALS, chosen)
    assert again.experiment is listed[1] and chosen == [listed[1]]
    chosen = [listed[3]]
    other = chosen_of(Foreseen(listed, **told), (0,), RIVALS, chosen)
    assert other.experiment is listed[0] and chosen == [listed[3], listed[0]]


def test_one_of_two_is_confirmed_where_nothing_tells_both():
    told = {"one": (9.0, 0.1, 2.0), "two": (8.0, 3.0, 0.2), "three": (7.0, 2.5, 0.2)}
    plan = chosen_of(Foreseen(experiments(), **told), (0,), RIVALS, [])
    assert plan.experiment.name == "two"
    text = "run two (10 s); it shows Coulomb friction, or how small it is"
    assert plan.advice.experiment == text and plan.advice.separation == 8.0


def test_warm_drives_are_for_laws_that_warm():
    """Experiments with other gains tell nothing of the arm's own torque."""
    listed = [
        Experiment("cold", path()), Experiment("warm", path(), start=1200.0),
        Experiment("gains", path(), gains=True),
    ]  # fmt: skip
    for other, asked in (("viscous", ["cold"]), ("thermal_friction", ["cold", "warm"])):
        every = {x.name: (9.0, 0.0, 0.0) for x in listed}
        foreseen, kinds = Foreseen(listed, **every), ("coulomb", other)
        rivals = (SimpleNamespace(effect=named(x), evidence=0.0) for x in kinds)
        assert chosen_of(foreseen, (0,), tuple(rivals), []) is None
        assert foreseen.asked == asked


def test_what_a_payload_is_carried_on_is_diagnosed_alone(monkeypatch):
    search, recorded = SimpleNamespace(gap=gap_of()), object()
    module = sys.modules[_discrimination.__module__]
    monkeypatch.setattr(module, "Discrimination", lambda *given: given)
    plain, heavy = Experiment("cold", path()), Experiment("heavy", path(), mass=0.5)
    for experiment, told in ((plain, recorded), (heavy, None)):
        found, ahead, known = _discrimination(search, recorded, experiment)
        assert found is search and known is told
        assert ahead.rate == pytest.approx(search.gap.rate)


def test_effects_at_two_joints_are_named_with_their_joints():
    listed = experiments()
    search = SimpleNamespace(placed=lambda x: x)
    both = ("load_friction", "elbow"), ("coulomb", "wrist")
    plan = Plan(Advice("run one (10 s)", (), 1.0), listed[0])
    said = _placed(search, plan, both).advice.experiment
    assert said == (
        "run one (10 s); it settles whether it is load friction at elbow "
        "or Coulomb friction at wrist"
    )
    confirms = replace(plan, advice=Advice("run one (10 s); it settles", (), 1.0))
    assert _placed(search, confirms, both) is confirms
    by_hand = Plan(Advice("push it", (), 0.0))
    assert _placed(search, by_hand, both) is by_hand


# --- other advice ---------------------------------------------------------------------


def asked_menu(*names):
    ladder = [Experiment("a ladder of speeds", path(2.0))]
    found = [Experiment(x, path(10.0), gains="gains" in x) for x in names]
    return SimpleNamespace(
        about=lambda joint: found, ladder=lambda joint: ladder, of_all_joints=found
    )


def unexplained(depends, missed, verdict="unexplained"):
    account = SimpleNamespace(missed=np.array(missed), depends=depends)
    diagnosis = SimpleNamespace(verdict=verdict)
    result = SimpleNamespace(diagnosis=diagnosis, account=account)
    names = (
        "one path", "a ladder of speeds", "moves between poses", "a multisine",
        "a random motion of all joints twice", "a random motion of all joints again",
    )  # fmt: skip
    return list(_for_unexplained(result, asked_menu(*names)))


@pytest.mark.parametrize(
    ("depends", "name"),
    [
        ("past of load", "a multisine"), ("what does not recur", "twice"),
        ("waves in time", "twice"), ("speed and time", "again"),
        ("waves of position", "ladder"), ("direction and load", "poses"),
        ("position of elbow", "poses"),
        ("acceleration", "one path"), ("speed", "ladder"), ("", "ladder"),
    ],
)  # fmt: skip
def test_each_variable_has_the_experiment_that_isolates_it(depends, name):
    (plan,) = unexplained((depends, "speed"), [16.0, 4.0])
    assert name in plan.advice.experiment
    assert plan.advice.separation == 4.0 and plan.advice.splits == ()
    assert plan.advice.experiment == f"run {plan.experiment.name} (10 s)"


def test_the_joint_that_misses_most_is_asked_about_if_anything_is_missed():
    (plan,) = unexplained(("past", "load"), [1.0, 9.0])
    assert "poses" in plan.advice.experiment and plan.advice.separation == 3.0
    assert unexplained(("load",), [0.0]) == []
    assert unexplained(("load",), [4.0], "explained") == []
    assert len(unexplained(("load",), [4.0], "partly_explained")) == 1


def foretold(named, findings=("coulomb",)):
    """Plans for joints a and b, with noise 1 and 2, of which ``named`` is left."""
    left = SimpleNamespace(named=named, noise=(1.0, 2.0))
    diagnosis = SimpleNamespace(
        unseen=left if named else None, findings=findings, joints=("a", "b")
    )
    menu = asked_menu("a multisine", "a fast random motion of all joints")
    return _for_unforetold(SimpleNamespace(diagnosis=diagnosis), menu)


def test_a_joint_above_noise_on_held_out_motion_asks_for_more_motion():
    """Though the training samples are explained: no experiment is not enough."""
    (plan,) = foretold((1.1, 3.0))
    assert plan.advice.experiment.startswith("run a fast random motion of all joints")
    assert plan.advice.experiment.endswith("the torque of b on other motion")
    assert plan.advice.separation == 0.0 and plan.advice.splits == ()
    (plan,) = foretold((2.0, 3.0))  # the joint most above its own noise
    assert plan.advice.experiment.endswith("the torque of a on other motion")


def test_an_experiment_says_how_much_lower_than_the_logs_it_reaches():
    """By MuJoCo's kinematics; a motion went 0.5 m below the logs, and none was told."""
    robot = arm("planar")
    model = robot.mujoco_spec().compile()
    data = mujoco.MjData(model)

    def lowest(q):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        return data.xpos[1:, 2].min()

    up, down = np.array([[0.5, 0.2]]), np.array([[-1.2, 0.3]])
    if lowest(up[0]) < lowest(down[0]):
        up, down = down, up
    gap = SimpleNamespace(robot=robot, sampled=SimpleNamespace(q=up))
    low, high = (
        Experiment("it", SimpleNamespace(q=np.vstack([up, x]))) for x in (down, up)
    )
    deeper = lowest(up[0]) - lowest(down[0])
    assert deeper > 0.05
    assert _caution(gap, low).startswith(
        f" (it reaches {deeper:.2g} m lower than these"
    )
    assert _caution(gap, high) == ""


def test_noise_on_held_out_motion_or_no_cause_asks_for_no_more():
    assert foretold((1.2, 2.4)) == foretold(()) == foretold((9.0, 9.0), ()) == ()


def test_a_joint_that_stands_is_not_the_one_above_noise():
    """Nothing is left there but NaN."""
    assert foretold((np.nan, 2.0)) == ()
    (plan,) = foretold((np.nan, 3.0))
    assert "the torque of b" in plan.advice.experiment


def test_up_to_three_joints_that_stood_climb_a_ladder():
    said = (
        "a does not move", "b moving up", "c below 0.1 rad/s", "d", "e moving down",
        "reversals of f",
    )  # fmt: skip
    result = SimpleNamespace(
        gap=SimpleNamespace(robot=SimpleNamespace(joints=tuple("abcdef"))),
        diagnosis=SimpleNamespace(not_excited=said),
    )
    asked = []
    menu = asked_menu()
    menu.ladder = lambda j: asked.append(j) or [Experiment("a ladder", path(2.0))]
    plans = list(_for_not_excited(result, menu))
    assert asked == [0, 1, 3]
    assert [p.advice for p in plans] == [Advice("run a ladder (2 s)", (), 0.0)] * 3


def test_findings_of_a_servo_that_are_alike_ask_for_other_gains():
    def plans(*ids):
        finding = SimpleNamespace(alternatives=ids)
        result = SimpleNamespace(diagnosis=SimpleNamespace(findings=(finding,)))
        return list(_for_servos(result, asked_menu("a path", "with other gains")))

    (plan,) = plans("controller_gain", "command_latency")
    assert plan.advice == Advice(
        "run with other gains (10 s)", ("controller_gain", "command_latency"), 0.0
    )
    assert plans("controller_gain") == [] and plans("coulomb", "viscous") == []


def test_the_menu_asks_for_motions_of_some_length_and_share_of_the_limits(monkeypatch):
    """In the second try, which is smaller."""
    asked = []

    def noted(name):
        def make(robot, *args, **given):
            asked.append((name, {k: x for k, x in given.items() if k in KEPT}))
            return path()

        return make

    for name in (
        "random_fourier", "static_poses", "multisine", "speed_ladder",
        "micro_reversals",
    ):  # fmt: skip
        monkeypatch.setattr(menu_module, name, noted(name))
    monkeypatch.setattr(menu_module, "at_speeds", lambda robot, path: [path])
    made = Menu(pendulum(2), np.random.default_rng(0), rate=50.0)
    made.first_safe = lambda make, arm=None: make(1)
    made._poses = lambda: None
    assert len(made.of_all_joints) == 7
    random = {"fundamental": 0.1, "duration": 20.0, "fill": 0.6 * 0.85}
    assert asked == [
        ("random_fourier", random | {"duration": 10.0, "fill": 0.2 * 0.85}),
        ("static_poses", {"hold": 0.5}),
        ("multisine", {"fill": 0.5 * 0.85}),
        ("random_fourier", random | {"fill": 0.8 * 0.85}),
        *[("random_fourier", random)] * 3,
    ]
    asked.clear()
    made.ladder(0), made.about(1)
    assert asked == [
        ("speed_ladder", {"longest": 4.0}), ("micro_reversals", {}),
        ("speed_ladder", {"longest": 2.0}),
    ]  # fmt: skip
