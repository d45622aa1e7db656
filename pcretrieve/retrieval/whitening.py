"""Whitening: an affine map of log-signatures after which all directions have the same variance.

The matrix is the symmetric inverse square root W = s C^(−1/2) of a covariance C (ZCA whitening). Of all
whitening matrices it changes the coordinates least in the mean square [1]_. This matters for D₁ and D₂, which
depend on the coordinate axes: they compare values that are close to the original ones. It is also independent
of the sign and the order of the eigenvectors of C. The factor s preserves the total variance of the shapes of
the fit. D₁ and D₂ are not homogeneous, so that without s they would be evaluated far from the magnitudes for
which they were designed, and distances with different whitenings would not be comparable.

C describes what should be ignored: the differences within classes (``within-class``), the differences of
pairs that are probably of one class (``neighbours``), or, as a first approximation, all differences
(``pca``). Whitening by the differences of nearest neighbours is unsupervised, in the manner of relevant
component analysis [2]_ with the pairs in place of its equivalence constraints.

``resolution`` is the same for every gallery. Whether fingers are separated and folds are open in a surface
depends more on the edge of the voxels than on the body. Its effect on log-signatures was measured once, on
simulated people, animals and hands, which were scanned, and reconstructed with two voxel edges. The whitening
reduces the weight of the directions in which the two log-signatures of a body differ (within-class covariance
normalisation [3]_ with one class of two members for each body). It improves the rankings of scans, but not of
bodies that differ mainly in the girth of their limbs, because the voxel edge changes this girth too. See
docs/decisions.md, resolution_whitening.

References
----------
.. [1] Kessy, Lewin and Strimmer, "Optimal whitening and decorrelation", The American Statistician 2018.
.. [2] Bar-Hillel, Hertz, Shental and Weinshall, "Learning a Mahalanobis metric from equivalence
   constraints", Journal of Machine Learning Research 2005.
.. [3] Hatch, Kajarekar and Stolcke, "Within-class covariance normalization for SVM-based speaker
   recognition", Interspeech 2006.
"""

from __future__ import annotations

import io
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import RetrievalOptions, Shrinkage, SignatureOptions, WhiteningKind
from pcretrieve.retrieval.covariances import (
    Fit,
    check_distinct,
    checked_shrinkage,
    covariance_of,
    inverse_square_root,
    neighbour_covariance,
    within_class_covariance,
)
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.values import FloatArray, Metric, SignatureTable
from pcretrieve.values.base import Value, locked
from pcretrieve.values.files import write_file

#: What a whitening can be; "auto" stands for one of them.
WHITENINGS: tuple[str, ...] = tuple(kind for kind in get_args(WhiteningKind) if kind != "auto")

#: The kind of a whitening that was fitted to labelled shapes other than those that it is used for.
CALIBRATED = "calibrated"

# Least number of classes from which labels are used by "auto".
LEAST_CLASSES = 5

# (2, n, m + 1) float32, written by scripts/sample resolution: logarithms of |μ_1| … |μ_m| and μ_0, divided by
# the squared area, of n bodies reconstructed with the smaller and with the larger voxel edge.
SAMPLE = "resolution.npy"

# Fraction of the bodies, those with the smallest change, of which the covariance is computed (trimming). In
# the others limbs fused, or a tail was lost, at one of the voxel edges, and these few outliers would dominate
# the covariance.
MOST = 0.85

# The signatures for which the changes caused by resolution were measured.
METHOD = "r-bihdm"
N_MODES = 60


