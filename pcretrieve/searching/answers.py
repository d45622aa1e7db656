"""The answer to one query of a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue import Record
from pcretrieve.retrieval import Vote, swapping_ranks
from pcretrieve.searching.queries import Described
from pcretrieve.values import Neighbors
from pcretrieve.values.base import Value

__all__ = ["Answer"]

# Pairs with a smaller score are of two classes more often than of one (a convention).
LIKELY_SCORE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Value):
    """The nearest neighbours of one query, and what the catalogue knows of them.

    Attributes
    ----------
    neighbors : Neighbors
        The neighbours, nearest first.
    records : tuple of Record, length k
        The record of each neighbour.
    vote : Vote or None
        The class that the neighbours vote for, weighted by their scores; the query itself does not vote. None
        if no class is known.
    rank_ranges : (k, 2) intp or None
        The lowest and the highest rank that each neighbour has within the error bar of the query, as by
        `pcretrieve.retrieval.rank_ranges`. None if the error bar is not known, and for ranks of a distance
        matrix or of re-ranked lists.
    query : str, Described or None
        The query: its id in the catalogue, or its signature.
    """

    neighbors: Neighbors
    records: tuple[Record, ...]
    vote: Vote | None = None
    rank_ranges: NDArray[np.intp] | None = None
    query: str | Described | None = None

    @property
    def labels(self) -> tuple[str | None, ...]:
        """Class of each neighbour; None if unknown."""
        return tuple(record.label for record in self.records)

    @property
    def best_score(self) -> float | None:
        """The greatest score of a neighbour, between 0 and 1; None if scores are not known."""
        known = self.neighbors.scores
        return None if known is None or not len(known) else float(known.max())

    @property
    def is_unlikely(self) -> bool:
        """Whether classes are known, and each neighbour is probably of another class than the query."""
        return self.vote is not None and self.best_score is not None and self.best_score < LIKELY_SCORE

    def __str__(self) -> str:
        """The verdict, in one line: the class, how sure it is, and which ranks could swap."""
        if not self.records:
            return "no match"
        parts = [f"probably no match: the best score is {self.best_score:.2f}"] if self.is_unlikely else []
        if self.vote is not None:
            nearest = "nearest class" if self.is_unlikely else "class"
            parts.append(
                f"{nearest} {self.vote.label} by {self.vote.share:.0%} of {self.vote.n_voters} votes, "
                f"margin {self.vote.margin:.0%}"
            )
        if self.rank_ranges is not None:
            runs = ", ".join(f"{first} to {last}" for first, last in swapping_ranks(self.rank_ranges))
            parts.append(f"ranks {runs} could swap" if runs else "no ranks could swap")
        return "; ".join(parts) or f"nearest {self.records[0].id}"
