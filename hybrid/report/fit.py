"""What an identification found: tables for people, content for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.report.table import Table, error_table

if TYPE_CHECKING:
    from hybrid.effects import Effect
    from hybrid.identification import Fit


def held_out_table(fit: Fit) -> Table:
    """RMS torque error of every stage on samples left out of its fit, [N·m]."""
    robot = fit.model.robot
    caption = f"Cross-validated RMS torque error on {robot.name}, N·m"
    return error_table(fit.held_out, robot.joints, caption)


def effects_table(fit: Fit) -> Table:
    """The effects found, by joint, with 95 % intervals and units.

    Gains at zero without an interval were not found, and are left out.
    """
    joints, factor = fit.model.robot.joints, _half_width_of_std(fit)
    effects = sorted(fit.model.effects, key=lambda effect: effect.joints)
    rows = []
    for effect in effects:
        found = _found(effect, factor)
        if found:
            where = "arm" if effect.scope == "arm" else _places(effect, joints)
            rows.append((where, effect.id, ", ".join(found)))
    return Table(
        header=("joint", "effect", "found"),
        rows=tuple(rows),
        caption="Effects found (± is half the 95 % interval)",
        words=True,
    )


def content_from_fit(fit: Fit) -> dict[str, Any]:
    """An identification in words and numbers, for JSON."""
    robot, estimate = fit.model.robot, fit.estimate
    low, high = estimate.interval()
    return {
        "robot": robot.name,
        "joints": list(robot.joints),
        "stage": fit.model.stage,
        "cutoff": fit.model.cutoff,
        "held_out": [
            {"name": name, "rms": rms, "mean": float(np.mean(rms))}
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
            effect.as_dict(robot.joints) | {"units": _units(effect)}
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


def _found(effect: Effect, factor: float) -> list[str]:
    """Parameters in words; empty if every gain is zero and has no interval."""
    gains = [
        _quantity(g.name, value, g.unit, factor * std)
        for g in effect.gains
        for value, std in [(effect.values[g.name], effect.std.get(g.name, 0.0))]
        if value != 0.0 or std > 0.0
    ]
    if not gains:
        return []
    shapes = [_quantity(s.name, effect.values[s.name], s.unit) for s in effect.shapes]
    return gains + shapes


def _quantity(name: str, value: float, unit: str, half: float = 0.0) -> str:
    """``level 2.395 ± 0.037 N·m``: two significant digits of the interval."""
    if half > 0 and np.isfinite(half):
        decimals = int(np.clip(1 - np.floor(np.log10(half)), 0, 9))
        number = f"{value:.{decimals}f} ± {half:.{decimals}f}"
    else:
        number = f"{value:.4g}"
    return f"{name} {number} {unit}".rstrip()


def _half_width_of_std(fit: Fit) -> float:
    """Half-widths of the 95 % intervals in standard deviations."""
    from scipy.special import stdtrit

    return float(stdtrit(fit.estimate.degrees, 0.975))


def _units(effect: Effect) -> dict[str, str]:
    return {x.name: x.unit for x in (*effect.gains, *effect.shapes)}


def _places(effect: Effect, joints: tuple[str, ...]) -> str:
    return "+".join(joints[j] for j in effect.joints)
