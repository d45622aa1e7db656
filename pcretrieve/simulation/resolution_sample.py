"""Measure how the resolution of a reconstruction changes log-signatures, for ``--whitening resolution``.

    .venv/bin/python scripts/sample_resolution

Writes pcretrieve/retrieval/resolution.npy: (2, n, 61) logarithms of |μ_1| … |μ_60| and μ_0 of R-BiHDM over
the squared area, of simulated people, animals and hands. The bodies are scanned with noise, holes and
outliers, and reconstructed with voxels of three quarters and of four thirds of the default edge. It takes ten
minutes.
"""

from __future__ import annotations

import argparse
import io
import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import click
import numpy as np
from tqdm import tqdm

from pcretrieve.atomic import write_file
from pcretrieve.descriptors import reduced_matrix
from pcretrieve.errors import PcretrieveError
from pcretrieve.ingestion import Isolation
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval.resolution import N_MODES, SAMPLE
from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.simulation.uniform import UniformOptions, scan_uniformly
from pcretrieve.values import FloatArray, Shape

__all__ = ["log_eigenvalues", "main"]

# Number of bodies of each family. Each body is another individual, in the poses of the family in turn.
N_BODIES = 56

# Edges of small and of large voxels, relative to the diagonal.
CELLS = (0.75 * 0.0045, 0.0045 / 0.75)

# Different from the seeds in `pcretrieve.benchmarks.sets`, so that the sample has no person of the benchmark.
SEED = 2016


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the sample, and write it into the package."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args(arguments)
    bodies = [(family, number) for family in POSES for number in range(N_BODIES)]
    running = Isolation().each(_of_body, bodies, workers=len(os.sched_getaffinity(0)))
    found: dict[tuple[str, int], FloatArray] = {}
    for which, outcome in tqdm(running, total=len(bodies), unit="body"):
        if isinstance(outcome, PcretrieveError):
            raise outcome
        found[which] = outcome
    sample = np.stack([found[which] for which in bodies], axis=1)
    path = Path(str(resources.files("pcretrieve.retrieval").joinpath(SAMPLE)))
    data = io.BytesIO()
    np.save(data, sample.astype(np.float32))
    write_file(path, data.getvalue())
    click.echo(f"{path}: {sample.shape}")


def log_eigenvalues(family: str, number: int) -> FloatArray:
    """Logarithms of the magnitudes of the eigenvalues of R-BiHDM, of one body with small and large voxels.

    Returns (2, 61) float64: dimensionless: of the surface scaled to unit area.
    """
    rng = np.random.default_rng((SEED, list(POSES).index(family), number))
    poses = list(POSES[family].values())
    mesh = body(make_subject(family, rng), poses[number % len(poses)], rng)
    cloud = scan_uniformly(mesh, UniformOptions(), rng)
    rows = []
    for cell in CELLS:
        shape = process(cloud, PipelineOptions().changed(surface={"cell": cell, "reconstructions": 1}))
        rows.append(_log_eigenvalues(shape))
    return np.array(rows)


def _of_body(which: tuple[str, int]) -> FloatArray:
    return log_eigenvalues(*which)


def _log_eigenvalues(shape: Shape) -> FloatArray:
    magnitudes: FloatArray = np.abs(np.linalg.eigvalsh(reduced_matrix(shape.spectrum, N_MODES)))
    return np.log(magnitudes)
