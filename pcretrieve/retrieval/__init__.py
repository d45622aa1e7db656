"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.clusters import NearPair, cluster_numbers, near_pairs, plane_map
from pcretrieve.retrieval.covariances import LEAST_SHAPES
from pcretrieve.retrieval.distances import (
    BLOCK_DISTANCES,
    DISTANCES,
    Distance,
    DistanceBlock,
    Positions,
    Ranking,
    checked_k,
    coordinates,
    known_distance,
    nearest_of,
    pairwise,
    pairwise_blocks,
    position_of,
    table_coordinates,
)
from pcretrieve.retrieval.index import N_INTERPRETED, SignatureIndex
from pcretrieve.retrieval.reranking import (
    N_RERANKED,
    RERANKINGS,
    NeighbourLists,
    rerank,
)
from pcretrieve.retrieval.scores import fit_scores
from pcretrieve.retrieval.votes import Vote, class_vote, rank_ranges, swapping_ranks
from pcretrieve.retrieval.whitening import (
    WHITENINGS,
    Whitening,
    fit_whitening,
    read_whitening,
    resolution_covariance,
    resolution_whitening,
    table_whitening,
    write_whitening,
)

__all__ = [
    "BLOCK_DISTANCES",
    "DISTANCES",
    "LEAST_SHAPES",
    "N_INTERPRETED",
    "N_RERANKED",
    "RERANKINGS",
    "WHITENINGS",
    "Distance",
    "DistanceBlock",
    "NearPair",
    "NeighbourLists",
    "Positions",
    "Ranking",
    "SignatureIndex",
    "Vote",
    "Whitening",
    "checked_k",
    "class_vote",
    "cluster_numbers",
    "coordinates",
    "fit_scores",
    "fit_whitening",
    "known_distance",
    "near_pairs",
    "nearest_of",
    "pairwise",
    "pairwise_blocks",
    "plane_map",
    "position_of",
    "rank_ranges",
    "read_whitening",
    "rerank",
    "resolution_covariance",
    "resolution_whitening",
    "swapping_ranks",
    "table_coordinates",
    "table_whitening",
    "write_whitening",
]
