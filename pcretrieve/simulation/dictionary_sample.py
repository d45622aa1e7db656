"""Learn the dictionaries of ``--method dl`` and ``--method dl-supervised`` from simulated bodies.

    .venv/bin/python scripts/sample_dictionary

Writes pcretrieve/descriptors/dl_atoms.npy: (2, 32, 19) atoms that are learned without labels and, from these,
with labels. The classes are individual people, animals and hands, in several poses each; no individual of the
benchmarks is among them. Ten minutes.
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

from pcretrieve.adapters.scikit_learn import sparse_dictionary
from pcretrieve.atomic import write_file
from pcretrieve.descriptors.dictionary_learning import supervised_dictionary
from pcretrieve.descriptors.dl import ATOMS, N_ATOMS, surface_points
from pcretrieve.descriptors.sparse_coding import PENALTY, SurfacePoints
from pcretrieve.simulation.bodies import POSES, body, make_subject
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray

__all__ = ["LabelledSurface", "dictionaries", "main", "surfaces"]

# Individuals of each family, and poses of each individual.
N_SUBJECTS = 8
N_POSES = 6

# Points of each surface to which the dictionary without labels is fitted.
N_POINTS = 40

# Different from the seeds in `pcretrieve.benchmarks.sets`, so that no person of the benchmarks is among them.
SEED = 2014

N_MODES = 60


class LabelledSurface(NamedTuple):
    """The point descriptors of a body."""

    points: SurfacePoints
    label: str


def main(arguments: Sequence[str] | None = None) -> None:
    """Learn the dictionaries, and write them into the package."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args(arguments)
    atoms = dictionaries(list(surfaces(N_SUBJECTS, N_POSES)))
    path = Path(str(resources.files("pcretrieve.descriptors").joinpath(ATOMS)))
    data = io.BytesIO()
    np.save(data, atoms.astype(np.float32))
    write_file(path, data.getvalue())
    click.echo(f"{path}: {atoms.shape}")


def surfaces(n_subjects: int, n_poses: int) -> Iterator[LabelledSurface]:
    """Simulated bodies of all families."""
    for family, (name, poses) in enumerate(POSES.items()):
        for number in range(n_subjects):
            subject = make_subject(name, np.random.default_rng((SEED, family, number)))
            for turn in range(n_poses):
                rng = np.random.default_rng((SEED, family, number, turn))
                pose = list(poses.values())[(number + turn * max(1, len(poses) // n_poses)) % len(poses)]
                pairs = unit_eigenpairs(body(subject, pose, rng), N_MODES + 1)
                yield LabelledSurface(surface_points(pairs), f"{name} {number}")


def dictionaries(bodies: Sequence[LabelledSurface], *, n_steps: int = 200) -> FloatArray:
    """The dictionaries of surfaces.

    Returns (2, 32, d) float64: the atoms that are learned without labels, and those that are learned from
        these with labels.
    """
    rng = np.random.default_rng(SEED)
    points = np.concatenate(
        [points.features[rng.choice(len(points.shares), N_POINTS, p=points.shares)] for points, _ in bodies]
    )
    atoms = sparse_dictionary(points, N_ATOMS, PENALTY)
    labelled = supervised_dictionary(
        [points for points, _ in bodies], [label for _, label in bodies], atoms, rng, n_steps=n_steps
    )
    return np.stack([atoms, labelled])
