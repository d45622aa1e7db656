"""Whitenings of signatures as scikit-learn transformers."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from pcretrieve.options import Scale, Shrinkage, SignatureOptions
from pcretrieve.retrieval import Whitening, fit_whitening, resolution_whitening
from pcretrieve.values import FloatArray

__all__ = ["NeighbourWhitening", "PCAWhitening", "ResolutionWhitening", "WithinClassWhitening"]


class _Whitener(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """The map of a whitening that `fit` has stored. The matrix is symmetric: no value changes its meaning."""

    whitening_: Whitening

    def transform(self, X: ArrayLike) -> FloatArray:
        """Whitened signatures.

        X: (n, L) array_like, signatures as in `fit`.
        Returns (n, L) float64: w (x − mean) for each row x.
        """
        check_is_fitted(self)
        return self.whitening_.apply(validate_data(self, X, dtype=np.float64, reset=False))


class NeighbourWhitening(_Whitener):
    """Whitening by what near signatures differ by; ``neighbours`` of `RetrievalOptions.whitening`.

    No classes are needed. Nothing is learned from fewer than 24 signatures, or fewer than 10 pairs of mutual
    neighbours: the signatures stay as they are, and ``whitening_.reason`` says so.

    Parameters
    ----------
    n_neighbors : int or "auto", default "auto"
        Two signatures are a pair if each is among the other's `n_neighbors` nearest. auto: the number at
        which neighbourhoods overlap most, if it stands out, else 5.
    shrinkage : float or "auto", default "auto"
        Shrinkage in (0, 1] of the covariance towards its mean variance times the identity. auto: .2.
    prior : (L, L) array_like, optional
        A covariance of trace 1 that is mixed in, as in `pcretrieve.retrieval.fit_whitening`.

    Attributes
    ----------
    whitening_ : Whitening
        The mean and the matrix of the map.
    n_features_in_ : int
        L, the number of values of a signature.
    """

    def __init__(
        self,
        n_neighbors: int | Literal["auto"] = "auto",
        shrinkage: Shrinkage = "auto",
        prior: ArrayLike | None = None,
    ) -> None:
        self.n_neighbors = n_neighbors
        self.shrinkage = shrinkage
        self.prior = prior

    def fit(self, X: ArrayLike, y: object = None) -> NeighbourWhitening:
        """Fit the whitening to signatures.

        Parameters
        ----------
        X : (n, L) array_like
            Log-signatures, or other coordinates of which distances are functions.
        y : object
            Ignored.

        Returns
        -------
        NeighbourWhitening
            The estimator itself.

        Raises
        ------
        OptionError
            If the shrinkage or the number of neighbours is out of range.
        """
        logs = validate_data(self, X, dtype=np.float64)
        prior = None if self.prior is None else np.asarray(self.prior, dtype=np.float64)
        self.whitening_ = fit_whitening(
            "neighbours",
            logs,
            shrinkage=self.shrinkage,
            n_neighbors=self.n_neighbors,
            prior=prior,
        )
        return self


class PCAWhitening(_Whitener):
    """Whitening by the covariance of all signatures; ``pca`` of `RetrievalOptions.whitening`.

    A warning is logged where it is likely to make rankings worse, as for bodies of one kind.

    Parameters
    ----------
    shrinkage : float or "auto", default "auto"
        Regularisation in (0, 1], times the largest eigenvalue of the covariance. auto: .01.

    Attributes
    ----------
    whitening_ : Whitening
        The mean and the matrix of the map.
    n_features_in_ : int
        L, the number of values of a signature.

    Examples
    --------
    >>> import numpy as np
    >>> logs = np.random.default_rng(0).normal(size=(50, 3)) * [1, 5, 10]
    >>> PCAWhitening().fit_transform(logs).std(axis=0).round(1)
    array([6., 6.4, 6.4])
    """

    def __init__(self, shrinkage: Shrinkage = "auto") -> None:
        self.shrinkage = shrinkage

    def fit(self, X: ArrayLike, y: object = None) -> PCAWhitening:
        """Fit the whitening to signatures.

        Parameters
        ----------
        X : (n, L) array_like
            Log-signatures, or other coordinates of which distances are functions.
        y : object
            Ignored.

        Returns
        -------
        PCAWhitening
            The estimator itself.

        Raises
        ------
        InputError
            If there are fewer than two distinct signatures.
        OptionError
            If the shrinkage is out of range.
        """
        logs = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        self.whitening_ = fit_whitening("pca", logs, shrinkage=self.shrinkage)
        return self


class WithinClassWhitening(_Whitener):
    """Whitening by the covariance within classes; ``within-class`` of `RetrievalOptions.whitening`.

    Parameters
    ----------
    shrinkage : float or "auto", default "auto"
        Shrinkage in (0, 1] of the covariance towards its mean variance times the identity. auto: the
        intensity between .0003 and .3 at which classes that are left out are most likely.

    Attributes
    ----------
    whitening_ : Whitening
        The mean and the matrix of the map.
    n_features_in_ : int
        L, the number of values of a signature.
    """

    def __init__(self, shrinkage: Shrinkage = "auto") -> None:
        self.shrinkage = shrinkage

    def fit(self, X: ArrayLike, y: ArrayLike) -> WithinClassWhitening:
        """Fit the whitening to labelled signatures.

        Parameters
        ----------
        X : (n, L) array_like
            Log-signatures, or other coordinates of which distances are functions.
        y : (n,) array_like
            Classes: numbers or strings. None is no class; classes of one signature are ignored.

        Returns
        -------
        WithinClassWhitening
            The estimator itself.

        Raises
        ------
        InputError
            If no class has two distinct signatures.
        OptionError
            If the shrinkage is out of range.
        """
        logs, classes = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=2)
        self.whitening_ = fit_whitening("within-class", logs, _labels(classes), shrinkage=self.shrinkage)
        return self

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags


class ResolutionWhitening(_Whitener):
    """Whitening by the changes that the resolution of a surface causes; ``resolution`` of `RetrievalOptions`.

    Nothing is estimated from the signatures, which must be R-BiHDM with 60 modes.

    Parameters
    ----------
    scale : {"area", "relative"}, default "area"
        Normalisation of the signatures, as in `SignatureOptions`.
    shrinkage : float or "auto", default "auto"
        Regularisation in (0, 1], times the largest eigenvalue of the covariance. auto: .03.

    Attributes
    ----------
    whitening_ : Whitening
        The mean and the matrix of the map.
    n_features_in_ : int
        L, the number of values of a signature, at most 60.
    """

    def __init__(self, scale: Scale = "area", shrinkage: Shrinkage = "auto") -> None:
        self.scale = scale
        self.shrinkage = shrinkage

    def fit(self, X: ArrayLike, y: object = None) -> ResolutionWhitening:
        """Note how many values the signatures have.

        Parameters
        ----------
        X : (n, L) array_like
            Log-signatures.
        y : object
            Ignored.

        Returns
        -------
        ResolutionWhitening
            The estimator itself.

        Raises
        ------
        OptionError
            If the scale is absolute, or the shrinkage out of range.
        """
        n_values = validate_data(self, X, dtype=np.float64).shape[1]
        options = SignatureOptions(method="r-bihdm", n_values=n_values, scale=self.scale)
        self.whitening_ = resolution_whitening(options, shrinkage=self.shrinkage)
        return self


def _labels(classes: NDArray[Any]) -> list[str | None]:
    """Classes as labels. Numbers must be whole, as anywhere in scikit-learn."""
    known = np.array([label is not None for label in classes.tolist()], dtype=bool)
    check_classification_targets(classes[known])
    return [None if label is None else str(label) for label in classes.tolist()]
