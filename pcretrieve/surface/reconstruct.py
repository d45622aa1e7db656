"""Input meshes: kept, or sampled for reconstruction; and Poisson reconstruction of oriented points."""

from __future__ import annotations

import time

import numpy as np

from pcretrieve.adapters import open3d
from pcretrieve.errors import DegenerateMeshError, ReconstructionError, Stage
from pcretrieve.options import SurfaceOptions
from pcretrieve.surface.repair import ONE_SIDED, largest_component, outward, repaired, used_vertices
from pcretrieve.surface.sampling import uniform_points
from pcretrieve.surface.topology import Defects, compact, defects, orient_faces
from pcretrieve.types import FloatArray, IntArray, PointCloud, Step, TriangleMesh

__all__ = ["poisson_surface", "sampled", "sound_mesh"]

# Seed of the points that are sampled on a mesh, so that the samples are reproducible.
SAMPLE_SEED = 0


def sound_mesh(mesh: TriangleMesh, options: SurfaceOptions) -> TriangleMesh | None:
    """The mesh that is used without reconstruction, or None if it must be reconstructed.

    Parameters
    ----------
    mesh : TriangleMesh
        Any mesh.
    options : SurfaceOptions
        Of which `mode` is used. ``auto``: keep a closed, connected manifold, and orient it outwards.
        ``keep``: keep the repaired mesh, see `repaired`, with its holes. ``reconstruct``: keep no mesh.

    Returns
    -------
    TriangleMesh or None
        The mesh, with a step ``topology`` in its provenance. None if it must be reconstructed.

    Raises
    ------
    DegenerateMeshError
        If the mode is ``keep`` and the mesh is one-sided, or has no face with an area.
    """
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
    """Random points on a mesh, with uniform density by area.

    Parameters
    ----------
    mesh : TriangleMesh
        Any two-sided mesh.
    options : SurfaceOptions
        Of which `sample_points`, the number of points, is used.

    Returns
    -------
    PointCloud
        The points without normals, with a step ``sample`` in its provenance. Equal meshes give equal points.

    Raises
    ------
    DegenerateMeshError
        If no face has an area, or the surface is one-sided.
    """
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
    """Screened Poisson reconstruction of oriented points, simplified and repaired.

    Parameters
    ----------
    cloud : PointCloud
        Points with normals.
    options : SurfaceOptions
        Of which `poisson_depth`, `poisson_scale`, `density_trim`, `max_discarded` and `target_faces` are
        used. If `reconstructions` is 2 or more, a note says that there is only one surface.

    Returns
    -------
    TriangleMesh
        A connected manifold, oriented outwards. Closed if `density_trim` is 0; otherwise it has holes where
        vertices were removed, which the remesher closes.

    Raises
    ------
    ReconstructionError
        If the points have no normals, the reconstruction is empty, has two large components, or is not a
        closed manifold.
    """
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
