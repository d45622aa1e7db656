"""Files as the programs of others write them are read, or refused with what mends them."""

from __future__ import annotations

import json
import warnings
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapes
from scan_files import (
    CUBE,
    HALVES,
    SIDES,
    SQUARE,
    XYZ,
    cloud,
    glb,
    gltf,
    mesh,
    npy,
    pcd_header,
    ply,
)

from pcretrieve import read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import ScanPath, is_scan
from pcretrieve.ingestion.discover import discover
from pcretrieve.values.topology import defects

BALL = shapes.icosphere(1)
TRIANGLES = np.array([(a, *two) for a, *rest in SIDES for two in pairwise(rest)])
POINTS = [f"{x:g} {y:g} {z:g}" for x, y, z in CUBE]


def is_cube(path: Path, content: str | bytes) -> bool:
    """Whether a file with this content is a closed cube."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    found = mesh(path)
    return (
        len(found.vertices) == 8
        and not defects(found)
        and abs(found.volume) == pytest.approx(1)
    )


def refusal(path: Path, content: str | bytes) -> str:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ScanReadError) as raised:
        read_scan(path)
    return raised.value.message


# --- numbers ----------------------------------------------------------------------------------------------

MISSING = ("-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND", "1.#INF00", "NaN", "-inf")


@pytest.mark.parametrize("word", MISSING)
def test_numbers_of_microsoft_that_are_none(word: str, tmp_path: Path) -> None:
    """One of them as the last value must not become the number before its sign of a comment."""
    rows = [*POINTS, f"0.5 0.5 {word}"]
    texts: dict[str, str | bytes] = {
        "a.xyz": "\n".join(rows),
        "a.txt": "\n".join(rows[::-1]),
        "a.csv": "x,y,z\n" + "\n".join(rows).replace(" ", ","),
        "a.pcd": pcd_header("x", "y", "z", n=9) + "\n".join(rows),
        "a.ply": ply("ascii", f"element vertex 9\n{XYZ}", "\n".join(rows).encode()),
        "a.obj": "\n".join(f"v {row}" for row in rows),
        "a.off": "OFF\n9 0 0\n" + "\n".join(rows),
    }
    for name, text in texts.items():
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        found = cloud(tmp_path / name)
        assert sorted(map(tuple, found.points)) == sorted(
            map(tuple, [*CUBE[1:].tolist(), [0] * 3])
        ), name
        assert "dropped 1 of 9 points that were NaN" in found.provenance[0].notes[0], name
        assert is_scan(ScanPath.parse(tmp_path / name)), name


def test_comments_behind_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(
        "\n".join(f"{row}. # one#\n{row}.#two\n#" for row in POINTS[1:])
    )
    assert len(cloud(tmp_path / "a.xyz").points) == 14


@pytest.mark.parametrize("columns", ["number", "row column"])
@pytest.mark.parametrize(
    ("name", "separator"), [("a.xyz", " "), ("a.txt", ","), ("a.csv", ";")]
)
def test_columns_that_count_need_a_header(
    columns: str, name: str, separator: str, tmp_path: Path
) -> None:
    before = {"number": "{k}", "row column": "{row}{separator}{column}"}[columns]
    table = [
        separator.join(
            [
                before.format(k=k, row=k // 9, column=k % 9, separator=separator),
                *map(repr, row),
                "7",
            ]
        )
        for k, row in enumerate(BALL.vertices.tolist())
    ]
    said = refusal(tmp_path / name, "\n".join(table))
    assert f"give the columns a header, such as {columns} x y z" in said
    header = separator.join([*columns.split(), *"xyzw"])
    (tmp_path / name).write_text("\n".join([header, *table]))
    np.testing.assert_array_equal(cloud(tmp_path / name).points, BALL.vertices)
    # Heights over a grid of whole numbers, and slices, are points as they stand.
    for row in ("{k} {k} 0.5", "{k} 4 0.5 0.25", "{half} 0.5 0.25 0.125"):
        rows = [row.format(k=k, half=k // 2) for k in range(9)]
        (tmp_path / "b.xyz").write_text("\n".join(rows))
        assert len(cloud(tmp_path / "b.xyz").points) == 9


def test_a_table_with_an_odd_row_is_no_list_of_scans(tmp_path: Path) -> None:
    """The message names the row that is no point, and no line is taken for a scan."""
    for name, rows, words in (
        ("a.txt", [*POINTS, "1 2 three"], "could not convert string 'three'"),
        (
            "a.csv",
            ["P1,0.5,1.5,2.5", "P2,0.5,1.5,2.5"],
            "got 'P1,0.5,1.5,2.5': give the columns a header",
        ),
        ("b.txt", ["what is this?"], "a list of scans must name a file that is there"),
        ("a.pts", ["3", *POINTS[:3], "6", *POINTS[3:]], "declares 9 points and holds 8"),
    ):
        assert words in refusal(tmp_path / name, "\n".join(rows))
        assert discover([tmp_path / name]) == [ScanPath(tmp_path / name)]
    (tmp_path / "list.txt").write_text("gone.ply\na.txt\n")
    assert discover([tmp_path / "list.txt"]) == [
        ScanPath(tmp_path / "gone.ply"),
        ScanPath(tmp_path / "a.txt"),
    ]


@pytest.mark.parametrize(
    "after", ["", " -2048", " 2047 255 0 0", " 0.5 255 0 0 0 0 1", "\t7"]
)
def test_clouds_of_pts_one_after_another(after: str, tmp_path: Path) -> None:
    """Cyclone writes intensities and colours, a count before each cloud; others write none."""
    rows = [f"{row}{after}" for row in POINTS]
    for text in (rows, ["8", *rows]):
        (tmp_path / "a.pts").write_text("\r\n".join(text))
        found = cloud(tmp_path / "a.pts")
        assert found.normals is None
        np.testing.assert_array_equal(found.points, CUBE)
    both = "\n".join([" 3 ", *rows[:3], "", "5", *rows[3:]])
    assert "the file holds several clouds, 2 one" in refusal(tmp_path / "a.pts", both)


@pytest.mark.parametrize("name", ["a.ply", "a.stl", "a.obj", "a.off", "a.pcd"])
def test_decimal_commas_are_named(name: str, tmp_path: Path) -> None:
    rows = [row.replace("1", "1,5") for row in POINTS]
    texts: dict[str, str | bytes] = {
        "a.ply": ply("ascii", f"element vertex 8\n{XYZ}", "\n".join(rows).encode()),
        "a.stl": "\n".join(["solid", "facet", *(f"vertex {row}" for row in rows[:3])]),
        "a.obj": "\n".join(f"v {row}" for row in rows),
        "a.off": "OFF\n8 0 0\n" + "\n".join(rows),
        "a.pcd": pcd_header("x", "y", "z", n=8) + "\n".join(rows),
    }
    assert "export it with decimal points, not commas" in refusal(
        tmp_path / name, texts[name]
    )


@pytest.mark.parametrize("shape", ["(8L, 3L)", "(8, 3)"])
def test_arrays_of_python_2_are_no_warning(shape: str, tmp_path: Path) -> None:
    content = npy(
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}", CUBE.tobytes()
    )
    (tmp_path / "a.npy").write_bytes(content)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(cloud(tmp_path / "a.npy").points, CUBE)
    assert not warned


# --- PCD --------------------------------------------------------------------------------------------------


def test_rows_of_pcd_that_are_filled_up(tmp_path: Path) -> None:
    """The point type of a lidar: fields of no values, several of the name _, types in lower case."""
    row = np.dtype(
        [("x", "<f4"), ("a", "u1", 3), ("b", "u1", 0), ("yz", "<f4", 2), ("c", "u1", 0)]
    )
    table = np.zeros(8, row)
    table["x"], table["yz"] = CUBE[:, 0], CUBE[:, 1:]
    header = (
        "# Größe\nVERSION .7\nFIELDS x _ _ y z _\nSIZE 4 1 1 4 4 1\nTYPE f u U F f I\nCOUNT 1 3 0 1 1 0\n"
        "WIDTH 8\nHEIGHT 1\nPOINTS 8\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode("cp1252") + table.tobytes())
    np.testing.assert_array_equal(cloud(tmp_path / "a.pcd").points, CUBE)
    text = header.replace("binary", "ascii") + "\n\n".join(
        f"{x:g} 1 2 3 {y:g} {z:g}" for x, y, z in CUBE
    )
    (tmp_path / "a.pcd").write_text(text)
    np.testing.assert_array_equal(cloud(tmp_path / "a.pcd").points, CUBE)
    assert "its last line lacks values" in refusal(tmp_path / "a.pcd", text[:-1])


# --- OBJ and OFF ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "gbk", "utf-16"])
def test_continued_lines_and_names_of_obj(encoding: str, tmp_path: Path) -> None:
    name = "人体" if encoding == "gbk" else "Körper"
    lines = [f"mtllib {name}.mtl", "g C:\\scans\\"]
    lines += [f"v {x:g} \\\n{y:g}\\\n {z:g}" for x, y, z in CUBE]
    lines += [
        f"o {name}\\",
        *(f"f {a + 1}//1 \\\n {b + 1}//1 {c + 1}//1" for a, b, c in TRIANGLES),
    ]
    for end in ("\n", "\r\n", "\r"):
        text = "\n".join(lines).replace("\n", end)
        assert is_cube(tmp_path / "a.obj", text.encode(encoding))


@pytest.mark.parametrize(
    "header", ["OFF\n8 12 18", "off 8 12", "OFF8 12 0", "COFF\n\n8 12 0", "8 12 0"]
)
def test_headers_of_off(header: str, tmp_path: Path) -> None:
    rows = [f"{row} 255 0 0 255 # red" for row in POINTS]
    rows += [f"3 {a} {b} {c} 0.5 0.5 0.5" for a, b, c in TRIANGLES]
    assert is_cube(tmp_path / "a.off", "\n".join(["# made by hand", header, *rows]))
    assert "it declares 8 vertices and 12 faces, 19 lines follow" in refusal(
        tmp_path / "a.off", "\n".join([header, *rows[:-1]])
    )


# --- STL --------------------------------------------------------------------------------------------------


def stl_text(solid: str = "a") -> str:
    rows = [f"solid {solid}"]
    for corners in TRIANGLES:
        rows += [
            "facet normal 0 0 0",
            "  outer loop",
            *(f"    vertex {POINTS[v]}" for v in corners),
        ]
        rows += ["  endloop", "endfacet"]
    return "\n".join([*rows, f"endsolid {solid}", ""])


WHOLE = stl_text()
STL_TEXTS = {
    "end solid": WHOLE.replace("endsolid", "end solid"),
    "end loop": WHOLE.replace("endloop", "end loop").replace("endfacet", "end facet"),
    "old Macs": WHOLE.replace("\n", "\r"),
    "Windows": WHOLE.replace("\n", "\r\n"),
    "capitals": WHOLE.upper(),
    "two solids": WHOLE[: len(WHOLE) // 2 - 9].rpartition("facet normal")[0]
    + "endsolid a\nsolid b\nfacet normal"
    + WHOLE[: len(WHOLE) // 2 - 9].rpartition("facet normal")[2]
    + WHOLE[len(WHOLE) // 2 - 9 :],
    "no end": WHOLE.rpartition("endsolid")[0],
    "name": stl_text("vertex buffer of Körper"),
    "normals of Microsoft": WHOLE.replace(
        "normal 0 0 0", "normal -nan(ind) 1.#QNAN 1.#IND"
    ),
    "one line": " ".join(WHOLE.split()),
}


@pytest.mark.parametrize("dialect", STL_TEXTS)
def test_dialects_of_stl(dialect: str, tmp_path: Path) -> None:
    assert is_cube(tmp_path / "a.stl", STL_TEXTS[dialect].encode("cp1252"))


def test_binary_stl_of_others(tmp_path: Path) -> None:
    """Headers that begin as those of texts, colours in the last two bytes, and bytes behind the triangles."""
    record = np.zeros(12, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    record["v"], record["a"] = CUBE[TRIANGLES], 7
    for head in (b"solid from CAD", b"COLOR=\xa9\xa9\xff\xff,MATERIAL=\x7f"):
        content = head.ljust(80) + np.uint32(12).tobytes() + record.tobytes()
        assert is_cube(tmp_path / "a.stl", content)
        assert is_cube(tmp_path / "a.stl", content + b"tail")
    assert "or 12 triangles in 600 bytes" in refusal(tmp_path / "a.stl", content[:600])
    assert "in the middle of a triangle" in refusal(
        tmp_path / "a.stl", "solid\nvertex 0 0 1\n"
    )


# --- PLY --------------------------------------------------------------------------------------------------

FACES = "element face 12\nproperty list uchar int vertex_indices\n"
ROWS = [*POINTS, *(f"3 {a} {b} {c}" for a, b, c in TRIANGLES)]


def test_lines_of_text_ply(tmp_path: Path) -> None:
    head = f"element vertex 8\n{XYZ}{FACES}"
    for end in ("\n", "\r\n", "\r"):
        for rows in (
            ["", *ROWS],
            [f"{row}\n \n" for row in ROWS],
            [f"\t{row} " for row in ROWS],
        ):
            text = ply("ascii", head, "\n".join(rows).encode()).replace(
                b"\n", end.encode()
            )
            assert is_cube(tmp_path / "a.ply", text)
    assert is_cube(
        tmp_path / "a.ply", b"\xef\xbb\xbf" + ply("ascii", head, "\n".join(ROWS).encode())
    )
    cut = ply("ascii", head, "\n".join(ROWS)[:-2].encode())
    assert "it ends in the middle of face" in refusal(tmp_path / "a.ply", cut)


@pytest.mark.parametrize("kind", ["Int", "int64", "INT32"])
def test_types_of_ply_by_other_names(kind: str, tmp_path: Path) -> None:
    head = f"element vertex 8\n{XYZ}{FACES}".replace("int ", f"{kind} ").replace(
        "float", "Float32"
    )
    assert is_cube(tmp_path / "a.ply", ply("ascii", head, "\n".join(ROWS).encode()))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_strips_of_triangles(form: str, tmp_path: Path) -> None:
    """Each side is a strip of two triangles; −1 lies between strips of one list, some of which are empty."""
    sides = [[a, b, d, c, -1] for a, b, c, d in SIDES]
    head = f"element vertex 8\n{XYZ}element tristrips 2\nproperty list int int vertex_indices\n"
    rows = [[-1, *sides[0], *sides[1]], [v for side in sides[2:] for v in side][:-1]]
    content = b"\n".join(" ".join(map(str, [len(row), *row])).encode() for row in rows)
    points = "\n".join([*POINTS, ""]).encode()
    if form != "ascii":
        content = b"".join(np.array([len(row), *row], "<i4").tobytes() for row in rows)
        points = CUBE.astype("<f4").tobytes()
    assert is_cube(tmp_path / "a.ply", ply(form, head, points + content))
    assert mesh(tmp_path / "a.ply").volume > 0


@pytest.mark.parametrize("form", ["n{}", "normal_{}", "normal{}", "Normals:{}"])
def test_names_of_normals(form: str, tmp_path: Path) -> None:
    normals = BALL.vertices / np.linalg.norm(BALL.vertices, axis=1, keepdims=True)
    names = "".join(f"property double {form.format(axis)}\n" for axis in "xyz")
    table = np.column_stack([BALL.vertices, normals]).astype("<f8")
    axes = "".join(f"property double {axis}\n" for axis in "XYZ")
    head = f"element vertex {len(table)}\n{axes}"
    (tmp_path / "a.ply").write_bytes(
        ply("binary_little_endian", head + names, table.tobytes())
    )
    found = cloud(tmp_path / "a.ply").normals
    assert found is not None
    np.testing.assert_allclose(found, normals)


def test_vertices_with_lists_of_several_lengths_keep_their_order(tmp_path: Path) -> None:
    """Such as the views that saw a point."""
    head = f"element vertex 42\n{XYZ}property list uchar int view\n"
    points = BALL.vertices.astype("<f4")
    rows = [
        point.tobytes() + bytes([k % 4]) + np.arange(k % 4, dtype="<i4").tobytes()
        for k, point in enumerate(points)
    ]
    (tmp_path / "a.ply").write_bytes(ply("binary_little_endian", head, b"".join(rows)))
    np.testing.assert_array_equal(cloud(tmp_path / "a.ply").points, points)


def test_faint_splats_are_named(tmp_path: Path) -> None:
    table = np.column_stack(
        [BALL.vertices, np.repeat([3.0, -5.0], [30, 12]), np.ones(42)]
    )
    names = ["x", "y", "z", "opacity", "scale_0"]
    head = "element vertex 42\n" + "".join(f"property float {name}\n" for name in names)
    content = ply("binary_little_endian", head, table.astype("<f4").tobytes())
    (tmp_path / "a.ply").write_bytes(content)
    (note,) = cloud(tmp_path / "a.ply").provenance[0].notes
    assert note.startswith(
        "12 of 42 splats are almost transparent by their column opacity"
    )
    (tmp_path / "a.ply").write_bytes(content.replace(b"opacity", b"density"))
    assert not cloud(tmp_path / "a.ply").provenance[0].notes


# --- glTF -------------------------------------------------------------------------------------------------


def test_extensions_that_gltf_requires(tmp_path: Path) -> None:
    tree, binary = gltf(SQUARE, HALVES, [{"mesh": 0}])
    tree["extensionsRequired"] = ["KHR_texture_basisu", "KHR_mesh_quantization"]
    (tmp_path / "a.glb").write_bytes(glb(tree, binary))
    assert len(mesh(tmp_path / "a.glb").faces) == 2
    for name in (
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "EXT_mesh_gpu_instancing",
    ):
        tree["extensionsRequired"] = [name]
        tree["bufferViews"] = []
        (tmp_path / "a.gltf").write_text(json.dumps(tree))
        said = refusal(tmp_path / "a.glb", glb(tree, binary))
        assert (
            f"stored by the extension {name}: export them without it, uncompressed"
            in said
        )
        assert "copy" not in said
