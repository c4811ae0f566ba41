"""A wrong torque constant scales all that a drive delivers: plant, columns, model."""

import numpy as np
import pytest
from coarse import Plant
from simulated import arm, quiet

from hybrid.dynamics import RigidBody
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.viscous import Viscous
from hybrid.identification import DynamicModel, identify, solver
from hybrid.plant import Noise, random_fourier
from hybrid.regression.problem import build_problem
from hybrid.signals import motion_from_recording

GAIN, LEVEL = 0.2, 5.0


@pytest.fixture(scope="module")
def log():
    """The planar arm, its shoulder with dry friction and a wrong torque constant."""
    robot, rng = arm("planar"), np.random.default_rng(0)
    effects = [TorqueGain((0,), {"gain": GAIN}), Coulomb((0,), {"level": LEVEL})]
    plant = Plant(robot, effects, noise=Noise.none(2))
    reference = random_fourier(robot, duration=5, rate=1000, seed=rng)
    (recording,) = plant.run([reference], seed=rng)
    return motion_from_recording(recording, cutoff=40.0)


def true_model(gain):
    """Everything known, but for the torque constant of the shoulder."""
    robot = arm("planar")
    declared = ((Armature, robot.chain.armature), (Viscous, robot.damping))
    effects = [cls((j,), dict.fromkeys([cls.gains[0].name], x[j]))
               for cls, x in declared for j in range(2)]  # fmt: skip
    dry = robot.frictionloss + [LEVEL, 0.0]
    effects += [Coulomb((j,), {"level": dry[j]}) for j in range(2)]
    base = build_problem(robot.chain, []).base
    base = base.with_values(base.mapping @ robot.chain.inertial.ravel())
    return DynamicModel(robot, base, (*effects, TorqueGain((0,), {"gain": gain})))


def error(model, log, joint):
    """RMS error where the joint moves, as a share of its torque."""
    use = log.mask & (np.abs(log.v[:, joint]) > 0.1)
    left = (log.tau - model.predict(log))[use, joint]
    return np.sqrt(np.mean(left**2) / np.mean(log.tau[use, joint] ** 2))


def test_the_model_predicts_what_the_plant_logs_friction_included(log):
    assert error(true_model(GAIN), log, 0) < 0.01
    assert error(true_model(GAIN), log, 1) < 0.01
    assert error(true_model(0.0), log, 0) > 0.1


def test_with_known_links_the_torque_constant_is_recovered(log):
    """The log is linear in g, so that one division gives it."""
    right = true_model(0.0).predict(log)[:, 0]
    use = log.mask & (np.abs(log.v[:, 0]) > 0.1)
    gain = (log.tau[use, 0] - right[use]) @ right[use] / (right[use] @ right[use])
    assert gain == pytest.approx(GAIN, abs=0.005)


def test_columns_are_the_change_of_what_the_log_shows_of_the_transmitted_torque(log):
    body = RigidBody(arm("planar").chain, log)
    effect = TorqueGain((0,), {"gain": GAIN})
    load, step = body.load[:, :1], 1e-6
    ahead, behind = (
        effect.at({"gain": GAIN + x}).report(log.t, load) for x in (step, -step)
    )
    np.testing.assert_allclose(
        effect.columns(log, body)[:, :, 0], (ahead - behind) / (2 * step), rtol=1e-6
    )


def test_a_linearisation_that_is_cut_short_is_said_not_to_have_settled(
    log, monkeypatch
):
    """The gain found first is that of columns at another gain."""
    gain = TorqueGain((0,))
    for most, settled in ((8, True), (1, False)):
        monkeypatch.setattr(solver, "_MOST_LINEARISATIONS", most)
        fit, said = quiet(
            identify, arm("planar"), [log], effects=[gain], stages=["rigid"], cutoff=20
        )
        assert fit.converged is settled
        assert any("did not settle" in text for text in said) is not settled
