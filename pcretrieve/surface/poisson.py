"""Oriented points → closed surface, by screened Poisson reconstruction; and points between sparse ones."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from pcretrieve.arrays import Frame
from pcretrieve.arrays.open3d import library, open3d_cloud
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.density import (
    FARTHER,
    local_spacings,
    many_sparse,
    on_spheres,
    sparse_points,
)
from pcretrieve.points.neighbors import Neighborhoods, nearest, neighborhoods
from pcretrieve.surface.field import normals_of
from pcretrieve.values import FloatArray, PointCloud, Step, TriangleMesh
from pcretrieve.values.repair import largest_component, repaired
from pcretrieve.values.simplify import decimated
from pcretrieve.values.topology import compact, defects

# Binary digits of a coordinate in single precision: in a cube of side 1, points nearer than 2**-24 coincide.
SINGLE_DIGITS = 24

# Below this length of the mean of the normals, points lie on all sides. Of half a sphere it is 1/2.
MOST_BALANCED = 0.3

# Fewer points than this bound no surface; and the number of points among which so many are looked for first.
FEWEST_POINTS = 100
SOME = 1000


def not_closed(cloud: PointCloud, found: str) -> ReconstructionError:
    """The error for points whose surface is not closed, with advice for where they lie."""
    advice = "scan the sides that are missing, or merge this view with others"
    if np.linalg.norm(normals_of(cloud).mean(axis=0)) < MOST_BALANCED:
        advice = (
            "they lie on all sides, and their normals contradict each other: scan with less noise, or leave "
            "out the normals, if the file has some"
        )
    return ReconstructionError(
        f"the points must surround a body, their surface has {found}: {advice}"
    )


def poisson_surface(cloud: PointCloud, options: SurfaceOptions) -> TriangleMesh:
    """Screened Poisson reconstruction of oriented points, simplified and repaired."""
    started = time.perf_counter()
    normals = normals_of(cloud)
    whole = poisson(
        cloud.points, normals, depth=options.poisson_depth, scale=options.poisson_scale
    )
    surface, dropped = largest_component(whole, options.max_discarded)
    if len(surface.faces) > options.target_faces:
        surface = decimated(surface, options.target_faces)
    final, notes = repaired(surface)
    if options.reconstructions > 1:
        notes = (
            *notes,
            "the method poisson makes one surface, so that the signature has no error bar",
        )
    if found := defects(final):
        raise not_closed(cloud, str(found))
    step = Step(
        "surface",
        time.perf_counter() - started,
        {
            "points": len(cloud.points),
            "faces_poisson": len(whole.faces),
            "faces": len(final.faces),
            "euler": final.euler_characteristic,
        },
        (*dropped, *notes),
    )
    return TriangleMesh(final.vertices, final.faces, (*cloud.provenance, step))


def poisson(
    points: FloatArray, normals: FloatArray, *, depth: int, scale: float
) -> TriangleMesh:
    """Screened Poisson reconstruction [1]_ of points with unit normals that point outwards.

    depth: of the octree.
    scale: side of its cube, relative to the longest side of the bounding box.

    References
    ----------
    .. [1] Kazhdan and Hoppe, "Screened Poisson surface reconstruction", ACM TOG 2013.
    """
    frame = Frame.around(points)
    framed = frame.inward(points)
    _check_resolved(framed)
    mesh, _ = library().geometry.TriangleMesh.create_from_point_cloud_poisson(
        open3d_cloud(framed, normals), depth=depth, scale=scale, n_threads=1
    )
    vertices, faces = np.array(mesh.vertices), np.array(mesh.triangles, dtype=np.int32)
    if not np.isfinite(vertices).all():
        raise ReconstructionError(
            f"Poisson reconstruction must give finite vertices, {len(points)} points gave "
            f"{np.isfinite(vertices).all(axis=1).sum()} of {len(vertices)}: look for points that are no part "
            "of the body, and drop them"
        )
    if not len(faces):
        raise ReconstructionError(
            f"Poisson reconstruction of {len(points)} points gave no surface"
        )
    return compact(frame.outward(vertices), faces)


def _check_resolved(framed: FloatArray) -> None:
    """Whether points, in their frame, are distinct in single precision."""
    n_distinct = 0
    # A few of the points mostly suffice, and take a twentieth of the time of all points.
    for some in (framed[:: 1 + len(framed) // SOME], framed):
        n_distinct = len(np.unique(np.round(np.ldexp(some, SINGLE_DIGITS)), axis=0))
        if n_distinct >= FEWEST_POINTS:
            return
    raise ReconstructionError(
        f"at least {FEWEST_POINTS} points must be distinct in single precision, relative to the diagonal "
        f"of all points; of {len(framed)} points {n_distinct} are: look for points far from the body "
        "and drop them"
    )


# --- between sparse points --------------------------------------------------------------------------------

# Depth of the octree, and side of its cube relative to the longest side of the bounding box.
DEPTH, SCALE = 7, 1.5

# Share of the surface that sparse points represent from which they are those of a whole side; and the largest
# distance of points between these from the Poisson surface, in their spacings.
SIDE = 0.25
BELIEVED = 0.3


def interpolated(cloud: PointCloud, some: Neighborhoods, *, cell: float) -> PointCloud:
    """A cloud with further points between its sparse ones.

    The points are on spheres that are fitted to the nearest ones. If a whole side is sparse, its limbs are as
    thin as its points are apart, and the spheres fly off: then only those near a screened Poisson surface are
    used, whose octree has large cells where there are few points. See docs/decisions.md, points between
    sparse ones. Each further point has the position of the sensor of a sparse point nearby.

    some: neighbourhoods of some of the points.
    cell: edge of the voxels, and distance between the further points.
    """
    if (
        cloud.normals is None
        or not many_sparse(local_spacings(some), cell, cloud.diagonal).any()
    ):
        return cloud
    neighbors = neighborhoods(cloud.points, FARTHER + 1)
    spacings = local_spacings(neighbors)
    sparse = sparse_points(neighbors, cell=cell, diagonal=cloud.diagonal)
    if not sparse.any():
        return cloud
    points, normals, centres = on_spheres(
        cloud.points, cloud.normals, spacings, sparse, step=cell
    )
    if many_sparse(spacings, cell, cloud.diagonal, least=SIDE).any():
        surface = poisson(cloud.points, cloud.normals, depth=DEPTH, scale=SCALE)
        distance, _ = nearest(surface.vertices, points, 1)
        is_near = distance[:, 0] < BELIEVED * spacings[centres]
        points, normals, centres = points[is_near], normals[is_near], centres[is_near]
    sensors = cloud.viewpoints
    return replace(
        cloud,
        points=np.concatenate([cloud.points, points]),
        normals=np.concatenate([cloud.normals, normals]),
        viewpoints=None
        if sensors is None
        else np.concatenate([sensors, sensors[centres]]),
    )
