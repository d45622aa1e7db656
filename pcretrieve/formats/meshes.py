"""Meshes: OBJ, OFF and STL, and scenes of several bodies: by trimesh 3MF and COLLADA (``.dae``).

trimesh would duplicate the vertices of an OBJ file at the seams of textures, normals and materials, which
opens a closed surface, and takes one dialect of OFF and of STL only. All three are therefore read here. A
mesh of a scene is a body, which the nodes of the scene place. Materials are not read.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.formats.format import (
    Cut,
    Damaged,
    RawScan,
    distinct_names,
    fans,
    joined,
    numbers_in,
    text_lines,
)
from pcretrieve.values import FloatArray, TriangleMesh, unit_of
from pcretrieve.values.files import check_members, opened_archive

# Largest vertex number of an OBJ file; more than any file has.
LARGEST_NUMBER = 2**40

# The first word of an OFF file, which may be missing, or without a blank before the numbers of the second.
OFF = re.compile(r"(ST)?C?N?4?OFF", re.IGNORECASE)

# Bytes of a binary STL file before its triangles, the last four of which are their number; and a triangle.
STL_HEADER = 84
STL_RECORD = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")]
)
# A vertex of a text; the other words differ between programs, such as "end loop" and "end solid".
STL_VERTEX = re.compile(r"\bvertex((?:\s+[-+.\dni]\S*){3})", re.IGNORECASE)

# Names of units in 3MF files; the last is that of trimesh, where a file names none.
UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "in",
    "foot": "ft",
}
UNITS |= {"millimeters": "mm", "meters": "m"}

# Elements of 3MF and of COLLADA files: scenes, nodes, and what refers to a node or to a mesh.
SCENES = ("{*}build", "{*}visual_scene")
NODES = ("{*}object", "{*}node")
USES = (
    "{*}item",
    "{*}component",
    "{*}instance_node",
    "{*}instance_geometry",
    "{*}instance_controller",
)

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
    polygons = []
    before = ""
    for number, line in enumerate(text_lines(path), start=1):
        line = before + line.split("#")[0].strip()
        words, before = line.split(), ""
        if words[:1] not in (["v"], ["f"]):
            continue  # a name, which may end with a backslash
        if line.endswith("\\"):
            before = f"{line[:-1]} "
            continue
        try:
            if words[0] == "v":
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
            else:
                polygons.append([_vertex(word, len(vertices)) for word in words[1:]])
        except ValueError as error:
            raise Damaged(f"line {number} is {line!r}") from error
    return _of_polygons(vertices, polygons)


def _vertex(word: str, n_before: int) -> int:
    """Vertex number, from 0, of ``v``, ``v/t`` or ``v/t/n``: from 1 in the file, negative from the last."""
    number = int(word.split("/")[0])
    if not 0 < abs(number) <= LARGEST_NUMBER:
        raise ValueError(f"vertices are numbered from 1 to {LARGEST_NUMBER}")
    return number - 1 if number > 0 else n_before + number


def read_off(path: Path) -> RawScan:
    """Read the vertices and the polygons of an OFF file, behind which lines may have colours and normals."""
    lines = [text for line in text_lines(path) if (text := line.split("#")[0].strip())]
    lines[:1] = [OFF.sub("", lines[0])]
    rows = [words for line in lines if (words := line.split())]
    n_vertices, n_faces = map(int, rows[0][:2])
    corners, polygons = rows[1 : 1 + n_vertices], rows[1 + n_vertices :][:n_faces]
    if (
        min(n_vertices, n_faces) < 0
        or len(corners) + len(polygons) < n_vertices + n_faces
    ):
        raise Cut(
            f"it declares {n_vertices} vertices and {n_faces} faces, {len(rows) - 1} lines follow"
        )
    return _of_polygons(
        [[float(word) for word in row[:3]] for row in corners],
        [[int(word) for word in row[1 : 1 + int(row[0])]] for row in polygons],
    )


def _of_polygons(vertices: list[list[float]], polygons: list[list[int]]) -> RawScan:
    if not vertices:
        raise Damaged("it holds no vertices")
    alike: dict[int, list[list[int]]] = {}  # by their number of corners
    for corners in polygons:
        alike.setdefault(len(corners), []).append(corners)
    faces = fans([np.array(corners) for corners in alike.values()]) if polygons else None
    return RawScan(np.array(vertices), faces)


def read_stl(path: Path) -> RawScan:
    """Read an STL file, a text or records, with nothing merged."""
    data = path.read_bytes()
    # In a text, four signs stand there, which are a number of 150 million or more.
    n = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    if 0 < n * STL_RECORD.itemsize <= len(data) - STL_HEADER:
        corners = np.frombuffer(data, STL_RECORD, n, STL_HEADER)["corners"].ravel()
    else:
        found = STL_VERTEX.findall(data.decode("latin-1"))
        if not found:
            raise Cut(f"it holds no vertices, or {n} triangles in {len(data)} bytes")
        corners = numbers_in(" ".join(found), "vertices")
    if len(corners) % 9:
        raise Cut("it ends in the middle of a triangle")
    points = corners.reshape(-1, 3).astype(np.float64)
    return RawScan(points, np.arange(len(points)).reshape(-1, 3))


def _of_trimesh(mesh: Any) -> RawScan:
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    return RawScan(
        np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3),
        faces if len(faces) else None,
    )


def welded(
    points: NDArray[Any], faces: NDArray[np.integer]
) -> tuple[NDArray[Any], NDArray[np.integer]]:
    """Merge the vertices that coincide at the ends of open edges, which have one face.

    STL repeats the vertices of each triangle, other formats those at seams of normals and textures. Vertices
    that coincide without such an edge in common are of parts that touch, and stay apart.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(points)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1) @ (
        n,
        1,
    )  # (m, 3), one number for each edge
    edges, use = np.unique(sides, return_counts=True)
    ends = np.column_stack(np.divmod(edges[use == 1], n))  # (s, 2)
    if not len(ends):
        return points, faces
    order = np.lexsort(points.T)
    place = np.empty(n, dtype=np.int64)
    place[order] = (
        np.cumsum(np.diff(points[order], axis=0, prepend=np.nan).any(axis=1)) - 1
    )
    at = place[ends]  # (s, 2)
    _, edge = np.unique(np.sort(at, axis=1) @ (n, 1), return_inverse=True)  # (s,)
    # A graph of the vertices, and of the two ends of each edge in space, which are theirs.
    end = n + 2 * edge[:, None] + (at == at.max(axis=1, keepdims=True))  # (s, 2)
    pairs, size = (ends.ravel(), end.ravel()), int(end.max()) + 1
    graph = coo_array((np.ones(ends.size, np.int8), pairs), shape=(size, size))
    merged = connected_components(graph, directed=False)[1][
        :n
    ]  # (n,), numbered in the order of the file
    first = np.flatnonzero(np.diff(np.maximum.accumulate(merged), prepend=-1))
    return points[first], merged[faces]


