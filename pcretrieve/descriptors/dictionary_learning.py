"""Dictionaries that separate classes: supervised learning of the atoms of sparse codes.

Litman et al. [1]_, section 4, change a dictionary so that surfaces of one class become nearer to each other
than to surfaces of other classes, by gradient descent. The loss is a function of the dictionary through the
codes. The derivative of a minimiser of the lasso follows from its optimality conditions on the active set,
the entries of a code that are not zero [2]_. For the codes of `sparse_codes`, which are near the minimisers,
this derivative is an approximation; that it suffices is measured on classes that were not learned from, see
docs/decisions.md, DL.

References
----------
.. [1] R. Litman, A. Bronstein, M. Bronstein and U. Castellani, "Supervised learning of bag-of-features shape
   descriptors using sparse coding", Computer Graphics Forum 33 (2014).
.. [2] J. Mairal, F. Bach and J. Ponce, "Task-driven dictionary learning", IEEE Transactions on Pattern
   Analysis and Machine Intelligence 34 (2012), proposition 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.descriptors.sparse_coding import N_ITERATIONS, SurfacePoints, atom_shares, sparse_codes
from pcretrieve.errors import InputError
from pcretrieve.values import FloatArray

__all__ = ["Loss", "supervised_dictionary", "triplet_loss"]

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
    """The loss of a dictionary, and its derivative.

    gradient: (L, d) float64, its derivative by the atoms.
    """

    value: float
    gradient: FloatArray


def supervised_dictionary(
    surfaces: Sequence[SurfacePoints],
    labels: Sequence[str],
    atoms: FloatArray,
    rng: np.random.Generator,
    *,
    n_steps: int = 200,
) -> FloatArray:
    """The atoms by which surfaces of one class are nearer to each other than to those of other classes.

    atoms: (L, d) float64, the dictionary to begin with, of rows of unit length: as a rule one that was
        learned without labels.
    Returns (L, d) float64: the dictionary, of rows of unit length.
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
    another class, with h the square roots of the shares of the atoms.

    atoms: (L, d) float64, the dictionary D.
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
