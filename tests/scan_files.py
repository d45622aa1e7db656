"""Valid and invalid scan files of each kind, for tests."""

from __future__ import annotations

import base64
import importlib.util
import io
import json
import struct
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.formats import missing_extra

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
# Corners of each side, counter-clockwise from outside.
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
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
    return pytest.mark.skipif(not can, reason=f"needs what reads and writes {suffix} files")


# --- PCD ---------------------------------------------------------------------------------------------------

XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {n}\nHEIGHT 1\n"
    "VIEWPOINT {viewpoint}\nPOINTS {n}\nDATA {data}\n"
)


def pcd_header(*fields: str, n: int, data: str = "ascii", viewpoint: str = "0 0 0 1 0 0 0") -> str:
    repeat = {"sizes": "4", "types": "F", "counts": "1"}
    columns = {key: " ".join([value] * len(fields)) for key, value in repeat.items()}
    return PCD.format(fields=" ".join(fields), n=n, data=data, viewpoint=viewpoint, **columns)


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
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": len(points)},
            {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": len(corners)},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": corners.nbytes},
        ],
        "buffers": [{"byteLength": points.nbytes + corners.nbytes}],
    }
    return tree, points.tobytes() + corners.tobytes()


THREE_MF = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
TYPES = (
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>"
)
COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2024-01-01T00:00:00Z</created><modified>2024-01-01T00:00:00Z</modified>
<unit name="u" meter="{metres}"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="{n}">{values}</float_array><technique_common>
<accessor source="#a" count="{points}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/><p>{numbers}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="first"><translate>{shift}</translate>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>
"""


def numbers(array: Any) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(array))


def three_mf(body: TriangleMesh, *, unit: str = "millimeter", items: str = '<item objectid="1"/>') -> bytes:
    """An archive with one object, which the items of the build place."""
    vertices = "".join('<vertex x="{:.9g}" y="{:.9g}" z="{:.9g}"/>'.format(*point) for point in body.vertices)
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in body.faces)
    content = (
        f'<object id="1" name="ball" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}'
    )
    model = (
        f'<model unit="{unit}" xmlns="{THREE_MF}"><resources>{content}</triangles></mesh></object>'
        "</resources>"
        f"<build>{items}</build></model>"
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", TYPES)
        archive.writestr("3D/3dmodel.model", model)
    return file.getvalue()


def collada(mesh: TriangleMesh, *, metres: float = 1.0, shift: str = "0 0 0") -> str:
    return COLLADA.format(
        metres=metres,
        n=mesh.vertices.size,
        values=numbers(mesh.vertices),
        shift=shift,
        points=len(mesh.vertices),
        faces=len(mesh.faces),
        numbers=numbers(mesh.faces),
    )


def write_gltf(path: Path, mesh: TriangleMesh, nodes: list[dict[str, Any]], buffer: str = "") -> None:
    """A glTF file and, if it is named, the file of its buffer; else the buffer is a data URI."""
    tree, binary = gltf(mesh.vertices.tolist(), mesh.faces.ravel().tolist(), nodes, range(len(nodes)))
    tree["buffers"][0]["uri"] = buffer or "data:;base64," + base64.b64encode(binary).decode()
    path.write_text(json.dumps(tree))
    if buffer:
        (path.parent / buffer).write_bytes(binary)


# --- laser scanners ----------------------------------------------------------------------------------------

# What the tests need beside pcretrieve to write a file.
WRITERS = {".las": ("laspy",), ".laz": ("laspy", "lazrs"), ".e57": ("pye57",)}
CAN_WRITE = {
    suffix: all(importlib.util.find_spec(module) for module in modules) for suffix, modules in WRITERS.items()
}


def write_las(path: Path, points: Any, *, point_format: int = 3, classes: Sequence[int] = ()) -> None:
    """Points to a tenth of a millimetre, compressed if the file is named so."""
    import laspy

    header = laspy.LasHeader(point_format=point_format, version="1.4" if point_format > 5 else "1.2")
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
            columns |= {name: scan[name] for name in ("rowIndex", "columnIndex") if name in scan}
            pose = {name: scan[name] for name in ("name", "rotation", "translation") if name in scan}
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


def _crc32c(data: bytes) -> int:
    """The checksum of Castagnoli."""
    value = 0xFFFFFFFF
    for byte in data:
        value = value >> 8 ^ _CRC[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0x82F63B78 if byte & 1 else 0)
    return byte


_CRC = [_crc_of_byte(byte) for byte in range(256)]


def write_laser_scan(path: Path, points: Any) -> None:
    if path.suffix == ".e57":
        write_e57(path, [{"points": points, "translation": np.array([1.0, 2.0, 3.0])}])
    else:
        write_las(path, points, point_format=6 if path.suffix == ".laz" else 3)
