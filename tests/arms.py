"""Arms that several test files share."""

import warnings
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.errors import HybridWarning
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

MODELS = Path(__file__).parents[1] / "models"
PUBLIC_ARMS = ("ur10", "panda", "xarm7", "z1")


@cache
def public_arm(name: str) -> Robot:
    """An arm nobody here modelled, from the example-robot-data wheel."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # held fingers
        return Robot.load(name)


def planar_of_xacro(folder: Path) -> Robot:
    """The planar arm, read from a xacro file in a folder."""
    text = (MODELS / "planar.urdf").read_text()
    xacro = text.replace("<robot ", '<robot xmlns:xacro="http://ros.org/xacro" ', 1)
    (folder / "arm.xacro").write_text(xacro)
    return Robot.load(folder / "arm.xacro")


def random_arm(seed: int) -> Robot:
    """Up to six joints of either kind on oblique axes, some of them intersecting."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    axis = np.where(rng.random((n, 1)) < 0.5, np.eye(3)[rng.integers(0, 3, n)], 0.0)
    axis = np.where(axis.any(axis=1, keepdims=True), axis, rng.normal(size=(n, 3)))
    chain = Chain(
        joints=tuple(f"joint_{k}" for k in range(n)),
        rotation=Rotation.random(n, rng=rng).as_matrix(),
        translation=rng.normal(size=(n, 3)) * (rng.random((n, 1)) < 0.7),
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
        revolute=rng.random(n) < 0.7,
        inertial=np.array([_random_link(rng) for _ in range(n)]),
        gravity=rng.normal(size=3) * 10,
        armature=np.zeros(n),
    )
    free, zero = np.full(n, np.inf), np.zeros(n)
    return Robot("random", chain, -free, free, free, free, zero, zero)


def _random_link(rng: np.random.Generator) -> list[float]:
    """Parameters of four point masses: a physical link."""
    mass, at = rng.uniform(0.1, 2.0, 4), rng.normal(size=(4, 3))
    second = (mass[:, None] * at).T @ at
    inertia = np.trace(second) * np.eye(3) - second
    order = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    return [mass.sum(), *(mass @ at), *inertia[order]]


def random_states(n: int, samples: int, seed: int = 0) -> list[np.ndarray]:
    """Position, speed and acceleration, shape (samples, n) each."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, np.pi, (samples, n))
    return [q, *rng.normal(size=(2, samples, n)) * [[[2.0]], [[5.0]]]]


LIFT = (
    "<mujoco><compiler angle='radian'/><worldbody>"
    "<body><inertial mass='4' pos='0.2 0 0' diaginertia='.05 .2 .2'/>"
    "<joint name='turn' axis='0 0 1' armature='0.2' range='-2 2'/>"
    "<body pos='0.4 0 0'><inertial mass='3' pos='0 0 0' diaginertia='.1 .1 .1'/>"
    "<joint name='lift' type='slide' axis='0 0 1' armature='2' range='-.2 .2' "
    "damping='35' frictionloss='8'/></body></body></worldbody></mujoco>"
)
