"""Readers: a scan has the content of its file."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scan_files import XYZ, pcd_header

from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import RawScan, write_cloud, write_mesh
from pcretrieve.ingestion.discover import content_hash, discover
from pcretrieve.surface import defects

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
# Corners of each side, counter-clockwise from outside.
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
HALVES = [half for a, b, c, d in SIDES for half in ((a, b, c), (a, c, d))]
FACES: dict[str, list[tuple[int, ...]]] = {
    "triangles": [*HALVES],
    "quads": [*SIDES],
    "mixed": [*SIDES[:3], *HALVES[6:]],
}


def cloud(path: Path) -> PointCloud:
    found = read_scan(path)
    assert isinstance(found, PointCloud)
    return found


def mesh(path: Path) -> TriangleMesh:
    found = read_scan(path)
    assert isinstance(found, TriangleMesh)
    return found


def is_cube(found: TriangleMesh) -> bool:
    return not defects(found) and found.area == pytest.approx(6) and found.volume == pytest.approx(1)


# --- polygons -----------------------------------------------------------------------------------------


def obj_lines(separator: str = "") -> str:
    """The cube as OBJ; each corner of each side with a texture or a normal of its own, where asked for."""
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in CUBE]
    lines += ["vt 0.5 0.5", "vn 0 0 1"] * 24
    for k, side in enumerate(SIDES):
        own = [f"{separator}{4 * k + corner + 1}" if separator else "" for corner in range(4)]
        lines += [f"usemtl paint{k}", "f " + " ".join(f"{v + 1}{o}" for v, o in zip(side, own, strict=True))]
    return "\n".join(lines)


@pytest.mark.parametrize("separator", ["", "/", "//"], ids=["plain", "textures", "normals"])
def test_seams_of_textures_and_materials_do_not_open_an_obj(separator: str, tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(obj_lines(separator))
    found = mesh(tmp_path / "cube.obj")
    assert len(found.vertices) == 8
    assert is_cube(found)


def test_obj_counts_backwards_too(tmp_path: Path) -> None:
    lines = [f"v {x:g} {y:g} {z:g} 1.0" for x, y, z in CUBE]
    lines += ["f " + " ".join(str(v - 8) for v in side) + "  # a side" for side in SIDES]
    (tmp_path / "cube.OBJ").write_text("\n".join(lines))
    assert is_cube(mesh(tmp_path / "cube.OBJ"))


def test_obj_without_faces_is_a_cloud(tmp_path: Path) -> None:
    (tmp_path / "points.obj").write_text("\n".join(f"v {x} {y} {z}" for x, y, z in CUBE))
    np.testing.assert_array_equal(cloud(tmp_path / "points.obj").points, CUBE)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("polygons", FACES)
def test_ply_polygons(form: str, polygons: str, tmp_path: Path) -> None:
    faces = FACES[polygons]
    header = (
        f"ply\nformat {form} 1.0\ncomment a cube\nelement vertex 8\n{XYZ}"
        f"element face {len(faces)}\nproperty list uchar int vertex_index\nend_header\n"
    )
    if form == "ascii":
        rows = [*(" ".join(map(str, point)) for point in CUBE)]
        rows += [" ".join(map(str, (len(face), *face))) for face in faces]
        body = "\n".join(rows).encode()
    else:
        order = "<" if "little" in form else ">"
        body = CUBE.astype(f"{order}f4").tobytes()
        body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    (tmp_path / "cube.ply").write_bytes(header.encode() + body)
    assert is_cube(mesh(tmp_path / "cube.ply"))


def test_off_polygons_and_comments(tmp_path: Path) -> None:
    lines = ["OFF # a cube", "8 6 0", *(" ".join(map(str, point)) for point in CUBE)]
    lines += [" ".join(map(str, (4, *side))) for side in SIDES]
    (tmp_path / "cube.off").write_text("\n".join(lines))
    assert is_cube(mesh(tmp_path / "cube.off"))


def test_faces_of_two_corners_leave_points(tmp_path: Path) -> None:
    rows = [*(" ".join(map(str, point)) for point in CUBE), "2 0 1", "2 1 2"]
    (tmp_path / "lines.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 8\n{XYZ}element face 2\n"
        "property list uchar int vertex_indices\nend_header\n" + "\n".join(rows) + "\n"
    )
    found = cloud(tmp_path / "lines.ply")
    assert len(found.points) == 8
    assert found.provenance[0].notes == ("took the vertices as points: no face has three of them",)


# --- normals and sensors --------------------------------------------------------------------------------


def ply_table(path: Path, names: str, rows: NDArray[np.float64], *, grid: bool = False) -> None:
    """Vertices with these properties; behind them, where asked for, the sampling grid of a range scanner."""
    properties = "".join(f"property double {name}\n" for name in names.split())
    trailing = "element range_grid 2\nproperty list uchar int vertex_indices\n" if grid else ""
    header = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{properties}{trailing}end_header\n"
    body = "\n".join(" ".join(map(str, row)) for row in rows) + ("\n0\n1 0\n" if grid else "\n")
    path.write_text(header + body)


def test_ply_normals_become_unit_vectors_and_each_point_keeps_its_sensor(tmp_path: Path) -> None:
    rows = np.column_stack([CUBE, 3 * (CUBE - 0.5), CUBE + 10])
    ply_table(tmp_path / "a.ply", "x y z nx ny nz vp_x vp_y vp_z", rows)
    found = cloud(tmp_path / "a.ply")
    assert found.normals is not None
    assert found.viewpoints is not None
    np.testing.assert_allclose(found.normals, (CUBE - 0.5) / np.sqrt(0.75), atol=1e-6)
    np.testing.assert_allclose(found.viewpoints, CUBE + 10)


def test_what_stands_behind_the_points_of_a_ply_is_left_unread(tmp_path: Path) -> None:
    ply_table(tmp_path / "a.ply", "x y z confidence", np.column_stack([CUBE, np.ones(8)]), grid=True)
    np.testing.assert_array_equal(cloud(tmp_path / "a.ply").points, CUBE)


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_pcd_encodings(data: str, tmp_path: Path) -> None:
    from pypcd4.pypcd4 import Encoding
    from pypcd4.pypcd4 import PointCloud as Pcd

    fields = ("x", "y", "z", "normal_x", "normal_y", "normal_z")
    rows = np.column_stack([CUBE, np.tile([0, 0, 2.0], (8, 1))]).astype(np.float32)
    content = Pcd.from_points(rows, fields, [np.float32] * 6)
    content.metadata.viewpoint = (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    content.save(tmp_path / "a.pcd", encoding=Encoding(data))
    found = cloud(tmp_path / "a.pcd")
    np.testing.assert_array_equal(found.points, CUBE)
    np.testing.assert_array_equal(found.normals, np.tile([0, 0, 1.0], (8, 1)))
    np.testing.assert_array_equal(found.viewpoints, np.tile([1.0, 2.0, 3.0], (8, 1)))


def test_pcd_fields_of_sensors_come_before_its_header(tmp_path: Path) -> None:
    header = pcd_header("x", "y", "z", "vp_x", "vp_y", "vp_z", n=2, viewpoint="9 9 9 1 0 0 0")
    (tmp_path / "a.pcd").write_text(header + "0 0 0 1 2 3\n1 1 1 4 5 6\n")
    np.testing.assert_array_equal(cloud(tmp_path / "a.pcd").viewpoints, [[1, 2, 3], [4, 5, 6]])


def test_pcd_text_may_be_spaced_at_will(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes((pcd_header("x", "y", "z", n=2) + " 1  2 3 \n4\t5 6\n").encode())
    (tmp_path / "b.pcd").write_bytes((tmp_path / "a.pcd").read_bytes().replace(b"\n", b"\r\n"))
    for name in ("a.pcd", "b.pcd"):
        np.testing.assert_array_equal(cloud(tmp_path / name).points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("normal", ["0 0 0", "nan 0 0"])
def test_normals_without_a_direction_are_left_out_with_a_note(normal: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyzn").write_text(f"0 0 0 0 0 1\n1 0 0 {normal}\n")
    found = cloud(tmp_path / "a.xyzn")
    assert found.normals is None
    assert found.provenance[0].notes == ("ignored the file's normals: 1 of them have no direction",)


@pytest.mark.parametrize("position", [np.nan, np.inf, -1e60])
def test_sensors_nowhere_are_left_out_with_a_note(position: float, tmp_path: Path) -> None:
    ply_table(tmp_path / "a.ply", "x y z vp_x vp_y vp_z", np.column_stack([CUBE, np.full((8, 3), position)]))
    found = cloud(tmp_path / "a.ply")
    assert found.viewpoints is None
    assert found.provenance[0].notes == (
        "ignored the file's sensor positions: some are NaN, infinite or beyond 1e+50",
    )


# --- points that are no numbers -------------------------------------------------------------------------


def test_points_that_are_nan_or_infinite_go_with_all_that_belongs_to_them(tmp_path: Path) -> None:
    (tmp_path / "a.xyzn").write_text("0 0 0 1 0 0\nnan 0 0 0 1 0\n1 2 3 0 0 1\n1 inf 3 0 0 1\n")
    found = cloud(tmp_path / "a.xyzn")
    np.testing.assert_array_equal(found.points, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(found.normals, [[1, 0, 0], [0, 0, 1]])
    assert found.provenance[0].notes == ("dropped 2 of 4 points that were NaN or infinite",)


def test_a_vertex_that_is_nan_takes_its_faces_with_it(tmp_path: Path) -> None:
    ball = shapes.icosphere(2)
    lines = [f"v {x} {y} {z}" for x, y, z in ball.vertices]
    lines[7] = "v 0 nan 0"
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in ball.faces]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    found = mesh(tmp_path / "ball.obj")
    n_around = int((ball.faces == 7).any(axis=1).sum())
    assert len(found.vertices) == len(ball.vertices) - 1
    assert len(found.faces) == len(ball.faces) - n_around
    assert defects(found).boundary_edges == n_around


# --- text -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6",
        "\ufeff1,2,3\r\n4,5,6\r\n",
        "# scanned\n1; 2; 3\n\n4; 5; 6  # last\n",
        "1\t2\t3 9\n4 5 6 9\n",
    ],
    ids=["plain", "byte order mark", "comments", "more columns"],
)
def test_ways_to_write_points(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text, encoding="utf-8", newline="")
    np.testing.assert_array_equal(cloud(tmp_path / "a.xyz").points, [[1, 2, 3], [4, 5, 6]])


def test_a_pts_file_without_a_count(tmp_path: Path) -> None:
    (tmp_path / "a.pts").write_text("1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(cloud(tmp_path / "a.pts").points, [[1, 2, 3], [4, 5, 6]])


# --- other people's readers -----------------------------------------------------------------------------


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an installed package that reads .grid files."""
    site = tmp_path / "site"
    (site / "gridscan-1.0.dist-info").mkdir(parents=True)
    (site / "gridscan-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: gridscan\nVersion: 1.0\n"
    )
    (site / "gridscan-1.0.dist-info" / "entry_points.txt").write_text(
        "[pcretrieve.readers]\n.grid = gridscan:read_grid\n"
    )
    (site / "gridscan.py").write_text(
        "import numpy as np\nfrom pcretrieve.formats import RawScan\n\n"
        "def read_grid(path):\n    return RawScan(np.loadtxt(path), notes=('read as a grid',))\n"
    )
    monkeypatch.syspath_prepend(site)
    monkeypatch.delitem(sys.modules, "gridscan", raising=False)
    return site


