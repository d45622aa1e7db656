"""Paths, folders, globs and manifests → the files of scans; their ids, and the parts of a job array."""

from __future__ import annotations

import codecs
import csv
import glob
import hashlib
import io
import logging
import os
import re
import stat
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from pcretrieve.errors import (
    InputError,
    OptionError,
    PcretrieveError,
    ShapeError,
    did_you_mean,
)
from pcretrieve.formats import Part, is_scan, members_of, parts_of, split_member
from pcretrieve.formats.format import no_parts, url_of
from pcretrieve.formats.registry import FORMATS, instead, suffixes
from pcretrieve.formats.remote import remote_files
from pcretrieve.formats.text import is_table
from pcretrieve.ingestion.pool import Worker, alone, in_processes
from pcretrieve.options import check_many
from pcretrieve.values.files import in_order

logger = logging.getLogger(__name__)

# Suffixes of manifests, of which files may also be tables of points, and the columns with the paths.
MANIFESTS = frozenset({".txt", ".csv"})
PATH_COLUMNS = ("path", "file", "filename", "name")
# Three numbers with decimals, which no header of a manifest has.
DECIMALS = re.compile(r"(?:\d[.,]\d.*){3}")

# Suffixes of files left unread that are named; further ones are counted together.
MOST_NAMED = 8

# Largest memory of the process that lists a folder at a URL; GiB.
LISTING_MEMORY = 1.0

# Number of bytes at the beginning and at the end of a file that choose its shard. All tasks read these bytes
# of all files, but only one task reads the rest of a file.
END = 4096


