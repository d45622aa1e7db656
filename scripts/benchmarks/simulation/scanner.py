"""A virtual rig: depth cameras round a surface, with the errors of real depth cameras.

Lengths in the options are relative to the diagonal of the bounding box of the surface, so that one rig can
scan hands and horses. Lengths in the clouds are in the unit of the surface. The y axis points up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays.open3d import RayScene
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh


@dataclass(frozen=True, slots=True)
class RigOptions:
    """Cameras at equal angles round a body, all looking at the centre of its bounding box.

    elevations: tuple of float, default (5, 50, -35), angles of the cameras above the horizon, in turn;
        degrees.
    pixels: side of the square images, which just hold the bounding sphere; pixels.
    max_incidence: angle between ray and normal beyond which there is no measurement; degrees.
    flying_share: number of flying pixels, which mix the depths before and behind a depth edge; relative to
        all pixels on depth edges.
    flying_reach: smallest difference of depth at a depth edge, and largest distance of flying pixels behind
        the edge; diagonals.
    """

    n_views: int = 9
    distance: float = 1.5
    elevations: tuple[float, ...] = (5.0, 50.0, -35.0)
    pixels: int = 240
    n_points: int | None = 14_000
    noise: float = 0.001
    max_incidence: float = 78.0
    flying_share: float = 0.04
    flying_reach: float = 0.02
    n_holes: int = 4
    hole_radius: float = 0.015
    outlier_share: float = 0.003


def scan_views(
    mesh: TriangleMesh, options: RigOptions, rng: np.random.Generator
) -> list[PointCloud]:
    """Scan a surface with each camera: a cloud for each, with the position of the camera as viewpoint."""
    scene = RayScene(mesh.vertices, mesh.faces)
    holes, _ = uniform_points(mesh, options.n_holes, rng)
    poses = [camera_pose(mesh, options, view) for view in range(options.n_views)]
    seen = [_see(scene, mesh, pose, options, holes, rng) for pose in poses]
    n_seen = sum(map(len, seen))
    if options.n_points is not None and options.n_points < n_seen:
        kept = np.zeros(n_seen, dtype=bool)
        kept[rng.choice(n_seen, options.n_points, replace=False)] = True
        ends = np.cumsum([len(points) for points in seen])[:-1]
        seen = [
            points[part] for points, part in zip(seen, np.split(kept, ends), strict=True)
        ]
    return [
        PointCloud(
            np.concatenate(
                [points, strays(mesh, round(options.outlier_share * len(points)), rng)]
            ),
            viewpoints=pose[:3, 3],
        )
        for pose, points in zip(poses, seen, strict=True)
    ]


def scan(mesh: TriangleMesh, options: RigOptions, rng: np.random.Generator) -> PointCloud:
    """Scan a surface with all cameras."""
    views = scan_views(mesh, options, rng)
    return PointCloud(
        np.concatenate([view.points for view in views]),
        viewpoints=np.concatenate(
            [view.viewpoints for view in views if view.viewpoints is not None]
        ),
    )


def camera_pose(mesh: TriangleMesh, options: RigOptions, view: int) -> FloatArray:
    """(4, 4) motion from the axes of a camera (x right, y down, z ahead) to those of the surface."""
    azimuth = 2 * np.pi * view / options.n_views
    elevation = np.radians(options.elevations[view % len(options.elevations)])
    ahead = -np.array(
        [
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ]
    )
    right = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    pose[:3, 3] = box_centre(mesh) - options.distance * mesh.diagonal * ahead
    return pose


def _see(
    scene: RayScene,
    mesh: TriangleMesh,
    pose: FloatArray,
    options: RigOptions,
    holes: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """The points that one camera measures, without outliers, (n, 3)."""
    diagonal, position = mesh.diagonal, pose[:3, 3]
    rays = _rays(options) @ pose[:3, :3].T  # (p², 3)
    depth, normals, _ = scene.cast(np.broadcast_to(position, rays.shape), rays)
    # (p²,), negative where a face is seen from inside.
    cosine = -np.einsum("ij,ij->i", rays, normals)
    kept = np.isfinite(depth) & (cosine > np.cos(np.radians(options.max_incidence)))
    step = _step_behind(depth.reshape(options.pixels, -1)).ravel()[kept]  # (n,)
    rays, depth, cosine = rays[kept], depth[kept], cosine[kept]

    reach = options.flying_reach * diagonal
    flying = (step > reach) & (rng.random(len(step)) < options.flying_share)
    error = rng.normal(0, options.noise * diagonal, len(depth)) / cosine
    error = np.where(flying, reach * rng.random(len(depth)), error)
    uncovered = outside_holes(
        position + depth[:, None] * rays, holes, options.hole_radius * diagonal
    )
    return np.asarray((position + (depth + error)[:, None] * rays)[uncovered])


def _rays(options: RigOptions) -> FloatArray:
    """Unit directions through the pixels, (p², 3), in the axes of the camera."""
    # The field of view is the smallest one that contains the bounding sphere.
    half = 0.5 / np.sqrt(options.distance**2 - 0.25)  # tangent of half the field of view
    ticks = (
        half * (2 * np.arange(options.pixels) + 1 - options.pixels) / options.pixels
    )  # (p,)
    across, down = np.meshgrid(ticks, ticks)
    rays = np.stack([across.ravel(), down.ravel(), np.ones(options.pixels**2)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays


def _step_behind(depth: FloatArray) -> FloatArray:
    """The largest depth of the four neighbours of each pixel minus its own depth, (p, p); may be infinite."""
    framed = np.pad(depth, 1, constant_values=0)
    around = [framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:]]
    return np.asarray(np.max(around, axis=0) - np.where(np.isfinite(depth), depth, 0))


# Outliers lie in the bounding box of the surface, enlarged by this factor about its centre.
OUTLIER_BOX = 1.2


def outside_holes(
    points: FloatArray, centres: FloatArray, radius: float
) -> NDArray[np.bool_]:
    """(n,) whether points are outside all holes of a scan, which are balls."""
    outside = np.ones(len(points), dtype=bool)
    for centre in centres:
        outside &= np.linalg.norm(points - centre, axis=1) >= radius
    return outside


def strays(mesh: TriangleMesh, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) random points in the bounding box of a surface, enlarged."""
    extent = np.ptp(mesh.vertices, axis=0)
    return np.asarray(
        box_centre(mesh) + OUTLIER_BOX * extent * rng.uniform(-0.5, 0.5, (n, 3))
    )


def box_centre(mesh: TriangleMesh) -> FloatArray:
    """(3,) centre of the bounding box of a surface."""
    return np.asarray((mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2)
