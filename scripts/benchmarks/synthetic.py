"""Large catalogues of random signatures without scans, and small meshes for ingestion, from a seed."""

from __future__ import annotations

import hashlib
import statistics
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from scipy.spatial import ConvexHull
from trimesh.remesh import subdivide

from benchmarks.measuring import timed
from pcretrieve.catalogue import Catalogue, Record, merge_catalogues
from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.records import OWN, Entry
from pcretrieve.descriptors import DESCRIPTORS
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import write_mesh
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.retrieval import people
from pcretrieve.values import FloatArray, Step, TriangleMesh

# Number of shapes in a class. Their signatures differ as those of one person do.
CLASS_SIZE = 10

# Number of signatures that are drawn at a time.
BLOCK = 10_000

# Provenance as it is stored of a scan that was made into one surface.
STEPS = (
    Step("read", 0.013, {"points": 14042}),
    Step("clean", 0.048, {"points_in": 14042, "points": 13768}),
    Step("orient", 0.237, {"points": 13768}),
    Step("surface", 0.937, {"points": 13768, "faces": 10000, "euler": 2}),
    Step("spectrum", 0.185, {"vertices": 5002, "pairs": 61}),
)
VERSIONS = {
    "pcretrieve": "0.1.0",
    "open3d": "0.20.0",
    "pytetwild": "0.4.2",
    "numpy": "2.4.6",
    "scipy": "1.17.1",
}


def synthetic_id(number: int) -> str:
    """The id of a shape of a synthetic catalogue."""
    return f"shape-{number:07}"


def synthetic_catalogue(
    path: Path, options: PipelineOptions, n_shapes: int, seed: int
) -> None:
    """Write a catalogue of records and signatures, without spectra and meshes.

    Coordinates of signatures are normally distributed within their class, and so are the means of the
    classes, with the covariances within and between simulated people.
    """
    made = signatures(options.signature, n_shapes, np.random.default_rng(seed))
    with Catalogue(path, options, create=True) as catalogue:
        for start in range(0, n_shapes, BLOCK):
            numbers = range(start, min(start + BLOCK, n_shapes))
            catalogue.rows.add(
                [_entry(number, next(made), options) for number in numbers]
            )


def _entry(number: int, values: FloatArray, options: PipelineOptions) -> Entry:
    shape_id = synthetic_id(number)
    record = Record(
        shape_id,
        f"/scans/{shape_id}.ply",
        hashlib.sha256(shape_id.encode()).hexdigest(),
        f"class-{number // CLASS_SIZE:06}",
        steps=STEPS,
        area=1.9,
        n_vertices=5002,
        n_faces=10000,
        euler=2,
        options_digest=options.digest,
        versions=VERSIONS,
        added="2026-01-01T00:00:00+00:00",
    )
    return Entry(record, {OWN: packed_values(values)}, {})


def write_small_meshes(folder: Path, n_meshes: int, n_vertices: int, seed: int) -> None:
    """Write closed meshes of bodies that differ, as files ``.off``."""
    rng, sphere = np.random.default_rng(seed), bumpy_sphere(n_vertices)
    for number in range(n_meshes):
        axes = rng.uniform(0.6, 1.6, size=3)
        write_mesh(
            replace(sphere, vertices=sphere.vertices * axes),
            folder / f"body-{number:05}.off",
        )


