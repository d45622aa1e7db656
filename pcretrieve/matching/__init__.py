"""Pairs of shapes → distances, for methods that have no vector for a single shape.

A distance matrix ranks a gallery as an index of signatures does; its files are those of SHREC tracks.
"""

from pcretrieve.matching.matcher import MATCHERS, Matcher, known_matcher, match_all
from pcretrieve.matching.matrix import DistanceMatrix, ids_path, read_matrix, write_matrix

__all__ = [
    "MATCHERS",
    "DistanceMatrix",
    "Matcher",
    "ids_path",
    "known_matcher",
    "match_all",
    "read_matrix",
    "write_matrix",
]
