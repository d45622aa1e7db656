"""Surface → stiffness and mass matrices: linear, cubic and intrinsic Delaunay elements.

A weak solution of Δφ + λφ = 0 satisfies ∫ ∇φ·∇ψ = λ ∫ φψ for all functions ψ. With a basis φ_1 … φ_n of a
space of functions this is S x = λ M x, with the stiffness matrix S_ij = ∫ ∇φ_i·∇φ_j and the mass matrix
M_ij = ∫ φ_i φ_j. An element is the choice of this space.
"""

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
Index = NDArray[np.integer]


class Assembled(NamedTuple):
    """The matrices of an element, with one row for each node and the natural (Neumann) boundary condition.

    stiffness: S, symmetric positive semi-definite, dimensionless, invariant to scaling. S·1 = 0, and the null
        space is spanned by the constants on the components.
    mass: M, symmetric positive definite; unit length². 1ᵀM·1 = area.
    boundary: (n,) bool, the nodes on the boundary; all false for a cloud.
    """

    stiffness: csc_array
    mass: csc_array
    boundary: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Element:
    """An element: one of `ELEMENTS`, or one's own, for `laplace_beltrami`.

    Attributes
    ----------
    name : str
        Value of the option `spectral.element`.
    assemble : function of TriangleMesh, or of PointCloud, that returns Assembled
        The matrices.
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
            raise OptionError(
                f"needs of an element must be 'mesh' or 'points', got {self.needs!r}"
            )
        if not self.masses or not set(self.masses) <= set(get_args(Mass)):
            known = ", ".join(get_args(Mass))
            raise OptionError(
                f"masses of an element must be one or both of {known}, got {self.masses!r}"
            )


class ReferenceElement(NamedTuple):
    """The reference matrices of a finite element with q nodes on each triangle of area a.

    Side k is from corner k to corner k + 1 (modulo 3), and D_k is the derivative along it, times its length.

    along: (q, q) float64, C_0 = (1/a) ∫ D_0 φ_i D_0 φ_j with the basis functions φ_i, dimensionless. C_1 and
        C_2 are C_0 with the nodes permuted by `turn`.
    mass: (q, q) float64, (1/a) ∫ φ_i φ_j, dimensionless; J4 of Ye and Yu [1]_, Tables 6 and 7.
    turn: (q,) int, the permutation of the nodes under the rotation of the triangle that maps corner k to
        corner k + 1.
    side: (r,) int, the nodes on side 0, including its corners.

    References
    ----------
    .. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
       Computer 32 (2016), Appendix C.
    """

    along: FloatArray
    mass: FloatArray
    turn: Index
    side: Index


def edge_keys(mesh: TriangleMesh) -> NDArray[np.int64]:
    """(m, 3) the edge at each side of a face: ascending with its lower, then its higher vertex number."""
    # (m, 3) each.
    tail, head = (mesh.faces.astype(np.int64), np.roll(mesh.faces, -1, axis=1))
    return np.minimum(tail, head) * len(mesh.vertices) + np.maximum(tail, head)


def lone_sides(mesh: TriangleMesh) -> NDArray[np.bool_]:
    """(m, 3) the sides on the boundary, where no other face is."""
    keys = edge_keys(mesh)
    edges, use = np.unique(keys, return_counts=True)  # much faster than with the inverse
    return np.isin(keys, edges[use == 1])


def assembled(mesh: TriangleMesh, nodes: Index, element: ReferenceElement) -> Assembled:
    """The sums over all faces of ½ Σ_k cot γ_k C_k and of a J4, with the angle γ_k opposite to side k.

    nodes: (m, q) int, node numbers of each face. Every number from 0 to the largest occurs.
    """
    corners = mesh.corners  # (3, 3, m): coordinate, corner, face
    edges = np.roll(corners, -1, axis=1) - corners
    area = mesh.face_areas  # (m,)
    # The angle opposite to side k is at corner k + 2, between sides k + 1 and k + 2.
    opposite = (np.roll(edges, -1, axis=1) * np.roll(edges, -2, axis=1)).sum(
        axis=0
    )  # (3, m)
    half_cotangents = np.ascontiguousarray((-opposite / (4 * area)).T)  # (m, 3)

    boundary, lone = np.zeros(int(nodes.max()) + 1, dtype=bool), lone_sides(mesh)
    along, side, back = [element.along], element.side, np.argsort(element.turn)
    for k in range(3):
        boundary[nodes[lone[:, k]][:, side]] = True
        along.append(along[k][np.ix_(back, back)])
        side = element.turn[side]
    stiffness, mass = _summed(
        nodes, half_cotangents, np.array(along[:3]), area, element.mass
    )
    return Assembled(stiffness, mass, boundary)


def _summed(
    nodes: Index,
    half_cotangents: FloatArray,
    along: FloatArray,
    area: FloatArray,
    mass: FloatArray,
) -> tuple[csc_array, csc_array]:
    """The sums of the element matrices of all faces: Σ_k (m, 3) · (3, q, q), and (m,) · (q, q)."""
    # Assembled as the real and the imaginary part of one matrix, so that its pattern is sorted once, and as
    # half of each symmetric element matrix: the sum with the transpose is symmetric in spite of rounding.
    one, two = np.triu_indices(nodes.shape[1])
    half = np.where(one == two, 0.5, 1.0)
    local = np.empty((len(nodes), len(half)), dtype=np.complex128)
    local.real = half_cotangents @ (along[:, one, two] * half)
    local.imag = area[:, None] * (mass[one, two] * half)
    n = int(nodes.max()) + 1
    total = coo_array(
        (local.ravel(), (nodes[:, one].ravel(), nodes[:, two].ravel())), shape=(n, n)
    ).tocsc()
    total = csc_array(total + total.T)
    real, imaginary = (
        csc_array((part.copy(), total.indices, total.indptr), shape=(n, n))
        for part in (total.data.real, total.data.imag)
    )
    return real, imaginary


def check_faces(mesh: TriangleMesh) -> None:
    """Check that finite elements are defined on a mesh."""
    check_vertices(mesh)
    flat = int(mesh.flat_faces.sum())
    if flat:
        raise DegenerateMeshError(
            f"every face must have an area, got {flat} of {len(mesh.faces)} without"
        )


def check_vertices(mesh: TriangleMesh) -> None:
    """Check that a mesh has faces, and that every vertex is in a face."""
    if not len(mesh.faces):
        raise DegenerateMeshError("a surface must have faces, got none")
    unused = np.ones(len(mesh.vertices), dtype=bool)
    unused[mesh.faces] = False
    n_unused = int(unused.sum())
    if n_unused:
        raise DegenerateMeshError(
            f"every vertex must be in a face, got {n_unused} that are in none"
        )


LINEAR_REFERENCE = ReferenceElement(
    along=np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]),
    mass=np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 12,
    turn=np.array([1, 2, 0]),
    side=np.array([0, 1]),
)


def linear(mesh: TriangleMesh) -> Assembled:
    """The matrices of continuous functions that are linear on each face, with one node for each vertex.

    The stiffness matrix is the cotangent matrix. The eigenvalues converge with order 2 in the edge length.
    With consistent mass on a flat surface they are upper bounds of the exact eigenvalues.
    """
    check_faces(mesh)
    return assembled(mesh, mesh.faces, LINEAR_REFERENCE)


LINEAR = Element("linear", linear)


# The nodes are the corners 0, 1, 2; two on each side, at one third and two thirds of it; and the centre. The
# entries are exact rationals, which tests/spectral/test_cubic.py derives from the basis functions.
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
    """The matrices of continuous functions that are cubic on each face, with about 9 nodes for each vertex.

    The eigenvalues of a flat surface converge with order 6 in the edge length; with lumped mass, with order
    4. On a curved surface the flat faces limit the order to 2.
    """
    check_faces(mesh)
    return assembled(mesh, cubic_nodes(mesh), CUBIC_REFERENCE)


CUBIC = Element("cubic", cubic)


def cubic_nodes(mesh: TriangleMesh) -> Index:
    """(m, 10) numbers of the nodes of each face, in the order of `CUBIC_REFERENCE`.

    With n vertices and e edges, node i is vertex i; nodes n + 2 j and n + 2 j + 1 are on edge j, the first
    nearer to the vertex of lower number; node n + 2 e + f is the centre of face f.
    """
    n, m = len(mesh.vertices), len(mesh.faces)
    edges, edge = np.unique(edge_keys(mesh), return_inverse=True)
    first = n + 2 * edge.reshape(m, 3)
    # The two faces at an edge traverse it in opposite directions, but must number its nodes equally.
    down = mesh.faces > np.roll(mesh.faces, -1, axis=1)  # (m, 3)
    on_sides = np.stack([first + down, first + ~down], axis=2).reshape(m, 6)
    centre = n + 2 * len(edges) + np.arange(m)
    # int32 halves the memory of the indices of the matrices, which have 100 entries for each face.
    return np.column_stack([mesh.faces, on_sides, centre]).astype(np.int32)


def intrinsic_delaunay(mesh: TriangleMesh) -> Assembled:
    """The matrices of linear elements on the intrinsic Delaunay triangulation [1]_, with lumped mass.

    Edges are flipped within the surface, whose geometry does not change, until the triangulation is Delaunay.
    No off-diagonal entry of the stiffness matrix is then positive, so that the maximum principle holds for
    triangles of any shape, and the order of the error remains 2. If the triangulation is Delaunay from the
    beginning, the stiffness matrix is that of `linear`. The flips are made in the tufted cover, which is a
    manifold for every mesh: also with non-manifold edges, inconsistent orientation or duplicate faces.

    References
    ----------
    .. [1] N. Sharp and K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum
       39(5), 2020.
    """
    from robust_laplacian import mesh_laplacian

    check_vertices(mesh)
    folded = int((mesh.faces == np.roll(mesh.faces, 1, axis=1)).any(axis=1).sum())
    if folded:
        raise DegenerateMeshError(
            f"every face must have three corners, got {folded} that name one twice"
        )
    if mesh.flat_faces.all():
        raise DegenerateMeshError("a surface must have an area, got only faces without")
    try:
        stiffness, mass = mesh_laplacian(mesh.vertices, mesh.faces)
    except RuntimeError as error:
        raise DegenerateMeshError(
            f"the surface has no intrinsic Delaunay triangulation: {error}"
        ) from error
    boundary, lone = np.zeros(len(mesh.vertices), dtype=bool), lone_sides(mesh)
    boundary[mesh.faces[lone]] = boundary[np.roll(mesh.faces, -1, axis=1)[lone]] = True
    return Assembled(csc_array(stiffness), csc_array(mass), boundary)


INTRINSIC_DELAUNAY = Element("intrinsic-delaunay", intrinsic_delaunay, masses=("lumped",))
