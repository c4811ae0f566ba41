"""The most probable explanation: its score, its classes, and what is unknown."""

from functools import cache
from unittest.mock import Mock

import numpy as np
import pytest
from coarse import Plant, simulate
from diagnosed import RIPPLE, STRIBECK
from simulated import arm

from hybrid.diagnosis.explanations.belief import Belief
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.joint_laws import joint_laws, waves
from hybrid.diagnosis.explanations.proposals import Proposal
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.explanations.transmission_laws import transmission_laws
from hybrid.diagnosis.gap.measure import measure_gap, split
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.presliding import Presliding
from hybrid.effects.saturation import Saturation
from hybrid.effects.stribeck import Stribeck
from hybrid.errors import HybridWarning
from hybrid.signals.filters import butterworth

TRUTH = {"ripple": RIPPLE, "stribeck": STRIBECK}


def logs(*names):
    plant = Plant(arm("planar"), [TRUTH[name] for name in names])
    return simulate(plant, trajectories=4, duration=4.0, seed=5)


@cache
def gap_of(*names):
    return measure_gap(arm("planar"), logs(*names))


def proposed(effect, worth):
    place, none = (effect.id, effect.joints), np.zeros(0, dtype=int)
    return Proposal(Cause(place, none, 10.0, Mock(effect=effect)), worth)


UNKNOWN = Proposal(Cause(("speed", (0,)), np.zeros(0, dtype=int), 12.0), 0.0)
SHARP, SOFT = Coulomb((0,)), Presliding((0,))


def belief(*options):
    """Of Coulomb friction at the first joint, beside something unknown."""
    cause = Cause(("coulomb", (0,)), np.zeros(1, dtype=int), 10.0)
    return Belief.of(cause, 5.0, {x.place: x for x in options}, 0.95)


def test_what_is_as_probable_as_something_unknown_is_there_by_half():
    found = belief(proposed(SHARP, 20.0), Proposal(UNKNOWN.cause, 20.0))
    assert found.probability == pytest.approx(0.5)


def test_what_is_e_times_less_probable_counts_by_that():
    found = belief(proposed(SHARP, 20.0), proposed(SOFT, 19.0))
    (_, own), (_, other) = found.alternatives
    assert other / own == pytest.approx(np.exp(-1.0))
    assert found.probability == pytest.approx(1.0)


@pytest.mark.parametrize(("odds", "count"), [(1.0, 3), (3.0, 3), (15.0, 2), (50.0, 1)])
def test_a_class_is_the_smallest_set_that_holds_its_probability(odds, count):
    laws = SHARP, SOFT, Stribeck((0,))
    options = [proposed(x, 20.0 - k * np.log(odds)) for k, x in enumerate(laws)]
    for order in (options, options[::-1]):
        found = belief(*order)
        assert len(found.alternatives) == count
        held = sum(p for _, p in found.alternatives)
        assert held >= 0.95 * found.probability
        if count > 1:
            least = min(p for _, p in found.alternatives)
            assert held - least < 0.95 * found.probability


def test_unknown_laws_are_of_every_sample_and_finite():
    gap = gap_of("stribeck")
    laws = dict(joint_laws(gap, 1))
    assert {"position", "speed", "load", "time", "past of speed"} <= set(laws)
    for x in laws.values():
        assert x.shape[0] == len(gap.left) and np.isfinite(x).all()


def test_waves_are_those_of_a_ripple():
    gap = gap_of("ripple")
    rows = np.flatnonzero(gap.moving[:, 0])
    x = dict(waves(gap, 0, gap.left[rows, 0], rows))["waves of position"][rows]
    y = gap.left[rows, 0]
    left = y - x @ np.linalg.lstsq(x, y)[0]
    assert left @ left < 0.1 * (y @ y)


class TestTwists:
    """Laws of where a link lies beside its encoder."""

    @staticmethod
    def felt(place):
        """What all drives feel of it, and what is left of that by each law."""
        gap = gap_of()
        tau = []
        for motion, body, sampler in gap:
            dq = place(motion, body)
            dv = np.gradient(dq, motion.t)
            da = np.gradient(dv, motion.t)
            tau.append(sampler(body.response(0, dq, dv, da)))
        tau = np.concatenate(tau)
        left = {}
        for name, columns in transmission_laws(gap, 0):
            rows = np.vstack([columns[j] for j in range(gap.robot.size)])
            target = np.concatenate([tau[:, j] for j in range(gap.robot.size)])
            gains = np.linalg.lstsq(rows, target, rcond=1e-9)[0]
            left[name] = np.var(target - rows @ gains) / np.var(target)
        return left

    def test_an_encoder_off_its_centre_is_one_for_all_joints(self):
        left = self.felt(lambda motion, body: 0.01 * np.sin(motion.q[:, 0] + 0.7))
        assert left["twist with position"] < 0.05

    def test_a_soft_gear_is_one_of_load_for_all_joints(self):
        def wound(motion, body):
            slow = 0.5 * gap_of().cutoff
            return 1e-4 * butterworth(body.load[:, 0], rate=motion.rate, cutoff=slow)

        left = self.felt(wound)
        assert left["twist with load"] < 0.05
        assert left["twist with position"] > 0.1


def test_links_far_from_the_file_do_not_stand_for_a_clipped_torque():
    """With rotors and friction as free as the links they took up half of it."""
    clipped = Saturation((1,), {"limit": 3.7, "loss": 1.0})
    plant = Plant(arm("planar"), [clipped])
    with pytest.warns(HybridWarning, match="at its torque limit"):
        recordings = simulate(plant, trajectories=4, duration=5.0, seed=1)
    gap = measure_gap(plant.robot, recordings)
    search = Search(gap, split(gap), without=("saturation", "soft_saturation"))
    search.set_file_error(5.0)
    links = search.evidence.solve(search.rigid).gains
    left = search.evidence.squares(search.rigid, links)
    assert np.all(left > 0.95 * search.evidence.power)
