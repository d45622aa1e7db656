"""The retrieval page: queries with their ranked results, and retrieval measures.

It is one self-contained HTML file: pictures are inlined, and the page makes no requests.
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
from pcretrieve.types import Failure, Verdict

__all__ = ["Card", "Panel", "write_report"]

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"

# The measures, explained for readers who do not know retrieval benchmarks.
MEASURES = (
    ("nn", "NN", "nearest neighbour", "How often the first shape found is of the query's class."),
    (
        "ft",
        "FT",
        "first tier",
        "Fraction of the other shapes of the class that are among the first R, where R is their number.",
    ),
    ("st", "ST", "second tier", "The same among the first 2R."),
    (
        "e",
        "E",
        "E-measure",
        "Harmonic mean of precision and recall of the first 32; below 1 even for a perfect ranking.",
    ),
    (
        "dcg",
        "DCG",
        "discounted cumulative gain",
        "How early the shapes of the class are ranked; the first ranks have the largest weights.",
    ),
    (
        "map",
        "mAP",
        "mean average precision",
        "Mean precision at the ranks of the other shapes of the class: the whole ranking in one number.",
    ),
)


@dataclass(frozen=True, slots=True)
class Card:
    """One shape on the page.

    Attributes
    ----------
    id : str
        Identifier of the shape.
    label : str or None
        Class of the shape, if known.
    path : str
        File of the scan; may be empty.
    distance : float or None
        Distance to the query; None for the query itself.
    picture : bytes or None
        PNG with a transparent background. The page shows a query with a width of 13 rem (about 210 pixels)
        and a result with 8 rem (about 130 pixels); screens of high resolution show up to twice as many.
    relevant : bool or None
        Whether the shape has the class of the query; None if one of both has no label, and for the query.
    verdict : Verdict or None
        Whether the signature can be relied on. The page says so if it cannot.

    Raises
    ------
    InputError
        If the picture is not a PNG, or the distance is negative or not finite.
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
                f"{self.picture[: len(PNG_MAGIC)]!r}; use pcretrieve.rendering.thumbnail, or None"
            )
        if self.distance is not None and not (isfinite(self.distance) and self.distance >= 0):
            raise InputError(f"the distance of {self.id} must be at least 0 and finite, got {self.distance}")


@dataclass(frozen=True, slots=True)
class Panel:
    """A query and its results.

    Attributes
    ----------
    query : Card
        The query.
    results : tuple of Card
        The results, in ascending order of distance.

    Raises
    ------
    InputError
        If the distances are not in ascending order.
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
        """Number of results that are known to be relevant or not."""
        return sum(card.relevant is not None for card in self.results)

    @property
    def n_right(self) -> int:
        """Number of results with the class of the query."""
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
    """Write the retrieval page. An existing file is replaced in one step, or left unchanged.

    Parameters
    ----------
    path : str or Path
        The HTML file, in a folder that exists.
    title : str
        Title of the page.
    panels : sequence of Panel
        Queries and results, in this order.
    measures : RetrievalMeasures, optional
        Measures over all queries, including queries that are not on the page.
    failures : sequence of Failure
        Shapes that are not in the rankings, with the reasons.
    facts : mapping of str to str
        What is stated at the top, such as the number of shapes and the distance.
    precision_recall : PrecisionRecall, optional
        Precision–recall curve over all queries.

    Returns
    -------
    Path
        Absolute path of the file.

    Raises
    ------
    InputError
        If the file cannot be written.
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
    # Bytes of file names that are not UTF-8 are replaced by question marks.
    write_file(target, page.encode("utf-8", errors="replace"))
    return target


class _MeasureRow(NamedTuple):
    short: str
    name: str
    value: float
    meaning: str


class _Curve(NamedTuple):
    """A curve in the unit square of an SVG, whose y axis points down, with the precision at both ends."""

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
