"""One scan through the pipeline, compared with the clean mesh; runs in a worker process."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pcretrieve.adapters.rays import RayScene
from pcretrieve.benchmarks.memory import forget_peak, peak_memory
from pcretrieve.descriptors import describe
from pcretrieve.formats import read_scan
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.points import clean, oriented_normals
from pcretrieve.surface import defects
from pcretrieve.surface.sampling import uniform_points
from pcretrieve.values import FloatArray, PointCloud, Shape, TriangleMesh

__all__ = ["N_VALUES", "Examination", "Signatures", "clean_signatures", "examine", "stacked"]

# Lengths of the signatures that are compared, independent of the configuration: the length in the paper, and
# all values that 61 eigenpairs give, for PCA whitening.
N_VALUES = 23
N_LONGER = 60

# Weight of the size in the signatures that include the size.
SIZE_WEIGHT = PipelineOptions.preset("body-scanner").signature.size_weight

# Number of random points on each of two surfaces from which the distance to the other surface is computed.
# Their spacing on a body is about .001 of the diagonal.
N_PROBES = 100_000


class Signatures(NamedTuple):
    """The signatures of one shape, (L,) each, or of many shapes, (n, L) each.

    Attributes
    ----------
    values : float64, L = 23
        By the options of the configuration, without the size.
    relative : float64, L = 23
        Relative to the first value, as in the paper.
    longer : float64, L = 60
        Relative to the first value.
    sized : float64, L = 24
        By the options of the configuration, with the size as a further value.
    """

    values: FloatArray
    relative: FloatArray
    longer: FloatArray
    sized: FloatArray


class Examination(NamedTuple):
    """The result of one scan. Lengths are relative to the diagonal of the clean mesh.

    Attributes
    ----------
    signatures : Signatures
        The signatures of the scan.
    seconds, processor : float
        Wall-clock time and processor time from the file to the signature.
    stages : dict of str to float
        Seconds of each stage.
    peak : float
        Largest resident memory during these seconds, of the process and its descendants; MiB.
    normals : float or None
        Fraction of the filtered points whose normal points to the correct side; None for meshes.
    closed : bool
        Whether the surface is a closed manifold.
    euler : int
        Euler characteristic of the surface.
    mean, hausdorff : float
        Mean and largest distance between the surfaces, in both directions.
    """

    signatures: Signatures
    seconds: float
    processor: float
    stages: dict[str, float]
    peak: float
    normals: float | None
    closed: bool
    euler: int
    mean: float
    hausdorff: float


def examine(path: Path, truth: TriangleMesh, options: PipelineOptions) -> Examination:
    """Process one scan, and compare the surface and the normals with the clean mesh.

    Parameters
    ----------
    path : Path
        The scan.
    truth : TriangleMesh
        The clean mesh, in the frame of the scan.
    options : PipelineOptions
        Options of all stages.

    Returns
    -------
    Examination
        The errors and times of the scan.

    Raises
    ------
    ShapeError
        If the scan has no usable surface.
    """
    forget_peak()
    started, processor = time.perf_counter(), time.process_time()
    shape = process(path, options)
    describe(shape, options.signature)
    seconds, processor = time.perf_counter() - started, time.process_time() - processor
    peak = peak_memory()
    stages: dict[str, float] = {}
    for step in shape.provenance:
        stages[step.stage] = stages.get(step.stage, 0.0) + step.seconds
    rng = np.random.default_rng(0)
    on_surface, _ = _probes(shape.mesh, rng)
    on_truth, true_normals = _probes(truth, rng)
    distances = [
        RayScene(mesh.vertices, mesh.faces).distance(points) / truth.diagonal
        for mesh, points in ((truth, on_surface), (shape.mesh, on_truth))
    ]
    return Examination(
        signatures=_signatures(shape, options),
        seconds=seconds,
        processor=processor,
        stages=stages,
        peak=peak,
        normals=_right_normals(path, on_truth, true_normals, options),
        closed=not defects(shape.mesh),
        euler=shape.mesh.euler_characteristic,
        mean=float(np.mean([part.mean() for part in distances])),
        hausdorff=float(max(part.max() for part in distances)),
    )


def clean_signatures(mesh: TriangleMesh, options: PipelineOptions) -> Signatures:
    """The signatures of a mesh without reconstruction.

    Parameters
    ----------
    mesh : TriangleMesh
        The clean mesh.
    options : PipelineOptions
        Options of the spectrum and the signatures.

    Returns
    -------
    Signatures
        Arrays of the shape (L,).

    Raises
    ------
    ShapeError
        If the mesh has no usable spectrum.
    """
    return _signatures(process(mesh, options.changed(surface={"mode": "keep"})), options)


def stacked(many: Sequence[Signatures]) -> Signatures:
    """The signatures of many shapes.

    Parameters
    ----------
    many : sequence of Signatures
        Arrays of the shape (L,).

    Returns
    -------
    Signatures
        Arrays of the shape (n, L).
    """
    lengths = (N_VALUES, N_VALUES, N_LONGER, N_VALUES + 1)
    return Signatures(
        *(np.array([one[k] for one in many]).reshape(-1, length) for k, length in enumerate(lengths))
    )


def _signatures(shape: Shape, options: PipelineOptions) -> Signatures:
    form, relative = {"size_weight": 0}, {"size_weight": 0, "scale": "relative"}
    changes: list[dict[str, Any]] = [
        form,
        relative,
        relative | {"n_values": N_LONGER},
        {"size_weight": SIZE_WEIGHT},
    ]
    chosen = [options.changed(signature=change).signature for change in changes]
    return Signatures(*(describe(shape, signature).values for signature in chosen))


def _right_normals(
    path: Path, places: FloatArray, normals: FloatArray, options: PipelineOptions
) -> float | None:
    """The fraction of the filtered points whose normal n agrees with the true normal m: n · m > 0.

    Parameters
    ----------
    path : Path
        The scan.
    places, normals : (n, 3) float64
        Points of the clean mesh, and their normals. The true normal of a filtered point is that of the
        nearest of these points.
    options : PipelineOptions
        Options of the stages `clean` and `orient`.

    Returns
    -------
    float or None
        Between 0 and 1; None for meshes.
    """
    cloud = read_scan(path)
    if not isinstance(cloud, PointCloud):
        return None
    oriented = oriented_normals(clean(cloud, options.scan), options.scan)
    _, nearest = cKDTree(places).query(oriented.points)
    agreement = np.einsum("ij,ij->i", np.asarray(oriented.normals), normals[nearest])
    return float((agreement > 0).mean())


def _probes(mesh: TriangleMesh, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points of a surface, uniform by area, and the unit normals there: (`N_PROBES`, 3) each."""
    points, faces = uniform_points(mesh, N_PROBES, rng)
    normals = mesh.area_vectors[faces]
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)
