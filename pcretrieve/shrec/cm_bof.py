"""MDS-CM-BOF: pictures of canonical forms, compared by bags of features in the best of 24 positions.

The canonical form of a surface is one whose Euclidean distances are the geodesic distances of the surface, so
that bent limbs become straight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import vq
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from pcretrieve.arrays.open3d import RayScene, library
from pcretrieve.descriptors.hapt import in_principal_frame
from pcretrieve.errors import DegenerateMeshError, OptionError, Stage
from pcretrieve.values import FloatArray, IntArray, Shape, TriangleMesh, unit_vectors
from pcretrieve.values.simplify import decimated, simplified
from pcretrieve.values.topology import compact

# Number of faces to which a surface is simplified first.
N_FACES = 1000

# Number of iterations of SMACOF. The stress changes by less than 1 % in further ones.
N_ITERATIONS = 30


def canonical_form(mesh: TriangleMesh) -> TriangleMesh:
    """The canonical form of a surface (Elad and Kimmel, IEEE TPAMI 25, 2003), of radius 1.

    Distances do not tell a form from its mirror image: of the two, the one is taken whose enclosed volume is
    positive, as that of the surface is if its faces are oriented outwards.
    """
    if not mesh.area > 0:
        raise DegenerateMeshError(
            f"no face of {len(mesh.faces)} has an area: give a surface",
            stage=Stage.SIGNATURE,
        )
    coarse = coarser(mesh, N_FACES)
    return _posed(
        TriangleMesh(scaled_coordinates(geodesic_distances(coarse)), coarse.faces)
    )


def coarser(mesh: TriangleMesh, n_faces: int) -> TriangleMesh:
    """A surface with about so many faces, or all of its faces if it has fewer."""
    if len(mesh.faces) <= n_faces:
        return compact(mesh.vertices, mesh.faces)
    try:
        return simplified(mesh, n_faces)
    except DegenerateMeshError:  # open, or not a manifold
        coarse = decimated(mesh, n_faces)
        return compact(coarse.vertices, coarse.faces)


def geodesic_distances(mesh: TriangleMesh) -> FloatArray:
    """(n, n) geodesic distances between the vertices, by shortest paths; symmetric.

    The paths follow the edges, and the diagonals of each two adjacent faces, which are unfolded into one
    plane. They are longer than geodesics by 3 % in the mean on a sphere, and need no solver.
    """
    n = len(mesh.vertices)
    if n < 4:
        raise DegenerateMeshError(
            f"a canonical form needs a surface of at least 4 vertices, got {n}",
            stage=Stage.SIGNATURE,
        )
    ends, lengths = _links(mesh)
    # The shortest of the links between two vertices, since a sparse matrix would add them up.
    order = np.argsort(lengths, kind="stable")
    _, first = np.unique(np.sort(ends[order], axis=1), axis=0, return_index=True)
    kept = order[first]
    graph = coo_array((lengths[kept], ends[kept].T), shape=(n, n)).tocsr()
    distances = dijkstra(graph, directed=False)
    if apart := int(np.isinf(distances[0]).sum()):
        raise DegenerateMeshError(
            f"a canonical form needs a connected surface, {apart} of {n} vertices are not connected to the "
            "first: keep one component",
            stage=Stage.SIGNATURE,
        )
    return np.asarray(np.minimum(distances, distances.T))


def _links(mesh: TriangleMesh) -> tuple[NDArray[np.int64], FloatArray]:
    """Ends (l, 2) and lengths (l,) of edges, and of diagonals of adjacent faces."""
    surface, vertices = mesh.to_trimesh(), mesh.vertices
    start, end = vertices[surface.face_adjacency_edges].swapaxes(0, 1)
    length = np.linalg.norm(end - start, axis=1)  # (t,)
    has_length = length > 0
    across = surface.face_adjacency_unshared[has_length]  # (t, 2)
    start, along, length = (kept[has_length] for kept in (start, end - start, length))
    inside, diagonals = _diagonals(vertices[across] - start[:, np.newaxis], along, length)
    inside &= across[:, 0] != across[:, 1]
    # A link of length 0 would be none: scipy leaves zeros of sparse matrices out of a graph.
    smallest = np.finfo(np.float64).eps * mesh.diagonal
    sides = surface.edges_unique_length
    lengths = np.maximum(np.concatenate([sides, diagonals[inside]]), smallest)
    return np.concatenate([surface.edges_unique, across[inside]]), lengths


def _diagonals(
    offsets: FloatArray, along: FloatArray, length: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Whether the diagonal of two faces, unfolded into a plane, crosses their common edge; and its length.

    offsets: (t, 2, 3), from the start of the edge to the other vertices. along, length: of the edge.
    """
    x = np.einsum("tkd,td->tk", offsets, along) / length[:, np.newaxis]
    y = np.sqrt(np.maximum((offsets**2).sum(axis=2) - x**2, 0))
    height = y.sum(axis=1)
    crossing = x[:, 0] + (x[:, 1] - x[:, 0]) * y[:, 0] / np.where(height > 0, height, 1)
    return (crossing > 0) & (crossing < length), np.hypot(x[:, 0] - x[:, 1], height)


