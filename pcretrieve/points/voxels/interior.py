"""The interior of a closed surface, found by the crossings of grid lines with its triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.points.voxels.grid import Grid, Mask
from pcretrieve.values import TriangleMesh

__all__ = ["interior"]

# Displacement of the grid lines along each axis, in voxels, that keeps them off the vertices and edges of
# surfaces that are aligned with the grid, where a crossing would be counted twice or not at all.
DISPLACEMENT = (1.3e-7, 2.1e-7, 0.7e-7)


def interior(mesh: TriangleMesh, grid: Grid) -> Mask:
    """The voxels whose centres are inside a surface.

    Along each of the three axes, the winding number of the surface round a voxel is the sum of the
    orientations of the triangles that the grid line crosses before the voxel [1]_. A voxel is inside if the
    winding number is not zero along two axes or three, so that a hole of an open surface is closed where the
    lines along the two other axes do not pass through it.

    References
    ----------
    .. [1] F. Nooruddin and G. Turk, "Simplification and repair of polygonal models using volumetric
       techniques", IEEE Transactions on Visualization and Computer Graphics 9 (2003).
    """
    at = grid.coordinates(mesh.vertices) + DISPLACEMENT
    triangles = at[mesh.faces]  # (m, 3, 3)
    votes = np.zeros(grid.shape, dtype=np.int8)
    for axis in range(3):
        order = [*(other for other in range(3) if other != axis), axis]
        turned = _winding(triangles[:, :, order], tuple(grid.shape[other] for other in order))
        votes += np.transpose(turned != 0, np.argsort(order))
    return votes >= 2


def _winding(triangles: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Winding numbers of triangles (m, 3, 3) round the voxels of a grid, along the last axis."""
    plane = triangles[:, :, :2]  # (m, 3, 2)
    first = np.ceil(plane.min(axis=1)).astype(np.intp)  # (m, 2): the grid lines in the bounding rectangle
    count = np.maximum(np.floor(plane.max(axis=1)).astype(np.intp) - first + 1, 0)
    n_lines = count.prod(axis=1)
    face = np.repeat(np.arange(len(triangles)), n_lines)  # (c,): one row for each pair of face and line
    number = np.arange(len(face)) - np.repeat(np.cumsum(n_lines) - n_lines, n_lines)
    rows, columns = np.divmod(number, count[face, 1])
    line = first[face] + np.column_stack([rows, columns])  # (c, 2)
    corners = plane[face] - line[:, np.newaxis]  # (c, 3, 2)
    after, last = corners[:, [1, 2, 0]], corners[:, [2, 0, 1]]
    # Twice the signed areas of the triangles of the line and one edge, the edge opposite each corner.
    parts = after[:, :, 0] * last[:, :, 1] - after[:, :, 1] * last[:, :, 0]  # (c, 3)
    crossed = (parts > 0).all(axis=1) | (parts < 0).all(axis=1)
    face, line, parts = face[crossed], line[crossed], parts[crossed]
    total = parts.sum(axis=1)
    height = (parts * triangles[face, :, 2]).sum(axis=1) / total
    crossings = np.zeros((shape[0], shape[1], shape[2] + 1), dtype=np.int32)
    np.add.at(crossings, (*line.T, np.ceil(height).astype(np.intp)), np.sign(total).astype(np.int32))
    winding: NDArray[np.int32] = np.cumsum(crossings, axis=2, dtype=np.int32)[:, :, :-1]
    return winding
