"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.distances import DISTANCES, log_signatures, pairwise
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.resolution import resolution_whitening
from pcretrieve.retrieval.whitening import DEFAULT_DAMPING, WHITENINGS, Whitening, fit_whitening

__all__ = [
    "DEFAULT_DAMPING",
    "DISTANCES",
    "WHITENINGS",
    "SignatureIndex",
    "Whitening",
    "fit_whitening",
    "log_signatures",
    "pairwise",
    "resolution_whitening",
]
