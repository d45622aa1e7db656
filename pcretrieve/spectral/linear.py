"""Linear (P1) finite elements: one node at each vertex."""

from __future__ import annotations

import numpy as np

from pcretrieve.spectral.elements import Assembled, Element, assembled, check_faces, sides_of
from pcretrieve.types import TriangleMesh

__all__ = ["LINEAR", "linear"]

LINEAR = Element(
    along=np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]]),
    mass=np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 12,  # J4 of Table 6
    turn=np.array([1, 2, 0]),
    side=np.array([0, 1]),
)


def linear(mesh: TriangleMesh) -> Assembled:
    """Continuous functions, linear on each face [1]_, Appendix C, Table 6.

    Row i is vertex i. The stiffness is the cotangent matrix: exact for linear functions, its eigenvalues of
    order 2 in the edge length and, with consistent mass on a flat surface, never below the true ones.

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
    return assembled(mesh, mesh.faces, LINEAR, sides_of(mesh))
