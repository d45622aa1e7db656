"""Large holes of a scan → caps of a coarse surface, of which some are the base on which the body stood."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import grid_points, joined_by, unit_vectors
from pcretrieve.points.neighbors import nearest, neighborhoods
from pcretrieve.surface.fairing import domed, faces_at, faired, membrane, with_ring
from pcretrieve.surface.field import normals_of
from pcretrieve.values import FloatArray, Mask, PointCloud, TriangleMesh
from pcretrieve.values.topology import edges_of

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
BELOW_RIM = 1.0
BESIDE_RIM = 1.3
ABOVE_RIM = 0.3

# A limb ends in a hole if the cosine between normals and the axis of the hole is less than this, in the mean,
# at the rim, and grows by less than this over one radius. Cut feet and heads have at most .06 and .07; holes
# of crowns, down to the widest place of the head, .04 and .36.
LEAST_TILT = 0.25
LEAST_STEEPNESS = 0.25

# A hole is deep if the normals at its rim have less than this tilt. It becomes a part of a sphere, which
# covers at most this angle; fairing closes others.
DEEP = 0.2
DEEPEST = np.radians(110)

# Largest area of a hole that becomes a part of a sphere, relative to the square of the diagonal: that of a
# head. A single hole that is smaller is no base: a body stands on two soles.
LARGEST_DOME = 0.02

# Largest area of a fair patch in a larger hole, relative to the flat one: 2 is half of a sphere. Under people
# who sit it is 1.6 at most, or 2.1 and more where the rim flares, and the patch swells to half of a ball.
MOST_SWOLLEN = 1.8

# A cap is flat if the norm of the sum of its area vectors, relative to its area, is at least this large. Two
# caps are parallel if the cosine of the angle between their normals is.
FLAT = 0.7
PARALLEL = 0.9

# A cap supports the body if at most a fraction of the points is beneath its plane, by more than a distance
# relative to the diagonal: on a seat, .18 are, those of the lower legs. Points above the plane by at most
# this distance touch it too.
MOST_BENEATH = 0.3
NEAR_PLANE = 0.02


# A point is at a rim if the middle of so many neighbours is beside it, by this part of the distance of the
# farthest of them. So many such points, this close to each other (in spacings), are a rim.
AROUND = 33
ASIDE = 0.3
FEWEST_OF_RIM = 12
ALONG_RIM = 3.0

# Number of nearest neighbours that are of one piece, if they are that close.
OF_PIECE = 8

# A rim is that of a limb if the directions beside its points have at least this mean, which is 0 beside a
# hole in a flat surface, and if the second eigenvalue of its normals is at least this large.
ONE_WAY = 0.5
ALL_ROUND = 0.2

# Smallest radius of a limb, relative to the diagonal: round fingers there are too few points.
THINNEST = 0.012

# Two ends are of one limb if they face each other, by these cosines, if their radii differ at most by a
# factor, and if they are not farther apart than so many radii.
FACING = 0.75
ALIKE = 2.0
FARTHEST_GAP = 8.0

# Distance from a rim, in radii of the limb, within which normals are made to point away from its axis.
BESIDE_END = 0.5

# The same of deep holes, above the rim of the coarse surface, which recedes where normals point inwards; and
# the least cosine between these and the direction to the axis.
RECEDED = 2.0
INWARDS = 0.3

# Largest share of the normals round a deep hole that face away from it, by this cosine, if any are turned: at
# crowns it is .07, in holes of faces and shins .3 or more, because these are as deep as the part.
AWAY = 0.7
MOST_AWAY = 0.2


# Area, relative to the squared diagonal, below which a hole is none: its whole rim is nearest to one point.
NO_AREA = 1e-12


class Capped(NamedTuple):
    """A surface that is closed in the holes of the points.

    cap: (m,) the number of the hole that a face closes, −1 if there are points.
    base: (m,) bool, whether the body stands on a face: see `base_of`.
    """

    surface: TriangleMesh
    cap: NDArray[np.intp]
    base: Mask


def capped(surface: TriangleMesh, cloud: PointCloud, *, spacing: float) -> Capped:
    """Close the large holes of the points: flat where the body stands, elsewhere round.

    A level set recedes in a hole, and a Poisson surface bulges out of a large one. The rim of each hole is
    moved to the points. A base gets a membrane: each vertex is at the mean of its neighbours. A deep hole,
    such as that of half a head, gets a part of a sphere, and another one a fair patch.

    spacing: of the points.
    """
    hole, near = _large_holes(surface, cloud, spacing)
    free = hole != NO_CAP
    cap = hole[surface.faces].max(axis=1)
    is_end = np.zeros(len(cap), dtype=np.bool_)
    if not free.any():
        return Capped(surface, cap, is_end)
    vertices = _on_points(
        surface.vertices, with_ring(free, surface.faces) & ~free, cloud, near
    )
    flat = TriangleMesh(membrane(vertices, surface.faces, free), surface.faces)
    vertices = flat.vertices
    for number in np.unique(hole[free]):
        own, here = hole == number, cap == number
        vertices, is_end[here] = _raised(vertices, flat, own, here, cloud)
    base = base_of(flat, cap, is_end, cloud)
    is_flat = np.isin(hole, cap[base])
    closed = np.where(is_flat[:, np.newaxis], flat.vertices, vertices)
    return Capped(TriangleMesh(closed, surface.faces), cap, base)


def _raised(
    vertices: FloatArray, flat: TriangleMesh, own: Mask, here: Mask, cloud: PointCloud
) -> tuple[FloatArray, bool]:
    """The vertices after the flat cap of one hole became round, and whether the hole is the end of a part.

    A cap on the ground stays flat.

    own, here: (n,) and (m,) bool, the vertices and the faces of the cap.
    """
    axis = flat.area_vectors[here].sum(axis=0)
    area = float(np.linalg.norm(axis))
    if area < NO_AREA * cloud.diagonal**2:
        return vertices, False
    axis /= area
    if faces_ground(axis, cloud):
        return vertices, True
    rim = flat.vertices[with_ring(own, flat.faces) & ~own]
    tilt, steepness = slope_of(rim, axis, cloud.points, normals_of(cloud))
    is_wide = area > LARGEST_DOME * cloud.diagonal**2
    if tilt < DEEP and not is_wide:
        angle = min(float(np.arccos(tilt)), DEEPEST)
        closed = domed(vertices, flat.faces, own, axis, angle)
    else:
        closed = faired(vertices, flat.faces, own)
    cap = TriangleMesh(closed, flat.faces[here])
    if not is_wide or cap.area <= MOST_SWOLLEN * area:
        vertices = closed
    return vertices, ends_a_part(tilt, steepness)


def _on_points(
    vertices: FloatArray, is_rim: Mask, cloud: PointCloud, near: NDArray[np.intp]
) -> FloatArray:
    """The vertices, of which those of rims are at their nearest points.

    Of several with one nearest point only the nearest moves: faces between them would have no area, so that
    the patch that they close could not be faired, and would stay flat.
    """
    rim = np.flatnonzero(is_rim)
    offsets = cloud.points[near[rim]] - vertices[rim]
    rim = rim[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    rim = rim[np.unique(near[rim], return_index=True)[1]]
    moved: FloatArray = vertices.copy()
    moved[rim] = cloud.points[near[rim]]
    return moved


def _large_holes(
    surface: TriangleMesh, cloud: PointCloud, spacing: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(n,) the large hole of each vertex, `NO_CAP` if there are points; and (n,) the nearest point."""
    from scipy.spatial import cKDTree

    # A surface may bulge far from the points, where a search by cells takes long.
    tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
    distance, near = map(np.asarray, tree.query(surface.vertices))  # (n,), (n,)
    if distance.max() <= LARGE_HOLE * cloud.diagonal:
        return np.full(len(near), NO_CAP), near
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
    return np.where(free, hole, NO_CAP), near


