"""Exact nearest neighbours of signatures as a scikit-learn estimator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, column_or_1d, validate_data

from pcretrieve.descriptors import describe, signature_length
from pcretrieve.errors import InputError, OptionError
from pcretrieve.evaluation import Rankings, evaluate_rankings
from pcretrieve.formats import ScanLike
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import BLOCK_DISTANCES, Positions, coordinates, known_distance, pairwise
from pcretrieve.values import FloatArray

Found: TypeAlias = "tuple[FloatArray, Positions] | Positions"


class SignatureNeighbors(BaseEstimator):  # type: ignore[misc]
    """The nearest of the fitted signatures, by any distance in `pcretrieve.retrieval.DISTANCES`.

    A query is compared with every fitted signature. The neighbours are those of `SignatureIndex`; equally
    near signatures are in the order of the fitted rows.

    Parameters
    ----------
    n_neighbors : int, default 5
        Number of neighbours that `kneighbors` returns.
    radius : float, default 1.0
        Distance within which `radius_neighbors` returns neighbours; dimensionless.
    distance : str, default "log"
        The distance.

    Attributes
    ----------
    n_samples_fit_ : int
        N, the number of fitted signatures.
    n_features_in_ : int
        L, the number of values of a signature.
    """

    def __init__(self, n_neighbors: int = 5, radius: float = 1.0, distance: str = "log") -> None:
        self.n_neighbors = n_neighbors
        self.radius = radius
        self.distance = distance

    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> SignatureNeighbors:
        """Store the signatures that are searched.

        Parameters
        ----------
        X : (N, L) array_like
            Log-signatures, or other coordinates of which the distance is a function; whitened or not.
        y : (N,) array_like, optional
            Classes, for `score`.

        Returns
        -------
        SignatureNeighbors
            The estimator itself.

        Raises
        ------
        InputError
            If there are not as many classes as signatures.
        OptionError
            If the distance does not exist.
        """
        self._fit_X = validate_data(self, X, dtype=np.float64)
        known_distance(self.distance)
        self._classes = None if y is None else column_or_1d(y)
        if self._classes is not None and len(self._classes) != len(self._fit_X):
            raise InputError(f"y must have {len(self._fit_X)} classes, one a row, got {len(self._classes)}")
        self.n_samples_fit_ = len(self._fit_X)
        return self

    def kneighbors(
        self, X: ArrayLike | None = None, n_neighbors: int | None = None, return_distance: bool = True
    ) -> Found:
        """The nearest of the fitted signatures.

        Parameters
        ----------
        X : (Q, L) array_like, optional
            The queries. By default the fitted signatures, each of which is then not its own neighbour.
        n_neighbors : int, optional
            Number of neighbours k; by default `n_neighbors` of the constructor.
        return_distance : bool, default True
            Whether distances are returned too.

        Returns
        -------
        distances : (Q, k) float64
            Ascending in each row; only if `return_distance`.
        indices : (Q, k) intp
            Rows of the fitted signatures.

        Raises
        ------
        OptionError
            If there are fewer than k neighbours, or k is less than 1.
        """
        k = self.n_neighbors if n_neighbors is None else n_neighbors
        check_is_fitted(self)
        most = self.n_samples_fit_ - (X is None)
        if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or not 1 <= k <= most:
            raise OptionError(f"Expected n_neighbors to be a whole number from 1 to {most}, got {k!r}")
        rows = [(own[:k], order[:k]) for own, order in self._sorted(X)]
        distances = np.array([own for own, _ in rows]).reshape(-1, k)
        indices = np.array([order for _, order in rows], dtype=np.intp).reshape(-1, k)
        return (distances, indices) if return_distance else indices

    def radius_neighbors(
        self, X: ArrayLike | None = None, radius: float | None = None, return_distance: bool = True
    ) -> tuple[NDArray[Any], NDArray[Any]] | NDArray[Any]:
        """The fitted signatures within a distance.

        Parameters
        ----------
        X : (Q, L) array_like, optional
            The queries. By default the fitted signatures, each of which is then not its own neighbour.
        radius : float, optional
            The largest distance; by default `radius` of the constructor.
        return_distance : bool, default True
            Whether distances are returned too.

        Returns
        -------
        distances : (Q,) object
            For each query the distances, a float64 array, ascending; only if `return_distance`.
        indices : (Q,) object
            For each query the rows of the fitted signatures, an intp array.
        """
        largest = self.radius if radius is None else radius
        check_is_fitted(self)
        rows = [
            (own[: (n := np.searchsorted(own, largest, side="right"))], order[:n])
            for own, order in self._sorted(X)
        ]
        distances, indices = (np.empty(len(rows), dtype=object) for _ in range(2))
        for number, (own, order) in enumerate(rows):
            distances[number], indices[number] = own, order
        return (distances, indices) if return_distance else indices

    def score(self, X: ArrayLike, y: ArrayLike) -> float:
        """Mean average precision of retrieving the fitted signatures of a query's class.

        Signatures that were whitened by the classes of the queries have too high a score;
        `pcretrieve.evaluate` fits such a whitening on other classes.

        Parameters
        ----------
        X : (Q, L) array_like
            The queries, none of which was fitted.
        y : (Q,) array_like
            Their classes. Queries whose class was not fitted are left out.

        Returns
        -------
        float
            Between 0 and 1, larger is better.

        Raises
        ------
        InputError
            If `fit` was given no classes, or no class in `y`.
        """
        check_is_fitted(self)
        if self._classes is None:
            raise InputError("a score needs the classes of the fitted signatures: give y to fit")
        queried = column_or_1d(y)
        hit_query, hit_rank = [], []
        n_relevant: list[int] = []
        for label, (_, order) in zip(queried, self._sorted(X), strict=True):
            ranks = np.flatnonzero(self._classes[order] == label) + 1
            if len(ranks):
                hit_query.append(np.full(len(ranks), len(n_relevant)))
                hit_rank.append(ranks)
                n_relevant.append(len(ranks))
        if not n_relevant:
            raise InputError("a score needs queries of fitted classes, got none")
        rankings = Rankings(
            ids=tuple(map(str, range(len(n_relevant)))),
            labels=("",) * len(n_relevant),
            n_relevant=np.array(n_relevant),
            hit_query=np.concatenate(hit_query),
            hit_rank=np.concatenate(hit_rank),
            nearest=(None,) * len(n_relevant),
            nearest_labels=(None,) * len(n_relevant),
            n_gallery=self.n_samples_fit_ + 1,
            n_failed=0,
            n_single=0,
        )
        return evaluate_rankings(rankings).map

    def _sorted(self, X: ArrayLike | None) -> Iterator[tuple[FloatArray, Positions]]:
        """For each query the distances, ascending, and the rows of the fitted signatures."""
        queries = self._fit_X if X is None else validate_data(self, X, dtype=np.float64, reset=False)
        rows = max(1, BLOCK_DISTANCES // self.n_samples_fit_)
        for start in range(0, len(queries), rows):
            distances = pairwise(self.distance, queries[start : start + rows], self._fit_X)  # (rows, N)
            # A stable sort: equal distances in the order of the rows.
            orders = np.argsort(distances, axis=1, kind="stable")
            for number, (order, own) in enumerate(zip(orders, distances, strict=True), start):
                kept = order[order != number] if X is None else order
                yield own[kept], kept


class SignatureTransformer(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Scans → the logarithms of their signatures, one row a scan.

    The rows are what distances are functions of (`pcretrieve.retrieval.coordinates`): of descriptors that
    are not compared by logarithms, the values themselves, or the square roots of histograms. Nothing is
    learned from the scans. The input is a sequence of scans and no array of numbers, which the tags of the
    estimator say.

    Parameters
    ----------
    options : OptionsLike, optional
        Options of all stages, a preset's name, a TOML file, or a mapping; see `PipelineOptions.of`.
    method : str, optional
        The descriptor; by default that of `options`.
    n_values : int, optional
        The number of values; by default that of `options`.
    scale : {"auto", "area", "relative", "absolute"}, optional
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

    def fit(self, X: Iterable[ScanLike], y: object = None) -> SignatureTransformer:
        """Check the parameters.

        Parameters
        ----------
        X : iterable of ScanLike
            Scans, which are not read.
        y : object
            Ignored.

        Returns
        -------
        SignatureTransformer
            The estimator itself.

        Raises
        ------
        OptionError
            If an option does not exist, or its value is not allowed.
        """
        self._chosen()
        return self

    def transform(self, X: Iterable[ScanLike]) -> FloatArray:
        """Process scans, one after the other.

        Parameters
        ----------
        X : iterable of ScanLike
            n files, arrays, or values of geometry.

        Returns
        -------
        (n, L) float64
            Log-signatures; dimensionless, except for the scale ``absolute``.

        Raises
        ------
        InputError
            If `X` is a single path.
        ShapeError
            If a scan cannot be read or has no usable surface.
        """
        if isinstance(X, (str, Path)):
            raise InputError(f"X must be a sequence of scans, got the path {X}: put it into a list")
        options = self._chosen()
        made = [describe(process(scan, options), options.compared) for scan in X]
        rows = [coordinates(signature.values, signature.metric) for signature in made]
        return np.array(rows).reshape(-1, self._n_features_out)

    @property
    def _n_features_out(self) -> int:
        """L, for the names of the features."""
        return signature_length(self._chosen().compared)

    def _chosen(self) -> PipelineOptions:
        """The options, with the parameters that were given in their place."""
        given = {"method": self.method, "n_values": self.n_values, "scale": self.scale}
        signature = {name: value for name, value in given.items() if value is not None}
        return PipelineOptions.of(self.options).changed(signature=signature)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.no_validation = True
        tags.requires_fit = False
        return tags
