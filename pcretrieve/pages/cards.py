"""What the retrieval page shows of shapes: a card of each, and a panel of each query with its results."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

from pcretrieve.errors import InputError
from pcretrieve.values import Verdict

__all__ = ["Card", "Panel"]

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class Card:
    """One shape on the page.

    picture: PNG with a transparent background. The page shows it with a width of 6 rem, about 96 pixels.
    """

    id: str
    label: str | None = None
    path: str = ""
    distance: float | None = None
    picture: bytes | None = None
    relevant: bool | None = None
    verdict: Verdict | None = None

    def __post_init__(self) -> None:
        if self.picture is not None and not self.picture.startswith(PNG_MAGIC):
            raise InputError(
                f"the picture of {self.id} must be a PNG, got {len(self.picture)} bytes that start with "
                f"{self.picture[: len(PNG_MAGIC)]!r}; use pcretrieve.draw.thumbnail, or None"
            )
        if self.distance is not None and not (isfinite(self.distance) and self.distance >= 0):
            raise InputError(f"the distance of {self.id} must be at least 0 and finite, got {self.distance}")


@dataclass(frozen=True, slots=True)
class Panel:
    """A query and its results.

    results: the results, in ascending order of distance.
    """

    query: Card
    results: tuple[Card, ...]
    score: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "results", tuple(self.results))
        measured = [card for card in self.results if card.distance is not None]
        for nearer, card in pairwise(measured):
            if (nearer.distance or 0) > (card.distance or 0):
                raise InputError(
                    f"results of {self.query.id} must ascend in distance, got {card.id} at {card.distance} "
                    f"after {nearer.id} at {nearer.distance}; sort them"
                )

    @property
    def n_judged(self) -> int:
        """Number of results that are known to be relevant or not."""
        return sum(card.relevant is not None for card in self.results)

    @property
    def n_right(self) -> int:
        """Number of results with the class of the query."""
        return sum(card.relevant is True for card in self.results)
