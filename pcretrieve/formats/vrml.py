"""The format VRML97 (``.wrl``): indexed faces and points of the scene, without materials."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import ScanReadError
from pcretrieve.formats.format import Format
from pcretrieve.formats.members import Members, distinct_names
from pcretrieve.formats.raw import RawScan, fans, incomplete, merged_vertices
from pcretrieve.formats.vrml_nodes import Node, parse_nodes

__all__ = ["VRML", "read_vrml"]

FIRST_LINE = "#VRML V2.0"
# Ends of the polygons in a list of vertex numbers.
END = -1
# Nodes are repeated in the scene for each reference to them. The number of visits, and that of the values in
# the scene, are limited to the number of bytes of the file, or to this number if the file is smaller.
MOST_OF_SMALL_FILE = 1_000_000


class Geometry(NamedTuple):
    """A node with coordinates, the name of its body, and the motion to the frame of the scene."""

    node: Node
    name: str
    motion: FloatArray  # (4, 4)


def read_vrml(path: Path, name: str | None = None) -> RawScan:
    """Read a VRML97 file."""
    found = _geometries(path)
    if name is not None:
        found = [found[_names_of(found).index(name)]]
    points: list[FloatArray] = []
    triangles: list[NDArray[np.int64]] = []
    n_points = 0
    try:
        for geometry in found:
            vertices, faces = _arrays(geometry)
            points.append(vertices)
            triangles.append(faces + n_points)
            n_points += len(vertices)
    except (ArithmeticError, AttributeError, IndexError, TypeError, ValueError) as error:
        raise incomplete(path, f"a field has a value of another type: {error}") from error
    merged, numbers = merged_vertices(np.concatenate(points), np.concatenate(triangles))
    return RawScan(merged, numbers if len(numbers) else None)


def _members(path: Path) -> tuple[str, ...]:
    return tuple(_names_of(_geometries(path)))


def _names_of(found: list[Geometry]) -> list[str]:
    return distinct_names(geometry.name for geometry in found)


def _geometries(path: Path) -> list[Geometry]:
    """The nodes with coordinates, whose sizes are checked before they are repeated."""
    # Names may be of any encoding, and numbers are the same in all of them.
    text = path.read_text(encoding="utf-8", errors="replace")
    if not text.startswith(FIRST_LINE):
        raise incomplete(path, f"it must begin with {FIRST_LINE}, got {text[:16]!r}: export it as VRML97")
    most = max(len(text), MOST_OF_SMALL_FILE)
    try:
        found = []
        n_values = 0
        for geometry in _visited(parse_nodes(text), most):
            inner = (geometry.node, *geometry.node.nodes())
            n_values += sum(np.size(value) for node in inner for value in node.fields.values())
            if n_values > most:
                raise ScanReadError(f"its scene repeats nodes to more than {most} values")
            found.append(geometry)
    except ScanReadError as error:
        raise incomplete(path, error.message) from error
    except (ArithmeticError, IndexError, TypeError, ValueError) as error:
        raise incomplete(path, f"a field has a value of another type: {error}") from error
    if not found:
        raise incomplete(path, "its scene has no coordinates")
    return found


def _visited(roots: list[Node], most: int) -> Iterator[Geometry]:
    """Yield the nodes with coordinates of the scene, in their order."""
    waiting = [(root, "", np.eye(4)) for root in reversed(roots)]
    n_visits = 0
    while waiting:
        node, name, motion = waiting.pop()
        n_visits += 1
        if n_visits > most:
            raise ScanReadError(f"its scene repeats nodes more than {most} times")
        name = node.name or name
        if node.kind in ("IndexedFaceSet", "PointSet"):
            yield Geometry(node, name, motion)
            continue
        if node.kind == "Transform":
            motion = motion @ _motion(node)
        inner = node.nodes()
        if node.kind == "LOD":
            inner = inner[:1]  # the finest of several levels
        elif node.kind == "Switch":
            choice = int(node.fields.get("whichChoice", [-1])[0])
            inner = inner[choice : choice + 1] if choice >= 0 else []
        waiting += [(child, name, motion) for child in reversed(inner)]


def _motion(node: Node) -> FloatArray:
    """The (4, 4) transform of a node Transform: T C R S' S S'⁻¹ C⁻¹."""
    translation, center = (_shift(node.fields.get(name, np.zeros(3))) for name in ("translation", "center"))
    rotation = _turn(node.fields.get("rotation", np.array([0, 0, 1.0, 0])))
    oriented = _turn(node.fields.get("scaleOrientation", np.array([0, 0, 1.0, 0])))
    scale = np.diag([*_three(node.fields.get("scale", np.ones(3))), 1.0])
    scaled = oriented @ scale @ oriented.T
    return np.asarray(translation @ center @ rotation @ scaled @ np.linalg.inv(center))


def _three(values: FloatArray) -> FloatArray:
    return np.asarray(values, dtype=np.float64).reshape(3)


def _shift(values: FloatArray) -> FloatArray:
    motion = np.eye(4)
    motion[:3, 3] = _three(values)
    return motion


def _turn(values: FloatArray) -> FloatArray:
    """The (4, 4) rotation about an axis by an angle, by the formula of Rodrigues."""
    x, y, z, angle = np.asarray(values, dtype=np.float64).reshape(4)
    motion = np.eye(4)
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0:
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / length
        motion[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return motion


def _arrays(geometry: Geometry) -> tuple[FloatArray, NDArray[np.int64]]:
    """The (n, 3) vertices of a node in the frame of the scene, and its (m, 3) triangles."""
    node, motion = geometry.node, geometry.motion
    coordinates = node.fields.get("coord")
    if not isinstance(coordinates, Node):
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    points = np.asarray(coordinates.fields.get("point", ()), dtype=np.float64).reshape(-1, 3)
    moved = points @ motion[:3, :3].T + motion[:3, 3]
    if node.kind == "PointSet":
        return moved, np.empty((0, 3), dtype=np.int64)
    numbers = np.asarray(node.fields.get("coordIndex", ()), dtype=np.float64).reshape(-1)
    if numbers.size and not (numbers.min() >= END and numbers.max() < len(points)):
        raise ValueError(f"vertices are numbered from 0 to {len(points) - 1}, got {numbers.max():g}")
    faces = fans(_polygons(numbers.astype(np.int64)))
    reversed_order = node.fields.get("ccw") == "FALSE"
    # A reflection reverses the orientation of triangles.
    if reversed_order != (np.linalg.det(motion[:3, :3]) < 0):
        faces = faces[:, ::-1]
    return moved, faces


def _polygons(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Polygons of the same number of corners as one array each, from vertex numbers that −1 ends."""
    if not len(numbers) or numbers[-1] != END:
        numbers = np.append(numbers, END)
    ends = np.flatnonzero(numbers == END)
    starts = np.concatenate([[0], ends[:-1] + 1])
    sizes = ends - starts
    return [
        numbers[starts[sizes == size][:, None] + np.arange(size)] for size in np.unique(sizes) if size >= 3
    ]


VRML = Format((".wrl", ".vrml"), read_vrml, members=Members(_members, read_vrml))
