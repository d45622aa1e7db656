"""Catalogue → retrieval page, with measures and with pictures of queries and results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import InputError
from pcretrieve.evaluation import (
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
)
from pcretrieve.evaluation.folds import unsupervised
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.cards import Card, Panel
from pcretrieve.pages.map_page import class_groups, map_drawing
from pcretrieve.pages.report import write_report
from pcretrieve.pages.settings import settings_in_words
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.retrieval import N_NEAR, Ranking, SignatureIndex, plane_map, reranked_neighbors
from pcretrieve.values import Failure

__all__ = ["MOST_QUERIES", "retrieval_page"]

#: Largest number of queries on a page, unless another one is given; of about 4 kB each.
MOST_QUERIES = 1000

# Side of the pictures, so that a page of 600 shapes stays below 3 MB.
PIXELS = 88

# Largest number of shapes on the map of a page, of about 200 bytes each.
MOST_MAPPED = 2000


def retrieval_page(
    catalogue: Catalogue,
    path: str | Path,
    *,
    n_queries: int = MOST_QUERIES,
    k: int = 5,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
    other: QueryScores | None = None,
    other_name: str = "another result",
    up: str | None = None,
) -> Path:
    """Write a page with retrieval measures, and with pictures of queries and their ranked results."""
    options = options or catalogue.options
    if matrix is None:
        # As the measures: with a whitening fitted to labels, the queries that they call bad would look good.
        options = options.changed(retrieval={"whitening": unsupervised(options.retrieval).whitening})
    records = {record.id: record for record in catalogue.records()}
    ranking: Ranking
    index = drawing = None
    if matrix is None:
        table = catalogue.signatures(options)
        if not len(table):
            raise InputError(f"{catalogue.location} holds no shapes: ingest some first")
        ranking = index = SignatureIndex(table, options.retrieval, whitening=catalogue.whitening(options))
        if len(index) <= MOST_MAPPED:
            groups = class_groups([records[shape_id].label for shape_id in index.ids])
            drawing = map_drawing(list(index.ids), groups, plane_map(index))
    else:
        check_known(matrix, catalogue)
        ranking = matrix
    method = options.retrieval.rerank if matrix is None else "none"
    classes = {shape_id: records[shape_id].label for shape_id in ranking.ids}
    sizes = Counter(label for label in classes.values() if label is not None)
    facts = {"shapes": str(len(classes)), "classes": str(len(sizes))}
    facts |= settings_in_words(catalogue, options, matrix)
    for left_out in ("searched", "score"):
        facts.pop(left_out, None)
    if matrix is None:
        facts["scale"] = options.compared.scale
    else:
        facts["distance"] = f"that of a matrix of {len(matrix)} shapes"

    ranked = scores = None
    if any(size > 1 for size in sizes.values()):
        found = rank_catalogue(catalogue, options.changed(retrieval={"rerank": method}), matrix=matrix)
        ranked, scores = found.rankings, query_scores(found.rankings)
        if found.whitening:
            # One that is fitted without labels is the same for the measures.
            is_same = found.whitening.startswith(facts["whitening"])
            facts["whitening" if is_same else "whitening of the measures"] = found.whitening
    elif other is not None:
        raise InputError(f"no class in {catalogue.location} has two shapes: there are no measures to compare")

    precision = {} if scores is None else dict(zip(scores.ids, scores.ap.tolist(), strict=True))
    queries = _worst_first(classes, precision)
    if len(queries) > n_queries:
        facts["queries"] = f"the {n_queries} with the lowest average precision of {len(queries)}"

    thumbnails = Thumbnails(up, PIXELS)

    def card(record: Record, gap: float | None = None, relevant: bool | None = None) -> Card:
        picture = thumbnails.of(catalogue, record)
        return Card(record.id, record.label, record.path, gap, picture, relevant, record.verdict)

    panels = []
    for shape_id in queries[:n_queries]:
        query = records[shape_id]
        near = ranking.nearest(shape_id, k + 1 if method == "none" else max(k + 1, N_NEAR))
        if index is not None:
            near = reranked_neighbors(index, near, method, shape_id=shape_id)
        hits = [
            (records[hit], float(gap))
            for hit, gap in zip(near.ids, near.distances, strict=True)
            if hit != shape_id
        ]
        n_others = 0 if query.label is None else sizes[query.label] - 1
        results = tuple(
            card(record, gap, _relevant(query, record, rank <= n_others))
            for rank, (record, gap) in enumerate(hits[:k], start=1)
        )
        panels.append(Panel(card(query), results, precision.get(shape_id)))

    comparison = None if scores is None or other is None else compare_scores(other, scores)
    return write_report(
        path,
        title=f"Retrieval in {Path(catalogue.location).name}",
        panels=panels,
        measures=None if ranked is None else evaluate_rankings(ranked),
        failures=[
            Failure(record.id, record.stage or "", record.error or "", record.message or "")
            for record in records.values()
            if record.status == "failed"
        ],
        facts=facts,
        precision_recall=None if ranked is None else precision_recall(ranked),
        intervals=None if scores is None else bootstrap_interval(scores.columns),
        classes=() if ranked is None else class_measures(ranked),
        confusion=None if ranked is None else confusion(ranked),
        comparison=comparison,
        compared_with=other_name,
        drawing=drawing,
    )


def _worst_first(classes: Mapping[str, str | None], precision: Mapping[str, float]) -> list[str]:
    """The queries in ascending order of their average precision, then those that have none."""
    return sorted(classes, key=lambda shape_id: precision.get(shape_id, 2.0))


def _relevant(query: Record, hit: Record, in_class_size: bool) -> bool | None:
    """As `Card.relevant`."""
    if query.label is None or hit.label is None:
        return None
    return hit.label == query.label or (False if in_class_size else None)
