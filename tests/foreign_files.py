"""Files of one body, by libraries that are not pcretrieve: forty files of twenty formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from laser_files import CAN_WRITE, write_e57, write_las
from numpy.typing import NDArray

from pcretrieve import TriangleMesh
from pcretrieve.formats import missing_extra

__all__ = ["write_clouds", "write_meshes"]

Writers = dict[str, Callable[[Path], object]]


def write_meshes(mesh: TriangleMesh, folder: Path) -> list[Path]:
    """A surface, in a folder for each library."""
    return [
        *_by_trimesh(mesh, folder),
        *_by_open3d(mesh, folder),
        *_by_vtk(mesh, folder),
        *_by_collada(mesh, folder),
    ]


def write_clouds(points: NDArray[np.float64], folder: Path) -> list[Path]:
    """A point cloud, in a folder for each library."""
    return [*_clouds_by_open3d(points, folder), *_tables(points, folder), *_clouds_by_others(points, folder)]


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
