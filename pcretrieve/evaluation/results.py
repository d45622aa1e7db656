"""A result, such as a catalogue or a file of distances → the measures of each query."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.catalogue import rank_catalogue, rank_matrix
from pcretrieve.evaluation.measures import QueryScores, query_scores
from pcretrieve.evaluation.score_files import read_scores
from pcretrieve.matching import DistanceMatrix, ids_path, read_matrix
from pcretrieve.options import PipelineOptions

__all__ = ["result_scores"]

# The first bytes of the file of a catalogue.
SQLITE = b"SQLite format 3"


def result_scores(
    result: str | Path | Catalogue | DistanceMatrix,
    options: Callable[[Catalogue], PipelineOptions],
    labels: str | Path | None = None,
) -> QueryScores:
    """The measures of each query."""
    if isinstance(result, (str, Path)) and Path(result).suffix.lower() == ".csv":
        return read_scores(result)
    if isinstance(result, (str, Path)) and _is_matrix(Path(result)):
        result = read_matrix(result)
    if isinstance(result, DistanceMatrix):
        if labels is None:
            raise BenchmarkError("a distance matrix has no classes: give labels, a file of classes")
        return query_scores(rank_matrix(result, labels).rankings)
    if isinstance(result, Catalogue):
        return query_scores(rank_catalogue(result, options(result), labels=labels).rankings)
    with Catalogue(result) as store:
        return query_scores(rank_catalogue(store, options(store), labels=labels).rankings)


def _is_matrix(path: Path) -> bool:
    """Whether a file is a distance matrix: its ids are beside it, and it is no SQLite file."""
    if not path.is_file() or not ids_path(path).is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(SQLITE)) != SQLITE
