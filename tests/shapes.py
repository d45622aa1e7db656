"""Surfaces with known geometry, for tests."""

from __future__ import annotations

from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pcretrieve.values import (
    FloatArray,
    IntArray,
    PointCloud,
    Shape,
    Surface,
    TriangleMesh,
)

# Faces of a tetrahedron whose corners 1, 2, 3 run anticlockwise seen from outside its corner 0.
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

# Where the limbs of `body` point, how long they are and how thick: no symmetry, so no eigenvalue is double.
LIMBS = (
    ((1.0, 0.2, 0.1), 1.1, 0.30),
    ((-0.9, 0.5, 0.2), 0.9, 0.32),
    ((0.1, -1.0, 0.3), 1.3, 0.28),
    ((0.2, 0.3, 1.0), 0.7, 0.40),
    ((-0.3, 0.1, -1.0), 1.0, 0.34),
)


def tetrahedron() -> TriangleMesh:
    """Origin and unit vectors: area 3/2 + √3/2, volume 1/6."""
    return TriangleMesh(np.eye(4, 3, k=-1), TETRAHEDRON_FACES)


def two_tetrahedra(shared: Literal["edge", "vertex"]) -> TriangleMesh:
    """A `tetrahedron` and its mirror image in the z axis (they share an edge) or in the origin (a vertex)."""
    one = tetrahedron()
    mirrored = one.vertices * (
        [-1, -1, 1] if shared == "edge" else [-1, -1, -1]
    )  # (4, 3)
    # The first corners of both coincide; so do the last, on the z axis. A point reflection turns faces over.
    numbers = np.array([0, 4, 5, 3] if shared == "edge" else [0, 4, 5, 6])
    faces = numbers[TETRAHEDRON_FACES if shared == "edge" else TETRAHEDRON_FACES[:, ::-1]]
    own = numbers >= 4
    return TriangleMesh(
        np.concatenate([one.vertices, mirrored[own]]), np.concatenate([one.faces, faces])
    )


def icosphere(subdivisions: int, radius: float = 1.0) -> TriangleMesh:
    """A sphere of 20 · 4^subdivisions faces: each face of an icosahedron cut in four, again and again."""
    golden = (1 + np.sqrt(5)) / 2
    rectangle = np.array(
        [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0]]
    )
    directions: FloatArray = np.concatenate(
        [np.roll(rectangle, k, axis=1) for k in range(3)]
    )  # (12, 3)
    near = np.isclose(np.linalg.norm(directions[:, None] - directions, axis=2), 2.0)
    faces = np.array(
        [
            three
            for three in combinations(range(12), 3)
            if near[np.ix_(three, three)].sum() == 6
        ]
    )
    inward = np.linalg.det(directions[faces]) < 0  # (20,)
    faces[inward] = faces[inward, ::-1]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for _ in range(subdivisions):
        sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, numbers = np.unique(sides, axis=0, return_inverse=True)
        # The middle of each side, as a vertex.
        ab, bc, ca = len(directions) + numbers.reshape(-1, 3).T
        directions = np.concatenate([directions, directions[edges].mean(axis=1)])
        a, b, c = faces.T
        faces = np.concatenate(
            [
                np.column_stack(corners)
                for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
            ]
        )
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return TriangleMesh(radius * directions, faces)


def ellipsoid(
    semi_axes: ArrayLike = (1.0, 0.7, 0.5), subdivisions: int = 4
) -> TriangleMesh:
    """An `icosphere`, stretched: volume near 4/3 π abc."""
    sphere = icosphere(subdivisions)
    return TriangleMesh(sphere.vertices * np.asarray(semi_axes), sphere.faces)


def body(subdivisions: int = 4) -> TriangleMesh:
    """A ball with five limbs of different lengths, seen from its middle at one distance each way.

    Distance from the origin: 1 + Σ length · exp((cos angle to the limb − 1) / thickness²).
    """
    sphere = icosphere(subdivisions)
    distance = np.ones(len(sphere.vertices))
    for direction, length, thickness in LIMBS:
        cosine = sphere.vertices @ (np.array(direction) / np.linalg.norm(direction))
        distance += length * np.exp((cosine - 1) / thickness**2)
    return TriangleMesh(distance[:, None] * sphere.vertices, sphere.faces)


def on_sphere(n: int, seed: int = 1) -> FloatArray:
    """Random points on the unit sphere."""
    points = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def torus(
    n_around: int = 48, n_tube: int = 24, *, major: float = 1.0, minor: float = 0.4
) -> TriangleMesh:
    """Area near 4π² major minor, volume near 2π² major minor²; Euler characteristic 0."""
    i, j = np.indices((n_around, n_tube))
    u, v = 2 * np.pi * i / n_around, 2 * np.pi * j / n_tube
    reach = major + minor * np.cos(v)
    vertices = np.stack(
        [reach * np.cos(u), reach * np.sin(u), minor * np.sin(v)], axis=-1
    ).reshape(-1, 3)
    return TriangleMesh(
        vertices, _quads(i, j, (i + 1) % n_around, (j + 1) % n_tube, n_tube)
    )


