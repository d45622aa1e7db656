"""Depth images with the parameters of their camera → organised clouds, in metres.

A depth image has the distance of each pixel along the optical axis. A pinhole camera is known by its focal
lengths and its principal point [1]_: by those of a file beside the image, or known ones.

References
----------
.. [1] Richard Hartley, Andrew Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, 2004,
   eq. (6.9).
"""

from __future__ import annotations

import io
import json
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import DEFLATE_RATIO, Damaged, Part, RawScan, check_file
from pcretrieve.formats.organised import organised_scan

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# Modes of Pillow with one channel of 16 bits, or of 32 bits.
DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I", "F")
# Size of a pixel of these modes; bytes.
MOST_PIXEL_BYTES = 4
# Depth values of one metre, if the file of the camera has none: millimetres in whole numbers, else metres.
MILLIMETRES = 1000.0
METRES = 1.0
# Value that sensors write for missing measurements, besides zero: the largest number of 16 bits.
NO_ANSWER = 65535

# Files beside an image, or in the folder above, that hold the parameters of its camera.
STEMS = ("camera", "camera_intrinsic", "intrinsic", "intrinsics")
SUFFIXES = (".json", ".toml")
NAMES = [stem + suffix for stem in STEMS for suffix in SUFFIXES]
# Largest size of such a file: those of Open3D have less than a kilobyte.
MOST_BYTES = 1 << 16
# The file of a folder in the layout of the TUM RGB-D benchmark, which names the images in its folder depth.
TUM_LIST = "depth.txt"


class Camera(NamedTuple):
    """A pinhole camera: focal lengths, principal point from the centre of the first pixel, size; pixels."""

    focal: tuple[float, float]
    center: tuple[float, float]
    depth_scale: float | None = None
    size: tuple[int, int] | None = None
    note: str = ""


