"""Scans of bodies by several sensors, and what damages them.

Lengths are relative to the diagonal of a body, to its height, or to its length, so that one sensor can scan
hands and horses. The y axis points up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.bodies import Body, Mask, is_outside, open_edges
from benchmarks.simulation import RigOptions, camera_pose, scan
from benchmarks.simulation.scanner import outside_holes, strays
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.retrieval import Positions
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.geometry import edge_graph
from pcretrieve.values.topology import components

# --- uniform points -----------------------------------------------------------------------------------------

# Noise, relative to the diagonal; strays, relative to the points; rays that look for the outside.
NOISE, STRAYS, N_RAYS = 0.001, 0.003, 48

# Number of points and of holes of the scans that the benchmark calls typical (benchmarks.fidelity).
N_TYPICAL, N_HOLES = 30_000, 6

# Least and largest radius of these holes, relative to the length of the body: 1 to 3 % of the diagonal of a
# person. The diagonal of a machine part is half as long again beside its length, so that holes of 3 % of it
# would be wider than the hole that is a damage.
HOLES = (0.0115, 0.0345)


def outer_points(
    mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> tuple[FloatArray, Positions]:
    """(n, 3) random points of the part of a surface that is seen from outside, and (n,) their faces."""
    points, faces = np.zeros((n, 3)), np.zeros(n, dtype=np.intp)
    missing = np.arange(n)
    while len(missing):
        points[missing], faces[missing] = uniform_points(mesh, len(missing), rng)
        normals = (
            mesh.area_vectors[faces[missing]]
            / mesh.face_areas[faces[missing], np.newaxis]
        )
        missing = missing[~is_outside(mesh, points[missing], normals, N_RAYS)]
    return points, faces


def noisy(
    mesh: TriangleMesh,
    points: FloatArray,
    rng: np.random.Generator,
    noise: float = NOISE,
) -> FloatArray:
    """Points with isotropic noise, relative to the diagonal."""
    return np.asarray(points + rng.normal(0, noise * mesh.diagonal, points.shape))


def _uniform(
    mesh: TriangleMesh, n: int, n_holes: int, rng: np.random.Generator
) -> FloatArray:
    """Uniform points with noise, holes of several radii, and strays."""
    points, _ = outer_points(mesh, n, rng)
    centres, _ = uniform_points(mesh, n_holes, rng)
    kept, length = np.ones(n, dtype=bool), _length(mesh)
    for centre in centres:
        radius = float(rng.uniform(*HOLES)) * length
        kept &= outside_holes(points, centre[np.newaxis], radius)
    return np.concatenate(
        [noisy(mesh, points[kept], rng), strays(mesh, round(STRAYS * n), rng)]
    )


# --- a depth camera beside a turntable ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DepthOptions:
    """A depth camera that is turned round a body; lengths are relative to the height of the body.

    n_views, elevations: views at equal angles, and their angles above the horizon, in turn; degrees.
    pixels: side of the square pictures; pixels.
    n_points: largest number of points of all views.
    step, noise: steps of the depth, and its noise before rounding; those of a body as tall as a person.
    slip, tilt: errors of the registration of a view: of coordinates, and of angles; degrees.
    """

    n_views: int = 16
    elevations: tuple[float, ...] = (8.0,)
    pixels: int = 260
    n_points: int = 40_000
    step: float = 0.002 / 1.7
    noise: float = 0.0008 / 1.7
    slip: float = 0.0009 / 1.7
    tilt: float = 0.06


# Angles of incidence at which the first measurements are lost, and all; degrees.
FIRST_LOST, ALL_LOST = 70.0, 86.0

# Share of the height from below that is not seen, and the largest share of it of the scalp, from the crown.
SOLES, SCALP = 0.02, 0.075

# Shares of the scalp of which nothing comes back, and the number and width of its patches.
LOST_HAIR, N_PATCHES, PATCH = (0.3, 0.6), 14, 0.02


def _turntable(
    body: Body,
    rng: np.random.Generator,
    options: DepthOptions = DepthOptions(),
) -> FloatArray:
    """Points of all views of one camera, without what such a camera does not see of soles and hair."""
    mesh, height = body.mesh, _height(body.mesh)
    points = depth_views(mesh, options, rng)
    points = points[points[:, 1] > mesh.vertices[:, 1].min() + SOLES * height]
    if "crown" in body.places:
        points = points[
            ~_lost_hair(points, mesh.vertices[body.places["crown"]], height, rng)
        ]
    return np.asarray(points[rng.permutation(len(points))[: options.n_points]])


def depth_views(
    mesh: TriangleMesh, options: DepthOptions, rng: np.random.Generator
) -> FloatArray:
    """(n, 3) the points of all views, merged with the errors of a registration."""
    height = _height(mesh)
    rig = RigOptions(n_views=options.n_views, elevations=options.elevations)
    scene = RayScene(mesh.vertices, mesh.faces)
    rays = _pixel_rays(rig.distance, options.pixels)
    middle = mesh.vertices.mean(axis=0)
    views = []
    for view in range(options.n_views):
        pose = camera_pose(mesh, rig, view)
        aimed = rays @ pose[:3, :3].T
        depth, normals, _ = scene.cast(np.broadcast_to(pose[:3, 3], aimed.shape), aimed)
        hit = np.isfinite(depth)
        cosines = -np.einsum("ij,ij->i", aimed[hit], normals[hit])
        cosines /= np.linalg.norm(aimed[hit], axis=1)
        angle = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        lost = (angle - FIRST_LOST) / (ALL_LOST - FIRST_LOST)
        kept = np.flatnonzero(hit)[rng.random(len(lost)) > lost]
        # A ray has the length 1 along the axis of the camera, so that its measure is the depth.
        measured = depth[kept] + rng.normal(0, options.noise * height, len(kept))
        step = options.step * height
        measured = step * np.round(measured / step)
        points = pose[:3, 3] + measured[:, np.newaxis] * aimed[kept]
        turn = Rotation.from_euler("xyz", rng.normal(0, options.tilt, 3), degrees=True)
        slip = rng.normal(0, options.slip * height, 3)
        views.append((points - middle) @ turn.as_matrix().T + middle + slip)
    return np.concatenate(views)


def _pixel_rays(distance: float, pixels: int) -> FloatArray:
    """(p², 3) rays through the pixels, of which the third coordinate, along the axis, is 1."""
    # The field of view holds the bounding sphere.
    half = 0.5 / np.sqrt(distance**2 - 0.25)
    ticks = half * ((2 * np.arange(pixels) + 1) / pixels - 1)
    across, down = np.meshgrid(ticks, ticks)
    return np.column_stack([across.ravel(), down.ravel(), np.ones(pixels**2)])


def _lost_hair(
    points: FloatArray, crown: FloatArray, height: float, rng: np.random.Generator
) -> Mask:
    """(n,) whether points are in patches of the scalp that do not answer."""
    apart = np.linalg.norm(points - crown, axis=1)
    scalp = np.flatnonzero(apart < SCALP * height)
    lost = np.zeros(len(points), dtype=bool)
    if not len(scalp):
        return lost
    centres = points[rng.choice(scalp, N_PATCHES)]
    near = cKDTree(centres).query(points[scalp], k=N_PATCHES)[0]  # (s, patches)
    signs = rng.choice([-1.0, 1.0], N_PATCHES)
    order = cKDTree(centres).query(points[scalp], k=N_PATCHES)[1]
    answer = (signs[order] * np.exp(-0.5 * (near / (PATCH * height)) ** 2)).sum(axis=1)
    lost[scalp] = answer < np.quantile(answer, rng.uniform(*LOST_HAIR))
    return lost


def _height(mesh: TriangleMesh) -> float:
    """The largest extent of a body."""
    return float(np.ptp(mesh.vertices, axis=0).max())


def _length(mesh: TriangleMesh) -> float:
    """The distance of two vertices that are about as far apart as any: the height of a person who stands."""
    apart = np.linalg.norm(mesh.vertices - mesh.vertices.mean(axis=0), axis=1)
    for _ in range(3):  # to the farthest vertex and on
        apart = np.linalg.norm(mesh.vertices - mesh.vertices[apart.argmax()], axis=1)
    return float(apart.max())


# Nine cameras, the lowest of which see soles at more than the largest angle of incidence (benchmarks.people).
NINE_ABOVE = RigOptions(elevations=(5.0, 45.0, -12.0), n_points=20_000)

SENSORS: dict[str, Callable[[Body, np.random.Generator], FloatArray]] = {
    "nine": lambda body, rng: scan(body.mesh, RigOptions(), rng).points,
    "uniform": lambda body, rng: _uniform(body.mesh, N_TYPICAL, N_HOLES, rng),
    "turntable": _turntable,
    "sparse": lambda body, rng: _uniform(body.mesh, 10_000, 0, rng),
    "dense": lambda body, rng: _uniform(body.mesh, 200_000, 0, rng),
    "above": lambda body, rng: scan(body.mesh, NINE_ABOVE, rng).points,
}
"""Sensors by their names: functions that return the points of a body, (n, 3), in its frame."""


# --- sensors drawn at random --------------------------------------------------------------------------------

KINDS = ("cameras", "uniform", "turntable", "steps")

# Number of points, of most scans and of one in ten; by their logarithms.
USUAL_POINTS, MORE_POINTS, SHARE_OF_MORE = (8_000, 60_000), (60_000, 200_000), 0.1

# Noise relative to the diagonal, by its logarithm; and the largest share of strays.
NOISES, MOST_STRAYS = (0.0002, 0.003), 0.005

# Number of views, and their elevations: one of three is level, one looks down and one looks up; degrees.
VIEWS, LEVEL, DOWN, UP = (4, 40), (-5.0, 15.0), (15.0, 60.0), (-45.0, -5.0)

# Steps of the depth relative to the height: 1 to 5 mm of a person.
STEPS = (0.0006, 0.003)

# Number of holes, and their radii relative to the length of the body, by their logarithms.
MOST_HOLES, RADII = 8, (0.005, 0.04)

# How often a place is not seen, its radius and the height of unseen soles, relative to the height.
UNSEEN, UNSEEN_RADIUS, UNSEEN_SOLES = 0.25, (0.02, 0.05), (0.005, 0.025)


def drawn(kind: str, body: Body, rng: np.random.Generator) -> FloatArray:
    """(n, 3) the points of a body by a sensor of some kind, whose numbers are drawn at random."""
    mesh = body.mesh
    n = round(
        _between(MORE_POINTS if rng.random() < SHARE_OF_MORE else USUAL_POINTS, rng)
    )
    noise, n_views = _between(NOISES, rng), int(rng.integers(VIEWS[0], VIEWS[1] + 1))
    elevations = tuple(float(rng.uniform(*each)) for each in (LEVEL, DOWN, UP))
    if kind == "uniform":
        points = noisy(mesh, outer_points(mesh, n, rng)[0], rng, noise)
    elif kind == "cameras":
        rig = RigOptions(
            n_views=n_views,
            elevations=elevations,
            n_points=None,
            noise=noise,
            n_holes=0,
            outlier_share=0.0,
        )
        points = scan(mesh, rig, rng).points
    else:
        depth = DepthOptions(
            n_views=max(8, n_views) if kind == "turntable" else n_views,
            elevations=elevations[:1] if kind == "turntable" else elevations,
            n_points=n,
            step=_between(STEPS, rng),
            noise=noise,
        )
        look = _turntable if kind == "turntable" else _seen
        points = look(body, rng, depth)
    points = _incomplete(points[rng.permutation(len(points))[:n]], body, rng)
    n_strays = round(rng.uniform(0, MOST_STRAYS) * len(points))
    return np.concatenate([points, strays(mesh, n_strays, rng)])


def _seen(body: Body, rng: np.random.Generator, options: DepthOptions) -> FloatArray:
    """Points of a body by a depth camera that loses neither soles nor hair."""
    return depth_views(body.mesh, options, rng)


def _between(limits: tuple[float, float], rng: np.random.Generator) -> float:
    """A number between two limits, whose logarithm is uniform."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def _incomplete(points: FloatArray, body: Body, rng: np.random.Generator) -> FloatArray:
    """Points of a scan without holes, and sometimes without the soles and the places of a body."""
    mesh, height, length = body.mesh, _height(body.mesh), _length(body.mesh)
    kept = np.ones(len(points), dtype=bool)
    for centre in uniform_points(mesh, int(rng.integers(MOST_HOLES + 1)), rng)[0]:
        kept &= outside_holes(points, centre[np.newaxis], _between(RADII, rng) * length)
    for vertex in body.places.values():
        if rng.random() < UNSEEN:
            radius = float(rng.uniform(*UNSEEN_RADIUS)) * height
            kept &= outside_holes(points, mesh.vertices[[vertex]], radius)
    if rng.random() < UNSEEN:
        kept &= points[:, 1] > mesh.vertices[:, 1].min() + height * rng.uniform(
            *UNSEEN_SOLES
        )
    return np.asarray(points[kept])


