"""Paths, folders, globs and manifests → the files of scans; content hashes and ids of files."""

from __future__ import annotations

import glob
import hashlib
import logging
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import (
    MARK,
    check_file,
    is_scan,
    local_copy,
    members_of,
    parts_of,
    remote_files,
    remote_version,
    split_member,
    suffixes,
    url_of,
)
from pcretrieve.ingestion.manifests import MANIFESTS, read_manifest
from pcretrieve.ingestion.unread import unread_files

__all__ = ["content_hash", "discover", "file_hash", "printable", "scan_hash", "shape_ids"]

logger = logging.getLogger(__name__)

CHUNK = 1 << 20


def discover(arguments: Sequence[str | Path], beside: Iterable[str | Path] = ()) -> list[Path]:
    """Find the files of scans.

    A warning names the files in a folder that are not scans.
    """
    known = {_absolute(Path(path)) for path in beside}
    found: dict[Path, None] = {}
    for argument in arguments:
        for path in _expand(argument, known):
            found.setdefault(_absolute(path))
    return [scan for path in _without_parts(list(found)) for scan in _scans_in(path)]


def content_hash(path: Path) -> str:
    """The SHA-256 hash of a scan."""
    file, _ = split_member(path)
    return scan_hash(path, file_hash(file))


def file_hash(file: Path) -> str:
    """The SHA-256 hash of a file and of the parts that the file names.

    That of a file at a URL is computed from what the store says of its content, if possible.
    """
    if url_of(file) is not None:
        version = remote_version(file)
        if version is not None:
            return hashlib.sha256(version.encode()).hexdigest()
        with local_copy(file) as copied:
            return file_hash(copied)
    digest = hashlib.sha256()
    part = file
    try:
        check_file(file)
        for part in [file, *(part.path for part in parts_of(file))]:
            check_file(part)
            with part.open("rb") as opened:
                while chunk := opened.read(CHUNK):
                    digest.update(chunk)
    except ScanReadError as error:
        if str(part) in error.message:
            raise
        raise ScanReadError(f"{part}: {error.message}") from error
    # A path with a zero byte, from a binary file in place of a manifest, raises a ValueError.
    except (OSError, ValueError) as error:
        raise ScanReadError(f"cannot read {part}: {getattr(error, 'strerror', None) or error}") from error
    return digest.hexdigest()


def scan_hash(path: Path, hash_of_file: str) -> str:
    """The hash of a scan, given that of its file."""
    _, name = split_member(path)
    if name is None:
        return hash_of_file
    return hashlib.sha256(os.fsencode(f"{hash_of_file}{MARK}{name}")).hexdigest()


def printable(text: str | Path) -> str:
    """Escape the bytes of a file name that are not UTF-8, so that it can be printed and stored."""
    url = url_of(text) if isinstance(text, Path) else None
    return os.fsencode(url or text).decode("utf-8", "backslashreplace")


def shape_ids(paths: Collection[str], taken: Mapping[str, str]) -> dict[str, str]:
    """Choose an id for each path: its name without suffix, with a number if another path has this id.

    That of a scan ``file.suffix#name`` is ``file#name``.
    """
    # Imported here, because commands that only look for scans should not wait for the import of descriptors.
    from pcretrieve.catalogue import numbered_id

    used = set(taken)
    ids = {path: shape_id for shape_id, path in taken.items()}
    last: dict[str, int] = {}  # the last number of each name, where the search for the next one starts
    for path in paths:
        if path in ids:
            continue
        file, name = split_member(Path(path))
        stem = file.stem if name is None else f"{file.stem}#{name}"
        number = last.get(stem, 0) + 1
        while (shape_id := numbered_id(stem, number)) in used:
            number += 1
        last[stem] = number
        ids[path] = shape_id
        used.add(shape_id)
    return {path: ids[path] for path in paths}


