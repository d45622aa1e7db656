"""SD-GDM: the spectrum of the geodesic distance matrix of a surface."""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.options import Scale
from pcretrieve.values import FloatArray, Signature, TriangleMesh

__all__ = ["SD_GDM", "SD_GDM_SAMPLED", "geodesic_matrix", "sd_gdm"]

# Number of faces to which a surface is simplified first, as Smeets et al. do: a closed surface of genus 0
# then has 502 vertices, and the dense matrix 502 rows.
N_FACES = 1000


def sd_gdm(
    mesh: TriangleMesh, n_values: int = 59, *, scale: Scale = "area", weighted: bool = True
) -> Signature:
    """The SD-GDM signature of a surface [1]_; requires the extra ``pcretrieve[geodesic]``.

    Returns Signature: values : (L,) float64, largest first, with μ_0, μ_1, … the eigenvalues of
        `geodesic_matrix` by descending magnitude. ``area``: ``|μ_j|`` / A^(3/2) for j = 1 … L; ``relative``:
        ``|μ_j / μ_0|``; both dimensionless, invariant to isometry and scaling. ``absolute``: ``|μ_j|``, unit
        length³.

    References
    ----------
    .. [1] D. Smeets, J. Hermans, D. Vandermeulen and P. Suetens, "Isometric deformation invariant 3D shape
       recognition", Pattern Recognition 45 (2012).
    """
    mu = np.sort(np.abs(np.linalg.eigvalsh(geodesic_matrix(mesh, weighted=weighted))))[::-1]
    if not 1 <= n_values < len(mu):
        raise DegenerateMeshError(
            f"{n_values} values need a surface of at least {n_values + 1} vertices, got {len(mu)}: "
            "use a finer surface or fewer values"
        )
    values: FloatArray = mu[1 : n_values + 1]  # (L,)
    unit = {"relative": mu[0], "area": mesh.area**1.5, "absolute": 1.0}[scale]
    kind = "sd-gdm" if weighted else "sd-gdm-sampled"
    return Signature(values / unit, kind=kind, digest=f"L={n_values} {scale}")


SD_GDM = Descriptor(
    name="sd-gdm",
    make=lambda shape, o: sd_gdm(shape.mesh, o.n_values, scale=o.measured_by),
    needs=("mesh",),
    spread=0.48,
)

SD_GDM_SAMPLED = Descriptor(
    name="sd-gdm-sampled",
    make=lambda shape, o: sd_gdm(shape.mesh, o.n_values, scale=o.measured_by, weighted=False),
    needs=("mesh",),
    spread=0.45,
)


def geodesic_matrix(mesh: TriangleMesh, *, weighted: bool = True) -> FloatArray:
    """The matrix √M D √M of the integral operator whose kernel is the geodesic distance.

    D holds the geodesic distances between the vertices of the simplified surface, and M is its lumped mass
    matrix. Smeets et al. take the eigenvalues of D, in which densely sampled parts of a surface weigh more;
    up to a factor they are those of the matrix with each of the n vertices weighing A / n (`weighted` false).
    The distances are computed by the heat method [1]_ and averaged over the two directions; see
    docs/decisions.md, geodesic_matrix, for other methods.

    Returns (n, n) float64: symmetric, zero on the diagonal, unit length³. n is the number of vertices after
        simplification to at most 1000 faces.

    References
    ----------
    .. [1] K. Crane, C. Weischedel and M. Wardetzky, "Geodesics in heat", ACM Transactions on Graphics 32
       (2013).
    """
    try:
        from potpourri3d import MeshHeatMethodDistanceSolver
    except ImportError as error:
        raise OptionError(
            "sd-gdm needs potpourri3d, which is not installed: pip install pcretrieve[geodesic]"
        ) from error

    # Imported here because the module's numba functions are compiled on import,
    # which no other descriptor needs.
    from pcretrieve.surface.simplify import simplified

    coarse = simplified(mesh, N_FACES) if len(mesh.faces) > N_FACES else mesh
    solver = MeshHeatMethodDistanceSolver(coarse.vertices, coarse.faces)
    distances = np.array(
        [solver.compute_distance(vertex) for vertex in range(len(coarse.vertices))]
    )  # (n, n)
    corners = np.repeat(coarse.face_areas / 3, 3)  # (3m,)
    areas = np.bincount(coarse.faces.ravel(), corners, len(coarse.vertices))  # (n,)
    weights = np.sqrt(areas if weighted else np.full_like(areas, areas.mean()))  # (n,)
    matrix: FloatArray = np.outer(weights, weights) * (distances + distances.T) / 2
    return matrix