def faces_ground(axis: FloatArray, cloud: PointCloud) -> bool:
    """Whether a hole, with the unit normal of the flat patch that closes it, faces a ground that is known."""
    return cloud.up is not None and bool(axis @ cloud.up < -PARALLEL)


def slope_of(
    rim: FloatArray, axis: FloatArray, points: FloatArray, normals: FloatArray
) -> tuple[float, float]:
    """The mean cosine between the axis of a hole and the normals at its rim; its growth over one radius.

    In a hole of a face or a chest the normals at the rim are tilted towards the axis of the hole. Round the
    hole of a crown they are perpendicular to it, but tilt more and more towards the rim, as on a sphere.
    Round a tube they do neither. Round a crotch, and beyond it, most of them face the axis, because both legs
    do: that counts as a tilt of 1. So does a gap between two parts, such as a hand beside a thigh.

    rim: (r, 3) float64, the vertices of the rim.
    axis: (3,) float64, the unit normal of the flat patch that closes the hole.
    points, normals: (n, 3) float64, of the surface.
    """
    along, across, near = _about(rim, axis, points)
    outwards = np.einsum("ij,ij->i", normals, unit_vectors(across))
    beyond = near & (along > ABOVE_RIM)
    is_between = outwards[near].sum() < 0 and outwards[beyond].sum() < 0
    near &= ~beyond
    if near.sum() < 3 or is_between or _touches_two(rim, points[near]):
        return 1.0, 0.0
    along, normals = along[near], normals[near]
    # The flood fill may have come in by the hole, and have turned normals at its rim inwards.
    away = across[near] + np.outer(along + 1, axis)
    tilt = np.sign(np.einsum("ij,ij->i", normals, away)) * (normals @ axis)
    # The slope of the regression line; np.polyfit warns where all points have one height.
    centred = along - along.mean()
    steepness = centred @ tilt / max(centred @ centred, np.finfo(np.float64).tiny)
    return float(tilt[along > -ABOVE_RIM].mean()), float(steepness)


