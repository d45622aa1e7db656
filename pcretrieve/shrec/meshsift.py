"""meshSIFT: local features of a surface at the extrema of its scale space, compared by matching them.

A feature describes the neighbourhood of a keypoint, relative to its main direction. Two surfaces are near if
many of their features have one clearly nearest partner: what matches depends on both surfaces.
"""

from __future__ import annotations

import logging
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import dijkstra

from pcretrieve.arrays import vertex_normals
from pcretrieve.errors import DegenerateMeshError, Stage
from pcretrieve.shrec.cm_bof import coarser
from pcretrieve.values import (
    FloatArray,
    IntArray,
    Shape,
    TriangleMesh,
    tangent_axes,
    unit_vectors,
)
from pcretrieve.values.geometry import adjacency, edge_graph

_log = logging.getLogger(__name__)

# Number of faces below which meshes are too coarse for local features.
FEWEST_FACES = 5000

# Number of faces to which finer surfaces are simplified, so that the scales of two surfaces are comparable.
N_FACES = 10_000

# Largest number of keypoints of a surface.
MOST_KEYPOINTS = 200

# Largest ratio of the angle to the nearest feature to that to the second one.
RATIO = 0.85

# Radii in units of 3σ: of the neighbourhood that gives the direction and of its weights, of a patch, and of
# the circle on which patches lie.
DISC = 3.0
DISC_WEIGHT = 1.5
PATCH = 1.25
CIRCLE = 1.5

# Centres of the nine patches, in units of `CIRCLE`: the middle, four on the axes and four on the diagonals.
CENTRES = np.array(
    [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)],
    dtype=np.float64,
)

# Number of bins of the histograms of a patch, of the histogram of directions, and the width of the Gauss
# filter that smooths the histogram of directions, in degrees; and how often.
N_BINS = 8
N_DIRECTIONS = 360
SMOOTHING = 17
N_SMOOTHINGS = 3

# Smallest ratio of a maximum of the histogram of directions to the largest one that gives a feature.
HIGH = 0.8

# Largest value of a descriptor of unit length, before it is scaled to unit length again.
LARGEST = 0.25


# Unit vectors (k, 144): for nine patches, 8 bins of the shape index and 8 bins of the slant of the normals.
MeshFeatures = NDArray[np.float32]


def mesh_features(shape: Shape) -> MeshFeatures:
    """The meshSIFT features of the first surface of a shape [1]_.

    Keypoints are extrema of the change of the mean curvature in a scale space of six smoothed surfaces. In a
    geodesic disc of radius 9σ around each, a histogram of the directions of the projected normals gives one
    or more main directions. For nine patches in the tangent plane there are histograms of the shape index and
    of the direction of the projected normals, relative to the main direction.

    Of the settings that the article leaves open: six levels, with scales of 1.2 to 6.5 mean lengths of edges;
    curvatures by least squares; 200 keypoints at most; the position of a neighbour in the tangent plane by
    its geodesic distance and its projected direction; simplification to 10,000 faces.

    References
    ----------
    .. [1] C. Maes, T. Fabry, J. Keustermans, D. Smeets, P. Suetens and D. Vandermeulen, "Feature detection on
       3D face surfaces for pose normalisation and recognition", BTAS 2010; and D. Smeets et al., "meshSIFT:
       Local surface features for 3D face recognition under expression variations and partial data", Computer
       Vision and Image Understanding 117 (2013).
    """
    if not shape.mesh.area > 0:
        raise DegenerateMeshError(
            f"no face of {len(shape.mesh.faces)} has an area: give a surface",
            stage=Stage.SIGNATURE,
        )
    if len(shape.mesh.faces) < FEWEST_FACES:
        _warn_once()
    mesh = coarser(
        TriangleMesh(shape.mesh.vertices / np.sqrt(shape.mesh.area), shape.mesh.faces),
        N_FACES,
    )
    scale_space = levels(mesh)
    vertices, levels_of = keypoints(scale_space, mesh, MOST_KEYPOINTS)
    if not len(vertices):
        raise DegenerateMeshError(
            f"the surface of {len(mesh.faces)} faces has no keypoints: give a finer or less regular one",
            stage=Stage.SIGNATURE,
        )
    described: list[FloatArray] = []
    graph = edge_graph(mesh)
    areas = np.zeros(len(mesh.vertices))
    np.add.at(areas, mesh.faces, mesh.face_areas[:, np.newaxis] / 3)
    for number, level in enumerate(scale_space):
        chosen = vertices[levels_of == number]
        if len(chosen):
            reach = (DISC + PATCH) * 3 * level.scale
            apart = dijkstra(graph, directed=False, indices=chosen, limit=reach)  # (k, n)
            for vertex, distances in zip(chosen, apart, strict=True):
                near = np.flatnonzero(np.isfinite(distances))
                described += _described(
                    int(vertex), near, distances[near], level, areas[near]
                )
    return np.array(described, dtype=np.float32)


