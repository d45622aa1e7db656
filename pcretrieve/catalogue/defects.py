"""Checks of a stored catalogue: the database, its rows and arrays; and repairs that lose nothing else."""

from __future__ import annotations

import re
import shutil
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pcretrieve.catalogue.arrays import stored_shape, unpacked, unpacked_values
from pcretrieve.catalogue.catalogue import Catalogue
from pcretrieve.catalogue.records import OWN, ChangedRow, Entry, Record
from pcretrieve.catalogue.rows import Rows
from pcretrieve.catalogue.tables import Payload
from pcretrieve.errors import CatalogueError, ShapeError, Stage
from pcretrieve.options import PipelineOptions

# Number of shapes that are read together. Of a part with a defect, the shapes are read one by one.
READ_AT_ONCE = 50

DIGEST = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Defect:
    """Something that is wrong in a catalogue."""

    kind: Literal["database", "orphan", "shape", "signature", "index"]
    shape_id: str | None
    message: str
    repair: str | None = None


def find_defects(
    catalogue: Catalogue, *, repair: bool = False, on_shapes: Callable[[int], None] = lambda number: None
) -> list[Defect]:
    """Check the database, everything that is stored of each shape, and the stored indexes.

    repair: remove rows of no shape, damaged records and damaged indexes, make SQL indexes again, and replace
        shapes with damaged arrays by failures in the stage ``check``, whose files the next ingest processes.
    on_shapes: called with the number of shapes that have been checked, now and then.

    Returns list of Defect: those of the database, of the shapes in ascending order of id, and of the indexes.
    """
    rows = catalogue.rows
    found = _database_defects(rows, repair=repair)
    # A file with damaged pages is neither read further nor changed, because that may damage it further.
    if all(defect.repair or defect.kind != "database" for defect in found):
        with rows.database.escaping():
            numbers = rows.numbers()
            for start in range(0, len(numbers), READ_AT_ONCE):
                part = numbers[start : start + READ_AT_ONCE]
                if _faults(rows, catalogue.options, part)[1]:
                    for number in part:
                        # Read again, because another process may have replaced the shape.
                        found += _shape_defects(rows, catalogue.options, number, repair=repair)
                on_shapes(len(part))
    for folder, fault in catalogue.cache.faults():
        if repair:
            shutil.rmtree(folder, ignore_errors=True)
        done = "removed, and made again when it is needed" if repair else None
        found.append(Defect("index", None, f"the stored index {folder} {fault}", done))
    return found


def set_to_be_ingested_again(catalogue: Catalogue, record: Record, message: str) -> str | None:
    """Replace a shape by a failure in the stage ``check``, whose file the next ingest processes again.

    Returns str or None: what was done, in words; None if the catalogue cannot be written to.
    """
    return _set_again(catalogue.rows, record, message)


def _database_defects(rows: Rows, *, repair: bool) -> list[Defect]:
    """Defects of the pages and the SQL indexes, and rows of no shape."""
    database = rows.database
    # Outside of a transaction, because one that has met a damaged page cannot be ended without an error.
    faults = database.faults()
    again = "SQL indexes made again" if faults and repair and database.is_reindexed() else None
    found = [Defect("database", None, fault, again) for fault in faults]
    if faults and not again:
        return found
    with database.writing() if repair else database.reading():
        for table in ("provenance", "arrays", "signatures"):
            condition = f"FROM {table} WHERE NOT EXISTS (SELECT 1 FROM shapes WHERE number = shape)"
            ((number,),) = database.execute(f"SELECT count(*) {condition}")
            if number and repair:
                database.execute(f"DELETE {condition}")
            if number:
                done = "removed" if repair else None
                found.append(Defect("orphan", None, f"{number} rows of {table} are of no shape", done))
    return found


