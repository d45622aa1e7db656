"""Values of other packages in, values for other packages out."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import shapes
import trimesh

import pcretrieve as pr
from pcretrieve.errors import InputError, OptionError
from pcretrieve.formats import as_scan
from pcretrieve.values import Eigenpairs, ModalSpectrum, Neighbors, Shape, Signature, SignatureTable, Surface
from pcretrieve.values.conversion import as_cloud, as_geometry, as_mesh

MESH = shapes.body(3)
CLOUD = pr.PointCloud(MESH.vertices, MESH.vertices / np.linalg.norm(MESH.vertices, axis=1, keepdims=True))
SIGNATURE = Signature(np.array([3.0, 2, 1, 0.5]), "r-bihdm", deviation=np.array([0.1, 0.2, 0.1, 0.1]))
TABLE = SignatureTable(("a", "b"), np.array([[1.0, 2], [3, 4]]), "r-bihdm", labels=("cat", None))
NEIGHBORS = Neighbors(("a", "b"), np.array([0.0, 0.5]))


def eigenpairs() -> Eigenpairs:
    return pr.eigenpairs(pr.laplace_beltrami(MESH), 5)


VALUES: dict[str, Any] = {
    "cloud": CLOUD,
    "mesh": MESH,
    "signature": SIGNATURE,
    "table": TABLE,
    "neighbors": NEIGHBORS,
    "eigenpairs": eigenpairs(),
    "spectrum": ModalSpectrum.of(eigenpairs()),
    "shape": Shape((Surface(MESH.area, mesh=MESH),)),
    "operator": pr.laplace_beltrami(MESH),
}


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


@pytest.mark.parametrize("options", ["clean-mesh", {"surface": {"mode": "keep"}}], ids=["preset", "mapping"])
def test_options_may_be_named_or_written_down(options: Any) -> None:
    assert pr.PipelineOptions.of(options).surface.mode == "keep"
    np.testing.assert_array_equal(
        pr.signature(MESH, options).values,
        pr.signature(MESH, pr.PipelineOptions().changed(surface={"mode": "keep"})).values,
    )


def test_no_other_options() -> None:
    with pytest.raises(OptionError, match=r"options must be PipelineOptions, a mapping .*, got int"):
        pr.signature(MESH, 3)  # type: ignore[arg-type]


def test_a_signature_is_an_array() -> None:
    np.testing.assert_array_equal(np.asarray(SIGNATURE), SIGNATURE.values)
    assert np.asarray(SIGNATURE, dtype=np.float32).dtype == np.float32
    np.log(SIGNATURE)
    assert np.asarray(TABLE).shape == (2, 2)


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_values_are_shown_in_one_line_and_pickled(value: Any) -> None:
    line = repr(value)
    assert line.startswith(type(value).__name__ + "(")
    assert "\n" not in line
    assert len(line) < 120
    again = pickle.loads(pickle.dumps(value))
    assert repr(again) == line
    assert again == value


@pytest.mark.parametrize("name", ["cloud", "mesh", "shape"])
def test_notebooks_show_a_picture(name: str) -> None:
    html = VALUES[name]._repr_html_()
    assert 'src="data:image/png;base64,' in html
    assert "<script" not in html


@pytest.mark.parametrize("name", ["cloud", "mesh", "signature", "neighbors", "eigenpairs", "spectrum"])
def test_plots_draw_into_the_axes_given(name: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    axes = VALUES[name].plot()
    assert axes.has_data()
    axes.figure.canvas.draw()
    assert VALUES[name].plot(axes) is axes
    pyplot.close("all")


def test_tables_go_to_pandas() -> None:
    frame = TABLE.to_pandas()
    assert list(frame.columns) == ["label", "v1", "v2"]
    assert frame.loc["b", "v2"] == 4
    assert NEIGHBORS.to_pandas().loc[2, "id"] == "b"
