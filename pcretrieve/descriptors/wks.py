"""The second moment of the wave kernel signature over a surface, as a global descriptor."""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.errors import OptionError
from pcretrieve.values import Eigenpairs, FloatArray, ModalSpectrum, Signature

__all__ = ["WKS", "wave_kernel_weights", "wks"]

# σ of the distribution of energies, relative to their range. Aubry et al. take 7 of 100 energy steps.
WIDTH = 0.07


def wks(pairs: Eigenpairs | ModalSpectrum, n_values: int = 59, n_modes: int = 60) -> Signature:
    """The second moment of the wave kernel signature over a surface, at L energies.

    The wave kernel signature of a point x at energy e [1]_, equations (4) and (5), is

        w_e(x) = Σ_k p_k(e) φ_k(x)²,    p_k(e) ∝ exp(−(e − log λ_k)² / 2σ²),    Σ_k p_k(e) = 1,

    summed over m modes. Its mean over a surface of area A is 1 / A for every surface. The lowest moment that
    distinguishes surfaces is the second one, which is a sum of ⟨φ_i², φ_j²⟩.

    Returns Signature: values : (L,) float64: A ∫ w_e², in the order of ascending energies. Dimensionless, at
        least 1, and 1 if w_e is constant on the surface. Invariant to isometry and scaling.

    References
    ----------
    .. [1] M. Aubry, U. Schlickewei and D. Cremers, "The wave kernel signature: a quantum mechanical approach
       to shape analysis", ICCV Workshops 2011.
    """
    spectrum = pairs if isinstance(pairs, ModalSpectrum) else ModalSpectrum.of(pairs)
    weights = wave_kernel_weights(spectrum.eigenvalues, n_values, n_modes)  # (L, m)
    overlaps = spectrum.known_overlaps()[1 : n_modes + 1, 1 : n_modes + 1]  # (m, m)
    values = spectrum.area * np.einsum("ei,ij,ej->e", weights, overlaps, weights)  # (L,)
    return Signature(values, kind="wks", digest=f"L={n_values} m={n_modes}")


def wave_kernel_weights(eigenvalues: FloatArray, n_energies: int, n_modes: int) -> FloatArray:
    """The weights p_k(e) of the modes in the wave kernel signature, as in `wks`.

    eigenvalues: (k,) float64, ascending, the zero eigenvalue first.
    Returns (n_energies, m) float64: each row sums to 1.
    """
    n_pairs = len(eigenvalues)
    if not 2 <= n_modes < n_pairs:
        raise OptionError(
            f"n_modes must be between 2 and {n_pairs - 1} for {n_pairs} eigenpairs, got {n_modes}"
        )
    levels = np.log(eigenvalues[1 : n_modes + 1])  # (m,)
    energies = np.linspace(levels[0], levels[-1], n_energies)
    width = WIDTH * (levels[-1] - levels[0])
    weights: FloatArray = np.exp(-((energies[:, np.newaxis] - levels) ** 2) / (2 * width**2))
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


WKS = Descriptor(
    name="wks",
    make=lambda shape, o: wks(shape.spectrum, o.n_values, o.n_modes),
    needs=("spectrum", "overlaps"),
    has_size=False,
    spread=0.44,
)
