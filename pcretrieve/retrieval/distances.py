"""Distances between signatures, as functions of the difference of their coordinates, and what ranks by them.

The coordinates of a signature are the logarithms of its values, if that is its metric. Let a and b be two
signatures and x = log a − log b, element by element. Then

    d1    Σ |a − b| / (a + b)      = Σ tanh(|x| / 2)         a metric, at most L
    d2    √ Σ (a − b)² / (a b)     = √ Σ 4 sinh²(x / 2)      not a metric
    log   √ Σ x²                                             a metric, and log ≤ d2, since |sinh u| ≥ |u|

`d1` and `d2` are the dissimilarities D₁ and D₂ of Ye and Yu [1]_ (D₂ is equation (11)). If a whitening maps
log-signatures to y, the distances are those of the positive vectors exp(y).

Signatures that are compared as they are have their values as coordinates, and histograms the square roots of
their bins. Of the distances above, only `log` is meaningful for them, which is then the Euclidean distance of
the values, and √2 times the Hellinger distance of histograms with the sum 1.

References
----------
.. [1] Ye and Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual Computer
   2016, section 2.4.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.values import FloatArray, Metric, Neighbors, SignatureTable
from pcretrieve.values.base import Value, locked
from pcretrieve.values.files import write_file

Positions = NDArray[np.intp]

# Number of differences in memory at once: 1 MiB, which fits the processor's second-level cache.
CHUNK_VALUES = 2**17

# Number of signatures that are processed together, so that intermediate arrays have a few MB.
CHUNK = 2**15

# Number of distances that are in memory at once: 32 MB.
BLOCK_DISTANCES = 2**22


def _d1(x: FloatArray) -> FloatArray:
    return np.asarray(np.tanh(np.abs(x) / 2).sum(axis=-1))


def _d2(x: FloatArray) -> FloatArray:
    # sinh²(x / 2) overflows float64 if |x| > 710: an infinite distance is then the intended result.
    with np.errstate(over="ignore"):
        root: FloatArray = np.sqrt((4 * np.sinh(x / 2) ** 2).sum(axis=-1))
    return root


def _log(x: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((x**2).sum(axis=-1)))


@dataclass(frozen=True, slots=True)
class Distance:
    """A distance of signatures, of pcretrieve or of one's own.

    between: function of (…, L) float64 that returns (…) float64, distances from the differences of
        coordinates, the last axis of which is summed over.
    metrics: the metrics of the signatures that the distance is meaningful for.
    exceeds_log: whether it is never smaller than `log`, whose lower bounds the index then uses; otherwise
        each query is compared with all shapes.
    """

    name: str
    between: Callable[[FloatArray], FloatArray]
    metrics: tuple[Metric, ...] = ("logarithms",)
    exceeds_log: bool = False


DISTANCES = {
    distance.name: distance
    for distance in (
        Distance(
            "log", _log, metrics=("logarithms", "values", "histograms"), exceeds_log=True
        ),
        Distance("d1", _d1),
        Distance("d2", _d2, exceeds_log=True),
    )
}


def known_distance(distance: str | Distance) -> Distance:
    """The distance of a name, or the one that is given."""
    if isinstance(distance, Distance):
        return distance
    if distance not in DISTANCES:
        raise OptionError(
            f"there is no distance {distance!r}; there are {', '.join(DISTANCES)}"
        )
    return DISTANCES[distance]


def coordinates(values: ArrayLike, metric: Metric = "logarithms") -> FloatArray:
    """The coordinates (…, L) of signatures (…, L): the logarithms, the values, or the square roots."""
    if metric == "logarithms":
        logs: FloatArray = np.log(
            _checked(values, "positive and finite", lambda x: np.isfinite(x) & (x > 0))
        )
        return logs
    array = _checked(values, "finite", np.isfinite)
    if metric == "values":
        return array
    roots: FloatArray = np.sqrt(
        _checked(array, "bins of a histogram, not negative", lambda x: x >= 0)
    )
    return roots


def table_coordinates(table: SignatureTable, distance: str | Distance) -> FloatArray:
    """The coordinates (N, L) of the signatures in a table, for a distance."""
    check_comparable(table, distance)
    return coordinates(table.values, table.metric)


def check_comparable(table: SignatureTable, distance: str | Distance) -> None:
    """OptionError if a distance is not meaningful for the signatures of a table."""
    asked = known_distance(distance)
    if table.metric not in asked.metrics:
        meaningful = ", ".join(
            name for name, each in DISTANCES.items() if table.metric in each.metrics
        )
        raise OptionError(
            f"distance must be {meaningful} for {table.kind}, which is compared as {table.metric}, got "
            f"{asked.name!r}"
        )


def pairwise(
    distance: str | Distance, queries: FloatArray, gallery: FloatArray
) -> FloatArray:
    """Distances (Q, N) of all queries (Q, L) to all shapes of the gallery (N, L), by their coordinates.

    The floating-point result for a pair depends on this pair alone: equal signatures have exactly equal
    distances, and d(a, b) = d(b, a) exactly.
    """
    between = known_distance(distance).between
    n_values = max(1, gallery.shape[1])
    columns = max(1, min(len(gallery), CHUNK_VALUES // n_values))
    rows = max(1, CHUNK_VALUES // (n_values * columns))
    distances = np.empty((len(queries), len(gallery)))
    for i in range(0, len(queries), rows):
        for j in range(0, len(gallery), columns):
            x = (
                queries[i : i + rows, np.newaxis] - gallery[np.newaxis, j : j + columns]
            )  # (rows, columns, L)
            distances[i : i + rows, j : j + columns] = between(x).reshape(x.shape[:2])
    return distances


def _checked(
    values: ArrayLike, kind: str, holds: Callable[[FloatArray], NDArray[np.bool_]]
) -> FloatArray:
    """The values as an array, all of which are of a kind."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"signature values must be an array of numbers, got {values!r}"
        ) from error
    bad = array[~holds(array)]
    if bad.size:
        raise InputError(
            f"signature values must be {kind}, got {bad[0]} ({bad.size} such values of "
            f"{array.size}); compute the signature again"
        )
    return array


