"""Catalogue → retrieval page, with measures and with pictures of queries and results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import InputError
from pcretrieve.evaluation import check_known, evaluate_rankings, precision_recall, rank_catalogue
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.report import Card, Panel, write_report
from pcretrieve.rendering import thumbnail
from pcretrieve.retrieval import N_NEAR, Ranking, SignatureIndex, reranked_neighbors
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
    matrix: DistanceMatrix | None = None,
) -> Path:
    """Write a page with retrieval measures, and with pictures of queries and their ranked results.

    Parameters
    ----------
    catalogue : Catalogue
        The shapes, with their classes if known.
    path : str or Path
        The HTML file.
    n_queries : int, default 8
        Largest number of queries on the page: the first shape of each class, or the first shapes if there are
        no classes.
    k : int, default 5
        Number of results of each query, without the query itself.
    options : PipelineOptions, optional
        Options with a descriptor, a distance or a whitening other than the catalogue's own. With the
        whitening ``within-class``, the measures are computed by grouped folds, and the results on the page
        with the whitening that is fitted to all labelled shapes.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures. Shapes that the matrix does not have are misses.

    Returns
    -------
    Path
        Absolute path of the page.

    Raises
    ------
    CatalogueError
        If `options` require other spectra than the catalogue has.
    InputError
        If the catalogue holds no shapes, the matrix has a shape that the catalogue does not have, or the page
        cannot be written.
    """
    options = options or catalogue.options
    records = {record.id: record for record in catalogue.records()}
    failed = [record for record in records.values() if record.status == "failed"]
    ranking: Ranking
    index = None
    if matrix is None:
        table = catalogue.signatures(options)
        if not len(table):
            raise InputError(f"{catalogue.location} holds no shapes: ingest some first")
        whitening = catalogue.whitening(options)
        ranking = index = SignatureIndex(table, options.retrieval, whitening=whitening)
        facts = _signature_facts(table, options) | {"whitening": whitening.reason}
    else:
        check_known(matrix, catalogue)
        ranking = matrix
        facts = {"distances": f"a matrix of {len(matrix)} shapes"}
    method = options.retrieval.rerank if matrix is None else "none"
    classes = {shape_id: records[shape_id].label for shape_id in ranking.ids}

    def card(record: Record, pixels: int, gap: float | None = None, relevant: bool | None = None) -> Card:
        mesh = catalogue.shape(record.id, ("mesh",)).surfaces[0].mesh
        picture = None if mesh is None else thumbnail(mesh.vertices, mesh.faces, size=pixels)
        return Card(record.id, record.label, record.path, gap, picture, relevant, record.verdict)

    panels = []
    for shape_id in _queries(classes, n_queries):
        query = records[shape_id]
        found = ranking.nearest(shape_id, k + 1 if method == "none" else max(k + 1, N_NEAR))
        if index is not None:
            found = reranked_neighbors(index, found, method, shape_id=shape_id)
        results = [
            card(
                records[found_id],
                RESULT_PIXELS,
                float(gap),
                None if query.label is None else records[found_id].label == query.label,
            )
            for found_id, gap in list(zip(found.ids, found.distances, strict=True))[: k + 1]
            if found_id != query.id
        ]
        panels.append(Panel(card(query, QUERY_PIXELS), tuple(results[:k])))

    measures = curve = None
    known = [label for label in classes.values() if label is not None]
    if len(set(known)) < len(known):
        shown = options.changed(retrieval={"rerank": method})
        ranked = rank_catalogue(catalogue, shown, matrix=matrix)
        measures, curve = evaluate_rankings(ranked.rankings), precision_recall(ranked.rankings)
        if ranked.whitening:
            facts["whitening of the measures"] = ranked.whitening
    return write_report(
        path,
        title=f"Retrieval in {Path(catalogue.location).name}",
        panels=panels,
        measures=measures,
        failures=[
            Failure(record.id, record.stage or "", record.error or "", record.message or "")
            for record in failed
        ],
        facts={"shapes": str(len(classes)), "classes": str(len(set(known)))} | facts,
        precision_recall=curve,
    )


def _signature_facts(table: SignatureTable, options: PipelineOptions) -> dict[str, str]:
    return {
        "signature": f"{table.kind}, {table.values.shape[1]} values",
        "scale": options.compared.scale,
        "weight of size": f"{options.signature.size_weight:g}",
        "distance": options.retrieval.distance,
        "re-ranking": options.retrieval.rerank,
    }


def _queries(classes: Mapping[str, str | None], most: int) -> list[str]:
    """The first shape of each class; the first shapes, if there are no classes."""
    first: dict[str, str] = {}
    for shape_id, label in classes.items():
        if label is not None:
            first.setdefault(label, shape_id)
    return (list(first.values()) or list(classes))[:most]
