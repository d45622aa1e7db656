"""Where the skins of two limbs touch inside what looks like one body.

A calf folded against its thigh makes no handle: nothing about the topology says that they are two. But the
points between them are a wall, and the way round it, through the knee, is long.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.types import FloatArray

__all__ = ["contacts", "walls"]

Mask = NDArray[np.bool_]
Voxels = NDArray[np.float32]

# A point is a disk of this radius that growth does not pass through while there is another way; cells.
DISK = 2.0

# Disks stand across an axis only where their normal leans this far towards it.
LEAST_LEAN = 0.3

# Two cells side by side with a way this long from one to the other lie on two skins; cells. The disks of a
# fold end two cells beyond it, and the way round those is shorter. Mean error of 23 log-values over 19 easy
# scans of TOSCA with contacts: no contacts .118, 5 .090, 6 .084; over 13 of them, with the way measured from
# the middle of the body: no contacts .135, 10 .098, 20 .143. Below 5, noise makes every skin two.
DETOUR = 6

# More such cells than this come of noise, not of contacts; relative to the cells of the skin. Noise of .1 %
# of the diagonal gives .03 to .06, of .3 % .10 to .17.
MOST_CONTACTS = 0.08


@njit(cache=True)
def walls(at: FloatArray, normals: FloatArray, shape: tuple[int, int, int]) -> Mask:
    """Ways from a cell to the next that pass through a disk round a point: (3, a, b, c), along each axis.

    `at`, (n, 3), are coordinates of the points in cells, `normals` their normals; the signs do not matter.
    """
    walls = np.zeros((3, shape[0], shape[1], shape[2]), dtype=np.bool_)
    place = np.zeros(3, dtype=np.int64)
    for i in range(len(at)):
        for axis in range(3):
            lean = normals[i, axis]
            if abs(lean) < LEAST_LEAN:
                continue
            first, second = (axis + 1) % 3, (axis + 2) % 3
            for a in range(int(np.ceil(at[i, first] - DISK)), int(np.floor(at[i, first] + DISK)) + 1):
                for b in range(int(np.ceil(at[i, second] - DISK)), int(np.floor(at[i, second] + DISK)) + 1):
                    da, db = a - at[i, first], b - at[i, second]
                    along = -(normals[i, first] * da + normals[i, second] * db) / lean
                    if da * da + db * db + along * along > DISK * DISK:
                        continue
                    place[axis], place[first], place[second] = int(np.floor(at[i, axis] + along)), a, b
                    if (
                        (place >= 0).all()
                        and place[0] < shape[0]
                        and place[1] < shape[1]
                        and place[2] < shape[2]
                    ):
                        walls[axis, place[0], place[1], place[2]] = True
    return walls


def contacts(inside: Mask, walls: Mask, to_points: Voxels) -> Mask:
    """Cells to leave out so that skins that touch come apart.

    The way to every cell is measured from the end of one limb, and does not pass through walls. Where it is
    much longer to a cell than to the one beside it, that cell is a contact: a layer of the skin which lies
    farther. So is one that cannot be reached, between two that can, at different ends of a way.

    Parameters
    ----------
    inside : (a, b, c) bool
        Cells that may be body; False on the border of the grid.
    walls : (3, a, b, c) bool
    to_points : (a, b, c) float32
        Distance to the nearest point; cells.

    Returns
    -------
    (a, b, c) bool
        None at all where there are so many that they tell of noise.
    """
    # From the middle of a body, two legs that touch are equally far.
    middle = np.where(inside, to_points, -1).argmax()
    limb = _away(inside, walls, int(middle)).argmax()
    found = _contacts(inside, _away(inside, walls, int(limb)))
    if found.sum() > MOST_CONTACTS * _skin_size(inside):
        return np.zeros_like(found)
    return found


@njit(cache=True)
def _away(inside: Mask, walls: Mask, source: int) -> NDArray[np.int32]:
    """Steps from a cell to each that is reached without passing through a wall; −1 elsewhere."""
    _, n_y, n_z = inside.shape
    allowed = inside.ravel()
    wall = (walls[0].ravel(), walls[1].ravel(), walls[2].ravel())
    step = (n_y * n_z, n_z, 1)
    away = np.full(allowed.size, -1, dtype=np.int32)
    queue = np.empty(allowed.size, dtype=np.int64)
    away[source] = 0
    queue[0] = source
    first, last = 0, 1
    while first < last:
        cell = queue[first]
        first += 1
        for axis in range(3):
            for side in range(2):
                other = cell + step[axis] if side else cell - step[axis]
                if away[other] >= 0 or not allowed[other] or wall[axis][cell if side else other]:
                    continue
                away[other] = away[cell] + 1
                queue[last] = other
                last += 1
    return away.reshape(inside.shape)


@njit(cache=True)
def _skin_size(inside: Mask) -> int:
    """Cells that share a side or an edge with one outside."""
    n_x, n_y, n_z = inside.shape
    size = 0
    for x in range(1, n_x - 1):
        for y in range(1, n_y - 1):
            for z in range(1, n_z - 1):
                if not inside[x, y, z]:
                    continue
                bare = False
                for u in range(-1, 2):
                    for v in range(-1, 2):
                        for w in range(-1, 2):
                            bare |= abs(u) + abs(v) + abs(w) < 3 and not inside[x + u, y + v, z + w]
                size += bare
    return size


@njit(cache=True)
def _contacts(inside: Mask, away: NDArray[np.int32]) -> Mask:
    """Cells much farther away than one beside them, or not reached and round which are near and far ones."""
    n_x, n_y, n_z = inside.shape
    found = np.zeros(inside.shape, dtype=np.bool_)
    for x in range(1, n_x - 1):
        for y in range(1, n_y - 1):
            for z in range(1, n_z - 1):
                if not inside[x, y, z]:
                    continue
                here = away[x, y, z]
                near, far = 1 << 30, here
                for u in range(-1, 2):
                    for v in range(-1, 2):
                        for w in range(-1, 2):
                            there = away[x + u, y + v, z + w]
                            if there < 0 or (here >= 0 and abs(u) + abs(v) + abs(w) > 1):
                                continue
                            near = min(near, there)
                            if here < 0:
                                far = max(far, there)
                found[x, y, z] = far - near >= DETOUR
    return found
