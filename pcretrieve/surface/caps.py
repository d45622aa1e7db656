"""Large holes of a scan → caps of a coarse surface, of which some are the base on which the body stood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from pcretrieve.points.grid import Mask, joined_by
from pcretrieve.surface.fairing import faces_at, faired
from pcretrieve.surface.field import normals_of
from pcretrieve.surface.topology import edges_of
from pcretrieve.values import FloatArray, IntArray, PointCloud, TriangleMesh

# Distance to the nearest point beyond which a vertex is in a hole: relative to the diagonal, and in spacings
# of the points, whichever is larger. A vertex of a large hole exceeds the last distance, relative to the
# diagonal. See docs/decisions.md, LARGE_HOLE.
IN_HOLE = 0.012
IN_SPACINGS = 2.0
LARGE_HOLE = 0.018

# Number of a face that is on no cap.
NO_CAP = -1

# The part of a body round a hole, by which the end of a limb is known: from one radius of the hole below its
# rim to a little above it, and not far beside it; in radii.
BESIDE_RIM = 1.3
ABOVE_RIM = 0.3

# A limb ends in a hole if the cosine between normals and the axis of the hole is less than this, in the mean,
# at the rim, and grows by less than this over one radius. Cut feet and heads have at most .06 and .07; holes
# of crowns, down to the widest place of the head, .04 and .36.
LEAST_TILT = 0.25
LEAST_STEEPNESS = 0.25

# A cap is flat if the norm of the sum of its area vectors, relative to its area, is at least this large. Two
# caps are parallel if the cosine of the angle between their normals is.
FLAT = 0.7
PARALLEL = 0.9

# A cap supports the body if at most a fraction of the points is beneath its plane, by more than a distance
# relative to the diagonal: on a seat, .18 are, those of the lower legs. Points above the plane by at most
# this distance touch it too.
MOST_BENEATH = 0.3
NEAR_PLANE = 0.02


class Capped(NamedTuple):
    """A surface that is closed in the holes of the points.

    cap: (m,) the number of the hole that a face closes, −1 if there are points.
    is_end: (m,) bool, whether it closes the end of a limb that was cut off, or a base.
    """

    surface: TriangleMesh
    cap: NDArray[np.intp]
    is_end: Mask


def capped(surface: TriangleMesh, cloud: PointCloud, *, spacing: float) -> Capped:
    """Close the large holes of the points, round, or flat on the ground.

    A level set recedes in a hole, and a Poisson surface bulges out of a large one. Each hole gets a fair
    patch instead. What stands on a ground that the stage `crop` has removed is flat there, so that it gets a
    membrane: each vertex is at the mean of its neighbours. The rim is moved to the points.

    spacing: of the points.
    """
    from scipy.spatial import cKDTree

    # A surface may bulge far from the points, where a search by cells takes long.
    tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
    distance, near = map(np.asarray, tree.query(surface.vertices))  # (n,), (n,)
    if distance.max() <= LARGE_HOLE * cloud.diagonal:
        n_faces = len(surface.faces)
        return Capped(surface, np.full(n_faces, NO_CAP), np.zeros(n_faces, dtype=np.bool_))
    far = distance > max(IN_HOLE * cloud.diagonal, IN_SPACINGS * spacing)  # (n,)
    n = len(far)
    ends = edges_of(faces_at(far, surface.faces)).ends  # (e, 2)
    inner = ends[far[ends].all(axis=1)]
    hole = joined_by(inner[:, 0], inner[:, 1], n)
    farthest = np.zeros(n)
    np.maximum.at(farthest, hole[far], distance[far])
    free = far & (farthest[hole] > LARGE_HOLE * cloud.diagonal)  # (n,)
    rims = ends[free[ends].sum(axis=1) == 1]  # (r, 2), edges between a hole and its rim
    # A component that is far from all points has no rim.
    free &= np.isin(hole, hole[rims[free[rims]]])
    cap = np.where(free[surface.faces], hole[surface.faces], NO_CAP).max(axis=1)
    is_end = np.zeros(len(cap), dtype=np.bool_)
    if not free.any():
        return Capped(surface, cap, is_end)
    vertices = surface.vertices.copy()
    rim = np.setdiff1d(surface.faces[cap != NO_CAP], np.flatnonzero(free))
    vertices[rim] = cloud.points[near[rim]]
    for number in np.unique(hole[free]):
        own, here = free & (hole == number), cap == number
        flat = _membrane(vertices, surface.faces, own)
        axis = TriangleMesh(flat, surface.faces[here]).area_vectors.sum(axis=0)
        axis /= np.linalg.norm(axis)
        own_rim = vertices[np.setdiff1d(surface.faces[here], np.flatnonzero(own))]
        if faces_ground(axis, cloud):
            vertices = flat
            is_end |= here
        else:
            vertices = faired(vertices, surface.faces, own)
            if ends_a_part(own_rim, axis, cloud.points, normals_of(cloud)):
                is_end |= here
    return Capped(TriangleMesh(vertices, surface.faces), cap, is_end)


def faces_ground(axis: FloatArray, cloud: PointCloud) -> bool:
    """Whether a hole, with the unit normal of the flat patch that closes it, faces a ground that is known."""
    return cloud.up is not None and bool(axis @ cloud.up < -PARALLEL)


def _membrane(vertices: FloatArray, faces: IntArray, free: Mask) -> FloatArray:
    """(n, 3) vertices, of which those in a mask are at the mean of their neighbours."""
    n, ends = len(vertices), edges_of(faces_at(free, faces)).ends
    joined = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    joined = joined + joined.T
    laplacian = (diags_array(joined.sum(axis=1)) - joined).tocsr()[free]  # (k, n)
    moved: FloatArray = vertices.copy()
    moved[free] = splu(laplacian[:, free].tocsc()).solve(-(laplacian[:, ~free] @ vertices[~free]))
    return moved


def ends_a_part(rim: FloatArray, axis: FloatArray, points: FloatArray, normals: FloatArray) -> bool:
    """Whether a hole is the end of a limb that was cut off, or a base: the body round it is like a tube.

    In a hole of a face or a chest the normals at the rim are tilted towards the axis of the hole. Round the
    hole of a crown they are perpendicular to it, but tilt more and more towards the rim, as on a sphere.
    Round a tube they do neither.

    rim: (r, 3) float64, the vertices of the rim.
    axis: (3,) float64, the unit normal of the flat patch that closes the hole.
    points, normals: (n, 3) float64, of the surface.
    """
    middle = rim.mean(axis=0)
    radius = float(np.linalg.norm(rim - middle, axis=1).mean())
    offsets = points - middle
    along = offsets @ axis / radius
    beside = (offsets**2).sum(axis=1) / radius**2 - along**2
    near = (along < ABOVE_RIM) & (along > -1) & (beside < BESIDE_RIM**2)
    if near.sum() < 3:
        return False
    tilt = normals[near] @ axis
    at_rim = along[near] > -ABOVE_RIM
    # The slope of the regression line; np.polyfit warns where all points have one height.
    centred = along[near] - along[near].mean()
    steepness = centred @ tilt / max(centred @ centred, np.finfo(np.float64).tiny)
    return bool(tilt[at_rim].mean() < LEAST_TILT and steepness < LEAST_STEEPNESS)


def base_of(capped: Capped, cloud: PointCloud) -> Mask:
    """(m,) mask of the faces of a base: caps of ends of the body that face down, and are nearly flat.

    Down is away from the ground, if the stage `crop` has removed it. Otherwise it is the normal of the
    largest cap on which the body can stand: few points are beneath its plane, and the mean of the points is
    above the convex hull of the caps that are parallel to it and of the points that touch its plane.

    The caps of a seat and of hands that rest on something belong to it, if they face down. It has no faces if
    the body cannot stand.
    """
    surface, cap, is_end = capped
    numbers = np.unique(cap[is_end])
    sums = np.array(
        [surface.area_vectors[cap == number].sum(axis=0) for number in numbers]
    ).reshape(-1, 3)
    areas = np.array([surface.face_areas[cap == number].sum() for number in numbers])
    size = np.linalg.norm(sums, axis=1)
    flat = size >= FLAT * areas  # (c,)
    normals = sums / np.where(size > 0, size, 1)[:, None]
    up = cloud.up
    downs = [-up] if up is not None else normals[flat][np.argsort(-areas[flat])]
    for down in downs:
        facing = numbers[flat & (normals @ down >= PARALLEL)]
        faces = np.asarray(np.isin(cap, facing))
        own = surface.vertices[surface.faces[faces]].reshape(-1, 3)
        if len(own) and (up is not None or _stands(own, down, cloud)):
            return faces
    return np.zeros(len(cap), dtype=np.bool_)


def _stands(base: FloatArray, down: FloatArray, cloud: PointCloud) -> bool:
    """Whether a body can stand on the points of its base, whose outward normal is `down`."""
    from scipy.spatial import ConvexHull, QhullError

    height = -cloud.points @ down  # (n,)
    ground = (-base @ down).min()
    touching = height <= ground + NEAR_PLANE * cloud.diagonal
    if (height < ground - NEAR_PLANE * cloud.diagonal).mean() > MOST_BENEATH:
        return False
    axes = np.linalg.svd(down[None])[2][1:]  # (2, 3), perpendicular to `down`
    try:
        outline = ConvexHull(np.concatenate([base, cloud.points[touching]]) @ axes.T).equations
    except QhullError:  # fewer than three points, or all on a line
        return False
    return bool((outline[:, :2] @ (axes @ cloud.points.mean(axis=0)) + outline[:, 2] <= 0).all())


def points_on(surface: TriangleMesh, faces: Mask, spacing: float) -> FloatArray:
    """(p, 3) points on some faces of a surface, on a regular grid of each face, at most a spacing apart."""
    corners = surface.vertices[surface.faces[faces]]  # (f, 3, 3)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(initial=0.0)
    n = int(np.ceil(longest / spacing)) + 1
    return grid_points(corners, n)


def grid_points(corners: FloatArray, n: int) -> FloatArray:
    """(k, 3) points of regular grids on triangles, whose corners are (f, 3, 3), n steps along each side."""
    i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
    shares = np.column_stack([i, j, n - i - j]) / n  # (g, 3): barycentric coordinates
    return np.asarray(np.einsum("gk,fkd->fgd", shares, corners).reshape(-1, 3))
