"""The stage ``spectrum``: surfaces, or points with normals → shape with spectra."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components

from pcretrieve.errors import ReconstructionError, Stage, in_stage
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.frames import moved
from pcretrieve.pipeline.seen import Seen
from pcretrieve.spectral import eigenpairs, laplace_beltrami, star_mesh, unit_eigenpairs
from pcretrieve.values import (
    Eigenpairs,
    LaplaceBeltrami,
    ModalSpectrum,
    PointCloud,
    Shape,
    Step,
    Surface,
    TriangleMesh,
)

__all__ = ["shape_of"]


def shape_of(seen: Seen, options: PipelineOptions) -> Shape:
    """Compute the spectra of the surfaces, or of the points, of one scan."""
    with in_stage(Stage.SPECTRUM):
        if seen.mesh is None and seen.cloud is not None:
            return _of_points(seen.cloud, options)
        return _of_surfaces(seen, options)


def _of_surfaces(seen: Seen, options: PipelineOptions) -> Shape:
    started = time.perf_counter()
    surface, sizes = _with_spectrum(seen.surface, options)
    others = tuple(_with_spectrum(other, options)[0] for other in seen.others)
    before = 0 if seen.cloud is None else len(seen.cloud.provenance)
    steps = [step for other in seen.others for step in other.provenance[before:]]
    step = Step("spectrum", time.perf_counter() - started, sizes)
    return Shape((surface, *others), seen.cloud, (*seen.surface.provenance, *steps, step))


def _with_spectrum(mesh: TriangleMesh, options: PipelineOptions) -> tuple[Surface, dict[str, float]]:
    pairs = unit_eigenpairs(mesh, options.spectral.n_pairs, options.spectral.element)
    # Of linear elements, which descriptors of vertices are defined by.
    kept = pairs if options.spectral.element == "linear" else None
    return Surface(mesh.area, _unit_spectrum(pairs), mesh, kept), _sizes(pairs, mesh)


def _unit_spectrum(pairs: Eigenpairs) -> ModalSpectrum:
    """The modal spectrum of a surface with unit area, which `pairs` has up to rounding errors."""
    return replace(ModalSpectrum.of(pairs), area=1.0)


def _sizes(pairs: Eigenpairs, mesh: TriangleMesh) -> dict[str, float]:
    """The sizes in the step of the stage."""
    return {
        "vertices": len(mesh.vertices),
        "pairs": len(pairs.eigenvalues),
        "residual": pairs.largest_residual,
    }


def _of_points(cloud: PointCloud, options: PipelineOptions) -> Shape:
    started = time.perf_counter()
    cloud, operator, notes = _largest_piece(cloud, options)
    mesh = star_mesh(cloud)
    unit = replace(operator, mass=csc_array(operator.mass / operator.area))
    pairs = eigenpairs(unit, options.spectral.n_pairs)
    step = Step("spectrum", time.perf_counter() - started, _sizes(pairs, mesh), notes)
    return Shape((Surface(operator.area, _unit_spectrum(pairs), mesh),), cloud, (*mesh.provenance, step))


def _largest_piece(
    cloud: PointCloud, options: PipelineOptions
) -> tuple[PointCloud, LaplaceBeltrami, tuple[str, ...]]:
    """The largest connected component of the points, its operator, and a note on removed loose pieces."""
    operator = laplace_beltrami(moved(cloud, -cloud.points.mean(axis=0)), options.spectral.element)
    if operator.n_components == 1:
        return cloud, operator, ()
    _, piece = connected_components(operator.stiffness, directed=False)  # (n,)
    share = np.bincount(piece) / len(piece)
    second = np.sort(share)[-2]
    if second > options.surface.max_discarded:
        raise ReconstructionError(
            f"the scan holds two bodies or more: a second piece has {second:.0%} of the points; cut them "
            "apart, or raise surface.max_discarded"
        )
    kept = np.flatnonzero(piece == share.argmax())
    stiffness, mass = (csc_array(full[:, kept][kept]) for full in (operator.stiffness, operator.mass))
    note = f"dropped {len(share) - 1} loose pieces with {1 - share.max():.1%} of the points"
    return cloud.select(kept), LaplaceBeltrami(stiffness, mass), (note,)
