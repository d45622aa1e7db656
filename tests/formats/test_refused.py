"""Invalid files raise one error, which says what is wrong, with which file, and what to do."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scan_files import (
    HALVES,
    HOSTILE,
    POSE,
    SQUARE,
    XYZ,
    glb,
    gltf,
    pcd_bomb,
    pcd_header,
    ply,
)

from pcretrieve import read_scan
from pcretrieve.errors import ScanReadError

ROWS = b"0 0 0\n1 0 0\n0 1 0\n"
POINTS = f"element vertex 3\n{XYZ}"
TRIANGLE = f"{POINTS}element face 1\nproperty list char int vertex_index\n"
LITTLE, FLOATS = (
    "binary_little_endian",
    np.add.outer(np.arange(3), np.arange(3)).astype("<f4").tobytes(),
)
PCD, BINARY = (
    pcd_header("x", "y", "z", n=3),
    pcd_header("x", "y", "z", n=3, data="binary"),
)
GRID = f"2\n2\n{POSE}"
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def broken(**changes: Any) -> bytes:
    """A square as GLB with some of its entries replaced; keys are paths into the tree."""
    tree, binary = gltf(SQUARE, HALVES, [{"mesh": 0}])
    for path, value in changes.items():
        *way, last = (int(key) if key.isdigit() else key for key in path.split("__"))
        place: Any = tree
        for key in way:
            place = place[key]
        place[last] = value
    return glb(tree, binary)


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


GOOD = broken()

REFUSED: list[tuple[str, str | bytes, str]] = [
    ("scan.doc", "1 2 3\n", "there is no reader for names in .doc"),
    ("scan", "1 2 3\n", "there is no reader for names without a suffix"),
    ("nothing.ply", b"", "the file is empty: scan or export it again"),
    ("near.xyz", "1e-300 0 0\n0 1e-300 0\n", "give the scan in another unit"),
    # PLY: the header
    (
        "a.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\n",
        "its header has no line 'end_header'",
    ),
    ("a.ply", "ply\nelement vertex 0\nend_header\n", "its header has no line 'format'"),
    ("a.ply", ply("morse", ""), "its header has the line 'format morse 1.0'"),
    (
        "a.ply",
        ply("ascii", "element a 0\nproperty half x\n"),
        "its header has the line 'property half x'",
    ),
    ("a.ply", ply("ascii", f"element vertex 0\n{XYZ}{XYZ}"), "occurs more than once"),
    (
        "a.ply",
        ply("ascii", f"element vertex 0\n{XYZ}element vertex 0\n{XYZ}"),
        "its header has the line 'element vertex 0'",
    ),
    ("a.ply", ply("ascii", f"element vertex {'9' * 5000}\n{XYZ}"), "declares inf"),
    (
        "a.ply",
        ply("ascii", TRIANGLE.replace("face 1", "face 99999"), ROWS),
        "its header declares 99999 of face, 18 bytes follow",
    ),
    # PLY: the rows
    (
        "a.ply",
        ply("ascii", "element cat 1\nproperty int n\n", b"1\n"),
        "must have an element 'vertex'",
    ),
    ("a.ply", ply("ascii", f"element vertex 0\n{XYZ}"), "has none at all"),
    (
        "a.ply",
        ply(
            "ascii",
            POINTS + "element face 1\nproperty int vertex_indices\n",
            ROWS,
            b"0\n",
        ),
        "must have the list vertex_indices or vertex_index",
    ),
    (
        "a.ply",
        ply("ascii", TRIANGLE, ROWS, b"3 0 1 3\n"),
        "faces must name vertices 0 to 2, got 0 to 3",
    ),
    (
        "a.ply",
        ply("ascii", TRIANGLE, b"0 0 0\n1 0 0"),
        "it ends after 1 of 3 lines of vertex",
    ),
    (
        "a.ply",
        ply("ascii", TRIANGLE, ROWS[:-2], b"x\n3 0 1 2\n"),
        "lines of vertex hold more than numbers",
    ),
    (
        "a.ply",
        ply("ascii", TRIANGLE, ROWS, b"3 0 1 1.5\n"),
        "by other than whole numbers",
    ),
    (
        "a.ply",
        ply("ascii", TRIANGLE, ROWS, b"1.5 0 1 2\n"),
        "a list in face cannot have 1.5 values",
    ),
    ("a.ply", ply(LITTLE, TRIANGLE, FLOATS[:-1]), "it ends in the middle of vertex"),
    # PCD
    ("a.pcd", "VERSION 0.7\nFIELDS x y z\n", "its header has no line DATA"),
    ("a.pcd", b"VERSION 0.7\nFIELDS x \xff\nDATA binary\n", "KeyError 'TYPE'"),
    ("a.pcd", pcd_header("x", "y", n=1) + "1 2\n", "must have the fields x y z"),
    ("a.pcd", PCD + "0 0 0\n", "declares 3 points and holds 1"),
    (
        "a.pcd",
        PCD.replace("COUNT 1", "COUNT 99999999"),
        "100000001 values a point, 4096 may be",
    ),
    ("a.pcd", pcd_bomb(36, n=3), "its points do not expand to 36 bytes"),
    (
        "a.pcd",
        pcd_bomb(36, n=10**8),
        "its header declares 100000000 points, 36 bytes follow",
    ),
    # Tables
    ("short.xyzn", "1 2 3\n", "each line must hold 6 numbers"),
    ("bytes.xyz", bytes(range(256)), "not a text file, though its name ends in .xyz"),
    ("blank.xyz", "\n\n", "has none at all"),
    ("a.pts", "4\n1 2 3\n4 5 6\n", "it declares 4 points and holds 2"),
    (
        "a.asc",
        "ncols 4\nnrows 4\nxllcorner 0\n" + "1 2 3 4\n" * 4,
        "a raster of heights by ESRI",
    ),
    ("a.xyz", "header\n" * 60 + "1 2 3\n", "each line must hold 3 numbers, got 'header'"),
    # PTX
    ("a.ptx", "2\n2\n0 0 0\n", "its header is damaged: it must be ten lines"),
    (
        "a.ptx",
        GRID.replace("\n1 0 0 0", "\n2 0 0 0") + "1 2 3\n" * 9,
        "the matrix is not a rigid motion",
    ),
    (
        "a.ptx",
        GRID + "0 0 0 0.5\n" * 4,
        "a scan must have points with finite coordinates, this one has none at all",
    ),
    (
        "a.ptx",
        GRID + "0 0 1\n0 0 2\n0 0 5\n0 0 0\n",
        "none of its 3 readings has three neighbours",
    ),
    # Arrays
    (
        "a.npz",
        npz(points=np.ones((5, 2))),
        "(n, c) or (h, w, c), c from 3 to 32, got (5, 2)",
    ),
    (
        "a.npz",
        npz(points=np.ones((5, 3), dtype=complex)),
        "must be an array of numbers, got one of type complex128",
    ),
    (
        "a.npz",
        npz(points=np.zeros(5, dtype=[("x", "f4"), ("y", "f4")])),
        "must have the fields x y z",
    ),
    (
        "a.npz",
        npz(points=np.ones((5, 3)), faces=np.full((2, 3), 0.5)),
        "faces must be whole numbers",
    ),
    (
        "a.npz",
        npz(ids=np.array(["a"]), values=np.ones(9)),
        "must hold an array 'points', got ids, values",
    ),
    # Meshes
    ("a.obj", CORNERS + f"f 1 2 1{'0' * 30}\n", f"line 4 is 'f 1 2 1{'0' * 30}'"),
    ("a.glb", b"glTF\x02\x00\x00\x00", "not a complete GLB file"),
    ("a.glb", GOOD[:4] + b"\1" + GOOD[5:], "it is not glTF 2.0"),
    (
        "a.glb",
        GOOD[:-4],
        f"its header declares {len(GOOD)} bytes, it has {len(GOOD) - 4}",
    ),
    ("a.glb", GOOD.replace(b'{"asset"', b'["asset"'), "not a valid GLB file (Expecting"),
    ("a.glb", broken(nodes__0={}), "its scene has no vertices"),
    (
        "a.glb",
        broken(nodes=[{"mesh": 0, "children": [0]}]),
        "node 0 has more than one parent",
    ),
    ("a.glb", broken(accessors__0__count=5), "its binary part is too short for 5 values"),
    ("a.glb", broken(accessors__0__count=10**9), "its scene declares 1000000006 values"),
    (
        "a.glb",
        broken(accessors__0__type="VEC2"),
        "positions must be VEC3 and indices SCALAR, one is VEC2",
    ),
    ("a.glb", broken(accessors__0={"type": "VEC3", "count": 4}), "export it plainly"),
    (
        "a.glb",
        broken(buffers__0__uri="http://example.org/a.bin"),
        "its values lie outside of it",
    ),
    ("a.glb", broken(accessors__0__count=3), "its faces name vertex 3, of 3"),
    # Views
    ("words.conf", "lorem ipsum\n", "must name its views"),
    (
        "six.conf",
        "bmesh a.ply 0 0 0 0 0 1\n",
        "line 1 must read `bmesh FILE tx ty tz qx qy qz qw`",
    ),
    (
        "nested.conf",
        "bmesh nested.conf 0 0 0 0 0 0 1\n",
        "its view nested.conf: a view must be a single",
    ),
    ("missing.conf", "bmesh gone.ply 0 0 0 0 0 0 1\n", "its view gone.ply: cannot read"),
    (
        "blind.conf",
        "bmesh blind.xyz 0 0 0 0 0 0 1\n",
        "its view blind.xyz: it has no points",
    ),
]


def test_what_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "blind.xyz").write_text("nan nan nan\n" * 5)
    for name, content, words in (*REFUSED, *HOSTILE):
        (tmp_path / name).write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
        with pytest.raises(ScanReadError) as raised:
            read_scan(tmp_path / name)
        assert words in raised.value.message, (name, words)
        assert raised.value.message.count(str(tmp_path / name)) == 1
        assert "codec" not in raised.value.message
        assert raised.value.stage == "read"
    assert not (tmp_path / "pickled").exists()


def test_only_a_regular_file_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    (tmp_path / "endless.xyz").symlink_to("/dev/zero")
    (tmp_path / "folder.ply").mkdir()
    for name, words in (
        ("pipe.ply", "must be a regular file"),
        ("endless.xyz", "must be a regular file"),
        ("folder.ply", "is a folder, not a scan"),
        ("gone.ply", "No such file or directory"),
        (
            "a.wrl",
            r"there is no reader for names in \.wrl, .*: export it as \.obj or \.glb",
        ),
        ("Model.zip", r"there is no reader for names in \.zip, .*: unpack it first"),
        ("scan.ply.gz", r"there is no reader for names in \.gz, .*: unpack it first"),
    ):
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / name)
