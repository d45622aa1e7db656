"""Components of a body that a hole in the scan has separated: connected to the body, or removed."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.voxels import Grid, Mask, components
from pcretrieve.values import FloatArray

__all__ = ["joined"]


# Smallest fraction of the points in a component for it to be connected to the body.
LEAST_PIECE = 0.002


def joined(
    inside: Mask, points: FloatArray, grid: Grid, options: SurfaceOptions, notes: list[str]
) -> tuple[Mask, NDArray[np.intp]]:
    """Connect the large components of a set of voxels, and fill its cavities.

    A component with at least `LEAST_PIECE` of the points is connected to the body by a cylinder of voxels if
    it is near enough; other components are removed.

    inside: (a, b, c) bool, the set of voxels; False on the border of the grid.
    points: (n, 3) float64, the points of the scan; unit of the file.
    Returns body : (a, b, c) bool: 6-connected, without cavities.
    Returns bridges : (j, 3) int: the voxels that were added to connect components.
    """
    from scipy.ndimage import distance_transform_edt

    nowhere = np.zeros((0, 3), dtype=np.intp)
    pieces, sizes = components(inside, corners=False)
    if len(sizes) == 1:
        return inside, nowhere
    near = _pieces_at(pieces, grid.coordinates(points))  # (n,)
    support = np.bincount(near, minlength=len(sizes)) / len(points)
    sizes[0] = 0
    body = pieces == sizes.argmax()
    support[0] = support[sizes.argmax()] = 0
    bridges = []
    for piece in np.argsort(-support)[: int((support > LEAST_PIECE).sum())]:
        depth, nearest = distance_transform_edt(~body, return_indices=True)
        cells = np.argwhere(pieces == piece)
        start = cells[depth[tuple(cells.T)].argmin()]
        gap = depth[tuple(start)] * grid.cell
        if gap > options.bridge * np.linalg.norm(np.ptp(points, axis=0)):
            if support[piece] > options.max_discarded:
                raise ReconstructionError(
                    f"the scan holds two bodies or more: a second piece has {support[piece]:.0%} of the "
                    "points; cut them apart, or raise surface.max_discarded"
                )
            notes.append(f"dropped a piece with {support[piece]:.1%} of the points, {gap:.3g} away")
            continue
        end = nearest[:, start[0], start[1], start[2]].astype(np.intp)
        tube = _tube(start, end, radius=min(3.0, max(1.5, _thickness(pieces == piece))))
        bridges.append(tube[~body[tuple(tube.T)] & (pieces[tuple(tube.T)] != piece)])
        body |= pieces == piece
        body[tuple(tube.T)] = True
        notes.append(f"joined a piece with {support[piece]:.1%} of the points across a gap of {gap:.3g}")
    hollow, _ = components(~body, corners=True)
    return hollow != hollow[0, 0, 0], np.concatenate([nowhere, *bridges])


@njit(cache=True)
def _pieces_at(pieces: NDArray[np.int32], at: FloatArray) -> NDArray[np.int32]:
    """The component of each point, which is in its voxel or in one adjacent to it; 0 for none."""
    found = np.zeros(len(at), dtype=np.int32)
    for i in range(len(at)):
        x, y, z = int(np.rint(at[i, 0])), int(np.rint(at[i, 1])), int(np.rint(at[i, 2]))
        found[i] = pieces[x, y, z]
        if found[i] == 0:
            found[i] = pieces[x - 1 : x + 2, y - 1 : y + 2, z - 1 : z + 2].max()
    return found


def _thickness(piece: Mask) -> float:
    """Largest distance of a voxel of the component from its complement; in voxels."""
    from scipy.ndimage import distance_transform_edt

    return float(distance_transform_edt(piece).max())


def _tube(start: NDArray[np.intp], end: NDArray[np.intp], *, radius: float) -> NDArray[np.intp]:
    """(k, 3) voxels at a distance of at most `radius` from the segment between two voxels; in voxels."""
    low = np.minimum(start, end) - int(radius) - 1
    box = np.indices(np.abs(end - start) + 2 * int(radius) + 3).reshape(3, -1).T + low  # (b, 3)
    along = (end - start).astype(np.float64)
    share = np.clip((box - start) @ along / max(along @ along, 1e-9), 0, 1)  # (b,)
    apart = np.linalg.norm(box - start - share[:, None] * along, axis=1)
    return np.asarray(box[apart <= radius], dtype=np.intp)
