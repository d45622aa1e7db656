"""Addresses → answers, by Starlette, which is installed by the extra ``web``."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from importlib.resources import files
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, quote, unquote

from pcretrieve.catalogue import Record
from pcretrieve.errors import CatalogueError, InputError, PcretrieveError
from pcretrieve.web.documents import job_document, shape_document
from pcretrieve.web.endpoints import ENDPOINTS, Endpoint, Question, jobs_of
from pcretrieve.web.folders import without_folders
from pcretrieve.web.guard import Application
from pcretrieve.web.openapi import openapi_document
from pcretrieve.web.replies import FRESH, KEPT
from pcretrieve.web.requests import Busy, NotFound, TooLarge, TooSlow
from pcretrieve.web.site import Site
from pcretrieve.web.uploads import checked_suffix, received
from pcretrieve.web.views import refusal_page

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

__all__ = ["application"]

logger = logging.getLogger(__name__)

# The files that pages refer to, and their types.
ASSETS = {
    "page.css": "text/css",
    "inspection.css": "text/css",
    "search.css": "text/css",
    "map.css": "text/css",
    "compare.js": "text/javascript",
    "htmx.min.js": "text/javascript",
    "map.js": "text/javascript",
    "progress.js": "text/javascript",
    "upload.js": "text/javascript",
    "view.js": "text/javascript",
    "viewer.js": "text/javascript",
}

# Time between two looks at a job, and the longest time until the connection of a refused scan is closed, as
# browsers may read the answer after they have sent the rest, which is not kept; seconds.
LOOK = 0.25
LINGER = 5.0

# Largest size of a form; bytes.
LONGEST_FORM = 10_000


def application(site: Site) -> Application:
    """The application that answers requests, without any check of who asks."""
    from starlette.applications import Starlette
    from starlette.exceptions import HTTPException
    from starlette.requests import ClientDisconnect
    from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
    from starlette.routing import Route

    def answered(endpoint: Endpoint) -> Callable[[Request], Awaitable[Response]]:
        async def handler(request: Request) -> Response:
            name, fields = _name(request), request.query_params
            readers = site.searching if endpoint.searches else site.drawing
            reply = await readers.read(
                lambda catalogue: endpoint.answer(Question(site, catalogue, name, fields))
            )
            return Response(reply.content, media_type=reply.media_type, headers=dict(reply.headers))

        return handler

    async def new_scan(request: Request) -> Response:
        jobs, name = jobs_of(site), request.query_params.get("name", "")
        suffix = checked_suffix(name)
        upload = jobs.begin(name)
        try:
            scan = await received(
                request.stream(),
                upload.folder,
                suffix,
                most_bytes=site.most_bytes,
                announced=request.headers.get("content-length"),
            )
        except BaseException as error:
            jobs.abandon(upload)
            if isinstance(error, ClientDisconnect):
                return Response(status_code=400)
            raise
        document = job_document(upload.job)
        jobs.submit(upload, scan)
        return JSONResponse(document, 202, headers=FRESH | {"location": f"/scans/{upload.job.id}"})

    async def keep_scan(request: Request) -> Response:
        """For scripts: the fields are in the address, and the answer is JSON."""
        record = await kept(request, request.query_params)
        address = f"/shapes/{quote(record.id, safe='')}"
        return JSONResponse(shape_document(record), 201, headers=FRESH | {"location": address})

    async def keep_scan_by_form(request: Request) -> Response:
        """For the form of the page: the fields are in the body, and the answer is the page of the shape."""
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > LONGEST_FORM:
                raise TooLarge(f"the form may have at most {LONGEST_FORM} bytes")
        record = await kept(request, dict(parse_qsl(body.decode("utf-8", "replace"))))
        address = f"/shape/{quote(record.id, safe='')}"
        return Response(status_code=303, headers=FRESH | {"location": address})

    async def kept(request: Request, fields: Mapping[str, str]) -> Record:
        label = fields.get("label", "").strip()
        future = jobs_of(site).keep(_name(request), fields.get("id", "").strip(), label or None)
        return await asyncio.wrap_future(future)

    async def scan_events(request: Request) -> Response:
        job = jobs_of(site).job(_name(request))
        return StreamingResponse(_events(site, job.id), media_type="text/event-stream", headers=FRESH)

    async def openapi(request: Request) -> Response:
        return JSONResponse(openapi_document(), headers=FRESH)

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in ASSETS:
            raise NotFound(f"there is no file {name!r}")
        content = (files("pcretrieve.pages") / "assets" / name).read_bytes()
        return Response(content, media_type=ASSETS[name], headers=KEPT)

    async def refused(request: Request, error: Exception) -> Response:
        status, message = _status(error)
        if request.scope["path"].startswith(("/shapes", "/scans", "/openapi.json")):
            told = JSONResponse({"error": type(error).__name__, "message": message}, status, headers=FRESH)
            if request.method in ("GET", "HEAD"):
                return told
            closed = {**told.headers, "connection": "close"}
            return StreamingResponse(_then_silent(bytes(told.body)), status, closed)
        return HTMLResponse(refusal_page(site.title, message), status, headers=FRESH)

    async def nowhere(request: Request, error: Exception) -> Response:
        status = error.status_code if isinstance(error, HTTPException) else 404
        words = "there is no such page" if status == 404 else "this address is not used so"
        return HTMLResponse(refusal_page(site.title, words), status, headers=FRESH)

    made: Application = Starlette(
        routes=[
            *(Route(endpoint.path, answered(endpoint)) for endpoint in ENDPOINTS),
            Route("/scans", new_scan, methods=["POST"]),
            Route("/scans/{id}/keep", keep_scan, methods=["POST"]),
            Route("/scan/{id}/keep", keep_scan_by_form, methods=["POST"]),
            Route("/scans/{id}/events", scan_events),
            Route("/openapi.json", openapi),
            Route("/assets/{name}", asset),
        ],
        exception_handlers={PcretrieveError: refused, HTTPException: nowhere, Exception: refused},
    )
    return made


def _name(request: Request) -> str:
    """The name of a shape in the path, which is percent-encoded still; empty if there is none."""
    return unquote(request.path_params.get("id", ""))


def _status(error: Exception) -> tuple[int, str]:
    """The status and the message for an error. What the caller cannot mend is logged, and not told."""
    if isinstance(error, NotFound):
        return 404, error.message
    if isinstance(error, TooLarge):
        return 413, error.message
    if isinstance(error, TooSlow):
        return 408, error.message
    if isinstance(error, Busy):
        return 503, error.message
    if isinstance(error, InputError) and not isinstance(error, CatalogueError):
        return 400, without_folders(error.message)
    logger.error("a request failed: %s", error, exc_info=error)
    return 500, "the server failed to answer; its log says why"


async def _then_silent(body: bytes) -> AsyncIterator[bytes]:
    yield body
    await asyncio.sleep(LINGER)


async def _events(site: Site, job_id: str) -> AsyncIterator[str]:
    """The document of a job at each change, as events that a server sends, until the scan is inspected."""
    last = None
    while True:
        job = jobs_of(site).job(job_id)
        has_ended = job.has_ended and job.inspection != "waiting"
        if (now := json.dumps(job_document(job))) != last:
            last = now
            yield f"data: {now}\n\n"
        if has_ended:
            return
        await asyncio.sleep(LOOK)
