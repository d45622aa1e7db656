"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.distances import (
    DISTANCES,
    DistanceBlock,
    Positions,
    coordinates,
    pairwise,
)
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.people import People, people
from pcretrieve.retrieval.whitening import Whitening, fit_whitening, table_whitening

__all__ = [
    "DISTANCES",
    "DistanceBlock",
    "People",
    "Positions",
    "SignatureIndex",
    "Whitening",
    "coordinates",
    "fit_whitening",
    "pairwise",
    "people",
    "table_whitening",
]
