"""Values of trimesh, from arrays, and the mesh files that it reads and writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.types import TriangleMesh

__all__ = ["mesh_arrays", "mesh_bytes", "trimesh_cloud", "trimesh_mesh"]


def trimesh_cloud(points: FloatArray) -> Any:
    """A point cloud of trimesh.

    Parameters
    ----------
    points : (n, 3) float64
        In any unit.

    Returns
    -------
    trimesh.PointCloud
        With a copy of the points.
    """
    import trimesh

    return trimesh.PointCloud(points.copy())  # type: ignore[no-untyped-call]


def trimesh_mesh(vertices: FloatArray, faces: IntArray) -> Any:
    """A mesh of trimesh, unprocessed: no vertex is merged or reordered.

    Parameters
    ----------
    vertices : (n, 3) float64
        In any unit.
    faces : (m, 3) int32
        Vertex numbers.

    Returns
    -------
    trimesh.Trimesh
        With copies of the arrays.
    """
    import trimesh

    return trimesh.Trimesh(vertices.copy(), faces.copy(), process=False)


def mesh_arrays(path: Path, file_type: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a mesh file; polygons are triangulated.

    Parameters
    ----------
    path : Path
        The file.
    file_type : str
        The format, as trimesh names it: a suffix without its dot.

    Returns
    -------
    vertices : (n, 3) float64
        Coordinates; unit of the file.
    faces : (m, 3) int64
        Vertex numbers of the triangles.

    Raises
    ------
    OSError
        If the file cannot be read.
    MemoryError
        If the file is too large for the memory.
    ValueError
        If the file is damaged.
    """
    import trimesh

    try:
        mesh: Any = trimesh.load(path, file_type=file_type, process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        return vertices, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except (OSError, MemoryError):
        raise
    # trimesh has no exception class of its own: damaged files raise exceptions of any class.
    except Exception as error:
        raise ValueError(str(error) or type(error).__name__) from error


def mesh_bytes(mesh: TriangleMesh, file_type: str) -> bytes:
    """The content of a mesh file.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh; its unit is that of the file.
    file_type : str
        The format, as trimesh names it: a suffix without its dot.

    Returns
    -------
    bytes
        The content.
    """
    data = trimesh_mesh(mesh.vertices, mesh.faces).export(file_type=file_type)
    return data.encode() if isinstance(data, str) else bytes(data)
