"""Valid and invalid scan files of each kind, for tests."""

from __future__ import annotations

import base64
import importlib.util
import io
import json
import struct
import zipfile
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.formats.registry import missing_extra

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
# Corners of each side, counter-clockwise from outside.
SIDES = [
    (0, 1, 3, 2),
    (4, 6, 7, 5),
    (0, 4, 5, 1),
    (2, 3, 7, 6),
    (0, 2, 6, 4),
    (1, 5, 7, 3),
]
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
HALVES = [0, 1, 2, 0, 2, 3]


def cloud(path: Path) -> PointCloud:
    found = read_scan(path)
    assert isinstance(found, PointCloud)
    return found


def mesh(path: Path) -> TriangleMesh:
    found = read_scan(path)
    assert isinstance(found, TriangleMesh)
    return found


def needs(suffix: str) -> pytest.MarkDecorator:
    can = CAN_WRITE.get(suffix, True) and missing_extra(suffix) is None
    return pytest.mark.skipif(
        not can, reason=f"needs what reads and writes {suffix} files"
    )


# --- points ------------------------------------------------------------------------------------------------

# The lines of a PTX header below the size of its grid.
POSE = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {n}\nHEIGHT 1\n"
    "VIEWPOINT {viewpoint}\nPOINTS {n}\nDATA {data}\n"
)


def pcd_header(
    *fields: str, n: int, data: str = "ascii", viewpoint: str = "0 0 0 1 0 0 0"
) -> str:
    repeat = {"sizes": "4", "types": "F", "counts": "1"}
    columns = {key: " ".join([value] * len(fields)) for key, value in repeat.items()}
    return PCD.format(
        fields=" ".join(fields), n=n, data=data, viewpoint=viewpoint, **columns
    )


def ply(form: str, elements: str, *rows: bytes) -> bytes:
    return f"ply\nformat {form} 1.0\n{elements}end_header\n".encode() + b"".join(rows)


# --- scenes ------------------------------------------------------------------------------------------------


