"""Compute the arrays that the package ships, and write them into it.

    .venv/bin/python scripts/sample heat          # half a minute
    .venv/bin/python scripts/sample dictionary    # a quarter of an hour

heat: hks_sample.npy, (2, s, 6) heat kernel signatures, plain and scale-invariant, and wavelet_sample.npy,
(s, 3) spectral graph wavelet signatures, of the same points of simulated bodies, from which the vocabularies
of the bags of features are clustered; those of the package are of bodies with other triangles. dictionary:
the atoms of the descriptors dl and dl-supervised, learned without labels and with them. The
metric of people is learned by scripts/benchmark_people.

The dictionary with labels is learned as by Litman, Bronstein, Bronstein and Castellani, "Supervised learning
of bag-of-features shape descriptors using sparse coding", 2014.
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
from numpy.typing import NDArray

from benchmarks.measuring import argument_parser
from pcretrieve.descriptors.bags import SAMPLE as HEAT_SAMPLE, heat_features
from pcretrieve.descriptors.dl import (
    ATOMS,
    N_ATOMS,
    N_ITERATIONS,
    PENALTY,
    SurfacePoints,
    atom_shares,
    sparse_codes,
    surface_points,
)
from pcretrieve.descriptors.ispm import SAMPLE as WAVELET_SAMPLE, wavelet_signatures
from pcretrieve.errors import InputError
from pcretrieve.simulation.bodies import POSES, body, make_subject
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
    _write("descriptors", HEAT_SAMPLE, np.concatenate([subject.heat for subject in made], axis=1))
    _write("descriptors", WAVELET_SAMPLE, np.concatenate([subject.wavelets for subject in made]))


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
            pairs = unit_eigenpairs(body(make_subject(family, rng), pose, rng), N_MODES + 1)
            share = np.asarray(pairs.mass.sum(axis=1))  # (n,)
            picked = rng.choice(len(share), POINTS_PER_SUBJECT, replace=False, p=share / share.sum())
            heat = np.array([heat_features(pairs, scale_invariant=kind)[picked] for kind in (False, True)])
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
    _write("descriptors", ATOMS, dictionaries(list(surfaces(N_SUBJECTS, N_POSES))))


def surfaces(n_subjects: int, n_poses: int) -> Iterator[tuple[SurfacePoints, str]]:
    """Point descriptors and labels of simulated bodies of all families."""
    for family, (name, poses) in enumerate(POSES.items()):
        for number in range(n_subjects):
            subject = make_subject(name, np.random.default_rng((DICTIONARY_SEED, family, number)))
            for turn in range(n_poses):
                rng = np.random.default_rng((DICTIONARY_SEED, family, number, turn))
                pose = list(poses.values())[(number + turn * max(1, len(poses) // n_poses)) % len(poses)]
                pairs = unit_eigenpairs(body(subject, pose, rng), N_MODES + 1)
                yield surface_points(pairs), f"{name} {number}"


def dictionaries(bodies: Sequence[tuple[SurfacePoints, str]], *, n_steps: int = 200) -> FloatArray:
    """(2, 32, d) the atoms learned without labels, and those learned from these with labels."""
    rng = np.random.default_rng(DICTIONARY_SEED)
    drawn = [rng.choice(len(points.shares), N_POINTS_OF_ATOMS, p=points.shares) for points, _ in bodies]
    points = np.concatenate([points.features[rows] for (points, _), rows in zip(bodies, drawn, strict=True)])
    atoms = sparse_dictionary(points, N_ATOMS, PENALTY)
    labelled = supervised_dictionary(
        [points for points, _ in bodies], [label for _, label in bodies], atoms, rng, n_steps=n_steps
    )
    return np.stack([atoms, labelled])


# Surfaces of each class, classes, and points of each surface in one step.
PER_CLASS = 3
N_CLASSES = 8
N_POINTS = 60

# The largest step of Adam, which decreases to zero linearly, and the decay of its means of the gradient and
# of its square (Kingma and Ba, 2015).
RATE = 0.01
DECAY, SQUARED_DECAY = 0.9, 0.999

# μ of the hinge, relative to the median squared distance of a surface to the nearest one of another class.
MARGIN = 0.3

# Added to the diagonal of the Gram matrix of active atoms, which may be almost parallel.
RIDGE = 1e-4

# Added to shares under the square root, whose derivative at zero is infinite.
SMALLEST = 1e-4


class Loss(NamedTuple):
    """The loss of a dictionary, and its derivative (L, d) by the atoms."""

    value: float
    gradient: FloatArray


# Points in each step of online learning, and the passes over all points.
BATCH_SIZE = 256
N_PASSES = 100


def sparse_dictionary(points: FloatArray, n_atoms: int, penalty: float) -> FloatArray:
    """(L, d) atoms of unit length by which points (N, d) have sparse codes, learned online (Mairal, 2010)."""
    from sklearn.decomposition import MiniBatchDictionaryLearning
    from sklearn.exceptions import ConvergenceWarning

    learning = MiniBatchDictionaryLearning(
        n_atoms, alpha=penalty, max_iter=N_PASSES, batch_size=BATCH_SIZE, fit_algorithm="cd", random_state=0
    )
    with warnings.catch_warnings():
        # Codes of a duality gap of 1e-4 are exact enough: the next step changes the atoms.
        warnings.simplefilter("ignore", ConvergenceWarning)
        atoms = np.asarray(learning.fit(points).components_, dtype=np.float64)
    return np.asarray(atoms / np.linalg.norm(atoms, axis=1, keepdims=True))


def supervised_dictionary(
    surfaces: Sequence[SurfacePoints],
    labels: Sequence[str],
    atoms: FloatArray,
    rng: np.random.Generator,
    *,
    n_steps: int = 200,
) -> FloatArray:
    """The atoms by which surfaces of one class are nearer to each other than to those of other classes.

    atoms: (L, d), the dictionary to begin with, as a rule one that was learned without labels.
    """
    classes = [np.flatnonzero(np.array(labels) == label) for label in sorted(set(labels))]
    classes = [members for members in classes if len(members) > 1]
    if len(classes) < 2:
        raise InputError(f"learning needs two classes of two surfaces or more, got {len(classes)}")
    margin = MARGIN * _gap(surfaces, labels, atoms)
    mean, squares = np.zeros_like(atoms), np.zeros_like(atoms)
    for step in range(1, n_steps + 1):
        chosen = np.concatenate(
            [
                rng.choice(classes[number], min(PER_CLASS, len(classes[number])), replace=False)
                for number in rng.choice(len(classes), min(N_CLASSES, len(classes)), replace=False)
            ]
        )
        drawn = [_drawn(surfaces[number], rng) for number in chosen]
        gradient = triplet_loss(drawn, [labels[number] for number in chosen], atoms, margin).gradient
        gradient -= (gradient * atoms).sum(axis=1, keepdims=True) * atoms  # along the sphere
        mean = DECAY * mean + (1 - DECAY) * gradient
        squares = SQUARED_DECAY * squares + (1 - SQUARED_DECAY) * gradient**2
        size = np.sqrt(squares / (1 - SQUARED_DECAY**step)) + np.finfo(float).tiny
        atoms = atoms - RATE * (1 - step / n_steps) * mean / (1 - DECAY**step) / size
        atoms = atoms / np.linalg.norm(atoms, axis=1, keepdims=True)
    return atoms


def triplet_loss(
    surfaces: Sequence[SurfacePoints],
    labels: Sequence[str],
    atoms: FloatArray,
    margin: float,
    n_iterations: int = N_ITERATIONS,
) -> Loss:
    """The hinge loss of all triplets of surfaces.

    The mean of max(0, μ + ‖h_q − h_p‖² − ‖h_q − h_n‖²) over all surfaces q, p of the class of q, and n of
    another class, with h the square roots of the shares of the atoms (L, d).
    """
    features = np.concatenate([surface.features for surface in surfaces])  # (n, d)
    shares = np.concatenate([surface.shares for surface in surfaces])  # (n,)
    of = np.repeat(np.arange(len(surfaces)), [len(surface.shares) for surface in surfaces])  # (n,)
    codes = sparse_codes(features, atoms, n_iterations)  # (n, L)
    pooled = np.zeros((len(surfaces), len(atoms)))
    np.add.at(pooled, of, shares[:, np.newaxis] * np.abs(codes))  # (S, L)
    totals = np.maximum(pooled.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    roots = np.sqrt(pooled / totals + SMALLEST)  # (S, L): h
    value, by_roots = _hinge(roots, np.array(labels), margin)
    by_shares = by_roots / (2 * roots)
    by_pooled = (by_shares - (by_shares * pooled / totals).sum(axis=1, keepdims=True)) / totals
    by_codes = shares[:, np.newaxis] * np.sign(codes) * by_pooled[of]  # (n, L)
    solved = _on_active_sets(atoms @ atoms.T, codes, by_codes)  # (n, L): β
    gradient = solved.T @ (features - codes @ atoms) - codes.T @ (solved @ atoms)
    return Loss(value, gradient)


def _hinge(roots: FloatArray, labels: NDArray[np.str_], margin: float) -> Loss:
    """The mean hinge of the triplets of the rows of (S, L) `roots`, and its derivative by them."""
    apart = ((roots[:, np.newaxis] - roots) ** 2).sum(axis=2)  # (S, S)
    alike = labels[:, np.newaxis] == labels
    queries, others = np.nonzero(alike & ~np.eye(len(labels), dtype=bool))  # (P,)
    hinges = margin + apart[queries, others][:, np.newaxis] - apart[queries]  # (P, S)
    counted = ~alike[queries]
    active = (hinges > 0) & counted
    weights = np.zeros_like(apart)  # (S, S): the derivative by the squared distances
    np.add.at(weights, (queries, others), active.sum(axis=1))
    np.add.at(weights, queries, -active.astype(float))
    weights = (weights + weights.T) / counted.sum()
    by_roots = 2 * (weights.sum(axis=1, keepdims=True) * roots - weights @ roots)
    return Loss(float((hinges * active).sum() / counted.sum()), by_roots)


def _on_active_sets(gram: FloatArray, codes: FloatArray, by_codes: FloatArray) -> FloatArray:
    """(n, L): for each code z with the active set Λ the solution of (D D ᵀ)_ΛΛ β_Λ = (∂ℓ/∂z)_Λ, else zero."""
    most = int((codes != 0).sum(axis=1).max())
    # The active atoms of each code come first, and those behind them are left out of the equations.
    first = np.argsort(codes == 0, axis=1, kind="stable")[:, :most]  # (n, k)
    active = np.take_along_axis(codes != 0, first, axis=1)  # (n, k)
    matrices = gram[first[:, :, np.newaxis], first[:, np.newaxis]]  # (n, k, k)
    matrices *= active[:, :, np.newaxis] & active[:, np.newaxis]
    matrices += np.eye(most) * np.where(active, RIDGE, 1.0)[:, :, np.newaxis]
    right = np.take_along_axis(by_codes, first, axis=1) * active
    solved = np.zeros_like(codes)
    np.put_along_axis(solved, first, np.linalg.solve(matrices, right[:, :, np.newaxis])[:, :, 0], axis=1)
    return solved


def _gap(surfaces: Sequence[SurfacePoints], labels: Sequence[str], atoms: FloatArray) -> float:
    """The median squared distance of a surface to the nearest one of another class."""
    roots = np.sqrt([atom_shares(surface, atoms) for surface in surfaces])  # (S, L)
    squares = (roots**2).sum(axis=1)
    apart = squares[:, np.newaxis] + squares - 2 * roots @ roots.T
    names = np.array(labels)
    apart[names[:, np.newaxis] == names] = np.inf
    return float(np.median(apart.min(axis=1)))


def _drawn(surface: SurfacePoints, rng: np.random.Generator) -> SurfacePoints:
    """Random points of a surface, in proportion to area."""
    number = min(N_POINTS, len(surface.shares))
    picked = rng.choice(len(surface.shares), number, p=surface.shares)
    return SurfacePoints(surface.features[picked], np.full(number, 1 / number))


ARRAYS = {"heat": heat, "dictionary": dictionary}


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute one of the arrays."""
    parser = argument_parser(__doc__)
    parser.add_argument("which", choices=ARRAYS)
    ARRAYS[parser.parse_args(arguments).which]()
