"""Signatures → ranked shapes: distances, whitening, and an exact nearest-neighbour index."""

from pcretrieve.retrieval.changes import with_shapes, without_shapes
from pcretrieve.retrieval.clusters import cluster_numbers, plane_map
from pcretrieve.retrieval.distances import (
    DISTANCES,
    Distance,
    coordinates,
    log_signatures,
    pairwise,
    table_coordinates,
)
from pcretrieve.retrieval.fitting import fit_whitening, table_whitening
from pcretrieve.retrieval.index import N_INTERPRETED, SignatureIndex
from pcretrieve.retrieval.near_pairs import NearPair, near_pairs
from pcretrieve.retrieval.neighbour_covariance import LEAST_SHAPES
from pcretrieve.retrieval.rank_errors import rank_ranges, swapping_ranks
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
from pcretrieve.retrieval.regularisation import DEFAULT_SHRINKAGE, checked_shrinkage
from pcretrieve.retrieval.reranking import (
    N_NEAR,
    N_RERANKED,
    RERANKINGS,
    NeighbourLists,
    neighbour_lists,
    rerank,
    reranked_neighbors,
)
from pcretrieve.retrieval.resolution import resolution_covariance, resolution_whitening
from pcretrieve.retrieval.scores import MatchScores, PairSample, fit_scores, pair_sample
from pcretrieve.retrieval.subsets import nearest_among
from pcretrieve.retrieval.votes import Vote, class_vote
from pcretrieve.retrieval.whitening import (
    CALIBRATED,
    WHITENINGS,
    Whitening,
    read_whitening,
    whitening_digest,
    write_whitening,
)

__all__ = [
    "BLOCK_DISTANCES",
    "CALIBRATED",
    "DEFAULT_SHRINKAGE",
    "DISTANCES",
    "LEAST_SHAPES",
    "N_INTERPRETED",
    "N_NEAR",
    "N_RERANKED",
    "RERANKINGS",
    "WHITENINGS",
    "Distance",
    "DistanceBlock",
    "MatchScores",
    "NearPair",
    "NeighbourLists",
    "PairSample",
    "Positions",
    "Ranking",
    "SignatureIndex",
    "Vote",
    "Whitening",
    "checked_k",
    "checked_shrinkage",
    "class_vote",
    "cluster_numbers",
    "coordinates",
    "fit_scores",
    "fit_whitening",
    "log_signatures",
    "near_pairs",
    "nearest_among",
    "nearest_of",
    "neighbour_lists",
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
    "whitening_digest",
    "with_shapes",
    "without_shapes",
    "write_whitening",
]
