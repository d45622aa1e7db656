"""What identifies a scan: its printable name, and the hash of its content."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, TypeVar

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import check_file
from pcretrieve.formats.registry import MARK, ScanPath, parts_of
from pcretrieve.formats.remote import local_copy, remote_version

CHUNK = 1 << 20  # bytes read at once

Found = TypeVar("Found")


def printable(text: str | ScanPath) -> str:
    """Escape the bytes of a file name that are not UTF-8, so that it can be printed and stored."""
    return os.fsencode(str(text)).decode("utf-8", "backslashreplace")


def content_hash(scan: ScanPath) -> str:
    """The SHA-256 hash of a scan."""
    return scan_hash(scan, file_hash(scan.whole))


def scan_hash(scan: ScanPath, hash_of_file: str) -> str:
    """The hash of a scan, given that of its file."""
    if scan.member is None:
        return hash_of_file
    text = f"{hash_of_file}{MARK}{scan.member}"
    return hashlib.sha256(os.fsencode(text)).hexdigest()


def file_hash(
    file: ScanPath, hash_of_copy: Callable[[ScanPath], str] | None = None
) -> str:
    """The SHA-256 hash of a file and of the parts that the file names.

    That of a file at a URL is computed from what the store says of its content, else of a copy.
    """
    if file.url is not None:
        version = remote_version(file.url)
        if version is not None:
            return hashlib.sha256(version.encode()).hexdigest()
        if hash_of_copy is not None:
            return hash_of_copy(file)
        with local_copy(file) as copied:
            return file_hash(copied)
    digest = hashlib.sha256()

    def add(opened: IO[bytes]) -> None:
        while chunk := opened.read(CHUNK):
            digest.update(chunk)

    of_each_file(file.file, add)
    return digest.hexdigest()


def of_each_file(file: Path, look: Callable[[IO[bytes]], Found]) -> list[Found]:
    """What a function finds in a file and in its parts, one after the other."""
    part, found = file, []
    try:
        check_file(file)
        for part in [file, *(part.path for part in parts_of(file))]:
            check_file(part)
            with part.open("rb") as opened:
                found.append(look(opened))
    except ScanReadError as error:
        if str(part) in error.message:
            raise
        raise ScanReadError(f"{part}: {error.message}") from error
    # A path with a zero byte, from a binary file in place of a manifest, raises a ValueError.
    except (OSError, ValueError) as error:
        raise ScanReadError(
            f"cannot read {part}: {getattr(error, 'strerror', None) or error}"
        ) from error
    return found
