"""What one sensor saw, as a picture of depths: where its surface is, and which space it saw through."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.types import FloatArray

__all__ = ["Comparison", "RangeImage"]

# Pixels per median distance of neighbouring rays: most pixels inside the silhouette then hold a point.
PIXEL = 2.0

# Pixels on a side, at most.
LARGEST_SIDE = 512

# Rays whose distances tell that of all.
SAMPLE = 2000

# Cosine of the angle between two normals beyond which points are not of one surface: 60 degrees.
LEAST_COSINE = 0.5


class Comparison(NamedTuple):
    """What a sensor says of points: each is on its surface, in front of it, or neither.

    Attributes
    ----------
    agrees : (..., n) bool
        On the surface that the sensor saw, facing the same way.
    contradicts : (..., n) bool
        In space that the sensor saw through.
    """

    agrees: NDArray[np.bool_]
    contradicts: NDArray[np.bool_]


class RangeImage:
    """A central projection of points onto the pixels of their sensor.

    Parameters
    ----------
    points, normals : (n, 3) float64
        Normals have unit length and face the sensor.
    sensor : (3,) float64
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
        # A frame of empty pixels, which all points beside the picture are sent to.
        self._shape = np.floor(np.ptp(rays[ahead_of_it], axis=0) / self._pixel).astype(np.int64) + 3
        pixel = self._pixels(rays, depth)
        order = np.argsort(-depth, kind="stable")  # the nearest point of a pixel is written last
        self._nearest = np.full(self._shape.prod(), -1)
        self._nearest[pixel[order]] = order
        self._nearest.reshape(self._shape)[[0, -1], :] = -1
        self._nearest.reshape(self._shape)[:, [0, -1]] = -1
        self._front = self._front_of_neighbors(depth)

    def _project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., 2) tangents of the rays, and (...) distances to the sensor; negative behind it."""
        seen = (points - self._sensor) @ self._axes  # (..., 3)
        ahead = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        depth = np.linalg.norm(seen, axis=-1)
        return seen[..., :2] / ahead[..., None], np.where(seen[..., 2] > 0, depth, -1.0)

    def _pixels(self, rays: FloatArray, depth: FloatArray) -> NDArray[np.int64]:
        """(...) number of the pixel that each ray meets; 0, an empty one, where it meets none."""
        index = np.nan_to_num((rays - self._low) / self._pixel, nan=-1.0)
        index = np.clip(np.floor(index), -1, self._shape - 2).astype(np.int64) + 1  # (..., 2)
        return np.where(depth > 0, index[..., 0] * self._shape[1] + index[..., 1], 0)

    def _front_of_neighbors(self, depth: FloatArray) -> FloatArray:
        """(pixels,) least depth in each pixel and the eight around it.

        A slanted surface, or an edge that a pixel straddles, is then contradicted by nothing.
        """
        from scipy import ndimage

        nearest = np.where(self._nearest >= 0, depth[self._nearest], np.inf).reshape(self._shape)
        return np.asarray(ndimage.minimum_filter(nearest, size=3, mode="nearest")).ravel()

    def compare(self, points: FloatArray, normals: FloatArray, *, tolerance: float) -> Comparison:
        """Points in the frame of this view, (..., n, 3), against what was seen.

        Parameters
        ----------
        tolerance : float
            Distance to the plane of the point seen within which a point agrees, and in front of everything
            seen near its ray beyond which it contradicts; unit of the points.
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
