"""Values of other packages in, values for other packages out."""

import base64
import html
import io
import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import pyvista
import shapes
import trimesh

import pcretrieve as pr
from pcretrieve.errors import InputError
from pcretrieve.formats import as_scan
from pcretrieve.values import Neighbors, Shape, Signature, SignatureTable, Surface
from pcretrieve.values.conversion import as_cloud, as_geometry, as_mesh

MESH = shapes.body(3)
VERTICES, FACES = MESH.vertices, MESH.faces
CLOUD = pr.PointCloud(
    VERTICES, VERTICES / np.linalg.norm(VERTICES, axis=1, keepdims=True)
)
SIGNATURE = Signature(
    np.array([3.0, 2, 1, 0.5]), "r-bihdm", errors=np.array([0.1, 0.2, 0.1, 0.1])
)
TABLE = SignatureTable(
    ("a", "b"), np.array([[1.0, 2], [3, 4]]), "r-bihdm", labels=("cat", None)
)
NEIGHBORS = Neighbors(("a", "b"), np.array([0.0, 0.5]))
PAIRS = pr.eigenpairs(pr.laplace_beltrami(MESH), 5)


def open3d_cloud() -> Any:
    cloud = CLOUD.to_open3d()
    cloud.normals = o3d.utility.Vector3dVector(2 * np.asarray(CLOUD.normals))
    return cloud


# Functions, not values: a process in which a tensor of Open3D is alive when the interpreter ends exits with
# status 1 (its MemoryManagerStatistic takes the tensor for a leak).
MESHES: dict[str, Callable[[], Any]] = {
    "open3d": MESH.to_open3d,
    "open3d tensor": lambda: MESH.to_open3d(tensor=True),
    "trimesh": MESH.to_trimesh,
    "pyvista": lambda: pyvista.PolyData(
        np.array(VERTICES), np.insert(FACES, 0, 3, axis=1).ravel()
    ),
    "vertices and faces": lambda: SimpleNamespace(
        vertices=VERTICES.tolist(), faces=FACES.tolist()
    ),
    "pair": lambda: (VERTICES, FACES),
    "pair of lists": lambda: [VERTICES.tolist(), FACES.tolist()],
}
CLOUDS: dict[str, Callable[[], Any]] = {
    "open3d": open3d_cloud,
    "open3d tensor": lambda: CLOUD.to_open3d(tensor=True),
    "points and normals": lambda: SimpleNamespace(
        points=VERTICES, normals=2 * np.asarray(CLOUD.normals)
    ),
    "trimesh": CLOUD.to_trimesh,
    "pyvista": lambda: pyvista.PolyData(np.array(VERTICES)),
    "array": lambda: VERTICES,
    "lists": VERTICES.tolist,
}


@pytest.mark.parametrize("kind", MESHES)
def test_meshes_keep_their_vertices_and_faces(kind: str) -> None:
    found = as_geometry(MESHES[kind]())
    assert isinstance(found, pr.TriangleMesh)
    np.testing.assert_allclose(
        found.vertices, VERTICES, atol=1e-7 if "tensor" in kind else 0
    )
    np.testing.assert_array_equal(found.faces, FACES)


@pytest.mark.parametrize("kind", CLOUDS)
def test_clouds_keep_their_points_and_get_unit_normals(kind: str) -> None:
    found = as_geometry(CLOUDS[kind]())
    assert isinstance(found, pr.PointCloud)
    np.testing.assert_allclose(
        found.points, VERTICES, atol=1e-7 if "tensor" in kind else 0
    )
    assert (found.normals is not None) == (
        kind in ("open3d", "open3d tensor", "points and normals")
    )
    if found.normals is not None:
        np.testing.assert_allclose(found.normals, np.asarray(CLOUD.normals), atol=1e-6)


def test_two_points_are_no_pair_and_quadrilaterals_are_cut() -> None:
    np.testing.assert_array_equal(as_cloud(VERTICES[:2].tolist()).points, VERTICES[:2])
    plane = as_mesh(pyvista.Plane(i_resolution=2, j_resolution=2))
    assert (len(plane.vertices), len(plane.faces)) == (9, 8)


def test_arrays_of_exported_geometry_are_copies() -> None:
    out = MESH.to_trimesh()
    out.vertices[0] = 99
    assert not (MESH.vertices == 99).any()


def test_public_functions_take_meshes_of_other_packages() -> None:
    wanted = pr.signature(MESH)
    np.testing.assert_allclose(
        pr.signature(MESH.to_trimesh()).values, wanted.values, rtol=1e-6
    )
    assert pr.laplace_beltrami(MESH.to_open3d()).area == pytest.approx(
        MESH.area, rel=1e-6
    )
    assert pr.reconstruct((VERTICES, FACES)).area == pytest.approx(MESH.area, rel=1e-6)


def test_what_is_no_surface_or_no_scan_is_said() -> None:
    with pytest.raises(
        InputError, match="a surface must have faces, got a cloud of 642 points"
    ):
        as_mesh(CLOUD)
    assert len(as_cloud(MESH).points) == len(MESH.vertices)
    lines, grid = o3d.geometry.LineSet(), pyvista.ImageData(dimensions=(2, 2, 2))
    things: tuple[Any, ...] = (3, {}, None, trimesh.Scene(), lines, grid, [[0.0], [1, 2]])
    for thing in things:
        with pytest.raises(
            InputError, match=f"a scan must be a path, .* got {type(thing).__name__}"
        ):
            as_scan(thing)
    with pytest.raises(InputError, match="got str"):
        as_mesh("scan.ply")  # type: ignore[arg-type]


def test_a_signature_is_an_array() -> None:
    np.testing.assert_array_equal(np.asarray(SIGNATURE), SIGNATURE.values)
    assert np.asarray(SIGNATURE, dtype=np.float32).dtype == np.float32
    np.log(SIGNATURE)
    assert np.asarray(TABLE).shape == (2, 2)


@pytest.mark.parametrize(
    "value", [CLOUD, MESH, Shape((Surface(MESH.area, mesh=MESH),))], ids=type
)
def test_notebooks_show_a_picture(value: Any) -> None:
    html = value._repr_html_()
    assert 'src="data:image/png;base64,' in html
    assert "<script" not in html


@pytest.mark.parametrize("value", [CLOUD, MESH, SIGNATURE], ids=type)
def test_plots_draw_into_the_axes_given(value: Any) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    axes = value.plot()
    assert axes.has_data()
    axes.figure.canvas.draw()
    assert value.plot(axes) is axes
    pyplot.close("all")


def test_tables_go_to_pandas() -> None:
    frame = TABLE.to_pandas()
    assert list(frame.columns) == ["label", "v1", "v2"]
    assert frame.loc["b", "v2"] == 4
    assert NEIGHBORS.to_pandas().loc[2, "id"] == "b"


@pytest.mark.parametrize("shape", [MESH, CLOUD], ids=["mesh", "cloud"])
def test_a_notebook_gets_the_whole_shape(shape: Any) -> None:
    """The page of the viewer holds a binary glTF file of it, with colours."""
    page = html.unescape(shape.show().data)
    content = base64.b64decode(re.findall(r'base64_data="([\w+/=]+)"', page)[0])
    scene: Any = trimesh.load(io.BytesIO(content), file_type="glb")
    (found,) = scene.geometry.values()
    np.testing.assert_allclose(found.vertices, VERTICES, atol=1e-6)
    assert len(found.visual.vertex_colors) == len(VERTICES)
