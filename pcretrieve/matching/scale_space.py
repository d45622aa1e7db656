"""Scale space of a surface: smoothed surfaces with their curvatures, and extrema of the mean curvature."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array

from pcretrieve.values import FloatArray, IntArray, TriangleMesh

__all__ = ["Keypoints", "Level", "keypoints", "levels"]

# Number of levels, and the number of averagings after which each is taken: the scale grows by 2^(1/2) each.
N_AVERAGINGS = (2, 4, 8, 16, 32, 64)

# An averaging over an edge and its two ends moves a vertex by an edge's length with this mean square.
MEAN_SQUARE = 2 / 3


class Level(NamedTuple):
    """A smoothed surface.

    scale: σ, the width of the smoothing; unit length.
    vertices: (n, 3) float64, the smoothed vertices; unit length.
    normals: (n, 3) float64, unit normals of the smoothed surface.
    curvatures: (n, 2) float64, principal curvatures, the larger one first; 1 / unit length, positive where
        the surface is convex.
    """

    scale: float
    vertices: FloatArray
    normals: FloatArray
    curvatures: FloatArray

    @property
    def mean_curvatures(self) -> FloatArray:
        """(n,) mean curvatures; 1 / unit length."""
        means: FloatArray = self.curvatures.mean(axis=1)
        return means


class Keypoints(NamedTuple):
    """Extrema of the scale space.

    vertices: (k,) int32, numbers of the vertices, the strongest extremum first.
    levels: (k,) int32, numbers of the levels.
    """

    vertices: IntArray
    levels: IntArray


def levels(mesh: TriangleMesh) -> list[Level]:
    """Smooth a surface step by step, and compute the curvatures of each step."""
    links = adjacency(mesh)
    average = links + diags_array(np.ones(len(mesh.vertices)))
    average = diags_array(1 / average.sum(axis=1)) @ average
    edge = _mean_edge(mesh, links)
    made = []
    smooth, done = mesh.vertices, 0
    for n in N_AVERAGINGS:
        for _ in range(n - done):
            smooth = average @ smooth
        done = n
        normals, curvatures = _curvatures(TriangleMesh(smooth, mesh.faces), links)
        made.append(Level(edge * float(np.sqrt(MEAN_SQUARE * n)), smooth, normals, curvatures))
    return made


def adjacency(mesh: TriangleMesh) -> csr_array:
    """The (n, n) matrix with 1 for each two vertices that share an edge.

    Returns (n, n) csr_array of float64: symmetric, 0 on the diagonal.
    """
    starts, ends = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    n = len(mesh.vertices)
    both = np.concatenate([starts, ends]), np.concatenate([ends, starts])
    links: csr_array[np.float64] = csr_array((np.ones(2 * len(starts)), both), shape=(n, n))
    links.data[:] = 1.0  # instead of the number of faces at an edge
    return links


def keypoints(scale_space: list[Level], mesh: TriangleMesh, most: int) -> Keypoints:
    """The vertices at which the change of the mean curvature with the scale is an extremum."""
    curved = np.array([level.scale * level.mean_curvatures for level in scale_space])  # (s, n)
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
        found[row] = change[row] > np.maximum(high[around].max(axis=0), others.max(axis=0))
        found[row] |= change[row] < np.minimum(low[around].min(axis=0), others.min(axis=0))
    level, vertex = np.nonzero(found)
    strongest = np.argsort(-np.abs(change[level, vertex]), kind="stable")[:most]
    return Keypoints(vertex[strongest].astype(np.int32), level[strongest].astype(np.int32))


def _mean_edge(mesh: TriangleMesh, links: csr_array) -> float:
    """Mean length of the edges; unit length."""
    starts = np.repeat(np.arange(len(mesh.vertices)), np.diff(links.indptr))
    return float(np.linalg.norm(mesh.vertices[starts] - mesh.vertices[links.indices], axis=1).mean())


def _curvatures(mesh: TriangleMesh, links: csr_array) -> tuple[FloatArray, FloatArray]:
    """Unit normals (n, 3), and principal curvatures (n, 2) fitted to differences of normals."""
    n = len(mesh.vertices)
    corners = np.repeat(mesh.area_vectors, 3, axis=0)  # (3m, 3)
    sums_of_vectors = [np.bincount(mesh.faces.ravel(), corners[:, k], n) for k in range(3)]
    normals = np.column_stack(sums_of_vectors).astype(np.float64)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    # Two directions in the tangent plane: the axis that is the farthest from the normal, made orthogonal.
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    second = np.cross(normals, first)
    starts, ends = np.repeat(np.arange(n), np.diff(links.indptr)), links.indices
    along = mesh.vertices[ends] - mesh.vertices[starts]
    length = np.maximum(np.linalg.norm(along, axis=1), np.finfo(np.float64).tiny)
    along = along / length[:, np.newaxis]
    turn = (normals[ends] - normals[starts]) / length[:, np.newaxis]
    u, v = (np.einsum("ij,ij->i", along, plane[starts]) for plane in (first, second))
    du, dv = (np.einsum("ij,ij->i", turn, plane[starts]) for plane in (first, second))
    # Unknowns a, b, c of (du, dv) = [[a, b], [b, c]] (u, v).
    columns = {"uu": u * u, "uv": u * v, "vv": v * v, "udu": u * du, "vdv": v * dv, "mix": v * du + u * dv}
    sums = {name: np.bincount(starts, values, n) for name, values in columns.items()}
    zero = np.zeros(n)
    matrix = np.array(
        [
            [sums["uu"], sums["uv"], zero],
            [sums["uv"], sums["uu"] + sums["vv"], sums["uv"]],
            [zero, sums["uv"], sums["vv"]],
        ]
    ).transpose(2, 0, 1) + 1e-9 * np.eye(3)  # (n, 3, 3); regular for a vertex with one edge, too
    right = np.column_stack([sums["udu"], sums["mix"], sums["vdv"]])
    a, b, c = np.linalg.solve(matrix, right[:, :, np.newaxis])[:, :, 0].T
    middle, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    return normals, np.column_stack([middle + spread, middle - spread])