# Names of the parameters: of Open3D and this package, of ROS, and of librealsense.
MATRICES = ("intrinsic_matrix", "K", "k")
PARAMETERS = (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy"))
SCALES = ("depth_scale", "depth_units")


def _camera_file(image: Path) -> Path | None:
    """The file with the parameters of the camera of an image."""
    own = [image.with_suffix(suffix) for suffix in SUFFIXES]
    folder = image.absolute().parent
    near = [place / name for place in (folder, folder.parent) for name in NAMES]
    listed = [folder.parent / TUM_LIST] if folder.name == "depth" else []
    return next((file for file in (*own, *near, *listed) if file.is_file()), None)


def camera_of(file: Path) -> Camera:
    """The parameters in a file."""
    if file.name == TUM_LIST:
        name = file.absolute().parent.name
        return next(camera for key, camera in TUM_CAMERAS.items() if key in name)
    check_file(file)
    if file.stat().st_size > MOST_BYTES:
        raise ScanReadError(
            f"the camera file {file.name} must have at most {MOST_BYTES} bytes"
        )
    try:
        text = file.read_text(encoding="utf-8")
        tree = json.loads(text) if file.suffix == ".json" else tomllib.loads(text)
        return _camera(tree.get("intrinsic", tree))
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise ScanReadError(
            f"the camera file {file.name} must have intrinsic_matrix as Open3D writes it, or fx fy cx cy: "
            f"{type(error).__name__} {error}"
        ) from error


def _camera(tree: Any) -> Camera:
    named = next((name for name in MATRICES if name in tree), None)
    if named is None:
        names = [
            next((name for name in known if name in tree), known[0])
            for known in PARAMETERS
        ]
        fx, fy, cx, cy = (float(tree[name]) for name in names)
    else:
        # Nine numbers, by columns or by rows, or three rows: the last row is (0, 0, 1).
        matrix = np.array(tree[named], dtype=np.float64).reshape(3, 3)
        (fx, _, cx), (_, fy, cy), _ = (
            matrix.T if matrix[2, :2].any() else matrix
        ).tolist()
    scale = next(
        (float(tree[name]) for name in SCALES if tree.get(name) is not None), None
    )
    if not (
        np.isfinite([fx, fy, cx, cy, scale or 1]).all()
        and min(fx, fy) > 0
        and (scale is None or scale > 0)
    ):
        raise ValueError("focal lengths and the depth scale must be positive")
    note = str(tree.get("note", ""))
    if scale is not None and scale < 1:
        note = f"read depth_scale {scale:g} as metres per value, not values per metre: it is below 1"
        scale = 1 / scale
    size = (
        (int(tree["width"]), int(tree["height"]))
        if {"width", "height"} <= tree.keys()
        else None
    )
    return Camera((fx, fy), (cx, cy), scale, size, note)


# Cameras that are known, by size and by the name of the folder: by OpenNI and ROS the first Kinect, by
# libfreenect2 the second, and by their calibrations the three cameras of the TUM benchmark, whose images have
# a scale of their own; of any other of its folders, that of OpenNI.
KNOWN = tomllib.loads("""
    [kinect.1]
    note = "assumed the camera of a Kinect: there is no camera.json beside the image"
    intrinsic_matrix = [[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]
    width = 640
    height = 480
    [kinect.2]
    note = "assumed the camera of a Kinect v2: there is no camera.json beside the image"
    intrinsic_matrix = [[365.456, 0, 254.878], [0, 365.456, 205.395], [0, 0, 1]]
    width = 512
    height = 424
    [tum]
    freiburg1 = { fx = 517.3, fy = 516.5, cx = 318.6, cy = 255.3, depth_scale = 5000 }
    freiburg2 = { fx = 520.9, fy = 521.0, cx = 325.1, cy = 249.7, depth_scale = 5000 }
    freiburg3 = { fx = 535.4, fy = 539.2, cx = 320.1, cy = 247.6, depth_scale = 5000 }
    "" = { fx = 525, fy = 525, cx = 319.5, cy = 239.5, depth_scale = 5000 }
""")
KINECTS = {camera.size: camera for camera in map(_camera, KNOWN["kinect"].values())}
TUM_CAMERAS = {name: _camera(tree) for name, tree in KNOWN["tum"].items()}


# --- images -----------------------------------------------------------------------------------------------


def depth_scan(path: Path, depth: NDArray[Any]) -> RawScan:
    """The points of a depth image.

    depth: (h, w) int or float, depth of each pixel: the coordinate along the optical axis.
    """
    height, width = depth.shape
    file = _camera_file(path)
    camera = KINECTS.get((width, height)) if file is None else camera_of(file)
    if camera is None:
        raise ScanReadError(
            f"a depth image of {width} × {height} pixels needs the parameters of its camera: put "
            "camera.json, as Open3D writes it, or camera.toml with fx fy cx cy beside the image"
        )
    if camera.size not in (None, (width, height)):
        raise ScanReadError(
            f"the camera has {camera.size} pixels, the image has {(width, height)}"
        )
    whole = depth.dtype.kind in "iu"
    measured = np.isfinite(depth) & (depth > 0)
    if whole:
        measured &= depth != NO_ANSWER
    z = np.where(measured, depth, 0) / (
        camera.depth_scale or (MILLIMETRES if whole else METRES)
    )  # (h, w)
    x = (np.arange(width) - camera.center[0]) / camera.focal[0]  # (w,)
    y = (np.arange(height) - camera.center[1]) / camera.focal[1]  # (h,)
    grid = np.stack([x[None] * z, y[:, None] * z, z], axis=2)  # (h, w, 3)
    scan = organised_scan(grid, measured, np.zeros(3))
    return scan._replace(
        notes=(camera.note, *scan.notes) if camera.note else scan.notes, unit="m"
    )


def camera_parts(path: Path) -> tuple[Part, ...]:
    """The file of the camera, which belongs to an image."""
    file = _camera_file(path)
    return () if file is None else (Part(file),)


@contextmanager
def _image(path: Path) -> Iterator[Any]:
    """An image, opened by Pillow."""
    from PIL import Image

    # In memory, because Pillow allocates what a damaged chunk declares before it reads a file, up to 4 GB.
    data = io.BytesIO(path.read_bytes())
    try:
        with warnings.catch_warnings():
            # Pillow warns of damaged metadata, and of images that are suspiciously large.
            warnings.simplefilter("error")
            with Image.open(data, formats=("PNG", "TIFF")) as image:
                yield image
    except OSError as error:  # of Pillow, for damage
        raise Damaged(str(error)) from error


def read_depth(path: Path) -> RawScan:
    """Read a depth image."""
    with _image(path) as image:
        if image.mode not in DEPTH_MODES:
            raise ScanReadError(
                f"a depth image must have one channel of 16 or 32 bits, this image is {image.mode}"
            )
        width, height = image.size
        if width * height * MOST_PIXEL_BYTES > DEFLATE_RATIO * path.stat().st_size:
            raise Damaged(f"it declares {width} × {height} pixels")
        depth = np.asarray(image)
    return depth_scan(path, depth)


def is_depth_image(path: Path) -> bool:
    """Whether an image has the channel of a depth image, and a camera."""
    if not camera_parts(path):
        return False
    with _image(path) as image:
        return image.mode in DEPTH_MODES
