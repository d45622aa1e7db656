"""Whitenings fitted to log-signatures.

The matrix is the symmetric inverse square root W = s C^(−1/2) of a covariance C (ZCA whitening). Of all
whitening matrices the symmetric one changes the coordinates least in the mean square [1]_. This matters for
D₁ and D₂, which unlike the Euclidean distance depend on the coordinate axes: they compare values that are
close to the original ones. The symmetric root is also independent of the sign and the order of the
eigenvectors of C.

The factor s preserves the total variance of the shapes of the fit. D₁ and D₂ are not homogeneous, so that
without s they would be evaluated far from the magnitudes for which they were designed, and distances with
different whitenings would not be comparable.

References
----------
.. [1] Kessy, Lewin and Strimmer, "Optimal whitening and decorrelation", The American Statistician 2018.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import Damping, RetrievalOptions
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.retrieval.whitening import WHITENINGS, Whitening
from pcretrieve.types import FloatArray, SignatureTable

__all__ = [
    "DEFAULT_DAMPING",
    "checked_damping",
    "fit_whitening",
    "inverse_square_root",
    "table_whitening",
]

#: Regularisation of the covariance, which limits the amplification of noise in directions of small variance.
#: See docs/decisions.md, DEFAULT_DAMPING.
DEFAULT_DAMPING: Mapping[str, float] = MappingProxyType(
    {
        "pca": 0.01,  # Tikhonov: times the largest eigenvalue, added to all eigenvalues
        "resolution": 0.03,  # as for pca
        "within-class": 0.10,  # shrinkage intensity towards the mean variance times the identity
    }
)


def fit_whitening(
    kind: str,
    logs: FloatArray,
    labels: Sequence[str | None] | None = None,
    *,
    damping: Damping = "auto",
    options_digest: str = "",
) -> Whitening:
    """Fit a whitening to log-signatures.

    Parameters
    ----------
    kind : str
        ``none``: W is the identity. ``pca``: C is the covariance of all shapes, labelled or not, with
        `damping` times its largest eigenvalue added to every eigenvalue (Tikhonov regularisation).
        ``within-class``: C is the pooled within-class covariance, shrunk with intensity `damping` towards its
        mean variance times the identity. ``resolution`` is not fitted: see `resolution_whitening`.
    logs : (N, L) float64
        Log-signatures, one in each row.
    labels : sequence of (str or None), length N, optional
        Classes, for ``within-class`` only. Shapes without a label, and classes of one shape, are ignored.
    damping : float or "auto", default "auto"
        In (0, 1]. auto: ``DEFAULT_DAMPING[kind]``. Ignored for ``none``.
    options_digest : str, default ""
        Digest of the table of the signatures.

    Returns
    -------
    Whitening
        The mean and the matrix W = s C^(−1/2) of the map.

    Raises
    ------
    OptionError
        If the kind does not exist or is not fitted, or the damping is not in (0, 1].
    InputError
        If a log-signature is not finite, there are fewer than two distinct shapes, or, for ``within-class``,
        no class with two distinct shapes.
    """
    if kind not in WHITENINGS:
        raise OptionError(f"whitening must be one of {', '.join(WHITENINGS)}, got {kind!r}")
    if logs.ndim != 2 or not np.isfinite(logs).all():
        raise InputError(f"log-signatures must be finite and have shape (N, L), got {logs.shape}")
    n_values = logs.shape[1]
    if kind == "none":
        return Whitening(
            kind, np.zeros(n_values), np.eye(n_values), n_fitted=len(logs), options_digest=options_digest
        )
    if kind not in _FITS:
        raise OptionError(f"whitening {kind!r} is not fitted to shapes: see resolution_whitening")
    used = checked_damping(kind, damping)
    fitted, covariance = _FITS[kind](logs, labels, used)
    total = _covariance(fitted)
    root = inverse_square_root(covariance)
    scale = np.sqrt(np.trace(total) / np.trace(root @ total @ root))
    return Whitening(kind, fitted.mean(axis=0), scale * root, len(fitted), used, options_digest)


def table_whitening(
    table: SignatureTable, options: RetrievalOptions, whitening: Whitening | None = None
) -> Whitening:
    """The whitening of a table of signatures.

    Parameters
    ----------
    table : SignatureTable
        The signatures.
    options : RetrievalOptions
        The kind of whitening to fit on `table`, and its damping.
    whitening : Whitening, optional
        A whitening made before, which is returned instead.

    Returns
    -------
    Whitening
        A whitening with the digest of `table`.

    Raises
    ------
    InputError
        If the whitening made before was fitted on signatures with other options, or `table` has too few
        shapes for a fit.
    OptionError
        If the kind is ``resolution``, which is not fitted.
    """
    if whitening is None:
        logs = table_coordinates(table, options.distance)
        return fit_whitening(
            options.whitening, logs, table.labels, damping=options.damping, options_digest=table.digest
        )
    whitening.check_made_for(table.digest)
    return whitening


def _pca(
    logs: FloatArray, labels: Sequence[str | None] | None, damping: float
) -> tuple[FloatArray, FloatArray]:
    """All shapes (N, L), and their regularised covariance (L, L)."""
    _check_distinct("pca", logs)
    covariance = _covariance(logs)
    largest = np.linalg.eigvalsh(covariance)[-1]
    return logs, covariance + damping * largest * np.eye(len(covariance))


def _within_class(
    logs: FloatArray, labels: Sequence[str | None] | None, damping: float
) -> tuple[FloatArray, FloatArray]:
    """The shapes in classes of at least two shapes, and their shrunk pooled covariance (L, L)."""
    if labels is None or len(labels) != len(logs):
        given = "none" if labels is None else str(len(labels))
        raise InputError(f"within-class whitening needs one label per shape ({len(logs)}), got {given}")
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(labels):
        if label is not None:
            rows.setdefault(label, []).append(row)
    classes = [logs[rows[label]] for label in sorted(rows) if len(rows[label]) > 1]
    if not classes:
        raise InputError(
            f"within-class whitening needs a class with at least 2 shapes, got {len(rows)} classes and none "
            "so large; label more shapes, or use the whitening 'pca' or 'none'"
        )
    fitted = np.concatenate(classes)
    _check_distinct("within-class", fitted)
    residuals = np.concatenate([members - members.mean(axis=0) for members in classes])
    pooled = residuals.T @ residuals / (len(fitted) - len(classes))
    mean_variance = np.trace(pooled) / len(pooled)
    if mean_variance == 0:
        raise InputError(
            "within-class whitening needs shapes that differ within their class, got equal signatures in "
            "every class; use the whitening 'pca' or 'none'"
        )
    return fitted, (1 - damping) * pooled + damping * mean_variance * np.eye(len(pooled))


_FITS: Mapping[
    str, Callable[[FloatArray, Sequence[str | None] | None, float], tuple[FloatArray, FloatArray]]
] = MappingProxyType({"pca": _pca, "within-class": _within_class})


def _covariance(logs: FloatArray) -> FloatArray:
    centred = logs - logs.mean(axis=0)
    covariance: FloatArray = centred.T @ centred / (len(logs) - 1)
    return covariance


def checked_damping(kind: str, damping: Damping) -> float:
    """The damping of a whitening, or its default, after a check of its range.

    Parameters
    ----------
    kind : str
        A key of `DEFAULT_DAMPING`.
    damping : float or "auto"
        auto: the default of the kind.

    Returns
    -------
    float
        In (0, 1].

    Raises
    ------
    OptionError
        If the damping is not in (0, 1].
    """
    value = DEFAULT_DAMPING[kind] if damping == "auto" else float(damping)
    if not 0 < value <= 1:
        raise OptionError(f"damping must lie in (0, 1], got {value}")
    return value


def inverse_square_root(covariance: FloatArray) -> FloatArray:
    """The symmetric inverse square root C^(−1/2) of a covariance.

    Parameters
    ----------
    covariance : (L, L) float64
        C, symmetric positive definite.

    Returns
    -------
    (L, L) float64
        Symmetric positive definite.
    """
    variances, directions = np.linalg.eigh(covariance)
    root: FloatArray = (directions / np.sqrt(variances)) @ directions.T
    return root


def _check_distinct(kind: str, logs: FloatArray) -> None:
    if (logs == logs[:1]).all():
        raise InputError(
            f"{kind} whitening needs at least 2 distinct shapes, got {len(logs)} shapes and no two distinct; "
            "add shapes, or use the whitening 'none'"
        )
