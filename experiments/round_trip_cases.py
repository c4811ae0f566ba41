"""Identified arms that ``round_trip.py`` exports: simulated ones and the real ones."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from coman import ROOT, simulate_run
from designed_coman import designed_run
from real_arms_data import ARMS

from hybrid import (
    DynamicModel,
    Motion,
    Recording,
    Robot,
    identify,
    read_recordings,
    simulate,
)
from hybrid.arrays import Array
from hybrid.diagnosis.diagnose import examine
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.identification.preparation import checked_logs, motions_from_logs
from hybrid.plant import install
from hybrid.plant.scale import joint_scales
from hybrid.signals import motion_from_recording

_SIMULATED = {
    "planar": "stribeck,viscous,torque_offset",
    "scara": "coulomb,viscous,load_friction",
}
_DRY, _SAMPLES, _PASSES = 500.0, 200, 60  # dry friction acts at v + a / _DRY


@dataclass(frozen=True)
class Case:
    """A model, and motions that it was made from and that it has not seen."""

    name: str
    model: DynamicModel
    fitting: Sequence[Motion]
    scoring: Sequence[Motion]

    def findings(self, arm: Robot | DynamicModel) -> str:
        """Verdict and findings of a diagnosis on motions that no fit has seen."""
        found = examine(arm, self.scoring, cutoff=self.model.cutoff).diagnosis
        names = [f"{x.effect} of {', '.join(x.joints)}" for x in found.findings]
        return f"{found.verdict}: {'; '.join(names) or '–'}"


def cases(data: Path | None) -> Iterator[Case]:
    """All arms, one after the other; the real ones if their logs are there."""
    for name, text in _SIMULATED.items():
        robot = Robot.load(ROOT / "models" / f"{name}.xml")
        effects = effects_from_text(text, robot.joints, joint_scales(robot))
        logs = simulate(robot, effects, trajectories=6, seed=0)
        yield _identified(name, robot, logs[:4], logs[4:])
    for name, run in (("COMAN-like", simulate_run(0)), ("demo", designed_run(0))):
        yield _identified(name, run.robot, run.fitting, run.scoring)
    for arm in ARMS if data else ():
        robot = Robot.load(data / arm.folder / "robot.urdf")  # type: ignore[operator]
        logs = read_recordings([data / arm.folder], joints=robot.joints)  # type: ignore[operator]
        motions = [motion_from_recording(x, cutoff=2 * arm.cutoff) for x in logs]
        _, fit, score = next(arm.splits(motions))
        model = _model(robot, [fit], effects=arm.effects, cutoff=arm.cutoff)
        standing = np.full(robot.size, arm.standing)
        yield Case(arm.name, replace(model, standing=standing), [fit], [score])


def _identified(
    name: str, robot: Robot, fitting: list[Recording], scoring: list[Recording]
) -> Case:
    model = _model(robot, fitting)
    fit, score = (
        motions_from_logs(checked_logs(robot, x), model.cutoff)[0]
        for x in (fitting, scoring)
    )
    return Case(name, model, fit, score)


def _model(robot: Robot, logs: Sequence[Recording | Motion], **given) -> DynamicModel:  # type: ignore[no-untyped-def]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        return identify(robot, logs, consistent=True, **given).model


def moving(model: DynamicModel, motion: Motion, *, ahead: float = 0.0) -> Array:
    """Where joints, and couplings of joints, move and do not turn soon, shape (N, n).

    Args:
        model: A model.
        motion: Motion of N samples.
        ahead: What is soon, [s].
    """
    fast = (np.abs(motion.v) > model.standing) & motion.mask[:, None]
    for effect in model.effects:
        if effect.scope == "coupling":
            j = list(effect.joints)
            v, a = (np.abs(x[:, j].sum(axis=1)) for x in (motion.v, motion.a))
            fast[:, j] &= (v > model.standing[j].max() + ahead * a)[:, None]
    return np.asarray(fast)


def with_callback(file: Path, case: Case) -> Array:
    """How file and callback differ from the model, shape (2, n).

    MuJoCo accelerates the arm under the model's torque, at samples where all joints
    move.

    Returns:
        Largest torque by which they differ, [N·m], and RMS torque error of file and
        callback over that of the model.
    """
    model, motion = case.model, case.scoring[0]
    mj = mujoco.MjModel.from_xml_path(str(file))
    mj.opt.tolerance, mj.opt.iterations = 0.0, 200
    mj.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, asked = mujoco.MjData(mj), model.predict(motion)
    dofs = [mj.joint(x).dofadr[0] for x in model.robot.joints]
    slowest = model.standing.copy()  # within its width a fit's law is not dry
    for effect in model.effects:
        j = list(effect.joints)
        slowest[j] = np.maximum(slowest[j], effect.values.get("width", 0.0))
    fast = np.abs(motion.v) > np.maximum(slowest, 2 * np.abs(motion.a) / _DRY)
    fast &= moving(model, motion, ahead=2 / _DRY)
    samples, off = np.flatnonzero(fast.all(axis=1) & motion.mask), []
    samples = samples[:: max(1, len(samples) // _SAMPLES)]
    added = install(mj, data, model)
    for k in samples:
        data.qpos[dofs], data.qvel[dofs] = motion.q[k], motion.v[k]
        data.qacc[dofs], data.qfrc_applied[dofs] = motion.a[k], asked[k]
        for _ in range(_PASSES):  # load-dependent friction is that of the pass before
            mujoco.mj_forward(mj, data)
        torque, change = np.zeros(mj.nv), data.qacc.copy()
        change[dofs] -= motion.a[k]
        mujoco.mj_mulM(mj, data, torque, change)
        off.append(torque[dofs])
    added.remove()
    error = (motion.tau - asked)[samples]
    rms = [np.sqrt(np.mean(x**2, axis=0)) for x in (error + off, error)]
    return np.array([np.abs(off).max(axis=0), rms[0] / rms[1]])
