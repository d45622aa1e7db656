"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.distances import (
    DISTANCES,
    Distance,
    coordinates,
    log_signatures,
    pairwise,
    table_coordinates,
)
from pcretrieve.retrieval.fitting import DEFAULT_DAMPING, checked_damping, fit_whitening, table_whitening
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.ranking import (
    BLOCK_DISTANCES,
    DistanceBlock,
    Positions,
    Ranking,
    nearest_of,
    pairwise_blocks,
    position_of,
)
from pcretrieve.retrieval.resolution import resolution_whitening
from pcretrieve.retrieval.whitening import WHITENINGS, Whitening, whitening_digest

__all__ = [
    "BLOCK_DISTANCES",
    "DEFAULT_DAMPING",
    "DISTANCES",
    "WHITENINGS",
    "Distance",
    "DistanceBlock",
    "Positions",
    "Ranking",
    "SignatureIndex",
    "Whitening",
    "checked_damping",
    "coordinates",
    "fit_whitening",
    "log_signatures",
    "nearest_of",
    "pairwise",
    "pairwise_blocks",
    "position_of",
    "resolution_whitening",
    "table_coordinates",
    "table_whitening",
    "whitening_digest",
]
