"""Pairs of shapes → distances, for methods that have no vector for a single shape.

A distance matrix ranks a gallery as an index of signatures does; its files are those of SHREC tracks.
"""

from pcretrieve.matching.matcher import MATCHERS, Matcher, PairwiseIndex, known_matcher
from pcretrieve.matching.matrix import DistanceMatrix, distance_matrix, ids_path, read_matrix, write_matrix

__all__ = [
    "MATCHERS",
    "DistanceMatrix",
    "Matcher",
    "PairwiseIndex",
    "distance_matrix",
    "ids_path",
    "known_matcher",
    "read_matrix",
    "write_matrix",
]
