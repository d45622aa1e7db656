"""Organised clouds: a grid of readings, as the sensor made them → points with normals.

The neighbours of a reading on its surface are those beside it on the grid, as far as they are near it in
space too: where the range jumps, neighbours on the grid belong to different surfaces.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import ScanReadError
from pcretrieve.formats.raw import RawScan

__all__ = ["organised_scan"]

# Half the edge of the window of neighbours, in readings: 24 neighbours.
REACH = 2
# Distance up to which a neighbour on the grid is on the same surface, relative to the distance on a surface
# that faces the sensor: that of a surface which is turned away by 80 degrees.
MOST_APART = 6.0
# Fewest neighbours that make a plane.
FEWEST_NEIGHBORS = 3
# Readings whose neighbours are in memory at a time, each with about 300 bytes.
MOST_AT_ONCE = 1 << 18


def organised_scan(grid: FloatArray, measured: NDArray[np.bool_], sensor: FloatArray) -> RawScan:
    """Make a cloud of a grid of readings.

    Parameters
    ----------
    grid : (h, w, 3) float64
        The points; in the frame and the unit of the file.
    measured : (h, w) bool
        Readings that are answers. All others are dropped.
    sensor : (3,) float64
        Position of the sensor.

    Returns
    -------
    RawScan
        The points with normals towards the sensor, and its position. Readings without three neighbours on
        the same surface, which lie between a body and its background, are dropped. Notes say how many.

    Raises
    ------
    ScanReadError
        If no reading is left.
    """
    n_readings, n_measured = measured.size, int(measured.sum())
    if not n_measured:
        raise ScanReadError(f"none of its {n_readings} readings is an answer")
    spacing = _spacing(grid, measured, sensor)  # (h, w)
    band = max(1, MOST_AT_ONCE // grid.shape[1])
    starts = range(0, len(grid), band)
    normals = np.concatenate(
        [_normals(grid, measured, spacing, slice(start, start + band)) for start in starts]
    )  # (h, w, 3)
    kept = normals.any(axis=2)  # (h, w)
    if not kept.any():
        raise ScanReadError(f"none of its {n_measured} readings has three neighbours on the same surface")
    points, normals = grid[kept], normals[kept]
    away = np.einsum("ij,ij->i", normals, sensor - points) < 0
    normals[away] *= -1
    notes = []
    if n_measured < n_readings:
        notes.append(f"dropped {n_readings - n_measured} of {n_readings} readings without an answer")
    if len(points) < n_measured:
        notes.append(
            f"dropped {n_measured - len(points)} of {n_measured} points without three neighbours on a surface"
        )
    return RawScan(points, None, normals, sensor, tuple(notes))


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


def _normals(grid: FloatArray, measured: NDArray[np.bool_], spacing: FloatArray, band: slice) -> FloatArray:
    """(b, w, 3) unit normals of a band of rows, by the covariance of neighbours; zero where there are few."""
    start, stop, _ = band.indices(len(grid))
    center, here = grid[start:stop], measured[start:stop]  # (b, w, 3), (b, w)
    count = np.zeros(here.shape)
    total = np.zeros(center.shape)
    products = np.zeros((*here.shape, 3, 3))
    height, width = measured.shape
    reach = range(-REACH, REACH + 1)
    for down, right in itertools.product(reach, reach):
        if not (down or right):
            continue
        top, bottom = max(start, -down), min(stop, height - down)
        left, end = max(0, -right), min(width, width - right)
        if top >= bottom or left >= end:
            continue
        inner = slice(top - start, bottom - start), slice(left, end)
        outer = slice(top + down, bottom + down), slice(left + right, end + right)
        apart = grid[outer] - center[inner]  # (b', w', 3)
        most = MOST_APART * np.hypot(down, right) * spacing[start:stop][inner]
        near = here[inner] & measured[outer] & (np.einsum("ijk,ijk->ij", apart, apart) <= most**2)
        apart = np.where(near[..., None], apart, 0)
        count[inner] += near
        total[inner] += apart
        products[inner] += apart[..., :, None] * apart[..., None, :]
    enough = here & (count >= FEWEST_NEIGHBORS)
    normals = np.zeros(center.shape)
    n = count[enough][:, None, None] + 1  # with the reading itself, which is at zero
    mean = total[enough][:, :, None] / n
    _, axes = np.linalg.eigh(products[enough] / n - mean * mean.transpose(0, 2, 1))
    normals[enough] = axes[:, :, 0]
    return normals
