"""Clean meshes → meshes as they are found: open, turned inside out in places, crossing themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pcretrieve.errors import InputError, OptionError
from pcretrieve.types import FloatArray, IntArray, TriangleMesh

__all__ = ["DamageOptions", "damaged"]


@dataclass(frozen=True, slots=True)
class DamageOptions:
    """What is wrong with a mesh, in patches: faces whose middles lie in a ball round one of them.

    Attributes
    ----------
    n_holes : int, default 4
        Patches that are cut out.
    n_flipped : int, default 4
        Patches whose faces are turned inside out.
    n_flaps : int, default 3
        Copies of patches, turned about their middles so that they cut through the surface.
    radius : float, default 0.02
        Of these patches; diagonals.
    duplicated_share : float, default 0.01
        Faces that come twice, half of them turned the second time; relative to all.
    shell_radius : float, default 0.15
        Of one patch that has a second shell beneath it; diagonals. 0 for none.
    shell_depth : float, default 0.004
        How far beneath the surface that shell lies; diagonals.

    Raises
    ------
    OptionError
        If a value is out of range.
    """

    n_holes: int = 4
    n_flipped: int = 4
    n_flaps: int = 3
    radius: float = 0.02
    duplicated_share: float = 0.01
    shell_radius: float = 0.15
    shell_depth: float = 0.004

    def __post_init__(self) -> None:
        for name in ("n_holes", "n_flipped", "n_flaps", "radius", "shell_radius", "shell_depth"):
            if not getattr(self, name) >= 0:
                raise OptionError(f"{name} must be at least 0, got {getattr(self, name)}")
        if not 0 <= self.duplicated_share <= 1:
            raise OptionError(
                f"duplicated_share must be a share between 0 and 1, got {self.duplicated_share}"
            )


def damaged(mesh: TriangleMesh, options: DamageOptions, rng: np.random.Generator) -> TriangleMesh:
    """The mesh with defects at random places; what is left of its surface stays where it was.

    Parameters
    ----------
    mesh : TriangleMesh
        Closed, pointing outwards.
    options : DamageOptions
    rng : numpy.random.Generator

    Raises
    ------
    InputError
        If the mesh has no faces.
    """
    if not len(mesh.faces):
        raise InputError("a mesh must have faces to be damaged, got none")
    middles = mesh.vertices[mesh.faces].mean(axis=1)  # (m, 3)

    def patch(radius: float) -> NDArray[np.bool_]:
        """(m,) faces round a random one."""
        centre = middles[rng.integers(len(middles))]
        near: NDArray[np.bool_] = np.linalg.norm(middles - centre, axis=1) <= radius * mesh.diagonal
        return near

    # All sheets are taken from the whole surface, before it has holes.
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
    """All vertices turned at random about the middle of some faces, and these faces."""
    middle = vertices[faces].mean(axis=(0, 1))
    turn = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    return (vertices - middle) @ turn.T + middle, faces


def _vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """(n, 3) unit normals of vertices: of the faces round them, weighted by area."""
    normals, of_faces = np.zeros_like(mesh.vertices), mesh.area_vectors
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], of_faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    return normals
