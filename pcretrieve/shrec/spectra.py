"""Spectra of other matrices of distances, and Shape-DNA as it was entered for SHREC'11.

SD-GDM takes geodesic distances, BiHDM by the Nyström method biharmonic distances between sample points.
Symbols are those of `pcretrieve.descriptors.r_bihdm`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, check_modes
from pcretrieve.descriptors.r_bihdm import leading
from pcretrieve.descriptors.shape_dna import shape_dna
from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.options import Scale, SignatureOptions
from pcretrieve.values import (
    Eigenpairs,
    FloatArray,
    ModalSpectrum,
    Shape,
    Signature,
    TriangleMesh,
)


def bihdm_sampled(
    pairs: Eigenpairs, n_values: int = 23, n_modes: int = 60, *, scale: Scale = "area"
) -> Signature:
    """The BiHDM signature by the matrix of distances between sample points, without weights.

    Equation (8) as the authors compute it, by the Nyström method: the operator is replaced by the matrix of
    the squared biharmonic distances between sample points, here all vertices. Densely sampled parts of a
    surface weigh more, for which rankings are worse. `bihdm` is the exact limit of infinitely many points,
    evenly spread; its rankings are as good as those of R-BiHDM.

    Returns Signature: values : (L,) float64, in the units of `r_bihdm`.
    """
    matrix = sampled_matrix(pairs, n_modes)
    return leading("bihdm-sampled", matrix, n_values, n_modes, scale, pairs.area)


def _bihdm_sampled(shape: Shape, o: SignatureOptions) -> Signature:
    made = bihdm_sampled(shape.eigenpairs, o.n_values, o.n_modes, scale=o.scale)
    # The eigenpairs of a shape are those at unit area, and the matrix scales as length⁴.
    return (
        replace(made, values=made.values * shape.area**2)
        if o.scale == "absolute"
        else made
    )


BIHDM_SAMPLED = Descriptor(
    name="bihdm-sampled", make=_bihdm_sampled, needs=("eigenvectors",), spread=1.01
)


def sampled_matrix(pairs: Eigenpairs, n_modes: int = 60) -> FloatArray:
    """(m + 2, m + 2) matrix of the squared distances between vertices, restricted to its range; length⁴.

    With the rows φ_i(x)/λ_i of V and g(x) = |V(x)|², the matrix is g 1ᵀ + 1 gᵀ − 2 V Vᵀ = B C Bᵀ, where B has
    the columns 1, g and V. If B = Q R with orthonormal columns of Q, R C Rᵀ has its non-zero eigenvalues. It
    is multiplied by A / n, the area for each of the n vertices.
    """
    check_modes(n_modes, len(pairs.eigenvalues))
    inner = slice(1, n_modes + 1)
    places = pairs.eigenvectors[:, inner] / pairs.eigenvalues[inner]  # (n, m): V
    green = (places**2).sum(axis=1)  # (n,): g
    _, factor = np.linalg.qr(
        np.column_stack([np.ones_like(green), green, places])
    )  # (m + 2, m + 2)
    middle = np.diag([0.0, 0.0] + [-2.0] * n_modes)  # (m + 2, m + 2): C
    middle[0, 1] = middle[1, 0] = 1
    matrix = factor @ middle @ factor.T * (pairs.area / len(green))
    return np.asarray((matrix + matrix.T) / 2)  # up to rounding errors the same


# Number of faces to which a surface is simplified first, as Smeets et al. do: a closed surface of genus 0
# then has 502 vertices, and the dense matrix 502 rows.
N_FACES = 1000


def sd_gdm(
    mesh: TriangleMesh,
    n_values: int = 23,
    *,
    scale: Scale = "area",
    weighted: bool = True,
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
    mu = np.sort(np.abs(np.linalg.eigvalsh(geodesic_matrix(mesh, weighted=weighted))))[
        ::-1
    ]
    if not 1 <= n_values < len(mu):
        raise DegenerateMeshError(
            f"{n_values} values need a surface of at least {n_values + 1} vertices, got {len(mu)}: "
            "use a finer surface or fewer values"
        )
    values: FloatArray = mu[1 : n_values + 1]  # (L,)
    unit = {"relative": mu[0], "area": mesh.area**1.5, "absolute": 1.0}[scale]
    kind = "sd-gdm" if weighted else "sd-gdm-sampled"
    return Signature(values / unit, kind=kind, digest=f"L={n_values} {scale}")


def _sd_gdm(name: str, spread: float, *, weighted: bool) -> Descriptor:
    return Descriptor(
        name=name,
        make=lambda shape, o: sd_gdm(
            shape.mesh, o.n_values, scale=o.scale, weighted=weighted
        ),
        needs=("mesh",),
        spread=spread,
    )


SD_GDM = _sd_gdm("sd-gdm", 0.48, weighted=True)
SD_GDM_SAMPLED = _sd_gdm("sd-gdm-sampled", 0.45, weighted=False)


def geodesic_matrix(mesh: TriangleMesh, *, weighted: bool = True) -> FloatArray:
    """The matrix √M D √M of the integral operator whose kernel is the geodesic distance.

    D holds the geodesic distances between the vertices of the simplified surface, and M is its lumped mass
    matrix. Smeets et al. take the eigenvalues of D, in which densely sampled parts of a surface weigh more;
    up to a factor they are those of the matrix with each of the n vertices weighing A / n (`weighted` false).
    The distances are computed by the heat method [1]_ and averaged over the two directions.

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

    # Imported here, because its compiled functions are loaded on import, which no other descriptor needs.
    from pcretrieve.values.simplify import simplified

    coarse = simplified(mesh, N_FACES) if len(mesh.faces) > N_FACES else mesh
    solver = MeshHeatMethodDistanceSolver(coarse.vertices, coarse.faces)
    n = len(coarse.vertices)
    distances = np.array(
        [solver.compute_distance(vertex) for vertex in range(n)]
    )  # (n, n)
    corners = np.repeat(coarse.face_areas / 3, 3)  # (3m,)
    areas = np.bincount(coarse.faces.ravel(), corners, n)  # (n,)
    weights = np.sqrt(areas if weighted else np.full_like(areas, areas.mean()))  # (n,)
    return np.asarray(np.outer(weights, weights) * (distances + distances.T) / 2)


