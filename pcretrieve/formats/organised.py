"""Organised clouds: a grid of readings, as the sensor made them → points with normals.

The neighbours of a reading on its surface are those beside it on the grid, as far as they are near it in
space too: where the range jumps, neighbours on the grid belong to different surfaces.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import RawScan
from pcretrieve.values import FloatArray

# Half the edge of the window of neighbours, in readings: 24 neighbours.
REACH = 2
# Distance up to which a neighbour on the grid is on the same surface, relative to the distance on a surface
# that faces the sensor: that of a surface which is turned away by 80 degrees.
MOST_APART = 6.0
# Fewest neighbours that make a plane.
FEWEST_NEIGHBORS = 3
# Readings whose sums are in memory at a time, few enough for the cache of a processor.
MOST_AT_ONCE = 1 << 14
# Elements of a symmetric matrix.
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def organised_scan(grid: FloatArray, measured: NDArray[np.bool_], sensor: FloatArray) -> RawScan:
    """A cloud of a grid (h, w, 3) of readings, of those that were measured; `sensor` (3,) is its position."""
    n_readings, n_measured = measured.size, int(measured.sum())
    if not n_measured:
        raise ScanReadError(f"none of its {n_readings} readings is an answer")
    rows, columns = _span(measured, axis=1), _span(measured, axis=0)
    grid, measured = grid[rows, columns], measured[rows, columns]
    spacing = _spacing(grid, measured, sensor)  # (h, w)
    band = max(1, MOST_AT_ONCE // grid.shape[1])
    starts = range(0, len(grid), band)
    normals = np.concatenate(
        [_normals(grid, measured, spacing, slice(start, start + band)) for start in starts]
    )  # (h, w, 3)
    kept = normals.any(axis=2)  # (h, w)
    if not kept.any():
        raise ScanReadError(
            f"none of its {n_measured} readings has three neighbours on the same surface"
        )
    points, normals = grid[kept], normals[kept]
    away = np.einsum("ij,ij->i", normals, sensor - points) < 0
    normals[away] *= -1
    notes = []
    if n_measured < n_readings:
        notes.append(
            f"dropped {n_readings - n_measured} of {n_readings} readings without an answer"
        )
    if len(points) < n_measured:
        notes.append(
            f"dropped {n_measured - len(points)} of {n_measured} points without three neighbours on a surface"
        )
    return RawScan(points, None, normals, sensor, tuple(notes))


def _span(measured: NDArray[np.bool_], axis: int) -> slice:
    """The rows, or columns, from the first with an answer to the last."""
    hit = np.flatnonzero(measured.any(axis=axis))
    return slice(int(hit[0]), int(hit[-1]) + 1)


def _spacing(grid: FloatArray, measured: NDArray[np.bool_], sensor: FloatArray) -> FloatArray:
    """(h, w) distance of readings beside each other on a surface that faces the sensor; grows with range."""
    distance = np.linalg.norm(grid - sensor, axis=2)  # (h, w)
    angles = []
    for axis in (0, 1):
        first, second = _shifted(measured, axis)
        both = first & second
        (a, b), (near, _) = _shifted(grid, axis), _shifted(distance, axis)
        angles.append(
            np.linalg.norm(a[both] - b[both], axis=1) / np.maximum(near[both], np.finfo(float).tiny)
        )
    steps = np.concatenate(angles)
    return np.asarray(distance * (np.median(steps) if len(steps) else 0.0))


def _shifted(array: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """The rows, or columns, of a grid without the last, and without the first."""
    return (array[:-1], array[1:]) if axis == 0 else (array[:, :-1], array[:, 1:])


def _normals(
    grid: FloatArray, measured: NDArray[np.bool_], spacing: FloatArray, band: slice
) -> FloatArray:
    """(b, w, 3) unit normals of a band of rows, by the covariance of neighbours; zero where there are few."""
    here = measured[band]  # (b, w)
    count, totals, products = _sums_of_neighbors(grid, measured, spacing, band)
    # Coordinates of damaged files have no squares.
    enough = here & (count >= FEWEST_NEIGHBORS) & np.isfinite(products).all(axis=0)
    n = count[enough] + 1  # with the reading itself, which is at zero
    means = totals[:, enough] / n  # (3, p)
    covariance = np.empty((len(n), 3, 3))
    for product, (i, j) in zip(products, PAIRS, strict=True):
        covariance[:, i, j] = covariance[:, j, i] = product[enough] / n - means[i] * means[j]
    normals = np.zeros((*here.shape, 3))
    normals[enough] = np.linalg.eigh(covariance)[1][:, :, 0]
    return normals


def _sums_of_neighbors(
    grid: FloatArray, measured: NDArray[np.bool_], spacing: FloatArray, band: slice
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The number (b, w) of neighbours on the same surface, and sums of their places relative to a reading.

    The sums are those of the places (3, b, w), and of their products (6, b, w) in the order of `PAIRS`.
    """
    shape = measured[band].shape
    count, totals = np.zeros(shape), np.zeros((3, *shape))
    products = np.zeros((len(PAIRS), *shape))
    for distance, own, inner, outer in _windows(measured.shape, band):
        apart = [plane[outer] - plane[own] for plane in grid.transpose(2, 0, 1)]  # three (b', w')
        squares = apart[0] * apart[0] + apart[1] * apart[1] + apart[2] * apart[2]
        farthest = MOST_APART * distance * spacing[own]
        near = (squares <= farthest**2) & measured[outer]
        count[inner] += near
        for k in range(3):
            apart[k] = np.where(near, apart[k], 0)
            totals[k][inner] += apart[k]
        for product, (i, j) in zip(products, PAIRS, strict=True):
            product[inner] += apart[i] * apart[j]
    return count, totals, products


Window = tuple[slice, slice]


def _windows(shape: tuple[int, ...], band: slice) -> Iterator[tuple[float, Window, Window, Window]]:
    """For each place of a neighbour, its distance on the grid, and the readings that have such a neighbour.

    These readings as a window of the grid and of the band, and their neighbours as a window of the grid.
    """
    height, width = shape
    start, stop, _ = band.indices(height)
    reach = range(-REACH, REACH + 1)
    for down, right in itertools.product(reach, reach):
        top, bottom = max(start, -down), min(stop, height - down)
        left, end = max(0, -right), min(width, width - right)
        if not (down or right) or top >= bottom or left >= end:
            continue
        own = slice(top, bottom), slice(left, end)
        inner = slice(top - start, bottom - start), slice(left, end)
        outer = slice(top + down, bottom + down), slice(left + right, end + right)
        yield float(np.hypot(down, right)), own, inner, outer
