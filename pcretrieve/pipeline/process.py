"""One scan through all stages to its surface, its shape with spectra, or its signature.

This is the only module that imports all stages. A mesh that is used without reconstruction (`surface.mode`)
passes through none of those that make a surface. Stages that work in single precision get coordinates near
the origin, because far from it they lose the shape.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components
from threadpoolctl import threadpool_limits

from pcretrieve import points
from pcretrieve.checks import Findings, findings_of, grade_of
from pcretrieve.descriptors import Descriptor, describe
from pcretrieve.descriptors.describe import MeshFunction
from pcretrieve.errors import (
    DegenerateMeshError,
    PcretrieveError,
    ReconstructionError,
    ShapeError,
    Stage,
    in_stage,
    shape_error,
)
from pcretrieve.formats import ScanLike, ScanPath, as_scan, located
from pcretrieve.formats.identity import content_hash
from pcretrieve.options import (
    JUDGED,
    OptionsLike,
    PipelineOptions,
    ScanOptions,
    SignatureOptions,
    SurfaceOptions,
)
from pcretrieve.pipeline import log_steps
from pcretrieve.points.neighbors import Neighborhoods, plane_neighborhoods
from pcretrieve.spectral import eigenpairs, laplace_beltrami, star_mesh, unit_eigenpairs
from pcretrieve.surface import reduced, remesh, sampled, sound_mesh, surfaces
from pcretrieve.surface.marching import level_set
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
from pcretrieve.values.conversion import as_cloud, as_geometry
from pcretrieve.values.files import lock
from pcretrieve.values.geometry import with_others
from pcretrieve.values.simplify import simplified
from pcretrieve.values.topology import SurfaceMarks, defects

V = TypeVar("V", PointCloud, TriangleMesh)

_remembered: dict[tuple[str, str], Shape] = {}
N_REMEMBERED = 200

# Said of a surface that fails, if all points have one sensor.
ONE_VIEW = (
    "all points are seen from one place, so that this is one view of the body: join it with "
    "views of its other sides by `pcretrieve merge`"
)

# The stages of points. A cloud that has passed some of them last does not pass these again.
FILTERS = ("crop", "clean", "orient")


def signature(
    scan: ScanLike,
    options: OptionsLike = None,
    *,
    method: str | Descriptor | MeshFunction | None = None,
) -> Signature:
    """The signature of one scan, whose quality `process` and `inspect` check.

    Parameters
    ----------
    scan : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; see `as_geometry`.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.
    method : str, Descriptor or function, optional
        The name of a descriptor, or several joined by ``+``; a descriptor of your own; or a function of a
        `TriangleMesh` that returns numbers. By default that of `options`.

    Returns
    -------
    Signature
        The signature; with the default options dimensionless and independent of the unit of the scan. Of a
        function, its numbers as they are, and its name.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface, or the function fails.
    """
    own = method if isinstance(method, Descriptor) or callable(method) else None
    named = {"method": method} if method and own is None else {}
    options = PipelineOptions.of(options).changed(signature=named)
    with threadpool_limits(limits=1), placed(scan):
        *_, last = stages(scan, options)
        shape = shape_of(last, options)
        log_steps(scan_name(scan), shape.provenance[-1:])
        return signature_of(shape, options, scan, own)


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
        and each fallback. Its `others` are further surfaces of the scan, so that its `signature` is that of
        the scan.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with placed(scan):
        # No spectrum is computed; the element is set, because with some elements there is no surface.
        options = PipelineOptions.of(options).changed(spectral={"element": "linear"})
        *_, last = stages(scan, options)
    first = last.surface
    return with_others(first.vertices, first.faces, first.provenance, last.others)


def crop(cloud: ScanLike, options: OptionsLike = None) -> PointCloud:
    """The points of a scan that are of the body, without background, ground and strays.

    `reconstruct` and `signature` do not crop its result again, so that filters of your own can follow.

    Parameters
    ----------
    cloud : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; of a mesh its vertices.
    options : OptionsLike, optional
        Options, of which those of the table ``scan`` count; see `PipelineOptions.of`.

    Returns
    -------
    PointCloud
        The points that are left, unchanged; unit of the scan. `PointCloud.up` is the normal of the ground.

    Raises
    ------
    ShapeError
        If the scan cannot be read, or too few points are left.
    """
    return _filtered(Stage.CROP, cloud, options, points.crop)


def clean(cloud: ScanLike, options: OptionsLike = None) -> PointCloud:
    """The mean of the points in each voxel, without outliers.

    `reconstruct` and `signature` do not clean its result again.

    Parameters
    ----------
    cloud : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; of a mesh its vertices.
    options : OptionsLike, optional
        Options, of which those of the table ``scan`` count; see `PipelineOptions.of`.

    Returns
    -------
    PointCloud
        The points that are left; unit of the scan.

    Raises
    ------
    ShapeError
        If the scan cannot be read, or too few points are left.
    """
    return _filtered(Stage.CLEAN, cloud, options, lambda *given: points.clean(*given)[0])


def orient(cloud: ScanLike, options: OptionsLike = None) -> PointCloud:
    """The points of a scan with normals that point out of the body.

    Parameters
    ----------
    cloud : ScanLike
        A path, an array, or geometry of this package, Open3D, trimesh or PyVista; of a mesh its vertices.
    options : OptionsLike, optional
        Options, of which those of the table ``scan`` count; see `PipelineOptions.of`.

    Returns
    -------
    PointCloud
        The same points; unit of the scan.

    Raises
    ------
    ShapeError
        If the scan cannot be read, or ``scan.orientation`` needs normals or sensors that it does not have.
    """
    return _filtered(Stage.ORIENT, cloud, options, _oriented)


def _filtered(
    stage: str,
    scan: ScanLike,
    options: OptionsLike,
    of: Callable[[PointCloud, ScanOptions], PointCloud],
) -> PointCloud:
    """The result of one stage for the points of a scan."""
    chosen = PipelineOptions.of(options).scan
    with placed(scan):
        cloud = as_cloud(as_scan(scan, chosen.unit))
        with in_stage(stage):
            return of(cloud, chosen)


def _oriented(cloud: PointCloud, options: ScanOptions) -> PointCloud:
    origin = cloud.points.mean(axis=0)
    return moved(points.oriented_normals(moved(cloud, -origin), options), origin)


def process(scan: ScanLike, options: OptionsLike = None) -> Shape:
    """Compute the surfaces of one scan and their spectra, and check them, on one thread.

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
        The surfaces with their spectra, the filtered points, the provenance and the grade. Lengths are in
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
        grade = grade_of(checked(last, shape).checks)
        notes = () if grade.is_good else (str(grade),)
        step = Step(
            "checks", time.perf_counter() - started, {"error": grade.error}, notes
        )
        shape = replace(shape, provenance=(*shape.provenance, step), grade=grade)
        log_steps(scan_name(scan), shape.provenance[-2:])
        return shape


