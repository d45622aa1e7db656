"""Meshes: OBJ, by trimesh OFF and STL, and scenes of several bodies: by trimesh 3MF and COLLADA (``.dae``).

trimesh would duplicate the vertices of an OBJ file at the seams of textures, normals and materials, which
opens a closed surface. Its ``v`` and ``f`` lines are therefore read here. A mesh of a scene is a body, which
the nodes of the scene place. Materials are not read.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcretrieve.formats.format import Damaged, RawScan, distinct_names, fans, joined, text_lines
from pcretrieve.values import FloatArray, TriangleMesh, unit_of

# Largest vertex number of an OBJ file; more than any file has.
LARGEST_NUMBER = 2**40

# Names of units in 3MF files; the last is that of trimesh, where a file names none.
UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "in",
    "foot": "ft",
    "millimeters": "mm",
    "meters": "m",
}

# Largest compression ratio of an archive of markup as a whole, and number of bytes to which any may expand.
# The ratio of meshes in XML is small, 7.3 of a grid of a million vertices with integer coordinates: an
# archive that expands to much more was made to fill the memory.
MARKUP_RATIO = 100
ANY_MARKUP = 10_000_000

# A mesh is repeated in a scene for each node that refers to it. The number of vertices and indices in the
# scene is limited to the number of bytes of the file, or to this number if the file is smaller.
MOST_OF_SMALL_FILE = 1_000_000


def mesh_bytes(mesh: TriangleMesh, file_type: str) -> bytes:
    """The content of a mesh file, in the unit of the mesh."""
    data = mesh.to_trimesh().export(file_type=file_type)
    return data.encode() if isinstance(data, str) else bytes(data)


# --- one mesh ---------------------------------------------------------------------------------------------


def read_obj(path: Path) -> RawScan:
    """Read the vertices and the polygons of an OBJ file."""
    vertices: list[list[float]] = []
    polygons: dict[int, list[list[int]]] = {}  # by their number of corners
    for number, line in enumerate(text_lines(path), start=1):
        words = line.split("#")[0].split()
        try:
            if words[:1] == ["v"]:
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
            elif words[:1] == ["f"]:
                corners = [_vertex(word, len(vertices)) for word in words[1:]]
                polygons.setdefault(len(corners), []).append(corners)
        except ValueError as error:
            raise Damaged(f"line {number} is {line.strip()!r}") from error
    if not vertices:
        raise Damaged("it holds no vertices")
    faces = fans([np.array(alike) for alike in polygons.values()]) if polygons else None
    return RawScan(np.array(vertices), faces)


def _vertex(word: str, n_before: int) -> int:
    """Vertex number, from 0, of ``v``, ``v/t`` or ``v/t/n``: from 1 in the file, negative from the last."""
    number = int(word.split("/")[0])
    if not 0 < abs(number) <= LARGEST_NUMBER:
        raise ValueError(f"vertices are numbered from 1 to {LARGEST_NUMBER}")
    return number - 1 if number > 0 else n_before + number


def read_off(path: Path) -> RawScan:
    """Read an OFF file."""
    mesh = _by_trimesh(path, "off")
    if not len(mesh.points):
        raise Damaged("it holds no vertices")
    return mesh


def read_stl(path: Path) -> RawScan:
    """Read an STL file, and merge the vertices that its triangles share."""
    mesh = _by_trimesh(path, "stl")
    if mesh.faces is None:
        raise Damaged("it holds no triangles")
    return _merged(mesh)


def _by_trimesh(path: Path, file_type: str) -> RawScan:
    """The vertices and the triangles of a file, with nothing merged."""
    import trimesh

    # An open file, because trimesh takes names in UTF-8 only.
    with path.open("rb") as file:
        return _of_trimesh(trimesh.load(file, file_type=file_type, process=False, force="mesh"))


def _of_trimesh(mesh: Any) -> RawScan:
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    return RawScan(np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3), faces if len(faces) else None)


def _merged(mesh: RawScan) -> RawScan:
    """A mesh without the duplicates of its vertices, which are in lexicographic order."""
    faces = np.empty((0, 3), dtype=np.int64) if mesh.faces is None else mesh.faces
    n = len(mesh.points)
    if faces.size and not (faces.min() >= 0 and faces.max() < n):
        raise Damaged(f"faces must name vertices 0 to {n - 1}, got {faces.min()} to {faces.max()}")
    points, inverse = np.unique(mesh.points, axis=0, return_inverse=True)
    return mesh._replace(points=points, faces=inverse.reshape(-1)[faces] if len(faces) else None)


# --- scenes -----------------------------------------------------------------------------------------------


class Scene(NamedTuple):
    """The bodies of a file by name, in its unit; which are read when they are called.

    names: the names in the order of the file.
    is_surface: whether the bodies may be parts of one surface, whose vertices are one too.
    """

    bodies: Mapping[str, Callable[[], RawScan]]
    names: tuple[str, ...]
    is_surface: bool = False


def read_scene(read: Callable[[Path], Scene], path: Path, name: str | None = None) -> RawScan:
    """All bodies of a scene as one scan, or the body of a name."""
    bodies, _, is_surface = read(path)
    chosen = [body() for body in (bodies.values() if name is None else [bodies[name]])]
    if not any(len(body.points) for body in chosen):
        raise Damaged("its scene has no vertices")
    # Formats duplicate vertices of faces of different normals.
    return _merged(joined(chosen)) if is_surface else joined([*map(_merged, chosen)])


def names_in_scene(read: Callable[[Path], Scene], path: Path) -> tuple[str, ...]:
    """The names of the bodies."""
    return read(path).names


def check_size(n_values: int, n_bytes: int) -> None:
    """Check that a file of so many bytes may have so many values, before they are repeated in the scene."""
    if n_values > max(n_bytes, MOST_OF_SMALL_FILE):
        raise Damaged(f"its scene declares {n_values} values, it has {n_bytes} bytes")


def moved(mesh: RawScan, motion: FloatArray) -> RawScan:
    """A mesh that a (4, 4) motion places; a reflection reverses the orientation of its triangles."""
    import trimesh

    points, faces = mesh.points, mesh.faces
    if faces is not None and np.linalg.det(motion[:3, :3]) < 0:
        faces = faces[:, ::-1]
    return RawScan(trimesh.transform_points(points, motion).reshape(-1, 3) if len(points) else points, faces)


def three_mf_scene(path: Path) -> Scene:
    """The bodies of a 3MF file."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    size, packed = sum(info.file_size for info in members), sum(info.compress_size for info in members)
    if size > max(ANY_MARKUP, MARKUP_RATIO * packed):
        raise Damaged(f"its members declare {size} bytes in {packed}")
    bodies, unit = _markup(path, "3mf", size)
    if unit is not None and unit not in UNITS:
        raise Damaged(f"its unit is {unit[:20]!r}")
    return _scene(bodies, None if unit is None else UNITS[unit])


