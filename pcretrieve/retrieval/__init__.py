"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index.

A distance matrix ranks a gallery as an index of signatures does; its files are those of SHREC tracks.
"""

from pcretrieve.retrieval.distances import (
    DISTANCES,
    DistanceBlock,
    DistanceMatrix,
    Positions,
    coordinates,
    ids_path,
    pairwise,
    read_matrix,
    write_matrix,
)
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.people import People, limbless_ratio, people
from pcretrieve.retrieval.whitening import Whitening, fit_whitening, table_whitening

__all__ = [
    "DISTANCES",
    "DistanceBlock",
    "DistanceMatrix",
    "People",
    "Positions",
    "SignatureIndex",
    "Whitening",
    "coordinates",
    "fit_whitening",
    "ids_path",
    "limbless_ratio",
    "pairwise",
    "people",
    "read_matrix",
    "table_whitening",
    "write_matrix",
]
