"""Linear (P1) Lagrange elements: one node at each vertex."""

from __future__ import annotations

import numpy as np

from pcretrieve.spectral.element import Assembled, Element
from pcretrieve.spectral.lagrange import ReferenceElement, assembled, check_faces, sides_of
from pcretrieve.values import TriangleMesh

__all__ = ["LINEAR", "LINEAR_REFERENCE", "linear"]

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
