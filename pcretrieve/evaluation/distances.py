"""Catalogue → all distances between its shapes."""

from __future__ import annotations

from typing import NamedTuple

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError
from pcretrieve.matching import MATCHERS, DistanceMatrix, PairwiseIndex, distance_matrix
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import Ranking, SignatureIndex
from pcretrieve.values import Failure

__all__ = ["CatalogueDistances", "catalogue_distances"]


class CatalogueDistances(NamedTuple):
    """The distances between the shapes of a catalogue."""

    matrix: DistanceMatrix
    failures: tuple[Failure, ...]


def catalogue_distances(
    catalogue: Catalogue, options: PipelineOptions | None = None, *, matcher: str | None = None
) -> CatalogueDistances:
    """All distances between the shapes of a catalogue that did not fail."""
    labels = {record.id: record.label for record in catalogue.records(status="done")}
    if not labels:
        raise InputError(f"{catalogue.location} holds no shapes: ingest some first")
    failures: tuple[Failure, ...] = ()
    ranking: Ranking
    if matcher is None:
        options = options or catalogue.options
        whitening = catalogue.whitening(options)
        ranking = SignatureIndex(catalogue.signatures(options), options.retrieval, whitening=whitening)
    else:
        needs = MATCHERS[matcher].needs
        ranking = PairwiseIndex(MATCHERS[matcher], labels, lambda shape_id: catalogue.shape(shape_id, needs))
        failures = ranking.failures
    matrix = distance_matrix(ranking, tuple(labels[shape_id] for shape_id in ranking.ids))
    return CatalogueDistances(matrix, failures)
