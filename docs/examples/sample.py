"""What several examples share: sample scans, simulated people, a sphere, and pictures of bodies."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from benchmarks.simulation import POSES, body, make_subject
from matplotlib.cm import viridis
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from pcretrieve.draw.axes import body_axes
from pcretrieve.draw.pictures import (
    CLAY,
    THUMBNAIL_AZIMUTH,
    THUMBNAIL_ELEVATION,
    cameras_framing,
    depth_picture,
    point_picture,
    rotation,
    surface_picture,
)
from pcretrieve.values import PointCloud, TriangleMesh

# `scripts/docs` says where the repository is, because it builds from a copy of these files.
SCANS = Path(os.environ.get("PCRETRIEVE_ROOT", Path(__file__).parents[2])) / "scans"

# Side of the square of a point in a picture, relative to half of the side of the picture.
POINT = 0.015


def person(seed: int, pose: str) -> TriangleMesh:
    """A simulated person in a pose, as a clean mesh."""
    return body(
        make_subject("person", np.random.default_rng(seed)), POSES["person"][pose]
    )


def sphere(rounds: int) -> TriangleMesh:
    """The unit sphere: an octahedron whose faces are divided in four, some times."""
    points = np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float
    )
    signs = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    corners = np.array(
        [(x, y, z) if (x + y + z) % 2 == 0 else (x, z, y) for x, y, z in signs]
    )
    triangles = points[corners]  # (m, 3, 3)
    for _ in range(rounds):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = (
            (p + q) / np.linalg.norm(p + q, axis=1)[:, None]
            for p, q in ((a, b), (b, c), (c, a))
        )
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    _, first, vertex = np.unique(
        triangles.reshape(-1, 3).round(9), axis=0, return_index=True, return_inverse=True
    )
    return TriangleMesh(
        triangles.reshape(-1, 3)[first], vertex.reshape(-1, 3).astype(np.int32)
    )


def draw(
    bodies: Mapping[str, TriangleMesh | PointCloud],
    colours: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Draw bodies in a row, upright and from the front, each with its name; points as those of the last mesh.

    colours: by name the values of vertices or points of bodies that are not drawn as clay.
    """
    _, places = plt.subplots(1, len(bodies), figsize=(9, 4.5), layout="constrained")
    meshes = [one for one in bodies.values() if isinstance(one, TriangleMesh)]
    for place, (name, one) in zip(places.flat, bodies.items(), strict=True):
        mesh = one if isinstance(one, TriangleMesh) else meshes[-1]
        at = one.vertices if isinstance(one, TriangleMesh) else one.points
        front = rotation(THUMBNAIL_AZIMUTH, THUMBNAIL_ELEVATION) @ body_axes(
            mesh.vertices, mesh.faces, mesh.up
        )
        (camera,) = cameras_framing(at, [front])
        values = (colours or {}).get(name)
        shades = (
            np.tile(CLAY, (len(at), 1))
            if values is None
            else viridis(Normalize()(values))[:, :3]
        )
        if isinstance(one, TriangleMesh):
            shades = shades[one.faces].mean(axis=1)
            picture = surface_picture(one.vertices, one.faces, shades, camera, size=600)
        elif values is None:
            picture = depth_picture(at, CLAY, camera, width=POINT * camera.half, size=600)
        else:
            picture = point_picture(
                at, shades, camera, width=POINT * camera.half, size=600
            )
        place.imshow(picture.crop(picture.getbbox()))
        place.set_title(name)
        place.set_axis_off()
        place.set_anchor("S")
