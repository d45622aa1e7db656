"""The intrinsic Delaunay Laplacian: linear elements on another triangulation of the same surface."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.spectral.elements import Assembled, Element, check_vertices, sides_of
from pcretrieve.values import TriangleMesh


def intrinsic_delaunay(mesh: TriangleMesh) -> Assembled:
    """Stiffness and lumped mass of linear elements on the intrinsic Delaunay triangulation [1]_.

    Edges are flipped within the surface, whose geometry does not change, until the triangulation is Delaunay.
    No off-diagonal entry of the stiffness matrix is then positive, so that the maximum principle holds for
    triangles of any shape, and the order of the error remains 2. If the triangulation is Delaunay from the
    beginning, the stiffness matrix is that of `linear`. The flips are made in the tufted cover, which is a
    manifold for every mesh: also with non-manifold edges, inconsistent orientation or duplicate faces.

    Returns Assembled: matrices of n rows, one for each vertex. S is symmetric positive semi-definite,
        dimensionless, S·1 = 0, and its null space is spanned by the constants on the components. M is
        diagonal and positive, unit length²; 1ᵀM·1 = area, if there are no degenerate faces.

    References
    ----------
    .. [1] N. Sharp and K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum
       39(5), 2020.
    """
    from robust_laplacian import mesh_laplacian

    check_vertices(mesh)
    folded = int((mesh.faces == np.roll(mesh.faces, 1, axis=1)).any(axis=1).sum())
    if folded:
        raise DegenerateMeshError(f"every face must have three corners, got {folded} that name one twice")
    if mesh.flat_faces.all():
        raise DegenerateMeshError("a surface must have an area, got only faces without")
    try:
        stiffness, mass = mesh_laplacian(mesh.vertices, mesh.faces)
    except RuntimeError as error:
        raise DegenerateMeshError(f"the surface has no intrinsic Delaunay triangulation: {error}") from error
    sides = sides_of(mesh)
    boundary = np.zeros(len(mesh.vertices), dtype=bool)
    on_boundary = sides.use[sides.edge] == 1  # (m, 3)
    boundary[mesh.faces[on_boundary]] = boundary[np.roll(mesh.faces, -1, axis=1)[on_boundary]] = True
    return Assembled(csc_array(stiffness), csc_array(mass), boundary)


INTRINSIC_DELAUNAY = Element("intrinsic-delaunay", intrinsic_delaunay, masses=("lumped",))
