"""Closed bodies without poses, drawn at random: bones like femurs, and parts of machines."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh.remesh import subdivide_to_size

from pcretrieve.surface.marching import level_set
from pcretrieve.values import FloatArray, IntArray, TriangleMesh
from pcretrieve.values.repair import outward
from pcretrieve.values.topology import compact

#: A distance of (..., 3) points from a surface, negative inside; exact or a bound of it.
Field = Callable[[FloatArray], FloatArray]

Point = Sequence[float] | FloatArray


# Turns about x and z of a body on its first side, degrees: tilted, so that a camera beside a turntable sees
# flat tops and all of the bottom but an edge.
TILT = (25.0, 20.0)


def lying(mesh: TriangleMesh, side: int) -> TriangleMesh:
    """The mesh on one of its sides."""
    angles = (TILT[0] + 90 * side, 37 * side, TILT[1] + 14 * side)
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    return TriangleMesh(mesh.vertices @ turn.T, mesh.faces)


# --- fields -------------------------------------------------------------------------------------------------


def _cone(start: Point, end: Point, radii: tuple[float, float]) -> Field:
    """A rod between two balls."""
    a, b = np.array(start), np.array(end)

    def field(points: FloatArray) -> FloatArray:
        along = ((points - a) @ (b - a) / ((b - a) @ (b - a))).clip(0, 1)
        apart = np.linalg.norm(points - a - along[..., np.newaxis] * (b - a), axis=-1)
        return np.asarray(apart - radii[0] - along * (radii[1] - radii[0]))

    return field


def _ellipsoid(centre: Point, radii: Sequence[float]) -> Field:
    def field(points: FloatArray) -> FloatArray:
        scaled = np.linalg.norm((points - np.array(centre)) / np.array(radii), axis=-1)
        return np.asarray((scaled - 1) * min(radii))

    return field


def _union(fields: Sequence[Field], blend: float) -> Field:
    """The union of bodies, with fillets as wide as `blend`."""

    def field(points: FloatArray) -> FloatArray:
        found = fields[0](points)
        for other in (one(points) for one in fields[1:]):
            if blend == 0:
                found = np.minimum(found, other)
                continue
            mixed = (0.5 + 0.5 * (other - found) / blend).clip(0, 1)
            found = other + mixed * (found - other) - blend * mixed * (1 - mixed)
        return np.asarray(found)

    return field


def _meshed(
    field: Field, low: Sequence[float], high: Sequence[float], cell: float
) -> TriangleMesh:
    """The zero level of a field in a box, by marching cubes."""
    axes = [
        np.arange(one - 2 * cell, other + 3 * cell, cell)
        for one, other in zip(low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    vertices, faces = level_set(-field(grid), 0.0)
    return TriangleMesh(vertices * cell + grid[0, 0, 0], faces)


# --- bones --------------------------------------------------------------------------------------------------


def femur(rng: np.random.Generator, number: int) -> TriangleMesh:
    """A long bone with head, neck, two trochanters and two condyles, that stands on the condyles; .45 m."""

    def about(mean: float, spread: float = 0.15) -> float:
        return float(mean * (1 + spread * np.clip(rng.standard_normal(), -2, 2)))

    shaft, bow, neck = about(0.032), about(0.03, 0.5), about(0.085)
    angle = np.radians(about(50, 0.1))
    top = np.array([0.0, 0.86, 0.0])
    head = top + neck * np.array([np.cos(angle), np.sin(angle), about(0.15, 0.5)])
    middle = np.array([about(0.006, 1.0), about(0.47, 0.05), bow])
    knee = np.array([about(0.01, 1.0), 0.10, 0.0])
    trochanter = [about(-0.022, 0.3), top[1] + about(0.045, 0.3), -0.012]
    waist = about(0.95, 0.05) * shaft
    fields = [
        _union(
            [
                _cone(knee, middle, (about(1.25) * shaft, waist)),
                _cone(middle, top, (waist, about(1.15) * shaft)),
            ],
            0,
        ),
        _cone(top, head, (about(0.034), about(0.030, 0.1))),
        _ellipsoid(head, [about(0.052, 0.08)] * 3),
        _cone(top, trochanter, (0.036, about(0.028))),
        _ellipsoid([0.028, about(0.80, 0.02), -0.026], [about(0.018)] * 3),
    ]
    apart = about(0.046, 0.1)
    for sign in (-1, 1):
        centre = [knee[0] + sign * apart, 0.055, about(-0.016, 0.3)]
        fields.append(_ellipsoid(centre, [about(0.038), about(0.045), about(0.062)]))
        fields.append(_cone(knee, centre, (1.2 * shaft, 0.03)))
    mesh = _meshed(_union(fields, 0.025), [-0.13, 0, -0.12], [0.16, 1.05, 0.12], 0.0095)
    return TriangleMesh(0.45 * mesh.vertices, mesh.faces)


# --- parts of machines --------------------------------------------------------------------------------------

# Longest edges of parts, relative to their diagonals, from coarse to fine.
EDGES = (0.03, 0.05, 0.02)


def machine_part(rng: np.random.Generator, number: int) -> TriangleMesh:
    """A bracket, a shaft, a gear, a pipe and others in turn, with flat faces and sharp edges; .2 m."""
    make = PARTS[number % len(PARTS)]
    mesh = make(rng)
    edge = EDGES[number // len(PARTS) % len(EDGES)] * mesh.diagonal
    vertices, faces = subdivide_to_size(mesh.vertices, mesh.faces, edge)  # type: ignore[no-untyped-call]
    merged, inverse = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    solid = compact(merged, inverse.reshape(-1)[faces].astype(np.int32))
    solid, _ = outward(solid)
    return TriangleMesh(0.2 * solid.vertices / solid.diagonal, solid.faces)


def _extruded(
    outline: FloatArray, height: float, kernel: Sequence[float] = (0, 0)
) -> TriangleMesh:
    """A prism over a polygon (n, 2), all of which is seen from a point."""
    n = len(outline)
    after = np.roll(np.arange(n), -1)
    around = np.arange(n)
    rings = [
        np.column_stack([outline[:, 0], np.full(n, y), outline[:, 1]])
        for y in (0, height)
    ]
    middles = np.array([[kernel[0], y, kernel[1]] for y in (0, height)])
    vertices = np.concatenate([*rings, middles])
    low, high = np.full(n, 2 * n), np.full(n, 2 * n + 1)
    faces = np.concatenate(
        [
            np.column_stack([around, after, low]),
            np.column_stack([after + n, around + n, high]),
            np.column_stack([around, around + n, after + n]),
            np.column_stack([around, after + n, after]),
        ]
    )
    return TriangleMesh(vertices, faces.astype(np.int32))


def _revolved(profile: FloatArray, n: int, *, closed: bool = False) -> TriangleMesh:
    """A profile (k, 2) of radius and height turned about y; on the axis at both ends unless it is closed."""
    angles = 2 * np.pi * np.arange(n) / n
    inner = profile if closed else profile[1:-1]
    k = len(inner)
    vertices = np.stack(
        [
            inner[:, :1] * np.cos(angles),
            np.repeat(inner[:, 1:], n, axis=1),
            inner[:, :1] * np.sin(angles),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ring, turn = np.arange(n), np.roll(np.arange(n), -1)
    faces: list[IntArray] = []
    for row in range(k if closed else k - 1):
        low, high = row * n, (row + 1) % k * n
        faces.append(np.column_stack([low + ring, high + ring, high + turn]))
        faces.append(np.column_stack([low + ring, high + turn, low + turn]))
    if not closed:
        ends = [[0, profile[0, 1], 0], [0, profile[-1, 1], 0]]
        vertices = np.concatenate([vertices, ends])
        faces.append(np.column_stack([ring, turn, np.full(n, k * n)]))
        last = (k - 1) * n
        faces.append(np.column_stack([last + turn, last + ring, np.full(n, k * n + 1)]))
    return TriangleMesh(vertices, np.concatenate(faces).astype(np.int32))


def _bracket(rng: np.random.Generator) -> TriangleMesh:
    wide, tall, thick = rng.uniform(0.6, 1), rng.uniform(0.5, 1), rng.uniform(0.12, 0.25)
    outline = [[0, 0], [wide, 0], [wide, thick], [thick, thick], [thick, tall], [0, tall]]
    return _extruded(np.array(outline), rng.uniform(0.3, 0.7), (thick / 2, thick / 2))


def _cross(rng: np.random.Generator) -> TriangleMesh:
    arm, thick = rng.uniform(0.4, 0.6, 4), rng.uniform(0.08, 0.15)
    corners = []
    for turn, length in enumerate(arm):
        c, s = np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2)
        for x, y in ((length, -thick), (length, thick), (thick, thick)):
            corners.append([c * x - s * y, s * x + c * y])
    return _extruded(np.array(corners), rng.uniform(0.15, 0.4))


def _gear(rng: np.random.Generator) -> TriangleMesh:
    n_teeth, tooth = int(rng.integers(9, 22)), rng.uniform(0.1, 0.2)
    angles = np.repeat(2 * np.pi * np.arange(n_teeth) / n_teeth, 4)
    angles += np.tile(np.array([0.0, 0.08, 0.42, 0.5]) * 2 * np.pi / n_teeth, n_teeth)
    radii = 0.5 - tooth * 0.5 + tooth * np.tile([0.0, 1, 1, 0], n_teeth)
    outline = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    return _extruded(outline, rng.uniform(0.15, 0.4))


def _shaft(rng: np.random.Generator) -> TriangleMesh:
    """A shaft with steps."""
    radii, lengths = rng.uniform(0.06, 0.25, 4), rng.uniform(0.12, 0.4, 4)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    profile = [[0.0, 0.0]]
    for radius, low, high in zip(radii, ends[:-1], ends[1:], strict=True):
        profile += [[radius, low], [radius, high]]
    return _revolved(np.array([*profile, [0.0, ends[-1]]]), 48)


def _filleted(rng: np.random.Generator) -> TriangleMesh:
    """A cylinder with rounded edges on a flange."""
    radius, flange, height = (
        rng.uniform(0.15, 0.25),
        rng.uniform(0.35, 0.5),
        rng.uniform(0.3, 0.9),
    )
    plate, fillet = rng.uniform(0.06, 0.14), rng.uniform(0.03, 0.08)
    angles = np.linspace(0, np.pi / 2, 7)
    foot = np.column_stack(
        [
            radius + fillet - fillet * np.sin(angles),
            plate + fillet - fillet * np.cos(angles),
        ]
    )
    top = np.column_stack(
        [
            radius - fillet + fillet * np.cos(angles),
            plate + height - fillet + fillet * np.sin(angles),
        ]
    )
    profile = [[0, 0], [flange, 0], [flange, plate], *foot, *top, [0, plate + height]]
    return _revolved(np.array(profile), 40)


def _box(rng: np.random.Generator) -> TriangleMesh:
    x, y, z = rng.uniform(0.25, 1, 3)
    return _extruded(np.array([[-x, -z], [x, -z], [x, z], [-x, z]]) / 2, y)


def _pipe(rng: np.random.Generator) -> TriangleMesh:
    """A thick ring: genus 1."""
    inner, outer, height = (
        rng.uniform(0.18, 0.3),
        rng.uniform(0.4, 0.5),
        rng.uniform(0.15, 0.8),
    )
    profile = [[inner, 0], [outer, 0], [outer, height], [inner, height]]
    return _revolved(np.array(profile), 48, closed=True)


def _torus(rng: np.random.Generator) -> TriangleMesh:
    """Genus 1."""
    around = 2 * np.pi * np.arange(24) / 24
    tube = rng.uniform(0.1, 0.2)
    profile = np.column_stack([0.4 + tube * np.cos(around), tube * np.sin(around)])
    return _revolved(profile, 48, closed=True)


PARTS = (_bracket, _shaft, _gear, _filleted, _cross, _torus, _box, _pipe)
