"""A closed mesh → the voxels inside it (scan conversion by parity), and its crossings with the grid lines."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.points.voxels import Grid, Mask, Voxels
from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["filled"]


# Offset of the lines from the centres of the voxels, at which vertices may lie; in voxels.
BESIDE = (1e-4, 1.7e-4)


def filled(mesh: TriangleMesh, grid: Grid) -> tuple[Mask, Voxels]:
    """Voxels inside a mesh, and the crossings of the mesh with the lines through their centres.

    A voxel is inside if the line to it along the last axis crosses the mesh an odd number of times (parity
    rule). The side of an edge on which a line passes is computed identically for both faces at the edge, so
    that the line crosses exactly one of them. Rays cast in single precision do not guarantee this.

    Returns inside : (a, b, c) bool: voxels whose centre is inside the mesh.
    Returns crossings : (3, a, b, c) float32: for each axis and voxel, where the mesh crosses the line from
        the centre of the voxel to the next centre: a fraction in [0, 1), NaN if it does not.
    """
    at = grid.coordinates(mesh.vertices)
    crossings = np.full((3, *grid.shape), np.nan, dtype=np.float32)
    odd = np.zeros(grid.shape, dtype=np.bool_)
    _cross(at, mesh.faces, crossings, odd)
    _accumulate(odd)
    for side in (0, -1):
        odd[side] = odd[:, side] = odd[:, :, side] = False
    return odd, crossings


@njit(cache=True)
def _accumulate(odd: Mask) -> None:
    """Turn the changes of the parity along the last axis into the parity."""
    for x in range(odd.shape[0]):
        for y in range(odd.shape[1]):
            line, is_inside = odd[x, y], False
            for z in range(len(line)):
                is_inside ^= line[z]
                line[z] = is_inside


@njit(cache=True)
def _cross(at: FloatArray, faces: NDArray[np.int32], crossings: Voxels, odd: Mask) -> None:
    """Write the crossings along each axis, and flip `odd` in the voxel after each along the last axis."""
    shape = odd.shape
    place = np.zeros(3, dtype=np.int64)
    for f in range(len(faces)):
        a, b, c = at[faces[f, 0]], at[faces[f, 1]], at[faces[f, 2]]
        for axis in range(3):
            i, j = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
            first = max(0, int(np.ceil(min(a[i], b[i], c[i]) - BESIDE[0])))
            last = min(shape[i] - 1, int(np.floor(max(a[i], b[i], c[i]) - BESIDE[0])))
            lowest = max(0, int(np.ceil(min(a[j], b[j], c[j]) - BESIDE[1])))
            highest = min(shape[j] - 1, int(np.floor(max(a[j], b[j], c[j]) - BESIDE[1])))
            for u in range(first, last + 1):
                for v in range(lowest, highest + 1):
                    x, y = u + BESIDE[0], v + BESIDE[1]
                    left = _left(at, faces[f, 0], faces[f, 1], i, j, x, y)
                    if left != _left(at, faces[f, 1], faces[f, 2], i, j, x, y):
                        continue
                    if left != _left(at, faces[f, 2], faces[f, 0], i, j, x, y):
                        continue
                    # The intersection of the line with the plane a + s (b - a) + t (c - a).
                    e, g = b[i] - a[i], c[i] - a[i]
                    h, k = b[j] - a[j], c[j] - a[j]
                    area = e * k - g * h
                    if area == 0:
                        continue
                    s = ((x - a[i]) * k - g * (y - a[j])) / area
                    t = (e * (y - a[j]) - (x - a[i]) * h) / area
                    along = a[axis] + s * (b[axis] - a[axis]) + t * (c[axis] - a[axis])
                    below = int(np.floor(along))
                    if axis == 2 and below < shape[2] - 1:
                        # A crossing before the first voxel changes the parity of all voxels of the line.
                        odd[u, v, max(0, below + 1)] ^= True
                    if 0 <= below < shape[axis] - 1:
                        place[axis], place[i], place[j] = below, u, v
                        crossings[axis, place[0], place[1], place[2]] = along - below


@njit(cache=True)
def _left(at: FloatArray, p: int, q: int, i: int, j: int, x: float, y: float) -> bool:
    """Whether (x, y) is left of the directed line from p to q in the projection along an axis."""
    # Evaluated from the lower to the higher vertex number, so that the two directions never agree.
    low, high = min(p, q), max(p, q)
    across, up = at[high, i] - at[low, i], at[high, j] - at[low, j]
    turn = across * (y - at[low, j]) - up * (x - at[low, i])
    if turn == 0:  # symbolic perturbation: (x, y) moves by ε along the first axis, by ε² along the second
        turn = across if up == 0 else -up
    return bool((turn > 0) == (p < q))
