"""Distances on a grid of voxels."""

from __future__ import annotations

import numpy as np
from numba import njit

from pcretrieve.voxels.grid import Mask, Voxels

__all__ = ["distances"]


@njit(cache=True)
def distances(sources: Mask, limit: float) -> Voxels:
    """The distance of each voxel to the nearest source voxel, by propagation of the nearest source [1]_.

    The propagation visits only voxels within the limit, unlike a distance transform of the whole grid. With a
    26-neighbourhood its error is less than a tenth of a voxel.

    Parameters
    ----------
    sources : (a, b, c) bool
        The source voxels.
    limit : float
        Largest distance; in voxels.

    Returns
    -------
    (a, b, c) float32
        Distances, at most `limit`; in voxels.

    References
    ----------
    .. [1] P.-E. Danielsson, "Euclidean distance mapping", Computer Graphics and Image Processing 14 (1980).
    """
    n_x, n_y, n_z = sources.shape
    n = sources.size
    result = np.full(n, limit, dtype=np.float32)
    nearest = np.empty(n, dtype=np.int32)
    is_source = sources.ravel()
    front = np.empty(n, dtype=np.int32)
    queued = np.zeros(n, dtype=np.bool_)
    count = 0
    for x in range(n_x):
        for y in range(n_y):
            for z in range(n_z):
                cell = (x * n_y + y) * n_z + z
                if not is_source[cell]:
                    continue
                result[cell] = 0
                nearest[cell] = cell
                # The propagation starts at the boundary of the sources.
                if (
                    (x > 0 and not is_source[cell - n_y * n_z])
                    or (x < n_x - 1 and not is_source[cell + n_y * n_z])
                    or (y > 0 and not is_source[cell - n_z])
                    or (y < n_y - 1 and not is_source[cell + n_z])
                    or (z > 0 and not is_source[cell - 1])
                    or (z < n_z - 1 and not is_source[cell + 1])
                ):
                    front[count] = cell
                    queued[cell] = True
                    count += 1
    head, waiting = 0, count
    tail = count % n
    while waiting:
        cell = front[head]
        head = (head + 1) % n
        waiting -= 1
        queued[cell] = False
        source = nearest[cell]
        a, b, c = source // (n_y * n_z), source // n_z % n_y, source % n_z
        x, y, z = cell // (n_y * n_z), cell // n_z % n_y, cell % n_z
        for u in range(max(0, x - 1), min(n_x, x + 2)):
            for v in range(max(0, y - 1), min(n_y, y + 2)):
                for w in range(max(0, z - 1), min(n_z, z + 2)):
                    other = (u * n_y + v) * n_z + w
                    apart = np.float32(np.sqrt((u - a) ** 2 + (v - b) ** 2 + (w - c) ** 2))
                    if apart < result[other]:
                        result[other] = apart
                        nearest[other] = source
                        if not queued[other]:
                            queued[other] = True
                            front[tail] = other
                            tail = (tail + 1) % n
                            waiting += 1
    return result.reshape(sources.shape)
