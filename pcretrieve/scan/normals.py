"""Normals, and which side of a surface is outside."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.adapters import open3d
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.scan.outside import Outside, flood
from pcretrieve.scan.sampling import spacing
from pcretrieve.types import FloatArray, PointCloud, Step

__all__ = ["oriented_normals"]

# Neighbours whose own direction leans less than this towards a point's are on the other side of a thin part.
SAME_SIDE = 0.2

# Neighbours count by a Gaussian of their distance, this wide relative to the farthest.
NEIGHBOR_SPREAD = 0.7

# Points this far below the outside say nothing about whether the flood leaked; cells.
SHOWN = 4.0

# Least cell of the flood; spacings of the points. Its walls must be tight.
FLOOD_CELL = 1.3

# How much wider a gap is kept shut at each try.
WIDER = 1.4

# Share of neighbouring normals that must agree on a side. Over 26 scans of TOSCA a tight flood reaches .995
# to .999, one that leaked inside .75 to .89.
LEAST_AGREEMENT = 0.95

# Neighbours that are asked whether they agree.
VOTERS = 8

Neighborhoods = tuple[FloatArray, NDArray[np.intp]]


def oriented_normals(cloud: PointCloud, options: ScanOptions) -> PointCloud:
    """The cloud with unit normals that point out of the body.

    ``options.orientation`` says where their sign comes from: the sensor that saw each point, the file's own
    normals, a flood of the space outside, or tangent planes.

    Raises
    ------
    ReconstructionError
        If it asks for sensors or normals that the scan does not have.
    """
    started = time.perf_counter()
    method = options.orientation
    if method == "auto":
        method = "flood" if cloud.normals is None else "given"
        method = "viewpoint" if cloud.viewpoints is not None else method
    if method == "given":
        if cloud.normals is None:
            raise ReconstructionError(
                "scan.orientation 'given' needs a scan with normals, this one has none: take 'auto'",
                stage="orient",
            )
        return cloud.after(
            Step("orient", time.perf_counter() - started, {}, ("used the file's own normals",))
        )
    oriented, notes = ORIENTATIONS[method](cloud, options)
    step = Step("orient", time.perf_counter() - started, {"points": len(oriented)}, notes)
    return replace(cloud, normals=oriented).after(step)


def _by_viewpoint(cloud: PointCloud, options: ScanOptions) -> tuple[FloatArray, tuple[str, ...]]:
    """A sensor sees outsides only; where it looks along the surface, the flood tells the sides apart."""
    if cloud.viewpoints is None:
        raise ReconstructionError(
            "scan.orientation 'viewpoint' needs sensor positions, this scan has none: take 'auto'",
            stage="orient",
        )
    towards = _unit(cloud.viewpoints - cloud.points)
    neighbors = _neighbors(cloud.points, options)
    outside, _, notes = _tight_flood(cloud, neighbors, options)
    if outside is not None:
        towards = _unit(towards + outside.direction_at(cloud.points))
    return _guided_normals(cloud.points, towards, neighbors, options), notes


def _by_tangent_planes(cloud: PointCloud, options: ScanOptions) -> tuple[FloatArray, tuple[str, ...]]:
    normals = open3d.estimate_normals(cloud.points, n_neighbors=options.normal_neighbors)
    oriented = open3d.orient_by_tangent_planes(cloud.points, normals, n_neighbors=options.normal_neighbors)
    # The spanning tree starts at the highest point, whose normal must look up.
    top = cloud.points[:, 2].argmax()
    return (-oriented if oriented[top, 2] < 0 else oriented), ()


def _by_flood(cloud: PointCloud, options: ScanOptions) -> tuple[FloatArray, tuple[str, ...]]:
    """Each normal looks where the outside is nearest; where no flood is tight, tangent planes decide."""
    neighbors = _neighbors(cloud.points, options)
    _, oriented, notes = _tight_flood(cloud, neighbors, options)
    if oriented is None:
        oriented, _ = _by_tangent_planes(cloud, options)
        notes = (*notes, "tangent planes decided which side is outside")
    return oriented, notes


def _tight_flood(
    cloud: PointCloud, neighbors: Neighborhoods, options: ScanOptions
) -> tuple[Outside | None, FloatArray | None, tuple[str, ...]]:
    """Flood the outside from a corner, shutting wider and wider gaps until it does not leak inside.

    A leak shows in the normals that follow from it, (n, 3): neighbours disagree.
    """
    cell = max(options.flood_cell * cloud.diagonal, FLOOD_CELL * spacing(cloud.points))
    gap = options.flood_gap
    for attempt in range(options.flood_retries + 1):
        gap = options.flood_gap * WIDER**attempt
        outside = flood(cloud.points, cell=cell, gap=gap * cloud.diagonal)
        towards = outside.direction_at(cloud.points)
        oriented = _guided_normals(cloud.points, towards, neighbors, options)
        shown = outside.depth_at(cloud.points) < SHOWN
        if shown.sum() > VOTERS and _agreement(oriented, neighbors, shown) >= LEAST_AGREEMENT:
            note = f"the flood leaked; gaps up to {gap:.3f} of the diagonal were shut"
            return outside, oriented, (note,) if attempt else ()
    return None, None, (f"the flood leaked with gaps up to {gap:.3f} of the diagonal shut",)


def _unit(vectors: FloatArray) -> FloatArray:
    """(n, 3) vectors of length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))


