"""Whitenings of signatures as scikit-learn transformers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from pcretrieve.options import Damping, Scale, SignatureOptions
from pcretrieve.retrieval import Whitening, fit_whitening, resolution_whitening
from pcretrieve.types import FloatArray

__all__ = ["PCAWhitening", "ResolutionWhitening", "WithinClassWhitening"]


class _Whitener(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """The map of a whitening that `fit` has stored. The matrix is symmetric: no value changes its meaning."""

    whitening_: Whitening

    def transform(self, X: ArrayLike) -> FloatArray:
        """Whitened signatures.

        Parameters
        ----------
        X : (n, L) array_like
            Signatures as in `fit`.

        Returns
        -------
        (n, L) float64
            W (x − mean) for each row x.
        """
        check_is_fitted(self)
        return self.whitening_.apply(validate_data(self, X, dtype=np.float64, reset=False))


class PCAWhitening(_Whitener):
    """Whitening by the covariance of all signatures; ``pca`` of `RetrievalOptions.whitening`.

    Parameters
    ----------
    damping : float or "auto", default "auto"
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

    def __init__(self, damping: Damping = "auto") -> None:
        self.damping = damping

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
            If the damping is out of range.
        """
        logs = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        self.whitening_ = fit_whitening("pca", logs, damping=self.damping)
        return self


class WithinClassWhitening(_Whitener):
    """Whitening by the covariance within classes; ``within-class`` of `RetrievalOptions.whitening`.

    Parameters
    ----------
    damping : float or "auto", default "auto"
        Shrinkage in (0, 1] of the covariance towards its mean variance times the identity. auto: .1.

    Attributes
    ----------
    whitening_ : Whitening
        The mean and the matrix of the map.
    n_features_in_ : int
        L, the number of values of a signature.
    """

    def __init__(self, damping: Damping = "auto") -> None:
        self.damping = damping

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
            If the damping is out of range.
        """
        logs, classes = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=2)
        self.whitening_ = fit_whitening("within-class", logs, _labels(classes), damping=self.damping)
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
    damping : float or "auto", default "auto"
        Regularisation in (0, 1], times the largest eigenvalue of the covariance. auto: .03.

    Attributes
    ----------
    whitening_ : Whitening
        The mean and the matrix of the map.
    n_features_in_ : int
        L, the number of values of a signature, at most 60.
    """

    def __init__(self, scale: Scale = "area", damping: Damping = "auto") -> None:
        self.scale = scale
        self.damping = damping

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
            If the scale is absolute, or the damping out of range.
        """
        n_values = validate_data(self, X, dtype=np.float64).shape[1]
        options = SignatureOptions(n_values=n_values, scale=self.scale)
        self.whitening_ = resolution_whitening(options, damping=self.damping)
        return self


def _labels(classes: NDArray[Any]) -> list[str | None]:
    """Classes as labels. Numbers must be whole, as anywhere in scikit-learn."""
    known = np.array([label is not None for label in classes.tolist()], dtype=bool)
    check_classification_targets(classes[known])
    return [None if label is None else str(label) for label in classes.tolist()]
