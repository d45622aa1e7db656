"""What the command line names → the scans it means."""

from __future__ import annotations

import glob
import hashlib
import logging
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import check_file, is_scan, parts_of, suffixes
from pcretrieve.ingestion.manifests import MANIFESTS, read_manifest
from pcretrieve.ingestion.unread import unread_files

__all__ = ["content_hash", "discover", "printable", "shape_ids"]

logger = logging.getLogger(__name__)

CHUNK = 1 << 20


def discover(arguments: Sequence[str | Path], beside: Iterable[str | Path] = ()) -> list[Path]:
    """Scans named by files, folders, globs or manifests, each once, in the order given.

    A folder stands for every scan below it, by name; a warning says which of its files are none. A ``.txt``
    or a ``.csv`` file that is not a table of points is a manifest: it holds one path on each line, or on each
    row under ``path`` or ``file``, relative to the manifest. Files that are parts of another scan, such as
    the views of a ``.conf``, are no scans of their own. Files `beside` the scans, such as their labels, are
    not warned of.

    Raises
    ------
    InputError
        If a path does not exist, a glob or a folder holds no scans, or a manifest cannot be read.
    """
    known = {_absolute(Path(path)) for path in beside}
    found: dict[Path, None] = {}
    for argument in arguments:
        for path in _expand(argument, known):
            found.setdefault(_absolute(path))
    return _without_parts(list(found))


def content_hash(path: Path) -> str:
    """SHA-256 of the bytes of a scan: of its file, and then of the parts of that.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        In hexadecimal digits.

    Raises
    ------
    ScanReadError
        If one of the files cannot be read.
    """
    digest = hashlib.sha256()
    part = path
    try:
        check_file(path)
        for part in [path, *(part.path for part in parts_of(path))]:
            check_file(part)
            with part.open("rb") as file:
                while chunk := file.read(CHUNK):
                    digest.update(chunk)
    except ScanReadError as error:
        if str(part) in error.message:
            raise
        raise ScanReadError(f"{part}: {error.message}") from error
    # A ValueError is a path with a zero byte, from a manifest that is none.
    except (OSError, ValueError) as error:
        raise ScanReadError(f"cannot read {part}: {getattr(error, 'strerror', None) or error}") from error
    return digest.hexdigest()


def printable(text: str | Path) -> str:
    """Text that can be printed and stored: bytes of a file name that are not UTF-8 are escaped."""
    return os.fsencode(text).decode("utf-8", "backslashreplace")


def shape_ids(paths: Collection[str], taken: Mapping[str, str]) -> dict[str, str]:
    """An id for each path: its name without suffix, numbered where another path has that one.

    Parameters
    ----------
    paths : collection of absolute paths
    taken : mapping of id to path
        Ids that are in use already.
    """
    # Here, so that commands that only look for scans need not wait for the catalogue and its descriptors.
    from pcretrieve.catalogue import numbered_id

    used = set(taken)
    ids = {path: shape_id for shape_id, path in taken.items()}
    last: dict[str, int] = {}  # number given to each name: the search goes on from there
    for path in paths:
        if path in ids:
            continue
        stem = Path(path).stem
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
        if path.is_dir():
            files = _files_below(path)
        elif path.exists():
            return read_manifest(path) if _is_manifest(path) else [path]
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


def _is_manifest(path: Path) -> bool:
    return path.suffix.lower() in MANIFESTS and not is_scan(path)


def _files_below(path: Path) -> list[Path]:
    """A file, or the files of a folder and of all folders below it, without hidden ones.

    A link that leads nowhere is among them: reading it gives a failed shape. A subfolder that may not be read
    is passed over with a warning, because one (``lost+found``) is on every disk.
    """

    def pass_over(error: OSError) -> None:
        folder = Path(error.filename)
        if folder == path:
            raise error
        logger.warning("passed over the folder %s and all scans in it: %s", folder, error.strerror)

    if path.is_dir():
        below = os.walk(path, onerror=pass_over)
        found = sorted(Path(folder, name) for folder, _, names in below for name in names)
    else:
        found = [path]
    return [file for file in found if not file.name.startswith(".")]


def _without_parts(paths: list[Path]) -> list[Path]:
    parts = _parts(paths)
    return [path for path in paths if path not in parts]


def _parts(paths: Iterable[Path]) -> set[Path]:
    """The files that belong to scans, by their absolute names."""
    parts: set[Path] = set()
    for path in paths:
        try:
            parts.update(_absolute(part.path) for part in parts_of(path))
        except (ScanReadError, OSError):
            continue  # reading it as a scan will report why
    return parts


def _absolute(path: Path) -> Path:
    """One name for one file, however it was written; links keep their own name."""
    return path.parent.resolve() / path.name if ".." in path.parts else path.absolute()
