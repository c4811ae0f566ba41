"""The COMAN-like arm with hoses and grease, moved by design: one run, scored.

It prints nothing by itself. Motions are designed for fitting and drawn at random for
scoring, so nothing is shared.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from coman import TRUTH, Run
from hose_and_grease import unmodelled
from published_chain import Chain, beside, published_chain

from hybrid import Fit, Motion, Robot, identify, validate
from hybrid.arrays import Array
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.excitation import Fourier, Limits, design, observe
from hybrid.identification import DynamicModel, Validation
from hybrid.plant import Noise, Plant, Reference, load_truth, random_fourier
from hybrid.plant.scale import joint_scales

_FAMILY = Fourier(5, 0.1)
_DESIGNED, _FILL = 0.8, 0.7  # share of the limits that either kind of motion may use
# What a fit may find beside the rigid body: torque over position among it, or a design
# has no reason to visit the range.
_SOUGHT = "viscous,coulomb,spring,torque_ripple(periods=1)"
_DESIGN_RATE = 10.0  # Hz


@dataclass(frozen=True)
class Repeat(DynamicModel):
    """The plant itself: what it delivers on the same motions without noise.

    No model can do better; its error is the noise.
    """

    quiet: Mapping[str, Array] = field(default_factory=dict)

    def predict(self, motion: Motion) -> Array:
        """Torque without noise, shape (N, n), [N·m]."""
        return self.quiet[motion.source]


def designed_run(seed: int, *, trajectories: int = 6) -> Run:
    """Designed motions for fitting, random ones for scoring, hoses and grease besides.

    Args:
        seed: Seed of designs, motions, noise, and of where hoses and grease are.
        trajectories: Motions of each kind, of 10 s each.
    """
    robot, plant = load_truth(TRUTH)
    places, motion_rng, noise_rng = np.random.default_rng(seed).spawn(3)
    laws = (*plant.effects, *unmodelled(joint_scales(robot), places))
    noise, still = plant.noise, Noise.none(robot.size)
    assert noise is not None  # a plant without one is given the usual
    plant = replace(plant, effects=laws, noise=still)
    references = designed_references(robot, noise, trajectories, motion_rng)
    references += [
        random_fourier(
            robot, duration=_FAMILY.duration, rate=plant.log_rate, seed=motion_rng,
            fill=_FILL,
        )
        for _ in range(trajectories)
    ]  # fmt: skip
    clean = plant.run(references, seed=noise_rng)
    logs = []
    for log in clean:
        signals = {"q": log.q, "v": log.v, "tau": log.tau}
        noisy = noise.apply(signals, rate=plant.log_rate, rng=noise_rng)
        logs.append(replace(log, **noisy))
    quiet = {log.source: log.tau for log in clean[trajectories:]}
    plant = replace(plant, noise=noise)
    return Run(robot, plant, logs[:trajectories], logs[trajectories:], quiet)


def designed_references(
    robot: Robot, noise: Noise, trajectories: int, rng: np.random.Generator
) -> list[Reference]:
    """Motions designed one after the other, each for what it adds."""
    sought = effects_from_text(_SOUGHT, robot.joints, joint_scales(robot))
    observation = observe(robot.chain, sought, covariance=noise.torque_covariance)
    limits = Limits.of(robot, fill=_DESIGNED)
    found = design(
        robot, observation, _FAMILY, seed=rng, limits=limits, trajectories=trajectories,
        starts=1, rate=_DESIGN_RATE,
    )  # fmt: skip
    return [x.reference(Plant.log_rate) for x in found.trajectories]


def compare(run: Run) -> tuple[Fit, Chain, Validation]:
    """Our ladder and the published chain on one half, scored on the other.

    A rung that was left out is no news here. The noise floor is that of the plant.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        fit = identify(run.robot, run.fitting)
        chain = published_chain(run.robot, run.fitting, cutoff=fit.model.cutoff)
    floor = Repeat(run.robot, fit.model.base, quiet=run.quiet)
    models = {"noise floor": floor, **beside(chain, fit.model)}
    scored = validate(replace(fit.model, simpler=models), run.scoring)
    noise, *rows = scored.rows
    rows[-1] = replace(rows[-1], name="ours")
    return fit, chain, replace(scored, rows=tuple(rows), noise_floor=noise.rms)
