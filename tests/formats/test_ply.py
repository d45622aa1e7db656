"""PLY: every type, order and layout of rows, against files that are written value by value."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scan_files import XYZ

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.ply import read_ply

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
    **{name: ("d", [0.1, -5e-324, 1e308]) for name in ("double", "float64")},
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
            packed += b"".join(struct.pack(order + SCALARS[type_][0], item) for item in items)
    return packed if order else " ".join(words).encode() + b"\n"


def ply(form: str, elements: str, *rows: bytes) -> bytes:
    return f"ply\nformat {form} 1.0\n{elements}end_header\n".encode() + b"".join(rows)


def corners(form: str, n: int) -> list[bytes]:
    return [row(form, *((float(k + axis), "float") for axis in range(3))) for k in range(n)]


@pytest.mark.parametrize("form", ORDERS)
@pytest.mark.parametrize("type_", SCALARS)
def test_every_type_of_number(type_: str, form: str, tmp_path: Path) -> None:
    code, values = SCALARS[type_]
    header = (
        f"element vertex 3\nproperty {type_} x\nproperty uchar red\nproperty double y\nproperty float z\n"
    )
    rows = [row(form, (value, type_), (7, "uchar"), (0.25, "double"), (0.5, "float")) for value in values]
    (tmp_path / "a.ply").write_bytes(ply(form, header, *rows))
    stored = [struct.unpack(f"<{code}", struct.pack(f"<{code}", value))[0] for value in values]
    found = read_ply(tmp_path / "a.ply").points
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, [[value, 0.25, 0.5] for value in stored])


@pytest.mark.parametrize("form", ORDERS)
@pytest.mark.parametrize("length", ["uchar", "char", "ushort", "short", "uint", "int"])
def test_faces_among_lists_of_other_lengths(length: str, form: str, tmp_path: Path) -> None:
    """The triangles of polygons of one size come in the order of the file."""
    polygons = [(0, 1, 2), (2, 1, 3), (0, 1, 2, 3), (3, 2, 1), (1, 2), (4, 3, 2, 1, 0), ()]
    textures = [(0.5, 0.5), (), (0.1,), (), (), (1.0,), ()]
    header = (
        f"element vertex 5\n{XYZ}element face 7\nproperty uchar flags\n"
        f"property list {length} uint vertex_indices\nproperty list uchar float texcoord\nproperty int id\n"
    )
    rows = [
        row(form, (9, "uchar"), (polygon, length, "uint"), (texture, "uchar", "float"), (-1, "int"))
        for polygon, texture in zip(polygons, textures, strict=True)
    ]
    (tmp_path / "a.ply").write_bytes(ply(form, header, *corners(form, 5), *rows))
    found = read_ply(tmp_path / "a.ply")
    fans = [(0, 1, 2), (2, 1, 3), (3, 2, 1), (0, 1, 2), (0, 2, 3), (4, 3, 2), (4, 2, 1), (4, 1, 0)]
    np.testing.assert_array_equal(found.faces, fans)
    np.testing.assert_array_equal(found.points, [[k, k + 1, k + 2] for k in range(5)])


@pytest.mark.parametrize("form", ORDERS)
def test_vertices_behind_another_element_and_with_lists(form: str, tmp_path: Path) -> None:
    header = (
        "element camera 2\nproperty float f\nproperty list int short k\n"
        f"element vertex 3\nproperty list uchar uchar seen_by\n{XYZ}"
    )
    cameras = [row(form, (1.5, "float"), (seen, "int", "short")) for seen in ([1, 2], [])]
    seen = [[0, 1], [], [1]]
    rows = [
        row(form, (by, "uchar", "uchar"), (k, "float"), (2 * k, "float"), (0.5, "float"))
        for k, by in enumerate(seen)
    ]
    (tmp_path / "a.ply").write_bytes(ply(form, header, *cameras, *rows))
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply").points, [[k, 2 * k, 0.5] for k in range(3)])


@pytest.mark.parametrize("form", ORDERS)
def test_what_follows_the_last_needed_element_is_not_read(form: str, tmp_path: Path) -> None:
    header = f"element vertex 2\n{XYZ}element face 0\nproperty list uchar int vertex_index\n"
    header += "element range_grid 5\nproperty list uchar int vertex_indices\n"
    (tmp_path / "a.ply").write_bytes(ply(form, header, *corners(form, 2), b"not rows of lists"))
    found = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.points, [[0, 1, 2], [1, 2, 3]])
    assert found.faces is None


@pytest.mark.parametrize("line_end", ["\r", "\r\n"])
def test_line_ends_of_other_systems(line_end: str, tmp_path: Path) -> None:
    header = f"ply\nformat {{}} 1.0\ncomment Müller's\nobj_info x\nelement vertex 2\n{XYZ}end_header\n"
    (tmp_path / "a.ply").write_bytes(
        (header.format("ascii") + "0 1 2\n1 2 3").replace("\n", line_end).encode()
    )
    lines = header.format("binary_big_endian").replace("\n", line_end)
    (tmp_path / "b.ply").write_bytes(lines.encode("latin-1") + b"".join(corners("binary_big_endian", 2)))
    for name in ("a.ply", "b.ply"):
        np.testing.assert_array_equal(read_ply(tmp_path / name).points, [[0, 1, 2], [1, 2, 3]])


TRIANGLE = f"element vertex 3\n{XYZ}element face 1\nproperty list char int vertex_index\n"
TEXT = b"0 0 0\n1 0 0\n0 1 0\n"
LITTLE = b"".join(corners("binary_little_endian", 3))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89PNG\r\n\x1a\n\xff\xd8", "its first line is not 'ply'"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n", "its header has no line 'end_header'"),
        (b"ply\nelement vertex 0\nend_header\n", "its header has no line 'format'"),
        (b"ply\nformat morse 1.0\nend_header\n", "its header has the line 'format morse 1.0'"),
        (b"ply\nformat ascii 2.0\nend_header\n", "its header has the line 'format ascii 2.0'"),
        (ply("ascii", "property float x\n"), "its header has the line 'property float x'"),
        (ply("ascii", "element vertex many\n"), "its header has the line 'element vertex many'"),
        (ply("ascii", "element vertex -1\n"), "its header has the line 'element vertex -1'"),
        (ply("ascii", "element vertex 0\nproperty half x\n"), "its header has the line 'property half x'"),
        (
            ply("ascii", "element face 0\nproperty list float int k\n"),
            "its header has the line 'property list float int k'",
        ),
        (ply("ascii", f"element vertex 0\n{XYZ}{XYZ}"), "declares vertex, or a property of it, twice"),
        (ply("ascii", f"element vertex 0\n{XYZ}" * 2), "declares vertex, or a property of it, twice"),
        (ply("ascii", TRIANGLE, b"0 0 0\n1 0 0"), "it ends after 1 of 3 lines of vertex"),
        (ply("ascii", TRIANGLE, TEXT), "it ends in the middle of face"),
        (ply("ascii", TRIANGLE, TEXT[:-2], b"x\n3 0 1 2\n"), "its lines of vertex hold more than numbers"),
        (ply("ascii", TRIANGLE, b"0 0 0 9\n", TEXT[6:]), "its lines of vertex hold more than its header"),
        (ply("ascii", TRIANGLE, TEXT, b"3 0 1\n"), "it ends in the middle of face"),
        (ply("ascii", TRIANGLE, TEXT, b"3 0 1 1.5\n"), "by other than whole numbers"),
        (ply("ascii", TRIANGLE, TEXT, b"3 0 1 nan\n"), "by other than whole numbers"),
        (
            ply("ascii", TRIANGLE, TEXT, b"3 0 1 1e30\n"),
            "by other than whole numbers",
        ),
        (ply("ascii", TRIANGLE, TEXT, b"1.5 0 1 2\n"), "a list in face cannot have 1.5 values"),
        (ply("ascii", TRIANGLE, TEXT, b"-1\n"), "a list in face cannot have -1 values"),
        (ply("binary_little_endian", TRIANGLE, LITTLE[:-1]), "it ends in the middle of vertex"),
        (ply("binary_little_endian", TRIANGLE, LITTLE), "it ends in the middle of face"),
        (ply("binary_little_endian", TRIANGLE, LITTLE, b"\x03" * 12), "it ends in the middle of face"),
        (ply("binary_little_endian", TRIANGLE, LITTLE, b"\xff"), "a list in face cannot have -1 values"),
    ],
)
def test_what_is_wrong_is_said(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(ScanReadError) as raised:
        read_ply(tmp_path / "a.ply")
    assert raised.value.message.startswith("not a complete PLY file (")
    assert words in raised.value.message


def test_messages_about_binary_files_do_not_quote_a_codec(tmp_path: Path) -> None:
    for start in (b"", b"ply\n", b"ply\nformat ascii 1.0\n"):
        (tmp_path / "a.ply").write_bytes(start + bytes(range(256)) * 4)
        with pytest.raises(ScanReadError) as raised:
            read_ply(tmp_path / "a.ply")
        assert "codec" not in raised.value.message