def discover(
    arguments: Sequence[str | Path],
    beside: Iterable[str | Path] = (),
    limits: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Find the files of scans; a warning names the files in a folder that are not scans, nor in `beside`.

    limits: of processes that list folders at URLs and look into files; without limits, this process does.
    """
    check_many("paths", arguments)
    groups = [_expand(argument, limits) for argument in arguments]
    looks = looked_into(
        dict.fromkeys(file for group in groups for file in group.files), limits
    )
    found = {
        _absolute(file): looks[file]
        for group in groups
        for file in group.files
        if group.are_named or looks[file].is_scan
    }
    parts = {part.path for look in found.values() for part in look.parts}
    expected = {*found, *parts, *(_absolute(Path(path)) for path in beside)}
    for group in groups:
        rest = [_absolute(file) for file in group.files if not looks[file].is_scan]
        unread = unread_files(file for file in rest if file not in expected)
        if len(rest) == len(group.files) and not group.are_named:
            left = f", but {unread}" if unread else ""
            raise InputError(
                f"{group.name} names no scans{left}; known are {' '.join(sorted(suffixes()))}"
            )
        if unread:
            logger.warning("left unread in %s: %s", group.name, unread)
    whole = {file: look for file, look in found.items() if file not in parts}
    return [
        scan
        for file, look in whole.items()
        for scan in map(_absolute, look.members or (file,))
    ]


def shape_ids(paths: Collection[str], taken: Mapping[str, str]) -> dict[str, str]:
    """Choose an id for each path: its name without suffix, with a number if another path has this id.

    That of a scan ``file.suffix#name`` is ``file#name``. `taken` has the paths of the ids there are.
    """
    # Imported here, because commands that only look for scans should not wait for the import of descriptors.
    from pcretrieve.catalogue import numbered_id

    used = set(taken)
    ids = {path: shape_id for shape_id, path in taken.items()}
    # The further ids of each name, of which those before are taken.
    further: dict[str, Iterator[str]] = {}
    for path in paths:
        if path not in ids:
            file, name = split_member(Path(path))
            stem = file.stem if name is None else f"{file.stem}#{name}"
            numbered = further.setdefault(stem, map(partial(numbered_id, stem), count(1)))
            ids[path] = next(one for one in numbered if one not in used)
            used.add(ids[path])
    return {path: ids[path] for path in paths}


def scans_of(shard: str | None, scans: Sequence[Path]) -> Sequence[Path]:
    """The scans of the shard ``I/N`` of a job array; copies of a file are in its shard, by their content."""
    if shard is None:
        return scans
    match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", shard)
    if match is None:
        raise OptionError(f"a shard must be I/N, such as 3/10, got {shard!r}")
    number, n = int(match[1]), int(match[2])
    if not 1 <= number <= n:
        raise OptionError(f"a shard must be I/N with I from 1 to N, got {number}/{n}")
    return [
        scan
        for scan in scans
        if int.from_bytes(_shard_key(scan), "big") % n == number - 1
    ]


def unread_files(paths: Iterable[Path]) -> str:
    """Say how many files of which suffix are left unread, and what would read them."""
    counts = Counter(path.suffix.lower() or "without a suffix" for path in paths)
    advice = {suffix: instead(suffix) for suffix in counts}
    order = sorted(
        counts, key=lambda suffix: (not advice[suffix], -counts[suffix], suffix)
    )
    said = [
        f"{counts[suffix]} {suffix}" + (f" ({advice[suffix]})" if advice[suffix] else "")
        for suffix in order[:MOST_NAMED]
    ]
    if rest := sum(counts[suffix] for suffix in order[MOST_NAMED:]):
        said.append(f"{rest} others")
    return ", ".join(said)


class _Group(NamedTuple):
    """The files that an argument means: those that it names, or those of which the scans are meant."""

    name: str | Path
    files: list[Path]
    are_named: bool


def _expand(argument: str | Path, limits: Mapping[str, Any] | None) -> _Group:
    """The files that one argument means."""
    if not str(argument):
        raise InputError("a path must not be empty: name a file or a folder")
    path, meant = Path(argument), ""
    url = url_of(path)
    are_named = False
    try:
        if url is not None:
            # The file of a URL with the suffix of a format, whatever it has; else the scans in a folder.
            are_named = split_member(path)[0].suffix.lower() in suffixes()
            are_named &= not glob.has_magic(path.name)
            files = [path] if are_named else _listed(path, limits)
        elif path.is_dir():
            files = _files_below(path)
        elif path.exists():
            files, are_named = _named_by(path), True
        elif split_member(path)[0].exists():
            files, are_named = [path], True
        elif glob.has_magic(str(argument)):
            matches = in_order(map(Path, glob.glob(str(argument), recursive=True)))
            are_named = path.suffix.lower() in MANIFESTS and bool(matches)
            within = _named_by if are_named else _files_below
            files = [file for match in matches for file in within(match)]
        else:
            with suppress(OSError):
                meant = did_you_mean(
                    path.name, (one.name for one in path.parent.iterdir())
                )
            raise InputError(f"there is no file or folder {path}{meant}")
    except OSError as error:
        raise InputError(f"cannot look into {path}: {error.strerror}") from error
    return _Group(url or path, files, are_named)


def _listed(path: Path, limits: Mapping[str, Any] | None) -> list[Path]:
    """The files in a folder at a URL, listed by an isolated process: a server may never end, or be silent."""
    try:
        if limits is None:
            return remote_files(path)
        memory = min(limits["memory"] or LISTING_MEMORY, LISTING_MEMORY)
        return alone(remote_files, path, timeout=limits["timeout"], memory=memory)
    except ShapeError as error:
        raise InputError(
            f"cannot look into {url_of(path)}: {error.message}; or name its files in a list (.txt)"
        ) from error


def _named_by(path: Path) -> list[Path]:
    """The scans that a manifest names, or the file itself."""
    if path.suffix.lower() not in MANIFESTS or is_scan(path):
        return [path]
    if path.exists() and not path.is_file():  # reading a pipe or a device may never end
        raise InputError(
            f"the manifest {path} must be a regular file, not a pipe or a device"
        )
    text = read_text(path, "manifest")
    if path.suffix.lower() == ".csv":
        if DECIMALS.search(text.partition("\n")[0]):  # no header, but a row of a table
            return [path]
        names = [name for (name,) in read_table(path, "manifest", text, PATH_COLUMNS)]
    else:
        # Not by splitlines: names may have its other separators, such as U+2028.
        names = [
            line.strip() for line in text.split("\n") if not line.lstrip().startswith("#")
        ]
    # Missing files are not an error here: reading them fails later, as a failure of one shape.
    scans = [
        Path(name) if url_of(Path(name)) else path.parent / name for name in names if name
    ]
    # Unless all are: it is a table with a row that is none, of which its reader tells.
    if scans and not any(map(_is_there, scans)):
        return [path]
    if not scans:
        raise InputError(f"the manifest {path} names no scans")
    return scans


def _is_there(scan: Path) -> bool:
    """Whether a scan is a file that is there, or at a URL."""
    with suppress(OSError, ValueError):  # of a name that the system does not take
        return url_of(scan) is not None or split_member(scan)[0].exists()
    return False


def read_text(path: Path, kind: str, names: Iterable[str] = ()) -> str:
    """The text of a file; `kind` says in messages what the file is, `names` are taken in its place."""
    try:
        content = path.read_bytes()  # names may have the end of a line of any system
        is_utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return content.decode("utf-16" if is_utf16 else "utf-8-sig")
    except OSError as error:
        meant = did_you_mean(path.name, names)
        raise InputError(
            f"cannot read the {kind} {path}: {error.strerror}{meant}"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"cannot read the {kind} {path}: it is not UTF-8 text; save it as CSV UTF-8"
        ) from error


def read_table(
    path: Path, kind: str, text: str, *columns: Sequence[str]
) -> Iterator[tuple[str, ...]]:
    """The values of some columns of a CSV file, each of which has one of several names."""
    # Spreadsheets separate columns by semicolons where the comma is the decimal point, or by tabs, and may
    # name the separator in a first line.
    said = re.match(r'(?i)"?sep=(.)"?[\r\n]+', text)
    text = text[said.end() :] if said else text
    separator = said[1] if said else max(",;\t", key=text.partition("\n")[0].count)
    try:
        rows = csv.DictReader(
            io.StringIO(text, newline=""), strict=True, delimiter=separator
        )
        header = {name.strip().lower(): name for name in rows.fieldnames or ()}
        found = [
            header[known[0]]
            for names in columns
            if (known := [n for n in names if n in header])
        ]
        if len(found) < len(columns):
            needed = " and one of ".join(", ".join(names) for names in columns)
            unknown = [name for name in header if header[name] not in found]
            known = [name for names in columns for name in names]
            meant = next(
                filter(None, (did_you_mean(name, known) for name in unknown)), ""
            )
            raise InputError(
                f"the {kind} {path} must have a header with one of {needed}, got "
                f"{', '.join(header) or 'nothing'}{meant}"
            )
        for row in rows:
            yield tuple((row[name] or "").strip() for name in found)
    except csv.Error as error:
        raise InputError(
            f"the {kind} {path} is not a CSV file ({error}): close each quotation mark, and write one within "
            'quotes as ""'
        ) from error


def _files_below(path: Path) -> list[Path]:
    """The path itself, or all files in a folder; without hidden files."""
    # Broken symbolic links are included: reading them fails later, as a failure of one shape. Subfolders that
    # must not be read are skipped with a warning, because there is one (lost+found) on every disk.

    def skip(error: OSError) -> None:
        folder = Path(error.filename)
        if folder == path:
            raise error
        logger.warning(
            "skipped the folder %s and all scans in it: %s", folder, error.strerror
        )

    if path.is_dir():
        below = os.walk(path, onerror=skip)
        found = in_order(
            Path(folder, name) for folder, _, names in below for name in names
        )
    else:
        found = [path]
    return [file for file in found if not file.name.startswith(".")]


class Look(NamedTuple):
    """What a file is: whether it is a scan, the files that belong to it, and the scans in it."""

    is_scan: bool
    parts: tuple[Part, ...] = ()
    members: tuple[Path, ...] = ()


def looked_into(
    files: Collection[Path],
    limits: Mapping[str, Any] | None,
    idle: list[Worker[Path, Look]] | None = None,
) -> dict[Path, Look]:
    """What files are. Isolated processes open those that may be long to read, and may use all memory.

    limits, idle: of `in_processes`; without limits, this process opens all files.
    """
    hidden = [file for file in files if limits is not None and not _is_plain(file)]
    isolated = in_processes(_look, hidden, idle=idle, **limits or {})
    opened = dict(isolated)
    looks = {}
    for file in files:
        look = opened[file] if file in opened else _look(file)
        # Reading a file as a scan will report why it cannot be looked into.
        looks[file] = Look(True) if isinstance(look, PcretrieveError) else look
    return looks


def _is_plain(path: Path) -> bool:
    """Whether at most the first bytes of a file say what it is. A file at a URL is not looked into."""
    suffix = split_member(path)[0].suffix.lower()
    if url_of(path) is not None or suffix not in suffixes():
        return True
    own = FORMATS.own.get(suffix)
    return (
        own is not None
        and own.names is None
        and own.parts is no_parts
        and own.recognise in (None, is_table)
    )


def _look(path: Path) -> Look:
    look = Look(True)
    # A name from a manifest may be none that the system takes; reading it as a scan will report that too.
    with suppress(Exception):
        look = look._replace(is_scan=is_scan(path))
    if url_of(path) is None:
        with suppress(Exception):
            look = look._replace(members=members_of(path))
        with suppress(Exception):
            parts = (Part(_absolute(part.path), part.pose) for part in parts_of(path))
            look = look._replace(parts=tuple(parts))
    return look


def _absolute(path: Path) -> Path:
    """An absolute path without ``..``, or that of a URL. Symbolic links to files are not resolved."""
    if url_of(path) is not None:
        return path
    return path.parent.resolve() / path.name if ".." in path.parts else path.absolute()


def _shard_key(scan: Path) -> bytes:
    """A hash of the size and the ends of a file; of the path, if the file cannot be read."""
    file, name = split_member(scan)
    with suppress(OSError, ValueError):
        status = file.stat()
        if stat.S_ISREG(status.st_mode):  # reading a pipe would wait
            with file.open("rb") as opened:
                first = opened.read(END)
                opened.seek(max(status.st_size - END, 0))
                ends = b"%d" % status.st_size + first + opened.read(END)
            return hashlib.sha256(os.fsencode(name or "") + ends).digest()
    return hashlib.sha256(os.fsencode(scan)).digest()
