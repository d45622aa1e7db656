"""Surface → Laplace–Beltrami operator: the table of the elements, and the boundary conditions."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.csgraph import connected_components

from pcretrieve.errors import (
    DegenerateMeshError,
    InputError,
    OptionError,
    Stage,
    in_stage,
)
from pcretrieve.spectral.eigen import eigenpairs
from pcretrieve.spectral.elements import CUBIC, INTRINSIC_DELAUNAY, LINEAR, Element, Mass
from pcretrieve.spectral.points import POINTS
from pcretrieve.values import Eigenpairs, LaplaceBeltrami, TriangleMesh
from pcretrieve.values.conversion import GeometryLike, as_geometry

#: The elements of pcretrieve by name.
ELEMENTS = {
    element.name: element for element in (LINEAR, CUBIC, INTRINSIC_DELAUNAY, POINTS)
}


def laplace_beltrami(
    surface: GeometryLike,
    element: str | Element = "linear",
    *,
    mass: Mass | None = None,
    boundary: Literal["neumann", "dirichlet"] = "neumann",
) -> LaplaceBeltrami:
    """The stiffness and the mass matrix of the Laplace–Beltrami operator of a surface.

    Parameters
    ----------
    surface : GeometryLike
        What stands for a TriangleMesh, or for the element ``points`` a PointCloud (see `as_geometry`): a
        surface, with or without boundary, in which every vertex is in a face; or the points of one.
    element : str or Element, default "linear"
        Discretisation, one's own or by name. ``linear``: linear Lagrange elements, order 2. ``cubic``: cubic
        ones, order 6 on flat surfaces. ``intrinsic-delaunay``: linear elements on the intrinsic Delaunay
        triangulation, for badly shaped and non-manifold triangles. ``points``: linear elements on local
        triangulations of points. The sources are in `pcretrieve.spectral.elements` and `.points`.
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
        If the surface is a cloud and the element needs a mesh, or the reverse.
    OptionError
        If `element`, `mass` or `boundary` does not exist, or their combination is not available.
    DegenerateMeshError
        If the element is not defined on this surface; or, with the Dirichlet boundary condition, if a
        component has no boundary, or there is no interior node.
    """
    geometry = as_geometry(surface)
    if isinstance(element, str):
        _one_of("element", element, tuple(ELEMENTS))
        element = ELEMENTS[element]
    _one_of("mass", mass, (None, "consistent", "lumped"))
    _one_of("boundary", boundary, ("neumann", "dirichlet"))
    name = element.name
    if mass not in (None, *element.masses):
        raise OptionError(
            f"element {name!r} has {element.masses[0]} mass only, got mass={mass!r}"
        )
    if element.needs == "points" and boundary == "dirichlet":
        raise OptionError(
            f"element {name!r} has boundary='neumann' only: a cloud does not say where it ends"
        )
    if element.needs == "mesh" and not isinstance(geometry, TriangleMesh):
        raise InputError(
            f"element {name!r} needs a TriangleMesh, got {type(geometry).__name__}"
        )
    if element.needs == "points" and isinstance(geometry, TriangleMesh):
        raise InputError(
            f"element {name!r} needs a PointCloud or an (n, 3) array, got a TriangleMesh"
        )
    with in_stage(Stage.SPECTRUM):
        assembled = element.assemble(geometry)
        # Raises, if it is not such an operator.
        LaplaceBeltrami(assembled.stiffness, assembled.mass)

    # The stiffness of a single edge can be zero (between two right angles). But the indicator function of a
    # proper subset of the nodes of a component has a non-zero gradient, so that not all entries between the
    # subset and its complement are zero: the graph of S has the components of the surface.
    n_components, component = connected_components(assembled.stiffness, directed=False)
    matrix = assembled.mass
    if (mass or element.masses[0]) == "lumped":
        matrix = csc_array(diags_array(matrix.sum(axis=1)))
    if boundary == "neumann":
        return LaplaceBeltrami(
            assembled.stiffness, matrix, n_components=int(n_components)
        )

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
    stiffness, matrix = (
        csc_array(full[:, nodes][nodes]) for full in (assembled.stiffness, matrix)
    )
    return LaplaceBeltrami(stiffness, matrix, n_components=0, nodes=nodes)


def _one_of(name: str, given: object, allowed: tuple[object, ...]) -> None:
    if given not in allowed:
        names = [repr(value) for value in allowed if value is not None]
        raise OptionError(
            f"{name} must be {', '.join(names[:-1])} or {names[-1]}, got {given!r}"
        )


def unit_eigenpairs(
    mesh: TriangleMesh, n_pairs: int, element: str = "linear"
) -> Eigenpairs:
    """The lowest eigenpairs of a surface scaled to unit area, as all descriptors take them.

    At unit area tolerances mean the same for every surface: the matrix of R-BiHDM scales as length⁴.
    """
    vertices = (mesh.vertices - mesh.vertices.mean(axis=0)) / np.sqrt(mesh.area)
    return eigenpairs(
        laplace_beltrami(TriangleMesh(vertices, mesh.faces), element), n_pairs
    )
