"""Scans → signatures as a scikit-learn transformer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin

from pcretrieve.descriptors import describe, signature_length
from pcretrieve.errors import InputError
from pcretrieve.formats.scans import ScanLike
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates
from pcretrieve.values import FloatArray

__all__ = ["SignatureTransformer"]


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
