"""The plane on which a body stands, found among the points of a scan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.points.neighbors import PLANE_NEIGHBORS, neighborhoods, noise
from pcretrieve.values import FloatArray, bounding_diagonal

# Number of points by which planes are compared, and from which the three points of each plane are chosen;
# number of planes; number of neighbours of the first point among which the second and the third are.
COMPARED = 2000
N_PLANES = 400
N_NEAR = 100

# Largest distance of a point from the plane to which it belongs: relative to the diagonal, and in units of
# the noise, whichever is larger. Points are removed to a smaller distance, in units of the median of these
# distances, which leaves more of the soles; at least the last, relative to the diagonal.
THICKNESS = 0.003
THICKNESS_OF_NOISE = 4.0
REMOVED = 7.5
LEAST_REMOVED = 0.0005

# Smallest fraction of all points on the ground and on the body, and largest fraction beneath the ground.
LEAST_SHARE = 0.05
MOST_BENEATH = 0.02

# A body stands on a plane, if its lowest points, up to a quantile, are at most this high above the plane;
# relative to the diagonal.
LOWEST = 0.02
STANDING = 0.05

# The ground must be seen around the body: farther from its middle than the quantile of its points, times the
# factor, in most of the sectors. The soles of a closed body are not: they end where its sides begin.
N_SECTORS = 8
N_AROUND = 6
OUTLINE = 0.99
BEYOND = 1.05
FEWEST_BEYOND = 3


class Ground(NamedTuple):
    """A plane on which a body stands.

    place: (3,) float64, the point of the plane beneath the body; unit of the file.
    up: (3,) float64, unit normal of the plane on the side of the body.
    points: (n,) bool, the points on the plane, and beneath it.
    """

    place: FloatArray
    up: FloatArray
    points: NDArray[np.bool_]


def ground_of(points: FloatArray, viewpoints: FloatArray | None = None) -> Ground | None:
    """Find the largest plane beneath a body, by random sample consensus (RANSAC [1]_).

    All other points must be on one side of the plane, with the sensors; the lowest of them near the plane;
    and points of the plane must surround them.

    References
    ----------
    .. [1] M. A. Fischler and R. C. Bolles, "Random sample consensus", Communications of the ACM 24 (1981).
    """
    rng = np.random.default_rng(0)
    some = np.sort(rng.permutation(len(points))[:COMPARED])
    few = points[some]
    middle = few.mean(axis=0)
    diagonal = bounding_diagonal(few)
    if not diagonal:
        return None
    close = neighborhoods(points, PLANE_NEIGHBORS + 1, of_some=True)
    thickness = max(THICKNESS * diagonal, THICKNESS_OF_NOISE * noise(points, close))
    normals, offsets = _planes(few - middle, rng)
    heights = normals @ (few - middle).T - offsets[:, None]  # (planes, s)
    on = (abs(heights) <= thickness).mean(axis=1)
    above = (heights > thickness).mean(axis=1)
    # Three collinear points have no plane: all points are on it, and none are on the body.
    possible = (np.minimum(above, 1 - on - above) <= MOST_BENEATH) & (on <= 1 - LEAST_SHARE)
    best = int(np.where(possible, on, 0).argmax())
    if not (possible[best] and on[best] >= LEAST_SHARE):
        return None
    up = normals[best] if above[best] > 0.5 * (1 - on[best]) else -normals[best]
    up, height = fitted_plane(points, few[abs(heights[best]) <= thickness], up, thickness)
    on_plane = abs(height) <= thickness
    body = height > 2 * thickness
    if not (on_plane.mean() >= LEAST_SHARE and body.mean() >= LEAST_SHARE):
        return None
    stands = np.quantile(height[body], LOWEST) <= STANDING * diagonal
    is_seen = viewpoints is None or ((viewpoints - points) @ up + height > 0)[on_plane].mean() > 0.5
    is_beneath = (height < -thickness).mean() <= MOST_BENEATH
    if not (
        stands
        and is_seen
        and is_beneath
        and _is_around(points[some], up, on_plane[some], body[some])
    ):
        return None
    removed = np.clip(
        REMOVED * np.median(abs(height[on_plane])), LEAST_REMOVED * diagonal, thickness
    )
    centre = np.median(points[body], axis=0)
    place = centre - (height[body][0] + (centre - points[body][0]) @ up) * up
    return Ground(place, up, height <= removed)


def _planes(points: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Unit normals (p, 3) and offsets (p,) of planes through three random points that are near each other.

    The normal is zero if the three points are collinear.
    """
    from scipy.spatial import cKDTree

    first = rng.integers(len(points), size=N_PLANES)
    k = min(N_NEAR, len(points))
    near = np.asarray(cKDTree(points).query(points[first], k=k)[1])  # (p, k)
    second, third = near[np.arange(N_PLANES), rng.integers(k, size=(2, N_PLANES))]
    a, b, c = points[first], points[second], points[third]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(length > 0, length, 1)
    return normals, np.einsum("ij,ij->i", normals, a)


def fitted_plane(
    points: FloatArray, inliers: FloatArray, up: FloatArray, thickness: float
) -> tuple[FloatArray, FloatArray]:
    """The least-squares plane of its inliers, which are selected again in each of three steps.

    inliers: (k, 3) float64, the inliers of the first step, at least three.
    up: (3,) float64, a vector on the side of the plane to which its normal shall point.
    thickness: largest distance of an inlier from the plane.
    Returns normal, heights: (3,) unit normal, and (n,) signed distances of all points from the plane.
    """
    height = np.zeros(len(points))
    for _ in range(3):
        centre = inliers.mean(axis=0)
        _, _, axes = np.linalg.svd(inliers - centre, full_matrices=False)
        up = axes[2] if axes[2] @ up > 0 else -axes[2]
        height = (points - centre) @ up
        inliers = points[abs(height) <= thickness]
    return up, height


def _is_around(
    points: FloatArray, up: FloatArray, ground: NDArray[np.bool_], body: NDArray[np.bool_]
) -> bool:
    """Whether the ground is seen beyond the outline of the body, in most directions."""
    right = np.cross(up, np.eye(3)[abs(up).argmin()])
    right /= np.linalg.norm(right)
    flat = points @ np.column_stack([right, np.cross(up, right)])  # (s, 2)
    flat = flat - np.median(flat[body], axis=0)
    radius = np.linalg.norm(flat, axis=1)
    sector = (
        np.floor((np.arctan2(flat[:, 1], flat[:, 0]) / (2 * np.pi) + 0.5) * N_SECTORS) % N_SECTORS
    )
    n_around = 0
    for number in range(N_SECTORS):
        here = sector == number
        outline = np.quantile(radius[body & here], OUTLINE) if (body & here).any() else 0.0
        n_around += int((radius[ground & here] > BEYOND * outline).sum() >= FEWEST_BEYOND)
    return n_around >= N_AROUND
