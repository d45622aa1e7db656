"""Distances on a grid of voxels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.points.voxels.grid import Mask, Voxels

__all__ = ["distances"]

# The squared distance of a voxel that no source has reached yet; in voxels².
FAR = np.float32(1e18)

Row = NDArray[np.float32]


@njit(cache=True)
def distances(sources: Mask, limit: float) -> Voxels:
    """The Euclidean distance of each voxel to the nearest source voxel, axis by axis [1]_.

    Distances along the second axis are exact squares, and each further axis takes the minimum over the
    neighbours on its lines. All loops are over lines of the last axis, which are contiguous, so that they
    compute eight voxels at once; lines that are beyond the limit are skipped.

    sources: (a, b, c) bool, the source voxels.
    Returns (a, b, c) float32: distances, at most `limit`; in voxels. `limit` everywhere if there are no
        sources.

    References
    ----------
    .. [1] T. Saito and J.-I. Toriwaki, "New algorithms for Euclidean distance transformation of an
       n-dimensional digitized picture with applications", Pattern Recognition 27 (1994).
    """
    n_x, n_y, n_z = sources.shape
    reach = int(min(limit, max(n_x, n_y, n_z))) + 1
    squares, largest, is_near = _squares_along_y(sources, min(limit * limit, FAR))
    result = np.full(sources.shape, limit, dtype=np.float32)
    line = np.empty(n_z, dtype=np.float32)
    for x in range(n_x):
        for y in range(n_y):
            line[:] = squares[x, y]
            is_reached = is_near[x, y]
            k = 1
            # A square that is less than k² cannot become smaller by a neighbour k voxels away.
            while k <= reach and k * k < largest[x, y]:
                if x >= k and is_near[x - k, y]:
                    _lower(line, squares[x - k, y], k)
                    is_reached = True
                if x + k < n_x and is_near[x + k, y]:
                    _lower(line, squares[x + k, y], k)
                    is_reached = True
                k += 1
            if not is_reached:
                continue
            best = result[x, y]
            best[:] = line
            deepest = line.max()
            k = 1
            while k <= reach and k < n_z and k * k < deepest:
                _lower(best[: n_z - k], line[k:], k)
                _lower(best[k:], line[: n_z - k], k)
                k += 1
            for z in range(n_z):
                best[z] = min(np.sqrt(best[z]), np.float32(limit))
    return result


@njit(cache=True)
def _squares_along_y(sources: Mask, most: float) -> tuple[Voxels, Voxels, Mask]:
    """Squared distances along the second axis; of each line, the largest, and whether any is below `most`."""
    n_x, n_y, n_z = sources.shape
    squares = np.empty(sources.shape, dtype=np.float32)
    largest = np.empty((n_x, n_y), dtype=np.float32)
    is_near = np.empty((n_x, n_y), dtype=np.bool_)
    for x in range(n_x):
        for y in range(n_y):
            line, here = squares[x, y], sources[x, y]
            before = squares[x, max(0, y - 1)]
            for z in range(n_z):
                step = before[z] + np.float32(1) if y else FAR
                line[z] = np.float32(0) if here[z] else step
        for y in range(n_y - 2, -1, -1):
            line, after = squares[x, y], squares[x, y + 1]
            for z in range(n_z):
                line[z] = min(line[z], after[z] + np.float32(1))
        for y in range(n_y):
            line = squares[x, y]
            for z in range(n_z):
                line[z] = min(line[z] * line[z], FAR)
            largest[x, y] = line.max()
            is_near[x, y] = line.min() < most
    return squares, largest, is_near


@njit(cache=True)
def _lower(line: Row, other: Row, k: int) -> None:
    """Lower the squares of a line to those of another line, k voxels away, plus k²."""
    square = np.float32(k * k)
    for z in range(len(line)):
        line[z] = min(line[z], other[z] + square)
