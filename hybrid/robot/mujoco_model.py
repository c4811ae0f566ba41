"""Compile a file by MuJoCo, also if meshes and pictures are missing."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco

from hybrid.errors import RobotError
from hybrid.names import printable

_CORNERS = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]  # of a tetrahedron


def compile_file(path: str | Path) -> Any:
    """Compile a file by MuJoCo; a warning of MuJoCo counts as an error."""
    return _checked(lambda: mujoco.MjModel.from_xml_path(str(path)), path)


def compile_without_assets(path: str | Path) -> tuple[Any, Mapping[int, str]]:
    """Compile a file whose meshes may be missing, as :func:`compile_spec` does."""
    try:
        return compile_file(path), {}
    except RobotError:
        spec = _checked(lambda: spec_from_file(Path(path)), path)
        if not (spec.meshes or spec.hfields or spec.textures):
            raise
    return compile_spec(spec, str(path))


def spec_from_file(path: Path) -> Any:
    """Read a file as MuJoCo's spec; ``ValueError`` if that fails."""
    if path.suffix.lower() == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    text = path.read_text(encoding="utf-8", errors="replace")
    spec = mujoco.MjSpec.from_string(text)  # from_file knows .xml only
    spec.modelfiledir = str(path.parent)
    return spec


def compile_spec(spec: Any, where: str) -> tuple[Any, Mapping[int, str]]:
    """Compile a spec; placeholders replace missing files in it.

    Returns:
        The model, and the missing mesh file that each body needs for its inertia.
    """
    spec.compiler.fusestatic = False  # keep the bodies of the file
    missing = dict(_replace_missing_files(spec))
    model = _checked(spec.compile, where)
    mode = spec.compiler.inertiafromgeom
    never, always, _ = mujoco.mjtInertiaFromGeom.__members__.values()
    low, high = spec.compiler.inertiagrouprange
    missing_inertia = {
        body.id: missing[geom.meshname]
        for body in spec.bodies
        if mode == always or not (mode == never or body.explicitinertial)
        for geom in body.geoms
        if geom.meshname in missing and low <= geom.group <= high
        # A geom of zero mass or density adds no inertia.
        and geom.mass != 0 and geom.density != 0
    }  # fmt: skip
    return model, missing_inertia


def _checked(make: Callable[[], Any], where: str | Path) -> Any:
    """Call MuJoCo; its warnings and exceptions become an error."""
    with mujoco_warnings() as messages:
        try:
            model = make()
        except (ValueError, OSError, mujoco.FatalError) as error:
            messages.append(str(error))
    if messages:
        reason = printable(" ".join(" ".join(messages).split()))
        raise RobotError(f"{where}: not a readable MJCF ({reason})")
    return model


@contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which it would write to a file in this folder."""
    messages: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    try:
        yield messages
    finally:
        mujoco.set_mju_user_warning(before)


def _replace_missing_files(spec: Any) -> Iterator[tuple[str, str]]:
    """Replace missing files by placeholders; yield name and file of missing meshes."""

    def missing(folder: str, asset: Any) -> bool:
        file = Path(asset.file).name if spec.strippath else asset.file
        exists = Path(spec.modelfiledir, folder, file).is_file()
        return bool(asset.file) and asset.file not in spec.assets and not exists

    for mesh in spec.meshes:
        if missing(mesh.compiler.meshdir, mesh):
            mesh.name = mesh.name or Path(mesh.file).stem
            yield mesh.name, mesh.file
            mesh.file, mesh.uservert, mesh.scale = "", _CORNERS, [1, 1, 1]
    for field in spec.hfields:
        if missing(field.compiler.meshdir, field):
            field.file, field.nrow, field.ncol, field.userdata = "", 2, 2, [0, 0, 0, 1]
    for texture in spec.textures:
        # Pictures are never needed.
        if texture.file or any(texture.cubefiles):
            texture.name = texture.name or Path(texture.file).stem
            texture.file, texture.cubefiles = "", [""] * len(texture.cubefiles)
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = 1
            texture.height = 6 if texture.type else 1  # sides of a cube
    for skin in list(spec.skins):
        spec.delete(skin)
