"""The same identification by FIGAROH, where it is installed (extra ``bench``).

FIGAROH 1.0 builds the regressor sample by sample, drops columns without torque, finds
base parameters by QR of the whole matrix and solves ordinary least squares. It gives no
intervals that allow for correlated residuals and no weights across joints, so it does
less than what it is compared with.
"""

from __future__ import annotations

import warnings
from time import process_time
from types import SimpleNamespace

from hybrid.robot import Robot
from hybrid.signals import Motion


def identify_by_figaroh(robot: Robot, motion: Motion) -> dict[str, float] | None:
    """Seconds of each step by name, or None where FIGAROH is not installed."""
    warnings.simplefilter("ignore")  # it warns of its own deprecations
    try:
        from figaroh.tools.qrdecomposition import QRDecomposer
        from figaroh.tools.regressor import (
            build_regressor_basic,
            build_regressor_reduced,
            get_index_eliminate,
        )
    except ModuleNotFoundError:
        return None
    model = robot.pinocchio()
    arm = SimpleNamespace(model=model, data=model.createData())
    terms = ("has_friction", "has_actuator_inertia", "has_joint_offset")
    options = dict.fromkeys(terms, True) | {"act_idxv": range(robot.size)}
    tau = motion.tau.T.ravel()  # joint after joint
    times = [process_time()]
    W = build_regressor_basic(arm, motion.q, motion.v, motion.a, options)
    times.append(process_time())
    standard = {f"p{k}": 0.0 for k in range(W.shape[1])}
    dropped, kept = get_index_eliminate(W, standard)
    W = build_regressor_reduced(W, dropped)
    times.append(process_time())
    QRDecomposer().double_decomposition(tau, W, kept, standard)
    times.append(process_time())
    names = ("build", "eliminate", "reduce and solve")
    gaps = (b - a for a, b in zip(times[:-1], times[1:], strict=True))
    return dict(zip(names, gaps, strict=True))