def shape_dna_values(pairs: Eigenpairs | ModalSpectrum, n_values: int = 23) -> Signature:
    """Shape-DNA as it was entered for SHREC'11, to be compared by the Euclidean distance of its values.

    With 11 values it is the run OrigM-n12-norm1 [1]_, the best of Shape-DNA: 12 eigenvalues of the original
    meshes, divided by the first of them. The factors 1/j, by Weyl's law, are what reproduces its published
    measures.

    References
    ----------
    .. [1] Z. Lian et al., "SHREC'11 track: shape retrieval on non-rigid 3D watertight meshes", Eurographics
       Workshop on 3D Object Retrieval 2011.
    """
    made = shape_dna(pairs, n_values, normalized_by="first")
    values = 1 / (made.values * np.arange(2, n_values + 2))
    return Signature(
        values, kind="shape-dna-norm1-values", digest=made.digest, metric="values"
    )


SHAPE_DNA_NORM1 = Descriptor(
    name="shape-dna-norm1",
    make=lambda shape, o: shape_dna(shape.spectrum, o.n_values, normalized_by="first"),
    needs=("spectrum",),
    has_size=False,
    spread=0.76,
)

SHAPE_DNA_VALUES = Descriptor(
    name="shape-dna-norm1-values",
    make=lambda shape, o: shape_dna_values(shape.spectrum, o.n_values),
    needs=("spectrum",),
    has_size=False,
    metric="values",
    spread=2.5,
)