def remembered(scan: ScanLike, options: PipelineOptions) -> Shape:
    """`process` of a scan, or what it gave last for the same content; without points and eigenvectors.

    A search over descriptors then makes each surface once. Some 200 shapes are remembered, of about 1 MB.
    """
    with placed(scan), in_stage(Stage.READ):
        place = located(scan)
        if isinstance(place, ScanPath):
            content = f"{content_hash(place)}{place.suffix}"
        else:
            content = hashlib.sha256(pickle.dumps(as_geometry(place))).hexdigest()
    key = content, options.digest
    if key not in _remembered:
        shape = process(scan, options)
        surfaces = tuple(replace(surface, eigenpairs=None) for surface in shape.surfaces)
        if len(_remembered) >= N_REMEMBERED:
            # Unless another thread was faster.
            _remembered.pop(next(iter(_remembered)), None)
        _remembered[key] = replace(shape, surfaces=surfaces)
    return _remembered[key]


def signature_of(
    shape: Shape,
    options: PipelineOptions,
    scan: ScanLike | None = None,
    method: Descriptor | MeshFunction | None = None,
) -> Signature:
    """The signature of the shape of a scan, by the same options."""
    with placed(scan), in_stage(Stage.SIGNATURE):
        return replace(
            describe(shape, options.signature, method), digest=options.signature_digest
        )


