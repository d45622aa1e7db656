"""scikit-learn estimators: scans → signatures → whitened signatures → neighbours.

They use the functions of other packages of pcretrieve, so that results are equal. Only this package imports
scikit-learn, and is itself imported on request only.
"""

from pcretrieve.estimators.neighbors import SignatureNeighbors, SignatureTransformer
from pcretrieve.estimators.whitenings import (
    NeighbourWhitening,
    PCAWhitening,
    ResolutionWhitening,
    WithinClassWhitening,
)

__all__ = [
    "NeighbourWhitening",
    "PCAWhitening",
    "ResolutionWhitening",
    "SignatureNeighbors",
    "SignatureTransformer",
    "WithinClassWhitening",
]
