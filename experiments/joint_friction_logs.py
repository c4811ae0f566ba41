"""Simulated logs of an arm with improved Stribeck friction. Nothing here prints.

The arm is the repository's COMAN-like one, with the published friction of joints 1–3;
the wrist, not published, has a quarter of it. The motion is prescribed; the log holds
its position on a 19-bit encoder and rigid torque + friction + ripple, 5 % of f_C unless
said otherwise, which no law here knows, + correlated noise (1 % of f_S).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from improved_stribeck_law import ImprovedStribeck

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody, inverse_dynamics
from hybrid.effects import JointState
from hybrid.plant import Noise
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler, motion_from_recording

ROOT = Path(__file__).parents[1]
NAMES = ("f_C", "f_S", "v_s", "f_V", "f_P", "v_0")
TRUE = np.array(
    [
        [11.64, 23.19, 0.02767, 27.88, 0.47, 0.010],
        [39.93, 73.24, 0.01292, 89.24, -3.34, 0.005],
        [38.53, 53.78, 0.01557, 89.49, -4.74, 0.010],
    ]
)
RATE, CUTOFF, REPEATS, RIPPLE = 500.0, 10.0, 10, 0.05
ARM = Robot.load(ROOT / "models" / "coman_like.xml")
ALL_TRUE = np.vstack([TRUE, TRUE * [0.25, 0.25, 1, 0.25, 0.25, 1]])


def improved(v: Array, p: Array) -> Array:
    """The law at speeds (N,) for parameters (..., 6) in the order of NAMES."""
    f_C, f_S, v_s, f_V, f_P, v_0 = np.moveaxis(np.asarray(p)[..., None], -2, 0)
    rest = np.zeros_like(v)
    state = JointState(rest, rest, v, rest, np.sign(v), rest)
    slide, stick, drag = ImprovedStribeck.law(state, velocity=v_s, width=v_0)
    return np.asarray(f_C * slide + f_S * stick + f_V * drag + f_P)


def logged(q: Array, rng: np.random.Generator, ripple: float = RIPPLE) -> Motion:
    """What the arm logs along a motion (N, 6), filtered and differentiated."""
    v, a = (
        np.gradient(x, 1 / RATE, axis=0) for x in (q, np.gradient(q, 1 / RATE, axis=0))
    )
    tau = inverse_dynamics(ARM.chain, ARM.chain.inertial, q, v, a)
    f_C, f_S = ALL_TRUE[:, 0], ALL_TRUE[:, 1]
    tau += np.stack([improved(v[:, j], ALL_TRUE[j]) for j in range(ARM.size)], axis=1)
    tau += ripple * f_C * np.sin(100 * q)
    noise = replace(Noise.typical(ARM), torque_covariance=np.diag((0.01 * f_S) ** 2))
    signals = noise.apply({"q": q, "v": v, "tau": tau}, rate=RATE, rng=rng)
    t = np.arange(len(q)) / RATE
    log = Recording(t=t, q=signals["q"], tau=signals["tau"], joints=ARM.joints)
    return motion_from_recording(log, cutoff=CUTOFF)


def one_joint(
    joint: int, angles: list[Array], rng: np.random.Generator, ripple: float = RIPPLE
) -> tuple[Array, Array]:
    """Speed and friction torque of one moving joint, repeats averaged, filtered."""
    parts = []
    for angle in angles:
        q = np.tile([0.0, 0.5, -0.7, 0.3, 0.6, 0.0], (len(angle), 1))
        q[:, joint] = angle
        logs = [logged(q, rng, ripple) for _ in range(REPEATS)]
        torque = [m.tau - RigidBody(ARM.chain, m).load for m in logs]
        sampler = Sampler.for_rate(RATE, CUTOFF)
        used = sampler.keep(logs[0].mask)
        v = np.mean([m.v[:, joint] for m in logs], axis=0)[:: sampler.factor]
        parts.append((v[used], sampler(np.mean(torque, axis=0)[:, joint])[used]))
    v, y = (np.concatenate(x) for x in zip(*parts, strict=True))
    return v, y
