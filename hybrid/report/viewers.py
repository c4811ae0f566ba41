"""Write a diagnosis for Rerun and Foxglove: the arm beside its simulators over time.

Links are drawn as capsules, in the base frame, [m].
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array
from hybrid.diagnosis.answer.replay import simulated_positions
from hybrid.diagnosis.answer.result import Result
from hybrid.dynamics.kinematics import frames
from hybrid.errors import HybridError, RobotError
from hybrid.extras import check_extra
from hybrid.files import atomic_path
from hybrid.report.diagnosis_data import continuous_time
from hybrid.report.style import BLUE, GREY, RED
from hybrid.robot.geometry import Capsules, capsules_from_robot
from hybrid.robot.robot import Robot
from hybrid.servo.servo_fit import ServoReplay

_MEASURED, _FILE, _FOUND = "measured", "as the file stands", "with what was found"
_INKS = {_MEASURED: GREY, _FILE: RED, _FOUND: BLUE}
_BASE = "base"
_OPACITY = 0.6
_RADIUS = 0.02  # of the arm's length, of links without geometry


@dataclass(frozen=True, eq=False)
class Scene:
    """Measured and simulated motion of an arm, N samples.

    Attributes:
        robot: The arm.
        t: Time, shape (N,), [s].
        curves: Curves of the joints by kind and source, shape (N, n): positions,
            [rad or m], torques and gaps, [N·m]; NaN where they are not known.
    """

    robot: Robot
    t: Array
    curves: Mapping[str, Mapping[str, Array]]

    @property
    def q(self) -> Mapping[str, Array]:
        """Positions of the arm and of its simulators, shape (N, n), [rad or m]."""
        return self.curves["position"]

    def each(self) -> Iterator[tuple[str, str, Array]]:
        """Kind, name and values of every curve."""
        for kind, named in self.curves.items():
            for name, x in named.items():
                yield kind, name, x

    def poses(self, name: str) -> tuple[Array, Array]:
        """Quaternions (x, y, z, w), (n, N, 4), and origins of links, (n, N, 3), [m].

        They are in the base frame. Where a simulator was not replayed, the measured
        position is taken.
        """
        q = self.q[name]
        q = np.where(np.isnan(q), self.q[_MEASURED], q)
        R, p, _ = frames(self.robot.chain, q)
        turns = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat()
        return turns.reshape(*R.shape[:2], 4), p

    def links(self) -> Iterator[tuple[int, Array, Array, Array, Array]]:
        """Capsules of each link in its frame; −1 is the base.

        Yields:
            Link, end points (C, 2, 3), radii (C,) and lengths (C,), [m], and
            quaternions (x, y, z, w) that rotate z along the capsules, (C, 4).
        """
        capsules = self._capsules()
        for k in np.unique(capsules.link).tolist():
            own = capsules.link == k
            ends = capsules.ends[own]
            axis = ends[:, 1] - ends[:, 0]
            turns = np.array([_rotation_to(x) for x in axis])
            length = np.linalg.norm(axis, axis=1)
            yield k, ends, capsules.radius[own], length, turns

    def _capsules(self) -> Capsules:
        try:
            return capsules_from_robot(self.robot)
        except RobotError:  # no geometry: capsules from joint to joint
            places = self.robot.chain.translation
            n = len(places)
            ends = np.stack([np.zeros((n, 3)), places], axis=1)
            radius = _RADIUS * np.linalg.norm(places, axis=1).sum()
            return Capsules(np.arange(n) - 1, ends, np.full(n, radius), ("",) * n)


def _rotation_to(axis: Array) -> Array:
    """Quaternion (x, y, z, w) that rotates the z axis along a vector."""
    if not axis.any():
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.asarray(Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0].as_quat())


def scene_of_diagnosis(result: Result) -> Scene:
    """All recordings one after another, with simulators without and with findings.

    The gap with the findings is known at held-out samples only.
    """
    gap, scored = result.gap, result.scored
    rows = np.arange(len(gap.left))
    t, _ = continuous_time(
        gap.sampled.t, gap.trajectory, rows, [x.source for x in gap.motions]
    )
    left = np.full_like(gap.left, np.nan)
    for i, seen in enumerate(scored.evidence.rows):
        left[seen, i] = scored.after[i]
    before, after = simulated_positions(scored)
    curves = {
        "position": {_MEASURED: gap.sampled.q, _FILE: before, _FOUND: after},
        "torque": {_MEASURED: gap.measured, _FILE: gap.measured - gap.left},
        "gap": {_FILE: gap.left, _FOUND: left},
    }
    return Scene(gap.robot, t, curves)


def scene_of_servos(robot: Robot, replay: ServoReplay) -> Scene:
    """A log without torque, with its replays."""
    q = {_MEASURED: replay.q, _FILE: replay.before, _FOUND: replay.after}
    return Scene(robot, replay.t, {"position": q})


def writer_of(path: Path) -> Callable[[Scene, Path], None]:
    """The function that writes a file, by its suffix.

    Raises:
        HybridError: The suffix is unknown, or its library is not installed.
    """
    kinds = {".rrd": ("rerun", write_rerun), ".mcap": ("foxglove", write_mcap)}
    if path.suffix not in kinds:
        raise HybridError(f"{path}: valid are {' and '.join(kinds)}")
    library, write = kinds[path.suffix]
    check_extra(library, "viewers", path.name)
    return write


def write_rerun(scene: Scene, path: str | Path) -> None:
    """Write a recording for Rerun, with a tab of curves for each joint."""
    import rerun as rr
    import rerun.blueprint as rrb

    joints = scene.robot.joints
    stream = rr.RecordingStream("hybrid", recording_id="hybrid", send_properties=False)
    time = [rr.TimeColumn("time", duration=scene.t)]
    tabs = [
        rrb.Vertical(
            *(
                rrb.TimeSeriesView(origin=rr.new_entity_path([kind, joint]), name=kind)
                for kind in scene.curves
            ),
            name=joint,
        )
        for joint in joints
    ]
    views = rrb.Horizontal(rrb.Spatial3DView(origin="/arm"), rrb.Tabs(*tabs))
    with atomic_path(path) as temporary:
        stream.save(temporary, default_blueprint=rrb.Blueprint(views))
        for name in scene.q:
            _log_arm(stream, scene, name, time)
        for kind, name, x in scene.each():
            for j, joint in enumerate(joints):
                where = rr.new_entity_path([kind, joint, name])
                line = rr.SeriesLines(colors=_rgb(name), names=name)
                stream.log(where, line, static=True)
                stream.send_columns(where, time, rr.Scalars.columns(scalars=x[:, j]))
        stream.flush()
        stream.disconnect()


def _log_arm(stream: Any, scene: Scene, name: str, time: list[Any]) -> None:
    """Log the capsules of each link, and how they move."""
    import rerun as rr

    turns, places = scene.poses(name)
    for k, ends, radius, length, turn in scene.links():
        where = rr.new_entity_path(["arm", name, (_BASE, *scene.robot.joints)[k + 1]])
        shape = rr.Capsules3D(
            lengths=length,
            radii=radius,
            translations=ends[:, 0],
            quaternions=turn,
            colors=_rgb(name),
        )
        stream.log(where, shape, static=True)
        if k >= 0:
            moves = rr.Transform3D.columns(translation=places[k], quaternion=turns[k])
            stream.send_columns(where, time, moves)


def _rgb(name: str) -> tuple[int, int, int]:
    """Colour of an arm and its curves, 0 to 255."""
    ink = _INKS[name]
    return int(ink[1:3], 16), int(ink[3:5], 16), int(ink[5:7], 16)


def write_mcap(scene: Scene, path: str | Path) -> None:
    """Write MCAP for Foxglove: transforms, a scene, and a message for each curve.

    Paths to plot are ``/position/measured.elbow``, ``/gap/as the file stands.elbow``
    and so on; unknown values are null.
    """
    import foxglove
    from foxglove.channels import FrameTransformsChannel, SceneUpdateChannel
    from foxglove.messages import FrameTransforms, SceneUpdate

    apart = foxglove.Context()
    stamps = np.round(1e9 * (scene.t - scene.t[0])).astype(int).tolist()
    moves = FrameTransformsChannel("/tf", context=apart)
    drawn = SceneUpdateChannel("/scene", context=apart)
    curves = [
        (foxglove.Channel(f"/{kind}/{name}", message_encoding="json", context=apart), x)
        for kind, name, x in scene.each()
    ]
    poses = {name: scene.poses(name) for name in scene.q}
    with atomic_path(path) as temporary, foxglove.open_mcap(temporary, context=apart):
        entities = [x for name in scene.q for x in _entities(scene, name)]
        drawn.log(SceneUpdate(entities=entities), log_time=stamps[0])
        for i, stamp in enumerate(stamps):
            now = [
                x
                for name, (turn, place) in poses.items()
                for x in _transforms(scene, name, turn[:, i], place[:, i], stamp)
            ]
            moves.log(FrameTransforms(transforms=now), log_time=stamp)
            for channel, x in curves:
                values = (v if np.isfinite(v) else None for v in x[i].tolist())
                row = dict(zip(scene.robot.joints, values, strict=True))
                channel.log(row, log_time=stamp)


def _frame(scene: Scene, name: str, k: int) -> str:
    return f"{name}/{scene.robot.joints[k]}" if k >= 0 else _BASE


def _placed(place: Array, turn: Array) -> tuple[Any, Any]:
    """An origin and a quaternion (x, y, z, w) as messages."""
    from foxglove import messages as m

    origin = m.Vector3(**dict(zip("xyz", place.tolist(), strict=True)))
    return origin, m.Quaternion(**dict(zip("xyzw", turn.tolist(), strict=True)))


def _transforms(
    scene: Scene, name: str, turn: Array, place: Array, stamp: int
) -> Iterator[Any]:
    """Poses of the links at one time, from quaternions (n, 4) and origins (n, 3)."""
    from foxglove import messages as m

    for k, pose in enumerate(map(_placed, place, turn)):
        yield m.FrameTransform(
            timestamp=m.Timestamp(*divmod(stamp, 10**9)),
            parent_frame_id=_BASE,
            child_frame_id=_frame(scene, name, k),
            translation=pose[0],
            rotation=pose[1],
        )


def _entities(scene: Scene, name: str) -> Iterator[Any]:
    """The links of an arm: cylinders between spheres, fixed to their frames."""
    from foxglove import messages as m

    def pose(place: Array, turn: Array) -> Any:
        origin, turned = _placed(place, turn)
        return m.Pose(position=origin, orientation=turned)

    red, green, blue = (x / 255 for x in _rgb(name))
    color = m.Color(r=red, g=green, b=blue, a=_OPACITY)
    for k, *parts in scene.links():
        spheres, cylinders = [], []
        for ends, radius, length, turn in zip(*parts, strict=True):
            wide = 2 * float(radius)
            size = m.Vector3(x=wide, y=wide, z=float(length))
            middle = pose(ends.mean(axis=0), turn)
            cylinders.append(
                m.CylinderPrimitive(
                    pose=middle, size=size, bottom_scale=1, top_scale=1, color=color
                )
            )
            sphere = m.Vector3(x=wide, y=wide, z=wide)
            spheres += [
                m.SpherePrimitive(pose=pose(end, turn), size=sphere, color=color)
                for end in ends
            ]
        yield m.SceneEntity(
            timestamp=m.Timestamp(0, 0),
            frame_id=_frame(scene, name, k),
            id=f"{name} {k}",
            frame_locked=True,
            spheres=spheres,
            cylinders=cylinders,
        )
