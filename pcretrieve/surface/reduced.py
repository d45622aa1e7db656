"""Very fine mesh that is used without reconstruction → the same surface with fewer faces."""

from __future__ import annotations

import time

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.options import SurfaceOptions
from pcretrieve.surface import open3d
from pcretrieve.surface.repair import repaired
from pcretrieve.values import Step, TriangleMesh

__all__ = ["reduced"]


def reduced(mesh: TriangleMesh, options: SurfaceOptions) -> TriangleMesh:
    """A surface with at most `max_faces` faces.

    The time and memory of a spectrum grow faster than the number of faces, while its error is small already:
    see docs/decisions.md, max_faces.
    """
    if len(mesh.faces) <= options.max_faces:
        return mesh
    started = time.perf_counter()
    # Imported here because the module's numba functions are compiled on import.
    from pcretrieve.surface.simplify import simplified

    n = options.max_faces
    notes: tuple[str, ...] = ("simplified, because it had more faces than surface.max_faces",)
    try:
        coarse = simplified(mesh, n)
    except DegenerateMeshError:  # open, or not a manifold
        vertices, faces = open3d.simplify(mesh.vertices, mesh.faces, n_faces=n)
        coarse, repairs = repaired(TriangleMesh(vertices, faces))
        notes = (*notes, *repairs)
    sizes: dict[str, float] = {"faces_in": len(mesh.faces), "faces": len(coarse.faces)}
    sizes["euler"] = coarse.euler_characteristic
    step = Step("simplify", time.perf_counter() - started, sizes, notes)
    return TriangleMesh(coarse.vertices, coarse.faces, (*mesh.provenance, step))