def signatures(
    options: SignatureOptions, n_shapes: int, rng: Generator
) -> Iterator[FloatArray]:
    """Signatures (L,), one class after the other."""
    known = people(options)
    if known is None:
        raise BenchmarkError(
            f"people must be known by {options.method}, which they are not"
        )
    between, within = _root(known.total - known.within), _root(known.within)
    n_values = len(known.mean)
    for start in range(0, n_shapes, BLOCK):
        n = min(BLOCK, n_shapes - start)
        classes = known.mean + rng.normal(size=(n // CLASS_SIZE, n_values)) @ between
        drawn = (
            np.repeat(classes, CLASS_SIZE, axis=0)
            + rng.normal(size=(n, n_values)) @ within
        )
        yield from (
            np.exp(drawn) if DESCRIPTORS[options.method].metric == "logarithms" else drawn
        )


def _root(covariance: FloatArray) -> FloatArray:
    """R with RᵀR = C."""
    variances, directions = np.linalg.eigh(covariance)
    root: FloatArray = np.sqrt(np.maximum(variances, 0))[:, np.newaxis] * directions.T
    return root


def bumpy_sphere(n: int) -> TriangleMesh:
    """A closed surface of `n` vertices without any symmetry, so that no two eigenvalues are equal.

    It is a sphere that is sampled on a Fibonacci spiral, displaced by a smooth function, and stretched to an
    ellipsoid.
    """
    height = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    flat = np.sqrt(1 - height**2)
    points = np.stack(
        [flat * np.cos(angle), flat * np.sin(angle), height], axis=1
    )  # (n, 3)
    faces = ConvexHull(points).simplices
    normals = np.cross(
        points[faces[:, 1]] - points[faces[:, 0]],
        points[faces[:, 2]] - points[faces[:, 0]],
    )
    inwards = (normals * points[faces[:, 0]]).sum(axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    x, y, z = points.T
    radius = 1 + 0.25 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.2 * np.sin(5 * z + x)
    return TriangleMesh(radius[:, None] * points * [1.5, 1.0, 0.8], faces)


def quartered(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface with each face cut in four at the midpoints of its edges."""
    return TriangleMesh(*subdivide(mesh.vertices, mesh.faces))  # type: ignore[no-untyped-call]


def unit_square(n: int) -> TriangleMesh:
    """The flat unit square, cut into n × n cells of two triangles each."""
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    faces = np.concatenate(
        [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    ).astype(np.int32)
    x, y = np.divmod(number.ravel(), n + 1)
    return TriangleMesh(np.column_stack([x, y, 0 * x]) / n, faces)


# Number of shapes that are copied to a part together.
COPIED_AT_ONCE = 1000


class WritingTimes(NamedTuple):
    """Median times of changes of a catalogue; seconds."""

    together: float
    single: float
    removal: float


def written_in(path: Path, n_shapes: int, n_repeats: int) -> WritingTimes:
    """Median times of adding shapes to a catalogue, and removing them."""
    times = []
    with Catalogue(path) as catalogue:
        page = catalogue.records(limit=n_shapes)
        stored = catalogue.rows.entries([record.id for record in page])
        new = [
            replace(
                entry, record=replace(entry.record, id=f"new-{at}", path=f"/new/{at}.ply")
            )
            for at, entry in enumerate(stored)
        ]
        ids = [entry.record.id for entry in new]
        for _ in range(n_repeats):
            together, _ = timed(partial(catalogue.rows.add, new))
            removal, _ = timed(partial(catalogue.remove, *ids))
            single, _ = timed(partial(_store, catalogue, new))
            catalogue.remove(*ids)
            times.append((together, single, removal))
    return WritingTimes(*map(statistics.median, zip(*times, strict=True)))


def merged_in(
    folder: Path, options: PipelineOptions, n_shapes: int, n_parts: int, seed: int
) -> float:
    """Seconds of merging the catalogues of a job array."""
    if n_shapes % (n_parts * CLASS_SIZE):
        raise BenchmarkError(
            f"the number of merged shapes must be a multiple of {n_parts * CLASS_SIZE}, got {n_shapes}"
        )
    synthetic_catalogue(folder / "whole.sqlite", options, n_shapes, seed)
    parts = [folder / f"part-{number}.sqlite" for number in range(n_parts)]
    with Catalogue(folder / "whole.sqlite") as whole:
        ids = [origin.id for origin in whole.rows.origins()]
        for number, part in enumerate(parts):
            with Catalogue(part, options, create=True) as store:
                chosen = ids[number::n_parts]
                for start in range(0, len(chosen), COPIED_AT_ONCE):
                    store.rows.add(
                        whole.rows.entries(chosen[start : start + COPIED_AT_ONCE])
                    )
    return timed(lambda: merge_catalogues(parts, folder / "all.sqlite"))[0]


def _store(catalogue: Catalogue, entries: Collection[Entry]) -> None:
    for entry in entries:
        catalogue.rows.store(entry)
