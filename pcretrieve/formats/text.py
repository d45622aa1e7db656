"""Text files with one point on each line: XYZ, XYZN, XYZRGB, PTS, ASC, CSV, TXT, and grids of points: PTX.

How a table is written is found from the first lines. A row holds three or more numbers, separated by
blanks, tabs, commas or semicolons; where commas are decimal points, by blanks or semicolons. The lines above
the first row are the header, which may name the columns, or hold the number of rows.
"""

from __future__ import annotations

import io
import re
import warnings
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats.format import (
    COORDINATE,
    NO_NUMBER,
    NORMAL,
    Cut,
    Damaged,
    RawScan,
    are_normals,
    axes_of,
    check_text,
    encoding_of,
    joined,
    without_zeros,
)
from pcretrieve.formats.organised import organised_scan
from pcretrieve.values import FloatArray, PointCloud
from pcretrieve.values.files import check_members

# Bytes at the start of a file from which its layout is found.
HEAD_BYTES = 1 << 16
# Longest part of a line in a message.
MOST_QUOTED = 40
# Longest header; those of scanners and of numerical programs have about ten lines.
MOST_HEADER_LINES = 50
# Fewest points of a body, the corners of a tetrahedron. A file with fewer rows is not taken for a scan.
FEWEST_POINTS = 4
# Largest number of columns of a table of points: coordinates, normals, colours, and readings of the sensor.
# Tables with more columns are other data, such as matrices of distances.
MOST_COLUMNS = 32

# Separator (None for blanks and tabs) and decimal point, in the order in which they are tried.
WRITINGS = ((None, "."), (",", "."), (";", "."), (";", ","), (None, ","))

# Names of columns of other tables: of trajectories, and of files.
OTHER_TABLES = frozenset({"timestamp", "qw", "path", "file", "filename"})
# The first line of a raster of heights by ESRI, which has the suffix .asc too.
RASTER = re.compile(r"\s*ncols\s+\d+\s*$", re.IGNORECASE)


class Layout(NamedTuple):
    """How a table of points is written: `promised` is the number of rows that its header names."""

    encoding: str
    separator: str | None
    decimal: str
    n_header_lines: int
    promised: float | None
    n_columns: int
    points: tuple[int, ...]
    normals: tuple[int, ...] | None
    named: bool


def read_text(path: Path, *, normals: bool | None = None) -> RawScan:
    """Read a table of points; rows of zeros are dropped with a note.

    normals: whether the fourth to the sixth column, of a file whose header does not name its columns, hold
        the normals. By default, if all of them have unit length.
    """
    lines, encoding = _head(path)
    layout = _layout(lines, encoding, n_numbers=6 if normals else 3)
    if not layout.named:
        _check_first_columns(lines[layout.n_header_lines :], layout)
    columns = layout.points + (layout.normals or ())
    if not layout.named and (normals or (normals is None and layout.n_columns >= 6)):
        columns = (0, 1, 2, 3, 4, 5)
    has_signs = _has_signs(path)
    with path.open(encoding=layout.encoding, errors="replace") as file:
        deque(islice(file, layout.n_header_lines), maxlen=0)
        # NumPy parses the lines as the file gives them, which is faster than line by line.
        rows: Iterable[str] = file
        if has_signs or layout.decimal != ".":
            rows = (_plain(line.replace(layout.decimal, ".")) for line in file)
        counts = [layout.promised or 0.0]
        if layout.promised is not None:
            rows = _without_counts(rows, counts)
        table = _number_rows(rows, columns, layout.separator)
    if layout.promised is not None and sum(counts) != len(table):
        raise Damaged(f"it declares {sum(counts):.0f} points and holds {len(table)}")
    keep = len(columns) == 6 and (layout.named or normals or are_normals(table[:, 3:]))
    if len(counts) > 1:
        raise ScanReadError(
            f"the file holds several clouds, {len(counts)} one after another, and may be several bodies: "
            "divide it, or remove the lines that count their points"
        )
    return without_zeros(RawScan(table[:, :3], normals=table[:, 3:] if keep else None))


def _without_counts(rows: Iterable[str], counts: list[float]) -> Iterator[str]:
    """The rows of several clouds in one file, without the lines that count them, which become `counts`."""
    for row in rows:
        if row.strip().isdecimal():
            counts.append(float(row))
        else:
            yield row


def _number_rows(
    lines: Iterable[str],
    columns: tuple[int, ...],
    separator: str | None = None,
) -> NDArray[np.float64]:
    """(n, c) columns of a table of numbers, whose text is never in memory as a whole."""
    try:
        with warnings.catch_warnings():
            # An empty table is reported by `read_scan`.
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(
                lines,
                np.float64,
                usecols=columns,
                delimiter=separator,
                ndmin=2,
                comments=None,
            )
    except ValueError as error:
        raise ScanReadError(
            f"each line must hold {max(columns) + 1} numbers: {error}"
        ) from error
    return table.reshape(-1, len(columns))