def _shape_defects(rows: Rows, options: PipelineOptions, number: int, *, repair: bool) -> list[Defect]:
    (entry, *_), faults = _faults(rows, options, [number])
    if not faults:
        return []
    if entry is not None:
        done = _set_again(rows, entry.record, "; ".join(faults)) if repair else None
        return [Defect("shape", entry.record.id, "; ".join(faults), done)]
    # Of a damaged record, not even the path and the id can be relied on, by which an ingest would replace it.
    ((shape_id,),) = rows.database.execute("SELECT id FROM shapes WHERE number = ?", [number])
    try:
        if repair:
            rows.remove([number], "number")
        done = "removed: ingest its file again" if repair else None
    except CatalogueError:
        done = None
    return [Defect("shape", shape_id, "; ".join(faults), done)]


def _set_again(rows: Rows, record: Record, message: str) -> str | None:
    failure = Record(
        record.id,
        record.path,
        "",  # of no file, so that the next ingest of the path processes it
        record.label,
        "failed",
        str(Stage.CHECK),
        CatalogueError.__name__,
        f"what was stored of it was damaged: {message}",
    )
    try:
        rows.add([Entry(failure, {}, {})])
    except CatalogueError:
        return None
    return "set to be ingested again"


def _faults(
    rows: Rows, options: PipelineOptions, numbers: Collection[int]
) -> tuple[list[Entry | None], list[str]]:
    """What is stored of shapes, None if a record cannot be read, and what is wrong with it."""
    try:
        entries = rows.entries(numbers, "number")
    except ChangedRow:
        return [None], ["its record has changed since it was stored"]
    except CatalogueError as error:
        return [None], [error.message]
    # Without entries, another process has removed the shape since.
    return [*entries, None], [fault for entry in entries for fault in _entry_faults(entry, options)]


def _entry_faults(entry: Entry, options: PipelineOptions) -> Iterator[str]:
    """What is wrong with everything that is stored of a shape."""
    record = entry.record
    if record.status == "failed":
        if not (record.stage and record.error and record.message):
            yield "it failed, but stage, error or message are missing"
        if kept := [*entry.payloads, *(["signatures"] if entry.signatures else [])]:
            yield f"it failed, but has {', '.join(kept)}"
        return
    if record.stage or record.error or record.message:
        yield f"it is finished, but has the failure {record.error or record.message} in {record.stage}"
    if not DIGEST.fullmatch(record.content_hash):
        yield f"its content hash must be 64 hexadecimal digits, but is {record.content_hash!r}"
    yield from _signature_faults(entry, options)
    needed: tuple[Payload, ...] = ("spectra", "moments", *options.catalogue.keep)
    if missing := [name for name in needed if name not in entry.payloads]:
        yield f"its {' and '.join(missing)} are missing"
    if "spectra" in entry.payloads:
        yield from _array_faults(entry)
    if "thumbnails" in entry.payloads:
        try:
            unpacked(entry.payloads["thumbnails"])
        except (ValueError, struct.error, zlib.error) as error:
            yield f"its thumbnail cannot be read: {error}"


def _signature_faults(entry: Entry, options: PipelineOptions) -> Iterator[str]:
    from pcretrieve.descriptors import signature_length

    if OWN not in entry.signatures:
        yield "its signature is missing"
    for digest, value in entry.signatures.items():
        name = "its signature" if digest == OWN else f"its signature by the options {digest}"
        n_values = signature_length(options.signature) if digest == OWN else len(value) // 8 - 1
        try:
            values = unpacked_values(np.frombuffer(value, np.uint8)[np.newaxis], n_values)
        except ValueError as error:
            yield f"{name} cannot be read: {error}"
        else:
            if not np.isfinite(values).all():
                yield f"{name} has values that are not finite"


def _array_faults(entry: Entry) -> Iterator[str]:
    record = entry.record
    try:
        shape = stored_shape(entry.payloads, record.steps)
    except (KeyError, ValueError, ShapeError, struct.error, zlib.error) as error:
        yield f"its arrays cannot be read: {error}"
        return
    if shape.area != record.area:
        yield f"its area is {record.area} in its record, and {shape.area} with its spectra"
    mesh = shape.surfaces[0].mesh
    if mesh is None:
        return
    stated = (record.n_vertices, record.n_faces, record.euler)
    found = (len(mesh.vertices), len(mesh.faces), mesh.euler_characteristic)
    if stated != found:
        yield f"vertices, faces and Euler characteristic are {stated} in its record, and {found} in its mesh"
