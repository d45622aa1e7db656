"""Simplification: the topology is preserved exactly, shape and spectrum approximately."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.surface import defects
from pcretrieve.surface.simplify import simplified
from pcretrieve.surface.topology import components
from pcretrieve.values import FloatArray, TriangleMesh


def blob(seed: int, n: int = 24) -> TriangleMesh:
    """Marching cubes on smooth noise: components of high genus, with slivers."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((n, n, n)), 2.0, mode="wrap")
    inside = np.pad(noise - 0.3 * noise.std(), 1, constant_values=-noise.std())
    vertices, faces, _, _ = marching_cubes(inside, 0)
    return TriangleMesh(vertices, faces[:, ::-1])


def smallest_angles(mesh: TriangleMesh) -> FloatArray:
    """(m,) degrees."""
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(ahead, behind), axis=2)
    smallest: FloatArray = np.degrees(np.arctan2(sine, (ahead * behind).sum(axis=2))).min(axis=1)
    return smallest


def same_topology(after: TriangleMesh, before: TriangleMesh) -> bool:
    return defects(after) == defects(before) and after.euler_characteristic == before.euler_characteristic


@pytest.mark.parametrize(
    "mesh", [shapes.icosphere(6), shapes.torus(160, 80), shapes.body(5)], ids=["sphere", "torus", "body"]
)
def test_the_shape_stays(mesh: TriangleMesh) -> None:
    small = simplified(mesh, 4000)
    assert len(small.faces) == 4000
    assert not defects(small)
    assert small.euler_characteristic == mesh.euler_characteristic
    assert small.area == pytest.approx(mesh.area, rel=0.002)
    assert small.volume == pytest.approx(mesh.volume, rel=0.005)
    assert np.percentile(smallest_angles(small), 1) > 15


@pytest.mark.parametrize("seed", range(3))
def test_topology_stays_however_few_faces_are_wanted(seed: int) -> None:
    mesh = blob(seed)
    small = simplified(mesh, 50)
    assert same_topology(small, mesh)
    assert len(small.faces) < len(mesh.faces) / 10
    piece, of_small = (np.bincount(components(each)) for each in (mesh, small))
    assert len(piece) == len(of_small)
    assert small.volume > 0.6 * mesh.volume > 0


@pytest.mark.parametrize("scale", [1e9])
def test_the_unit_of_length_chooses_no_face(scale: float) -> None:
    mesh = blob(1)
    small, scaled = simplified(mesh, 1000), simplified(TriangleMesh(scale * mesh.vertices, mesh.faces), 1000)
    assert np.array_equal(small.faces, scaled.faces)
    assert scaled.vertices == pytest.approx(scale * small.vertices, rel=1e-9)


@pytest.mark.parametrize(
    ("mesh", "n_bad"),
    [
        (shapes.square(3), 12),  # boundary half-edges
        (TriangleMesh(shapes.tetrahedron().vertices, shapes.TETRAHEDRON_FACES[1:]), 3),
        (shapes.two_tetrahedra("edge"), 4),
        (shapes.two_tetrahedra("vertex"), 1),
    ],
    ids=["square", "three faces", "shared edge", "shared vertex"],
)
def test_what_is_not_a_closed_manifold_is_refused(mesh: TriangleMesh, n_bad: int) -> None:
    message = (
        f"must be closed, manifold and oriented .* not at {n_bad} half-edges or vertices; repair it first"
    )
    with pytest.raises(DegenerateMeshError, match=message):
        simplified(mesh, 2)


def test_faces_that_disagree_are_refused() -> None:
    mesh = shapes.icosphere(1)
    turned = np.concatenate([mesh.faces[:1, ::-1], mesh.faces[1:]])
    with pytest.raises(DegenerateMeshError, match=r"not at \d+ half-edges"):
        simplified(TriangleMesh(mesh.vertices, turned), 20)


def test_a_body_without_a_size_is_refused() -> None:
    mesh = shapes.icosphere(1)
    with pytest.raises(DegenerateMeshError, match="no face of 80 has an area"):
        simplified(TriangleMesh(np.ones_like(mesh.vertices), mesh.faces), 20)
