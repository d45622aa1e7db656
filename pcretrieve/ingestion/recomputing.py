"""Stored shapes → their signatures computed again, from the stored surfaces or from their files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import CatalogueError, PcretrieveError, ShapeError
from pcretrieve.ingestion import work
from pcretrieve.ingestion.discover import content_hash
from pcretrieve.ingestion.isolation import Isolation
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import signature_of_surfaces
from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["recomputed"]

# Largest relative difference of a value that is computed again. Other processors and libraries move values by
# less than .001; other poses of a body by .1.
TOLERANCE = 0.01


class _Task(NamedTuple):
    record: Record
    stored: FloatArray  # (L,)
    meshes: tuple[TriangleMesh, ...]  # none if the signature is computed from the file


def recomputed(
    catalogue: Catalogue, records: Iterable[Record], *, timeout: float
) -> Iterator[tuple[Record, str | None]]:
    """Compute the signatures of stored shapes again, in another process.

    Shapes whose surfaces are not stored, and whose files have changed or are not there, are left out, and so
    are those of which a part is damaged.

    timeout: longest time for one shape; seconds.
    """
    isolation = Isolation(timeout=timeout)
    with closing(isolation.each(partial(_again, catalogue.options), _tasks(catalogue, records))) as outcomes:
        for task, outcome in outcomes:
            if isinstance(outcome, PcretrieveError):
                yield task.record, f"its signature cannot be computed again: {outcome.message}"
                continue
            size = np.maximum(np.abs(task.stored), np.abs(outcome))
            difference = float((np.abs(task.stored - outcome) / np.where(size > 0, size, 1)).max())
            source = "its stored surfaces" if task.meshes else "its file"
            fault = f"its signature differs from that of {source} by {difference:.1%}"
            yield task.record, fault if difference > TOLERANCE else None


def _tasks(catalogue: Catalogue, records: Iterable[Record]) -> Iterator[_Task]:
    # Imported here, because other functions do not need this slow import.
    from pcretrieve.spectral import ELEMENTS

    of_points = ELEMENTS[catalogue.options.spectral.element].needs == "points"
    for record in records:
        try:
            stored = catalogue.signature(record.id)
            surfaces = catalogue.shape(record.id, needs=("mesh",)).surfaces
        except CatalogueError:
            continue  # which is a defect that the check of the rows finds
        meshes = tuple(surface.mesh for surface in surfaces if surface.mesh is not None)
        if of_points or len(meshes) < len(surfaces):
            meshes = ()
        if meshes or _is_unchanged(record):
            yield _Task(record, stored, meshes)


def _is_unchanged(record: Record) -> bool:
    """Whether the file has the stored content, and was processed by the options of the catalogue."""
    if any(step.stage == "retry" for step in record.steps):
        return False
    try:
        return content_hash(Path(record.path)) == record.content_hash
    except ShapeError:
        return False


def _again(options: PipelineOptions, task: _Task) -> FloatArray:
    if task.meshes:
        return signature_of_surfaces(task.meshes, options)
    return work.content(Path(task.record.path), options).signature
