"""Defects counted by hand; splits, orientations and collapses that do not change the shape."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve.surface.repair import split_non_manifold
from pcretrieve.surface.tetwild import boundary_faces
from pcretrieve.surface.topology import SOUND, Defects, compact, components, defects, orient_faces
from pcretrieve.values import TriangleMesh

# The six tetrahedra around the long diagonal of a cube whose corners are numbered x + 2 y + 4 z.
CUBE = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])


def without_faces(mesh: TriangleMesh, *faces: int) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0))


def with_faces(mesh: TriangleMesh, *faces: list[int]) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, np.concatenate([mesh.faces, np.array(faces, dtype=np.int32)]))


def turned(mesh: TriangleMesh, *faces: int) -> TriangleMesh:
    corners = mesh.faces.copy()
    corners[list(faces)] = corners[list(faces), ::-1]
    return TriangleMesh(mesh.vertices, corners)


def three_pages() -> TriangleMesh:
    """Three triangles that share one edge, as the pages of a book do."""
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]])
    return TriangleMesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], dtype=np.int32))


def boundary(solid: NDArray[np.bool_], bend: float) -> TriangleMesh:
    """The boundary of a set of cubes, each of six tetrahedra; corners are shifted by `bend` at most."""
    side = max(solid.shape) + 1
    corner = np.arange(8)
    offset = (corner & 1) + side * ((corner >> 1) & 1) + side**2 * (corner >> 2)  # (8,)
    x, y, z = np.nonzero(solid)
    cubes = (x + side * y + side**2 * z)[:, None] + offset  # (c, 8)
    number = np.arange(side**3)
    nodes = np.column_stack([number % side, number // side % side, number // side**2])
    shift = bend * np.random.default_rng(0).random(nodes.shape)
    return compact(nodes + shift, boundary_faces(nodes + shift, cubes[:, CUBE].reshape(-1, 4)))


# --- counting -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "found"),
    [
        (shapes.tetrahedron(), SOUND),
        (shapes.icosphere(2), SOUND),
        (shapes.torus(), SOUND),
        (without_faces(shapes.tetrahedron(), 0), Defects(3, 0, 0, 0, 0, 1)),
        (without_faces(shapes.tetrahedron(), 0, 1), Defects(4, 0, 0, 0, 0, 1)),
        (shapes.square(4), Defects(16, 0, 0, 0, 0, 1)),
        (turned(shapes.tetrahedron(), 2), Defects(0, 0, 0, 3, 0, 1)),
        (shapes.two_tetrahedra("edge"), Defects(0, 1, 0, 0, 0, 1)),
        (shapes.two_tetrahedra("vertex"), Defects(0, 0, 1, 0, 0, 1)),
        (three_pages(), Defects(6, 1, 0, 0, 0, 1)),
        (shapes.joined(shapes.tetrahedron(), shapes.torus()), Defects(0, 0, 0, 0, 0, 2)),
        # A face twice: three faces on each of its edges.
        (with_faces(shapes.tetrahedron(), [0, 1, 3]), Defects(0, 3, 0, 0, 1, 1)),
        # Two faces back to back, along two sides of a square.
        (with_faces(shapes.square(1), [0, 1, 2], [0, 2, 1]), Defects(2, 2, 0, 0, 1, 1)),
        # No area: a repeated vertex.
        (with_faces(shapes.tetrahedron(), [0, 0, 1]), Defects(1, 1, 0, 0, 1, 1)),
        # A strip of four cells across with a half twist.
        (shapes.mobius_strip(30, 4), Defects(60, 0, 0, 4, 0, 1)),
        (TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int32)), Defects(0, 0, 0, 0, 0, 0)),
    ],
)
def test_defects(mesh: TriangleMesh, found: Defects) -> None:
    assert defects(mesh) == found
    assert defects(shapes.renumbered(mesh, seed=1)) == found
    assert bool(defects(mesh)) == (found != SOUND)


# --- orientation --------------------------------------------------------------------------------------


def test_scrambled_faces_are_turned_back() -> None:
    for mesh in (shapes.body(3), shapes.torus(), shapes.square(8)):
        scrambled = np.flatnonzero(np.random.default_rng(0).random(len(mesh.faces)) < 0.3)  # a minority
        answer = orient_faces(shapes.renumbered(turned(mesh, *scrambled), 0))
        assert answer is not None
        back, n_turned = answer
        assert n_turned == len(scrambled)
        assert defects(back).inconsistent_edges == 0
        assert back.volume == pytest.approx(mesh.volume, rel=1e-12, abs=1e-12)


def test_a_mobius_strip_has_one_side() -> None:
    strip = shapes.mobius_strip()
    assert orient_faces(shapes.renumbered(strip, 0)) is None
    assert orient_faces(shapes.joined(shapes.tetrahedron(), strip)) is None


# --- cutting apart ------------------------------------------------------------------------------------


def test_a_manifold_is_left_alone() -> None:
    for mesh in (shapes.body(2), shapes.torus(), shapes.square(3), shapes.mobius_strip()):
        split = split_non_manifold(mesh)
        # Vertices may come in another order; the faces run through the same points.
        assert len(split.vertices) == len(mesh.vertices)
        assert (split.vertices[split.faces] == mesh.vertices[mesh.faces]).all()


@pytest.mark.parametrize("seed", range(2))
def test_boundaries_of_random_solids_become_manifolds(seed: int) -> None:
    """Random cubes with perturbed corners: many non-manifold edges, at various angles."""
    mesh = boundary(np.random.default_rng(seed).random((4, 4, 4)) < 0.3, bend=0.1)
    before = defects(mesh)
    assert before.non_manifold_edges
    assert before.boundary_edges == before.inconsistent_edges == before.degenerate_faces == 0
    split = split_non_manifold(mesh)
    assert defects(split) == Defects(0, 0, 0, 0, 0, defects(split).components)
    assert split.area == pytest.approx(mesh.area, rel=1e-12)
    assert split.volume == pytest.approx(mesh.volume, rel=1e-12)
    piece = components(split)
    for number in range(piece.max() + 1):
        one = compact(split.vertices, split.faces[piece == number])
        assert not defects(one)
        assert one.euler_characteristic in range(2, -100, -2)  # 2 − 2 genus


def test_components_come_by_area_and_loose_vertices_are_none() -> None:
    mesh = shapes.joined(shapes.icosphere(0, 0.5), shapes.icosphere(1, 2.0), shapes.icosphere(0, 1.0))
    mesh = TriangleMesh(np.concatenate([mesh.vertices, np.ones((3, 3))]), mesh.faces)
    assert components(mesh).tolist() == [2] * 20 + [0] * 80 + [1] * 20
