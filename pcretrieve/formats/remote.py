"""Scans at URLs: what the URLs name, and copies of the files on this computer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pcretrieve.errors import InputError, PcretrieveError, ScanReadError, ShapeError
from pcretrieve.formats.contents import parts_of
from pcretrieve.formats.fsspec import copy_file, files_below, stored_version
from pcretrieve.formats.registry import split_member
from pcretrieve.formats.urls import url_of

__all__ = ["local_copy", "remote_files", "remote_version"]


def remote_files(path: Path) -> list[Path]:
    """The files that a URL names."""
    url = _url(path)
    try:
        return [Path(found) for found in files_below(url)]
    except PcretrieveError:
        raise
    # Stores have exceptions of many packages, which are not all an OSError.
    except Exception as error:
        raise InputError(f"cannot look into {url}: {_words(error)}") from error


def remote_version(path: Path) -> str | None:
    """What the store says of the content of a file, without reading it."""
    url = _url(path)
    with _errors_of(url):
        version = stored_version(url)
    # Some servers compute what they call a hash from the size and the time of the last change.
    return None if version is None else f"{url} {version}"


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
        copy_file(url, file)


def _url(path: Path) -> str:
    url = url_of(path)
    if url is None:
        raise InputError(f"a URL must begin with its protocol, as in s3://, got {path}")
    return url


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
