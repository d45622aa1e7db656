"""Connected components of a set of voxels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.points.voxels.grid import Mask

__all__ = ["components"]


@njit(cache=True)
def components(voxels: Mask, corners: bool) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Label the connected components of a set of voxels, by runs along the last axis [1]_.

    voxels: (a, b, c) bool, the set.
    Returns labels : (a, b, c) int32: number of the component of each voxel, from 1, in the order of their
        first voxels; 0 outside the set.

    References
    ----------
    .. [1] L. He, Y. Chao and K. Suzuki, "A run-based two-scan labeling algorithm", IEEE Transactions on Image
       Processing 17 (2008).
    """
    n_x, n_y, _ = voxels.shape
    begins, ends, lines = _runs(voxels)
    parent = np.arange(len(begins))
    apart = 0 if corners else -1  # the largest number of voxels from the end of a run to an adjacent run
    for x in range(n_x):
        for y in range(n_y):
            line = x * n_y + y
            if y:
                _join(parent, begins, ends, lines, line, line - 1, apart)
            if x:
                for other in range(max(0, y - corners), min(n_y, y + corners + 1)):
                    _join(parent, begins, ends, lines, line, line - n_y - y + other, apart)
    label = np.zeros(len(begins), dtype=np.int32)
    n = 0
    for run in range(len(begins)):  # roots come before the runs that are joined to them
        root = _root(parent, run)
        if root == run:
            n += 1
            label[run] = n
        else:
            label[run] = label[root]
    labels = np.zeros(voxels.shape, dtype=np.int32)
    sizes = np.zeros(n + 1, dtype=np.int64)
    sizes[0] = voxels.size
    for line in range(n_x * n_y):
        here = labels[line // n_y, line % n_y]
        for run in range(lines[line], lines[line + 1]):
            here[begins[run] : ends[run]] = label[run]
            sizes[label[run]] += ends[run] - begins[run]
            sizes[0] -= ends[run] - begins[run]
    return labels, sizes


@njit(cache=True)
def _runs(voxels: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """First voxel and end of each run of voxels on each line, and the first run of each line."""
    n_x, n_y, n_z = voxels.shape
    lines = np.zeros(n_x * n_y + 1, dtype=np.int64)
    for x in range(n_x):
        for y in range(n_y):
            here = voxels[x, y]
            n = np.int64(here[0])
            for z in range(1, n_z):
                n += here[z] and not here[z - 1]
            lines[x * n_y + y + 1] = lines[x * n_y + y] + n
    begins = np.empty(lines[-1], dtype=np.int32)
    ends = np.empty(lines[-1], dtype=np.int32)
    for x in range(n_x):
        for y in range(n_y):
            here = voxels[x, y]
            run = lines[x * n_y + y]
            if run == lines[x * n_y + y + 1]:
                continue
            inside = False
            for z in range(n_z):
                if here[z] != inside:
                    inside = here[z]
                    if inside:
                        begins[run] = z
                    else:
                        ends[run] = z
                        run += 1
            if inside:
                ends[run] = n_z
    return begins, ends, lines


@njit(cache=True)
def _join(
    parent: NDArray[np.int64],
    begins: NDArray[np.int32],
    ends: NDArray[np.int32],
    lines: NDArray[np.int64],
    line: int,
    other: int,
    apart: int,
) -> None:
    """Join the runs of two adjacent lines that are adjacent."""
    a, b = lines[line], lines[other]
    while a < lines[line + 1] and b < lines[other + 1]:
        if begins[a] - ends[b] <= apart and begins[b] - ends[a] <= apart:
            one, two = _root(parent, a), _root(parent, b)
            parent[max(one, two)] = min(one, two)
        if ends[a] < ends[b]:
            a += 1
        else:
            b += 1


@njit(cache=True)
def _root(parent: NDArray[np.int64], run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run
