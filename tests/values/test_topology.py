"""Defects counted by hand; repairs that make one change, leave a note, and do not move the surface."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve.errors import DegenerateMeshError, ReconstructionError
from pcretrieve.surface.tetwild import boundary_faces
from pcretrieve.values import IntArray, TriangleMesh
from pcretrieve.values.repair import (
    denoised,
    largest_component,
    repaired,
    split_non_manifold,
)
from pcretrieve.values.topology import (
    SOUND,
    Defects,
    compact,
    components,
    defects,
    orient_faces,
)

BALL = shapes.icosphere(2)  # 162 vertices, 320 faces


def cut(mesh: TriangleMesh, *faces: int) -> TriangleMesh:
    """Without some faces."""
    return TriangleMesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0))


def with_more(mesh: TriangleMesh, faces: object, vertices: object = ()) -> TriangleMesh:
    added: IntArray = np.reshape(np.asarray(faces, dtype=np.int32), (-1, 3))
    points = np.concatenate(
        [mesh.vertices, np.reshape(np.asarray(vertices, dtype=float), (-1, 3))]
    )
    return TriangleMesh(points, np.concatenate([mesh.faces, added]))


def turned(mesh: TriangleMesh, *faces: int) -> TriangleMesh:
    corners = mesh.faces.copy()
    corners[list(faces)] = corners[list(faces), ::-1]
    return TriangleMesh(mesh.vertices, corners)


def with_caps(mesh: TriangleMesh, n: int) -> TriangleMesh:
    """A ball with n bisected faces, each with a degenerate face that closes the gap at the new vertex."""
    bisected = np.arange(n) * (len(mesh.faces) // n)
    a, b, c = mesh.faces[bisected].T
    middle = len(mesh.vertices) + np.arange(n)
    halves = np.concatenate(
        [np.column_stack(f) for f in ((a, middle, c), (middle, b, c), (a, b, middle))]
    )
    return with_more(
        cut(mesh, *bisected), halves, (mesh.vertices[a] + mesh.vertices[b]) / 2
    )


# The six tetrahedra around the long diagonal of a cube whose corners are numbered x + 2 y + 4 z.
CUBE = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)


def boundary(solid: NDArray[np.bool_], bend: float) -> TriangleMesh:
    """The boundary of a set of cubes, each of six tetrahedra whose corners come in any order.

    bend: largest shift of a corner.
    """
    side = max(solid.shape) + 1
    corner = np.arange(8)
    offset = (corner & 1) + side * ((corner >> 1) & 1) + side**2 * (corner >> 2)  # (8,)
    x, y, z = np.nonzero(solid)
    cubes = (x + side * y + side**2 * z)[:, None] + offset  # (c, 8)
    number = np.arange(side**3)
    nodes = np.column_stack([number % side, number // side % side, number // side**2])
    rng = np.random.default_rng(0)
    nodes = nodes + bend * rng.random(nodes.shape)
    tetrahedra = rng.permuted(cubes[:, CUBE].reshape(-1, 4), axis=1)
    return compact(nodes, boundary_faces(nodes, tetrahedra))


# --- counting -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "found"),
    [
        (shapes.tetrahedron(), SOUND),
        (shapes.icosphere(2), SOUND),
        (shapes.torus(), SOUND),
        (cut(shapes.tetrahedron(), 0), Defects(3, 0, 0, 0, 0, 1)),
        (cut(shapes.tetrahedron(), 0, 1), Defects(4, 0, 0, 0, 0, 1)),
        (shapes.square(4), Defects(16, 0, 0, 0, 0, 1)),
        (turned(shapes.tetrahedron(), 2), Defects(0, 0, 0, 3, 0, 1)),
        (shapes.two_tetrahedra("edge"), Defects(0, 1, 0, 0, 0, 1)),
        (shapes.two_tetrahedra("vertex"), Defects(0, 0, 1, 0, 0, 1)),
        (shapes.joined(shapes.tetrahedron(), shapes.torus()), Defects(0, 0, 0, 0, 0, 2)),
        # A face twice: three faces on each of its edges.
        (with_more(shapes.tetrahedron(), [0, 1, 3]), Defects(0, 3, 0, 0, 1, 1)),
        # Two faces back to back, along two sides of a square.
        (with_more(shapes.square(1), [[0, 1, 2], [0, 2, 1]]), Defects(2, 2, 0, 0, 1, 1)),
        # No area: a repeated vertex.
        (with_more(shapes.tetrahedron(), [0, 0, 1]), Defects(1, 1, 0, 0, 1, 1)),
        # A strip of four cells across with a half twist.
        (shapes.mobius_strip(30, 4), Defects(60, 0, 0, 4, 0, 1)),
        (
            TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int32)),
            Defects(0, 0, 0, 0, 0, 0),
        ),
    ],
)
def test_defects(mesh: TriangleMesh, found: Defects) -> None:
    assert defects(mesh) == found
    assert defects(shapes.renumbered(mesh, seed=1)) == found
    assert bool(defects(mesh)) == (found != SOUND)


# --- orientation --------------------------------------------------------------------------------------


def test_scrambled_faces_are_turned_back() -> None:
    for mesh in (shapes.body(3), shapes.torus(), shapes.square(8)):
        # A minority.
        scrambled = np.flatnonzero(np.random.default_rng(0).random(len(mesh.faces)) < 0.3)
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
    assert (
        before.boundary_edges == before.inconsistent_edges == before.degenerate_faces == 0
    )
    assert mesh.volume > 0
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
    mesh = shapes.joined(
        shapes.icosphere(0, 0.5), shapes.icosphere(1, 2.0), shapes.icosphere(0, 1.0)
    )
    mesh = TriangleMesh(np.concatenate([mesh.vertices, np.ones((3, 3))]), mesh.faces)
    assert components(mesh).tolist() == [2] * 20 + [0] * 80 + [1] * 20


# --- repairs ------------------------------------------------------------------------------------------

REPEATED = "faces that repeat others, or lie back to back"
TWO_FACES = np.array([[0, 1, 2], [1, 2, 3]], dtype=np.int32)


@pytest.mark.parametrize(
    ("broken", "note"),
    [
        (with_more(BALL, [], np.ones((3, 3))), "dropped 3 vertices that are in no face"),
        (with_caps(BALL, 7), "collapsed 14 of 334 faces, flat ones and their neighbours"),
        (
            with_more(BALL, [0, 0, 5]),
            "collapsed 1 of 321 faces, flat ones and their neighbours",
        ),
        (with_more(BALL, BALL.faces[:4]), f"dropped 4 of 324 {REPEATED}"),
        (with_more(BALL, [[0, 1, 2], [0, 2, 1]]), f"dropped 2 of 322 {REPEATED}"),
        (with_more(BALL, BALL.faces[:, ::-1]), f"dropped 320 of 640 {REPEATED}"),
        (
            turned(BALL, *range(20)),
            "turned 20 faces of 320 to agree with their neighbours",
        ),
        (turned(BALL, *range(320)), "turned the surface inside out"),
        (
            shapes.joined(BALL, shapes.icosphere(2, 0.1)),
            "dropped 1 smaller components with 0.99% of the area",
        ),
    ],
)
def test_a_ball_with_defects_is_repaired_to_the_ball(
    broken: TriangleMesh, note: str
) -> None:
    mesh, notes = repaired(broken)
    assert notes == (note,)
    assert not defects(mesh)
    assert len(mesh.vertices) == len(BALL.vertices)
    assert mesh.area == pytest.approx(BALL.area, rel=1e-14)
    assert mesh.volume == pytest.approx(BALL.volume, rel=1e-14)


def test_a_face_at_a_rim_that_is_stored_again_turned_is_kept_once() -> None:
    """Unlike a fin, it has two faces at its side on the rim, but three at the others."""
    sheet = shapes.square(4)
    for stored in (sheet.faces[:1], sheet.faces[:1, ::-1]):
        mesh, _ = repaired(with_more(sheet, stored))
        assert mesh.area == pytest.approx(sheet.area, rel=1e-14)
        assert len(mesh.faces) == len(sheet.faces)


def test_noisy_vertices_alone_are_smoothed_and_the_ball_keeps_its_size() -> None:
    ball = shapes.icosphere(4)
    assert denoised(ball)[0] is ball
    edge = np.linalg.norm(
        ball.vertices[ball.faces[:, 0]] - ball.vertices[ball.faces[:, 1]], axis=1
    ).mean()
    off = np.random.default_rng(0).normal(0, 0.3 * edge, ball.vertices.shape)
    smooth, notes = denoised(TriangleMesh(ball.vertices + off, ball.faces))
    assert notes[0].startswith("smoothed noisy vertices: ")
    radii = np.linalg.norm(smooth.vertices, axis=1)
    assert radii.mean() == pytest.approx(1, abs=0.002)
    assert radii.std() < 0.5 * np.linalg.norm(ball.vertices + off, axis=1).std()


def test_two_balls_that_touch_are_split_and_the_larger_stays() -> None:
    edge, notes = repaired(shapes.two_tetrahedra("edge"))
    assert notes == (
        "split 2 vertices where the surface was not manifold",
        "dropped 1 smaller components with 50.00% of the area",
    )
    assert not defects(edge)
    assert edge.volume == pytest.approx(1 / 6)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (
            TriangleMesh(np.zeros((4, 3)), TWO_FACES),
            "no face of 2 bounds anything: they are flat or cancel out",
        ),
        (
            TriangleMesh(np.outer(np.arange(4.0), [1, 2, 3]), TWO_FACES),
            "no face of 2 bounds anything",
        ),
        (
            TriangleMesh(np.eye(3), np.zeros((0, 3), dtype=np.int32)),
            "no face of 0 bounds anything",
        ),
        (shapes.mobius_strip(), "the surface is one-sided, as a Möbius strip is"),
    ],
)
def test_what_bounds_nothing_is_refused(mesh: TriangleMesh, message: str) -> None:
    with pytest.raises(DegenerateMeshError, match=message):
        repaired(mesh)


def test_a_second_body_is_an_error_where_it_is_too_large_to_drop() -> None:
    two = shapes.joined(shapes.icosphere(2), shapes.icosphere(2, 0.5))
    message = (
        r"the scan holds more than one body: the second has 20% of the area, more than "
        r"surface.max_discarded = 10%; give each body a file of its own"
    )
    with pytest.raises(ReconstructionError, match=message):
        largest_component(two, 0.1)
    assert len(largest_component(two, 0.2001)[0].faces) == 320
