"""Points, or a mesh → the surfaces that are described: meshes that are kept, points sampled on others."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import DegenerateMeshError, Stage
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.neighbors import Neighborhoods
from pcretrieve.surface.body import body_surfaces
from pcretrieve.surface.poisson import poisson_surface
from pcretrieve.values import FloatArray, PointCloud, Step, TriangleMesh
from pcretrieve.values.repair import (
    ONE_SIDED,
    denoised,
    outward,
    repaired,
    used_vertices,
)
from pcretrieve.values.simplify import decimated, simplified
from pcretrieve.values.topology import Defects, SurfaceMarks, defects, orient_faces


def uniform_points(
    mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.intp]]:
    """(n, 3) random points of a surface, uniform by area [1]_, and (n,) numbers of their faces.

    References
    ----------
    .. [1] Osada, Funkhouser, Chazelle and Dobkin, "Shape distributions", ACM TOG 2002, equation (1).
    """
    areas = mesh.face_areas  # (m,)
    faces = rng.choice(len(areas), size=n, p=areas / areas.sum())
    # The square root makes the barycentric coordinates uniform over the triangle.
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.column_stack([1 - u, u * (1 - v), u * v])  # (n, 3)
    points: FloatArray = np.einsum(
        "nk,nkd->nd", weights, mesh.vertices[mesh.faces[faces]]
    )
    return points, faces


# Seed of the points that are sampled on a mesh, so that the samples are reproducible.
SAMPLE_SEED = 0


def sound_mesh(mesh: TriangleMesh, options: SurfaceOptions) -> TriangleMesh | None:
    """The mesh that is used without reconstruction, or None if it must be reconstructed."""
    started = time.perf_counter()
    if options.mode == "reconstruct":
        return None
    if options.mode == "auto":
        if defects(mesh):
            return None
        used, unused = used_vertices(mesh)
        kept, turned = outward(used)
        notes = (*unused, *turned)
        sizes: dict[str, float] = {}
    else:
        kept, notes = repaired(mesh)
        sizes = {"non_manifold": _n_non_manifold(defects(mesh))}
    kept, smoothed = denoised(kept)
    notes += smoothed
    sizes |= {
        "vertices": len(kept.vertices),
        "faces": len(kept.faces),
        "euler": kept.euler_characteristic,
    }
    step = Step("topology", time.perf_counter() - started, sizes, notes)
    return TriangleMesh(kept.vertices, kept.faces, (*mesh.provenance, step))


def sampled(mesh: TriangleMesh, options: SurfaceOptions) -> PointCloud:
    """Random points on a mesh, with uniform density by area."""
    started = time.perf_counter()
    if not mesh.area > 0:
        raise DegenerateMeshError(
            f"no face of {len(mesh.faces)} has an area", stage=Stage.SURFACE
        )
    if orient_faces(mesh) is None:
        raise DegenerateMeshError(ONE_SIDED, stage=Stage.SURFACE)
    found = defects(mesh)
    n = options.sample_points
    points, _ = uniform_points(mesh, n, np.random.default_rng(SAMPLE_SEED))
    step = Step(
        "sample",
        time.perf_counter() - started,
        {"points": n, "non_manifold": _n_non_manifold(found)},
        (f"sampled {n} points from a mesh with defects: {found}",) if found else (),
    )
    return PointCloud(points, provenance=(*mesh.provenance, step))


def reduced(mesh: TriangleMesh, options: SurfaceOptions) -> TriangleMesh:
    """A surface with at most `max_faces` faces.

    The time and memory of a spectrum grow faster than the number of faces, while its error is small already.
    """
    if len(mesh.faces) <= options.max_faces:
        return mesh
    started = time.perf_counter()
    notes: tuple[str, ...] = (
        "simplified, because it had more faces than surface.max_faces",
    )
    try:
        coarse = simplified(mesh, options.max_faces)
    except DegenerateMeshError:  # open, or not a manifold
        coarse, repairs = repaired(decimated(mesh, options.max_faces))
        notes = (*notes, *repairs)
    sizes: dict[str, float] = {"faces_in": len(mesh.faces), "faces": len(coarse.faces)}
    sizes["euler"] = coarse.euler_characteristic
    step = Step("simplify", time.perf_counter() - started, sizes, notes)
    return TriangleMesh(coarse.vertices, coarse.faces, (*mesh.provenance, step))


def _n_non_manifold(found: Defects) -> int:
    return found.non_manifold_edges + found.non_manifold_vertices


Reconstructed = tuple[TriangleMesh, SurfaceMarks | None]


def surfaces(
    cloud: PointCloud, near: Neighborhoods, options: SurfaceOptions
) -> Iterator[Reconstructed]:
    """Reconstruct the surfaces of a cloud by the method of the options; with the neighbours of all points."""
    if options.method == "poisson":
        yield poisson_surface(cloud, options), None
    else:
        yield from body_surfaces(cloud, options, near)
