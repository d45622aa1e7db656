"""Covariances of what shapes differ by: within labelled classes, or between nearest neighbours.

A covariance is shrunk towards that of uncorrelated values. In this target all values have the same variance
if they have one unit, as logarithms have; otherwise each value has its own variance, so that the result does
not depend on the units (targets B and D of Schäfer and Strimmer, Statistical Applications in Genetics and
Molecular Biology 2005). See docs/decisions.md, one_unit. Within classes, the intensity is the one at which
classes that are left out are most likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import Shrinkage
from pcretrieve.retrieval.pairs import neighbour_pairs
from pcretrieve.retrieval.ranking import Positions
from pcretrieve.values import FloatArray

# Number of signatures that are processed together, so that intermediate arrays have a few MB.
CHUNK = 2**15

# Regularisation of the covariance, which limits the amplification of noise in directions of small
# variance. For
# within-class it is estimated instead.
DEFAULT_SHRINKAGE = {
    "neighbours": 0.20,  # intensity towards the mean variance times the identity
    "pca": 0.01,  # times the largest eigenvalue, added to all eigenvalues (Tikhonov)
    "resolution": 0.03,  # as for pca
}

# Intensities that are tried within classes, and the number of groups of classes, each of which is left out
# once. With fewer than two classes, none can be left out: the intensity is then UNTESTED.
INTENSITIES = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
N_GROUPS = 4
SEED = 1
UNTESTED = 0.1

# Smallest variance of a value in the target, relative to the mean variance: the covariance must be invertible
# also if a value is the same for all shapes of each class.
LEAST_VARIANCE = 1e-9

# Shrinkage of the covariance of neighbours towards the covariance of changes of resolution, where that is
# known, and the remaining shrinkage towards the identity.
PRIOR_SHARE = 0.3
SHRINKAGE_WITH_PRIOR = 0.03

# Least numbers of shapes and of pairs for a whitening by neighbours.
LEAST_SHAPES = 24
LEAST_PAIRS = 10


class CovarianceFit(NamedTuple):
    """What a whitening is made of.

    shapes: (n, L) float64, the shapes of the fit.
    covariance: (L, L) float64, regularised.
    """

    shapes: FloatArray
    covariance: FloatArray
    shrinkage: float
    reason: str


def checked_shrinkage(kind: str, shrinkage: Shrinkage) -> float:
    """The shrinkage of a whitening, or its default, after a check of its range."""
    value = DEFAULT_SHRINKAGE.get(kind, 1.0) if shrinkage == "auto" else float(shrinkage)
    if not 0 < value <= 1:
        raise OptionError(f"shrinkage must lie in (0, 1], got {value}")
    return value


def inverse_square_root(covariance: FloatArray) -> FloatArray:
    """The symmetric inverse square root C^(−1/2) of a covariance (L, L), symmetric positive definite."""
    variances, directions = np.linalg.eigh(covariance)
    root: FloatArray = (directions / np.sqrt(variances)) @ directions.T
    return root


def scatter_matrix(logs: FloatArray, mean: FloatArray) -> FloatArray:
    """The outer products of many shapes (N, L) minus their mean, summed: (L, L), N − 1 times the covariance.

    No centred copy of the table is made.
    """
    scatter = np.zeros((len(mean), len(mean)))
    for start in range(0, len(logs), CHUNK):
        centred = logs[start : start + CHUNK] - mean
        scatter += centred.T @ centred
    return scatter


def shrunk(covariance: FloatArray, intensity: float, *, one_unit: bool = True) -> FloatArray:
    """A covariance C shrunk towards that of uncorrelated values, (1 − s) C + s T.

    one_unit: whether all values have one unit. The target T is then tr(C)/L I, otherwise the diagonal of C.
    """
    variances = np.diag(covariance)
    mean = variances.mean()
    target = np.full(len(variances), mean) if one_unit else np.maximum(variances, LEAST_VARIANCE * mean)
    result: FloatArray = (1 - intensity) * covariance + intensity * np.diag(target)
    return result


class _Residuals(NamedTuple):
    """The differences of shapes from the mean of their class.

    rows: (n,) intp, positions of the shapes in classes of at least two shapes, class after class.
    classes: (n,) intp, number of the class of each of these shapes, ascending.
    values: (n, L) float64, the residuals.
    """

    rows: Positions
    classes: Positions
    values: FloatArray


def within_class_covariance(
    logs: FloatArray, labels: Sequence[str | None] | None, shrinkage: Shrinkage, *, one_unit: bool
) -> CovarianceFit:
    """The shapes in classes of at least two shapes, and their shrunk pooled covariance.

    logs: (N, L) float64, log-signatures.
    """
    residuals = _residuals(logs, labels)
    fitted = logs[residuals.rows]
    check_distinct("within-class", fitted)
    pooled = _pooled(residuals.values, residuals.classes)
    if np.trace(pooled) == 0:
        raise InputError(
            "within-class whitening needs shapes that differ within their class, got equal signatures in "
            "every class; use the whitening 'pca' or 'none'"
        )
    used = _likeliest_shrinkage(residuals, one_unit=one_unit) if shrinkage == "auto" else float(shrinkage)
    reason = f"within-class: {residuals.classes[-1] + 1} classes of {len(fitted)} shapes"
    return CovarianceFit(fitted, shrunk(pooled, used, one_unit=one_unit), used, reason)


def check_distinct(kind: str, logs: FloatArray) -> None:
    """InputError if all log-signatures (N, L) are equal."""
    if (logs == logs[:1]).all():
        raise InputError(
            f"{kind} whitening needs at least 2 distinct shapes, got {len(logs)} shapes and no two distinct; "
            "add shapes, or use the whitening 'none'"
        )


def _residuals(logs: FloatArray, labels: Sequence[str | None] | None) -> _Residuals:
    """Subtract the mean of its class from each labelled shape."""
    if labels is None or len(labels) != len(logs):
        given = "none" if labels is None else str(len(labels))
        raise InputError(f"within-class whitening needs one label per shape ({len(logs)}), got {given}")
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(labels):
        if label is not None:
            rows.setdefault(label, []).append(row)
    classes = [rows[label] for label in sorted(rows) if len(rows[label]) > 1]
    if not classes:
        raise InputError(
            f"within-class whitening needs a class with at least 2 shapes, got {len(rows)} classes and none "
            "so large; label more shapes, or use the whitening 'pca' or 'none'"
        )
    numbers = np.repeat(np.arange(len(classes)), [len(members) for members in classes])
    values = np.concatenate([logs[members] - logs[members].mean(axis=0) for members in classes])
    return _Residuals(np.concatenate([np.array(members) for members in classes]), numbers, values)


def _pooled(values: FloatArray, classes: Positions) -> FloatArray:
    """(L, L) pooled within-class covariance of residuals (n, L), without bias."""
    covariance: FloatArray = values.T @ values / (len(values) - len(np.unique(classes)))
    return covariance


def _likeliest_shrinkage(residuals: _Residuals, *, one_unit: bool) -> float:
    """The shrinkage at which the residuals of classes that are left out are most likely."""
    n_classes = int(residuals.classes[-1]) + 1
    n_groups = min(N_GROUPS, n_classes)
    if n_groups < 2:
        return UNTESTED
    group = np.random.default_rng(SEED).permutation(n_classes) % n_groups
    likelihood = np.zeros(len(INTENSITIES))
    for left_out in range(n_groups):
        held = group[residuals.classes] == left_out
        pooled = _pooled(residuals.values[~held], residuals.classes[~held])
        tested = _pooled(residuals.values[held], residuals.classes[held])
        if np.trace(pooled) == 0:
            continue
        n_free = held.sum() - (group == left_out).sum()
        for number, intensity in enumerate(INTENSITIES):
            covariance = shrunk(pooled, intensity, one_unit=one_unit)
            deviance = np.linalg.slogdet(covariance)[1] + np.trace(np.linalg.solve(covariance, tested))
            likelihood[number] -= n_free * deviance
    return INTENSITIES[int(np.argmax(likelihood))]


def neighbour_covariance(
    logs: FloatArray,
    shrinkage: Shrinkage,
    n_neighbors: int | Literal["auto"],
    prior: FloatArray | None,
) -> CovarianceFit | str:
    """The covariance of the differences of neighbours, or why there is none.

    logs: (N, L) float64, log-signatures.
    prior: (L, L) float64 or None, as in `fit_whitening`.
    """
    if len(logs) < LEAST_SHAPES:
        return f"none, because {len(logs)} shapes are too few to learn from neighbours ({LEAST_SHAPES})"
    if shrinkage == "auto":
        used = DEFAULT_SHRINKAGE["neighbours"] if prior is None else SHRINKAGE_WITH_PRIOR
    else:
        used = float(shrinkage)
    pairs = neighbour_pairs(logs, n_neighbors)
    n_pairs = len(pairs.weights)
    if n_pairs < LEAST_PAIRS:
        return f"none, because only {n_pairs} pairs of shapes are mutual neighbours ({LEAST_PAIRS})"
    differences = logs[pairs.first] - logs[pairs.second]  # (P, L)
    covariance = (differences * pairs.weights[:, np.newaxis]).T @ differences
    covariance /= np.trace(covariance)
    if prior is not None:
        covariance = (1 - PRIOR_SHARE) * covariance + PRIOR_SHARE * prior
    reason = f"neighbours: {n_pairs} pairs, each among the other's {pairs.n_neighbors} nearest"
    return CovarianceFit(logs, shrunk(covariance, used), used, reason)
