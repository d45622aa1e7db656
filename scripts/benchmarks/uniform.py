"""Uniform scans of surfaces, of a quality that is set: random points with noise, holes and outliers.

Also exact points of analytic bodies, functions of (n, 3) points that are 0 on a surface and negative inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.simulation import RigOptions
from benchmarks.simulation.scanner import box_centre, outside_holes, strays
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

# Number of sensor positions that are tried for each point before the point is left out as hidden. A point
# that is visible from a twentieth of all positions is left out with a probability of 1 / 700.
SENSOR_TRIES = 128

# Largest difference between the distance of a point and the length of the ray to it, if no other part of the
# surface is between; relative to the distance.
SAME_PLACE = 1e-3


@dataclass(frozen=True, slots=True)
class UniformOptions:
    """Options of a uniform scan. Lengths are relative to the diagonal of the surface."""

    n_points: int = 30_000
    noise: float = 0.001
    n_holes: int = 6
    hole_radius: float = 0.02
    outlier_share: float = 0.003
    sensors: bool = False


def scan_uniformly(
    mesh: TriangleMesh, options: UniformOptions, rng: np.random.Generator
) -> PointCloud:
    """Random points of a surface, uniform by area, with isotropic Gaussian noise, holes and outliers."""
    points, _ = uniform_points(mesh, options.n_points, rng)
    centres, _ = uniform_points(mesh, options.n_holes, rng)
    points = points[outside_holes(points, centres, options.hole_radius * mesh.diagonal)]
    noisy = points + rng.normal(0, options.noise * mesh.diagonal, points.shape)
    strange = strays(mesh, round(options.outlier_share * options.n_points), rng)
    cloud = PointCloud(np.concatenate([noisy, strange]))
    if not options.sensors:
        return cloud
    sensors, seen = _sensors(mesh, points, rng)
    # An outlier is on no surface: any sensor may have measured it.
    viewpoints = np.concatenate([sensors, _around(mesh, len(strange), rng)])
    kept = np.concatenate([seen, np.ones(len(strange), dtype=bool)])
    return replace(cloud, viewpoints=viewpoints).select(kept)


def _sensors(
    mesh: TriangleMesh, points: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Random sensor positions round a surface, one for each point, from which the point is visible.

    A sensor measures a point with a probability equal to the cosine of the angle of incidence, because the
    density of pixels on an inclined surface is proportional to it. Returns positions (n, 3), and whether the
    sensor measures the point (n,): not if none of `SENSOR_TRIES` positions does.
    """
    scene = RayScene(mesh.vertices, mesh.faces)
    steepest = np.cos(np.radians(RigOptions().max_incidence))
    sensors = np.empty_like(points)
    hidden = np.arange(len(points))
    for _ in range(SENSOR_TRIES):
        sensors[hidden] = _around(mesh, len(hidden), rng)
        rays = points[hidden] - sensors[hidden]  # (h, 3)
        reached, normals, _ = scene.cast(sensors[hidden], rays)  # in lengths of the rays
        cosine = -np.einsum("ij,ij->i", rays, normals) / np.linalg.norm(rays, axis=1)
        taken = (np.abs(reached - 1) < SAME_PLACE) & (
            cosine > np.maximum(steepest, rng.random(len(hidden)))
        )
        hidden = hidden[~taken]
    seen = np.ones(len(points), dtype=bool)
    seen[hidden] = False
    return sensors, seen


def _around(mesh: TriangleMesh, n: int, rng: np.random.Generator) -> FloatArray:
    """Random positions of sensors, (n, 3), uniform on a sphere round the surface."""
    directions = rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(
        box_centre(mesh) + RigOptions().distance * mesh.diagonal * directions
    )


def _blob(points: FloatArray) -> FloatArray:
    """Radii that are a sum of spherical harmonics."""
    radius = np.linalg.norm(points, axis=1)
    x, y, z = points.T / radius
    low = 0.1 * (3 * z * z - 1) / 2 + 0.6 * x * y * z + 0.225 * (x * x - y * y) * z
    return np.asarray(radius - 1 - low - 0.06 * (x**4 - 6 * x * x * y * y + y**4))


Body = Callable[[FloatArray], FloatArray]

BODIES: dict[str, Body] = {
    "sphere": lambda p: np.linalg.norm(p, axis=1) - 1,
    "ellipsoid": lambda p: ((p / [1, 0.7, 0.5]) ** 2).sum(axis=1) - 1,
    "torus": lambda p: np.hypot(np.hypot(p[:, 0], p[:, 1]) - 1, p[:, 2]) - 0.4,
    "capsule": lambda p: (
        np.linalg.norm(p - np.clip(p, [-0.8, 0, 0], [0.8, 0, 0]), axis=1) - 0.35
    ),
    "blob": _blob,
    # An oval of Cassini, turned about the line through its foci.
    "dumbbell": lambda p: ((p * p).sum(axis=1) + 1) ** 2 - 4 * p[:, 0] ** 2 - 1.1**4,
}

# Half the side of a cube around each body, and half the thickness of the layer around its surface in which
# points are drawn. The density of their feet varies by the square of the thickness, 2 % at a radius of .2.
HALF_SIDE, LAYER = 1.6, 0.05


def points_of(body: Body, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) random points of the surface of a body, uniform by area."""
    found = np.zeros((0, 3))
    while len(found) < n:
        places = rng.uniform(-HALF_SIDE, HALF_SIDE, (500_000, 3))
        # A blob has no radius at its centre.
        places = places[np.linalg.norm(places, axis=1) > LAYER]
        places = places[np.abs(_above(body, places)[1][:, 0]) < LAYER]
        found = np.concatenate([found, feet(body, places)])
    return found[:n]


def feet(body: Body, points: FloatArray) -> FloatArray:
    """The points of the surface of a body that are nearest to (n, 3) points near it."""
    found = points
    for _ in range(5):  # to the foot in the tangent plane, then down to the surface
        normals, height = _above(body, found)
        apart = points - found
        found = (
            points
            - (apart * normals).sum(axis=1, keepdims=True) * normals
            - height * normals
        )
    return found


def _above(
    body: Body, points: FloatArray, step: float = 1e-5
) -> tuple[FloatArray, FloatArray]:
    """Unit normals (n, 3) and heights (n, 1) above the surface, to first order."""
    steps = step * np.eye(3)
    slope = np.column_stack([body(points + by) - body(points - by) for by in steps]) / (
        2 * step
    )
    steepness = np.linalg.norm(slope, axis=1, keepdims=True)
    return slope / steepness, body(points)[:, None] / steepness
