"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.distances import DISTANCES, DistanceBlock, Positions, coordinates, pairwise
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.whitening import (
    Whitening,
    fit_whitening,
    resolution_covariance,
    resolution_whitening,
    table_whitening,
)

__all__ = [
    "DISTANCES",
    "DistanceBlock",
    "Positions",
    "SignatureIndex",
    "Whitening",
    "coordinates",
    "fit_whitening",
    "pairwise",
    "resolution_covariance",
    "resolution_whitening",
    "table_whitening",
]