def judged_signature(shape: Shape) -> Signature | None:
    """The signature by which scans are judged; None if the spectrum is too short."""
    options = SignatureOptions(**JUDGED)
    if len(shape.spectrum.eigenvalues) <= options.n_modes:
        return None
    return describe(shape, options)


def checked(seen: Seen, shape: Shape | None) -> Findings:
    """What the checks find of the stages of a scan, and of its shape, if they came so far."""
    return findings_of(
        seen.cloud,
        seen.mesh,
        seen.marks,
        shape,
        judged=None if shape is None else judged_signature(shape),
        scan=seen.cropped,
        around=seen.around,
    )


def signature_of_surfaces(
    meshes: Sequence[TriangleMesh], options: PipelineOptions
) -> Signature:
    """Compute the signature of a scan again from its surfaces, on one thread, as `process` does."""
    with threadpool_limits(limits=1):
        return signature_of(
            shape_of(Seen(mesh=meshes[0], others=tuple(meshes[1:])), options), options
        )


# --- from a scan to its surfaces ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The results of the stages of a scan, up to some stage; lengths are in the unit of the scan."""

    scan: PointCloud | None = None
    cropped: PointCloud | None = None
    cleaned: PointCloud | None = None
    cloud: PointCloud | None = None  # as the last stage left it
    around: Neighborhoods | None = None  # of some of its points
    mesh: TriangleMesh | None = None
    marks: SurfaceMarks | None = None
    others: tuple[TriangleMesh, ...] = ()

    @property
    def surface(self) -> TriangleMesh:
        """The first surface; TypeError if there is none yet."""
        if self.mesh is None:
            raise TypeError("there must be a surface after the last stage, there is none")
        return self.mesh

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of all stages so far, in order."""
        latest = next(
            (each for each in (self.mesh, self.cloud, self.scan) if each is not None),
            None,
        )
        first = () if latest is None else latest.provenance
        further = (
            step for mesh in self.others for step in mesh.provenance if step not in first
        )
        return (*first, *further)


def stages(scan: ScanLike, options: PipelineOptions) -> Iterator[Seen]:
    """Run the stages before the stage ``spectrum``, and log each of them when it has ended."""
    seen = Seen()
    try:
        logged = 0
        for seen in _stages(scan, options):
            log_steps(scan_name(scan), seen.steps[logged:])
            logged = len(seen.steps)
            yield seen
    except ReconstructionError as error:
        # What the reader took for granted, or left out, may be why there is no surface.
        notes = [note for step in seen.steps for note in step.notes]
        sensors = None if seen.cloud is None else seen.cloud.viewpoints
        is_of_one = sensors is not None and np.allclose(sensors, sensors[0])
        if is_of_one and error.stage == Stage.SURFACE:
            notes.insert(0, ONE_VIEW)
        if notes:
            error.message = f"{error.message}; {'; '.join(notes)}"
        raise


def _stages(scan: ScanLike, options: PipelineOptions) -> Iterator[Seen]:
    with in_stage(Stage.READ):
        value = as_scan(scan, options.scan.unit)
    if isinstance(value, TriangleMesh):
        yield Seen(scan=PointCloud(value.vertices, provenance=value.provenance))
        if (
            value.others
            and not options.spectral.of_points
            and options.surface.mode != "reconstruct"
        ):
            mesh, *others = (
                _with_few_faces(each, options.surface) for each in (value, *value.others)
            )
            yield Seen(mesh=mesh, others=tuple(others))
            return
        with in_stage(Stage.SURFACE):
            kept = (
                None if options.spectral.of_points else sound_mesh(value, options.surface)
            )
            used = (
                sampled(value, options.surface)
                if kept is None
                else _with_few_faces(kept, options.surface)
            )
        if isinstance(used, TriangleMesh):
            yield Seen(mesh=used)
            return
        value = used
    compile_stages()
    yield from _of_scan(value, options)


def _of_scan(value: PointCloud, options: PipelineOptions) -> Iterator[Seen]:
    yield (seen := Seen(scan=value))
    latest = (step.stage for step in reversed(value.provenance))
    done = set(takewhile(FILTERS.__contains__, latest))
    # Normals of a file are not shown before they are oriented, because they need not point outwards.
    with in_stage(Stage.CROP):
        cloud = value if "crop" in done else points.crop(value, options.scan)
        bare = replace(cloud, normals=None)
    yield (seen := replace(seen, cropped=bare, cloud=bare))
    with in_stage(Stage.CLEAN):
        if "clean" in done:
            neighbors = plane_neighborhoods(cloud.points, options.scan)
        else:
            cloud, neighbors = points.clean(cloud, options.scan)
        bare = replace(cloud, normals=None)
    yield (seen := replace(seen, cleaned=bare, cloud=bare))
    with in_stage(Stage.ORIENT):
        origin = cloud.points.mean(axis=0)
        cloud = points.oriented_normals(moved(cloud, -origin), options.scan, neighbors)
    yield (seen := replace(seen, cloud=moved(cloud, origin), around=neighbors.some()))
    if not options.spectral.of_points:
        yield from _of_surfaces(seen, cloud, neighbors, origin, options)


@cache
def compile_stages() -> None:
    """Compile the loops of all stages, if setup.py has not; one process after the other."""
    from pcretrieve.points.voxels import components, distances

    components(np.zeros((1, 1, 1), dtype=np.bool_), False)
    if components.dispatcher.stats.cache_misses:
        logging.getLogger("pcretrieve").warning(
            "compiling, once after an installation: half a minute"
        )
        # Even points, along a spiral by the golden angle, need none of Open3D, which no build has.
        up = np.linspace(-0.999, 0.999, 4_000)
        flat = np.sqrt(1 - up**2) * np.exp(2.39996j * np.arange(4_000))
        body = np.stack([flat.real, 0.6 * flat.imag, 0.3 * up], axis=1)
        with Path(__file__).open(encoding="utf-8") as file:
            with suppress(OSError):  # a file system without locks
                lock(file)
            # In 32 bits: `body` needs 16 only.
            distances(np.zeros((1, 1, 200), dtype=np.bool_), np.inf)
            # Another process compiles the later stages; this one does it, if that one cannot.
            other = subprocess.Popen(
                [sys.executable, "-c", LATER_STAGES], stderr=subprocess.DEVNULL
            )
            for last in _of_scan(PointCloud(body), options := PipelineOptions()):
                if last.mesh is not None:
                    other.wait()
            describe(shape_of(last, options), options.signature)


LATER_STAGES = f"from {__name__} import compile_later_stages; compile_later_stages()"


def compile_later_stages() -> None:
    """Compile the loops that make a mesh of voxels, and those of meshes."""
    x, y, z = np.indices((40, 40, 40)) - 19.5
    voxels = TriangleMesh(*level_set(-(x**2 + 2 * y**2 + 3 * z**2), -300.0))
    mesh, options = simplified(voxels, 2_000), PipelineOptions()
    describe(shape_of(Seen(mesh=mesh), options), options.signature)


def _of_surfaces(
    seen: Seen,
    cloud: PointCloud,
    neighbors: Neighborhoods,
    origin: FloatArray,
    options: PipelineOptions,
) -> Iterator[Seen]:
    """Yield the surfaces of points near the origin; the first before and after it is remeshed.

    origin: (3,) float64, that of the points in the frame of the scan.
    """
    with in_stage(Stage.SURFACE):
        made = surfaces(cloud, neighbors, options.surface)
        mesh, marks = next(made)
    if unused := options.surface.unused:
        ignored = f"surface.method = {options.surface.method!r} does not use {', '.join(unused)}"
        mesh = mesh.after(Step("surface", 0.0, notes=(ignored,)))
    seen = replace(
        seen,
        mesh=moved(mesh, origin),
        marks=None if marks is None else marks.moved(origin),
    )
    yield seen
    yield (seen := replace(seen, mesh=moved(_remeshed(mesh, options), origin)))
    try:
        with in_stage(Stage.SURFACE):
            for mesh, _ in made:
                further = moved(_remeshed(mesh, options), origin)
                yield (seen := replace(seen, others=(*seen.others, further)))
    except ReconstructionError as error:
        # One surface suffices for a signature; only the error bar needs two.
        note = Step(
            "surface", 0.0, notes=(f"no further surface could be made: {error.message}",)
        )
        yield replace(seen, mesh=seen.surface.after(note))


def _remeshed(mesh: TriangleMesh, options: PipelineOptions) -> TriangleMesh:
    with in_stage(Stage.REMESH):
        result = remesh(mesh, options.remesh)
    if wrong := defects(result):
        raise DegenerateMeshError(
            f"the surface must be a closed manifold, it has defects: {wrong}"
        )
    return result


def _with_few_faces(mesh: TriangleMesh, options: SurfaceOptions) -> TriangleMesh:
    """A mesh that is used without reconstruction, with at most `max_faces` faces."""
    if len(mesh.faces) <= options.max_faces:
        return mesh
    origin = mesh.vertices.mean(axis=0)
    return moved(reduced(moved(mesh, -origin), options), origin)


def moved(value: V, by: FloatArray) -> V:
    """Translate points or a surface.

    by: (3,) float64, the translation.
    """
    if isinstance(value, TriangleMesh):
        return replace(value, vertices=value.vertices + by)
    viewpoints = None if value.viewpoints is None else value.viewpoints + by
    return replace(value, points=value.points + by, viewpoints=viewpoints)


# --- from surfaces to spectra --------------------------------------------------------------------------


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
        mesh, pairs = found[0]
        step = Step("spectrum", time.perf_counter() - started, _sizes(pairs, mesh))
        # Descriptors of vertices are defined by the eigenfunctions of linear elements.
        surfaces = tuple(
            Surface(
                mesh.area,
                _unit_spectrum(pairs),
                mesh,
                pairs if element == "linear" else None,
            )
            for mesh, pairs in found
        )
        return Shape(surfaces, seen.cloud, (*seen.steps, step))


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
    return Shape(
        (Surface(operator.area, _unit_spectrum(pairs), mesh),),
        cloud,
        (*mesh.provenance, step),
    )


def _largest_piece(
    cloud: PointCloud, options: PipelineOptions
) -> tuple[PointCloud, LaplaceBeltrami, tuple[str, ...]]:
    """The largest connected component of the points, its operator, and a note on removed loose pieces."""
    operator = laplace_beltrami(
        moved(cloud, -cloud.points.mean(axis=0)), options.spectral.element
    )
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
    stiffness, mass = (
        csc_array(full[:, kept][kept]) for full in (operator.stiffness, operator.mass)
    )
    note = (
        f"dropped {len(share) - 1} loose pieces with {1 - share.max():.1%} of the points"
    )
    return cloud.select(kept), LaplaceBeltrami(stiffness, mass), (note,)


# --- names and messages --------------------------------------------------------------------------------


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


def scan_name(scan: object) -> str | None:
    """The name of a scan in messages."""
    is_path = isinstance(scan, (str, Path, ScanPath))
    return Path(str(scan)).name if is_path else None
