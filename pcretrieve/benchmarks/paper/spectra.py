"""Spectra of surfaces, and of the reduced matrix of the squared biharmonic distance."""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors import reduced_matrix
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import FloatArray, ModalSpectrum, TriangleMesh

__all__ = ["reduced_eigenvalues", "unit_area_spectrum"]


def unit_area_spectrum(mesh: TriangleMesh, n_modes: int) -> ModalSpectrum:
    """Spectrum of a surface scaled to unit area, by linear elements.

    Parameters
    ----------
    mesh : TriangleMesh
        Connected, of any area.
    n_modes : int
        Number of modes, without the constant one.

    Returns
    -------
    ModalSpectrum
        `n_modes` + 1 eigenvalues.
    """
    return ModalSpectrum.of(eigenpairs(laplace_beltrami(mesh), n_modes + 1)).scaled(1.0)


def reduced_eigenvalues(spectrum: ModalSpectrum, n_modes: int) -> FloatArray:
    """Eigenvalues of the reduced matrix of the squared biharmonic distance.

    Parameters
    ----------
    spectrum : ModalSpectrum
        Of at least `n_modes` + 1 eigenvalues.
    n_modes : int
        Number of modes of the matrix, without the constant one.

    Returns
    -------
    (n_modes + 1,) float64
        Largest magnitude first; unit length⁴.
    """
    mu = np.linalg.eigvalsh(reduced_matrix(spectrum, n_modes))
    return np.asarray(mu[np.argsort(-np.abs(mu))], dtype=np.float64)
