"""A virtual scanner: depth cameras round a surface, with the faults that real ones have.

Lengths in the options are relative to the diagonal of the surface's bounding box, so that one scanner suits a
hand and a horse; lengths in the clouds are in the unit of the surface. The y axis points up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters.open3d import RayScene
from pcretrieve.errors import InputError, OptionError
from pcretrieve.surface.sampling import uniform_points
from pcretrieve.types import FloatArray, PointCloud, TriangleMesh

__all__ = ["RigOptions", "UniformOptions", "camera_pose", "scan", "scan_uniformly", "scan_views"]

# Strays lie in the bounding box of the surface, enlarged by this about its centre.
STRAY_BOX = 1.2

# Sensors that are tried for each point that was seen from everywhere, before it counts as hidden from all: a
# point that one sensor in twenty takes is missed once in seven hundred.
SENSOR_TRIES = 128

# A ray that ends before its point by more than this met something else on the way; relative to the distance.
SAME_PLACE = 1e-3


@dataclass(frozen=True, slots=True)
class RigOptions:
    """Cameras at equal angles round a body, all looking at the centre of its bounding box.

    Attributes
    ----------
    n_views : int, default 9
    distance : float, default 1.5
        From the centre to the cameras; diagonals.
    elevations : tuple of float, default (5, 50, -35)
        Height of the cameras above the horizon, in turn; degrees.
    pixels : int, default 240
        Side of the square images, which just hold the bounding sphere; pixels.
    n_points : int or None, default 14_000
        Points of all views together, strays aside: chosen at random from what the cameras see. None keeps
        all.
    noise : float, default 0.001
        Standard deviation of a depth at normal incidence, along the ray; diagonals. It grows as 1 / cos θ
        with the angle of incidence θ: a ray that misses its pixel's centre by a little meets a slanted
        surface at a depth that is wrong by as much more.
    max_incidence : float, default 78
        Angle between ray and normal beyond which nothing comes back; degrees.
    flying_share : float, default 0.04
        Pixels on depth edges that see both the edge and what is behind it, of all pixels there.
    flying_reach : float, default 0.02
        Jump of depth that makes an edge, and how far behind it flying pixels may lie; diagonals.
    n_holes : int, default 4
        Spots of the surface that no camera sees: too dark, too shiny, or covered.
    hole_radius : float, default 0.015
        Diagonals.
    stray_share : float, default 0.003
        Points anywhere in the bounding box enlarged by a fifth; relative to all others.

    Raises
    ------
    OptionError
        If a value is out of range.
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
    stray_share: float = 0.003

    def __post_init__(self) -> None:
        _at_least(1, n_views=self.n_views, pixels=self.pixels, elevations=len(self.elevations))
        if self.n_points is not None:
            _at_least(1, n_points=self.n_points)
        if not self.distance > 0.5:
            raise OptionError(
                f"distance must exceed 0.5, the radius of the bounding sphere, got {self.distance}"
            )
        if not all(-90 < elevation < 90 for elevation in self.elevations):
            raise OptionError(f"elevations must lie between -90 and 90 degrees, got {self.elevations}")
        if not 0 < self.max_incidence <= 90:
            raise OptionError(f"max_incidence must lie between 0 and 90 degrees, got {self.max_incidence}")
        _at_least(0, noise=self.noise, flying_reach=self.flying_reach)
        _at_least(0, n_holes=self.n_holes, hole_radius=self.hole_radius)
        _shares(flying_share=self.flying_share, stray_share=self.stray_share)


@dataclass(frozen=True, slots=True)
class UniformOptions:
    """Points all over a surface, as if it had been seen from everywhere.

    Attributes
    ----------
    n_points : int, default 30_000
        Before holes are cut.
    noise : float, default 0.001
        Standard deviation of each coordinate; diagonals.
    n_holes : int, default 6
        Balls round random points of the surface, without points.
    hole_radius : float, default 0.02
        Diagonals.
    stray_share : float, default 0.003
        Points anywhere in the bounding box enlarged by a fifth; relative to `n_points`.
    sensors : bool, default False
        Give each point the position of a sensor that could have seen it, somewhere on a sphere round the
        surface as far out as the cameras of `RigOptions`, and leave out the points that no sensor sees.

    Raises
    ------
    OptionError
        If a value is out of range.
    """

    n_points: int = 30_000
    noise: float = 0.001
    n_holes: int = 6
    hole_radius: float = 0.02
    stray_share: float = 0.003
    sensors: bool = False

    def __post_init__(self) -> None:
        _at_least(1, n_points=self.n_points)
        _at_least(0, noise=self.noise, n_holes=self.n_holes, hole_radius=self.hole_radius)
        _shares(stray_share=self.stray_share)


