"""Lower bounds of the distances from one signature to all others, in single precision.

Exact k-nearest-neighbour search by filter and refinement (`pcretrieve.retrieval.index`) needs bounds of the
distances that are fast to compute for many shapes. The bounds are sums of terms of the distances |p − q| of
coordinates, for which `pcretrieve.retrieval.blocks` has lower bounds.

``log`` and ``d2``
    An orthogonal projection does not increase the Euclidean distance. The sum of (p − q)² over the
    coordinates along the first principal directions is therefore a lower bound of the square of ``log``, and
    of that of ``d2``, since ``log`` ≤ ``d2``.
``d1``
    tanh(x / 2) is concave for x ≥ 0. It is therefore at least its chord, x tanh(c / 2) / c, for x ≤ c, and at
    least tanh(c / 2) for x > c. The sum of min(|p − q|, c) over some of the values, times tanh(c / 2) / c, is
    a lower bound of ``d1``. Its cells have the same length along all values, so that it is a sum of small
    integers in units of that length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.retrieval.blocks import N_CELLS, Blocks, Rows
from pcretrieve.retrieval.covariances import CHUNK, scatter_matrix
from pcretrieve.values import FloatArray

__all__ = ["LowerBounds"]

# Number of principal directions, and for d1 number of values, that the bounds are computed from. With fewer
# the bounds are looser and more shapes need an exact distance; with more the bounds take longer. See
# docs/decisions.md, N_LEADING.
N_LEADING = 24
N_LEADING_D1 = 128  # a sum of so many numbers of eight bits has 16 bits

# Largest number of the leading axes that the blocks are divided along. A million shapes are divided ten times
# before they are in blocks.
N_DIVIDING = 8

# The abscissa c where the chord of d1 ends; any c gives a lower bound. See docs/decisions.md, CLIP.
CLIP = 1.0
CHORD_SLOPE = math.tanh(CLIP / 2) / CLIP

SINGLE = float(np.finfo(np.float32).eps)
LARGEST_SINGLE = float(np.finfo(np.float32).max)

# Rounding errors in single precision of the distance to a cell, in units of its length: numbers of up to 512
# lengths are rounded three times, and the factor of ten beyond that is without effect on the bounds.
CELL_ROUNDING = 10 * 3 * 2 * N_CELLS * SINGLE


@dataclass(frozen=True, slots=True, eq=False)
class LowerBounds:
    """The coordinates of a table of signatures that lower bounds of distances are computed from.

    mean: (L,) float64, mean of the whitened log-signatures, which is subtracted from each.
    axes: (L, D) float64, orthonormal columns: the principal directions, or the unit vectors of the selected
        values.
    """

    euclidean: bool
    mean: FloatArray
    axes: FloatArray
    blocks: Blocks

    @classmethod
    def of(cls, distance: str, gallery: FloatArray, n_leading: int | None = None) -> LowerBounds:
        """The bounds of a distance for a table of whitened log-signatures.

        gallery: (N, L) float64, whitened log-signatures, at least one.
        """
        mean = gallery.mean(axis=0)
        scatter = scatter_matrix(gallery, mean)
        if distance == "d1":
            order = np.argsort(-np.diag(scatter), kind="stable")[: n_leading or N_LEADING_D1]
            axes = np.eye(gallery.shape[1])[:, order]  # (L, D)
        else:
            _, directions = np.linalg.eigh(scatter)  # variances ascend
            axes = np.ascontiguousarray(directions[:, ::-1][:, : n_leading or N_LEADING])
        coordinates = partial(_coordinates, gallery, mean, axes)
        leading = np.empty((min(N_DIVIDING, axes.shape[1]), len(gallery)), np.float32)
        rows = np.arange(len(gallery), dtype=np.int32)
        with np.errstate(over="ignore"):
            for start in range(0, len(rows), CHUNK):
                chunk = slice(start, start + CHUNK)
                leading[:, chunk] = _coordinates(gallery, mean, axes[:, : len(leading)], chunk).T
        return cls(
            distance != "d1", mean, axes, Blocks.of(leading, coordinates, rows, cubic=distance == "d1")
        )

    def renumbered(self, numbers: Rows) -> LowerBounds:
        """The bounds after rows of the table were moved or removed.

        numbers: (N,) int32, as in `Blocks.renumbered`.
        """
        return replace(self, blocks=self.blocks.renumbered(numbers))

    def extended(self, gallery: FloatArray, rows: Rows) -> LowerBounds:
        """The bounds with further rows, as in `Blocks.extended`.

        gallery: (N, L) float64, all whitened log-signatures.
        rows: (n,) int32, those that have no bounds.
        """
        coordinates = partial(_coordinates, gallery, self.mean, self.axes)
        return replace(self, blocks=self.blocks.extended(coordinates, rows, cubic=not self.euclidean))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the bounds, by name: the input of `from_arrays`."""
        return {"mean": self.mean, "axes": self.axes} | self.blocks.to_arrays()

    @classmethod
    def from_arrays(cls, distance: str, arrays: Mapping[str, NDArray[Any]]) -> LowerBounds:
        """The bounds of a distance as in `of`, from the arrays of `to_arrays`."""
        return cls(distance != "d1", arrays["mean"], arrays["axes"], Blocks.from_arrays(arrays))

    def fits(self, gallery: FloatArray) -> bool:
        """Whether the arrays have the shapes of the bounds of a table (N, L)."""
        blocks, n_axes = self.blocks, self.axes.shape[1]
        n_blocks, size = blocks.rows.shape
        return (
            (blocks.n_rows, len(self.mean)) == gallery.shape
            and self.axes.shape[0] == len(self.mean)
            and blocks.low.shape == blocks.high.shape == blocks.step.shape == (n_blocks, n_axes)
            and blocks.codes.shape == (n_blocks, n_axes, size)
        )

    def query(self, point: FloatArray) -> FloatArray:
        """(D,) coordinates of a point (L,) along the axes."""
        coordinates: FloatArray = (point - self.mean) @ self.axes
        return coordinates

    def to_blocks(self, query: FloatArray) -> FloatArray:
        """Values that increase with the lower bounds of the distances from a query to whole blocks.

        query: (D,) float64, the result of `query`.
        Returns (B,) float64: to be compared with `limit`; zero where a number is too large for a bound.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            gaps = self.blocks.gaps(query)
            terms = gaps**2 if self.euclidean else np.minimum(gaps, CLIP)
        bounds: FloatArray = terms.sum(axis=1)
        bounds[np.isnan(bounds)] = 0
        return bounds

    def to_rows(
        self, query: FloatArray, chosen: NDArray[np.intp], limit: float, scan: Callable[..., int]
    ) -> tuple[Rows, NDArray[np.float32]]:
        """The rows in some blocks whose lower bound is at most a limit.

        query: (D,) float64, the result of `query`.
        chosen: (b,) intp, the blocks.
        Returns rows : (n,) int32: the rows.
        Returns bounds : (n,) float32: values that increase with the lower bounds of their distances.
        """
        blocks = self.blocks
        rows = np.empty(len(chosen) * blocks.rows.shape[1], np.int32)
        bounds = np.empty(len(rows), np.float32)
        n = scan(
            blocks.codes,
            blocks.rows,
            blocks.low,
            blocks.high,
            blocks.step,
            chosen,
            query,
            0.5 + CELL_ROUNDING,
            0.0 if self.euclidean else CLIP,
            np.float32(limit),
            rows,
            bounds,
        )
        return rows[:n], bounds[:n]

    def limit(self, radius: float) -> float:
        """The largest value of `to_blocks` or `to_rows` that a signature within a radius can have."""
        limit = (radius * radius if self.euclidean else radius / CHORD_SLOPE) * self._rounding
        return limit if limit < LARGEST_SINGLE else math.inf

    @property
    def _rounding(self) -> float:
        """The factor that allows for rounding errors of D terms and of their partial sums."""
        return 1 + 4 * (int(self.axes.shape[1]) + 8) * SINGLE


def _coordinates(gallery: FloatArray, mean: FloatArray, axes: FloatArray, rows: Rows | slice) -> FloatArray:
    """(n, D) coordinates of some rows along the axes."""
    along: FloatArray = (gallery[rows] - mean) @ axes
    return along
