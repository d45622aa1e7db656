"""The intrinsic parameters of a depth camera: those of a file beside an image, or known ones.

A depth image has the distance of each pixel along the optical axis. A pinhole camera is known by its focal
lengths and its principal point [1]_.

References
----------
.. [1] Richard Hartley, Andrew Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, 2004,
   eq. (6.9).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.files import check_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["Camera", "camera_file", "camera_of", "known_camera"]

# Files beside an image, or in the folder above, that hold the parameters of its camera.
NAMES = tuple(
    name + suffix
    for name in ("camera", "camera_intrinsic", "intrinsic", "intrinsics")
    for suffix in (".json", ".toml")
)
# Largest size of such a file: those of Open3D have less than a kilobyte.
MOST_BYTES = 1 << 16
# The file of a folder in the layout of the TUM RGB-D benchmark, which names the images in its folder depth.
TUM_LIST = "depth.txt"


class Camera(NamedTuple):
    """The parameters of a pinhole camera.

    focal: focal lengths in x and in y; pixels.
    center: principal point, x and y; pixels, from the centre of the first pixel.
    size: width and height of the images; pixels.
    """

    focal: tuple[float, float]
    center: tuple[float, float]
    depth_scale: float | None = None
    size: tuple[int, int] | None = None
    note: str = ""


# The defaults of OpenNI and ROS for the first Kinect, and of libfreenect2 for the second.
KINECTS = {
    (640, 480): Camera((525.0, 525.0), (319.5, 239.5), note="Kinect"),
    (512, 424): Camera((365.456, 365.456), (254.878, 205.395), note="Kinect v2"),
}
# The calibrations of the three cameras of the TUM benchmark, and the scale of its images.
TUM_SCALE = 5000.0
TUM_CAMERAS = {
    "freiburg1": Camera((517.3, 516.5), (318.6, 255.3), TUM_SCALE, (640, 480)),
    "freiburg2": Camera((520.9, 521.0), (325.1, 249.7), TUM_SCALE, (640, 480)),
    "freiburg3": Camera((535.4, 539.2), (320.1, 247.6), TUM_SCALE, (640, 480)),
}
TUM_DEFAULT = Camera((525.0, 525.0), (319.5, 239.5), TUM_SCALE, (640, 480))


def camera_file(image: Path) -> Path | None:
    """The file with the parameters of the camera of an image."""
    own = [image.with_suffix(suffix) for suffix in (".json", ".toml")]
    folder = image.absolute().parent
    near = [place / name for place in (folder, folder.parent) for name in NAMES]
    listed = [folder.parent / TUM_LIST] if folder.name == "depth" else []
    return next((file for file in (*own, *near, *listed) if file.is_file()), None)


def camera_of(file: Path) -> Camera:
    """The parameters in a file."""
    if file.name == TUM_LIST:
        name = file.absolute().parent.name
        return next((camera for key, camera in TUM_CAMERAS.items() if key in name), TUM_DEFAULT)
    check_file(file)
    if file.stat().st_size > MOST_BYTES:
        raise ScanReadError(f"the camera file {file.name} must have at most {MOST_BYTES} bytes")
    try:
        text = file.read_text(encoding="utf-8")
        tree = json.loads(text) if file.suffix == ".json" else tomllib.loads(text)
        return _camera(tree.get("intrinsic", tree))
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ScanReadError(
            f"the camera file {file.name} must have intrinsic_matrix as Open3D writes it, or fx fy cx cy: "
            f"{type(error).__name__} {error}"
        ) from error


def known_camera(width: int, height: int) -> Camera | None:
    """The default parameters of a Kinect.

    width, height: size of an image; pixels.
    """
    camera = KINECTS.get((width, height))
    if camera is None:
        return None
    return camera._replace(
        note=f"assumed the camera of a {camera.note}: there is no camera.json beside the image"
    )


def _camera(tree: Any) -> Camera:
    if "intrinsic_matrix" in tree:
        matrix = np.array(tree["intrinsic_matrix"], dtype=np.float64)
        # Nine numbers by columns, or three rows.
        matrix = matrix.reshape(3, 3).T if matrix.ndim == 1 else matrix
        (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    else:
        fx, fy, cx, cy = (float(tree[name]) for name in ("fx", "fy", "cx", "cy"))
    scale = None if tree.get("depth_scale") is None else float(tree["depth_scale"])
    if not (
        np.isfinite([fx, fy, cx, cy, scale or 1]).all() and min(fx, fy) > 0 and (scale is None or scale > 0)
    ):
        raise ValueError("focal lengths and the depth scale must be positive")
    size = (int(tree["width"]), int(tree["height"])) if {"width", "height"} <= tree.keys() else None
    return Camera((fx, fy), (cx, cy), scale, size)
