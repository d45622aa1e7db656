"""One body in forty files of twenty formats, by other libraries, has one signature."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scan_files import CAN_WRITE, write_e57, write_las

import pcretrieve as pr
from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.formats import missing_extra
from pcretrieve.surface import defects
from pcretrieve.values import FloatArray

BODY = shapes.body(3)
POINTS = shapes.points_on(BODY, 6000)
# Vertices 0 and 1 have no neighbours in common: two parts touch in a point.
TOUCHING = TriangleMesh(BODY.vertices[[1, *range(1, len(BODY.vertices))]], BODY.faces)
# Largest error of coordinates of about 1, in text of six digits; and in LAS files of steps of 1e-4.
DIGITS, STEP = 6e-6, 6e-5
# Relative difference of the values of signatures of one surface: the order of sums, and single precision.
SURFACE_TOLERANCE = 1e-4
# The same of points, of which the reconstruction may put single cells to another side.
POINTS_TOLERANCE = 0.02

EVERYTHING = all(CAN_WRITE.values()) and not any(map(missing_extra, (".3mf", ".dae", ".e57", ".laz")))


Writers = dict[str, Callable[[Path], object]]


def _written(folder: Path, writers: Writers) -> list[Path]:
    folder.mkdir(parents=True)
    for name, write in writers.items():
        if not missing_extra(Path(name).suffix):
            write(folder / name)
    return [folder / name for name in writers if (folder / name).exists()]


def _by_trimesh(mesh: TriangleMesh, folder: Path) -> list[Path]:
    import trimesh

    body: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)

    scene: Any = trimesh.Scene(body)

    def write_gltf(path: Path) -> None:
        for name, data in body.export(file_type="gltf").items():
            (path if name.endswith(".gltf") else path.parent / name).write_bytes(data)

    return _written(
        folder / "trimesh",
        {
            "binary.ply": body.export,
            "text.ply": lambda path: path.write_bytes(body.export(file_type="ply", encoding="ascii")),
            "body.obj": body.export,
            "body.off": body.export,
            "binary.stl": body.export,
            "text.stl": lambda path: path.write_text(body.export(file_type="stl_ascii")),
            "body.glb": body.export,
            "body.gltf": write_gltf,
            "body.3mf": lambda path: scene.export(path),
        },
    )


def _by_open3d(mesh: TriangleMesh, folder: Path) -> list[Path]:
    import open3d

    body: Any = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.array(mesh.vertices)),
        open3d.utility.Vector3iVector(np.array(mesh.faces)),
    )
    body.compute_vertex_normals()

    def write(**options: bool) -> Callable[[Path], object]:
        return lambda path: open3d.io.write_triangle_mesh(path, body, **options)

    return _written(
        folder / "open3d",
        {
            "binary.ply": write(),
            "text.ply": write(write_ascii=True),
            "body.obj": write(),
            "body.off": write(),
            "body.stl": write(),
            "body.glb": write(),
            "body.gltf": write(),
        },
    )


def _by_vtk(mesh: TriangleMesh, folder: Path) -> list[Path]:
    """VTK, by PyVista."""
    import pyvista

    body = pyvista.PolyData.from_regular_faces(np.array(mesh.vertices), mesh.faces.tolist())

    return _written(
        folder / "vtk",
        {
            "binary.ply": body.save,
            "text.ply": lambda path: body.save(path, binary=False),
            "binary.stl": body.save,
            "text.stl": lambda path: body.save(path, binary=False),
            "body.obj": body.save,
        },
    )


def _by_collada(mesh: TriangleMesh, folder: Path) -> list[Path]:
    def write(path: Path) -> None:
        import collada  # type: ignore[import-not-found,import-untyped,unused-ignore]

        document = collada.Collada()
        source = collada.source.FloatSource("points", mesh.vertices.ravel(), ("X", "Y", "Z"))
        geometry = collada.geometry.Geometry(document, "body", "body", [source])
        inputs = collada.source.InputList()
        inputs.addInput(0, "VERTEX", "#points")
        geometry.primitives.append(geometry.createTriangleSet(mesh.faces.ravel(), inputs, "paint"))
        document.geometries.append(geometry)
        node = collada.scene.Node("node", children=[collada.scene.GeometryNode(geometry, [])])
        document.scenes.append(collada.scene.Scene("scene", [node]))
        document.scene = document.scenes[0]
        with path.open("wb") as file:
            document.write(file)

    return _written(folder / "pycollada", {"body.dae": write})


def _clouds_by_open3d(points: NDArray[np.float64], folder: Path) -> list[Path]:
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.paint_uniform_color([0.2, 0.4, 0.6])

    def write(**options: Any) -> Callable[[Path], object]:
        return lambda path: open3d.io.write_point_cloud(path, cloud, **options)

    return _written(
        folder / "open3d_points",
        {
            "binary.ply": write(),
            "text.ply": write(write_ascii=True),
            "binary.pcd": write(),
            "text.pcd": write(write_ascii=True),
            "compressed.pcd": write(compressed=True),
            "body.xyz": write(),
            "body.xyzrgb": write(),
            "body.pts": write(),
        },
    )


def _tables(points: NDArray[np.float64], folder: Path) -> list[Path]:
    """NumPy and, in part, pandas."""
    import pandas

    table = pandas.DataFrame(points, columns=["x", "y", "z"])
    return _written(
        folder / "tables",
        {
            "body.txt": lambda path: np.savetxt(path, points),
            "body.asc": lambda path: np.savetxt(path, points, delimiter="\t", header="x y z"),
            "numpy.csv": lambda path: np.savetxt(path, points, delimiter=","),
            "pandas.csv": lambda path: table.to_csv(path),
            "excel.csv": lambda path: table.to_csv(path, sep=";", decimal=",", index=False),
            "double.npy": lambda path: np.save(path, points),
            "single.npy": lambda path: np.save(path, points.astype(np.float32)),
            "plain.npz": lambda path: np.savez(path, points),
            "named.npz": lambda path: np.savez_compressed(path, points=points),
        },
    )


def _clouds_by_others(points: NDArray[np.float64], folder: Path) -> list[Path]:
    import trimesh
    from pypcd4.pypcd4 import PointCloud

    cloud: Any = trimesh.PointCloud(points)  # type: ignore[no-untyped-call]
    writers: Writers = {
        "trimesh.ply": cloud.export,
        "trimesh.xyz": cloud.export,
        "pypcd4.pcd": lambda path: PointCloud.from_xyz_points(points.astype(np.float32)).save(path),
    }
    if CAN_WRITE[".laz"]:
        writers |= {
            "laspy.las": lambda path: write_las(path, points),
            "laspy.laz": lambda path: write_las(path, points),
        }
    if CAN_WRITE[".e57"]:
        writers["pye57.e57"] = lambda path: write_e57(path, [{"points": points}])
    return _written(folder / "others", writers)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("meshes")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the libraries that write
        return [
            path
            for write in (_by_trimesh, _by_open3d, _by_vtk, _by_collada)
            for path in write(TOUCHING, folder)
        ]


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("clouds")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        writers = (_clouds_by_open3d, _tables, _clouds_by_others)
        return [path for write in writers for path in write(POINTS, folder)]


@pytest.mark.skipif(not EVERYTHING, reason="needs the extras meshes, las, e57 and laspy")
def test_there_are_forty_files_of_twenty_formats(meshes: list[Path], clouds: list[Path]) -> None:
    files = [*meshes, *clouds]
    assert len(files) >= 40
    assert len({file.suffix for file in files}) >= 20


def test_the_surface_of_every_file_has_one_signature(meshes: list[Path]) -> None:
    """No format merges the vertices of parts that touch, nor leaves seams open."""
    expected = pr.signature(TOUCHING).values
    for file in meshes:
        found = read_scan(file)
        assert isinstance(found, TriangleMesh), file
        assert len(found.vertices) == len(TOUCHING.vertices), file
        assert len(found.faces) == len(TOUCHING.faces), file
        assert not defects(found), file
        # trimesh writes 3MF files in millimetres, which are read in metres.
        volume = TOUCHING.volume * (1e-9 if file.suffix == ".3mf" else 1)
        assert found.volume == pytest.approx(volume, rel=1e-5), file
        values = pr.signature(file).values
        np.testing.assert_allclose(values, expected, rtol=SURFACE_TOLERANCE, err_msg=str(file))


@pytest.mark.slow
def test_the_points_of_every_file_have_one_signature(clouds: list[Path]) -> None:
    """Most files give the same numbers: a signature is computed once for each array."""
    expected = pr.signature(PointCloud(POINTS)).values
    signatures: dict[bytes, FloatArray] = {}
    for file in clouds:
        found = read_scan(file)
        assert isinstance(found, PointCloud), file
        assert found.normals is None, file
        atol = STEP if file.suffix in (".las", ".laz") else DIGITS
        np.testing.assert_allclose(found.points, POINTS, atol=atol, err_msg=str(file))
        key = found.points.tobytes()
        if key not in signatures:
            signatures[key] = pr.signature(found).values
        np.testing.assert_allclose(signatures[key], expected, rtol=POINTS_TOLERANCE, err_msg=str(file))
    assert len(signatures) < len(clouds)