def test_an_installed_package_brings_a_reader(plugin: Path, tmp_path: Path) -> None:
    (tmp_path / "a.GRID").write_text("1 2 3\n4 5 6\n")
    found = cloud(tmp_path / "a.GRID")
    np.testing.assert_array_equal(found.points, [[1, 2, 3], [4, 5, 6]])
    assert found.provenance[0].notes == ("read as a grid",)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import a_module_that_is_nowhere", "cannot be loaded, ModuleNotFoundError: No module named"),
        ("raise SystemExit(0)", "cannot be loaded, SystemExit: 0;"),
        ("x = 1 / 0", "cannot be loaded, ZeroDivisionError: division by zero"),
        ("read_mesh = None", "cannot be loaded, AttributeError: module 'gridscan' has no attribute"),
        ("read_grid = None", "must be a Format, or a function that reads a file, got NoneType;"),
        ("def read_grid(path): return [1, 2]", "failed, TypeError: a reader must return a RawScan, got list"),
        ("def read_grid(path): raise SystemExit(0)", "failed, SystemExit: 0"),
        ("def read_grid(path): return path.suffix / 2", "failed, TypeError: unsupported operand"),
        ("def read_grid(path): return RawScan([1, 2])", "points must have the shape (n, 3), got (2,)"),
        ("def read_grid(path): return RawScan('abc')", "failed, ValueError: could not convert string"),
        (
            "def read_grid(path): return RawScan([[1, 2, 3]], normals=[[0, 0, 1]] * 2)",
            "normals must have the shape (1, 3), got (2, 3)",
        ),
        (
            "def read_grid(path): return RawScan([[1, 2, 3]], faces=[[0, 0, 0.5]])",
            "faces must be whole numbers",
        ),
    ],
)
def test_a_package_whose_reader_is_broken_fails_its_own_files_only(
    code: str, words: str, plugin: Path, tmp_path: Path
) -> None:
    (plugin / "gridscan.py").write_text(f"from pcretrieve.formats import RawScan\n{code}\n")
    (tmp_path / "a.grid").write_text("1 2 3\n")
    (tmp_path / "b.xyz").write_text("1 2 3\n")
    with pytest.raises(ScanReadError) as raised:
        read_scan(tmp_path / "a.grid")
    assert "the format '.grid' of the package gridscan" in raised.value.message
    assert words in raised.value.message
    assert len(cloud(tmp_path / "b.xyz").points) == 1


