"""Oriented points → the indicator function of their body on a coarse grid, by Fourier transforms."""

from __future__ import annotations

import numpy as np
from numba import njit

from pcretrieve.points.voxels import Grid, Voxels
from pcretrieve.values import FloatArray

__all__ = ["indicator"]

# Standard deviation of the Gaussian filter of the indicator function; in voxels.
FILTER = 0.6


def indicator(points: FloatArray, normals: FloatArray, spacings: FloatArray, grid: Grid) -> Voxels:
    """The indicator function of a body, smoothed, from oriented points of its surface [1]_.

    The gradient of the indicator function χ is concentrated on the surface, where it is −n. It is known at
    the points, each of which stands for a small piece of the surface, and χ is the solution of the Poisson
    equation whose right side is the divergence of this field. On a periodic grid the Fourier transform of χ
    is i k · V / k², with the transform V of the field n and the wave vector k. Where a part of the surface
    was not seen, χ is the solid angle of the other parts divided by 4π (generalized winding number [2]_):
    in a flat hole it is 1/2.

    points, normals: (n, 3) float64, coordinates, inside the grid, and unit normals that point out of the
        body.
    spacings: (n,) float64, the square root of the area of surface for each point. A point stands for an area
        of at most one face of a voxel. Unit of the points.
    Returns (a, b, c) float32: about 1 inside and 0 outside. Exactly 0 at the corners of the grid.

    References
    ----------
    .. [1] M. Kazhdan, "Reconstruction of solid models from oriented point sets", Symposium on Geometry
       Processing 2005.
    .. [2] G. Barill, N. Dickson, R. Schmidt, D. Levin and A. Jacobson, "Fast winding numbers for soups and
       clouds", ACM Transactions on Graphics 37 (2018).
    """
    from scipy import fft

    shares = np.minimum(spacings / grid.cell, 1) ** 2  # of the area of the face of a voxel
    field = _splatted(grid.coordinates(points), shares[:, None] * normals, grid.shape)
    n_x, n_y, n_z = grid.shape
    frequencies = np.ix_(fft.fftfreq(n_x), fft.fftfreq(n_y), fft.rfftfreq(n_z))
    x, y, z = (np.asarray(2 * np.pi * frequency, dtype=np.float32) for frequency in frequencies)
    squares = x**2 + y**2 + z**2
    squares[0, 0, 0] = 1  # the divergence is zero there
    divergence = x * fft.rfftn(field[0]) + y * fft.rfftn(field[1]) + z * fft.rfftn(field[2])
    smooth = np.exp(np.float32(-(FILTER**2) / 2) * squares) / squares
    values = fft.irfftn(np.complex64(1j) * smooth * divergence, grid.shape)
    return np.asarray(values - values[0, 0, 0], dtype=np.float32)


@njit(cache=True)
def _splatted(at: FloatArray, vectors: FloatArray, shape: tuple[int, int, int]) -> Voxels:
    """(3, a, b, c) sums of vectors at positions in voxels, by trilinear weights."""
    field = np.zeros((3, shape[0], shape[1], shape[2]), dtype=np.float32)
    for i in range(len(at)):
        x, y, z = int(at[i, 0]), int(at[i, 1]), int(at[i, 2])
        u, v, w = at[i, 0] - x, at[i, 1] - y, at[i, 2] - z
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    share = abs(1 - a - u) * abs(1 - b - v) * abs(1 - c - w)
                    for axis in range(3):
                        field[axis, x + a, y + b, z + c] += share * vectors[i, axis]
    return field
