"""Lagrange finite elements on a triangulated surface: from reference matrices to sparse ones.

On a flat triangle of area a with angles θ, let D_k be the derivative along side k, times the side's length.
The barycentric gradients add up to zero, and ∇λ_i·∇λ_j = −cot θ_k / (2a), θ_k opposite side k; so for every
u

    ∫ |∇u|² = Σ_k ½ cot θ_k · (1/a) ∫ (D_k u)²,

and the stiffness matrix of any element is Σ_k ½ cot θ_k C_k with matrices C_k of rational numbers. Ye and
Yu [1]_ write the same sum by squared side lengths, Appendix C: J_k = (C_i + C_j − C_k) / 8.

References
----------
.. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
   Computer 32 (2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.types import FloatArray, TriangleMesh

__all__ = ["Assembled", "Element", "Index", "Sides", "assembled", "check_faces", "check_vertices", "sides_of"]

Index = NDArray[np.integer]


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """What a finite element is on every triangle. Side k runs from corner k to corner k + 1.

    Attributes
    ----------
    along : (q, q) float64
        C_0 = (1/a) ∫ D_0 φ_i D_0 φ_j, dimensionless.
    mass : (q, q) float64
        (1/a) ∫ φ_i φ_j, dimensionless; the J4 of the paper.
    turn : (q,) int
        The node that each node becomes when corner 0 becomes corner 1, corner 1 becomes 2, and 2 becomes 0.
    side : (r,) int
        The nodes on side 0, its corners included.
    """

    along: FloatArray
    mass: FloatArray
    turn: Index
    side: Index


class Sides(NamedTuple):
    """(m, 3) number of the edge that each side of each face lies on, and (e,) faces on each edge."""

    edge: Index
    use: Index


class Assembled(NamedTuple):
    """Stiffness, mass, and a mask of the rows whose nodes lie on the boundary."""

    stiffness: csc_array
    mass: csc_array
    boundary: NDArray[np.bool_]


def sides_of(mesh: TriangleMesh) -> Sides:
    """The edges of a surface, in ascending order of their lower and then of their higher vertex."""
    tail, head = mesh.faces.astype(np.int64), np.roll(mesh.faces, -1, axis=1)  # (m, 3) each
    key = np.minimum(tail, head) * len(mesh.vertices) + np.maximum(tail, head)
    _, edge, use = np.unique(key, return_inverse=True, return_counts=True)
    return Sides(edge.reshape(-1, 3), use)


def assembled(mesh: TriangleMesh, nodes: Index, element: Element, sides: Sides) -> Assembled:
    """Consistent mass and stiffness.

    Parameters
    ----------
    mesh : TriangleMesh
        That `check_faces` has passed.
    nodes : (m, q) int
        The rows that the nodes of each face have in the matrices, every row in some face.
    element : Element
    sides : Sides
        Of `mesh`.
    """
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    edges = np.roll(corners, -1, axis=1) - corners  # (m, 3, 3)
    area = mesh.face_areas  # (m,)
    # Side k meets the next one at corner k + 1 and the last at corner k: opposite it, between the other two.
    opposite = np.einsum("mkx,mkx->mk", np.roll(edges, -1, axis=1), np.roll(edges, -2, axis=1))
    half_cotangents = -opposite / (4 * area[:, None])  # (m, 3)

    n = int(nodes.max()) + 1
    boundary = np.zeros(n, dtype=bool)
    along, side, back = [element.along], element.side, np.argsort(element.turn)
    for k in range(3):
        boundary[nodes[sides.use[sides.edge[:, k]] == 1][:, side]] = True
        along.append(along[k][np.ix_(back, back)])
        side = element.turn[side]
    stiffness, mass = _summed(
        half_cotangents @ np.reshape(along[:3], (3, -1)), area[:, None] * element.mass.ravel(), nodes, n
    )
    return Assembled(stiffness, mass, boundary)


def _summed(one: FloatArray, other: FloatArray, nodes: Index, n: int) -> tuple[csc_array, csc_array]:
    """(n, n) sums of the (m, q²) matrices of all faces."""
    # As real and imaginary part of one matrix, so that its pattern is sorted once for both.
    local = np.empty(one.shape, dtype=np.complex128)
    local.real, local.imag = one, other
    q = nodes.shape[1]
    rows, columns = np.repeat(nodes, q, axis=1).ravel(), np.tile(nodes, (1, q)).ravel()
    total = csc_array(coo_array((local.ravel(), (rows, columns)), shape=(n, n)))
    # Where more than two faces meet, rounding depends on the order that they are added up in.
    total = csc_array((total + total.T) / 2)
    first, second = (
        csc_array((part.copy(), total.indices, total.indptr), shape=(n, n))
        for part in (total.data.real, total.data.imag)
    )
    return first, second


def check_faces(mesh: TriangleMesh) -> None:
    """Refuse what no element can be set up on.

    Raises
    ------
    DegenerateMeshError
        If there are no faces, a vertex without a face, or a face without area.
    """
    check_vertices(mesh)
    flat = int(mesh.flat_faces.sum())
    if flat:
        raise DegenerateMeshError(f"every face must have an area, got {flat} of {len(mesh.faces)} without")


def check_vertices(mesh: TriangleMesh) -> None:
    """As `check_faces`, but faces may be flat as long as they have three corners.

    Raises
    ------
    DegenerateMeshError
        If there are no faces, or a vertex without a face.
    """
    if not len(mesh.faces):
        raise DegenerateMeshError("a surface must have faces, got none")
    loose = np.ones(len(mesh.vertices), dtype=bool)
    loose[mesh.faces] = False
    n_loose = int(loose.sum())
    if n_loose:
        raise DegenerateMeshError(f"every vertex must be in a face, got {n_loose} that are in none")
