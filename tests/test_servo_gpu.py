"""Replays where JAX computes: those of MuJoCo's C, or one clear line."""

import copy
from contextlib import nullcontext
from dataclasses import replace
from operator import attrgetter
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np
import pytest

from hybrid.cli import main
from hybrid.errors import HybridError
from hybrid.recording import Recording, write
from hybrid.robot import Robot
from hybrid.servo.drive import Drive
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch

LINK = """<body name="{name}" pos="0 0 0.11"><joint name="{name}" axis="{axis}"
  range="-1.9 1.9" damping="0.6" frictionloss="0.05" armature="0.028"/>
  <inertial pos="0 0.01 0.05" mass="0.1" diaginertia="1e-4 9e-5 3e-5"/>{next}</body>"""
AXES = {"pan": "0 0 1", "lift": "0 1 0", "elbow": "0 1 0"}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """An arm of light links behind strong servos."""
    links, servos = "", ""
    for name, axis in reversed(AXES.items()):
        links = LINK.format(name=name, axis=axis, next=links)
        servos += f'<position joint="{name}" kp="900" kv="2.7" forcerange="-3 3"/>'
    path = tmp_path_factory.mktemp("gpu") / "arm.xml"
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody>{links}</worldbody>'
        f"<actuator>{servos}</actuator></mujoco>"
    )
    return path


