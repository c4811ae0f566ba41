"""Batches of replays on a GPU, all in one compiled loop.

MJX moves the arm; it has no servo such as MuJoCo's DC motor, so that the torque of
:mod:`hybrid.servo.drive` is written out here, with the numbers of the compiled models
and in the order of MuJoCo's step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.extras import check_extra
from hybrid.robot import Robot
from hybrid.servo.drive import Drive
from hybrid.servo.model import lay_ground, servo_spec

if TYPE_CHECKING:
    from hybrid.servo.simulator import Run

# What differs between the models of a batch.
_FIELDS = (
    "body_mass",
    "body_inertia",
    "body_subtreemass",
    "dof_armature",
    "dof_damping",
    "dof_invweight0",
    "geom_rbound",
    "geom_size",
    "jnt_axis",
    "jnt_range",
    "jnt_stiffness",
    "qpos0",
    "qpos_spring",
    "opt.gravity",
    "opt.timestep",
)
_MOTORS = ("actuator_gainprm", "actuator_biasprm", "actuator_dynprm")
_SEARCHES = 4  # of the solver, and of its lines: stops of joints need no more
_STEPS = 512  # of one call of the loop
_LEAST, _MORE = 256, 4  # replays: a loop is compiled for 256, 1024, 4096, ...


def check_gpu() -> None:
    """Refuse to go on where no GPU is.

    Raises:
        HybridError: MJX is not installed, or JAX sees no GPU.
    """
    for library in ("jax", "mujoco.mjx"):
        check_extra(library, "gpu", "replaying on a GPU")
    import jax

    if all(x.platform == "cpu" for x in jax.devices()):
        raise HybridError("replaying on a GPU: JAX sees none; valid is it with one")


class GpuRollout:
    """Replays of one arm where JAX computes: on a GPU if there is one.

    Raises:
        HybridError: The arm has friction that MJX would ignore.
    """

    def __init__(self, robot: Robot) -> None:
        curved = np.flatnonzero((robot.quadratic != 0) | (robot.cubic != 0))
        if curved.size:
            joints = ", ".join(robot.joints[j] for j in curved)
            raise HybridError(
                f"replaying on a GPU: MJX ignores the quadratic and cubic damping of "
                f"{joints}; valid is a file without it, or a replay without a GPU"
            )
        import jax

        with redirect_stdout(StringIO()):  # it tells that Warp is not there
            from mujoco import mjx

        spec = servo_spec(robot, Drive.declared(robot))
        for actuator in spec.actuators:
            spec.delete(actuator)
        lay_ground(spec, robot)
        bare = spec.compile()
        bare.dof_frictionloss[:] = 0.0
        bare.opt.iterations = bare.opt.ls_iterations = _SEARCHES
        with jax.enable_x64(True):
            self._model, self._data = mjx.put_model(bare), mjx.make_data(bare)

    def __call__(self, runs: Sequence[Run]) -> Array:
        """Positions after every step, shape (batch, steps, n), [rad]."""
        import jax

        steps, n = max(len(x.control) for x in runs), runs[0].control.shape[1]
        every = [*runs, *[runs[-1]] * (_padded(len(runs)) - len(runs))]
        control = np.empty((len(every), -(-steps // _STEPS) * _STEPS, n))
        for goals, x in zip(control, every, strict=True):
            goals[: len(x.control)] = x.control
            goals[len(x.control) :] = x.control[-1]
        models = {id(x.model): x.model for x in every}
        row = {key: k for k, key in enumerate(models)}
        which = [row[id(x.model)] for x in every]

        def of_each(name: str) -> Array:
            return np.array([attrgetter(name)(x) for x in models.values()])[which]

        motors = [of_each(name) for name in _MOTORS]
        dead = np.array([x.drive["dead_band"] for x in every])
        states = np.array([x.state for x in every])
        state = tuple(np.split(states, [1, 1 + n, 1 + 2 * n], axis=1)[1:])
        arm, moved = (self._model, self._data), []
        with jax.enable_x64(True):
            fields = {name: of_each(name) for name in _FIELDS}
            own = jax.device_put((fields, motors, dead))
            for goals in np.split(control, control.shape[1] // _STEPS, axis=1):
                state, part = _loop()(*arm, own, goals, state)
                moved.append(part)
            found = [np.asarray(x[: len(runs)]) for x in moved]
        return np.concatenate(found, axis=1)[:, :steps]


def _padded(count: int) -> int:
    """A count for which there may be a compiled loop already."""
    return _LEAST if count <= _LEAST else _MORE * _padded(-(-count // _MORE))


@cache
def _loop() -> Any:
    """The compiled loop over steps, of a batch of replays."""
    import jax
    from mujoco import mjx

    def replay(base: Any, data: Any, own: Any, control: Any, start: Any) -> Any:
        fields, motor, dead = own
        model, laws = base.tree_replace(fields), _laws(motor, dead, fields)

        def step(state: tuple[Any, Any, Any], goal: Any) -> tuple[Any, Any]:
            q, v, z = state
            torque, z = laws(q, v, z, goal)
            now = data.replace(qpos=q, qvel=v, qfrc_applied=torque)
            after = mjx.step(model, now)
            return (after.qpos, after.qvel, z), after.qpos

        return jax.lax.scan(step, start, control)

    return jax.jit(jax.vmap(replay, in_axes=(None, None, 0, 0, 0)))


def _laws(motor: Sequence[Any], dead: Any, fields: Mapping[str, Any]) -> Any:
    """Torque of servos and their friction, and bristles after a step."""
    from jax import numpy as jnp

    (gain, bias, dyn), h = motor, fields["opt.timestep"]
    resistance, constant, stiffness = gain[:, 0], gain[:, 1], gain[:, 4]
    damping, most = gain[:, 6], gain[:, 7]
    coulomb, breakaway, slow = bias[:, 3], bias[:, 4], bias[:, 5]
    bristle, friction = dyn[:, 5], dyn[:, 6]

    def laws(q: Any, v: Any, z: Any, goal: Any) -> tuple[Any, Any]:
        off = goal - q
        off = off - jnp.clip(off, -dead, dead)
        asked = stiffness * off - damping * v
        voltage = resistance / constant * asked + constant * v
        voltage = jnp.clip(voltage, -most, most)
        drive = constant / resistance * (voltage - constant * v)
        level = coulomb + (breakaway - coulomb) * jnp.exp(-((v / slow) ** 2))
        rate = -bristle * jnp.abs(v) / level
        torque = drive - bristle * z - friction * (rate * z + v)
        still = jnp.abs(rate) < 1e-15
        held = jnp.where(still, h, jnp.expm1(rate * h) / jnp.where(still, 1.0, rate))
        return torque, jnp.exp(rate * h) * z + held * v

    return laws
