"""Properties of all elements: the matrices, what they converge to, boundaries, and invalid arguments."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
import shapes
from scipy.linalg import eigh

from pcretrieve.errors import (
    DegenerateMeshError,
    InputError,
    OptionError,
    ShapeError,
    Stage,
)
from pcretrieve.spectral import Element, eigenpairs, laplace_beltrami
from pcretrieve.spectral.operators import ELEMENTS
from pcretrieve.values import FloatArray, LaplaceBeltrami, PointCloud, TriangleMesh

BOUNDED = {"square": shapes.square(5), "Möbius strip": shapes.mobius_strip(16, 3)}
BOUNDARY_EDGES = {"square": 20, "Möbius strip": 32}
SURFACES = {"body": shapes.body(1), **BOUNDED}

# On the grid, four adjacent points are cocircular.
CLOUDS = [
    *(shapes.points_on(mesh, 600) for mesh in (shapes.icosphere(6), shapes.body(5))),
    shapes.square(11).vertices,
]
DIRICHLET = {"boundary": "dirichlet"}
ON_MESHES = [name for name, element in ELEMENTS.items() if element.needs == "mesh"]

elements = pytest.mark.parametrize("element", ON_MESHES)


def surface(vertices: FloatArray, faces: list[list[int]]) -> TriangleMesh:
    return TriangleMesh(vertices, np.array(faces, dtype=np.int32).reshape(-1, 3))


def book(n: int, pages: int = 3) -> TriangleMesh:
    """Unit squares that share one side, a non-manifold edge with one face for each square."""
    page = shapes.square(n)
    x, y, _ = page.vertices.T
    angles = 2 * np.pi * np.arange(pages) / pages
    turned = (
        np.column_stack([x * np.cos(angle), y, x * np.sin(angle)]) for angle in angles
    )
    mesh = shapes.joined(*(TriangleMesh(vertices, page.faces) for vertices in turned))
    _, first, numbers = np.unique(
        mesh.vertices.round(9), axis=0, return_index=True, return_inverse=True
    )
    return TriangleMesh(
        mesh.vertices[first], numbers.astype(np.int32).reshape(-1)[mesh.faces]
    )


def spectrum(operator: LaplaceBeltrami, n: int) -> FloatArray:
    """The n smallest eigenvalues, whatever the boundary."""
    found: FloatArray = eigh(
        operator.stiffness.toarray(),
        operator.mass.toarray(),
        eigvals_only=True,
        subset_by_index=[0, n - 1],
    )
    return found


# --- matrices -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("element", "surface"),
    [*product(ON_MESHES, SURFACES.values()), *product(["points"], CLOUDS)],
)
def test_the_laws_of_the_matrices(element: Any, surface: Any) -> None:
    masses = (
        "lumped",
        "consistent" if "consistent" in ELEMENTS[element].masses else "lumped",
    )
    lumped, whole = (laplace_beltrami(surface, element, mass=mass) for mass in masses)  # type: ignore[arg-type]
    assert lumped.mass.nnz == lumped.mass.shape[0]
    np.testing.assert_allclose(lumped.mass.diagonal(), whole.mass.sum(axis=1), rtol=1e-12)
    for operator in (lumped, whole):
        stiffness, mass = operator.stiffness, operator.mass
        assert operator.n_components == 1
        assert abs(stiffness - stiffness.T).max() == 0
        assert np.abs(stiffness.sum(axis=1)).max() < 1e-11
        eigenvalues = np.linalg.eigvalsh(stiffness.toarray())
        assert eigenvalues[0] > -1e-12
        assert (
            eigenvalues[1] > 1e-6
        )  # connected: the null space is spanned by the constants
        assert abs(mass - mass.T).max() == 0
        assert np.linalg.eigvalsh(mass.toarray())[0] > 0
        if element != "points":
            assert operator.area == pytest.approx(surface.area, rel=1e-13)


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
    operator = laplace_beltrami(surface(np.eye(3, 3, -1), [[0, 1, 2]]))
    # Angles 90°, 45° and 45°: cotangents 0, 1 and 1.
    np.testing.assert_allclose(
        operator.stiffness.toarray(), [[1, -0.5, -0.5], [-0.5, 0.5, 0], [-0.5, 0, 0.5]]
    )
    np.testing.assert_allclose(
        operator.mass.toarray(), np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 24
    )


# --- what they converge to ----------------------------------------------------------------------------


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_eigenvalues_of_the_sphere_converge_at_order_two(mass: Any) -> None:
    exact = np.array(
        [degree * (degree + 1.0) for degree in range(6) for _ in range(2 * degree + 1)]
    )
    errors = [
        np.abs(
            eigenpairs(
                laplace_beltrami(shapes.icosphere(level), mass=mass), 36
            ).eigenvalues
            - exact
        )[1:]
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
    one, other = (
        eigenpairs(laplace_beltrami(mesh), 12).eigenvalues for mesh in (flat, rolled)
    )
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
        np.abs(
            spectrum(laplace_beltrami(shapes.square(n), element, boundary=boundary), 6)
            - exact
        )
        for n in sizes
    ]
    first = int(boundary == "neumann")  # 0 is exact
    rates = np.log2(errors[0] / errors[1])[first:]
    np.testing.assert_allclose(rates, order, atol=0.1 * order)


@elements
def test_three_pages_of_a_book_vibrate_as_one(element: Any) -> None:
    """Across the pages, the eigenfunctions of a star graph of three edges: k = 1/2 twice, and k = 1 once."""
    across = np.array([0, 0.5, 0.5, 1, 1.5, 1.5])
    exact = np.sort(
        [(np.pi * k) ** 2 + (np.pi * n) ** 2 for k in across for n in range(3)]
    )[:10]
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


def test_components_and_nodes_inside() -> None:
    two = laplace_beltrami(
        shapes.joined(shapes.square(3), shapes.square(3)), boundary="dirichlet"
    )
    assert two.n_components == 0
    # Two faces with all vertices on the boundary; of cubic elements, four nodes are inside.
    assert laplace_beltrami(
        shapes.square(1), "cubic", boundary="dirichlet"
    ).mass.shape == (4, 4)


# --- the intrinsic Delaunay triangulation -------------------------------------------------------------


def delaunay(mesh: TriangleMesh) -> LaplaceBeltrami:
    return laplace_beltrami(mesh, "intrinsic-delaunay")


def assert_same(one: LaplaceBeltrami, other: LaplaceBeltrami) -> None:
    assert abs(one.stiffness - other.stiffness).max() < 1e-12
    assert abs(one.mass - other.mass).max() < 1e-12


@pytest.mark.parametrize(
    "mesh", [shapes.icosphere(3), shapes.square(6)], ids=["sphere", "square"]
)
def test_on_a_delaunay_surface_it_is_the_linear_one(mesh: TriangleMesh) -> None:
    assert_same(delaunay(mesh), laplace_beltrami(mesh, mass="lumped"))


def test_it_flips_the_edges_that_should_be() -> None:
    # After the shear the diagonal of every cell is its longer one; with the shorter one it is Delaunay.
    square = shapes.square(5)
    sheared = square.vertices + square.vertices[:, 1:2] * [1, 0, 0]
    lower, upper = (
        square.faces[: len(square.faces) // 2],
        square.faces[len(square.faces) // 2 :],
    )
    (a, b, c), d = lower.T, upper[:, 2]
    flipped = TriangleMesh(
        sheared, np.concatenate([np.column_stack([a, b, d]), np.column_stack([b, c, d])])
    )
    long = TriangleMesh(sheared, square.faces)
    assert (
        abs(laplace_beltrami(long).stiffness - laplace_beltrami(flipped).stiffness).max()
        > 0.4
    )
    assert_same(delaunay(long), laplace_beltrami(flipped, mass="lumped"))


@pytest.mark.parametrize("shared", ["edge", "vertex"])
def test_non_manifold_places(shared: str) -> None:
    mesh = shapes.two_tetrahedra(shared)  # type: ignore[arg-type]
    operator = delaunay(mesh)
    assert operator.n_components == 1
    assert operator.area == pytest.approx(mesh.area)
    assert np.linalg.eigvalsh(operator.stiffness.toarray())[1] > 0.1


def test_a_face_without_area_is_stood() -> None:
    # A vertex in the middle of a side of one face only: a degenerate face closes the slit.
    mesh = shapes.square(8)
    (a, b, third), middle = mesh.faces[30], len(mesh.vertices)
    vertices = np.concatenate(
        [mesh.vertices, mesh.vertices[[a, b]].mean(axis=0, keepdims=True)]
    )
    around = [[a, middle, third], [middle, b, third], [a, b, middle]]
    slit = surface(vertices, [*np.delete(mesh.faces, 30, axis=0).tolist(), *around])
    assert slit.flat_faces.sum() == 1
    with pytest.raises(DegenerateMeshError, match="every face must have an area"):
        laplace_beltrami(slit)
    operator = delaunay(slit)
    assert operator.area == pytest.approx(1, rel=1e-3)
    found, expected = (
        eigenpairs(each, 20).eigenvalues[1:] for each in (operator, delaunay(mesh))
    )
    np.testing.assert_allclose(found, expected, rtol=0.02)


# --- elements of one's own, and refusals --------------------------------------------------------------

linear = ELEMENTS["linear"].assemble
SOFT = Element(
    "soft",
    lambda mesh: linear(mesh)._replace(stiffness=(linear(mesh).stiffness * 0.5).tocsc()),
)
CLOUD = Element(
    "cloud", ELEMENTS["points"].assemble, needs="points", masses=("consistent",)
)
WEIGHTLESS = Element(
    "weightless", lambda mesh: linear(mesh)._replace(mass=linear(mesh).mass * np.nan)
)


def test_an_element_is_passed_as_an_object() -> None:
    mesh, points = shapes.body(3), shapes.points_on(shapes.body(), 3000)
    soft, own = (laplace_beltrami(mesh, element) for element in (SOFT, "linear"))
    assert abs(2 * soft.stiffness - own.stiffness).max() < 1e-12
    consistent, lumped = (
        laplace_beltrami(points, element) for element in (CLOUD, "points")
    )
    np.testing.assert_allclose(consistent.mass.sum(), lumped.mass.sum())
    with pytest.raises(
        ShapeError, match="stiffness and mass must be finite, got NaN or"
    ) as raised:
        laplace_beltrami(mesh, WEIGHTLESS)
    assert raised.value.stage == Stage.SPECTRUM


BALL = shapes.icosphere(1)
POINTS = PointCloud(shapes.points_on(BALL, 500))
ELEMENT_NAMES = "element must be 'linear', 'cubic', 'intrinsic-delaunay' or 'points', got"


@pytest.mark.parametrize(
    ("geometry", "options", "error", "message"),
    [
        (BALL, {"element": "quintic"}, OptionError, f"{ELEMENT_NAMES} 'quintic'"),
        (POINTS, {"element": "cloud"}, OptionError, f"{ELEMENT_NAMES} 'cloud'"),
        (
            BALL,
            {"mass": "barycentric"},
            OptionError,
            "must be 'consistent' or 'lumped', got 'barycentric'",
        ),
        (
            POINTS,
            {"element": CLOUD, "mass": "lumped"},
            OptionError,
            "'cloud' has consistent mass only, got",
        ),
        (
            BALL,
            {"boundary": "robin"},
            OptionError,
            "must be 'neumann' or 'dirichlet', got 'robin'",
        ),
        (
            POINTS,
            {"element": CLOUD} | DIRICHLET,
            OptionError,
            "'cloud' has boundary='neumann' only",
        ),
        (
            POINTS,
            {"element": "cubic"},
            InputError,
            "element 'cubic' needs a TriangleMesh, got PointCloud",
        ),
        (
            BALL,
            {"element": CLOUD},
            InputError,
            r"'cloud' needs a PointCloud or an \(n, 3\) array, got a Tri",
        ),
        (
            BALL,
            DIRICHLET,
            DegenerateMeshError,
            "boundary on every component, got 1 of 1 that are closed",
        ),
        (
            shapes.joined(BALL, shapes.square(3)),
            DIRICHLET,
            DegenerateMeshError,
            "got 1 of 2 that are closed",
        ),
        (
            shapes.square(1),
            DIRICHLET,
            DegenerateMeshError,
            "needs nodes inside, got all on the boundary",
        ),
    ],
)
def test_questions_without_an_answer(
    geometry: Any, options: Any, error: Any, message: str
) -> None:
    with pytest.raises(error, match=message):
        laplace_beltrami(geometry, **options)


FLAT = surface(np.outer(range(3), [1.0, 2, 3]), [[0, 1, 2]])
FOLDED = surface(np.eye(3), [[0, 1, 2], [0, 1, 1]])
NO_AREA = "every face must have an area, got 1 of"
REFUSED = [
    *(
        (name, surface(np.eye(5, 3), []), "a surface must have faces, got none")
        for name in ON_MESHES
    ),
    *(
        (name, surface(np.eye(5, 3), [[0, 1, 2]]), "in a face, got 2 that are in none")
        for name in ON_MESHES
    ),
    # On a face without area there is no gradient.
    *((name, flat, NO_AREA) for name in ("linear", "cubic") for flat in (FLAT, FOLDED)),
    ("intrinsic-delaunay", FLAT, "must have an area, got only faces without"),
    (
        "intrinsic-delaunay",
        FOLDED,
        "every face must have three corners, got 1 that name one twice",
    ),
    ("points", POINTS.points[:30], "a cloud must have at least 31 points, got 30"),
    (
        "points",
        POINTS.points[np.r_[0:500, 0:3]],
        "must be distinct, got 6 that are there more than once",
    ),
    (
        "points",
        np.outer(range(100), [1.0, 0, 0]),
        "got 100 that do not: points on a line are no surface",
    ),
]


@pytest.mark.parametrize(("element", "degenerate", "message"), REFUSED)
def test_what_is_no_surface(element: Any, degenerate: Any, message: str) -> None:
    with pytest.raises(DegenerateMeshError, match=message):
        laplace_beltrami(degenerate, element)


def test_records_that_declare_what_does_not_exist() -> None:
    with pytest.raises(
        OptionError, match="needs of an element must be 'mesh' or 'points', got 'voxels'"
    ):
        Element("x", linear, needs="voxels")  # type: ignore[arg-type]
    with pytest.raises(
        OptionError, match=r"masses of an element must be one or both of .* got \(\)"
    ):
        Element("x", linear, masses=())
