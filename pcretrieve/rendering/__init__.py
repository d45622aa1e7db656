"""Pictures of surfaces and point clouds.

In come arrays of vertices and faces, or of points; out come shaded pictures, cast ray by ray so that no
display is needed. The virtual camera, the lamps and the ray casting of all pictures are here.
"""

from pcretrieve.rendering.camera import MARGIN, View, body_axes, views_around
from pcretrieve.rendering.pictures import Colour, css, point_picture, rgb, surface_picture
from pcretrieve.rendering.shading import CLAY
from pcretrieve.rendering.thumbnail import cloud_thumbnail, thumbnail

__all__ = [
    "CLAY",
    "MARGIN",
    "Colour",
    "View",
    "body_axes",
    "cloud_thumbnail",
    "css",
    "point_picture",
    "rgb",
    "surface_picture",
    "thumbnail",
    "views_around",
]
