"""Normals of the points of a scan, and their orientation."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import DOUBLE_OFFSET, Frame, joined_by, unit_vectors
from pcretrieve.arrays.open3d import library, open3d_cloud
from pcretrieve.errors import ReconstructionError, Stage
from pcretrieve.options import ScanOptions
from pcretrieve.points.density import disks, local_spacings, sparse_points
from pcretrieve.points.neighbors import (
    Neighborhoods,
    guided_planes,
    plane_neighborhoods,
    spacing,
)
from pcretrieve.points.voxels import Outside, flood
from pcretrieve.values import FloatArray, PointCloud, Step
from pcretrieve.values.compiled import compiled

# Largest depth below the outside of the points by which a leak is detected; in voxels.
SHALLOW = 4.0

# Smallest edge of the voxels of the flood fill, in spacings of the points. Smaller ones would leave gaps.
FLOOD_CELL = 1.3

# Factor by which the radius of the holes that are closed grows at each attempt.
WIDER = 1.4

# Smallest fraction of pairs of neighbours with consistent normals, below which the flood fill has leaked into
# the body: of the pairs whose normals are parallel up to this cosine, because noise turns the others.
LEAST_AGREEMENT = 0.95
PARALLEL = 0.7

# A point is contradicted by its neighbours if more than this share of the parallel ones point the other way.
MOST_CONTRADICTED = 0.3

# Largest connected patch of contradicted points; share of all points. A flood that leaks into one part only,
# such as a head, leaves nearly all pairs consistent: the patch is then 2.5 to 4.6 % of the points, and
# at most .12 % in sound scans.
LARGEST_PATCH = 0.005

# The same, if it stays larger whatever holes are closed: of few points, hands are such patches.
MOST_PATCHED = 0.02

# Patches that all around contradicts are turned if the flood fill leaked at first, and one of them has at
# least so many points; otherwise they lie in mouths and ears. See docs/decisions.md, LEAST_TURNED.
LEAST_TURNED = 12

# The flood fill contradicts a sensor if the cosine between its direction and that to the sensor is below
# −OPPOSED. If it contradicts more than a fraction of them, it has leaked into the body, or no sensor was
# where the file says.
OPPOSED = 0.3
MOST_OPPOSED = 0.05

# The flood fill contradicts a normal if the cosine between them is below ASKEW: .1 % of those of a surface,
# half of those of any sign, 9 % of directions to six cameras around a body.
ASKEW = 0.5

# Number of neighbours with which each point is compared.
N_COMPARED = 8

# The note on normals that nothing contradicts.
OWN = "used the file's own normals"

Oriented = tuple[PointCloud, tuple[str, ...]]  # with normals; and notes


def oriented_normals(
    cloud: PointCloud, options: ScanOptions, neighbors: Neighborhoods | None = None
) -> PointCloud:
    """The points with unit normals that point out of the body, and a step ``orient`` in the provenance.

    neighbors: those of the points, at least as many as `options.normal_neighbors`, if they are known.
    """
    started = time.perf_counter()
    method = options.orientation
    if method == "auto":
        method = "flood" if cloud.normals is None else "given"
        method = "viewpoint" if cloud.viewpoints is not None else method
    orientations = {
        "given": _as_given,
        "viewpoint": _by_viewpoint,
        "flood": _by_flood,
        "tangent-plane": _by_tangent_planes,
    }
    if neighbors is None:
        neighbors = plane_neighborhoods(cloud.points, options)
    oriented, notes = orientations[method](cloud, neighbors, options)
    step = Step(
        "orient", time.perf_counter() - started, {"points": len(cloud.points)}, notes
    )
    return oriented.after(step)


def _as_given(
    cloud: PointCloud, neighbors: Neighborhoods, options: ScanOptions
) -> Oriented:
    """The normals of the file, unless the flood fill contradicts them.

    Files hold normals without an orientation, and directions of view in place of normals.
    """
    if cloud.normals is None:
        raise ReconstructionError(
            "scan.orientation 'given' needs a scan with normals, this one has none: take 'auto'",
            stage=Stage.ORIENT,
        )
    if options.orientation == "given":
        return cloud, (OWN,)
    _, flooded, notes = _tight_flood(cloud, neighbors, options)
    if flooded is None:
        return cloud, (f"{OWN} (scan.orientation 'flood' ignores them)", *notes)
    askew = float((np.einsum("ij,ij->i", cloud.normals, flooded) < ASKEW).mean())
    if askew <= MOST_OPPOSED:
        return cloud, (OWN,)
    note = f"did not use the file's own normals: the flood fill contradicts {askew:.0%} of them"
    return replace(cloud, normals=flooded), (
        *notes,
        f"{note} (scan.orientation 'given' uses them)",
    )


def _by_viewpoint(
    cloud: PointCloud, neighbors: Neighborhoods, options: ScanOptions
) -> Oriented:
    """Normals towards the sensors; at grazing incidence the flood fill decides."""
    if cloud.viewpoints is None:
        raise ReconstructionError(
            "scan.orientation 'viewpoint' needs sensor positions, this scan has none: take 'auto'",
            stage=Stage.ORIENT,
        )
    towards = unit_vectors(cloud.viewpoints - cloud.points)
    outside, flooded, notes = _tight_flood(cloud, neighbors, options)
    guided = partial(_guided_normals, cloud.points, neighbors=neighbors, options=options)
    if outside is None or flooded is None:
        return replace(cloud, normals=guided(towards)), notes
    direction = outside.direction_at(cloud.points)
    opposed = float((np.einsum("ij,ij->i", towards, direction) < -OPPOSED).mean())
    if opposed <= MOST_OPPOSED:
        return replace(cloud, normals=guided(unit_vectors(towards + direction))), notes
    # Towards a place where no sensor was, such as the shift of the coordinates, normals turn where the body
    # does; by a leak, in and around it.
    seen, everywhere = guided(towards), np.ones(len(towards), dtype=np.bool_)
    by_sensors, by_flood = (
        _disagreeing(normals, neighbors.near, everywhere)[1]
        for normals in (seen, flooded)
    )
    if options.orientation == "auto" and by_flood >= by_sensors:
        note = (
            f"did not use the file's own sensor positions: the flood fill contradicts {opposed:.0%} of them "
            "(scan.orientation 'viewpoint' uses them)"
        )
        return replace(cloud, normals=flooded, viewpoints=None), (*notes, note)
    note = f"the flood fill contradicted {opposed:.0%} of the sensors and was not used"
    return replace(cloud, normals=seen), (*notes, note)


def _by_tangent_planes(
    cloud: PointCloud, _: Neighborhoods, options: ScanOptions
) -> Oriented:
    normals = estimate_normals(cloud.points, n_neighbors=options.normal_neighbors)
    oriented = orient_by_tangent_planes(
        cloud.points, normals, n_neighbors=options.normal_neighbors
    )
    # The outward normal of the highest point points upwards.
    top = cloud.points[:, 2].argmax()
    return replace(cloud, normals=-oriented if oriented[top, 2] < 0 else oriented), ()


def estimate_normals(points: FloatArray, *, n_neighbors: int) -> FloatArray:
    """(n, 3) unit normals, of arbitrary sign, of the least-squares planes of the neighbours of each point."""
    cloud = open3d_cloud(Frame.around(points, offset=DOUBLE_OFFSET).inward(points))
    cloud.estimate_normals(library().geometry.KDTreeSearchParamKNN(n_neighbors))
    return np.array(cloud.normals)


def orient_by_tangent_planes(
    points: FloatArray, normals: FloatArray, *, n_neighbors: int
) -> FloatArray:
    """The unit normals, or their opposites, consistent along a minimum spanning tree of tangent planes [1]_.

    References
    ----------
    .. [1] Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992.
    """
    cloud = open3d_cloud(
        Frame.around(points, offset=DOUBLE_OFFSET).inward(points), normals
    )
    try:
        cloud.orient_normals_consistent_tangent_plane(n_neighbors)
    except RuntimeError as error:  # from Qhull: the points coincide in its precision
        raise ReconstructionError(
            f"tangent planes need a Delaunay triangulation, and {len(points)} points have none: look for "
            "points that coincide or lie far from the body, and drop them",
            stage=Stage.ORIENT,
        ) from error
    return np.array(cloud.normals)


def _by_flood(
    cloud: PointCloud, neighbors: Neighborhoods, options: ScanOptions
) -> Oriented:
    """Normals towards the nearest outside; by tangent planes, if every flood fill leaks."""
    _, flooded, notes = _tight_flood(cloud, neighbors, options)
    if flooded is None:
        oriented, _ = _by_tangent_planes(cloud, neighbors, options)
        return oriented, (*notes, "tangent planes decided which side is outside")
    return replace(cloud, normals=flooded), notes


def _tight_flood(
    cloud: PointCloud, neighbors: Neighborhoods, options: ScanOptions
) -> tuple[Outside | None, FloatArray | None, tuple[str, ...]]:
    """Repeat the flood fill with larger closed holes until it does not leak into the body.

    A leak is detected by the normals towards the outside, which are then inconsistent between neighbours. If
    every flood fill seems to leak, that with the fewest such points is used; if these are too many, the
    outside and the normals are None.
    """
    cell = max(
        options.flood_cell * cloud.diagonal, FLOOD_CELL * spacing(neighbors.some())
    )
    walled = _with_disks(cloud, neighbors, options, cell / FLOOD_CELL)
    best, fewest = None, MOST_PATCHED * len(cloud.points)
    for attempt in range(options.flood_retries + 1):
        gap = options.flood_gap * WIDER**attempt
        outside = flood(walled, cell=cell, gap=gap * cloud.diagonal)
        towards = outside.direction_at(cloud.points)
        oriented = _guided_normals(cloud.points, towards, neighbors, options)
        shallow = outside.depth_at(cloud.points) < SHALLOW
        largest = _contradicted(oriented, neighbors.near, shallow)
        if shallow.sum() > N_COMPARED and largest < fewest:
            best, fewest = (attempt, gap, outside, oriented), largest
            if largest <= LARGEST_PATCH * len(oriented):
                break
    if best is None:
        note = f"the flood fill leaked with holes up to {gap:.3f} of the diagonal closed"
        return None, None, (note,)
    attempt, gap, outside, oriented = best
    if not attempt:
        return outside, oriented, ()
    notes = [
        f"the flood fill leaked; holes with radii up to {gap:.3f} of the diagonal were closed"
    ]
    if fewest >= LEAST_TURNED:
        oriented, n_turned = _agreed(oriented, neighbors.near)
        notes += [f"turned {n_turned} normals in patches"] if n_turned else []
    return outside, oriented, tuple(notes)


def _with_disks(
    cloud: PointCloud, neighbors: Neighborhoods, options: ScanOptions, step: float
) -> FloatArray:
    """The points, and points on disks around those that are sparse, which close the surface between them."""
    spacings = local_spacings(neighbors)
    sparse = sparse_points(neighbors, cell=step, diagonal=cloud.diagonal)
    if not sparse.any():
        return cloud.points
    unguided = np.zeros_like(cloud.points)
    normals = _guided_normals(cloud.points, unguided, neighbors, options)
    placed, _ = disks(cloud.points, normals, spacings, sparse, step=step)
    return np.concatenate([cloud.points, placed])


def _guided_normals(
    points: FloatArray, guide: FloatArray, neighbors: Neighborhoods, options: ScanOptions
) -> FloatArray:
    """Normals of weighted least-squares planes of the neighbours on the same side of the body.

    In ears, fingers and tails, a neighbourhood contains points of both sides, and its least-squares plane is
    wrong. Neighbours are therefore weighted by the agreement of their guides with that of the point.

    guide: (n, 3) float64, approximate unit direction to the outside at each point; zero if unknown.
    """
    k = options.normal_neighbors
    near = np.ascontiguousarray(neighbors.near[:, :k])
    distance = np.ascontiguousarray(neighbors.distance[:, :k])
    return guided_planes(points, guide, near, distance)


def _contradicted(
    oriented: FloatArray, near: NDArray[np.intp], shallow: NDArray[np.bool_]
) -> int:
    """Number of points in the largest patch that neighbours contradict; all, if most of the scan does."""
    disagreeing, agreement = _disagreeing(oriented, near, shallow)
    if agreement < LEAST_AGREEMENT:
        return len(near)
    points = np.flatnonzero(disagreeing)
    others = near[points, 1 : N_COMPARED + 1].ravel()
    both = disagreeing[others]
    patch = joined_by(np.repeat(points, N_COMPARED)[both], others[both], len(near))
    return int(np.bincount(patch[points], minlength=1).max())


def _agreed(normals: FloatArray, near: NDArray[np.intp]) -> tuple[FloatArray, int]:
    """The normals, after patches were turned that all around contradicts; and how many were.

    A flood fill that comes in by a hole, but not far, turns some patches inwards.
    """
    n = len(near)
    points = np.repeat(np.arange(n), N_COMPARED)
    others = near[:, 1 : N_COMPARED + 1].ravel()
    cosines = np.einsum("ij,ij->i", normals[points], normals[others])
    agrees = cosines > PARALLEL
    patch = joined_by(points[agrees], others[agrees], n)
    border = patch[points] != patch[others]
    votes = np.bincount(patch[points[border]], cosines[border] + OPPOSED, minlength=n)
    size = np.bincount(patch, minlength=n)
    turned = (votes < 0) & (size <= LARGEST_PATCH * n)
    if size[turned].max(initial=0) < LEAST_TURNED:
        return normals, 0
    return np.where(turned[patch][:, np.newaxis], -normals, normals), size[turned].sum()


@compiled()
def _disagreeing(
    oriented: FloatArray, near: NDArray[np.intp], shallow: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], float]:
    """The points that a share of their neighbours contradicts, and the share of all pairs that agree.

    Pairs count if their normals are parallel and both are in the mask `shallow`.
    """
    disagreeing = np.zeros(len(near), dtype=np.bool_)
    n_pairs, n_opposed = 0, 0
    for i in range(len(near)):
        n_here, n_opposed_here = 0, 0
        for j in near[i, 1 : N_COMPARED + 1]:  # without the point itself
            cosine = 0.0
            for axis in range(3):
                cosine += oriented[i, axis] * oriented[j, axis]
            n_here += shallow[i] and shallow[j] and abs(cosine) > PARALLEL
            n_opposed_here += shallow[i] and shallow[j] and cosine < -PARALLEL
        disagreeing[i] = n_opposed_here > MOST_CONTRADICTED * n_here
        n_pairs += n_here
        n_opposed += n_opposed_here
    return disagreeing, 1 - n_opposed / max(1, n_pairs)
