"""The retrieval page: retrieval measures, and queries with their ranked results.

It is one self-contained HTML file that makes no requests: each picture is inlined once for all queries and
results, and once for the map. A script sorts and searches the queries; without it, the page shows the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import pcretrieve as pr
from pcretrieve.options import OptionsLike
from pcretrieve.pages.html import write_page
from pcretrieve.pages.map_page import map_drawing, map_pictures
from pcretrieve.pages.queries_page import settings_in_words
from pcretrieve.pages.thumbnails import Thumbnails

# Side of the pictures, so that a page of 600 shapes stays below 3 MB.
PIXELS = 88

# Largest number of shapes on the map of a page, of about 200 bytes each.
MOST_MAPPED = 2000


class _Card(NamedTuple):
    """A query, or a result with its distance, and whether it is of the class of the query."""

    record: pr.Record
    picture: bytes | None
    distance: float | None = None
    relevant: bool | None = None


class _Panel(NamedTuple):
    """A query with its average precision and its results, nearest first."""

    query: _Card
    results: list[_Card]
    score: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Ranked:
    """A catalogue whose shapes are queries: how they are ranked, their records, and the sizes of classes."""

    catalogue: pr.Catalogue
    options: pr.PipelineOptions
    ranking: pr.SignatureIndex | pr.DistanceMatrix
    records: Mapping[str, pr.Record]
    sizes: Mapping[str, int]
    thumbnails: Thumbnails

    @classmethod
    def of(
        cls,
        catalogue: pr.Catalogue,
        options: pr.PipelineOptions,
        matrix: pr.DistanceMatrix | None,
        thumbnails: Thumbnails,
    ) -> _Ranked:
        ranking = pr.index(catalogue, options=options) if matrix is None else matrix
        records = {record.id: record for record in catalogue.rows.several(ranking.ids)}
        if unknown := set(ranking.ids) - records.keys():
            raise catalogue.rows.unknown(min(unknown))
        labels = (record.label for record in records.values())
        sizes = Counter(label for label in labels if label is not None)
        return cls(catalogue, options, ranking, records, sizes, thumbnails)

    def card(self, shape_id: str) -> _Card:
        """A shape with its picture."""
        record = self.records[shape_id]
        return _Card(record, self.thumbnails.of(self.catalogue, record))

    def results(self, shape_id: str, k: int) -> list[_Card]:
        """The `k` shapes nearest to a shape of the gallery."""
        if isinstance(self.ranking, pr.SignatureIndex):
            rerank = self.options.retrieval.rerank
            near = self.ranking.ranked(shape_id, k + 1, rerank=rerank)
        else:
            near = self.ranking.nearest(shape_id, k + 1)
        hits = zip(near.ids, near.distances.tolist(), strict=True)
        found = [hit for hit in hits if hit[0] != shape_id][:k]
        cards = [self.card(name)._replace(distance=gap) for name, gap in found]
        return _judged(self.records[shape_id].label, cards, self.sizes)

    def drawing(self) -> dict[str, object] | None:
        """The map; None for distances without coordinates, or of too many shapes."""
        if not isinstance(self.ranking, pr.SignatureIndex):
            return None
        if len(self.ranking) > MOST_MAPPED:
            return None
        places = pr.places(self.catalogue, options=self.options)
        return map_drawing(self.ranking.ids, self.catalogue, places)


def report(
    catalogue: pr.Catalogue | str | Path,
    path: str | Path,
    *,
    n_queries: int = 1000,
    k: int = 5,
    options: OptionsLike = None,
    matrix: pr.DistanceMatrix | None = None,
    versus: str | Path | pr.Catalogue | None = None,
    up: str | None = None,
) -> Path:
    """Write a page with retrieval measures, and with pictures of queries and their ranked results.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    path : str or Path
        The HTML file.
    n_queries : int, default 1000
        Largest number of queries, those with the lowest average precision first.
    k : int, default 5
        Number of results of each query, without the query itself.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures.
    versus : str, Path or Catalogue, optional
        Another result for the same shapes, with which the page compares query by query: a catalogue, or a
        file ``queries.csv`` of `Evaluation.write`.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.

    Returns
    -------
    Path
        Absolute path of the page.

    Raises
    ------
    InputError
        If the catalogue has no shapes, or the page cannot be written.
    CatalogueError
        If the options require other spectra than the catalogue has.
    """
    with pr.Catalogue.opened(catalogue) as store:
        chosen = pr.PipelineOptions.of(options, store.options)
        if not len(store) and store.rows.failures():  # of which the page has the reasons
            matrix = pr.DistanceMatrix((), np.zeros((0, 0)))
        # As the measures: with a whitening fitted to labels, the queries that they call bad would look good.
        chosen = (
            chosen.without_labels
            if matrix is None
            else chosen.changed(retrieval={"rerank": "none"})
        )
        ranked = _Ranked.of(store, chosen, matrix, Thumbnails(store, up, PIXELS))
        precision, measured, comparison = _evaluated(ranked, matrix, versus)
        # The worst first, then those that have no average precision.
        queries = sorted(ranked.ranking.ids, key=lambda name: precision.get(name, 2.0))
        facts = {"classes": str(len(ranked.sizes))}
        facts |= settings_in_words(store, chosen, matrix)
        if len(queries) > n_queries:
            facts["queries"] = (
                f"the {n_queries} with the lowest average precision of {len(queries)}"
            )
        panels = [
            _Panel(ranked.card(one), ranked.results(one, k), precision.get(one))
            for one in queries[:n_queries]
        ]
        return write_page(
            path,
            "report.html",
            title=f"Retrieval in {Path(store.location).stem}",
            facts=facts,
            **_shown(panels),
            measured=measured,
            comparison=comparison,
            compared_with=Path(
                versus.location if isinstance(versus, pr.Catalogue) else str(versus)
            ).name,
            drawing=ranked.drawing(),
            map_pictures=map_pictures(store, ranked.ranking.ids, ranked.thumbnails),
            failures=store.records(status="failed"),
        )


def _evaluated(
    ranked: _Ranked,
    matrix: pr.DistanceMatrix | None,
    versus: str | Path | pr.Catalogue | None,
) -> tuple[dict[str, float], pr.Evaluation | None, pr.Comparison | None]:
    """Average precision by query, if a class has two shapes the measures, and another result beside them."""
    if any(size > 1 for size in ranked.sizes.values()):
        found = pr.evaluate(ranked.catalogue, options=ranked.options, matrix=matrix)
        comparison = None if versus is None else pr.compare(versus, found)
        precision = dict(zip(found.scores.ids, found.scores.ap.tolist(), strict=True))
        return precision, found, comparison
    if versus is not None:
        raise pr.InputError(
            f"no class in {ranked.catalogue.location} has two shapes: there are no measures to compare"
        )
    return {}, None, None


def _shown(panels: list[_Panel]) -> dict[str, Any]:
    """The queries as the template shows them: each picture once, and each query at its anchor."""
    cards = [card for panel in panels for card in (panel.query, *panel.results)]
    pictures = dict.fromkeys(card.picture for card in cards if card.picture is not None)
    return {
        "panels": panels,
        "judged": any(card.relevant is not None for card in cards),
        "anchors": {
            panel.query.record.id: f"q{number}" for number, panel in enumerate(panels)
        },
        "pictures": {picture: number for number, picture in enumerate(pictures)},
    }


def _judged(
    label: str | None, found: list[_Card], sizes: Mapping[str, int]
) -> list[_Card]:
    """The results of a query of a class, and whether each is right; `sizes` of the classes."""
    n_others = 0 if label is None else sizes[label] - 1
    cards = []
    for rank, card in enumerate(found, start=1):
        other, relevant = card.record.label, None
        if label is not None and other is not None:
            # After as many results as the class has other shapes, those of other classes are not wrong.
            relevant = other == label or (False if rank <= n_others else None)
        cards.append(card._replace(relevant=relevant))
    return cards
