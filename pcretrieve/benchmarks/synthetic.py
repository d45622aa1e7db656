"""Large catalogues of random signatures without scans, and small meshes for ingestion, from a seed."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.random import Generator

from pcretrieve.benchmarks.surfaces import bumpy_sphere
from pcretrieve.catalogue import Catalogue
from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.record_rows import CHECKSUMS, NUMBERED, with_checksums
from pcretrieve.formats import write_mesh
from pcretrieve.options import PipelineOptions
from pcretrieve.values import FloatArray

__all__ = ["CLASS_SIZE", "synthetic_catalogue", "synthetic_id", "write_small_meshes"]

# Number of shapes in a class. Their signatures differ as those of one body at several resolutions.
CLASS_SIZE = 10

# Number of signatures that are drawn at a time.
BLOCK = 10_000

# Provenance as it is stored of a scan that was made into one surface.
STEPS = [
    {"stage": "read", "seconds": 0.013, "sizes": {"points": 14042}, "notes": []},
    {"stage": "clean", "seconds": 0.048, "sizes": {"points_in": 14042, "points": 13768}, "notes": []},
    {"stage": "orient", "seconds": 0.237, "sizes": {"points": 13768}, "notes": []},
    {
        "stage": "surface",
        "seconds": 0.937,
        "sizes": {"points": 13768, "faces": 10000, "euler": 2},
        "notes": [],
    },
    {"stage": "spectrum", "seconds": 0.185, "sizes": {"vertices": 5002, "pairs": 61}, "notes": []},
]
VERSIONS = {
    "pcretrieve": "0.1.0",
    "open3d": "0.20.0",
    "pytetwild": "0.4.2",
    "numpy": "2.4.6",
    "scipy": "1.17.1",
}


def synthetic_id(number: int) -> str:
    """The id of a shape of a synthetic catalogue.

    Parameters
    ----------
    number : int
        From 0 to the size of the catalogue.

    Returns
    -------
    str
        The id. Ids are in the order of the numbers.
    """
    return f"shape-{number:07}"


def synthetic_catalogue(path: Path, options: PipelineOptions, n_shapes: int, seed: int) -> None:
    """Write a catalogue of records and signatures, without spectra and meshes.

    Logarithms of signatures are normally distributed within their class, and so are the means of the classes.
    The covariances are those of simulated bodies: within a class, of the changes that the resolution of a
    surface causes; between classes, of the bodies.

    Parameters
    ----------
    path : Path
        The file, which is created.
    options : PipelineOptions
        Options of the catalogue, with the descriptor ``r-bihdm`` and the scale relative.
    n_shapes : int
        Number of shapes, a multiple of `CLASS_SIZE`.
    seed : int
        Seed of the signatures.
    """
    with Catalogue(path, options, create=True):
        pass
    signatures = _signatures(options.signature.n_values, n_shapes, np.random.default_rng(seed))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("INSERT INTO descriptors (number, digest) VALUES (0, 'own')")
        connection.executemany(
            "INSERT INTO shapes (number, id, path, content_hash, label, status, area, n_vertices, n_faces, "
            "euler) VALUES (?, ?, ?, ?, ?, 'done', 1.9, 5002, 10000, 2)",
            (
                (
                    number,
                    shape_id := synthetic_id(number),
                    f"/scans/{shape_id}.ply",
                    hashlib.sha256(shape_id.encode()).hexdigest(),
                    f"class-{number // CLASS_SIZE:06}",
                )
                for number in range(n_shapes)
            ),
        )
        provenance = (json.dumps(STEPS), options.digest, json.dumps(VERSIONS), "2026-01-01T00:00:00+00:00")
        connection.executemany(
            "INSERT INTO provenance (shape, steps, options_digest, versions, added) VALUES (?, ?, ?, ?, ?)",
            ((number, *provenance) for number in range(n_shapes)),
        )
        rows = connection.execute(NUMBERED, {"last": -1, "limit": n_shapes})
        connection.executemany(CHECKSUMS, [with_checksums(row) for row in rows])
        connection.executemany(
            "INSERT INTO signatures (descriptor, shape, value) VALUES (0, ?, ?)",
            ((number, packed_values(values)) for number, values in enumerate(signatures)),
        )


def write_small_meshes(folder: Path, n_meshes: int, n_vertices: int, seed: int) -> None:
    """Write closed meshes of bodies that differ, as files ``.off``.

    Parameters
    ----------
    folder : Path
        An empty folder.
    n_meshes : int
        Number of files.
    n_vertices : int
        Number of vertices of each mesh.
    seed : int
        Seed of the shapes of the meshes.
    """
    rng, sphere = np.random.default_rng(seed), bumpy_sphere(n_vertices)
    for number in range(n_meshes):
        axes = rng.uniform(0.6, 1.6, size=3)
        write_mesh(replace(sphere, vertices=sphere.vertices * axes), folder / f"body-{number:05}.off")


def _signatures(n_values: int, n_shapes: int, rng: Generator) -> Iterator[FloatArray]:
    """Signatures (L,), one class after the other."""
    # (2, n, m + 1): log-signatures of n bodies from small and from large cells, the first value last.
    file = resources.files("pcretrieve.retrieval").joinpath("resolution.npy")
    sample = np.load(str(file)).astype(np.float64)
    logs = (sample - sample[:, :, -1:])[:, :, :n_values]
    between, within = _root(np.cov(logs[0].T)), _root(np.cov((logs[0] - logs[1]).T))
    for start in range(0, n_shapes, BLOCK):
        n = min(BLOCK, n_shapes - start)
        classes = logs[0].mean(axis=0) + rng.normal(size=(n // CLASS_SIZE, n_values)) @ between
        drawn = np.repeat(classes, CLASS_SIZE, axis=0) + rng.normal(size=(n, n_values)) @ within
        yield from np.exp(drawn)


def _root(covariance: FloatArray) -> FloatArray:
    """R with RᵀR = C."""
    variances, directions = np.linalg.eigh(covariance)
    root: FloatArray = np.sqrt(np.maximum(variances, 0))[:, np.newaxis] * directions.T
    return root
