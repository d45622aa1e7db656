"""Pictures of surfaces and point clouds.

In come arrays of vertices and faces, or of points; out come shaded pictures, made by ray casting without a
display, and figures by matplotlib.
"""

from pcretrieve.draw.axes import FEWEST_BODIES, NEAR_AXIS, body_axes, common_axis, upward
from pcretrieve.draw.pictures import (
    CLAY,
    DARKEST,
    MARGIN,
    Camera,
    Colour,
    cameras_around,
    cameras_framing,
    depth_picture,
    point_picture,
    rgb,
    surface_picture,
)
from pcretrieve.draw.thumbnail import (
    THUMBNAIL_PIXELS,
    cloud_thumbnail,
    direction_upwards,
    picture_html,
    resized,
    thumbnail,
)

__all__ = [
    "CLAY",
    "DARKEST",
    "FEWEST_BODIES",
    "MARGIN",
    "NEAR_AXIS",
    "THUMBNAIL_PIXELS",
    "Camera",
    "Colour",
    "body_axes",
    "cameras_around",
    "cameras_framing",
    "cloud_thumbnail",
    "common_axis",
    "depth_picture",
    "direction_upwards",
    "picture_html",
    "point_picture",
    "resized",
    "rgb",
    "surface_picture",
    "thumbnail",
    "upward",
]
