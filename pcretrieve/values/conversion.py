"""Geometry of other packages, and arrays → `PointCloud` and `TriangleMesh`.

Values of other packages are recognised by their attributes, so that this module imports none of the packages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import unit_vectors
from pcretrieve.errors import InputError
from pcretrieve.values.geometry import PointCloud, TriangleMesh


class _HasPoints(Protocol):
    @property
    def points(self) -> Any: ...


class _HasVertices(Protocol):
    @property
    def vertices(self) -> Any: ...


#: What can be converted to a surface or a point cloud: geometry of Open3D, trimesh, PyVista and others, which
#: is recognised by its attributes; an (n, 3) array of points; or a pair (vertices, faces).
GeometryLike: TypeAlias = "_HasPoints | _HasVertices | _Rows | Sequence[_Rows]"
_Rows: TypeAlias = "NDArray[Any] | Sequence[Sequence[float]]"


def as_geometry(geometry: GeometryLike) -> PointCloud | TriangleMesh:
    """A point cloud or a surface: the value itself if it is one, else a checked copy of its arrays."""
    if isinstance(geometry, (PointCloud, TriangleMesh)):
        return geometry
    try:
        return _converted(geometry)
    except TypeError as error:
        raise InputError(
            "a scan must be a path, an (n, 3) array, a pair (vertices, faces), a PointCloud, a TriangleMesh, "
            "geometry of Open3D, trimesh or PyVista, or have vertices and faces or points, got "
            f"{type(geometry).__name__}"
        ) from error


def as_mesh(mesh: GeometryLike) -> TriangleMesh:
    """A surface, in the unit of the value."""
    geometry = as_geometry(mesh)
    if not isinstance(geometry, TriangleMesh):
        raise InputError(
            f"a surface must have faces, got a cloud of {len(geometry.points)} points: make a surface of the "
            "points with pcretrieve.reconstruct first"
        )
    return geometry


def as_cloud(cloud: GeometryLike) -> PointCloud:
    """A point cloud, in the unit of the value: of a surface its vertices."""
    geometry = as_geometry(cloud)
    if isinstance(geometry, TriangleMesh):
        return PointCloud(geometry.vertices, provenance=geometry.provenance)
    return geometry


def _converted(geometry: object) -> PointCloud | TriangleMesh:
    package = type(geometry).__module__.partition(".")[0]
    if package == "open3d":
        return _of_open3d(geometry)
    if package == "pyvista":
        return _of_pyvista(geometry)
    vertices, faces = (
        getattr(geometry, "vertices", None),
        getattr(geometry, "faces", None),
    )
    if vertices is not None:
        return (
            PointCloud(np.asarray(vertices))
            if faces is None
            else TriangleMesh(vertices, faces)
        )
    points = getattr(geometry, "points", None)
    if points is not None and not callable(points):
        normals = getattr(geometry, "normals", None)
        return PointCloud(
            np.asarray(points),
            None
            if normals is None
            else unit_vectors(np.asarray(normals, dtype=np.float64)),
        )
    # Two arrays of rows are the vertices and the faces of a mesh; two rows are points.
    if (
        isinstance(geometry, (tuple, list))
        and len(geometry) == 2
        and np.ndim(geometry[0]) == 2
    ):
        return TriangleMesh(np.asarray(geometry[0]), np.asarray(geometry[1]))
    if isinstance(geometry, (str, bytes, dict)) or not isinstance(
        geometry, (np.ndarray, Sequence)
    ):
        raise TypeError(
            f"neither a point cloud nor a triangle mesh: {type(geometry).__name__}"
        )
    try:
        array = np.asarray(geometry)
    except ValueError as error:  # rows of different lengths
        raise TypeError(f"not an array of points: {error}") from error
    return PointCloud(array)


def _of_open3d(geometry: Any) -> PointCloud | TriangleMesh:
    legacy = geometry.to_legacy() if hasattr(geometry, "to_legacy") else geometry
    if hasattr(legacy, "triangles"):
        return TriangleMesh(np.array(legacy.vertices), np.array(legacy.triangles))
    if not hasattr(legacy, "points") or hasattr(legacy, "lines"):
        raise TypeError(
            f"neither a point cloud nor a triangle mesh: {type(geometry).__name__}"
        )
    return PointCloud(
        np.array(legacy.points),
        unit_vectors(np.asarray(legacy.normals)) if legacy.has_normals() else None,
    )


def _of_pyvista(geometry: Any) -> PointCloud | TriangleMesh:
    if not hasattr(geometry, "faces"):
        raise TypeError(
            f"not a surface: a PyVista {type(geometry).__name__}; take its extract_surface() or its points"
        )
    if not len(geometry.faces):
        return PointCloud(np.array(geometry.points))
    # The number of corners, and these.
    faces = np.array(geometry.triangulate().faces).reshape(-1, 4)
    return TriangleMesh(np.array(geometry.points), faces[:, 1:])
