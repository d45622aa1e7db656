"""The value types: invalid arguments, immutability, and derived quantities."""

import pickle
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapes
from scipy.sparse import csc_array, eye_array
from scipy.sparse.csgraph import dijkstra

from pcretrieve import errors
from pcretrieve.arrays import (
    DOUBLE_OFFSET,
    SINGLE_OFFSET,
    Frame,
    power_of_two,
    tangent_axes,
    unit_vectors,
)
from pcretrieve.errors import InputError, PcretrieveError, Stage
from pcretrieve.retrieval import fit_whitening
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import (
    Eigenpairs,
    LaplaceBeltrami,
    ModalSpectrum,
    Neighbors,
    PointCloud,
    Shape,
    Signature,
    SignatureTable,
    Step,
    Surface,
    TriangleMesh,
    bounding_diagonal,
)
from pcretrieve.values.geometry import edge_graph

CORNERS = np.eye(3)
IDENTITY = csc_array(eye_array(3))
ONE = Signature(np.ones(1), "x")


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (PointCloud, [np.zeros((4, 2))], "points must have shape (n, 3), got (4, 2)"),
        (
            PointCloud,
            ["bunny"],
            "points must be an array of numbers, got one of type <U5",
        ),
        (
            PointCloud,
            [[[1, 2, 3], [4, 5]]],
            "points must be an array of numbers: setting an array element",
        ),
        (
            PointCloud,
            [[[0, np.nan, np.inf]]],
            "points must be finite, got 2 values that are NaN or infinite",
        ),
        (
            PointCloud,
            [CORNERS, CORNERS[:2]],
            "normals must have shape (3, 3), got (2, 3)",
        ),
        (
            PointCloud,
            [CORNERS, np.diag([1.0, 2, 0])],
            "normals must have unit length, got 2 of 3 that have",
        ),
        (
            PointCloud,
            [CORNERS, None, [0, 0]],
            "viewpoints must have shape (3, 3), got (2,)",
        ),
        (
            TriangleMesh,
            [CORNERS, np.zeros((1, 4))],
            "faces must have shape (n, 3), got (1, 4)",
        ),
        (
            TriangleMesh,
            [CORNERS, [[0, 1, 3]]],
            "faces must name vertices 0 to 2, got 0 to 3",
        ),
        (
            TriangleMesh,
            [CORNERS, [[-1, 1, 2]]],
            "faces must name vertices 0 to 2, got -1 to 2",
        ),
        (
            TriangleMesh,
            [CORNERS, [[0, 0.5, 2**32]]],
            "faces must be whole numbers below 2³¹, got 2 that are",
        ),
        (
            LaplaceBeltrami,
            [IDENTITY, csc_array((3, 2))],
            "of one size, got shapes (3, 3) and (3, 2)",
        ),
        (
            LaplaceBeltrami,
            [IDENTITY * np.nan, IDENTITY],
            "stiffness and mass must be finite, got NaN or inf",
        ),
        (
            LaplaceBeltrami,
            [IDENTITY, 0 * IDENTITY],
            "mass must sum up to a positive area, got 0",
        ),
        (
            LaplaceBeltrami,
            [IDENTITY, IDENTITY, 0, [0, 1]],
            "nodes must have shape (3), got (2,)",
        ),
        (
            Eigenpairs,
            [np.zeros(2), np.zeros((3, 1)), IDENTITY],
            "must have shape (3, 2), got (3, 1)",
        ),
        (
            ModalSpectrum,
            [np.zeros(2), np.zeros((2, 3)), 1.0],
            "moments must have shape (2, 2), got (2, 3)",
        ),
        (Signature, [np.zeros((2, 2)), "x"], "values must have shape (n), got (2, 2)"),
        (Signature, [[1.0, -0.5], "x"], "signature values must be positive, got -0.5"),
        (
            Signature,
            [[1, -1], "x", "", None, "histograms"],
            "bins of a histogram must not be negative, got",
        ),
        (
            Signature,
            [[1], "x", "", None, "angles"],
            "metric must be one of logarithms, values, histograms,",
        ),
        (SignatureTable, [("a", "a"), np.ones((2, 3)), "x"], "ids must be distinct"),
        (
            SignatureTable,
            [("a",), np.ones((2, 3)), "x"],
            "values must have shape (1, n), got (2, 3)",
        ),
        (
            SignatureTable,
            [("a",), [[1.0, 0.0]], "x"],
            "signature values must be positive, got 0.0",
        ),
        (
            SignatureTable,
            [("a",), [[1]], "x", "", ("b", "c")],
            "labels must be as many as ids (1), got 2",
        ),
        (ONE.distance, [1], "the other signature must be of the type Signature, got int"),
        (
            ONE.distance,
            [Signature(np.ones(1), "y")],
            "must be made by the same options, got ('x',",
        ),
        (
            ONE.distance,
            [Signature(np.ones(1), "x", "other")],
            "must be made by the same options",
        ),
        (
            ONE.distance,
            [Signature(np.ones(1), "x", unit="m")],
            "must be made by the same options",
        ),
        (
            ONE.distance,
            [Signature(np.ones(1), "x", metric="values")],
            "must be made by the same options",
        ),
        (
            eigenpairs,
            [CORNERS],
            "operator must be of the type LaplaceBeltrami, got ndarray",
        ),
        (
            ModalSpectrum.of,
            [1],
            "pairs must be of the type Eigenpairs or ModalSpectrum, got int",
        ),
        (Surface, [0.0], "the area of a surface must be positive and finite, got 0.0"),
        (Shape, [()], "a shape must have at least 1 surface, got none"),
        (Neighbors, [("a", "b"), np.zeros(3)], "distances must have shape (2), got (3,)"),
        (Neighbors, [("a", "a"), np.zeros(2)], "ids must be distinct"),
        (
            Neighbors,
            [("a", "b"), [0.0, np.nan]],
            "distances must be numbers, got 1 values that are NaN",
        ),
        (Neighbors, [("a", "b"), [1.0, 0.5]], "distances must ascend from 0 or more"),
        (Neighbors, [("a", "b"), [-1.0, 0.5]], "distances must ascend from 0 or more"),
        (
            Neighbors,
            [("b", "a"), [0.5, 0.5]],
            "ids of equally distant shapes must be in alphabetical order",
        ),
    ],
)
def test_refuses(kind: type[Any], arguments: list[Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        kind(*arguments)


MESH = shapes.icosphere(2).after(
    Step("made", 0.5, {"faces": 320.0}, ("nothing to note",))
)
CLOUD = PointCloud(CORNERS, CORNERS, np.zeros(3), MESH.provenance)
OPERATOR = laplace_beltrami(MESH)
PAIRS = eigenpairs(OPERATOR, 5)
TABLE = SignatureTable(("a", "b"), np.ones((2, 3)), "x", "L=3", ("cat", None))
VALUES = [
    *(MESH, CLOUD, OPERATOR, PAIRS, TABLE),
    laplace_beltrami(shapes.square(3), boundary="dirichlet"),
    ModalSpectrum.of(PAIRS),
    Surface(2.0, ModalSpectrum.of(PAIRS), MESH, PAIRS),
    Shape((Surface(2.0),), PointCloud(CORNERS), MESH.provenance),
    Signature(np.ones(3), "x", "L=3"),
    Signature(np.array([0.0, -1.5, 2.0]), "x", metric="values"),
    Neighbors(("a", "c", "b"), np.array([0.0, 0.0, np.inf])),
    fit_whitening("pca", np.eye(3), options_digest="L=3"),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_copied_and_locked_also_after_pickling(value: Any) -> None:
    copy = pickle.loads(pickle.dumps(value))
    assert copy == value
    assert repr(copy) == repr(value)
    for name in value.__dataclass_fields__:
        here, there = getattr(value, name), getattr(copy, name)
        if isinstance(here, csc_array):
            assert (here != there).nnz == 0
        else:
            np.testing.assert_array_equal(here, there)
        for array in (here, there):
            assert not (isinstance(array, np.ndarray) and array.flags.writeable), name


@pytest.mark.parametrize(
    ("value", "part"),
    [
        (MESH, {"vertices": 2 * MESH.vertices}),
        (CLOUD, {"normals": None}),
        (OPERATOR, {"stiffness": 2 * OPERATOR.stiffness}),
        (TABLE, {"labels": ("cat", "dog")}),
    ],
)
def test_equal_are_values_of_equal_parts(value: Any, part: dict[str, Any]) -> None:
    assert replace(value) == value
    assert replace(value, **part) != value
    assert value != "a value"
    with pytest.raises(TypeError, match="unhashable"):
        hash(value)


def test_how_a_value_was_made_is_no_part_of_it() -> None:
    for value in (MESH, CLOUD):
        first, second = Step("made", 0.5), Step("clean", 2.0)
        assert value.after(first) == value
        assert value.after(first).after(second).provenance == (
            *value.provenance,
            first,
            second,
        )


def test_whole_numbers_name_faces_whatever_their_type() -> None:
    for dtype in (np.uint8, np.int64, np.float64):
        mesh = TriangleMesh(CORNERS, np.array([[0, 1, 2]], dtype=dtype))
        assert mesh.faces.dtype == np.int32
        assert mesh.faces.tolist() == [[0, 1, 2]]


def test_points_keep_what_belongs_to_them() -> None:
    seen_at_once = PointCloud(CORNERS, viewpoints=np.array([1.0, 2, 3]))
    assert seen_at_once == PointCloud(CORNERS, viewpoints=np.array([[1.0, 2, 3]] * 3))
    cloud = PointCloud(CORNERS, CORNERS[::-1], CORNERS * 5).select(np.array([2, 0]))
    assert cloud == PointCloud(CORNERS[[2, 0]], CORNERS[[0, 2]], 5 * CORNERS[[2, 0]])


KINDS = [kind for kind in vars(errors).values() if isinstance(kind, type)]


@pytest.mark.parametrize(
    "error", [kind for kind in KINDS if issubclass(kind, PcretrieveError)]
)
def test_errors_keep_their_place_through_pickling(error: type[PcretrieveError]) -> None:
    copy = pickle.loads(
        pickle.dumps(error("no closed surface", stage=Stage.REMESH, shape_id="T17"))
    )
    assert type(copy) is error
    assert (copy.message, copy.stage, copy.shape_id) == (
        "no closed surface",
        Stage.REMESH,
        "T17",
    )
    assert str(copy) == "[T17 / remesh] no closed surface"


def test_errors_of_a_stage_know_it() -> None:
    assert str(errors.SpectrumError("no answer")) == "[spectrum] no answer"
    assert str(errors.InputError("no file")) == "no file"
    assert isinstance(errors.OptionError("what?"), ValueError)


def test_measures_of_a_tetrahedron() -> None:
    mesh = shapes.tetrahedron()
    assert mesh.area == pytest.approx(3 / 2 + np.sqrt(3) / 2, rel=1e-14)
    assert mesh.volume == pytest.approx(1 / 6, rel=1e-14)
    assert mesh.diagonal == pytest.approx(np.sqrt(3), rel=1e-14)
    assert PointCloud(np.zeros((0, 3))).diagonal == 0
    assert TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]).volume == pytest.approx(
        -1 / 6, rel=1e-14
    )


@pytest.mark.parametrize(
    ("mesh", "euler"),
    [
        (shapes.tetrahedron(), 2),
        (shapes.icosphere(2), 2),
        (shapes.torus(), 0),
        (shapes.square(3), 1),
        (shapes.mobius_strip(), 0),
        (shapes.two_tetrahedra("edge"), 6 - 11 + 8),
        (shapes.two_tetrahedra("vertex"), 7 - 12 + 8),
        (shapes.joined(shapes.torus(), shapes.icosphere(1)), 2),
        (TriangleMesh(np.zeros((5, 3)), np.zeros((0, 3), dtype=np.int32)), 0),
        # A vertex in no face does not count.
        (TriangleMesh(np.ones((4, 3)), np.array([[0, 1, 2]], dtype=np.int32)), 1),
    ],
)
def test_euler_characteristic(mesh: TriangleMesh, euler: int) -> None:
    assert mesh.euler_characteristic == euler


def test_rigid_motion_moves_no_measure_and_scale_moves_each_by_its_power() -> None:
    mesh = shapes.body(3)
    moved = shapes.renumbered(shapes.moved(mesh, 1, scale=1000), 1)
    assert moved.area == pytest.approx(1e6 * mesh.area, rel=1e-12)
    assert moved.volume == pytest.approx(1e9 * mesh.volume, rel=1e-11)
    assert moved.euler_characteristic == mesh.euler_characteristic


def test_flat_faces_have_no_area_to_speak_of_at_any_scale() -> None:
    vertices = np.array(
        [[0, 0, 0], [1, 0, 0], [0.5, 1e-10, 0], [0.5, 1e-7, 0], [0, 0, 0]]
    )
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 4, 1], [0, 0, 1]])
    for scale in (1e-6, 1.0, 1e6):
        assert TriangleMesh(scale * vertices, faces).flat_faces.tolist() == [
            True,
            False,
            True,
            True,
        ]


