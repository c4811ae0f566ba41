"""Export a model in a format that other programs run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hybrid.arguments import MODEL, check_argument
from hybrid.errors import HybridError
from hybrid.exports.c_project import write_c
from hybrid.exports.manifest import build_manifest, model_digest, seal
from hybrid.exports.onnx_graph import onnx_model
from hybrid.exports.program import program_from_model
from hybrid.exports.simulator.model import model_simulator
from hybrid.exports.simulator.snippets import isaac_lab, mjx_notes, write_ranges
from hybrid.extras import check_extra
from hybrid.files import atomic_folder
from hybrid.model.dynamic_model import DynamicModel
from hybrid.names import file_stem
from hybrid.signals import Motion

FORMATS = (
    "onnx", "torchscript", "c", "mjcf", "urdf", "isaaclab", "ranges", "json",
)  # fmt: skip


def export(
    model: DynamicModel,
    folder: str | Path,
    *,
    format: str,
    motions: Sequence[Motion] = (),
) -> tuple[str, ...]:
    """Write a model for other programs, with a manifest that describes it.

    Files are named after the arm. Exports of other formats stay in the folder and in
    the manifest.

    ``c`` writes a C99 header with an example and a build file; ``onnx`` and
    ``torchscript`` the inverse dynamics with a free batch axis; ``mjcf`` and ``urdf``
    the arm's own file, ``model.robot.path``, with identified links, rotors and
    friction, and a ``.diff``; ``isaaclab`` actuators for Isaac Lab; ``ranges`` the
    uncertainty of each number, as YAML and for Isaac Lab and MJX; ``json`` the model.

    Args:
        model: An identified model.
        folder: Folder of the files.
        format: One of ``FORMATS``.
        motions: Motions whose speeds are used to approximate friction that a robot file
            cannot express.

    Returns:
        What the format cannot express; the manifest lists it, too.

    Raises:
        HybridError: ``model`` is none, the format is unknown, or its package is
            missing.
        EffectError: An effect cannot run in a control loop.
    """
    check_argument(model, DynamicModel, MODEL)
    if format not in FORMATS:
        raise HybridError(f"no format {format!r}; valid are {', '.join(FORMATS)}")
    if format == "onnx":
        check_extra("onnx", "export", "ONNX")
    if format == "torchscript":
        check_extra("torch", "learn", "TorchScript")
    digest = model_digest(model)
    left_out: Sequence[str] = ()
    memory: Sequence[str] = ()
    stem = file_stem(model.robot.name)
    with atomic_folder(folder, lambda old, new: seal(manifest, new, old)) as hidden:
        if format == "json":
            model.save(hidden / "model.json")
        elif format in ("mjcf", "urdf"):
            edited = model_simulator(model, kind=format, motions=motions, folder=folder)
            edited.write(hidden / f"{stem}.{'xml' if format == 'mjcf' else 'urdf'}")
            left_out = edited.notes
            left_out += tuple(mjx_notes(edited.robot)) if format == "mjcf" else ()
        elif format == "isaaclab":
            text, left_out = isaac_lab(model, motions)
            (hidden / f"{stem}_isaaclab.py").write_text(text, encoding="utf-8")
        elif format == "ranges":
            left_out = write_ranges(model, hidden, stem)
        else:
            program = program_from_model(model)
            left_out, memory = program.left_out, program.memory_names
        manifest = build_manifest(
            model, format=format, digest=digest, left_out=left_out, memory=memory
        )
        if format == "c":
            write_c(model, program, digest, hidden)
        elif format == "onnx":
            content = onnx_model(program, manifest).SerializeToString()
            (hidden / f"{stem}.onnx").write_bytes(content)
        elif format == "torchscript":
            from hybrid.exports.torch_module import write_torchscript  # loads torch

            write_torchscript(program, manifest, hidden / f"{stem}.pt")
    return tuple(left_out)
