"""BiHDM: the spectrum of the squared biharmonic distance on the surface itself.

Equation numbers are those of J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape
retrieval", The Visual Computer 32 (2016).
"""

from __future__ import annotations

import numpy as np

from pcretrieve.options import Scale
from pcretrieve.signatures.r_bihdm import leading, reduced_matrix
from pcretrieve.types import Eigenpairs, FloatArray, ModalSpectrum, Signature

__all__ = ["bihdm", "full_matrix"]


def bihdm(
    pairs: Eigenpairs | ModalSpectrum,
    n_values: int = 23,
    n_modes: int = 60,
    *,
    scale: Scale = "area",
) -> Signature:
    """The BiHDM signature, equation (8) cut at m modes.

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_modes` + 1 of them.
    n_values : int, default 23
        L, at most `n_modes`.
    n_modes : int, default 60
        m, the modes that the distance is summed over.
    scale : {"area", "relative", "absolute"}, default "area"

    Returns
    -------
    Signature
        values (L,): as those of `r_bihdm`, which they approach as m grows, since what sets the two apart is
        the part of the Green's function that the first m modes do not reach.

    Raises
    ------
    OptionError
        If `n_values` or `n_modes` does not fit.
    SpectrumError
        If the kernel does not have one positive eigenvalue.
    """
    matrix = full_matrix(pairs, n_modes)
    values = leading(matrix, n_values, n_modes, scale, pairs.area)
    return Signature(values, kind="bihdm", digest=f"L={n_values} m={n_modes} {scale}")


def full_matrix(pairs: Eigenpairs | ModalSpectrum, n_modes: int = 60) -> FloatArray:
    """The squared biharmonic distance, summed over m modes, on all of L².

    With g = Σ φ_i²/λ_i² the kernel is d²(x, y) = g(x) + g(y) − 2 Σ φ_i(x) φ_i(y)/λ_i². It maps every
    function into the span of 1, g and φ_1 … φ_m, and has rank m + 2 at most. An orthonormal basis of that
    span is φ_0 … φ_m and the direction of what is left of g when its share in the modes is taken away. In
    this basis the kernel is the arrowhead of `reduced_matrix` with one more point,

        a_{m+1} = √A ‖g − Σ ⟨g, φ_j⟩ φ_j‖,    K_{m+1,m+1} = 0,

    which is where all a_j with j > m of equation (7) have gone. Its eigenvalues are all the non-zero ones of
    the kernel, exactly.

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_modes` + 1 of them.
    n_modes : int, default 60

    Returns
    -------
    (m + 2, m + 2) float64
        Symmetric; scales as length⁴.

    Raises
    ------
    OptionError
        If there are fewer pairs than `n_modes` + 1.
    InputError
        If the spectrum was stored without overlaps.
    """
    spectrum = pairs if isinstance(pairs, ModalSpectrum) else ModalSpectrum.of(pairs)
    matrix = np.pad(reduced_matrix(spectrum, n_modes), (0, 1))  # (m + 2, m + 2)
    inner = slice(1, n_modes + 1)
    weights = spectrum.eigenvalues[inner] ** -2  # (m,)
    in_modes = weights @ spectrum.moments[inner, : n_modes + 1]  # (m + 1,): ⟨g, φ_j⟩
    squared = weights @ spectrum.known_overlaps()[inner, inner] @ weights  # ⟨g, g⟩
    left = np.sqrt(np.maximum(squared - in_modes @ in_modes, 0))  # negative by rounding only
    matrix[0, -1] = matrix[-1, 0] = np.sqrt(spectrum.area) * left
    return matrix
