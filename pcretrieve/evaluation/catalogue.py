"""Catalogue, table or distance matrix → rankings of its shapes, with the shapes that failed as misses."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pcretrieve.catalogue import Catalogue, CatalogueLike
from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.evaluation.rankings import Rankings, Subset, rank_subsets, rank_table
from pcretrieve.gallery.fitted import calibrated, signatures
from pcretrieve.ingestion.labels import labels_of, match_labels
from pcretrieve.options import OptionsLike, PipelineOptions, RerankKind
from pcretrieve.retrieval import DistanceBlock, DistanceMatrix, people, table_whitening
from pcretrieve.values import SignatureTable
from pcretrieve.values.base import numbers

logger = logging.getLogger(__name__)


class RankedShapes(NamedTuple):
    """The rankings of some shapes; `plain` without re-ranking.

    n_left_out: number of queries that were left out because their scans are not good.
    """

    rankings: Rankings
    plain: Rankings
    table: SignatureTable | None = None
    whitening: str = ""
    n_left_out: int = 0


def rank_shapes(
    shapes: CatalogueLike | SignatureTable | DistanceMatrix | ArrayLike,
    options: OptionsLike = None,
    labels: str | Path | Iterable[object] | None = None,
    *,
    matrix: DistanceMatrix | None = None,
    good_only: bool = False,
) -> RankedShapes:
    """Rank shapes for each labelled shape among them."""
    if isinstance(shapes, SignatureTable):
        return RankedShapes(
            *rank_table(shapes, PipelineOptions.of(options).retrieval), table=shapes
        )
    if not isinstance(shapes, (str, Path, Catalogue)):
        distances = shapes if isinstance(shapes, DistanceMatrix) else _numbered(shapes)
        classes = _classes_of_rows(distances, labels)
        return _of_matrix(
            distances, classes, {}, PipelineOptions.of(options).retrieval.rerank
        )
    if not isinstance(labels, (str, Path, type(None))):
        raise InputError(
            "labels of a catalogue must be a label file or a layout, not a list"
        )
    with Catalogue.opened(shapes) as store:
        chosen = PipelineOptions.of(options, store.options)
        ranked = _of_catalogue(store, chosen, labels, matrix)
        if not good_only:
            return ranked
        good = {record.id for record in store.records() if not record.is_incomplete}
        asked = ranked.rankings.of_queries(good)
        if not asked.ids:
            raise BenchmarkError(f"no labelled scan in {store.location} is good")
        return ranked._replace(
            rankings=asked,
            plain=ranked.plain.of_queries(good),
            n_left_out=len(ranked.rankings.ids) - len(asked.ids),
        )


def _of_catalogue(
    catalogue: Catalogue,
    options: PipelineOptions,
    labels: str | Path | None,
    matrix: DistanceMatrix | None,
) -> RankedShapes:
    records = {record.id: record for record in catalogue.records()}
    if labels is None:
        classes = {shape_id: record.label for shape_id, record in records.items()}
    else:
        paths = {shape_id: record.path for shape_id, record in records.items()}
        classes = _classes(labels, labels_of(labels, paths.values()), paths)
    if not any(classes.values()):
        advice = "give --labels, a file of classes or a layout"
        if labels is not None:
            advice = f"no name in {labels} fits one"
        raise BenchmarkError(f"no shape in {catalogue.location} has a class: {advice}")
    if matrix is not None:
        check_known(matrix, catalogue)
        ranked_ids = set(matrix.ids)
        missing = {
            shape_id: classes[shape_id]
            for shape_id in records
            if shape_id not in ranked_ids
        }
        return _of_matrix(matrix, classes, missing, options.retrieval.rerank)
    table = signatures(catalogue, options=options)
    table = replace(table, labels=tuple(classes[shape_id] for shape_id in table.ids))
    failed = {
        record.id: classes[record.id]
        for record in records.values()
        if record.status == "failed"
    }
    retrieval = options.retrieval.without_labels
    whitening = None
    if retrieval.whitening == "within-class" and retrieval.calibration is None:
        reason = f"within-class, fitted for each of {retrieval.n_folds} folds of classes to the other folds"
        if retrieval.rerank != "none":
            reason += ", and the gallery is the fold"
    else:
        whitening = calibrated(options) or table_whitening(
            table, retrieval, people=people(options.signature)
        )
        reason = whitening.reason
        if options.retrieval.whitening == "auto" and whitening.kind in (
            "none",
            "neighbours",
        ):
            reason += ", without labels"
    rankings = rank_table(table, retrieval, whitening=whitening, failed=failed)
    return RankedShapes(*rankings, table, reason)


def check_known(matrix: DistanceMatrix, catalogue: Catalogue) -> None:
    """Check that a catalogue holds all shapes of a distance matrix."""
    if unknown := sorted({*matrix.ids} - catalogue.labels().keys()):
        raise InputError(
            f"a distance matrix must be of shapes in {catalogue.location}, got {len(unknown)} others, such "
            f"as {unknown[0]!r}: make it again with pcretrieve.matrix, or correct its ids"
        )


def _of_matrix(
    matrix: DistanceMatrix,
    classes: Mapping[str, str | None],
    missing: Mapping[str, str | None],
    rerank: RerankKind,
) -> RankedShapes:
    """The rankings by a matrix, in which some shapes are missing."""
    labels = [classes[shape_id] for shape_id in matrix.ids]
    again = rerank != "none"
    if again and not np.isfinite(matrix.values).all():
        raise InputError(
            f"re-ranking needs finite distances, got {np.isinf(matrix.values).sum()} that are infinite: "
            "rank without it"
        )
    everything = Subset(
        np.arange(len(matrix)), [DistanceBlock(np.arange(len(matrix)), matrix.values)]
    )
    return RankedShapes(
        *rank_subsets([everything], matrix.ids, labels, again=again, failed=missing)
    )


def _numbered(distances: ArrayLike) -> DistanceMatrix:
    """A plain array of distances, whose ids are the numbers of its rows, in their order."""
    rows = numbers("distances", distances)
    width = len(str(len(rows)))
    return DistanceMatrix(tuple(f"{row:0{width}}" for row in range(len(rows))), rows)


def _classes_of_rows(
    distances: DistanceMatrix, labels: str | Path | Iterable[object] | None
) -> Mapping[str, str | None]:
    """The classes of the rows of distances: those that are given, or those that they have."""
    if isinstance(labels, (str, Path)):
        return _classes_of_ids(labels, set(distances.ids))
    if labels is not None:
        given = tuple(None if label is None else str(label) for label in labels)
        distances = replace(distances, labels=given)
    classes = dict(zip(distances.ids, distances.labels, strict=True))
    if not any(classes.values()):
        raise BenchmarkError(
            "no row of the distances has a class: give labels, one for each row"
        )
    return classes


def _classes_of_ids(file: str | Path, ids: Set[str]) -> dict[str, str | None]:
    """The classes of shapes by the labels in a file, which names ids or files."""
    named: dict[str, str] = {}
    for name, label in labels_of(
        file, (f"/{shape_id}" for shape_id in sorted(ids))
    ).items():
        shape_id = name if name in ids else Path(name).stem
        if named.setdefault(shape_id if shape_id in ids else name, label) != label:
            raise BenchmarkError(
                f"a shape must have one class, {shape_id!r} has {named[shape_id]!r} and {label!r} in {file}"
            )
    return _classes(file, named, {shape_id: f"/{shape_id}" for shape_id in ids})


def _classes(
    file: str | Path, labels: Mapping[str, str], paths: Mapping[str, str]
) -> dict[str, str | None]:
    """The classes of shapes by the labels in a file; names in it that fit no shape are logged."""
    matched, unknown = match_labels(labels, paths)
    if unknown:
        logger.warning(
            "%s names %d shapes that are not among those ranked, such as %s",
            file,
            len(unknown),
            unknown[0],
        )
    return {shape_id: matched.get(shape_id) for shape_id in paths}