def stretch(samples: int) -> Stretch:
    """Tones and a step at 50 Hz."""
    t = 0.02 * np.arange(samples)[:, None]
    goal = np.array([0.4, 1.2, 0.5]) + 0.6 * np.sin(t * np.array([2.0, 3.1, 4.3]))
    goal[samples // 2 :] += 0.2
    return Stretch(0.02, goal, goal, np.zeros(3))


def test_replays_by_mjx_are_those_of_mujoco(path, monkeypatch):
    pytest.importorskip("jax")
    pytest.importorskip("mujoco.mjx")
    from hybrid.servo import accelerated

    monkeypatch.setattr(accelerated, "_STEPS", 128)
    monkeypatch.setattr(accelerated, "_LEAST", 32)
    robot, parts = Robot.load(path), [stretch(76), stretch(50)]
    file = Drive.declared(robot)
    usual = file.at(
        stiffness=12.0, damping=0.8, coulomb=0.2, armature=0.02, delay=0.013
    )
    changed = (
        {}, {"dead_band": 0.02}, {"stall": 0.3}, {"stiction": 0.15}, {"mass": 1.5},
        {"spring": 2.0, "offset": 0.1}, {"upper": 0.8}, {"sign": -1.0, "zero": 0.1},
        {"ground": np.array([-1.0, -1.0, 0.2])},
    )  # fmt: skip
    drives = [usual.at(**x) for x in changed]
    simulator = ServoSimulator(robot)
    exact = simulator.replay(parts, drives)
    simulator.roll = accelerated.GpuRollout(robot)
    found = simulator.replay(parts, drives)
    moved = [np.concatenate(x) for x in exact]
    assert all(np.abs(x - moved[0]).max() > 1e-3 for x in moved[1:])  # all of them act
    for x, y in zip(moved, map(np.concatenate, found), strict=True):
        assert np.sqrt(np.mean((x - y) ** 2, axis=0)).max() < 1e-6


def test_damping_that_mjx_ignores_is_refused(path):
    from hybrid.servo.accelerated import GpuRollout

    robot = Robot.load(path)
    curved = replace(robot, cubic=np.array([0.0, 0.1, 0.0]))
    with pytest.raises(HybridError, match="quadratic and cubic damping of lift;"):
        GpuRollout(curved)


def test_without_jax_one_line_says_what_to_install(path, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("hybrid.extras.find_spec", lambda _: None)
    with pytest.raises(HybridError, match="hybrid-arm\\[gpu\\]"):
        ServoSimulator(Robot.load(path), gpu=True)
    part, out = stretch(150), tmp_path / "fixed.xml"
    t = part.step * np.arange(len(part.q))
    log = Recording(t, part.q, command=part.command, joints=tuple(AXES), source="a")
    write(log, tmp_path / "a.csv")
    asked = ["--robot", str(path), "--recordings", str(tmp_path / "a.csv"), "--gpu"]
    assert main(["identify", *asked, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "pip install 'hybrid-arm[gpu]'" in said and len(said.splitlines()) == 1
    assert not out.exists()


def sliced(x, k):
    """Element k of every array of nested containers."""
    if isinstance(x, dict):
        return {name: sliced(y, k) for name, y in x.items()}
    if isinstance(x, list | tuple):
        return type(x)(sliced(y, k) for y in x)
    return x[k]


class Slow:
    """What is used of JAX and MJX, by NumPy and MuJoCo in loops."""

    def __init__(self):
        self.numpy, self.lax = np, SimpleNamespace(scan=self.scan)
        self.calls = []

    @staticmethod
    def scan(step, state, inputs):
        out = []
        for x in inputs:
            state, y = step(state, x)
            out.append(y)
        return state, np.array(out)

    def vmap(self, f, in_axes):
        assert in_axes == (None, None, 0, 0, 0)

        def loop(*given):
            count = len(given[3])
            self.calls.append(count)
            found = [
                f(*given[:2], *(sliced(x, k) for x in given[2:])) for k in range(count)
            ]
            states = tuple(np.array([x[0][i] for x in found]) for i in range(3))
            return states, np.array([x[1] for x in found])

        return loop

    @staticmethod
    def put_model(model):
        def tree_replace(own):
            new = copy.copy(model)
            new.opt.timestep = own["opt.timestep"]
            for name in own.keys() - {"opt.timestep"}:
                attrgetter(name)(new)[:] = own[name]
            return new

        return SimpleNamespace(tree_replace=tree_replace)

    @staticmethod
    def step(model, now):
        data = mujoco.MjData(model)
        for name, x in now.items():
            getattr(data, name)[:] = x
        mujoco.mj_step(model, data)
        return data


@pytest.fixture
def slow(monkeypatch):
    from hybrid.servo import accelerated

    made, jax, mjx = Slow(), ModuleType("jax"), ModuleType("mujoco.mjx")
    jax.numpy, jax.lax, jax.vmap, jax.jit = np, made.lax, made.vmap, lambda f: f
    jax.enable_x64, jax.device_put = lambda _: nullcontext(), lambda x: x
    mjx.put_model, mjx.step = made.put_model, made.step
    mjx.make_data = lambda model: SimpleNamespace(replace=dict)
    for name, module in (("jax", jax), ("mujoco.mjx", mjx)):
        monkeypatch.setitem(__import__("sys").modules, name, module)
    monkeypatch.setattr(mujoco, "mjx", mjx, raising=False)
    accelerated._loop.cache_clear()
    yield made
    accelerated._loop.cache_clear()


def test_the_loop_for_a_gpu_has_the_law_of_mujoco_s_motor(path, slow, monkeypatch):
    """Where neither JAX nor MJX is installed, by loops in their place."""
    from hybrid.servo import accelerated

    monkeypatch.setattr(accelerated, "_STEPS", 24)
    monkeypatch.setattr(accelerated, "_LEAST", 2)
    robot, parts = Robot.load(path), [stretch(16), stretch(9)]
    file = Drive.declared(robot)
    usual = file.at(
        stiffness=12.0, damping=0.8, coulomb=0.2, armature=0.02, delay=0.013
    )
    drives = [
        usual,
        usual.at(dead_band=0.02, stiction=0.15, mass=1.5, spring=2.0, offset=0.1),
        usual.at(stall=0.3, upper=0.8, sign=-1.0, zero=0.1),
    ]
    simulator = ServoSimulator(robot)
    exact = simulator.replay(parts, drives)
    simulator.roll = accelerated.GpuRollout(robot)
    found = simulator.replay(parts, drives)
    assert slow.calls == [8, 8, 8]  # 60 steps in calls of 24, of 6 replays and 2 more
    for x, y in zip(exact, found, strict=True):
        for a, b in zip(x, y, strict=True):
            assert np.sqrt(np.mean((a - b) ** 2, axis=0)).max() < 1e-6
    assert np.abs(exact[0][0] - exact[1][0]).max() > 1e-3
    ((alone,),) = simulator.replay(parts[:1], drives[:1])
    np.testing.assert_allclose(alone, exact[0][0], atol=1e-6)


def test_a_gpu_is_asked_for_and_none_is_seen(path, slow, monkeypatch):
    import jax

    monkeypatch.setattr("hybrid.extras.find_spec", lambda _: object())
    cpu, gpu = SimpleNamespace(platform="cpu"), SimpleNamespace(platform="gpu")
    for seen, refused in (([cpu], True), ([cpu, gpu], False), ([gpu], False)):
        jax.devices = lambda seen=seen: seen
        if refused:
            with pytest.raises(HybridError, match="JAX sees none"):
                ServoSimulator(Robot.load(path), gpu=True)
        else:
            ServoSimulator(Robot.load(path), gpu=True)


@pytest.mark.parametrize(
    ("replays", "compiled"),
    [(1, 256), (256, 256), (257, 1024), (1024, 1024), (1025, 4096), (4097, 16384)],
)
def test_a_loop_is_compiled_for_powers_of_four(replays, compiled):
    from hybrid.servo.accelerated import _padded

    assert _padded(replays) == compiled