def scaled_coordinates(distances: FloatArray) -> FloatArray:
    """(n, 3) points whose distances approximate given ones (n, n): metric multidimensional scaling.

    SMACOF (de Leeuw, 1977) minimises the sum of the squared differences of all distances, from the solution
    of classical scaling. n is at least 4. The points are determined up to rotations, reflections and
    translations.
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
    framed = in_principal_frame(mesh)
    vertices = framed.vertices[:, ::-1]
    vertices = vertices / np.linalg.norm(vertices, axis=1).max()
    skew = framed.face_areas @ vertices[mesh.faces].mean(axis=1) ** 3  # (3,)
    vertices = vertices * np.where(skew < 0, -1.0, 1.0)
    side = np.sign(TriangleMesh(vertices, mesh.faces).volume) or 1.0
    return TriangleMesh(vertices * [1.0, 1.0, side], mesh.faces)


# Side of the pictures in pixels.
N_PIXELS = 128

# Margin on each side of a picture, relative to half of its width.
MARGIN = 0.05

# Distance of a camera from the centre of a form, which has the radius 1.
START = 2.0


@cache
def directions() -> FloatArray:
    """(66, 3) unit vectors: the vertices of the octahedron whose faces are cut in four twice."""
    sphere = library().geometry.TriangleMesh.create_octahedron(1.0)
    for _ in range(2):
        sphere = sphere.subdivide_midpoint(1)
        vertices = np.asarray(sphere.vertices)  # the memory of the mesh
        vertices[:] = unit_vectors(vertices)
    return np.array(sphere.vertices)


@cache
def exchanges() -> IntArray:
    """(24, 66) numbers of the directions to which the rotations of an octahedron turn each direction."""
    views = directions()
    turns = Rotation.create_group("O").as_matrix()
    rows = [(views @ turn.T @ views.T).argmax(axis=1) for turn in turns]
    return np.array(rows, dtype=np.int32)


def depth_pictures(mesh: TriangleMesh) -> Iterator[FloatArray]:
    """Depth pictures (128, 128) of a surface within the unit sphere, from all `directions`.

    The projection is orthographic. The value is (1 + z) / 2 at the point nearest to the camera, with z the
    coordinate towards the camera; 0 where there is no surface.
    """
    ticks = np.linspace(-1, 1, N_PIXELS) / (1 - MARGIN)
    across, up = np.meshgrid(ticks, ticks)
    pixels = np.column_stack(
        [across.ravel(), up.ravel(), np.full(across.size, START)]
    )  # (p, 3)
    scene = RayScene(mesh.vertices, mesh.faces)
    for towards in directions():
        upright = np.eye(3)[2] if abs(towards[2]) < 1 - 1e-9 else np.eye(3)[1]
        right = unit_vectors(np.cross(upright, towards))
        # (3, 3): to the right, upwards, nearer.
        camera = np.stack([right, np.cross(towards, right), towards])
        ways, _, _ = scene.cast(pixels @ camera, np.broadcast_to(-towards, pixels.shape))
        yield np.where(np.isfinite(ways), (1 + START - ways) / 2, 0).reshape(N_PIXELS, -1)


# Number of visual words, and of values of a SIFT descriptor: 4 × 4 cells of 8 directions.
VOCABULARY = 1500
SIFT_LENGTH = 128

# The (k, 128) SIFT descriptors of each view of a form; k is 0 for a view without keypoints.
ViewDescriptors = list[NDArray[np.uint8]]


# (66, W) how often each visual word is in each view of a form.
ViewWords: TypeAlias = "csr_array[np.float64]"


def view_descriptors(shape: Shape) -> ViewDescriptors:
    """The SIFT descriptors in 66 depth pictures of the canonical form of a shape [1]_.

    Of the settings that the article leaves open, or that differ: shortest paths over faces instead of fast
    marching; forms of at most 1000 faces, which are drawn themselves; pictures of 128 × 128 pixels instead of
    256 × 256; principal axes without the measure of rectilinearity; and OpenCV's default settings of SIFT.

    References
    ----------
    .. [1] Z. Lian, A. Godil, X. Sun and J. Xiao, "CM-BOF: visual similarity-based 3D shape retrieval using
       clock matching and bag-of-features", Machine Vision and Applications 24 (2013); and Z. Lian et al.,
       "Non-rigid 3D shape retrieval using multidimensional scaling and bag-of-features", ICIP 2010.
    """
    try:
        import cv2
    except ImportError as error:
        raise OptionError(
            "SIFT needs OpenCV, which is not installed: pip install 'pcretrieve[views]'"
        ) from error
    cv2.setNumThreads(1)
    sift = cv2.SIFT.create()
    views = []
    for picture in depth_pictures(canonical_form(shape.mesh)):
        _, found = sift.detectAndCompute(np.round(255 * picture).astype(np.uint8), None)
        # OpenCV gives whole numbers from 0 to 255 in single precision, or None.
        views.append(
            np.asarray([] if found is None else found, np.uint8).reshape(-1, SIFT_LENGTH)
        )
    return views


def view_words(
    gallery: Sequence[ViewDescriptors],
) -> Callable[[ViewDescriptors], ViewWords]:
    """Draw the visual words from the descriptors of a gallery, at random, as published."""
    rng = np.random.default_rng(0)
    every = np.concatenate([view for views in gallery for view in views])  # (p, 128)
    words = every[rng.choice(len(every), min(VOCABULARY, len(every)), replace=False)]
    return partial(_counted, words.astype(np.float64))


def _counted(vocabulary: FloatArray, views: ViewDescriptors) -> ViewWords:
    """How often each word is the nearest one to the descriptors of each view."""
    words, _ = vq(np.concatenate(views).astype(np.float64), vocabulary)
    view = np.repeat(np.arange(len(views)), [len(each) for each in views])
    # Equal places are added up.
    return csr_array(
        (np.ones(len(words)), (view, words)), shape=(len(views), len(vocabulary))
    )


def clock_distance(query: ViewWords, other: ViewWords) -> float:
    """The distance of two canonical forms, in the best of 24 positions.

    For views with frequencies a and b, the distance is 1 − Σ min(a, b) / max(Σ a, Σ b), and 0 for two views
    without words. The distances of corresponding views are averaged, for each of the 24 rotations of an
    octahedron, and the smallest average is the distance.
    """
    shared = np.flatnonzero(query.sum(axis=0) * other.sum(axis=0))
    ours, its = query[:, shared].toarray(), other[:, shared].toarray()
    # Σ |a − b| = Σ a + Σ b − 2 Σ min(a, b)
    sums = ours.sum(axis=1)[:, np.newaxis] + its.sum(axis=1)
    common = (sums - cdist(ours, its, "cityblock")) / 2  # (66, 66)
    larger = np.maximum(query.sum(axis=1)[:, np.newaxis], other.sum(axis=1))
    apart = np.where(larger > 0, 1 - common / np.maximum(larger, 1), 0)
    return float(apart[exchanges(), np.arange(len(apart))].mean(axis=1).min())
