"""The record that declares an element: a discretisation of the Laplace–Beltrami operator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from pcretrieve.errors import OptionError

__all__ = ["Assembled", "Element", "Mass"]

Mass = Literal["consistent", "lumped"]


class Assembled(NamedTuple):
    """The stiffness matrix, the mass matrix, and a mask of the rows whose nodes are on the boundary."""

    stiffness: csc_array
    mass: csc_array
    boundary: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Element:
    """The declaration of an element, beside its function in pcretrieve or in another package.

    Attributes
    ----------
    name : str
        Value of the option `spectral.element`.
    assemble : function of TriangleMesh, or of PointCloud, that returns Assembled
        The matrices with natural (Neumann) boundary conditions, S symmetric positive semi-definite and
        invariant to scaling, M symmetric positive definite with 1ᵀM·1 = area, as in `LaplaceBeltrami`; the
        mask may be all false for a cloud.
    needs : {"mesh", "points"}, default "mesh"
        What `assemble` is called with. For ``points``, no surface is reconstructed from a scan, and the
        boundary condition ``dirichlet`` is refused.
    masses : tuple of {"consistent", "lumped"}, default ("consistent", "lumped")
        The mass matrices that are available, first the default. Lumped mass is the diagonal of the row sums.

    Raises
    ------
    OptionError
        If `needs` or `masses` has another value.
    """

    name: str
    assemble: Callable[[Any], Assembled]
    needs: Literal["mesh", "points"] = "mesh"
    masses: tuple[Mass, ...] = ("consistent", "lumped")

    def __post_init__(self) -> None:
        if self.needs not in ("mesh", "points"):
            raise OptionError(f"needs of an element must be 'mesh' or 'points', got {self.needs!r}")
        if not self.masses or not set(self.masses) <= set(get_args(Mass)):
            known = ", ".join(get_args(Mass))
            raise OptionError(f"masses of an element must be one or both of {known}, got {self.masses!r}")