def is_table(path: Path) -> bool:
    """Whether a text file is a table of points, by its first rows."""
    lines, encoding = _head(path)
    layout = _layout(lines, encoding, n_numbers=3)
    header = lines[: layout.n_header_lines]
    names = {name for line in header for name in _names(line, layout.separator)}
    rows = [
        cells
        for line in lines[layout.n_header_lines :]
        if (cells := _cells(line, layout.separator))
    ]
    return (
        len(rows) >= FEWEST_POINTS
        and layout.n_columns <= MOST_COLUMNS
        and not names & OTHER_TABLES
        and all(
            len(row) == layout.n_columns and _is_row(row, layout.points, layout.decimal)
            for row in rows
        )
    )


# --- the layout -------------------------------------------------------------------------------------------


def _head(path: Path) -> tuple[list[str], str]:
    """The first lines of a text file, which are complete, and its encoding."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    encoding = encoding_of(head)
    text = head.decode(encoding, errors="replace")
    check_text(path, text)
    lines = list(io.StringIO(text, newline=None))
    return lines[:-1] if len(head) == HEAD_BYTES and len(lines) > 1 else lines, encoding


def _layout(lines: list[str], encoding: str, n_numbers: int) -> Layout:
    if lines and RASTER.match(lines[0]):
        raise ScanReadError(
            "it is a raster of heights by ESRI, not a table of points: export the points"
        )
    header = ""  # the last line above the first row that has words
    promised = None
    for n_lines, line in enumerate(lines[: MOST_HEADER_LINES + 1]):
        for separator, decimal in WRITINGS:
            cells = _cells(line, separator)
            names = _names(header, separator)
            points, normals = axes_of(names, COORDINATE), axes_of(names, NORMAL)
            matches = len(names) == len(cells)
            if not matches:  # columns behind those that are named change nothing
                matches, points, normals = points in (None, (0, 1, 2)), None, None
            if _is_row(cells, points or range(n_numbers), decimal):
                if not matches:
                    raise ScanReadError(
                        f"its header names {len(names)} columns, its first row has {len(cells)}"
                    )
                return Layout(
                    *(encoding, separator, decimal, n_lines, promised, len(cells)),
                    *(points or (0, 1, 2), normals, points is not None),
                )
        words = _cells(line, None)
        if len(words) == 1 and words[0].isdecimal() and words[0].isascii():
            # `int` raises an exception for a number of thousands of digits.
            promised = float(words[0])
        elif words and _is_row(words, range(len(words)), "."):
            break  # a row with too few numbers, and not a header
        else:
            header = line if _names(line, None) else header
    first = next((line.strip()[:MOST_QUOTED] for line in lines if line.strip()), None)
    if first is None:
        raise ScanReadError(
            "a table of points must have rows of numbers, this one has none at all"
        )
    raise ScanReadError(
        f"each line must hold {n_numbers} numbers, got {first!r}: give the columns a header such as x y z, "
        "if others stand before them; a list of scans must name a file that is there"
    )


def _check_first_columns(lines: list[str], layout: Layout) -> None:
    """Refuse a table without a header in which numbers of points, or of rows and columns, come first."""
    rows = [cells for line in lines if (cells := _cells(line, layout.separator))]

    def whole(k: int) -> bool:
        return all(k < len(row) and row[k].isdecimal() for row in rows)

    n_before = 0 if not whole(0) else 1 if not whole(1) else 2
    steps = (
        {float(after[0]) - float(row[0]) for row, after in pairwise(rows)}
        if n_before
        else set()
    )
    counts = n_before == 2 or steps == {1}
    fractions = [
        layout.decimal in cell for row in rows for cell in row[n_before : n_before + 3]
    ]
    if counts and all(fractions) and len(fractions) >= 3 * max(len(rows), FEWEST_POINTS):
        names = ("number", "row column")[n_before - 1]
        raise ScanReadError(
            f"its first columns count points, or the rows and columns of readings, which are no coordinates: "
            f"give the columns a header, such as {names} x y z"
        )


def _has_signs(path: Path) -> bool:
    """Whether a file has a sign of `_plain` anywhere."""
    with path.open("rb") as file:
        blocks = iter(partial(file.read, HEAD_BYTES), b"")
        return any(b"#" in block or b"(" in block for block in blocks)


def _plain(line: str) -> str:
    """A line without a comment, whose missing numbers are NaN: 1.#QNAN is not 1 before a comment."""
    # Few lines have these signs, and the search of an expression takes as long as all the rest.
    has_signs = "#" in line or "(" in line
    return NO_NUMBER.sub("nan", line).partition("#")[0] if has_signs else line


def _cells(line: str, separator: str | None) -> list[str]:
    """The cells of a row, without an empty one behind the last separator."""
    cells = [cell.strip() for cell in _plain(line).strip().split(separator)]
    return cells[:-1] if cells and not cells[-1] else cells


def _is_row(cells: list[str], columns: Iterable[int], decimal: str) -> bool:
    """Whether the cells of these columns are numbers."""
    return all(k < len(cells) and _is_number(cells[k], decimal) for k in columns)


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell if decimal == "." else cell.replace(decimal, "."))
    except ValueError:
        return False
    return "_" not in cell  # which Python allows between digits


