"""Exact nearest neighbours among many signatures.

A BallTree searches an embedding of the log-signatures in which distances are cheap and never longer than the
true ones. What it finds is then measured exactly:

1. the k shapes nearest by the bound have k exact distances, the largest of which is τ;
2. each of the k true neighbours is no farther than τ, hence no farther than τ by the bound either;
3. all shapes that near by the bound are ranked by exact distance, ties by id.

The answer is that of comparing the query with every shape, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.retrieval.distances import DISTANCES, log_signatures, pairwise
from pcretrieve.retrieval.whitening import Whitening, fit_whitening
from pcretrieve.types import FloatArray, Neighbors, Signature, SignatureTable

__all__ = ["SignatureIndex"]

# Directions of largest variance that the tree searches. One query, 45 values, 100 000 shapes, k = 10: 2 to
# 4 ms with 6 directions; 2 to 20 ms with 3, whose bound lets too much through; 5 to 10 ms with all 45, where
# the tree leaves little out. Comparing with every shape takes 16 ms.
N_LEADING = 6

# exp stays within float64, with room for the sums over a whole gallery.
LARGEST_LOG = 300.0

# Rounding of a sum of L products of numbers of size s is a few L·s·ε: the bound is trusted only up to that.
ROUNDING = 64 * float(np.finfo(np.float64).eps)

Embedding = Callable[[FloatArray], FloatArray]


def _leading_directions(gallery: FloatArray, n_leading: int) -> tuple[str, Embedding]:
    """Coordinates along the gallery's directions of largest variance; Euclidean distance.

    Rotations keep the Euclidean distance of log-signatures and leaving coordinates out shortens it, so this
    bounds the distance ``log`` from below, and ``d2``, which is never less than ``log``.
    """
    mean = gallery.mean(axis=0)
    centred = gallery - mean
    _, directions = np.linalg.eigh(centred.T @ centred)  # variances ascend
    leading = directions[:, ::-1][:, :n_leading]  # (L, n_leading)
    return "euclidean", lambda logs: (logs - mean) @ leading


def _positive_values(gallery: FloatArray, n_leading: int) -> tuple[str, Embedding]:
    """Signature values, from log-signatures; Canberra distance Σ |a − b| / (|a| + |b|), which is ``d1``.

    It is a metric, and compiled into BallTree. A common factor per value leaves it alone, so the mean is
    taken off for the sake of exp. Clipping brings two logarithms nearer, never apart, and tanh(|x| / 2) grows
    with |x|: what is clipped is bounded from below.
    """
    mean = gallery.mean(axis=0)
    return "canberra", lambda logs: np.exp(np.clip(logs - mean, -LARGEST_LOG, LARGEST_LOG))


_EMBEDDINGS: Mapping[str, Callable[[FloatArray, int], tuple[str, Embedding]]] = MappingProxyType(
    {"log": _leading_directions, "d2": _leading_directions, "d1": _positive_values}
)


class SignatureIndex:
    """A searchable table of signatures.

    The tree is built here and not stored: its pickle changes between versions of scikit-learn, and building
    takes 0.3 s for 100 000 shapes.

    Parameters
    ----------
    table : SignatureTable
    distance : str
        A name in `pcretrieve.retrieval.DISTANCES`: ``log`` (default), ``d1`` or ``d2``.
    whitening : Whitening or str
        One made before, such as `resolution_whitening`, or the kind of one to fit on `table`; by default
        ``none``.
    n_leading : int
        Directions that the tree searches for ``log`` and ``d2``; changes the speed, never the answer.

    Attributes
    ----------
    distance : str
    whitening : Whitening

    Raises
    ------
    OptionError
        For a distance or a whitening that does not exist, or `n_leading` below 1.
    InputError
        For an empty table, or a whitening that was fitted on signatures made by other options.
    """

    def __init__(
        self,
        table: SignatureTable,
        *,
        distance: str = "log",
        whitening: Whitening | str = "none",
        n_leading: int = N_LEADING,
    ) -> None:
        from sklearn.neighbors import BallTree

        if distance not in DISTANCES:
            raise OptionError(f"distance must be one of {', '.join(DISTANCES)}, got {distance!r}")
        if n_leading < 1:
            raise OptionError(f"n_leading must be at least 1, got {n_leading}")
        if not len(table):
            raise InputError("an index needs at least 1 shape, got an empty table; ingest shapes first")
        logs = log_signatures(table.values)
        if isinstance(whitening, str):
            whitening = fit_whitening(whitening, logs, table.labels, options_digest=table.digest)
        elif whitening.options_digest != table.digest:
            raise InputError(
                f"the whitening must be fitted on signatures made by the same options as the table "
                f"({table.digest!r}), got {whitening.options_digest!r}; fit it again"
            )
        self.distance = distance
        self.whitening = whitening
        self._kind, self._digest = table.kind, table.digest
        by_id = sorted(range(len(table)), key=table.ids.__getitem__)
        self._ids = tuple(table.ids[row] for row in by_id)
        self._gallery = whitening.apply(logs[by_id])  # (N, L); rows ascend by id, so ties do
        self._size = max(1.0, float(np.abs(self._gallery).max(initial=0)))
        metric, self._embed = _EMBEDDINGS[distance](self._gallery, n_leading)
        self._tree: Any = BallTree(self._embed(self._gallery), metric=metric)

    def __len__(self) -> int:
        return len(self._ids)

    def query(self, signature: Signature | ArrayLike, k: int = 10) -> Neighbors:
        """The `k` shapes nearest to one signature, itself included where it is in the table.

        Parameters
        ----------
        signature : Signature or (L,) array_like
            Positive values, as in the table; not whitened, not logarithms.
        k : int
            Shapes wanted, at least 1. A table with fewer shapes gives all of them.

        Raises
        ------
        OptionError
            For `k` below 1.
        InputError
            For a signature of another kind, digest or length than the table's, or one with values that are
            not positive and finite.
        """
        if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or k < 1:
            raise OptionError(f"k must be a whole number of at least 1, got {k!r}")
        point = self.whitening.apply(self._checked_logs(signature)[np.newaxis])  # (1, L)
        candidates = self._candidates(point, min(int(k), len(self)))
        distances = pairwise(self.distance, point, self._gallery[candidates])[0]
        order = np.argsort(distances, kind="stable")[:k]
        ranked = distances[order]
        ranked.flags.writeable = False
        return Neighbors(tuple(self._ids[row] for row in candidates[order]), ranked)

    def query_many(self, signatures: Iterable[Signature | ArrayLike], k: int = 10) -> list[Neighbors]:
        """`query` for each signature, or each row of a (Q, L) array, in order."""
        return [self.query(signature, k) for signature in signatures]

    def _candidates(self, point: FloatArray, k: int) -> NDArray[np.intp]:
        """Rows of the gallery, ascending, among which are the `k` nearest and all that tie with them."""
        embedded = self._embed(point)
        bounds, rows = self._tree.query(embedded, k=min(k + 1, len(self)))  # (1, k + 1), ascending
        exact = pairwise(self.distance, point, self._gallery[rows[0]])[0]
        farthest = np.partition(exact, k - 1)[k - 1]
        size = max(self._size, float(np.abs(point).max(initial=0)))
        radius = farthest + ROUNDING * (farthest + size * point.shape[1])
        # Where even the last bound is beyond the radius, so is every shape that the tree left out.
        if rows.shape[1] < len(self) and bounds[0, -1] <= radius:
            rows = self._tree.query_radius(embedded, radius)
        candidates: NDArray[np.intp] = np.sort(rows[0])
        return candidates

    def _checked_logs(self, signature: Signature | ArrayLike) -> FloatArray:
        """(L,) logarithms of a query that belongs in this table."""
        if isinstance(signature, Signature):
            if (signature.kind, signature.digest) != (self._kind, self._digest):
                raise InputError(
                    f"the query must be made by the same method and options as the table, "
                    f"{self._kind!r} {self._digest!r}, got {signature.kind!r} {signature.digest!r}"
                )
            signature = signature.values
        logs = log_signatures(signature)
        if logs.shape != (self._gallery.shape[1],):
            raise InputError(
                f"the query must have shape ({self._gallery.shape[1]},), as the table's rows have, "
                f"got {logs.shape}"
            )
        return logs
