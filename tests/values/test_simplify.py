"""Simplification: the topology is preserved exactly, shape and spectrum approximately."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from scipy.ndimage import gaussian_filter

import pcretrieve as pr
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.surface.marching import level_set
from pcretrieve.values import FloatArray, Step, TriangleMesh
from pcretrieve.values.simplify import simplified
from pcretrieve.values.topology import compact, components, defects


def blob(seed: int, n: int = 24) -> TriangleMesh:
    """Marching cubes on smooth noise: components of high genus, with slivers."""
    noise = gaussian_filter(
        np.random.default_rng(seed).standard_normal((n, n, n)), 2.0, mode="wrap"
    )
    inside = np.pad(noise - 0.3 * noise.std(), 1, constant_values=-noise.std())
    return TriangleMesh(*level_set(inside, 0.0))


def smallest_angles(mesh: TriangleMesh) -> FloatArray:
    """(m,) degrees."""
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    ahead, behind = (
        np.roll(corners, -1, axis=1) - corners,
        np.roll(corners, 1, axis=1) - corners,
    )
    sine = np.linalg.norm(np.cross(ahead, behind), axis=2)
    smallest: FloatArray = np.degrees(np.arctan2(sine, (ahead * behind).sum(axis=2))).min(
        axis=1
    )
    return smallest


@pytest.mark.parametrize(
    "mesh",
    [shapes.icosphere(6), shapes.torus(160, 80), shapes.body(5)],
    ids=["sphere", "torus", "body"],
)
def test_the_shape_stays(mesh: TriangleMesh) -> None:
    small = simplified(mesh, 4000)
    assert len(small.faces) == 4000
    assert not defects(small)
    assert small.euler_characteristic == mesh.euler_characteristic
    assert small.area == pytest.approx(mesh.area, rel=0.002)
    assert small.volume == pytest.approx(mesh.volume, rel=0.005)
    assert np.percentile(smallest_angles(small), 1) > 15


def test_topology_stays_however_few_faces_are_wanted() -> None:
    for seed in range(3):
        mesh = blob(seed)
        small = simplified(mesh, 50)
        assert defects(small) == defects(mesh)
        assert small.euler_characteristic == mesh.euler_characteristic
        assert len(small.faces) < len(mesh.faces) / 10
        piece, of_small = (np.bincount(components(each)) for each in (mesh, small))
        assert len(piece) == len(of_small)
        assert small.volume > 0.6 * mesh.volume > 0


def test_the_unit_of_length_chooses_no_face() -> None:
    mesh = blob(1)
    small, scaled = (
        simplified(mesh, 1000),
        simplified(TriangleMesh(1e9 * mesh.vertices, mesh.faces), 1000),
    )
    assert np.array_equal(small.faces, scaled.faces)
    assert scaled.vertices == pytest.approx(1e9 * small.vertices, rel=1e-9)


BALL = shapes.icosphere(1)


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (shapes.square(3), "not at 12 half-edges"),  # of the boundary
        (
            TriangleMesh(shapes.tetrahedron().vertices, shapes.TETRAHEDRON_FACES[1:]),
            "not at 3 half-edges",
        ),
        (
            shapes.two_tetrahedra("edge"),
            "not at 4 half-edges or vertices; repair it first",
        ),
        (
            shapes.two_tetrahedra("vertex"),
            "must be closed, manifold and oriented .* not at 1 half-edges or",
        ),
        (
            TriangleMesh(
                BALL.vertices, np.concatenate([BALL.faces[:1, ::-1], BALL.faces[1:]])
            ),
            r"not at \d+ half-edges",
        ),
        (
            TriangleMesh(np.ones_like(BALL.vertices), BALL.faces),
            "no face of 80 has an area",
        ),
    ],
)
def test_what_is_not_a_closed_oriented_manifold_of_some_size_is_refused(
    mesh: TriangleMesh, words: str
) -> None:
    with pytest.raises(DegenerateMeshError, match=words):
        simplified(mesh, 2)


# --- meshes with too many faces -----------------------------------------------------------------------

FINE = shapes.ellipsoid((1, 1.3, 1.9), subdivisions=5)  # 20,480 faces
FEW = 5000


def kept(mode: str, max_faces: int) -> pr.PipelineOptions:
    surface, signature = {"mode": mode, "max_faces": max_faces}, {"method": "r-bihdm"}
    return pr.PipelineOptions().changed(surface=surface, signature=signature)


def step_of(mesh: TriangleMesh) -> Step:
    (step,) = (step for step in mesh.provenance if step.stage == "simplify")
    return step


@pytest.mark.parametrize("mode", ["auto", "keep"])
def test_a_fine_mesh_has_the_signature_of_a_simplified_one(mode: str) -> None:
    whole = pr.signature(FINE, kept(mode, len(FINE.faces)))
    shape = pr.process(FINE, kept(mode, FEW))
    assert FEW - 2 <= len(shape.mesh.faces) <= FEW
    step = step_of(shape.mesh)
    assert step.sizes == {
        "faces_in": len(FINE.faces),
        "faces": len(shape.mesh.faces),
        "euler": 2,
    }
    assert step.notes == ("simplified, because it had more faces than surface.max_faces",)
    assert step in shape.provenance
    assert shape.area == pytest.approx(FINE.area, rel=1e-3)
    coarse = np.log(pr.signature(FINE, kept(mode, FEW)).values / whole.values)
    assert 0 < np.abs(coarse).max() < 0.08


def test_a_mesh_with_a_hole_stays_one() -> None:
    half = compact(
        FINE.vertices, FINE.faces[FINE.vertices[FINE.faces][:, :, 2].mean(axis=1) > 0]
    )
    mesh = pr.reconstruct(half, kept("keep", FEW))
    assert FEW - 100 < len(mesh.faces) <= FEW
    assert (
        step_of(mesh).sizes["euler"]
        == mesh.euler_characteristic
        == half.euler_characteristic
        == 1
    )
    assert mesh.area == pytest.approx(half.area, rel=2e-3)
    full, coarse = (
        pr.signature(half, kept("keep", n)).values for n in (len(half.faces), FEW)
    )
    assert np.abs(np.log(coarse / full)).max() < 0.08