def _guided_normals(
    points: FloatArray, guide: FloatArray, neighbors: Neighborhoods, options: ScanOptions
) -> FloatArray:
    """(n, 3) unit normals of the best plane through those neighbours that lie on the same side of the body.

    Ears, fingers and tails are thinner than a neighbourhood is wide: with the points of both sides in it, a
    plane stands askew. Neighbours count as far as their guide, a rough (n, 3) direction to the outside,
    agrees with the point's own; each normal takes the sign of its guide.
    """
    distance, near = (of[:, : options.normal_neighbors] for of in neighbors)  # (n, k)
    agreement = np.einsum("ij,ikj->ik", guide, guide[near])
    weight = np.clip((agreement - SAME_SIDE) / (1 - SAME_SIDE), 0, 1)
    weight[~guide.any(axis=1)] = 1
    weight *= np.exp(-((distance / (NEIGHBOR_SPREAD * distance[:, -1:] + np.finfo(float).tiny)) ** 2))
    around = points[near]  # (n, k, 3)
    middle = np.einsum("nk,nkd->nd", weight, around) / weight.sum(axis=1, keepdims=True)
    apart = around - middle[:, None]
    _, axes = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, apart, apart, optimize=True))
    normals = axes[:, :, 0]
    return np.asarray(np.where(np.einsum("ij,ij->i", normals, guide)[:, None] < 0, -normals, normals))


def _agreement(oriented: FloatArray, neighbors: Neighborhoods, shown: NDArray[np.bool_]) -> float:
    """Share of pairs of neighbours, both among the shown, whose normals point to one side."""
    near = neighbors[1][shown, 1 : VOTERS + 1]  # (m, VOTERS), without the point itself
    agree = np.einsum("ij,ikj->ik", oriented[shown], oriented[near]) > 0
    pairs = shown[near]
    return float((agree & pairs).sum() / max(1, pairs.sum()))


def _neighbors(points: FloatArray, options: ScanOptions) -> Neighborhoods:
    """(n, k) distances and numbers of the points nearest to each, itself first."""
    from scipy.spatial import cKDTree

    k = max(options.normal_neighbors, VOTERS + 1)
    distance, near = cKDTree(points).query(points, k=min(k, len(points)))
    return np.asarray(distance), np.asarray(near)


Orientation = Callable[[PointCloud, ScanOptions], tuple[FloatArray, tuple[str, ...]]]

ORIENTATIONS: dict[str, Orientation] = {
    "viewpoint": _by_viewpoint,
    "flood": _by_flood,
    "tangent-plane": _by_tangent_planes,
}
