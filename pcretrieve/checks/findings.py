"""Points, surface and spectrum of a scan → checks, and the places that they name."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pcretrieve.checks.grading import Check
from pcretrieve.checks.stages import (
    base_check,
    fit_checks,
    marks_check,
    mesh_check,
    normal_checks,
    point_checks,
    spectrum_checks,
    surface_checks,
)
from pcretrieve.draw.open3d import RayScene
from pcretrieve.points.density import local_spacings
from pcretrieve.points.neighbors import SPACING_NEIGHBORS, Neighborhoods, nearest
from pcretrieve.surface import SurfaceMarks
from pcretrieve.values import FloatArray, PointCloud, Shape, TriangleMesh

# Number of neighbours with whose normals the normal of a point is compared.
N_NEIGHBORS = 8

# Number of points at which normals are compared and distances to the surface measured, at regular steps. The
# standard error of a fraction of .01 is then .0015.
MEASURED = 5000

# Distance to the nearest point beyond which a face was filled in, in median distances between nearest
# neighbours. If points are distributed uniformly over a surface, the fraction of the surface beyond this
# distance is 1e-6.
FILLED = 4

# Distance to the nearest point beyond which a face was filled in where points are sparse, in spacings there.
# As often exceeded as FILLED, if points are random: their nearest neighbours are half a spacing apart.
FILLED_OF_SPARSE = 2

# Largest cosine of the angle between the normal of a face that was filled in and that of the nearest point
# at which the face closes a cut end. In a hole of a smooth surface the normals agree.
TURNED = 0.3

# Fractions of the surface that are nearer to a point than what "Gaps" and "Largest hole" measure.
COVERED, NEARLY_ALL = 0.95, 0.9999

# Largest distance of voxels that belong to one cut or bridge, relative to the diagonal.
PLACE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """The checks of one scan, and the places that they name.

    spacing: median distance from a point to its nearest neighbour, unit of the file; 0 without points.
    filled: (m,) bool, faces of the surface without a point nearby.
    cuts, bridges: (k, 3) float64, places where parts of the surface that touch were separated, and where a
        loose part was connected.
    """

    checks: tuple[Check, ...] = ()
    spacing: float = 0.0
    filled: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    cuts: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    bridges: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def findings_of(
    cloud: PointCloud | None, mesh: TriangleMesh | None, marks: SurfaceMarks | None, shape: Shape | None
) -> Findings:
    """Check the results of the stages of a scan, up to some stage.

    Returns Findings: lengths are in the unit of the file.
    """
    checks: list[Check] = []
    spacing = 0.0
    filled = np.zeros(0 if mesh is None else len(mesh.faces), dtype=np.bool_)
    cuts = bridges = np.zeros((0, 3))
    if cloud is not None:
        some = slice(None, None, max(1, len(cloud.points) // MEASURED))
        places = np.ascontiguousarray(cloud.points[some])
        distance, near = nearest(
            cloud.points, places, min(N_NEIGHBORS + 1, len(cloud.points))
        )  # itself first
        spacing = float(np.median(distance[:, 1]))
        checks += point_checks(cloud, spacing=spacing)
        if cloud.normals is not None:
            checks += normal_checks(cloud.normals, cloud.normals[some], near[:, 1:])
        if mesh is not None:
            base = np.zeros((0, 3)) if marks is None else marks.base
            filled, fit = _fit(cloud, mesh, places, spacing, base)
            checks += fit
        if marks is not None:
            reach = PLACE * cloud.diagonal
            cuts, bridges = _places(marks.cuts, reach), _places(marks.bridges, reach)
            checks.append(marks_check(len(cuts), len(bridges)))
    if mesh is not None:
        checks += [*surface_checks(mesh), *mesh_check(mesh.provenance)]
    if shape is not None:
        checks += spectrum_checks(shape)
    return Findings(tuple(checks), spacing, filled, cuts, bridges)


def _fit(
    cloud: PointCloud, mesh: TriangleMesh, some: FloatArray, spacing: float, base: FloatArray
) -> tuple[NDArray[np.bool_], list[Check]]:
    """Faces without a point nearby, and the checks of the fit; `base` as in `SurfaceMarks`."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    middles = (a + b + c) / 3
    distance, number = nearest(cloud.points, middles, 1)
    apart, near = distance[:, 0], number[:, 0]  # (m,)
    filled = np.asarray(apart > FILLED * spacing)  # (m,)
    filled[filled] = apart[filled] > FILLED_OF_SPARSE * _spacings(cloud.points, near[filled])
    vectors = mesh.area_vectors
    areas = np.linalg.norm(vectors, axis=1)
    area = areas.sum()
    checks = []
    if len(base):
        on_base = filled.copy()
        on_base[filled] = nearest(base, middles[filled], 1)[0][:, 0] < apart[filled]
        checks.append(base_check(float(areas[on_base].sum() / area), cloud.up is not None))
        apart, areas = np.where(on_base, 0, apart), np.where(on_base, 0, areas)
    ends = 0.0
    if cloud.normals is not None:
        lean = np.einsum("ij,ij->i", vectors, cloud.normals[near])  # area times cosine
        ends = float(areas[filled & (lean < TURNED * areas)].sum() / area)
    order = np.argsort(apart)
    covered = np.searchsorted(np.cumsum(areas[order]), np.array([COVERED, NEARLY_ALL]) * areas.sum())
    gaps, hole = apart[order[np.minimum(covered, len(order) - 1)]] / cloud.diagonal
    # Open3D computes these distances in single precision, so the points are moved near the origin.
    origin = some.mean(axis=0)
    gap = RayScene(mesh.vertices - origin, mesh.faces).distance(some - origin)
    lost = gap > FILLED * spacing
    checks += fit_checks(
        filled=float(areas[filled].sum() / area),
        ends=ends,
        gaps=float(gaps),
        hole=float(hole),
        lost=float(lost.mean()),
        noise=float(np.sqrt((gap[~lost] ** 2).sum() / max((~lost).sum(), 1))) / cloud.diagonal,
    )
    return filled, checks


def _spacings(points: FloatArray, chosen: NDArray[np.intp]) -> FloatArray:
    """The spacing of the points near each of the chosen ones; unit of the file."""
    return local_spacings(Neighborhoods(*nearest(points, points[chosen], SPACING_NEIGHBORS + 1)))


def _places(cells: FloatArray, reach: float) -> FloatArray:
    """Centroids of groups of cells, (p, 3); cells nearer to each other than `reach` are in one group."""
    near = cKDTree(cells).query_pairs(reach, output_type="ndarray") if len(cells) else np.zeros((0, 2), int)
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(cells), len(cells)))
    n, group = connected_components(links, directed=False)
    sums = np.stack([np.bincount(group, cells[:, axis], n) for axis in range(3)], axis=1)
    middles: FloatArray = sums / np.bincount(group, minlength=n)[:, None]
    return middles
