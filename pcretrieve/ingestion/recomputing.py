"""A catalogue → its defects, with a sample of signatures computed again from surfaces or from files."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from sqlite3 import sqlite_version
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue import (
    Catalogue,
    CatalogueLike,
    Defect,
    Record,
    find_defects,
)
from pcretrieve.catalogue.check import REMOVED
from pcretrieve.errors import CatalogueError, InputError, PcretrieveError, ShapeError
from pcretrieve.formats.identity import content_hash
from pcretrieve.formats.remote import Remote, check_remote
from pcretrieve.ingestion.attempts import content_of
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.options import PipelineOptions
from pcretrieve.values import FloatArray, TriangleMesh

# Largest relative difference of a value that is computed again. Other processors and libraries move values by
# less than .001; other poses of a body by .1.
TOLERANCE = 0.01


@dataclass(frozen=True, slots=True)
class Check:
    """The result of a check of a catalogue."""

    n_shapes: int
    n_failed: int
    n_recomputed: int
    defects: tuple[Defect, ...]
    sqlite_version: str = sqlite_version  # of the library that has read a file

    @property
    def is_whole(self) -> bool:
        """Whether there are no defects, or all of them were repaired."""
        return all(defect.repair is not None for defect in self.defects)


def check(
    catalogue: CatalogueLike,
    *,
    sample: int = 10,
    repair: bool = False,
    remote: Remote = False,
    timeout: float = 600.0,
    seed: int | None = None,
    on_shapes: Callable[[int], None] = lambda number: None,
) -> Check:
    """Check whether a catalogue is whole.

    The check reads everything: pages and SQL indexes of an SQLite file; rows of no shape; of each shape,
    whether its record is as it was stored, and all arrays and signatures are there with the right checksums;
    and the stored indexes. Signatures of a sample are computed again, from the stored surfaces or from files
    that are unchanged.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    sample : int, default 10
        Number of signatures that are computed again.
    repair : bool, default False
        Remove damaged shapes, whose files the next ingest processes again, rows of no shape, and damaged
        indexes, and make SQL indexes again.
    remote : bool or function, default False
        Whether signatures of the sample are also computed again from scans at URLs, which the catalogue
        names: anyone who made it may have written any address. A function is given the hosts, and decides.
    timeout : float, default 600
        Longest time to compute a signature again; seconds.
    seed : int, optional
        Seed of the sample; by default another sample in each call.
    on_shapes : function of int, optional
        Called with the number of shapes that have been checked, now and then.

    Returns
    -------
    Check
        The defects, and which of them were repaired.

    Raises
    ------
    InputError
        If a scan of the sample must be fetched from a URL, and may not be.
    CatalogueError
        If the catalogue cannot be opened, or cannot be written to for repairs.
    """
    with Catalogue.opened(catalogue) as store:
        chosen: list[Record] = []
        with suppress(CatalogueError):  # which is a defect that the check of the database finds
            chosen += _sample(store, sample, seed)
        if not _has_meshes(store):
            check_remote([record.path for record in chosen], remote, store.location)
        defects = find_defects(store, repair=repair, on_shapes=on_shapes)
        is_broken = any(defect.kind == "database" and defect.repair is None for defect in defects)
        tasks = _tasks(store, [] if is_broken else chosen)
        again, n_recomputed = partial(_again, store.options), 0
        with closing(in_processes(again, tasks, workers=1, timeout=timeout)) as outcomes:
            for task, outcome in outcomes:
                if outcome is None:
                    continue
                n_recomputed += 1
                if (fault := _fault(task, outcome)) is not None:
                    if repair:
                        store.forget("id", task.record.id)
                    done = REMOVED if repair else None
                    defects.append(Defect("signature", task.record.id, fault, done))
        n_failed = sum(store.failures().values())
        return Check(len(store), n_failed, n_recomputed, tuple(defects))


class _Task(NamedTuple):
    record: Record
    stored: FloatArray  # (L,)
    meshes: tuple[TriangleMesh, ...]  # none if the signature is computed from the file


def _fault(task: _Task, outcome: FloatArray | PcretrieveError) -> str | None:
    """What is wrong with a stored signature, given the one that was computed again."""
    if isinstance(outcome, PcretrieveError):
        return f"its signature cannot be computed again: {outcome.message}"
    size = np.maximum(np.abs(task.stored), np.abs(outcome))
    difference = float((np.abs(task.stored - outcome) / np.where(size > 0, size, 1)).max())
    source = "its stored surfaces" if task.meshes else "its file"
    differs = f"its signature differs from that of {source} by {difference:.1%}"
    return differs if difference > TOLERANCE else None


def _sample(store: Catalogue, number: int, seed: int | None) -> Iterator[Record]:
    """Some finished shapes, without those whose records are damaged."""
    n_shapes = len(store)
    for offset in sorted(random.Random(seed).sample(range(n_shapes), min(number, n_shapes))):
        with suppress(CatalogueError):
            for page in store.pages(status="done", offset=offset, limit=1):
                yield from page


def _has_meshes(catalogue: Catalogue) -> bool:
    """Whether signatures are computed again from stored surfaces."""
    # Imported here, because other functions do not need this slow import.
    from pcretrieve.spectral import ELEMENTS

    of_points = ELEMENTS[catalogue.options.spectral.element].needs == "points"
    return "meshes" in catalogue.options.catalogue.keep and not of_points


def _tasks(catalogue: Catalogue, records: Iterable[Record]) -> Iterator[_Task]:
    """What is to be computed again, without shapes of which a part is damaged, or is not there any more."""
    has_meshes = _has_meshes(catalogue)
    for record in records:
        try:
            stored = catalogue.signature(record.id)
            surfaces = catalogue.shape(record.id, needs=("mesh",)).surfaces
        except (CatalogueError, InputError):
            continue  # which is a defect that the check of the rows finds
        meshes = tuple(surface.mesh for surface in surfaces if surface.mesh is not None)
        # A file that was tried again was not processed by the options of the catalogue.
        is_retried = any(step.stage == "retry" for step in record.steps)
        if len(meshes) == len(surfaces) if has_meshes else not is_retried:
            yield _Task(record, stored, meshes if has_meshes else ())


def _again(options: PipelineOptions, task: _Task) -> FloatArray | None:
    """The signature of a shape; None if its file is not there any more, or has changed."""
    if task.meshes:
        from pcretrieve.pipeline.process import signature_of_surfaces

        return signature_of_surfaces(task.meshes, options).values
    path = Path(task.record.path)
    try:
        is_same = content_hash(path) == task.record.content_hash
    except ShapeError:
        is_same = False
    return content_of(path, options).signature if is_same else None
