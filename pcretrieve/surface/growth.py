"""Topology-preserving region growing: the largest part of a body that has the topology of a ball [1]_.

Where limbs touch, their voxels are connected and form handles that the body does not have. The region grows
voxel by voxel, in order of descending depth, and only by simple points, which do not change its topology. The
voxels that remain outside are at the thinnest place of each handle: at the contact.

References
----------
.. [1] Bazin and Pham, "Topology correction of segmented medical images using a fast marching algorithm",
   Computer Methods and Programs in Biomedicine 2007.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.voxels import Mask, Voxels

__all__ = ["grown"]


# Number of integer priorities for each voxel edge of depth.
STEPS = 8

# The 3 × 3 × 3 neighbourhood of a voxel. Its voxels are numbered x·9 + y·3 + z with x, y, z in 0 … 2, the
# centre is number 13, and a set of them is an integer with one bit for each. SIX[k] are the 6-neighbours of
# voxel k within the 18-neighbourhood of the centre, ALL_ROUND[k] its 26-neighbours without the centre, FACES
# the 6-neighbours of the centre, and EVERYTHING its 26-neighbours.
_AROUND = np.array([[x, y, z] for x in range(3) for y in range(3) for z in range(3)])
_APART = np.abs(_AROUND[:, None] - _AROUND[None])  # (27, 27, 3)
_BITS = 1 << np.arange(27)
_NEAR = np.array([k != 13 and not (_AROUND[k] != 1).all() for k in range(27)])
SIX = ((_APART.sum(axis=2) == 1) & _NEAR[:, None] & _NEAR[None]) @ _BITS
ALL_ROUND = ((_APART.max(axis=2) == 1) & (np.arange(27) != 13)[None] & (np.arange(27) != 13)[:, None]) @ _BITS
FACES = int(sum(_BITS[k] for k in (4, 10, 12, 14, 16, 22)))
EVERYTHING = int(_BITS.sum() - _BITS[13])


def grown(inside: Mask, priority: Voxels, walls: Mask) -> Mask:
    """Grow a region without handles and cavities from the voxel of highest priority.

    The region is 6-connected and its complement 26-connected.

    Parameters
    ----------
    inside : (a, b, c) bool
        Voxels that may be added; False on the border of the grid.
    priority : (a, b, c) float32
        Voxels of the front are added in order of descending priority.
    walls : (3, a, b, c) bool
        Whether the link from a voxel to the next along each axis crosses a surfel, from `contacts.walls`. The
        region grows along such links only after all voxels that are reached by other links.

    Returns
    -------
    (a, b, c) bool
        The region, of genus 0.
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
    # Two bucket queues, whose buckets are linked lists through `after`: 1 for voxels that are reached by a
    # link without a surfel, 0 for the others.
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
            continue  # it is queued again when a neighbour is added
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
    """Whether a voxel with these neighbours in the region is a simple point: adding it keeps the topology."""
    # It is simple if exactly one component of the region, in the 18-neighbourhood, and exactly one component
    # of the complement, in the 26-neighbourhood, are adjacent to it (Bertrand and Malandain, "A new
    # characterization of three-dimensional simple points", 1994).
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
    """The connected component of the set `allowed` that contains `start`."""
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
