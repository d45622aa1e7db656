"""Files at URLs by fsspec: their names, what the store says of their contents, and copies of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pcretrieve.errors import InputError

__all__ = ["copy_file", "files_below", "stored_version"]

# What stores say of the content of a file, the best first: hashes, then the time of the last change.
HASHES = ("ETag", "etag", "md5Hash", "Content-MD5", "Digest", "crc32c", "checksum")
TIMES = ("LastModified", "Last-Modified", "updated", "mtime", "created")


def files_below(url: str) -> list[str]:
    """The files that a URL names."""
    system, path = _opened(url)
    if any(sign in path for sign in "*?["):
        found = [name for name in system.glob(path) if system.isfile(name)]
    elif system.isdir(path):
        found = system.find(path)
    else:
        found = [path] if system.exists(path) else []
    return [str(system.unstrip_protocol(name)) for name in sorted(found)]


def stored_version(url: str) -> str | None:
    """What the store says of the content of a file, without reading it."""
    system, path = _opened(url)
    about = system.info(path)
    known = next((key for key in (*HASHES, *TIMES) if about.get(key)), None)
    return None if known is None else f"{known} {about[known]} {about.get('size')}"


def copy_file(url: str, file: Path) -> None:
    """Copy a file to this computer."""
    system, path = _opened(url)
    system.get_file(path, str(file))


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise InputError(f"reading {url} needs fsspec: pip install 'pcretrieve[remote]'") from error
    try:
        system, path = url_to_fs(url)
    except ImportError as error:
        raise InputError(f"cannot read {url}: {error}: pip install 'pcretrieve[remote]'") from error
    except ValueError as error:
        raise InputError(f"cannot read {url}: {error}") from error
    return system, path
