"""Patches of a surface where there are no points → patches that continue the curvature round them.

A membrane, which has the least area, would close the hole of a crown by a flat cap. The patch of least
bending meets its rim without a crease, but is too low where the hole is large, because nothing tells it how
round the body is. The mean curvature of the rim does: if it is that of a sphere, so is the patch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from pcretrieve.arrays import Mask, area_vectors, vertex_normals
from pcretrieve.values import FloatArray, IntArray
from pcretrieve.values.topology import edges_of

# Linear problems that are solved in turn, each with the operator and the normals of the patch before it: a
# flat patch gets the area of a dome. After four, a cap of a sphere of 60 degrees has its height to 1 %.
ROUNDS = 4

# Rings of vertices round a patch over which the mean curvature of the rim is averaged: one is too noisy.
RIM_RINGS = 2

# Cotangents that count. Slivers, as marching cubes leave them, have larger ones, which would hold their
# vertices where they are; obtuse angles have negative ones.
LEAST_COTANGENT = 0.05
LARGEST_COTANGENT = 10.0
TINY = np.finfo(np.float64).tiny

# Least area of a vertex, by which the problem divides, relative to the mean.
LEAST_AREA = 0.01

# How strongly free vertices are held where they are, relative to the equations: enough for a part that has no
# rim, whose equations are singular, and too little to be seen in any other.
ANCHOR = 1e-13

# Least area of a face of a patch, relative to the mean. A smaller one is degenerate after simplification.
LEAST_FACE = 1e-4


def faired(vertices: FloatArray, faces: IntArray, free: Mask) -> FloatArray:
    """(n, 3) vertices of a closed manifold, after those in a mask have been moved to a fair patch.

    The mean curvature vector of a surface is Δx = −2 H n. The free vertices minimise Σ |Δx + 2 h n|² A over
    themselves and the vertices beside them, with areas A, and h the mean curvature of the rim, or zero if the
    rim is concave. With h = 0 this is the patch of least bending [1]_; to prescribe the mean curvature is due
    to [2]_.

    free: (n,) bool, one patch.

    References
    ----------
    .. [1] M. Botsch and O. Sorkine, "On linear variational surface deformation methods", IEEE Transactions on
       Visualization and Computer Graphics 14 (2008), section 3.
    .. [2] R. Schneider and L. Kobbelt, "Geometric fairing of irregular meshes for free-form surface design",
       Computer Aided Geometric Design 18 (2001).
    """
    # How deep vertices are in the patch: 1 in the ring behind the rim.
    depth = free.astype(np.intp)
    for _ in range(RIM_RINGS + 2):
        depth += with_ring(depth > 0, faces)
    faces = faces[(depth > 0)[faces].all(axis=1)]
    # The deepest come first: slices of matrices are taken faster than rows and columns in a mask.
    numbers = np.unique(faces)
    numbers = numbers[np.argsort(-depth[numbers], kind="stable")]
    n_free, n_bent, n_around = (
        int((depth > least).sum()) for least in (RIM_RINGS + 2, RIM_RINGS + 1, 1)
    )
    places = np.empty(len(vertices), dtype=np.int32)
    places[numbers] = np.arange(len(numbers))
    patch = places[faces]
    at = vertices[numbers]
    operators = _operators(at, patch)
    curvature = _curvature(at, operators, slice(n_bent, n_around))
    for n_left in reversed(range(ROUNDS)):
        next_at = _least_bent(at, operators, curvature, n_free, n_bent)
        if _has_collapsed(next_at, patch):
            break
        at = next_at
        if n_left:
            operators = _operators(at, patch)
    moved: FloatArray = vertices.copy()
    moved[numbers] = at
    return moved


class Operators(NamedTuple):
    """Of a patch with k vertices.

    stiffness: the cotangent matrix S (k, k), symmetric. S x is −Δx, integrated over the area of each vertex.
    areas, normals: (k,), and (k, 3) unit vectors, of the vertices.
    """

    stiffness: csr_array
    areas: FloatArray
    normals: FloatArray


def _curvature(at: FloatArray, operators: Operators, rim: slice) -> float:
    """Twice the mean curvature of the rim, as a mean over its area; 0 if it is concave, or there is none."""
    area = operators.areas[rim].sum()
    # Integrated over the rim, S x = −∫ Δx = ∫ 2 H n.
    bending = ((operators.stiffness[rim] @ at) * operators.normals[rim]).sum()
    return max(0.0, float(bending / area)) if area else 0.0


def _least_bent(
    at: FloatArray, operators: Operators, curvature: float, n_free: int, n_bent: int
) -> FloatArray:
    """(k, 3) vertices, of which the free ones, the first, minimise Σ |Δx + 2 h n|² A over the bent ones.

    curvature: 2 h.
    """
    root = np.sqrt(operators.areas[:n_bent])
    rows = diags_array(1 / root) @ operators.stiffness[:n_bent]  # (b, k)
    own = csc_array(rows[:, :n_free])
    bending = curvature * root[:, np.newaxis] * operators.normals[:n_bent]
    wanted = bending - rows[:, n_free:] @ at[n_free:]
    squares = csc_array(own.T @ own)
    anchor = ANCHOR * squares.diagonal().max()
    squares.setdiag(squares.diagonal() + anchor)
    # Symmetric and positive definite: an ordering for such matrices, and no pivoting.
    factor = splu(
        squares,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    moved: FloatArray = at.copy()
    moved[:n_free] = factor.solve(own.T @ wanted + anchor * at[:n_free])
    return moved


def domed(
    vertices: FloatArray, faces: IntArray, free: Mask, axis: FloatArray, angle: float
) -> FloatArray:
    """(n, 3) vertices, of which a flat patch, in a mask, becomes a part of a sphere that meets its rim.

    Fairing cannot raise a flat patch to more than half of a sphere. The flat patch is the stereographic
    projection of the sphere, which keeps the form of faces. The rim is moved back to where it was, and
    what it moves spreads over the patch as a membrane. A rim below the widest place of a head is longer than
    wide; the sphere is stretched, so that the head is as high as it is long.

    axis: (3,) float64, the unit vector from the middle of the rim to that of the patch.
    angle: between the axis and the rim, at the centre of the sphere.
    """
    is_rim = with_ring(free, faces) & ~free
    offsets = vertices - vertices[is_rim].mean(axis=0)
    across = offsets - np.outer(offsets @ axis, axis)
    distance = np.linalg.norm(across, axis=1)  # (n,) from the axis
    radius = distance[is_rim].mean()
    angles = 2 * np.arctan(distance / radius * np.tan(angle / 2))
    rises = np.outer(np.cos(angles) - np.cos(angle), axis)
    outwards = (np.sin(angles) / np.maximum(distance, TINY))[:, np.newaxis] * across
    longest = distance[is_rim].max() if angle > np.pi / 2 else radius
    sphere = (longest * rises + radius * outwards) / np.sin(angle)
    moved: FloatArray = vertices.copy()
    moved[free] = (sphere + membrane(vertices - sphere, faces, free))[free]
    return moved


def membrane(vertices: FloatArray, faces: IntArray, free: Mask) -> FloatArray:
    """(n, 3) vertices, of which those in a mask are at the mean of their neighbours."""
    ends = edges_of(faces_at(free, faces)).ends
    edges = [(np.ones(len(ends)), ends[:, 0], ends[:, 1])]
    laplacian = _laplacian(edges, len(vertices))[free]  # (k, n)
    moved: FloatArray = vertices.copy()
    moved[free] = splu(laplacian[:, free].tocsc()).solve(
        -(laplacian[:, ~free] @ vertices[~free])
    )
    return moved


def _has_collapsed(at: FloatArray, faces: IntArray) -> bool:
    """Whether faces of a patch have hardly any area: each round can draw vertices together."""
    areas = np.linalg.norm(area_vectors(at, faces), axis=1)
    return bool(areas.min() < LEAST_FACE * areas.mean())


def with_ring(chosen: Mask, faces: IntArray) -> Mask:
    """(n,) mask of some vertices and of their neighbours."""
    grown: Mask = chosen.copy()
    grown[faces_at(chosen, faces)] = True
    return grown


def faces_at(chosen: Mask, faces: IntArray) -> IntArray:
    """(k, 3) the faces with a vertex in a mask, (n,): edges of a patch are found fast among these."""
    a, b, c = (chosen[faces[:, corner]] for corner in range(3))
    return faces[a | b | c]


def _operators(at: FloatArray, faces: IntArray) -> Operators:
    n = len(at)
    edges, areas = [], np.zeros(n)
    for corner in range(3):
        here, a, b = (faces[:, (corner + k) % 3] for k in range(3))
        to_a, to_b = at[a] - at[here], at[b] - at[here]
        twice_area = np.linalg.norm(np.cross(to_a, to_b), axis=1)
        product = np.einsum("ij,ij->i", to_a, to_b)
        cotangents = product / np.maximum(
            twice_area, np.abs(product) / LARGEST_COTANGENT + TINY
        )
        edges.append((np.maximum(cotangents, LEAST_COTANGENT) / 2, a, b))
        areas += np.bincount(here, twice_area / 6, minlength=n)
    stiffness = _laplacian(edges, n)
    areas = np.maximum(areas, LEAST_AREA * areas.mean())
    return Operators(stiffness, areas, vertex_normals(at, faces))


def _laplacian(
    edges: Sequence[tuple[FloatArray, NDArray[np.integer], NDArray[np.integer]]], n: int
) -> csr_array:
    """The graph Laplacian (n, n) of blocks of edges: weights (e,), and the vertices at both ends.

    The weights of an edge that comes twice are added.
    """
    weights, tails, heads = (np.concatenate(part) for part in zip(*edges, strict=True))
    ends = np.concatenate([tails, heads]), np.concatenate([heads, tails])
    links = csr_array((np.concatenate([weights, weights]), ends), (n, n))
    return csr_array(diags_array(links.sum(axis=1)) - links)