class Arrays(Value):
    """A value that is stored as arrays by name, none of which needs pickle."""

    __slots__ = ()

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The fields as arrays by name."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """The inverse of `to_arrays`; KeyError if an array is missing."""
        found = {field.name: arrays[field.name] for field in fields(cls)}  # type: ignore[arg-type]
        return cls(**{name: array if array.ndim else array.item() for name, array in found.items()})


@dataclass(frozen=True, slots=True, eq=False)
class Whitening(Arrays):
    """The map x → W (x − mean) of log-signatures.

    Attributes
    ----------
    kind : str
        One of `WHITENINGS`, or ``calibrated``.
    mean : (L,) float64
        Mean log-signature of the shapes of the fit; zero for ``none``.
    matrix : (L, L) float64
        W, symmetric positive definite, dimensionless; the identity for ``none``.
    n_fitted : int
        Number of shapes of the fit.
    shrinkage : float
        Regularisation as in `fit_whitening`; zero for ``none``.
    options_digest : str
        Digest of the signatures of the fit, to which alone the whitening may be applied.
    reason : str
        What was used and why, in one line.
    """

    kind: str
    mean: FloatArray
    matrix: FloatArray
    n_fitted: int
    shrinkage: float = 0.0
    options_digest: str = ""
    reason: str = ""

    def __post_init__(self) -> None:
        if self.kind not in (*WHITENINGS, CALIBRATED):
            raise OptionError(f"whitening must be one of {', '.join(WHITENINGS)}, got {self.kind!r}")
        mean = locked("the mean of a whitening", self.mean, (None,))
        matrix = locked("the matrix of a whitening", self.matrix, (len(mean), len(mean)))
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "matrix", matrix)

    def check_made_for(self, digest: str) -> None:
        """InputError if the whitening was fitted on signatures of another digest."""
        if self.options_digest != digest:
            raise InputError(
                f"the whitening must be fitted on signatures made by the same options as the table "
                f"({digest!r}), got {self.options_digest!r}; fit it again"
            )

    def apply(self, logs: FloatArray) -> FloatArray:
        """W (x − mean) for each row x of log-signatures (N, L); for ``none`` the input array itself."""
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


def write_whitening(whitening: Whitening, path: Path) -> None:
    """Write a whitening that was fitted to labelled shapes, for shapes of other catalogues."""
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **replace(whitening, kind=CALIBRATED).to_arrays())
    write_file(path, packed.getvalue())


def read_whitening(path: Path) -> Whitening:
    """Read a whitening of `write_whitening`."""
    try:
        # NumPy leaves a file open that is no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            whitening = Whitening.from_arrays(arrays)
            return replace(whitening, reason=f"{whitening.reason}, from {path}")
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError, TypeError, KeyError) as error:
        raise InputError(
            f"a whitening must be a name such as auto, or a file of `pcretrieve calibrate`, got {path} "
            f"({error})"
        ) from error


def fit_whitening(
    kind: str,
    logs: FloatArray,
    labels: Sequence[str | None] | None = None,
    *,
    shrinkage: Shrinkage = "auto",
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
    checked_shrinkage(kind, shrinkage)
    used = _chosen(logs, labels) if kind == "auto" else kind
    fit = Fit(logs, None, 0.0, "none")
    if used == "pca":
        fit = _pca(logs, shrinkage)
    elif used == "within-class":
        fit = within_class_covariance(logs, labels, shrinkage, one_unit=metric != "values")
    elif used == "neighbours":
        fit = neighbour_covariance(logs, shrinkage, prior)
    if fit.covariance is None:
        n_values = logs.shape[1]
        zero, identity = np.zeros(n_values), np.eye(n_values)
        return Whitening("none", zero, identity, len(logs), 0.0, options_digest, fit.reason)
    total = covariance_of(fit.shapes)
    root = inverse_square_root(fit.covariance)
    scale = np.sqrt(np.trace(total) / np.trace(root @ total @ root))
    mean = fit.shapes.mean(axis=0)
    return Whitening(used, mean, scale * root, len(fit.shapes), fit.shrinkage, options_digest, fit.reason)


def table_whitening(
    table: SignatureTable, options: RetrievalOptions, *, prior: FloatArray | None = None
) -> Whitening:
    """The whitening of a table of signatures.

    prior: (L, L) float64, optional, as in `fit_whitening`.
    """
    return fit_whitening(
        options.whitening,
        table_coordinates(table, options.distance),
        table.labels,
        shrinkage=options.shrinkage,
        prior=prior,
        metric=table.metric,
        options_digest=table.digest,
    )


def _chosen(logs: FloatArray, labels: Sequence[str | None] | None) -> str:
    """The whitening that ``auto`` stands for."""
    counts = Counter(label for label in labels or () if label is not None)
    sizes = [size for size in counts.values() if size > 1]
    # The rank of the pooled covariance, beyond which directions would be whitened by the shrinkage alone.
    rank = sum(sizes) - len(sizes)
    return "within-class" if len(sizes) >= LEAST_CLASSES and rank >= logs.shape[1] else "neighbours"


def _pca(logs: FloatArray, shrinkage: Shrinkage) -> Fit:
    """All shapes, and their regularised covariance."""
    check_distinct("pca", logs)
    used = checked_shrinkage("pca", shrinkage)
    total = covariance_of(logs)
    covariance = total + used * np.linalg.eigvalsh(total)[-1] * np.eye(len(total))
    return Fit(logs, covariance, used, f"pca: the covariance of {len(logs)} shapes")


def resolution_whitening(
    options: SignatureOptions, *, shrinkage: Shrinkage = "auto", options_digest: str = ""
) -> Whitening:
    """W = s (C + d c I)^(−1/2): C second moment of the changes, c its largest eigenvalue, d the shrinkage."""
    used = checked_shrinkage("resolution", shrinkage)
    if (known := _changes(options)) is None:
        raise OptionError(
            f"whitening 'resolution' has been measured for {METHOD} with n_modes = {N_MODES}, by area or "
            f"relative, got {options.method} with {options.n_modes}, {options.measured_by}: take 'pca' or "
            "'none'"
        )
    mean, change = known
    covariance = change.T @ change / len(change)
    largest = np.linalg.eigvalsh(covariance)[-1]
    root = inverse_square_root(covariance + used * largest * np.eye(len(covariance)))
    root *= np.sqrt(len(root) / np.trace(root @ root))
    if options.size_weight:
        root, mean = np.pad(root, (0, 1)), np.append(mean, 0.0)
        root[-1, -1] = 1
    reason = f"resolution: changes of {len(change)} simulated bodies"
    return Whitening("resolution", mean, root, len(change), used, options_digest, reason)


def resolution_covariance(options: SignatureOptions) -> FloatArray | None:
    """The covariance (L, L) of the changes, of trace 1, zero for a size; None if it was not measured."""
    if (known := _changes(options)) is None:
        return None
    covariance = known[1].T @ known[1]
    covariance /= np.trace(covariance)
    return np.pad(covariance, (0, 1)) if options.size_weight else covariance


def _changes(options: SignatureOptions) -> tuple[FloatArray, FloatArray] | None:
    """The mean log-signature (L,), and the changes (n, L) of the bodies of the sample that change least.

    None if the changes of such signatures were not measured.
    """
    if options.method != METHOD or options.n_modes != N_MODES or options.measured_by == "absolute":
        return None
    sample = np.load(str(resources.files(__package__).joinpath(SAMPLE))).astype(np.float64)
    if options.measured_by == "relative":
        sample -= sample[:, :, -1:]
    logs = sample[:, :, : options.n_values]
    change = logs[0] - logs[1]  # (n, L)
    size = np.linalg.norm(change, axis=1)
    return logs.mean(axis=(0, 1)), change[size <= np.quantile(size, MOST)]
