"""Compute the arrays and simulate the scans that the package ships, and write them into it.

    scripts/sample heat          # half a minute
    scripts/sample dictionary    # a quarter of an hour
    scripts/sample demo          # half a minute

heat: hks_sample.npy, (2, s, 6) heat kernel signatures, plain and scale-invariant, and wavelet_sample.npy,
(s, 3) spectral graph wavelet signatures, of the same points of simulated bodies, from which the vocabularies
of the bags of features are clustered; those of the package are of bodies with other triangles. dictionary:
the atoms of the descriptors dl and dl-supervised, learned without labels and with them.
demo: the scans that `pcretrieve demo` ingests, and the one that it searches for. The metric of people is
learned by scripts/benchmark people.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from benchmarks.measuring import argument_parser
from benchmarks.poses import POSES
from benchmarks.simulation.bodies import body, make_subject
from benchmarks.simulation.samples import write_samples
from pcretrieve.shrec.dl import (
    ATOMS,
    N_ATOMS,
    PENALTY,
    SurfacePoints,
    supervised_dictionary,
    surface_points,
)
from pcretrieve.shrec.heat import SAMPLE as HEAT_SAMPLE, heat_features
from pcretrieve.shrec.ispm import SAMPLE as WAVELET_SAMPLE, wavelet_signatures
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

# Bodies of each family, and points of each of them.
N_HEAT_SUBJECTS = 4

N_MODES = 60
POINTS_PER_SUBJECT = 60


class PointFeatures(NamedTuple):
    """Heat kernel signatures (2, 60, 6), plain and scale-invariant, and wavelet signatures (60, 3)."""

    heat: FloatArray
    wavelets: FloatArray


def heat() -> None:
    """Compute the point descriptors, and write them into the package."""
    made = list(features())
    _write(
        "shrec", HEAT_SAMPLE, np.concatenate([subject.heat for subject in made], axis=1)
    )
    _write(
        "shrec", WAVELET_SAMPLE, np.concatenate([subject.wavelets for subject in made])
    )


def _write(room: str, name: str, sample: FloatArray) -> None:
    path = Path(str(resources.files(f"pcretrieve.{room}").joinpath(name)))
    data = io.BytesIO()
    np.save(data, sample.astype(np.float32))
    write_file(path, data.getvalue())
    click.echo(f"{path}: {sample.shape}")


def features() -> Iterator[PointFeatures]:
    """Point descriptors of random points of simulated bodies, whose subjects take poses in turn."""
    rng = np.random.default_rng(0)
    for family, poses in POSES.items():
        for number in range(N_HEAT_SUBJECTS):
            pose = list(poses.values())[number % len(poses)]
            pairs = unit_eigenpairs(
                body(make_subject(family, rng), pose, rng), N_MODES + 1
            )
            share = np.asarray(pairs.mass.sum(axis=1))  # (n,)
            picked = rng.choice(
                len(share), POINTS_PER_SUBJECT, replace=False, p=share / share.sum()
            )
            heat = np.array(
                [
                    heat_features(pairs, scale_invariant=kind)[picked]
                    for kind in (False, True)
                ]
            )
            yield PointFeatures(heat, wavelet_signatures(pairs, N_MODES)[picked])


# Individuals of each family, and poses of each individual.
N_SUBJECTS = 8
N_POSES = 6

# Points of each surface to which the dictionary without labels is fitted.
N_POINTS_OF_ATOMS = 40

# Different from the seeds in `benchmarks.sets`, so that no person of the benchmarks is among them.
DICTIONARY_SEED = 2014


def dictionary() -> None:
    """Learn the dictionaries, and write them into the package."""
    _write("shrec", ATOMS, dictionaries(list(surfaces(N_SUBJECTS, N_POSES))))


def surfaces(n_subjects: int, n_poses: int) -> Iterator[tuple[SurfacePoints, str]]:
    """Point descriptors and labels of simulated bodies of all families."""
    for family, (name, poses) in enumerate(POSES.items()):
        for number in range(n_subjects):
            subject = make_subject(
                name, np.random.default_rng((DICTIONARY_SEED, family, number))
            )
            for turn in range(n_poses):
                rng = np.random.default_rng((DICTIONARY_SEED, family, number, turn))
                pose = list(poses.values())[
                    (number + turn * max(1, len(poses) // n_poses)) % len(poses)
                ]
                pairs = unit_eigenpairs(body(subject, pose, rng), N_MODES + 1)
                yield surface_points(pairs), f"{name} {number}"


def dictionaries(bodies: Sequence[tuple[SurfacePoints, str]]) -> FloatArray:
    """(2, 32, d) the atoms learned without labels, and those learned from these with labels."""
    rng = np.random.default_rng(DICTIONARY_SEED)
    drawn = [
        rng.choice(len(points.shares), N_POINTS_OF_ATOMS, p=points.shares)
        for points, _ in bodies
    ]
    points = np.concatenate(
        [points.features[rows] for (points, _), rows in zip(bodies, drawn, strict=True)]
    )
    atoms = sparse_dictionary(points, N_ATOMS, PENALTY)
    points_of, labels = zip(*bodies, strict=True)
    labelled = supervised_dictionary(points_of, labels, atoms, rng)
    return np.stack([atoms, labelled])


# Points in each step of online learning, and the passes over all points.
BATCH_SIZE = 256
N_PASSES = 100


def sparse_dictionary(points: FloatArray, n_atoms: int, penalty: float) -> FloatArray:
    """(L, d) atoms of unit length by which points (N, d) have sparse codes, learned online (Mairal, 2010)."""
    from sklearn.decomposition import MiniBatchDictionaryLearning
    from sklearn.exceptions import ConvergenceWarning

    learning = MiniBatchDictionaryLearning(
        n_atoms,
        alpha=penalty,
        max_iter=N_PASSES,
        batch_size=BATCH_SIZE,
        fit_algorithm="cd",
        random_state=0,
    )
    with warnings.catch_warnings():
        # Codes of a duality gap of 1e-4 are exact enough: the next step changes the atoms.
        warnings.simplefilter("ignore", ConvergenceWarning)
        atoms = np.asarray(learning.fit(points).components_, dtype=np.float64)
    return np.asarray(atoms / np.linalg.norm(atoms, axis=1, keepdims=True))


# The scans of the demo, whose catalogue is made in about a minute; and one of the same people, in a pose with
# contacts.
DEMO_SAMPLES = (
    *("person-1_stand", "person-1_walk", "person-1_sit"),
    *("person-2_stand", "person-2_run", "person-2_wave"),
    *("person-3_walk", "person-3_lunge", "person-3_point"),
    *("person-4_stand", "person-4_sit", "person-4_run"),
)
DEMO_QUERY = "person-1_hands_on_hips"


def demo() -> None:
    """Simulate the scans of the demo, and write them into the package."""
    folder = Path(str(resources.files("pcretrieve.cli").joinpath("demo")))
    write_samples(folder / "scans", DEMO_SAMPLES, on_scan=click.echo)
    write_samples(folder / "new", [DEMO_QUERY], on_scan=click.echo)


SHIPPED = {"heat": heat, "dictionary": dictionary, "demo": demo}


def main(arguments: Sequence[str] | None = None) -> None:
    """Make one of them."""
    parser = argument_parser(__doc__)
    parser.add_argument("which", choices=SHIPPED)
    SHIPPED[parser.parse_args(arguments).which]()
