"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.clusters import NearPair, cluster_numbers, near_pairs, plane_map
from pcretrieve.retrieval.covariances import CHUNK, LEAST_SHAPES
from pcretrieve.retrieval.distances import (
    DISTANCES,
    Distance,
    check_comparable,
    coordinates,
    known_distance,
    log_signatures,
    pairwise,
    table_coordinates,
)
from pcretrieve.retrieval.fitting import (
    fit_whitening,
    is_measured,
    resolution_covariance,
    resolution_whitening,
    table_whitening,
)
from pcretrieve.retrieval.index import N_INTERPRETED, MadeBy, Names, SignatureIndex
from pcretrieve.retrieval.ranking import (
    BLOCK_DISTANCES,
    DistanceBlock,
    Positions,
    Ranking,
    checked_k,
    nearest_of,
    pairwise_blocks,
    position_of,
)
from pcretrieve.retrieval.reranking import (
    N_NEAR,
    N_RERANKED,
    RERANKINGS,
    NeighbourLists,
    rerank,
    reranked_neighbors,
)
from pcretrieve.retrieval.scores import MatchScores, fit_scores, pair_sample
from pcretrieve.retrieval.votes import Vote, class_vote, rank_ranges, swapping_ranks
from pcretrieve.retrieval.whitening import CALIBRATED, WHITENINGS, Whitening, read_whitening, write_whitening

__all__ = [
    "BLOCK_DISTANCES",
    "CALIBRATED",
    "CHUNK",
    "DISTANCES",
    "LEAST_SHAPES",
    "N_INTERPRETED",
    "N_NEAR",
    "N_RERANKED",
    "RERANKINGS",
    "WHITENINGS",
    "Distance",
    "DistanceBlock",
    "MadeBy",
    "MatchScores",
    "Names",
    "NearPair",
    "NeighbourLists",
    "Positions",
    "Ranking",
    "SignatureIndex",
    "Vote",
    "Whitening",
    "check_comparable",
    "checked_k",
    "class_vote",
    "cluster_numbers",
    "coordinates",
    "fit_scores",
    "fit_whitening",
    "is_measured",
    "known_distance",
    "log_signatures",
    "near_pairs",
    "nearest_of",
    "pair_sample",
    "pairwise",
    "pairwise_blocks",
    "plane_map",
    "position_of",
    "rank_ranges",
    "read_whitening",
    "rerank",
    "reranked_neighbors",
    "resolution_covariance",
    "resolution_whitening",
    "swapping_ranks",
    "table_coordinates",
    "table_whitening",
    "write_whitening",
]
