"""Defects counted by hand; splits, orientations and collapses that do not change the shape."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve.surface.remesh import boundary_faces
from pcretrieve.surface.repair import split_non_manifold
from pcretrieve.surface.topology import Defects, compact, components, defects, edges_of, orient_faces
from pcretrieve.values import TriangleMesh

SOUND = Defects(0, 0, 0, 0, 0, 1)

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


def boundary(solid: NDArray[np.bool_], bend: float = 0.0) -> TriangleMesh:
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


def random_solid(seed: int, share: float) -> TriangleMesh:
    """Random cubes with perturbed corners: many non-manifold edges, at various angles."""
    return boundary(np.random.default_rng(seed).random((4, 4, 4)) < share, bend=0.1)


def cavity_and_notch() -> TriangleMesh:
    """A cube with a cavity inside and a notch in one side, which meet along an edge.

    The body hangs together around both ends of that edge, so that each of them stays in one fan.
    """
    solid = np.ones((3, 3, 3), dtype=bool)
    solid[1, 1, 1] = solid[2, 2, 1] = False
    return boundary(solid)


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


def test_two_fans_of_an_open_surface_that_share_a_vertex() -> None:
    bow_tie = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]]),
        np.array([[0, 1, 2], [0, 3, 4]], dtype=np.int32),
    )
    assert defects(bow_tie) == Defects(6, 0, 1, 0, 0, 1)


def test_defects_in_words() -> None:
    assert str(SOUND) == "none"
    assert str(defects(without_faces(shapes.tetrahedron(), 0))) == "3 boundary edges"
    assert str(Defects(1, 2, 3, 4, 5, 6)) == (
        "1 boundary edges, 2 non-manifold edges, 3 non-manifold vertices, 4 edges between faces of opposite "
        "orientation, 5 degenerate or duplicate faces, 6 components"
    )
    assert str(Defects(0, 0, 0, 0, 0, 0)) == "no faces"


def test_edges_of_a_square_cut_in_two() -> None:
    edges = edges_of(shapes.square(1).faces)
    assert sorted(edges.use.tolist()) == [1, 1, 1, 1, 2]
    (shared,) = np.flatnonzero(edges.use == 2).tolist()
    assert sorted(edges.ends[shared].tolist()) == [0, 3]
    assert edges.balance[shared] == 0
    assert edges.pairs.tolist() == [edges.around(shared).tolist()]


# --- components ---------------------------------------------------------------------------------------


def test_components_come_by_area_and_loose_vertices_are_none() -> None:
    mesh = shapes.joined(shapes.icosphere(0, 0.5), shapes.icosphere(1, 2.0), shapes.icosphere(0, 1.0))
    mesh = TriangleMesh(np.concatenate([mesh.vertices, np.ones((3, 3))]), mesh.faces)
    assert components(mesh).tolist() == [2] * 20 + [0] * 80 + [1] * 20


def test_a_shared_vertex_joins() -> None:
    assert components(shapes.two_tetrahedra("vertex")).max() == 0


def test_many_components_take_no_time() -> None:
    corners = np.random.default_rng(0).random((30_000, 3, 3))
    soup = TriangleMesh(corners.reshape(-1, 3), np.arange(90_000, dtype=np.int32).reshape(-1, 3))
    piece = components(soup)
    assert np.all(np.diff(soup.face_areas[np.argsort(piece)]) <= 0)


# --- orientation --------------------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", [shapes.body(3), shapes.torus(), shapes.square(8)])
@pytest.mark.parametrize("seed", range(3))
def test_scrambled_faces_are_turned_back(mesh: TriangleMesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scrambled = np.flatnonzero(rng.random(len(mesh.faces)) < 0.3)  # a minority
    answer = orient_faces(shapes.renumbered(turned(mesh, *scrambled), seed))
    assert answer is not None
    back, n_turned = answer
    assert n_turned == len(scrambled)
    assert defects(back).inconsistent_edges == 0
    assert back.volume == pytest.approx(mesh.volume, rel=1e-12, abs=1e-12)


def test_each_patch_keeps_the_side_of_most_of_its_faces() -> None:
    ball = shapes.icosphere(1)
    mesh = shapes.joined(turned(ball, 0, 1, 2), turned(ball, *range(70)))
    answer = orient_faces(mesh)
    assert answer is not None
    assert answer[1] == 3 + 10
    half = len(ball.vertices)
    inner, outer = (
        compact(answer[0].vertices, answer[0].faces[part]) for part in (slice(80, 160), slice(80))
    )
    assert half == len(inner.vertices) == len(outer.vertices)
    assert outer.volume == pytest.approx(ball.volume)
    assert inner.volume == pytest.approx(-ball.volume)


def test_where_as_many_want_either_side_the_first_face_decides() -> None:
    for first in (0, 1):
        square = turned(shapes.square(1), first)
        answer = orient_faces(square)
        assert answer is not None
        assert answer[1] == 1
        assert answer[0].faces[0].tolist() == square.faces[0].tolist()


@pytest.mark.parametrize("seed", range(3))
def test_a_mobius_strip_has_one_side(seed: int) -> None:
    strip = shapes.mobius_strip()
    assert orient_faces(shapes.renumbered(strip, seed)) is None
    assert orient_faces(shapes.joined(shapes.tetrahedron(), strip)) is None


def test_an_annulus_has_two_sides() -> None:
    torus = shapes.torus(12, 8)
    annulus = TriangleMesh(torus.vertices, torus.faces[(torus.faces % 8 < 4).all(axis=1)])
    assert annulus.euler_characteristic == 0
    assert orient_faces(turned(annulus, 0)) is not None


# --- cutting apart ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("shared", "n_shared"), [("edge", 2), ("vertex", 1)])
def test_two_tetrahedra_come_apart(shared: str, n_shared: int) -> None:
    mesh = shapes.two_tetrahedra("edge" if shared == "edge" else "vertex")
    split = split_non_manifold(mesh)
    assert len(split.vertices) == len(mesh.vertices) + n_shared
    assert defects(split) == Defects(0, 0, 0, 0, 0, 2)
    assert split.euler_characteristic == 4
    for piece in (0, 1):
        one = compact(split.vertices, split.faces[components(split) == piece])
        assert not defects(one)
        assert one.volume == pytest.approx(1 / 6)


@pytest.mark.parametrize("mesh", [shapes.body(2), shapes.torus(), shapes.square(3), shapes.mobius_strip()])
def test_a_manifold_is_left_alone(mesh: TriangleMesh) -> None:
    split = split_non_manifold(mesh)
    # Vertices may come in another order; the faces run through the same points.
    assert len(split.vertices) == len(mesh.vertices)
    assert (split.vertices[split.faces] == mesh.vertices[mesh.faces]).all()


def test_three_pages_come_apart() -> None:
    split = split_non_manifold(three_pages())
    assert defects(split) == Defects(9, 0, 0, 0, 0, 3)
    assert split.area == pytest.approx(three_pages().area)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("share", [0.3, 0.6])
def test_boundaries_of_random_solids_become_manifolds(seed: int, share: float) -> None:
    mesh = random_solid(seed, share)
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


def test_an_edge_whose_ends_both_stay_in_one_fan() -> None:
    mesh = cavity_and_notch()
    assert defects(mesh) == Defects(0, 1, 0, 0, 0, 1)
    split = split_non_manifold(mesh)
    assert not defects(split)
    # A vertex in the middle for each of two pairs of faces, and each of these four faces cut in two.
    assert len(split.vertices) == len(mesh.vertices) + 2
    assert len(split.faces) == len(mesh.faces) + 4
    assert split.euler_characteristic == 2  # the cavity now opens into the notch
    assert split.area == pytest.approx(mesh.area, rel=1e-14)
    assert split.volume == pytest.approx(25, rel=1e-14)


def test_faces_on_top_of_one_another_close_up_all_the_same() -> None:
    # A long tetrahedron minus a short one on the same base: the faces around its edges do not bound an
    # interior, and every pairing is allowed.
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [2, 0, 0.5], [1, 1, 0.5]])
    long = np.array([[0, 1, 3], [1, 0, 4], [3, 4, 0], [4, 3, 1]], dtype=np.int32)
    short = np.where(long == 3, 2, long)[:, ::-1]
    mesh = TriangleMesh(vertices, np.concatenate([long, short]))
    assert defects(mesh).non_manifold_edges
    split = split_non_manifold(mesh)
    assert defects(split).non_manifold_edges == defects(split).boundary_edges == 0
    assert split.volume == pytest.approx(mesh.volume, abs=1e-14)
