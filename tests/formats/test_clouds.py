"""Tables, arrays, PLY and PCD: a scan has the content of its file, and a file that of its scan."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import shapes
from scan_files import CUBE, XYZ, cloud, mesh, pcd_header, ply

from pcretrieve import PointCloud
from pcretrieve.errors import InputError
from pcretrieve.formats import ScanPath, is_scan, write_cloud, write_mesh
from pcretrieve.values.topology import defects

POINTS = np.array([[1.5, 2, 3], [4, 5, -6], [7, 8.25, 9], [-1, 0, 2e-3], [0, 0, 0]])
BALL = shapes.icosphere(1)
NORMALS = BALL.vertices / np.linalg.norm(BALL.vertices, axis=1, keepdims=True)
CLOUD = PointCloud(BALL.vertices, NORMALS, 3 * NORMALS)


# --- text and arrays --------------------------------------------------------------------------------------


def lines(form: str, decimal: str = ".") -> str:
    rows = (
        form.format(*(f"{value!r}".replace(".", decimal) for value in row))
        for row in POINTS.tolist()
    )
    return "\n".join(rows)


TABLES = {
    "blank.txt": lines("{} {} {}"),
    "tab.asc": lines("{}\t{}\t{}"),
    "aligned.txt": lines("   {}   {}   {}  "),
    "comma.csv": lines("{},{},{}"),
    "trailing.csv": lines("{}, {}, {},"),
    "semicolon.csv": lines("{};{};{}"),
    "decimal_comma.csv": "X;Y;Z\r\n" + lines("{};{};{}", ","),
    "decimal_comma.txt": lines("{} {} {}", ","),
    "header.csv": "x,y,z\n" + lines("{},{},{}"),
    "quoted.csv": '"t","Points:0","Points:1","Points:2"\n' + lines("9,{},{},{}"),
    "units.csv": "X [mm];Y [mm];Z [mm];I\n" + lines("{};{};{};7"),
    "cloud_compare.asc": "//X Y Z R G B\n" + lines("{} {} {} 255 0 9"),
    "comments.asc": "# made by a scanner\n# x y z\n\n" + lines("{} {} {}"),
    "count.txt": "5\n" + lines("{} {} {}"),
    "count_below.pts": "X Y Z\n5\n" + lines("{} {} {} 7 1 2 3"),
    "colours.xyzrgb": lines("{} {} {} 0.1 0.2 1"),
    "named.csv": "id,intensity,z,y,x\n"
    + "\n".join(f"P{k},5,{z},{y},{x}" for k, (x, y, z) in enumerate(POINTS)),
    "pandas.csv": ",x,y,z\n" + lines("17,{},{},{}"),
    "words_in_names.txt": "Point ID\tX coord\tY coord\tZ coord\n"
    + lines("17\t{}\t{}\t{}"),
    "more_columns.asc": "# x y z\n" + lines("{} {} {} 17 18"),
    "words_behind.txt": lines("{} {} {} ground"),
    "bom.txt": "\ufeff" + lines("{} {} {}"),
}


def test_ways_to_write_a_table(tmp_path: Path) -> None:
    for name, text in TABLES.items():
        (tmp_path / name).write_text(text, encoding="utf-8", newline="")
        found = cloud(tmp_path / name)
        np.testing.assert_array_equal(found.points, POINTS, err_msg=name)
        assert found.normals is None, name
        assert is_scan(ScanPath.parse(tmp_path / name)), name
    (tmp_path / "a.txt").write_text("x\ty\tz\n" + lines("{}\t{}\t{}"), encoding="utf-16")
    np.testing.assert_array_equal(cloud(tmp_path / "a.txt").points, POINTS)


NO_POINTS = {
    "paths.txt": "a.ply\nb.ply\nc.ply\nd.ply\n",
    "list.csv": "file,height,weight,age\n1.ply,1,2,3\n2.ply,1,2,3\n3.ply,1,2,3\n4.ply,1,2,3\n",
    "labels.csv": "a,1\nb,2\nc,3\nd,4\n",
    "poses.txt": "# timestamp tx ty tz qx qy qz qw\n" + "1 2 3 4 0 0 0 1\n" * 9,
    "ragged.txt": "1 2 3\n1 2 3 4\n" * 9,
    "short.txt": "1 2 3\n" * 3,
    "wide.txt": " ".join(map(str, range(40))) + "\n",
    "raster.asc": "ncols 4\nnrows 4\nxllcorner 0\n" + "1 2 3 4\n" * 4,
    "prose.txt": "Three or more\nnumeric columns are points.\n",
    "zeros.txt": "\0" * 50,
    "empty.txt": "",
}


def test_what_a_folder_does_not_take_for_points(tmp_path: Path) -> None:
    for name, text in NO_POINTS.items():
        (tmp_path / name).write_text(text)
        assert not is_scan(ScanPath.parse(tmp_path / name)), name
    np.savez(tmp_path / "a.npz", ids=np.array(["a"]), values=np.ones((1, 9)))
    np.save(tmp_path / "a.npy", np.ones((40, 40)))
    assert not is_scan(ScanPath.parse(tmp_path / "a.npz"))
    assert not is_scan(ScanPath.parse(tmp_path / "a.npy"))


def test_normals_that_are_named_or_of_unit_length_are_no_colours(tmp_path: Path) -> None:
    rows = np.column_stack([3 * BALL.vertices, NORMALS])
    for name, header, form in (
        ("named.csv", "x,y,z,label,nx,ny,nz\n", "{},{},{},a,{},{},{}"),
        ("meshlab.xyz", "x y z normal_x normal_y normal_z\n", "{} {} {} {} {} {}"),
        ("plain.txt", "", "{} {} {} {} {} {}"),
        ("plain.xyzn", "", "{} {} {} {} {} {}"),
    ):
        (tmp_path / name).write_text(
            header + "\n".join(form.format(*row) for row in rows.tolist())
        )
        found = cloud(tmp_path / name)
        np.testing.assert_array_equal(found.points, 3 * BALL.vertices)
        assert found.normals is not None, name
        np.testing.assert_allclose(found.normals, NORMALS, atol=1e-12)
    for colour in ("1.0 0.0 0.0", "255 0 17"):
        (tmp_path / "a.txt").write_text(lines(f"{{}} {{}} {{}} {colour}"))
        assert cloud(tmp_path / "a.txt").normals is None


def test_what_is_left_out_is_noted(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(lines("{} {} {}") + "\n0 0 0\nnan nan nan\n")
    found = cloud(tmp_path / "a.txt")
    np.testing.assert_array_equal(found.points, POINTS[:4])
    assert found.provenance[0].notes == (
        "dropped 2 of 7 points at zero: readings without an answer",
        "dropped 1 of 5 points that were NaN or infinite",
    )
    (tmp_path / "a.xyzn").write_text(
        "0 0 0 1 0 0\nnan 0 0 0 1 0\n1 2 3 0 0 1\n1 inf 3 0 0 1\n"
    )
    found = cloud(tmp_path / "a.xyzn")
    np.testing.assert_array_equal(found.points, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(found.normals, [[1, 0, 0], [0, 0, 1]])
    for normal in ("0 0 0", "nan 0 0"):
        (tmp_path / "a.xyzn").write_text(f"0 0 0 0 0 1\n1 0 0 {normal}\n")
        found = cloud(tmp_path / "a.xyzn")
        assert found.normals is None
        assert found.provenance[0].notes == (
            "ignored the file's normals: 1 of them have no direction",
        )
    np.savez(tmp_path / "a.npz", points=POINTS, viewpoint=[0, np.inf, 0])
    found = cloud(tmp_path / "a.npz")
    assert found.viewpoints is None
    assert (
        found.provenance[0]
        .notes[-1]
        .startswith("ignored the file's sensor positions: some are NaN")
    )


def test_arrays_of_points(tmp_path: Path) -> None:
    for array in (
        *(
            POINTS,
            np.asfortranarray(POINTS),
            POINTS.astype(np.float32),
            POINTS.astype(">f8"),
        ),
        *(np.column_stack([POINTS, np.arange(5)]), POINTS[:4].reshape(2, 2, 3)),
        (1000 * POINTS).astype(np.int16),
    ):
        np.save(tmp_path / "a.npy", array)
        np.savez_compressed(tmp_path / "a.npz", array)
        for name in ("a.npy", "a.npz"):
            expected = array.reshape(-1, array.shape[-1])[:, :3].astype(float)
            np.testing.assert_array_equal(cloud(tmp_path / name).points, expected)
        assert is_scan(ScanPath.parse(tmp_path / "a.npy"))
    rows = np.column_stack([BALL.vertices, np.ones(42), NORMALS])
    types = [
        (name, np.float64) for name in ("x", "y", "z", "intensity", "nx", "ny", "nz")
    ]
    np.save(tmp_path / "records.npy", np.array([tuple(row) for row in rows], dtype=types))
    np.save(tmp_path / "table.npy", rows[:, [0, 1, 2, 4, 5, 6]])
    np.savez(
        tmp_path / "named.npz", xyz=BALL.vertices, normals=NORMALS, viewpoint=[0, 0, 9.0]
    )
    for name in ("records.npy", "table.npy", "named.npz"):
        found = cloud(tmp_path / name)
        np.testing.assert_array_equal(found.points, BALL.vertices)
        assert found.normals is not None and is_scan(ScanPath.parse(tmp_path / name))
        np.testing.assert_allclose(found.normals, NORMALS, atol=1e-12)
    sensors = cloud(tmp_path / "named.npz").viewpoints
    np.testing.assert_array_equal(sensors, np.tile([0, 0, 9.0], (42, 1)))
    np.savez(tmp_path / "mesh.npz", vertices=BALL.vertices, faces=BALL.faces)
    np.testing.assert_array_equal(mesh(tmp_path / "mesh.npz").faces, BALL.faces)


# --- PLY and PCD ------------------------------------------------------------------------------------------

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# What PLY calls a type, what the module struct calls it, and values at its limits.
SCALARS: dict[str, tuple[str, list[float]]] = {
    **{name: ("b", [-128, 0, 127]) for name in ("char", "int8")},
    **{name: ("B", [0, 1, 255]) for name in ("uchar", "uint8")},
    **{name: ("h", [-(2**15), 0, 2**15 - 1]) for name in ("short", "int16")},
    **{name: ("H", [0, 1, 2**16 - 1]) for name in ("ushort", "uint16")},
    **{name: ("i", [-(2**31), 0, 2**31 - 1]) for name in ("int", "int32")},
    **{name: ("I", [0, 1, 2**32 - 1]) for name in ("uint", "uint32")},
    **{name: ("f", [0.1, -1e-40, 3e38]) for name in ("float", "float32")},
    **{name: ("d", [0.1, -5e-324, 1e40]) for name in ("double", "float64")},
}

# One value and the type of it, or a list, the type of its length and that of its values.
Value = tuple[float, str] | tuple[Sequence[float], str, str]


def row(form: str, *values: Value) -> bytes:
    """One row, value by value."""
    order, words, packed = ORDERS[form], [], b""
    for value in values:
        if len(value) == 2:
            words.append(repr(value[0]))
            packed += struct.pack(order + SCALARS[value[1]][0], value[0])
        else:
            items, length_type, type_ = value
            words += [str(len(items)), *map(repr, items)]
            packed += struct.pack(order + SCALARS[length_type][0], len(items))
            packed += b"".join(
                struct.pack(order + SCALARS[type_][0], item) for item in items
            )
    return packed if order else " ".join(words).encode() + b"\n"


def test_every_type_of_number(tmp_path: Path) -> None:
    for form in ORDERS:
        for type_, (code, values) in SCALARS.items():
            header = f"element vertex 3\nproperty {type_} x\nproperty uchar red\n"
            header += "property double y\nproperty float z\n"
            rows = [
                row(form, (value, type_), (7, "uchar"), (0.25, "double"), (0.5, "float"))
                for value in values
            ]
            (tmp_path / "a.ply").write_bytes(ply(form, header, *rows))
            stored = [
                struct.unpack(f"<{code}", struct.pack(f"<{code}", value))[0]
                for value in values
            ]
            found = cloud(tmp_path / "a.ply").points
            np.testing.assert_array_equal(found, [[value, 0.25, 0.5] for value in stored])


def test_faces_among_lists_of_other_lengths(tmp_path: Path) -> None:
    polygons = [
        (0, 1, 2),
        (2, 1, 3),
        (0, 1, 2, 3),
        (3, 2, 1),
        (1, 2),
        (4, 3, 2, 1, 0),
        (),
    ]
    triangles = [
        (0, 1, 2),
        (2, 1, 3),
        (3, 2, 1),
        (0, 1, 2),
        (0, 2, 3),
        (4, 3, 2),
        (4, 2, 1),
        (4, 1, 0),
    ]
    for form in ORDERS:
        for length in ("uchar", "char", "ushort", "short", "uint", "int"):
            header = f"element vertex 5\n{XYZ}element face 7\nproperty uchar red\n"
            header += (
                f"property list uchar float uv\nproperty list {length} int vertex_index\n"
            )
            rows = [
                row(form, *((float(k * k + axis), "float") for axis in range(3)))
                for k in range(5)
            ]
            rows += [
                row(
                    form,
                    (7, "uchar"),
                    ([0.5] * (k % 3), "uchar", "float"),
                    (polygon, length, "int"),
                )
                for k, polygon in enumerate(polygons)
            ]
            (tmp_path / "a.ply").write_bytes(ply(form, header, *rows))
            assert sorted(map(tuple, mesh(tmp_path / "a.ply").faces)) == sorted(triangles)


def test_line_ends_comments_and_what_stands_behind_the_points(tmp_path: Path) -> None:
    text = f"ply\nformat ascii 1.0\ncomment \u00e9\nelement vertex 2\n{XYZ}element range_grid 1\n"
    text += "property list uchar int vertex_indices\nend_header\n0 1 2\n1 2 3\n1 0"
    for line_end in ("\n", "\r\n", "\r"):
        (tmp_path / "a.ply").write_bytes(text.replace("\n", line_end).encode("latin-1"))
        np.testing.assert_array_equal(
            cloud(tmp_path / "a.ply").points, [[0, 1, 2], [1, 2, 3]]
        )
    (tmp_path / "a.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 3\n{XYZ}element face 2\n"
        "property list uchar int vertex_indices\nend_header\n0 0 1\n0 1 0\n1 0 0\n2 0 1\n2 1 2\n"
    )
    notes = cloud(tmp_path / "a.ply").provenance[0].notes
    assert notes == ("took the vertices as points: no face has three of them",)


def test_pcd_encodings_and_sensors(tmp_path: Path) -> None:
    from pypcd4.pypcd4 import Encoding, PointCloud as Pcd

    fields = ("x", "y", "z", "normal_x", "normal_y", "normal_z")
    rows = np.column_stack([CUBE, np.tile([0, 0, 2.0], (8, 1))]).astype(np.float32)
    content = Pcd.from_points(rows, fields, [np.float32] * 6)
    for position in ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)):
        content.metadata.viewpoint = (*position, 1.0, 0.0, 0.0, 0.0)
        for data in ("ascii", "binary", "binary_compressed"):
            content.save(tmp_path / "a.pcd", encoding=Encoding(data))
            found = cloud(tmp_path / "a.pcd")
            np.testing.assert_array_equal(found.points, CUBE)
            np.testing.assert_array_equal(found.normals, np.tile([0, 0, 1.0], (8, 1)))
            if any(position):
                np.testing.assert_array_equal(found.viewpoints, np.tile(position, (8, 1)))
            else:
                assert found.viewpoints is None  # of programs that do not know the sensor
    header = pcd_header(
        "x", "y", "z", "vp_x", "vp_y", "vp_z", n=2, viewpoint="9 9 9 1 0 0 0"
    )
    for body in ("0 0 0 1 2 3\n1 1 1 4 5 6\n", " 0  0 0 1 2 3 \n1\t1 1 4 5 6\r\n"):
        (tmp_path / "a.pcd").write_text(header + body)
        np.testing.assert_array_equal(
            cloud(tmp_path / "a.pcd").viewpoints, [[1, 2, 3], [4, 5, 6]]
        )


# --- writing ----------------------------------------------------------------------------------------------


def test_what_is_written_is_read(tmp_path: Path) -> None:
    for suffix, error in ((".ply", 0.0), (".pcd", 1e-6), (".xyzn", 1e-8)):
        write_cloud(CLOUD, tmp_path / f"ball{suffix}")
        found = cloud(tmp_path / f"ball{suffix}")
        assert found.normals is not None
        np.testing.assert_allclose(found.points, CLOUD.points, rtol=0, atol=error)
        np.testing.assert_allclose(found.normals, NORMALS, rtol=0, atol=max(error, 1e-12))
        assert (found.viewpoints is None) == (suffix == ".xyzn")
        if found.viewpoints is not None:
            np.testing.assert_allclose(
                found.viewpoints, 3 * NORMALS, rtol=0, atol=3 * error
            )
    for suffix in (".ply", ".pcd"):
        write_cloud(PointCloud(BALL.vertices), tmp_path / f"ball{suffix}")
        found = cloud(tmp_path / f"ball{suffix}")
        assert found.normals is None and found.viewpoints is None
    for suffix in (".ply", ".obj", ".off", ".stl", ".glb"):
        write_mesh(BALL, tmp_path / f"mesh{suffix}")
        found_mesh = mesh(tmp_path / f"mesh{suffix}")
        assert not defects(found_mesh)
        assert found_mesh.volume == pytest.approx(BALL.volume, rel=1e-5)


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    for scan, name, words in (
        (CLOUD, "ball.obj", r"\.ply \.pcd \.xyzn, got ball\.obj"),
        (PointCloud(BALL.vertices), "ball.xyzn", "must hold normals"),
        (CLOUD, "nowhere/ball.ply", "cannot write"),
        (CLOUD, "folder.ply", "cannot write"),
    ):
        with pytest.raises(InputError, match=words):
            write_cloud(scan, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.ply"]
