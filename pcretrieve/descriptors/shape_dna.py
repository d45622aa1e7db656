"""Shape-DNA: the spectrum of the Laplace–Beltrami operator."""

from __future__ import annotations

from typing import Literal

from pcretrieve.descriptors.descriptor import Descriptor, spectrum_of
from pcretrieve.errors import OptionError
from pcretrieve.values import Eigenpairs, ModalSpectrum, Signature
from pcretrieve.values.base import check_type


def shape_dna(
    pairs: Eigenpairs | ModalSpectrum,
    n_values: int = 23,
    *,
    normalized_by: Literal["area", "first", "nothing"] = "area",
) -> Signature:
    """The Shape-DNA signature of a surface: its smallest non-zero eigenvalues [1]_, as reciprocals.

    Parameters
    ----------
    pairs : Eigenpairs or ModalSpectrum
        At least `n_values` + 1 eigenpairs of a connected surface; `n_values` + 2 for ``first``.
    n_values : int, default 23
        L, the number of values.
    normalized_by : {"area", "first", "nothing"}, default "area"
        Normalisation of the eigenvalues: by the area A, by λ_1, or none. ``first`` leaves λ_1 itself out,
        because it becomes 1; with 11 values it is the run OrigM-n12-norm1 of SHREC'11.

    Returns
    -------
    Signature
        values : (L,) float64, largest first. ``area``: 1 / (λ_j A) for j = 1 … L; ``first``: λ_1 / λ_{j+1};
        both dimensionless, invariant to isometry and scaling. ``nothing``: 1 / λ_j, unit length², invariant
        to isometry. Reciprocals, so that values descend as in the other descriptors; every distance of
        `pcretrieve.retrieval` is the same for two signatures and for their reciprocals.

    Raises
    ------
    OptionError
        If `n_values` is less than 1, or more than the eigenpairs allow.

    References
    ----------
    .. [1] M. Reuter, F.-E. Wolter and N. Peinecke, "Laplace–Beltrami spectra as 'Shape-DNA' of surfaces
       and solids", Computer-Aided Design 38 (2006).
    """
    check_type("pairs", pairs, Eigenpairs, ModalSpectrum)
    first = 2 if normalized_by == "first" else 1
    n_pairs = len(pairs.eigenvalues)
    if not 1 <= n_values <= n_pairs - first:
        raise OptionError(
            f"n_values must be between 1 and {n_pairs - first} for {n_pairs} eigenpairs, got {n_values}"
        )
    unit = {"area": 1 / pairs.area, "first": pairs.eigenvalues[1], "nothing": 1.0}[
        normalized_by
    ]
    values = unit / pairs.eigenvalues[first : n_values + first]
    kind = "shape-dna-norm1" if normalized_by == "first" else "shape-dna"
    return Signature(values, kind=kind, digest=f"L={n_values} {normalized_by}")


SHAPE_DNA = Descriptor(
    name="shape-dna",
    make=lambda shape, o: shape_dna(
        spectrum_of(shape, o),
        o.n_values,
        normalized_by="nothing"
        if o.scale == "absolute"
        else "area",  # the same for `relative`
    ),
    needs=("spectrum",),
    spread=0.52,
)
