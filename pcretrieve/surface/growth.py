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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import SurfaceOptions
from pcretrieve.points.voxels import FARTHEST, Voxels, distances, touching
from pcretrieve.surface.marching import marched, voxels_of
from pcretrieve.values import IntArray, Mask, TriangleMesh
from pcretrieve.values.compiled import compiled, inlined, inner

# Largest amount by which the depth of a voxel, as the priority of region growing, may exceed its distance to
# the nearest point; in voxels. It is small, so that a contact, with points of both surfaces in it, has a
# lower priority than the interior of a thin limb.
SKIN_DEPTH = 0.3

# Number of integer priorities for each voxel edge of depth, and of all.
STEPS = 8
MOST_STEPS = 30_000

# The 3 × 3 × 3 neighbourhood of a voxel. Its voxels are numbered x·9 + y·3 + z with x, y, z in 0 … 2, the
# centre is number 13, and a set of them is an integer with one bit for each, so that a shift moves all voxels
# of a set at once. FACES are the 6-neighbours of the centre, NEAR its 18-neighbours and EVERYTHING its
# 26-neighbours; Y_LOW to Z_HIGH are the voxels that can be moved along an axis without leaving the
# neighbourhood.
_AROUND = [(x, y, z) for x in range(3) for y in range(3) for z in range(3)]
# From the centre, along some axes.
_OFF = [sum(coordinate != 1 for coordinate in place) for place in _AROUND]
FACES = sum(1 << k for k in range(27) if _OFF[k] == 1)
NEAR = sum(1 << k for k in range(27) if _OFF[k] in (1, 2))
EVERYTHING = sum(1 << k for k in range(27) if _OFF[k])


def _without(axis: int, side: int) -> int:
    """The voxels of the neighbourhood that are not on one side, 0 or 2, along an axis."""
    return sum(1 << k for k in range(27) if _AROUND[k][axis] != side)


Y_LOW = _without(axis=1, side=2)
Y_HIGH = _without(axis=1, side=0)
Z_LOW = _without(axis=2, side=2)
Z_HIGH = _without(axis=2, side=0)

# The state of a voxel, as a set of bits: whether it may be added, was added, is adjacent to the region, is
# adjacent to it by a link without a surfel, and waits in the queue 0 (the next bit is for the queue 1).
INSIDE = 1
ADDED = 2
ADJACENT = 4
LINKED = 8
WAITING = 16


def grown(inside: Mask, depth: Voxels, to_points: Voxels, walls: Mask) -> Mask:
    """Grow a region of genus 0, 6-connected and its complement 26-connected, in order of descending depth.

    inside: voxels that may be added; False on the border of the grid.
    to_points: distance to the nearest point, of which depth counts for little more: at a contact there are
        points between the limbs.
    walls: (3, a, b, c) bool, from `parts.walls`. The region grows along links that cross a surfel only after
        all voxels that are reached by other links.
    """
    steps, seed = _steps(inside, depth, to_points)
    size = int(steps.flat[seed]) + 1
    queues = Queues(
        head=np.full((2, size), -1, dtype=np.int32),
        tail=np.full((2, size), -1, dtype=np.int32),
        after=np.empty((2, steps.size), dtype=np.int32),
        top=np.zeros(2, dtype=np.int64),
    )
    state = (steps.ravel() > 0) * np.uint8(INSIDE)
    _, n_y, n_z = steps.shape
    offset = (np.array(_AROUND) - 1) @ (n_y * n_z, n_z, 1)
    _grow(state, queues, steps, seed, walls, offset)
    region: Mask = (state & ADDED != 0).reshape(steps.shape)
    return region


@compiled()
def _steps(
    inside: Mask, depth: Voxels, to_points: Voxels
) -> tuple[NDArray[np.int16], int]:
    """The integer priority of each voxel from 1, 0 outside; and the first voxel of the highest."""
    steps = np.zeros(inside.size, dtype=np.int16)
    is_inside, depths, apart = inside.ravel(), depth.ravel(), to_points.ravel()
    seed = 0
    for cell in range(inside.size):
        if is_inside[cell]:
            most = (
                apart[cell] + np.float32(SKIN_DEPTH)
                if apart[cell] < FARTHEST
                else depths[cell]
            )
            value = min(depths[cell], most)
            steps[cell] = np.int16(min(max(value * np.float32(STEPS), 0), MOST_STEPS)) + 1
            if steps[cell] > steps[seed]:
                seed = cell
    return steps.reshape(inside.shape), seed


