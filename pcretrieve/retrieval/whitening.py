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

``people`` is the metric of `pcretrieve.retrieval.people`, which hardly depends on a gallery of people. It is
followed by a normalisation of length [3]_, because scans of unusual people differ more from one another: see
`People.unusual`.

References
----------
.. [1] Kessy, Lewin and Strimmer, "Optimal whitening and decorrelation", The American Statistician 2018.
.. [2] Bar-Hillel, Hertz, Shental and Weinshall, "Learning a Mahalanobis metric from equivalence
   constraints", Journal of Machine Learning Research 2005.
.. [3] Garcia-Romero and Espy-Wilson, "Analysis of i-vector length normalization in speaker recognition
   systems", Interspeech 2011.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from pcretrieve.errors import InputError, OptionError, did_you_mean
from pcretrieve.options import RetrievalOptions, Shrinkage, WhiteningKind
from pcretrieve.retrieval import covariances
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.retrieval.people import ALIKE, KNOWN, LEAST_SHARE, People
from pcretrieve.values import FloatArray, SignatureTable
from pcretrieve.values.base import Value
from pcretrieve.values.files import member_array, opened_archive, write_file

#: What stands for a whitening that suits the shapes, with and without their labels.
AUTOMATIC = ("auto", "unsupervised")

#: What a whitening can be.
WHITENINGS: tuple[str, ...] = tuple(
    kind for kind in get_args(WhiteningKind) if kind not in AUTOMATIC
)

#: The kind of a whitening that was fitted to labelled shapes other than those that it is used for.
CALIBRATED = "calibrated"

# Least number of classes from which labels are used by "auto".
LEAST_CLASSES = 5

# What is added to how unusual a person is (`Whitening.unusual`), since scans of the most usual people differ
# too; and the largest value that counts, which shapes exceed that are no people. See docs/decisions.md,
# length.
USUAL, MOST_UNUSUAL = 0.35, 3.0


