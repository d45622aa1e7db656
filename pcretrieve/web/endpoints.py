"""Every address of the server: what it answers with, and the words that the OpenAPI document has for it.

Addresses in the plural, ``/shapes/...``, have data for scripts; those in the singular, ``/shape/...``, pages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError
from pcretrieve.query import Answer
from pcretrieve.web.comparison import compare_page, glb_of, scene_document
from pcretrieve.web.documents import (
    job_document,
    listing_document,
    shape_document,
    similar_csv,
    similar_document,
    similar_to,
)
from pcretrieve.web.job import Job
from pcretrieve.web.jobs import Jobs
from pcretrieve.web.replies import FRESH, KEPT, Reply, csv_reply, html_reply, json_reply
from pcretrieve.web.requests import SORTS, STATES, Listing, NotFound, Similar
from pcretrieve.web.site import Site
from pcretrieve.web.views import collection_page, map_page, scan_page, shape_page

__all__ = ["ENDPOINTS", "KEPT_AS", "Endpoint", "Field", "Question", "jobs_of"]


class Question(NamedTuple):
    """A request that a reader of the catalogue answers."""

    site: Site
    catalogue: Catalogue
    name: str
    fields: Mapping[str, str]


class Field(NamedTuple):
    """A field of an address."""

    name: str
    words: str
    type: str = "string"
    choices: tuple[str, ...] = ()
    required: bool = False


class Endpoint(NamedTuple):
    """An address that is answered from the catalogue."""

    path: str
    answer: Callable[[Question], Reply]
    words: str
    media_type: str = "text/html"
    fields: tuple[Field, ...] = ()

    @property
    def searches(self) -> bool:
        """Whether the answer is one search, which takes milliseconds, or less."""
        return self.fields == ASKED or self.path in ("/shapes/{id}", "/scans/{id}")


def jobs_of(site: Site) -> Jobs:
    """The uploaded scans of a server."""
    if site.jobs is None:
        raise NotFound("this server takes no scans: it was started with --read-only")
    return site.jobs


def _collection(asked: Question) -> Reply:
    site, jobs = asked.site, asked.site.jobs
    most_bytes = 0 if jobs is None else site.most_bytes
    keeps_scans = jobs is not None and jobs.collection is not None
    listing = Listing.of(asked.fields)
    page = collection_page(asked.catalogue, site.title, listing, most_bytes, keeps_scans=keeps_scans)
    return html_reply(page)


def _map(asked: Question) -> Reply:
    return html_reply(map_page(asked.catalogue, asked.site.title, asked.site.maps, asked.site.options))


def _shape(asked: Question) -> Reply:
    similar = Similar.of(asked.fields)
    return html_reply(shape_page(asked.catalogue, asked.site.title, asked.name, similar, asked.site.options))


def _compare(asked: Question) -> Reply:
    first, second = (asked.fields.get(name, "") for name in ("a", "b"))
    return html_reply(compare_page(asked.catalogue, asked.site.title, first, second, asked.site.options))


def _scan(asked: Question) -> Reply:
    job, similar = _job(asked), Similar.of(asked.fields)
    found = None if job.described is None else _scan_document(asked)
    document = job_document(job)
    return html_reply(
        scan_page(
            asked.catalogue,
            asked.site.title,
            document,
            similar,
            found,
            has_picture=job.described is not None and job.described.picture is not None,
            can_be_kept=job.scan is not None and jobs_of(asked.site).collection is not None,
        )
    )


def _inspection(asked: Question) -> Reply:
    job = _job(asked)
    if job.page is None:
        raise NotFound(
            "the inspection of this scan is not ready: try again in a few seconds"
            if job.inspection == "waiting"
            else "the inspection of this scan failed, or is too long ago: use `pcretrieve inspect`"
        )
    return html_reply(job.page.decode())


def _shapes(asked: Question) -> Reply:
    return json_reply(listing_document(asked.catalogue, Listing.of(asked.fields)))


def _one(asked: Question) -> Reply:
    record = asked.catalogue.get(asked.name)
    if record is None:
        raise NotFound(f"there is no shape {asked.name!r}")
    return json_reply(shape_document(record))


def _similar(asked: Question) -> Reply:
    answer, similar = _shape_answer(asked), Similar.of(asked.fields)
    return json_reply(similar_document(asked.catalogue, asked.name, similar, asked.site.options, answer))


def _similar_table(asked: Question) -> Reply:
    return csv_reply(similar_csv(asked.name, _shape_answer(asked)))


def _thumbnail(asked: Question) -> Reply:
    record = asked.catalogue.get(asked.name)
    if record is None:
        raise NotFound(f"there is no shape {asked.name!r}")
    picture = asked.site.thumbnails.of(asked.catalogue, record)
    if picture is None:
        raise NotFound(f"the shape {asked.name!r} has no picture, because its mesh is not stored")
    return Reply(picture, "image/png", KEPT)


def _scene(asked: Question) -> Reply:
    return json_reply(scene_document(asked.catalogue, asked.name, asked.site.thumbnails))


def _glb(asked: Question) -> Reply:
    headers = FRESH | {"content-disposition": 'attachment; filename="shape.glb"'}
    return Reply(glb_of(asked.catalogue, asked.name), "model/gltf-binary", headers)


def _scan_job(asked: Question) -> Reply:
    return json_reply(job_document(_job(asked)))


def _scan_thumbnail(asked: Question) -> Reply:
    described = _job(asked).described
    if described is None or described.picture is None:
        raise NotFound("the scan has no picture, because it has no surface")
    return Reply(described.picture, "image/png", FRESH)


def _scan_similar(asked: Question) -> Reply:
    return json_reply(_scan_document(asked))


def _scan_table(asked: Question) -> Reply:
    job = _job(asked)
    return csv_reply(similar_csv(job.name, _scan_answer(asked, job)))


def _job(asked: Question) -> Job:
    return jobs_of(asked.site).job(asked.name)


def _shape_answer(asked: Question) -> Answer:
    if asked.catalogue.get(asked.name) is None:
        raise NotFound(f"there is no shape {asked.name!r}")
    return similar_to(asked.catalogue, asked.name, Similar.of(asked.fields), asked.site.options)


def _scan_answer(asked: Question, job: Job) -> Answer:
    if job.described is None:
        raise InputError(
            f"the scan has no signature, it is {job.state}: ask for /scans/{job.id} until it is done"
        )
    return similar_to(asked.catalogue, job.described, Similar.of(asked.fields), asked.site.options)


def _scan_document(asked: Question) -> dict[str, object]:
    job = _job(asked)
    answer = _scan_answer(asked, job)
    similar = Similar.of(asked.fields)
    return similar_document(asked.catalogue, job.name, similar, asked.site.options, answer)


LISTED = (
    Field("q", "parts of names, in any case; all must occur"),
    Field("label", "a class"),
    Field("state", "all shapes, those with a signature, the doubtful or the failed ones", choices=STATES),
    Field("since", "first day on which shapes were added, such as 2026-01-31"),
    Field("until", "last day on which shapes were added"),
    Field("sort", "the order; - for descending", choices=SORTS),
    Field("page", "number of the page, from 1", "integer"),
)
ASKED = (
    Field("k", "number of results, 12 by default", "integer"),
    Field("label", "search shapes of this class only"),
    Field("min_score", "least score of a result, from 0 to 1", "number"),
)
KEPT_AS = (
    Field("id", "name of the shape, and of its file on the server", required=True),
    Field("label", "its class"),
)
PAIR = (Field("a", "name of a shape", required=True), Field("b", "name of another shape", required=True))

JSON, CSV = "application/json", "text/csv"

ENDPOINTS = (
    Endpoint("/", _collection, "the page of the collection", fields=LISTED),
    Endpoint("/map", _map, "the page of the map of the collection"),
    Endpoint("/shape/{id}", _shape, "the page of a shape and its nearest shapes", fields=ASKED),
    Endpoint("/compare", _compare, "the page of two shapes, and of what differs", fields=PAIR),
    Endpoint("/scan/{id}", _scan, "the page of an uploaded scan", fields=ASKED),
    Endpoint("/scan/{id}/inspection", _inspection, "the page of the inspection of an uploaded scan"),
    Endpoint("/shapes", _shapes, "60 shapes a page", JSON, LISTED),
    Endpoint("/shapes/{id}", _one, "what the catalogue says of a shape", JSON),
    Endpoint("/shapes/{id}/similar", _similar, "the nearest shapes of a shape, without itself", JSON, ASKED),
    Endpoint("/shapes/{id}/similar.csv", _similar_table, "the nearest shapes as a table", CSV, ASKED),
    Endpoint("/shapes/{id}/thumbnail.png", _thumbnail, "a picture of a shape", "image/png"),
    Endpoint("/shapes/{id}/scene", _scene, "a shape for the 3-D viewer, of at most 20,000 faces", JSON),
    Endpoint("/shapes/{id}/mesh.glb", _glb, "the surface of a shape", "model/gltf-binary"),
    Endpoint("/scans/{id}", _scan_job, "how far the processing of an uploaded scan is", JSON),
    Endpoint("/scans/{id}/thumbnail.png", _scan_thumbnail, "a picture of an uploaded scan", "image/png"),
    Endpoint("/scans/{id}/similar", _scan_similar, "the nearest shapes of an uploaded scan", JSON, ASKED),
    Endpoint("/scans/{id}/similar.csv", _scan_table, "the nearest shapes as a table", CSV, ASKED),
)
