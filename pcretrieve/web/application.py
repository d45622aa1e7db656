"""Every address of the server, and what it answers with, by Starlette.

Addresses in the plural, ``/shapes/...``, have data for scripts; those in the singular, ``/shape/...``, pages.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from threading import Barrier, local
from typing import Any, TypeVar
from urllib.parse import parse_qsl, quote, unquote
from zlib import crc32

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    HTMLResponse,
    JSONResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from pcretrieve import Answer, Catalogue, PipelineOptions, Record, mark
from pcretrieve.errors import CatalogueError, InputError, PcretrieveError
from pcretrieve.gallery.answers import Question, answer_to
from pcretrieve.pages.html import page_of, without_folders
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.values import UPWARD
from pcretrieve.web.comparison import Maps, compared, mesh_of, scene_document
from pcretrieve.web.documents import (
    PAGE,
    job_document,
    listing_document,
    record_of,
    shape_document,
    similar_csv,
    similar_document,
)
from pcretrieve.web.jobs import Job, Jobs
from pcretrieve.web.requests import (
    ONE_FILE,
    Listing,
    Refused,
    Similar,
    checked_suffix,
    received,
)

logger = logging.getLogger(__name__)

# Answers belong to one state of the catalogue, and are asked for again each time.
FRESH = {"cache-control": "private, no-cache"}

# Time between two looks at a job, and the longest time until the connection of a refused scan is closed, as
# browsers may read the answer after they have sent the rest, which is not kept; seconds.
LOOK = 0.25
LINGER = 5.0

# Largest number of answers that are kept, of at most 70 kB each.
MOST_ANSWERS = 100

# Largest number of classes that a page names for a choice; with more, the name is typed. Ten thousand take
# half a megabyte, and a tenth of a second, on each page.
MOST_CLASSES = 500

# More shapes than any catalogue has, all of which are on the only page of an exported site.
ALL = 10**9

# Largest number of other scans of a class on the page of a shape.
MOST_OTHERS = 24

# Largest size of a form; bytes.
LONGEST_FORM = 10_000

Found = TypeVar("Found")


class Readers:
    """A few threads, each with the catalogue open: a connection belongs to the thread that made it."""

    def __init__(self, location: str, n: int) -> None:
        self._location, self._n, self._own = location, n, local()
        self._threads = ThreadPoolExecutor(n, thread_name_prefix="pcretrieve-reader")

    async def read(self, function: Callable[[Catalogue], Found]) -> Found:
        """Apply a function to the catalogue in one of the threads."""
        return await asyncio.wrap_future(self._threads.submit(self._applied, function))

    def prepare(self, function: Callable[[Catalogue], object]) -> None:
        """Apply a function to the catalogue in one of the threads, without waiting for it."""
        self._threads.submit(self._applied, function)

    def close(self) -> None:
        """Close the catalogue in all threads, and end them."""
        # As many tasks as threads that wait for each other, so that each thread has one of them.
        barrier = Barrier(self._n)
        for _ in range(self._n):
            self._threads.submit(self._closed, barrier)
        self._threads.shutdown()

    def _applied(self, function: Callable[[Catalogue], Found]) -> Found:
        catalogue: Catalogue | None = getattr(self._own, "catalogue", None)
        if catalogue is None:
            catalogue = self._own.catalogue = Catalogue(self._location)
            catalogue.rows.answer_at_once()
        return function(catalogue)

    def _closed(self, barrier: Barrier) -> None:
        barrier.wait()
        if hasattr(self._own, "catalogue"):
            self._own.catalogue.close()


class Answers:
    """The latest answers by address, each of one state of the catalogue; for one thread."""

    def __init__(self) -> None:
        self._kept: OrderedDict[object, tuple[float, object, Response]] = OrderedDict()

    def of(self, asked: Asked, answer: Callable[[Asked], Response]) -> Response:
        """The answer to a request: that to an earlier one, if it would be the same."""
        scope, pictures = asked.request.scope, asked.site.thumbnails
        address = scope["path"], scope["query_string"]
        begun, state, kept = self._kept.pop(address, (0.0, None, None))
        # Requests that have waited for an answer share the next one, which has begun after they arrived.
        if kept is None or begun < asked.arrived:
            begun = time.monotonic()
            now = asked.catalogue.rows.state(), pictures.up
            if kept is None or state != now:
                state, kept = now, answer(asked)
        self._kept[address] = begun, state, kept
        if len(self._kept) > MOST_ANSWERS:
            self._kept.popitem(last=False)
        return kept


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """One catalogue and everything that is kept of it between requests."""

    searching: Readers
    listing: Readers
    drawing: Readers
    title: str
    options: PipelineOptions
    given_jobs: Jobs | None
    most_bytes: int
    thumbnails: Thumbnails
    maps: Maps
    answers: Answers = field(default_factory=Answers)
    exported: bool = False

    @property
    def jobs(self) -> Jobs:
        """The uploaded scans."""
        if self.given_jobs is None:
            raise Refused("this server takes no scans: it was started with --read-only")
        return self.given_jobs

    def close(self) -> None:
        """End all threads and processes."""
        if self.given_jobs is not None:
            self.given_jobs.close()
        self.maps.close()
        for readers in (self.searching, self.listing, self.drawing):
            readers.close()

    @property
    def keeps_scans(self) -> bool:
        """Whether uploaded scans can be kept."""
        return self.given_jobs is not None and self.given_jobs.collection is not None


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A request that a reader of the catalogue answers."""

    site: Site
    catalogue: Catalogue
    request: Request
    arrived: float

    @property
    def name(self) -> str:
        """The id of a shape or of a job in the path."""
        return _name(self.request)

    @property
    def record(self) -> Record:
        """The shape of the path."""
        return record_of(self.catalogue, self.name)

    @property
    def job(self) -> Job:
        """The uploaded scan of the path."""
        return self.site.jobs.job(self.name)

    @property
    def classes(self) -> dict[str, int] | None:
        """The classes that can be chosen, and their sizes; None if they are too many."""
        found = self.catalogue.rows.classes(MOST_CLASSES + 1)
        return dict(sorted(found.items())) if len(found) <= MOST_CLASSES else None

    @property
    def similar(self) -> Similar:
        """What is asked of its neighbours."""
        return Similar.of(self.request.query_params)

    def page(self, template: str, **context: Any) -> Response:
        """A page by a template."""
        site = {"title": self.site.title, "exported": self.site.exported}
        return HTMLResponse(page_of(template, **site, **context), headers=FRESH)

    def answer(self, job: Job | None = None) -> Answer:
        """The neighbours of the scan of a job, or else of the shape that the path names."""
        query = self.record.id if job is None else job.described
        if query is None:
            raise InputError(
                f"the scan has no signature: ask for /scans/{self.name} until it is done"
            )
        asked = self.similar
        labels = [asked.label] if asked.label else None
        question = Question(
            self.site.options,
            asked.k,
            labels,
            exclude_self=True,
            min_score=asked.min_score,
        )
        return answer_to(self.catalogue, query, question)

    def found(self, job: Job | None = None) -> dict[str, Any]:
        """The answer as a document."""
        name = self.name if job is None else job.name
        return similar_document(
            self.catalogue, name, self.similar, self.site.options, self.answer(job)
        )


