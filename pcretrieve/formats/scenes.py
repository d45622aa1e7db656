"""Scenes of several bodies: 3MF and COLLADA (``.dae``), which trimesh reads.

A mesh of a scene is a body, which the nodes of the scene place. Materials are not read.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import (
    Extra,
    Format,
    RawScan,
    distinct_names,
    joined,
    merged_vertices,
)
from pcretrieve.formats.meshes import damage
from pcretrieve.values import FloatArray, unit_of

# Names of units in 3MF files.
UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "in",
    "foot": "ft",
    "millimeters": "mm",
    "meters": "m",  # by trimesh, where a file names none
}

# Largest compression ratio of an archive of markup as a whole, and number of bytes to which any may expand.
# The ratio of meshes in XML is small, 7.3 of a grid of a million vertices with integer coordinates: an
# archive that expands to much more was made to fill the memory.
MARKUP_RATIO = 100
ANY_MARKUP = 10_000_000

# A mesh is repeated in a scene for each node that refers to it. The number of vertices and indices in the
# scene is limited to the number of bytes of the file, or to this number if the file is smaller.
MOST_OF_SMALL_FILE = 1_000_000


class Scene(NamedTuple):
    """The bodies of a file by name, in its unit; which are read when they are called.

    names: the names in the order of the file.
    is_surface: whether the bodies may be parts of one surface, whose vertices are one too.
    """

    bodies: Mapping[str, Callable[[], RawScan]]
    names: tuple[str, ...]
    is_surface: bool = False


def _read(read: Callable[[Path], Scene], path: Path, name: str | None = None) -> RawScan:
    """All bodies of a scene as one scan, or the body of a name."""
    with damage(path):
        bodies, _, is_surface = read(path)
        chosen = [body() for body in (bodies.values() if name is None else [bodies[name]])]
        if not any(len(body.points) for body in chosen):
            raise ScanReadError("its scene has no vertices")
        return _merged(joined(chosen)) if is_surface else joined([*map(_merged, chosen)])


def _names(read: Callable[[Path], Scene], path: Path) -> tuple[str, ...]:
    with damage(path):
        return read(path).names


def _merged(body: RawScan) -> RawScan:
    """A body without the duplicates of its vertices, which formats have for faces of different normals."""
    faces = np.empty((0, 3), dtype=np.int64) if body.faces is None else body.faces
    points, faces = merged_vertices(body.points, faces)
    return body._replace(points=points, faces=faces if len(faces) else None)


def check_size(n_values: int, n_bytes: int) -> None:
    """Check that a file of so many bytes may have so many values, before they are repeated in the scene."""
    if n_values > max(n_bytes, MOST_OF_SMALL_FILE):
        raise ScanReadError(f"its scene declares {n_values} values, it has {n_bytes} bytes")


def moved(mesh: RawScan, motion: FloatArray) -> RawScan:
    """A mesh that a (4, 4) motion places; a reflection reverses the orientation of its triangles."""
    import trimesh

    mirrored = mesh.faces is not None and np.linalg.det(motion[:3, :3]) < 0
    points = trimesh.transform_points(mesh.points, motion).reshape(-1, 3) if len(mesh.points) else mesh.points
    return RawScan(points, mesh.faces[:, ::-1] if mesh.faces is not None and mirrored else mesh.faces)


# --- 3MF and COLLADA --------------------------------------------------------------------------------------


def _markup(path: Path, file_type: str, n_bytes: int) -> tuple[list[tuple[str, RawScan]], str | None]:
    """The bodies in so many bytes of markup with their names, and the unit as trimesh names it."""
    import trimesh

    with path.open("rb") as file:
        scene: Any = trimesh.load_scene(file, file_type=file_type, process=False)
    placed = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
    meshes = [(str(node), motion, scene.geometry[name]) for node, motion, name in placed]
    meshes = [found for found in meshes if len(getattr(found[2], "faces", ()))]
    if not meshes:
        raise ScanReadError("it holds no triangles")
    check_size(sum(mesh.vertices.size + mesh.faces.size for _, _, mesh in meshes), n_bytes)
    bodies = []
    for name, motion, mesh in meshes:
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        body = RawScan(vertices, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3))
        bodies.append((name, moved(body, motion)))
    return bodies, meshes[-1][2].metadata.get("units")


def _scene(found: list[tuple[str, RawScan]], unit: str | None, scale: float = 1.0) -> Scene:
    names = distinct_names(name for name, _ in found)
    scans = [scan._replace(points=scale * scan.points, unit=unit) for _, scan in found]
    bodies = {name: partial(RawScan, *scan) for name, scan in zip(names, scans, strict=True)}
    return Scene(bodies, tuple(names))


def _three_mf(path: Path) -> Scene:
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    size, packed = sum(info.file_size for info in members), sum(info.compress_size for info in members)
    if size > max(ANY_MARKUP, MARKUP_RATIO * packed):
        raise ScanReadError(f"its members declare {size} bytes in {packed}")
    bodies, unit = _markup(path, "3mf", size)
    if unit is not None and unit not in UNITS:
        raise ScanReadError(f"its unit is {unit[:20]!r}")
    return _scene(bodies, None if unit is None else UNITS[unit])


def _collada(path: Path) -> Scene:
    bodies, said = _markup(path, "dae", path.stat().st_size)
    if said is None:
        return _scene(bodies, None)
    metres = 1.0 if said == "meters" else float(said.split()[0])
    if not (math.isfinite(metres) and metres > 0):
        raise ScanReadError(f"its unit is {metres:g} m")
    unit = unit_of(metres)
    return _scene(bodies, unit) if unit else _scene(bodies, "m", metres)


def scene_format(suffix: str, read: Callable[[Path], Scene], **options: Any) -> Format:
    """The format of a suffix whose files are scenes."""
    return Format((suffix,), partial(_read, read), names=partial(_names, read), **options)


THREE_MF = scene_format(".3mf", _three_mf, extra=Extra("meshes", ("lxml", "networkx")))
COLLADA = scene_format(".dae", _collada, extra=Extra("meshes", ("collada",)))
