"""Lower bounds of the distances from one signature to all others, in single precision.

Exact k-nearest-neighbour search by filter and refinement (`pcretrieve.retrieval.index`) needs for each
distance a bound that is fast to compute for every shape.

``log`` and ``d2``
    An orthogonal projection does not increase the Euclidean distance. The squared distance of the coordinates
    along the first principal directions is therefore a lower bound of the square of ``log``, and of that of
    ``d2``, since ``log`` ≤ ``d2``. Written as ‖p‖² − 2 p·q + ‖q‖², it is a product of a vector and a matrix.
``d1``
    tanh(x / 2) is concave for x ≥ 0. It is therefore at least its chord, x tanh(c / 2) / c, for x ≤ c, and at
    least tanh(c / 2) for x > c. The sum of min(|x|, c) over some of the values, times tanh(c / 2) / c, is a
    lower bound of ``d1``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.types import FloatArray

__all__ = ["BLOCK", "LowerBounds"]

# Number of principal directions, and for d1 number of values, that the bounds are computed from. With fewer
# the bounds are looser and more shapes need an exact distance; with more the bounds take longer. See
# docs/decisions.md, N_LEADING.
N_LEADING = 16
N_LEADING_D1 = 32

# The abscissa c where the chord of d1 ends; any c gives a lower bound. See docs/decisions.md, CLIP.
CLIP = 1.5

# Number of signatures that are processed together, so that intermediate arrays have a few MB.
BLOCK = 2**15

SINGLE = float(np.finfo(np.float32).eps)


@dataclass(frozen=True, slots=True, eq=False)
class LowerBounds:
    """The coordinates of a table of signatures that lower bounds of distances are computed from.

    Attributes
    ----------
    euclidean : bool
        Whether the bounds are those of ``log`` and ``d2``; otherwise they are those of ``d1``.
    mean : (L,) float64
        Mean of the whitened log-signatures, which is subtracted from each.
    axes : (L, D) float64
        Orthonormal columns: the principal directions, or the unit vectors of the selected values.
    coordinates : (D + 1, N) or (D, N) float32
        Coordinates of the signatures along the axes; for ``log`` and ``d2`` the squared length of each in the
        last row.
    """

    euclidean: bool
    mean: FloatArray
    axes: FloatArray
    coordinates: NDArray[np.float32]

    @classmethod
    def of(cls, distance: str, gallery: FloatArray, n_leading: int | None = None) -> LowerBounds:
        """The bounds of a distance for a table of whitened log-signatures.

        Parameters
        ----------
        distance : {"log", "d1"}
            The distance, or one that is never larger: the bounds of ``log`` are bounds of ``d2`` too.
        gallery : (N, L) float64
            Whitened log-signatures, at least one.
        n_leading : int, optional
            D; by default `N_LEADING`, for ``d1`` `N_LEADING_D1`.

        Returns
        -------
        LowerBounds
            With the principal directions, or the values, of largest variance.
        """
        mean = gallery.mean(axis=0)
        if distance == "d1":
            order = np.argsort(-np.diag(_scatter(gallery, mean)), kind="stable")[: n_leading or N_LEADING_D1]
            axes = np.eye(gallery.shape[1])[:, order]  # (L, D)
            return cls(False, mean, axes, _coordinates(gallery, mean, axes))
        _, directions = np.linalg.eigh(_scatter(gallery, mean))  # variances ascend
        axes = np.ascontiguousarray(directions[:, ::-1][:, : n_leading or N_LEADING])
        return cls(True, mean, axes, _coordinates(gallery, mean, axes, lengths=True))

    @property
    def table_shape(self) -> tuple[int, int]:
        """(N, L): the number of signatures, and of values of each."""
        return self.coordinates.shape[1], len(self.mean)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the bounds, by name: the input of `from_arrays`."""
        return {"mean": self.mean, "axes": self.axes, "coordinates": self.coordinates}

    @classmethod
    def from_arrays(cls, distance: str, arrays: Mapping[str, NDArray[Any]]) -> LowerBounds:
        """The bounds of a distance as in `of`, from the arrays of `to_arrays`.

        Parameters
        ----------
        distance : {"log", "d1"}
            As in `of`.
        arrays : mapping of str to array
            The arrays, which are not copied.

        Returns
        -------
        LowerBounds
            The bounds before.

        Raises
        ------
        KeyError
            If an array is missing.
        """
        return cls(distance != "d1", arrays["mean"], arrays["axes"], arrays["coordinates"])

    def to(self, point: FloatArray) -> NDArray[np.float32]:
        """Values that increase with the lower bounds of the distances from a query.

        Parameters
        ----------
        point : (L,) float64
            Whitened log-signature of the query.

        Returns
        -------
        (N,) float32
            To be compared with `limit`.
        """
        query = self._query(point)
        # Where single precision overflows, bounds are infinite or NaN.
        with np.errstate(over="ignore", invalid="ignore"):
            if self.euclidean:
                product: NDArray[np.float32] = np.append(-2 * query, 1).astype(np.float32) @ self.coordinates
                return product
            return _clipped_sums(query.astype(np.float32), self.coordinates)

    def limit(self, point: FloatArray, radius: float) -> np.float32:
        """The largest value of `to` that a signature within a radius can have, rounding errors included.

        Parameters
        ----------
        point : (L,) float64
            Whitened log-signature of the query.
        radius : float
            Distance from the query; not negative, may be infinite.

        Returns
        -------
        float32
            A signature with a larger value, NaN apart, is outside the radius.
        """
        query = self._query(point)
        n = len(query)
        with np.errstate(over="ignore", invalid="ignore"):
            if self.euclidean:
                length = query @ query
                # The stored squared lengths are reduced by their share of the rounding error.
                bound = radius**2 - length + _rounding(n) * length
            else:
                # Where |p − q| ≤ c, the magnitude of the coordinate p is at most |q| + c.
                rounding = SINGLE * n * (2 * np.abs(query).max() + (n + 3) * CLIP)
                bound = radius * CLIP / np.tanh(CLIP / 2) + rounding
            limit: np.float32 = np.nextafter(np.float32(bound), np.float32(np.inf))
            return limit

    def _query(self, point: FloatArray) -> FloatArray:
        """(D,) coordinates of a point along the axes."""
        coordinates: FloatArray = (point - self.mean) @ self.axes
        return coordinates


