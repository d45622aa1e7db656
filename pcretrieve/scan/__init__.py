"""Raw points of one scan, prepared for a surface.

In comes a point cloud with outliers; out goes a filtered one, with normals that point outwards.
"""

from pcretrieve.scan.clean import clean
from pcretrieve.scan.normals import oriented_normals

__all__ = ["clean", "oriented_normals"]
