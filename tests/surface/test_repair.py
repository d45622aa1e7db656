"""Each repair makes one change, leaves a note, and does not move the rest of the surface."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.errors import DegenerateMeshError, ReconstructionError
from pcretrieve.surface import defects
from pcretrieve.surface.repair import largest_component, repaired
from pcretrieve.values import IntArray, TriangleMesh

BALL = shapes.icosphere(2)  # 162 vertices, 320 faces


def with_more(mesh: TriangleMesh, faces: object, vertices: object = ()) -> TriangleMesh:
    added: IntArray = np.reshape(np.asarray(faces, dtype=np.int32), (-1, 3))
    points = np.concatenate([mesh.vertices, np.reshape(np.asarray(vertices, dtype=float), (-1, 3))])
    return TriangleMesh(points, np.concatenate([mesh.faces, added]))


def with_caps(mesh: TriangleMesh, n: int) -> TriangleMesh:
    """A ball with n bisected faces, each with a degenerate face that closes the gap at the new vertex."""
    cut = np.arange(n) * (len(mesh.faces) // n)
    a, b, c = mesh.faces[cut].T
    middle = len(mesh.vertices) + np.arange(n)
    halves = np.concatenate([np.column_stack(f) for f in ((a, middle, c), (middle, b, c), (a, b, middle))])
    rest = TriangleMesh(mesh.vertices, np.delete(mesh.faces, cut, axis=0))
    return with_more(rest, halves, (mesh.vertices[a] + mesh.vertices[b]) / 2)


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


def test_two_balls_that_touch_are_split_and_the_larger_stays() -> None:
    edge, notes = repaired(shapes.two_tetrahedra("edge"))
    assert notes == (
        "split 2 vertices where the surface was not manifold",
        "dropped 1 smaller components with 50.00% of the area",
    )
    assert not defects(edge)
    assert edge.volume == pytest.approx(1 / 6)


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


def test_a_second_body_is_an_error_where_it_is_too_large_to_drop() -> None:
    two = shapes.joined(shapes.icosphere(2), shapes.icosphere(2, 0.5))
    message = (
        r"the scan holds more than one body: the second has 20% of the area, more than "
        r"surface.max_discarded = 10%; give each body a file of its own"
    )
    with pytest.raises(ReconstructionError, match=message):
        largest_component(two, 0.1)
    assert len(largest_component(two, 0.2001)[0].faces) == 320
