"""What a request asks: the fields of its address, and the scan that is its body."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, Mapping
from datetime import date
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, Literal
from urllib.parse import urlencode

from pydantic import ConfigDict, Field
from typing_extensions import Self

from pcretrieve.errors import InputError
from pcretrieve.options import Options
from pcretrieve.values import Decision

if TYPE_CHECKING:
    from starlette.requests import Request

# Formats with all of a scan in one file. Left out are archives (.npz .3mf), and formats that name other files
# of the computer that reads them (.conf .gltf .glb .txt).
ONE_FILE = (
    ".ply",
    ".pcd",
    ".off",
    ".stl",
    ".obj",
    ".xyz",
    ".pts",
    ".ptx",
    ".las",
    ".laz",
    ".e57",
    ".npy",
)

LONGEST_NAME = 200

# Longest time in which a scan must have been received; seconds.
RECEIVING_TIMEOUT = 600.0


class Refused(InputError):
    """A request that is refused, with a status of HTTP: 404 if there is nothing of this name."""

    def __init__(self, message: str, status: int = 404) -> None:
        super().__init__(message)
        self.status = status


class _Fields(Options):
    """Fields of an address; empty ones have their defaults, and others are ignored."""

    model_config = ConfigDict(extra="ignore")

    @classmethod
    def of(cls, fields: Mapping[str, str]) -> Self:
        return cls(**{name: value for name, value in fields.items() if value.strip()})

    def address(self, **changed: object) -> str:
        """The fields that differ from the defaults, as the end of an address."""
        chosen = self.model_copy(update=changed).model_dump(
            mode="json", exclude_defaults=True
        )
        return f"?{urlencode(chosen)}" if chosen else ""


class Listing(_Fields):
    """Which shapes are listed, and in which order; ``-`` for descending."""

    q: str = ""
    label: str = ""
    state: Literal["", "done", "incomplete", "failed"] = ""
    marked: Literal["", "any", Decision] = ""
    sort: Literal[
        "id", "-id", "label", "-label", "added", "-added", "error", "-error"
    ] = "id"
    since: date | None = None
    until: date | None = None
    page: Annotated[int, Field(ge=1, le=10**9)] = 1

    @property
    def wanted(self) -> dict[str, Any]:
        """What `Catalogue.wanted` is asked, without the words of a name and the page."""
        days = None
        if self.since or self.until:
            days = str(self.since or ""), str(self.until or "9999-12-31")
        return {
            "label": self.label,
            "state": self.state,
            "marked": self.marked,
            "days": days,
            "order": self.sort.removeprefix("-"),
            "descending": self.sort.startswith("-"),
        }


class Similar(_Fields):
    """What is asked of the neighbours of a shape; not a catalogue with all provenance."""

    k: Annotated[int, Field(ge=1, le=1000)] = 12
    label: str = ""
    min_score: Annotated[float, Field(ge=0, le=1)] | None = None


def checked_suffix(name: str) -> str:
    """The suffix of an uploaded file."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in ONE_FILE or len(name) > LONGEST_NAME:
        raise InputError(
            f"a scan must be a file with one of the suffixes {' '.join(ONE_FILE)} and a name of at "
            f"most {LONGEST_NAME} characters, got {name[-50:]!r}"
        )
    return suffix


async def received(request: Request, path: Path, *, most_bytes: int) -> None:
    """Store the body of a request as a file."""
    message = f"a scan may have at most {most_bytes} bytes: reduce it, or use `pcretrieve query`"
    announced = request.headers.get("content-length", "")
    if announced.isdecimal() and int(announced[:20]) > most_bytes:
        raise Refused(message, 413)
    try:
        size = await asyncio.wait_for(
            _stored(request.stream(), path, most_bytes), RECEIVING_TIMEOUT
        )
    except asyncio.TimeoutError as error:
        raise Refused(
            f"the scan has not arrived within {RECEIVING_TIMEOUT:g} s: reduce it, or use `pcretrieve query`",
            408,
        ) from error
    if size > most_bytes:
        raise Refused(message, 413)
    if not size:
        raise InputError("the file is empty: scan or export it again")


async def _stored(chunks: AsyncIterable[bytes], path: Path, most_bytes: int) -> int:
    """The number of bytes that were received: all, which are in the file, or the first that are too many."""
    size = 0
    with path.open("xb") as file:
        async for chunk in chunks:
            size += len(chunk)
            if size > most_bytes:
                break
            file.write(chunk)
    return size
