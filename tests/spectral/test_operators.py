"""Properties of all elements: the matrices, what they converge to, boundaries, and invalid arguments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapes
from scipy.linalg import eigh

from pcretrieve.errors import DegenerateMeshError, InputError, OptionError, ShapeError, Stage
from pcretrieve.spectral import Element, eigenpairs, laplace_beltrami
from pcretrieve.spectral.operators import ELEMENTS
from pcretrieve.values import FloatArray, LaplaceBeltrami, PointCloud, TriangleMesh

BOUNDED = {"square": shapes.square(5), "Möbius strip": shapes.mobius_strip(16, 3)}
BOUNDARY_EDGES = {"square": 20, "Möbius strip": 32}
SURFACES = {"body": shapes.body(1), **BOUNDED}

elements = pytest.mark.parametrize(
    "element", [name for name, element in ELEMENTS.items() if element.needs == "mesh"]
)
surfaces = pytest.mark.parametrize("mesh", SURFACES.values(), ids=SURFACES)


def book(n: int, pages: int = 3) -> TriangleMesh:
    """Unit squares that share one side, a non-manifold edge with one face for each square."""
    page = shapes.square(n)
    spine = page.vertices[:, 0] == 0  # (v,)
    numbers = np.arange(len(spine))
    free = numbers[~spine]
    vertices, faces = [page.vertices], [page.faces]
    for k in range(1, pages):
        angle = 2 * np.pi * k / pages
        turned = page.vertices[free] * [np.cos(angle), 1, 0] + page.vertices[free, :1] * [0, 0, np.sin(angle)]
        own = numbers.copy()
        own[free] = len(spine) + (k - 1) * len(free) + np.arange(len(free))
        vertices.append(turned)
        faces.append(own[page.faces])
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def spectrum(operator: LaplaceBeltrami, n: int) -> FloatArray:
    """The n smallest eigenvalues, whatever the boundary."""
    found: FloatArray = eigh(
        operator.stiffness.toarray(), operator.mass.toarray(), eigvals_only=True, subset_by_index=[0, n - 1]
    )
    return found


# --- matrices -----------------------------------------------------------------------------------------


@elements
@surfaces
def test_stiffness_is_symmetric_semi_definite_and_kills_constants(mesh: TriangleMesh, element: Any) -> None:
    stiffness = laplace_beltrami(mesh, element).stiffness
    assert abs(stiffness - stiffness.T).max() == 0
    assert np.abs(stiffness.sum(axis=1)).max() < 1e-12
    eigenvalues = np.linalg.eigvalsh(stiffness.toarray())
    assert eigenvalues[0] > -1e-12
    assert eigenvalues[1] > 1e-6  # connected: the null space is spanned by the constants


@elements
@surfaces
def test_mass_is_symmetric_definite_and_adds_up_to_the_area(mesh: TriangleMesh, element: Any) -> None:
    for mass in ELEMENTS[element].masses:
        operator = laplace_beltrami(mesh, element, mass=mass)
        assert abs(operator.mass - operator.mass.T).max() == 0
        assert np.linalg.eigvalsh(operator.mass.toarray())[0] > 0
        assert operator.area == pytest.approx(mesh.area, rel=1e-13)
    lumped, whole = (
        laplace_beltrami(mesh, element, mass=m).mass for m in ("lumped", ELEMENTS[element].masses[0])
    )
    assert lumped.nnz == lumped.shape[0]
    np.testing.assert_allclose(lumped.diagonal(), whole.sum(axis=1), rtol=1e-12)


@elements
def test_moving_leaves_both_and_scaling_squares_mass(element: Any) -> None:
    mesh, scale = shapes.body(2), 1e3
    here = laplace_beltrami(mesh, element)
    there = laplace_beltrami(shapes.moved(mesh, seed=0, scale=scale), element)
    assert abs(there.stiffness - here.stiffness).max() < 1e-10
    assert abs(there.mass - scale**2 * here.mass).max() < 1e-10 * scale**2


@elements
def test_eigenvalues_do_not_depend_on_numbers(element: Any) -> None:
    mesh = shapes.body(2)
    here, there = (
        eigenpairs(laplace_beltrami(each, element), 30, tolerance=1e-6)
        for each in (mesh, shapes.renumbered(mesh, 4))
    )
    np.testing.assert_allclose(there.eigenvalues, here.eigenvalues, rtol=1e-9)


def test_stiffness_of_one_triangle_is_half_its_cotangents() -> None:
    triangle = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], dtype=np.int32)
    )
    operator = laplace_beltrami(triangle)
    # Angles 90°, 45° and 45°: cotangents 0, 1 and 1.
    np.testing.assert_allclose(
        operator.stiffness.toarray(), [[1, -0.5, -0.5], [-0.5, 0.5, 0], [-0.5, 0, 0.5]]
    )
    np.testing.assert_allclose(operator.mass.toarray(), np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 24)


# --- what they converge to ----------------------------------------------------------------------------


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_eigenvalues_of_the_sphere_converge_at_order_two(mass: Any) -> None:
    exact = np.array([degree * (degree + 1.0) for degree in range(6) for _ in range(2 * degree + 1)])
    errors = [
        np.abs(eigenpairs(laplace_beltrami(shapes.icosphere(level), mass=mass), 36).eigenvalues - exact)[1:]
        / exact[1:]
        for level in (3, 4, 5)
    ]
    # An edge halves from level to level, so errors of order two fall to a quarter; some fall faster, where
    # the symmetries of the mesh are those of the eigenfunction.
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > 1.9
    worst = np.max(errors, axis=1)
    np.testing.assert_allclose(np.log2(worst[:-1] / worst[1:]), 2, atol=0.1)
    assert worst[-1] < 0.004


def test_eigenvalues_are_invariant_to_bending_without_stretching() -> None:
    # A strip of paper, flat and rolled to a quarter of a tube: every edge along or across keeps its length
    # up to second order.
    flat = shapes.square(24)
    x, y, _ = flat.vertices.T
    rolled = TriangleMesh(np.column_stack([np.sin(x), y, 1 - np.cos(x)]), flat.faces)
    one, other = (eigenpairs(laplace_beltrami(mesh), 12).eigenvalues for mesh in (flat, rolled))
    np.testing.assert_allclose(one[1:], other[1:], rtol=1e-3)


@pytest.mark.parametrize(
    ("element", "sizes", "order"),
    [("linear", (16, 32), 2), ("intrinsic-delaunay", (16, 32), 2), ("cubic", (4, 8), 6)],
)
@pytest.mark.parametrize("boundary", ["neumann", "dirichlet"])
def test_eigenvalues_of_the_square_converge_at_their_order(
    element: Any, sizes: tuple[int, ...], order: float, boundary: Any
) -> None:
    waves = range(10) if boundary == "neumann" else range(1, 11)
    exact = np.sort([np.pi**2 * (m**2 + n**2) for m in waves for n in waves])[:6]
    errors = [
        np.abs(spectrum(laplace_beltrami(shapes.square(n), element, boundary=boundary), 6) - exact)
        for n in sizes
    ]
    first = int(boundary == "neumann")  # 0 is exact
    rates = np.log2(errors[0] / errors[1])[first:]
    np.testing.assert_allclose(rates, order, atol=0.1 * order)


@elements
def test_three_pages_of_a_book_vibrate_as_one(element: Any) -> None:
    """Across the pages, the eigenfunctions of a star graph of three edges: k = 1/2 twice, and k = 1 once."""
    across = np.array([0, 0.5, 0.5, 1, 1.5, 1.5])
    exact = np.sort([(np.pi * k) ** 2 + (np.pi * n) ** 2 for k in across for n in range(3)])[:10]
    size, tolerance = (4, 1e-4) if element == "cubic" else (12, 0.02)
    mesh = book(size)
    operator = laplace_beltrami(mesh, element)
    assert abs(operator.stiffness - operator.stiffness.T).max() == 0
    assert abs(operator.stiffness.sum(axis=1)).max() < 1e-12
    assert operator.area == pytest.approx(3, rel=1e-12)
    np.testing.assert_allclose(spectrum(operator, 10), exact, rtol=tolerance, atol=1e-9)


# --- Dirichlet ----------------------------------------------------------------------------------------


@elements
@pytest.mark.parametrize("name", BOUNDED)
def test_nodes_on_the_boundary_have_no_rows(name: str, element: Any) -> None:
    mesh = BOUNDED[name]
    free = laplace_beltrami(mesh, element)
    held = laplace_beltrami(mesh, element, boundary="dirichlet")
    nodes = held.nodes
    assert free.nodes is None
    assert nodes is not None
    per_edge = 3 if element == "cubic" else 1  # its first vertex, and the nodes on it
    assert len(nodes) == free.mass.shape[0] - per_edge * BOUNDARY_EDGES[name]
    assert abs(held.stiffness - free.stiffness[nodes][:, nodes]).max() == 0
    assert abs(held.mass - free.mass[nodes][:, nodes]).max() == 0


@elements
def test_a_closed_surface_has_no_boundary_to_hold(element: Any) -> None:
    message = r"needs a boundary on every component, got 1 of 1 that are closed: use 'neumann'"
    with pytest.raises(DegenerateMeshError, match=message):
        laplace_beltrami(shapes.icosphere(1), element, boundary="dirichlet")
    half_closed = shapes.joined(shapes.icosphere(1), shapes.square(3))
    with pytest.raises(DegenerateMeshError, match="got 1 of 2 that are closed"):
        laplace_beltrami(half_closed, element, boundary="dirichlet")
    two = laplace_beltrami(shapes.joined(shapes.square(3), shapes.square(3)), element, boundary="dirichlet")
    assert two.n_components == 0


# --- refusals -----------------------------------------------------------------------------------------


def test_options_that_do_not_exist() -> None:
    names = "'linear', 'cubic', 'intrinsic-delaunay' or 'points'"
    delaunay: Any = {"element": "intrinsic-delaunay", "mass": "consistent"}
    cloud: Any = {"element": "points", "boundary": "dirichlet"}
    refused: list[tuple[Any, str]] = [
        ({"element": "quintic"}, f"element must be {names}, got 'quintic'"),
        ({"mass": "barycentric"}, "mass must be 'consistent' or 'lumped', got 'barycentric'"),
        ({"boundary": "robin"}, "boundary must be 'neumann' or 'dirichlet', got 'robin'"),
        (delaunay, "element 'intrinsic-delaunay' has lumped mass only, got mass='consistent'"),
        (cloud, "element 'points' has boundary='neumann' only"),
    ]
    for options, message in refused:
        with pytest.raises(OptionError, match=message):
            laplace_beltrami(shapes.tetrahedron(), **options)


def test_an_element_of_a_surface_takes_no_cloud() -> None:
    cloud = PointCloud(shapes.icosphere(2).vertices)
    with pytest.raises(InputError, match="element 'cubic' needs a TriangleMesh, got PointCloud"):
        laplace_beltrami(cloud, "cubic")


@elements
def test_what_is_no_surface(element: Any) -> None:
    empty, one = np.zeros((0, 3), dtype=np.int32), np.array([[0, 1, 2]], dtype=np.int32)
    folded = np.array([[0, 1, 2], [0, 1, 1]], dtype=np.int32)
    refused = [
        (np.eye(5, 3), empty, "a surface must have faces, got none"),
        (np.eye(5, 3), one, "every vertex must be in a face, got 2 that are in none"),
    ]
    if element != "intrinsic-delaunay":  # on a face without area there is no gradient
        refused += [
            (np.outer(range(3), [1.0, 2, 3]), one, "every face must have an area, got 1 of 1 without"),
            (np.eye(3), folded, "every face must have an area, got 1 of 2 without"),
        ]
    for vertices, faces, message in refused:
        with pytest.raises(DegenerateMeshError, match=message):
            laplace_beltrami(TriangleMesh(vertices, faces), element)


def test_a_surface_that_is_all_boundary() -> None:
    with pytest.raises(DegenerateMeshError, match="needs nodes inside, got all on the boundary: refine it"):
        laplace_beltrami(shapes.square(1), boundary="dirichlet")
    # Its cubic elements have nodes inside: four on the diagonal and in the middles of its two faces.
    assert laplace_beltrami(shapes.square(1), "cubic", boundary="dirichlet").mass.shape == (4, 4)


# --- elements of one's own ----------------------------------------------------------------------------

linear = ELEMENTS["linear"].assemble
SOFT = Element("soft", lambda mesh: linear(mesh)._replace(stiffness=(linear(mesh).stiffness * 0.5).tocsc()))
CLOUD = Element("cloud", ELEMENTS["points"].assemble, needs="points", masses=("consistent",))
WEIGHTLESS = Element("weightless", lambda mesh: linear(mesh)._replace(mass=linear(mesh).mass * np.nan))


def test_an_element_is_passed_as_an_object() -> None:
    mesh = shapes.body(3)
    soft, own = (laplace_beltrami(mesh, element) for element in (SOFT, "linear"))
    assert abs(2 * soft.stiffness - own.stiffness).max() < 1e-12


def test_an_element_has_what_it_declares_only() -> None:
    points = shapes.points_on(shapes.body(), 3000)
    lumped = laplace_beltrami(points, "points")
    np.testing.assert_allclose(laplace_beltrami(points, CLOUD).mass.sum(), lumped.mass.sum())
    with pytest.raises(OptionError, match="element 'cloud' has boundary='neumann' only"):
        laplace_beltrami(points, CLOUD, boundary="dirichlet")
    with pytest.raises(OptionError, match="element 'cloud' has consistent mass only, got mass='lumped'"):
        laplace_beltrami(points, CLOUD, mass="lumped")
    with pytest.raises(InputError, match=r"element 'cloud' needs a PointCloud or an \(n, 3\) array, got"):
        laplace_beltrami(shapes.icosphere(2), CLOUD)
    with pytest.raises(OptionError, match=r"element must be 'linear', .* or 'points', got 'cloud'"):
        laplace_beltrami(points, "cloud")


def test_matrices_that_are_not_finite_fail_the_shape() -> None:
    with pytest.raises(ShapeError, match="stiffness and mass must be finite, got NaN or") as raised:
        laplace_beltrami(shapes.tetrahedron(), WEIGHTLESS)
    assert raised.value.stage == Stage.SPECTRUM


def test_records_that_declare_what_does_not_exist() -> None:
    with pytest.raises(OptionError, match="needs of an element must be 'mesh' or 'points', got 'voxels'"):
        Element("x", linear, needs="voxels")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"masses of an element must be one or both of .* got \(\)"):
        Element("x", linear, masses=())
