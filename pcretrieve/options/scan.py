"""The options of the stages from raw points to points with normals."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pcretrieve.options.model import Count, Length, Options

__all__ = ["ScanOptions"]


class ScanOptions(Options):
    """Raw points → filtered points with normals that point outwards."""

    voxel: Literal["auto"] | Length = "auto"
    """Edge of the voxels in which points are averaged (voxel-grid filter); relative to the diagonal, 0 for no
    filter. auto: .003 for dense clouds, .0015 for others."""
    outlier_neighbors: Count = 20
    """Statistical outlier removal: number of neighbours to which the mean distance of a point is computed."""
    outlier_std: Annotated[float, Field(gt=0)] = 2.0
    """Statistical outlier removal: largest mean distance that is kept; standard deviations above the mean of
    the cloud."""
    normal_neighbors: Annotated[int, Field(ge=3)] = 16
    """Number of neighbours to which the tangent plane of a point is fitted."""
    orientation: Literal["auto", "viewpoint", "flood", "tangent-plane", "given"] = "auto"
    """How the sign of normals is found. viewpoint: towards the sensor; flood: towards the outside, found by
    flood fill; tangent-plane: consistently along a minimum spanning tree; given: the normals in the file.
    auto: viewpoint if the file has sensor positions, else given if it has normals, else flood."""
    flood_cell: Annotated[float, Field(gt=0, lt=0.1)] = 0.005
    """Edge of the grid cells of the flood fill; relative to the diagonal. At least 1.3 times the spacing of
    the points."""
    flood_gap: Length = 0.02
    """Radius of the largest hole in the scan through which the flood fill does not pass, at the first
    attempt; relative to the diagonal."""
    flood_retries: Annotated[int, Field(ge=0, le=10)] = 4
    """Number of further attempts, each with a larger radius, if the flood fill leaks into the body."""