def _touches_two(rim: FloatArray, points: FloatArray) -> bool:
    """Whether the points (r, 3) of a rim are of several connected pieces of the points (n, 3) about it."""
    beside = neighborhoods(points, OF_PIECE).near
    here = np.indices(beside.shape)[0]
    piece = joined_by(here.ravel(), beside.ravel(), len(points))
    return len(np.unique(piece[nearest(points, rim, 1)[1]])) > 1


def _about(
    rim: FloatArray, axis: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, Mask]:
    """Where points are, seen from a hole, in mean radii of its rim.

    Returns along, across, near: (n,) heights above the rim, (n, 3) offsets from the axis, and (n,) whether
        points are above, beside or up to a radius below the hole.
    """
    middle = rim.mean(axis=0)
    offsets = (points - middle) / np.linalg.norm(rim - middle, axis=1).mean()
    along = offsets @ axis
    across = offsets - np.outer(along, axis)
    near = (along > -BELOW_RIM) & ((across**2).sum(axis=1) < BESIDE_RIM**2)
    return along, across, near


def outwards_at_rims(found: Capped, cloud: PointCloud) -> PointCloud:
    """The points, whose normals round deep holes point away from the axes of the holes.

    The flood fill may have come in by a hole and have turned them inwards, so that the surface recedes.
    """
    surface, normals = found.surface, normals_of(cloud).copy()
    for number in np.unique(found.cap[found.cap != NO_CAP]):
        here = found.cap == number
        axis = surface.area_vectors[here].sum(axis=0)
        area = np.linalg.norm(axis)
        if area < NO_AREA * cloud.diagonal**2:
            continue
        axis /= area
        rim = np.intersect1d(surface.faces[here], surface.faces[~here])
        if slope_of(surface.vertices[rim], axis, cloud.points, normals)[0] >= DEEP:
            continue
        along, across, near = _about(surface.vertices[rim], axis, cloud.points)
        near &= along < RECEDED
        if (normals[near] @ axis < -AWAY).mean() < MOST_AWAY:
            towards = np.einsum("ij,ij->i", normals, unit_vectors(across))
            normals[near & (towards < -INWARDS)] *= -1
    return replace(cloud, normals=normals)