@compiled()
def _grow(
    state: NDArray[np.uint8],
    queues: Queues,
    steps: NDArray[np.int16],
    seed: int,
    walls: Mask,
    offset: NDArray[np.intp],
) -> None:
    """Add voxels to the region, from the first one, until none in the queues can be added.

    state: of each voxel in one byte, so that those of a neighbourhood stay in the cache.
    offset: (27,) from a voxel to those around it.
    """
    _, n_y, n_z = steps.shape
    step, wall = steps.ravel(), walls.reshape(3, steps.size)
    _put(queues, 1, seed, step[seed])
    while True:
        queue, cell = _take(queues)
        if cell < 0:
            return
        state[cell] &= ~(WAITING << queue)
        if state[cell] & ADDED:
            continue
        around = 0
        for k in range(27):
            around |= (state[cell + offset[k]] & ADDED != 0) << k
        if around and not _is_simple(around):  # the first voxel has nothing around it
            continue  # it is queued again when a neighbour is added
        state[cell] |= ADDED
        _mark_adjacent(state, wall, cell, (n_y * n_z, n_z, 1))
        for k in range(27):
            other = cell + offset[k]
            if state[other] & (INSIDE | ADDED | ADJACENT) != INSIDE | ADJACENT:
                continue
            queue = 1 if state[other] & LINKED else 0
            if not state[other] & (WAITING << queue):
                state[other] |= WAITING << queue
                _put(queues, queue, other, step[other])


@inner()
def _mark_adjacent(
    state: NDArray[np.uint8], wall: Mask, cell: int, along: tuple[int, int, int]
) -> None:
    """Note that a voxel was added, at its six neighbours."""
    for axis in range(3):
        above, below = cell + along[axis], cell - along[axis]
        state[above] |= ADJACENT if wall[axis, cell] else ADJACENT | LINKED
        state[below] |= ADJACENT if wall[axis, below] else ADJACENT | LINKED


class Queues(NamedTuple):
    """Two queues of voxels by priority: 1 for voxels that a link without a surfel reaches, 0 for the others.

    Each priority has a bucket, which is a list of voxels in the order in which they came.

    head, tail: (2, b) the first and the last voxel of each bucket; the head of an empty one is −1.
    after: (2, n) the voxel that follows each voxel in its bucket; −1 for the last.
    top: (2,) a priority above which all buckets are empty; the bucket 0 is empty.
    """

    head: IntArray
    tail: IntArray
    after: IntArray
    top: NDArray[np.int64]


@inlined()
def _put(queues: Queues, queue: int, cell: int, priority: int) -> None:
    """Append a voxel to its bucket."""
    queues.after[queue, cell] = -1
    if queues.head[queue, priority] < 0:
        queues.head[queue, priority] = cell
    else:
        queues.after[queue, queues.tail[queue, priority]] = cell
    queues.tail[queue, priority] = cell
    queues.top[queue] = max(queues.top[queue], priority)


@inlined()
def _take(queues: Queues) -> tuple[int, int]:
    """The queue and the voxel that is next, which is removed; the voxel is −1 if there is none."""
    for queue in (1, 0):
        while queues.top[queue] > 0 and queues.head[queue, queues.top[queue]] < 0:
            queues.top[queue] -= 1
        if queues.top[queue] > 0:
            cell = queues.head[queue, queues.top[queue]]
            queues.head[queue, queues.top[queue]] = queues.after[queue, cell]
            return queue, cell
    return 0, -1


@inner()
def _is_simple(body: int) -> bool:
    """Whether a voxel with these neighbours in the region is a simple point: adding it keeps the topology."""
    # It is simple if exactly one component of the region, in the 18-neighbourhood, and exactly one component
    # of the complement, in the 26-neighbourhood, are adjacent to it (Bertrand and Malandain, "A new
    # characterization of three-dimensional simple points", 1994).
    faces = body & FACES
    if faces == 0:
        return False
    first = faces & -faces
    if faces != first and not _joined_by_faces(first, faces, body & NEAR):
        return False
    rest = EVERYTHING & ~body
    return rest != 0 and _is_joined_by_corners(rest)


