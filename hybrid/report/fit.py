"""Show an identification: tables, torque over time, and content for JSON."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.errors import HybridError
from hybrid.identification import DynamicModel, Fit
from hybrid.recording import Recording
from hybrid.report.style import BEST, OTHERS, PALE, Figure, lines_figure
from hybrid.report.table import Table, error_table
from hybrid.robot import Robot
from hybrid.shown import decimals_of
from hybrid.signals import Motion, Sampler, motion_from_recording

_EXCERPT_SECONDS = 3.0  # of a recording in a figure


def held_out_table(fit: Fit) -> Table:
    """RMS torque error of every stage on held-out samples, [N·m]."""
    robot = fit.model.robot
    caption = f"Cross-validated RMS torque error on {robot.name}"
    units, rows = robot.chain.units("N·m"), dict[str, Array]()
    before: Array | None = None
    for name, rms in fit.held_out.items():
        # A stage whose terms do not foretell unseen torque leaves the model as it was.
        same = before is not None and np.array_equal(rms, before)
        rows[f"{name}: none" if same else name], before = rms, rms
    return error_table(rows, robot.joints, units, caption)


def effects_table(fit: Fit) -> Table:
    """The effects found at each joint, with half-widths of 95 % intervals and units.

    Gains without an interval are left out: logs do not tell them.
    """
    from scipy.special import stdtrit

    joints, factor = fit.model.robot.joints, float(stdtrit(fit.estimate.degrees, 0.975))
    rows = []
    for effect in sorted(fit.model.effects, key=lambda effect: effect.joints):
        found = _found(effect, fit.model.robot, factor)
        if found:
            places = "+".join(joints[j] for j in effect.joints)
            where = "arm" if effect.scope == "arm" else places
            rows.append((where, effect.id, ", ".join(found)))
    return Table(
        header=("joint", "effect", "found"),
        rows=tuple(rows),
        caption="Effects found (± is half the 95 % interval)",
        words=True,
    )


def content_from_fit(fit: Fit) -> dict[str, Any]:
    """Content of an identification for JSON."""
    robot, estimate = fit.model.robot, fit.estimate
    low, high = estimate.interval()
    return {
        "robot": robot.name,
        "joints": list(robot.joints),
        "stage": fit.model.stage,
        "cutoff": fit.model.cutoff,
        "held_out": [
            {"name": name, "rms": rms, "mean": float(np.nanmean(rms))}
            for name, rms in fit.held_out.items()
        ],
        "left_out": fit.left_out,
        "unidentifiable": fit.unidentifiable,
        "warnings": fit.warnings,
        "converged": fit.converged,
        "rounds": fit.rounds,
        "condition": fit.condition,
        "sigma": fit.sigma,
        "effects": [
            effect.as_dict(robot.joints) | {"units": _units(effect, robot)}
            for effect in fit.model.effects
        ],
        "unknowns": [
            {
                "label": label,
                "name": fit.names[k],
                "unit": fit.units[k],
                "value": estimate.theta[k],
                "std": estimate.std[k],
                "interval": (low[k], high[k]),
            }
            for k, label in enumerate(fit.labels)
        ],
    }


def _units(effect: Effect, robot: Robot) -> dict[str, str]:
    """Unit of every parameter at the effect's joints."""
    unit = partial(robot.chain.unit_at, effect.unit_joints)
    return {x.name: unit(x.unit) for x in (*effect.gains, *effect.shapes)}


def _found(effect: Effect, robot: Robot, factor: float) -> list[str]:
    """Parameters as texts; none if no gain has an interval."""
    units = _units(effect, robot)
    gains = [
        _quantity(g.name, effect.values[g.name], units[g.name], factor * std)
        for g in effect.gains
        if (std := effect.std.get(g.name, 0.0)) > 0.0
    ]
    if not gains:
        return []
    values = effect.shape_values.items()
    return gains + [_quantity(name, x, units[name]) for name, x in values]


def _quantity(name: str, value: float, unit: str, half: float = 0.0) -> str:
    """``level 2.395 ± 0.037 N·m``: two significant digits of the interval."""
    if half > 0 and np.isfinite(half):
        decimals = decimals_of(half, 2)
        number = f"{value:.{decimals}f} ± {half:.{decimals}f}"
    else:
        number = f"{value:.4g}"
    return f"{name} {number} {unit}".rstrip()


def torque_figure(
    t: Array, measured: Array, predicted: Mapping[str, Array], joints: Sequence[str]
) -> Figure:
    """Draw measured and predicted torque of each joint, and the residual below.

    Args:
        t: Time, shape (N,), in [s].
        measured: Joint torque, shape (N, n), in [N·m].
        predicted: Predictions by name, each of shape (N, n), in [N·m]; at most three.
        joints: Joint names, n of them.

    Returns:
        Figure of 2n axes: torque and residual of each joint.

    Raises:
        HybridError: A shape does not fit, or there are more than three predictions.
    """
    most = len(OTHERS) + 1
    if not 1 <= len(predicted) <= most:
        raise HybridError(f"{len(predicted)} predictions, valid are 1 to {most}")
    shape = (len(t), len(joints))
    for name, torque in {"measured": measured, **predicted}.items():
        if torque.shape != shape:
            raise HybridError(f"{name} has shape {torque.shape}, valid is {shape}")
    inks = (*OTHERS[: len(predicted) - 1], BEST)
    pairs = list(zip(predicted.items(), inks, strict=True))
    rows = {
        "torque\n[N·m]": [
            ("measured", measured, PALE, 2.2),
            *((name, torque, ink, 0.9) for (name, torque), ink in pairs),
        ],
        "residual\n[N·m]": [
            ("", measured - torque, ink, 0.7) for (_, torque), ink in pairs
        ],
    }
    return lines_figure(t, joints, rows, 2.1, ratios=(2.2, 1.0))[0]


def excerpt_figure(model: DynamicModel, recording: Recording) -> Figure:
    """Draw torque in the middle of a recording, and the predictions of models."""
    motion, sampler = seen_by(model, recording)
    half = round(_EXCERPT_SECONDS * motion.rate / 2)
    middle = len(motion.t) // 2
    part = slice(max(0, middle - half), middle + half)
    torques = {"all stages": model.predict(motion)}
    if "LS" in model.simpler:
        torques = {"plain least squares": model.simpler["LS"].predict(motion)} | torques
    shown = {name: sampler(tau)[part] for name, tau in torques.items()}
    measured = sampler(motion.tau)[part]
    return torque_figure(motion.t[part], measured, shown, model.robot.joints)


def seen_by(model: DynamicModel, recording: Recording) -> tuple[Motion, Sampler]:
    """Motion as the identification filters it, and its filter without decimation.

    That is the logger's own filter if the torque had passed one.
    """
    motion = motion_from_recording(recording, cutoff=2 * model.cutoff)
    return motion, Sampler(motion.rate, min(model.cutoff, model.band), 1)
