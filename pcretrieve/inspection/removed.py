"""Which points of a scan the stages removed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcretrieve.options import DEFAULT_STAGES, PipelineOptions
from pcretrieve.pipeline.seen import Seen
from pcretrieve.points import outliers
from pcretrieve.values import FloatArray, PointCloud

__all__ = ["Removed", "median_spacing", "removed_after"]

# Distance to the nearest point that a filter of another package left, beyond which this filter removed a
# point, in median distances between nearest neighbours. A filter may move points that it keeps.
DROPPED = 1.1


class Removed(NamedTuple):
    """The points of a scan that were removed, (n,) bool each.

    cut_away: (n,) bool, points that the stage `crop` removed.
    dropped: (n,) bool, points that another stage removed.
    """

    cut_away: NDArray[np.bool_]
    dropped: NDArray[np.bool_]

    @classmethod
    def none_of(cls, scan: PointCloud | None) -> Removed:
        """All points are left."""
        n = 0 if scan is None else len(scan.points)
        return cls(np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_))


def removed_after(removed: Removed, before: Seen, seen: Seen, options: PipelineOptions) -> Removed:
    """Find the points that have been removed after a stage."""
    if seen.scan is not before.scan:
        return Removed.none_of(seen.scan)
    if seen.scan is None or seen.cloud is None or seen.cloud is before.cloud:
        return removed
    stage = seen.steps[-1].stage
    left = ~(removed.cut_away | removed.dropped)
    points, given = seen.scan.points, seen.scan if before.cloud is None else before.cloud
    if stage == "crop":  # does not move points
        return removed._replace(cut_away=removed.cut_away | (left & (_distance(seen.cloud, points) > 0)))
    dropped = removed.dropped.copy()
    if stage == "clean" and len(given.points) == left.sum():
        dropped[left] = outliers(given, options.scan)
    elif stage == "clean" or stage not in DEFAULT_STAGES:
        reach = DROPPED * median_spacing(seen.cloud.points)
        dropped |= left & (_distance(seen.cloud, points) > reach)
    return removed._replace(dropped=dropped)


def median_spacing(points: FloatArray) -> float:
    """The median distance of points to their nearest neighbours; 0 if there are fewer than two.

    points: (n, 3) float64, coordinates.
    Returns float: in the unit of the points.
    """
    return float(np.median(cKDTree(points).query(points, k=[2])[0])) if len(points) > 1 else 0.0


def _distance(cloud: PointCloud, places: FloatArray) -> FloatArray:
    """The distance of each place to the nearest point of a cloud, (n,)."""
    return np.asarray(cKDTree(cloud.points).query(places)[0])
