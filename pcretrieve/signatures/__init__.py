"""Eigenpairs → descriptor: one file per method, and the table that names them."""

from __future__ import annotations

from collections.abc import Callable

from pcretrieve.options import SignatureOptions
from pcretrieve.signatures.r_bihdm import r_bihdm, reduced_matrix
from pcretrieve.signatures.shape_dna import shape_dna
from pcretrieve.types import ModalSpectrum, Signature

__all__ = ["METHODS", "describe", "r_bihdm", "reduced_matrix", "shape_dna"]

METHODS: dict[str, Callable[[ModalSpectrum, SignatureOptions], Signature]] = {
    "r-bihdm": lambda spectrum, options: r_bihdm(spectrum, options.n_values, options.n_modes),
    "shape-dna": lambda spectrum, options: shape_dna(spectrum, options.n_values),
}


def describe(spectrum: ModalSpectrum, options: SignatureOptions) -> Signature:
    """The descriptor that `options` names."""
    return METHODS[options.method](spectrum, options)