def ends_a_part(tilt: float, steepness: float) -> bool:
    """Whether a hole is the end of a limb that was cut off, or a base: the body round it is like a tube."""
    return tilt < LEAST_TILT and steepness < LEAST_STEEPNESS


def base_of(
    surface: TriangleMesh, cap: NDArray[np.intp], is_end: Mask, cloud: PointCloud
) -> Mask:
    """(m,) mask of the faces of a base: caps of ends of the body that face down, and are nearly flat.

    Down is away from the ground, if the stage `crop` has removed it. Otherwise it is the normal of the
    largest cap on which the body can stand: few points are beneath its plane, and the mean of the points is
    above the convex hull of the caps that are parallel to it and of the points that touch its plane.

    The caps of a seat and of hands that rest on something belong to it, if they face down. It has no faces if
    the body cannot stand.

    cap: (m,) the number of the hole that a face closes.
    is_end: (m,) bool, whether it closes an end, by a flat cap.
    """
    numbers = np.unique(cap[is_end])
    members = cap == numbers[:, np.newaxis]  # (c, m)
    sums, areas = members @ surface.area_vectors, members @ surface.face_areas
    size = np.linalg.norm(sums, axis=1)
    flat = size >= FLAT * areas  # (c,)
    normals = sums / np.where(size > 0, size, 1)[:, None]
    up = cloud.up
    downs = [-up] if up is not None else normals[flat][np.argsort(-areas[flat])]
    for down in downs:
        facing = numbers[flat & (normals @ down >= PARALLEL)]
        faces = np.asarray(np.isin(cap, facing))
        own = surface.vertices[surface.faces[faces]].reshape(-1, 3)
        if not len(own):
            continue
        is_wide = len(facing) > 1 or areas.max() > LARGEST_DOME * cloud.diagonal**2
        if up is not None or (is_wide and _stands(own, down, cloud)):
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
        outline = ConvexHull(
            np.concatenate([base, cloud.points[touching]]) @ axes.T
        ).equations
    except QhullError:  # fewer than three points, or all on a line
        return False
    return bool(
        (outline[:, :2] @ (axes @ cloud.points.mean(axis=0)) + outline[:, 2] <= 0).all()
    )


class End(NamedTuple):
    """Where a limb ends in a gap: (r, 3) the points of its rim, and its axis, a unit vector outwards.

    piece: the number of the connected piece of the points that it belongs to.
    """

    rim: FloatArray
    axis: FloatArray
    piece: int

    @property
    def middle(self) -> FloatArray:
        """(3,) the middle of the rim."""
        return np.asarray(self.rim.mean(axis=0))

    @property
    def radius(self) -> float:
        """The mean radius of the rim."""
        return float(np.linalg.norm(self.rim - self.middle, axis=1).mean())

    def gap(self, other: End) -> float:
        """The distance to another end in mean radii; infinity if they are not the two ends of a gap.

        A gap parts a limb from the body. Two hands that face each other are of one piece.
        """
        across = other.middle - self.middle
        distance = float(np.linalg.norm(across))
        least = FACING * distance
        is_facing = across @ self.axis > least and across @ other.axis < -least
        alike = max(self.radius, other.radius) < ALIKE * min(self.radius, other.radius)
        if not (is_facing and alike) or self.piece == other.piece:
            return np.inf
        return 2 * distance / (self.radius + other.radius)


def limbs_continued(cloud: PointCloud, spacing: float) -> PointCloud:
    """The points, with further ones between two ends of a limb that face each other across a gap.

    spacing: of the points.
    """
    found = _ends(cloud, spacing)
    while len(found) > 1:
        one, other = min(combinations(found, 2), key=lambda two: two[0].gap(two[1]))
        if one.gap(other) > FARTHEST_GAP:
            break
        cloud = _bridged(cloud, one, other, spacing)
        found = [each for each in found if each is not one and each is not other]
    return cloud


