"""Surface → boundary of a tetrahedral mesh (fTetWild)."""

from __future__ import annotations

import time

import numpy as np

from pcretrieve.errors import RemeshError, ShapeError
from pcretrieve.options import RemeshOptions
from pcretrieve.surface import tetwild
from pcretrieve.surface.repair import repaired
from pcretrieve.surface.topology import compact, defects, edges_of, face_groups
from pcretrieve.values import FloatArray, IntArray, Step, TriangleMesh

# The faces of a tetrahedron of positive volume, counter-clockwise seen from outside.
OUTWARD_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def remesh(mesh: TriangleMesh, options: RemeshOptions, *, optimize: bool = False) -> TriangleMesh:
    """The boundary of the tetrahedral mesh that fTetWild generates inside a surface.

    The boundary is used if, after repair, it is a closed manifold, and its area and volume differ by at most
    ``options.max_change`` from those of the input (if the input has holes, only the area is compared).
    Otherwise the input is returned, with the reason in its provenance.

    optimize: optimise the quality of the tetrahedra; slow, without benefit for the signature.
    """
    if options.method == "none":
        return mesh
    started = time.perf_counter()
    try:
        nodes, tetrahedra = tetwild.tetrahedralize(
            mesh.vertices,
            mesh.faces,
            edge_length=options.edge_length,
            envelope=options.envelope,
            optimize=optimize,
            timeout=options.timeout,
        )
        result, notes = repaired(compact(nodes, boundary_faces(nodes, tetrahedra)))
        _check_change(mesh, result, options.max_change)
    except ShapeError as error:
        if found := defects(mesh):
            raise RemeshError(
                f"the surface has defects ({found}) and could not be remeshed: {error.message}"
            ) from error
        result, notes = mesh, (f"kept the surface as it was before remeshing: {error.message}",)
    step = Step(
        "remesh",
        time.perf_counter() - started,
        {"faces_in": len(mesh.faces), "faces": len(result.faces)},
        notes,
    )
    return TriangleMesh(result.vertices, result.faces, (*mesh.provenance, step))


def boundary_faces(nodes: FloatArray, tetrahedra: IntArray) -> IntArray:
    """The boundary of a tetrahedral mesh: the faces that belong to exactly one tetrahedron.

    nodes: (p, 3) float64, coordinates of the nodes.
    tetrahedra: (q, 4) int32, node numbers of each tetrahedron, in any orientation.
    Returns (m, 3) int32: node numbers of each face, counter-clockwise seen from outside.
    """
    a, b, c, d = (nodes[tetrahedra[:, k]] for k in range(4))
    negative = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0  # (q,)
    corners = np.where(negative[:, None], tetrahedra[:, [0, 2, 1, 3]], tetrahedra)
    faces = corners[:, OUTWARD_FACES].reshape(-1, 3)  # (4q, 3)
    group = face_groups(faces)
    return np.asarray(faces[np.bincount(group)[group] == 1], dtype=np.int32)


def _check_change(before: TriangleMesh, after: TriangleMesh, most: float) -> None:
    if found := defects(after):
        raise RemeshError(f"its surface has defects: {found}")
    sizes = [("area", before.area, after.area)]
    if not (edges_of(before.faces).use == 1).any():
        sizes.append(("volume", before.volume, after.volume))
    for name, old, new in sizes:
        if abs(new - old) > most * abs(old):
            raise RemeshError(f"it changed the {name} from {old:.6g} to {new:.6g}, by more than {most:.0%}")
