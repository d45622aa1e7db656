"""Linear elements on a point cloud, without a reconstructed surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.spectral.elements import LINEAR_REFERENCE, Assembled, Element, assembled
from pcretrieve.values import FloatArray, IntArray, PointCloud, TriangleMesh, area_vectors

# Number of neighbours among which the triangles of a point are searched, and to which its tangent plane is
# fitted if the cloud has no normals. With fewer neighbours triangles are missed, with more the neighbourhood
# includes points of the opposite side of a thin limb.
NEIGHBORS = 30
PLANE_NEIGHBORS = 12

# Smallest number of neighbours with a normal on the side of that of the point. With fewer of them the normal
# of the point is likely to be wrong, and all neighbours are used.
FEWEST_AGREEING = 3

# Amplitude of a random displacement of every point, relative to the distance to its nearest neighbour.
# Without it the Delaunay triangulation of cocircular points, such as a grid, is not unique, and its points
# may choose different diagonals.
JITTER = 1e-4

# Tolerance for rounding of the turning angle between sides of a convex hull; radians.
TURN_TOLERANCE = 1e-9


def points(cloud: PointCloud) -> Assembled:
    """The matrices of linear elements on Delaunay triangles in the tangent plane of each point [1]_.

    If the cloud has normals, they are the normals of the tangent planes, and neighbours with opposite normals
    are not used, so that the two sides of a thin limb are not connected. The matrices of each triangle are
    divided by three, because each of its corners should generate it; if all three do, the result is that of
    linear elements on the Delaunay triangulation. 1ᵀM·1 approximates the area of the sampled surface; it is
    too small at the boundary of an open surface, and too large for noisy points.

    The matrices that robust_laplacian makes of such triangles [2]_ are not used: they depend on the position
    of the cloud, through the rounding by which the copies of a triangle are ordered around its sides, and
    their eigenvalues are too small on random points.

    References
    ----------
    .. [1] U. Clarenz, M. Rumpf and A. Telea, "Finite elements on point based surfaces", Symposium on
       Point-Based Graphics, 2004.
    .. [2] N. Sharp and K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum
       39(5), 2020, section 5.7.
    """
    n = len(cloud.points)
    if n <= NEIGHBORS:
        raise DegenerateMeshError(
            f"a cloud must have at least {NEIGHBORS + 1} points, got {n}"
        )
    mesh = TriangleMesh(cloud.points, stars(cloud.points, cloud.normals))
    mesh = TriangleMesh(cloud.points, mesh.faces[~mesh.flat_faces])
    lone = n - len(np.unique(mesh.faces))
    if lone:
        raise DegenerateMeshError(
            f"every point must form a triangle with its neighbours, got {lone} that do not: points on a line "
            "are no surface"
        )
    stiffness, mass, _ = assembled(mesh, mesh.faces, LINEAR_REFERENCE)
    return Assembled(
        csc_array(stiffness / 3), csc_array(mass / 3), np.zeros(n, dtype=bool)
    )


# Lumped mass is more accurate.
POINTS = Element("points", points, needs="points", masses=("lumped", "consistent"))


def star_mesh(cloud: PointCloud) -> TriangleMesh:
    """A mesh, with small holes, of the Delaunay triangles that at least two corners generate, for display.

    If the cloud has normals, the faces are oriented by them.
    """
    faces = stars(cloud.points, cloud.normals)
    _, first, times = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    faces = faces[first[times > 1]]
    if cloud.normals is not None:
        vectors = area_vectors(cloud.points, faces)
        inward = np.einsum("mi,mi->m", vectors, cloud.normals[faces[:, 0]]) < 0
        faces[inward] = faces[inward, ::-1]
    return TriangleMesh(cloud.points, faces, cloud.provenance)


def stars(positions: FloatArray, normals: FloatArray | None = None) -> IntArray:
    """The star of each point: its Delaunay triangles with its nearest neighbours, in its tangent plane.

    An inversion in a circle around the point maps circles through the point to lines. The Delaunay triangles
    at the point are therefore given by the sides of the convex hull of the inverted neighbours, which is
    computed by gift wrapping for all points at once. If the point itself is a vertex of this hull, it is on a
    boundary, and the two sides at it give no triangles.

    Returns (t, 3) int32: numbers of the points of each triangle, the first of which has it in its star.
    """
    from scipy.spatial import KDTree

    # (n, 1 + k); the first column is the point itself
    distance, neighbors = map(
        np.asarray, KDTree(positions).query(positions, NEIGHBORS + 1)
    )
    double = int((distance[:, 1] == 0).sum())
    if double:
        raise DegenerateMeshError(
            f"points must be distinct, got {double} that are there more than once"
        )
    shifts = np.random.default_rng(0).standard_normal(positions.shape)
    shaken = positions + JITTER * distance[:, 1:2] * shifts
    offset = shaken[neighbors] - shaken[:, None]  # (n, 1 + k, 3)
    plane, reaches = _tangent_planes(offset, neighbors, normals)
    planar = offset @ plane  # (n, 1 + k, 2)
    # The projection keeps the distance in space. Neighbours that are not used are at infinity.
    direction = np.exp(1j * np.arctan2(planar[..., 1], planar[..., 0]))
    length = np.where(reaches, np.linalg.norm(offset, axis=2), np.inf)
    # The point itself, and neighbours that are not used, are at the origin.
    return _wrapped(direction / length, neighbors)


def _wrapped(inverted: NDArray[np.complex128], neighbors: NDArray[np.intp]) -> IntArray:
    """The triangles of each point and two neighbours that are the ends of a side of the hull of `inverted`.

    inverted: (n, 1 + k) complex, the inverted neighbours of each point in its plane.
    """
    # Gift wrapping starts at the nearest neighbour, the inverted point of largest magnitude, which is on the
    # hull, in the direction perpendicular to it.
    centre = np.arange(len(inverted))
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
    """The (n, 3, 2) axes of the tangent planes, and a (n, 1 + k) mask of the neighbours that are used."""
    reaches = np.ones(neighbors.shape, dtype=bool)
    reaches[:, 0] = False
    if normals is None:
        near = offset[:, : 1 + PLANE_NEIGHBORS]
        spread = np.einsum("nki,nkj->nij", near, near)
    else:
        agree = np.einsum("nki,ni->nk", normals[neighbors[:, 1:]], normals) > 0  # (n, k)
        reaches[:, 1:] = agree | (agree.sum(axis=1, keepdims=True) < FEWEST_AGREEING)
        spread = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    # The eigenvector of the smallest eigenvalue is the normal, and the other two span the plane.
    return np.linalg.eigh(spread).eigenvectors[:, :, 1:], reaches