class _Json(JSONResponse):
    """A JSON document in ASCII, because names of files need not be UTF-8; it is asked for again each time."""

    def __init__(self, content: Any, status: int = 200, **headers: str) -> None:
        super().__init__(content, status, headers=FRESH | headers)

    def render(self, content: Any) -> bytes:
        return json.dumps(content, separators=(",", ":")).encode()


# --- pages ------------------------------------------------------------------------------------------------


def _collection(asked: Asked) -> Response:
    listing = Listing.of(asked.request.query_params)
    return asked.page(
        "collection.html",
        listing=listing,
        found=listing_document(
            asked.catalogue, listing, ALL if asked.site.exported else PAGE
        ),
        classes=asked.classes,
        suffixes=() if asked.site.given_jobs is None else ONE_FILE,
        most_bytes=asked.site.most_bytes,
        keeps_scans=asked.site.keeps_scans,
        axes=("", *UPWARD),
        pictures=asked.site.thumbnails,
    )


def _shape(asked: Asked) -> Response:
    record, rows = asked.record, asked.catalogue.rows
    writes = asked.site.given_jobs is not None
    others = rows.wanted(label=record.label, limit=MOST_OTHERS)[1] if record.label else ()
    return asked.page(
        "shape.html",
        shape=shape_document(record),
        asked=asked.similar,
        found=asked.found() if record.status == "done" else None,
        classes=asked.classes,
        has_surface="meshes" in asked.catalogue.options.catalogue.keep,
        others=others,
        can_be_marked=writes,
        can_be_inspected=writes and Path(record.path).is_file(),
        can_be_turned=writes and asked.site.thumbnails.up is None,
    )


