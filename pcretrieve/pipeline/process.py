"""The only module that knows every stage: scan → surface → spectrum → signature."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components
from threadpoolctl import threadpool_limits

from pcretrieve.adapters import tetwild
from pcretrieve.descriptors import describe
from pcretrieve.errors import (
    DegenerateMeshError,
    PcretrieveError,
    ReconstructionError,
    ShapeError,
    Stage,
    in_stage,
    shape_error,
)
from pcretrieve.formats.scans import ScanLike, as_scan
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pipeline.progress import log_steps, scan_name
from pcretrieve.pipeline.seen import Seen
from pcretrieve.scan import clean, oriented_normals
from pcretrieve.spectral import ELEMENTS, eigenpairs, laplace_beltrami, star_mesh, unit_eigenpairs
from pcretrieve.surface import (
    SurfaceMarks,
    defects,
    remesh,
    sampled,
    sound_mesh,
    surfaces,
)
from pcretrieve.types import (
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

__all__ = [
    "described_shape",
    "placed",
    "process",
    "reconstruct",
    "signature",
    "surface_stages",
]


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
        Dimensionless; the same for a scan in millimetres and in metres.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    options = PipelineOptions.of(options)
    shape = process(scan, options)
    with placed(scan), in_stage(Stage.SIGNATURE):
        described = describe(shape, options.signature)
    return replace(described, digest=options.signature_digest)


def reconstruct(scan: ScanLike, options: OptionsLike = None) -> TriangleMesh:
    """The surface of one scan: closed, connected, manifold, pointing outwards.

    A mesh with these properties is used as it is, unless ``options.surface.mode`` is ``reconstruct``; with
    the mode ``keep``, a mesh may have holes.

    Parameters
    ----------
    scan : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; see `as_geometry`.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.

    Returns
    -------
    TriangleMesh
        In the unit of the scan. Its `provenance` has a step for each stage, with a note for each repair and
        each fallback.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with placed(scan):
        options = PipelineOptions.of(options)
        *_, last = surface_stages(scan, options.changed(surface={"reconstructions": 1}))
    return _surface_of(last)


def _surface_of(seen: Seen) -> TriangleMesh:
    if seen.mesh is None:
        raise TypeError("there must be a surface after the last stage, there is none")
    return seen.mesh


def surface_stages(scan: object, options: PipelineOptions) -> Iterator[Seen]:
    """The stages from a scan to its surface, one at a time. Each is logged when it has ended.

    Parameters
    ----------
    scan : object
        As `reconstruct` takes it.
    options : PipelineOptions
        Of which the stages up to `remesh` are used.

    Yields
    ------
    Seen
        What there is after each stage; the last has the final surfaces.

    Raises
    ------
    ShapeError
        In the stage that fails, after the stages before it have been yielded.
    """
    name, logged = scan_name(scan), 0
    for seen in _surface_stages(scan, options):
        steps = seen.steps
        log_steps(name, steps[logged:])
        logged = len(steps)
        yield seen


def _surface_stages(scan: object, options: PipelineOptions) -> Iterator[Seen]:
    with in_stage(Stage.READ):
        value = as_scan(scan)
    if isinstance(value, TriangleMesh):
        yield Seen(scan=PointCloud(value.vertices, provenance=value.provenance))
        with in_stage(Stage.SURFACE):
            kept = sound_mesh(value, options.surface)
        if kept is not None:
            yield Seen(mesh=kept)
            return
        with in_stage(Stage.SURFACE):
            value = sampled(value, options.surface)
    if options.remesh.method == "tetwild":
        tetwild.start()
    yield (seen := Seen(scan=value))
    with in_stage(Stage.CLEAN):
        cleaned = clean(value, options.scan)
    yield (seen := replace(seen, cloud=replace(cleaned, normals=None)))
    # Open3D reconstructs in single precision: far from the origin it loses the shape, or crashes.
    origin = cleaned.points.mean(axis=0)
    with in_stage(Stage.ORIENT):
        cloud = oriented_normals(_moved(cleaned, -origin), options.scan)
    yield (seen := replace(seen, cloud=_moved(cloud, origin)))
    with in_stage(Stage.SURFACE):
        made = surfaces(cloud, options.surface)
        mesh, found = next(made)
    if unused := options.surface.unused:
        ignored = f"surface.method = {options.surface.method!r} does not use {', '.join(unused)}"
        mesh = mesh.after(Step("surface", 0.0, notes=(ignored,)))
    marks = None if found is None else SurfaceMarks(found.cuts + origin, found.bridges + origin)
    yield (seen := replace(seen, mesh=_mesh_moved(mesh, origin), marks=marks))
    final = _mesh_moved(_final(mesh, options), origin)
    yield (seen := replace(seen, mesh=final))
    try:
        with in_stage(Stage.SURFACE):
            for other, _ in made:
                moved = _mesh_moved(_final(other, options), origin)
                yield (seen := replace(seen, others=(*seen.others, moved)))
    except ReconstructionError as error:
        # One surface is enough for a signature; two are needed only for its error bar.
        note = Step("surface", 0.0, notes=(f"no further surface could be made: {error.message}",))
        yield replace(seen, mesh=final.after(note))


