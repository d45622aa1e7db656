"""scikit-learn estimators: scans → signatures → whitened signatures → neighbours.

Results and errors are those of the functions of pcretrieve. Signatures are arrays (n, L) of their logarithms,
or of other coordinates of whose differences distances are functions, as `SignatureTransformer` gives them. A
fitted whitening has the attribute ``whitening_``, with the mean and the matrix of the map. Only this module
imports scikit-learn at once, and is itself imported on request only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import (
    BaseEstimator,
    ClassNamePrefixFeaturesOutMixin,
    OneToOneFeatureMixin,
    TransformerMixin,
)
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, column_or_1d, validate_data
from typing_extensions import Self

from pcretrieve import InputError, OptionError, PipelineOptions
from pcretrieve.descriptors import signature_length
from pcretrieve.formats import ScanLike
from pcretrieve.options import OptionsLike, Shrinkage, SignatureOptions
from pcretrieve.pipeline.process import remembered, signature_of
from pcretrieve.retrieval import (
    Positions,
    Whitening,
    coordinates,
    fit_whitening,
    pairwise,
    people,
)
from pcretrieve.retrieval.distances import BLOCK_DISTANCES, known_distance

Found: TypeAlias = "tuple[NDArray[np.float64], Positions] | Positions"


class _Whitener(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """A whitening by `fit_whitening`. The matrix is symmetric: no value changes its meaning."""

    _kind: ClassVar[str]
    _least_samples: ClassVar[int] = 2
    whitening_: Whitening

    def __init__(self, shrinkage: Shrinkage = "auto") -> None:
        self.shrinkage = shrinkage

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Fit the whitening to signatures X."""
        logs = validate_data(
            self, X, dtype=np.float64, ensure_min_samples=self._least_samples
        )
        self.whitening_ = fit_whitening(self._kind, logs, **self.get_params())
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Whitened signatures (n, L) float64: `Whitening.apply` of the rows of X."""
        check_is_fitted(self)
        return self.whitening_.apply(
            validate_data(self, X, dtype=np.float64, reset=False)
        )


class NeighbourWhitening(_Whitener):
    """Whitening by what near signatures differ by; ``neighbours`` of `RetrievalOptions.whitening`.

    No classes are needed. Nothing is learned from fewer than 24 signatures, or fewer than 10 pairs of mutual
    neighbours: the signatures stay as they are, and ``whitening_.reason`` says so.

    Parameters
    ----------
    shrinkage : float or "auto", default "auto"
        Shrinkage in (0, 1] of the covariance towards its mean variance times the identity. auto: .2.
    """

    _kind = "neighbours"
    _least_samples = 1


class PCAWhitening(_Whitener):
    """Whitening by the covariance of all signatures; ``pca`` of `RetrievalOptions.whitening`.

    It is likely to make rankings worse for bodies of one kind.

    Parameters
    ----------
    shrinkage : float or "auto", default "auto"
        Regularisation in (0, 1], times the largest eigenvalue of the covariance. auto: .01.
    """

    _kind = "pca"


class WithinClassWhitening(_Whitener):
    """Whitening by the covariance within classes; ``within-class`` of `RetrievalOptions.whitening`.

    Parameters
    ----------
    shrinkage : float or "auto", default "auto"
        Shrinkage in (0, 1] of the covariance towards its mean variance times the identity. auto: the
        intensity between .0003 and .3 at which classes that are left out are most likely.
    """

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:  # type: ignore[override]
        """Fit the whitening to signatures X of classes y, of which one must have two distinct signatures.

        Classes are numbers or strings. None is no class; classes of one signature are ignored.
        """
        logs, classes = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=2)
        labels = [None if label is None else str(label) for label in classes.tolist()]
        # Numbers must be whole, as anywhere in scikit-learn.
        check_classification_targets(
            classes[np.array([label is not None for label in labels], dtype=bool)]
        )
        self.whitening_ = fit_whitening(
            "within-class", logs, labels, shrinkage=self.shrinkage
        )
        return self

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags


class PeopleWhitening(_Whitener):
    """Whitening by the metric that was learned from simulated people; ``people`` of `RetrievalOptions`.

    The signatures must be by area, with 60 modes. The less they are like those of simulated people, the more
    their own neighbours count.

    Parameters
    ----------
    method : {"hapt+r-bihdm", "r-bihdm", "hapt"}, default "hapt+r-bihdm"
        The descriptor of the signatures.
    shrinkage : float or "auto", default "auto"
        As for `NeighbourWhitening`.
    """

    def __init__(
        self, method: str = "hapt+r-bihdm", shrinkage: Shrinkage = "auto"
    ) -> None:
        self.method = method
        self.shrinkage = shrinkage

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Weigh the metric of simulated people against what near signatures X differ by."""
        logs = validate_data(self, X, dtype=np.float64)
        n_others = signature_length(SignatureOptions(method=self.method, n_values=1)) - 1
        options = SignatureOptions(
            method=self.method, n_values=max(1, logs.shape[1] - n_others)
        )
        known = people(options)
        if known is None or len(known.mean) != logs.shape[1]:
            raise InputError(
                f"X must be signatures by area of {self.method}, with at most 59 values of r-bihdm"
            )
        self.whitening_ = fit_whitening(
            "people", logs, shrinkage=self.shrinkage, people=known
        )
        return self