def _compare(asked: Asked) -> Response:
    site, shown = asked.site, dict[str, Any](shapes=())
    pair = [asked.request.query_params.get(name, "") for name in "ab"]
    if all(pair):
        shown = compared(asked.catalogue, pair, site.options, site.thumbnails)
    else:
        _, shown["ids"] = asked.catalogue.rows.wanted(state="done", limit=MOST_CLASSES)
    return asked.page("compare.html", pair=pair, **shown)


def _scan(asked: Asked) -> Response:
    job = asked.job
    described = job.described
    return asked.page(
        "scan.html",
        asked=asked.similar,
        found=None if described is None else asked.found(job),
        job=job_document(job),
        classes=asked.classes,
        has_picture=described is not None and described.picture is not None,
        can_be_kept=job.scan is not None and asked.site.keeps_scans,
    )


def _inspection(asked: Asked) -> Response:
    job = asked.job
    if job.page is None:
        raise Refused(
            "the inspection of this scan is not ready: try again in a few seconds"
            if job.inspection == "waiting"
            else "the inspection of this scan failed, or is too long ago: use `pcretrieve inspect`"
        )
    return HTMLResponse(job.page, headers=FRESH)


# --- data -------------------------------------------------------------------------------------------------


def _download(content: bytes, name: str, kind: str) -> Response:
    headers = FRESH | {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, headers=headers, media_type=kind)


def _table(name: str, answer: Answer) -> Response:
    return _download(
        similar_csv(name, answer).encode("utf-8", "replace"), "similar.csv", "text/csv"
    )


def _thumbnail(asked: Asked) -> Response:
    picture = asked.site.thumbnails.of(asked.catalogue, asked.record)
    if picture is None:
        raise Refused(
            f"the shape {asked.name!r} has no picture, because its mesh is not stored"
        )
    # Browsers keep pictures, and ask whether they have been turned.
    headers = FRESH | {"etag": f'"{crc32(picture):x}"'}
    if asked.request.headers.get("if-none-match") == headers["etag"]:
        return Response(status_code=304, headers=headers)
    return Response(picture, headers=headers, media_type="image/png")


def _scene(asked: Asked) -> Response:
    than, thumbnails = asked.request.query_params.get("than"), asked.site.thumbnails
    return _Json(scene_document(asked.catalogue, asked.name, thumbnails, than))


def _glb(asked: Asked) -> Response:
    """The surface of a shape as a binary glTF file, in the unit of the scan."""
    content = mesh_of(asked.catalogue, asked.name).to_trimesh().export(file_type="glb")
    return _download(content, "shape.glb", "model/gltf-binary")


def _scan_thumbnail(asked: Asked) -> Response:
    described = asked.job.described
    if described is None or described.picture is None:
        raise Refused("the scan has no picture, because it has no surface")
    return Response(described.picture, headers=FRESH, media_type="image/png")


# --- uploaded scans ---------------------------------------------------------------------------------------


async def _new_scan(request: Request) -> Response:
    name, jobs = request.query_params.get("name", ""), _site(request).jobs
    suffix = checked_suffix(name)
    job = jobs.begin(name)
    path = job.folder / f"scan{suffix}"
    try:
        await received(request, path, most_bytes=_site(request).most_bytes)
    except BaseException as error:
        jobs.abandon(job)
        if isinstance(error, ClientDisconnect):
            return Response(status_code=400)
        raise
    document = job_document(job)
    jobs.submit(job, path)
    return _Json(document, 202, location=f"/scans/{job.id}")


