"""BiHDM: the spectrum of the squared biharmonic distance, without reduction to the modal space.

Equation numbers and symbols are those of `pcretrieve.descriptors.r_bihdm`.
"""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, spectrum_of
from pcretrieve.descriptors.r_bihdm import leading, reduced_matrix
from pcretrieve.options import Scale
from pcretrieve.values import Eigenpairs, FloatArray, ModalSpectrum, Signature


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
    return leading("bihdm", matrix, n_values, n_modes, scale, pairs.area)


BIHDM = Descriptor(
    name="bihdm",
    make=lambda shape, o: bihdm(
        spectrum_of(shape, o), o.n_values, o.n_modes, scale=o.scale
    ),
    needs=("spectrum", "overlaps"),
    spread=1.04,
)


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
    spectrum = ModalSpectrum.of(pairs)
    matrix = np.pad(reduced_matrix(spectrum, n_modes), (0, 1))  # (m + 2, m + 2)
    inner = slice(1, n_modes + 1)
    weights = spectrum.eigenvalues[inner] ** -2  # (m,): 1/λ_i²
    in_modes = weights @ spectrum.moments[inner, : n_modes + 1]  # (m + 1,): ⟨g, φ_j⟩
    squared = weights @ spectrum.known_overlaps()[inner, inner] @ weights  # ⟨g, g⟩
    # Clipped: rounding can make it negative.
    left = np.sqrt(np.maximum(squared - in_modes @ in_modes, 0))
    matrix[0, -1] = matrix[-1, 0] = np.sqrt(spectrum.area) * left
    return matrix