def cube() -> TriangleMesh:
    """The unit cube, two faces a side."""
    corners = np.indices((2, 2, 2)).reshape(3, -1).T.astype(float)
    sides = [
        [0, 1, 3, 2],
        [4, 6, 7, 5],
        [0, 4, 5, 1],
        [2, 3, 7, 6],
        [0, 2, 6, 4],
        [1, 5, 7, 3],
    ]
    faces = [[a, *two] for a, b, c, d in sides for two in ((b, c), (c, d))]
    return TriangleMesh(corners, np.array(faces))


def square(n: int) -> TriangleMesh:
    """The unit square, n cells a side, each cut in two; facing up."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    i, j = np.indices((n, n))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return TriangleMesh(vertices, _quads(i, j, i + 1, j + 1, n + 1))


def mobius_strip(n_around: int = 30, n_across: int = 4) -> TriangleMesh:
    """One half twist, one side, one boundary of 2 · `n_around` edges; Euler characteristic 0."""
    i, j = np.indices((n_around, n_across + 1))
    u, v = 2 * np.pi * i / n_around, np.linspace(-0.4, 0.4, n_across + 1)[j]
    reach = 1 + v * np.cos(u / 2)
    vertices = np.stack(
        [reach * np.cos(u), reach * np.sin(u), v * np.sin(u / 2)], axis=-1
    ).reshape(-1, 3)
    i, j = i[:, :-1], j[:, :-1]
    faces = _quads(i, j, i + 1, j + 1, n_across + 1)
    # Once around, the strip meets its start upside down.
    past = faces >= n_around * (n_across + 1)
    return TriangleMesh(
        vertices, np.where(past, n_across - (faces - n_around * (n_across + 1)), faces)
    )


def renumbered(mesh: TriangleMesh, seed: int) -> TriangleMesh:
    """The same surface: vertices and faces in another order, each face from another corner."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(mesh.vertices))
    number = np.argsort(order).astype(np.int32)
    faces = number[mesh.faces][rng.permutation(len(mesh.faces))]
    start = rng.integers(3, size=len(faces))
    corners = (start[:, None] + np.arange(3)) % 3
    return TriangleMesh(mesh.vertices[order], np.take_along_axis(faces, corners, axis=1))


def moved(mesh: TriangleMesh, seed: int, *, scale: float = 1.0) -> TriangleMesh:
    """The same surface, turned, shifted and scaled."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    return TriangleMesh(
        scale * (mesh.vertices @ turn.T + 10 * rng.standard_normal(3)), mesh.faces
    )


def shape(mesh: TriangleMesh) -> Shape:
    """A shape of one surface, without a spectrum."""
    return Shape((Surface(mesh.area or 1.0, mesh=mesh),))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """All of them in one mesh, none touching another."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
        ),
    )


def points_on(
    mesh: TriangleMesh, n: int, *, noise: float = 0.0, seed: int = 0
) -> FloatArray:
    """(n, 3) points, uniform by area, with Gaussian noise (relative to the diagonal)."""
    points: FloatArray = oriented_points_on(mesh, n, noise=noise, seed=seed).points.copy()
    return points


def oriented_points_on(
    mesh: TriangleMesh, n: int, *, noise: float = 0.0, seed: int = 0
) -> PointCloud:
    """`points_on`, with the normals of the faces that they come from."""
    rng = np.random.default_rng(seed)
    areas = mesh.face_areas
    face = rng.choice(len(areas), size=n, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), size=n)  # uniform on a triangle
    corners = mesh.vertices[mesh.faces[face]]  # (n, 3, 3)
    points = np.einsum("nk,nkd->nd", weights, corners)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return PointCloud(
        points + noise * mesh.diagonal * rng.standard_normal((n, 3)),
        normals=across / np.linalg.norm(across, axis=1, keepdims=True),
    )


def _quads(
    i: ArrayLike, j: ArrayLike, i1: ArrayLike, j1: ArrayLike, width: int
) -> IntArray:
    """Two faces for each cell of a grid whose vertex (i, j) has number i · `width` + j."""
    a, b, c, d = (
        np.ravel(np.asarray(p) * width + np.asarray(q))
        for p, q in ((i, j), (i1, j), (i1, j1), (i, j1))
    )
    return np.concatenate(
        [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    ).astype(np.int32)
