"""Values of other packages in, values for other packages out."""

from collections.abc import Callable
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import shapes
import trimesh

import pcretrieve as pr
from pcretrieve.errors import InputError
from pcretrieve.formats import as_scan
from pcretrieve.values import ModalSpectrum, Neighbors, Shape, Signature, SignatureTable, Surface
from pcretrieve.values.conversion import as_cloud, as_geometry, as_mesh

MESH = shapes.body(3)
CLOUD = pr.PointCloud(MESH.vertices, MESH.vertices / np.linalg.norm(MESH.vertices, axis=1, keepdims=True))
SIGNATURE = Signature(np.array([3.0, 2, 1, 0.5]), "r-bihdm", deviation=np.array([0.1, 0.2, 0.1, 0.1]))
TABLE = SignatureTable(("a", "b"), np.array([[1.0, 2], [3, 4]]), "r-bihdm", labels=("cat", None))
NEIGHBORS = Neighbors(("a", "b"), np.array([0.0, 0.5]))


PAIRS = pr.eigenpairs(pr.laplace_beltrami(MESH), 5)


@pytest.mark.parametrize("back", [lambda mesh: mesh.to_open3d(), lambda mesh: mesh.to_trimesh()])
def test_a_mesh_survives_the_way_out_and_in(back: Any) -> None:
    again = as_geometry(back(MESH))
    assert isinstance(again, pr.TriangleMesh)
    np.testing.assert_array_equal(again.vertices, MESH.vertices)
    np.testing.assert_array_equal(again.faces, MESH.faces)


def test_a_cloud_survives_the_way_out_and_in() -> None:
    again = as_cloud(CLOUD.to_open3d())
    np.testing.assert_array_equal(again.points, CLOUD.points)
    assert again.normals is not None
    assert CLOUD.normals is not None
    np.testing.assert_allclose(again.normals, CLOUD.normals, atol=1e-15)
    np.testing.assert_array_equal(as_cloud(CLOUD.to_trimesh()).points, CLOUD.points)


def test_arrays_of_exported_geometry_are_copies() -> None:
    out = MESH.to_trimesh()
    out.vertices[0] = 99
    assert not (MESH.vertices == 99).any()


# Functions, not values: pytest keeps parameters until the interpreter ends, and a process in which a tensor
# of Open3D is then alive exits with status 1 (its MemoryManagerStatistic takes the tensor for a leak).
@pytest.mark.parametrize(
    "make",
    [
        MESH.to_open3d,
        lambda: o3d.t.geometry.TriangleMesh.from_legacy(MESH.to_open3d()),
        MESH.to_trimesh,
        lambda: (MESH.vertices, MESH.faces),
    ],
    ids=["open3d", "open3d tensor", "trimesh", "pair"],
)
def test_public_functions_take_meshes_of_other_packages(make: Callable[[], Any]) -> None:
    thing = make()
    wanted = pr.signature(MESH)
    np.testing.assert_allclose(pr.signature(thing).values, wanted.values, rtol=1e-6)
    assert pr.laplace_beltrami(thing).area == pytest.approx(MESH.area, rel=1e-6)
    assert pr.reconstruct(thing).area == pytest.approx(MESH.area, rel=1e-6)


def test_a_cloud_is_no_surface() -> None:
    with pytest.raises(InputError, match="a surface must have faces, got a cloud of 642 points"):
        as_mesh(CLOUD)
    assert len(as_cloud(MESH).points) == len(MESH.vertices)


@pytest.mark.parametrize("thing", [3, {}, None, trimesh.Scene()], ids=["number", "dict", "none", "scene"])
def test_what_stands_for_no_scan_is_said(thing: Any) -> None:
    with pytest.raises(InputError, match=f"a scan must be a path, .* got {type(thing).__name__}"):
        as_scan(thing)


def test_a_signature_is_an_array() -> None:
    np.testing.assert_array_equal(np.asarray(SIGNATURE), SIGNATURE.values)
    assert np.asarray(SIGNATURE, dtype=np.float32).dtype == np.float32
    np.log(SIGNATURE)
    assert np.asarray(TABLE).shape == (2, 2)


@pytest.mark.parametrize("value", [CLOUD, MESH, Shape((Surface(MESH.area, mesh=MESH),))], ids=type)
def test_notebooks_show_a_picture(value: Any) -> None:
    html = value._repr_html_()
    assert 'src="data:image/png;base64,' in html
    assert "<script" not in html


@pytest.mark.parametrize(
    "value", [CLOUD, MESH, SIGNATURE, NEIGHBORS, PAIRS, ModalSpectrum.of(PAIRS)], ids=type
)
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
