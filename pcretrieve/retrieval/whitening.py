"""Whitening: an affine map of log-signatures after which all directions have the same variance.

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

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.types import FloatArray

__all__ = [
    "DEFAULT_DAMPING",
    "WHITENINGS",
    "Whitening",
    "checked_damping",
    "fit_whitening",
    "inverse_square_root",
]

WHITENINGS = ("none", "resolution", "pca", "within-class")

#: Regularisation of the covariance, which limits the amplification of noise in directions of small variance.
#: See docs/decisions.md, DEFAULT_DAMPING.
DEFAULT_DAMPING: Mapping[str, float] = MappingProxyType(
    {
        "pca": 0.01,  # Tikhonov: times the largest eigenvalue, added to all eigenvalues
        "resolution": 0.03,  # as for pca
        "within-class": 0.10,  # shrinkage intensity towards the mean variance times the identity
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """The map x → W (x − mean) of log-signatures.

    Attributes
    ----------
    kind : str
        One of `WHITENINGS`.
    mean : (L,) float64
        Mean log-signature of the shapes of the fit; zero for ``none``.
    matrix : (L, L) float64
        W, symmetric positive definite, dimensionless; the identity for ``none``.
    n_fitted : int
        Number of shapes of the fit.
    damping : float
        Regularisation as in `fit_whitening`; zero for ``none``.
    options_digest : str
        Digest of the signatures of the fit, to which alone the whitening may be applied.
    """

    kind: str
    mean: FloatArray
    matrix: FloatArray
    n_fitted: int
    damping: float = 0.0
    options_digest: str = ""

    def __post_init__(self) -> None:
        _check_kind(self.kind)
        mean = np.array(self.mean, dtype=np.float64)
        matrix = np.array(self.matrix, dtype=np.float64)
        if mean.ndim != 1 or matrix.shape != (len(mean), len(mean)):
            raise InputError(
                f"mean and matrix must have shapes (L,) and (L, L), got {mean.shape} and {matrix.shape}"
            )
        if not (np.isfinite(mean).all() and np.isfinite(matrix).all()):
            raise InputError(
                "mean and matrix of a whitening must be finite, got NaN or infinity; fit it again"
            )
        mean.flags.writeable = matrix.flags.writeable = False
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "matrix", matrix)

    @property
    def digest(self) -> str:
        """Hash of the kind, the damping, and the options of the signatures."""
        made_by = json.dumps([self.kind, self.damping, self.options_digest])
        return hashlib.sha256(made_by.encode()).hexdigest()

    def apply(self, logs: FloatArray) -> FloatArray:
        """Whitened log-signatures.

        Parameters
        ----------
        logs : (N, L) float64
            Log-signatures, one in each row.

        Returns
        -------
        (N, L) float64
            W (x − mean) for each row x; the input array itself for ``none``.

        Raises
        ------
        InputError
            If the log-signatures do not have L values.
        """
        if logs.ndim != 2 or logs.shape[1] != len(self.mean):
            raise InputError(
                f"log-signatures must have shape (N, {len(self.mean)}), as this whitening was fitted, "
                f"got {logs.shape}"
            )
        if self.kind == "none":
            return logs
        # einsum instead of a BLAS product, in which the rounding of a row depends on the other rows: equal
        # signatures would no longer be at exactly equal distances.
        whitened: FloatArray = np.einsum("ij,kj->ik", logs - self.mean, self.matrix)
        return whitened

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The attributes as arrays by name, for `numpy.savez` or a database; no array needs pickle."""
        return {
            "kind": np.array(self.kind),
            "mean": self.mean,
            "matrix": self.matrix,
            "n_fitted": np.array(self.n_fitted),
            "damping": np.array(self.damping),
            "options_digest": np.array(self.options_digest),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Whitening:
        """The inverse of `to_arrays`.

        Parameters
        ----------
        arrays : mapping of str to array
            The attributes by name.

        Returns
        -------
        Whitening
            The whitening with these attributes.

        Raises
        ------
        InputError
            If an array is missing or has the wrong shape.
        """
        missing = [name for name in cls.__slots__ if name not in arrays]
        if missing:
            raise InputError(
                f"a stored whitening must hold {', '.join(cls.__slots__)}; missing: {', '.join(missing)}; "
                "fit it again"
            )
        return cls(
            kind=str(arrays["kind"]),
            mean=arrays["mean"],
            matrix=arrays["matrix"],
            n_fitted=int(arrays["n_fitted"]),
            damping=float(arrays["damping"]),
            options_digest=str(arrays["options_digest"]),
        )


def fit_whitening(
    kind: str,
    logs: FloatArray,
    labels: Sequence[str | None] | None = None,
    *,
    damping: float | None = None,
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
    damping : float, optional
        In (0, 1]. By default ``DEFAULT_DAMPING[kind]``; ignored for ``none``.
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
    _check_kind(kind)
    if logs.ndim != 2 or not np.isfinite(logs).all():
        raise InputError(f"log-signatures must be finite and have shape (N, L), got {logs.shape}")
    n_values = logs.shape[1]
    if kind == "none":
        return Whitening(
            kind, np.zeros(n_values), np.eye(n_values), n_fitted=len(logs), options_digest=options_digest
        )
    if kind not in _FITS:
        raise OptionError(f"whitening {kind!r} is not fitted to shapes: see resolution_whitening")
    damping = checked_damping(kind, damping)
    fitted, covariance = _FITS[kind](logs, labels, damping)
    total = _covariance(fitted)
    root = inverse_square_root(covariance)
    scale = np.sqrt(np.trace(total) / np.trace(root @ total @ root))
    return Whitening(kind, fitted.mean(axis=0), scale * root, len(fitted), damping, options_digest)


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


def checked_damping(kind: str, damping: float | None) -> float:
    """The damping of a whitening, or its default, after a check of its range.

    Parameters
    ----------
    kind : str
        A key of `DEFAULT_DAMPING`.
    damping : float or None
        None for the default of the kind.

    Returns
    -------
    float
        In (0, 1].

    Raises
    ------
    OptionError
        If the damping is not in (0, 1].
    """
    damping = DEFAULT_DAMPING[kind] if damping is None else float(damping)
    if not 0 < damping <= 1:
        raise OptionError(f"damping must lie in (0, 1], got {damping}")
    return damping


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


def _check_kind(kind: str) -> None:
    if kind not in WHITENINGS:
        raise OptionError(f"whitening must be one of {', '.join(WHITENINGS)}, got {kind!r}")


def _check_distinct(kind: str, logs: FloatArray) -> None:
    if (logs == logs[:1]).all():
        raise InputError(
            f"{kind} whitening needs at least 2 distinct shapes, got {len(logs)} shapes and no two distinct; "
            "add shapes, or use the whitening 'none'"
        )
