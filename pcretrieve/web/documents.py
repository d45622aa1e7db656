"""Shapes and answers as JSON documents and CSV, without the folders of the server."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcretrieve import Answer, Catalogue, PipelineOptions, Record, __version__, index
from pcretrieve.pages.html import without_folders
from pcretrieve.values.files import csv_text
from pcretrieve.web.requests import Listing, Refused, Similar

if TYPE_CHECKING:
    from pcretrieve.web.jobs import Job

Document = dict[str, Any]

# What a document has of a record as it is.
SHOWN = (
    "id",
    "label",
    "status",
    "mark",
    "note",
    "added",
    "area",
    "n_vertices",
    "n_faces",
    "euler",
)

# Number of shapes on a page of the collection.
PAGE = 60


def record_of(catalogue: Catalogue, shape_id: str) -> Record:
    """The record of a shape."""
    for record in catalogue.rows.several([shape_id]):
        return record
    raise Refused(f"there is no shape {shape_id!r}")


def shape_document(record: Record) -> Document:
    """What a catalogue says of one shape."""
    document: Document = {name: getattr(record, name) for name in SHOWN}
    document |= {
        "file": Path(record.path).name,
        "grade": None if record.grade is None else asdict(record.grade),
    }
    if record.status == "failed":
        message = record.message and without_folders(
            record.message, Path(record.path).parent
        )
        document |= {"stage": record.stage, "error": record.error, "message": message}
    return document


def listing_document(
    catalogue: Catalogue, listing: Listing, size: int = PAGE
) -> Document:
    """A page of the collection."""
    words, start = listing.q.casefold().split(), (listing.page - 1) * size
    if words:  # compared by Python, because databases know ASCII letters alone
        _, ids = catalogue.rows.wanted(**listing.wanted)
        among = [one for one in ids if all(word in one.casefold() for word in words)]
        total, chosen = len(among), among[start : start + size]
    else:
        total, chosen = catalogue.rows.wanted(**listing.wanted, limit=size, offset=start)
    found = {record.id: record for record in catalogue.rows.several(chosen)}
    return {
        "total": total,
        "page": listing.page,
        "pages": -(-total // size),
        "shapes": [shape_document(found[one]) for one in chosen if one in found],
    }


def job_document(job: Job) -> Document:
    """How far the processing of an uploaded scan is."""
    document: Document = {
        "job": job.id,
        "name": job.name,
        "state": job.state,
        "stages": [{"stage": stage, "seconds": seconds} for stage, seconds in job.stages],
        "inspection": job.inspection,
        "kept_as": job.kept_as,
    }
    if job.described is not None and job.described.grade is not None:
        document["grade"] = asdict(job.described.grade)
    if job.error is not None:
        kind = type(job.error).__name__
        document |= {
            "stage": job.error.stage,
            "error": kind,
            "message": without_folders(job.error.message).replace(
                f"scan{Path(job.name).suffix.lower()}", job.name
            ),
        }
    return document


def similar_document(
    catalogue: Catalogue,
    name: str,
    asked: Similar,
    options: PipelineOptions,
    answer: Answer,
) -> Document:
    """An answer with its query and the settings by which it was found."""
    return {
        "query": name,
        "arguments": asked.model_dump(),
        **answer.document(),
        "neighbors": [row | {"path": Path(row["path"]).name} for row in answer.rows()],
        "distance": options.retrieval.distance,
        "whitening": without_folders(index(catalogue, options=options).whitening.reason),
        "version": __version__,
    }


def similar_csv(name: str, answer: Answer) -> str:
    """An answer as a table."""
    rows = [[*row, path and Path(path).name] for *row, path in answer.table(name)]
    return csv_text(Answer.columns, rows)
