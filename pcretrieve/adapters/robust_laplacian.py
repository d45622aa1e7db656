"""robust_laplacian, as a function on arrays."""

from __future__ import annotations

from scipy.sparse import csc_array

from pcretrieve.types import FloatArray, IntArray

__all__ = ["tufted_matrices"]


def tufted_matrices(vertices: FloatArray, faces: IntArray) -> tuple[csc_array, csc_array]:
    """(n, n) stiffness and diagonal mass on the vertices of any triangles.

    Raises
    ------
    RuntimeError
        Where the library gives up.
    """
    from robust_laplacian import mesh_laplacian

    stiffness, mass = mesh_laplacian(vertices, faces)
    return csc_array(stiffness), csc_array(mass)
