"""The options of the registration of several views, before the pipeline."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pcretrieve.options.model import Length, Options, Share

__all__ = ["MergeOptions"]


class MergeOptions(Options):
    """Range scans (views), with or without poses → one cloud in one frame, before the pipeline.

    Lengths called relative are relative to the median bounding-box diagonal of the views without background.
    """

    refine: bool = True
    """Refine given poses by registration."""
    sensor: Literal["front", "origin"] = "front"
    """Position of the sensor of a view whose file has none. front: far along the z axis of the frame of the
    view, the convention of range scanners; origin: at its origin, the convention of depth cameras."""
    max_range: Annotated[float, Field(gt=0)] | None = None
    """Distance from the sensor beyond which points are removed as background; unit of the file."""
    background: Literal["none", "planes"] = "none"
    """planes: remove floors and walls: planes with a tenth of the points or more, and with nothing behind."""
    keep_largest: bool = False
    """Remove all but the largest connected component of each view as background."""
    # Distance between points above which they are in different components; relative to the diagonal of the
    # view.
    piece_gap: ClassVar[float] = 0.02
    voxel: Length = 0.0
    """Edge of the voxels in which the points of the merged cloud are averaged, 0 to keep all points;
    relative."""
    # Number of neighbours to which the tangent plane of a point is fitted.
    normal_neighbors: ClassVar[int] = 16
    # Edge of the voxels of which each gives one point to the matching of features; relative.
    cell: ClassVar[float] = 0.012
    # Number of random samples of point correspondences for each pair of views.
    n_tries: ClassVar[int] = 200_000
    # Number of distinct rigid motions for each pair of views that are refined and verified.
    n_candidates: ClassVar[int] = 12
    reach: Annotated[float, Field(gt=0, lt=0.1)] = 0.01
    """Largest distance between corresponding points of two registered views; relative."""
    min_overlap: Share = 0.1
    """Smallest overlap of a view with the other views; fraction of its points."""
    # Largest number of points of a view that lie in space which another view observed as empty; relative to
    # the number of points in the overlap.
    max_contradiction: ClassVar[float] = 0.02
    # Seed of the random samples.
    seed: ClassVar[int] = 0
