"""What recordings leave open: draws, intervals, and Python for other simulators."""

import sys
import types
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse import Plant, simulate
from simulated import arm
from test_export_exact import run

from hybrid.dynamics import effect_gains, stacked_base
from hybrid.dynamics.pseudo_inertia import is_consistent
from hybrid.effects import effect_class
from hybrid.effects.command_latency import CommandLatency
from hybrid.errors import HybridError
from hybrid.exports import export, ranges, sample
from hybrid.exports.simulator.posterior import _changed
from hybrid.files import read_yaml
from hybrid.identification import identify
from hybrid.model import DynamicModel
from hybrid.robot.chain import INERTIAL_NAMES

NAMES = ("armature", "damping", "frictionloss")


@cache
def fitted(name="planar"):
    """An arm, identified from simulated logs of itself."""
    robot = arm(name)
    plant = Plant(robot, [], nominal=robot)
    logs = simulate(plant, trajectories=4, duration=6.0, seed=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return identify(robot, logs, stages=("rigid",), consistent=True)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """What an export of ranges writes of that arm, with few draws."""
    folder = tmp_path_factory.mktemp("ranges")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hybrid.exports.simulator.snippets._DRAWS", 20)
        export(fitted().model, folder, format="ranges")
    return folder


def test_draws_spread_as_the_covariance_says():
    fit = fitted()
    drawn = sample(fit.model, 300, np.random.default_rng(0))
    for effect in fit.model.effects:
        for gain in effect.gains:
            own = [
                e.values[gain.name] for model in drawn for e in model.effects
                if (e.id, e.joints) == (effect.id, effect.joints)
            ]  # fmt: skip
            label = f"{effect.id}.{gain.name}[{arm('planar').joints[effect.joints[0]]}]"
            if label in fit.labels and effect.values[gain.name]:
                std = np.sqrt(fit.covariance[(k := fit.labels.index(label)), k])
                assert np.std(own) == pytest.approx(std, rel=0.2), label
    assert all(is_consistent(model.inertial).all() for model in drawn)


def test_a_drawn_gain_changes_with_the_others_wherever_its_effect_acts():
    robot, rng = arm("planar"), np.random.default_rng(0)
    tilt = effect_class("gravity_tilt")((0, 1), {"roll": 0.1, "pitch": 0.2})
    ripples = [
        effect_class("torque_ripple")((1,), {"sine": 1.0, "periods": k}) for k in (3, 5)
    ]
    model = replace(fitted().model, effects=(tilt, *ripples))
    labels = stacked_base(
        robot.chain, model.effects, effect_gains(model.effects)
    ).labels
    changes = {x: 0.01 * k for k, x in enumerate(labels) if "." in x}
    for effect in model.effects:
        found = _changed(model, effect, changes, rng)
        for name in ("pitch",) if effect is tilt else ("sine", "cosine"):
            ends = (
                "arm]" if effect is tilt else f"periods {effect.values['periods']:g}]"
            )
            own = [
                x for label, x in changes.items()
                if f".{name}[" in label and label.endswith(ends)
            ]  # fmt: skip
            assert [found.values[name] - effect.values[name]] == pytest.approx(own)


@pytest.mark.study
def test_what_varies_by_rounding_alone_has_no_interval():
    # Its axes are vertical: of the first link, the torque tells the inertia about one.
    found = ranges(fitted("scara").model)
    assert [
        x for joint, x in found.keys if joint == "shoulder" and x in INERTIAL_NAMES
    ] == ["Izz"]


def test_intervals_hold_the_truth_and_the_model():
    found, robot = ranges(fitted().model, seed=1, draws=200), arm("planar")
    truth = dict(zip(NAMES, (robot.chain.armature, robot.damping, robot.frictionloss),
                     strict=True))  # fmt: skip
    held = [
        low <= truth[name][robot.joints.index(joint)] <= high
        for (joint, name), low, high in zip(
            found.keys, found.low, found.high, strict=True
        )
        if name in NAMES[1:]
    ]
    assert len(held) == 4
    assert np.mean(held) >= 0.5  # of four; their intervals are for 95 %
    assert np.diag(found.correlation) == pytest.approx(1.0)
    assert (found.low < found.high).all()


def test_the_same_model_has_the_same_ranges_in_yaml(exported, tmp_path, monkeypatch):
    monkeypatch.setattr("hybrid.exports.simulator.snippets._DRAWS", 20)
    model = fitted().model
    model.save(tmp_path / "model.json")
    loaded = DynamicModel.load(tmp_path / "model.json")
    np.testing.assert_array_equal(loaded.covariance, model.covariance)
    export(loaded, tmp_path / "again", format="ranges")
    first, again = (x / "planar_ranges.yaml" for x in (exported, tmp_path / "again"))
    assert first.read_text() == again.read_text()
    content = read_yaml(first)
    first = content["parameters"][0]
    assert set(first) == {"joint", "name", "unit", "nominal", "interval"}
    assert len(content["correlation"]) == len(content["parameters"])


def test_a_model_without_covariance_is_refused(tmp_path):
    bare = replace(fitted().model, covariance=np.zeros((0, 0)))
    with pytest.raises(HybridError, match="identify again"):
        export(bare, tmp_path / "new", format="ranges")
    assert not (tmp_path / "new").exists()


def test_a_model_without_links_that_could_be_built_is_refused(tmp_path):
    model = replace(fitted().model, inertial=None)
    with pytest.raises(HybridError, match="--consistent"):
        export(model, tmp_path / "ranges", format="ranges")
    assert not (tmp_path / "ranges").exists()


def test_isaac_lab_gets_friction_rotors_limits_and_delay(tmp_path, monkeypatch):
    model = fitted().model
    late = CommandLatency((0,), {"time": 0.0025})
    model = replace(model, effects=(*model.effects, late))
    notes = export(model, tmp_path, format="isaaclab")
    assert all(note.startswith("torque_offset") for note in notes)
    found = run((tmp_path / "planar_isaaclab.py").read_text(), monkeypatch)
    own, robot = found["ACTUATORS"]["arm"], arm("planar")
    assert own["joint_names_expr"] == list(robot.joints)
    assert own["effort_limit"] == dict(zip(robot.joints, robot.tau_max, strict=True))
    assert (own["min_delay"], own["max_delay"]) == (2, 3)  # steps of a millisecond
    for j, name in enumerate(robot.joints):
        assert own["friction"][name] == pytest.approx(robot.frictionloss[j], rel=0.2)
        assert own["viscous_friction"][name] == pytest.approx(robot.damping[j], rel=0.2)


@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_the_function_for_mjx_refuses_damping_that_jax_ignores(
    impl, exported, monkeypatch
):
    text = (exported / "planar_mjx.py").read_text()
    library = types.SimpleNamespace(numpy=types.SimpleNamespace(array=list))
    monkeypatch.setitem(sys.modules, "jax", library)
    monkeypatch.setitem(sys.modules, "jax.numpy", library.numpy)
    names = {}
    exec(compile(text, "x", "exec"), names)
    names["_FIELDS"] = [("dof_dampingpoly", 0, ["elbow"])]
    model = types.SimpleNamespace(impl=types.SimpleNamespace(value=impl))
    wanted = {
        "jax": (NotImplementedError, "MJX on JAX ignores quadratic"),
        "warp": (AttributeError, "joint"),
    }  # it goes on
    error, message = wanted[impl]
    with pytest.raises(error, match=message):
        names["domain_randomize"](model, None, types.SimpleNamespace())


@pytest.mark.parametrize("format", ["mjcf", "urdf", "ranges"])
def test_an_export_says_what_mjx_on_jax_does_not_take(format, tmp_path, monkeypatch):
    monkeypatch.setattr("hybrid.exports.simulator.snippets._DRAWS", 8)
    model = fitted().model
    more = (
        effect_class("nonlinear_viscous")((0,), {"cubic": 0.02}),
        effect_class("torque_ripple")((1,), {"sine": 0.1, "periods": 4.0}),
    )
    curved = replace(model, effects=(*model.effects, *more), simpler={})
    notes = [x for x in export(curved, tmp_path, format=format) if "MJX" in x]
    lost = [
        "for MJX on JAX: quadratic and cubic damping of shoulder, which it ignores",
        "for MJX on JAX: ripple or falling friction of elbow, which it refuses",
    ]
    assert notes == ([] if format == "urdf" else lost)


def test_what_is_drawn_for_given_links_is_surer_by_what_these_tell():
    model = fitted().model
    drawn = sample(model, 400, np.random.default_rng(0), links=False)
    links = [x.inertial for x in drawn]
    np.testing.assert_allclose(links, 400 * [model.inertial], atol=1e-9)
    rigid = np.array(model.base.kept) < 20
    precision = np.linalg.inv(model.covariance)[np.ix_(~rigid, ~rigid)]
    std = np.sqrt(np.diagonal(np.linalg.inv(precision)))
    labels = np.array(model.base.kept_labels)[~rigid].tolist()
    own = [e.gain_values[0] for x in drawn for e in x.effects
           if (e.id, e.joints) == ("viscous", (1,))]  # fmt: skip
    expected = std[labels.index("viscous.coefficient[elbow]")]
    assert np.std(own) == pytest.approx(expected, rel=0.1)


def test_a_gain_that_is_certain_stays():
    model = fitted().model
    at = list(model.base.kept_labels).index("coulomb.level[elbow]")
    sure = model.covariance.copy()
    sure[at], sure[:, at] = 0.0, 0.0
    (value,) = {e.gain_values[0] for e in model.effects
                if (e.id, e.joints) == ("coulomb", (1,))}  # fmt: skip
    for x in sample(replace(model, covariance=100 * sure), 50):
        (own,) = (e.gain_values[0] for e in x.effects
                  if (e.id, e.joints) == ("coulomb", (1,)))  # fmt: skip
        assert own == pytest.approx(value, rel=1e-6)


def test_draws_keep_to_the_torque_though_their_gains_are_uncertain():
    """Dry and viscous friction of one speed trade off; zero is a bound for both."""
    model = fitted().model
    labels = list(model.base.kept_labels)
    pair = [
        labels.index(f"{x}[elbow]") for x in ("viscous.coefficient", "coulomb.level")
    ]
    wide, speed = model.covariance.copy(), 0.8
    together = np.array([-1.0, speed])  # of which v · viscous + coulomb knows nothing
    wide[np.ix_(pair, pair)] += 25.0 * np.outer(together, together)
    drawn = sample(replace(model, covariance=wide), 300, np.random.default_rng(0))
    level, slope = (
        np.array([
            e.gain_values[0] for x in drawn for e in x.effects
            if (e.id, e.joints) == (kind, (1,))
        ])
        for kind in ("coulomb", "viscous")
    )  # fmt: skip
    assert level.min() >= 0 and slope.min() >= 0 and slope.std() > 0.2
    assert (level + speed * slope).std() < 0.1 * speed * slope.std()
