"""A body with the topology of a ball, grown inside another [1]_.

Where limbs touch, their cells run together and make handles that the body does not have. Growing the body
cell by cell, deepest first, and never adding a cell that would close a handle, leaves the last cells of each
contact out.

References
----------
.. [1] Bazin and Pham, "Topology correction of segmented medical images using a fast marching algorithm",
   Computer Methods and Programs in Biomedicine 2007.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["grown"]

Mask = NDArray[np.bool_]

# Priorities are kept in this many steps a cell.
STEPS = 8

# Cells round a cell are numbered x·9 + y·3 + z with x, y, z in 0 … 2, itself 13; sets of them are the bits of
# an integer. SIX[k]: cells that share a face with k, among those that share a face or an edge with 13.
# ALL_ROUND[k]: cells that share a face, an edge or a corner with k.
_AROUND = np.array([[x, y, z] for x in range(3) for y in range(3) for z in range(3)])
_APART = np.abs(_AROUND[:, None] - _AROUND[None])  # (27, 27, 3)
_BITS = 1 << np.arange(27)
_NEAR = np.array([k != 13 and not (_AROUND[k] != 1).all() for k in range(27)])
SIX = ((_APART.sum(axis=2) == 1) & _NEAR[:, None] & _NEAR[None]) @ _BITS
ALL_ROUND = ((_APART.max(axis=2) == 1) & (np.arange(27) != 13)[None] & (np.arange(27) != 13)[:, None]) @ _BITS
FACES = int(sum(_BITS[k] for k in (4, 10, 12, 14, 16, 22)))
EVERYTHING = int(_BITS.sum() - _BITS[13])


def grown(inside: Mask, priority: NDArray[np.float32], walls: NDArray[np.bool_]) -> Mask:
    """The largest body without handles or cavities that growth in order of priority reaches.

    Cells are connected through their faces in the body, and through faces, edges and corners outside it.

    Parameters
    ----------
    inside : (a, b, c) bool
        Cells that may be added; False on the border of the grid.
    priority : (a, b, c) float32
        Cells are added highest first; the body starts from the highest of all.
    walls : (3, a, b, c) bool
        Whether the way from a cell to the next along each axis passes through a surface. Growth takes such a
        way only when no other is left.

    Returns
    -------
    (a, b, c) bool
    """
    steps = np.where(inside, np.clip(priority * STEPS, 0, 30_000) + 1, 0).astype(np.int16)
    return _grown(steps, walls, int(steps.argmax()), int(steps.max()) + 1)


@njit(cache=True)
def _grown(steps: NDArray[np.int16], walls: Mask, seed: int, n_buckets: int) -> Mask:
    _, n_y, n_z = steps.shape
    n = steps.size
    step = steps.ravel()
    wall_x, wall_y, wall_z = walls[0].ravel(), walls[1].ravel(), walls[2].ravel()
    body = np.zeros(n, dtype=np.bool_)
    offset = np.empty(27, dtype=np.int64)
    for k in range(27):
        offset[k] = (k // 9 - 1) * n_y * n_z + (k // 3 % 3 - 1) * n_z + k % 3 - 1
    along_x, along_y = n_y * n_z, n_z
    # Two queues of buckets, each a linked list through `after`: 1 for cells reached freely, 0 through walls.
    head = np.full((2, n_buckets), -1, dtype=np.int64)
    tail = np.full((2, n_buckets), -1, dtype=np.int64)
    after = np.full((2, n), -1, dtype=np.int64)
    waiting = np.zeros((2, n), dtype=np.bool_)
    top = np.zeros(2, dtype=np.int64)
    top[1] = step[seed]
    head[1, top[1]] = seed
    empty = True
    while True:
        queue = 1
        while queue >= 0:
            while top[queue] > 0 and head[queue, top[queue]] < 0:
                top[queue] -= 1
            if top[queue] > 0:
                break
            queue -= 1
        if queue < 0:
            return body.reshape(steps.shape)
        cell = head[queue, top[queue]]
        head[queue, top[queue]] = after[queue, cell]
        waiting[queue, cell] = False
        if body[cell]:
            continue
        around = 0
        for k in range(27):
            if k != 13 and body[cell + offset[k]]:
                around |= 1 << k
        if not empty and not _is_simple(around):
            continue  # it is asked again when a cell round it is added
        empty = False
        body[cell] = True
        for k in range(27):
            other = cell + offset[k]
            if k == 13 or step[other] == 0 or body[other]:
                continue
            queue = -1
            if body[other - along_x]:
                queue = max(queue, 0 if wall_x[other - along_x] else 1)
            if body[other + along_x]:
                queue = max(queue, 0 if wall_x[other] else 1)
            if body[other - along_y]:
                queue = max(queue, 0 if wall_y[other - along_y] else 1)
            if body[other + along_y]:
                queue = max(queue, 0 if wall_y[other] else 1)
            if body[other - 1]:
                queue = max(queue, 0 if wall_z[other - 1] else 1)
            if body[other + 1]:
                queue = max(queue, 0 if wall_z[other] else 1)
            if queue < 0 or waiting[queue, other]:
                continue
            waiting[queue, other] = True
            after[queue, other] = -1
            if head[queue, step[other]] < 0:
                head[queue, step[other]] = other
            else:
                after[queue, tail[queue, step[other]]] = other
            tail[queue, step[other]] = other
            top[queue] = max(top[queue], step[other])


@njit(cache=True)
def _is_simple(body: int) -> bool:
    """Whether adding a cell changes no topology, given the cells of the body round it.

    It does not where the body touches it through one connected piece, and so does the rest (Bertrand and
    Malandain, "A new characterization of three-dimensional simple points", 1994).
    """
    faces = body & FACES
    if faces == 0:
        return False
    first = faces & -faces
    if faces != first and _reached(first, body, SIX) & faces != faces:
        return False
    rest = EVERYTHING & ~body
    return rest != 0 and _reached(rest & -rest, rest, ALL_ROUND) == rest


@njit(cache=True)
def _reached(start: int, allowed: int, neighbors: NDArray[np.int64]) -> int:
    """The connected piece of `allowed` that holds `start`."""
    reached = front = start
    while front:
        found = 0
        k = 0
        while front:
            if front & 1:
                found |= neighbors[k]
            front >>= 1
            k += 1
        front = found & allowed & ~reached
        reached |= front
    return reached
