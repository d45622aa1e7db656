"""The intrinsic Delaunay Laplacian: linear elements on a better triangulation of the same surface."""

from __future__ import annotations

import numpy as np

from pcretrieve.adapters.robust_laplacian import tufted_matrices
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.spectral.elements import Assembled, check_vertices, sides_of
from pcretrieve.types import TriangleMesh

__all__ = ["intrinsic_delaunay"]


def intrinsic_delaunay(mesh: TriangleMesh) -> Assembled:
    """Linear elements on the intrinsic Delaunay triangulation of the tufted cover [1]_.

    Row i is vertex i; mass is lumped. Edges are flipped within the surface, which stays what it is, until no
    entry of the stiffness off the diagonal is positive: the maximum principle holds, however thin the
    triangles, and errors stay of order 2. On a surface that is Delaunay already it is that of linear
    elements. Any triangles will do: edges with three faces and more, faces that disagree on the side, one
    face twice. A face without area gets about a thousandth of its longest side squared: where there is one,
    every side of the surface is made longer by up to 1e-5 of the mean one.

    Returns
    -------
    Assembled
        S symmetric positive semi-definite, dimensionless, its null space the constants of each component; M
        symmetric positive definite, unit length². S·1 = 0 and 1ᵀM·1 = area, but for flat faces.

    Raises
    ------
    DegenerateMeshError
        If there are no faces, a vertex without a face, a face that names a vertex twice, or no area at all.

    References
    ----------
    .. [1] N. Sharp and K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum
       39(5), 2020.
    """
    check_vertices(mesh)
    folded = int((mesh.faces == np.roll(mesh.faces, 1, axis=1)).any(axis=1).sum())
    if folded:
        raise DegenerateMeshError(f"every face must have three corners, got {folded} that name one twice")
    if mesh.flat_faces.all():
        raise DegenerateMeshError("a surface must have an area, got only faces without")
    try:
        stiffness, mass = tufted_matrices(mesh.vertices, mesh.faces)
    except RuntimeError as error:
        raise DegenerateMeshError(f"the surface has no intrinsic Delaunay triangulation: {error}") from error
    sides = sides_of(mesh)
    boundary = np.zeros(len(mesh.vertices), dtype=bool)
    on_boundary = sides.use[sides.edge] == 1  # (m, 3)
    boundary[mesh.faces[on_boundary]] = boundary[np.roll(mesh.faces, -1, axis=1)[on_boundary]] = True
    return Assembled(stiffness, mass, boundary)
