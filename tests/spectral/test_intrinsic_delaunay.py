"""The intrinsic Delaunay Laplacian, on Delaunay, sheared, degenerate and non-manifold triangulations."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import FloatArray, LaplaceBeltrami, TriangleMesh


def delaunay(mesh: TriangleMesh) -> LaplaceBeltrami:
    return laplace_beltrami(mesh, "intrinsic-delaunay")


def eigenvalues(operator: LaplaceBeltrami) -> FloatArray:
    return eigenpairs(operator, 20).eigenvalues[1:]


def assert_same(one: LaplaceBeltrami, other: LaplaceBeltrami) -> None:
    assert abs(one.stiffness - other.stiffness).max() < 1e-12
    assert abs(one.mass - other.mass).max() < 1e-12


@pytest.mark.parametrize("mesh", [shapes.icosphere(3), shapes.square(6)], ids=["sphere", "square"])
def test_on_a_delaunay_surface_it_is_the_linear_one(mesh: TriangleMesh) -> None:
    assert_same(delaunay(mesh), laplace_beltrami(mesh, mass="lumped"))


def test_it_flips_the_edges_that_should_be() -> None:
    # After the shear the diagonal of every cell is its longer one; with the shorter one it is Delaunay.
    square = shapes.square(5)
    sheared = square.vertices + square.vertices[:, 1:2] * [1, 0, 0]
    lower, upper = square.faces[: len(square.faces) // 2], square.faces[len(square.faces) // 2 :]
    (a, b, c), d = lower.T, upper[:, 2]
    flipped = TriangleMesh(sheared, np.concatenate([np.column_stack([a, b, d]), np.column_stack([b, c, d])]))
    long = TriangleMesh(sheared, square.faces)
    assert abs(laplace_beltrami(long).stiffness - laplace_beltrami(flipped).stiffness).max() > 0.4
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
    a, b = mesh.faces[30][[0, 1]]
    middle = len(mesh.vertices)
    third = mesh.faces[30][2]
    vertices = np.concatenate([mesh.vertices, mesh.vertices[[a, b]].mean(axis=0, keepdims=True)])
    faces = np.concatenate(
        [np.delete(mesh.faces, 30, axis=0), [[a, middle, third], [middle, b, third], [a, b, middle]]]
    )
    slit = TriangleMesh(vertices, faces)
    assert slit.flat_faces.sum() == 1
    with pytest.raises(DegenerateMeshError, match="every face must have an area"):
        laplace_beltrami(slit)
    operator = delaunay(slit)
    assert operator.area == pytest.approx(1, rel=1e-3)
    np.testing.assert_allclose(eigenvalues(operator), eigenvalues(delaunay(mesh)), rtol=0.02)


@pytest.mark.parametrize(
    ("places", "faces", "message"),
    [
        (np.eye(3), [[0, 1, 2], [0, 1, 1]], "every face must have three corners, got 1 that name one twice"),
        (np.outer(range(3), [1, 2, 3]), [[0, 1, 2]], "must have an area, got only faces without"),
    ],
)
def test_refuses(places: FloatArray, faces: list[list[int]], message: str) -> None:
    with pytest.raises(DegenerateMeshError, match=message):
        delaunay(TriangleMesh(places, np.array(faces, dtype=np.int32)))