def _expand(argument: str | Path, beside: Collection[Path]) -> list[Path]:
    if not str(argument):
        raise InputError("a path must not be empty: name a file or a folder")
    path = Path(argument)
    try:
        if url_of(path) is not None:
            return _remote_scans(path)
        if path.is_dir():
            files = _files_below(path)
        elif path.exists():
            return read_manifest(path) if _is_manifest(path) else [path]
        elif split_member(path)[0].exists():
            return [path]
        elif glob.has_magic(str(argument)):
            matches = [Path(name) for name in sorted(glob.glob(str(argument), recursive=True))]
            if path.suffix.lower() in MANIFESTS:
                return [
                    scan
                    for match in matches
                    for scan in (read_manifest(match) if _is_manifest(match) else [match])
                ]
            files = [file for match in matches for file in _files_below(match)]
        else:
            raise InputError(f"there is no file or folder {path}")
    except OSError as error:
        raise InputError(f"cannot look into {path}: {error.strerror}") from error
    scans = {file: None for file in files if is_scan(file)}
    expected = _parts(scans).union(beside)
    unread = unread_files(file for file in files if file not in scans and _absolute(file) not in expected)
    if not scans:
        left = f", but {unread}" if unread else ""
        raise InputError(f"{path} names no scans{left}; known are {' '.join(sorted(suffixes()))}")
    if unread:
        logger.warning("left unread in %s: %s", path, unread)
    return list(scans)


def _remote_scans(path: Path) -> list[Path]:
    """The file of a URL with the suffix of a format, whatever it has; else the scans in a folder."""
    if split_member(path)[0].suffix.lower() in suffixes() and not glob.has_magic(path.name):
        return [path]
    files = remote_files(path)
    scans = [file for file in files if is_scan(file)]
    unread = unread_files(file for file in files if file not in set(scans))
    if not scans:
        left = f", but {unread}" if unread else ""
        raise InputError(f"{url_of(path)} names no scans{left}; known are {' '.join(sorted(suffixes()))}")
    if unread:
        logger.warning("left unread in %s: %s", url_of(path), unread)
    return scans


def _is_manifest(path: Path) -> bool:
    return path.suffix.lower() in MANIFESTS and not is_scan(path)


def _files_below(path: Path) -> list[Path]:
    """The path itself, or all files in a folder; without hidden files."""
    # Broken symbolic links are included: reading them fails later, as a failure of one shape. Subfolders that
    # must not be read are skipped with a warning, because there is one (lost+found) on every disk.

    def skip(error: OSError) -> None:
        folder = Path(error.filename)
        if folder == path:
            raise error
        logger.warning("skipped the folder %s and all scans in it: %s", folder, error.strerror)

    if path.is_dir():
        below = os.walk(path, onerror=skip)
        found = sorted(Path(folder, name) for folder, _, names in below for name in names)
    else:
        found = [path]
    return [file for file in found if not file.name.startswith(".")]


def _scans_in(path: Path) -> tuple[Path, ...]:
    """The scans in a file of several, or the file itself; one at a URL is not copied to be looked into."""
    if url_of(path) is not None:
        return (path,)
    try:
        return members_of(path) or (path,)
    except (ScanReadError, OSError):
        return (path,)  # reading it as a scan will report why


def _without_parts(paths: list[Path]) -> list[Path]:
    parts = _parts(paths)
    return [path for path in paths if path not in parts]


def _parts(paths: Iterable[Path]) -> set[Path]:
    """The files that belong to scans, by their absolute names."""
    parts: set[Path] = set()
    for path in paths:
        if url_of(path) is not None:
            continue
        try:
            parts.update(_absolute(part.path) for part in parts_of(path))
        except (ScanReadError, OSError):
            continue  # reading the file as a scan will report the error
    return parts


def _absolute(path: Path) -> Path:
    """An absolute path without ``..``, or that of a URL. Symbolic links to files are not resolved."""
    if url_of(path) is not None:
        return path
    return path.parent.resolve() / path.name if ".." in path.parts else path.absolute()
