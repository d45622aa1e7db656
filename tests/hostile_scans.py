"""Files that a hostile person would upload: promises of many points, other formats, code, references."""

from __future__ import annotations

import struct
from pathlib import Path

import shapes
from scan_files import with_other_xml, write_e57, write_las

HUGE = 999_999_999_999

FLOATS = "".join(f"property float {axis}\n" for axis in "xyz")
PLY = "ply\nformat {} 1.0\nelement vertex {}\n" + FLOATS + "end_header\n"
PCD = (
    "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    "WIDTH {0}\nHEIGHT 1\nPOINTS {0}\nDATA {1}\n"
)
PTX = f"{10**9}\n{10**9}\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n0 0 0 0.5\n"

# Unpickled, it would write a file; numpy reads it where `allow_pickle` is set.
PICKLE = b"cos\nsystem\n(S'echo > pickled'\ntR."

# One triangle, and the names of files and programs that a reader of materials would open.
REFERENCES = (
    "mtllib file:///etc/passwd\nmtllib ../../../../etc/passwd\nmtllib http://127.0.0.1:{port}/a.mtl\n"
    "call /etc/passwd\ncsh id\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"
)


def npy(declared: str, body: bytes) -> bytes:
    """An array whose header says what it likes."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", 118) + declared.encode().ljust(117) + b"\n" + body


# The name of the file, its content, and words of the message by which it is refused.
HOSTILE = {
    "vertices of ascii PLY": ("a.ply", PLY.format("ascii", HUGE).encode() + b"0 0 0\n", "declares"),
    "vertices of binary PLY": ("a.ply", PLY.format("binary_little_endian", HUGE).encode() + b"0", "declares"),
    "points of PCD": ("a.pcd", PCD.format(HUGE, "binary").encode() + bytes(12), "declares"),
    "bomb in PCD": (
        "a.pcd",
        PCD.format(3 * 10**8, "binary_compressed").encode() + struct.pack("<II", 99, 36 * 10**8) + bytes(99),
        "declares 3600000000 bytes in 99",
    ),
    "faces of STL": ("a.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), "not a complete STL"),
    "faces of OFF": ("a.off", f"OFF\n{HUGE} {HUGE} 0\n0 0 0\n".encode(), "not a complete OFF"),
    "grid of PTX": ("a.ptx", PTX.encode(), f"declares {10**18} rows in"),
    "shape of NPY": (
        "a.npy",
        npy(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({HUGE}, 3), }}", b""),
        "declares",
    ),
    "objects of NPY": (
        "a.npy",
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }", PICKLE),
        "Python objects",
    ),
    "code in the header of NPY": (
        "a.npy",
        npy("__import__('os').system('echo > pickled')", b""),
        "not a complete NPY",
    ),
    "pickle": ("a.npy", PICKLE, "not a complete NPY"),
    "shell script": ("a.php.off", b"<?php system($_GET['a']); ?>", "not a complete OFF"),
    "page": ("a.obj", b"<script>alert(1)</script>\nv <b> 0 0\n", "line 2 is 'v <b> 0 0'"),
    "picture": ("a.off", b"\x89PNG\r\n\x1a\n" + bytes(99), "not a complete OFF"),
    "archive": ("a.ply", b"PK\x03\x04" + bytes(99), "its first line is not 'ply'"),
    "XML": (
        "a.ply",
        b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>',
        "its first line is not 'ply'",
    ),
    "line without end": ("a.xyz", b"9" * 900_000 + b" 1 2\n", "each line must hold 3 numbers"),
    "numbers beyond all": ("a.xyz", b"1e308 -1e308 1e308\n" * 200, "coordinates must be"),
    "not numbers": ("a.xyz", b"nan inf nan\n" * 200, ""),
    "lines of a log": ("a.off", b"OFF\nscan: read in 1.2.3 s\nscan: x in 1 s\n", "not a complete OFF"),
    "polyglot": ("a.off", b"OFF\n#<script>alert(1)</script>\n/*PK\x03\x04*/GIF89a\n", "not a complete OFF"),
}


def laser_scan(folder: Path, suffix: str) -> bytes:
    """A whole scan of a hundred points, whose header promises more than there are."""
    path = folder / f"a{suffix}"
    points = shapes.points_on(shapes.body(), 100)
    if suffix == ".e57":
        write_e57(path, [{"points": points}])
        count = b'recordCount="%d"'
        return with_other_xml(path.read_bytes(), lambda xml: xml.replace(count % 100, count % HUGE))
    write_las(path, points, point_format=6)
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 247, HUGE)
    return bytes(data)
