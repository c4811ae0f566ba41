"""Exports against Python: C, ONNX, MJCF, URDF and JSON say what the model says."""

import ctypes
import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from arms import MODELS, public_arm, random_arm, random_states
from test_files import killed_at

import hybrid
from hybrid.cli import main
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.dynamics import BaseParameters, Law, regressor
from hybrid.dynamics.base import inertial_labels
from hybrid.dynamics.tape import OPERATIONS, Tape
from hybrid.effects import Effect, Port, effect_class, effect_classes
from hybrid.effects.actuator_lag import ActuatorLag
from hybrid.effects.presliding import Presliding
from hybrid.effects.viscous import Viscous
from hybrid.errors import EffectError, HybridError, ModelFileError
from hybrid.exports import FORMATS, export, manifest, read_manifest
from hybrid.identification import DynamicModel
from hybrid.model.model_file import content_from_model
from hybrid.model.program import program_from_model
from hybrid.plant import load_truth
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.signals.filters import LOWER_BAND

STRICT = (
    "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion",
)  # fmt: skip
# Effects whose torque in a log follows from the torque that was measured.
INVERTED = {"deadzone", "saturation"}
DYNAMIC = {n for n, cls in effect_classes().items() if cls.memory}
WRAPPER = """#include "{p}.h"
int run(int count, int keep, const double *q, const double *v, const double *a,
        double *tau, double *variance)
{{
    {p}_state s;
    int j, k, bad = 0;
    {p}_start(&s, 0.01);
    for (k = 0; k < count * {n}; k += {n}) {{
        if (!keep)
            {p}_start(&s, 0.01);
        for (j = 0; j < {n}; j++)
            s.clamp[j] = INFINITY;
        if ({p}_torque(&s, q + k, v + k, a + k, tau + k, variance + k) < 0)
            bad = -1;
    }}
    return bad;
}}
"""


def model_of(robot, effects=(), **parts):
    """A model that knows the robot's links exactly."""
    labels, units = inertial_labels(robot.size)
    count = len(labels)
    links = robot.chain.inertial
    base = BaseParameters(
        labels, units, tuple(range(count)), np.eye(count), links.ravel()
    )
    return DynamicModel(robot, base, tuple(effects), inertial=links, **parts)


def mixture(seed, inputs, components):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(1500, inputs))
    y = np.sin(2 * x[:, :1]) + 0.3 * x[:, 1:2] ** 2 + 0.1 * rng.normal(size=(1500, 1))
    return fit_gmr(x, y, components=components, covariance_floor=1e-3)


@cache
def full_model():
    """The COMAN-like truth, with learned parts of different widths."""
    nominal, plant = load_truth(MODELS / "coman_truth.yaml")
    parts = [(0, (0,), (0,), 8), (3, (2, 3, 4), (3,), 20), (5, (5,), (4, 5), 3)]
    remainder = ArmRemainder(
        6,
        tuple(
            JointRemainder(j, p, v, mixture(j, len(p) + len(v), k))
            for j, p, v, k in parts
        ),
    )
    seen = {"q_min": np.full(6, -1.0), "q_max": np.full(6, 1.0), "v_max": np.ones(6)}
    robot = replace(plant.robot, path=nominal.path)
    sure = 1e-8 * np.eye(60)  # of all link parameters
    return model_of(
        robot, plant.effects, remainder=remainder, range=seen, covariance=sure
    )


def learned_variance(model, motion):
    """Variance of the learned torque, shape (N, n)."""
    _, variance = model.remainder.at_instant(motion.q.T, motion.v.T)
    return np.stack(np.broadcast_arrays(*variance, motion.t)[:-1], axis=1)


def motion_of(robot, samples, seed=0):
    q, v, a = random_states(robot.size, samples, seed)
    t = np.arange(samples) * 0.01
    return Motion(t, q, v, a, np.full_like(q, np.nan), np.ones(samples, bool))


