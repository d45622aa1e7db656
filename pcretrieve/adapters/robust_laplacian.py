"""robust_laplacian, as a function of arrays."""

from __future__ import annotations

from scipy.sparse import csc_array

from pcretrieve.arrays import FloatArray, IntArray

__all__ = ["tufted_matrices"]


def tufted_matrices(vertices: FloatArray, faces: IntArray) -> tuple[csc_array, csc_array]:
    """The tufted intrinsic Delaunay Laplacian [1]_ of any triangle mesh.

    vertices: (n, 3) float64, coordinates.
    faces: (m, 3) int32, vertex numbers of each face; the mesh may have any connectivity.
    Returns stiffness : (n, n) sparse: symmetric positive semi-definite, dimensionless.
    Returns mass : (n, n) sparse: diagonal, unit length².

    References
    ----------
    .. [1] N. Sharp and K. Crane, "A Laplacian for nonmanifold triangle meshes", Computer Graphics Forum
       39(5), 2020.
    """
    from robust_laplacian import mesh_laplacian

    stiffness, mass = mesh_laplacian(vertices, faces)
    return csc_array(stiffness), csc_array(mass)
