"""Raw points of one scan, prepared for a surface.

In comes a point cloud with background and outliers; out goes a filtered cloud of the body, with normals that
point outwards.
"""

from pcretrieve.points.clean import check_extent, clean, outliers
from pcretrieve.points.crop import crop, kept_points
from pcretrieve.points.normals import oriented_normals

__all__ = ["check_extent", "clean", "crop", "kept_points", "oriented_normals", "outliers"]
