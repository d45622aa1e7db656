"""One scan through all stages to its surface, its shape with spectra, or its signature."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components
from threadpoolctl import threadpool_limits

from pcretrieve.checks import findings_of, verdict_of
from pcretrieve.descriptors import describe
from pcretrieve.errors import PcretrieveError, ReconstructionError, ShapeError, Stage, in_stage, shape_error
from pcretrieve.formats import ScanLike
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pipeline.stages import Seen, log_steps, moved, scan_name, stages
from pcretrieve.spectral import eigenpairs, laplace_beltrami, star_mesh, unit_eigenpairs
from pcretrieve.values import (
    Eigenpairs,
    FloatArray,
    LaplaceBeltrami,
    ModalSpectrum,
    PointCloud,
    Shape,
    Signature,
    Step,
    Surface,
    TriangleMesh,
)


def signature(scan: ScanLike, options: OptionsLike = None) -> Signature:
    """The signature of one scan.

    Parameters
    ----------
    scan : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; see `as_geometry`.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.

    Returns
    -------
    Signature
        The signature; with the default options dimensionless and independent of the unit of the scan.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    return described_shape(scan, options)[0]


def described_shape(scan: ScanLike, options: OptionsLike = None) -> tuple[Signature, Shape]:
    """The signature of one scan, and the shape that it describes, with its verdict."""
    options = PipelineOptions.of(options)
    shape = process(scan, options)
    with placed(scan), in_stage(Stage.SIGNATURE):
        described = describe(shape, options.signature)
    return replace(described, digest=options.signature_digest), shape


def reconstruct(scan: ScanLike, options: OptionsLike = None) -> TriangleMesh:
    """The surface of one scan: closed, connected, manifold and oriented outwards.

    A mesh with these properties is used without reconstruction, unless ``options.surface.mode`` is
    ``reconstruct``; with the mode ``keep``, a mesh may have holes.

    Parameters
    ----------
    scan : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; see `as_geometry`.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.

    Returns
    -------
    TriangleMesh
        The surface; unit of the scan. Its `provenance` has a step for each stage, with a note for each repair
        and each fallback.

    Raises
    ------
    OptionError
        If the stages do not include the stage ``surface``.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with placed(scan):
        options = PipelineOptions.of(options)
        # No spectrum is computed; the element is set, because with some elements there is no surface.
        alone = options.changed(surface={"reconstructions": 1}, spectral={"element": "linear"})
        *_, last = stages(scan, alone)
    return last.surface


def process(scan: ScanLike, options: OptionsLike = None) -> Shape:
    """Compute the surfaces of one scan and their spectra, on one thread.

    More threads would not be faster, because the blocks of the eigenvalue solver are narrow, and threads wait
    for each other if a core is busy.

    Parameters
    ----------
    scan : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; see `as_geometry`.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.

    Returns
    -------
    Shape
        The surfaces with their spectra, the filtered points, the provenance and the verdict. Lengths are in
        the unit of the scan; spectra are those of the surfaces scaled to unit area.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    options = PipelineOptions.of(options)
    with threadpool_limits(limits=1), placed(scan):
        *_, last = stages(scan, options)
        shape = shape_of(last, options)
        started = time.perf_counter()
        verdict = verdict_of(findings_of(last.cloud, last.mesh, last.marks, shape).checks)
        step = Step(
            "checks",
            time.perf_counter() - started,
            {"uncertainty": verdict.uncertainty},
            () if verdict.is_sound else (str(verdict),),
        )
        shape = replace(shape, provenance=(*shape.provenance, step), verdict=verdict)
        log_steps(scan_name(scan), shape.provenance[-2:])
        return shape


def signature_of_surfaces(meshes: Sequence[TriangleMesh], options: PipelineOptions) -> FloatArray:
    """Compute the signature of a scan again from its surfaces, on one thread, as `process` does.

    Returns (L,) float64: the values of the signature.
    """
    with threadpool_limits(limits=1):
        shape = shape_of(Seen(mesh=meshes[0], others=tuple(meshes[1:])), options)
        with in_stage(Stage.SIGNATURE):
            return describe(shape, options.signature).values


def shape_of(seen: Seen, options: PipelineOptions) -> Shape:
    """Compute the spectra of the surfaces, or of the points, of one scan."""
    with in_stage(Stage.SPECTRUM):
        if seen.mesh is None and seen.cloud is not None:
            return _of_points(seen.cloud, options)
        started = time.perf_counter()
        element, found = options.spectral.element, []
        for mesh in (seen.surface, *seen.others):
            pairs = unit_eigenpairs(mesh, options.spectral.n_pairs, element)
            found.append((mesh, pairs))
        before = 0 if seen.cloud is None else len(seen.cloud.provenance)
        steps = [step for other in seen.others for step in other.provenance[before:]]
        mesh, pairs = found[0]
        step = Step("spectrum", time.perf_counter() - started, _sizes(pairs, mesh))
        # Descriptors of vertices are defined by the eigenfunctions of linear elements.
        surfaces = tuple(
            Surface(mesh.area, _unit_spectrum(pairs), mesh, pairs if element == "linear" else None)
            for mesh, pairs in found
        )
        return Shape(surfaces, seen.cloud, (*seen.surface.provenance, *steps, step))


@contextmanager
def placed(scan: object) -> Iterator[None]:
    """Add the file name of the scan to the exceptions that are raised inside, and convert unexpected ones."""
    name = scan_name(scan)
    try:
        yield
    except PcretrieveError as error:
        if isinstance(error, ShapeError):
            error.shape_id = error.shape_id or name
        raise
    except Exception as error:
        unexpected = shape_error(error)
        unexpected.shape_id = name
        raise unexpected from error


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
