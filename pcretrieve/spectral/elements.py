"""The record that declares an element: a discretisation of the Laplace–Beltrami operator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array

from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.values import FloatArray, TriangleMesh

Mass = Literal["consistent", "lumped"]


class Assembled(NamedTuple):
    """The stiffness matrix, the mass matrix, and a mask of the rows whose nodes are on the boundary."""

    stiffness: csc_array
    mass: csc_array
    boundary: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Element:
    """The declaration of an element, beside its function in pcretrieve or in another package.

    Attributes
    ----------
    name : str
        Value of the option `spectral.element`.
    assemble : function of TriangleMesh, or of PointCloud, that returns Assembled
        The matrices with natural (Neumann) boundary conditions, S symmetric positive semi-definite and
        invariant to scaling, M symmetric positive definite with 1ᵀM·1 = area, as in `LaplaceBeltrami`; the
        mask may be all false for a cloud.
    needs : {"mesh", "points"}, default "mesh"
        What `assemble` is called with. For ``points``, no surface is reconstructed from a scan, and the
        boundary condition ``dirichlet`` is refused.
    masses : tuple of {"consistent", "lumped"}, default ("consistent", "lumped")
        The mass matrices that are available, first the default. Lumped mass is the diagonal of the row sums.

    Raises
    ------
    OptionError
        If `needs` or `masses` has another value.
    """

    name: str
    assemble: Callable[[Any], Assembled]
    needs: Literal["mesh", "points"] = "mesh"
    masses: tuple[Mass, ...] = ("consistent", "lumped")

    def __post_init__(self) -> None:
        if self.needs not in ("mesh", "points"):
            raise OptionError(f"needs of an element must be 'mesh' or 'points', got {self.needs!r}")
        if not self.masses or not set(self.masses) <= set(get_args(Mass)):
            known = ", ".join(get_args(Mass))
            raise OptionError(f"masses of an element must be one or both of {known}, got {self.masses!r}")


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


LINEAR_REFERENCE = ReferenceElement(
    along=np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]),
    mass=np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 12,  # J4 of Table 6
    turn=np.array([1, 2, 0]),
    side=np.array([0, 1]),
)


def linear(mesh: TriangleMesh) -> Assembled:
    """Stiffness and mass of continuous functions that are linear on each face [1]_, Appendix C, Table 6.

    The stiffness matrix is the cotangent matrix. The eigenvalues converge with order 2 in the edge length.
    With consistent mass on a flat surface they are upper bounds of the exact eigenvalues.

    Returns Assembled: matrices of n rows, one for each vertex. S is symmetric positive semi-definite,
        dimensionless, S·1 = 0, and its null space is spanned by the constants on the components. M is
        symmetric positive definite, unit length², 1ᵀM·1 = area.

    References
    ----------
    .. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
       Computer 32 (2016).
    """
    check_faces(mesh)
    return assembled(mesh, mesh.faces, LINEAR_REFERENCE, sides_of(mesh))


LINEAR = Element("linear", linear)


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
