"""A depth camera before a turning body, on a floor and before a wall.

The camera does not move. The frame of its points has the axes x right, y down and z ahead, and the camera at
the origin; lengths are in metres.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pcretrieve.arrays.open3d import RayScene
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.files import write_file

# Depth values of one metre in the files of the images: millimetres, as most depth cameras write.
MILLIMETRES = 1000

# Names of the images, by their number, and of the file of the camera.
FRAME, CAMERA = "frame{:03d}.png", "camera.json"


@dataclass(frozen=True, slots=True)
class TurningOptions:
    """A body that turns about a vertical axis before a depth camera.

    turn: angle by which the body turns from the first frame to the one after the last; degrees.
    width, height: size of the images; pixels. A camera that stands upright sees more of a person.
    focal: focal length; pixels.
    tilt: angle by which the camera looks down; degrees.
    max_incidence: angle between ray and normal beyond which there is no measurement; degrees.
    flying_share: fraction of the pixels on depth edges that mix the depths before and behind the edge.

    References
    ----------
    .. [1] K. Khoshelham and S. O. Elberink, "Accuracy and resolution of Kinect depth data for indoor mapping
       applications", Sensors 12 (2012), eq. (8).
    """

    n_frames: int = 100
    turn: float = 360.0
    unevenness: float = 0.3
    width: int = 240
    height: int = 320
    focal: float = 340.0
    distance: float = 2.4
    wall: float = 4.0
    camera_height: float = 1.1
    tilt: float = 4.0
    eccentricity: float = 0.03
    noise: float = 0.003
    max_incidence: float = 78.0
    flying_share: float = 0.04


def turning_frames(
    mesh: TriangleMesh, options: TurningOptions, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Depth images (n_frames, height, width) of a turning body, and its motions (n_frames, 4, 4).

    Images have the coordinate z; m, 0 where there is no measurement. Motions lead from the frame of the mesh
    to that of the camera.
    """
    scene = RayScene(mesh.vertices, mesh.faces)
    steps = 1 + options.unevenness * rng.standard_normal(options.n_frames)
    angles = (
        options.turn / options.n_frames * (np.cumsum(steps) - steps[0])
    )  # (n_frames,)
    motions = np.array([_motion(mesh, options, angle) for angle in angles])
    images = np.array([_image(scene, mesh, motion, options, rng) for motion in motions])
    return images, motions


def write_frames(folder: Path, images: FloatArray, options: TurningOptions) -> list[Path]:
    """Write images as PNG files of 16 bits, in millimetres, and ``camera.json``, as Open3D writes it."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    (fx, cx), (fy, cy) = (
        (options.focal, (side - 1) / 2) for side in (options.width, options.height)
    )
    camera = {
        "width": options.width,
        "height": options.height,
        "intrinsic_matrix": [fx, 0, 0, 0, fy, 0, cx, cy, 1],  # by columns
    }
    write_file(folder / CAMERA, json.dumps(camera).encode())
    files = []
    for number, image in enumerate(images):
        file = io.BytesIO()
        Image.fromarray(np.round(MILLIMETRES * image).astype(np.uint16)).save(
            file, format="PNG"
        )
        files.append(folder / FRAME.format(number))
        write_file(files[-1], file.getvalue())
    return files


def _upright(options: TurningOptions) -> FloatArray:
    """(3, 3) rotation from axes with y up, and z from the body to the camera, to those of the camera."""
    down = Rotation.from_euler("x", options.tilt, degrees=True).as_matrix()
    return np.asarray(down @ np.diag([1.0, -1.0, -1.0]))


def _motion(mesh: TriangleMesh, options: TurningOptions, angle: float) -> FloatArray:
    """(4, 4) motion of the body to the camera, after a turn by an angle; degrees."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    axis = (low + high) / 2 + [options.eccentricity, 0, 0]
    axis[1] = low[1]
    turn = Rotation.from_euler("y", angle, degrees=True).as_matrix()
    # Upright, with the camera as origin.
    feet = np.array([0, -options.camera_height, -options.distance])
    motion = np.eye(4)
    motion[:3, :3] = _upright(options) @ turn
    motion[:3, 3] = _upright(options) @ (feet - turn @ axis)
    return motion


def _image(
    scene: RayScene,
    mesh: TriangleMesh,
    motion: FloatArray,
    options: TurningOptions,
    rng: np.random.Generator,
) -> FloatArray:
    """(height, width) depths of one frame."""
    from scipy import ndimage

    u, v = (
        (np.arange(side) - (side - 1) / 2) / options.focal
        for side in (options.width, options.height)
    )
    rays = np.stack(
        [*(grid.ravel() for grid in np.meshgrid(u, v)), np.ones(u.size * v.size)], axis=1
    )
    to_body = motion[:3, :3].T
    camera = -to_body @ motion[:3, 3]
    # The depth, because the component of each ray along z is 1.
    depth, normals, _ = scene.cast(np.broadcast_to(camera, rays.shape), rays @ to_body.T)
    normals = normals @ motion[:3, :3].T
    upright = rays @ _upright(options)  # in axes with y up
    for axis, position in ((1, -options.camera_height), (2, -options.wall)):
        direction = upright[:, axis]
        plane = np.where(
            direction * position > 0, position / np.where(direction, direction, 1), np.inf
        )
        nearer = plane < depth
        depth = np.where(nearer, plane, depth)
        normals[nearer] = _upright(options)[:, axis]
    cosine = -np.einsum("ij,ij->i", rays, normals) / np.linalg.norm(rays, axis=1)
    measured = np.isfinite(depth) & (cosine > np.cos(np.radians(options.max_incidence)))
    depth = np.where(measured, depth, 0)
    # The largest depth of each pixel and of its four neighbours.
    cross = ndimage.generate_binary_structure(2, 1)
    grid = depth.reshape(options.height, options.width)
    behind = ndimage.maximum_filter(grid, footprint=cross, mode="nearest").ravel()
    flying = (behind > (1 + 4 * options.noise) * depth) & (
        rng.random(len(depth)) < options.flying_share
    )
    error = (
        options.noise
        * mesh.diagonal
        * (depth / options.distance) ** 2
        * rng.standard_normal(len(depth))
    )
    mixed = depth + (behind - depth) * rng.random(len(depth))
    image = np.where(measured, np.where(flying, mixed, depth + error), 0)
    return np.asarray(image.reshape(options.height, options.width))
