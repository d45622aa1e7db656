"""Cubic (P3) finite elements: ten nodes on each face."""

from __future__ import annotations

import numpy as np

from pcretrieve.spectral.elements import Assembled, Element, Index, Sides, assembled, check_faces, sides_of
from pcretrieve.types import TriangleMesh

__all__ = ["CUBIC", "cubic", "cubic_nodes"]

# Corners 0, 1, 2; two nodes on each side, at a third and at two thirds of the way along it; the centre.
# Exact rationals; tests/spectral/test_cubic.py derives them anew from the basis functions.
CUBIC = Element(
    along=np.array(
        [
            [34, -7, 0, -54, 27, -3, -3, 3, 3, 0],
            [-7, 34, 0, 27, -54, 3, 3, -3, -3, 0],
            [0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            [-54, 27, 0, 135, -108, 0, 0, 0, 0, 0],
            [27, -54, 0, -108, 135, 0, 0, 0, 0, 0],
            [-3, 3, 0, 0, 0, 135, -27, 27, 27, -162],
            [-3, 3, 0, 0, 0, -27, 135, -135, 27, 0],
            [3, -3, 0, 0, 0, 27, -135, 135, -27, 0],
            [3, -3, 0, 0, 0, 27, 27, -27, 135, -162],
            [0, 0, 0, 0, 0, -162, 0, 0, -162, 324],
        ]
    )
    / 40,
    mass=np.array(
        [
            [76, 11, 11, 18, 0, 27, 27, 0, 18, 36],
            [11, 76, 11, 0, 18, 18, 0, 27, 27, 36],
            [11, 11, 76, 27, 27, 0, 18, 18, 0, 36],
            [18, 0, 27, 540, -189, -135, -54, -135, 270, 162],
            [0, 18, 27, -189, 540, 270, -135, -54, -135, 162],
            [27, 18, 0, -135, 270, 540, -189, -135, -54, 162],
            [27, 0, 18, -54, -135, -189, 540, 270, -135, 162],
            [0, 27, 18, -135, -54, -135, 270, 540, -189, 162],
            [18, 27, 0, 270, -135, -54, -135, -189, 540, 162],
            [36, 36, 36, 162, 162, 162, 162, 162, 162, 1944],
        ]
    )
    / 6720,
    turn=np.array([1, 2, 0, 5, 6, 7, 8, 3, 4, 9]),
    side=np.array([0, 1, 3, 4]),
)


def cubic(mesh: TriangleMesh) -> Assembled:
    """Continuous functions, cubic on each face [1]_, Appendix C, Table 7.

    Rows are the vertices, then two nodes on each edge, then the centre of each face, as `cubic_nodes` numbers
    them: about nine times as many as vertices. Exact for cubic functions; eigenvalues of order 6 in the edge
    length on a flat surface. The faces of a curved one stay flat: there, order 2 remains, of the distance
    between the faces and what they stand for. With lumped mass the order is 4.

    Returns
    -------
    Assembled
        S symmetric positive semi-definite, dimensionless, its null space the constants of each component; M
        symmetric positive definite, unit length². S·1 = 0 and 1ᵀM·1 = area.

    Raises
    ------
    DegenerateMeshError
        If there are no faces, a vertex without a face, or a face without area.

    References
    ----------
    .. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
       Computer 32 (2016).
    """
    check_faces(mesh)
    sides = sides_of(mesh)
    return assembled(mesh, cubic_nodes(mesh, sides), CUBIC, sides)


def cubic_nodes(mesh: TriangleMesh, sides: Sides) -> Index:
    """(m, 10) the rows of the nodes of each face, in the order of `CUBIC`.

    With n vertices and e edges: vertex i is row i; the nodes of edge j are rows n + 2j, nearer to its lower
    vertex, and n + 2j + 1; the centre of face f is row n + 2e + f.
    """
    n, m = len(mesh.vertices), len(mesh.faces)
    first = n + 2 * sides.edge  # (m, 3)
    # The two faces at an edge run along it in opposite directions, and must mean the same node.
    down = mesh.faces > np.roll(mesh.faces, -1, axis=1)  # (m, 3)
    on_sides = np.stack([first + down, first + ~down], axis=2).reshape(m, 6)
    centre = n + 2 * len(sides.use) + np.arange(m)
    # Half the memory of int64, for indices of matrices with a hundred entries a face.
    return np.column_stack([mesh.faces, on_sides, centre]).astype(np.int32)
