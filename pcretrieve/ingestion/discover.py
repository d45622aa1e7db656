"""What the command line names → the scans it means."""

from __future__ import annotations

import csv
import glob
import hashlib
import io
import logging
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import check_file, parts_of, suffixes

__all__ = ["content_hash", "discover", "printable", "shape_ids"]

logger = logging.getLogger(__name__)

MANIFESTS = frozenset({".txt", ".csv"})
PATH_COLUMNS = ("path", "file", "filename", "name")
CHUNK = 1 << 20


def discover(arguments: Sequence[str | Path]) -> list[Path]:
    """Scans named by files, folders, globs or manifests, each once, in the order given.

    A folder stands for every scan below it, by name. A ``.txt`` manifest holds one path a line, a ``.csv``
    one a row under ``path`` or ``file``; both are relative to the manifest. Files that are parts of another
    scan among them, such as the views of a ``.conf``, are no scans of their own.

    Raises
    ------
    InputError
        If a path does not exist, a glob or a folder holds no scans, or a manifest cannot be read.
    """
    found: dict[Path, None] = {}
    for argument in arguments:
        for path in _expand(argument):
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


def _expand(argument: str | Path) -> list[Path]:
    if not str(argument):
        raise InputError("a path must not be empty: name a file or a folder")
    path = Path(argument)
    try:
        if path.is_dir():
            scans = _scans_below(path)
        elif path.exists():
            return _manifest(path) if path.suffix.lower() in MANIFESTS else [path]
        elif glob.has_magic(str(argument)):
            matches = [Path(name) for name in sorted(glob.glob(str(argument), recursive=True))]
            if path.suffix.lower() in MANIFESTS:
                return [scan for match in matches for scan in _manifest(match)]
            scans = [scan for match in matches for scan in _scans_below(match)]
        else:
            raise InputError(f"there is no file or folder {path}")
    except OSError as error:
        raise InputError(f"cannot look into {path}: {error.strerror}") from error
    if not scans:
        raise InputError(f"{path} names no scans; known are {' '.join(sorted(suffixes()))}")
    return scans


def _scans_below(path: Path) -> list[Path]:
    """The files that are named like scans and are not hidden, of a folder those of all folders below it too.

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
    known = suffixes()
    return [scan for scan in found if scan.suffix.lower() in known and not scan.name.startswith(".")]


def _manifest(path: Path) -> list[Path]:
    try:
        # Reading a pipe or a device may never end.
        if path.exists() and not path.is_file():
            raise InputError(f"the manifest {path} must be a regular file, not a pipe or a device")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the manifest {path}: {error}") from error
    if path.suffix.lower() == ".csv":
        try:
            rows = csv.DictReader(io.StringIO(text, newline=""))
            header = {name.strip().lower(): name for name in rows.fieldnames or ()}
            column = next((header[name] for name in PATH_COLUMNS if name in header), None)
            if column is None:
                raise InputError(f"the manifest {path} must have a column {' or '.join(PATH_COLUMNS)}")
            names = [(row[column] or "").strip() for row in rows]
        except csv.Error as error:
            raise InputError(f"the manifest {path} is not a CSV file: {error}") from error
    else:
        names = [line.strip() for line in text.splitlines() if not line.lstrip().startswith("#")]
    # A file that is missing is that shape's failure, not the batch's: reading it will say so.
    scans = [path.parent / name for name in names if name]
    if not scans:
        raise InputError(f"the manifest {path} names no scans")
    return scans


def _without_parts(paths: list[Path]) -> list[Path]:
    parts: set[Path] = set()
    for path in paths:
        try:
            parts.update(_absolute(part.path) for part in parts_of(path))
        except (ScanReadError, OSError):
            continue  # reading it as a scan will report why
    return [path for path in paths if path not in parts]


def _absolute(path: Path) -> Path:
    """One name for one file, however it was written; links keep their own name."""
    return path.parent.resolve() / path.name if ".." in path.parts else path.absolute()
