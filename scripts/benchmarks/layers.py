"""Print how many scans of views that are shifted against each other have "double walls".

Simulated people, animals and hands are scanned, and each view is moved and turned in a random direction; the
errors are those of a body of 1.7 m. A scan is found if the check is not passed. The last columns are the part
of the surface with layers: the least, the median and the largest of all scans.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.measuring import (
    Column,
    Table,
    all_in_workers,
    argument_parser,
    print_lines,
)
from benchmarks.simulation import POSES, RigOptions, body, make_subject, scan_views
from pcretrieve.checks import findings_of
from pcretrieve.errors import InputError
from pcretrieve.options import ScanOptions
from pcretrieve.points import clean, crop, oriented_normals
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

# How far each view is moved, and by how much it is turned: millimetres, degrees.
ERRORS = ((0.0, 0.0), (1.0, 0.1), (2.0, 0.15), (6.0, 0.5), (12.0, 1.5))
# The diagonal of a body of 1.7 m; millimetres.
DIAGONAL = 1800.0

SENSORS = ("nine cameras", "turntable", "four cameras", "two laps")
NUMBERS = (8_000, 40_000, 200_000)
NOISES = (0.0002, 0.001, 0.003)

# Each seed has one body of each family, in the next pose.
FAMILIES = ("person", "person", "animal", "hand")

# Points that a camera sees of a surface that is sampled uniformly: the least cosine of the incidence.
LEAST_COSINE = 0.2

# Mean number of the four cameras that see a point.
N_SEEING = 1.6

# Number of points of the rig's images of 240 pixels, and the part of it that is asked for.
RIG_POINTS = 14_000
SPARE = 1.35

TABLE = Table(
    Column("error", 14, align="<"),
    Column("noise", 6, ".2%"),
    Column("points", 8, "d"),
    Column("scans", 6, "d"),
    Column("found", 6, "d"),
    Column("failed", 7, "d"),
    *(Column(title, 7, ".1%") for title in ("least", "median", "largest")),
)


class Case(NamedTuple):
    """A scan of a body with an error of registration."""

    seed: int
    family: str
    sensor: str
    n_points: int
    noise: float
    error: tuple[float, float]


class Found(NamedTuple):
    """The share of the surface with layers, and the outcome of the check."""

    case: Case
    share: float
    outcome: str


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[101], help="of the bodies"
    )
    parser.add_argument(
        "--points", type=int, nargs="+", default=NUMBERS, help="of the scans"
    )
    given = parser.parse_args(arguments)
    print_lines(_lines(given.seeds, given.points))


def _lines(seeds: Sequence[int], numbers: Sequence[int]) -> Iterator[str]:
    yield TABLE.head
    for error, noise, n in product(ERRORS, NOISES, numbers):
        cases = [
            Case(seed, FAMILIES[(number + seed) % len(FAMILIES)], sensor, n, noise, error)
            for seed in seeds
            for number, sensor in enumerate(SENSORS)
        ]
        found = all_in_workers(_found, cases, "layers")
        shares = np.array([one.share for one in found])
        outcomes = [one.outcome for one in found]
        title = f"{error[0]:g} mm, {error[1]:g}°"
        n_found = len(outcomes) - outcomes.count("passed")
        least, median, largest = np.quantile(shares, [0, 0.5, 1])
        yield TABLE.row(
            *(title, noise, n, len(found), n_found, outcomes.count("failed")),
            *(least, median, largest),
        )


def _found(case: Case) -> Found:
    """Scan a body, shift the views, and check the points."""
    rng = np.random.default_rng(
        (case.seed, SENSORS.index(case.sensor), case.n_points, round(1e4 * case.noise))
    )
    mesh = _mesh(case.family, case.seed, int(rng.integers(1 << 16)))
    views = _views(mesh, case, rng)
    middle = mesh.vertices.mean(axis=0)
    move, turn = case.error[0] / DIAGONAL * mesh.diagonal, np.radians(case.error[1])
    placed = []
    for points in views:
        axis, direction = (
            vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3))
        )
        rotation = Rotation.from_rotvec(turn * axis).as_matrix()
        placed.append((points - middle) @ rotation.T + middle + move * direction)
    scan = crop(PointCloud(np.concatenate(placed)), ScanOptions())
    cleaned, neighbors = clean(scan, ScanOptions())
    cloud = oriented_normals(cleaned, ScanOptions(), neighbors)
    checks = {one.name: one for one in findings_of(cloud, None, None, None).checks}
    walls = checks["Double walls"]
    return Found(case, walls.value or 0.0, walls.outcome)


@cache
def _mesh(family: str, seed: int, draw: int) -> TriangleMesh:
    """A body in one of the poses without contacts; of some seeds of hands, the next that has a skin."""
    names = sorted(POSES[family])
    for attempt in range(seed, seed + 100_000, 1000):
        try:
            subject = make_subject(family, np.random.default_rng(attempt))
            return body(subject, POSES[family][names[draw % len(names)]])
        except InputError:  # its limbs overlap at rest
            continue
    raise InputError(f"no subject of the family {family} has a skin from the seed {seed}")


def _views(mesh: TriangleMesh, case: Case, rng: np.random.Generator) -> list[FloatArray]:
    """The points of each view, in the frame of the mesh."""
    pixels = max(180, round(240 * np.sqrt(SPARE * case.n_points / RIG_POINTS)))
    rig = RigOptions(pixels=pixels, n_points=case.n_points, noise=case.noise)
    if case.sensor == "turntable":
        rig = RigOptions(
            n_views=16,
            elevations=(8.0,),
            pixels=pixels,
            n_points=case.n_points,
            noise=case.noise,
        )
    if case.sensor in ("nine cameras", "turntable"):
        return [view.points for view in scan_views(mesh, rig, rng)]

    def noisy(points: FloatArray) -> FloatArray:
        return points + rng.normal(0, case.noise * mesh.diagonal, points.shape)

    if case.sensor == "two laps":
        return [noisy(uniform_points(mesh, case.n_points // 2, rng)[0]) for _ in range(2)]
    points, faces = uniform_points(mesh, round(case.n_points / N_SEEING), rng)
    normals = mesh.area_vectors[faces] / mesh.face_areas[faces, np.newaxis]
    azimuths = np.arange(4) * np.pi / 2
    looks = np.stack([np.cos(azimuths), np.zeros(4), np.sin(azimuths)], axis=1)
    return [noisy(points[normals @ look > LEAST_COSINE]) for look in looks]
