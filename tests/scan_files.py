"""Valid and invalid scan files, for tests."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {n}\nHEIGHT 1\n"
    "VIEWPOINT {viewpoint}\nPOINTS {n}\nDATA {data}\n"
)


def pcd_header(*fields: str, n: int, data: str = "ascii", viewpoint: str = "0 0 0 1 0 0 0") -> str:
    repeat = {"sizes": "4", "types": "F", "counts": "1"}
    columns = {key: " ".join([value] * len(fields)) for key, value in repeat.items()}
    return PCD.format(fields=" ".join(fields), n=n, data=data, viewpoint=viewpoint, **columns)


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