# --- the coordinates that single precision can bear ---------------------------------------------------

POINTS = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 3))


@pytest.mark.parametrize("unit", [1e-49, 3e-5, 1.0, 7e8, 1e49])
@pytest.mark.parametrize("place", [0.0, -0.3, 40.0, 1e7])
def test_points_have_one_size_and_lie_near_the_origin(unit: float, place: float) -> None:
    points = (POINTS + place) * unit
    for offset in (SINGLE_OFFSET, DOUBLE_OFFSET):
        framed = Frame.around(points, offset=offset).inward(points)
        assert 0.5 <= bounding_diagonal(framed) < 1
        middle = (framed.min(axis=0) + framed.max(axis=0)) / 2
        assert (np.abs(middle) <= offset).all()


@pytest.mark.parametrize("unit", [1e-49, 1.0, 1e49])
def test_round_the_origin_no_digit_is_lost(unit: float) -> None:
    points = POINTS * unit
    frame = Frame.around(points)
    np.testing.assert_array_equal(frame.outward(frame.inward(points)), points)
    doubled = Frame.around(2 * points)
    np.testing.assert_array_equal(doubled.inward(2 * points), frame.inward(points))


def test_points_in_one_place_have_a_frame() -> None:
    for points in (np.zeros((0, 3)), np.full((3, 3), 1e16)):
        assert np.abs(Frame.around(points).inward(points)).max(initial=0) == 0


def test_the_power_of_two_above_a_length() -> None:
    assert [power_of_two(length) for length in (0.0, 0.5, 0.75, 1.9, 2.0)] == [
        1,
        1,
        1,
        2,
        4,
    ]


def test_vertices_at_one_place_are_linked() -> None:
    mesh = TriangleMesh(
        np.array([[0, 0, 0], [0, 0, 0], [1.0, 0, 0]]), np.array([[0, 1, 2]])
    )
    apart = dijkstra(edge_graph(mesh), directed=False)
    np.testing.assert_allclose(apart, [[0, 0, 1], [0, 0, 1], [1, 1, 0]], atol=1e-12)


def test_directions_have_unit_length_and_their_tangent_axes_are_orthogonal() -> None:
    vectors = np.random.default_rng(0).normal(size=(50, 3))
    vectors[0] = 0
    made = unit_vectors(vectors)
    assert not made[0].any(), "zero has no direction"
    np.testing.assert_allclose(np.linalg.norm(made[1:], axis=1), 1)
    frames = np.stack([made[1:], *tangent_axes(made[1:])], axis=1)  # (49, 3, 3)
    np.testing.assert_allclose(
        frames @ frames.transpose(0, 2, 1), [np.eye(3)] * 49, atol=1e-12
    )
