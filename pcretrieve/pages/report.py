"""The retrieval page: retrieval measures, and queries with their ranked results.

It is one self-contained HTML file that makes no requests: each picture is inlined once, however often it is
shown. A script sorts and searches the queries; without it, the page shows the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pcretrieve.evaluation import ClassMeasures, Comparison, Confusion, PrecisionRecall, RetrievalMeasures
from pcretrieve.pages.cards import Panel
from pcretrieve.pages.confusion_picture import confusion_picture
from pcretrieve.pages.html import page_template
from pcretrieve.values import Failure, FloatArray
from pcretrieve.values.files import write_file

__all__ = ["write_report"]

# Number of queries that a comparison lists.
N_CHANGES = 10

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


def write_report(
    path: str | Path,
    *,
    title: str,
    panels: Sequence[Panel],
    measures: RetrievalMeasures | None = None,
    failures: Sequence[Failure] = (),
    facts: Mapping[str, str] = MappingProxyType({}),
    precision_recall: PrecisionRecall | None = None,
    intervals: FloatArray | None = None,
    classes: Sequence[ClassMeasures] = (),
    confusion: Confusion | None = None,
    comparison: Comparison | None = None,
    compared_with: str = "",
    drawing: Mapping[str, object] | None = None,
) -> Path:
    """Write the retrieval page. An existing file is replaced in one step, or left unchanged.

    intervals: (2, 6) float64, optional, lower and upper ends of the confidence intervals of the measures, as
        by `bootstrap_interval`.
    """
    target = Path(path).absolute()
    cards = [card for panel in panels for card in (panel.query, *panel.results)]
    pictures: dict[bytes, int] = {}
    for card in cards:
        if card.picture is not None:
            pictures.setdefault(card.picture, len(pictures))
    page = page_template("report.html").render(
        title=title,
        facts=facts,
        panels=panels,
        judged=any(panel.n_judged for panel in panels),
        scored=any(panel.score is not None for panel in panels),
        anchors={panel.query.id: f"q{number}" for number, panel in enumerate(panels)},
        pictures=pictures,
        measures=[] if measures is None else _measure_rows(measures, intervals),
        counts=measures,
        curve=None if precision_recall is None else _curve(precision_recall),
        classes=sorted(classes, key=lambda one: (one.means[-1], one.label)),
        confusion=None if confusion is None else confusion_picture(confusion),
        differences=[] if comparison is None else _difference_rows(comparison),
        comparison=comparison,
        changes=[]
        if comparison is None
        else [c for c in comparison.changes if c.first != c.second][:N_CHANGES],
        compared_with=compared_with,
        drawing=drawing,
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
    low: float | None
    high: float | None


class _DifferenceRow(NamedTuple):
    """A measure of the other result and of this one, and this minus the other with its interval."""

    short: str
    name: str
    other: float
    this: float
    difference: float
    low: float
    high: float
    verdict: str


class _Curve(NamedTuple):
    """A curve in the unit square of an SVG, whose y axis points down, with the precision at both ends."""

    points: str
    first: float
    last: float


def _measure_rows(measures: RetrievalMeasures, intervals: FloatArray | None) -> list[_MeasureRow]:
    ends = [(None, None)] * len(MEASURES) if intervals is None else intervals.T.tolist()
    return [
        _MeasureRow(short, name, getattr(measures, field), meaning, low, high)
        for (field, short, name, meaning), (low, high) in zip(MEASURES, ends, strict=True)
    ]


def _difference_rows(comparison: Comparison) -> list[_DifferenceRow]:
    columns = (comparison.first, comparison.second, comparison.difference, *comparison.interval)
    rows = []
    for (_, short, name, _), numbers in zip(MEASURES, np.transpose(columns).tolist(), strict=True):
        other, this, difference, low, high = numbers
        verdict = "better" if low > 0 else "worse" if high < 0 else "no difference shown"
        rows.append(_DifferenceRow(short, name, other, this, difference, low, high, verdict))
    return rows


def _curve(curve: PrecisionRecall) -> _Curve:
    points = zip(curve.recall, 1 - curve.precision, strict=True)
    return _Curve(
        " ".join(f"{x:.4f},{y:.4f}" for x, y in points), float(curve.precision[0]), float(curve.precision[-1])
    )