def compiled(folder, name, n):
    """The exported header as a function of arrays."""
    (folder / "wrapper.c").write_text(WRAPPER.format(p=name, n=n))
    source, library = folder / "wrapper.c", folder / "wrapper.so"
    command = ["cc", *STRICT, "-shared", "-fPIC", "-o", library, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    run = ctypes.CDLL(str(library)).run
    pointer = ctypes.POINTER(ctypes.c_double)

    def torque(q, v, a, *, keep=False):
        arrays = [np.array(x, order="C") for x in (q, v, a)]
        arrays += [np.zeros_like(arrays[0]), np.zeros_like(arrays[0])]
        given = (x.ctypes.data_as(pointer) for x in arrays)
        bad = run(len(q), int(keep), *given)
        return bad, arrays[3], arrays[4]

    return torque


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Every format of the full model; its ranges are of few draws."""
    folder = tmp_path_factory.mktemp("exports")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("hybrid.exports.simulator.snippets"), "_DRAWS", 8)
        for kind in FORMATS:
            export(full_model(), folder / kind, format=kind)
    return folder


@pytest.fixture(scope="module")
def in_c(folders):
    """The full model, compiled."""
    return compiled(folders / "c", "coman_like", 6)


# --- the tape -------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [*map(random_arm, range(8)), public_arm("panda")])
def test_newton_euler_on_the_tape_is_the_regressor_form_of_the_dynamics(robot):
    model, motion = model_of(robot), motion_of(robot, 50)
    tau, _ = program_from_model(model).run(motion.q, motion.v, motion.a)
    columns = regressor(robot.chain, motion.q, motion.v, motion.a)
    expected = columns @ robot.chain.inertial.ravel()
    np.testing.assert_allclose(tau, expected, atol=1e-11 * np.abs(expected).max())


def test_a_tape_folds_constants_and_writes_nothing_twice():
    tape = Tape()
    x = tape.input("x")
    assert 0.0 * x == 0.0
    assert (1.0 * x + 0.0).line == x.line
    before = np.sin(x) * np.sin(x)
    assert (np.sin(x) * np.sin(x)).line == before.line
    assert np.clip(tape.input("x"), None, None).line == x.line
    (value,) = Law(tape, (before + x**3,), ("x",)).at([0.5])
    assert value == pytest.approx(np.sin(0.5) ** 2 + 0.125)


def test_a_law_that_branches_is_refused_with_advice():
    with pytest.raises(HybridError, match="use numpy.where"):
        bool(Tape().input("x") > 0)


def test_a_function_without_counterpart_is_refused_by_name():
    with pytest.raises(HybridError, match="arctan cannot be exported; valid are add"):
        np.arctan(Tape().input("x"))


# --- effects --------------------------------------------------------------------------


def joints_for(cls):
    return {"joint": (1,), "coupling": (3, 4), "arm": tuple(range(6))}[cls.scope]


@pytest.mark.parametrize("name", sorted(set(effect_classes()) - DYNAMIC))
def test_every_effect_is_exported_or_says_why_not(name):
    robot = full_model().robot
    cls = effect_class(name)
    effect = cls.typical(joints_for(cls), joint_scales(robot))
    model, motion = model_of(robot, [effect]), motion_of(robot, 40)
    if name in INVERTED:
        return  # see the next test
    program = program_from_model(model)
    if effect.not_in_loop:
        (said,) = program.left_out
        assert said.startswith(f"{name} of ") and said.endswith(effect.not_in_loop)
        model = model_of(robot)
    for k in range(0, 40, 13):  # one at a time: a law may depend on time
        q, v, a = (x[k : k + 1] for x in (motion.q, motion.v, motion.a))
        tau, _ = program.run(q, v, a, t=motion.t[k])
        np.testing.assert_allclose(
            tau[0], model.predict(motion)[k], rtol=1e-10, atol=1e-9
        )


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("deadzone", {"width": 5.0}),
        ("deadzone", {"width": 0.5}),
        ("saturation", {"loss": 0.4, "limit": 60.0}),
        ("saturation", {"loss": 1.0, "limit": 60.0}),
    ],
)
def test_a_drive_that_loses_torque_is_asked_for_what_it_then_delivers(name, values):
    robot = full_model().robot
    effect, motion = effect_class(name)((1,), values), motion_of(robot, 200)
    needed, asked = (
        program_from_model(model_of(robot, effects)).run(motion.q, motion.v, motion.a)
        for effects in ([], [effect])
    )
    found = effect.deliver(asked[0][:, 1])
    within = np.abs(needed[0][:, 1]) <= values.get("limit", np.inf)
    can = within | (values.get("loss", 1.0) < 1.0)
    can &= np.abs(needed[0][:, 1]) > 0.05 * values.get("width", 0.0)
    assert 20 < can.sum()
    np.testing.assert_allclose(found[can], needed[0][can, 1], rtol=1e-12)
    if name == "saturation" and not can.all():  # no windup beyond what it can do
        np.testing.assert_array_equal(asked[0][~can, 1], needed[0][~can, 1])


@pytest.mark.parametrize("name", ["backlash", "elasticity"])
def test_a_soft_gear_is_left_out_of_a_loop_and_the_manifest_says_so(name, tmp_path):
    robot = full_model().robot
    effect = effect_class(name).typical((1,), joint_scales(robot))
    left_out = export(model_of(robot, [effect]), tmp_path, format="c")
    assert read_manifest(tmp_path)["left_out"] == list(left_out)
    assert left_out[0].startswith(f"{name} of shoulder: it")


def test_an_effect_of_a_user_needs_nothing_more_than_its_law():
    class Cube(effect_class("viscous")):
        id = "cube"

        @staticmethod
        def law(state, **shapes):
            return (np.where(np.abs(state.v) > 0.1, state.v**3, 0.0),)

    robot = full_model().robot
    model, motion = model_of(robot, [Cube((2,), {"coefficient": 3.0})]), None
    motion = motion_of(robot, 100)
    tau, _ = program_from_model(model).run(motion.q, motion.v, motion.a)
    np.testing.assert_allclose(tau, model.predict(motion), atol=1e-10)


def test_an_effect_with_no_torque_at_one_instant_is_named():
    class Odd(Effect):
        id, port, gains = "odd", Port.DRIVE, Viscous.gains

        def columns(self, motion, body):
            return np.cumsum(motion.v[:, :1], axis=0)[:, :, None]

    with pytest.raises(EffectError, match="odd cannot run in a control loop"):
        program_from_model(model_of(full_model().robot, [Odd((0,))]))


# --- C --------------------------------------------------------------------------------


def test_c_is_python_on_ten_thousand_random_states(in_c):
    model, motion = full_model(), motion_of(full_model().robot, 10_000)
    bad, tau, variance = in_c(motion.q, motion.v, motion.a)
    assert bad == 0
    np.testing.assert_allclose(tau, model.predict(motion), rtol=0, atol=1e-9)
    expected = learned_variance(model, motion)
    np.testing.assert_allclose(variance, expected, rtol=0, atol=1e-9)


def test_c_remembers_what_dynamic_effects_need(tmp_path):
    robot = public_arm("ur10")
    effects = [
        Presliding((1,), {"level": 3.0, "distance": 0.02}),
        ActuatorLag((2,), {"time": -0.03}),
        Presliding((4,), {"level": 0.5, "distance": 0.1}),
    ]
    model = model_of(robot, effects)
    t = np.arange(300) * 0.01
    q = np.sin(np.outer(t, [3.0, 2.0, 4.0, 1.0, 5.0, 2.5]))
    v, a = (np.gradient(q, 0.01, axis=0, edge_order=2), -9.0 * q)
    motion = Motion(t, q, v, a, np.full_like(q, np.nan), np.ones(300, bool))
    export(model, tmp_path, format="c")
    bad, tau, _ = compiled(tmp_path, "ur10", 6)(q, v, a, keep=True)
    assert bad == 0
    np.testing.assert_allclose(tau, model.predict(motion), rtol=0, atol=1e-9)


def test_a_leading_drive_is_ahead_by_its_time_constant(tmp_path):
    robot = public_arm("ur10")
    model = model_of(robot, [ActuatorLag((1,), {"time": 0.02})])
    program, plain = program_from_model(model), program_from_model(model_of(robot))
    t = np.arange(200) * 0.001
    memory, lead, rigid = None, [], []
    for k in range(200):
        q = np.full((1, 6), 0.5 * np.sin(2.0 * t[k]))
        v, a = np.cos(2.0 * t[k]) + 0 * q, -4.0 * q
        tau, memory = program.run(q, v, a, memory=memory, step=0.001)
        lead.append(tau[0, 1])
        rigid.append(plain.run(q, v, a)[0][0, 1])
    # The difference looks back by half a step.
    slope = np.diff(rigid) / 0.001
    np.testing.assert_allclose(lead[1:], rigid[1:] + 0.02 * slope, rtol=1e-9)


def test_a_leading_drive_shows_no_noise_that_no_fit_has_seen():
    """Its lead of a noisy torque is bounded, as a prediction is, and right below it."""
    robot, cutoff, time, step = public_arm("ur10"), 10.0, 0.02, 0.001
    rng, t = np.random.default_rng(0), np.arange(4000) * 0.001
    at_rest = np.zeros((len(t), 6))
    noise = rng.normal(size=at_rest.shape)

    def along(program, a):
        memory, found = None, []
        for x in a[:, None]:
            tau, memory = program.run(x * 0, x * 0, x, memory=memory, step=step)
            found.append(tau[0, 1])
        return np.array(found)

    model = replace(model_of(robot, [ActuatorLag((1,), {"time": time})]), cutoff=cutoff)
    led, plain = (program_from_model(x) for x in (model, model_of(robot)))
    most = 1.0 + time * 2 * np.pi * LOWER_BAND * cutoff
    assert along(led, noise).std() < most * along(plain, noise).std()
    slow = np.outer(np.sin(2 * np.pi * 0.5 * t), np.ones(6))
    motion = Motion(t, at_rest, at_rest, slow, at_rest, np.ones(len(t), bool))
    expected, moved = model.predict(motion)[:, 1], along(plain, slow)
    error = (along(led, slow) - expected)[500:-500]
    assert np.abs(error).max() < 0.15 * np.abs(expected - moved)[500:-500].max()


def test_c_refuses_numbers_that_are_not_finite(in_c):
    zero = np.zeros((1, 6))
    for k, bad in enumerate((np.nan, np.inf, -np.inf)):
        states = [zero.copy() for _ in range(3)]
        states[k][0, 2] = bad
        status, tau, _ = in_c(*states)
        assert status == -1
        assert not tau.any()


def test_the_c_example_builds_with_cmake_in_both_precisions(folders, tmp_path):
    for command in (
        ["cmake", "-S", folders / "c", "-B", tmp_path],
        ["cmake", "--build", tmp_path],
        ["ctest", "--test-dir", tmp_path],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


# --- ONNX -----------------------------------------------------------------------------


def session(folder, name):
    runtime = pytest.importorskip("onnxruntime", reason="an optional extra")
    return runtime.InferenceSession(folder / f"{name}.onnx")


@pytest.fixture(scope="module")
def in_onnx(folders):
    """The full model, as ONNX's runtime has it."""
    return session(folders / "onnx", "coman_like")


def test_onnx_is_python_for_any_batch(in_onnx):
    model, run = full_model(), in_onnx.run
    for samples in (1, 7, 2000):
        motion = motion_of(model.robot, samples, seed=samples)
        tau, variance = run(None, {"q": motion.q, "v": motion.v, "a": motion.a})
        np.testing.assert_allclose(tau, model.predict(motion), rtol=0, atol=1e-6)
        expected = learned_variance(model, motion)
        np.testing.assert_allclose(variance, expected, rtol=0, atol=1e-6)


def test_onnx_hands_its_memory_back(tmp_path):
    robot = public_arm("ur10")
    model = model_of(robot, [Presliding((1,), {"level": 3.0, "distance": 0.02})])
    export(model, tmp_path, format="onnx")
    run, program = session(tmp_path, "ur10").run, program_from_model(model)
    memory, known = np.zeros((1, 2)), np.zeros((1, 1))
    ours = None
    for k in range(20):
        q = np.full((1, 6), 0.1 * np.sin(k))
        v, a = np.full((1, 6), np.cos(k)), 0.0 * q
        given = {"q": q, "v": v, "a": a, "memory": memory, "known": known}
        tau, _, memory = run(None, given)
        expected, ours = program.run(q, v, a, memory=ours)
        known = np.ones((1, 1))
        np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9)


