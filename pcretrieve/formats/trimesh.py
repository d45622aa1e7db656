"""The mesh files that trimesh reads and writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import TriangleMesh

__all__ = ["Body", "mesh_arrays", "mesh_bytes", "scene_bodies"]


def mesh_arrays(path: Path, file_type: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a mesh file; polygons are triangulated.

    Returns vertices : (n, 3) float64: coordinates; unit of the file.
    Returns faces : (m, 3) int64: vertex numbers of the triangles.
    """
    import trimesh

    try:
        # An open file, because trimesh takes names in UTF-8 only.
        with path.open("rb") as file:
            mesh: Any = trimesh.load(file, file_type=file_type, process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        return vertices, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except (OSError, MemoryError):
        raise
    # trimesh has no exception class of its own: damaged files raise exceptions of any class.
    except Exception as error:
        raise ValueError(str(error) or type(error).__name__) from error


class Body(NamedTuple):
    """A mesh of a scene.

    vertices: (n, 3) float64, coordinates in the frame of the scene; unit of the file.
    faces: (m, 3) int64, vertex numbers of the triangles.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def scene_bodies(path: Path, file_type: str) -> tuple[list[Body], str | None]:
    """Read a file of several meshes, which the nodes of a scene place.

    Returns unit : str or None: the unit of the file, as trimesh names it.
    """
    import trimesh

    try:
        with path.open("rb") as file:
            scene: Any = trimesh.load_scene(file, file_type=file_type, process=False)
        bodies, unit = [], None
        for node in scene.graph.nodes_geometry:
            motion, name = scene.graph[node]
            mesh = scene.geometry[name]
            if not len(getattr(mesh, "faces", ())):
                continue
            vertices = trimesh.transform_points(np.asarray(mesh.vertices, dtype=np.float64), motion)
            faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
            # A reflection reverses the orientation of triangles.
            mirrored = np.linalg.det(motion[:3, :3]) < 0
            bodies.append(Body(str(node), vertices.reshape(-1, 3), faces[:, ::-1] if mirrored else faces))
            unit = mesh.metadata.get("units")
        return bodies, unit
    except (OSError, MemoryError):
        raise
    # trimesh has no exception class of its own: damaged files raise exceptions of any class.
    except Exception as error:
        raise ValueError(str(error) or type(error).__name__) from error


def mesh_bytes(mesh: TriangleMesh, file_type: str) -> bytes:
    """The content of a mesh file.

    mesh: the mesh; its unit is that of the file.
    """
    data = mesh.to_trimesh().export(file_type=file_type)
    return data.encode() if isinstance(data, str) else bytes(data)
