"""The body of a request → the file of a scan, of a known kind and a limited size."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable
from pathlib import Path, PurePosixPath

from pcretrieve.errors import InputError
from pcretrieve.formats import missing_extra, suffixes
from pcretrieve.web.requests import TooLarge, TooSlow

__all__ = ["checked_suffix", "received", "upload_suffixes"]

# Formats with all of a scan in one file. Left out are archives (.npz .3mf), and formats that name other files
# of the computer that reads them (.conf .gltf .glb .txt).
ONE_FILE = (".ply", ".pcd", ".off", ".stl", ".obj", ".xyz", ".pts", ".ptx", ".las", ".laz", ".e57", ".npy")

LONGEST_NAME = 200

# Longest time in which a scan must have been received; seconds.
RECEIVING_TIMEOUT = 600.0


def upload_suffixes() -> tuple[str, ...]:
    """The suffixes of files that can be uploaded, and that this installation can read."""
    known = suffixes()
    return tuple(suffix for suffix in ONE_FILE if suffix in known and not missing_extra(suffix))


def checked_suffix(name: str) -> str:
    """The suffix of an uploaded file."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in upload_suffixes() or len(name) > LONGEST_NAME:
        raise InputError(
            f"a scan must be a file with one of the suffixes {' '.join(upload_suffixes())} and a name of at "
            f"most {LONGEST_NAME} characters, got {name[-50:]!r}"
        )
    return suffix


async def received(
    chunks: AsyncIterable[bytes], folder: Path, suffix: str, *, most_bytes: int, announced: str | None
) -> Path:
    """Store the body of a request as a file."""
    message = f"a scan may have at most {most_bytes} bytes: reduce it, or use `pcretrieve query`"
    if announced is not None and announced.isdecimal() and int(announced[:20]) > most_bytes:
        raise TooLarge(message)
    path = folder / f"scan{suffix}"
    try:
        size = await asyncio.wait_for(_stored(chunks, path, most_bytes), RECEIVING_TIMEOUT)
    except asyncio.TimeoutError as error:
        raise TooSlow(
            f"the scan has not arrived within {RECEIVING_TIMEOUT:g} s: reduce it, or use `pcretrieve query`"
        ) from error
    if size > most_bytes:
        raise TooLarge(message)
    if not size:
        raise InputError("the file is empty: scan or export it again")
    return path


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
