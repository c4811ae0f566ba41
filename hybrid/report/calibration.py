"""Show a kinematic calibration: tables, and content for JSON."""

from typing import Any

import numpy as np

from hybrid.calibration import Calibration, Errors
from hybrid.report.table import Table

# Factor and unit of numbers in tables.
_SHOWN = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "rad/(N·m)": (1e6, "µrad/(N·m)")}
_UNIT = {"position": "m", "orientation": "rad", "distance": "m"}
_FRAME = "rotation", "translation"


def errors_table(errors: Errors) -> Table:
    """Median, RMS and largest error on held-out poses, outliers included."""
    rows = []
    for kind, calibrated in errors.calibrated.items():
        factor, unit = _SHOWN[_UNIT[kind]]
        both = *_sizes(errors.nominal[kind]).values(), *_sizes(calibrated).values()
        rows.append((f"{kind} [{unit}]", *(f"{factor * x:.4g}" for x in both)))
    sizes_shown = ("median", "RMS", "largest")
    header = ("", *(f"{arm} {x}" for arm in ("nominal", "new") for x in sizes_shown))
    return Table(header, tuple(rows), "Error on poses left out of the fit")


def corrections_table(calibration: Calibration) -> Table:
    """Corrections with the half-widths of their 95 % intervals."""
    low, high = calibration.solution.interval()
    rows = []
    half_widths = (high - low) / 2
    for parameter, half in zip(calibration.parameters, half_widths, strict=True):
        factor, unit = _SHOWN.get(parameter.unit, (1.0, parameter.unit))
        value, width = factor * parameter.value, factor * half
        rows.append((parameter.name, f"{value:.4f}", f"{width:.4f}", unit))
    header = ("correction", "value", "± 95 %", "unit")
    return Table(header, tuple(rows), f"Corrections to {calibration.setup.robot.name}")


def content_from_calibration(
    calibration: Calibration, errors: Errors
) -> dict[str, Any]:
    """Content of a calibration for JSON, in SI units."""
    low, high = calibration.solution.interval()
    solution, robot = calibration.solution, calibration.setup.robot
    chain = calibration.robot.chain
    return {
        "robot": robot.name,
        "joints": list(robot.joints),
        "measured": calibration.data.kind,
        "poses": calibration.data.size,
        "errors": {kind: _error(errors, kind) for kind in errors.calibrated},
        "parameters": [
            parameter.as_dict() | {"interval": [low[k], high[k]]}
            for k, parameter in enumerate(calibration.parameters)
        ],
        "unidentifiable": list(calibration.unidentifiable),
        "rejected": [
            {"pose": x.pose + 1, "kind": x.kind, "size": x.size}
            for x in solution.rejected
        ],
        "noise": solution.noise,
        "observability": calibration.observability,
        "iterations": solution.iterations,
        "evaluations": solution.evaluations,
        "converged": solution.converged,
        "base": dict(zip(_FRAME, calibration.base, strict=True)),
        "tools": [dict(zip(_FRAME, tool, strict=True)) for tool in calibration.tools],
        "stations": calibration.stations,
        "chain": [  # placement of each joint in its parent link
            {"joint": joint, "rotation": R, "translation": p}
            for joint, R, p in zip(
                chain.joints, chain.rotation, chain.translation, strict=True
            )
        ],
    }


def _error(errors: Errors, kind: str) -> dict[str, Any]:
    nominal, calibrated = _sizes(errors.nominal[kind]), _sizes(errors.calibrated[kind])
    return {"unit": _UNIT[kind], "nominal": nominal, "calibrated": calibrated}


def _sizes(sizes: Any) -> dict[str, float]:
    return {
        "median": float(np.median(sizes)),
        "rms": float(np.sqrt(np.mean(sizes**2))),
        "largest": float(np.max(sizes)),
    }
