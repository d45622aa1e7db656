"""Compute the point descriptors from which the vocabularies of the bags of features are clustered.

    .venv/bin/python scripts/sample_heat

Writes two files to pcretrieve/descriptors, of the same points, which are spread evenly over simulated people,
animals and hands: hks_sample.npy, (2, s, 6) heat kernel signatures, plain and scale-invariant, and
wavelet_sample.npy, (s, 3) spectral graph wavelet signatures. Half a minute.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from pcretrieve.atomic import write_file
from pcretrieve.descriptors.hks_bow import SAMPLE as HEAT_SAMPLE
from pcretrieve.descriptors.hks_bow import heat_features
from pcretrieve.descriptors.ispm import SAMPLE as WAVELET_SAMPLE
from pcretrieve.descriptors.ispm import wavelet_signatures
from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray

__all__ = ["PointFeatures", "features", "main"]

N_SUBJECTS = 4
N_MODES = 60
POINTS_PER_SUBJECT = 60


class PointFeatures(NamedTuple):
    """Point descriptors of the points of one subject.

    heat: (2, 60, 6) float64, heat kernel signatures, plain and scale-invariant; dimensionless.
    wavelets: (60, 3) float64, spectral graph wavelet signatures; dimensionless.
    """

    heat: FloatArray
    wavelets: FloatArray


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the point descriptors, and write them into the package."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args(arguments)
    made = list(features())
    _write(HEAT_SAMPLE, np.concatenate([subject.heat for subject in made], axis=1))  # (2, s, 6)
    _write(WAVELET_SAMPLE, np.concatenate([subject.wavelets for subject in made]))  # (s, 3)


def _write(name: str, sample: FloatArray) -> None:
    path = Path(str(resources.files("pcretrieve.descriptors").joinpath(name)))
    data = io.BytesIO()
    np.save(data, sample.astype(np.float32))
    write_file(path, data.getvalue())
    click.echo(f"{path}: {sample.shape}")


def features() -> Iterator[PointFeatures]:
    """Point descriptors of random points of simulated bodies.

    Points are drawn in proportion to area; the subjects of a family take poses in turn.
    """
    rng = np.random.default_rng(0)
    for family, poses in POSES.items():
        for number in range(N_SUBJECTS):
            pose = list(poses.values())[number % len(poses)]
            pairs = unit_eigenpairs(body(make_subject(family, rng), pose, rng), N_MODES + 1)
            share = np.asarray(pairs.mass.sum(axis=1))  # (n,)
            picked = rng.choice(len(share), POINTS_PER_SUBJECT, replace=False, p=share / share.sum())
            heat = np.array([heat_features(pairs, scale_invariant=kind)[picked] for kind in (False, True)])
            yield PointFeatures(heat, wavelet_signatures(pairs, N_MODES)[picked])
