"""Distance matrices: all distances between the shapes of a gallery, however they were computed."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError
from pcretrieve.retrieval.distances import nearest_of, position_of
from pcretrieve.values import FloatArray, Neighbors
from pcretrieve.values.base import Value, locked
from pcretrieve.values.files import write_file


@dataclass(frozen=True, slots=True, eq=False)
class DistanceMatrix(Value):
    """All distances between the shapes of a gallery.

    Attributes
    ----------
    ids : tuple of str, length N
        Identifiers of the shapes, distinct.
    values : (N, N) float64
        Row i has the distances from shape i as a query to all shapes. Not negative, may be infinite; need not
        be symmetric, nor zero on the diagonal.
    labels : tuple of (str or None), length N
        Class of each shape; None if unknown.
    """

    ids: tuple[str, ...]
    values: FloatArray
    labels: tuple[str | None, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(self.ids))
        n = len(self.ids)
        if len(set(self.ids)) != n:
            twice = next(one for number, one in enumerate(self.ids) if one in self.ids[:number])
            raise InputError(f"ids of a distance matrix must be distinct, {twice!r} comes twice")
        values = locked("a distance matrix", self.values, (n, n), finite=False)
        if (negative := int((values < 0).sum())) > 0:
            raise InputError(
                f"distances must be 0 or more, got {negative} that are negative; turn similarities into "
                "distances first"
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "labels", tuple(self.labels) or (None,) * n)
        if len(self.labels) != n:
            raise InputError(f"labels must be as many as ids ({n}), got {len(self.labels)}")

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, ids: Sequence[str]) -> DistanceMatrix:
        """The distances between some of the shapes; ValueError if there is no shape of such an id."""
        chosen = [self.ids.index(shape_id) for shape_id in ids]
        labels = tuple(self.labels[row] for row in chosen)
        return DistanceMatrix(tuple(ids), self.values[np.ix_(chosen, chosen)], labels)

    def nearest(self, shape_id: str, k: int = 10) -> Neighbors:
        """The k shapes nearest to a shape of the gallery, itself included."""
        return nearest_of(self.ids, self.values[position_of(self.ids, shape_id)], k)


# Significant digits that every float64 is restored from exactly.
DIGITS = 17


def ids_path(path: str | Path) -> Path:
    """The file with the ids of a distance matrix."""
    return Path(path).with_suffix(".ids")


def write_matrix(matrix: DistanceMatrix, path: str | Path) -> None:
    """Write a distance matrix, and its ids to a second file.

    Parameters
    ----------
    matrix : DistanceMatrix
        The matrix; its labels are not written.
    path : str or Path
        A ``.npy`` file for NumPy; any other suffix, except ``.ids``, for plain text with one row a line,
        which restores every distance exactly. The ids are written to `ids_path`, one a line. Existing files
        are replaced.

    Raises
    ------
    InputError
        If a file cannot be written, or an id has a line break.
    """
    path = Path(path)
    if path.suffix == ".ids":
        raise InputError(
            f"a matrix file must not end in .ids, which is for its ids, got {path.name}"
        )
    broken = [shape_id for shape_id in matrix.ids if len(shape_id.splitlines()) != 1]
    if broken:
        raise InputError(
            f"ids must have one line each, got {broken[0]!r}: rename that file and ingest it again"
        )
    data = io.BytesIO()
    if path.suffix == ".npy":
        np.save(data, matrix.values, allow_pickle=False)
    else:
        np.savetxt(data, matrix.values, fmt=f"%.{DIGITS}g")
    lines = "".join(f"{shape_id}\n" for shape_id in matrix.ids)
    write_file(path, data.getvalue())
    write_file(ids_path(path), lines.encode("utf-8", errors="surrogateescape"))


def read_matrix(path: str | Path) -> DistanceMatrix:
    """Read a distance matrix and its ids.

    Parameters
    ----------
    path : str or Path
        A ``.npy`` file, or plain text with the distances from one shape to all in each line, separated by
        white space. The ids are read from `ids_path`, one a line, in the order of the rows.

    Returns
    -------
    DistanceMatrix
        Without labels.

    Raises
    ------
    InputError
        If a file cannot be read, the matrix is not square, a distance is negative or not a number, or the
        ids are not distinct or not as many as the rows.
    """
    path = Path(path)
    beside = ids_path(path)
    try:
        values = _read(path)
    except OSError as error:
        raise InputError(
            f"cannot read the distance matrix {path}: {error.strerror or error}"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a distance matrix: it is not UTF-8 text") from error
    # NumPy reads the header of a .npy file by parsers of Python, and lets their exceptions pass.
    except (
        ValueError,
        EOFError,
        SyntaxError,
        TokenError,
        TypeError,
        MemoryError,
        OverflowError,
    ) as error:
        raise InputError(f"{path} is not a distance matrix: {error}") from error
    if values.ndim != 2 or values.shape[0] != values.shape[1]:
        size = " by ".join(str(length) for length in values.shape) or "a single number"
        raise InputError(f"{path} must hold a square matrix, rows by columns, got {size}")
    try:
        ids = beside.read_bytes().decode("utf-8", errors="surrogateescape").splitlines()
    except OSError as error:
        raise InputError(
            f"cannot read {beside}, which must name the rows of {path.name}, one id a line: {error.strerror}"
        ) from error
    if len(ids) != len(values):
        raise InputError(
            f"{beside} must name the {len(values)} rows of {path.name}, got {len(ids)} ids"
        )
    try:
        return DistanceMatrix(tuple(ids), values)
    except InputError as error:
        raise InputError(f"{path}: {error.message}") from error


def _read(path: Path) -> NDArray[Any]:
    if path.suffix == ".npy":
        # Mapped into memory, because a header may declare more than the file has.
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*input contained no data")
        return np.loadtxt(path, ndmin=2, encoding="utf-8")
