"""Stage three: learned where there is structure, left out where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import (
    arm,
    coloured,
    linear_problem,
    motions,
    quiet,
    stacked,
    with_torque,
)

from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.identification import identify, validate
from hybrid.identification.identification import MOST_LEARNED
from hybrid.identification.remainder import fit_remainder
from hybrid.regression.data import Data
from hybrid.signals import Motion

OPTIONS = {"stages": ("rigid", "remainder"), "cutoff": 15.0}


def rest(structure, *, seed=0, noise=0.1, n=3, samples=4000):
    """What physical terms might leave: a smooth walk through the state, four folds."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 40, samples)
    w = rng.uniform(0.5, 3.0, (4, 1, n))
    angle = w * t[:, None] + rng.uniform(0, 2 * np.pi, (4, 1, n))
    q, v = np.sin(angle).sum(axis=0) / 2, (w * np.cos(angle)).sum(axis=0) / 2
    tau = structure(q, v) + coloured(rng, samples, noise**2 * np.eye(n), 0.9)
    motion = Motion(t, q, v, 0 * q, tau, np.ones(samples, dtype=bool))
    return Data((motion,), ((t // 1.0).astype(int) % 4,), np.inf, np.full(n, -1.0))


def rms(data):
    """All of the torque, shape (n,)."""
    return np.sqrt(np.mean(data.motions[0].tau ** 2, axis=0))


def learn(data, **options):
    """A remainder of all the torque of the data, its torque, and what it leaves."""
    (motion,) = data.motions
    found, (cross,) = fit_remainder(data, [motion.tau], **options)
    squares = data.squares([motion.tau - cross])
    return found, cross, np.sqrt(squares.sum(axis=0) / data.moving)


def bump(q, v):
    """Torque of the middle joint that depends on its own position and direction."""
    tau = np.zeros_like(q)
    tau[:, 1] = np.cos(3 * q[:, 1]) + 0.5 * np.tanh(3 * v[:, 1])
    return tau


def of_neighbour(q, v):
    """Torque of the first joint that depends on the position of the second."""
    tau = np.zeros_like(q)
    tau[:, 0] = np.sin(2 * q[:, 1])
    return tau


def nothing(q, v):
    return np.zeros_like(q)


def test_a_joint_that_never_moves_is_off_by_nothing():
    data = rest(bump)
    still = replace(data, standing=np.array([-1.0, -1.0, np.inf]))
    tau = [m.tau for m in still.motions]
    error = np.sqrt(still.squares(tau).sum(axis=0) / still.moving)
    np.testing.assert_allclose(error[:2], rms(data)[:2])
    assert error[2] == 0.0


@pytest.fixture(scope="module")
def data():
    return rest(bump)


@pytest.fixture(scope="module")
def found(data):
    return learn(data)


@pytest.fixture(scope="module")
def learned(found):
    return found[0]


def test_structure_is_learned_at_its_joint_and_nowhere_else(data, found):
    (learned, cross, left), before = found, rms(data)
    (part,) = learned.parts
    assert part.joint == 1
    assert left[1] < 0.35 * before[1]
    assert left[1] < 2.0 * 0.1  # of the noise
    np.testing.assert_allclose(left[[0, 2]], before[[0, 2]], rtol=1e-12)
    assert (cross[:, [0, 2]] == 0).all()


def test_what_is_learned_holds_on_other_motion(learned):
    (other,) = rest(bump, seed=1, noise=1e-9).motions
    near = np.abs(other.q[:, 1]) < 0.8
    error = (learned.predict(other.q, other.v) - other.tau)[near, 1]
    assert np.sqrt(np.mean(error**2)) < 0.3 * np.sqrt(np.mean(other.tau[near, 1] ** 2))


def test_a_neighbours_position_is_taken_in_where_it_matters():
    data = rest(of_neighbour)
    learned, _, left = learn(data)
    (part,) = learned.parts
    assert part.joint == 0 and 1 in part.positions
    assert left[0] < 0.5 * rms(data)[0]


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_learned_from_noise(seed):
    """Slow noise looks like structure to one who scores on neighbouring samples."""
    learned, cross, _ = learn(rest(nothing, seed=seed))
    assert learned.parts == ()
    assert (cross == 0).all()


def test_samples_that_do_not_count_teach_nothing(learned):
    """What the log shows for a fifth of the time is not to be used."""
    data = rest(bump, samples=2400)
    (motion,) = data.motions
    masked = replace(motion, mask=np.abs(motion.q[:, 1]) >= 0.2)
    spoiled = np.where(masked.mask[:, None], motion.tau, 50.0)
    (found, _, left), (clean, _, expected) = (
        learn(replace(data, motions=(replace(masked, tau=tau),)), among=learned)
        for tau in (spoiled, motion.tau)
    )
    assert len(clean.parts) == 1
    for name, x in clean.arrays().items():
        np.testing.assert_array_equal(found.arrays()[name], x)
    np.testing.assert_array_equal(left, expected)


def test_a_second_round_keeps_to_the_joints_and_inputs_of_the_first(learned):
    again = learn(rest(of_neighbour), among=learned)[0]
    assert {p.joint for p in again.parts} <= {1}


def test_it_fades_to_zero_outside_its_data_and_stays_bounded(data, learned):
    (data,), remainder = data.motions, learned
    inside = np.abs(remainder.predict(data.q, data.v)[:, 1])
    assert inside.max() <= np.abs(data.tau[:, 1]).max()
    far = np.full((1, 3), 20.0)
    for q, v in ((far, 0 * far), (0 * far, 10 * far), (-far, -far)):
        np.testing.assert_array_equal(remainder.predict(q, v), 0.0)
    line = np.linspace(0, 20, 4001)[:, None] * np.ones((1, 3))
    assert np.abs(np.diff(remainder.predict(line, 0 * line)[:, 1])).max() < 0.1


def test_a_remainder_never_exceeds_its_bound(data, learned):
    bound = np.array([9.0, 0.4, 9.0])
    found, (data,) = learn(data, bound=bound, among=learned)[0], data.motions
    tau = found.predict(data.q, data.v)
    assert np.abs(tau[:, 1]).max() == 0.4
    assert np.abs(learned.predict(data.q, data.v)[:, 1]).max() > 0.8
    rng = np.random.default_rng(0)
    states = rng.normal(size=(2, 100_000, 3)) * 10 ** rng.uniform(
        -2, 4, (2, 100_000, 1)
    )
    assert (np.abs(found.predict(*states)) <= bound).all()


def test_variance_is_that_of_the_noise_and_unknown_where_nothing_was_learned(
    data, learned
):
    (data,), remainder = data.motions, learned
    mean, variance = remainder.at_instant(data.q.T, data.v.T)
    found = remainder.predict(data.q, data.v)  # compiled
    for joint, x in enumerate(mean):
        np.testing.assert_allclose(x, found[:, joint], rtol=0, atol=1e-13)
    assert np.isnan(variance[0]) and np.isnan(variance[2])
    error = mean[1] - data.tau[:, 1]
    inside = np.mean(np.abs(error) < 2 * np.sqrt(variance[1]))
    assert 0.93 < inside < 0.999
    assert np.mean(variance[1]) < 0.1 * np.mean(data.tau[:, 1] ** 2)


def test_arrays_and_description_give_the_same_remainder_back(data, learned):
    (data,), remainder = data.motions, learned
    again = ArmRemainder.from_dict(3, remainder.as_dict(), remainder.arrays())
    np.testing.assert_array_equal(
        again.predict(data.q, data.v), remainder.predict(data.q, data.v)
    )


# --- through the whole identification -------------------------------------------------


def logs(extra, seed=0):
    """Planar arm with linear friction, some torque over position, and noise."""
    robot = arm("planar")
    problem, rng = linear_problem(robot), np.random.default_rng(seed)
    theta = rng.uniform(0.5, 1.5, problem.size)
    found = []
    for motion in motions(robot, count=6, duration=10.0, rate=200, seed=seed):
        tau = stacked(problem, motion) @ theta
        tau[:, 1] += extra * np.tanh(4 * motion.q[:, 1]) * np.cos(2 * motion.q[:, 1])
        tau += coloured(rng, len(tau), 0.01 * np.eye(2), 0.9)
        found.append(with_torque(motion, tau))
    return found


@pytest.fixture(scope="module")
def with_and_without():
    """The same logs, with torque that no effect describes, in two stages and in one."""
    recordings, planar = logs(0.8), arm("planar")
    full, said = quiet(identify, planar, recordings[:3], **OPTIONS)
    rigid, _ = quiet(identify, planar, recordings[:3], stages=("rigid",), cutoff=15.0)
    assert full.left_out == () and said == []
    return full, rigid, recordings[3:]


def errors(fit, recordings):
    return {row.name: row.rms for row in validate(fit.model, recordings).rows}


def test_a_remainder_lowers_the_error_on_motion_it_has_not_seen(with_and_without):
    fit, _, unseen = with_and_without
    (part,) = fit.model.remainder.parts
    assert part.joint == 1
    assert part.regression.bound[0] <= MOST_LEARNED * arm("planar").tau_max[1]
    assert fit.held_out["+ remainder"][1] < 0.7 * fit.held_out["IRLS"][1]
    rows = errors(fit, unseen)
    assert rows["+ remainder"][1] < 0.75 * rows["IRLS"][1]
    assert rows["+ remainder"][0] < 1.02 * rows["IRLS"][0]
    held_out = fit.held_out["+ remainder"]
    # Of two thirds of the logs: not better than of all of them, and not much worse.
    assert (held_out > 0.95 * rows["+ remainder"]).all()
    assert held_out[1] < 0.5 * rows["IRLS"][1]


def test_links_are_fitted_anew_around_what_was_learned(with_and_without):
    """Structure that was taken for gravity and inertia before is not any more."""
    full, rigid, _ = with_and_without
    problem = linear_problem(arm("planar"))
    truth = np.random.default_rng(0).uniform(0.5, 1.5, problem.size)
    labels = problem.base.kept_labels
    links = [k for k, x in enumerate(labels) if x.startswith(("m", "I"))]
    assert len(links) == 6
    off = []
    for base in (rigid.model.base, full.model.base):
        values = dict(zip(base.kept_labels, base.values, strict=True))
        off.append(np.linalg.norm([values[labels[k]] / truth[k] - 1.0 for k in links]))
    assert off[1] < 0.85 * off[0]
    assert full.rounds > 1


def test_the_stages_before_are_kept_as_they_were(with_and_without):
    full, rigid, unseen = with_and_without
    found, expected = errors(full, unseen), errors(rigid, unseen)
    for stage in ("LS", "WLS", "IRLS"):
        np.testing.assert_allclose(found[stage], expected[stage], rtol=1e-9)
        np.testing.assert_allclose(full.held_out[stage], rigid.held_out[stage])


def test_without_structure_the_remainder_is_left_out_with_a_warning():
    fit, said = quiet(identify, arm("planar"), logs(0.0), **OPTIONS)
    assert fit.model.remainder is None
    assert any("remainder" in text for text in fit.left_out)
    assert any("left out remainder" in text for text in said)
    np.testing.assert_array_equal(fit.held_out["+ remainder"], fit.held_out["rigid"])
