"""One scan through all stages to its surface, its shape with spectra, or its signature."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from threadpoolctl import threadpool_limits

from pcretrieve.checks import findings_of, verdict_of
from pcretrieve.descriptors import describe
from pcretrieve.errors import PcretrieveError, ShapeError, Stage, in_stage, shape_error
from pcretrieve.formats import ScanLike
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pipeline.progress import log_steps, scan_name
from pcretrieve.pipeline.seen import Seen
from pcretrieve.pipeline.spectra import shape_of
from pcretrieve.pipeline.stages import stages
from pcretrieve.values import FloatArray, Shape, Signature, Step, TriangleMesh, Verdict

__all__ = [
    "described_shape",
    "judged_signature",
    "placed",
    "process",
    "reconstruct",
    "signature",
    "signature_of_surfaces",
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
        The signature; with the default options dimensionless and independent of the unit of the scan.

    Raises
    ------
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    return judged_signature(scan, options)[0]


def judged_signature(scan: ScanLike, options: OptionsLike = None) -> tuple[Signature, Verdict]:
    """The signature of one scan, and whether it can be relied on."""
    described, verdict, _ = described_shape(scan, options)
    return described, verdict


def described_shape(scan: ScanLike, options: OptionsLike = None) -> tuple[Signature, Verdict, Shape]:
    """The signature of one scan, whether it can be relied on, and the shape that it describes."""
    options = PipelineOptions.of(options)
    shape, verdict = _judged(scan, options)
    with placed(scan), in_stage(Stage.SIGNATURE):
        described = describe(shape, options.signature)
    return replace(described, digest=options.signature_digest), verdict, shape


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
    return _judged(scan, PipelineOptions.of(options))[0]


def signature_of_surfaces(meshes: Sequence[TriangleMesh], options: PipelineOptions) -> FloatArray:
    """Compute the signature of a scan again from its surfaces, on one thread, as `process` does.

    Returns (L,) float64: the values of the signature.
    """
    with threadpool_limits(limits=1):
        shape = shape_of(Seen(mesh=meshes[0], others=tuple(meshes[1:])), options)
        with in_stage(Stage.SIGNATURE):
            return describe(shape, options.signature).values


def _judged(scan: ScanLike, options: PipelineOptions) -> tuple[Shape, Verdict]:
    """The shape of a scan with its verdict, and the verdict."""
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
        return shape, verdict


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
