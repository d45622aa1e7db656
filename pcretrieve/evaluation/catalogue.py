"""Catalogue → rankings of its shapes, with the shapes that failed as misses."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.evaluation.folds import Subset, rank_subsets, rank_table, rerank_table, unsupervised
from pcretrieve.evaluation.rankings import Rankings, rank
from pcretrieve.ingestion.labels import labels_of, match_labels
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions, RerankKind
from pcretrieve.retrieval import resolution_covariance, table_whitening
from pcretrieve.values import SignatureTable

logger = logging.getLogger(__name__)


class RankedCatalogue(NamedTuple):
    """The rankings of the shapes of a catalogue, or of a distance matrix."""

    rankings: Rankings
    n_failed: int
    table: SignatureTable | None
    whitening: str
    plain: Rankings


def rank_catalogue(
    catalogue: Catalogue,
    options: PipelineOptions | None = None,
    *,
    labels: str | Path | None = None,
    matrix: DistanceMatrix | None = None,
    sound_only: bool = False,
) -> RankedCatalogue:
    """Rank the shapes of a catalogue for each labelled shape."""
    options = options or catalogue.options
    everything = catalogue.records()
    left = {record.id for record in everything if sound_only and record.is_doubtful}
    records = {record.id: record for record in everything if record.id not in left}
    if labels is None:
        classes = {shape_id: record.label for shape_id, record in records.items()}
    else:
        paths = {shape_id: record.path for shape_id, record in records.items()}
        classes = _classes(labels, labels_of(labels, paths.values()), paths)
    if not any(classes.values()):
        advice = (
            "give --labels, a file of classes or a layout"
            if labels is None
            else f"no name in {labels} fits one"
        )
        raise BenchmarkError(f"no shape in {catalogue.location} has a class: {advice}")
    if matrix is not None:
        check_known(matrix, catalogue)
        if left.intersection(matrix.ids):
            matrix = matrix.select([shape_id for shape_id in matrix.ids if shape_id not in left])
        ranked_ids = set(matrix.ids)
        missing = {shape_id: classes[shape_id] for shape_id in records if shape_id not in ranked_ids}
        return _ranked(matrix, classes, missing, options.retrieval.rerank)
    table = catalogue.signatures(options)
    if left:
        table = table.select([shape_id for shape_id in table.ids if shape_id not in left])
    table = replace(table, labels=tuple(classes[shape_id] for shape_id in table.ids))
    failed = {record.id: classes[record.id] for record in records.values() if record.status == "failed"}
    retrieval = unsupervised(options.retrieval)
    whitening = None
    if retrieval.whitening == "within-class" and retrieval.calibration is None:
        reason = f"within-class, fitted for each of {retrieval.n_folds} folds of classes to the other folds"
        if retrieval.rerank != "none":
            reason += ", and the gallery is the fold"
    else:
        prior = resolution_covariance(options.compared)
        is_measured = retrieval.whitening == "resolution" or retrieval.calibration is not None
        made = catalogue.whitening(options) if is_measured else None
        whitening = made or table_whitening(table, retrieval, prior=prior)
        reason = whitening.reason + (
            ", without labels"
            if whitening.kind in ("none", "neighbours") and options.retrieval.whitening == "auto"
            else ""
        )

    if retrieval.rerank == "none":
        rankings = plain = rank_table(table, retrieval, whitening=whitening, failed=failed)
    else:
        methods = ("none", retrieval.rerank)
        by_method = rerank_table(table, methods, retrieval, whitening=whitening, failed=failed)
        rankings, plain = by_method[retrieval.rerank], by_method["none"]
    return RankedCatalogue(rankings, len(failed), table, reason, plain)


def check_known(matrix: DistanceMatrix, catalogue: Catalogue) -> None:
    """Check that a catalogue holds all shapes of a distance matrix."""
    if unknown := sorted(set(matrix.ids).difference(record.id for record in catalogue.records())):
        raise InputError(
            f"a distance matrix must be of shapes in {catalogue.location}, got {len(unknown)} others, such "
            f"as {unknown[0]!r}: make it again with `pcretrieve matrix`, or correct its ids"
        )


def rank_matrix(
    matrix: DistanceMatrix, labels: str | Path, *, rerank: RerankKind = "none"
) -> RankedCatalogue:
    """Rank the shapes of a distance matrix for each labelled shape."""
    ids = set(matrix.ids)
    named: dict[str, str] = {}
    for name, label in labels_of(labels, (f"/{shape_id}" for shape_id in matrix.ids)).items():
        shape_id = name if name in ids else Path(name).stem
        if named.setdefault(shape_id if shape_id in ids else name, label) != label:
            raise BenchmarkError(
                f"a shape must have one class, {shape_id!r} has {named[shape_id]!r} and {label!r} in {labels}"
            )
    classes = _classes(labels, named, {shape_id: f"/{shape_id}" for shape_id in ids})
    return _ranked(matrix, classes, {}, rerank)


def _ranked(
    matrix: DistanceMatrix,
    classes: Mapping[str, str | None],
    missing: Mapping[str, str | None],
    rerank: RerankKind,
) -> RankedCatalogue:
    """The rankings by a matrix, in which some shapes are missing."""
    labels = [classes[shape_id] for shape_id in matrix.ids]
    if rerank == "none":
        plain = again = rank(matrix, labels, failed=missing)
    else:
        if not np.isfinite(matrix.values).all():
            raise InputError(
                f"re-ranking needs finite distances, got {np.isinf(matrix.values).sum()} that are infinite: "
                "rank without it"
            )
        everything = Subset(np.arange(len(matrix)), matrix.blocks())
        by_method = rank_subsets([everything], matrix.ids, labels, ("none", rerank), failed=missing)
        plain, again = by_method["none"], by_method[rerank]
    return RankedCatalogue(again, len(missing), None, "", plain)


def _classes(file: str | Path, labels: Mapping[str, str], paths: Mapping[str, str]) -> dict[str, str | None]:
    """The classes of shapes by the labels in a file; names in it that fit no shape are logged."""
    matched, unknown = match_labels(labels, paths)
    if unknown:
        logger.warning(
            "%s names %d shapes that are not among those ranked, such as %s", file, len(unknown), unknown[0]
        )
    return {shape_id: matched.get(shape_id) for shape_id in paths}
