"""Checks of a stored catalogue: the database, its rows and arrays; and repairs that lose nothing else."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

from pcretrieve.catalogue.defects import ChangedRow, Defect
from pcretrieve.catalogue.faults import faults_of
from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import Entry, Origin, Rows
from pcretrieve.errors import CatalogueError, Stage
from pcretrieve.options import PipelineOptions

__all__ = ["check_rows", "set_to_be_ingested_again"]

# Number of shapes that are read together. Of a part with a defect, the shapes are read one by one.
READ_AT_ONCE = 50

AGAIN = "set to be ingested again"
UNLABELLED = "class removed: give it again (ingest --labels)"
REMOVED = "removed: ingest its file again"


def check_rows(
    rows: Rows, options: PipelineOptions, *, repair: bool, on_shapes: Callable[[int], None]
) -> list[Defect]:
    """Check a store and everything that is stored of each shape.

    Returns list of Defect: the defects of the store, then those of the shapes in ascending order of id.
    """
    found = rows.defects(repair=repair)
    try:
        origins = rows.origins()
    except CatalogueError as error:
        return [*found, Defect("database", None, error.message)]
    # A file with damaged pages is not changed, because that may damage it further.
    repair = repair and not any(defect.repair is None for defect in found if defect.kind == "database")
    for start in range(0, len(origins), READ_AT_ONCE):
        part = origins[start : start + READ_AT_ONCE]
        if _faults(rows, options, [origin.id for origin in part])[0]:
            for origin in part:
                # Read again, because another process may have replaced the shape.
                found += _defects_of(rows, options, origin, repair=repair)
        on_shapes(len(part))
    return found


def _defects_of(rows: Rows, options: PipelineOptions, origin: Origin, *, repair: bool) -> list[Defect]:
    faults, changed = _faults(rows, options, [origin.id])
    if not faults:
        return []
    message = "; ".join(faults)
    done = _repaired(rows, origin, changed, message) if repair else None
    found = [Defect("shape", origin.id, message, done)]
    # Only a row whose texts can be relied on is read further.
    if done == UNLABELLED:
        found += _defects_of(rows, options, replace(origin, label=None), repair=True)
    return found


def _repaired(rows: Rows, origin: Origin, changed: Collection[str], message: str) -> str | None:
    """Repair a shape, whose id, path, label or record may have changed; what was done, in words."""
    try:
        if "id" in changed or "path" in changed:
            # An ingest would not find its file, or not give it its id.
            rows.remove([origin.id])
            return REMOVED
        if "label" in changed:
            rows.revise(moved={}, removed=(), labels={origin.path: None}, stamps={})
            return UNLABELLED
    except CatalogueError:
        return None
    return set_to_be_ingested_again(rows, origin, message)


def set_to_be_ingested_again(rows: Rows, origin: Origin, message: str) -> str | None:
    """Replace a shape by a failure in the stage ``check``, whose file the next ingest processes again."""
    failure = Record(
        origin.id,
        origin.path,
        "",  # of no file, so that the next ingest of the path processes it
        origin.label,
        "failed",
        str(Stage.CHECK),
        CatalogueError.__name__,
        f"what was stored of it was damaged: {message}",
    )
    try:
        rows.add([Entry(failure, {}, {})])
    except CatalogueError:
        return None
    return AGAIN


def _faults(
    rows: Rows, options: PipelineOptions, shape_ids: Collection[str]
) -> tuple[list[str], tuple[str, ...]]:
    """What is wrong with shapes, and which parts of a row have changed."""
    try:
        entries = rows.entries(shape_ids)
    except ChangedRow as error:
        return [error.fault], error.parts
    except CatalogueError as error:
        return [error.message], ()
    return [fault for entry in entries for fault in faults_of(entry, options)], ()
