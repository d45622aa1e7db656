"""A catalogue → its defects, with a sample of signatures computed again from surfaces or from files."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from sqlite3 import sqlite_version
from typing import Literal, NamedTuple

import numpy as np

from pcretrieve.catalogue import Catalogue, CatalogueLike, Record
from pcretrieve.catalogue.arrays import stored_shape, unpacked, unpacked_values
from pcretrieve.catalogue.cache import remove_kept
from pcretrieve.catalogue.records import OWN, ChangedRow, Entry, Payload, repeated
from pcretrieve.errors import CatalogueError, InputError, PcretrieveError, ShapeError
from pcretrieve.formats import ScanPath
from pcretrieve.formats.identity import content_hash
from pcretrieve.ingestion.attempts import content_of
from pcretrieve.ingestion.discover import Remote, check_remote
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.options import PipelineOptions
from pcretrieve.values import FloatArray, TriangleMesh

# Largest relative difference of a value that is computed again. Other processors and libraries move values by
# less than .001; other poses of a body by .1.
TOLERANCE = 0.01

# The repair of a damaged shape.
REMOVED = "removed: ingest its file again"


@dataclass(frozen=True, slots=True)
class Defect:
    """Something that is wrong in a catalogue."""

    kind: Literal["database", "log", "orphan", "shape", "signature", "index"]
    shape_id: str | None
    message: str
    repair: str | None = None


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
        with suppress(
            CatalogueError
        ):  # which is a defect that the check of the database finds
            chosen += _sample(store, sample, seed)
        if not _has_meshes(store):
            check_remote(map(_place, chosen), remote, store.location)
        defects = find_defects(store, repair=repair, on_shapes=on_shapes)
        is_broken = any(
            defect.kind == "database" and defect.repair is None for defect in defects
        )
        tasks = _tasks(store, [] if is_broken else chosen)
        again, n_recomputed = partial(_again, store.options), 0
        with closing(in_processes(again, tasks, workers=1, timeout=timeout)) as outcomes:
            for task, outcome in outcomes:
                if outcome is None:
                    continue
                n_recomputed += 1
                if (fault := _fault(task, outcome)) is not None:
                    if repair:
                        store.rows.forget("id", task.record.id)
                    done = REMOVED if repair else None
                    defects.append(Defect("signature", task.record.id, fault, done))
        n_failed = sum(store.rows.failures().values())
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
    difference = float(
        (np.abs(task.stored - outcome) / np.where(size > 0, size, 1)).max()
    )
    source = "its stored surfaces" if task.meshes else "its file"
    differs = f"its signature differs from that of {source} by {difference:.1%}"
    return differs if difference > TOLERANCE else None


def _sample(store: Catalogue, number: int, seed: int | None) -> Iterator[Record]:
    """Some finished shapes, without those whose records are damaged."""
    n_shapes = len(store)
    for offset in sorted(
        random.Random(seed).sample(range(n_shapes), min(number, n_shapes))
    ):
        with suppress(CatalogueError):
            yield from store.records(status="done", offset=offset, limit=1)


def _has_meshes(catalogue: Catalogue) -> bool:
    """Whether signatures are computed again from stored surfaces."""
    options = catalogue.options
    return "meshes" in options.catalogue.keep and not options.spectral.of_points


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


def _place(record: Record) -> ScanPath:
    """Where the scan of a shape was."""
    return ScanPath.parse(record.path)


def _again(options: PipelineOptions, task: _Task) -> FloatArray | None:
    """The signature of a shape; None if its file is not there any more, or has changed."""
    if task.meshes:
        from pcretrieve.pipeline.process import signature_of_surfaces

        return signature_of_surfaces(task.meshes, options).values
    scan = _place(task.record)
    try:
        is_same = content_hash(scan) == task.record.content_hash
    except ShapeError:
        is_same = False
    return content_of(scan, options).signature if is_same else None


# --- what is stored -------------------------------------------------------------------------------------


def find_defects(
    catalogue: Catalogue,
    *,
    repair: bool = False,
    on_shapes: Callable[[int], None] = lambda number: None,
) -> list[Defect]:
    """The defects of the database, of each shape, and of the stored indexes, as `pcretrieve.check` says."""
    found = _database_defects(catalogue, repair=repair)
    if lost := catalogue.rows.database.lost:
        done = "dropped: run the last ingest again" if repair else None
        found.append(Defect("log", None, lost, done))
    # A file with damaged pages is neither read further nor changed, because that may damage it further.
    if all(defect.repair or defect.kind != "database" for defect in found):
        for (number,) in catalogue.rows.database.execute(
            "SELECT number FROM shapes ORDER BY id"
        ):
            found += _shape_defects(catalogue, number, repair=repair)
            on_shapes(1)
    for folder, fault in catalogue.cache.faults():
        if repair:
            remove_kept(folder)
        done = "removed, and made again when it is needed" if repair else None
        found.append(Defect("index", None, f"the stored index {folder} {fault}", done))
    return found


@repeated
def _database_defects(catalogue: Catalogue, *, repair: bool) -> list[Defect]:
    """Defects of the pages and the SQL indexes, and rows of no shape."""
    database = catalogue.rows.database
    # Outside of a transaction, because one that has met a damaged page cannot be ended without an error.
    faults = database.faults()
    done = (
        "SQL indexes made again"
        if faults and repair and _is_reindexed(catalogue)
        else None
    )
    found = [Defect("database", None, fault, done) for fault in faults]
    if faults and done is None:
        return found
    with database.writing() if repair else database.reading():
        for table in ("provenance", "arrays", "signatures"):
            condition = f"FROM {table} WHERE NOT EXISTS (SELECT 1 FROM shapes WHERE number = shape)"
            ((number,),) = database.execute(f"SELECT count(*) {condition}")
            if number and repair:
                database.execute(f"DELETE {condition}")
            if number:
                done = "removed" if repair else None
                found.append(
                    Defect(
                        "orphan", None, f"{number} rows of {table} are of no shape", done
                    )
                )
    return found


def _is_reindexed(catalogue: Catalogue) -> bool:
    """Make the SQL indexes again; whether the file has no fault then. Otherwise it stays as it was."""
    try:
        with catalogue.rows.database.writing():
            catalogue.rows.database.execute("REINDEX")
            if faults := catalogue.rows.database.faults():
                raise CatalogueError(faults[0])
    except CatalogueError:
        return False
    return True


def _shape_defects(catalogue: Catalogue, number: int, *, repair: bool) -> list[Defect]:
    """What is wrong with a shape. A damaged one is removed, so that the next ingest processes its file."""
    shape_id, faults = f"number {number}", ""
    try:
        for entry in catalogue.rows.entries([number], "number"):
            shape_id = entry.record.id
            faults = "; ".join(_faults(catalogue, entry))
    except ChangedRow:
        faults = "its record has changed since it was stored"
        with suppress(ChangedRow):
            where = "SELECT id FROM shapes WHERE number = ?"
            ((shape_id,),) = catalogue.rows.database.execute(where, [number])
    if not faults:
        return []
    if repair:
        catalogue.rows.forget("number", number)
    return [Defect("shape", shape_id, faults, REMOVED if repair else None)]


def _faults(catalogue: Catalogue, entry: Entry) -> Iterator[str]:
    """What is wrong with the signatures and arrays of a shape."""
    if entry.record.status == "failed":
        return
    options, stored = catalogue.options, entry.payloads
    needed: tuple[Payload, ...] = ("spectra", "moments", *options.catalogue.keep)
    if missing := [name for name in needed if name not in stored]:
        yield f"its {' and '.join(missing)} are missing"
    if OWN not in entry.signatures:
        yield "its signature is missing"
    reading: list[tuple[str, Callable[[], object]]] = []
    for digest, value in entry.signatures.items():
        name = (
            "its signature" if digest == OWN else f"its signature by the options {digest}"
        )
        reading.append((name, partial(unpacked_values, value, 1, len(value) // 8 - 1)))
    if "spectra" in stored:
        reading.append(("its arrays", partial(stored_shape, stored, entry.record.steps)))
    drawn: tuple[Payload, ...] = ("up", "thumbnails")
    for name in drawn:
        if name in stored:
            reading.append(("its thumbnail", partial(unpacked, stored[name], 1)))
    for what, read in reading:
        try:
            read()
        except (KeyError, ValueError, ShapeError, struct.error, zlib.error) as error:
            yield f"{what} cannot be read: {error}"
