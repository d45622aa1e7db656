"""Addresses → handlers, by Starlette, which is installed by the extra ``web``.

Addresses in the plural, ``/shapes/...``, have data for scripts; those in the singular, ``/shape/...``, pages.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from pcretrieve.errors import CatalogueError, InputError, PcretrieveError
from pcretrieve.web.documents import (
    job_document,
    listing_document,
    shape_document,
    similar_csv,
    similar_document,
    similar_to,
    without_folders,
)
from pcretrieve.web.guard import Application
from pcretrieve.web.jobs import Job, Jobs
from pcretrieve.web.requests import Busy, Listing, NotFound, Similar, TooLarge
from pcretrieve.web.site import Site
from pcretrieve.web.uploads import checked_suffix, received
from pcretrieve.web.views import collection_page, refusal_page, scan_page, shape_page

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

    from pcretrieve.catalogue import Catalogue
    from pcretrieve.searching import Answer

__all__ = ["application"]

logger = logging.getLogger(__name__)

# The files that pages refer to, and their types.
ASSETS = {
    "page.css": "text/css",
    "search.css": "text/css",
    "htmx.min.js": "text/javascript",
    "progress.js": "text/javascript",
    "upload.js": "text/javascript",
}

# Answers that belong to one state of the catalogue are asked for again each time, pictures once in an hour.
FRESH = {"cache-control": "private, no-cache"}
KEPT = {"cache-control": "private, max-age=3600"}

# Longest time in which a scan must have been received, and the time between two looks at a job; seconds.
RECEIVING_TIMEOUT = 600.0
LOOK = 0.25


def application(site: Site) -> Application:
    """The application that answers requests, without any check of who asks.

    Parameters
    ----------
    site : Site
        The catalogue.

    Returns
    -------
    ASGI application
        The application. Paths are given to it percent-encoded.
    """
    from starlette.applications import Starlette
    from starlette.exceptions import HTTPException
    from starlette.requests import ClientDisconnect
    from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
    from starlette.routing import Route

    async def collection(request: Request) -> Response:
        listing = Listing.of(request.query_params)
        page = await site.readers.read(partial(_collection, site, listing))
        return HTMLResponse(page, headers=FRESH)

    async def shape(request: Request) -> Response:
        asked = Similar.of(request.query_params)
        page = await site.readers.read(partial(_shape, site, _name(request), asked))
        return HTMLResponse(page, headers=FRESH)

    async def shapes_document(request: Request) -> Response:
        listing = Listing.of(request.query_params)
        document = await site.readers.read(lambda catalogue: listing_document(catalogue, listing))
        return JSONResponse(document, headers=FRESH)

    async def one_document(request: Request) -> Response:
        document = await site.readers.read(partial(_document, _name(request)))
        return JSONResponse(document, headers=FRESH)

    async def similar(request: Request) -> Response:
        asked = Similar.of(request.query_params)
        document = await site.readers.read(partial(_similar, site, _name(request), asked))
        return JSONResponse(document, headers=FRESH)

    async def similar_table(request: Request) -> Response:
        asked = Similar.of(request.query_params)
        table = await site.readers.read(partial(_table, site, _name(request), asked))
        headers = FRESH | {"content-disposition": 'attachment; filename="similar.csv"'}
        return Response(table, media_type="text/csv", headers=headers)

    async def picture(request: Request) -> Response:
        name = _name(request)
        drawn = await site.readers.read(lambda catalogue: site.thumbnails.of(catalogue, name))
        return Response(drawn, media_type="image/png", headers=KEPT)

    async def new_scan(request: Request) -> Response:
        jobs, name = _jobs(site), request.query_params.get("name", "")
        suffix = checked_suffix(name)
        upload = jobs.begin(name)
        try:
            body = received(
                request.stream(),
                Path(upload.folder.name),
                suffix,
                most_bytes=site.most_bytes,
                announced=request.headers.get("content-length"),
            )
            scan = await asyncio.wait_for(body, RECEIVING_TIMEOUT)
        except BaseException as error:
            jobs.abandon(upload)
            if isinstance(error, ClientDisconnect):
                return Response(status_code=400)
            raise
        document = job_document(upload.job)
        jobs.submit(upload, scan)
        return JSONResponse(document, 202, headers=FRESH | {"location": f"/scans/{upload.job.id}"})

    async def scan(request: Request) -> Response:
        job, asked = _jobs(site).job(_name(request)), Similar.of(request.query_params)
        page = await site.readers.read(partial(_scan, site, job, asked))
        return HTMLResponse(page, headers=FRESH)

    async def scan_document(request: Request) -> Response:
        return JSONResponse(job_document(_jobs(site).job(_name(request))), headers=FRESH)

    async def scan_events(request: Request) -> Response:
        job = _jobs(site).job(_name(request))
        return StreamingResponse(_events(site, job.id), media_type="text/event-stream", headers=FRESH)

    async def scan_similar(request: Request) -> Response:
        job, asked = _jobs(site).job(_name(request)), Similar.of(request.query_params)
        document = await site.readers.read(partial(_scan_similar, site, job, asked))
        return JSONResponse(document, headers=FRESH)

    async def scan_table(request: Request) -> Response:
        job, asked = _jobs(site).job(_name(request)), Similar.of(request.query_params)
        table = await site.readers.read(partial(_scan_table, site, job, asked))
        headers = FRESH | {"content-disposition": 'attachment; filename="similar.csv"'}
        return Response(table, media_type="text/csv", headers=headers)

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in ASSETS:
            raise NotFound(f"there is no file {name!r}")
        content = (files("pcretrieve.pages") / "assets" / name).read_bytes()
        return Response(content, media_type=ASSETS[name], headers=KEPT)

    async def refused(request: Request, error: Exception) -> Response:
        status, message = _status(error)
        if request.scope["path"].startswith(("/shapes", "/scans")):
            kind = type(error).__name__
            return JSONResponse({"error": kind, "message": message}, status, headers=FRESH)
        return HTMLResponse(refusal_page(site.title, message), status, headers=FRESH)

    async def nowhere(request: Request, error: Exception) -> Response:
        status = error.status_code if isinstance(error, HTTPException) else 404
        words = "there is no such page" if status == 404 else "this address is not used so"
        return HTMLResponse(refusal_page(site.title, words), status, headers=FRESH)

    made: Application = Starlette(
        routes=[
            Route("/", collection),
            Route("/shape/{id}", shape),
            Route("/shapes", shapes_document),
            Route("/shapes/{id}", one_document),
            Route("/shapes/{id}/similar", similar),
            Route("/shapes/{id}/similar.csv", similar_table),
            Route("/shapes/{id}/thumbnail.png", picture),
            Route("/scan/{id}", scan),
            Route("/scans", new_scan, methods=["POST"]),
            Route("/scans/{id}", scan_document),
            Route("/scans/{id}/events", scan_events),
            Route("/scans/{id}/similar", scan_similar),
            Route("/scans/{id}/similar.csv", scan_table),
            Route("/assets/{name}", asset),
        ],
        exception_handlers={PcretrieveError: refused, HTTPException: nowhere, Exception: refused},
    )
    return made


def _name(request: Request) -> str:
    """The name of a shape in the path, which is percent-encoded still."""
    name: str = request.path_params["id"]
    return unquote(name)


def _status(error: Exception) -> tuple[int, str]:
    """The status and the message for an error. What the caller cannot mend is logged, and not told."""
    if isinstance(error, NotFound):
        return 404, error.message
    if isinstance(error, TooLarge):
        return 413, error.message
    if isinstance(error, Busy):
        return 503, error.message
    if isinstance(error, InputError) and not isinstance(error, CatalogueError):
        return 400, without_folders(error.message)
    logger.error("a request failed: %s", error, exc_info=error)
    return 500, "the server failed to answer; its log says why"


def _collection(site: Site, listing: Listing, catalogue: Catalogue) -> str:
    return collection_page(catalogue, site.title, listing, 0 if site.jobs is None else site.most_bytes)


def _shape(site: Site, name: str, asked: Similar, catalogue: Catalogue) -> str:
    return shape_page(catalogue, site.title, name, asked, site.options)


def _jobs(site: Site) -> Jobs:
    if site.jobs is None:
        raise NotFound("this server takes no scans: it was started with --read-only")
    return site.jobs


async def _events(site: Site, job_id: str) -> AsyncIterator[str]:
    """The document of a job at each change, as events that a server sends, until the job has ended."""
    last = None
    while True:
        job = _jobs(site).job(job_id)
        has_ended = job.has_ended
        if (now := json.dumps(job_document(job))) != last:
            last = now
            yield f"data: {now}\n\n"
        if has_ended:
            return
        await asyncio.sleep(LOOK)


def _scan(site: Site, job: Job, asked: Similar, catalogue: Catalogue) -> str:
    found = None if job.described is None else _scan_similar(site, job, asked, catalogue)
    return scan_page(catalogue, site.title, job_document(job), asked, found)


def _scan_answer(site: Site, job: Job, asked: Similar, catalogue: Catalogue) -> Answer:
    if job.described is None:
        raise InputError(
            f"the scan has no signature, it is {job.state}: ask for /scans/{job.id} until it is done"
        )
    return similar_to(catalogue, job.described, asked, site.options)


def _scan_similar(site: Site, job: Job, asked: Similar, catalogue: Catalogue) -> dict[str, Any]:
    answer = _scan_answer(site, job, asked, catalogue)
    return similar_document(catalogue, job.name, asked, site.options, answer)


def _scan_table(site: Site, job: Job, asked: Similar, catalogue: Catalogue) -> str:
    return similar_csv(job.name, _scan_answer(site, job, asked, catalogue))


def _document(name: str, catalogue: Catalogue) -> dict[str, Any]:
    record = catalogue.get(name)
    if record is None:
        raise NotFound(f"there is no shape {name!r}")
    return shape_document(record)


def _similar(site: Site, name: str, asked: Similar, catalogue: Catalogue) -> dict[str, Any]:
    _document(name, catalogue)
    answer = similar_to(catalogue, name, asked, site.options)
    return similar_document(catalogue, name, asked, site.options, answer)


def _table(site: Site, name: str, asked: Similar, catalogue: Catalogue) -> str:
    _document(name, catalogue)
    return similar_csv(name, similar_to(catalogue, name, asked, site.options))
