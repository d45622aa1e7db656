"""Regularised covariances, and their inverse square roots."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import OptionError
from pcretrieve.options import Shrinkage
from pcretrieve.values import FloatArray

__all__ = ["DEFAULT_SHRINKAGE", "CovarianceFit", "checked_shrinkage", "inverse_square_root"]

#: Regularisation of the covariance, which limits the amplification of noise in directions of small variance.
#: See docs/decisions.md, DEFAULT_SHRINKAGE. For within-class it is estimated instead.
DEFAULT_SHRINKAGE: Mapping[str, float] = MappingProxyType(
    {
        "neighbours": 0.20,  # intensity towards the mean variance times the identity
        "pca": 0.01,  # times the largest eigenvalue, added to all eigenvalues (Tikhonov)
        "resolution": 0.03,  # as for pca
    }
)


class CovarianceFit(NamedTuple):
    """What a whitening is made of.

    shapes: (n, L) float64, the shapes of the fit.
    covariance: (L, L) float64, regularised.
    """

    shapes: FloatArray
    covariance: FloatArray
    shrinkage: float
    reason: str


def checked_shrinkage(kind: str, shrinkage: Shrinkage) -> float:
    """The shrinkage of a whitening, or its default, after a check of its range."""
    value = DEFAULT_SHRINKAGE.get(kind, 1.0) if shrinkage == "auto" else float(shrinkage)
    if not 0 < value <= 1:
        raise OptionError(f"shrinkage must lie in (0, 1], got {value}")
    return value


def inverse_square_root(covariance: FloatArray) -> FloatArray:
    """The symmetric inverse square root C^(−1/2) of a covariance.

    covariance: (L, L) float64, c, symmetric positive definite.
    Returns (L, L) float64: symmetric positive definite.
    """
    variances, directions = np.linalg.eigh(covariance)
    root: FloatArray = (directions / np.sqrt(variances)) @ directions.T
    return root
