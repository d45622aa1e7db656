"""The options of the stages from raw points to points with normals."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from pcretrieve.options.model import Length, Options

__all__ = ["ScanOptions"]

Corner = tuple[float, float, float]


class ScanOptions(Options):
    """Raw points → points of the body, filtered, with normals that point outwards."""

    unit: Literal["none", "um", "mm", "cm", "dm", "m", "km", "in", "ft"] = "none"
    """Unit of the files whose format does not have one; they are converted to metres, as all others are.
    none: unknown, the coordinates are not converted."""
    min_range: Annotated[float, Field(gt=0)] | Literal["none"] = "none"
    """Distance from the sensor below which points are removed; unit of the file. From the origin, if the file
    has no sensor positions."""
    max_range: Annotated[float, Field(gt=0)] | Literal["none"] = "none"
    """Distance from the sensor beyond which points are removed as background, as min_range."""
    box: tuple[Corner, Corner] | Literal["none"] = "none"
    """Axis-aligned box outside which points are removed: [[x, y, z], [x, y, z]], its lowest and its highest
    corner; unit of the file."""
    ground: Literal["auto", "none"] = "auto"
    """auto: remove the largest plane on which the body stands, if it is seen around the body."""
    keep_largest: bool = False
    """Remove all but the largest connected component."""
    # Distance between points above which they are in different components; relative to the diagonal.
    piece_gap: ClassVar[float] = 0.02
    voxel: Literal["auto"] | Length = "auto"
    """Edge of the voxels in which points are averaged (voxel-grid filter); relative to the diagonal, 0 for no
    filter. auto: .003 for dense clouds, .0015 for others."""
    # Statistical outlier removal: number of neighbours to which the mean distance of a point is computed.
    outlier_neighbors: ClassVar[int] = 20
    outlier_std: Annotated[float, Field(gt=0)] = 2.0
    """Statistical outlier removal: largest mean distance that is kept; standard deviations above the mean of
    the cloud."""
    normal_neighbors: Annotated[int, Field(ge=3)] = 16
    """Number of neighbours to which the tangent plane of a point is fitted."""
    orientation: Literal["auto", "viewpoint", "flood", "tangent-plane", "given"] = "auto"
    """How the sign of normals is found. viewpoint: towards the sensor; flood: towards the outside, found by
    flood fill; tangent-plane: consistently along a minimum spanning tree; given: the normals in the file.
    auto: viewpoint if the file has sensor positions, else given if it has normals, else flood."""
    # Edge of the grid cells of the flood fill; relative to the diagonal. At least 1.3 times the spacing of
    # the points.
    flood_cell: ClassVar[float] = 0.005
    flood_gap: Length = 0.02
    """Radius of the largest hole in the scan through which the flood fill does not pass, at the first
    attempt; relative to the diagonal."""
    # Number of further attempts, each with a larger radius, if the flood fill leaks into the body.
    flood_retries: ClassVar[int] = 4

    @field_validator("box")
    @classmethod
    def _has_a_volume(cls, box: tuple[Corner, Corner] | str) -> tuple[Corner, Corner] | str:
        if not isinstance(box, str) and not all(low < high for low, high in zip(*box, strict=True)):
            raise ValueError(
                "input should be the lowest and the highest corner of a box, got "
                f"{[list(corner) for corner in box]}"
            )
        return box
