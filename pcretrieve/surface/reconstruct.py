"""Random points of a surface."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import DegenerateMeshError, ReconstructionError, Stage
from pcretrieve.options import SurfaceOptions
from pcretrieve.surface import open3d
from pcretrieve.surface.body import SurfaceMarks, body_surfaces
from pcretrieve.surface.repair import ONE_SIDED, largest_component, outward, repaired, used_vertices
from pcretrieve.surface.topology import Defects, compact, defects, orient_faces
from pcretrieve.values import FloatArray, IntArray, PointCloud, Step, TriangleMesh


def uniform_points(
    mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Random points of a surface, uniform by area [1]_.

    Returns points : (n, 3) float64: in the unit of the mesh.
    Returns faces : (n,) intp: number of the face that each point lies on.

    References
    ----------
    .. [1] Osada, Funkhouser, Chazelle and Dobkin, "Shape distributions", ACM TOG 2002, equation (1).
    """
    areas = mesh.face_areas  # (m,)
    faces = rng.choice(len(areas), size=n, p=areas / areas.sum())
    # The square root makes the barycentric coordinates uniform over the triangle.
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.column_stack([1 - u, u * (1 - v), u * v])  # (n, 3)
    points: FloatArray = np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[faces]])
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
    sizes |= {"vertices": len(kept.vertices), "faces": len(kept.faces), "euler": kept.euler_characteristic}
    step = Step("topology", time.perf_counter() - started, sizes, notes)
    return TriangleMesh(kept.vertices, kept.faces, (*mesh.provenance, step))


def sampled(mesh: TriangleMesh, options: SurfaceOptions) -> PointCloud:
    """Random points on a mesh, with uniform density by area."""
    started = time.perf_counter()
    if not mesh.area > 0:
        raise DegenerateMeshError(f"no face of {len(mesh.faces)} has an area", stage=Stage.SURFACE)
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


def poisson_surface(cloud: PointCloud, options: SurfaceOptions) -> TriangleMesh:
    """Screened Poisson reconstruction of oriented points, simplified and repaired."""
    if cloud.normals is None:
        raise ReconstructionError("reconstruction needs points with normals, these have none")
    started = time.perf_counter()
    vertices, faces, density = open3d.poisson(
        cloud.points, cloud.normals, depth=options.poisson_depth, scale=options.poisson_scale
    )
    if not len(faces):
        raise ReconstructionError(f"Poisson reconstruction of {len(cloud.points)} points gave no surface")
    n_raw = len(faces)
    trimmed = _trimmed(vertices, faces, density, options.density_trim)
    surface, dropped = largest_component(trimmed, options.max_discarded)
    if len(surface.faces) > options.target_faces:
        surface = TriangleMesh(
            *open3d.simplify(surface.vertices, surface.faces, n_faces=options.target_faces)
        )
    final, notes = repaired(surface)
    if options.reconstructions > 1:
        notes = (*notes, "the method poisson makes one surface, so that the signature has no error bar")
    if options.density_trim == 0 and (found := defects(final)):
        raise ReconstructionError(
            f"the points must surround a body, their surface has {found}: "
            "scan the sides that are missing, or merge this view with others"
        )
    step = Step(
        "surface",
        time.perf_counter() - started,
        {
            "points": len(cloud.points),
            "faces_poisson": n_raw,
            "faces": len(final.faces),
            "euler": final.euler_characteristic,
        },
        (*dropped, *notes),
    )
    return TriangleMesh(final.vertices, final.faces, (*cloud.provenance, step))


def _n_non_manifold(found: Defects) -> int:
    return found.non_manifold_edges + found.non_manifold_vertices


def _trimmed(vertices: FloatArray, faces: IntArray, density: FloatArray, share: float) -> TriangleMesh:
    """The mesh without the fraction `share` of its vertices that have the lowest point density."""
    if share == 0:
        return compact(vertices, faces)
    kept = density >= np.quantile(density, share)
    return compact(vertices, faces[kept[faces].all(axis=1)])


Reconstructed = tuple[TriangleMesh, SurfaceMarks | None]


def surfaces(cloud: PointCloud, options: SurfaceOptions) -> Iterator[Reconstructed]:
    """Reconstruct the surfaces of a cloud by the method of the options.

    Yields mesh : TriangleMesh: with the provenance of the cloud and a step ``surface``; unit of the file.
    """
    if options.method == "poisson":
        yield poisson_surface(cloud, options), None
    else:
        yield from body_surfaces(cloud, options)