def scan_views(mesh: TriangleMesh, options: RigOptions, rng: np.random.Generator) -> list[PointCloud]:
    """What each camera sees, as one cloud with the camera's position as viewpoint.

    Raises
    ------
    InputError
        If no camera sees any of the surface.
    """
    _check_surface(mesh)
    scene = RayScene(mesh.vertices, mesh.faces)
    holes = uniform_points(mesh, options.n_holes, rng)
    poses = [camera_pose(mesh, options, view) for view in range(options.n_views)]
    seen = [_see(scene, mesh, pose, options, holes, rng) for pose in poses]
    n_seen = sum(map(len, seen))
    if not n_seen:
        raise InputError(
            "the cameras must see the surface, got no point: its faces point inwards, or the holes cover it"
        )
    if options.n_points is not None and options.n_points < n_seen:
        kept = np.zeros(n_seen, dtype=bool)
        kept[rng.choice(n_seen, options.n_points, replace=False)] = True
        ends = np.cumsum([len(points) for points in seen])[:-1]
        seen = [points[part] for points, part in zip(seen, np.split(kept, ends), strict=True)]
    return [
        PointCloud(
            np.concatenate([points, _strays(mesh, round(options.stray_share * len(points)), rng)]),
            viewpoints=pose[:3, 3],
        )
        for pose, points in zip(poses, seen, strict=True)
    ]


def scan(mesh: TriangleMesh, options: RigOptions, rng: np.random.Generator) -> PointCloud:
    """What all cameras see together: the clouds of `scan_views`, one after another."""
    views = scan_views(mesh, options, rng)
    return PointCloud(
        np.concatenate([view.points for view in views]),
        viewpoints=np.concatenate([view.viewpoints for view in views if view.viewpoints is not None]),
    )


def scan_uniformly(mesh: TriangleMesh, options: UniformOptions, rng: np.random.Generator) -> PointCloud:
    """Points drawn from the surface in proportion to area, moved by noise in all directions, with holes."""
    _check_surface(mesh)
    points = uniform_points(mesh, options.n_points, rng)
    points = points[
        _outside(points, uniform_points(mesh, options.n_holes, rng), options.hole_radius * mesh.diagonal)
    ]
    noisy = points + rng.normal(0, options.noise * mesh.diagonal, points.shape)
    strays = _strays(mesh, round(options.stray_share * options.n_points), rng)
    cloud = PointCloud(np.concatenate([noisy, strays]))
    if not options.sensors:
        return cloud
    sensors, seen = _sensors(mesh, points, rng)
    # Strays are nowhere in particular: any sensor may have dreamt them.
    return replace(cloud, viewpoints=np.concatenate([sensors, _around(mesh, len(strays), rng)])).select(
        np.concatenate([seen, np.ones(len(strays), dtype=bool)])
    )


def camera_pose(mesh: TriangleMesh, options: RigOptions, view: int) -> FloatArray:
    """(4, 4) rigid motion from the axes of a camera (x right, y down, z ahead) to those of the surface.

    View 0 stands in front (+z), the next ones follow towards +x; the last column is the camera's position.
    """
    azimuth = 2 * np.pi * view / options.n_views
    elevation = np.radians(options.elevations[view % len(options.elevations)])
    ahead = -np.array(
        [np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)]
    )
    right = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    pose[:3, 3] = _centre(mesh) - options.distance * mesh.diagonal * ahead
    return pose


