"""Geometry of other packages, as arrays."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import open3d as o3d
import pytest
import pyvista
import trimesh

from pcretrieve.values.conversion import geometry_arrays

VERTICES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)


def open3d_mesh() -> o3d.geometry.TriangleMesh:
    return o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(VERTICES), o3d.utility.Vector3iVector(FACES))


def open3d_cloud() -> o3d.geometry.PointCloud:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(VERTICES))
    cloud.normals = o3d.utility.Vector3dVector(2 * VERTICES + [1.0, 0, 0])
    return cloud


MESHES: dict[str, Callable[[], object]] = {
    "open3d": open3d_mesh,
    "open3d tensor": lambda: o3d.t.geometry.TriangleMesh.from_legacy(open3d_mesh()),
    "trimesh": lambda: trimesh.Trimesh(VERTICES, FACES, process=False),
    "pyvista": lambda: pyvista.PolyData(VERTICES, np.insert(FACES, 0, 3, axis=1).ravel()),
    "vertices and faces": lambda: SimpleNamespace(vertices=VERTICES.tolist(), faces=FACES.tolist()),
    "pair": lambda: (VERTICES, FACES),
    "pair of lists": lambda: [VERTICES.tolist(), FACES.tolist()],
}
CLOUDS: dict[str, Callable[[], object]] = {
    "open3d": open3d_cloud,
    "open3d tensor": lambda: o3d.t.geometry.PointCloud.from_legacy(open3d_cloud()),
    "trimesh": lambda: trimesh.PointCloud(VERTICES),  # type: ignore[no-untyped-call]
    "pyvista": lambda: pyvista.PolyData(VERTICES),
    "points": lambda: SimpleNamespace(points=VERTICES),
    "array": lambda: VERTICES,
    "lists": lambda: VERTICES.tolist(),
    "two points": lambda: VERTICES[:2].tolist(),
}


@pytest.mark.parametrize("kind", [MESHES, CLOUDS], ids=["mesh", "cloud"])
def test_meshes_and_clouds_keep_their_vertices_and_faces(kind: dict[str, Callable[[], object]]) -> None:
    for name, make in kind.items():
        points, faces, normals = geometry_arrays(make())
        np.testing.assert_allclose(points, VERTICES[: 2 if name == "two points" else 4], atol=1e-7)
        if kind is MESHES:
            np.testing.assert_array_equal(faces, FACES)
            assert normals is None
        else:
            assert faces is None


@pytest.mark.parametrize("make", [open3d_cloud, CLOUDS["open3d tensor"]], ids=["legacy", "tensor"])
def test_normals_get_unit_length(make: Callable[[], object]) -> None:
    normals = geometry_arrays(make()).normals
    assert normals is not None
    expected = 2 * VERTICES + [1.0, 0, 0]
    np.testing.assert_allclose(normals, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-6)


def test_quadrilaterals_of_pyvista_are_cut_into_triangles() -> None:
    points, faces, _ = geometry_arrays(pyvista.Plane(i_resolution=2, j_resolution=2))
    assert len(points) == 9
    assert faces is not None
    assert faces.shape == (8, 3)


@pytest.mark.parametrize(
    "thing",
    [
        o3d.geometry.LineSet(),
        pyvista.ImageData(dimensions=(2, 2, 2)),
        "scan.ply",
        {},
        3,
        None,
        [[0.0], [1, 2]],
    ],
    ids=["lines", "grid", "text", "dict", "number", "none", "ragged"],
)
def test_anything_else_is_refused(thing: object) -> None:
    with pytest.raises(TypeError, match=r"not|neither"):
        geometry_arrays(thing)
