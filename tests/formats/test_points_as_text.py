"""Tables of points as text and as arrays, as programs and scanners write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import is_scan

POINTS = np.array([[1.5, 2, 3], [4, 5, -6], [7, 8.25, 9], [-1, 0, 2e-3], [0, 0, 0]])
BALL = shapes.icosphere(1)
NORMALS = BALL.vertices / np.linalg.norm(BALL.vertices, axis=1, keepdims=True)


def cloud(path: Path) -> PointCloud:
    found = read_scan(path)
    assert isinstance(found, PointCloud)
    return found


def lines(form: str, decimal: str = ".") -> str:
    rows = (form.format(*(f"{value!r}".replace(".", decimal) for value in row)) for row in POINTS.tolist())
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
    "words_in_names.txt": "Point ID\tX coord\tY coord\tZ coord\n" + lines("17\t{}\t{}\t{}"),
    "more_columns.asc": "# x y z\n" + lines("{} {} {} 17 18"),
    "words_behind.txt": lines("{} {} {} ground"),
    "bom.txt": "\ufeff" + lines("{} {} {}"),
}


@pytest.mark.parametrize("name", TABLES)
def test_ways_to_write_a_table(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(TABLES[name], encoding="utf-8", newline="")
    found = cloud(tmp_path / name)
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.normals is None
    assert is_scan(tmp_path / name)


def test_a_table_of_a_spreadsheet_in_utf_16(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x\ty\tz\n" + lines("{}\t{}\t{}"), encoding="utf-16")
    np.testing.assert_array_equal(cloud(tmp_path / "a.txt").points, POINTS)


@pytest.mark.parametrize(
    ("name", "header", "form"),
    [
        ("named.csv", "x,y,z,label,nx,ny,nz\n", "{},{},{},a,{},{},{}"),
        ("meshlab.xyz", "x y z normal_x normal_y normal_z\n", "{} {} {} {} {} {}"),
        ("plain.txt", "", "{} {} {} {} {} {}"),
        ("plain.xyzn", "", "{} {} {} {} {} {}"),
    ],
)
def test_normals_that_are_named_or_of_unit_length(name: str, header: str, form: str, tmp_path: Path) -> None:
    rows = np.column_stack([3 * BALL.vertices, NORMALS])
    (tmp_path / name).write_text(header + "\n".join(form.format(*row) for row in rows.tolist()))
    found = cloud(tmp_path / name)
    np.testing.assert_array_equal(found.points, 3 * BALL.vertices)
    assert found.normals is not None
    np.testing.assert_allclose(found.normals, NORMALS, atol=1e-12)


@pytest.mark.parametrize("colour", ["1.0 0.0 0.0", "255 0 17"])
def test_colours_are_no_normals(colour: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(lines(f"{{}} {{}} {{}} {colour}"))
    assert cloud(tmp_path / "a.txt").normals is None


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


@pytest.mark.parametrize("name", NO_POINTS)
def test_what_a_folder_does_not_take_for_points(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(NO_POINTS[name])
    assert not is_scan(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.asc", NO_POINTS["raster.asc"], "a raster of heights by ESRI"),
        ("a.txt", "Three or more\n", "each line must hold 3 numbers, got 'Three or more'"),
        ("a.txt", "x y z\n1 2 3\n4 5\n", "each line must hold 3 numbers: invalid column index 2"),
        ("a.csv", "x,y,z\n1,2,3\n4,,5\n", "could not convert string ''"),
        ("a.csv", "id,x,y,z\n1,2,3,4,5\n", "its header names 4 columns, its first row has 5"),
        ("a.pts", "4\n1 2 3\n4 5 6\n", "it declares 4 points and holds 2"),
        ("a.xyz", "header\n" * 60 + "1 2 3\n", "each line must hold 3 numbers, got 'header'"),
    ],
)
def test_a_table_that_cannot_be_read(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ScanReadError, match=words):
        read_scan(tmp_path / name)


def test_rows_of_zeros_are_dropped_with_a_note_but_a_point_at_the_origin_is_one(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(lines("{} {} {}") + "\n0 0 0\nnan nan nan\n")
    found = cloud(tmp_path / "a.txt")
    np.testing.assert_array_equal(found.points, POINTS[:4])
    assert found.provenance[0].notes == (
        "dropped 2 of 7 points at zero: readings without an answer",
        "dropped 1 of 5 points that were NaN or infinite",
    )


# --- arrays -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "array",
    [
        POINTS,
        np.asfortranarray(POINTS),
        POINTS.astype(np.float32),
        np.column_stack([POINTS, np.arange(5)]),
        POINTS[:4].reshape(2, 2, 3),
        POINTS.astype(">f8"),
        (1000 * POINTS).astype(np.int16),
    ],
    ids=["table", "by columns", "single", "intensity", "organised", "big endian", "whole"],
)
def test_arrays_of_points(array: NDArray[Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", array)
    np.savez_compressed(tmp_path / "a.npz", array)
    for name in ("a.npy", "a.npz"):
        np.testing.assert_array_equal(
            cloud(tmp_path / name).points, array.reshape(-1, array.shape[-1])[:, :3].astype(float)
        )
    assert is_scan(tmp_path / "a.npy")


def test_records_and_normals(tmp_path: Path) -> None:
    rows = np.column_stack([BALL.vertices, np.ones(42), NORMALS])
    types = [(name, np.float64) for name in ("x", "y", "z", "intensity", "nx", "ny", "nz")]
    records = np.array([tuple(row) for row in rows], dtype=types)
    np.save(tmp_path / "records.npy", records)
    np.save(tmp_path / "table.npy", rows[:, [0, 1, 2, 4, 5, 6]])
    np.savez(tmp_path / "named.npz", xyz=BALL.vertices, normals=NORMALS, viewpoint=[0, 0, 9.0])
    for name in ("records.npy", "table.npy", "named.npz"):
        found = cloud(tmp_path / name)
        np.testing.assert_array_equal(found.points, BALL.vertices)
        assert found.normals is not None
        np.testing.assert_allclose(found.normals, NORMALS, atol=1e-12)
        assert is_scan(tmp_path / name)
    sensors = cloud(tmp_path / "named.npz").viewpoints
    np.testing.assert_array_equal(sensors, np.tile([0, 0, 9.0], (42, 1)))


def test_an_archive_of_a_mesh(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", vertices=BALL.vertices, faces=BALL.faces)
    found = read_scan(tmp_path / "a.npz")
    assert isinstance(found, TriangleMesh)
    np.testing.assert_array_equal(found.faces, BALL.faces)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.ones((5, 2)), r"must have the shape \(n, c\) or \(h, w, c\), c from 3 to 32, got \(5, 2\)"),
        (np.ones((40, 40)), r"got \(40, 40\)"),
        (np.ones((5, 3), dtype=complex), "must be real numbers, got complex128"),
        (np.array([["a", "b", "c"]]), "must be real numbers, got <U1"),
        (np.array([[{}, 1, 2]]), "it holds Python objects"),
        (np.zeros(5, dtype=[("x", "f4"), ("y", "f4")]), "records must have the fields x y z, got x y"),
    ],
)
def test_other_arrays(array: NDArray[Any], words: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    assert not is_scan(tmp_path / "a.npy") or array.dtype == complex
    with pytest.raises(ScanReadError, match=words):
        read_scan(tmp_path / "a.npy")


def test_an_archive_of_something_else(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", ids=np.array(["a"]), values=np.ones((1, 9)))
    assert not is_scan(tmp_path / "a.npz")
    with pytest.raises(ScanReadError, match="must hold an array 'points', got ids, values"):
        read_scan(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"points": POINTS, "faces": np.ones((2, 3))}, r"faces must be whole numbers \(m, 3\), got float64"),
        ({"points": POINTS, "normals": np.ones((2, 3))}, r"normals must be numbers \(5, 3\), got float64"),
        ({"points": POINTS, "viewpoint": np.ones(2)}, r"viewpoints must be numbers \(5, 3\) or \(3,\)"),
    ],
)
def test_arrays_that_do_not_belong_together(
    arrays: dict[str, NDArray[Any]], words: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(ScanReadError, match=words):
        read_scan(tmp_path / "a.npz")


def test_an_array_must_be_as_large_as_its_header_says(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(
        data.replace(b"(5, 3)", b"(99999999999, 3)"[:6]).replace(b"(9999 ", b"(9, 3)")
    )
    (tmp_path / "b.npy").write_bytes(data[:-8])
    for name in ("a.npy", "b.npy"):
        with pytest.raises(ScanReadError, match="not a complete NPY file"):
            read_scan(tmp_path / name)
