"""The answer to one query of a search."""

from __future__ import annotations

from dataclasses import dataclass

from pcretrieve.catalogue import Record
from pcretrieve.types import Neighbors
from pcretrieve.values import Value

__all__ = ["Answer"]


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Value):
    """The nearest neighbours of one query, and what the catalogue knows of them.

    Attributes
    ----------
    neighbors : Neighbors
        The neighbours, nearest first.
    records : tuple of Record, length k
        The record of each neighbour.
    """

    neighbors: Neighbors
    records: tuple[Record, ...]

    @property
    def labels(self) -> tuple[str | None, ...]:
        """Class of each neighbour; None if unknown."""
        return tuple(record.label for record in self.records)
