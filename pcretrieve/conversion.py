"""Values of other packages → pcretrieve's own: whatever stands for a point cloud or a surface is taken."""

from __future__ import annotations

from typing import Protocol, TypeAlias, runtime_checkable

from numpy.typing import ArrayLike

from pcretrieve.adapters.geometry import geometry_arrays
from pcretrieve.errors import InputError
from pcretrieve.types import PointCloud, TriangleMesh

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
    """A surface of another package: trimesh, PyVista, libigl's and others'."""

    @property
    def vertices(self) -> ArrayLike:
        """(n, 3) coordinates."""

    @property
    def faces(self) -> ArrayLike:
        """(m, 3) vertex numbers."""


@runtime_checkable
class HasPoints(Protocol):
    """A point cloud, or a surface with points for vertices, of another package such as Open3D or PyVista."""

    @property
    def points(self) -> ArrayLike:
        """(n, 3) coordinates."""


#: What stands for a surface.
MeshLike: TypeAlias = "TriangleMesh | HasFaces | tuple[ArrayLike, ArrayLike]"
#: What stands for a point cloud.
CloudLike: TypeAlias = "PointCloud | HasPoints | ArrayLike"
#: What stands for either. Open3D's geometry is among them, though it has no types to name.
GeometryLike: TypeAlias = "MeshLike | CloudLike | object"


def as_geometry(geometry: GeometryLike) -> PointCloud | TriangleMesh:
    """The point cloud or the surface that a value stands for.

    Parameters
    ----------
    geometry : PointCloud, TriangleMesh or GeometryLike
        An (n, 3) array of points; a pair (vertices, faces) of arrays; an Open3D point cloud or triangle mesh,
        legacy or tensor; a trimesh or PyVista object; any value with ``vertices`` and ``faces``, or with
        ``points``.

    Returns
    -------
    PointCloud or TriangleMesh
        The value itself where it is one of them; else a checked copy of its arrays, in its own unit.

    Raises
    ------
    InputError
        If it stands for neither, or its arrays have the wrong shape or are not finite.
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
    """The surface that a value stands for.

    Parameters
    ----------
    mesh : GeometryLike
        As in `as_geometry`.

    Returns
    -------
    TriangleMesh
        In the unit of the value.

    Raises
    ------
    InputError
        If the value is no surface.
    """
    geometry = as_geometry(mesh)
    if not isinstance(geometry, TriangleMesh):
        raise InputError(
            f"a surface must have faces, got a cloud of {len(geometry.points)} points: make a surface of the "
            "points with pcretrieve.reconstruct first"
        )
    return geometry


def as_cloud(cloud: GeometryLike) -> PointCloud:
    """The point cloud that a value stands for; of a surface, its vertices.

    Parameters
    ----------
    cloud : GeometryLike
        As in `as_geometry`.

    Returns
    -------
    PointCloud
        In the unit of the value.
    """
    geometry = as_geometry(cloud)
    if isinstance(geometry, TriangleMesh):
        return PointCloud(geometry.vertices, provenance=geometry.provenance)
    return geometry
