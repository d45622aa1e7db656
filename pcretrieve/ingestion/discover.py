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
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from pcretrieve.errors import (
    InputError,
    OptionError,
    PcretrieveError,
    ShapeError,
    did_you_mean,
)
from pcretrieve.formats import Part, ScanPath, is_scan, members_of, parts_of
from pcretrieve.formats.format import no_parts
from pcretrieve.formats.identity import printable
from pcretrieve.formats.registry import FILE, FORMATS, INSTEAD, missing_extra, suffixes
from pcretrieve.formats.remote import remote_files
from pcretrieve.formats.text import is_table
from pcretrieve.ingestion.pool import Worker, alone, in_processes, own_limit
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


#: Whether scans are fetched whose URLs are stored in a catalogue, or what decides that, given their hosts.
Remote: TypeAlias = bool | Callable[[Sequence[str]], bool]


def discover(
    arguments: Sequence[str | Path | ScanPath],
    beside: Iterable[str | Path] = (),
    limits: Mapping[str, Any] | None = None,
) -> list[ScanPath]:
    """Find scans; a warning names the files in a folder that are not scans, nor in `beside`.

    limits: of processes that list folders at URLs and look into files; without limits, this process does.
    """
    check_many("paths", arguments)
    groups = [_expand(argument, limits) for argument in arguments]
    looks = looked_into(
        dict.fromkeys(scan for group in groups for scan in group.scans), limits
    )
    found = {
        _absolute(scan): looks[scan]
        for group in groups
        for scan in group.scans
        if group.are_named or looks[scan].is_scan
    }
    parts = {part.path for look in found.values() for part in look.parts}
    expected = {_absolute(ScanPath(Path(path))).file for path in beside}
    expected |= parts | {scan.file for scan in found}
    for group in groups:
        rest = [_absolute(scan).file for scan in group.scans if not looks[scan].is_scan]
        unread = unread_files(file for file in rest if file not in expected)
        if len(rest) == len(group.scans) and not group.are_named:
            left = f", but {unread}" if unread else ""
            raise InputError(
                f"{group.name} names no scans{left}; known are {' '.join(sorted(suffixes()))}"
            )
        if unread:
            logger.warning("left unread in %s: %s", group.name, unread)
    return [
        _absolute(member)
        for scan, look in found.items()
        if scan.file not in parts
        for member in look.members or (scan,)
    ]


def shape_ids(scans: Mapping[str, ScanPath], taken: Mapping[str, str]) -> dict[str, str]:
    """Choose an id for each path: its name without suffix, with a number if another path has this id.

    That of a scan ``file.suffix#name`` is ``file#name``. `taken` has the paths of the ids there are.
    """
    # Imported here, because commands that only look for scans should not wait for the import of descriptors.
    from pcretrieve.catalogue import numbered_id

    used = set(taken)
    ids = {path: shape_id for shape_id, path in taken.items()}
    # The further ids of each name, of which those before are taken.
    further: dict[str, Iterator[str]] = {}
    for path, scan in scans.items():
        if path not in ids:
            stem = printable(replace(scan, file=Path(scan.file.stem), url=None))
            numbered = further.setdefault(stem, map(partial(numbered_id, stem), count(1)))
            ids[path] = next(one for one in numbered if one not in used)
            used.add(ids[path])
    return {path: ids[path] for path in scans}


def scans_of(shard: str | None, scans: Sequence[ScanPath]) -> Sequence[ScanPath]:
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


def check_remote(scans: Iterable[ScanPath], remote: Remote, location: str) -> None:
    """Check that the URLs among the scans of a catalogue, which may be somebody else's, may be fetched."""
    urls = [scan.url for scan in scans if scan.url is not None]
    # Not parsed, because parsers differ in what they take for the host.
    hosts = {
        "/".join(url.split("/", 3)[:3]) for url in urls if url.partition(":")[0] != FILE
    }
    if hosts and not (remote(sorted(hosts)) if callable(remote) else remote):
        raise InputError(
            f"{location} names scans at {', '.join(sorted(hosts))}, which are not fetched unasked, because "
            "it may name any address: give --remote (in Python remote=True) if you trust it"
        )


def _instead(suffix: str) -> str:
    """What to do with files of a suffix that are not read; empty if there is no advice."""
    extra = missing_extra(suffix)
    return extra.command if extra else INSTEAD.get(suffix, "")


def unread_files(paths: Iterable[Path]) -> str:
    """Say how many files of which suffix are left unread, and what would read them."""
    counts = Counter(path.suffix.lower() or "without a suffix" for path in paths)
    advice = {suffix: _instead(suffix) for suffix in counts}
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

    name: ScanPath
    scans: list[ScanPath]
    are_named: bool


def _expand(argument: str | Path | ScanPath, limits: Mapping[str, Any] | None) -> _Group:
    """The files that one argument means."""
    if not str(argument):
        raise InputError("a path must not be empty: name a file or a folder")
    path, meant = Path(str(argument)), ""
    place = ScanPath.parse(argument)
    are_named = False
    try:
        if place.url is not None:
            # The file of a URL with the suffix of a format, whatever it has; else the scans in a folder.
            are_named = place.suffix in suffixes() and not glob.has_magic(place.name)
            scans = [place] if are_named else _listed(place.url, limits)
        elif path.is_dir():
            scans = _files_below(path)
        elif path.exists():
            scans, are_named = _named_by(path), True
        elif place.file.exists():
            scans, are_named = [place], True
        elif glob.has_magic(str(argument)):
            matches = in_order(map(Path, glob.glob(str(argument), recursive=True)))
            are_named = path.suffix.lower() in MANIFESTS and bool(matches)
            within = _named_by if are_named else _files_below
            scans = [scan for match in matches for scan in within(match)]
        else:
            with suppress(OSError):
                meant = did_you_mean(
                    path.name, (one.name for one in path.parent.iterdir())
                )
            raise InputError(f"there is no file or folder {path}{meant}")
    except OSError as error:
        raise InputError(f"cannot look into {path}: {error.strerror}") from error
    return _Group(place, scans, are_named)


