"""Surface, or points → stiffness and mass matrices → smallest eigenpairs."""

from pcretrieve.spectral.eigen import eigenpairs
from pcretrieve.spectral.elements import Assembled, Element
from pcretrieve.spectral.operators import ELEMENTS, laplace_beltrami, unit_eigenpairs
from pcretrieve.spectral.points import star_mesh

__all__ = [
    "ELEMENTS",
    "Assembled",
    "Element",
    "eigenpairs",
    "laplace_beltrami",
    "star_mesh",
    "unit_eigenpairs",
]
