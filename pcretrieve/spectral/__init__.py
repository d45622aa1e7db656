"""Surface, or points → stiffness and mass matrices → smallest eigenpairs."""

from pcretrieve.spectral.eigen import eigenpairs
from pcretrieve.spectral.modes import unit_eigenpairs
from pcretrieve.spectral.operators import laplace_beltrami
from pcretrieve.spectral.points import star_mesh

__all__ = ["eigenpairs", "laplace_beltrami", "star_mesh", "unit_eigenpairs"]
