"""Linear elements on a point cloud: no surface needed."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array
from scipy.spatial import KDTree

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.spectral.elements import Assembled, assembled, sides_of
from pcretrieve.spectral.linear import LINEAR
from pcretrieve.types import FloatArray, IntArray, PointCloud, TriangleMesh

__all__ = ["points", "stars"]

# Neighbours that the triangles of a point are sought among. Of points strewn at random over a sphere, 20 miss
# triangles worth 3 % of the area, 30 miss 0.4 %, 40 miss 0.1 %.
NEIGHBORS = 40

# Four points of a grid lie on one circle, and their corners must agree on the diagonal. So the triangles are
# sought with every point moved by this share of the distance to its nearest neighbour.
JITTER = 1e-4

# Radians that rounding may turn a side of the hull to the right.
TURN_TOLERANCE = 1e-9


def points(cloud: PointCloud) -> Assembled:
    """Linear elements on the Delaunay triangles that each point forms in its tangent plane [1]_.

    Row i is point i. Points need no normals and no order. Every triangle counts for a third, as each of its
    corners should find it: where they all do, this is the linear element on the Delaunay triangulation. So
    1ᵀM·1 is the area of the surface that was sampled, within 0.5 % for a thousand random points on a sphere;
    on an open surface it lacks a part of the outermost triangles. Noise adds area: of 0.1, 0.3 and 1 % of
    the diagonal on 3000 points, 0.7, 8 and 64 %. Points that are close across a gap are neighbours: limbs
    that touch are one.

    The mass may be lumped or consistent; lumped is as good here. The matrices that the package
    robust_laplacian makes of the same triangles [2]_ depend on where the cloud lies, by the rounding that
    orders the three copies of each triangle round its sides, and their eigenvalues stay 5 % low on random
    points, however many.

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
    mesh = TriangleMesh(cloud.points, stars(cloud.points))
    mesh = TriangleMesh(cloud.points, mesh.faces[~mesh.flat_faces])
    lone = n - len(np.unique(mesh.faces))
    if lone:
        raise DegenerateMeshError(
            f"every point must form a triangle with its neighbours, got {lone} that do not: points on a line "
            "are no surface"
        )
    stiffness, mass, _ = assembled(mesh, mesh.faces, LINEAR, sides_of(mesh))
    return Assembled(csc_array(stiffness / 3), csc_array(mass / 3), np.zeros(n, dtype=bool))


def stars(positions: FloatArray) -> IntArray:
    """(t, 3) the Delaunay triangles at each point, among its nearest neighbours in its tangent plane.

    Inversion in a circle round the point takes circles through it to lines, so its triangles are the sides of
    the convex hull of the inverted neighbours. The hulls of all points are wrapped at once. A point outside
    its hull lies on a boundary, and the two sides that it sees are none of its triangles.

    Raises
    ------
    DegenerateMeshError
        If a point is there more than once.
    """
    n = len(positions)
    found = KDTree(positions).query(positions, NEIGHBORS + 1)
    distance, neighbors = (np.asarray(part)[:, 1:] for part in found)  # (n, k): the first is the point itself
    double = int((distance[:, 0] == 0).sum())
    if double:
        raise DegenerateMeshError(f"points must be distinct, got {double} that are there more than once")
    shaken = positions + JITTER * distance[:, :1] * np.random.default_rng(0).standard_normal((n, 3))
    offset = shaken[neighbors] - shaken[:, None]  # (n, k, 3)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset))  # the normal first
    planar = offset @ axes[:, :, 1:]  # (n, k, 2)
    # A neighbour keeps its direction in the plane and its distance in space.
    direction = np.exp(1j * np.arctan2(planar[..., 1], planar[..., 0]))
    inverted = np.concatenate(
        [direction / np.linalg.norm(offset, axis=2), np.zeros((n, 1))], axis=1
    )  # (n, k + 1): the point itself last

    # Wrapping starts at the nearest neighbour, which is on the hull, along the tangent of its circle.
    centre = np.arange(n)
    first = here = np.abs(inverted).argmax(axis=1)
    heading = 1j * inverted[centre, here]
    triangles = []
    for _ in range(NEIGHBORS + 1):  # a hull has no more sides
        if not len(centre):
            break
        step = inverted[centre] - inverted[centre, here][:, None]  # (open, k + 1)
        turn = np.angle(step / heading[:, None])
        turn[(step == 0) | (turn < -TURN_TOLERANCE)] = np.inf
        there = turn.argmin(axis=1)
        own = (here < NEIGHBORS) & (there < NEIGHBORS)
        ends = neighbors[centre[own], here[own]], neighbors[centre[own], there[own]]
        triangles.append(np.column_stack([centre[own], *ends]))
        still = there != first
        heading = step[np.arange(len(centre)), there][still]
        centre, first, here = centre[still], first[still], there[still]
    return np.concatenate(triangles).astype(np.int32)
