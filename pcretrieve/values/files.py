"""Files that are written: in one step, CSV text, tables of pandas and Parquet (the extra ``tables``).

And files that are read: of several parts, ZIP archives and NumPy's arrays, whose promises are checked before.
"""

from __future__ import annotations

import csv
import io
import os
import re
import secrets
import stat
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from errno import ENOLCK
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ScanReadError

ADVICE = "tables need pandas and pyarrow: pip install 'pcretrieve[tables]'"

# Largest number of scans, views, buffers or arrays in one file. Each scan is a row of a catalogue; as many
# views are about half a minute of a sensor with thirty frames a second.
MOST_MEMBERS = 1000

# Largest size of the directory of an archive, which `zipfile` reads as a whole; bytes.
MOST_DIRECTORY = 1 << 20

# Largest compression ratio of an archive as a whole. That of meshes in XML is small, 7.3 of a grid of a
# million vertices with integer coordinates: an archive that expands to much more was made to fill the memory.
MOST_RATIO = 100
# Number of bytes to which any archive may expand.
ANY_SIZE = 10_000_000

# Methods of compression whose output `zipfile` limits to the size that is asked for.
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


# Whether this is a system such as Linux or macOS: Windows has no locks, signals and pipes like theirs.
IS_POSIX = hasattr(os, "fork")


def lock(
    file: int | IO[bytes] | IO[str], *, shared: bool = False, waits: bool = True
) -> None:
    """Lock an open file until it is closed; OSError where that is not possible."""
    try:
        import fcntl
    except ImportError as error:
        raise OSError(ENOLCK, "this system has no such locks") from error
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    fcntl.flock(file, kind if waits else kind | fcntl.LOCK_NB)


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Paths in ascending order, in which numbers count as numbers: frame_2 comes before frame_10."""

    def key(path: Path) -> tuple[list[list[str | int]], Path]:
        texts = (re.split("([0-9]+)", part) for part in path.parts)
        return [
            [int(text) if text.isdecimal() else text for text in part] for part in texts
        ], path

    return sorted(paths, key=key)


def make_folder(path: Path) -> Path:
    """Make a folder, unless it is there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot make the folder {path}: {error.strerror}; name another"
        ) from error
    return path


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
        raise InputError(
            f"there is no folder {path.parent} to put {path.name} into: make it first"
        )
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file")
    if path.exists() and any(
        source.exists() and path.samefile(source) for source in sources
    ):
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
    # Without the umask.
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
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


def parquet_bytes(
    columns: Mapping[str, Sequence[object]], metadata: Mapping[str, str]
) -> bytes:
    """A Parquet file of named columns of one length."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(ADVICE) from error
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(
        pyarrow.table(dict(columns)).replace_schema_metadata(dict(metadata)), sink
    )
    return bytes(sink.getvalue().to_pybytes())


# --- what is read ----------------------------------------------------------------------------------------


def check_members(n: int) -> None:
    """Check the number of scans, views, buffers or arrays of a file, before they are made."""
    if n > MOST_MEMBERS:
        raise ScanReadError(
            f"a file must hold at most {MOST_MEMBERS} scans, views or arrays, this one has {n} or more: "
            "divide it into several files"
        )


class _File(io.FileIO):
    """A file of which no part is read as a whole that is larger than the largest directory."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > MOST_DIRECTORY:
            raise ValueError(
                f"its directory declares {size} bytes, {MOST_DIRECTORY} may be"
            )
        return super().read(size)


@contextmanager
def opened_archive(path: Path, ratio: int = MOST_RATIO) -> Iterator[zipfile.ZipFile]:
    """A ZIP archive; ValueError if it declares more than `ratio` times its size."""
    with _File(path) as file:
        directory = zipfile.ZipFile(file).infolist()
    check_members(len(directory))
    size, packed = sum(member.file_size for member in directory), path.stat().st_size
    if size > max(ANY_SIZE, ratio * packed):
        raise ValueError(f"its members declare {size} bytes in {packed}")
    if not {member.compress_type for member in directory} <= {*METHODS}:
        raise ValueError("its members must be stored or deflated: pack it again")
    with zipfile.ZipFile(path) as archive:
        yield archive


def member_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """An array in an archive."""
    with archive.open(member) as file:
        # Not all that the member expands to, which may be more than its directory declares.
        data = file.read(member.file_size)
    return read_array(io.BytesIO(data), len(data))


def read_array(file: IO[bytes], n_bytes: int) -> NDArray[Any]:
    """The array in a file of so many bytes; ValueError if it declares more."""
    shape, dtype, in_columns = array_header(file)
    if dtype.hasobject:
        raise ValueError(
            "it holds Python objects, which are not read: save an array of numbers"
        )
    promised = int(np.prod([*shape, dtype.itemsize], dtype=object))
    if (
        any(not 0 <= size <= n_bytes for size in shape)
        or promised > n_bytes - file.tell()
    ):
        raise ValueError(
            f"its header declares {promised} bytes, {n_bytes - file.tell()} follow"
        )
    values = np.frombuffer(file.read(promised), dtype)
    return values.reshape(shape, order="F" if in_columns else "C")


def array_header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any], bool]:
    """Shape and type of an array, and whether it is stored by columns."""
    # More than NumPy reads, which would allocate what is declared.
    head = io.BytesIO(file.read(1 << 16))
    version = np.lib.format.read_magic(head)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    with warnings.catch_warnings():
        # Warnings of headers by Python 2, and of odd signs in them.
        warnings.simplefilter("ignore")
        shape, in_columns, dtype = read(head)
    file.seek(head.tell())
    return shape, dtype, in_columns
