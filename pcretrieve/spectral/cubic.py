"""Cubic (P3) Lagrange elements: ten nodes on each face."""

from __future__ import annotations

import numpy as np

from pcretrieve.spectral.element import Assembled, Element
from pcretrieve.spectral.lagrange import Index, ReferenceElement, Sides, assembled, check_faces, sides_of
from pcretrieve.values import TriangleMesh

__all__ = ["CUBIC", "CUBIC_REFERENCE", "cubic", "cubic_nodes"]

# The nodes are the corners 0, 1, 2; two nodes on each side, at one third and two
# thirds of it; and the centre. The entries are exact rationals, which
# tests/spectral/test_cubic.py derives from the basis functions.
CUBIC_REFERENCE = ReferenceElement(
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
    """Stiffness and mass of continuous functions that are cubic on each face [1]_, Appendix C, Table 7.

    The eigenvalues of a flat surface converge with order 6 in the edge length; with lumped mass, with order
    4. On a curved surface the flat faces limit the order to 2.

    Returns Assembled: matrices of n + 2 e + m rows, about 9 n, in the order of `cubic_nodes`. S is symmetric
        positive semi-definite, dimensionless, S·1 = 0, and its null space is spanned by the constants on the
        components. M is symmetric positive definite, unit length², 1ᵀM·1 = area.

    References
    ----------
    .. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
       Computer 32 (2016).
    """
    check_faces(mesh)
    sides = sides_of(mesh)
    return assembled(mesh, cubic_nodes(mesh, sides), CUBIC_REFERENCE, sides)


CUBIC = Element("cubic", cubic)


def cubic_nodes(mesh: TriangleMesh, sides: Sides) -> Index:
    """The numbers of the nodes of each face.

    With n vertices and e edges, node i is vertex i; nodes n + 2 j and n + 2 j + 1 are on edge j, the first
    nearer to the vertex of lower number; node n + 2 e + f is the centre of face f.

    Returns (m, 10) int32: node numbers, in the order of the nodes of `CUBIC_REFERENCE`.
    """
    n, m = len(mesh.vertices), len(mesh.faces)
    first = n + 2 * sides.edge  # (m, 3)
    # The two faces at an edge traverse it in opposite directions, but must number its nodes equally.
    down = mesh.faces > np.roll(mesh.faces, -1, axis=1)  # (m, 3)
    on_sides = np.stack([first + down, first + ~down], axis=2).reshape(m, 6)
    centre = n + 2 * len(sides.use) + np.arange(m)
    # int32 halves the memory of the indices of the matrices, which have 100 entries for each face.
    return np.column_stack([mesh.faces, on_sides, centre]).astype(np.int32)