def _names(line: str, separator: str | None) -> tuple[str, ...]:
    """The names in a header in lower case, without units in brackets, quotes and comment signs."""
    plain = re.sub(r"[\[(].*?[\])]", "", line.lower()).strip("#/%\ufeff \r\n")
    mark = "\t" if separator is None and "\t" in plain.strip() else separator
    # Names of one word may be separated otherwise than the cells of the rows. A name may be empty: that of
    # the index of a table by pandas.
    words = (
        plain.split(mark)
        if mark is not None and mark in plain
        else re.split(r"[\s,;]+", plain.strip())
    )
    names = tuple(word.strip("\"' \t") for word in words)
    return names if any(names) else ()


def xyzn_bytes(cloud: PointCloud) -> bytes:
    """Points and normals as lines of nine digits, sufficient for single precision."""
    if cloud.normals is None:
        raise InputError(
            "an .xyzn file must hold normals, these points have none: write .ply, or estimate them"
        )
    text = io.BytesIO()
    np.savetxt(text, np.concatenate([cloud.points, cloud.normals], axis=1), fmt="%.9g")
    return text.getvalue()


# --- PTX: grids of readings, each with the pose of the sensor -----------------------------------------------

# Lines of a header: columns, rows, the sensor and its three axes, and a matrix of four lines.
N_HEADER_LINES = 10
# Size of the shortest row, "0 0 0" and the end of the line; bytes.
SHORTEST_ROW = 6
# Largest difference of the rotation of a pose from an orthogonal matrix: files have six digits.
POSE_TOLERANCE = 1e-3


class Grid(NamedTuple):
    """The size of a grid, and the motion from the frame of its sensor to that of the file."""

    n_columns: int
    n_rows: int
    rotation: FloatArray  # (3, 3), for points in rows: p' = p R + t
    translation: FloatArray  # (3,)


def read_ptx(path: Path, name: str | None = None) -> RawScan:
    """Read the scans in a PTX file as one, or the scan of a number, without readings that are zeros."""
    with closing(_grids(path)) as grids:
        return joined(
            [
                _scan(rows, grid)
                for k, (grid, rows) in enumerate(grids, start=1)
                if name in (None, str(k))
            ]
        )


def ptx_names(path: Path) -> tuple[str, ...]:
    """The numbers of the scans in a file."""
    with closing(_grids(path)) as grids:
        return tuple(str(number) for number, _ in enumerate(grids, start=1))


def _grids(path: Path) -> Generator[tuple[Grid, Iterator[str]], None, None]:
    """Yield the header and the rows of each scan; rows that are not read are skipped."""
    n_scans = 0
    # Bytes that are no text are no numbers either, and are reported as such.
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        filled = filter(str.strip, file)
        while (lines := [*islice(filled, N_HEADER_LINES)]) or not n_scans:
            n_scans += 1
            check_members(n_scans)
            try:
                grid = _header(lines, path.stat().st_size)
            except ValueError as error:
                raise Damaged(f"its header is damaged: {error}") from error
            rows = islice(filled, grid.n_columns * grid.n_rows)
            yield grid, rows
            deque(rows, maxlen=0)


def _header(lines: list[str], size: int) -> Grid:
    """The header of a scan in a file of so many bytes; ValueError if it is damaged."""
    numbers = [[float(word) for word in line.split()] for line in lines]
    (n_columns,), (n_rows,) = numbers[:2]
    pose = np.array(numbers[6:])
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError("it must be ten lines, of which the last four are a matrix")
    if not (
        n_columns.is_integer() and n_rows.is_integer() and min(n_columns, n_rows) >= 0
    ):
        raise ValueError(
            f"the size of the grid must be whole numbers, got {n_columns:g} {n_rows:g}"
        )
    if n_columns * n_rows * SHORTEST_ROW > size:
        raise ValueError(f"it declares {n_columns * n_rows:.0f} rows in {size} bytes")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > POSE_TOLERANCE:
        raise ValueError("the matrix is not a rigid motion")
    return Grid(int(n_columns), int(n_rows), rotation, pose[3, :3])


def _scan(rows: Iterator[str], header: Grid) -> RawScan:
    n = header.n_columns * header.n_rows
    table = _number_rows(map(_plain, rows), (0, 1, 2))
    if len(table) != n:
        raise Cut(f"its header declares {n} points, it holds {len(table)}")
    measured = np.isfinite(table).all(axis=1) & table.any(axis=1)  # (n,)
    if not measured.any():
        return RawScan(table[:0])
    points = table @ header.rotation + header.translation
    size = header.n_columns, header.n_rows
    try:
        return organised_scan(
            points.reshape(*size, 3), measured.reshape(size), header.translation
        )
    except ScanReadError as error:
        raise ScanReadError(
            f"a scan of {size[0]} × {size[1]} readings: {error.message}"
        ) from error