# --- damages ------------------------------------------------------------------------------------------------

WHOLE, PAIR = "whole", "pair"
DAMAGES = ("limb", "hole", "side")

# The limb that is missing, relative to the largest extent of the body, and the width of the hole, relative to
# the length of the body.
LIMB, HOLE = 0.22, 0.08

# Share of the points that are left on the sparse side.
SPARSE = 0.1


def left_by(
    damage: str, points: FloatArray, body: Body, rng: np.random.Generator
) -> Mask:
    """(n,) whether a damage leaves points of a scan."""
    height = _height(body.mesh)
    if damage == "hole":
        centre = points[rng.integers(len(points))]
        return np.asarray(
            np.linalg.norm(points - centre, axis=1) >= HOLE * _length(body.mesh) / 2
        )
    if damage == "limb":
        near = cKDTree(body.mesh.vertices).query(points)[1]
        return np.asarray((_from_an_end(body.mesh, rng) >= LIMB * height)[near])
    if damage == "side":
        sparse = (points[:, 0] > np.median(points[:, 0])) == (rng.random() < 0.5)
        return np.asarray(~sparse | (rng.random(len(points)) < SPARSE))
    return np.ones(len(points), dtype=bool)


# A body has four limbs and a head. Ends with a smaller share of the surface are tails of dogs and horses,
# those with a larger one are no ends.
N_ENDS, SHARES = 5, (0.02, 0.3)