def match_distance(query: MeshFeatures, other: MeshFeatures) -> float:
    """One minus the share of features that match.

    Two features match if each is the nearest of the other among the features of the other surface, and the
    angle between them is at most .85 of the angle to the second nearest. The share is the mean number of
    matches by the second nearest of both surfaces, divided by the larger number of features. The smaller
    number lets surfaces with few features be near to all others.
    """
    cosines = query @ other.T
    nearest, is_clear = _nearest(cosines)
    back, is_clear_back = _nearest(np.ascontiguousarray(cosines.T))
    is_mutual = back[nearest] == np.arange(len(nearest))
    clear = is_clear.astype(int) + is_clear_back[nearest]
    return float(1 - clear[is_mutual].sum() / (2 * max(cosines.shape)))


def _nearest(cosines: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For each row the column of the largest cosine, and whether it is clearly the nearest."""
    nearest = cosines.argmax(axis=1)
    if cosines.shape[1] < 2:
        return nearest, np.zeros(len(cosines), dtype=bool)
    two = np.partition(cosines, -2, axis=1)[:, -2:]
    angles = np.arccos(np.clip(two.astype(np.float64), -1, 1))
    return nearest, angles[:, 1] < RATIO * angles[:, 0]


@cache
def _warn_once() -> None:
    _log.warning(
        "meshsift needs surfaces of at least %d faces, got coarser ones: use finer ones, or another method",
        FEWEST_FACES,
    )


def _described(
    vertex: int,
    near: NDArray[np.intp],
    distances: FloatArray,
    level: Level,
    areas: FloatArray,
) -> list[FloatArray]:
    """The descriptors (144,) of a keypoint, one for each main direction."""
    unit = 3 * level.scale
    disc = distances <= DISC * unit
    weights = areas * np.exp(-((distances / (DISC_WEIGHT * unit)) ** 2) / 2)
    plane = np.stack(tangent_axes(unit_vectors((weights * disc) @ level.normals[near])))
    tilts = level.normals[near] @ plane.T  # (v, 2): normals in the tangent plane
    tilt = np.linalg.norm(tilts, axis=1)
    slants = np.arctan2(tilts[:, 1], tilts[:, 0])
    offsets = (level.vertices[near] - level.vertices[vertex]) @ plane.T
    offsets *= (distances / np.maximum(np.linalg.norm(offsets, axis=1), 1e-12))[
        :, np.newaxis
    ] / (CIRCLE * unit)
    bins = _shape_bins(level.curvatures[near])
    made = []
    for angle in _directions(slants[disc], (weights * tilt)[disc]):
        by_slant = np.floor((slants - angle) / (2 * np.pi) * N_BINS).astype(int) % N_BINS
        share = _in_patches(offsets, angle) * areas[:, np.newaxis]  # (v, 9)
        shapes = np.array(
            [np.bincount(bins, column, N_BINS) for column in share.T]
        )  # (9, 8)
        turns = np.array(
            [np.bincount(by_slant, column * tilt, N_BINS) for column in share.T]
        )
        made.append(_joined(shapes, turns))
    return made


def _shape_bins(curvatures: FloatArray) -> IntArray:
    """(v,) the bins of the shape index, which goes from 0, a cup, to 1, of principal curvatures (v, 2)."""
    large, small = curvatures.T
    index = np.arctan2(large + small, np.maximum(large - small, 0)) / np.pi + 0.5
    return np.asarray(np.minimum((index * N_BINS).astype(np.int32), N_BINS - 1))


def _in_patches(offsets: FloatArray, angle: float) -> FloatArray:
    """(v, 9) weights of neighbours in the nine patches, of which the second lies in a direction."""
    cos, sin = np.cos(angle), np.sin(angle)
    turned = offsets @ np.array([[cos, -sin], [sin, cos]])
    gaps = np.linalg.norm(turned[:, np.newaxis] - CENTRES, axis=2) * CIRCLE / PATCH
    return np.where(gaps <= 1, np.exp(-(gaps**2) / 2), 0)


def _joined(shapes: FloatArray, turns: FloatArray) -> FloatArray:
    """(144,) the histograms (9, 8) of both kinds, each scaled to unit length, and cut off at `LARGEST`."""
    parts = [part / (np.linalg.norm(part) or 1.0) for part in (shapes, turns)]
    values = np.concatenate(parts, axis=1).ravel()
    values = np.minimum(values / (np.linalg.norm(values) or 1.0), LARGEST)
    return values / (np.linalg.norm(values) or 1.0)


def _directions(angles: FloatArray, weights: FloatArray) -> FloatArray:
    """(k,) main directions in radians: the high maxima of the smoothed histogram, refined by parabolas."""
    degrees = np.degrees(angles) % N_DIRECTIONS
    smooth = np.bincount(degrees.astype(int) % N_DIRECTIONS, weights, N_DIRECTIONS)
    for _ in range(N_SMOOTHINGS):
        smooth = gaussian_filter1d(smooth, SMOOTHING, radius=SMOOTHING // 2, mode="wrap")
    before, after = np.roll(smooth, 1), np.roll(smooth, -1)
    top = np.flatnonzero(
        (smooth > before) & (smooth >= after) & (smooth >= HIGH * smooth.max())
    )
    bend = before[top] - 2 * smooth[top] + after[top]
    shift = np.where(
        bend < 0, (before[top] - after[top]) / np.where(bend < 0, 2 * bend, 1), 0
    )
    return np.asarray(np.radians(top + 0.5 + shift))


# Number of levels, and the number of averagings after which each is taken: the scale grows by 2^(1/2) each.
N_AVERAGINGS = (2, 4, 8, 16, 32, 64)

# An averaging over an edge and its two ends moves a vertex by an edge's length with this mean square.
MEAN_SQUARE = 2 / 3


class Level(NamedTuple):
    """A smoothed surface: the width σ of the smoothing, vertices (n, 3) and unit normals (n, 3).

    curvatures: (n, 2) float64, principal curvatures, the larger one first; 1 / unit length, positive where
        the surface is convex.
    """

    scale: float
    vertices: FloatArray
    normals: FloatArray
    curvatures: FloatArray


def levels(mesh: TriangleMesh) -> list[Level]:
    """Smooth a surface step by step, and compute the curvatures of each step."""
    links = adjacency(mesh)
    average = links + diags_array(np.ones(len(mesh.vertices)))
    average = diags_array(1 / average.sum(axis=1)) @ average
    edge = float(edge_graph(mesh).data.mean())
    made = []
    smooth, done = mesh.vertices, 0
    for n in N_AVERAGINGS:
        for _ in range(n - done):
            smooth = average @ smooth
        done = n
        normals, curvatures = _curvatures(TriangleMesh(smooth, mesh.faces), links)
        made.append(
            Level(edge * float(np.sqrt(MEAN_SQUARE * n)), smooth, normals, curvatures)
        )
    return made


def keypoints(
    scale_space: list[Level], mesh: TriangleMesh, most: int
) -> tuple[IntArray, IntArray]:
    """Vertices (k,) and levels (k,) at which the change of the mean curvature with the scale is an extremum.

    The strongest extrema come first.
    """
    curved = np.array(
        [level.scale * level.curvatures.mean(axis=1) for level in scale_space]
    )  # (s, n)
    change = np.diff(curved, axis=0)  # (s − 1, n)
    links = adjacency(mesh)
    starts = links.indptr[:-1]
    # The largest of the neighbours; each vertex is in a face and has neighbours.
    high = np.array([np.maximum.reduceat(row[links.indices], starts) for row in change])
    low = np.array([np.minimum.reduceat(row[links.indices], starts) for row in change])
    found = np.zeros(change.shape, dtype=bool)
    for row in range(1, len(change) - 1):
        around = slice(row - 1, row + 2)
        others = change[[row - 1, row + 1]]
        found[row] = change[row] > np.maximum(
            high[around].max(axis=0), others.max(axis=0)
        )
        found[row] |= change[row] < np.minimum(
            low[around].min(axis=0), others.min(axis=0)
        )
    level, vertex = np.nonzero(found)
    strongest = np.argsort(-np.abs(change[level, vertex]), kind="stable")[:most]
    return vertex[strongest].astype(np.int32), level[strongest].astype(np.int32)


def _curvatures(mesh: TriangleMesh, links: csr_array) -> tuple[FloatArray, FloatArray]:
    """Unit normals (n, 3), and principal curvatures (n, 2) fitted to differences of normals."""
    n = len(mesh.vertices)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    first, second = tangent_axes(normals)
    starts, ends = np.repeat(np.arange(n), np.diff(links.indptr)), links.indices
    along = mesh.vertices[ends] - mesh.vertices[starts]
    length = np.maximum(np.linalg.norm(along, axis=1), np.finfo(np.float64).tiny)
    along = along / length[:, np.newaxis]
    turn = (normals[ends] - normals[starts]) / length[:, np.newaxis]
    u, v = (np.einsum("ij,ij->i", along, plane[starts]) for plane in (first, second))
    du, dv = (np.einsum("ij,ij->i", turn, plane[starts]) for plane in (first, second))
    products = (u * u, u * v, v * v, u * du, v * du + u * dv, v * dv)
    return normals, _fitted_curvatures(
        [np.bincount(starts, each, n) for each in products]
    )


def _fitted_curvatures(sums: list[NDArray[Any]]) -> FloatArray:
    """(n, 2) eigenvalues of [[a, b], [b, c]], which maps edges (u, v) to turns (du, dv) of the normal.

    sums: (n,) those over the edges of a vertex that the normal equations for a, b, c have: u u, u v, v v, and
        the three right sides.
    """
    uu, uv, vv, *right = sums
    zero = np.zeros(len(uu))
    matrix = np.array([[uu, uv, zero], [uv, uu + vv, uv], [zero, uv, vv]]).transpose(
        2, 0, 1
    )
    matrix = matrix + 1e-9 * np.eye(3)  # regular for a vertex with one edge, too
    a, b, c = np.linalg.solve(matrix, np.column_stack(right)[:, :, np.newaxis])[:, :, 0].T
    middle, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    return np.column_stack([middle + spread, middle - spread])
