"""Point clouds and surfaces of other packages, and arrays → `PointCloud` and `TriangleMesh`."""

from __future__ import annotations

from typing import Protocol, TypeAlias, runtime_checkable

from numpy.typing import ArrayLike

from pcretrieve.adapters.geometry import geometry_arrays
from pcretrieve.errors import InputError
from pcretrieve.values import PointCloud, TriangleMesh

__all__ = [
    "CloudLike",
    "GeometryLike",
    "HasFaces",
    "HasPoints",
    "MeshLike",
    "as_cloud",
    "as_geometry",
    "as_mesh",
]


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
