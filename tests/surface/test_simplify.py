"""Simplification: the topology is preserved exactly, shape and spectrum approximately."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from pcretrieve.errors import DegenerateMeshError
from pcretrieve.formats import read_scan
from pcretrieve.points.open3d import estimate_normals, orient_by_tangent_planes
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.surface import defects, repaired
from pcretrieve.surface.open3d import poisson
from pcretrieve.surface.simplify import simplified
from pcretrieve.surface.topology import components, edges_of
from pcretrieve.values import FloatArray, TriangleMesh

DATA = Path(__file__).parents[3] / "shared" / "data" / "tosca"


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


def test_the_spectrum_stays() -> None:
    mesh = shapes.body(6)
    full, small = (
        eigenpairs(laplace_beltrami(each, "linear"), 31).eigenvalues[1:]
        for each in (mesh, simplified(mesh, 8000))
    )
    assert small == pytest.approx(full, rel=0.01)


@pytest.mark.parametrize("seed", range(20))
def test_topology_stays_however_few_faces_are_wanted(seed: int) -> None:
    mesh = blob(seed)
    small = simplified(mesh, 50)
    assert same_topology(small, mesh)
    assert len(small.faces) < len(mesh.faces) / 10
    piece, of_small = (np.bincount(components(each)) for each in (mesh, small))
    assert len(piece) == len(of_small)
    assert small.volume > 0.6 * mesh.volume > 0


def test_slivers_go() -> None:
    mesh = blob(0)
    small = simplified(mesh, len(mesh.faces) // 4)
    assert np.percentile(smallest_angles(mesh), 1) < 10
    assert np.percentile(smallest_angles(small), 1) > 15


def test_it_ends_at_tetrahedra() -> None:
    small = simplified(shapes.icosphere(3), 0)
    assert len(small.faces) == 4
    assert not defects(small)
    tetrahedron = shapes.tetrahedron()
    assert np.array_equal(simplified(tetrahedron, 0).faces, tetrahedron.faces)


def test_a_surface_with_few_faces_is_not_changed() -> None:
    mesh = shapes.body(2)
    same = simplified(mesh, len(mesh.faces))
    assert np.array_equal(same.vertices, mesh.vertices)
    assert np.array_equal(same.faces, mesh.faces)


@pytest.mark.parametrize("scale", [1e-6, 1e3, 1e9])
def test_the_unit_of_length_chooses_no_face(scale: float) -> None:
    mesh = blob(1)
    small, scaled = simplified(mesh, 1000), simplified(TriangleMesh(scale * mesh.vertices, mesh.faces), 1000)
    assert np.array_equal(small.faces, scaled.faces)
    assert scaled.vertices == pytest.approx(scale * small.vertices, rel=1e-9)


def test_the_answer_is_the_same_each_time_and_the_input_is_left_as_it_was() -> None:
    mesh = blob(2)
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    first, second = simplified(mesh, 1000), simplified(mesh, 1000)
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.faces, second.faces)
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.faces, faces)


def test_inside_out_stays_inside_out() -> None:
    mesh = shapes.body(4)
    small = simplified(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]), 1000)
    assert not defects(small)
    assert small.volume == pytest.approx(-mesh.volume, rel=0.02)


def test_faces_without_an_area_are_no_obstacle() -> None:
    mesh = shapes.icosphere(4)
    vertices = mesh.vertices.copy()
    a, b = edges_of(mesh.faces).ends[::7].T
    vertices[a] = vertices[b]
    small = simplified(TriangleMesh(vertices, mesh.faces), 500)
    assert len(small.faces) == 500
    assert not defects(small)


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


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the TOSCA meshes beside the checkout, in ../shared/data")
def test_the_poisson_surface_of_a_cat() -> None:
    cat = read_scan(DATA / "cat0.off")
    assert isinstance(cat, TriangleMesh)
    rng = np.random.default_rng(0)
    points = shapes.points_on(cat, 50_000)
    points += 1e-4 * cat.diagonal * rng.standard_normal(points.shape)
    normals = orient_by_tangent_planes(points, estimate_normals(points, n_neighbors=20), n_neighbors=20)
    vertices, faces, _ = poisson(points, normals, depth=8, scale=1.1)
    mesh, _ = repaired(TriangleMesh(vertices, faces))
    small = simplified(mesh, 10_000)
    assert len(small.faces) == 10_000
    assert same_topology(small, mesh)
    assert small.area == pytest.approx(mesh.area, rel=0.005)
    assert small.volume == pytest.approx(mesh.volume, rel=0.005)