async def _keep_scan(request: Request) -> Response:
    """For scripts: the fields are in the address, and the answer is JSON."""
    record = await _kept(request, request.query_params)
    return _Json(
        shape_document(record), 201, location=f"/shapes/{quote(record.id, safe='')}"
    )


async def _keep_scan_by_form(request: Request) -> Response:
    """For the form of the page: the fields are in the body, and the answer is the page of the shape."""
    return _to_shape((await _kept(request, await _form(request))).id)


def _to_shape(name: str) -> Response:
    return RedirectResponse(f"/shape/{quote(name, safe='')}", 303, headers=FRESH)


async def _form(request: Request) -> dict[str, str]:
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > LONGEST_FORM:
            raise Refused(f"the form may have at most {LONGEST_FORM} bytes", 413)
    return dict(parse_qsl(body.decode("utf-8", "replace")))


# --- which way is up --------------------------------------------------------------------------------------


async def _say_up(request: Request) -> Response:
    """All shapes of a catalogue stand along an axis of their files."""
    up, site = (await _form(request)).get("up"), _site(request)
    await site.drawing.read(lambda catalogue: site.thumbnails.say(catalogue, up))
    return RedirectResponse("/", 303, headers=FRESH)


async def _turn(request: Request) -> Response:
    """One shape is turned by a quarter."""
    forwards, site, name = (
        (await _form(request)).get("way") == "forwards",
        _site(request),
        _name(request),
    )
    await site.drawing.read(
        lambda catalogue: site.thumbnails.turn(
            catalogue, record_of(catalogue, name), forwards=forwards
        )
    )
    return _to_shape(name)


async def _mark(request: Request) -> Response:
    """What a person decides about a scan is kept; an empty decision forgets it."""
    fields, name = await _form(request), _name(request)
    decision, note = (fields.get(key, "").strip() for key in ("decision", "note"))
    await _site(request).listing.read(
        lambda catalogue: mark(
            catalogue, [record_of(catalogue, name).id], decision or None, note
        )
    )
    return _to_shape(name)


async def _inspect(request: Request) -> Response:
    """The file of a stored shape is inspected, as uploaded scans are."""
    site, name = _site(request), _name(request)
    record = await site.searching.read(lambda catalogue: record_of(catalogue, name))
    job = site.jobs.inspect(record.id, Path(record.path))
    return RedirectResponse(f"/scan/{job.id}", 303, headers=FRESH)


async def _kept(request: Request, fields: Mapping[str, str]) -> Record:
    label = fields.get("label", "").strip()
    future = _site(request).jobs.keep(
        _name(request), fields.get("id", "").strip(), label or None
    )
    return await asyncio.wrap_future(future)


async def _scan_events(request: Request) -> Response:
    jobs, job_id = _site(request).jobs, _name(request)
    jobs.job(job_id)
    return StreamingResponse(
        _events(jobs, job_id), media_type="text/event-stream", headers=FRESH
    )


async def _events(jobs: Jobs, job_id: str) -> AsyncIterator[str]:
    """The document of a job at each change, as events that a server sends, until the scan is inspected."""
    last = None
    while True:
        job = jobs.job(job_id)
        has_ended = job.has_ended
        if (now := json.dumps(job_document(job))) != last:
            last = now
            yield f"data: {now}\n\n"
        if has_ended:
            return
        await asyncio.sleep(LOOK)


TURNS = (
    Route("/up", _say_up, methods=["POST"]),
    Route("/shape/{id}/turn", _turn, methods=["POST"]),
    Route("/shape/{id}/mark", _mark, methods=["POST"]),
    Route("/shape/{id}/inspect", _inspect, methods=["POST"]),
)

# --- addresses --------------------------------------------------------------------------------------------

