"""Surface → Laplace–Beltrami operator: the table of the elements, and the boundary conditions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.csgraph import connected_components

from pcretrieve.conversion import GeometryLike, as_geometry
from pcretrieve.errors import DegenerateMeshError, InputError, OptionError
from pcretrieve.spectral.cubic import cubic
from pcretrieve.spectral.elements import Assembled
from pcretrieve.spectral.intrinsic_delaunay import intrinsic_delaunay
from pcretrieve.spectral.linear import linear
from pcretrieve.spectral.points import points
from pcretrieve.types import LaplaceBeltrami, TriangleMesh

__all__ = ["ELEMENTS", "laplace_beltrami"]

ELEMENTS: dict[str, Callable[[TriangleMesh], Assembled]] = {
    "linear": linear,
    "cubic": cubic,
    "intrinsic-delaunay": intrinsic_delaunay,
}

# Elements with lumped mass by default: the first has no other, and for the second it is more accurate.
LUMPED = {"intrinsic-delaunay", "points"}


def laplace_beltrami(
    surface: GeometryLike,
    element: str = "linear",
    *,
    mass: Literal["consistent", "lumped"] | None = None,
    boundary: Literal["neumann", "dirichlet"] = "neumann",
) -> LaplaceBeltrami:
    """The stiffness and the mass matrix of the Laplace–Beltrami operator of a surface.

    Parameters
    ----------
    surface : GeometryLike
        What stands for a TriangleMesh, or for the element ``points`` a PointCloud (see `as_geometry`): a
        surface, with or without boundary, in which every vertex is in a face; or the points of one.
    element : {"linear", "cubic", "intrinsic-delaunay", "points"}, default "linear"
        Discretisation. ``linear``: linear Lagrange elements, order 2. ``cubic``: cubic ones, order 6 on flat
        surfaces. ``intrinsic-delaunay``: linear elements on the intrinsic Delaunay triangulation, for badly
        shaped and non-manifold triangles. ``points``: linear elements on local triangulations of points. The
        sources are in `pcretrieve.spectral.linear`, `.cubic`, `.intrinsic_delaunay` and `.points`.
    mass : {"consistent", "lumped"}, optional
        ``consistent``: ∫ φ_i φ_j. ``lumped``: its row sums on the diagonal. With lumped mass the reduced
        matrix of R-BiHDM is exactly the projection of the dense kernel; consistent mass gives more accurate
        eigenvalues. Default: consistent for ``linear`` and ``cubic``, lumped for ``points``, and for
        ``intrinsic-delaunay``, for which consistent mass is not available.
    boundary : {"neumann", "dirichlet"}, default "neumann"
        Boundary condition. ``neumann``: zero normal derivative (natural). ``dirichlet``: zero on the
        boundary, whose nodes have no rows in the matrices.

    Returns
    -------
    LaplaceBeltrami
        S symmetric positive semi-definite, dimensionless, invariant to scaling; M symmetric positive
        definite, unit length². Neumann: S·1 = 0, the null space of S is spanned by the constants on the
        components, and 1ᵀM·1 = area. Dirichlet: S is positive definite, and 1ᵀM·1 is less than the area.

    Raises
    ------
    InputError
        If the surface is a cloud and the element is not ``points``, or the reverse.
    OptionError
        If `element`, `mass` or `boundary` does not exist, or their combination is not available.
    DegenerateMeshError
        If the element is not defined on this surface; or, with the Dirichlet boundary condition, if a
        component has no boundary, or there is no interior node.
    """
    geometry = as_geometry(surface)
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
        if isinstance(geometry, TriangleMesh):
            raise InputError("element 'points' needs a PointCloud or an (n, 3) array, got a TriangleMesh")
        assembled = points(geometry)
    else:
        if not isinstance(geometry, TriangleMesh):
            raise InputError(f"element {element!r} needs a TriangleMesh, got {type(surface).__name__}")
        assembled = ELEMENTS[element](geometry)

    # The stiffness of a single edge can be zero (between two right angles). But the indicator function of a
    # proper subset of the nodes of a component has a non-zero gradient, so that not all entries between the
    # subset and its complement are zero: the graph of S has the components of the surface.
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
