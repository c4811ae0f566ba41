"""The generator: a process of its own that seals what it has put into a plant.

    python -m blind.generate CASE.json OPEN SEALED

``OPEN`` gets the robot file as the simulator has it, the recordings, and the question;
``SEALED`` the truth, and recordings that no diagnosis sees.
"""

from __future__ import annotations

import json
import sys
import warnings
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from blind.case import Case
from blind.draw import command_effects, draw, torque_effects
from blind.independent import INDEPENDENT
from blind.robots import load_arm, off_by
from blind.size import Rig
from blind.strangers import STRANGERS
from hybrid.effects import Effect, effect_classes
from hybrid.errors import HybridError, HybridWarning
from hybrid.files import write_json
from hybrid.plant import Noise, Plant, Reference, random_fourier
from hybrid.recording.write import write
from hybrid.robot import Robot

DURATION, RATE = 10.0, 500.0  # s, Hz
IMPOSSIBLE = 3  # exit code: the arm cannot have such an effect
_UNSEEN = 2
_PARTNERS = 6  # other effects that are tried beside the first


@dataclass(frozen=True)
class Recipe:
    """What a plant is made of, but for its effects.

    Attributes:
        names: Ids to draw effects of.
        sizes: Their sizes in residuals of a perfect fit, None for usual ones.
        noise: Sensor noise in multiples of the usual one.
        off: Largest relative error of the file's numbers.
        recordings: How many the diagnosis gets.
        poor: Whether the motions excite poorly.
        step: Physics step, [s].
        integrator: Name of the integrator.
    """

    names: tuple[str, ...]
    sizes: tuple[float | None, ...]
    noise: float
    off: float
    recordings: int
    poor: bool
    step: float
    integrator: str


def recipe_for(case: Case, rng: np.random.Generator) -> Recipe:
    """Draw the recipe of a case; effects and sizes are dealt, all others drawn."""
    names, sizes = _dealt(case, rng)
    return Recipe(
        names=names,
        sizes=sizes,
        noise=float(rng.choice([0.5, 1.0, 2.0])),
        off=float(rng.choice([0.0, *rng.uniform(0.01, 0.05, 4)])),
        recordings=int(rng.choice([1, 2, 4, 8], p=[0.15, 0.2, 0.5, 0.15])),
        poor=case.stratum == "poor",
        step=float(rng.choice([0.0005, 0.00025], p=[0.7, 0.3])),
        integrator=str(rng.choice(["euler", "implicit", "implicitfast"])),
    )


def _dealt(
    case: Case, rng: np.random.Generator
) -> tuple[tuple[str, ...], tuple[float | None, ...]]:
    library, large = torque_effects(), (1.0, 3.0, None)
    if case.stratum == "none":
        return (), ()
    if case.stratum in ("pair", "triple"):
        count = 2 if case.stratum == "pair" else 3
        names = rng.choice(library, count, replace=False).tolist()
        return tuple(names), tuple(float(rng.choice([1.0, 3.0])) for _ in names)
    names, sizes = {
        "single": (library, (0.3, *large)),
        "unknown": (tuple(STRANGERS), large),
        "independent": (tuple(INDEPENDENT), large),
        "command": (command_effects(), (None,)),
    }.get(case.stratum, (library, large))
    deck: list[tuple[str, float | None]] = [(n, s) for n in names for s in sizes]
    name, size = deck[case.deal(deck)]
    return (name,), (size,)


def generate(case: Case, visible: Path, sealed: Path) -> None:
    """Make the plant of a case, run it, and write what is open and what is sealed.

    Raises:
        HybridError: No effect that was tried can have the size asked for.
    """
    rng = case.rng()
    robot = load_arm(case.robot)
    recipe = recipe_for(case, rng)
    usual = Noise.typical(robot)
    noise = replace(usual, torque_covariance=recipe.noise**2 * usual.torque_covariance)
    count = recipe.recordings + _UNSEEN
    references = [_reference(robot, recipe, child) for child in rng.spawn(count)]
    rig = Rig.build(robot, references[0], noise, rng)
    effects, skipped = _effects(recipe, rig, rng)
    real = off_by(robot, recipe.off, rng)
    plant = Plant(
        real, effects, nominal=robot, noise=noise,
        step=recipe.step, integrator=recipe.integrator, log_rate=RATE,
    )  # fmt: skip
    recordings = plant.run(references, seed=rng)
    # Whoever runs a controller knows its gains, or what they are meant to be.
    assert plant.servo is not None
    shown = replace(robot, kp=plant.servo.kp, kd=plant.servo.kd)
    write_json(visible / "robot.json", shown.as_dict())
    for k, recording in enumerate(recordings):
        folder = visible if k < recipe.recordings else sealed
        write(recording, folder / f"recording_{k}.npz")
    hidden = [e.id for e in effects] if case.stratum == "withheld" else []
    write_json(visible / "question.json", {"without": hidden})
    content = {
        "case": asdict(case),
        "recipe": asdict(recipe),
        "skipped": skipped,
        "effects": [_described(e, rig, robot) for e in effects],
    }
    write_json(sealed / "truth.json", content)


def _effects(
    recipe: Recipe, rig: Rig, rng: np.random.Generator
) -> tuple[list[Effect], list[str]]:
    """The effects, and the ids of those that could not have their size."""
    effects: list[Effect] = []
    skipped: list[str] = []
    library = torque_effects()
    others = [x for x in library if x not in recipe.names]
    for name, size in zip(recipe.names, recipe.sizes, strict=True):
        # Another effect takes the place of one that no joint can have.
        spare = rng.permutation(others)[:_PARTNERS].tolist() if name in library else []
        for tried in (name, *spare):
            found = draw(tried, rig, size, rng)
            if found is not None:
                effects.append(found)
                others = [x for x in others if x != tried]
                break
            skipped.append(tried)
        else:
            raise HybridError(f"{name} cannot have the size {size} on this arm")
    return effects, skipped


def _reference(robot: Robot, recipe: Recipe, rng: np.random.Generator) -> Reference:
    fill = 0.12 if recipe.poor else 0.7
    motion = random_fourier(
        robot, duration=DURATION, rate=RATE, seed=rng, fill=fill,
        order=3 if recipe.poor else 5,
    )  # fmt: skip
    if not recipe.poor:
        return motion
    still = np.arange(robot.size) % 2 == 1
    q = np.where(still, motion.q[:1], motion.q)
    return Reference(motion.t, q, np.where(still, 0.0, motion.v),
                     np.where(still, 0.0, motion.a))  # fmt: skip


def _described(effect: Effect, rig: Rig, robot: Robot) -> dict[str, Any]:
    try:
        sizes = rig.sizes(effect).tolist()
    except HybridError:
        sizes = []
    means = effect.id if effect.id in effect_classes() else ""
    return {
        **effect.as_dict(robot.joints),
        "means": getattr(effect, "means", means),
        "at": list(effect.joints),
        "scope": effect.scope,
        "sizes": sizes,
    }


def main() -> None:
    """Run the generator on the files named in the arguments."""
    case, visible, sealed = map(Path, sys.argv[1:4])
    for folder in (visible, sealed):
        folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        content = json.loads(case.read_text(encoding="utf-8"))
        try:
            generate(Case(**content), visible, sealed)
        except HybridError as error:
            sys.stderr.write(f"{error}\n")
            sys.exit(IMPOSSIBLE)


if __name__ == "__main__":
    main()
