"""The value types: invalid arguments, immutability, and derived quantities."""

import pickle
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapes
from scipy.sparse import csc_array, eye_array

from pcretrieve import errors
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
)

CORNERS = np.eye(3)
IDENTITY = csc_array(eye_array(3))


# --- what they refuse ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (PointCloud, [np.zeros((4, 2))], "points must have shape (n, 3), got (4, 2)"),
        (PointCloud, [np.zeros(3)], "points must have shape (n, 3), got (3,)"),
        (PointCloud, ["bunny"], "points must be an array of numbers, got one of type <U5"),
        (PointCloud, [[[1, 2, 3], [4, 5]]], "points must be an array of numbers: setting an array element"),
        (PointCloud, [CORNERS * 1j], "points must be an array of numbers, got one of type complex128"),
        (
            PointCloud,
            [[[0, 0, np.nan], [np.inf, 0, -np.inf]]],
            "points must be finite, got 3 values that are NaN or infinite",
        ),
        (PointCloud, [CORNERS, CORNERS[:2]], "normals must have shape (3, 3), got (2, 3)"),
        (
            PointCloud,
            [CORNERS, np.diag([1.0, 2.0, 0.0])],
            "normals must have unit length, got 2 of 3 that have not: divide them by their length",
        ),
        (PointCloud, [CORNERS, None, CORNERS[:2]], "viewpoints must have shape (3, 3), got (2, 3)"),
        (PointCloud, [CORNERS, None, [0, 0]], "viewpoints must have shape (3, 3), got (2,)"),
        (TriangleMesh, [CORNERS, np.zeros((1, 4))], "faces must have shape (n, 3), got (1, 4)"),
        (TriangleMesh, [CORNERS, [[0, 1, 3]]], "faces must name vertices 0 to 2, got 0 to 3"),
        (TriangleMesh, [CORNERS, [[-1, 1, 2]]], "faces must name vertices 0 to 2, got -1 to 2"),
        (TriangleMesh, [CORNERS, [[0, 1, 0.5]]], "faces must be whole numbers below 2³¹, got 1 that are not"),
        (
            TriangleMesh,
            [CORNERS, [[0, 1, 2**32]]],
            "faces must be whole numbers below 2³¹, got 1 that are not",
        ),
        (
            LaplaceBeltrami,
            [IDENTITY, csc_array((3, 2))],
            "stiffness and mass must be square and of one size, got shapes (3, 3) and (3, 2)",
        ),
        (
            LaplaceBeltrami,
            [IDENTITY * np.nan, IDENTITY],
            "stiffness and mass must be finite, got NaN or infinite entries",
        ),
        (LaplaceBeltrami, [IDENTITY, 0 * IDENTITY], "mass must sum up to a positive area, got 0"),
        (LaplaceBeltrami, [IDENTITY, IDENTITY, 0, [0, 1]], "nodes must have shape (3), got (2,)"),
        (
            Eigenpairs,
            [np.zeros(2), np.zeros((3, 1)), IDENTITY],
            "eigenvectors must have shape (3, 2), got (3, 1)",
        ),
        (ModalSpectrum, [np.zeros(2), np.zeros((2, 3)), 1.0], "moments must have shape (2, 2), got (2, 3)"),
        (Signature, [np.zeros((2, 2)), "x"], "values must have shape (n), got (2, 2)"),
        (SignatureTable, [("a", "a"), np.ones((2, 3)), "x"], "ids must be distinct"),
        (SignatureTable, [("a",), np.ones((2, 3)), "x"], "values must have shape (1, n), got (2, 3)"),
        (SignatureTable, [("a",), [[1.0, 0.0]], "x"], "signature values must be positive, got 0.0"),
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
        (
            Signature,
            [[1, np.nan], "x", "", None, "values"],
            "values must be finite, got 1 values that are NaN",
        ),
        (Surface, [0.0], "the area of a surface must be positive and finite, got 0.0"),
        (Shape, [()], "a shape must have at least 1 surface, got none"),
        (
            SignatureTable,
            [("a",), np.ones((1, 2)), "x", "", ("cat", "dog")],
            "labels must be as many as ids (1), got 2",
        ),
        (Neighbors, [("a", "b"), np.zeros(3)], "distances must have shape (2), got (3,)"),
        (Neighbors, [("a", "a"), np.zeros(2)], "ids must be distinct"),
        (Neighbors, [("a", "b"), [0.0, np.nan]], "distances must be numbers, got 1 values that are NaN"),
        (Neighbors, [("a", "b"), [1.0, 0.5]], "distances must ascend from 0 or more"),
        (Neighbors, [("a", "b"), [-1.0, 0.5]], "distances must ascend from 0 or more"),
        (Neighbors, [("b", "a"), [0.5, 0.5]], "ids of equally distant shapes must be in alphabetical order"),
    ],
)
def test_refuses(kind: type[Any], arguments: list[Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        kind(*arguments)


# --- immutability -------------------------------------------------------------------------------------


def everything() -> list[Any]:
    mesh = shapes.icosphere(2).after(Step("made", 0.5, {"faces": 320.0}, ("nothing to note",)))
    operator = laplace_beltrami(mesh)
    pairs = eigenpairs(operator, 5)
    return [
        mesh,
        PointCloud(CORNERS, CORNERS, np.zeros(3), mesh.provenance),
        operator,
        laplace_beltrami(shapes.square(3), boundary="dirichlet"),
        pairs,
        ModalSpectrum.of(pairs),
        Surface(2.0, ModalSpectrum.of(pairs), mesh, pairs),
        Shape((Surface(2.0),), PointCloud(CORNERS), mesh.provenance),
        Signature(np.ones(3), "x", "L=3"),
        Signature(np.array([0.0, -1.5, 2.0]), "x", metric="values"),
        SignatureTable(("a", "b"), np.ones((2, 3)), "x", "L=3", ("cat", None)),
        Neighbors(("a", "c", "b"), np.array([0.0, 0.0, np.inf])),
        fit_whitening("pca", np.eye(3), options_digest="L=3"),
    ]


def arrays(value: Any) -> dict[str, Any]:
    parts = {name: getattr(value, name) for name in value.__dataclass_fields__}
    return {name: part for name, part in parts.items() if isinstance(part, np.ndarray)}


@pytest.mark.parametrize("value", everything(), ids=lambda value: type(value).__name__)
def test_frozen_copied_and_locked_also_after_pickling(value: Any) -> None:
    copy = pickle.loads(pickle.dumps(value))
    for one in (value, copy):
        for name, array in arrays(one).items():
            assert not array.flags.writeable, name
        for name in one.__dataclass_fields__:
            with pytest.raises(AttributeError):
                setattr(one, name, None)
    assert copy == value
    for name in value.__dataclass_fields__:
        here, there = getattr(value, name), getattr(copy, name)
        if isinstance(here, csc_array):
            assert (here != there).nnz == 0
        else:
            np.testing.assert_array_equal(here, there)
    line = repr(value)
    assert repr(copy) == line
    assert line.startswith(type(value).__name__ + "(")
    assert "\n" not in line or type(value).__name__ == "Whitening"  # whose arrays are shown


# One part of each value, and another content for it.
CHANGES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "TriangleMesh": ("vertices", lambda vertices: 2 * vertices),
    "PointCloud": ("normals", lambda normals: None),
    "LaplaceBeltrami": ("stiffness", lambda stiffness: 2 * stiffness),
    "Eigenpairs": ("eigenvectors", np.negative),
    "ModalSpectrum": ("overlaps", lambda overlaps: None),
    "Surface": ("eigenpairs", lambda pairs: None),
    "Shape": ("surfaces", lambda surfaces: 2 * surfaces),
    "Signature": ("deviation", lambda deviation: np.ones(3)),
    "SignatureTable": ("labels", lambda labels: ("cat", "dog")),
    "Neighbors": ("distances", lambda distances: distances + 1),
    "Whitening": ("shrinkage", lambda shrinkage: shrinkage / 2),
}


@pytest.mark.parametrize("value", everything(), ids=lambda value: type(value).__name__)
def test_equal_are_values_of_equal_parts(value: Any) -> None:
    name, change = CHANGES[type(value).__name__]
    parts = {part: getattr(value, part) for part in value.__dataclass_fields__}
    assert type(value)(**parts) == value
    assert type(value)(**parts | {name: change(parts[name])}) != value
    assert value != tuple(parts.values())
    with pytest.raises(TypeError, match="unhashable"):
        hash(value)


def test_how_a_value_was_made_is_no_part_of_it() -> None:
    mesh = shapes.icosphere(1)
    cloud = PointCloud(mesh.vertices)
    first, second = Step("made", 0.5), Step("clean", 2.0)
    for value in (mesh, cloud):
        assert value.after(first) == value
        assert value.after(first).after(second).provenance == (*value.provenance, first, second)


def test_whole_numbers_name_faces_whatever_their_type() -> None:
    for dtype in (np.uint8, np.int64, np.float64):
        mesh = TriangleMesh(CORNERS, np.array([[0, 1, 2]], dtype=dtype))
        assert mesh.faces.dtype == np.int32
        assert mesh.faces.tolist() == [[0, 1, 2]]


def test_one_sensor_saw_all_points() -> None:
    cloud = PointCloud(CORNERS, viewpoints=np.array([1.0, 2.0, 3.0]))
    assert cloud.viewpoints is not None
    assert cloud.viewpoints.tolist() == [[1, 2, 3]] * 3


def test_selected_points_keep_what_belongs_to_them() -> None:
    cloud = PointCloud(CORNERS, CORNERS[::-1], CORNERS * 5).select(np.array([2, 0]))
    assert cloud.normals is not None
    assert cloud.viewpoints is not None
    assert cloud.points.tolist() == CORNERS[[2, 0]].tolist()
    assert cloud.normals.tolist() == CORNERS[[0, 2]].tolist()
    assert cloud.viewpoints.tolist() == (5 * CORNERS[[2, 0]]).tolist()


@pytest.mark.parametrize(
    "error",
    [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, PcretrieveError)],
    ids=lambda error: str(error.__name__),
)
def test_errors_keep_their_place_through_pickling(error: type[PcretrieveError]) -> None:
    copy = pickle.loads(pickle.dumps(error("no closed surface", stage=Stage.REMESH, shape_id="T17")))
    assert type(copy) is error
    assert (copy.message, copy.stage, copy.shape_id) == ("no closed surface", Stage.REMESH, "T17")
    assert str(copy) == "[T17 / remesh] no closed surface"


