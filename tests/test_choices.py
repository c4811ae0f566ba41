"""What is chosen of a few: samples to learn from, parts of a curve, joints by name."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
from pendulum import pendulum, swings

from hybrid import read_recordings
from hybrid.diagnosis.evidence.noise import autocovariance
from hybrid.diagnosis.gap.measure import split, unseen_samples
from hybrid.dynamics import regressor
from hybrid.dynamics.base import base_parameters
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import ModelFileError
from hybrid.exports.simulator.friction import _CURVES, _FALLS, _KNEES, _fit, curve
from hybrid.identification import DynamicModel
from hybrid.model.model_file import _real, _whole
from hybrid.model.program import program_from_model
from hybrid.online.columns import InstantColumns
from hybrid.online.layout import MOVING, TORQUE, RowLayout
from hybrid.recording.joints import _by_name
from hybrid.regression.problem import build_problem
from hybrid.robot.demand import _demand

# --- what is learnt from --------------------------------------------------------------


def left(trajectories, blocks, loud=lambda part: False, times=1.0):
    """What a gap leaves of some recordings, in some of which it is larger."""
    trajectory = np.repeat(np.arange(trajectories), 40 * blocks)
    fold = np.tile(np.repeat(np.arange(blocks), 40), trajectories)
    rng = np.random.default_rng(0)
    x = rng.standard_normal((len(fold), 2))
    part = fold if trajectories < 4 else trajectory
    x[[loud(k) for k in part], 1] *= times
    moving = np.ones(x.shape, dtype=bool)
    return SimpleNamespace(trajectory=trajectory, fold=fold, moving=moving, left=x)


@pytest.mark.parametrize(("recordings", "kept"), [(4, {3}), (5, {3}), (9, {3, 7})])
def test_every_fourth_recording_is_kept_for_scoring(recordings, kept):
    gap = left(recordings, 2)
    learn = split(gap)
    assert set(gap.trajectory[~learn]) == kept
    assert not set(gap.trajectory[learn]) & kept


@pytest.mark.parametrize("loud", range(4))
@pytest.mark.parametrize(("times", "learnt"), [(8.0, True), (2.0, False)])
def test_what_is_far_larger_than_all_else_is_learnt_from(loud, times, learnt):
    """And what is but twice as large is no reason to choose."""
    gap = left(8, 1, lambda k: k == loud, times)
    learn = split(gap)
    if learnt:
        assert learn[gap.trajectory == loud].all()
    else:
        assert set(gap.trajectory[~learn]) == {3, 7}
    gap.moving[gap.trajectory == loud] = False  # nothing is told of a joint at rest
    assert set(gap.trajectory[~split(gap)]) == {3, 7}


@pytest.mark.parametrize("recordings", [1, 2, 3])
@pytest.mark.parametrize("loud", [None, 3, 2])
def test_of_few_recordings_blocks_of_time_are_kept(recordings, loud):
    gap = left(recordings, 8, lambda k: k == loud, 20.0)
    learn = split(gap)
    assert learn.mean() == pytest.approx(0.75)
    kept = [set(gap.fold[~learn & (gap.trajectory == k)]) for k in range(recordings)]
    assert all(len(x) == 2 for x in kept)
    if recordings > 1 and loud is None:
        assert kept[0] != kept[1]  # not the same time of each
    if loud is not None and recordings == 1:
        assert loud not in kept[0]


@pytest.mark.parametrize(("recordings", "apart"), [(1, True), (4, False)])
def test_a_sixth_of_a_block_beside_what_is_learnt_from_is_not_scored(recordings, apart):
    logs = swings(count=recordings, seconds=12.0)
    trajectory = np.repeat(np.arange(recordings), len(logs[0].t))
    gap = SimpleNamespace(motions=logs, rate=100.0, trajectory=trajectory)
    learn = np.zeros(len(trajectory), dtype=bool)
    learn[500:700] = True
    kept = unseen_samples(gap, learn)
    beside = len(kept) - 200 - kept.sum()
    assert bool(beside > 0) is apart and (apart or kept[~learn].all())
    if apart:
        assert not kept[500:700].any() and kept[:400].all() and kept[800:].all()
        assert not kept[499] and not kept[700]


def test_the_covariance_of_a_signal_with_holes_is_that_of_its_pairs():
    rng = np.random.default_rng(0)
    row = np.flatnonzero(rng.random(60) < 0.7) + 5
    x = rng.standard_normal(len(row))
    at = dict(zip(row.tolist(), x, strict=True))
    pairs = [sum(y * at.get(k + m, 0.0) for k, y in at.items()) for m in range(5)]
    np.testing.assert_allclose(autocovariance(x, row, 4), np.array(pairs) / len(x))


# --- what a simulator's fields can say ------------------------------------------------

FIELDS = ("frictionloss", "damping", "quadratic", "cubic", "knee", "fall")
V = np.linspace(-2.0, 2.0, 401)


@pytest.mark.parametrize(
    "values",
    [
        {"frictionloss": 0.7, "damping": 0.4},
        {"damping": 0.4, "quadratic": 0.2, "cubic": 0.1},
        {"frictionloss": 0.5, "knee": 0.8, "knee_speed": 2.0 * _KNEES[3]},
        {"frictionloss": 0.5, "fall": 0.6, "fall_speed": 2.0 * _FALLS[12]},
        *(
            {"damping": 1.0, "quadratic": -2.0 / w, "cubic": 1.0 / w**2}
            for w in 2.0 * _CURVES[[0, -1]]
        ),
    ],
)
def test_a_friction_that_fields_can_say_is_said(values):
    """Also a drag that falls before it rises: v·(1 − |v|/w)² does at every w."""
    torque = curve(values, V)
    found = _fit(torque, V, FIELDS, 0.0)
    miss = np.sqrt(np.mean((curve(found, V) - torque) ** 2) / np.mean(torque**2))
    assert miss < 5e-3
    plain = _fit(torque, V, ("frictionloss", "damping"), 0.0)
    assert set(plain) == {"frictionloss", "damping"}
    assert min(plain.values()) >= 0.0


def test_curves_of_fields_are_odd_but_for_a_preload():
    values = {
        "frictionloss": 0.5, "damping": 0.3, "quadratic": 0.2, "cubic": 0.1,
        "knee": 0.8, "knee_speed": 0.4, "fall": 0.6, "fall_speed": 0.3,
    }  # fmt: skip
    torque = curve(values, V)
    np.testing.assert_allclose(torque, -torque[::-1], atol=1e-12)
    np.testing.assert_allclose(curve({**values, "preload": 0.9}, V), torque + 0.9)
    assert curve(values, np.array([1e-9]))[0] == pytest.approx(1.1, abs=1e-6)
    far = curve(values, np.array([2.0]))[0]
    assert far == pytest.approx(0.5 + 0.6 + 0.8 + 0.8 + 0.8)


# --- names and places -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "joints", "found"),
    [
        (("a", "b"), ("a", "b"), {"a": "a", "b": "b"}),
        (("A_Joint", "b"), ("a", "b_joint"), {"A_Joint": "a", "b": "b_joint"}),
        (("ur.pan", "ur.lift"), ("pan", "lift"), {"ur.pan": "pan", "ur.lift": "lift"}),
        (("pan", "lift"), ("ur/pan", "ur/lift"), {"pan": "ur/pan", "lift": "ur/lift"}),
        (("a.pan", "a.lift"), ("b_pan", "b_lift"),
         {"a.pan": "b_pan", "a.lift": "b_lift"}),
        (("left_axis1", "left_axis2", "gripper"), ("axis1", "axis2"),
         {"left_axis1": "axis1", "left_axis2": "axis2"}),
        (("left_pan", "right_pan"), ("pan", "lift"), {}),
        (("x", "y"), ("pan", "lift"), {}),
    ],
)  # fmt: skip
def test_a_name_is_the_joint_that_it_alone_spells(names, joints, found):
    assert _by_name(names, joints) == found


def test_each_torque_has_places_for_what_moves_it_and_for_the_load():
    robot = pendulum(2)
    problem = build_problem(robot.chain, [Viscous((1,))])
    layout = RowLayout(problem, tracked=False)
    assert layout.gains == [[problem.size - 1]] and layout.shapes == [[]]
    assert layout.size == problem.size and layout.shape == (2, problem.size + 6)
    columns = np.arange(layout.shape[1])
    extra = [*columns[layout.payload], columns[TORQUE], columns[MOVING]]
    assert extra == [*range(problem.size, problem.size + 6)]
    filled = InstantColumns(robot, problem, layout, 1)
    states = np.zeros((1, 1)), np.zeros((1, 2)), np.ones((1, 2)), np.zeros((1, 2))
    for _ in filled.fill(states, np.zeros(problem.size)):
        pass
    np.testing.assert_array_equal(filled.rows[0, :, problem.size - 1], [0.0, 1.0])


@pytest.mark.parametrize(
    ("inside", "elements"),
    [
        ("<geom/>", 1),
        ("<replicate count='10'><geom/></replicate><geom/>", 10 + 10 + 1),
        ("<replicate count='10'><body></body><geom/></replicate>", 30),
        ("<replicate count='10'><a><b></b></a><replicate count='5'><c/></replicate>"
         "</replicate>", 10 + 20 + 50 + 50),
    ],
)  # fmt: skip
def test_copies_are_of_what_is_inside_and_of_nothing_after(tmp_path, inside, elements):
    file = tmp_path / "arm.xml"
    file.write_text(f"<mujoco>{inside}</mujoco>")
    assert _demand(file).elements == 1 + elements


@pytest.mark.parametrize("x", [True, "1", None, [1]])
def test_what_is_no_number_is_refused(x):
    for check in (_real, _whole):
        with pytest.raises(ModelFileError, match="is no (whole )?number"):
            check(x)
    assert (_real(2), _real(0.5), _whole(3)) == (2.0, 0.5, 3)
    with pytest.raises(ModelFileError):
        _whole(json.loads("0.5"))


# --- at one instant -------------------------------------------------------------------


def test_a_program_reads_an_encoder_as_the_model_does():
    """An offset moves the weight; friction and speeds do not change with it."""
    robot, (motion,) = pendulum(2), swings(2, count=1, seconds=1.0)
    Y = regressor(robot.chain, motion.q, motion.v, motion.a).reshape(-1, 20)
    base = base_parameters(Y, tuple(f"x{k}" for k in range(20)), ("",) * 20)
    links = robot.chain.inertial
    effects = (EncoderOffset((1,), {"offset": 0.2}), Coulomb((0,), {"level": 0.7}))
    model = DynamicModel(robot, base, effects, inertial=links)
    found, _ = program_from_model(model).run(motion.q, motion.v, motion.a)
    np.testing.assert_allclose(found, model.predict(motion), atol=1e-9)
    plain = DynamicModel(robot, base, effects[1:], inertial=links)
    other, _ = program_from_model(plain).run(motion.q, motion.v, motion.a)
    moved = np.abs(found - other).max(axis=0)
    assert moved.min() > 0.1  # both joints carry the link that hangs elsewhere
    friction = other - plain_rigid(robot, motion)
    np.testing.assert_allclose(friction, [[0.7, 0.0]] * np.sign(motion.v), atol=1e-9)


def plain_rigid(robot, motion):
    columns = regressor(robot.chain, motion.q, motion.v, motion.a)
    return columns @ robot.chain.inertial.ravel()


# --- names within a file --------------------------------------------------------------


@pytest.mark.parametrize("label", ["joints", "joint_names"])
def test_names_in_a_matlab_file_are_of_its_columns(tmp_path, label):
    t = np.arange(200) / 100.0
    q = np.stack([np.sin(t), np.cos(3 * t)], axis=1)
    names = np.array(["b", "a"], dtype=object)
    content = {"t": t, "q": q, "tau": 5.0 * q, label: names}
    scipy.io.savemat(tmp_path / "log.mat", content)
    (found,) = read_recordings(tmp_path / "log.mat", joints=("a", "b"))
    np.testing.assert_allclose(found.q, q[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(found.tau, 5.0 * found.q, atol=1e-12)
