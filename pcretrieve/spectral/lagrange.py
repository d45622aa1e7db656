"""Lagrange finite elements on a triangulated surface: reference matrices, and assembly of sparse matrices.

On a flat triangle of area a, let D_k be the derivative in the direction of side k, times the length of the
side, and θ_k the angle opposite to side k. The gradients of the barycentric coordinates λ_i sum up to zero,
and ∇λ_i·∇λ_j = −cot θ_k / (2a) for the side k between corners i and j. Hence for every function u

    ∫ |∇u|² = Σ_k ½ cot θ_k · (1/a) ∫ (D_k u)²,

and the stiffness matrix of a triangle is Σ_k ½ cot θ_k C_k for every Lagrange element, with reference
matrices C_k of rational numbers. Ye and Yu [1]_ write this sum with squared side lengths, Appendix C: their
matrices are J_k = (C_i + C_j − C_k) / 8.

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
from pcretrieve.spectral.element import Assembled
from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["Index", "ReferenceElement", "Sides", "assembled", "check_faces", "check_vertices", "sides_of"]

Index = NDArray[np.integer]


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceElement:
    """The reference matrices of a finite element with q nodes on each triangle.

    Side k is from corner k to corner k + 1 (modulo 3).

    along: (q, q) float64, c_0 = (1/a) ∫ D_0 φ_i D_0 φ_j with the basis functions φ_i, dimensionless.
    mass: (q, q) float64, (1/a) ∫ φ_i φ_j, dimensionless; J4 of Ye and Yu.
    turn: (q,) int, the permutation of the nodes under the rotation of the triangle that maps corner k to
        corner k + 1.
    side: (r,) int, the nodes on side 0, including its corners.
    """

    along: FloatArray
    mass: FloatArray
    turn: Index
    side: Index


class Sides(NamedTuple):
    """The (m, 3) edge numbers of the sides of each face, and the (e,) number of faces at each edge."""

    edge: Index
    use: Index


def sides_of(mesh: TriangleMesh) -> Sides:
    """The edges of a surface, in ascending order of the lower and then of the higher vertex number."""
    tail, head = mesh.faces.astype(np.int64), np.roll(mesh.faces, -1, axis=1)  # (m, 3) each
    key = np.minimum(tail, head) * len(mesh.vertices) + np.maximum(tail, head)
    _, edge, use = np.unique(key, return_inverse=True, return_counts=True)
    return Sides(edge.reshape(-1, 3), use)


def assembled(mesh: TriangleMesh, nodes: Index, element: ReferenceElement, sides: Sides) -> Assembled:
    """Assemble the stiffness matrix and the consistent mass matrix of an element.

    nodes: (m, q) int, node numbers of each face. Every number from 0 to the largest occurs.
    Returns Assembled: s, dimensionless, and M, unit length², with one row for each node.
    """
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    edges = np.roll(corners, -1, axis=1) - corners  # (m, 3, 3)
    area = mesh.face_areas  # (m,)
    # The angle opposite to side k is at corner k + 2, between sides k + 1 and k + 2.
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
    """The (n, n) sums of the (m, q²) matrices of all faces, for two matrices of one pattern."""
    # Assembled as the real and the imaginary part of one matrix, so that its pattern is sorted once.
    local = np.empty(one.shape, dtype=np.complex128)
    local.real, local.imag = one, other
    q = nodes.shape[1]
    rows, columns = np.repeat(nodes, q, axis=1).ravel(), np.tile(nodes, (1, q)).ravel()
    total = csc_array(coo_array((local.ravel(), (rows, columns)), shape=(n, n)))
    # Rounding depends on the order of summation where more than two faces meet: make
    # the sum symmetric exactly.
    total = csc_array((total + total.T) / 2)
    first, second = (
        csc_array((part.copy(), total.indices, total.indptr), shape=(n, n))
        for part in (total.data.real, total.data.imag)
    )
    return first, second


def check_faces(mesh: TriangleMesh) -> None:
    """Check that finite elements are defined on a mesh."""
    check_vertices(mesh)
    flat = int(mesh.flat_faces.sum())
    if flat:
        raise DegenerateMeshError(f"every face must have an area, got {flat} of {len(mesh.faces)} without")


def check_vertices(mesh: TriangleMesh) -> None:
    """Check that a mesh has faces, and that every vertex is in a face."""
    if not len(mesh.faces):
        raise DegenerateMeshError("a surface must have faces, got none")
    unused = np.ones(len(mesh.vertices), dtype=bool)
    unused[mesh.faces] = False
    n_unused = int(unused.sum())
    if n_unused:
        raise DegenerateMeshError(f"every vertex must be in a face, got {n_unused} that are in none")
