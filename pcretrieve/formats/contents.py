"""The contents of a file, before it is read: whether it is a scan, its scans, and the files of its parts."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.errors import OptionError, ScanReadError, ShapeError, Stage
from pcretrieve.formats.files import check_file
from pcretrieve.formats.format import Part
from pcretrieve.formats.members import MARK
from pcretrieve.formats.registry import FORMATS, format_of, missing_extra, reading, split_member
from pcretrieve.formats.urls import url_of

__all__ = ["is_scan", "members_of", "parts_of"]


def is_scan(path: Path) -> bool:
    """Whether a file of a folder is a scan that can be read."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS.names.all() or missing_extra(suffix):
        return False
    try:
        recognise = FORMATS[suffix].recognise
        if recognise is None:
            return True
        if url_of(path) is not None:
            return False  # only a copy of the file could be looked into
        check_file(path)
        with FORMATS.blamed(suffix, Stage.READ):
            return recognise(path)
    except ScanReadError:
        return False  # a folder, a pipe or a device, or an empty file
    except (OSError, OptionError, ShapeError):
        return True


def members_of(path: Path) -> tuple[Path, ...]:
    """The scans in a file."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS.names.all() or missing_extra(suffix):
        return ()
    members = format_of(suffix).members
    if members is None:
        return ()
    check_file(path)
    with reading(suffix):
        names = members.names(path)
    return tuple(path.with_name(f"{path.name}{MARK}{name}") for name in names) if len(names) > 1 else ()


def parts_of(path: Path) -> tuple[Part, ...]:
    """The other files that belong to a file."""
    file, _ = split_member(path)
    suffix = file.suffix.lower()
    if suffix not in FORMATS.names.all():
        return ()
    found = format_of(suffix)
    with reading(suffix):
        return tuple(found.parts(file))