# Largest squared length of the cut relative to the area of what is cut off: 2 π radius / length for limbs,
# 4 π for patches of a trunk. It is measured along the edges of faces, which makes it longer.
ROUND = 5.0

# Number of extremities that are looked at, of which some are ends of one limb.
N_EXTREMITIES = 12


def _from_an_end(mesh: TriangleMesh, rng: np.random.Generator) -> FloatArray:
    """(n,) geodesic distances of the vertices from the end of a random limb."""
    reach = LIMB * _height(mesh)
    extremities = list(islice(_from_extremities(mesh), N_EXTREMITIES))
    ends = [paths for paths in extremities if _is_limb(mesh, paths < reach)][:N_ENDS]
    return ends[int(rng.integers(len(ends)))] if ends else extremities[0]


def _is_limb(mesh: TriangleMesh, inside: Mask) -> bool:
    """Whether vertices are the end of a limb: the cut is short, and leaves the rest in one piece."""
    cut_off = inside[mesh.faces].all(axis=1)
    area = float(mesh.face_areas[cut_off].sum())
    if not SHARES[0] < area / mesh.area < SHARES[1]:
        return False
    rest = TriangleMesh(mesh.vertices, mesh.faces[~cut_off])
    rim = open_edges(mesh.faces[cut_off])
    length = np.linalg.norm(
        mesh.vertices[rim[:, 0]] - mesh.vertices[rim[:, 1]], axis=1
    ).sum()
    return bool(components(rest).max() == 0 and length**2 / area < ROUND)


