"""Right logs of simulated arms for ``wrong_logs.py``: arms that are not as their files.

Inertias, rotors and friction are off by up to two; files know no friction; the arm
carries something, moves little, is logged rarely or briefly, holds a joint still, or
has a fault that a diagnosis is to find. And what is said of wrong ones. Nothing prints.
"""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from blind.robots import off_by

from hybrid.effects import Effect
from hybrid.effects.delay import Delay
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.payload import Payload
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.inspect import inspect_recording
from hybrid.inspect.doubt import Doubt
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.spatial import central_inertia, inertial_about

_PATH = Path(__file__).parents[1] / "tests" / "wrong_logs.py"
_SPEC = importlib.util.spec_from_file_location("wrong_logs_made", _PATH)
assert _SPEC is not None and _SPEC.loader is not None
made: Any = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = made
_SPEC.loader.exec_module(made)

RARE = slice(None, None, 10)  # of 500 Hz
BRIEF = slice(0, 1500)
COUNT = 1e-6  # rad, noise of an encoder at rest


def wrong_logs(robot: Robot, seeds: int) -> list[tuple[Any, ...]]:
    """Arm, log, log of small motion, and two joints, for each seed."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        real = off_by(robot, 0.3, rng)
        log, small = (
            made.healthy(real, nominal=robot, seed=seed, reach=reach)
            for reach in (None, 0.08)
        )
        pair = sorted(rng.permutation(robot.size)[:2].tolist())
        found.append((robot, log, small, pair))
    return found


def off_by_two(robot: Robot, rng: np.random.Generator) -> Robot:
    """The arm with every number half to twice as large, all physical."""
    links = robot.chain.inertial.copy()
    for k, link in enumerate(links):
        if link[0] > 0:
            mass, centre, about = central_inertia(link)
            m, c, i = (2.0 ** rng.uniform(-1, 1, n) for n in (1, 3, 1))
            links[k] = inertial_about(float(mass * m[0]), centre * c, about * i[0])
    rotor, viscous, dry = 2.0 ** rng.uniform(-1, 1, (3, robot.size))
    return replace(
        robot,
        chain=replace(
            robot.chain, inertial=links, armature=robot.chain.armature * rotor
        ),
        damping=robot.damping * viscous,
        frictionloss=robot.frictionloss * dry,
    )


def right_logs(robot: Robot, seed: int) -> Iterator[tuple[str, Robot, Recording]]:
    """Kind, what its file says of the arm, and a log that is right."""
    rng, n = np.random.default_rng(seed), robot.size
    none, every = np.zeros(n), tuple(range(n))
    real = off_by_two(robot, rng)
    log = made.healthy(real, nominal=robot, seed=seed)
    yield "off by two", robot, log
    bare = replace(robot.chain, armature=none)
    bare_file = replace(robot, chain=bare, damping=none, frictionloss=none)
    yield "file without friction and rotors", bare_file, log
    for kind, kept in (("50 Hz", RARE), ("3 s", BRIEF)):
        part = {name: x[kept] for name, x in log.channels.items()}
        yield kind, robot, replace(log, t=log.t[kept], **part)
    yield "small motion", robot, made.healthy(robot, seed=seed, fill=0.08)
    j, k = (int(x) for x in rng.integers(0, n, 2))
    effects: dict[str, Effect] = {
        "torque gain 0.58": TorqueGain((j,), {"gain": -0.42}),
        "torque offset": TorqueOffset((j,), {"level": 0.05 * robot.tau_max[j]}),
        "delay of 20 ms": Delay((j,), {"time": 0.02}),
        "encoder offset": EncoderOffset((j,), {"offset": 0.05}),
        "payload": Payload.typical(every, joint_scales(robot)),
    }
    for kind, effect in effects.items():
        yield kind, robot, made.healthy(robot, effects=[effect], seed=seed)
    yield "joint at rest", robot, made.healthy(robot, seed=seed, rest=k, count=COUNT)


def said_of_right(robots: Sequence[Robot], seeds: int) -> dict[str, Counter[str]]:
    """How many logs there are of each kind, and how many have errors and warnings."""
    said = {name: Counter[str]() for name in ("logs", "errors", "warnings")}
    for robot in robots:
        for seed in range(seeds):
            for kind, file, log in right_logs(robot, seed):
                doubts = inspect_recording(log, file).doubts
                said["logs"][kind] += 1
                for severity in {d.severity for d in doubts}:
                    said[f"{severity}s"][f"{kind}, {robot.name}: {doubts[0].line}"] += 1
    return said


def _kind(doubt: Doubt) -> tuple[object, ...]:
    return doubt.channel, doubt.joints, doubt.remedy


def outcome(robot: Robot, log: Recording, way: Any, i: int, j: int) -> str:
    """What is said of a wrong log, and not of the right one that it was made of."""
    of_right = {_kind(d) for d in inspect_recording(log, robot).doubts}
    doubts = inspect_recording(way.make(log, i, j), robot).doubts
    doubts = tuple(d for d in doubts if _kind(d) not in of_right)
    columns = made.about(way, i, j)
    right = [
        d
        for d in doubts
        if d.channel in way.channels and any(w in d.line for w in way.words)
    ]
    named = {j for d in right for j in d.joints}
    if any(d.severity == "error" for d in doubts):
        return "right" if right and columns <= named else "caught"
    return "warned" if doubts else "missed"
