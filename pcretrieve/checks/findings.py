"""Points, surface and spectrum of a scan → checks, and the places that they name."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks import stages
from pcretrieve.checks.grading import Check
from pcretrieve.draw.open3d import RayScene
from pcretrieve.points.density import local_spacings
from pcretrieve.points.grid import joined_by
from pcretrieve.points.layers import Layers, double_layers
from pcretrieve.points.neighbors import SPACING_NEIGHBORS, Neighborhoods, nearest
from pcretrieve.surface import SurfaceMarks, components
from pcretrieve.values import FloatArray, PointCloud, Shape, TriangleMesh

# Number of neighbours with whose normals the normal of a point is compared.
N_NEIGHBORS = 8

# Number of points at which normals are compared and distances to the surface measured, at regular steps. The
# standard error of a fraction of .01 is then .0015.
MEASURED = 5000

# Distance to the nearest point beyond which a face was filled in, in median distances between nearest
# neighbours, and, where points are sparse, in spacings there. If points are distributed uniformly over a
# surface, their nearest neighbours are half a spacing apart, and the share of the surface beyond is 1e-6.
FILLED = 4
FILLED_OF_SPARSE = 2

# The same beyond which a face may close a cut limb or a hole.
BARE = 1.75
BARE_OF_SPARSE = 0.6

# Of a face that closes a cut limb: the largest cosine between its normal and that of the nearest point, since
# in a smooth hole these agree; the least distance to it, in median spacings; the largest to the middle
# of what closes it, in diagonals; the number of places; and the least likeness to a rim, for floors.
TURNED = 0.8
CLOSING = 1.9
NEAR_END = 0.045
N_ENDS = 10
SHEET = 0.1

# Of a face in a hole that is not explained by occlusion: the least distance to the nearest point, in
# diagonals, and the least share of the hemisphere, weighted by the cosine as for ambient occlusion, that
# surface with points leaves free, unlike folds of a lap; and this share of a face that closes a cut limb.
FAR_OFF = 0.007
OPEN = 0.7
OPEN_END = 0.65
N_RAYS = 64

# Height above a face from which rays are cast, relative to the diagonal: beyond single precision.
ABOVE = 1e-3

# Fraction of the surface that is nearer to a point than what "Gaps" measures.
COVERED = 0.95

# Largest distance of voxels that belong to one cut or bridge, relative to the diagonal.
PLACE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """The checks of one scan, and the places that they name.

    spacing: median distance from a point to its nearest neighbour, unit of the file; 0 without points.
    layers: where points lie in several layers; None without normals.
    filled: (m,) bool, faces of the surface without a point nearby.
    cuts, bridges: (k, 3) float64, places where parts of the surface that touch were separated, and where a
        loose part was connected.
    """

    checks: tuple[Check, ...] = ()
    spacing: float = 0.0
    layers: Layers | None = None
    filled: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    cuts: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    bridges: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def findings_of(
    cloud: PointCloud | None,
    mesh: TriangleMesh | None,
    marks: SurfaceMarks | None,
    shape: Shape | None,
) -> Findings:
    """Check the results of the stages of a scan, up to some stage.

    Returns Findings: lengths are in the unit of the file.
    """
    checks: list[Check] = []
    spacing = 0.0
    layers = None
    filled = np.zeros(0 if mesh is None else len(mesh.faces), dtype=np.bool_)
    cuts = bridges = np.zeros((0, 3))
    if cloud is not None:
        some = slice(None, None, max(1, len(cloud.points) // MEASURED))
        places = np.ascontiguousarray(cloud.points[some])
        distance, near = nearest(cloud.points, places, min(N_NEIGHBORS + 1, len(cloud.points)))
        spacing = float(np.median(distance[:, 1]))
        checks += stages.point_checks(cloud, spacing=spacing)
        if cloud.normals is not None:
            checks += stages.normal_checks(
                cloud.normals, cloud.normals[some], near[:, 1:]
            )  # itself first
            layers = double_layers(cloud)
            checks.append(stages.layers_check(layers, cloud.diagonal))
        if mesh is not None:
            base = np.zeros((0, 3)) if marks is None else marks.base
            filled, fit = _fit(cloud, mesh, places, spacing, base)
            checks += fit
        if marks is not None:
            reach = PLACE * cloud.diagonal
            cuts, bridges = _places(marks.cuts, reach), _places(marks.bridges, reach)
            checks.append(stages.marks_check(len(cuts), len(bridges)))
    if mesh is not None:
        checks += [*stages.surface_checks(mesh), *stages.mesh_check(mesh.provenance)]
    if shape is not None:
        checks += stages.spectrum_checks(shape)
    return Findings(tuple(checks), spacing, layers, filled, cuts, bridges)


def _fit(
    cloud: PointCloud, mesh: TriangleMesh, some: FloatArray, spacing: float, base: FloatArray
) -> tuple[NDArray[np.bool_], list[Check]]:
    """Faces without a point nearby, and the checks of the fit; `base` as in `SurfaceMarks`."""
    diagonal, middles = cloud.diagonal, mesh.vertices[mesh.faces].mean(axis=1)
    distance, number = nearest(cloud.points, middles, 1)
    apart, near = distance[:, 0], number[:, 0]  # (m,)
    local, some_bare = np.zeros(len(apart)), apart > BARE * spacing
    around = nearest(cloud.points, cloud.points[near[some_bare]], SPACING_NEIGHBORS + 1)
    local[some_bare] = local_spacings(Neighborhoods(*around))
    filled = apart > np.maximum(FILLED * spacing, FILLED_OF_SPARSE * local)
    bare = apart > np.maximum(BARE * spacing, BARE_OF_SPARSE * local)
    vectors = mesh.area_vectors
    areas = np.linalg.norm(vectors, axis=1)
    area = areas.sum()
    checks = []
    if len(base):
        on_base = filled.copy()
        on_base[filled] = nearest(base, middles[filled], 1)[0][:, 0] < apart[filled]
        checks.append(stages.base_check(float(areas[on_base].sum() / area), cloud.up is not None))
        apart, areas = np.where(on_base, 0, apart), np.where(on_base, 0, areas)
    order = np.argsort(apart)
    covered = np.searchsorted(np.cumsum(areas[order]), COVERED * areas.sum())
    # Open3D computes these distances in single precision, so the points are moved near the origin.
    origin = some.mean(axis=0)
    scene = RayScene(mesh.vertices - origin, mesh.faces)
    gap = scene.distance(some - origin)
    lost = gap > FILLED * spacing
    far = np.flatnonzero(bare & (areas > 0))
    normals = vectors[far] / areas[far, np.newaxis]
    seen = RayScene(
        mesh.vertices - origin, mesh.faces[~bare]
    )  # dents that close a hole hide nothing
    light = _openness(seen, middles[far] - origin + ABOVE * diagonal * normals, normals)
    ends = 0.0
    if cloud.normals is not None:
        is_turned = np.einsum("ij,ij->i", normals, cloud.normals[near[far]]) < TURNED
        is_closing = is_turned & (apart[far] > CLOSING * spacing) & (light > OPEN_END)
        for part in _parts(mesh, far[is_closing])[:N_ENDS]:
            middle = np.average(middles[part], 0, areas[part])
            is_near = np.linalg.norm(middles[far] - middle, axis=1) < NEAR_END * diagonal
            end, cap = far[is_near & is_turned], vectors[far[is_near & is_closing]].sum(axis=0)
            if len(end):
                rim, middle = np.unique(near[far[is_near]]), np.average(middles[end], 0, areas[end])
                likeness = _rim(
                    cloud.normals[rim], cloud.points[rim] - middle, vectors[end].sum(axis=0)
                )
                ends = max(ends, max(likeness, SHEET) * float(np.linalg.norm(cap) / area))
    is_hole = (light > OPEN) & (apart[far] > FAR_OFF * diagonal)
    # The points round a hole lie beside it; those of a thin part, round which the surface is too wide, below.
    beside = np.linalg.norm(np.cross(cloud.points[near[far]] - middles[far], normals), axis=1)
    weights = areas.copy()
    weights[far] *= beside / apart[far]
    holes = [weights[part].sum() for part in _parts(mesh, far[is_hole])]
    checks += stages.fit_checks(
        filled=float(areas[filled].sum() / area),
        ends=ends,
        gaps=float(apart[order[min(covered, len(order) - 1)]] / diagonal),
        hole=float(max(holes, default=0) / area),
        lost=float(lost.mean()),
        noise=float(np.sqrt((gap[~lost] ** 2).sum() / max((~lost).sum(), 1))) / diagonal,
    )
    return filled, checks


def _parts(mesh: TriangleMesh, faces: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """The connected components of some faces, in order of descending area."""
    label = components(TriangleMesh(mesh.vertices, mesh.faces[faces]))
    return [faces[label == number] for number in range(label.max(initial=-1) + 1)]


def _rim(normals: FloatArray, offsets: FloatArray, axis: FloatArray) -> float:
    """How like points, by normals and offsets (r, 3) from their middle, are to those round a limb cut off.

    They lie on all sides of its axis, and so do their normals, which are perpendicular to it: twice the
    second eigenvalue of the covariance of such directions is 1, and 0 for those of folds and thin sheets.
    Of the normals its root counts, because it is small if the limb is not round.
    """
    axis = axis / np.linalg.norm(axis)
    both = [directions - np.outer(directions @ axis, axis) for directions in (normals, offsets)]
    both[1] /= np.maximum(np.linalg.norm(both[1], axis=1, keepdims=True), np.finfo(np.float64).tiny)
    spread = np.linalg.eigvalsh([2 * np.cov(across.T, bias=True) for across in both])[:, 1].clip(0)
    return float(np.sqrt(spread[0]) * spread[1] * (1 - np.abs(normals @ axis).mean()))


def _openness(scene: RayScene, places: FloatArray, normals: FloatArray) -> FloatArray:
    """(k,) shares of the light from a uniform sky that reach places (k, 3): 1 − the ambient occlusion."""
    rays = np.random.default_rng(0).standard_normal((N_RAYS, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cosines = normals @ rays.T  # (k, r)
    directions = np.sign(cosines)[:, :, np.newaxis] * rays
    distance = scene.cast(np.repeat(places, N_RAYS, axis=0), directions.reshape(-1, 3))[0]
    light = np.abs(cosines)
    return np.asarray(
        (light * np.isinf(distance).reshape(light.shape)).sum(axis=1) / light.sum(axis=1)
    )


def _places(cells: FloatArray, reach: float) -> FloatArray:
    """Centroids of groups of cells, (p, 3); cells nearer to each other than `reach` are in one group."""
    if not len(cells):
        return cells
    from scipy.spatial import cKDTree

    a, b = cKDTree(cells).query_pairs(reach, output_type="ndarray").T
    group = joined_by(a, b, len(cells))
    sums = np.stack([np.bincount(group, cells[:, axis]) for axis in range(3)], axis=1)
    return np.asarray(sums / np.bincount(group)[:, None])