def _from_extremities(mesh: TriangleMesh) -> Iterator[FloatArray]:
    """(n,) lengths of the shortest paths along edges from one extremity of a body after the other.

    The extremities are found by farthest-point sampling that begins in the middle of the body.
    """
    graph = edge_graph(mesh)  # symmetric
    place = np.linalg.norm(mesh.vertices - mesh.vertices.mean(axis=0), axis=1).argmin()
    apart = dijkstra(graph, indices=np.array([place]))[0]
    while True:
        place = np.where(np.isfinite(apart), apart, 0).argmax()
        distances = dijkstra(graph, indices=np.array([place]))[0]
        apart = np.minimum(apart, distances)
        yield distances


# How far one body is pushed into another after they touch, relative to the diagonal; the largest angle of the
# push to the direction ahead, in degrees; and of how many ways that are tried the one is taken by which
# their middles come nearest to each other, so that not only their fingers touch.
PUSH, ASIDE, N_WAYS = (0.01, 0.03), 35.0, 6


def pressed(one: Body, other: Body, rng: np.random.Generator) -> Body:
    """Two bodies of one size as one, the other pushed into the first from its front."""
    a, b = one.mesh, other.mesh
    # Sets have several units: beside a horse of TOSCA, a simulated animal would be a speck.
    b = TriangleMesh(b.vertices * (a.diagonal / b.diagonal), b.faces)
    placed = min((_touching(a, b, rng) for _ in range(N_WAYS)), key=lambda way: way[0])[1]
    faces = np.concatenate([a.faces, b.faces + len(a.vertices)])
    both = TriangleMesh(np.concatenate([a.vertices, placed]), faces)
    return Body(f"{one.name}+{other.name}", one.label, both, one.places)


def _touching(
    a: TriangleMesh, b: TriangleMesh, rng: np.random.Generator
) -> tuple[float, FloatArray]:
    """The vertices of a mesh that is turned at random and pushed into another, and how far apart they are."""
    turn = Rotation.from_euler("y", rng.uniform(-180, 180), degrees=True).as_matrix()
    azimuth = np.radians(rng.uniform(-ASIDE, ASIDE))
    ahead = np.array([np.sin(azimuth), 0, np.cos(azimuth)])
    away = a.diagonal + b.diagonal
    placed = (b.vertices - b.vertices.mean(axis=0)) @ turn.T + a.vertices.mean(axis=0)
    placed[:, 1] += a.vertices[:, 1].min() - placed[:, 1].min()
    placed += away * ahead
    # They touch where a vertex of one first meets the surface of the other.
    gaps = [
        RayScene(placed, b.faces).cast(
            a.vertices, np.broadcast_to(ahead, a.vertices.shape)
        )[0],
        RayScene(a.vertices, a.faces).cast(placed, np.broadcast_to(-ahead, placed.shape))[
            0
        ],
    ]
    gap = min(float(each.min()) for each in gaps)
    gap = (away if np.isinf(gap) else gap) + float(rng.uniform(*PUSH)) * a.diagonal
    return away - gap, placed - gap * ahead
