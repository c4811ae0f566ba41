"""Columns of numbers <-> recording."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.columns import Layout
from hybrid.recording.recording import Recording, numbered_joints

Array = NDArray[np.float64]


def recording_from_layout(
    layout: Layout, column: Callable[[int], Array], *, source: str
) -> Recording:
    """Build the recording of a table.

    Args:
        layout: Which column holds what.
        column: Gives the samples of a column by its index, shape (N,).
        source: File name for messages.

    Raises:
        RecordingError: The samples are not a valid recording.
    """
    t = column(layout.time)
    channels = {
        channel: [column(k) for k in indices]
        for channel, indices in layout.channels.items()
    }
    for channel, columns in channels.items():
        for k, x in enumerate(columns):
            if x.shape != t.shape:
                raise RecordingError(
                    f"{source}: {channel}{k + 1} ({layout.joints[k]}) has {len(x)} "
                    f"rows; valid are {len(t)}, as many as there are times"
                )
    return Recording(
        t=t,
        joints=layout.joints,
        source=source,
        **{name: np.stack(x, axis=1) for name, x in channels.items()},  # type: ignore[arg-type]
    )


def labels_of(recording: Recording) -> dict[str, Array]:
    """The columns of a recording under the labels that read back to it.

    Args:
        recording: Joint log.

    Returns:
        Label -> samples, shape (N,): ``time``, then ``q1`` ... or ``q_elbow`` ...
    """
    numbered = recording.joints == numbered_joints(recording.size)
    columns = {"time": recording.t}
    for channel, x in recording.channels.items():
        for k, joint in enumerate(recording.joints):
            columns[f"{channel}{k + 1}" if numbered else f"{channel}_{joint}"] = x[:, k]
    return columns
