"""Meshes: OBJ, OFF and STL, and scenes of several bodies: 3MF, and by trimesh COLLADA (``.dae``).

trimesh would duplicate the vertices of an OBJ file at the seams of textures, normals and materials, which
opens a closed surface, and takes one dialect of OFF and of STL only. All three are therefore read here. A
mesh of a scene is a body, which the nodes of the scene place. Materials are not read.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Callable
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from pcretrieve.formats.format import (
    Cut,
    Damaged,
    RawScan,
    distinct_names,
    joined,
    numbers_in,
    text_lines,
)
from pcretrieve.values import FloatArray, TriangleMesh, polygon_triangles, unit_of, welded
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

# Names of units in 3MF files.
UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "in",
    "foot": "ft",
}

# Types of objects in 3MF files that are bodies. Others are supports, and what must not be printed.
BODIES = ("model", "surface")
# The relationship of a 3MF file, to the model that it starts with.
START = "{*}Relationship[@Type='http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel']"
# The motion of a 3MF file that leaves a body in its place, by rows.
UNMOVED = "1 0 0 0 1 0 0 0 1 0 0 0"
# Elements of COLLADA files: the scene, its nodes, and what refers to a node or to a mesh.
NODES = ("{*}visual_scene", "{*}node")
USES = ("{*}instance_node", "{*}instance_geometry", "{*}instance_controller")

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
    faces = (
        polygon_triangles([np.array(corners) for corners in alike.values()])
        if polygons
        else None
    )
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


# --- scenes -----------------------------------------------------------------------------------------------


#: The bodies of a file by name, in their order and in the unit of the file; each is read when it is called.
Scene: TypeAlias = dict[str, Callable[[], RawScan]]
#: The name of a mesh, its arrays, and the (4, 4) motion to its place.
Placed: TypeAlias = tuple[str, RawScan, FloatArray]


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
    faces = mesh.faces
    if faces is not None and np.linalg.det(motion[:3, :3]) < 0:
        faces = faces[:, ::-1]
    return RawScan(mesh.points @ motion[:3, :3].T + motion[:3, 3], faces)


def three_mf_scene(path: Path) -> Scene:
    """The bodies of a 3MF file: the objects of its models, as items and components place them.

    trimesh would read all objects of a second model, as slicers write one for the parts of a body, as one.
    """
    from lxml import etree  # type: ignore[import-untyped,unused-ignore]

    # By the name of their model, and their id in it.
    objects: dict[tuple[str, str], Any] = {}
    items: list[tuple[str, Any]] = []
    starts = set()
    with opened_archive(path) as archive:
        members = archive.infolist()
        for info in members:
            model = info.filename.lower()
            if not model.endswith((".model", "_rels/.rels")):
                continue
            with archive.open(info) as file:
                parser = etree.XMLParser(resolve_entities=False, huge_tree=True)
                root = etree.parse(file, parser).getroot()
            starts |= {_model(one.get("Target")) for one in root.iterfind(START)}
            objects |= {(model, one.get("id")): one for one in root.iter("{*}object")}
            items += [(model, one) for one in root.iter("{*}item")]
    # The builds of other models do not count, if the file says which one it starts with.
    items = [one for one in items if one[0] in starts] or items
    mesh_of = cache(lambda key: _mesh(objects[key]))
    placed: list[Placed] = []

    def place(use: Any, model: str, motion: FloatArray, above: str) -> None:
        check_members(len(placed))
        (other,) = use.xpath("@*[local-name()='path']") or [model]
        key = _model(other), use.get("objectid")
        if objects[key].get("type", "model") not in BODIES:
            return
        own = np.eye(4)
        own[:3] = numbers_in(use.get("transform", UNMOVED), "motions").reshape(4, 3).T
        motion = motion @ own
        name = objects[key].get("name") or above or key[1]
        placed.append((name, mesh_of(key), motion))
        for component in objects[key].iter("{*}component"):
            place(component, key[0], motion, name)

    unit = "millimeter"
    for model, item in items:
        place(item, model, np.eye(4), "")
        unit = item.getroottree().getroot().get("unit", unit)
    if unit not in UNITS:
        raise Damaged(f"its unit is {unit[:20]!r}")
    return _scene(_bodies(placed, sum(info.file_size for info in members)), UNITS[unit])


def _model(path: str) -> str:
    """The name of a model in the archive, by its path in another file."""
    return path.strip("/").lower()


def _mesh(node: Any) -> RawScan:
    """The mesh of an object of a 3MF file."""

    def table(tag: str, *names: str) -> FloatArray:
        rows = [" ".join([one.get(name, "") for name in names]) for one in node.iter(tag)]
        return numbers_in(" ".join(rows), "vertices and triangles").reshape(-1, 3)

    faces = table("{*}triangle", "v1", "v2", "v3")
    return RawScan(table("{*}vertex", *"xyz"), faces.astype(np.int64))


def collada_scene(path: Path) -> Scene:
    """The bodies of a COLLADA file."""
    import trimesh

    _check_instances(path)
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of dates whose time zone has an unknown name
        scene: Any = trimesh.load_scene(file, file_type="dae", process=False)
    placed: list[Placed] = []
    said = None
    for node in scene.graph.nodes_geometry:
        motion, name = scene.graph[node]
        mesh = scene.geometry[name]
        if len(getattr(mesh, "faces", ())):
            mesh.unmerge_vertices()  # trimesh merges what coincides, of parts that touch too
            placed.append(
                (str(node), RawScan(mesh.vertices, np.asarray(mesh.faces)), motion)
            )
            said = mesh.metadata.get("units")
    bodies = _bodies(placed, path.stat().st_size)
    if said is None:
        return _scene(bodies, None)
    metres = 1.0 if said == "meters" else float(said.split()[0])
    if not (math.isfinite(metres) and metres > 0):
        raise Damaged(f"its unit is {metres:g} m")
    unit = unit_of(metres)
    return _scene(bodies, unit) if unit else _scene(bodies, "m", metres)


def _check_instances(path: Path) -> None:
    """Check how many bodies a file has, of which trimesh makes one for each way from its scene to a mesh."""
    from lxml import etree

    # Of nodes and meshes, by the id of a node; "": by the scene.
    uses: dict[str, list[str]] = {}
    # As bytes, because lxml refuses names of files that are not UTF-8.
    for _, node in etree.iterparse(
        io.BytesIO(path.read_bytes()), tag=NODES, resolve_entities=False, huge_tree=True
    ):
        named = [one.get("url", "")[1:] for one in node.iter(*USES)]
        is_scene = node.tag.endswith("visual_scene")
        uses.setdefault("" if is_scene else node.get("id"), []).extend(named)

    @cache
    def n_below(name: str) -> int:
        return sum(map(n_below, uses.get(name, ()))) or 1

    check_members(n_below(""))


def _bodies(placed: list[Placed], n_bytes: int) -> list[tuple[str, RawScan]]:
    """The meshes in so many bytes of markup, in their places."""
    meshes = [found for found in placed if np.asarray(found[1].faces).size]
    if not meshes:
        raise Damaged("it holds no triangles")
    arrays = [each for _, mesh, _ in meshes for each in (mesh.points, mesh.faces)]
    check_size(sum(np.asarray(each).size for each in arrays), n_bytes)
    return [(name, moved(mesh, motion)) for name, mesh, motion in meshes]


def _scene(
    found: list[tuple[str, RawScan]], unit: str | None, scale: float = 1.0
) -> Scene:
    names = distinct_names(name for name, _ in found)
    scans = [scan._replace(points=scale * scan.points, unit=unit) for _, scan in found]
    return {
        name: partial(RawScan, *scan) for name, scan in zip(names, scans, strict=True)
    }
