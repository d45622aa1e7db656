"""R-BiHDM: the spectrum of the reduced biharmonic distance matrix of a surface.

Equation numbers are those of J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape
retrieval", The Visual Computer 32 (2016), section 2.

Let M be a connected surface of area A. Let 0 = λ_0 < λ_1 ≤ λ_2 ≤ … be the eigenvalues of its Laplace–Beltrami
operator, −Δ φ_i = λ_i φ_i (1), and φ_0 = 1/√A, φ_1, φ_2, … its eigenfunctions, orthonormal in L²(M). The
squared biharmonic distance

    d²(x, y) = Σ_{i ≥ 1} (φ_i(x) − φ_i(y))² / λ_i²                          (4)

is the kernel of the integral operator (𝒦 f)(y) = ∫ d²(x, y) f(x) dx (2). In the basis of the eigenfunctions
this operator is the arrowhead matrix (3)

          ⎡ a_0     a_1       a_2     …  ⎤        a_0 = Σ 2/λ_i²
    K  =  ⎢ a_1   −2/λ_1²                ⎥        a_j = √A ∫ g φ_j,  j ≥ 1    (5), (6)
          ⎢ a_2             −2/λ_2²      ⎥        g   = Σ φ_i²/λ_i²
          ⎣  ⋮                        ⋱  ⎦

in which g is the diagonal of the Green's function of Δ². The sums and the matrix are truncated at the modes
1 … m (7), which makes K an (m + 1) × (m + 1) matrix (9). Its diagonal is positive in the first entry and
negative in the others, so that by Cauchy interlacing one eigenvalue is positive, μ_0, and m are negative. The
signature is the L largest magnitudes |μ_1| ≥ … ≥ |μ_L| of the negative eigenvalues (10).

An isometry preserves the λ_i and the integrals of the φ_i, and hence the spectrum of K. A scaling of the
surface by s multiplies λ_i by s⁻², φ_i by s⁻¹ and dx by s², and hence K by s⁴: division by A², or by μ_0,
makes the spectrum invariant to scaling.
"""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, check_modes, spectrum_of
from pcretrieve.errors import OptionError, SpectrumError
from pcretrieve.options import Scale
from pcretrieve.values import Eigenpairs, FloatArray, ModalSpectrum, Signature


def r_bihdm(
    pairs: Eigenpairs | ModalSpectrum,
    n_values: int = 23,
    n_modes: int = 60,
    *,
    scale: Scale = "area",
) -> Signature:
    """The R-BiHDM signature of a surface, equation (10).

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_modes` + 1 eigenpairs of a connected surface.
    n_values : int, default 23
        L, the number of values, at most `n_modes`. The paper takes 10 to 30; see docs/decisions.md, n_values.
    n_modes : int, default 60
        m, the number of modes at which the matrix is truncated. The paper asks for m > max(60, 2 L).
    scale : {"area", "relative", "absolute"}, default "area"
        What the eigenvalues are divided by: the squared area, μ_0 as in equation (10), or nothing. See
        docs/decisions.md, scale.

    Returns
    -------
    Signature
        values : (L,) float64, largest first. ``area``: ``|μ_j|`` / A² for j = 1 … L; ``relative``:
        ``|μ_j / μ_0|``; both dimensionless, invariant to isometry and scaling. ``absolute``: ``|μ_j|``,
        unit length⁴, invariant to isometry.

    Raises
    ------
    OptionError
        If `n_modes` is not between 1 and the number of eigenpairs − 1, or `n_values` not between 1 and
        `n_modes`.
    SpectrumError
        If the matrix does not have exactly one positive and m negative eigenvalues.
    """
    matrix = reduced_matrix(pairs, n_modes)
    return leading("r-bihdm", matrix, n_values, n_modes, scale, pairs.area)


R_BIHDM = Descriptor(
    name="r-bihdm",
    make=lambda shape, o: r_bihdm(
        spectrum_of(shape, o), o.n_values, o.n_modes, scale=o.scale
    ),
    needs=("spectrum",),
    # Eight times as much as the total variance: limbs that are not parted change it more than girths.
    spread=12.5,
)


def reduced_matrix(pairs: Eigenpairs | ModalSpectrum, n_modes: int = 60) -> FloatArray:
    """The reduced biharmonic distance matrix K of a surface, equations (5) to (7).

    Returns (m + 1, m + 1) float64: k, symmetric, unit length⁴. Non-zero in its first row, its first column
        and its diagonal only.
    """
    spectrum = ModalSpectrum.of(pairs)
    m = n_modes
    check_modes(m, len(spectrum.eigenvalues))
    lam = spectrum.eigenvalues[1 : m + 1]  # (m,): λ_1 … λ_m
    green = (
        lam**-2 @ spectrum.moments[1 : m + 1, 1 : m + 1]
    )  # (m,): ∫ g φ_j = Σ_i ⟨φ_i², φ_j⟩ / λ_i²
    matrix = np.diag(
        np.concatenate([[np.sum(2 / lam**2)], -2 / lam**2])
    )  # (m + 1, m + 1): a_0, −2/λ_j²
    matrix[0, 1:] = matrix[1:, 0] = np.sqrt(spectrum.area) * green  # a_j
    return matrix


def leading(
    kind: str, matrix: FloatArray, n_values: int, n_modes: int, scale: Scale, area: float
) -> Signature:
    """The signature of a biharmonic distance matrix, equation (10).

    matrix: (n, n) float64, the matrix of R-BiHDM (n = m + 1) or of BiHDM (n = m + 2), symmetric, unit
        length⁴.
    area: a, unit length².
    Returns Signature: values : (L,) float64, the largest magnitudes of the negative eigenvalues, largest
        first, in the unit named by `scale`.
    """
    if not 1 <= n_values <= n_modes:
        raise OptionError(
            f"n_values must be between 1 and n_modes = {n_modes}, got {n_values}"
        )
    # (n,), ascending: the negative eigenvalues first, μ_0 last.
    mu = np.linalg.eigvalsh(matrix)
    # The matrix of BiHDM has one row more than modes and constant, and may have one zero eigenvalue.
    if not (mu[-1] > 0 > mu[n_modes - 1]):
        raise SpectrumError(
            f"the matrix must have one positive eigenvalue, got {int((mu > 0).sum())}: "
            "the eigenpairs are not those of a connected surface"
        )
    unit = {"relative": mu[-1], "area": area**2, "absolute": 1.0}[scale]
    values = np.abs(mu[:n_values]) / unit
    return Signature(values, kind=kind, digest=f"L={n_values} m={n_modes} {scale}")
