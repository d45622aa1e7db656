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
    """Whether a file of a folder is a scan that can be read.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    bool
        True if the suffix is that of a format whose extra is installed, and which recognises the file, if
        other files may have the suffix too. A file that cannot be opened counts as a scan, so that reading it
        reports the error; one at a URL counts as none, if other files may have the suffix too.
    """
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
    """The scans in a file.

    Parameters
    ----------
    path : Path
        The file, of any suffix.

    Returns
    -------
    tuple of Path
        The path ``file#name`` of each scan, if there are two or more; else empty.

    Raises
    ------
    OSError
        If the file cannot be read.
    ScanReadError
        If the file is damaged, or its reader cannot be loaded.
    """
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
    """The other files that belong to a file.

    Parameters
    ----------
    path : Path
        The file, of any suffix.

    Returns
    -------
    tuple of Part
        Empty, if the file is a scan alone.

    Raises
    ------
    OSError
        If the file cannot be read.
    ScanReadError
        If the file does not name its parts, or its reader cannot be loaded.
    """
    file, _ = split_member(path)
    suffix = file.suffix.lower()
    if suffix not in FORMATS.names.all():
        return ()
    found = format_of(suffix)
    with reading(suffix):
        return tuple(found.parts(file))
