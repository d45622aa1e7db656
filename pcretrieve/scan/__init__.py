"""Raw points of one scan, prepared for a surface.

In comes a point cloud with background and outliers; out goes a filtered cloud of the body, with normals that
point outwards.
"""

from pcretrieve.options import PointFilter
from pcretrieve.scan.clean import check_extent, clean, outliers
from pcretrieve.scan.crop import crop, kept_points
from pcretrieve.scan.filters import POINT_FILTERS
from pcretrieve.scan.normals import oriented_normals

__all__ = [
    "POINT_FILTERS",
    "PointFilter",
    "check_extent",
    "clean",
    "crop",
    "kept_points",
    "oriented_normals",
    "outliers",
]
