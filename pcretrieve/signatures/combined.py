"""R-BiHDM and Shape-DNA side by side."""

from __future__ import annotations

import numpy as np

from pcretrieve.options import Scale
from pcretrieve.signatures.r_bihdm import r_bihdm
from pcretrieve.signatures.shape_dna import BY, shape_dna
from pcretrieve.types import Eigenpairs, ModalSpectrum, Signature

__all__ = ["combined"]


def combined(
    pairs: Eigenpairs | ModalSpectrum,
    n_values: int = 23,
    n_modes: int = 60,
    *,
    scale: Scale = "area",
) -> Signature:
    """The signatures of `r_bihdm` and `shape_dna`, one after the other.

    Both come from one spectrum, but err in different directions: whitened, they tell more than either.

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_modes` + 1 of them.
    n_values : int, default 23
        L, at most `n_modes`.
    n_modes : int, default 60
        m, as in `r_bihdm`.
    scale : {"area", "relative", "absolute"}, default "area"

    Returns
    -------
    Signature
        values (2 L,): first those of R-BiHDM, then those of Shape-DNA, each largest first.

    Raises
    ------
    OptionError
        If `n_values` or `n_modes` does not fit.
    SpectrumError
        As `r_bihdm`.
    """
    spectrum = pairs if isinstance(pairs, ModalSpectrum) else ModalSpectrum.of(pairs)
    halves = (
        r_bihdm(spectrum, n_values, n_modes, scale=scale),
        shape_dna(spectrum, n_values, normalized_by=BY[scale]),
    )
    values = np.concatenate([half.values for half in halves])
    return Signature(values, kind="combined", digest=f"L={n_values} m={n_modes} {scale}")
