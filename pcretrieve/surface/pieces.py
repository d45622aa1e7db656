"""Parts of a body that holes in the scan have cut off, joined to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.scan.outside import Grid
from pcretrieve.types import FloatArray

__all__ = ["joined"]

Mask = NDArray[np.bool_]

# Pieces that hold at least this share of the points belong to the body, and are joined to it.
LEAST_PIECE = 0.002


def joined(
    inside: Mask, points: FloatArray, grid: Grid, options: SurfaceOptions, notes: list[str]
) -> tuple[Mask, NDArray[np.intp]]:
    """The largest piece with those that belong to it, without cavities; and (j, 3) cells that join them."""
    from scipy import ndimage

    nowhere = np.zeros((0, 3), dtype=np.intp)
    pieces, n = ndimage.label(inside)
    if n == 0:
        return inside, nowhere
    # Points lie on the surface of their piece, in it or just outside.
    at = np.array(grid.index(points))  # (3, n)
    near = pieces[tuple(at)]  # (n,)
    beside = near == 0
    round_it = np.indices((3, 3, 3)).reshape(3, 27, 1) - 1
    x, y, z = at[:, None, beside] + round_it  # (27, b) each
    near[beside] = pieces[x, y, z].max(axis=0, initial=0)
    support = np.bincount(near, minlength=n + 1) / len(points)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    body = pieces == sizes.argmax()
    support[0] = support[sizes.argmax()] = 0
    bridges = []
    for piece in np.argsort(-support)[: int((support > LEAST_PIECE).sum())]:
        depth, nearest = ndimage.distance_transform_edt(~body, return_indices=True)
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
    hollow, _ = ndimage.label(~body, np.ones((3, 3, 3)))
    return hollow != hollow[0, 0, 0], np.concatenate([nowhere, *bridges])


def _thickness(piece: Mask) -> float:
    """Largest distance from the outside; cells."""
    from scipy.ndimage import distance_transform_edt

    return float(distance_transform_edt(piece).max())


def _tube(start: NDArray[np.intp], end: NDArray[np.intp], *, radius: float) -> NDArray[np.intp]:
    """(k, 3) cells nearer than `radius` to the line between two cells."""
    low = np.minimum(start, end) - int(radius) - 1
    box = np.indices(np.abs(end - start) + 2 * int(radius) + 3).reshape(3, -1).T + low  # (b, 3)
    along = (end - start).astype(np.float64)
    share = np.clip((box - start) @ along / max(along @ along, 1e-9), 0, 1)  # (b,)
    apart = np.linalg.norm(box - start - share[:, None] * along, axis=1)
    return np.asarray(box[apart <= radius], dtype=np.intp)
