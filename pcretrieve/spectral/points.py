"""Linear elements on a point cloud: no surface needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.spatial import KDTree

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.spectral.elements import Assembled, assembled, sides_of
from pcretrieve.spectral.linear import LINEAR
from pcretrieve.types import FloatArray, IntArray, PointCloud, TriangleMesh

__all__ = ["points", "star_mesh", "stars"]

# Neighbours that the triangles of a point are sought among, and those that its tangent plane is fitted to
# where the cloud has no normals. Of points strewn at random over a sphere, 20 miss triangles worth 3 % of the
# area, 30 miss 0.4 %, 40 miss 0.1 %; but the more there are, the more lie on the other side of a thin limb.
# 3000 points on each of 180 shapes of SHREC'11, first tier of R-BiHDM: 40 and 40 .591, 40 and 12 .619,
# 30 and 30 .643, 30 and 12 .678; 40 with true normals .717; the meshes themselves .949.
NEIGHBORS = 30
PLANE_NEIGHBORS = 12

# A star needs that many; where fewer neighbours face the side of a point, its normal is not to be trusted.
FEWEST_AGREEING = 3

# Four points of a grid lie on one circle, and their corners must agree on the diagonal. So the triangles are
# sought with every point moved by this share of the distance to its nearest neighbour.
JITTER = 1e-4

# Radians that rounding may turn a side of the hull to the right.
TURN_TOLERANCE = 1e-9


def points(cloud: PointCloud) -> Assembled:
    """Linear elements on the Delaunay triangles that each point forms in its tangent plane [1]_.

    Row i is point i. Where the cloud has normals, they are those of the planes, and neighbours that face the
    other way are none: the two sides of a thin limb stay apart. Points need no order. Every triangle counts
    for a third, as each of its corners should find it: where they all do, this is the linear element on the
    Delaunay triangulation. So 1ᵀM·1 is the area of the surface that was sampled, within 1 % for a thousand
    random points on a sphere; on an open surface it lacks a part of the outermost triangles. Noise adds
    area: of 0.1, 0.3 and 1 % of the diagonal on 3000 points, 1, 9 and 70 %.

    Either mass will do; lumped is somewhat better. The matrices that the package robust_laplacian makes of
    such triangles [2]_ depend on where the cloud lies, by the rounding that orders the three copies of each
    triangle round its sides, and their eigenvalues stay 5 % low on random points, however many.

    Returns
    -------
    Assembled
        S symmetric positive semi-definite, dimensionless, its null space the constants of each component; M
        symmetric positive definite, unit length². S·1 = 0 and 1ᵀM·1 = area as said.

    Raises
    ------
    DegenerateMeshError
        If there are too few points, one is there more than once, or one forms no triangle.

    References
    ----------
    .. [1] U. Clarenz, M. Rumpf and A. Telea, "Finite elements on point based surfaces", Symposium on
       Point-Based Graphics, 2004.
    .. [2] N. Sharp and K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum
       39(5), 2020, section 5.7.
    """
    n = len(cloud.points)
    if n <= NEIGHBORS:
        raise DegenerateMeshError(f"a cloud must have at least {NEIGHBORS + 1} points, got {n}")
    mesh = TriangleMesh(cloud.points, stars(cloud.points, cloud.normals))
    mesh = TriangleMesh(cloud.points, mesh.faces[~mesh.flat_faces])
    lone = n - len(np.unique(mesh.faces))
    if lone:
        raise DegenerateMeshError(
            f"every point must form a triangle with its neighbours, got {lone} that do not: points on a line "
            "are no surface"
        )
    stiffness, mass, _ = assembled(mesh, mesh.faces, LINEAR, sides_of(mesh))
    return Assembled(csc_array(stiffness / 3), csc_array(mass / 3), np.zeros(n, dtype=bool))


def star_mesh(cloud: PointCloud) -> TriangleMesh:
    """The triangles that two of their corners at least agree on: a surface to look at, with small holes.

    Where the cloud has normals, faces are counter-clockwise seen from where they point. The area is that of
    `points` within a few per cent.
    """
    faces = stars(cloud.points, cloud.normals)
    _, first, times = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    faces = faces[first[times > 1]]
    if cloud.normals is not None:
        a, b, c = cloud.points[faces].transpose(1, 0, 2)
        inward = np.einsum("mi,mi->m", np.cross(b - a, c - a), cloud.normals[faces[:, 0]]) < 0
        faces[inward] = faces[inward, ::-1]
    return TriangleMesh(cloud.points, faces, cloud.provenance)


def stars(positions: FloatArray, normals: FloatArray | None = None) -> IntArray:
    """(t, 3) the Delaunay triangles at each point, among its nearest neighbours in its tangent plane.

    Inversion in a circle round the point takes circles through it to lines, so its triangles are the sides of
    the convex hull of the inverted neighbours. The hulls of all points are wrapped at once. A point outside
    its hull lies on a boundary, and the two sides that it sees are none of its triangles.

    Parameters
    ----------
    positions : (n, 3) float64
    normals : (n, 3) float64, optional
        Unit length. Neighbours that face the other way are none.

    Raises
    ------
    DegenerateMeshError
        If a point is there more than once.
    """
    n = len(positions)
    # (n, 1 + k), the first of them the point itself
    distance, neighbors = map(np.asarray, KDTree(positions).query(positions, NEIGHBORS + 1))
    double = int((distance[:, 1] == 0).sum())
    if double:
        raise DegenerateMeshError(f"points must be distinct, got {double} that are there more than once")
    shaken = positions + JITTER * distance[:, 1:2] * np.random.default_rng(0).standard_normal((n, 3))
    offset = shaken[neighbors] - shaken[:, None]  # (n, 1 + k, 3)
    plane, reaches = _tangent_planes(offset, neighbors, normals)
    planar = offset @ plane  # (n, 1 + k, 2)
    # A neighbour keeps its direction in the plane and its distance in space. None at all is at infinity.
    direction = np.exp(1j * np.arctan2(planar[..., 1], planar[..., 0]))
    length = np.where(reaches, np.linalg.norm(offset, axis=2), np.inf)
    inverted = direction / length  # (n, 1 + k): the point itself, on the hull or not, is the origin

    # Wrapping starts at the nearest neighbour, which is on the hull, along the tangent of its circle.
    centre = np.arange(n)
    first = here = np.abs(inverted).argmax(axis=1)
    heading = 1j * inverted[centre, here]
    triangles = []
    for _ in range(NEIGHBORS + 1):  # a hull has no more sides
        if not len(centre):
            break
        step = inverted[centre] - inverted[centre, here][:, None]  # (open, 1 + k)
        turn = np.angle(step / heading[:, None])
        turn[(step == 0) | (turn < -TURN_TOLERANCE)] = np.inf
        there = turn.argmin(axis=1)
        own = (here > 0) & (there > 0)
        ends = neighbors[centre[own], here[own]], neighbors[centre[own], there[own]]
        triangles.append(np.column_stack([centre[own], *ends]))
        still = there != first
        heading = step[np.arange(len(centre)), there][still]
        centre, first, here = centre[still], first[still], there[still]
    return np.concatenate(triangles).astype(np.int32)


def _tangent_planes(
    offset: FloatArray, neighbors: NDArray[np.intp], normals: FloatArray | None
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(n, 3, 2) axes of the tangent plane of each point, and (n, 1 + k) which are neighbours on its side."""
    reaches = np.ones(neighbors.shape, dtype=bool)
    reaches[:, 0] = False
    if normals is None:
        near = offset[:, : 1 + PLANE_NEIGHBORS]
        spread = np.einsum("nki,nkj->nij", near, near)
    else:
        agree = np.einsum("nki,ni->nk", normals[neighbors[:, 1:]], normals) > 0  # (n, k)
        reaches[:, 1:] = agree | (agree.sum(axis=1, keepdims=True) < FEWEST_AGREEING)
        spread = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    return np.linalg.eigh(spread).eigenvectors[:, :, 1:], reaches  # the normal has the least
