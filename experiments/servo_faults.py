"""One fault of an arm that logs command and position only: is it named?

Arms with position servos and one fault each, or none, are simulated by MuJoCo's own
friction and servo laws at 1 ms, logged at 50 Hz with an encoder of 4096 steps, and
fitted from the file without the fault. A table appears: for each arm and fault, what
stands first among the findings. A fault does not show where the file itself replays the
logs of that joint within a step of the encoder.

    python experiments/servo_faults.py --out reports/servo_faults
"""

from __future__ import annotations

import time
import warnings
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
from outputs import command_line

from hybrid.errors import HybridWarning
from hybrid.files import atomic_path
from hybrid.recording import Recording
from hybrid.report import Table, markdown_table, provenance, write_results
from hybrid.robot import Robot
from hybrid.servo.servo_fit import fit_servo
from hybrid.servo.simulator import declared_spec

ARMS = ("models/scara.xml", "ur5", "SO101")
STEP, RATE, TICK = 0.001, 50.0, 2 * np.pi / 4096
FAULTS = (
    "none", "controller_gain", "viscous", "coulomb", "armature", "saturation",
    "torque_offset", "command_latency", "encoder_offset", "stribeck",
)  # fmt: skip
# Not told apart by motion at all, or shapes of one law.
ALIKE = {"stribeck": {"coulomb"}, "encoder_offset": {"torque_offset"}}


def with_servos(robot: Robot) -> Robot:
    """The arm with stiff servos and some friction, where its file has none."""
    from dataclasses import replace

    weight = np.array(
        [9.81 * robot.chain.inertial[j:, 0].sum() for j in range(robot.size)]
    )
    reach = np.linalg.norm(robot.chain.translation, axis=1)
    beyond = np.array([reach[j + 1 :].sum() + 0.1 for j in range(robot.size)])
    stall = np.where(np.isfinite(robot.tau_max), robot.tau_max, 2 * weight * beyond)
    inertia = weight / 9.81 * beyond**2
    rotor = np.maximum(robot.chain.armature, 0.3 * inertia)
    kp = stall / 0.15
    both = {"kp": kp, "kd": 0.7 * np.sqrt(kp * (inertia + rotor)), "tau_max": stall}
    dry = np.maximum(robot.frictionloss, 0.03 * stall)
    damping = np.maximum(robot.damping, 0.3 * both["kd"])
    chain = replace(robot.chain, armature=rotor)
    return replace(robot, chain=chain, frictionloss=dry, damping=damping, **both)


def log(robot: Robot, fault: str, j: int, seed: int, seconds: float) -> Recording:
    """One log of the arm with a fault at joint j."""
    rng = np.random.default_rng(seed)
    model = declared_spec(robot).compile()
    model.opt.timestep, stall = STEP, robot.tau_max[j]
    late, zero = np.zeros(robot.size), np.zeros(robot.size)
    falling = 0.0  # of Stribeck friction, N·m
    match fault:
        case "controller_gain":
            model.actuator_gainprm[j, 0] *= 0.6
            model.actuator_biasprm[j, 1] *= 0.6
        case "viscous":
            model.dof_damping[j] += 1.0 * robot.kd[j]
        case "coulomb":
            model.dof_frictionloss[j] += 0.06 * stall
        case "armature":
            model.dof_armature[j] *= 3.0
        case "saturation":
            model.actuator_forcerange[j] = np.array([-0.25, 0.25]) * stall
        case "torque_offset":
            model.jnt_stiffness[j], model.qpos_spring[j] = 1e-6, 0.06e6 * stall
        case "command_latency":
            late[j] = 0.06
        case "encoder_offset":
            zero[j] = 0.08
        case "stribeck":
            falling = 0.06 * stall
    data, plain = mujoco.MjData(model), model.dof_frictionloss.copy()
    t = np.arange(0.0, seconds, 1 / RATE)
    middle = np.where(
        np.isfinite(robot.q_min + robot.q_max), (robot.q_min + robot.q_max) / 2, 0.4
    )
    span = np.minimum(
        np.where(np.isfinite(robot.q_max), robot.q_max - middle, 1.0), 0.8
    )
    command = middle + np.minimum(t, 1)[:, None] * span * sum(
        rng.uniform(0.1, 0.5, robot.size)
        * np.sin(
            2 * np.pi * rng.uniform(0.05, 0.7, robot.size) * t[:, None]
            + rng.uniform(0, 6, robot.size)
        )
        for _ in range(2)
    )
    data.qpos[:], q = command[0] + zero, []
    for k in range(len(t)):
        q.append(data.qpos - zero)
        for i in range(round(1 / RATE / STEP)):
            now = t[k] + i * STEP - late
            data.ctrl[:] = [
                np.interp(x, t, c) for x, c in zip(now, command.T, strict=True)
            ]
            data.ctrl[:] += zero
            model.dof_frictionloss[j] = plain[j] + falling * np.exp(
                -((data.qvel[j] / 0.05) ** 2)
            )
            mujoco.mj_step(model, data)
    measured = np.round(np.array(q) / TICK) * TICK
    return Recording(
        t, measured, command=command, joints=robot.joints, source=f"{seed}"
    )


def outcome(fit, fault: str, joint: str) -> str:
    """What is said, against what is true."""
    if not fit.findings:
        if fault == "none":
            return "right"
        j = fit.robot.joints.index(joint)
        return "does not show" if fit.before[j] < TICK else "nothing"
    first = fit.findings[0]
    others = {x.effect for x in fit.findings} - {fault} - ALIKE.get(fault, set())
    if first.effect == fault and first.joint == joint:
        return "right" if not others else f"right, and {', '.join(sorted(others))}"
    if first.effect in ALIKE.get(fault, ()) and first.joint == joint:
        return f"in class ({first.effect})"
    return f"{first.effect} at {first.joint}"


def main() -> None:
    """Simulate, fit and write."""
    parser = command_line(__doc__, "servo_faults")
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--so101", type=Path, help="MJCF file of an SO-101")
    args = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)
    said: dict[str, dict[str, str]] = {}
    numbers, start = [], time.process_time()
    for name in args.arms.split(","):
        if name == "SO101" and not args.so101:
            continue
        file = str(args.so101) if name == "SO101" else name
        robot = with_servos(Robot.load(file))
        for n, fault in enumerate(FAULTS):
            j = n % robot.size
            logs = [log(robot, fault, j, seed, 20.0) for seed in range(4)]
            fit = fit_servo(robot, logs)
            what = outcome(fit, fault, robot.joints[j])
            said.setdefault(fault, {})[Path(name).stem] = what
            numbers.append(
                {
                    "arm": Path(name).stem,
                    "fault": fault,
                    "said": what,
                    "fit": fit.as_dict(),
                }
            )
            print(Path(name).stem, fault, robot.joints[j], what, flush=True)
    arms = list(said["none"])
    rows = tuple((f, *(said[f].get(a, "") for a in arms)) for f in said)
    counts = Counter(x["said"].split(",")[0].split(" (")[0] for x in numbers)
    minutes = (time.process_time() - start) / 60
    text = markdown_table(Table(("", *arms), rows, words=True))
    text += f"\n{dict(counts)}, {minutes:.0f} min of processor time\n"
    how = provenance(command="python experiments/servo_faults.py")
    write_results(args.out / "results.json", {"cases": numbers, "provenance": how})
    with atomic_path(args.out / "table.md") as path:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
