"""Covariance within labelled classes, and its shrinkage by the likelihood of classes that are left out.

A covariance is shrunk towards that of uncorrelated values. In this target all values have the same variance
if they have one unit, as logarithms have; otherwise each value has its own variance, so that the result does
not depend on the units (targets B and D of Schäfer and Strimmer, Statistical Applications in Genetics and
Molecular Biology 2005). See docs/decisions.md, one_unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import InputError
from pcretrieve.retrieval.ranking import Positions
from pcretrieve.values import FloatArray

__all__ = ["CHUNK", "Residuals", "likeliest_shrinkage", "scatter_matrix", "shrunk", "within_class_residuals"]

# Number of signatures that are processed together, so that intermediate arrays have a few MB.
CHUNK = 2**15

# Intensities that are tried, and the number of groups of classes, each of which is left out once.
INTENSITIES = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
N_GROUPS = 4
SEED = 1

# Smallest variance of a value in the target, relative to the mean variance: the covariance must be invertible
# also if a value is the same for all shapes of each class.
LEAST_VARIANCE = 1e-9

# Intensity if there are fewer than two classes, so that none can be left out.
UNTESTED = 0.1


def scatter_matrix(logs: FloatArray, mean: FloatArray) -> FloatArray:
    """The scatter matrix of many shapes, without a centred copy of the table.

    logs: (N, L) float64, log-signatures, one in each row.
    mean: (L,) float64, their mean.
    Returns (L, L) float64: the sum of the outer products of the centred rows: N − 1 times the covariance.
    """
    scatter = np.zeros((len(mean), len(mean)))
    for start in range(0, len(logs), CHUNK):
        centred = logs[start : start + CHUNK] - mean
        scatter += centred.T @ centred
    return scatter


class Residuals(NamedTuple):
    """The differences of shapes from the mean of their class.

    rows: (n,) intp, positions of the shapes in classes of at least two shapes, class after class.
    classes: (n,) intp, number of the class of each of these shapes, ascending.
    values: (n, L) float64, the residuals.
    """

    rows: Positions
    classes: Positions
    values: FloatArray

    @property
    def n_classes(self) -> int:
        """Number of classes of at least two shapes."""
        return int(self.classes[-1]) + 1

    @property
    def covariance(self) -> FloatArray:
        """(L, L) pooled within-class covariance, without bias."""
        return _pooled(self.values, self.classes)


def within_class_residuals(logs: FloatArray, labels: Sequence[str | None] | None) -> Residuals:
    """Subtract the mean of its class from each labelled shape.

    logs: (N, L) float64, log-signatures.
    """
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
    return Residuals(np.concatenate([np.array(members) for members in classes]), numbers, values)


def likeliest_shrinkage(residuals: Residuals, *, one_unit: bool = True) -> float:
    """The shrinkage at which the residuals of classes that are left out are most likely.

    one_unit: whether all values have one unit, as in `shrunk`.
    """
    n_groups = min(N_GROUPS, residuals.n_classes)
    if n_groups < 2:
        return UNTESTED
    group = np.random.default_rng(SEED).permutation(residuals.n_classes) % n_groups
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


def shrunk(covariance: FloatArray, intensity: float, *, one_unit: bool = True) -> FloatArray:
    """A covariance shrunk towards that of uncorrelated values.

    covariance: (L, L) float64, c.
    one_unit: whether all values have one unit. The target T is then tr(C)/L I, otherwise the diagonal of C.
    Returns (L, L) float64: (1 − s) C + s T.
    """
    variances = np.diag(covariance)
    mean = variances.mean()
    target = np.full(len(variances), mean) if one_unit else np.maximum(variances, LEAST_VARIANCE * mean)
    result: FloatArray = (1 - intensity) * covariance + intensity * np.diag(target)
    return result


def _pooled(values: FloatArray, classes: Positions) -> FloatArray:
    covariance: FloatArray = values.T @ values / (len(values) - len(np.unique(classes)))
    return covariance
