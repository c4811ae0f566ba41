"""MuJoCo's model of a file, with stand-ins for meshes and pictures it lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from hybrid.errors import RobotError
from hybrid.names import printable

_CORNERS = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]  # of a tetrahedron


def compiled(path: str | Path) -> Any:
    """Compile a file with MuJoCo; a warning of MuJoCo counts as an error.

    Raises:
        RobotError: The file does not compile.
    """
    import mujoco

    return _quietly(lambda: mujoco.MjModel.from_xml_path(str(path)), path)


def compiled_without_files(path: str | Path) -> tuple[Any, Mapping[int, str]]:
    """MuJoCo's model of a file whose meshes, pictures and height fields may be missing.

    Raises:
        RobotError: The file does not compile for another reason.
    """
    try:
        return compiled(path), {}
    except RobotError:
        spec = _quietly(lambda: spec_from_file(Path(path)), path)
        if not (spec.meshes or spec.hfields or spec.textures):
            raise
    return compiled_spec(spec, str(path))


def spec_from_file(path: Path) -> Any:
    """A file as MuJoCo's spec; ``ValueError`` if it is none."""
    import mujoco

    if path.suffix.lower() == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    text = path.read_text(encoding="utf-8", errors="replace")
    spec = mujoco.MjSpec.from_string(text)  # which files of other endings need
    spec.modelfiledir = str(path.parent)
    return spec


def compiled_spec(spec: Any, where: str) -> tuple[Any, Mapping[int, str]]:
    """Compile a spec; stand-ins replace missing files in it.

    Returns:
        The model, and the missing file that each body's inertia would come from.

    Raises:
        RobotError: The spec does not compile.
    """
    import mujoco

    spec.compiler.fusestatic = False  # bodies stay what geometry belongs to
    missing = dict(_stand_ins(spec))
    model = _quietly(spec.compile, where)
    by = spec.compiler.inertiafromgeom
    never, always, _ = mujoco.mjtInertiaFromGeom.__members__.values()
    low, high = spec.compiler.inertiagrouprange
    wanting = {
        body.id: missing[geom.meshname]
        for body in spec.bodies
        if by == always or not (by == never or body.explicitinertial)
        for geom in body.geoms
        if geom.meshname in missing and low <= geom.group <= high
        # What has no mass of its own has none by its shape either.
        and geom.mass != 0 and geom.density != 0
    }  # fmt: skip
    return model, wanting


def _quietly(make: Callable[[], Any], where: str | Path) -> Any:
    import mujoco

    # Without a listener MuJoCo leaves a log in the folder that one happens to be in.
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        model = make()
    except (ValueError, OSError, mujoco.FatalError) as error:
        said.append(str(error))
    finally:
        mujoco.set_mju_user_warning(before)
    if said:
        reason = printable(" ".join(" ".join(said).split()))
        raise RobotError(f"{where}: not a readable MJCF ({reason})")
    return model


def _stand_ins(spec: Any) -> Iterator[tuple[str, str]]:
    """Put something in place of missing files; name and file of each such mesh."""
    import mujoco

    def missing(folder: str, asset: Any) -> bool:
        file = Path(asset.file).name if spec.strippath else asset.file
        there = Path(spec.modelfiledir, folder, file).is_file()
        return bool(asset.file) and asset.file not in spec.assets and not there

    for mesh in spec.meshes:
        if missing(mesh.compiler.meshdir, mesh):
            mesh.name = mesh.name or Path(mesh.file).stem
            yield mesh.name, mesh.file
            mesh.file, mesh.uservert, mesh.scale = "", _CORNERS, [1, 1, 1]
    for field in spec.hfields:
        if missing(field.compiler.meshdir, field):
            field.file, field.nrow, field.ncol, field.userdata = "", 2, 2, [0, 0, 0, 1]
    for texture in spec.textures:
        # Pictures have no part in motion.
        if texture.file or any(texture.cubefiles):
            texture.name = texture.name or Path(texture.file).stem
            texture.file, texture.cubefiles = "", [""] * len(texture.cubefiles)
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = 1
            texture.height = 6 if texture.type else 1  # of a cube, each side
    for skin in list(spec.skins):
        spec.delete(skin)
