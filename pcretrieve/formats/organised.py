"""Organised clouds: a grid of readings, as the sensor made them → points with normals.

The neighbours of a reading on its surface are those beside it on the grid, as far as they are near it in
space too: where the range jumps, neighbours on the grid belong to different surfaces.
"""

from __future__ import annotations

import itertools
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


def organised_scan(
    grid: FloatArray, measured: NDArray[np.bool_], sensor: FloatArray
) -> RawScan:
    """A cloud of a grid (h, w, 3) of readings, of those that were measured; `sensor` (3,) is its position."""
    n_readings = measured.size
    n_measured = int(measured.sum())
    if not n_measured:
        raise ScanReadError(f"none of its {n_readings} readings is an answer")
    notes = []
    if n_measured < n_readings:
        notes.append(
            f"dropped {n_readings - n_measured} of {n_readings} readings without an answer"
        )
    if 1 in measured.shape:  # points that are no grid, as other programs write them
        return RawScan(
            grid[measured],
            viewpoints=sensor if sensor.any() else None,
            notes=tuple(notes),
        )
    rows, columns = _span(measured, axis=1), _span(measured, axis=0)
    grid, measured = grid[rows, columns], measured[rows, columns]
    spacing = _spacing(grid, measured, sensor)  # (h, w)
    band = max(1, MOST_AT_ONCE // grid.shape[1])
    planes = np.pad(grid.transpose(2, 0, 1), ((0, 0), (REACH, REACH), (REACH, REACH)))
    answers = np.pad(measured, REACH)
    rows_of = [
        slice(start, start + band + 2 * REACH) for start in range(0, len(grid), band)
    ]
    normals = np.concatenate(
        [
            _normals(
                planes[:, rows], answers[rows], spacing[rows.start : rows.start + band]
            )
            for rows in rows_of
        ]
    )  # (h, w, 3)
    kept = normals.any(axis=2)  # (h, w)
    if not kept.any():
        raise ScanReadError(
            f"none of its {n_measured} readings has three neighbours on the same surface"
        )
    points, normals = grid[kept], normals[kept]
    away = np.einsum("ij,ij->i", normals, sensor - points) < 0
    normals[away] *= -1
    if len(points) < n_measured:
        notes.append(
            f"dropped {n_measured - len(points)} of {n_measured} points without three neighbours on a surface"
        )
    return RawScan(points, None, normals, sensor, tuple(notes))


def _span(measured: NDArray[np.bool_], axis: int) -> slice:
    """The rows, or columns, from the first with an answer to the last."""
    hit = np.flatnonzero(measured.any(axis=axis))
    return slice(int(hit[0]), int(hit[-1]) + 1)


def _spacing(
    grid: FloatArray, measured: NDArray[np.bool_], sensor: FloatArray
) -> FloatArray:
    """(h, w) distance of readings beside each other on a surface that faces the sensor; grows with range."""
    distance = np.linalg.norm(grid - sensor, axis=2)  # (h, w)
    angles = []
    for axis in (0, 1):
        first, second = _shifted(measured, axis)
        both = first & second
        (a, b), (near, _) = _shifted(grid, axis), _shifted(distance, axis)
        angles.append(
            np.linalg.norm(a[both] - b[both], axis=1)
            / np.maximum(near[both], np.finfo(float).tiny)
        )
    steps = np.concatenate(angles)
    return np.asarray(distance * (np.median(steps) if len(steps) else 0.0))


def _shifted(array: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """The rows, or columns, of a grid without the last, and without the first."""
    return (array[:-1], array[1:]) if axis == 0 else (array[:, :-1], array[:, 1:])


def _normals(
    planes: FloatArray, measured: NDArray[np.bool_], spacing: FloatArray
) -> FloatArray:
    """(b, w, 3) unit normals of a band of rows, by the covariance of neighbours; zero where there are few.

    planes, measured, spacing: (3, b + 2 REACH, w + 2 REACH), the coordinates with a margin; the answers with
        the same margin; (b, w).
    """
    height, width = spacing.shape

    def beside(array: NDArray[Any], down: int, right: int) -> NDArray[Any]:
        """What is beside each reading of the band: so many rows down, so many columns to the right."""
        top, left = REACH + down, REACH + right
        return array[..., top : top + height, left : left + width]

    count, totals = np.zeros(spacing.shape), np.zeros((3, *spacing.shape))
    products = np.zeros((3, *totals.shape))
    reach = range(-REACH, REACH + 1)
    for down, right in itertools.product(reach, reach):
        apart = beside(planes, down, right) - beside(planes, 0, 0)
        farthest = MOST_APART * np.hypot(down, right) * spacing
        near = ((apart * apart).sum(axis=0) <= farthest**2) & beside(
            measured, down, right
        )
        count += near  # the reading itself is at zero, and counts too
        apart = np.where(near, apart, 0)
        totals += apart
        products += apart[:, None] * apart
    # Coordinates of damaged files have no squares.
    enough = beside(measured, 0, 0) & (count > FEWEST_NEIGHBORS)
    enough &= np.isfinite(products).all(axis=(0, 1))
    n = count[enough]
    means = totals[:, enough] / n  # (3, p)
    covariance = products[:, :, enough] / n - means[:, None] * means
    normals = np.zeros((height, width, 3))
    normals[enough] = np.linalg.eigh(covariance.transpose(2, 0, 1))[1][:, :, 0]
    return normals
