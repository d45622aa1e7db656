"""A page to look at: queries, what was found for each, and how well that went.

One HTML file that needs nothing else: pictures are inlined, and no request leaves the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from pcretrieve.atomic import write_file
from pcretrieve.errors import InputError
from pcretrieve.evaluation import PrecisionRecall, RetrievalMeasures
from pcretrieve.pages.html import page_template
from pcretrieve.types import Failure

__all__ = ["Card", "Panel", "write_report"]

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"

# What a reader who has never seen a retrieval benchmark needs to know of each measure.
MEASURES = (
    ("nn", "NN", "nearest neighbour", "How often the first shape found is of the query's class."),
    (
        "ft",
        "FT",
        "first tier",
        "Share of the other shapes of the class that come among the first R, where R is how many there are.",
    ),
    ("st", "ST", "second tier", "The same among the first 2R."),
    (
        "e",
        "E",
        "E-measure",
        "Precision and recall of the first 32 taken together; below 1 even for a perfect ranking.",
    ),
    (
        "dcg",
        "DCG",
        "discounted cumulative gain",
        "How early the shapes of the class come; the first places weigh most.",
    ),
    (
        "map",
        "mAP",
        "mean average precision",
        "Precision at the place of each shape of the class, averaged: the whole ranking in one number.",
    ),
)


@dataclass(frozen=True, slots=True)
class Card:
    """A shape as the page shows it.

    Attributes
    ----------
    id : str
    label : str or None
        Its class, where known.
    path : str
        Where it came from; may be empty.
    distance : float or None
        To the query; None for the query itself.
    picture : bytes or None
        PNG with a transparent background. The page shows a result at 8 rem and a query at 13, about 130 and
        210 pixels; twice that looks sharp on a fine screen.
    relevant : bool or None
        Whether it is of the query's class; None where one of them has no label, and for the query itself.

    Raises
    ------
    InputError
        For a picture that is not a PNG, or a distance that is negative or not finite.
    """

    id: str
    label: str | None = None
    path: str = ""
    distance: float | None = None
    picture: bytes | None = None
    relevant: bool | None = None

    def __post_init__(self) -> None:
        if self.picture is not None and not self.picture.startswith(PNG_MAGIC):
            raise InputError(
                f"the picture of {self.id} must be a PNG, got {len(self.picture)} bytes that start with "
                f"{self.picture[: len(PNG_MAGIC)]!r}; use pcretrieve.pages.thumbnail.thumbnail, or None"
            )
        if self.distance is not None and not (isfinite(self.distance) and self.distance >= 0):
            raise InputError(f"the distance of {self.id} must be at least 0 and finite, got {self.distance}")


@dataclass(frozen=True, slots=True)
class Panel:
    """A query and the shapes found for it.

    Attributes
    ----------
    query : Card
    results : tuple of Card
        Nearest first: the rank of a shape is its place.

    Raises
    ------
    InputError
        For distances that descend.
    """

    query: Card
    results: tuple[Card, ...]

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
        """Results that are known to be right or wrong."""
        return sum(card.relevant is not None for card in self.results)

    @property
    def n_right(self) -> int:
        """Results of the query's class."""
        return sum(card.relevant is True for card in self.results)


def write_report(
    path: str | Path,
    *,
    title: str,
    panels: Sequence[Panel],
    measures: RetrievalMeasures | None = None,
    failures: Sequence[Failure] = (),
    facts: Mapping[str, str] = MappingProxyType({}),
    precision_recall: PrecisionRecall | None = None,
) -> Path:
    """Write the page; a file that is there already is replaced in one step, or left as it is.

    Parameters
    ----------
    path : str or Path
        The HTML file, in a folder that exists.
    title : str
    panels : sequence of Panel
        Shown in this order.
    measures, precision_recall : optional
        Over all queries, also those that are not shown.
    failures : sequence of Failure
        Shapes that are missing from the rankings, and why.
    facts : mapping of str to str
        What else to say at the top, such as how many shapes there are and which distance was used.

    Returns
    -------
    Path
        Of the file, absolute.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    target = Path(path).absolute()
    page = page_template("report.html").render(
        title=title,
        facts=facts,
        panels=panels,
        judged=any(panel.n_judged for panel in panels),
        measures=[] if measures is None else _measure_rows(measures),
        counts=measures,
        curve=None if precision_recall is None else _curve(precision_recall),
        failures=failures,
    )
    # A file name may hold bytes that are no text; the page then shows a question mark.
    write_file(target, page.encode("utf-8", errors="replace"))
    return target


class _MeasureRow(NamedTuple):
    short: str
    name: str
    value: float
    meaning: str


class _Curve(NamedTuple):
    """A curve in the unit square of an SVG, whose y axis points down, and its precision at both ends."""

    points: str
    first: float
    last: float


def _measure_rows(measures: RetrievalMeasures) -> list[_MeasureRow]:
    return [
        _MeasureRow(short, name, getattr(measures, field), meaning)
        for field, short, name, meaning in MEASURES
    ]


def _curve(curve: PrecisionRecall) -> _Curve:
    points = zip(curve.recall, 1 - curve.precision, strict=True)
    return _Curve(
        " ".join(f"{x:.4f},{y:.4f}" for x, y in points), float(curve.precision[0]), float(curve.precision[-1])
    )