class SignatureNeighbors(BaseEstimator):  # type: ignore[misc]
    """The nearest of the fitted signatures, by any distance in `pcretrieve.retrieval.DISTANCES`.

    A query is compared with every fitted signature. The neighbours are those of `SignatureIndex`; equally
    near signatures are in the order of the fitted rows.

    Parameters
    ----------
    n_neighbors : int, default 5
        Number of neighbours that `kneighbors` returns.
    distance : str, default "log"
        The distance.
    """

    def __init__(self, n_neighbors: int = 5, distance: str = "log") -> None:
        self.n_neighbors = n_neighbors
        self.distance = distance

    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> Self:
        """Store the signatures X that are searched, and for `score` their classes y."""
        self._fit_X = validate_data(self, X, dtype=np.float64)
        known_distance(self.distance)
        self._classes = None if y is None else column_or_1d(y)
        if self._classes is not None and len(self._classes) != len(self._fit_X):
            raise InputError(
                f"y must have {len(self._fit_X)} classes, one a row, got {len(self._classes)}"
            )
        self.n_samples_fit_ = len(self._fit_X)
        return self

    def kneighbors(
        self,
        X: ArrayLike | None = None,
        n_neighbors: int | None = None,
        return_distance: bool = True,
    ) -> Found:
        """The distances (Q, k) to the nearest of the fitted signatures, ascending, and their rows (Q, k).

        X: (Q, L), the queries; by default the fitted signatures, each of which is then not its own neighbour.
        return_distance: False for the rows alone.
        """
        k = self.n_neighbors if n_neighbors is None else n_neighbors
        check_is_fitted(self)
        most = self.n_samples_fit_ - (X is None)
        if (
            isinstance(k, bool)
            or not isinstance(k, (int, np.integer))
            or not 1 <= k <= most
        ):
            raise OptionError(
                f"Expected n_neighbors to be a whole number from 1 to {most}, got {k!r}"
            )
        rows = [(own[:k], order[:k]) for own, order in self._sorted(X)]
        distances = np.array([own for own, _ in rows]).reshape(-1, k)
        indices = np.array([order for _, order in rows], dtype=np.intp).reshape(-1, k)
        return (distances, indices) if return_distance else indices

    def score(self, X: ArrayLike, y: ArrayLike) -> float:
        """Mean average precision of retrieving the fitted signatures of the classes y of queries X.

        Queries whose class was not fitted are left out. Signatures that were whitened by the classes of the
        queries have too high a score; `pcretrieve.evaluate` fits such a whitening on other classes.
        """
        check_is_fitted(self)
        if self._classes is None:
            raise InputError(
                "a score needs the classes of the fitted signatures: give y to fit"
            )
        total, n_queries = 0.0, 0
        for label, (_, order) in zip(column_or_1d(y), self._sorted(X), strict=True):
            ranks = np.flatnonzero(self._classes[order] == label) + 1
            if len(ranks):
                # Summed one after the other, as by `pcretrieve.evaluate`.
                total += np.cumsum(np.arange(1, len(ranks) + 1) / ranks)[-1] / len(ranks)
                n_queries += 1
        if not n_queries:
            raise InputError("a score needs queries of fitted classes, got none")
        return float(total / n_queries)

    def _sorted(
        self, X: ArrayLike | None
    ) -> Iterator[tuple[NDArray[np.float64], Positions]]:
        """For each query the distances, ascending, and the rows of the fitted signatures."""
        queries = (
            self._fit_X
            if X is None
            else validate_data(self, X, dtype=np.float64, reset=False)
        )
        rows = max(1, BLOCK_DISTANCES // self.n_samples_fit_)
        for start in range(0, len(queries), rows):
            distances = pairwise(
                self.distance, queries[start : start + rows], self._fit_X
            )  # (rows, N)
            # A stable sort: equal distances in the order of the rows.
            orders = np.argsort(distances, axis=1, kind="stable")
            for number, (order, own) in enumerate(
                zip(orders, distances, strict=True), start
            ):
                kept = order[order != number] if X is None else order
                yield own[kept], kept


class SignatureTransformer(
    ClassNamePrefixFeaturesOutMixin,  # type: ignore[misc]
    TransformerMixin,  # type: ignore[misc]
    BaseEstimator,  # type: ignore[misc]
):
    """Scans → the logarithms of their signatures, one row a scan.

    Of descriptors that are not compared by logarithms, the rows are the values themselves, or the square
    roots of histograms. Nothing is learned from the scans. The input is a sequence of scans and no array of
    numbers, which the tags of the estimator say.

    Parameters
    ----------
    options : OptionsLike, optional
        Options of all stages, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.
    method : str, optional
        The descriptor; by default that of `options`.
    n_values : int, optional
        The number of values; by default that of `options`.
    scale : {"area", "relative", "absolute"}, optional
        The normalisation; by default that of `options`.

    Examples
    --------
    >>> from sklearn.pipeline import make_pipeline
    >>> from pcretrieve.estimators import PCAWhitening, SignatureNeighbors
    >>> search = make_pipeline(SignatureTransformer(scale="relative"), PCAWhitening(), SignatureNeighbors())
    """

    def __init__(
        self,
        options: OptionsLike = None,
        *,
        method: str | None = None,
        n_values: int | None = None,
        scale: str | None = None,
    ) -> None:
        self.options = options
        self.method = method
        self.n_values = n_values
        self.scale = scale

    def fit(self, X: Iterable[ScanLike], y: object = None) -> Self:
        """Check the parameters."""
        self._chosen()
        return self

    def transform(self, X: Iterable[ScanLike]) -> NDArray[np.float64]:
        """The log-signatures (n, L) float64 of n files, arrays, or values of geometry.

        Dimensionless, except for the scale ``absolute``. The surfaces of 200 scans are remembered by their
        content, so that a grid search makes each once.
        """
        if isinstance(X, (str, Path)):
            raise InputError(
                f"X must be a sequence of scans, got the path {X}: put it into a list"
            )
        options = self._chosen()
        made = [signature_of(remembered(scan, options), options, scan) for scan in X]
        rows = [coordinates(one.values, one.metric) for one in made]
        return np.array(rows).reshape(-1, self._n_features_out)

    @property
    def _n_features_out(self) -> int:
        """L, for the names of the features."""
        return signature_length(self._chosen().signature)

    def _chosen(self) -> PipelineOptions:
        """The options, with the parameters that were given in their place."""
        given = {"method": self.method, "n_values": self.n_values, "scale": self.scale}
        chosen = {name: value for name, value in given.items() if value is not None}
        return PipelineOptions.of(self.options).changed(signature=chosen)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.no_validation = True
        tags.requires_fit = False
        return tags