def collada_scene(path: Path) -> Scene:
    """The bodies of a COLLADA file."""
    bodies, said = _markup(path, "dae", path.stat().st_size)
    if said is None:
        return _scene(bodies, None)
    metres = 1.0 if said == "meters" else float(said.split()[0])
    if not (math.isfinite(metres) and metres > 0):
        raise Damaged(f"its unit is {metres:g} m")
    unit = unit_of(metres)
    return _scene(bodies, unit) if unit else _scene(bodies, "m", metres)


def _markup(path: Path, file_type: str, n_bytes: int) -> tuple[list[tuple[str, RawScan]], str | None]:
    """The bodies in so many bytes of markup with their names, and the unit as trimesh names it."""
    import trimesh

    with path.open("rb") as file:
        scene: Any = trimesh.load_scene(file, file_type=file_type, process=False)
    placed = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
    meshes = [(str(node), motion, scene.geometry[name]) for node, motion, name in placed]
    meshes = [found for found in meshes if len(getattr(found[2], "faces", ()))]
    if not meshes:
        raise Damaged("it holds no triangles")
    check_size(sum(mesh.vertices.size + mesh.faces.size for _, _, mesh in meshes), n_bytes)
    bodies = [(name, moved(_of_trimesh(mesh), motion)) for name, motion, mesh in meshes]
    return bodies, meshes[-1][2].metadata.get("units")


def _scene(found: list[tuple[str, RawScan]], unit: str | None, scale: float = 1.0) -> Scene:
    names = distinct_names(name for name, _ in found)
    scans = [scan._replace(points=scale * scan.points, unit=unit) for _, scan in found]
    return Scene({name: partial(RawScan, *scan) for name, scan in zip(names, scans, strict=True)}, (*names,))
