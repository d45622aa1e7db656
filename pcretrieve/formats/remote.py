"""Scans at URLs, by fsspec: what the URLs name, and copies of the files on this computer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pcretrieve.errors import InputError, PcretrieveError, ScanReadError, ShapeError
from pcretrieve.formats.format import url_of
from pcretrieve.formats.registry import parts_of, split_member

# Largest size of a file that is copied for one command; bytes.
LARGEST = 1 << 32

# What stores say of the content of a file, the best first: hashes, then the time of the last change.
VERSIONS = (
    *("ETag", "etag", "md5Hash", "Content-MD5", "Digest", "crc32c", "checksum"),
    *("LastModified", "Last-Modified", "updated", "mtime", "created"),
)


def remote_files(path: Path) -> list[Path]:
    """The files that a URL names: by a pattern, in a folder and below, or one."""
    with _store(path, InputError, "look into") as (system, place, _):
        if any(sign in place for sign in "*?["):
            found = [name for name in system.glob(place) if system.isfile(name)]
        elif system.isdir(place):
            found = system.find(place)
        else:
            found = [place] if system.exists(place) else []
        return [Path(str(system.unstrip_protocol(name))) for name in sorted(found)]


def remote_version(path: Path) -> str | None:
    """What the store says of the content of a file, without reading it."""
    with _store(path) as (system, place, url):
        about = system.info(place)
    known = next((key for key in VERSIONS if about.get(key)), None)
    # Some servers compute what they call a hash from the size and the time of the last change.
    return None if known is None else f"{url} {known} {about[known]} {about.get('size')}"


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """A file on this computer with the content of a scan."""
    if url_of(path) is None:
        yield path
        return
    remote, _ = split_member(path)
    with TemporaryDirectory(prefix="pcretrieve-") as folder:
        file = Path(folder, remote.name)
        _copy(remote, file)
        for part in parts_of(file):
            # A file may name files anywhere: only those beside it and below belong to the scan.
            if part.path.is_relative_to(folder) and ".." not in part.path.parts:
                part.path.parent.mkdir(parents=True, exist_ok=True)
                _copy(remote.parent / part.path.relative_to(folder), part.path)
        try:
            yield Path(folder, path.name)
        except ShapeError as error:
            error.message = error.message.replace(folder, str(url_of(remote.parent)))
            raise


def _copy(path: Path, file: Path) -> None:
    with _store(path) as (system, place, url):
        from fsspec.callbacks import Callback

        def check(size: int | None, value: int) -> None:
            if max(size or 0, value) > LARGEST:
                raise ScanReadError(
                    f"{url} has more than {LARGEST} bytes: copy it to this computer first"
                )

        system.get_file(place, str(file), callback=Callback(hooks={"size": check}))


@contextmanager
def _store(
    path: Path, kind: type[PcretrieveError] = ScanReadError, act: str = "read"
) -> Iterator[tuple[Any, str, str]]:
    """The file system of a URL, the path in it, and the URL. Errors of stores get one kind and a message."""
    url = str(url_of(path))
    try:
        try:
            from fsspec.core import url_to_fs

            system, place = url_to_fs(url)
        except ImportError as error:
            raise kind(f"cannot {act} {url}, {error}: pip install 'pcretrieve[remote]'") from error
        yield system, place, url
    except PcretrieveError:
        raise
    # Stores have exceptions of many packages, which are not all an OSError.
    except Exception as error:
        words = getattr(error, "strerror", None) or error or type(error).__name__
        if isinstance(error, FileNotFoundError):
            words = "there is no such file"
        raise kind(f"cannot {act} {url}: {words}") from error
