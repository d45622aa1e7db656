"""What several examples share: sample scans, simulated people, a sphere, and functions in colour."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from pcretrieve.simulation import POSES, body, make_subject
from pcretrieve.values import FloatArray, TriangleMesh

# `scripts/docs` says where the repository is, because it builds from a copy of these files.
SCANS = Path(os.environ.get("PCRETRIEVE_ROOT", Path(__file__).parents[2])) / "scans"


def person(seed: int, pose: str) -> TriangleMesh:
    """A simulated person in a pose, as a clean mesh."""
    return body(make_subject("person", np.random.default_rng(seed)), POSES["person"][pose])


def sphere(rounds: int) -> TriangleMesh:
    """The unit sphere: an octahedron whose faces are divided in four, some times."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    signs = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    corners = np.array([(x, y, z) if (x + y + z) % 2 == 0 else (x, z, y) for x, y, z in signs])
    triangles = points[corners]  # (m, 3, 3)
    for _ in range(rounds):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q, axis=1)[:, None] for p, q in ((a, b), (b, c), (c, a)))
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    _, first, vertex = np.unique(
        triangles.reshape(-1, 3).round(9), axis=0, return_index=True, return_inverse=True
    )
    return TriangleMesh(triangles.reshape(-1, 3)[first], vertex.reshape(-1, 3).astype(np.int32))


def draw_function(axes: Any, mesh: TriangleMesh, values: FloatArray) -> None:
    """Colour the faces of a surface by the values of a function at its vertices."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    # Bodies stand: the longest extent is up.
    points = np.roll(mesh.vertices, 2 - np.ptp(mesh.vertices, axis=0).argmax(), axis=1)
    colours = values[mesh.faces].mean(axis=1)
    axes.add_collection3d(Poly3DCollection(points[mesh.faces], array=colours, cmap="viridis", linewidths=0))
    for name, low, high in zip("xyz", points.min(axis=0), points.max(axis=0), strict=True):
        getattr(axes, f"set_{name}lim")(low, high)
    axes.view_init(10, 25)
    axes.set_box_aspect(np.ptp(points, axis=0))
    axes.set_axis_off()