def _scatter(gallery: FloatArray, mean: FloatArray) -> FloatArray:
    """(L, L) sum of the outer products of the centred rows, without a centred copy of the table."""
    scatter = np.zeros((len(mean), len(mean)))
    for start in range(0, len(gallery), BLOCK):
        centred = gallery[start : start + BLOCK] - mean
        scatter += centred.T @ centred
    return scatter


def _coordinates(
    gallery: FloatArray, mean: FloatArray, axes: FloatArray, *, lengths: bool = False
) -> NDArray[np.float32]:
    """(D, N) coordinates along the axes; with `lengths` (D + 1, N), the squared lengths in the last row."""
    n_axes = axes.shape[1]
    coordinates = np.empty((n_axes + lengths, len(gallery)), np.float32)
    with np.errstate(over="ignore"):
        for start in range(0, len(gallery), BLOCK):
            block = slice(start, start + BLOCK)
            along = (gallery[block] - mean) @ axes  # (n, D)
            coordinates[:n_axes, block] = along.T
            if lengths:
                coordinates[-1, block] = (along**2).sum(axis=1) * (1 - 2 * _rounding(n_axes))
    return coordinates


def _rounding(n_axes: int) -> float:
    """Bound of the rounding error of ‖p‖² − 2 p·q in single precision, relative to 2 ‖p‖² + ‖q‖²."""
    # The factors, the products and the partial sums of D + 1 terms are rounded, and 2 |p·q| ≤ ‖p‖² + ‖q‖².
    # The factor of four beyond that covers the errors in double precision.
    return 2 * (n_axes + 4) * SINGLE


def _clipped_sums(query: NDArray[np.float32], coordinates: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,) sums over the rows of min(|coordinate − query|, c)."""
    sums = np.empty(coordinates.shape[1], np.float32)
    terms = np.empty((len(query), BLOCK), np.float32)
    for start in range(0, len(sums), BLOCK):
        block = coordinates[:, start : start + BLOCK]
        apart = np.subtract(block, query[:, np.newaxis], out=terms[:, : block.shape[1]])
        np.abs(apart, out=apart)
        np.minimum(apart, np.float32(CLIP), out=apart)
        apart.sum(axis=0, out=sums[start : start + BLOCK])
    return sums
