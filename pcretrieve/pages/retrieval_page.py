"""The retrieval page: retrieval measures, and queries with their ranked results.

It is one self-contained HTML file that makes no requests: each picture is inlined once, however often it is
shown. A script sorts and searches the queries; without it, the page shows the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.catalogue import Catalogue, CatalogueLike, Record, opened
from pcretrieve.errors import InputError
from pcretrieve.evaluation import (
    Comparison,
    Confusion,
    QueryScores,
    bootstrap_interval,
    check_known,
    class_measures,
    compare_scores,
    confusion,
    evaluate_rankings,
    precision_recall,
    query_scores,
    rank_catalogue,
    result_scores,
)
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.html import line_of, write_page
from pcretrieve.pages.map_page import class_groups, map_drawing
from pcretrieve.pages.queries_page import settings_in_words
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.query import Question, without_labels
from pcretrieve.retrieval import N_NEAR, Ranking, SignatureIndex, plane_map, reranked_neighbors

# Side of the pictures, so that a page of 600 shapes stays below 3 MB.
PIXELS = 88

# Largest number of shapes on the map of a page, of about 200 bytes each.
MOST_MAPPED = 2000

# Number of queries that a comparison lists.
N_CHANGES = 10

# Largest number of letters of a class beside the confusion matrix, and the width of a letter in cells.
MOST_LETTERS = 20
LETTER = 0.36

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


class _Card(NamedTuple):
    """A query, or a result with its distance, and whether it is of the class of the query."""

    record: Record
    picture: bytes | None
    distance: float | None = None
    relevant: bool | None = None


class _Panel(NamedTuple):
    """A query with its average precision and its results, nearest first."""

    query: _Card
    results: list[_Card]
    score: float | None


def report(
    catalogue: CatalogueLike,
    path: str | Path,
    *,
    n_queries: int = 1000,
    k: int = 5,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    versus: str | Path | Catalogue | None = None,
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
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        if matrix is None:
            # As the measures: with a whitening fitted to labels, the queries that they call bad would look
            # good.
            chosen = without_labels(chosen)
        other = None if versus is None else result_scores(versus)[0]
        records = {record.id: record for record in store.records()}
        ranking = _ranking(store, chosen, matrix)
        sizes = Counter(label for one in ranking.ids if (label := records[one].label) is not None)
        scores = measured = None
        if any(size > 1 for size in sizes.values()):
            scores, measured = _measured(store, chosen, matrix)
        elif other is not None:
            raise InputError(f"no class in {store.location} has two shapes: there are no measures to compare")
        precision = {} if scores is None else dict(zip(scores.ids, scores.ap.tolist(), strict=True))
        # The worst first, then those that have no average precision.
        queries = sorted(ranking.ids, key=lambda shape_id: precision.get(shape_id, 2.0))
        facts = {"shapes": str(len(ranking.ids)), "classes": str(len(sizes))}
        facts |= _facts(store, chosen, matrix, measured)
        if len(queries) > n_queries:
            facts["queries"] = f"the {n_queries} with the lowest average precision of {len(queries)}"
        results = _Results(store, ranking, records, sizes, Thumbnails(up, PIXELS), k, chosen.retrieval.rerank)
        panels = [results.panel(shape_id, precision.get(shape_id)) for shape_id in queries[:n_queries]]
        cards = [card for panel in panels for card in (panel.query, *panel.results)]
        shown = dict.fromkeys(card.picture for card in cards if card.picture is not None)
        return write_page(
            path,
            "report.html",
            title=f"Retrieval in {Path(store.location).name}",
            facts=facts,
            panels=panels,
            judged=any(card.relevant is not None for card in cards),
            anchors={panel.query.record.id: f"q{number}" for number, panel in enumerate(panels)},
            pictures={picture: number for number, picture in enumerate(shown)},
            measured=measured,
            comparison=_compared(other, scores),
            compared_with=versus.location if isinstance(versus, Catalogue) else str(versus),
            drawing=_map(ranking, records),
            failures=[record for record in records.values() if record.status == "failed"],
        )


def _ranking(catalogue: Catalogue, options: PipelineOptions, matrix: DistanceMatrix | None) -> Ranking:
    if matrix is not None:
        check_known(matrix, catalogue)
        return matrix
    table = catalogue.signatures(options)
    if not len(table):
        raise InputError(f"{catalogue.location} holds no shapes: ingest some first")
    return SignatureIndex(table, options.retrieval, whitening=catalogue.whitening(options))


def _facts(
    catalogue: Catalogue,
    options: PipelineOptions,
    matrix: DistanceMatrix | None,
    measured: dict[str, Any] | None,
) -> dict[str, str]:
    """How shapes are compared."""
    facts = settings_in_words(catalogue, Question(options, matrix=matrix))
    for left_out in ("searched", "score"):
        facts.pop(left_out, None)
    if matrix is None:
        facts["scale"] = options.compared.scale
    else:
        facts["distance"] = f"that of a matrix of {len(matrix)} shapes"
    if measured is not None and measured["whitening"]:
        # One that is fitted without labels is the same for the measures.
        is_same = measured["whitening"].startswith(facts["whitening"])
        facts["whitening" if is_same else "whitening of the measures"] = measured["whitening"]
    return facts


def _measured(
    catalogue: Catalogue, options: PipelineOptions, matrix: DistanceMatrix | None
) -> tuple[QueryScores, dict[str, Any]]:
    """The scores of queries, and the measures as the template shows them."""
    if matrix is not None:
        options = options.changed(retrieval={"rerank": "none"})
    found = rank_catalogue(catalogue, options, matrix=matrix)
    ranked = found.rankings
    scores, means, curve = query_scores(ranked), evaluate_rankings(ranked), precision_recall(ranked)
    ends = bootstrap_interval(scores.columns).T.tolist()
    return scores, {
        "counts": means,
        "rows": [
            {"short": short, "name": name, "value": getattr(means, field), "meaning": meaning, "ends": pair}
            for (field, short, name, meaning), pair in zip(MEASURES, ends, strict=True)
        ],
        "curve": line_of(curve.recall, 1 - curve.precision),
        "precision": curve.precision.tolist(),
        "classes": sorted(class_measures(ranked), key=lambda one: (one.means[-1], one.label)),
        "confusion": _confusion(confusion(ranked)),
        "whitening": found.whitening,
    }


def _confusion(matrix: Confusion) -> dict[str, Any]:
    """A confusion matrix whose cells have side 1."""
    counts = matrix.counts
    n_columns = len(matrix.nearest) - (not counts[:, -1].any())
    nearest = ["no class" if label is None else label for label in matrix.nearest[:n_columns]]
    totals = counts.sum(axis=1)
    cells, n_right = [], 0
    for y, x in np.argwhere(counts).tolist():
        label, n, right = matrix.labels[y], int(counts[y, x]), matrix.nearest[x] == matrix.labels[y]
        words = f"{label}: the nearest shape of {n} of {totals[y]} is {nearest[x]}"
        cells.append({"x": x, "y": y, "share": n / float(totals[y]), "right": right, "words": words})
        n_right += n if right else 0
    rows, columns = [[_short(label) for label in labels] for labels in (matrix.labels, nearest)]
    margin = 0.5 + LETTER * max(map(len, rows + columns), default=0)
    drawn = {"cells": cells, "rows": rows, "columns": columns, "margin": margin}
    return drawn | {"n_right": n_right, "n": int(counts.sum())}


def _short(label: str) -> str:
    return label if len(label) <= MOST_LETTERS else label[: MOST_LETTERS - 1] + "…"


def _compared(other: QueryScores | None, scores: QueryScores | None) -> dict[str, Any] | None:
    """The measures of another result and of this one, and this minus the other with its interval."""
    if other is None or scores is None:
        return None
    found: Comparison = compare_scores(other, scores)
    columns = (found.first, found.second, found.difference, *found.interval)
    rows = []
    for (_, short, _, _), numbers in zip(MEASURES, np.transpose(columns).tolist(), strict=True):
        *_, low, high = numbers
        verdict = "better" if low > 0 else "worse" if high < 0 else "no difference shown"
        rows.append((short, *numbers, verdict))
    changes = [change for change in found.changes if change.first != change.second][:N_CHANGES]
    return {"of": found, "rows": rows, "changes": changes}


def _map(ranking: Ranking, records: Mapping[str, Record]) -> dict[str, object] | None:
    if not isinstance(ranking, SignatureIndex) or len(ranking) > MOST_MAPPED:
        return None
    groups = class_groups([records[shape_id].label for shape_id in ranking.ids])
    return map_drawing(ranking.ids, groups, plane_map(ranking))


class _Results(NamedTuple):
    """Where the results of queries are found; `sizes` of the classes."""

    catalogue: Catalogue
    ranking: Ranking
    records: Mapping[str, Record]
    sizes: Mapping[str, int]
    thumbnails: Thumbnails
    k: int
    rerank: str

    def panel(self, shape_id: str, score: float | None) -> _Panel:
        """A query and its nearest shapes."""
        index = self.ranking if isinstance(self.ranking, SignatureIndex) else None
        method = "none" if index is None else self.rerank
        near = self.ranking.nearest(shape_id, self.k + 1 if method == "none" else max(self.k + 1, N_NEAR))
        if index is not None:
            near = reranked_neighbors(index, near, method, shape_id=shape_id)
        hits = [hit for hit in zip(near.ids, near.distances.tolist(), strict=True) if hit[0] != shape_id]
        query, results = self.records[shape_id], []
        n_others = 0 if query.label is None else self.sizes[query.label] - 1
        for rank, (name, gap) in enumerate(hits[: self.k], start=1):
            found, relevant = self.records[name], None
            if query.label is not None and found.label is not None:
                # After as many results as the class has other shapes, those of other classes are not wrong.
                relevant = found.label == query.label or (False if rank <= n_others else None)
            results.append(_Card(found, self._picture(found), gap, relevant))
        return _Panel(_Card(query, self._picture(query)), results, score)

    def _picture(self, record: Record) -> bytes | None:
        return self.thumbnails.of(self.catalogue, record)
