"""Reference motions for the controller."""

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.robot.robot import Robot

# Limits of a robot file without them.
DEFAULT_POSITION = np.pi  # rad
DEFAULT_SPEED = 2.0  # rad/s
DEFAULT_ACCELERATION = 10.0  # rad/s²
_SAMPLES_A_PERIOD = 4  # of the highest harmonic, at least


@dataclass(frozen=True, eq=False)
class Reference:
    """A desired motion on a uniform clock.

    Attributes:
        t: Time from 0, uniform, shape (N,), [s].
        q: Position, shape (N, n), [rad].
        v: Speed, shape (N, n), [rad/s].
        a: Acceleration, shape (N, n), [rad/s²].

    Raises:
        HybridError: Shapes disagree, a sample is not finite, or the clock is not
            uniform from 0.
    """

    t: Array
    q: Array
    v: Array
    a: Array

    def __post_init__(self) -> None:
        shape = (len(self.t), *self.q.shape[1:])
        if self.t.ndim != 1 or len(shape) != 2 or len(self.t) < 2:
            raise HybridError("a reference needs t of shape (N,) and q of shape (N, n)")
        for name in ("q", "v", "a"):
            x = getattr(self, name)
            if x.shape != shape or not np.isfinite(x).all():
                raise HybridError(
                    f"reference {name} needs finite samples of shape {shape}"
                )
        clock = np.linspace(0.0, self.t[-1], len(self.t))
        if not (self.t[-1] > 0 and np.allclose(self.t, clock, atol=1e-9)):
            raise HybridError("the clock of a reference must be uniform from t = 0")

    @property
    def rate(self) -> float:
        """Samples per second, [Hz]."""
        return float((len(self.t) - 1) / self.t[-1])

    def at(self, t: Array) -> tuple[Array, Array]:
        """Position [rad] and speed [rad/s] at other times (M,), [s], shape (M, n) each.

        Outside the clock the arm stands still.
        """
        from scipy.interpolate import CubicHermiteSpline

        spline = CubicHermiteSpline(self.t, self.q, self.v)
        inside = np.clip(t, 0.0, self.t[-1])
        moving = (inside == t)[:, None]
        return spline(inside), np.where(moving, spline(inside, 1), 0.0)


def random_fourier(
    robot: Robot,
    *,
    duration: float,
    rate: float,
    seed: int | np.random.Generator = 0,
    order: int = 5,
    fundamental: float | None = None,
    fill: float = 0.7,
) -> Reference:
    """A random Fourier-series motion within the limits of an arm.

    Every joint moves as a sum of ``order`` harmonics, so that slow motion, reversals
    and fast motion occur in one record. Random coefficients are projected on those that
    start at rest. The duration is a whole number of periods, so the motion starts *and*
    ends with zero speed and acceleration, and has no frequency above the last harmonic.
    Each joint is scaled to the stated share of its tightest limit, and centred at
    random within its range. See Swevers et al. 1997, doi 10.1109/70.631234.

    Args:
        robot: The arm; missing limits are ±π rad, 2 rad/s and 10 rad/s².
        duration: Length of the motion, [s].
        rate: Samples per second, [Hz].
        seed: Seed or generator of the coefficients.
        order: Number of harmonics, at least 3.
        fundamental: Lowest frequency, [Hz]; rounded to a whole number of periods in
            the duration. By default 0.1 Hz, or one period if the motion is shorter.
        fill: Share of the limits to use, above 0 up to 1.

    Raises:
        HybridError: An argument is out of range.
    """
    _check(duration=duration, rate=rate, order=order, fill=fill)
    lowest = max(0.1, 1.0 / duration) if fundamental is None else fundamental
    periods = max(1, round(duration * lowest))
    fewest = _SAMPLES_A_PERIOD * order * periods
    if duration * rate < fewest:
        raise HybridError(
            f"{duration:g} s at {rate:g} Hz is too short for {order} harmonics; valid "
            f"are {fewest} samples or more"
        )
    omega = 2 * np.pi * periods / duration * np.arange(1.0, order + 1)  # (order,)
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    rng = np.random.default_rng(seed)
    sine, cosine = _coefficients(omega, robot.size, rng)
    s, c = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))  # (N, order)
    v = s @ sine + c @ cosine
    a = (c * omega) @ sine - (s * omega) @ cosine
    q = (s / omega) @ cosine - (c / omega) @ sine
    q -= (q.max(axis=0) + q.min(axis=0)) / 2
    low, high, v_max, a_max = limits(robot)
    room = fill * (high - low) / 2
    pairs = (q, room), (v, fill * v_max), (a, fill * a_max)
    scale = np.min([most / np.abs(x).max(axis=0) for x, most in pairs], axis=0)
    q, v, a = q * scale, v * scale, a * scale
    spare = room - np.abs(q).max(axis=0)
    center = (low + high) / 2 + spare * rng.uniform(-1.0, 1.0, robot.size)
    return Reference(t, center + q, v, a)


def limits(robot: Robot) -> tuple[Array, Array, Array, Array]:
    """Lowest and highest position [rad], speed [rad/s] and acceleration [rad/s²], (n,).

    Missing ones are defaults.
    """
    low = np.where(np.isfinite(robot.q_min), robot.q_min, -DEFAULT_POSITION)
    high = np.where(np.isfinite(robot.q_max), robot.q_max, DEFAULT_POSITION)
    # With one limit only, the default range lies beside it.
    high = np.maximum(high, np.where(np.isfinite(robot.q_max), high, low + np.pi))
    low = np.minimum(low, np.where(np.isfinite(robot.q_min), low, high - np.pi))
    v_max = np.where(np.isfinite(robot.v_max), robot.v_max, DEFAULT_SPEED)
    a_max = np.where(np.isfinite(robot.a_max), robot.a_max, DEFAULT_ACCELERATION)
    return low, high, v_max, a_max


def _coefficients(
    omega: Array, size: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Random speed amplitudes of sine and cosine with v(0) = a(0) = 0."""
    sine, cosine = rng.standard_normal((2, len(omega), size))
    sine -= np.outer(omega, omega @ sine) / (omega @ omega)  # a(0) = Σ ω s
    cosine -= cosine.mean(axis=0)  # v(0) = Σ c
    return sine, cosine


def _check(*, duration: float, rate: float, order: int, fill: float) -> None:
    for name, x, unit in (("duration", duration, "s"), ("rate", rate, "Hz")):
        if not (np.isfinite(x) and x > 0):
            raise HybridError(f"{name} is {x:g} {unit}, above 0 is valid")
    if order < 3:
        raise HybridError(f"order is {order}, 3 harmonics or more are valid")
    if not 0 < fill <= 1:
        raise HybridError(f"fill is {fill:g}, above 0 up to 1 is valid")
