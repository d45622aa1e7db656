"""Silhouette, as a black and white picture → planar triangle mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from pcretrieve.adapters.scikit_image import contours
from pcretrieve.errors import BenchmarkError
from pcretrieve.points.voxels import Mask
from pcretrieve.surface.topology import compact
from pcretrieve.values import FloatArray, IntArray, TriangleMesh

__all__ = ["planar_mesh", "read_silhouette"]

# Standard deviation of the Gaussian filter that smooths the staircase of the pixels, relative to the square
# root of the area; the smallest in pixels. The outline is where the filtered picture is 1/2.
SMOOTHING = 0.01
LEAST_SMOOTHING = 0.7

# Distances of points of the lattice from the outline, relative to the edge of the triangles: the smallest,
# with which every step of the outline is an edge of the triangulation, and the largest outside the shape.
# Without points outside, the circumscribed circles of flat triangles along the outline would be empty.
CLEARANCE = 0.6
BAND = 2.0

# Smallest area of a triangle, relative to the square of the edge.
LEAST_AREA = 1e-3


def read_silhouette(path: Path) -> FloatArray:
    """Read a silhouette.

    Parameters
    ----------
    path : Path
        A picture of two brightnesses; the shape is the bright part.

    Returns
    -------
    (h, w) float64
        1 in the shape and 0 outside.

    Raises
    ------
    BenchmarkError
        If the file cannot be read, or shows one brightness only.
    """
    try:
        with Image.open(path) as picture:
            values = np.asarray(picture.convert("L"), dtype=np.float64)
    except (OSError, SyntaxError) as error:
        raise BenchmarkError(f"{path} must be a picture: {error}") from error
    if np.ptp(values) == 0:
        raise BenchmarkError(f"{path} must show a silhouette, got pixels of one brightness")
    return np.asarray(values > (values.min() + values.max()) / 2, dtype=np.float64)


def planar_mesh(silhouette: FloatArray, n_vertices: int = 6000) -> TriangleMesh:
    """Triangulate a silhouette.

    The outline is sampled at equal steps, and the rest by a lattice of equilateral triangles of the same
    edge. The mesh has the triangles of the Delaunay triangulation of all these points that lie inside. Only
    the largest component of the shape is kept; its holes stay.

    Parameters
    ----------
    silhouette : (h, w) float64
        1 in the shape and 0 outside.
    n_vertices : int, default 6000
        Number of vertices of a shape whose outline is short; thin shapes have more.

    Returns
    -------
    TriangleMesh
        In the plane z = 0, with a boundary, oriented to +z; unit: pixel.

    Raises
    ------
    BenchmarkError
        If the shape has no interior.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates
    from scipy.spatial import Delaunay, KDTree

    area = float(silhouette.sum())
    blur = max(LEAST_SMOOTHING, SMOOTHING * area**0.5)
    smooth = gaussian_filter(np.pad(silhouette, int(np.ceil(4 * blur)) + 1), blur)
    # The area for each vertex of a lattice of equilateral triangles is √3/2 of the square of an edge.
    edge = (area / (n_vertices * 3**0.5 / 2)) ** 0.5
    outline = np.concatenate([np.empty((0, 2)), *(_resampled(c, edge) for c in contours(smooth, 0.5))])
    if not len(outline):
        raise BenchmarkError("a silhouette must have an interior, the smoothed picture has none")
    lattice = _lattice(smooth.shape, edge)
    distance = KDTree(outline).query(lattice)[0] / edge
    is_inside = map_coordinates(smooth, lattice.T, order=1) > 0.5
    lattice = lattice[(distance > CLEARANCE) & (is_inside | (distance < BAND))]
    points = np.concatenate([outline, lattice])  # (n, 2), row and column of the picture
    triangles = Delaunay(points)
    corners = points[triangles.simplices]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2  # positive for normals along +z
    kept = map_coordinates(smooth, corners.mean(axis=1).T, order=1) > 0.5
    kept &= np.abs(areas) > LEAST_AREA * edge**2
    kept = _largest_component(triangles.neighbors, kept, np.abs(areas))
    faces = np.where(areas[:, None] < 0, triangles.simplices[:, ::-1], triangles.simplices)[kept]
    return compact(np.column_stack([points[:, 1], -points[:, 0], np.zeros(len(points))]), faces)


def _largest_component(neighbors: IntArray, kept: Mask, areas: FloatArray) -> Mask:
    """Of the kept triangles, the largest component by area; triangles with a common edge are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    here, side = np.nonzero(kept[:, None] & (neighbors >= 0) & kept[neighbors])
    links = coo_array((np.ones(len(here)), (here, neighbors[here, side])), shape=2 * (len(kept),))
    _, component = connected_components(links, directed=False)
    largest = np.bincount(component[kept], weights=areas[kept]).argmax()
    return np.asarray(kept & (component == largest))


def _resampled(contour: FloatArray, step: float) -> FloatArray:
    """Points of a closed polygon at equal steps along it; none if it is shorter than three steps."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(contour, axis=0), axis=1))])
    n = round(along[-1] / step)
    if n < 3:
        return np.empty((0, 2))
    at = np.arange(n) * along[-1] / n
    return np.column_stack([np.interp(at, along, contour[:, axis]) for axis in (0, 1)])


def _lattice(shape: tuple[int, ...], edge: float) -> FloatArray:
    """(n, 2) points of a lattice of equilateral triangles that covers a picture."""
    height = edge * 3**0.5 / 2
    rows, columns = np.meshgrid(
        np.arange(0, shape[0] - 1, height), np.arange(0, shape[1] - 1 - edge / 2, edge), indexing="ij"
    )
    columns[1::2] += edge / 2
    return np.column_stack([rows.ravel(), columns.ravel()])