def _see(
    scene: RayScene,
    mesh: TriangleMesh,
    pose: FloatArray,
    options: RigOptions,
    holes: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, 3) points that one camera sees, strays aside."""
    diagonal, position = mesh.diagonal, pose[:3, 3]
    rays = _rays(options) @ pose[:3, :3].T  # (p², 3)
    depth, normals, _ = scene.cast(np.broadcast_to(position, rays.shape), rays)
    cosine = -np.einsum("ij,ij->i", rays, normals)  # (p²,), negative where a face is seen from inside
    kept = np.isfinite(depth) & (cosine > np.cos(np.radians(options.max_incidence)))
    step = _step_behind(depth.reshape(options.pixels, -1)).ravel()[kept]  # (n,)
    rays, depth, cosine = rays[kept], depth[kept], cosine[kept]

    reach = options.flying_reach * diagonal
    flying = (step > reach) & (rng.random(len(step)) < options.flying_share)
    error = rng.normal(0, options.noise * diagonal, len(depth)) / cosine
    error = np.where(flying, reach * rng.random(len(depth)), error)
    uncovered = _outside(position + depth[:, None] * rays, holes, options.hole_radius * diagonal)
    points: FloatArray = (position + (depth + error)[:, None] * rays)[uncovered]
    return points


def _rays(options: RigOptions) -> FloatArray:
    """(p², 3) unit directions through the pixels, in the camera's axes; the bounding sphere just fits."""
    half = 0.5 / np.sqrt(options.distance**2 - 0.25)  # tangent of half the field of view
    ticks = half * (2 * np.arange(options.pixels) + 1 - options.pixels) / options.pixels  # (p,)
    across, down = np.meshgrid(ticks, ticks)
    rays = np.stack([across.ravel(), down.ravel(), np.ones(options.pixels**2)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays


def _step_behind(depth: FloatArray) -> FloatArray:
    """(p, p) from each pixel's depth to the deepest of its four neighbours; infinite towards the background.

    Meaningless where there is no depth.
    """
    framed = np.pad(depth, 1, constant_values=0)
    around = [framed[:-2, 1:-1], framed[2:, 1:-1], framed[1:-1, :-2], framed[1:-1, 2:]]
    step: FloatArray = np.max(around, axis=0) - np.where(np.isfinite(depth), depth, 0)
    return step


def _sensors(
    mesh: TriangleMesh, points: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(n, 3) sensors at random about the surface, each with a free view of the front of its point on it.

    A sensor takes a point with the probability of the cosine of its incidence, for pixels lie that much more
    thinly on a slanted surface. The second array, (n,), tells whether one did.
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
        taken = (np.abs(reached - 1) < SAME_PLACE) & (cosine > np.maximum(steepest, rng.random(len(hidden))))
        hidden = hidden[~taken]
    seen = np.ones(len(points), dtype=bool)
    seen[hidden] = False
    return sensors, seen


def _around(mesh: TriangleMesh, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) positions of sensors, uniform on a sphere round the surface."""
    directions = rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    there: FloatArray = _centre(mesh) + RigOptions().distance * mesh.diagonal * directions
    return there


def _outside(points: FloatArray, centres: FloatArray, radius: float) -> NDArray[np.bool_]:
    """(n,) whether a point lies in none of the balls."""
    outside = np.ones(len(points), dtype=bool)
    for centre in centres:
        outside &= np.linalg.norm(points - centre, axis=1) >= radius
    return outside


def _strays(mesh: TriangleMesh, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) points anywhere in the enlarged bounding box."""
    extent = np.ptp(mesh.vertices, axis=0)
    strays: FloatArray = _centre(mesh) + STRAY_BOX * extent * rng.uniform(-0.5, 0.5, (n, 3))
    return strays


def _centre(mesh: TriangleMesh) -> FloatArray:
    centre: FloatArray = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    return centre


def _check_surface(mesh: TriangleMesh) -> None:
    if not (len(mesh.faces) and mesh.area > 0):
        raise InputError(f"a scan needs a surface with area, got {len(mesh.faces)} faces without")


def _at_least(bound: int, **options: float) -> None:
    for name, value in options.items():
        if not value >= bound:
            raise OptionError(f"{name} must be at least {bound}, got {value}")


def _shares(**options: float) -> None:
    for name, value in options.items():
        if not 0 <= value <= 1:
            raise OptionError(f"{name} must be a share between 0 and 1, got {value}")
