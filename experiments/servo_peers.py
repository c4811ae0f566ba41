"""Servos as other searches find them, on the stretches of logs that ours has."""

from __future__ import annotations

from servo_cma import by_cma
from servo_sysid import by_sysid

from hybrid.servo.stretch import chosen, stretches_of


def by_peers(robot, learn, args, seed) -> dict:
    """Arms with the servos that other searches find, and their processor time."""
    parts, found = chosen(stretches_of(learn), 60.0, 5.0), {}
    if args.cma:
        other, cpu = by_cma(robot, parts, args.cma, seed=seed)
        found["plain, CMA-ES"] = robot, other, cpu
    if args.sysid:
        arm, cpu = by_sysid(robot, parts)
        found["plain, mujoco.sysid"] = arm, None, cpu
    return found
