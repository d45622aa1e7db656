"""Surface → stiffness and mass: the table of elements, and the boundary."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.csgraph import connected_components

from pcretrieve.errors import DegenerateMeshError, InputError, OptionError
from pcretrieve.spectral.cubic import cubic
from pcretrieve.spectral.elements import Assembled
from pcretrieve.spectral.intrinsic_delaunay import intrinsic_delaunay
from pcretrieve.spectral.linear import linear
from pcretrieve.spectral.points import points
from pcretrieve.types import FloatArray, LaplaceBeltrami, PointCloud, TriangleMesh

__all__ = ["ELEMENTS", "laplace_beltrami"]

ELEMENTS: dict[str, Callable[[TriangleMesh], Assembled]] = {
    "linear": linear,
    "cubic": cubic,
    "intrinsic-delaunay": intrinsic_delaunay,
}

# Lumped mass is all that the first has, and better for the second.
LUMPED = {"intrinsic-delaunay", "points"}


def laplace_beltrami(
    surface: TriangleMesh | PointCloud | FloatArray,
    element: Literal["linear", "cubic", "intrinsic-delaunay", "points"] = "linear",
    *,
    mass: Literal["consistent", "lumped"] | None = None,
    boundary: Literal["neumann", "dirichlet"] = "neumann",
) -> LaplaceBeltrami:
    """Stiffness and mass matrix of a surface.

    Parameters
    ----------
    surface : TriangleMesh, or for points a PointCloud or (n, 3) float64
        n vertices, each of them in some face. Boundaries are allowed.
    element : {"linear", "cubic", "intrinsic-delaunay", "points"}, default "linear"
        linear: one node at each vertex, order 2. cubic: ten on each face, order 6 where the surface is flat.
        intrinsic-delaunay: linear on a better triangulation of the same surface, for faces of any shape and
        edges with any number of them. points: that of a cloud, without a surface. `linear`, `cubic`,
        `intrinsic_delaunay` and `points` tell more, and their sources.
    mass : {"consistent", "lumped"}, optional
        ∫ φ_i φ_j, or its row sums on the diagonal. Lumped mass makes the reduced matrix of R-BiHDM equal
        the dense kernel exactly; consistent mass gives better eigenvalues. Default: consistent for linear and
        cubic, lumped for points, and for intrinsic-delaunay, which has no other.
    boundary : {"neumann", "dirichlet"}, default "neumann"
        neumann: natural, nothing flows out. dirichlet: zero on the boundary, whose nodes have no rows.

    Returns
    -------
    LaplaceBeltrami
        Whatever the element: S symmetric positive semi-definite, dimensionless, unchanged by scaling; M
        symmetric positive definite, scaling as length². Eigenvalues scale as length⁻². Neumann: S·1 = 0, the
        null space is spanned by the constants of the components, and 1ᵀM·1 = area. Dirichlet: S is positive
        definite, and 1ᵀM·1 lacks what the nodes on the boundary carry.

    Raises
    ------
    InputError
        If the surface is a cloud and the element is not points, or the other way round.
    OptionError
        If `element`, `mass` or `boundary` is none of these, or they do not go together.
    DegenerateMeshError
        If the element cannot be set up on this surface; or with Dirichlet boundary a component has no
        boundary, or nothing but boundary.
    """
    _one_of("element", element, (*ELEMENTS, "points"))
    _one_of("mass", mass, (None, "consistent", "lumped"))
    _one_of("boundary", boundary, ("neumann", "dirichlet"))
    if (element, mass) == ("intrinsic-delaunay", "consistent"):
        raise OptionError("element 'intrinsic-delaunay' has lumped mass only, got mass='consistent'")
    if element == "points":
        if boundary == "dirichlet":
            raise OptionError(
                "element 'points' has boundary='neumann' only: a cloud does not say where it ends"
            )
        if isinstance(surface, TriangleMesh):
            raise InputError("element 'points' needs a PointCloud or an (n, 3) array, got a TriangleMesh")
        assembled = points(surface if isinstance(surface, PointCloud) else PointCloud(surface))
    else:
        if not isinstance(surface, TriangleMesh):
            raise InputError(f"element {element!r} needs a TriangleMesh, got {type(surface).__name__}")
        assembled = ELEMENTS[element](surface)

    # Between right angles an edge has no stiffness. But a function that is one on some nodes of a component
    # and zero on the others has a gradient, so not all entries between the two can vanish.
    n_components, component = connected_components(assembled.stiffness, directed=False)
    matrix = assembled.mass
    if mass == "lumped" or (mass is None and element in LUMPED):
        matrix = csc_array(diags_array(matrix.sum(axis=1)))
    if boundary == "neumann":
        return LaplaceBeltrami(assembled.stiffness, matrix, n_components=int(n_components))

    closed = n_components - len(np.unique(component[assembled.boundary]))
    if closed:
        raise DegenerateMeshError(
            f"boundary='dirichlet' needs a boundary on every component, got {closed} of {n_components} that "
            "are closed: use 'neumann'"
        )
    nodes = np.flatnonzero(~assembled.boundary).astype(np.int32)
    if not len(nodes):
        raise DegenerateMeshError(
            "boundary='dirichlet' needs nodes inside, got all on the boundary: refine it"
        )
    stiffness, matrix = (csc_array(full[:, nodes][nodes]) for full in (assembled.stiffness, matrix))
    return LaplaceBeltrami(stiffness, matrix, n_components=0, nodes=nodes)


def _one_of(name: str, given: object, allowed: tuple[object, ...]) -> None:
    if given not in allowed:
        names = [repr(value) for value in allowed if value is not None]
        raise OptionError(f"{name} must be {', '.join(names[:-1])} or {names[-1]}, got {given!r}")