# Answers from the catalogue. The first are one search, which takes milliseconds, or less.
SEARCHES: dict[str, Callable[[Asked], Response]] = {
    "/shape/{id}": _shape,
    "/scan/{id}": _scan,
    "/shapes/{id}": lambda asked: _Json(shape_document(asked.record)),
    "/shapes/{id}/similar": lambda asked: _Json(asked.found()),
    "/shapes/{id}/similar.csv": lambda asked: _table(asked.name, asked.answer()),
    "/scans/{id}": lambda asked: _Json(job_document(asked.job)),
    "/scans/{id}/similar": lambda asked: _Json(asked.found(asked.job)),
    "/scans/{id}/similar.csv": lambda asked: _table(
        asked.job.name, asked.answer(asked.job)
    ),
}
# Lists, which are kept.
LISTS: dict[str, Callable[[Asked], Response]] = {
    "/": _collection,
    "/shapes": lambda asked: _Json(
        listing_document(asked.catalogue, Listing.of(asked.request.query_params))
    ),
}
OTHERS: dict[str, Callable[[Asked], Response]] = {
    "/map": lambda asked: asked.page(
        "search_map.html", **asked.site.maps.shown(asked.catalogue)
    ),
    "/compare": _compare,
    "/scan/{id}/inspection": _inspection,
    "/shapes/{id}/thumbnail.png": _thumbnail,
    "/shapes/{id}/scene": _scene,
    "/shapes/{id}/mesh.glb": _glb,
    "/scans/{id}/thumbnail.png": _scan_thumbnail,
}


def application(site: Site) -> Starlette:
    """The application that answers requests, without any check of who asks."""
    made = Starlette(
        routes=[
            *(
                Route(path, _read(answer, site.searching))
                for path, answer in SEARCHES.items()
            ),
            *(
                Route(path, _read(_kept_answer(answer), site.listing))
                for path, answer in LISTS.items()
            ),
            *(
                Route(path, _read(answer, site.drawing))
                for path, answer in OTHERS.items()
            ),
            Route("/scans", _new_scan, methods=["POST"]),
            Route("/scans/{id}/keep", _keep_scan, methods=["POST"]),
            Route("/scan/{id}/keep", _keep_scan_by_form, methods=["POST"]),
            Route("/scans/{id}/events", _scan_events),
            *(() if site.given_jobs is None else TURNS),
            Mount("/assets", StaticFiles(packages=[("pcretrieve.pages", "assets")])),
        ],
        exception_handlers={
            PcretrieveError: _refused,
            HTTPException: _nowhere,
            Exception: _refused,
        },
    )
    made.state.site = site
    return made


def _read(
    answer: Callable[[Asked], Response], readers: Readers
) -> Callable[[Request], Awaitable[Response]]:
    async def handler(request: Request) -> Response:
        arrived = time.monotonic()
        return await readers.read(
            lambda catalogue: answer(Asked(_site(request), catalogue, request, arrived))
        )

    return handler


def _kept_answer(answer: Callable[[Asked], Response]) -> Callable[[Asked], Response]:
    return lambda asked: asked.site.answers.of(asked, answer)


def _site(request: Request) -> Site:
    site: Site = request.app.state.site
    return site


def _name(request: Request) -> str:
    """The name of a shape in the path, which is percent-encoded still, so that it is one part of it."""
    return unquote(request.path_params["id"])


async def _refused(request: Request, error: Exception) -> Response:
    status, message = _status(error)
    if not request.scope["path"].startswith(("/shapes", "/scans")):
        return _refusal(request, status, message)
    told = _Json({"error": type(error).__name__, "message": message}, status)
    if request.method in ("GET", "HEAD"):
        return told
    return StreamingResponse(
        _then_silent(told.body), status, {**told.headers, "connection": "close"}
    )


async def _nowhere(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 404
    words = "there is no such page" if status == 404 else "this address is not used so"
    return _refusal(request, status, words)


def _refusal(request: Request, status: int, message: str) -> Response:
    title = _site(request).title
    page = page_of("refusal.html", title=title, exported=False, message=message)
    return HTMLResponse(page, status, headers=FRESH)


def _status(error: Exception) -> tuple[int, str]:
    """The status and the message for an error. What the caller cannot mend is logged, and not told."""
    if isinstance(error, InputError) and not isinstance(error, CatalogueError):
        status = getattr(error, "status", 400)
        return status, without_folders(error.message) if status == 400 else error.message
    logger.error("a request failed: %s", error, exc_info=error)
    is_told = isinstance(error, CatalogueError)
    return 500, without_folders(
        str(error)
    ) if is_told else "the server failed to answer; its log says why"


async def _then_silent(body: bytes | memoryview) -> AsyncIterator[bytes]:
    yield bytes(body)
    await asyncio.sleep(LINGER)
