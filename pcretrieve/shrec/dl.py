"""Bags of sparse codes: point descriptors as sparse combinations of the atoms of a learned dictionary.

Litman et al. learn the dictionary from the shapes of a set, without labels or with labels. Here both
dictionaries are learned from simulated people, animals and hands, are stored beside this file, and are made
by ``scripts/sample dictionary``: the signature of a shape depends on this shape alone, and signatures of
different galleries are comparable. `learned_atoms` are those of labelled shapes, for the option ``atoms``.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.descriptors.csd import scale_invariant_heat
from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.errors import InputError
from pcretrieve.options.tables import Atoms
from pcretrieve.shrec.heat import shipped
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import (
    Eigenpairs,
    FloatArray,
    Signature,
    TriangleMesh,
    unit_vectors,
)

logger = logging.getLogger(__name__)

# Number of atoms, as published, and of frequencies of the point descriptor.
N_ATOMS = 32
N_FREQUENCIES = 19

# λ of the lasso, for point descriptors and atoms of unit length.
PENALTY = 0.1

# Steps of FISTA.
N_ITERATIONS = 100

# (2, 32, 19): the dictionary that was learned without labels, and the one with labels.
ATOMS = "dl_atoms.npy"


class SurfacePoints(NamedTuple):
    """Point descriptors (n, d) of unit length, and their shares (n,) of the area of the surface, of sum 1."""

    features: FloatArray
    shares: FloatArray


def dl(
    pairs: Eigenpairs, *, supervised: bool = False, atoms: Atoms | None = None
) -> Signature:
    """The mean absolute sparse code of a surface [1]_.

    The open settings, and deviations from the article: scale-invariant heat kernel signatures of unit length,
    of 19 frequencies, as the point descriptor; λ = 0.1; codes after 100 steps of FISTA; dictionaries that are
    learned from simulated bodies instead of the gallery, the supervised one with individuals as classes and a
    margin of 0.3 of the gap between classes; and the Hellinger distance of the shares of the atoms instead of
    the Euclidean distance of the means, in the loss of the supervised dictionary too.

    pairs: of a connected surface on unit area, all of which are in the sum of the heat kernel.
    atoms: (32, 19), a dictionary of one's own. The hash of the dictionary is in the digest.

    References
    ----------
    .. [1] R. Litman, A. Bronstein, M. Bronstein and U. Castellani, "Supervised learning of bag-of-features
       shape descriptors using sparse coding", Computer Graphics Forum 33 (2014).
    """
    used = np.array(atoms) if supervised and atoms else shipped(ATOMS)[int(supervised)]
    digest = f"m={len(pairs.eigenvalues) - 1}, atoms {hashlib.sha256(used.tobytes()).hexdigest()[:16]}"
    kind = "dl-supervised" if supervised else "dl"
    return Signature(
        atom_shares(surface_points(pairs), used),
        kind=kind,
        digest=digest,
        metric="histograms",
    )


def surface_points(pairs: Eigenpairs) -> SurfacePoints:
    """The scale-invariant heat kernel signatures of all vertices, scaled to unit length."""
    features = scale_invariant_heat(pairs, N_FREQUENCIES)  # (n, 19)
    areas = np.asarray(pairs.mass.sum(axis=0)).ravel()  # (n,)
    return SurfacePoints(unit_vectors(features), areas / areas.sum())


def atom_shares(points: SurfacePoints, atoms: FloatArray) -> FloatArray:
    """(L,) shares of the atoms, ``∫ |z_k| / Σ_l ∫ |z_l|`` for codes z; equal if every code is zero."""
    pooled = points.shares @ np.abs(
        sparse_codes(points.features, atoms)
    )  # (L,): ∫ |z| / A
    total = pooled.sum()
    return pooled / total if total else np.full(len(atoms), 1 / len(atoms))


def sparse_codes(
    features: FloatArray, atoms: FloatArray, n_iterations: int = N_ITERATIONS
) -> FloatArray:
    """(n, L) codes z near the minimisers of ½ ‖x − zᵀ D‖² + λ ‖z‖₁, most entries of which are zero.

    By FISTA (Beck and Teboulle, SIAM Journal on Imaging Sciences 2, 2009, section 4), for point descriptors x
    (n, d) and the dictionary D (L, d), of rows of unit length.
    """
    gram = atoms @ atoms.T  # (L, L)
    correlation = features @ atoms.T  # (n, L)
    lipschitz = np.linalg.eigvalsh(gram)[-1]
    codes: FloatArray = np.zeros_like(correlation)
    ahead = codes
    momentum = 1.0
    for _ in range(n_iterations):
        moved = ahead - (ahead @ gram - correlation) / lipschitz
        # Soft threshold.
        after = moved - np.clip(moved, -PENALTY / lipschitz, PENALTY / lipschitz)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = after + (momentum - 1) / following * (after - codes)
        codes, momentum = after, following
    return codes


# --- learning from labels ------------------------------------------------------------------------------

# Classes in one step, surfaces of each class, and points of each surface, of which more are kept.
N_CLASSES = 8
PER_CLASS = 3
N_POINTS = 60
N_KEPT = 1000

# The largest step of Adam, which decreases to zero linearly, and the decay of its means of the gradient and
# of its square (Kingma and Ba, 2015).
N_STEPS = 200
RATE = 0.01
DECAY = 0.9
SQUARED_DECAY = 0.999

# μ of the hinge, relative to the median squared distance of a surface to the nearest one of another class.
MARGIN = 0.3

# Of atoms that a few classes change: by larger steps, other classes are told apart less well than before.
CHANGE = {"rate": 0.001, "margin": 1.0}

# Added to the diagonal of the Gram matrix of active atoms, which may be almost parallel; and to shares under
# the square root, whose derivative at zero is infinite.
RIDGE = SMALLEST = 1e-4


def learned_atoms(
    meshes: Iterable[TriangleMesh], labels: Sequence[str], n_modes: int
) -> FloatArray:
    """(32, 19): the shipped atoms of ``dl-supervised``, changed by the labels of meshes."""
    rng = np.random.default_rng(0)

    def surfaces() -> Iterator[SurfacePoints]:
        for number, mesh in enumerate(meshes, start=1):
            points = surface_points(unit_eigenpairs(mesh, n_modes + 1))
            yield SurfacePoints(_drawn(points, rng, N_KEPT), np.full(N_KEPT, 1 / N_KEPT))
            logger.info("%d of %d shapes", number, len(labels))

    return supervised_dictionary(surfaces(), labels, shipped(ATOMS)[1], rng, **CHANGE)


def supervised_dictionary(
    surfaces: Iterable[SurfacePoints],
    labels: Sequence[str],
    atoms: FloatArray,
    rng: np.random.Generator,
    *,
    rate: float = RATE,
    margin: float = MARGIN,
) -> FloatArray:
    """The atoms by which surfaces of one class are nearer to each other than to those of other classes.

    atoms: (L, d), the dictionary to begin with.
    """
    names = np.array(labels)
    classes = [np.flatnonzero(names == name) for name in sorted(set(labels))]
    classes = [members for members in classes if len(members) > 1]
    if len(classes) < 2:
        raise InputError(
            f"learning needs two classes of two shapes or more, got {len(classes)}: label more"
        )
    surfaces = list(surfaces)
    apart = _squares_apart(np.sqrt([atom_shares(surface, atoms) for surface in surfaces]))
    apart[names[:, np.newaxis] == names] = np.inf
    margin *= float(np.median(apart.min(axis=1)))
    mean, squares = np.zeros_like(atoms), np.zeros_like(atoms)
    for step in range(1, N_STEPS + 1):
        logger.info("step %d of %d", step, N_STEPS)
        chosen = np.concatenate(
            [
                rng.choice(
                    classes[number], min(PER_CLASS, len(classes[number])), replace=False
                )
                for number in rng.choice(
                    len(classes), min(N_CLASSES, len(classes)), replace=False
                )
            ]
        )
        drawn = np.array([_drawn(surfaces[number], rng, N_POINTS) for number in chosen])
        _, gradient = triplet_loss(drawn, names[chosen], atoms, margin)
        # Along the sphere.
        gradient -= (gradient * atoms).sum(axis=1, keepdims=True) * atoms
        mean = DECAY * mean + (1 - DECAY) * gradient
        squares = SQUARED_DECAY * squares + (1 - SQUARED_DECAY) * gradient**2
        size = np.sqrt(squares / (1 - SQUARED_DECAY**step)) + np.finfo(float).tiny
        atoms = unit_vectors(
            atoms - rate * (1 - step / N_STEPS) * mean / (1 - DECAY**step) / size
        )
    return atoms


def triplet_loss(
    points: FloatArray,
    labels: NDArray[np.str_],
    atoms: FloatArray,
    margin: float,
    n_iterations: int = N_ITERATIONS,
) -> tuple[float, FloatArray]:
    """The hinge loss of all triplets of surfaces (S, p, d) of classes (S,), and its derivative (L, d).

    The mean of max(0, μ + ‖h_q − h_p‖² − ‖h_q − h_n‖²) over all surfaces q, p of the class of q, and n of
    another class, with h the square roots of the shares of the atoms. The derivative by the atoms D is that
    of Mairal, Bach and Ponce, "Task-driven dictionary learning", IEEE PAMI 34 (2012), proposition 1: codes z
    with the active set Λ change by β, with (D Dᵀ)_ΛΛ β_Λ = (∂ℓ/∂z)_Λ, and zero elsewhere.
    """
    n_surfaces, n_points, length = points.shape
    features = points.reshape(-1, length)  # (n, d)
    codes = sparse_codes(features, atoms, n_iterations)  # (n, L)
    shares = np.abs(codes) * (1 / n_points)
    pooled = shares.reshape(n_surfaces, n_points, -1).sum(axis=1)  # (S, L)
    loss, by_pooled = _loss_of_shares(pooled, labels, margin)
    by_codes = (
        np.sign(codes) / n_points * np.repeat(by_pooled, n_points, axis=0)
    )  # (n, L)
    solved = _active_solutions(codes, atoms, by_codes)
    gradient = solved.T @ (features - codes @ atoms) - codes.T @ (solved @ atoms)
    return loss, gradient


def _loss_of_shares(
    pooled: FloatArray, labels: NDArray[np.str_], margin: float
) -> tuple[float, FloatArray]:
    """The loss of mean absolute codes (S, L), and its derivative (S, L) by them."""
    totals = np.maximum(pooled.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    roots = np.sqrt(pooled / totals + SMALLEST)  # (S, L): h

    loss, weights = _hinges(_squares_apart(roots), labels, margin)
    by_roots = 2 * (weights.sum(axis=1, keepdims=True) * roots - weights @ roots)
    by_shares = by_roots / (2 * roots)
    by_pooled = (
        by_shares - (by_shares * pooled / totals).sum(axis=1, keepdims=True)
    ) / totals
    return loss, by_pooled


def _hinges(
    apart: FloatArray, labels: NDArray[np.str_], margin: float
) -> tuple[float, FloatArray]:
    """The loss of squared distances (S, S), and its derivative (S, S) by them."""
    alike = labels[:, np.newaxis] == labels  # (S, S)
    hinges = margin + apart[:, :, np.newaxis] - apart[:, np.newaxis]  # (q, p, n)
    counted = (alike & ~np.eye(len(labels), dtype=bool))[:, :, np.newaxis] & ~alike[
        :, np.newaxis
    ]
    active = (hinges > 0) & counted
    weights = active.sum(axis=2) - active.sum(axis=1)
    loss = float((hinges * active).sum() / counted.sum())
    return loss, (weights + weights.T) / counted.sum()


def _active_solutions(
    codes: FloatArray, atoms: FloatArray, right: FloatArray
) -> FloatArray:
    """(n, L) β: solutions of (D Dᵀ)_ΛΛ β_Λ = right_Λ for the active atoms Λ of each code, else zero."""
    # The k active atoms of each code come first, and those behind them are left out of the equations.
    most = (codes != 0).sum(axis=1).max()
    first = np.argsort(codes == 0, axis=1, kind="stable")[:, :most]  # (n, k)
    used = np.take_along_axis(codes != 0, first, axis=1)
    gram = (atoms @ atoms.T)[first[:, :, np.newaxis], first[:, np.newaxis]]  # (n, k, k)
    gram *= used[:, :, np.newaxis] & used[:, np.newaxis]
    gram += np.eye(first.shape[1]) * np.where(used, RIDGE, 1.0)[:, np.newaxis]
    given = np.take_along_axis(right, first, axis=1)[:, :, np.newaxis]
    solved = np.zeros_like(codes)
    np.put_along_axis(solved, first, np.linalg.solve(gram, given)[:, :, 0], axis=1)
    return solved


def _squares_apart(rows: FloatArray) -> FloatArray:
    """The squared distances of all pairs of rows."""
    squares = (rows**2).sum(axis=1)
    return np.asarray(squares[:, np.newaxis] + squares - 2 * rows @ rows.T)


def _drawn(surface: SurfacePoints, rng: np.random.Generator, number: int) -> FloatArray:
    """The descriptors of random points of a surface, in proportion to area."""
    return surface.features[rng.choice(len(surface.shares), number, p=surface.shares)]


def _record(name: str, spread: float, *, supervised: bool) -> Descriptor:
    return Descriptor(
        name=name,
        make=lambda shape, options: dl(
            shape.eigenpairs, supervised=supervised, atoms=options.atoms
        ),
        needs=("eigenvectors",),
        has_size=False,
        length=lambda _: N_ATOMS,
        metric="histograms",
        spread=spread,
    )


DL = _record("dl", 0.065, supervised=False)
DL_SUPERVISED = _record("dl-supervised", 0.067, supervised=True)
