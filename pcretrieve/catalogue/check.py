"""Checks of a stored catalogue: the database, its rows and arrays; and repairs that lose nothing else."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal

from pcretrieve.catalogue.arrays import stored_shape, unpacked, unpacked_values
from pcretrieve.catalogue.cache import remove_kept
from pcretrieve.catalogue.catalogue import Catalogue
from pcretrieve.catalogue.records import OWN, ChangedRow, Entry, Payload, repeated
from pcretrieve.errors import CatalogueError, ShapeError

# The repair of a damaged shape.
REMOVED = "removed: ingest its file again"


@dataclass(frozen=True, slots=True)
class Defect:
    """Something that is wrong in a catalogue."""

    kind: Literal["database", "log", "orphan", "shape", "signature", "index"]
    shape_id: str | None
    message: str
    repair: str | None = None


def find_defects(
    catalogue: Catalogue,
    *,
    repair: bool = False,
    on_shapes: Callable[[int], None] = lambda number: None,
) -> list[Defect]:
    """The defects of the database, of each shape, and of the stored indexes, as `pcretrieve.check` says."""
    found = _database_defects(catalogue, repair=repair)
    if lost := catalogue.database.lost:
        done = "dropped: run the last ingest again" if repair else None
        found.append(Defect("log", None, lost, done))
    # A file with damaged pages is neither read further nor changed, because that may damage it further.
    if all(defect.repair or defect.kind != "database" for defect in found):
        for (number,) in catalogue.database.execute("SELECT number FROM shapes ORDER BY id"):
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
    database = catalogue.database
    # Outside of a transaction, because one that has met a damaged page cannot be ended without an error.
    faults = database.faults()
    done = "SQL indexes made again" if faults and repair and _is_reindexed(catalogue) else None
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
                    Defect("orphan", None, f"{number} rows of {table} are of no shape", done)
                )
    return found


def _is_reindexed(catalogue: Catalogue) -> bool:
    """Make the SQL indexes again; whether the file has no fault then. Otherwise it stays as it was."""
    try:
        with catalogue.database.writing():
            catalogue.database.execute("REINDEX")
            if faults := catalogue.database.faults():
                raise CatalogueError(faults[0])
    except CatalogueError:
        return False
    return True


def _shape_defects(catalogue: Catalogue, number: int, *, repair: bool) -> list[Defect]:
    """What is wrong with a shape. A damaged one is removed, so that the next ingest processes its file."""
    shape_id, faults = f"number {number}", ""
    try:
        for entry in catalogue.entries([number], "number"):
            shape_id = entry.record.id
            faults = "; ".join(_faults(catalogue, entry))
    except ChangedRow:
        faults = "its record has changed since it was stored"
        with suppress(ChangedRow):
            where = "SELECT id FROM shapes WHERE number = ?"
            ((shape_id,),) = catalogue.database.execute(where, [number])
    if not faults:
        return []
    if repair:
        catalogue.forget("number", number)
    return [Defect("shape", shape_id, faults, REMOVED if repair else None)]


def _faults(catalogue: Catalogue, entry: Entry) -> Iterator[str]:
    """What is wrong with the signatures and arrays of a shape."""
    from pcretrieve.descriptors import signature_length

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
        name = "its signature" if digest == OWN else f"its signature by the options {digest}"
        n_values = signature_length(options.signature) if digest == OWN else len(value) // 8 - 1
        reading.append((name, partial(unpacked_values, value, 1, n_values)))
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