class Arrays(Value):
    """A value that is stored as arrays by name, none of which needs pickle."""

    __slots__ = ()

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The fields as arrays by name."""
        own = fields(self)  # type: ignore[arg-type]
        return {field.name: np.asarray(getattr(self, field.name)) for field in own}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """The inverse of `to_arrays`; KeyError if an array is missing."""
        found = {field.name: arrays[field.name] for field in fields(cls)}  # type: ignore[arg-type]
        return cls(
            **{
                name: array if array.ndim else array.item()
                for name, array in found.items()
            }
        )


@dataclass(frozen=True, slots=True, eq=False)
class Whitening(Arrays):
    """The map x → y / √l(y), y = W (x − mean), of log-signatures; l = 1 but for people.

    Attributes
    ----------
    kind : str
        One of `WHITENINGS`, or ``calibrated``.
    mean : (L,) float64
        Mean log-signature of the shapes of the fit; zero for ``none``.
    matrix : (L, L) float64
        W, symmetric positive semidefinite, dimensionless; the identity for ``none``.
    n_fitted : int
        Number of shapes of the fit; 0 for ``people`` alone.
    shrinkage : float
        Regularisation as in `fit_whitening`; zero for ``none``.
    options_digest : str
        Digest of the signatures of the fit, to which alone the whitening may be applied.
    reason : str
        What was used and why, in one line.
    unusual : (L, L) float64 or empty
        Of people, Q: yᵀ Q y is how unusual a person is, 1 on average, and l the ratio of what scans of such a
        person differ by to what it is on average, (min(yᵀ Q y, `MOST_UNUSUAL`) + `USUAL`) / (1 + `USUAL`).
    """

    kind: str
    mean: FloatArray
    matrix: FloatArray
    n_fitted: int
    shrinkage: float = 0.0
    options_digest: str = ""
    reason: str = ""
    unusual: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        if self.kind not in (*WHITENINGS, CALIBRATED):
            raise OptionError(
                f"whitening must be one of {', '.join(WHITENINGS)}, got {self.kind!r}"
            )
        length = len(self._lock("mean", (None,)))
        self._lock("matrix", (length, length))
        self._lock("unusual", (length, length) if np.size(self.unusual) else (0, 0))

    def check_made_for(self, digest: str) -> None:
        """InputError if the whitening was fitted on signatures of another digest."""
        if self.options_digest != digest:
            raise InputError(
                f"the whitening must be fitted on signatures made by the same options as the table "
                f"({digest!r}), got {self.options_digest!r}; fit it again"
            )

    def apply(self, logs: FloatArray) -> FloatArray:
        """The whitened coordinates of rows of log-signatures (N, L); for ``none`` the input array itself."""
        if logs.ndim != 2 or logs.shape[1] != len(self.mean):
            raise InputError(
                f"log-signatures must have shape (N, {len(self.mean)}), as this whitening was fitted, "
                f"got {logs.shape}"
            )
        if self.kind == "none":
            return logs
        whitened = _row_by_row(logs - self.mean, self.matrix.T)
        if not self.unusual.size:
            return whitened
        unusual = (_row_by_row(whitened, self.unusual) * whitened).sum(axis=1)
        lengths = (np.minimum(unusual, MOST_UNUSUAL) + USUAL) / (1 + USUAL)
        return np.asarray(whitened / np.sqrt(lengths)[:, np.newaxis])


def _row_by_row(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """The product (N, L) of rows and a matrix, in which the rounding of a row does not depend on others."""
    return np.asarray((rows[:, np.newaxis] @ matrix)[:, 0])


def write_whitening(whitening: Whitening, path: Path) -> None:
    """Write a whitening that was fitted to labelled shapes, for shapes of other catalogues."""
    packed = io.BytesIO()
    np.savez(
        packed, allow_pickle=False, **replace(whitening, kind=CALIBRATED).to_arrays()
    )
    write_file(path, packed.getvalue())


def read_whitening(path: Path) -> Whitening:
    """Read a whitening of `write_whitening`."""
    try:
        # `write_whitening` does not compress.
        with opened_archive(path, ratio=1) as archive:
            arrays = {
                member.filename.removesuffix(".npy"): member_array(archive, member)
                for member in archive.infolist()
            }
        whitening = Whitening.from_arrays(arrays)
        return replace(whitening, reason=f"{whitening.reason}, from {path}")
    # `zipfile` and NumPy raise exceptions of many kinds for damage.
    except Exception as error:
        raise InputError(
            f"a whitening must be a name such as auto, or a file of `pcretrieve lab calibrate`, got {path} "
            f"({error}){did_you_mean(str(path), get_args(WhiteningKind))}"
        ) from error


def fit_whitening(
    kind: str,
    logs: FloatArray,
    labels: Sequence[str | None] | None = None,
    *,
    shrinkage: Shrinkage = "auto",
    people: People | None = None,
    one_unit: bool = True,
    options_digest: str = "",
) -> Whitening:
    """Fit a whitening to log-signatures.

    logs: (N, L) float64, log-signatures, one in each row.
    people: the moments of such signatures of people, if known; ``auto`` stands for ``people`` if the shapes
        are alike. Neighbours are found by `People.compared`, else by all coordinates.
    one_unit: as `SignatureTable.has_one_unit`; for ``within-class`` only.
    """
    if kind not in (*WHITENINGS, *AUTOMATIC):
        raise OptionError(
            f"whitening must be one of auto, {', '.join(WHITENINGS)}, got {kind!r}"
        )
    if logs.ndim != 2 or not np.isfinite(logs).all():
        raise InputError(
            f"log-signatures must be finite and have shape (N, L), got {logs.shape}"
        )
    covariances.checked_shrinkage(kind, shrinkage)
    used, unlike = kind, np.inf
    compared = None if people is None else people.compared
    if people is not None and len(logs) and kind in (*AUTOMATIC, "people"):
        unlike = people.unlikeness(logs)
    if kind in AUTOMATIC:
        used = _chosen(logs, labels if kind == "auto" else None, unlike)
    if used == "people":
        if people is None:
            raise OptionError(
                "whitening 'people' is known for hapt, r-bihdm and their fusion, by area and with n_modes = "
                "60: take one of these descriptors, or another whitening"
            )
        own = covariances.Fit(logs, None, 0.0, "none")
        if unlike > 1 and not (kind == "auto" and _are_of_one_scan_each(labels)):
            own = covariances.neighbour_covariance(logs, shrinkage, compared)
        return replace(
            _of_people(own, people, 1 - 1 / max(unlike, 1.0)),
            options_digest=options_digest,
        )
    fit = covariances.Fit(logs, None, 0.0, "none")
    if used == "pca":
        fit = _pca(logs, shrinkage)
    elif used == "within-class":
        fit = covariances.within_class_covariance(
            logs, labels, shrinkage, one_unit=one_unit
        )
    elif used == "neighbours":
        fit = covariances.neighbour_covariance(logs, shrinkage, compared)
    if fit.covariance is None:
        zero, identity = np.zeros(logs.shape[1]), np.eye(logs.shape[1])
        return Whitening(
            "none", zero, identity, len(logs), 0.0, options_digest, fit.reason
        )
    total = covariances.covariance_of(fit.shapes)
    variances, directions = np.linalg.eigh(fit.covariance)
    root = (directions / np.sqrt(variances)) @ directions.T  # C^(−1/2)
    scale = np.sqrt(np.trace(total) / np.trace(root @ total @ root))
    mean = fit.shapes.mean(axis=0)
    return Whitening(
        used,
        mean,
        scale * root,
        len(fit.shapes),
        fit.shrinkage,
        options_digest,
        fit.reason,
    )


def table_whitening(
    table: SignatureTable, options: RetrievalOptions, *, people: People | None = None
) -> Whitening:
    """The whitening of a table of signatures; `people` as in `fit_whitening`."""
    return fit_whitening(
        options.whitening,
        table_coordinates(table, options.distance),
        table.labels,
        shrinkage=options.shrinkage,
        people=people,
        one_unit=table.has_one_unit,
        options_digest=table.digest,
    )


def calibrated_whitening(
    table: SignatureTable, options: RetrievalOptions, people: People | None
) -> Whitening:
    """The whitening by the classes of a table, with the metric of people if the shapes are like people."""
    logs = table_coordinates(table, options.distance)
    if people is None or not len(logs) or (unlike := people.unlikeness(logs)) > ALIKE:
        return table_whitening(
            table, options.model_copy(update={"whitening": "within-class"})
        )
    own = covariances.within_class_covariance(
        logs, table.labels, options.shrinkage, one_unit=True
    )
    found = _of_people(own, people, max(LEAST_SHARE, 1 - 1 / max(unlike, 1.0)))
    return replace(found, options_digest=table.digest)


def _chosen(logs: FloatArray, labels: Sequence[str | None] | None, unlike: float) -> str:
    """The whitening that ``auto`` stands for; `unlike` as by `People.unlikeness`, infinite if not known."""
    if unlike <= KNOWN:
        return "people"
    counts = Counter(label for label in labels or () if label is not None)
    sizes = [size for size in counts.values() if size > 1]
    # The rank of the pooled covariance, beyond which directions would be whitened by the shrinkage alone.
    rank = sum(sizes) - len(sizes)
    if len(sizes) >= LEAST_CLASSES and rank >= logs.shape[1]:
        return "within-class"
    return "people" if unlike <= ALIKE else "neighbours"


def _are_of_one_scan_each(labels: Sequence[str | None] | None) -> bool:
    """Whether all shapes have classes, each another one: then no neighbours are of one class."""
    known = {*(labels or ())} - {None}
    return labels is not None and len(known) == len(labels) > 0


def _of_people(own: covariances.Fit, people: People, share: float) -> Whitening:
    """The symmetric root of the metric of people, by which the total variance of people does not change.

    own: what the shapes themselves teach; share: how much it counts, if they teach something.
    """
    if own.covariance is None:
        share = 0.0
    else:
        people = people.adapted(own.covariance, share)
    weights, directions = np.linalg.eigh(people.metric)
    root = (directions * np.sqrt(np.maximum(weights, 0))) @ directions.T
    scale = np.sqrt(np.trace(people.total) / np.trace(root @ people.total @ root))
    unusual = people.unusual(root) / scale**2
    reason = f"people: {1 - share:.0%} learned from simulated people"
    reason += f", {share:.0%} from {own.reason}" if share else ""
    n_own = len(own.shapes) if share else 0
    return Whitening(
        "people", people.mean, scale * root, n_own, own.shrinkage, "", reason, unusual
    )


def _pca(logs: FloatArray, shrinkage: Shrinkage) -> covariances.Fit:
    """All shapes, and their regularised covariance."""
    covariances.check_distinct("pca", logs)
    used = covariances.checked_shrinkage("pca", shrinkage)
    total = covariances.covariance_of(logs)
    covariance = total + used * np.linalg.eigvalsh(total)[-1] * np.eye(len(total))
    return covariances.Fit(
        logs, covariance, used, f"pca: the covariance of {len(logs)} shapes"
    )
