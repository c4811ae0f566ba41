"""One fault of an arm that somebody simulates, or of what is logged of it."""

from __future__ import annotations

import mujoco
import numpy as np

from hybrid.effects import Scale
from hybrid.robot import Robot

IN_MODEL = ("coulomb", "viscous", "armature", "gravity_tilt", "payload", "link_inertia",
            "elasticity", "backlash")  # fmt: skip
IN_DRIVE = ("torque_gain", "torque_offset", "saturation", "deadzone", "torque_ripple",
            "actuator_lag")  # fmt: skip
IN_TORQUE = ("nonlinear_viscous", "stribeck", "asymmetric_friction", "load_friction",
             "thermal_friction", "friction_lag", "presliding", "spring",
             "contact")  # fmt: skip
IN_LOG = ("delay", "encoder_offset", "encoder_eccentricity")
IN_COMMAND = ("command_latency", "controller_gain")
KINDS = ("none", *IN_MODEL, *IN_DRIVE, *IN_TORQUE, *IN_LOG, *IN_COMMAND)


class Fault:
    """A fault of usual size.

    Args:
        kind: One of ``KINDS``.
        j: Its joint.
        scale: Rated torque and speed of that.
        rated: Torque of all joints, shape (n,), [N·m].
    """

    def __init__(self, kind: str, j: int, scale: Scale, rated: np.ndarray) -> None:
        self.kind, self.j = kind, j
        self.R, self.V = scale.torque, scale.speed
        self.limit = np.inf  # of torque, if it saturates
        self.inertia = np.nan  # kg·m², that its joint feels
        push = 0.3 * rated[: min(2, len(rated))].max()
        self.force = push * np.array([0.5, -0.3, 0.8])  # N, of a contact
        self.begin()

    def begin(self) -> None:
        """Forget what was."""
        self.lagging, self.bristle, self.past = 0.0, 0.0, list[float]()

    def change(self, spec: mujoco.MjSpec, robot: Robot, inertia: float) -> None:
        """Change a model by it, if it is one of the model.

        Args:
            spec: The model.
            robot: The file that it is of.
            inertia: What its joint feels, [kg·m²].
        """
        name, self.inertia = robot.joints[self.j], inertia
        joint, body = spec.joint(name), spec.body(name)
        match self.kind:
            case "coulomb":
                joint.frictionloss += 0.05 * self.R
            case "viscous":
                joint.damping[0] += 0.06 * self.R / self.V
            case "armature":
                joint.armature += 0.5 * inertia
            case "gravity_tilt":
                g, tilt = float(np.linalg.norm(robot.chain.gravity)), np.deg2rad(3.0)
                spec.option.gravity = [g * np.sin(tilt), 0.0, -g * np.cos(tilt)]
            case "payload":
                tool = spec.body(robot.joints[-1])
                more = 0.06 * float(robot.chain.inertial[:, 0].sum())
                centre = more * np.array([0.02, -0.03, 0.08])
                tool.ipos = (np.array(tool.ipos) * tool.mass + centre) / (
                    tool.mass + more
                )
                tool.mass += more
            case "link_inertia":
                body.mass *= 1.2
                body.ipos = np.array(body.ipos) + np.array([0.02, 0.01, -0.02])
            case "elasticity" | "backlash":
                joint.armature = max(float(joint.armature), 0.15 * inertia)
                twist = body.add_joint(name=f"{name}_{self.kind}", axis=joint.axis)
                stiffness = inertia * (2 * np.pi * 15.0) ** 2
                twist.damping[0] = 0.03 * inertia
                if self.kind == "elasticity":
                    twist.stiffness[0] = stiffness
                    twist.damping[0] = 0.1 * np.sqrt(stiffness * inertia)
                else:
                    twist.limited, twist.range = True, [-0.0012, 0.0012]
                    twist.solref_limit = [0.002, 1.0]

    @property
    def values(self) -> dict[str, float]:
        """Parameters of the library's effect of its name, where both laws agree."""
        R, V = self.R, self.V
        return {
            "coulomb": {"level": 0.05 * R},
            "viscous": {"coefficient": 0.06 * R / V},
            "armature": {"inertia": 0.5 * self.inertia},
            "backlash": {"half_width": 0.0012},
            "torque_gain": {"gain": 0.12},
            "torque_offset": {"level": 0.04 * R},
            "saturation": {"limit": self.limit},
            "deadzone": {"width": 0.05 * R},
            "torque_ripple": {
                "sine": -0.03 * R * np.cos(1.0), "cosine": -0.03 * R * np.sin(1.0),
            },
            "stribeck": {"level": 0.07 * R, "velocity": 0.08 * V},
            "asymmetric_friction": {"level": 0.03 * R},
            "load_friction": {"coefficient": 0.12},
            "thermal_friction": {"cold": 0.1 * R / V, "time_constant": 6.0},
            "friction_lag": {"coefficient": 0.1 * R / V},
            "presliding": {"level": 0.06 * R, "distance": 0.02},
            "spring": {"stiffness": 0.08 * R, "preload": -0.016 * R},
            "delay": {"time": 0.008},
            "encoder_offset": {"offset": 0.03},
            "encoder_eccentricity": {
                "sine": 0.012 * np.cos(0.7), "cosine": 0.012 * np.sin(0.7),
            },
        }.get(self.kind, {})  # fmt: skip

    def sense(self, q: np.ndarray) -> None:
        """Turn positions of all joints into what the encoders show."""
        if self.kind == "encoder_offset":
            q[self.j] += 0.03
        if self.kind == "encoder_eccentricity":
            q[self.j] += 0.012 * np.sin(q[self.j] + 0.7)

    def delivered(self, u: float, q: float, step: float) -> float:
        """Torque that the drive delivers for one that it is given."""
        match self.kind:
            case "torque_gain":
                return u / 1.12
            case "torque_offset":
                return u - 0.04 * self.R
            case "saturation":
                return float(np.clip(u, -self.limit, self.limit))
            case "deadzone":
                return float(np.sign(u) * max(abs(u) - 0.05 * self.R, 0.0))
            case "torque_ripple":
                return float(u + 0.03 * self.R * np.sin(10.0 * q + 1.0))
            case "actuator_lag":
                self.lagging += (u - self.lagging) * step / 0.008
                return self.lagging
        return u

    def pushed(self, t: float, q: float, v: float, load: float, step: float) -> float:
        """Torque on the joint besides."""
        R, V = self.R, self.V
        sign = np.tanh(v / (0.002 * V))
        match self.kind:
            case "nonlinear_viscous":
                return float(-0.1 * R / V**2 * v * abs(v))
            case "stribeck":
                return float(-0.07 * R * np.exp(-((v / (0.08 * V)) ** 2)) * sign)
            case "asymmetric_friction":
                return float(-0.03 * R * abs(sign))
            case "load_friction":
                return float(-0.12 * abs(load) * sign)
            case "thermal_friction":
                return float(-0.1 * R / V * v * np.exp(-t / 6.0))
            case "friction_lag":
                self.past.append(v)
                return -0.1 * R / V * self.past[-1 - round(0.06 / step) :][0]
            case "presliding":
                self.bristle += step * (v - abs(v) * self.bristle / 0.02)
                return float(-0.06 * R * self.bristle / 0.02)
            case "spring":
                return float(-0.08 * R * (q - 0.2))
        return 0.0

    def touches(self, t: float) -> bool:
        """Whether it is a contact, and the arm in it."""
        return self.kind == "contact" and 3.0 <= t < 3.8
