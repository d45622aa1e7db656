"""The page of one search: each query with its picture, its verdict and its nearest shapes.

It is one self-contained HTML file: pictures are inlined, and the page makes no requests.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import ShapeError
from pcretrieve.ingestion.versions import versions
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.html import page_template
from pcretrieve.pages.settings import settings_in_words
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.query import Answer, Described, result_rows
from pcretrieve.retrieval import swapping_ranks
from pcretrieve.values import Verdict
from pcretrieve.values.files import write_file

__all__ = ["write_query_page"]


@dataclass(frozen=True, slots=True)
class _Panel:
    """One query as the template shows it.

    swaps: list of (int, int), first and last rank of each run of ranks that could swap.
    """

    name: str
    record: Record | None
    picture: bytes | None
    verdict: Verdict | None
    answer: Answer
    results: list[dict[str, Any]]
    swaps: list[tuple[int, int]]


def write_query_page(
    path: str | Path,
    catalogue: Catalogue,
    outcomes: Iterable[tuple[str, Answer | ShapeError]],
    *,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
    labels: Collection[str] | None = None,
    min_score: float | None = None,
    up: str | None = None,
) -> Path:
    """Write the answers to queries on a page. An existing file is replaced in one step, or left unchanged.

    outcomes: iterable of (str, Answer or ShapeError), the queries, as `pcretrieve.query.search_many`
        answers them. All are on one page; those that failed are listed at the end, with the reasons.
    """
    target = Path(path).absolute()
    panels: list[_Panel] = []
    failures: list[tuple[str, ShapeError]] = []

    thumbnails = Thumbnails(up)
    for name, outcome in outcomes:
        if isinstance(outcome, ShapeError):
            failures.append((name, outcome))
            continue
        query, record = outcome.query, None
        if isinstance(query, str):
            record = catalogue.record(query)
            described = (thumbnails.of(catalogue, record), record.verdict)
        else:
            described = (query.picture, query.verdict) if isinstance(query, Described) else (None, None)
        results = [
            row | {"picture": thumbnails.of(catalogue, found)}
            for row, found in zip(result_rows(outcome), outcome.records, strict=True)
        ]
        swaps = [] if outcome.rank_ranges is None else swapping_ranks(outcome.rank_ranges)
        panels.append(_Panel(name, record, *described, outcome, results, swaps))
    names = [panel.name for panel in panels] + [name for name, _ in failures]
    page = page_template("query.html").render(
        title=Path(names[0]).name if len(names) == 1 else f"{len(names)} queries",
        catalogue=Path(catalogue.location).name,
        panels=panels,
        failures=failures,
        min_score=min_score,
        settings=settings_in_words(catalogue, options or catalogue.options, matrix, labels, min_score),
        version=versions()["pcretrieve"],
    )
    # Bytes of file names that are not UTF-8 are replaced by question marks.
    write_file(target, page.encode("utf-8", errors="replace"))
    return target
