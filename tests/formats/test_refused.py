"""Invalid files raise one error, which says what is wrong, with which file, and what to do."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_scans import HOSTILE
from numpy.typing import NDArray
from scan_files import HALVES, SQUARE, XYZ, glb, gltf, pcd_header

from pcretrieve import read_scan
from pcretrieve.errors import ScanReadError

PLY = f"ply\nformat ascii 1.0\nelement vertex 3\n{XYZ}"
ROWS = "0 0 0\n1 0 0\n0 1 0\n"

BROKEN = {
    "nothing.ply": (b"", "the file is empty: scan or export it again"),
    "no_vertex.ply": (
        b"ply\nformat ascii 1.0\nelement cat 1\nproperty int n\nend_header\n1\n",
        "must have an element 'vertex'",
    ),
    "no_z.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\nend_header\n1 2\n",
        "must have the fields x y z",
    ),
    "list_x.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\n"
        b"property int y\nproperty int z\nend_header\n1 1 2 3\n",
        "must have the fields x y z",
    ),
    "no_points.ply": (PLY.replace("vertex 3", "vertex 0").encode() + b"end_header\n", "has none at all"),
    "no_list.ply": (
        f"{PLY}element face 1\nproperty int vertex_indices\nend_header\n{ROWS}0\n".encode(),
        "must have the list vertex_indices or vertex_index",
    ),
    "beyond.ply": (
        f"{PLY}element face 1\nproperty list uchar int vertex_indices\nend_header\n{ROWS}3 0 1 3\n".encode(),
        "faces must name vertices 0 to 2, got 0 to 3",
    ),
    "promise.ply": (
        f"{PLY}element face 99999\nproperty list uchar int vertex_indices\nend_header\n{ROWS}".encode(),
        "its header declares 99999 of face, 18 bytes follow",
    ),
    "endless.ply": (
        PLY.replace("vertex 3", f"vertex {'9' * 5000}").encode() + b"end_header\n",
        "declares inf",
    ),
    "far.xyz": (b"1e300 0 0\n0 1e300 0\n", "coordinates must be 1e-50 to 1e+50 in size"),
    "near.xyz": (b"1e-300 0 0\n0 1e-300 0\n", "give the scan in another unit"),
    "short.xyzn": (b"1 2 3\n", "each line must hold 6 numbers"),
    "bytes.xyz": (bytes(range(256)), "not a text file, though its name ends in .xyz"),
    "zeros.pts": (bytes(100), "not a text file, though its name ends in .pts"),
    "blank.xyz": (b"\n\n", "has none at all"),
    "superscript.pts": ("²\n1 2\n".encode(), "each line must hold 3 numbers"),
    "no_data.pcd": (b"VERSION 0.7\nFIELDS x y z\n", "its header has no line DATA"),
    "no_z.pcd": ((pcd_header("x", "y", n=1) + "1 2\n").encode(), "must have the fields x y z"),
    "short.pcd": ((pcd_header("x", "y", "z", n=3) + ROWS[:6]).encode(), "declares 3 points and holds 1"),
    "odd.pcd": (
        pcd_header("x", "y", "z", n=3).replace("SIZE 4 4", "SIZE 4").encode(),
        "not a complete PCD file",
    ),
    "short_binary.pcd": (
        pcd_header("x", "y", "z", n=3, data="binary").encode() + bytes(20),
        "not a complete PCD file",
    ),
    "bad_lzf.pcd": (
        pcd_header("x", "y", "z", n=3, data="binary_compressed").encode()
        + struct.pack("<II", 9, 36)
        + bytes(9),
        "not a complete PCD file",
    ),
    "counts.pcd": (
        pcd_header("x", "y", "z", n=3).replace("COUNT 1", "COUNT 99999999").encode() + ROWS.encode(),
        "its header declares 100000001 values a point, 4096 may be",
    ),
    "underscores.pcd": (
        pcd_header("x", "y", "z", n=3, data="binary").replace("POINTS 3", "POINTS 3_000_000").encode()
        + bytes(36),
        "its header declares 3000000 points, 36 bytes follow",
    ),
    "lzf_size.pcd": (
        pcd_header("x", "y", "z", n=10**8, data="binary_compressed").encode()
        + struct.pack("<II", 9, 12 * 10**8)
        + bytes(9),
        "it declares 1200000000 bytes in 9, 9 follow",
    ),
    "lzf_points.pcd": (
        pcd_header("x", "y", "z", n=10**8, data="binary_compressed").encode()
        + struct.pack("<II", 9, 36)
        + bytes(9),
        "its header declares 100000000 points, 36 bytes follow",
    ),
    "words.pcd": (
        b"VERSION 0.7\nFIELDS x \xff\nDATA binary\n",
        "it holds bytes that are no text",
    ),
    "beyond.obj": (
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 1000000000000000000000000000000\n",
        "line 4 is 'f 1 2 1000000000000000000000000000000'",
    ),
    "no_vertices.obj": (b"# nothing\n", "it holds no vertices"),
    "half_line.obj": (b"v 1 2 3\nv 1 2", "line 2 is 'v 1 2'"),
    "zeroth.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4 is 'f 0 1 2'"),
    "half.stl": (b"solid\nfacet normal 0 0 1\nouter loop\n", "not a complete STL file"),
    "short.glb": (b"glTF\x02\x00\x00\x00", "not a complete GLB file"),
    "words.conf": (b"lorem ipsum\n", "must name its views"),
    "six.conf": (b"bmesh a.ply 0 0 0 0 0 1\n", "line 1 must read `bmesh FILE tx ty tz qx qy qz qw`"),
    "nan.conf": (b"bmesh a.ply 0 0 nan 0 0 0 1\n", "seven finite numbers"),
    "still.conf": (b"bmesh a.ply 0 0 0 0 0 0 0\n", "zero norm"),
    "nested.conf": (
        b"bmesh nested.conf 0 0 0 0 0 0 1\n",
        "its view nested.conf: a view must be a single range scan",
    ),
    "missing.conf": (b"bmesh gone.ply 0 0 0 0 0 0 1\n", "its view gone.ply: cannot read"),
    "blind.conf": (b"bmesh blind.xyz 0 0 0 0 0 0 1\n", "its view blind.xyz: it has no points"),
    "scan.doc": (b"1 2 3\n", "there is no reader for names in .doc"),
    "scan": (b"1 2 3\n", "there is no reader for names without a suffix"),
}


def ply(form: str, elements: str, *rows: bytes) -> bytes:
    return f"ply\nformat {form} 1.0\n{elements}end_header\n".encode() + b"".join(rows)


TRIANGLE = f"element vertex 3\n{XYZ}element face 1\nproperty list char int vertex_index\n"
TEXT = b"0 0 0\n1 0 0\n0 1 0\n"
LITTLE = np.add.outer(np.arange(3), np.arange(3)).astype("<f4").tobytes()

BROKEN_PLY: list[tuple[bytes, str]] = [
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
    (ply("ascii", f"element vertex 0\n{XYZ}{XYZ}"), "twice"),
    (ply("ascii", f"element vertex 0\n{XYZ}" * 2), "twice"),
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
]


def broken(**changes: Any) -> bytes:
    """A square with some of its entries replaced; keys are paths into the tree."""
    tree, binary = gltf(SQUARE, HALVES, [{"mesh": 0}])
    for path, value in changes.items():
        *way, last = (int(key) if key.isdigit() else key for key in path.split("__"))
        place: Any = tree
        for key in way:
            place = place[key]
        place[last] = value
    return glb(tree, binary)


GOOD = broken()

BROKEN_GLB: list[tuple[bytes, str]] = [
    (b"solid", "its first bytes are not those of glTF"),
    (GOOD[:4] + b"\1" + GOOD[5:], "it is not glTF 2.0"),
    (GOOD[:-4], f"its header declares {len(GOOD)} bytes, it has {len(GOOD) - 4}"),
    (GOOD[:12] + b"\xff\xff\xff\xff" + GOOD[16:], "its header declares"),
    (GOOD.replace(b'{"asset"', b'["asset"'), "not a complete GLB file (Expecting"),
    (GOOD.replace(b'"asset"', b"\xff" * 7), "it holds bytes that are no text"),
    (glb([]), "AttributeError"),
    (broken(scenes=[]), "IndexError"),
    (broken(nodes__0={}), "its scene has no vertices"),
    (broken(nodes=[{"mesh": 0, "children": [0]}]), "node 0 has more than one parent"),
    (broken(nodes__0__mesh=1), "IndexError"),
    (broken(accessors__0__count=5), "its binary part is too short for 5 values"),
    (broken(accessors__0__count=10**9), "its scene declares 1000000006 values"),
    (broken(accessors__0__count="many"), "not a complete GLB file (invalid literal"),
    (broken(accessors__1__count=5), "not a complete GLB file (cannot reshape"),
    (broken(accessors__0__byteOffset=-4), "its binary part is too short"),
    (broken(accessors__0__type="VEC2"), "positions must be VEC3 and indices SCALAR, one is VEC2"),
    (broken(accessors__0__componentType=5130), "KeyError"),
    (broken(accessors__0={"componentType": 5126, "type": "VEC3", "count": 4}), "export it plainly"),
    (broken(bufferViews__0__buffer=1), "its values lie outside of it"),
    (broken(buffers__0__uri="http://example.org/a.bin"), "its values lie outside of it"),
    (broken(accessors__0__count=3), "its faces name vertex 3, of 3"),
    (
        glb(*gltf(SQUARE * 100, HALVES * 50, [{"mesh": 0}] * 5000, roots=range(5000))),
        "its scene declares 3500000 values",
    ),
]

POSE = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
GRID = f"2\n2\n{POSE}"

BROKEN_PTX: list[tuple[str, str]] = [
    ("2\n2\n0 0 0\n", "its header is damaged: it must be ten lines"),
    ("1 2 3\n" * 20, "its header is damaged"),
    (GRID.replace("2\n2\n", "1.5\n2\n") + "1 2 3\n" * 9, "must be whole numbers, got 1.5 2"),
    (GRID.replace("\n1 0 0 0\n", "\n2 0 0 0\n") + "1 2 3\n" * 9, "the matrix is not a rigid motion"),
    (GRID + "1 2 3 0.5\n" * 3, "its header declares 4 points, it holds 3"),
    (GRID + "1 2\n" * 4, "each line must hold 3 numbers"),
    (GRID + "0 0 0 0.5\n" * 4, "a scan of 2 × 2 readings: none of its 4 readings is an answer"),
    (GRID + "0 0 1\n0 0 2\n0 0 5\n0 0 0\n", "none of its 3 readings has three neighbours"),
]

RASTER = "ncols 4\nnrows 4\nxllcorner 0\n" + "1 2 3 4\n" * 4

BROKEN_TABLES: list[tuple[str, str, str]] = [
    ("a.asc", RASTER, "a raster of heights by ESRI"),
    ("a.txt", "Three or more\n", "each line must hold 3 numbers, got 'Three or more'"),
    ("a.txt", "x y z\n1 2 3\n4 5\n", "each line must hold 3 numbers: invalid column index 2"),
    ("a.csv", "x,y,z\n1,2,3\n4,,5\n", "could not convert string ''"),
    ("a.csv", "id,x,y,z\n1,2,3,4,5\n", "its header names 4 columns, its first row has 5"),
    ("a.pts", "4\n1 2 3\n4 5 6\n", "it declares 4 points and holds 2"),
    ("a.xyz", "header\n" * 60 + "1 2 3\n", "each line must hold 3 numbers, got 'header'"),
]

ARRAYS: list[tuple[dict[str, NDArray[Any]], str]] = [
    ({"points": np.ones((5, 2))}, "must have the shape (n, c) or (h, w, c), c from 3 to 32, got (5, 2)"),
    ({"points": np.ones((40, 40))}, "got (40, 40)"),
    ({"points": np.ones((5, 3), dtype=complex)}, "must be real numbers, got complex128"),
    ({"points": np.array([["a", "b", "c"]])}, "must be real numbers, got <U1"),
    ({"points": np.zeros(5, dtype=[("x", "f4"), ("y", "f4")])}, "a scan must have the fields x y z"),
    (
        {"points": np.ones((5, 3)), "faces": np.ones((2, 3))},
        "faces must be whole numbers (m, 3)",
    ),
    ({"points": np.ones((5, 3)), "normals": np.ones((2, 3))}, "normals must be numbers (5, 3), got float64"),
    ({"points": np.ones((5, 3)), "viewpoint": np.ones(2)}, "viewpoints must be numbers (5, 3) or (3,)"),
    ({"ids": np.array(["a"]), "values": np.ones((1, 9))}, "must hold an array 'points', got ids, values"),
]


def test_what_cannot_be_read(tmp_path: Path) -> None:
    cases = [(name, content, words) for name, (content, words) in BROKEN.items()]
    cases += [("a.ply", content, words) for content, words in BROKEN_PLY]
    cases += [("a.glb", content, words) for content, words in BROKEN_GLB]
    cases += [("a.ptx", text.encode(), words) for text, words in BROKEN_PTX]
    cases += [(name, text.encode(), words) for name, text, words in BROKEN_TABLES]
    cases += HOSTILE.values()
    (tmp_path / "blind.xyz").write_text("nan nan nan\n" * 5)
    for name, content, words in cases:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ScanReadError) as raised:
            read_scan(tmp_path / name)
        assert words in raised.value.message, (name, words)
        assert raised.value.message.count(str(tmp_path / name)) == 1
        assert "codec" not in raised.value.message
        assert raised.value.stage == "read"
    assert not (tmp_path / "pickled").exists()


def test_arrays_that_are_no_points(tmp_path: Path) -> None:
    for arrays, words in ARRAYS:
        np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
        with pytest.raises(ScanReadError) as raised:
            read_scan(tmp_path / "a.npz")
        assert words in raised.value.message


def test_only_a_regular_file_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    (tmp_path / "endless.xyz").symlink_to("/dev/zero")
    (tmp_path / "folder.ply").mkdir()
    for name, words in (
        ("pipe.ply", "must be a regular file"),
        ("endless.xyz", "must be a regular file"),
        ("folder.ply", "is a folder, not a scan"),
        ("gone.ply", "No such file or directory"),
        ("a.wrl", r"there is no reader for names in \.wrl, .*: export the scan as \.obj or \.glb"),
    ):
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / name)
