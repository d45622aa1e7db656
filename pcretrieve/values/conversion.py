"""Geometry of other packages, and arrays → `PointCloud` and `TriangleMesh`.

Values of other packages are recognised by their attributes, so that this module imports none of the packages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError
from pcretrieve.values.geometry import PointCloud, TriangleMesh

# Corners of a triangle. PyVista writes this number before the vertices of each face.
N_CORNERS = 3


@runtime_checkable
class HasFaces(Protocol):
    """A surface of another package, such as trimesh, PyVista or libigl."""

    @property
    def vertices(self) -> ArrayLike:
        """(n, 3) coordinates."""

    @property
    def faces(self) -> ArrayLike:
        """(m, 3) vertex numbers."""


@runtime_checkable
class HasPoints(Protocol):
    """A point cloud, or a surface with its vertices as points, of a package such as Open3D or PyVista."""

    @property
    def points(self) -> ArrayLike:
        """(n, 3) coordinates."""


#: What can be converted to a surface.
MeshLike: TypeAlias = "TriangleMesh | HasFaces | tuple[ArrayLike, ArrayLike]"
#: What can be converted to a point cloud.
CloudLike: TypeAlias = "PointCloud | HasPoints | ArrayLike"
#: What can be converted to either, including geometry of Open3D, which has no static types.
GeometryLike: TypeAlias = "MeshLike | CloudLike | object"


def as_geometry(geometry: GeometryLike) -> PointCloud | TriangleMesh:
    """Convert a value to a point cloud or a surface.

    Returns PointCloud or TriangleMesh: the value itself if it has one of these types, else a checked copy of
        its arrays; unit of the value.
    """
    if isinstance(geometry, (PointCloud, TriangleMesh)):
        return geometry
    try:
        points, faces, normals = geometry_arrays(geometry)
    except TypeError as error:
        raise InputError(
            "a scan must be a path, an (n, 3) array, a pair (vertices, faces), a PointCloud, a TriangleMesh, "
            "geometry of Open3D, trimesh or PyVista, or have vertices and faces or points, got "
            f"{type(geometry).__name__}"
        ) from error
    return PointCloud(points, normals) if faces is None else TriangleMesh(points, faces)


def as_mesh(mesh: GeometryLike) -> TriangleMesh:
    """Convert a value to a surface.

    Returns TriangleMesh: the surface; unit of the value.
    """
    geometry = as_geometry(mesh)
    if not isinstance(geometry, TriangleMesh):
        raise InputError(
            f"a surface must have faces, got a cloud of {len(geometry.points)} points: make a surface of the "
            "points with pcretrieve.reconstruct first"
        )
    return geometry


def as_cloud(cloud: GeometryLike) -> PointCloud:
    """Convert a value to a point cloud: a surface to its vertices.

    Returns PointCloud: the point cloud; unit of the value.
    """
    geometry = as_geometry(cloud)
    if isinstance(geometry, TriangleMesh):
        return PointCloud(geometry.vertices, provenance=geometry.provenance)
    return geometry


class GeometryArrays(NamedTuple):
    """A point cloud or a triangle mesh as arrays, unchecked.

    points: (n, 3) array, points of a cloud, vertices of a mesh; in the unit of the geometry.
    faces: (m, 3) array or None, vertex numbers; None for a point cloud.
    normals: (n, 3) array or None, unit normals of a point cloud, if it has normals.
    """

    points: NDArray[Any]
    faces: NDArray[Any] | None = None
    normals: NDArray[Any] | None = None


def geometry_arrays(geometry: object) -> GeometryArrays:
    """The arrays of a point cloud or a triangle mesh of any package."""
    package = type(geometry).__module__.partition(".")[0]
    if package == "open3d":
        return _of_open3d(geometry)
    if package == "pyvista":
        return _of_pyvista(geometry)
    vertices, faces = getattr(geometry, "vertices", None), getattr(geometry, "faces", None)
    if vertices is not None:
        return GeometryArrays(np.asarray(vertices), None if faces is None else np.asarray(faces))
    points = getattr(geometry, "points", None)
    if points is not None and not callable(points):
        normals = getattr(geometry, "normals", None)
        return GeometryArrays(np.asarray(points), normals=_unit(normals) if normals is not None else None)
    # Two arrays of rows are the vertices and the faces of a mesh; two rows are points.
    if isinstance(geometry, (tuple, list)) and len(geometry) == 2 and np.ndim(geometry[0]) == 2:
        return GeometryArrays(np.asarray(geometry[0]), np.asarray(geometry[1]))
    if isinstance(geometry, (str, bytes, dict)) or not isinstance(geometry, (np.ndarray, Sequence)):
        raise TypeError(f"neither a point cloud nor a triangle mesh: {type(geometry).__name__}")
    try:
        return GeometryArrays(np.asarray(geometry))
    except ValueError as error:  # rows of different lengths
        raise TypeError(f"not an array of points: {error}") from error


def _of_open3d(geometry: Any) -> GeometryArrays:
    legacy = geometry.to_legacy() if hasattr(geometry, "to_legacy") else geometry
    if hasattr(legacy, "triangles"):
        return GeometryArrays(np.array(legacy.vertices), np.array(legacy.triangles))
    if not hasattr(legacy, "points") or hasattr(legacy, "lines"):
        raise TypeError(f"neither a point cloud nor a triangle mesh: {type(geometry).__name__}")
    return GeometryArrays(
        np.array(legacy.points), normals=_unit(legacy.normals) if legacy.has_normals() else None
    )


def _of_pyvista(geometry: Any) -> GeometryArrays:
    if not hasattr(geometry, "faces"):
        raise TypeError(
            f"not a surface: a PyVista {type(geometry).__name__}; take its extract_surface() or its points"
        )
    if not len(geometry.faces):
        return GeometryArrays(np.array(geometry.points))
    faces = np.array(geometry.triangulate().faces).reshape(-1, 1 + N_CORNERS)
    return GeometryArrays(np.array(geometry.points), faces[:, 1:])


def _unit(normals: Any) -> NDArray[np.float64]:
    """Normals divided by their length; normals of length zero are not changed."""
    vectors = np.array(normals, dtype=np.float64)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))
