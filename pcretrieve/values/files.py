"""What is written: files in one step, CSV text, and tables of pandas and Parquet (the extra ``tables``)."""

from __future__ import annotations

import csv
import os
import secrets
import stat
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from pcretrieve.errors import InputError

ADVICE = "tables need pandas and pyarrow: pip install 'pcretrieve[tables]'"


def write_file(path: Path, data: bytes) -> None:
    """Write a file in one step: at any time, its path has the old content or all of the new content.

    The data are written to a temporary file in the same directory, which is renamed when the data have
    reached the disk. The file gets the permissions of a new file. A symbolic link is followed. A path that is
    not a regular file, such as ``/dev/stdout``, cannot be replaced, and is written directly.
    """
    try:
        if path.exists() and not stat.S_ISREG(path.stat().st_mode):
            path.write_bytes(data)
        else:
            _replace(Path(os.path.realpath(path)), data)
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror or error}; name a file in a folder that exists and can be "
            "written"
        ) from error


def check_target(path: Path, sources: Sequence[Path] = ()) -> None:
    """Check, before a long computation, that its result can be written and replaces no file that is read."""
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} to put {path.name} into: make it first")
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file")
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise InputError(f"{path} is one of the files to be read: name another file")


def check_no_links(files: Iterable[Path]) -> None:
    """Check that no file with a name that nobody typed is a link, which `write_file` would follow."""
    for file in files:
        if file.is_symlink():
            raise InputError(
                f"{file} is a link, and what it leads to would be replaced: remove the link, or name another "
                "folder"
            )


def _replace(target: Path, data: bytes) -> None:
    # A short name, because a name longer than that of the file might be too long.
    temporary = target.with_name(f".{secrets.token_hex(8)}.part")
    descriptor = os.open(
        temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666
    )  # without the umask
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def csv_text(header: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Write rows as comma-separated values, from which any reader gets the same fields again."""
    # With the line ends of RFC 4180, because a writer with other ends does not quote a carriage return.
    lines: list[str] = []
    writer = csv.writer(SimpleNamespace(write=lines.append))
    writer.writerow(header)
    writer.writerows(rows)
    return "".join(line.removesuffix("\r\n") + "\n" for line in lines)


def data_frame(columns: Mapping[str, Any], index: str) -> Any:
    """A table of named columns of one length."""
    try:
        import pandas
    except ImportError as error:
        raise InputError(ADVICE) from error
    return pandas.DataFrame(dict(columns)).set_index(index)


def parquet_bytes(columns: Mapping[str, Sequence[object]], metadata: Mapping[str, str]) -> bytes:
    """A Parquet file of named columns of one length."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(ADVICE) from error
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(dict(columns)).replace_schema_metadata(dict(metadata)), sink)
    return bytes(sink.getvalue().to_pybytes())