def _listed(url: str, limits: Mapping[str, Any] | None) -> list[ScanPath]:
    """The files in a folder at a URL, listed by an isolated process: a server may never end, or be silent."""
    try:
        if limits is None:
            return remote_files(url)
        memory = own_limit(min(limits["memory"] or LISTING_MEMORY, LISTING_MEMORY))
        return alone(remote_files, url, timeout=limits["timeout"], memory=memory)
    except ShapeError as error:
        raise InputError(
            f"cannot look into {url}: {error.message}; or name its files in a list (.txt)"
        ) from error


def _named_by(path: Path) -> list[ScanPath]:
    """The scans that a manifest names, or the file itself."""
    itself = ScanPath.parse(path)
    if path.suffix.lower() not in MANIFESTS or is_scan(itself):
        return [itself]
    if path.exists() and not path.is_file():  # reading a pipe or a device may never end
        raise InputError(
            f"the manifest {path} must be a regular file, not a pipe or a device"
        )
    text = read_text(path, "manifest")
    if path.suffix.lower() == ".csv":
        if DECIMALS.search(text.partition("\n")[0]):  # no header, but a row of a table
            return [itself]
        names = [name for (name,) in read_table(path, "manifest", text, PATH_COLUMNS)]
    else:
        # Not by splitlines: names may have its other separators, such as U+2028.
        names = [
            line.strip() for line in text.split("\n") if not line.lstrip().startswith("#")
        ]
    # Missing files are not an error here: reading them fails later, as a failure of one shape.
    named = [ScanPath.parse(name) for name in names if name]
    scans = [
        scan if scan.url else replace(scan, file=path.parent / scan.file)
        for scan in named
    ]
    # Unless all are: it is a table with a row that is none, of which its reader tells.
    if scans and not any(map(_is_there, scans)):
        return [itself]
    if not scans:
        raise InputError(f"the manifest {path} names no scans")
    return scans


def _is_there(scan: ScanPath) -> bool:
    """Whether a scan is a file that is there, or at a URL."""
    with suppress(OSError, ValueError):  # of a name that the system does not take
        return scan.url is not None or scan.file.exists()
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


def _files_below(path: Path) -> list[ScanPath]:
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
    return [ScanPath.parse(file) for file in found if not file.name.startswith(".")]


class Look(NamedTuple):
    """What a file is: whether it is a scan, the files that belong to it, and the scans in it."""

    is_scan: bool
    parts: tuple[Part, ...] = ()
    members: tuple[ScanPath, ...] = ()


def looked_into(
    scans: Collection[ScanPath],
    limits: Mapping[str, Any] | None,
    idle: list[Worker[ScanPath, Look]] | None = None,
) -> dict[ScanPath, Look]:
    """What files are. Isolated processes open those that may be long to read, and may use all memory.

    limits, idle: of `in_processes`; without limits, this process opens all files.
    """
    hidden = [scan for scan in scans if limits is not None and not _is_plain(scan)]
    isolated = in_processes(_look, hidden, idle=idle, **limits or {})
    opened = dict(isolated)
    looks = {}
    for scan in scans:
        look = opened[scan] if scan in opened else _look(scan)
        # Reading a file as a scan will report why it cannot be looked into.
        looks[scan] = Look(True) if isinstance(look, PcretrieveError) else look
    return looks


def _is_plain(scan: ScanPath) -> bool:
    """Whether at most the first bytes of a file say what it is. A file at a URL is not looked into."""
    if scan.url is not None or scan.suffix not in suffixes():
        return True
    own = FORMATS.own.get(scan.suffix)
    return (
        own is not None
        and own.names is None
        and own.parts is no_parts
        and own.recognise in (None, is_table)
    )


def _look(scan: ScanPath) -> Look:
    look = Look(True)
    # A name from a manifest may be none that the system takes; reading it as a scan will report that too.
    with suppress(Exception):
        look = look._replace(is_scan=is_scan(scan))
    if scan.url is None:
        with suppress(Exception):
            members = members_of(scan.file) if scan.member is None else ()
            look = look._replace(members=members)
        with suppress(Exception):
            parts = (
                Part(_absolute(ScanPath(part.path)).file, part.pose)
                for part in parts_of(scan.file)
            )
            look = look._replace(parts=tuple(parts))
    return look


def _absolute(scan: ScanPath) -> ScanPath:
    """The place by an absolute path without ``..``. Symbolic links to files are not resolved."""
    path = scan.file
    if scan.url is not None:
        return scan
    is_plain = ".." not in path.parts
    return replace(
        scan, file=path.absolute() if is_plain else path.parent.resolve() / path.name
    )


def _shard_key(scan: ScanPath) -> bytes:
    """A hash of the size and the ends of a file; of the path, if the file cannot be read."""
    file, name = scan.file, scan.member
    with suppress(OSError, ValueError):
        status = file.stat()
        if stat.S_ISREG(status.st_mode):  # reading a pipe would wait
            with file.open("rb") as opened:
                first = opened.read(END)
                opened.seek(max(status.st_size - END, 0))
                ends = b"%d" % status.st_size + first + opened.read(END)
            return hashlib.sha256(os.fsencode(name or "") + ends).digest()
    return hashlib.sha256(os.fsencode(str(scan))).digest()
