"""BiHDM: the spectrum of the squared biharmonic distance, without reduction to the modal space.

Equation numbers and symbols are those of `pcretrieve.descriptors.r_bihdm`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, check_modes, spectrum_of
from pcretrieve.descriptors.r_bihdm import leading, reduced_matrix
from pcretrieve.errors import DegenerateMeshError, OptionError
from pcretrieve.options import Scale, SignatureOptions
from pcretrieve.values import Eigenpairs, FloatArray, ModalSpectrum, Shape, Signature, TriangleMesh


def bihdm(
    pairs: Eigenpairs | ModalSpectrum,
    n_values: int = 23,
    n_modes: int = 60,
    *,
    scale: Scale = "area",
) -> Signature:
    """The BiHDM signature of a surface: equation (8), with the sum over m modes.

    Returns Signature: values : (L,) float64, in the units of `r_bihdm`. BiHDM and R-BiHDM converge to each
        other as m grows, since they differ by the part of g = Σ φ_i²/λ_i² outside the span of the first m
        modes.
    """
    matrix = full_matrix(pairs, n_modes)
    values = leading(matrix, n_values, n_modes, scale, pairs.area)
    return Signature(values, kind="bihdm", digest=f"L={n_values} m={n_modes} {scale}")


BIHDM = Descriptor(
    name="bihdm",
    make=lambda shape, o: bihdm(spectrum_of(shape, o), o.n_values, o.n_modes, scale=o.scale),
    needs=("spectrum", "overlaps"),
    spread=1.04,
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
    values = leading(matrix, n_values, n_modes, scale, pairs.area)
    return Signature(values, kind="bihdm-sampled", digest=f"L={n_values} m={n_modes} {scale}")


def _bihdm_sampled(shape: Shape, o: SignatureOptions) -> Signature:
    made = bihdm_sampled(shape.eigenpairs, o.n_values, o.n_modes, scale=o.scale)
    # The eigenpairs of a shape are those at unit area, and the matrix scales as length⁴.
    return replace(made, values=made.values * shape.area**2) if o.scale == "absolute" else made


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


def full_matrix(pairs: Eigenpairs | ModalSpectrum, n_modes: int = 60) -> FloatArray:
    """The matrix of the squared biharmonic distance, summed over m modes, on all of L²(M).

    With g = Σ φ_i²/λ_i² the kernel is d²(x, y) = g(x) + g(y) − 2 Σ φ_i(x) φ_i(y)/λ_i². Its range is the span
    of 1, g and φ_1 … φ_m, so its rank is at most m + 2. An orthonormal basis of this span is φ_0 … φ_m and
    the normalised residual of g after projection onto φ_0 … φ_m. In this basis the operator is the arrowhead
    matrix of `reduced_matrix`, bordered by one more row and column with

        a_{m+1} = √A ‖g − Σ ⟨g, φ_j⟩ φ_j‖,    K_{m+1,m+1} = 0.

    The entry a_{m+1} is the norm of all a_j with j > m of equation (7). The eigenvalues of this finite matrix
    are exactly the non-zero eigenvalues of the operator.

    Returns (m + 2, m + 2) float64: symmetric, unit length⁴.
    """
    spectrum = pairs if isinstance(pairs, ModalSpectrum) else ModalSpectrum.of(pairs)
    matrix = np.pad(reduced_matrix(spectrum, n_modes), (0, 1))  # (m + 2, m + 2)
    inner = slice(1, n_modes + 1)
    weights = spectrum.eigenvalues[inner] ** -2  # (m,): 1/λ_i²
    in_modes = weights @ spectrum.moments[inner, : n_modes + 1]  # (m + 1,): ⟨g, φ_j⟩
    squared = weights @ spectrum.known_overlaps()[inner, inner] @ weights  # ⟨g, g⟩
    left = np.sqrt(
        np.maximum(squared - in_modes @ in_modes, 0)
    )  # clipped: rounding can make it negative
    matrix[0, -1] = matrix[-1, 0] = np.sqrt(spectrum.area) * left
    return matrix


# Number of faces to which a surface is simplified first, as Smeets et al. do: a closed surface of genus 0
# then has 502 vertices, and the dense matrix 502 rows.
N_FACES = 1000


def sd_gdm(
    mesh: TriangleMesh, n_values: int = 23, *, scale: Scale = "area", weighted: bool = True
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


def _sd_gdm(name: str, spread: float, *, weighted: bool) -> Descriptor:
    return Descriptor(
        name=name,
        make=lambda shape, o: sd_gdm(shape.mesh, o.n_values, scale=o.scale, weighted=weighted),
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
    from pcretrieve.surface.simplify import simplified

    coarse = simplified(mesh, N_FACES) if len(mesh.faces) > N_FACES else mesh
    solver = MeshHeatMethodDistanceSolver(coarse.vertices, coarse.faces)
    n = len(coarse.vertices)
    distances = np.array([solver.compute_distance(vertex) for vertex in range(n)])  # (n, n)
    corners = np.repeat(coarse.face_areas / 3, 3)  # (3m,)
    areas = np.bincount(coarse.faces.ravel(), corners, n)  # (n,)
    weights = np.sqrt(areas if weighted else np.full_like(areas, areas.mean()))  # (n,)
    return np.asarray(np.outer(weights, weights) * (distances + distances.T) / 2)
