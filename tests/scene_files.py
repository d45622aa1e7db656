"""Files of several meshes, as text, for tests."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from scan_files import gltf

from pcretrieve import TriangleMesh

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


def three_mf(mesh: TriangleMesh, *, unit: str = "millimeter", items: str = '<item objectid="1"/>') -> bytes:
    """An archive with one object, which the items of the build place."""
    vertices = "".join('<vertex x="{:.9g}" y="{:.9g}" z="{:.9g}"/>'.format(*point) for point in mesh.vertices)
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in mesh.faces)
    body = (
        f'<object id="1" name="ball" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}'
    )
    model = (
        f'<model unit="{unit}" xmlns="{THREE_MF}"><resources>{body}</triangles></mesh></object></resources>'
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
