"""Clean meshes → meshes with typical defects: holes, flipped faces, self-intersections, duplicates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pcretrieve.values import FloatArray, IntArray, TriangleMesh


@dataclass(frozen=True, slots=True)
class DamageOptions:
    """Defects of a mesh. A patch is the set of faces whose centroids lie in a ball round that of one face."""

    n_holes: int = 4
    n_flipped: int = 4
    n_flaps: int = 3
    radius: float = 0.02
    duplicated_share: float = 0.01
    shell_radius: float = 0.15
    shell_depth: float = 0.004


def damaged(mesh: TriangleMesh, options: DamageOptions, rng: np.random.Generator) -> TriangleMesh:
    """Add defects to a mesh at random places. Other parts of the surface do not change."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)  # (m, 3)

    def patch(radius: float) -> NDArray[np.bool_]:
        """A mask of the faces in a patch round a random face, (m,)."""
        centre = middles[rng.integers(len(middles))]
        near: NDArray[np.bool_] = np.linalg.norm(middles - centre, axis=1) <= radius * mesh.diagonal
        return near

    # Flaps and the second surface are copied from the mesh before holes are cut.
    sheets = [_turned(mesh.vertices, mesh.faces[patch(options.radius)], rng) for _ in range(options.n_flaps)]
    if options.shell_radius > 0:
        beneath = mesh.vertices - options.shell_depth * mesh.diagonal * _vertex_normals(mesh)
        sheets.append((beneath, mesh.faces[patch(options.shell_radius)]))
    faces = mesh.faces.copy()
    for _ in range(options.n_flipped):
        flipped = patch(options.radius)
        faces[flipped] = faces[flipped][:, ::-1]
    whole = np.ones(len(faces), dtype=bool)
    for _ in range(options.n_holes):
        whole &= ~patch(options.radius)
    faces = faces[whole]
    twice = faces[rng.choice(len(faces), round(options.duplicated_share * len(faces)), replace=False)]
    twice[::2] = twice[::2, ::-1]
    vertices, parts = [mesh.vertices], [faces, twice]
    for points, sheet in sheets:
        used, number = np.unique(sheet, return_inverse=True)
        parts.append(number.reshape(-1, 3) + sum(map(len, vertices)))
        vertices.append(points[used])
    return TriangleMesh(np.concatenate(vertices), np.concatenate(parts))


def _turned(vertices: FloatArray, faces: IntArray, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """All vertices, rotated at random about the mean vertex of some faces, and these faces."""
    middle = vertices[faces].mean(axis=(0, 1))
    turn = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    return (vertices - middle) @ turn.T + middle, faces


def _vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """(n, 3) unit normals of vertices: means of the normals of the incident faces, weighted by area."""
    normals, of_faces = np.zeros_like(mesh.vertices), mesh.area_vectors
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], of_faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    return normals