def _final(mesh: TriangleMesh, options: PipelineOptions) -> TriangleMesh:
    with in_stage(Stage.REMESH):
        final = remesh(mesh, options.remesh)
    if wrong := defects(final):
        raise DegenerateMeshError(f"the surface must be a closed manifold, it has defects: {wrong}")
    return final


def process(scan: ScanLike, options: OptionsLike = None) -> Shape:
    """Make the surfaces of one scan and their spectra, on one thread.

    More threads would not help: the blocks of the eigensolver are narrow, and threads wait for each other
    where other work keeps a core busy.

    Parameters
    ----------
    scan : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; see `as_geometry`.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.

    Returns
    -------
    Shape
        The surfaces with their spectra, the filtered points and the provenance; lengths in the unit of the
        scan, spectra of surfaces of unit area.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    options = PipelineOptions.of(options)
    with threadpool_limits(limits=1), placed(scan):
        if ELEMENTS[options.spectral.element].needs == "points":
            return _of_points(scan, options)
        *_, last = surface_stages(scan, options)
        with in_stage(Stage.SPECTRUM):
            shape = described_shape(last, options)
        log_steps(scan_name(scan), shape.provenance[-1:])
        return shape


def described_shape(seen: Seen, options: PipelineOptions) -> Shape:
    """The shape whose surfaces are those of one scan, with their spectra.

    Parameters
    ----------
    seen : Seen
        The result of the last stage of `surface_stages`.
    options : PipelineOptions
        Of which `spectral` is used.

    Returns
    -------
    Shape
        As of `process`.

    Raises
    ------
    SpectrumError
        If a surface has no spectrum.
    """
    mesh = _surface_of(seen)
    started = time.perf_counter()
    surface, sizes = _with_spectrum(mesh, options)
    others = tuple(_with_spectrum(other, options)[0] for other in seen.others)
    before = 0 if seen.cloud is None else len(seen.cloud.provenance)
    steps = [step for other in seen.others for step in other.provenance[before:]]
    step = Step("spectrum", time.perf_counter() - started, sizes)
    return Shape((surface, *others), seen.cloud, (*mesh.provenance, *steps, step))


def _with_spectrum(mesh: TriangleMesh, options: PipelineOptions) -> tuple[Surface, dict[str, float]]:
    pairs = unit_eigenpairs(mesh, options.spectral.n_pairs, options.spectral.element)
    return Surface(mesh.area, _unit_spectrum(pairs), mesh), _sizes(pairs, mesh)


def _unit_spectrum(pairs: Eigenpairs) -> ModalSpectrum:
    """The spectrum of a surface of unit area, which it has but for rounding."""
    return replace(ModalSpectrum.of(pairs), area=1.0)


def _sizes(pairs: Eigenpairs, mesh: TriangleMesh) -> dict[str, float]:
    """What the step of the stage states."""
    return {
        "vertices": len(mesh.vertices),
        "pairs": len(pairs.eigenvalues),
        "residual": pairs.largest_residual,
    }


def _of_points(scan: object, options: PipelineOptions) -> Shape:
    """The spectrum of a cloud that no surface is made of."""
    cloud = _oriented(scan, options)
    started = time.perf_counter()
    with in_stage(Stage.SPECTRUM):
        cloud, operator, notes = _largest_piece(cloud, options)
        mesh = star_mesh(cloud)
        unit = replace(operator, mass=csc_array(operator.mass / operator.area))
        pairs = eigenpairs(unit, options.spectral.n_pairs)
    step = Step("spectrum", time.perf_counter() - started, _sizes(pairs, mesh), notes)
    return Shape((Surface(operator.area, _unit_spectrum(pairs), mesh),), cloud, (*mesh.provenance, step))


def _oriented(scan: object, options: PipelineOptions) -> PointCloud:
    """The cleaned points with their normals, of a mesh those sampled from it: the way as far as a surface."""
    for seen in surface_stages(scan, options.changed(surface={"mode": "reconstruct"})):
        if seen.cloud is not None and seen.cloud.normals is not None:
            return seen.cloud
    raise TypeError("a surface is always made from oriented points")


def _largest_piece(
    cloud: PointCloud, options: PipelineOptions
) -> tuple[PointCloud, LaplaceBeltrami, tuple[str, ...]]:
    """The points that hang together, without clumps of strays; their operator; and what was dropped."""
    operator = laplace_beltrami(_moved(cloud, -cloud.points.mean(axis=0)), options.spectral.element)
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


def _mesh_moved(mesh: TriangleMesh, by: FloatArray) -> TriangleMesh:
    return replace(mesh, vertices=mesh.vertices + by)


def _moved(cloud: PointCloud, by: FloatArray) -> PointCloud:
    return replace(
        cloud,
        points=cloud.points + by,
        viewpoints=None if cloud.viewpoints is None else cloud.viewpoints + by,
    )


@contextmanager
def placed(scan: object) -> Iterator[None]:
    """Add the file name of the scan to the exceptions that are raised inside, and convert unexpected ones.

    Parameters
    ----------
    scan : object
        A path; for other values there is no name to add.

    Yields
    ------
    None
        Once.

    Raises
    ------
    PcretrieveError
        The exception that was raised inside; an `UnexpectedError` instead of one of another library.
    """
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