def test_onnx_carries_its_manifest(folders, in_onnx):
    found = in_onnx.get_modelmeta().custom_metadata_map
    manifest = json.loads((folders / "onnx" / "manifest.json").read_text())
    assert found["model_sha256"] == manifest["model_sha256"]
    assert json.loads(found["joints"]) == manifest["joints"]


# --- TorchScript ----------------------------------------------------------------------

LOADED = """
import json, sys, warnings
import numpy as np
import torch
warnings.simplefilter("ignore")  # torch announces the end of TorchScript
extra = {"manifest.json": ""}
module = torch.jit.load(sys.argv[1], _extra_files=extra)
for path in sys.argv[2:]:
    given = np.load(path)
    tau, variance = module(*(torch.tensor(given[k]) for k in "qva"))
    np.savez(path, tau=tau.numpy(), variance=variance.numpy())
assert "hybrid" not in sys.modules
print(json.loads(extra["manifest.json"])["model_sha256"])
"""


def test_torchscript_is_python_in_another_process_for_any_batch(folders, tmp_path):
    model = full_model()
    archive = folders / "torchscript" / "coman_like.pt"
    motions = {
        tmp_path / f"{samples}.npz": motion_of(model.robot, samples, seed=samples)
        for samples in (1, 500)
    }
    for path, motion in motions.items():
        np.savez(path, q=motion.q, v=motion.v, a=motion.a)
    done = subprocess.run(
        [sys.executable, "-c", LOADED, str(archive), *map(str, motions)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    manifest = json.loads((archive.parent / "manifest.json").read_text())
    assert done.stdout.strip() == manifest["model_sha256"]
    for path, motion in motions.items():
        found = np.load(path)
        expected = model.predict(motion)
        np.testing.assert_allclose(found["tau"], expected, rtol=0, atol=1e-9)
        expected = learned_variance(model, motion)
        np.testing.assert_allclose(found["variance"], expected, rtol=0, atol=1e-9)


def test_an_archive_names_no_file_of_this_computer(folders):
    with zipfile.ZipFile(folders / "torchscript" / "coman_like.pt") as archive:
        for name in archive.namelist():
            assert str(Path(hybrid.__file__).parent).encode() not in archive.read(name)


def test_a_torch_module_hands_its_memory_back():
    import torch

    from hybrid.exports.torch_module import ProgramModule

    robot = public_arm("ur10")
    model = model_of(robot, [Presliding((1,), {"level": 3.0, "distance": 0.02})])
    program = program_from_model(model)
    module = ProgramModule(program)
    assert module.names == ["known", "memory"]
    memory, known, ours = torch.zeros(1, 2).double(), torch.zeros(1, 1).double(), None
    for k in range(20):
        q = np.full((1, 6), 0.1 * np.sin(k))
        v, a = np.full((1, 6), np.cos(k)), 0.0 * q
        tau, _, memory = module(*map(torch.tensor, (q, v, a)), known, memory)
        expected, ours = program.run(q, v, a, memory=ours)
        known = torch.ones(1, 1).double()
        np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9)


# --- manifest and command -------------------------------------------------------------


@pytest.mark.parametrize("kind", FORMATS)
def test_a_manifest_says_what_the_numbers_mean(folders, kind):
    model = full_model()
    found = read_manifest(folders / kind)
    assert found["joints"] == list(model.robot.joints)
    assert found["version"] == hybrid.__version__
    assert found["units"]["tau"] == "N·m"
    assert found["training_range"]["q_max"] == [1.0] * 6
    assert found["limits"]["tau_max"] == list(model.robot.tau_max)


def test_another_version_is_refused(tmp_path):
    model = model_of(Robot.load(MODELS / "planar.xml"))
    export(model, tmp_path, format="json")
    path = tmp_path / "manifest.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "version": "0.0.9"}))
    with pytest.raises(ModelFileError, match="version 0.0.9 .* export the model again"):
        read_manifest(tmp_path)


def test_files_that_always_change_are_not_taken_unchecked(tmp_path, monkeypatch):
    export(model_of(Robot.load(MODELS / "planar.xml")), tmp_path, format="json")
    read, count = manifest.read_json, iter(range(10**6))
    (tmp_path / next(iter(read(tmp_path / "manifest.json")["files"]))).unlink()
    again = lambda path: read(path) | {"count": next(count)}  # noqa: E731
    monkeypatch.setattr(manifest, "read_json", again)
    with pytest.raises(ModelFileError, match="missing"):
        read_manifest(tmp_path)


def test_a_changed_file_is_noticed(tmp_path):
    export(model_of(Robot.load(MODELS / "planar.xml")), tmp_path, format="c")
    header = tmp_path / "planar.h"
    header.write_text(header.read_text().replace("#define PLANAR_JOINTS 2", "", 1))
    with pytest.raises(ModelFileError, match="planar.h: changed since"):
        read_manifest(tmp_path)


def test_an_exported_model_file_is_the_model(folders):
    again, motion = DynamicModel.load(folders / "json" / "model.json"), None
    motion = motion_of(again.robot, 20)
    assert np.array_equal(again.predict(motion), full_model().predict(motion))


def test_an_unknown_format_is_refused_with_the_valid_ones(tmp_path):
    with pytest.raises(HybridError, match="no format 'pickle'; valid are onnx, torch"):
        export(full_model(), tmp_path, format="pickle")
    assert not list(tmp_path.iterdir())


def test_the_command_exports_and_says_what_is_missing(folders, tmp_path, capsys):
    given = ["--model", str(folders / "json" / "model.json"), "--format", "urdf"]
    assert main(["export", *given, "--out", str(tmp_path / "arm")]) == 0
    assert "not in it: torque_ripple of wrist_3" in capsys.readouterr().out
    assert read_manifest(tmp_path / "arm")["format"] == "urdf"


def test_every_operation_of_a_tape_has_its_c_onnx_and_torch():
    from hybrid.exports import c_code, onnx_graph, torch_module

    for name in OPERATIONS:
        assert name in onnx_graph._NAMES
        assert name in torch_module._OPERATIONS
        template = c_code._OPERATIONS[name]
        assert "x0" in template.format("x0", "x1", "x2", P="P")


def test_a_second_format_in_the_same_folder_keeps_the_first(tmp_path):
    model = model_of(Robot.load(MODELS / "planar.xml"))
    for kind in ("c", "json", "urdf", "json"):
        export(model, tmp_path, format=kind)
    found = read_manifest(tmp_path)
    assert found["format"] == "json" and set(found["files"]) == {"model.json"}
    assert set(found["beside"]) == {"c", "urdf"}
    assert "planar.h" in found["beside"]["c"]["files"]
    (tmp_path / "planar.urdf").write_text("<robot/>")
    with pytest.raises(ModelFileError, match="planar.urdf: changed since"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("damage", ["", "[]", "{", '{"schema": "hybrid.export/2"}'])
def test_a_damaged_manifest_is_refused_and_does_not_stop_an_export(tmp_path, damage):
    model = model_of(Robot.load(MODELS / "planar.xml"))
    (tmp_path / "manifest.json").write_text(damage)
    with pytest.raises(ModelFileError, match=r"manifest\.json: .*manifest"):
        read_manifest(tmp_path)
    export(model, tmp_path, format="c")
    assert read_manifest(tmp_path)["beside"] == {}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs POSIX")
def test_whenever_it_is_killed_an_export_and_a_model_can_be_read(tmp_path):
    old, new = (
        model_of(replace(Robot.load(MODELS / "planar.xml"), name="arm"), effects)
        for effects in ((), (Viscous((0,), {"coefficient": 1.0}),))
    )
    folder, path = tmp_path / "out", tmp_path / "model.json"
    seen = set()
    for step in range(100):
        export(old, folder, format="c")
        old.save(path)

        def work():
            export(new, folder, format="c")
            new.save(path)

        died = killed_at(step, work)
        digest = read_manifest(folder)["model_sha256"]
        saved = content_from_model(DynamicModel.load(path))["sha256"]
        first, second = (content_from_model(x)["sha256"] for x in (old, new))
        assert {digest, saved} <= {first, second}
        seen.add((digest == second, saved == second))
        if not died:
            break
    assert seen == {(False, False), (True, False), (True, True)} and step > 10


# A process of its own, without threads: children of one with threads may not load code.
WRITERS = """
import os, sys
from dataclasses import replace
from hybrid.effects.viscous import Viscous
from hybrid.exports import export
from hybrid.identification import DynamicModel

folder, path, *kinds = sys.argv[1:]
model, children = DynamicModel.load(path), []
for k in range(10):
    if child := os.fork():
        children.append(child)
        continue
    other = replace(model, effects=(Viscous((0,), {"coefficient": float(k)}),))
    for _ in range(5):
        export(other, folder, format=kinds[k % 4])
        other.save(path)
    os._exit(0)
sys.exit(any([os.waitpid(child, 0)[1] for child in children]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs POSIX")
@pytest.mark.study
def test_who_reads_while_ten_export_and_save_finds_one_whole_export(tmp_path):
    model = model_of(Robot.load(MODELS / "planar.xml"))
    folder, path = tmp_path / "out", tmp_path / "model.json"
    kinds = ("c", "json", "urdf", "mjcf")
    for kind in kinds:
        export(model, folder, format=kind)
    model.save(path)
    single = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", WRITERS, folder, path, *kinds]
    writers, reads = subprocess.Popen(command, env=single), 0
    while writers.poll() is None:
        found = read_manifest(folder)
        assert {found["format"], *found["beside"]} == set(kinds)
        assert DynamicModel.load(path).robot.name == "planar"
        reads += 1
    assert writers.returncode == 0 and reads > 10
    assert set(tmp_path.iterdir()) == {folder, path}