# --- scenes -----------------------------------------------------------------------------------------------


#: The bodies of a file by name, in their order and in the unit of the file; each is read when it is called.
Scene: TypeAlias = dict[str, Callable[[], RawScan]]


def read_scene(
    read: Callable[[Path], Scene], path: Path, name: str | None = None
) -> RawScan:
    """All bodies of a scene as one scan, or the body of a name with all its pieces."""
    bodies = read(path)
    chosen = [*bodies]
    if name is not None:
        chosen = next(pieces for pieces in scene_bodies(read, path) if pieces[0] == name)
    scans = [bodies[piece]() for piece in chosen]
    if not any(len(scan.points) for scan in scans):
        raise Damaged("its scene has no vertices")
    return joined(scans)


def scene_bodies(read: Callable[[Path], Scene], path: Path) -> list[list[str]]:
    """The names of the pieces of each body in a scene."""
    status = path.stat()
    return _pieces(read, path, status.st_mtime_ns, status.st_size)


# A worker that reads one body after the other of a file finds their pieces once.
@lru_cache(maxsize=1)
def _pieces(
    read: Callable[[Path], Scene], path: Path, changed: int, n_bytes: int
) -> list[list[str]]:
    """The names of the meshes in a scene, together if their open edges coincide.

    Photogrammetry writes a mesh for each image of the texture of one body.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    bodies = read(path)
    scans = [body() for body in bodies.values()]
    whole = joined(scans) if len(scans) > 1 else None
    if whole is None or whole.faces is None:
        return [[name] for name in bodies]
    counts = [0 if scan.faces is None else len(scan.faces) for scan in scans]
    _, faces = welded(whole.points, whole.faces)
    mesh = np.repeat(np.arange(len(scans)), counts)  # (m,), of each face
    pairs = np.repeat(mesh, 3), len(scans) + faces.ravel()
    size = len(scans) + len(whole.points)
    graph = coo_array((np.ones(faces.size, np.int8), pairs), shape=(size, size))
    _, body = connected_components(graph, directed=False)
    return [
        [name for name, one in zip(bodies, body, strict=False) if one == number]
        for number in dict.fromkeys(body[: len(scans)].tolist())
    ]


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
    return RawScan(
        trimesh.transform_points(points, motion).reshape(-1, 3)
        if len(points)
        else points,
        faces,
    )


def three_mf_scene(path: Path) -> Scene:
    """The bodies of a 3MF file."""
    with opened_archive(path) as archive:
        members = archive.infolist()
        size = sum(info.file_size for info in members)
        for info in members:
            if "3d/3dmodel.model" in info.filename.lower():
                with archive.open(info) as file:
                    _check_instances(file)
    bodies, unit = _markup(path, "3mf", size)
    if unit is not None and unit not in UNITS:
        raise Damaged(f"its unit is {unit[:20]!r}")
    return _scene(bodies, None if unit is None else UNITS[unit])


def collada_scene(path: Path) -> Scene:
    """The bodies of a COLLADA file."""
    _check_instances(
        io.BytesIO(path.read_bytes())
    )  # lxml refuses names of files that are not UTF-8
    bodies, said = _markup(path, "dae", path.stat().st_size)
    if said is None:
        return _scene(bodies, None)
    metres = 1.0 if said == "meters" else float(said.split()[0])
    if not (math.isfinite(metres) and metres > 0):
        raise Damaged(f"its unit is {metres:g} m")
    unit = unit_of(metres)
    return _scene(bodies, unit) if unit else _scene(bodies, "m", metres)


def _check_instances(file: IO[bytes]) -> None:
    """Check how many bodies markup has, of which trimesh makes one for each way from its scene to a mesh."""
    from lxml import etree  # type: ignore[import-untyped,unused-ignore]

    uses: dict[
        str, list[str]
    ] = {}  # of other nodes and of meshes, by the name of a node; "": by the scene
    for _, node in etree.iterparse(
        file, tag=SCENES + NODES, resolve_entities=False, huge_tree=True
    ):
        named = [
            one.get("objectid") or one.get("url", "")[1:] for one in node.iter(*USES)
        ]
        is_scene = node.tag.endswith(("build", "visual_scene"))
        uses.setdefault("" if is_scene else node.get("id"), []).extend(named)

    @cache
    def count(name: str) -> int:
        return sum(map(count, uses.get(name, ()))) or 1

    check_members(count(""))


def _markup(
    path: Path, file_type: str, n_bytes: int
) -> tuple[list[tuple[str, RawScan]], str | None]:
    """The bodies in so many bytes of markup with their names, and the unit as trimesh names it."""
    import trimesh

    with path.open("rb") as file:
        scene: Any = trimesh.load_scene(file, file_type=file_type, process=False)
    placed = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
    meshes = [(str(node), motion, scene.geometry[name]) for node, motion, name in placed]
    meshes = [found for found in meshes if len(getattr(found[2], "faces", ()))]
    if not meshes:
        raise Damaged("it holds no triangles")
    check_size(
        sum(mesh.vertices.size + mesh.faces.size for _, _, mesh in meshes), n_bytes
    )
    if (
        file_type == "dae"
    ):  # in which trimesh merges all that coincides, of parts that touch too
        for *_, mesh in meshes:
            mesh.unmerge_vertices()
    bodies = [(name, moved(_of_trimesh(mesh), motion)) for name, motion, mesh in meshes]
    return bodies, meshes[-1][2].metadata.get("units")


def _scene(
    found: list[tuple[str, RawScan]], unit: str | None, scale: float = 1.0
) -> Scene:
    names = distinct_names(name for name, _ in found)
    scans = [scan._replace(points=scale * scan.points, unit=unit) for _, scan in found]
    return {
        name: partial(RawScan, *scan) for name, scan in zip(names, scans, strict=True)
    }
