"""Reading a damaged file gives a scan, or an error that names the defect of the file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
import trimesh
from mutations import mutated, read_damaged
from PIL import Image
from pypcd4.pypcd4 import Encoding, PointCloud as Pcd
from scan_files import (
    CAN_WRITE,
    collada,
    three_mf,
    with_checksums,
    without_checksums,
    write_gltf,
    write_laser_scan,
)

from pcretrieve import PointCloud, TriangleMesh
from pcretrieve.formats import missing_extra, read_scan, write_cloud, write_mesh
from pcretrieve.formats.registry import FORMATS

N_SEEDS = int(os.environ.get("PCRETRIEVE_SEEDS", "60"))

BALL = shapes.icosphere(1)
NORMALS = BALL.vertices / np.linalg.norm(BALL.vertices, axis=1, keepdims=True)
CLOUD = PointCloud(BALL.vertices, NORMALS, 3 * NORMALS)
PLY = (
    "ply\nformat {} 1.0\nelement vertex 42\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 3\nproperty list uchar int vertex_indices\nend_header\n"
)
POLYGONS = [[0, 1, 2], [2, 3, 4, 5], [6, 7, 8]]
PTX = "6\n7\n1 2 3\n1 0 0\n0 1 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n1 2 3 1\n"
GRID = np.array([[x, y, 9 - (x * x + y * y) / 20] for x in range(6) for y in range(7)])
DEPTH = np.fromfunction(lambda v, u: 1500 + u * u + v, (30, 40)).astype(np.uint16)
CONF = "camera 0 0 0\nbmesh cloud.ply 0 0 0 0 0 0 1\nbmesh cloud.pcd 0 0 1 0 0.6 0 0.8\n"


def lines(rows: Any) -> str:
    return "".join(" ".join(f"{value:.6g}" for value in row) + "\n" for row in rows)


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A whole file of each format in each of its encodings, by name."""
    folder = tmp_path_factory.mktemp("originals")
    for suffix in ("ply", "obj", "off", "stl", "glb"):
        write_mesh(BALL, folder / f"mesh.{suffix}")
    for suffix in ("ply", "pcd", "xyzn"):
        write_cloud(CLOUD, folder / f"cloud.{suffix}")
    sizes = [[len(polygon), *polygon] for polygon in POLYGONS]
    (folder / "text.ply").write_text(PLY.format("ascii") + lines(BALL.vertices) + lines(sizes))
    rows = [np.array(BALL.vertices, dtype=">f4").tobytes()]
    rows += [bytes([len(polygon)]) + np.array(polygon, dtype=">i4").tobytes() for polygon in POLYGONS]
    (folder / "big_endian.ply").write_bytes(PLY.format("binary_big_endian").encode() + b"".join(rows))
    pcd = Pcd.from_xyz_points(BALL.vertices.astype(np.float32))
    for encoding in (Encoding.ASCII, Encoding.BINARY_COMPRESSED):
        pcd.save(folder / f"{encoding.value}.pcd", encoding=encoding)
    (folder / "lines.xyz").write_text(lines(BALL.vertices))
    (folder / "lines.pts").write_text("42\n" + lines(BALL.vertices))
    (folder / "lines.xyzrgb").write_text(lines(np.tile(BALL.vertices, 2)))
    (folder / "lines.asc").write_text("// X Y Z\n" + lines(BALL.vertices))
    (folder / "lines.csv").write_text("x,y,z\n" + lines(BALL.vertices).replace(" ", ","))
    (folder / "lines.txt").write_text(lines(np.column_stack([BALL.vertices, NORMALS])))
    (folder / "grids.ptx").write_text(2 * (PTX + lines(np.column_stack([GRID, GRID[:, 0]]))))
    write_gltf(folder / "scene.gltf", BALL, [{"mesh": 0}], "scene.bin")
    write_gltf(folder / "data.gltf", BALL, [{"mesh": 0}])
    (folder / "scene.3mf").write_bytes(three_mf(BALL))
    (folder / "scene.dae").write_text(collada(BALL))
    for suffix in (".las", ".laz", ".e57"):
        if CAN_WRITE[suffix]:
            write_laser_scan(folder / f"scan{suffix}", BALL.vertices)
    for name in ("depth.png", "depth.tif", "depth.tiff"):
        Image.fromarray(DEPTH).save(folder / name)
    np.save(folder / "depth.npy", DEPTH)
    (folder / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 20\ncy = 15\n")
    np.save(folder / "array.npy", BALL.vertices)
    np.savez_compressed(folder / "arrays.npz", points=BALL.vertices, normals=NORMALS)
    ball: Any = trimesh.Trimesh(BALL.vertices, BALL.faces)
    (folder / "text.stl").write_text(ball.export(file_type="stl_ascii"))
    (folder / "views.conf").write_text(CONF)
    return {path.name: path for path in folder.iterdir() if path.suffix in FORMATS.own}


NAMES = (
    *("mesh.ply", "cloud.ply", "text.ply", "big_endian.ply", "mesh.obj", "mesh.off", "mesh.stl", "text.stl"),
    *("mesh.glb", "cloud.pcd", "ascii.pcd", "binary_compressed.pcd", "cloud.xyzn", "lines.xyz", "lines.pts"),
    *("lines.xyzrgb", "lines.asc", "lines.csv", "lines.txt", "grids.ptx", "array.npy", "arrays.npz"),
    *("scene.gltf", "data.gltf", "scene.3mf", "scene.dae"),
    *(f"scan{suffix}" for suffix in (".las", ".laz", ".e57") if CAN_WRITE[suffix]),
    *("depth.png", "depth.tif", "depth.tiff", "depth.npy"),
    "views.conf",
)


def test_every_format_is_damaged(originals: dict[str, Path]) -> None:
    assert originals.keys() == {*NAMES}
    unwritten = {suffix for suffix, can in CAN_WRITE.items() if not can}
    assert {path.suffix for path in originals.values()} == FORMATS.own.keys() - unwritten
    for path in originals.values():
        if not missing_extra(path.suffix):
            read_scan(path)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_is_not_utf8_is_read_as_any_other(name: str, originals: dict[str, Path]) -> None:
    if extra := missing_extra(originals[name].suffix):
        pytest.skip(f"needs the extra {extra.name}")
    other = originals[name].with_name(os.fsdecode(b"latin-\xe9") + originals[name].suffix)
    other.write_bytes(originals[name].read_bytes())
    scan, expected = read_scan(other), read_scan(originals[name])
    other.unlink()
    if isinstance(scan, TriangleMesh) and isinstance(expected, TriangleMesh):
        scan, expected = PointCloud(scan.vertices), PointCloud(expected.vertices)
    assert scan == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_damaged_file_is_a_scan_or_an_error_of_that_file(name: str, originals: dict[str, Path]) -> None:
    if extra := missing_extra(originals[name].suffix):
        pytest.skip(f"needs the extra {extra.name}")
    whole = originals[name].read_bytes()
    damaged = originals[name].with_name(f"damaged{originals[name].suffix}")  # beside the views of a .conf

    def contents(seed: int) -> bytes:
        if damaged.suffix == ".e57":
            return with_checksums(mutated(without_checksums(whole), seed), len(whole))
        return mutated(whole, seed)

    n_errors, faults = read_damaged(damaged, contents, read_scan, N_SEEDS, named=str(damaged))
    assert not faults
    assert n_errors
