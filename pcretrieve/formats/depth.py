"""Depth images with the parameters of their camera → organised clouds, in metres."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.camera import camera_file, camera_of, known_camera
from pcretrieve.formats.files import DEFLATE_RATIO
from pcretrieve.formats.format import Format, Part
from pcretrieve.formats.organised import organised_scan
from pcretrieve.formats.raw import RawScan, incomplete

__all__ = ["DEPTH_IMAGE", "camera_parts", "depth_scan", "has_camera"]

# Modes of Pillow with one channel of 16 bits, or of 32 bits.
DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I", "F")
# Size of a pixel of these modes; bytes.
MOST_PIXEL_BYTES = 4
# Depth values of one metre, if the file of the camera has none: millimetres in whole numbers, else metres.
MILLIMETRES, METRES = 1000.0, 1.0
# Value that sensors write for missing measurements, besides zero: the largest number of 16 bits.
NO_ANSWER = 65535


def read_depth(path: Path) -> RawScan:
    """Read a depth image."""
    return depth_scan(path, _pixels(path))


def depth_scan(path: Path, depth: NDArray[Any]) -> RawScan:
    """The points of a depth image.

    depth: (h, w) int or float, depth of each pixel: the coordinate along the optical axis.
    """
    height, width = depth.shape
    file = camera_file(path)
    camera = known_camera(width, height) if file is None else camera_of(file)
    if camera is None:
        raise ScanReadError(
            f"a depth image of {width} × {height} pixels needs the parameters of its camera: put "
            "camera.json, as Open3D writes it, or camera.toml with fx fy cx cy beside the image"
        )
    if camera.size not in (None, (width, height)):
        raise ScanReadError(f"the camera has {camera.size} pixels, the image has {(width, height)}")
    whole = depth.dtype.kind in "iu"
    measured = np.isfinite(depth) & (depth > 0)
    if whole:
        measured &= depth != NO_ANSWER
    z = np.where(measured, depth, 0) / (camera.depth_scale or (MILLIMETRES if whole else METRES))  # (h, w)
    x = (np.arange(width) - camera.center[0]) / camera.focal[0]  # (w,)
    y = (np.arange(height) - camera.center[1]) / camera.focal[1]  # (h,)
    grid = np.stack([x[None] * z, y[:, None] * z, z], axis=2)  # (h, w, 3)
    scan = organised_scan(grid, measured, np.zeros(3))
    return scan._replace(notes=(camera.note, *scan.notes) if camera.note else scan.notes, unit="m")


def has_camera(path: Path) -> bool:
    """Whether the parameters of the camera of an image lie beside it."""
    return camera_file(path) is not None


def camera_parts(path: Path) -> tuple[Part, ...]:
    """The file of the camera, which belongs to an image."""
    file = camera_file(path)
    return () if file is None else (Part(file),)


def _pixels(path: Path) -> NDArray[Any]:
    from PIL import Image

    # In memory, because Pillow allocates what a damaged chunk declares before it reads a file, up to 4 GB.
    data = path.read_bytes()
    try:
        with warnings.catch_warnings():
            # Pillow warns of damaged metadata, and of images that are suspiciously large.
            warnings.simplefilter("error")
            with Image.open(io.BytesIO(data), formats=("PNG", "TIFF")) as image:
                if image.mode not in DEPTH_MODES:
                    raise ScanReadError(
                        f"a depth image must have one channel of 16 or 32 bits, this image is {image.mode}"
                    )
                width, height = image.size
                if width * height * MOST_PIXEL_BYTES > DEFLATE_RATIO * path.stat().st_size:
                    raise incomplete(path, f"it declares {width} × {height} pixels")
                return np.asarray(image)
    except (MemoryError, ScanReadError):
        raise
    # Pillow has no exception class for damaged files: its decoders raise many, OSError among them.
    except Exception as error:
        raise incomplete(path, error) from error


def _is_depth_image(path: Path) -> bool:
    """Whether an image has the channel of a depth image, and a camera."""
    from PIL import Image

    if not has_camera(path):
        return False
    data = path.read_bytes()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with Image.open(io.BytesIO(data), formats=("PNG", "TIFF")) as image:
                return image.mode in DEPTH_MODES
    except Exception:  # noqa: BLE001 - a file that cannot be read is not recognised
        return False


DEPTH_IMAGE = Format((".png", ".tif", ".tiff"), read_depth, camera_parts, recognise=_is_depth_image)
