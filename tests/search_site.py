"""The application of the search page in this process, with its guard, and requests to it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from search_server import Answer

from pcretrieve.web.application import Site, application
from pcretrieve.web.guard import Guard
from pcretrieve.web.server import opened_site

TOKEN = "the-token"

# As a browser sends them.
KNOWN = {"host": "127.0.0.1:8765", "cookie": f"pcretrieve-8765={TOKEN}"}
OWN_ORIGIN = {"origin": "http://127.0.0.1:8765"}


@contextmanager
def opened(
    catalogue: Path, *, most_bytes: int = 1000, keep: Path | None = None
) -> Iterator[Site]:
    with opened_site(
        catalogue,
        read_only=False,
        most_bytes=most_bytes,
        timeout=60,
        memory=4,
        up=None,
        keep=keep,
    ) as site:
        yield site


def ask(
    site: Site,
    path: str,
    *,
    method: str = "GET",
    headers: dict[str, str] | None = None,
    chunks: Iterable[bytes] = (),
) -> Answer:
    """The answer to one request, whose body comes in chunks, each when it is asked for."""
    path, _, query = path.partition("?")
    scope = {
        "type": "http",
        "asgi": {
            "spec_version": "2.4"
        },  # answers do not wait for the end of the connection
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "query_string": query.encode(),
        "headers": [
            (name.encode(), value.encode())
            for name, value in (KNOWN | (headers or {})).items()
        ],
    }
    left = iter(chunks)
    sent: list[Any] = []

    async def receive() -> dict[str, Any]:
        for chunk in left:
            return {"type": "http.request", "body": chunk, "more_body": True}
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(Guard(application(site), TOKEN)(scope, receive, send))
    start, *bodies = sent
    found = {name.decode(): value.decode() for name, value in start["headers"]}
    return Answer(
        start["status"], found, b"".join(each.get("body", b"") for each in bodies)
    )
