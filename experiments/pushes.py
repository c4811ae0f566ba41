"""Pushes by hand on a real arm that moves, whose file lacks friction: are they found?

To a log the torque of a push on the last link is added, by the Jacobian of Pinocchio:
of random direction and time, 30 to 120 N, 0.3 to 1 s, either half a sine or constant
with edges of 60 ms. It passes the filter by which the log was smoothed, if one was.
Each is diagnosed, with the other logs, against the arm's file. A
row appears for each push: the largest torque that it adds, whether an event of the
answer overlaps it, by how much its start and end are off, the part of its mean torque,
over all joints, that is missed, and other events.

    python experiments/pushes.py DATA_FOLDER --arm ur10_salerno --first 1 --count 12
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from outputs import command_line, write_tables

from hybrid import Recording, Robot, identify, read_recordings
from hybrid.arrays import Array
from hybrid.diagnosis import diagnose
from hybrid.errors import HybridWarning
from hybrid.report import Table, markdown_table
from hybrid.signals import Sampler

FORCES, LASTS = (30.0, 120.0), (0.3, 1.0)  # N, s
EDGE = 0.06  # s, of a push that is constant
APART = 0.5  # s from both ends of the log
HEADER = ("push", "shape", "force, N", "from, s", "for, s", "torque, N·m", "found",
          "start, s", "end, s", "missed", "others")  # fmt: skip


@dataclass(frozen=True)
class Push:
    """A force on the last link, in the base frame, for some time.

    Attributes:
        force: Shape (3,), [N].
        start: When it begins, [s].
        lasts: How long it lasts, [s].
        shape: ``half a sine`` or ``constant``.
    """

    force: Array
    start: float
    lasts: float
    shape: str

    @classmethod
    def drawn(cls, seed: int, duration: float, factor: float = 1.0) -> Push:
        """A random push in a log of some duration, [s]; of forces times a factor."""
        rng = np.random.default_rng([seed, 80])
        way = rng.standard_normal(3)
        size = factor * np.exp(rng.uniform(*np.log(FORCES)))
        lasts = rng.uniform(*LASTS)
        start = rng.uniform(APART, duration - APART - lasts)
        shape = ("half a sine", "constant")[seed % 2]
        return cls(size * way / np.linalg.norm(way), start, lasts, shape)

    def strength(self, t: Array) -> Array:
        """Share of the force at times in [s], shape (N,)."""
        since, left = t - self.start, self.start + self.lasts - t
        during = (since > 0) & (left > 0)
        if self.shape == "constant":
            edge = np.clip(np.minimum(since, left) / EDGE, 0.0, 1.0)
            return np.where(during, 0.5 - 0.5 * np.cos(np.pi * edge), 0.0)
        return np.where(during, np.sin(np.pi * since / self.lasts), 0.0)


def pushed(
    log: Recording, file: Path, push: Push, band: float
) -> tuple[Recording, Array]:
    """A log with a push, and the torque that it adds, shape (N, n), [N·m].

    ``band`` is the bandwidth of the logged torque, [Hz].
    """
    model = pin.buildModelFromUrdf(str(file))
    data, names = model.createData(), list(model.names)
    at = [names.index(x) - 1 for x in log.joints]
    last, more = names.index(log.joints[-1]), np.zeros_like(log.tau)
    share = push.strength(log.t - log.t[0])
    for k in np.flatnonzero(share):
        q = np.zeros(model.nq)
        q[at] = log.q[k]
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobians(model, data, q)
        J = pin.getJointJacobian(model, data, last, frame)
        more[k] = share[k] * (J[:3].T @ push.force)[at]
    more = Sampler(log.rate, band, 1)(more)
    return replace(log, tau=log.tau + more), more


def outcome(
    robot: Robot, logs: Sequence[Recording], file: Path, push: Push, band: float
) -> tuple[object, ...]:
    """Diagnose logs, a push in the first: the columns of a row from its torque on."""
    log, *rest = logs
    told, more = pushed(log, file, push, band)
    events = diagnose.examine(robot, [told, *rest]).diagnosis.events
    zero, end = log.t[0] + push.start, log.t[0] + push.start + push.lasts
    here = [e for e in events if e.start < end and e.end > zero]
    size = float(np.abs(more).max())
    if not here:
        return size, False, np.nan, np.nan, np.nan, len(events)
    found = max(here, key=lambda e: min(e.end, end) - max(e.start, zero))
    during = (log.t >= found.start) & (log.t < found.end)
    mean = more[during].mean(axis=0)
    missed = np.linalg.norm(np.array(found.torque) - mean) / np.linalg.norm(mean)
    others = len(events) - len(here)
    return size, True, found.start - zero, found.end - end, float(missed), others


def main() -> None:
    """Diagnose all pushes, and write the report."""
    parser = command_line(__doc__, "pushes")
    parser.add_argument("data", type=Path, help="folder with a folder for each arm")
    parser.add_argument("--arm", default="ur10_salerno", help="one of these folders")
    parser.add_argument("--factor", type=float, default=1.0, help="of the forces")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--count", type=int, default=12, help="number of pushes")
    args = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)  # columns of the log not needed
    file = args.data / args.arm / "robot.urdf"
    robot = Robot.load(file)
    logs = read_recordings([args.data / args.arm], joints=robot.joints)
    duration = float(np.ptp(logs[0].t))
    band = identify(robot, logs, stages=("rigid",)).model.band
    rows = []
    for seed in range(args.first, args.first + args.count):
        push = Push.drawn(seed, duration, args.factor)
        size, found, *rest = outcome(robot, logs, file, push, band)
        force = float(np.linalg.norm(push.force))
        rows.append((seed, push.shape, force, push.start, push.lasts, size, found,
                     *rest))  # fmt: skip
        print(rows[-1], flush=True)
    command = (
        f"python experiments/pushes.py DATA_FOLDER --arm {args.arm} "
        f"--factor {args.factor:g} --first {args.first} --count {args.count}"
    )
    lines = [
        (
            str(r[0]), r[1], f"{r[2]:.0f}", f"{r[3]:.1f}", f"{r[4]:.2f}", f"{r[5]:.0f}",
            "yes" if r[6] else "no",
            *(f"{x:+.2f}" if r[6] else "" for x in r[7:9]),
            f"{r[9]:.0%}" if r[6] else "", str(r[10]),
        )
        for r in rows
    ]  # fmt: skip
    table = markdown_table(Table(HEADER, tuple(lines)))
    count = sum(bool(r[6]) for r in rows)
    said = f"Found: {count} of {len(rows)}; other events: {sum(r[10] for r in rows)}."
    lead = (__doc__ or "").split("\n    python")[0].strip()
    text = f"{lead}\n\n{said}\n\n{table}"
    write_tables(args.out, text, command, header=HEADER, rows=rows)


if __name__ == "__main__":
    main()