def test_errors_of_a_stage_know_it() -> None:
    assert str(errors.SpectrumError("no answer")) == "[spectrum] no answer"
    assert str(errors.InputError("no file")) == "no file"
    assert isinstance(errors.OptionError("what?"), ValueError)


# --- what they measure --------------------------------------------------------------------------------


def test_measures_of_a_tetrahedron() -> None:
    mesh = shapes.tetrahedron()
    assert mesh.area == pytest.approx(3 / 2 + np.sqrt(3) / 2, rel=1e-14)
    assert mesh.volume == pytest.approx(1 / 6, rel=1e-14)
    assert mesh.diagonal == pytest.approx(np.sqrt(3), rel=1e-14)
    assert PointCloud(np.zeros((0, 3))).diagonal == 0
    assert TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]).volume == pytest.approx(-1 / 6, rel=1e-14)


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


@pytest.mark.parametrize("seed", range(3))
def test_rigid_motion_moves_no_measure_and_scale_moves_each_by_its_power(seed: int) -> None:
    mesh = shapes.body(3)
    moved = shapes.renumbered(shapes.moved(mesh, seed, scale=1000), seed)
    assert moved.area == pytest.approx(1e6 * mesh.area, rel=1e-12)
    assert moved.volume == pytest.approx(1e9 * mesh.volume, rel=1e-11)
    assert moved.euler_characteristic == mesh.euler_characteristic


def test_flat_faces_have_no_area_to_speak_of_at_any_scale() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-10, 0], [0.5, 1e-7, 0], [0, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 4, 1], [0, 0, 1]])
    for scale in (1e-6, 1.0, 1e6):
        assert TriangleMesh(scale * vertices, faces).flat_faces.tolist() == [True, False, True, True]
