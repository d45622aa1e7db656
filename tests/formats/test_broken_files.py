"""Invalid files raise one error, which says what is wrong, with which file, and what to do."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from scan_files import XYZ, pcd_header

from pcretrieve import read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import parts_of

PLY = f"ply\nformat ascii 1.0\nelement vertex 3\n{XYZ}"
ROWS = "0 0 0\n1 0 0\n0 1 0\n"

BROKEN = {
    "nothing.ply": (b"", "the file is empty: scan or export it again"),
    "image.ply": (b"\x89PNG\r\n\x1a\n", "not a complete PLY file"),
    "no_end.ply": (b"ply\nformat ascii 1.0\nelement vertex 3\n", "not a complete PLY file"),
    "no_vertex.ply": (
        b"ply\nformat ascii 1.0\nelement cat 1\nproperty int n\nend_header\n1\n",
        "must have an element 'vertex'",
    ),
    "no_z.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\nend_header\n1 2\n",
        "must have the numbers x, y and z",
    ),
    "list_x.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\n"
        b"property int y\nproperty int z\nend_header\n1 1 2 3\n",
        "must have the numbers x, y and z",
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
    "words.xyz": (b"lorem ipsum dolor\n", "each line must hold 3 numbers"),
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
    "codec.pcd": (
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
    "half.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n", "not a complete OFF file"),
    "words.off": (b"lorem ipsum\n", "not a complete OFF file"),
    "half.stl": (b"solid\nfacet normal 0 0 1\nouter loop\n", "not a complete STL file"),
    "promise.stl": (bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "not a complete STL file"),
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
    "scan.doc": (b"1 2 3\n", "there is no reader for names in .doc"),
    "scan": (b"1 2 3\n", "there is no reader for names without a suffix"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_cannot_be_read(name: str, tmp_path: Path) -> None:
    content, words = BROKEN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ScanReadError) as raised:
        read_scan(tmp_path / name)
    assert words in raised.value.message
    assert raised.value.message.count(str(tmp_path / name)) == 1
    assert raised.value.stage == "read"


def test_a_view_without_points(tmp_path: Path) -> None:
    (tmp_path / "blind.xyz").write_text("nan nan nan\n" * 5)
    (tmp_path / "a.conf").write_text("bmesh blind.xyz 0 0 0 0 0 0 1\n")
    with pytest.raises(ScanReadError, match=r"its view blind\.xyz: it has no points with finite coordinates"):
        read_scan(tmp_path / "a.conf")


def test_a_conf_names_its_views(tmp_path: Path) -> None:
    (tmp_path / "a.conf").write_text("camera 0 0 0\nbmesh a.ply 0 0 0 0 0 0 1\n\nbmesh b.ply 1 0 0 0 0 0 1\n")
    first, second = parts_of(tmp_path / "a.conf")
    assert (first.path, second.path) == (tmp_path / "a.ply", tmp_path / "b.ply")
    np.testing.assert_array_equal(first.pose, np.eye(4))
    np.testing.assert_array_equal(second.pose, [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert parts_of(tmp_path / "a.ply") == parts_of(tmp_path / "a.doc") == ()


def test_only_a_regular_file_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    (tmp_path / "endless.xyz").symlink_to("/dev/zero")
    (tmp_path / "folder.ply").mkdir()
    for name, words in (
        ("pipe.ply", "must be a regular file"),
        ("endless.xyz", "must be a regular file"),
        ("folder.ply", "is a folder, not a scan"),
        ("gone.ply", "No such file or directory"),
    ):
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / name)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_that_may_not_be_read(tmp_path: Path) -> None:
    (tmp_path / "secret.xyz").write_text("1 2 3\n")
    (tmp_path / "secret.xyz").chmod(0)
    with pytest.raises(ScanReadError, match="Permission denied"):
        read_scan(tmp_path / "secret.xyz")
