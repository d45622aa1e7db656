"""The array types of pcretrieve, for annotations."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["FloatArray", "IntArray"]

#: Real numbers in double precision: coordinates, eigenvalues, signatures.
FloatArray: TypeAlias = NDArray[np.float64]

#: Whole numbers of 32 bits: the vertex numbers of faces.
IntArray: TypeAlias = NDArray[np.int32]
