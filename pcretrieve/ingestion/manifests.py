"""A text file or a table that names scans → their paths."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from pcretrieve.errors import InputError
from pcretrieve.formats import url_of

__all__ = ["MANIFESTS", "read_manifest"]

# Suffixes of manifests. Files of the same suffixes may be tables of points.
MANIFESTS = frozenset({".txt", ".csv"})
PATH_COLUMNS = ("path", "file", "filename", "name")


def read_manifest(path: Path) -> list[Path]:
    """The scans that a manifest names."""
    try:
        # Reading a pipe or a device may never end.
        if path.exists() and not path.is_file():
            raise InputError(f"the manifest {path} must be a regular file, not a pipe or a device")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(f"cannot read the manifest {path}: {reason}") from error
    if path.suffix.lower() == ".csv":
        try:
            rows = csv.DictReader(io.StringIO(text, newline=""), strict=True)
            header = {name.strip().lower(): name for name in rows.fieldnames or ()}
            column = next((header[name] for name in PATH_COLUMNS if name in header), None)
            if column is None:
                raise InputError(f"the manifest {path} must have a column {' or '.join(PATH_COLUMNS)}")
            names = [(row[column] or "").strip() for row in rows]
        except csv.Error as error:
            raise InputError(f"the manifest {path} is not a CSV file: {error}") from error
    else:
        # Not by splitlines: names may have its other separators, such as U+2028.
        names = [line.strip() for line in text.split("\n") if not line.lstrip().startswith("#")]
    # Missing files are not an error here: reading them fails later, as a failure of one shape.
    scans = [Path(name) if url_of(Path(name)) else path.parent / name for name in names if name]
    if not scans:
        raise InputError(f"the manifest {path} names no scans")
    return scans
