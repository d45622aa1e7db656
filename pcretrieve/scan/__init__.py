"""Raw points of one scan, prepared for a surface.

In comes a point cloud with strays; out goes a cleaned one, whose normals look outwards.
"""

from pcretrieve.scan.clean import clean
from pcretrieve.scan.normals import oriented_normals

__all__ = ["clean", "oriented_normals"]
