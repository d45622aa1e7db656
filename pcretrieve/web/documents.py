"""Shapes and answers as JSON documents and CSV, without the folders of the server."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from pcretrieve import __version__
from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.options import PipelineOptions
from pcretrieve.query import Answer, Described, Question, answer_to, result_rows
from pcretrieve.values.files import csv_text
from pcretrieve.web.folders import without_folders
from pcretrieve.web.job import Job
from pcretrieve.web.listing import listed
from pcretrieve.web.requests import PAGE, Listing, Similar

__all__ = [
    "job_document",
    "listing_document",
    "shape_document",
    "similar_csv",
    "similar_document",
    "similar_to",
]

Document = dict[str, Any]

CSV_COLUMNS = ("query", "rank", "id", "label", "distance", "score", "file")


def shape_document(record: Record) -> Document:
    """What a catalogue says of one shape."""
    document: Document = {
        "id": record.id,
        "file": Path(record.path).name,
        "label": record.label,
        "status": record.status,
        "verdict": None if record.verdict is None else asdict(record.verdict),
        "added": record.added,
        "area": record.area,
        "n_vertices": record.n_vertices,
        "n_faces": record.n_faces,
        "euler": record.euler,
    }
    if record.status == "failed":
        message = (
            None if record.message is None else without_folders(record.message, Path(record.path).parent)
        )
        document |= {"stage": record.stage, "error": record.error, "message": message}
    return document


def listing_document(catalogue: Catalogue, listing: Listing) -> Document:
    """A page of the collection."""
    found = listed(catalogue, listing)
    return {
        "total": found.total,
        "page": listing.page,
        "pages": -(-found.total // PAGE),
        "shapes": [shape_document(record) for record in found.records],
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
    if job.described is not None and job.described.verdict is not None:
        document["verdict"] = asdict(job.described.verdict)
    if job.error is not None:
        kind = type(job.error).__name__
        document |= {"stage": job.error.stage, "error": kind, "message": without_folders(job.error.message)}
    return document


def similar_to(
    catalogue: Catalogue, query: str | Described, asked: Similar, options: PipelineOptions
) -> Answer:
    """The neighbours of a shape of the catalogue, without the shape, or of a scan."""
    labels = [asked.label] if asked.label else None
    question = Question(options, asked.k, labels, exclude_self=True, min_score=asked.min_score)
    return answer_to(catalogue, query, question)


def similar_document(
    catalogue: Catalogue, name: str, asked: Similar, options: PipelineOptions, answer: Answer
) -> Document:
    """An answer with its query and the settings by which it was found."""
    return {
        "query": name,
        "arguments": asdict(asked),
        "results": [_without_path(row) for row in result_rows(answer)],
        "vote": None if answer.vote is None else asdict(answer.vote),
        "verdict": str(answer),
        "distance": options.retrieval.distance,
        "whitening": without_folders(catalogue.whitening(options).reason),
        "version": __version__,
    }


def similar_csv(name: str, answer: Answer) -> str:
    """An answer as a table."""
    rows = [{"query": name, **_without_path(row)} for row in result_rows(answer)]
    return csv_text(CSV_COLUMNS, ([row[column] for column in CSV_COLUMNS] for row in rows))


def _without_path(row: Document) -> Document:
    return {
        "file" if name == "path" else name: Path(value).name if name == "path" else value
        for name, value in row.items()
    }
