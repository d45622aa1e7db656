"""Whitenings fitted to log-signatures.

The matrix is the symmetric inverse square root W = s C^(−1/2) of a covariance C (ZCA whitening). Of all
whitening matrices the symmetric one changes the coordinates least in the mean square [1]_. This matters for
D₁ and D₂, which unlike the Euclidean distance depend on the coordinate axes: they compare values that are
close to the original ones. The symmetric root is also independent of the sign and the order of the
eigenvectors of C.

The factor s preserves the total variance of the shapes of the fit. D₁ and D₂ are not homogeneous, so that
without s they would be evaluated far from the magnitudes for which they were designed, and distances with
different whitenings would not be comparable.

C describes what should be ignored: the differences within classes (``within-class``), the differences of
pairs that are probably of one class (``neighbours``), or, as a first approximation, all differences
(``pca``). Whitening by the differences of nearest neighbours is unsupervised, in the manner of relevant
component analysis [2]_ with the pairs in place of its equivalence constraints.

References
----------
.. [1] Kessy, Lewin and Strimmer, "Optimal whitening and decorrelation", The American Statistician 2018.
.. [2] Bar-Hillel, Hertz, Shental and Weinshall, "Learning a Mahalanobis metric from equivalence
   constraints", Journal of Machine Learning Research 2005.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions, Shrinkage
from pcretrieve.retrieval.covariances import (
    likeliest_shrinkage,
    scatter_matrix,
    shrunk,
    within_class_residuals,
)
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.retrieval.neighbour_covariance import LEAST_SHAPES, neighbour_covariance
from pcretrieve.retrieval.pairs import neighbour_pairs
from pcretrieve.retrieval.regularisation import CovarianceFit, checked_shrinkage, inverse_square_root
from pcretrieve.retrieval.whitening import WHITENINGS, Whitening
from pcretrieve.values import FloatArray, Metric, SignatureTable

__all__ = ["fit_whitening", "table_whitening"]

logger = logging.getLogger(__name__)

# Least number of classes from which labels are used by "auto".
LEAST_CLASSES = 5

# Mean squared difference of neighbouring shapes as a share of the total variance, after PCA whitening, above
# which PCA whitening is likely to do harm. See docs/decisions.md, PCA_NOISE.
PCA_NOISE = 0.1


def fit_whitening(
    kind: str,
    logs: FloatArray,
    labels: Sequence[str | None] | None = None,
    *,
    shrinkage: Shrinkage = "auto",
    n_neighbors: int | Literal["auto"] = "auto",
    rounds: int = 1,
    prior: FloatArray | None = None,
    metric: Metric = "logarithms",
    options_digest: str = "",
) -> Whitening:
    """Fit a whitening to log-signatures.

    logs: (N, L) float64, log-signatures, one in each row.
    prior: (L, L) float64, optional, a covariance of trace 1 of what should be ignored in any gallery, such as
        `resolution_covariance`. For ``neighbours`` only: 30 % of the covariance.
    metric: the metric of the signatures. The coordinates of the metric ``values`` may have different units.
        For ``within-class`` only.
    """
    if kind not in (*WHITENINGS, "auto"):
        raise OptionError(f"whitening must be one of auto, {', '.join(WHITENINGS)}, got {kind!r}")
    if logs.ndim != 2 or not np.isfinite(logs).all():
        raise InputError(f"log-signatures must be finite and have shape (N, L), got {logs.shape}")
    if kind == "resolution":
        raise OptionError(f"whitening {kind!r} is not fitted to shapes: see resolution_whitening")
    if kind not in ("none", "auto"):
        checked_shrinkage(kind, shrinkage)
    used = _chosen(logs, labels) if kind == "auto" else kind
    fit: CovarianceFit | str | None = None
    if used == "pca":
        fit = _pca(logs, shrinkage)
    elif used == "within-class":
        fit = _within_class(logs, labels, shrinkage, one_unit=metric != "values")
    elif used == "neighbours":
        fit = neighbour_covariance(logs, shrinkage, n_neighbors, rounds, prior)
    if fit is None or isinstance(fit, str):
        n_values = logs.shape[1]
        reason = fit or "none"
        return Whitening("none", np.zeros(n_values), np.eye(n_values), len(logs), 0.0, options_digest, reason)
    total = _covariance(fit.shapes)
    root = inverse_square_root(fit.covariance)
    scale = np.sqrt(np.trace(total) / np.trace(root @ total @ root))
    mean = fit.shapes.mean(axis=0)
    return Whitening(used, mean, scale * root, len(fit.shapes), fit.shrinkage, options_digest, fit.reason)


def table_whitening(
    table: SignatureTable,
    options: RetrievalOptions,
    whitening: Whitening | None = None,
    *,
    prior: FloatArray | None = None,
) -> Whitening:
    """The whitening of a table of signatures.

    prior: (L, L) float64, optional, as in `fit_whitening`.
    """
    if whitening is None:
        logs = table_coordinates(table, options.distance)
        return fit_whitening(
            options.whitening,
            logs,
            table.labels,
            shrinkage=options.shrinkage,
            prior=prior,
            metric=table.metric,
            options_digest=table.digest,
        )
    whitening.check_made_for(table.digest)
    return whitening


def _chosen(logs: FloatArray, labels: Sequence[str | None] | None) -> str:
    """The whitening that ``auto`` stands for."""
    sizes = [
        size for size in Counter(label for label in labels or () if label is not None).values() if size > 1
    ]
    # The rank of the pooled covariance, beyond which directions would be whitened by the shrinkage alone.
    rank = sum(sizes) - len(sizes)
    return "within-class" if len(sizes) >= LEAST_CLASSES and rank >= logs.shape[1] else "neighbours"


def _pca(logs: FloatArray, shrinkage: Shrinkage) -> CovarianceFit:
    """All shapes, and their regularised covariance."""
    _check_distinct("pca", logs)
    used = checked_shrinkage("pca", shrinkage)
    covariance = _covariance(logs)
    largest = np.linalg.eigvalsh(covariance)[-1]
    covariance += used * largest * np.eye(len(covariance))
    _warn_of_noise(logs, inverse_square_root(covariance))
    return CovarianceFit(logs, covariance, used, f"pca: the covariance of {len(logs)} shapes")


def _warn_of_noise(logs: FloatArray, root: FloatArray) -> None:
    """Warn if whitening by a covariance makes neighbours distant, as with bodies of one kind."""
    if len(logs) < LEAST_SHAPES:
        return
    pairs = neighbour_pairs(logs)
    if not len(pairs.weights):
        return
    difference = (logs[pairs.first] - logs[pairs.second]) @ root
    share = (difference**2).sum(axis=1).mean() / 2 / (logs @ root).var(axis=0).sum()
    if share > PCA_NOISE:
        logger.warning(
            "PCA whitening is likely to make rankings worse here: after it, neighbouring shapes differ by "
            "%.0f %% of the total variance, as in collections of one kind of body; the whitening "
            "'neighbours' has no such effect",
            100 * share,
        )


def _within_class(
    logs: FloatArray, labels: Sequence[str | None] | None, shrinkage: Shrinkage, *, one_unit: bool
) -> CovarianceFit:
    """The shapes in classes of at least two shapes, and their shrunk pooled covariance."""
    residuals = within_class_residuals(logs, labels)
    fitted = logs[residuals.rows]
    _check_distinct("within-class", fitted)
    pooled = residuals.covariance
    if np.trace(pooled) == 0:
        raise InputError(
            "within-class whitening needs shapes that differ within their class, got equal signatures in "
            "every class; use the whitening 'pca' or 'none'"
        )
    used = likeliest_shrinkage(residuals, one_unit=one_unit) if shrinkage == "auto" else float(shrinkage)
    reason = f"within-class: {residuals.n_classes} classes of {len(fitted)} shapes"
    return CovarianceFit(fitted, shrunk(pooled, used, one_unit=one_unit), used, reason)


def _covariance(logs: FloatArray) -> FloatArray:
    return scatter_matrix(logs, logs.mean(axis=0)) / (len(logs) - 1)


def _check_distinct(kind: str, logs: FloatArray) -> None:
    if (logs == logs[:1]).all():
        raise InputError(
            f"{kind} whitening needs at least 2 distinct shapes, got {len(logs)} shapes and no two distinct; "
            "add shapes, or use the whitening 'none'"
        )
