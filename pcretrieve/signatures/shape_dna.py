"""Shape-DNA: the Laplace–Beltrami spectrum itself."""

from __future__ import annotations

from pcretrieve.errors import OptionError
from pcretrieve.types import Eigenpairs, ModalSpectrum, Signature

__all__ = ["shape_dna"]


def shape_dna(pairs: Eigenpairs | ModalSpectrum, n_values: int = 23) -> Signature:
    """The first non-zero eigenvalues, normalised by area [1]_.

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_values` + 1 of them.
    n_values : int, default 23

    Returns
    -------
    Signature
        values (L,): 1 / (λ_j · area) for j = 1 … L, dimensionless, largest first; unchanged by isometry
        and scaling. The reciprocal keeps the order of the other descriptors, and every distance of
        pcretrieve is the same for a signature and its reciprocal.

    Raises
    ------
    OptionError
        If there are fewer pairs than `n_values` + 1.

    References
    ----------
    .. [1] M. Reuter, F.-E. Wolter and N. Peinecke, "Laplace–Beltrami spectra as 'Shape-DNA' of surfaces
       and solids", Computer-Aided Design 38 (2006).
    """
    n_pairs = len(pairs.eigenvalues)
    if not 1 <= n_values < n_pairs:
        raise OptionError(
            f"n_values must be between 1 and {n_pairs - 1} for {n_pairs} eigenpairs, got {n_values}"
        )
    values = 1 / (pairs.eigenvalues[1 : n_values + 1] * pairs.area)
    return Signature(values, kind="shape-dna", digest=f"L={n_values}")
