"""Linear (P1) finite elements on a triangulated surface."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.csgraph import connected_components

from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.types import LaplaceBeltrami, TriangleMesh

__all__ = ["laplace_beltrami"]

# ∫ φ_i φ_j over a triangle, in units of its area: J4 of Table 6.
REFERENCE_MASS = np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 12


def laplace_beltrami(
    mesh: TriangleMesh,
    element: Literal["linear"] = "linear",
    *,
    mass: Literal["consistent", "lumped"] = "consistent",
) -> LaplaceBeltrami:
    """Stiffness and mass matrix of a surface.

    Parameters
    ----------
    mesh : TriangleMesh
        n vertices, each of them in some face; boundaries are allowed and get the natural (Neumann)
        condition.
    element : {"linear"}, default "linear"
        Continuous piecewise linear functions, one per vertex [1]_, Appendix C, Table 6.
    mass : {"consistent", "lumped"}, default "consistent"
        ∫ φ_i φ_j, or its row sums on the diagonal. Lumped mass makes the reduced matrix of R-BiHDM equal
        the dense kernel exactly; consistent mass gives better eigenvalues.

    Returns
    -------
    LaplaceBeltrami
        S symmetric positive semi-definite with S·1 = 0, dimensionless, unchanged by scaling; M symmetric
        positive definite with 1ᵀM·1 = area, scaling as length². Eigenvalues scale as length⁻².

    Raises
    ------
    OptionError
        If `element` or `mass` is none of these.
    DegenerateMeshError
        If there are no faces, a vertex without a face, or a face without area.

    References
    ----------
    .. [1] J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual
       Computer 32 (2016).
    """
    if element != "linear":
        raise OptionError(f"element must be 'linear', got {element!r}")
    if mass not in ("consistent", "lumped"):
        raise OptionError(f"mass must be 'consistent' or 'lumped', got {mass!r}")
    _check_faces(mesh)
    faces, n = mesh.faces, len(mesh.vertices)
    corners = mesh.vertices[faces]  # (m, 3, 3)
    # Edge k runs opposite corner k, so that ∇φ_k is edge k turned by 90° over twice the area, and
    # ∫ ∇φ_i·∇φ_j = e_i·e_j / (4 area).
    edges = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # (m, 3, 3)
    area = mesh.face_areas  # (m,)
    local_stiffness = np.einsum("tik,tjk->tij", edges, edges) / (4 * area[:, None, None])  # (m, 3, 3)
    local_mass = area[:, None, None] * REFERENCE_MASS  # (m, 3, 3)

    rows = np.repeat(faces, 3, axis=1).ravel()
    columns = np.tile(faces, (1, 3)).ravel()
    stiffness = csc_array(coo_array((local_stiffness.ravel(), (rows, columns)), shape=(n, n)))
    consistent = csc_array(coo_array((local_mass.ravel(), (rows, columns)), shape=(n, n)))
    return LaplaceBeltrami(
        stiffness=stiffness,
        mass=consistent if mass == "consistent" else csc_array(diags_array(consistent.sum(axis=1))),
        # By the mass, whose entries are positive: between right angles an edge has no stiffness.
        n_components=connected_components(consistent, directed=False)[0],
    )


def _check_faces(mesh: TriangleMesh) -> None:
    if not len(mesh.faces):
        raise DegenerateMeshError("a surface must have faces, got none")
    n_loose = len(mesh.vertices) - len(np.unique(mesh.faces))
    if n_loose:
        raise DegenerateMeshError(f"every vertex must be in a face, got {n_loose} that are in none")
    flat = int(mesh.flat_faces.sum())
    if flat:
        raise DegenerateMeshError(f"every face must have an area, got {flat} of {len(mesh.faces)} without")
