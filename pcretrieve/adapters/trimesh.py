"""Values of trimesh, from arrays."""

from __future__ import annotations

from typing import Any

from pcretrieve.arrays import FloatArray, IntArray

__all__ = ["trimesh_cloud", "trimesh_mesh"]


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