TILES = """
import numpy as np
from pcretrieve.formats import Format, Part, RawScan

def parts(path):
    return tuple(Part(path.parent / name) for name in path.read_text().split())

def read(path):
    return RawScan(np.concatenate([np.loadtxt(part.path, ndmin=2) for part in parts(path)]))

def write(cloud):
    if len(cloud.points) > 2:
        raise RuntimeError("too many points")
    return "".join("%g %g %g\\n" % tuple(point) for point in cloud.points).encode()

read_grid = Format((".grid",), read, parts, write_cloud=write)
"""


def test_an_installed_package_brings_a_format_of_several_files(plugin: Path, tmp_path: Path) -> None:
    (plugin / "gridscan.py").write_text(TILES)
    (tmp_path / "a.grid").write_text("left.xyz right.tile\n")
    write_cloud(PointCloud(CUBE[:2]), tmp_path / "left.grid")
    (tmp_path / "left.grid").rename(tmp_path / "left.xyz")
    (tmp_path / "right.tile").write_text("4 5 6\n")
    np.testing.assert_array_equal(cloud(tmp_path / "a.grid").points, [*CUBE[:2], [4, 5, 6]])
    before = content_hash(tmp_path / "a.grid")
    (tmp_path / "right.tile").write_text("4 5 7\n")
    assert content_hash(tmp_path / "a.grid") != before
    assert discover([tmp_path]) == [tmp_path / "a.grid"]


def test_a_package_whose_writer_is_broken(plugin: Path, tmp_path: Path) -> None:
    (plugin / "gridscan.py").write_text(TILES)
    with pytest.raises(InputError, match="of the package gridscan failed, RuntimeError: too many points"):
        write_cloud(PointCloud(CUBE), tmp_path / "a.grid")
    with pytest.raises(InputError, match=r"a mesh file must end in one of \.ply \.obj"):
        write_mesh(shapes.icosphere(0), tmp_path / "a.grid")


def test_a_reader_may_say_what_is_wrong_itself(plugin: Path, tmp_path: Path) -> None:
    (plugin / "gridscan.py").write_text(
        "from pcretrieve.errors import ScanReadError\n"
        "def read_grid(path):\n    raise ScanReadError('the grid is not square')\n"
    )
    (tmp_path / "a.grid").write_text("1 2 3\n")
    with pytest.raises(ScanReadError, match=r"a\.grid: the grid is not square$"):
        read_scan(tmp_path / "a.grid")


def test_a_raw_scan_needs_points_only() -> None:
    assert RawScan(CUBE)[1:] == (None, None, None, (), None)
