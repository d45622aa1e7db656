"""Remeshing: the result of fTetWild is used only if it is the same body."""

from __future__ import annotations

import re

import numpy as np
import pytest
import shapes

from pcretrieve.errors import RemeshError
from pcretrieve.options import RemeshOptions
from pcretrieve.surface import defects, remesh
from pcretrieve.surface.tetwild import boundary_faces
from pcretrieve.values import Step, TriangleMesh

BODY = shapes.body(3)
TETWILD = RemeshOptions(method="tetwild")
KEPT = "kept the surface as it was before remeshing: "


def only_note(mesh: TriangleMesh) -> str:
    (note,) = mesh.provenance[-1].notes
    return note


@pytest.mark.parametrize("mesh", [BODY, shapes.torus(24, 12)], ids=["body", "torus"])
def test_a_closed_surface_keeps_topology_area_and_volume(mesh: TriangleMesh) -> None:
    earlier = Step("surface", 1.0)
    result = remesh(mesh.after(earlier), TETWILD)
    assert not defects(result)
    assert result.euler_characteristic == mesh.euler_characteristic
    assert result.area == pytest.approx(mesh.area, rel=0.01)
    assert result.volume == pytest.approx(mesh.volume, rel=0.01)
    first, step = result.provenance
    assert first == earlier
    assert (step.stage, step.sizes) == ("remesh", {"faces_in": len(mesh.faces), "faces": len(result.faces)})
    assert step.seconds > 0
    assert not any(note.startswith(KEPT) for note in step.notes)


def kept_as_it_was(result: TriangleMesh, mesh: TriangleMesh) -> bool:
    return np.array_equal(result.vertices, mesh.vertices) and np.array_equal(result.faces, mesh.faces)


@pytest.mark.parametrize(
    ("mesh", "options", "why"),
    [
        (BODY, {"timeout": 1e-3}, r"fTetWild did not finish within 0\.001 s and was stopped"),
        # For a body that is oriented inwards the result is almost empty, or oriented outwards.
        (
            TriangleMesh(BODY.vertices, BODY.faces[:, ::-1]),
            {},
            r"fTetWild gave no|it changed the",
        ),
    ],
    ids=["no time", "inside out"],
)
def test_an_answer_that_cannot_be_used_is_refused_and_said_so(
    mesh: TriangleMesh, options: dict[str, float], why: str
) -> None:
    result = remesh(mesh, TETWILD.model_copy(update=options))
    assert kept_as_it_was(result, mesh)
    note = only_note(result)
    assert note.startswith(KEPT)
    assert re.match(why, note.removeprefix(KEPT)), note


def test_without_an_answer_a_surface_with_holes_is_an_error() -> None:
    pricked = TriangleMesh(BODY.vertices, BODY.faces[1:])
    message = (
        r"the surface has defects \(3 boundary edges\) and could not be remeshed: fTetWild did not finish "
        r"within 0\.001 s and was stopped"
    )
    with pytest.raises(RemeshError, match=message):
        remesh(pricked, RemeshOptions(method="tetwild", timeout=1e-3))


@pytest.mark.parametrize("seed", range(4))
def test_the_boundary_of_tetrahedra_points_outwards_whatever_their_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Two tetrahedra on one face, their corners in any order.
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
    both = np.array([rng.permutation([0, 1, 2, 3]), rng.permutation([1, 2, 3, 4])], dtype=np.int32)
    surface = TriangleMesh(nodes, boundary_faces(nodes, both))
    assert len(surface.faces) == 6
    assert not defects(surface)
    assert surface.volume == pytest.approx(1 / 6 + 1 / 3)