@inner()
def _joined_by_faces(start: int, wanted: int, allowed: int) -> bool:
    """Whether the 6-connected component of `start` in the set `allowed` has all voxels of `wanted`."""
    reached = start
    while wanted & ~reached:
        beside = (reached & Z_LOW) << 1 | (reached & Z_HIGH) >> 1
        beside |= (reached & Y_LOW) << 3 | (reached & Y_HIGH) >> 3
        beside |= reached << 9 | reached >> 9
        more = reached | beside & allowed
        if more == reached:
            return False
        reached = more
    return True


@inner()
def _is_joined_by_corners(voxels: int) -> bool:
    """Whether a set of voxels is 26-connected."""
    reached = voxels & -voxels
    while reached != voxels:
        more = reached | (reached & Z_LOW) << 1 | (reached & Z_HIGH) >> 1
        more |= (more & Y_LOW) << 3 | (more & Y_HIGH) >> 3
        more |= more << 9 | more >> 9
        more &= voxels
        if more == reached:
            return False
        reached = more
    return True


# Smallest thickness of a cut, relative to the greatest depth of the body, for its handle to be a true one.
HANDLE = 0.6


def with_topology(
    inside: Mask,
    walls: Mask,
    to_points: Voxels,
    options: SurfaceOptions,
    notes: list[str],
) -> tuple[Mask, NDArray[np.intp]]:
    """The voxels of the body with the requested genus, and the (k, 3) voxels that were removed.

    inside: voxels that may belong to the body; False on the border of the grid.
    walls: (3, a, b, c) bool, from `parts.walls`.
    to_points: distance of each voxel to the nearest point; in voxels.
    """
    if options.genus == "free":
        return inside, np.zeros((0, 3), dtype=np.intp)
    depth = distances(~inside, np.inf)
    body = grown(inside, depth, to_points, walls)
    if options.genus not in ("sphere", 0):
        body = _with_handles(inside, body, depth, options.genus, notes)
    return body, voxels_of(inside & ~body)


def _with_handles(
    inside: Mask, body: Mask, depth: Voxels, genus: str | int, notes: list[str]
) -> Mask:
    """The body after restoring the handles with the thickest cuts, as many as the genus requires."""
    # A contact is thin compared with the limbs, a true handle is not: ``auto`` restores the handles whose
    # cuts are at least `HANDLE` as deep as the body. Each component of the removed voxels is a cut.
    left_out = voxels_of(inside & ~body)  # (k, 3)
    cut_of = touching(left_out)
    n_cuts = int(cut_of.max(initial=-1)) + 1
    thickness = np.zeros(n_cuts)
    np.maximum.at(thickness, cut_of, depth[tuple(left_out.T)])
    wanted = n_cuts if genus == "auto" else int(genus)
    made = 0
    for cut in np.argsort(-thickness):
        if made == wanted or (genus == "auto" and thickness[cut] < HANDLE * depth.max()):
            break
        cells = left_out[cut_of == cut]
        low = cells.min(axis=0) - 2
        box = tuple(slice(a, b) for a, b in zip(low, cells.max(axis=0) + 3, strict=True))
        closed = body[box].copy()
        closed[tuple((cells - low).T)] = True
        change = _euler(closed) - _euler(body[box])
        if change == -2:  # exactly one handle
            body[box] = closed
            made += 1
    if genus == "auto" and made:
        notes.append(
            f"kept {made} handles as thick as the body round them; genus = 'sphere' would cut them"
        )
    elif genus != "auto" and made < int(genus):
        notes.append(f"only {made} of {genus} handles were found")
    return body


def _euler(body: Mask) -> int:
    """Euler characteristic of the surface that `marched` makes of a set of voxels."""
    padded = np.pad(body, 1)
    if not padded.any():
        return 0
    vertices, faces = marched(padded)
    return TriangleMesh(vertices, faces).euler_characteristic
