"""Export a model in a format that other programs run."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hybrid.arguments import typed
from hybrid.errors import HybridError
from hybrid.exports.c_code import write_c
from hybrid.exports.manifest import build_manifest, seal
from hybrid.exports.simulator.model import model_simulator
from hybrid.exports.simulator.snippets import isaac_lab, mjx_notes, write_ranges
from hybrid.extras import check_extra
from hybrid.files import atomic_folder
from hybrid.model.dynamic_model import DynamicModel
from hybrid.model.program import Program, program_from_model
from hybrid.names import file_stem
from hybrid.signals import Motion

_PROGRAMS = "onnx", "torchscript", "c"
FORMATS = (*_PROGRAMS, "mjcf", "urdf", "isaaclab", "ranges", "json")
# Package that a format needs, the extra that brings it, and what to call the format.
_LIBRARIES = {
    "onnx": ("onnx", "export", "ONNX"),
    "torchscript": ("torch", "learn", "TorchScript"),
}


@typed
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
        HybridError: ``model`` is no model, the format is unknown, or its package is
            missing.
        EffectError: An effect cannot run in a control loop.
    """
    if format not in FORMATS:
        raise HybridError(f"no format {format!r}; valid are {', '.join(FORMATS)}")
    if format in _LIBRARIES:
        check_extra(*_LIBRARIES[format])
    stem = file_stem(model.robot.name)
    with atomic_folder(folder, lambda old, new: seal(manifest, new, old)) as hidden:
        path, describe = hidden / stem, partial(build_manifest, model, format=format)
        if format in _PROGRAMS:
            program = program_from_model(model)
            manifest = describe(left_out=program.left_out, memory=program.memory_names)
            _write_program(program, model, manifest, path)
        else:
            manifest = describe(
                left_out=_write_file(model, path, format, motions, folder)
            )
    return tuple(manifest["left_out"])


def _write_file(
    model: DynamicModel,
    path: Path,
    format: str,
    motions: Sequence[Motion],
    home: str | Path,
) -> tuple[str, ...]:
    """Write a file of numbers, at a path without suffix; return what it lacks."""
    if format == "json":
        model.save(path.with_name("model.json"))
        return ()
    if format == "ranges":
        return write_ranges(model, path.parent, path.name)
    if format == "isaaclab":
        text, left_out = isaac_lab(model, motions)
        target = path.with_name(f"{path.name}_isaaclab.py")
        target.write_text(text, encoding="utf-8")
        return left_out
    edited = model_simulator(model, kind=format, motions=motions, folder=home)
    edited.write(path.with_name(f"{path.name}.{'xml' if format == 'mjcf' else 'urdf'}"))
    return (*edited.notes, *(mjx_notes(edited.robot) if format == "mjcf" else ()))


def _write_program(
    program: Program, model: DynamicModel, manifest: Mapping[str, Any], path: Path
) -> None:
    """Write a program, at a path without suffix."""
    if manifest["format"] == "c":
        write_c(model, program, manifest["model_sha256"], path.parent)
    elif manifest["format"] == "onnx":
        from hybrid.exports.onnx_graph import onnx_model  # loads onnx

        content = onnx_model(program, manifest).SerializeToString()
        path.with_name(f"{path.name}.onnx").write_bytes(content)
    else:
        from hybrid.exports.torch_module import write_torchscript  # loads torch

        write_torchscript(program, manifest, path.with_name(f"{path.name}.pt"))
