"""The options of the comparison of signatures."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from pcretrieve.names import NAMES
from pcretrieve.options.model import Options

__all__ = ["RerankKind", "RetrievalOptions", "Shrinkage", "WhiteningKind"]

WhiteningKind = Literal["auto", "none", "resolution", "neighbours", "pca", "within-class"]
RerankKind = Literal["none", "local", "k-reciprocal"]
Shrinkage = Literal["auto"] | Annotated[float, Field(gt=0, le=1)]


class RetrievalOptions(Options):
    """Signatures → ranked shapes. No stored spectrum or signature depends on these options."""

    distance: Annotated[str, AfterValidator(NAMES["distance"].known)] = "log"
    """Distance of two signatures: the Euclidean distance of their logarithms (log), or the dissimilarities D1
    and D2 of Ye and Yu."""
    whitening: WhiteningKind = "auto"
    """Linear map of log-signatures before they are compared: none; the whitening of the changes that the
    resolution of a surface causes, measured on simulated bodies (resolution, for r-bihdm only); or that of
    the covariance of the gallery: of the differences of shapes that are among each other's nearest
    (neighbours), of all shapes (pca), or pooled within classes (within-class). auto: within-class if labels
    suffice, else neighbours; none for few shapes. In an evaluation auto does not use labels."""
    calibration: str | None = None
    """File of a whitening that `pcretrieve calibrate` has fitted to labelled scans, which replaces that of
    the option whitening; none by default."""
    shrinkage: Shrinkage = "auto"
    """Regularisation of the covariance of a whitening: for pca and resolution relative to its largest
    eigenvalue, for others the shrinkage intensity. auto: .01, .03, and .2 for neighbours, .03 with r-bihdm;
    for within-class the likeliest on classes that are left out."""
    rerank: RerankKind = "none"
    """Re-ranking of the first hundred results of a query, of which the first keeps its rank: by distances
    relative to the distances of near shapes (local), or by the overlap of k-reciprocal neighbourhoods
    (k-reciprocal)."""
    # Number of folds of classes with which a within-class whitening is evaluated.
    n_folds: ClassVar[int] = 5
    # Seed of the random assignment of classes to folds.
    fold_seed: ClassVar[int] = 0
