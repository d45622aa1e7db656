"""Compute the point descriptors from which the vocabulary of the bags of features is clustered.

    .venv/bin/python scripts/sample_heat

Writes pcretrieve/descriptors/hks_sample.npy: (2, s, 6) heat kernel signatures, plain and scale-invariant, of
points spread evenly over simulated people, animals and hands. Half a minute.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path

import click
import numpy as np

from pcretrieve.atomic import write_file
from pcretrieve.descriptors.hks_bow import SAMPLE, heat_features
from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.types import FloatArray

__all__ = ["features", "main"]

N_SUBJECTS = 4
N_MODES = 60
POINTS_PER_SUBJECT = 60


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the point descriptors, and write them into the package.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args(arguments)
    sample = np.concatenate(list(features()), axis=1).astype(np.float32)  # (2, s, 6)
    path = Path(str(resources.files("pcretrieve.descriptors").joinpath(SAMPLE)))
    data = io.BytesIO()
    np.save(data, sample)
    write_file(path, data.getvalue())
    click.echo(f"{path}: {sample.shape}")


def features() -> Iterator[FloatArray]:
    """Heat kernel signatures of random points of simulated bodies.

    Points are drawn in proportion to area; the subjects of a family take poses in turn.

    Yields
    ------
    (2, 60, 6) float64
        Of 60 points of one subject, plain and scale-invariant; dimensionless.
    """
    rng = np.random.default_rng(0)
    for family, poses in POSES.items():
        for number in range(N_SUBJECTS):
            pose = list(poses.values())[number % len(poses)]
            pairs = unit_eigenpairs(body(make_subject(family, rng), pose, rng), N_MODES + 1)
            share = np.asarray(pairs.mass.sum(axis=1))  # (n,)
            picked = rng.choice(len(share), POINTS_PER_SUBJECT, replace=False, p=share / share.sum())
            yield np.array([heat_features(pairs, scale_invariant=kind)[picked] for kind in (False, True)])
