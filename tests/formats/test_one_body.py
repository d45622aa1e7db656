"""One body in forty files of twenty formats, by other libraries, has one signature."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import open3d
import pandas
import pytest
import pyvista
import shapes
import trimesh
from pypcd4.pypcd4 import PointCloud as Pcd
from scan_files import CAN_WRITE, collada, write_e57, write_las

import pcretrieve as pr
from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.formats.registry import missing_extra
from pcretrieve.values import FloatArray
from pcretrieve.values.topology import defects

# Its values are smooth: a histogram jumps where a rounding error moves a voxel.
R_BIHDM = {"signature": {"method": "r-bihdm"}}

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

Writers = dict[str, Callable[[Path], object]]


def mesh_writers() -> Writers:
    """Of trimesh, Open3D, VTK (by PyVista) and pycollada."""
    of_trimesh, of_open3d = TOUCHING.to_trimesh(), TOUCHING.to_open3d()
    of_open3d.compute_vertex_normals()
    of_vtk = pyvista.PolyData.from_regular_faces(
        np.array(TOUCHING.vertices), TOUCHING.faces.tolist()
    )

    def gltf(path: Path) -> None:
        for name, data in of_trimesh.export(file_type="gltf").items():
            (path if name.endswith(".gltf") else path.parent / name).write_bytes(data)

    def by_open3d(**options: Any) -> Callable[[Path], object]:
        return lambda path: open3d.io.write_triangle_mesh(path, of_open3d, **options)

    return {
        **{
            f"trimesh.{suffix}": of_trimesh.export
            for suffix in ("ply", "obj", "off", "stl", "glb")
        },
        "trimesh_text.ply": lambda path: path.write_bytes(
            of_trimesh.export(file_type="ply", encoding="ascii")
        ),
        "trimesh_text.stl": lambda path: path.write_text(
            of_trimesh.export(file_type="stl_ascii")
        ),
        "trimesh.gltf": gltf,
        "trimesh.3mf": trimesh.Scene(of_trimesh).export,
        **{
            f"open3d.{suffix}": by_open3d()
            for suffix in ("ply", "obj", "off", "stl", "glb", "gltf")
        },
        "open3d_text.ply": by_open3d(write_ascii=True),
        **{f"vtk.{suffix}": of_vtk.save for suffix in ("ply", "obj", "stl")},
        "vtk_text.ply": lambda path: of_vtk.save(path, binary=False),
        "vtk_text.stl": lambda path: of_vtk.save(path, binary=False),
        "pycollada.dae": lambda path: path.write_text(collada(TOUCHING)),
    }


def cloud_writers() -> Writers:
    """Of Open3D, trimesh, pypcd4, laspy, pye57, NumPy and pandas."""
    of_open3d = PointCloud(POINTS).to_open3d()
    of_open3d.paint_uniform_color([0.2, 0.4, 0.6])
    of_trimesh: Any = PointCloud(POINTS).to_trimesh()
    table = pandas.DataFrame(POINTS, columns=["x", "y", "z"])

    def by_open3d(**options: Any) -> Callable[[Path], object]:
        return lambda path: open3d.io.write_point_cloud(path, of_open3d, **options)

    return {
        **{
            f"open3d.{suffix}": by_open3d()
            for suffix in ("ply", "pcd", "xyz", "xyzrgb", "pts")
        },
        "open3d_text.ply": by_open3d(write_ascii=True),
        "open3d_text.pcd": by_open3d(write_ascii=True),
        "open3d_compressed.pcd": by_open3d(compressed=True),
        "trimesh.ply": of_trimesh.export,
        "trimesh.xyz": of_trimesh.export,
        "pypcd4.pcd": Pcd.from_xyz_points(POINTS.astype(np.float32)).save,
        "laspy.las": lambda path: write_las(path, POINTS),
        "laspy.laz": lambda path: write_las(path, POINTS),
        "pye57.e57": lambda path: write_e57(path, [{"points": POINTS}]),
        "numpy.txt": lambda path: np.savetxt(path, POINTS),
        "numpy.asc": lambda path: np.savetxt(
            path, POINTS, delimiter="\t", header="x y z"
        ),
        "numpy.csv": lambda path: np.savetxt(path, POINTS, delimiter=","),
        "pandas.csv": table.to_csv,
        "excel.csv": lambda path: table.to_csv(path, sep=";", decimal=",", index=False),
        "double.npy": lambda path: np.save(path, POINTS),
        "single.npy": lambda path: np.save(path, POINTS.astype(np.float32)),
        "plain.npz": lambda path: np.savez(path, POINTS),
        "named.npz": lambda path: np.savez_compressed(path, points=POINTS),
    }


def written(writers: Writers, folder: Path) -> Iterator[Path]:
    for name, write in writers.items():
        file = folder / name
        if not missing_extra(file.suffix) and CAN_WRITE.get(file.suffix, True):
            with warnings.catch_warnings():
                # Of the libraries that write.
                warnings.simplefilter("ignore", DeprecationWarning)
                write(file)
            yield file


def test_the_surface_of_every_file_has_one_signature(tmp_path: Path) -> None:
    """No format merges the vertices of parts that touch, nor leaves seams open."""
    expected = pr.signature(TOUCHING, R_BIHDM).values
    for file in written(mesh_writers(), tmp_path):
        found = read_scan(file)
        assert isinstance(found, TriangleMesh), file
        assert len(found.vertices) == len(TOUCHING.vertices), file
        assert len(found.faces) == len(TOUCHING.faces), file
        assert not defects(found), file
        # trimesh writes 3MF files in millimetres, which are read in metres.
        volume = TOUCHING.volume * (1e-9 if file.suffix == ".3mf" else 1)
        assert found.volume == pytest.approx(volume, rel=1e-5), file
        values = pr.signature(file, R_BIHDM).values
        np.testing.assert_allclose(
            values, expected, rtol=SURFACE_TOLERANCE, err_msg=str(file)
        )


@pytest.mark.slow
def test_the_points_of_every_file_have_one_signature(tmp_path: Path) -> None:
    """Most files give the same numbers: a signature is computed once for each array."""
    expected = pr.signature(PointCloud(POINTS), R_BIHDM).values
    signatures: dict[bytes, FloatArray] = {}
    for file in written(cloud_writers(), tmp_path):
        found = read_scan(file)
        assert isinstance(found, PointCloud), file
        assert found.normals is None, file
        atol = STEP if file.suffix in (".las", ".laz") else DIGITS
        np.testing.assert_allclose(found.points, POINTS, atol=atol, err_msg=str(file))
        key = found.points.tobytes()
        if key not in signatures:
            signatures[key] = pr.signature(found, R_BIHDM).values
        np.testing.assert_allclose(
            signatures[key], expected, rtol=POINTS_TOLERANCE, err_msg=str(file)
        )
