"""Canonical forms: surfaces whose Euclidean distances are the geodesic distances of a bending surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from pcretrieve.adapters.open3d import simplify
from pcretrieve.errors import DegenerateMeshError, Stage
from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["canonical_form", "coarser", "geodesic_distances", "scaled_coordinates"]

# Number of faces to which a surface is simplified first. See docs/decisions.md, VOCABULARY.
N_FACES = 1000

# Number of iterations of SMACOF. The stress changes by less than 1 % in further ones.
N_ITERATIONS = 30


def canonical_form(mesh: TriangleMesh) -> TriangleMesh:
    """The canonical form of a surface [1]_: bent limbs become straight.

    The vertices are placed such that their Euclidean distances approximate their geodesic distances, by least
    squares (`scaled_coordinates`). Distances do not tell a form from its mirror image: of the two, the one is
    taken whose enclosed volume is positive, as that of the surface is if its faces are oriented outwards.

    References
    ----------
    .. [1] A. Elad and R. Kimmel, "On bending invariant signatures for surfaces", IEEE Transactions on Pattern
       Analysis and Machine Intelligence 25 (2003).
    """
    if not mesh.area > 0:
        raise DegenerateMeshError(
            f"no face of {len(mesh.faces)} has an area: give a surface", stage=Stage.SIGNATURE
        )
    coarse = coarser(mesh, N_FACES)
    points = scaled_coordinates(geodesic_distances(coarse))
    return _posed(TriangleMesh(points, coarse.faces))


def coarser(mesh: TriangleMesh, n_faces: int) -> TriangleMesh:
    """A surface with about so many faces, or all of its faces if it has fewer."""
    # Imported here because the modules' numba functions are compiled on import.
    from pcretrieve.surface.simplify import simplified
    from pcretrieve.surface.topology import compact

    if len(mesh.faces) <= n_faces:
        return compact(mesh.vertices, mesh.faces)
    try:
        return simplified(mesh, n_faces)
    except DegenerateMeshError:  # open, or not a manifold
        return compact(*simplify(mesh.vertices, mesh.faces, n_faces=n_faces))


def geodesic_distances(mesh: TriangleMesh) -> FloatArray:
    """Geodesic distances between the vertices of a surface, by shortest paths.

    The paths follow the edges, and the diagonals of each two adjacent faces, which are unfolded into one
    plane. They are longer than geodesics by 3 % in the mean on a sphere, and need no solver.

    Returns (n, n) float64: symmetric; unit length.
    """
    n = len(mesh.vertices)
    if n < 4:
        raise DegenerateMeshError(
            f"a canonical form needs a surface of at least 4 vertices, got {n}", stage=Stage.SIGNATURE
        )
    ends, lengths = _links(mesh)
    low, high = np.sort(ends, axis=1).T
    order = np.lexsort((lengths, high, low))
    low, high, lengths = low[order], high[order], lengths[order]
    # The shortest of the links between two vertices, since a sparse matrix would add them up.
    first = np.diff(low * n + high, prepend=-1) > 0
    graph = coo_array((lengths[first], (low[first], high[first])), shape=(n, n)).tocsr()
    distances: FloatArray = dijkstra(graph, directed=False)
    if apart := int(np.isinf(distances[0]).sum()):
        raise DegenerateMeshError(
            f"a canonical form needs a connected surface, {apart} of {n} vertices are not connected to the "
            "first: keep one component",
            stage=Stage.SIGNATURE,
        )
    both: FloatArray = np.minimum(distances, distances.T)
    return both


def _links(mesh: TriangleMesh) -> tuple[NDArray[np.int64], FloatArray]:
    """Ends (l, 2) and lengths (l,) of edges, once for each face, and of diagonals of adjacent faces."""
    faces, vertices = mesh.faces.astype(np.int64), mesh.vertices
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])  # (3m,)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, opposite = edges[order], opposite[order]
    twice = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    start = vertices[edges[twice, 0]]
    along = vertices[edges[twice, 1]] - start
    length = np.linalg.norm(along, axis=1)  # (t,)
    twice, start, along, length = (kept[length > 0] for kept in (twice, start, along, length))
    across = np.column_stack([opposite[twice], opposite[twice + 1]])  # (t, 2)
    offsets = vertices[across] - start[:, np.newaxis]  # (t, 2, 3)
    x = np.einsum("tkd,td->tk", offsets, along) / length[:, np.newaxis]
    y = np.sqrt(np.maximum((offsets**2).sum(axis=2) - x**2, 0))
    height = y.sum(axis=1)
    crossing = x[:, 0] + (x[:, 1] - x[:, 0]) * y[:, 0] / np.where(height > 0, height, 1)
    inside = (crossing > 0) & (crossing < length) & (across[:, 0] != across[:, 1])
    diagonals = np.hypot(x[:, 0] - x[:, 1], height)[inside]
    sides = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    # A link of length 0 would be none: scipy leaves zeros of sparse matrices out of a graph.
    smallest = np.finfo(np.float64).eps * mesh.diagonal
    lengths = np.maximum(np.concatenate([sides, diagonals]), smallest)
    return np.concatenate([edges, across[inside]]), lengths


def scaled_coordinates(distances: FloatArray) -> FloatArray:
    """Points in space whose distances approximate given ones: metric multidimensional scaling.

    Thirty iterations of SMACOF [1]_, which minimises the sum of the squared differences of all distances,
    from the solution of classical scaling.

    distances: (n, n) float64, symmetric, finite, zero on the diagonal; n is at least 4.
    Returns (n, 3) float64: the points, in the unit of the distances; determined up to rotations, reflections
        and translations.

    References
    ----------
    .. [1] J. de Leeuw, "Applications of convex analysis to multidimensional scaling", Recent Developments in
       Statistics (1977).
    """
    n = len(distances)
    squares = distances**2
    means = squares.mean(axis=0)
    scalars = -(squares - means - means[:, np.newaxis] + means.mean()) / 2
    values, vectors = np.linalg.eigh(scalars)
    points: FloatArray = vectors[:, -3:] * np.sqrt(np.maximum(values[-3:], 0))
    for _ in range(N_ITERATIONS):
        apart = cdist(points, points)
        ratios = np.divide(distances, apart, out=np.zeros_like(apart), where=apart > 0)
        points = (ratios.sum(axis=1)[:, np.newaxis] * points - ratios @ points) / n
    return points


def _posed(mesh: TriangleMesh) -> TriangleMesh:
    """The surface, centred, turned to its principal axes and scaled to radius 1, or its mirror image."""
    areas = mesh.face_areas
    if not areas.sum() > 0:
        raise DegenerateMeshError("the canonical form has no area", stage=Stage.SIGNATURE)
    shares = areas / areas.sum()
    vertices = mesh.vertices - shares @ mesh.vertices[mesh.faces].mean(axis=1)
    corners = vertices[mesh.faces]  # (m, 3, 3)
    # The midpoints of the edges integrate quadratics over a triangle exactly.
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    moments = np.einsum("f,fki,fkj->ij", shares, middles, middles) / 3
    vertices = vertices @ np.linalg.eigh(moments)[1][:, ::-1]
    vertices = vertices / np.linalg.norm(vertices, axis=1).max()
    skew = shares @ vertices[mesh.faces].mean(axis=1) ** 3  # (3,)
    vertices = vertices * np.where(skew < 0, -1.0, 1.0)
    side = np.sign(TriangleMesh(vertices, mesh.faces).volume) or 1.0
    return TriangleMesh(vertices * [1.0, 1.0, side], mesh.faces)