class DistanceBlock(NamedTuple):
    """Distances (q, N) from some shapes (q,) of a gallery to all N, themselves included."""

    queries: Positions
    distances: FloatArray


def pairwise_blocks(
    distance: str | Distance, gallery: FloatArray, queries: Positions
) -> Iterator[DistanceBlock]:
    """Distances from some signatures of a gallery (N, L) to all of them, a few queries at a time."""
    rows = max(1, BLOCK_DISTANCES // max(1, len(gallery)))
    for start in range(0, len(queries), rows):
        chunk = queries[start : start + rows]
        yield DistanceBlock(chunk, pairwise(distance, gallery[chunk], gallery))


def nearest_of(ids: Sequence[str], distances: FloatArray, k: int) -> Neighbors:
    """The nearest shapes by their distances (N,), which are not NaN."""
    k = checked_k(k)
    # Shapes as near as the k-th are candidates too: which of them come first is decided by their ids.
    limit = np.partition(distances, k - 1)[k - 1] if k < len(distances) else np.inf
    near: list[int] = np.flatnonzero(distances <= limit).tolist()
    rows = sorted(near, key=lambda row: (distances[row], ids[row]))[:k]
    return Neighbors(tuple(ids[row] for row in rows), distances[rows])


def checked_k(k: int) -> int:
    """A number of neighbours, after a check."""
    if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or k < 1:
        raise OptionError(f"k must be a whole number of at least 1, got {k!r}")
    return int(k)


def position_of(ids: Sequence[str], shape_id: str) -> int:
    """The position of a shape in a gallery."""
    try:
        return ids.index(shape_id)
    except ValueError as error:
        raise unknown_shape(ids, shape_id) from error


def unknown_shape(ids: Sequence[str], shape_id: str) -> InputError:
    """The error of a shape that is not in a gallery."""
    return InputError(
        f"the query must be one of the {len(ids)} ranked shapes, got {shape_id!r}"
    )


# --- all distances of a gallery ----------------------------------------------------------------------------


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
            twice = next(
                one for number, one in enumerate(self.ids) if one in self.ids[:number]
            )
            raise InputError(
                f"ids of a distance matrix must be distinct, {twice!r} comes twice"
            )
        values = locked("a distance matrix", self.values, (n, n), finite=False)
        if (negative := int((values < 0).sum())) > 0:
            raise InputError(
                f"distances must be 0 or more, got {negative} that are negative; turn similarities into "
                "distances first"
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "labels", tuple(self.labels) or (None,) * n)
        if len(self.labels) != n:
            raise InputError(
                f"labels must be as many as ids ({n}), got {len(self.labels)}"
            )

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
        raise InputError(
            f"{path} is not a distance matrix: it is not UTF-8 text"
        ) from error
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
