"""The concatenation of the R-BiHDM and the Shape-DNA signature."""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, spectrum_of
from pcretrieve.descriptors.r_bihdm import r_bihdm
from pcretrieve.descriptors.shape_dna import BY, shape_dna
from pcretrieve.options import Scale
from pcretrieve.types import Eigenpairs, ModalSpectrum, Signature

__all__ = ["COMBINED", "combined"]


def combined(
    pairs: Eigenpairs | ModalSpectrum,
    n_values: int = 59,
    n_modes: int = 60,
    *,
    scale: Scale = "area",
) -> Signature:
    """The values of `r_bihdm` followed by the values of `shape_dna`, from one spectrum.

    The errors of the two descriptors are only partly correlated, so that whitened retrieval by both is better
    than by either of them.

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_modes` + 1 eigenpairs of a connected surface.
    n_values : int, default 59
        L, the number of values of each descriptor, at most `n_modes`.
    n_modes : int, default 60
        m, the number of modes, as in `r_bihdm`.
    scale : {"area", "relative", "absolute"}, default "area"
        Normalisation of both descriptors: as in `r_bihdm`; Shape-DNA is normalised by the area for ``area``
        and ``relative``, and not normalised for ``absolute``.

    Returns
    -------
    Signature
        values : (2 L,) float64: L values of R-BiHDM, then L values of Shape-DNA, each part largest first.
        Dimensionless; for ``absolute``, unit length⁴ and unit length² respectively.

    Raises
    ------
    OptionError
        If `n_modes` is not between 1 and the number of eigenpairs − 1, or `n_values` not between 1 and
        `n_modes`.
    SpectrumError
        If the matrix of R-BiHDM does not have a positive and m negative eigenvalues.
    """
    spectrum = pairs if isinstance(pairs, ModalSpectrum) else ModalSpectrum.of(pairs)
    halves = (
        r_bihdm(spectrum, n_values, n_modes, scale=scale),
        shape_dna(spectrum, n_values, normalized_by=BY[scale]),
    )
    values = np.concatenate([half.values for half in halves])
    return Signature(values, kind="combined", digest=f"L={n_values} m={n_modes} {scale}")


COMBINED = Descriptor(
    name="combined",
    make=lambda shape, o: combined(spectrum_of(shape, o), o.n_values, o.n_modes, scale=o.measured_by),
    needs=("spectrum",),
    length=lambda o: 2 * o.n_values,
)
