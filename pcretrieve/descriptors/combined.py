"""The R-BiHDM signature and the compact shape descriptor, concatenated with powers that balance them."""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.csd import csd
from pcretrieve.descriptors.descriptor import Descriptor, spectrum_of
from pcretrieve.descriptors.r_bihdm import r_bihdm
from pcretrieve.options import Scale
from pcretrieve.values import Eigenpairs, ModalSpectrum, Signature

__all__ = ["COMBINED", "combined"]

# A power of a value is a factor of its logarithm. The ratio of the two powers balances the variances of the
# two parts; their size makes distances between shapes as large as those of R-BiHDM alone. See
# docs/decisions.md, POWERS.
R_BIHDM_POWER = 0.6
CSD_POWER = 3.0


def combined(
    spectrum: ModalSpectrum,
    pairs: Eigenpairs,
    n_values: int = 59,
    n_modes: int = 60,
    *,
    scale: Scale = "area",
) -> Signature:
    """The values of `r_bihdm` to the power .6, followed by those of `csd` to the power 3.

    R-BiHDM describes how modes interact over the whole surface, the compact shape descriptor what the
    neighbourhood of a point is like on average. Their errors are only partly correlated, so that whitened
    retrieval by both is better than by either of them.

    pairs: at least `n_modes` + 1 eigenpairs of the surface on unit area.
    Returns Signature: values : (2 L,) float64. Dimensionless; for ``absolute`` the first L are in unit
        length^2.4 of the spectrum.
    """
    interaction = r_bihdm(spectrum, n_values, n_modes, scale=scale).values
    average = csd(pairs, n_values, n_modes).values
    values = np.concatenate([interaction**R_BIHDM_POWER, average**CSD_POWER])
    return Signature(values, kind="combined", digest=f"L={n_values} m={n_modes} {scale}")


COMBINED = Descriptor(
    name="combined",
    make=lambda shape, o: combined(
        spectrum_of(shape, o), shape.eigenpairs, o.n_values, o.n_modes, scale=o.measured_by
    ),
    needs=("spectrum", "eigenvectors"),
    length=lambda o: 2 * o.n_values,
    spread=0.83,
)
