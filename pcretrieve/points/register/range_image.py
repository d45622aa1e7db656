"""Range images of views: which points a sensor measured, and which space it observed as empty."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray

# Edge of a pixel, in median distances of neighbouring rays, so that most pixels
# inside the silhouette contain a point.
PIXEL = 2.0

# Largest number of pixels along a side.
LARGEST_SIDE = 512

# Number of rays that are sampled for the median distance.
SAMPLE = 2000

# Smallest cosine of the angle between the normals of corresponding points: 60 degrees.
LEAST_COSINE = 0.5


class Comparison(NamedTuple):
    """The comparison of points with a range image. A point that is occluded is in neither mask.

    agrees: (..., n) bool, points on the measured surface, with a similar normal.
    contradicts: (..., n) bool, points in space that the sensor observed as empty: between the sensor and the
        measured surface.
    """

    agrees: NDArray[np.bool_]
    contradicts: NDArray[np.bool_]


class RangeImage:
    """The central projection of points onto an image plane of their sensor.

    points, normals: (n, 3) float64, coordinates, and unit normals that point towards the sensor.
    sensor: (3,) float64, position of the sensor; unit of the points.
    """

    def __init__(self, points: FloatArray, normals: FloatArray, sensor: FloatArray) -> None:
        from scipy.spatial import cKDTree

        self._points, self._normals, self._sensor = points, normals, sensor
        ahead = points.mean(axis=0) - sensor
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, np.eye(3)[np.abs(ahead).argmin()])
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)  # (3, 3)
        rays, depth = self._project(points)
        ahead_of_it = depth > 0
        some = rays[ahead_of_it][:: max(1, len(rays) // SAMPLE)]
        spacing = np.asarray(cKDTree(rays[ahead_of_it]).query(some, k=2)[0])[:, 1]
        self._low = rays[ahead_of_it].min(axis=0)
        extent = float(np.ptp(rays[ahead_of_it], axis=0).max())
        self._pixel = max(PIXEL * float(np.median(spacing)), extent / LARGEST_SIDE)
        # A border of empty pixels, to which all points outside the image are mapped.
        self._shape = np.floor(np.ptp(rays[ahead_of_it], axis=0) / self._pixel).astype(np.int64) + 3
        pixel = self._pixels(rays, depth)
        order = np.argsort(-depth, kind="stable")  # the nearest point in a pixel is written last
        self._nearest = np.full(self._shape.prod(), -1)
        self._nearest[pixel[order]] = order
        self._nearest.reshape(self._shape)[[0, -1], :] = -1
        self._nearest.reshape(self._shape)[:, [0, -1]] = -1
        self._front = self._front_of_neighbors(depth)

    def _project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., 2) image coordinates, and (...) distances to the sensor; negative behind the sensor."""
        seen = (points - self._sensor) @ self._axes  # (..., 3)
        ahead = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        depth = np.linalg.norm(seen, axis=-1)
        return seen[..., :2] / ahead[..., None], np.where(seen[..., 2] > 0, depth, -1.0)

    def _pixels(self, rays: FloatArray, depth: FloatArray) -> NDArray[np.int64]:
        """(...) number of the pixel of each ray; 0, an empty pixel, outside the image."""
        index = np.nan_to_num((rays - self._low) / self._pixel, nan=-1.0)
        index = np.clip(np.floor(index), -1, self._shape - 2).astype(np.int64) + 1  # (..., 2)
        return np.where(depth > 0, index[..., 0] * self._shape[1] + index[..., 1], 0)

    def _front_of_neighbors(self, depth: FloatArray) -> FloatArray:
        """(pixels,) smallest depth in each pixel and its eight neighbours."""
        from scipy import ndimage

        # The minimum, so that points of an inclined surface, or at a depth edge, do not contradict the image.

        nearest = np.where(self._nearest >= 0, depth[self._nearest], np.inf).reshape(self._shape)
        return np.asarray(ndimage.minimum_filter(nearest, size=3, mode="nearest")).ravel()

    def compare(self, points: FloatArray, normals: FloatArray, *, tolerance: float) -> Comparison:
        """Compare points with the image.

        points, normals: (..., n, 3) float64, coordinates and unit normals, in the frame of the view.
        tolerance: largest distance of a point that agrees from the tangent plane of the measured point, and
            smallest distance of a point that contradicts in front of the measured points around its ray; unit
            of the points.
        """
        rays, depth = self._project(points)
        pixel = self._pixels(rays, depth)
        nearest = self._nearest[pixel]
        there = nearest >= 0
        offset = points - self._points[nearest]
        facing = self._normals[nearest]
        on_plane = np.abs(np.einsum("...j,...j->...", offset, facing)) < tolerance
        near = np.linalg.norm(offset, axis=-1) < tolerance + 2 * self._pixel * depth
        alike = np.einsum("...j,...j->...", normals, facing) > LEAST_COSINE
        in_front = depth < self._front[pixel] - tolerance
        return Comparison(there & on_plane & near & alike, there & in_front)
