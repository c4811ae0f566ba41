"""Online identification of a six-axis arm: time per sample, payloads, false alarms.

A table appears: time per sample at 1 kHz; time to notice a payload grasped or dropped
and to know its mass; false alarms per hour on an arm with exactly the tracked effects
and on a MuJoCo plant with effects that nobody tracks; what an hour of standstill does.

    python benchmarks/online.py --hours 1
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hybrid.dynamics import inverse_dynamics
from hybrid.effects import effects_from_text
from hybrid.files import atomic_path
from hybrid.identify.online import OnlineIdentifier, Sample
from hybrid.plant import Noise, load_truth, random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.report import numbers_table, provenance, write_results
from hybrid.report.table import Table, markdown_table
from hybrid.robot import Robot
from hybrid.robot.chain import Array

ROOT = Path(__file__).parents[1]
ARM = Robot.load(ROOT / "models" / "coman_like.xml")
EFFECTS = effects_from_text("coulomb,viscous,stribeck", ARM.joints, joint_scales(ARM))
TORQUE, SPEED = np.array([(s.torque, s.speed) for s in joint_scales(ARM)]).T


def simulated(
    seconds: float, rate: float, seed: int, mass: float = 0.0, at: float = np.inf
) -> tuple[Array, Array, Array, Array]:
    """Clock, position and torque of an arm 15 % off its file, and its true links."""
    rng = np.random.default_rng(seed)
    ref = random_fourier(ARM, duration=seconds, rate=rate, rng=rng)
    links = ARM.chain.inertial * rng.uniform(0.85, 1.15, (6, 1))
    loaded = links.copy()
    loaded[-1] += mass * np.array([1, 0, 0, 0.1, 0.02, 0, 0.02, 0, 0, 0.005])
    before, after = (
        inverse_dynamics(ARM.chain, x, ref.q, ref.v, ref.a) for x in (links, loaded)
    )
    tau = np.where(ref.t[:, None] < at, before, after) + 0.05 * TORQUE / SPEED * ref.v
    tau += TORQUE * (0.04 + 0.03 * np.exp(-((ref.v / 0.05) ** 2))) * np.sign(ref.v)
    noise = replace(Noise.typical(ARM), speed_std=np.zeros(6))
    signals = noise.apply({"q": ref.q, "v": ref.v, "tau": tau}, rate=rate, rng=rng)
    return ref.t, signals["q"], signals["tau"], links


def alarms(clock: Array, q: Array, tau: Array, tracker: OnlineIdentifier) -> int:
    """Changes noticed along a log without any."""
    for k, t in enumerate(clock):
        tracker.update(Sample(t, q[k], tau[k]))
    return len(tracker.changes)


def time_per_sample() -> dict[str, float]:
    """Microseconds of one update at 1 kHz, over 10 s."""
    t, q, tau, _ = simulated(10.0, 1000.0, 0)
    tracker, taken = OnlineIdentifier(ARM, EFFECTS, rate=1000.0), []
    for k in range(len(t)):
        start = time.process_time_ns()
        tracker.update(Sample(t[k], q[k], tau[k]))
        taken.append((time.process_time_ns() - start) / 1000)
    steady = np.array(taken[200:])
    return {"mean": steady.mean(), "median": np.median(steady), "p99": np.percentile(steady, 99)}  # fmt: skip


def payload(mass: float, seed: int) -> tuple[float, float, float]:
    """Seconds until it is noticed, and relative error of the mass 0.5 s and 2 s after."""
    at = 10.0 + 0.31 * seed
    t, q, tau, _ = simulated(at + 3.0, 1000.0, seed, mass, at)
    tracker, found = OnlineIdentifier(ARM, EFFECTS, rate=1000.0), [np.nan] * 2
    for k in range(len(t)):
        tracker.update(Sample(t[k], q[k], tau[k]))
        if tracker.changes:
            since = round((t[k] - tracker.changes[0].t) * 1000)
            for i, after in enumerate((500, 2000)):
                found[i] = abs(tracker.taken[0] / mass - 1) if since == after else found[i]
    noticed = tracker.changes[0].t - at if tracker.changes else np.inf
    return noticed, found[0], found[1]
