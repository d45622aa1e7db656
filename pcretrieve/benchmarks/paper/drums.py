"""Two isospectral drums: flat surfaces that are not congruent, but have the same Laplace spectrum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["DRUM_CUTS", "drums"]

# Legs of the seven half-squares, and cuts along each of their sides: 969 vertices, the paper's "~1k".
DRUM_LEG = 0.5
DRUM_CUTS = 16

# The transvections x ↦ x + f(x) v of the Fano plane that the drums are built by, one for each side of a
# triangle, as rows (f, v) over the field of two elements. Of all triples of transvections this is the only
# one, up to names, whose two unfoldings of a half-square neither overlap, nor close up on themselves, nor are
# congruent.
TRANSVECTIONS = np.array([[[0, 0, 1], [0, 1, 0]], [[0, 1, 0], [0, 0, 1]], [[1, 0, 1], [1, 1, 1]]])


def drums(n_cuts: int = DRUM_CUTS) -> tuple[TriangleMesh, TriangleMesh]:
    """Two isospectral flat surfaces of seven half-squares each, oriented upwards.

    Triangles are the points of the Fano plane on one drum and its lines on the other, and two triangles are
    neighbours across side k where the k-th of three collineations of order two swaps them. The two actions of
    the collineations have the same characters, so every function on one drum has a counterpart on the other
    [1]_; and as the mesh of every triangle is the mirror image of its neighbours' meshes, so has every finite
    element function.

    Parameters
    ----------
    n_cuts : int, default 16
        Parts that each side of a half-square is cut into.

    Returns
    -------
    TriangleMesh, TriangleMesh
        Flat disks of area 7/8, in the plane z = 0.

    References
    ----------
    .. [1] P. Buser, J. Conway, P. Doyle and K.-D. Semmler, "Some planar isospectral domains", International
       Mathematics Research Notices 1994; the shapes are those of Gordon, Webb and Wolpert, 1992.
    """
    plane = np.stack(np.unravel_index(np.arange(1, 8), (2, 2, 2)), axis=1)  # (7, 3): points, and lines alike
    maps = np.eye(3, dtype=int) + TRANSVECTIONS[:, 1, :, None] * TRANSVECTIONS[:, 0, None]  # (3, 3, 3)
    place = np.array([4, 2, 1])  # of the binary digits
    of_points, of_lines = (plane @ by % 2 @ place - 1 for by in (maps.transpose(0, 2, 1), maps))  # (3, 7)
    return _cut(_unfolded(of_points), n_cuts), _cut(_unfolded(of_lines), n_cuts)


def _unfolded(across: NDArray[np.integer]) -> FloatArray:
    """Unfold seven triangles into the plane, each the mirror image of its neighbours.

    Parameters
    ----------
    across : (3, 7) int
        The triangle beyond the side opposite corner k of each triangle; at the border, the triangle itself.

    Returns
    -------
    (7, 3, 2) float64
        Corners of the triangles.
    """
    corners = {0: np.array([[0.0, 0.0], [DRUM_LEG, 0.0], [0.0, DRUM_LEG]])}
    order = [0]
    for triangle in order:
        for k in range(3):
            neighbor = int(across[k, triangle])
            if neighbor in corners:
                continue
            mirrored = corners[triangle].copy()
            start, end = np.delete(mirrored, k, axis=0)
            side = (end - start) / np.linalg.norm(end - start)
            apex = mirrored[k] - start
            mirrored[k] = start + 2 * (apex @ side) * side - apex
            corners[neighbor] = mirrored
            order.append(neighbor)
    return np.stack([corners[triangle] for triangle in order])


def _cut(corners: FloatArray, n: int) -> TriangleMesh:
    """Triangles (t, 3, 2) cut into n² similar triangles each, in one surface."""
    grid = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    number = {place: k for k, place in enumerate(grid)}
    faces = np.array(
        [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in grid if i + j < n]
        + [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in grid if i + j < n - 1]
    )  # (n², 3)
    weights = np.array([(n - i - j, i, j) for i, j in grid]) / n  # (v, 3)
    places, vertex = np.unique(
        np.round(weights @ corners, 9).reshape(-1, 2), axis=0, return_inverse=True
    )  # (tv,)
    all_faces = vertex.reshape(len(corners), -1)[:, faces].astype(np.int32)  # (t, n², 3)
    upside_down = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0  # (t,)
    all_faces[upside_down] = all_faces[upside_down, :, ::-1]
    return TriangleMesh(np.pad(places, ((0, 0), (0, 1))), all_faces.reshape(-1, 3))
