"""Writing of mesh files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pcretrieve.atomic import replace_file
from pcretrieve.conversion import MeshLike, as_mesh
from pcretrieve.errors import InputError

__all__ = ["write_mesh"]

SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")


def write_mesh(mesh: MeshLike, path: str | Path) -> None:
    """Write a mesh to a file, in the format of the suffix, in one atomic step.

    Parameters
    ----------
    mesh : MeshLike
        The mesh, of this package or another (see `as_mesh`); its unit is that of the file.
    path : str or Path
        The file, with one of the suffixes ``.ply .obj .off .stl .glb``. An existing file is replaced.

    Raises
    ------
    InputError
        If the suffix is not one of ``.ply .obj .off .stl .glb``, or the file cannot be written.
    """
    import trimesh

    mesh, path = as_mesh(mesh), Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"a mesh file must end in one of {' '.join(SUFFIXES)}, got {path.name}")
    data: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(
        file_type=path.suffix[1:].lower()
    )
    try:
        replace_file(path, data.encode() if isinstance(data, str) else data)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
