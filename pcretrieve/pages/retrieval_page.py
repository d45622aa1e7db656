"""Catalogue → the page that shows how well it retrieves."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import InputError
from pcretrieve.evaluation.folds import rank_table
from pcretrieve.evaluation.measures import evaluate_rankings, precision_recall
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.report import Card, Panel, write_report
from pcretrieve.rendering import thumbnail
from pcretrieve.retrieval import SignatureIndex
from pcretrieve.types import Failure, SignatureTable

__all__ = ["retrieval_page"]

QUERY_PIXELS = 240
RESULT_PIXELS = 160


def retrieval_page(
    catalogue: Catalogue,
    path: str | Path,
    *,
    n_queries: int = 8,
    k: int = 5,
    options: PipelineOptions | None = None,
) -> Path:
    """Write a page with retrieval measures, and pictures of queries and their ranked results.

    Parameters
    ----------
    catalogue : Catalogue
    path : str or Path
        The HTML file.
    n_queries : int, default 8
        Rows of results: the first shape of each class, or of all where there are no classes.
    k : int, default 5
        Results in a row, the query itself left out.
    options : PipelineOptions, optional
        With a descriptor, a distance or a whitening other than the catalogue's own. Measures with the
        whitening ``within-class`` come from grouped folds, the rows from the whitening of a query.

    Returns
    -------
    Path
        Of the page, absolute.

    Raises
    ------
    CatalogueError
        If `options` are for other spectra than those of the catalogue.
    InputError
        If the catalogue holds no shapes, or the page cannot be written.
    """
    options = options or catalogue.options
    table = catalogue.signatures(options)
    if not len(table):
        raise InputError(f"{catalogue.path} holds no shapes: ingest some first")
    records = {record.id: record for record in catalogue.records()}
    failed = [record for record in records.values() if record.status == "failed"]
    whitening = catalogue.whitening(options)
    index = SignatureIndex(table, options.retrieval, whitening=whitening)

    def card(record: Record, pixels: int, gap: float | None = None, relevant: bool | None = None) -> Card:
        mesh = catalogue.mesh(record.id)
        picture = thumbnail(mesh.vertices, mesh.faces, size=pixels)
        return Card(record.id, record.label, record.path, gap, picture, relevant)

    panels = []
    for row in _queries(table, n_queries):
        query = records[table.ids[row]]
        found = index.query(table.values[row], k + 1)
        results = [
            card(
                records[shape_id],
                RESULT_PIXELS,
                float(gap),
                None if query.label is None else records[shape_id].label == query.label,
            )
            for shape_id, gap in zip(found.ids, found.distances, strict=True)
            if shape_id != query.id
        ]
        panels.append(Panel(card(query, QUERY_PIXELS), tuple(results[:k])))

    measures = curve = None
    if _has_pairs(table):
        rankings = rank_table(
            table,
            options.retrieval,
            whitening=whitening,
            failed_labels=[record.label for record in failed],
        )
        measures, curve = evaluate_rankings(rankings), precision_recall(rankings)
    n_classes = len({label for label in table.labels if label is not None})
    return write_report(
        path,
        title=f"Retrieval in {catalogue.path.name}",
        panels=panels,
        measures=measures,
        failures=[
            Failure(record.id, record.stage or "", record.error or "", record.message or "")
            for record in failed
        ],
        facts={
            "shapes": str(len(table)),
            "classes": str(n_classes),
            "signature": f"{table.kind}, {table.values.shape[1]} values",
            "scale": options.compared.scale,
            "weight of size": f"{options.signature.size_weight:g}",
            "distance": options.retrieval.distance,
            "whitening": options.retrieval.whitening,
        },
        precision_recall=curve,
    )


def _queries(table: SignatureTable, most: int) -> list[int]:
    """Rows of the first shape of each class; of the first shapes where there are no classes."""
    first: dict[str | None, int] = {}
    for row, label in enumerate(table.labels):
        if label is not None:
            first.setdefault(label, row)
    return (list(first.values()) or list(range(len(table))))[:most]


def _has_pairs(table: SignatureTable) -> bool:
    labels = [label for label in table.labels if label is not None]
    return len(set(labels)) < len(labels)