def _ends(cloud: PointCloud, spacing: float) -> list[End]:
    """The ends of limbs in gaps: rims beside all of which the surface goes the same way, round an axis."""
    from scipy.spatial import cKDTree

    around = neighborhoods(cloud.points, AROUND)
    offsets = cloud.points - cloud.points[around.near].mean(axis=1)  # (n, 3)
    distance = np.linalg.norm(offsets, axis=1)
    at_rim = distance > ASIDE * around.distance[:, -1]
    directions = offsets[at_rim] / distance[at_rim, np.newaxis]
    places, normals = cloud.points[at_rim], normals_of(cloud)[at_rim]
    pairs = cKDTree(places).query_pairs(ALONG_RIM * spacing, output_type="ndarray")
    label = joined_by(pairs[:, 0], pairs[:, 1], len(places))
    close = around.distance[:, :OF_PIECE] < ALONG_RIM * spacing
    beside = around.near[:, :OF_PIECE][close]
    piece = joined_by(np.nonzero(close)[0], beside, len(cloud.points))[at_rim]
    found = []
    for number in np.flatnonzero(np.bincount(label, minlength=1) >= FEWEST_OF_RIM):
        own = label == number
        axis = directions[own].mean(axis=0)
        # Normals round a tube have the eigenvalues 1/2, 1/2 and 0, whatever their signs.
        spread = np.linalg.eigvalsh(normals[own].T @ normals[own] / own.sum())[1]
        if np.linalg.norm(axis) > ONE_WAY and spread > ALL_ROUND:
            usual = int(np.bincount(piece[own]).argmax())
            found.append(End(places[own], axis / np.linalg.norm(axis), usual))
    return [end for end in found if end.radius > THINNEST * cloud.diagonal]


def _bridged(cloud: PointCloud, one: End, other: End, spacing: float) -> PointCloud:
    """The points, with those on straight lines between the rims of two ends."""
    along = other.middle - one.middle
    along /= np.linalg.norm(along)

    def across(places: FloatArray, middle: FloatArray) -> FloatArray:
        offsets = places - middle
        return offsets - np.outer(offsets @ along, along)

    rims = [across(each.rim, each.middle) / each.radius for each in (one, other)]
    opposite = (
        nearest(rims[1], rims[0], 1)[1][:, 0],
        nearest(rims[0], rims[1], 1)[1][:, 0],
    )
    starts = np.concatenate([one.rim, one.rim[opposite[1]]])
    ends = np.concatenate([other.rim[opposite[0]], other.rim])
    longest = np.linalg.norm(ends - starts, axis=1).max()
    shares = np.linspace(0, 1, int(longest / spacing) + 2)[1:-1, np.newaxis, np.newaxis]
    made = (starts + shares * (ends - starts)).reshape(-1, 3)
    normals = across(made, one.middle)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    known = normals_of(cloud).copy()
    # The flood fill may have come in by the gap, and have turned normals at the rims inwards.
    for each in (one, other):
        near = nearest(each.rim, cloud.points, 1)[0][:, 0] < BESIDE_END * each.radius
        inwards = (
            np.einsum("ij,ij->i", known[near], across(cloud.points[near], each.middle))
            < 0
        )
        known[np.flatnonzero(near)[inwards]] *= -1
    return replace(
        cloud,
        points=np.concatenate([cloud.points, made]),
        normals=np.concatenate([known, normals]),
    )


def points_on(surface: TriangleMesh, faces: Mask, spacing: float) -> FloatArray:
    """(p, 3) points on some faces of a surface, on a regular grid of each face, at most a spacing apart."""
    corners = surface.vertices[surface.faces[faces]]  # (f, 3, 3)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(
        initial=0.0
    )
    n = int(np.ceil(longest / spacing)) + 1
    return grid_points(corners, n)
