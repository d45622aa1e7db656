"""Surface → stiffness and mass → lowest eigenpairs."""

from pcretrieve.spectral.eigen import eigenpairs
from pcretrieve.spectral.operators import laplace_beltrami

__all__ = ["eigenpairs", "laplace_beltrami"]