def glb(tree: object, binary: bytes = b"") -> bytes:
    """A JSON tree and a binary chunk, as GLB."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf(
    vertices: Sequence[Sequence[float]],
    indices: Sequence[int],
    nodes: Sequence[Any],
    roots: Sequence[int] = (0,),
) -> tuple[dict[str, Any], bytes]:
    """One mesh and the nodes that show it, as the JSON tree and the binary chunk of a GLB file."""
    points, corners = np.asarray(vertices, dtype="<f4"), np.asarray(indices, dtype="<u2")
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(roots)}],
        "nodes": list(nodes),
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "type": "VEC3",
                "count": len(points),
            },
            {
                "bufferView": 1,
                "componentType": 5123,
                "type": "SCALAR",
                "count": len(corners),
            },
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": corners.nbytes},
        ],
        "buffers": [{"byteLength": points.nbytes + corners.nbytes}],
    }
    return tree, points.tobytes() + corners.tobytes()


THREE_MF = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"


def three_mf(
    body: TriangleMesh, *, unit: str = "millimeter", items: str = '<item objectid="1"/>'
) -> bytes:
    """An archive with one object, which the items of the build place."""
    vertices = "".join(
        '<vertex x="{:.9g}" y="{:.9g}" z="{:.9g}"/>'.format(*point)
        for point in body.vertices
    )
    triangles = "".join(
        '<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in body.faces
    )
    model = (
        f'<model unit="{unit}" xmlns="{THREE_MF}"><resources><object id="1" name="ball" type="model"><mesh>'
        f"<vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object></resources>"
        f"<build>{items}</build></model>"
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", model)
    return file.getvalue()


def collada(
    *meshes: TriangleMesh, metres: float = 1.0, shift: Sequence[float] = (0, 0, 0)
) -> str:
    """Meshes and the nodes that show them, by pycollada."""
    import collada  # type: ignore[import-not-found,import-untyped,unused-ignore]

    document = collada.Collada()
    document.assetInfo.unitname, document.assetInfo.unitmeter = "u", metres
    nodes = []
    for number, mesh in enumerate(meshes):
        values = mesh.vertices.ravel()
        source = collada.source.FloatSource(f"points_{number}", values, ("X", "Y", "Z"))
        name = f"texture_{number}"
        geometry = collada.geometry.Geometry(document, name, name, [source])
        inputs = collada.source.InputList()
        inputs.addInput(0, "VERTEX", f"#points_{number}")
        geometry.primitives.append(
            geometry.createTriangleSet(mesh.faces.ravel(), inputs, "paint")
        )
        document.geometries.append(geometry)
        place = [collada.scene.TranslateTransform(*shift)]
        shown = [collada.scene.GeometryNode(geometry, [])]
        nodes.append(collada.scene.Node(f"node_{number}", shown, place))
    document.scene = collada.scene.Scene("scene", nodes)
    document.scenes.append(document.scene)
    file = io.BytesIO()
    document.write(file)
    return file.getvalue().decode()


def write_gltf(
    path: Path, mesh: TriangleMesh, nodes: list[dict[str, Any]], buffer: str = ""
) -> None:
    """A glTF file and, if it is named, the file of its buffer; else the buffer is a data URI."""
    tree, binary = gltf(
        mesh.vertices.tolist(), mesh.faces.ravel().tolist(), nodes, range(len(nodes))
    )
    tree["buffers"][0]["uri"] = (
        buffer or "data:;base64," + base64.b64encode(binary).decode()
    )
    path.write_text(json.dumps(tree))
    if buffer:
        (path.parent / buffer).write_bytes(binary)


# --- laser scanners ----------------------------------------------------------------------------------------

# What the tests need beside pcretrieve to write a file.
WRITERS = {".las": ("laspy",), ".laz": ("laspy", "lazrs"), ".e57": ("pye57",)}
CAN_WRITE = {
    suffix: all(importlib.util.find_spec(module) for module in modules)
    for suffix, modules in WRITERS.items()
}


def write_las(
    path: Path, points: Any, *, point_format: int = 3, classes: Sequence[int] = ()
) -> None:
    """Points to a tenth of a millimetre, compressed if the file is named so."""
    import laspy

    header = laspy.LasHeader(
        point_format=point_format, version="1.4" if point_format > 5 else "1.2"
    )
    header.scales, header.offsets = np.full(3, 1e-4), np.array([10.0, 20.0, 30.0])
    data = laspy.LasData(header)
    data.x, data.y, data.z = np.transpose(points)
    if classes:
        data.classification = np.array(classes)
    data.write(str(path))


def write_e57(path: Path, scans: Sequence[dict[str, Any]]) -> None:
    """Scans of the points (n, 3), with the arguments of pye57: name, rotation (w, x, y, z), translation."""
    import pye57

    with pye57.E57(str(path), "w") as file:
        for scan in scans:
            points = np.asarray(scan["points"], dtype=np.float64)
            columns = {f"cartesian{axis}": points[:, k] for k, axis in enumerate("XYZ")}
            columns |= {
                name: scan[name] for name in ("rowIndex", "columnIndex") if name in scan
            }
            pose = {
                name: scan[name]
                for name in ("name", "rotation", "translation")
                if name in scan
            }
            file.write_scan_raw(columns, **pose)


PAGE, CHECKSUM = 1024, 4  # of E57 files; bytes


def without_checksums(data: bytes) -> bytes:
    """The content of an E57 file."""
    return b"".join(data[k : k + PAGE - CHECKSUM] for k in range(0, len(data), PAGE))


def with_checksums(content: bytes, n_bytes: int) -> bytes:
    """An E57 file of that size, in which damage of the content is not found by its checksums alone."""
    size = PAGE - CHECKSUM
    whole = content[: n_bytes // PAGE * size].ljust(n_bytes // PAGE * size, b"\0")
    pages = (whole[k : k + size] for k in range(0, len(whole), size))
    return b"".join(page + _crc32c(page).to_bytes(CHECKSUM, "big") for page in pages)


def with_other_xml(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """An E57 file, which must end with its XML part, with that part changed."""
    content = without_checksums(data)
    place, n_xml = struct.unpack_from("<QQ", content, 24)
    start = place // PAGE * (PAGE - CHECKSUM) + place % PAGE
    xml = change(content[start : start + n_xml])
    whole = bytearray(content[:start] + xml)
    size = PAGE * -(-len(whole) // (PAGE - CHECKSUM))
    struct.pack_into("<Q", whole, 16, size)
    struct.pack_into("<Q", whole, 32, len(xml))
    return with_checksums(bytes(whole), size)


def _remainder(value: int) -> int:
    """The remainder of a byte by the polynomial of Castagnoli."""
    for _ in range(8):
        value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return value


REMAINDERS = [_remainder(byte) for byte in range(256)]


@lru_cache(maxsize=64)  # most pages of a file that is damaged stay as they are
def _crc32c(data: bytes) -> int:
    """The checksum of Castagnoli."""
    value = 0xFFFFFFFF
    for byte in data:
        value = value >> 8 ^ REMAINDERS[(value ^ byte) & 255]
    return value ^ 0xFFFFFFFF


def laser_scan(folder: Path, suffix: str) -> bytes:
    """A whole scan of a hundred points, whose header promises more than there are."""
    path, points = folder / f"a{suffix}", np.arange(300.0).reshape(-1, 3)
    if suffix == ".e57":
        write_e57(path, [{"points": points}])
        count = b'recordCount="%d"'
        return with_other_xml(
            path.read_bytes(), lambda xml: xml.replace(count % 100, count % HUGE)
        )
    write_las(path, points, point_format=6)
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 247, HUGE)
    return bytes(data)


# --- files that a hostile person would upload --------------------------------------------------------------

HUGE = 999_999_999_999

# Unpickled, it would write a file; numpy reads it where `allow_pickle` is set.
PICKLE = b"cos\nsystem\n(S'echo > pickled'\ntR."

# One triangle, and the names of files and programs that a reader of materials would open.
REFERENCES = (
    "mtllib file:///etc/passwd\nmtllib ../../../../etc/passwd\nmtllib http://127.0.0.1:{port}/a.mtl\n"
    "call /etc/passwd\ncsh id\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"
)


def npy(declared: str, body: bytes = b"") -> bytes:
    """An array whose header says what it likes."""
    return (
        b"\x93NUMPY\x01\x00"
        + struct.pack("<H", 118)
        + declared.encode().ljust(117)
        + b"\n"
        + body
    )


def pcd_bomb(n_bytes: int, n: int = 3 * 10**8, packed: int = 99) -> bytes:
    """A compressed file of so many points that declares to expand to so many bytes."""
    head = pcd_header("x", "y", "z", n=n, data="binary_compressed").encode()
    return head + struct.pack("<II", packed, n_bytes) + bytes(packed)


# The name of the file, its content, and words of the message by which it is refused: promises of many points,
# code, other formats, references, text that never ends or says nothing.
HOSTILE: list[tuple[str, bytes, str]] = [
    ("a.ply", ply("ascii", f"element vertex {HUGE}\n{XYZ}", b"0 0 0\n"), "declares"),
    (
        "a.pcd",
        pcd_header("x", "y", "z", n=HUGE, data="binary").encode() + bytes(12),
        "declares",
    ),
    ("a.pcd", pcd_bomb(36 * 10**8), "declares 3600000000 bytes in 99"),
    (
        "a.pcd",
        pcd_bomb(36 * 10**6, 3 * 10**6, 10**6),
        "declares 36000000 bytes in 1000000",
    ),
    (
        "a.stl",
        bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50),
        "4294967295 triangles in 134 bytes",
    ),
    ("a.off", f"OFF\n{HUGE} {HUGE} 0\n0 0 0\n".encode(), "declares"),
    (
        "a.ptx",
        f"{10**9}\n{10**9}\n{POSE}0 0 0 0.5\n".encode(),
        f"declares {10**18} rows in",
    ),
    (
        "a.npy",
        npy(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({HUGE}, 3), }}"),
        "declares",
    ),
    (
        "a.npy",
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }", PICKLE),
        "Python objects",
    ),
    ("a.npy", npy("__import__('os').system('echo > pickled')"), "not a valid NPY"),
    ("a.npy", PICKLE, "not a valid NPY"),
    ("a.php.off", b"<?php system($_GET['a']); ?>", "not a valid OFF"),
    ("a.obj", b"<script>alert(1)</script>\nv <b> 0 0\n", "line 2 is 'v <b> 0 0'"),
    (
        "a.ply",
        b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>',
        "first line is not 'ply'",
    ),
    ("a.xyz", b"9" * 900_000 + b" 1 2\n", "each line must hold 3 numbers"),
    (
        "a.xyz",
        b"1e308 -1e308 1e308\n" * 200,
        "coordinates must be 1e-50 to 1e+50 in size",
    ),
]
