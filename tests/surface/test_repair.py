"""Each repair makes one change, leaves a note, and does not move the rest of the surface."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.errors import DegenerateMeshError, ReconstructionError
from pcretrieve.surface import defects, repaired
from pcretrieve.surface.repair import collapse_flat_faces, drop_repeated_faces, largest_component
from pcretrieve.values import IntArray, TriangleMesh

BALL = shapes.icosphere(2)  # 162 vertices, 320 faces


def with_more(mesh: TriangleMesh, faces: object, vertices: object = ()) -> TriangleMesh:
    added: IntArray = np.reshape(np.asarray(faces, dtype=np.int32), (-1, 3))
    points = np.concatenate([mesh.vertices, np.reshape(np.asarray(vertices, dtype=float), (-1, 3))])
    return TriangleMesh(points, np.concatenate([mesh.faces, added]))


def with_needles(mesh: TriangleMesh, n: int) -> TriangleMesh:
    """A ball with n collapsed edges, each with two degenerate faces."""
    vertices = mesh.vertices.copy()
    for a, b in mesh.faces[:: len(mesh.faces) // n, :2]:
        vertices[a] = vertices[b]
    return TriangleMesh(vertices, mesh.faces)


def with_caps(mesh: TriangleMesh, n: int) -> TriangleMesh:
    """A ball with n bisected faces, each with a degenerate face that closes the gap at the new vertex."""
    cut = np.arange(n) * (len(mesh.faces) // n)
    a, b, c = mesh.faces[cut].T
    middle = len(mesh.vertices) + np.arange(n)
    halves = np.concatenate([np.column_stack(f) for f in ((a, middle, c), (middle, b, c), (a, b, middle))])
    rest = TriangleMesh(mesh.vertices, np.delete(mesh.faces, cut, axis=0))
    return with_more(rest, halves, (mesh.vertices[a] + mesh.vertices[b]) / 2)


def test_a_sound_mesh_needs_nothing() -> None:
    mesh, notes = repaired(BALL)
    assert notes == ()
    assert not defects(mesh)
    assert (mesh.vertices[mesh.faces] == BALL.vertices[BALL.faces]).all()


@pytest.mark.parametrize(
    ("broken", "note"),
    [
        (with_more(BALL, [], np.ones((3, 3))), "dropped 3 vertices that are in no face"),
        (with_caps(BALL, 7), "collapsed 14 of 334 faces, flat ones and their neighbours"),
        (with_more(BALL, [[0, 0, 5]]), "collapsed 1 of 321 faces, flat ones and their neighbours"),
        (with_more(BALL, BALL.faces[:4]), "dropped 4 of 324 faces that repeat others, or lie back to back"),
        (
            with_more(BALL, [[0, 1, 2], [0, 2, 1]]),
            "dropped 2 of 322 faces that repeat others, or lie back to back",
        ),
        (
            with_more(BALL, BALL.faces[:, ::-1]),
            "dropped 320 of 640 faces that repeat others, or lie back to back",
        ),
        (
            TriangleMesh(BALL.vertices, np.concatenate([BALL.faces[:20, ::-1], BALL.faces[20:]])),
            "turned 20 faces of 320 to agree with their neighbours",
        ),
        (TriangleMesh(BALL.vertices, BALL.faces[:, ::-1]), "turned the surface inside out"),
        (
            shapes.joined(BALL, shapes.icosphere(2, 0.1)),
            "dropped 1 smaller components with 0.99% of the area",
        ),
    ],
)
def test_a_ball_with_defects_is_repaired_to_the_ball(broken: TriangleMesh, note: str) -> None:
    mesh, notes = repaired(broken)
    assert notes == (note,)
    assert not defects(mesh)
    assert len(mesh.vertices) == len(BALL.vertices)
    assert mesh.area == pytest.approx(BALL.area, rel=1e-14)
    assert mesh.volume == pytest.approx(BALL.volume, rel=1e-14)


def test_flat_faces_collapse_without_a_slit() -> None:
    broken = with_needles(BALL, 5)
    mesh, notes = repaired(broken)
    assert notes == ("collapsed 10 of 320 faces, flat ones and their neighbours",)
    assert not defects(mesh)
    assert mesh.volume == pytest.approx(broken.volume, rel=1e-14)


def test_flat_faces_collapse_until_none_is_left() -> None:
    # A fan of points on one line: the first collapse leaves other faces flat.
    line = np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6)])
    faces = np.array([[0, k, k + 1] for k in range(1, 5)] + [[0, 5, 6]], dtype=np.int32)
    mesh, notes = collapse_flat_faces(TriangleMesh(np.concatenate([line, [[0.0, 1.0, 0.0]]]), faces))
    assert not mesh.flat_faces.any()
    assert mesh.area == pytest.approx(2.5)
    assert notes == ("collapsed 4 of 5 faces, flat ones and their neighbours",)


def test_a_fin_is_removed_and_the_surface_remains_closed() -> None:
    a, b = BALL.faces[0, :2]
    tip = len(BALL.vertices)
    fin = with_more(BALL, [[a, b, tip], [b, a, tip]], [0, 0, 3])
    mesh, notes = repaired(fin)
    assert not defects(mesh)
    assert "dropped 2 of 322 faces that repeat others, or lie back to back" in notes
    assert mesh.area == pytest.approx(BALL.area)


def test_one_of_each_two_stays_where_a_mesh_is_two_sided_on_purpose() -> None:
    sheet = shapes.square(4)
    both = with_more(sheet, sheet.faces[:, ::-1])
    mesh, _ = drop_repeated_faces(both)
    assert mesh.faces.tolist() == sheet.faces.tolist()


def test_two_balls_that_touch_are_split_and_the_larger_stays() -> None:
    edge, notes = repaired(shapes.two_tetrahedra("edge"))
    assert notes == (
        "split 2 vertices where the surface was not manifold",
        "dropped 1 smaller components with 50.00% of the area",
    )
    assert not defects(edge)
    assert edge.volume == pytest.approx(1 / 6)


@pytest.mark.parametrize("seed", range(5))
def test_everything_at_once(seed: int) -> None:
    body = shapes.body(3)
    rng = np.random.default_rng(seed)
    broken = with_caps(with_needles(body, 6), 9)
    broken = with_more(broken, broken.faces[rng.integers(len(broken.faces), size=5)], rng.random((4, 3)))
    broken = shapes.joined(broken, shapes.icosphere(0, 0.05), shapes.two_tetrahedra("vertex"))
    faces = broken.faces.copy()
    flipped = rng.random(len(faces)) < 0.2
    faces[flipped] = faces[flipped, ::-1]
    broken = shapes.renumbered(TriangleMesh(broken.vertices, faces), seed)
    mesh, notes = repaired(broken)
    assert not defects(mesh)
    assert mesh.euler_characteristic == 2
    assert mesh.volume == pytest.approx(with_needles(body, 6).volume, rel=1e-12)
    assert [note.split()[0] for note in notes[:4]] == ["dropped", "collapsed", "dropped", "turned"]


def test_holes_stay() -> None:
    open_ball = TriangleMesh(BALL.vertices, BALL.faces[5:])
    mesh, notes = repaired(open_ball)
    assert notes == ()
    assert defects(mesh) == defects(open_ball)


@pytest.mark.parametrize(
    "mesh",
    [
        TriangleMesh(np.zeros((4, 3)), np.array([[0, 1, 2], [1, 2, 3]], dtype=np.int32)),
        TriangleMesh(np.outer(np.arange(4.0), [1, 2, 3]), np.array([[0, 1, 2], [1, 2, 3]], dtype=np.int32)),
        TriangleMesh(np.eye(3), np.zeros((0, 3), dtype=np.int32)),
    ],
)
def test_nothing_is_left_of_a_mesh_without_area(mesh: TriangleMesh) -> None:
    message = rf"no face of {len(mesh.faces)} bounds anything: they are flat or cancel out"
    with pytest.raises(DegenerateMeshError, match=message):
        repaired(mesh)


def test_a_one_sided_surface_is_refused() -> None:
    with pytest.raises(DegenerateMeshError, match=r"the surface is one-sided, as a Möbius strip is"):
        repaired(shapes.mobius_strip())


def test_the_largest_component_by_area_not_by_faces() -> None:
    small, large = shapes.icosphere(3, 0.1), shapes.icosphere(1, 1.0)
    mesh, notes = largest_component(shapes.joined(small, large))
    assert len(mesh.faces) == len(large.faces)
    share = small.area / (small.area + large.area)
    assert notes == (f"dropped 1 smaller components with {share:.2%} of the area",)


def test_a_second_body_is_an_error_where_it_is_too_large_to_drop() -> None:
    two = shapes.joined(shapes.icosphere(2), shapes.icosphere(2, 0.5))
    message = (
        r"the scan holds more than one body: the second has 20% of the area, more than "
        r"surface.max_discarded = 10%; give each body a file of its own"
    )
    with pytest.raises(ReconstructionError, match=message):
        largest_component(two, 0.1)
    assert len(largest_component(two, 0.2001)[0].faces) == 320
