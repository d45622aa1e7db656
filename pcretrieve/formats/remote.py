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

# What stores say of the content of a file, the best first: hashes, then the time of the last change.
HASHES = ("ETag", "etag", "md5Hash", "Content-MD5", "Digest", "crc32c", "checksum")
TIMES = ("LastModified", "Last-Modified", "updated", "mtime", "created")


def remote_files(path: Path) -> list[Path]:
    """The files that a URL names: by a pattern, in a folder and below, or one."""
    url = _url(path)
    try:
        system, place = _opened(url)
        if any(sign in place for sign in "*?["):
            found = [name for name in system.glob(place) if system.isfile(name)]
        elif system.isdir(place):
            found = system.find(place)
        else:
            found = [place] if system.exists(place) else []
        return [Path(str(system.unstrip_protocol(name))) for name in sorted(found)]
    except PcretrieveError:
        raise
    # Stores have exceptions of many packages, which are not all an OSError.
    except Exception as error:
        raise InputError(f"cannot look into {url}: {_words(error)}") from error


def remote_version(path: Path) -> str | None:
    """What the store says of the content of a file, without reading it."""
    url = _url(path)
    with _errors_of(url):
        system, place = _opened(url)
        about = system.info(place)
    known = next((key for key in (*HASHES, *TIMES) if about.get(key)), None)
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
            error.message = error.message.replace(folder, _url(remote.parent))
            raise


def _copy(path: Path, file: Path) -> None:
    url = _url(path)
    with _errors_of(url):
        system, place = _opened(url)
        system.get_file(place, str(file))


def _url(path: Path) -> str:
    url = url_of(path)
    if url is None:
        raise InputError(f"a URL must begin with its protocol, as in s3://, got {path}")
    return url


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


@contextmanager
def _errors_of(url: str) -> Iterator[None]:
    """Turn the errors of a store, which are exceptions of many packages, into errors of a scan."""
    try:
        yield
    except PcretrieveError as error:
        raise ScanReadError(error.message) from error
    except Exception as error:
        raise ScanReadError(f"cannot read {url}: {_words(error)}") from error


def _words(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)
