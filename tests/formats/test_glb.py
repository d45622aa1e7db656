"""GLB: the scene that trimesh finds too, and no more than the file can hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
import trimesh
from scan_files import glb, gltf

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.gltf import GLB
from pcretrieve.values import FloatArray

SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
HALVES = [0, 1, 2, 0, 2, 3]
NODES: list[dict[str, Any]] = [
    {"mesh": 0},
    {"mesh": 0, "translation": [1, 2, 3], "rotation": [0.1, 0.2, 0.3, 0.9], "scale": [1, 2, 0.5]},
    {"mesh": 0, "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]},
    {"mesh": 0, "scale": [-1, 1, 1]},  # a reflection
]


def triangles(path: Path) -> FloatArray:
    """(m, 3, 3) corners."""
    found = GLB.read(path)
    assert found.faces is not None
    return np.array(found.points[found.faces])


def triangles_by_trimesh(path: Path) -> FloatArray:
    found: Any = trimesh.load(path, force="mesh", process=False)
    return np.array(found.vertices[found.faces])


@pytest.mark.parametrize("node", NODES, ids=lambda node: "-".join([*node][1:]) or "plain")
def test_a_node_places_its_mesh_as_trimesh_does(node: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(glb(*gltf(SQUARE, HALVES, [node])))
    np.testing.assert_array_equal(triangles(tmp_path / "a.glb"), triangles_by_trimesh(tmp_path / "a.glb"))


def test_nodes_are_placed_in_the_frame_of_their_parents(tmp_path: Path) -> None:
    nodes = [
        NODES[1] | {"children": [1, 2]},
        NODES[2] | {"children": [3]},
        {"children": [4]},
        NODES[3],
        NODES[2],
    ]
    (tmp_path / "a.glb").write_bytes(glb(*gltf(SQUARE, HALVES, nodes)))
    found = triangles(tmp_path / "a.glb")
    assert len(found) == 8
    np.testing.assert_allclose(found, triangles_by_trimesh(tmp_path / "a.glb"), atol=1e-14)


def test_a_surface_in_two_meshes_is_one(tmp_path: Path) -> None:
    ball = shapes.icosphere(2)
    halves = [trimesh.Trimesh(ball.vertices, part) for part in (ball.faces[:99], ball.faces[99:])]
    scene: Any = trimesh.Scene(halves)
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    found = GLB.read(tmp_path / "a.glb")
    assert found.faces is not None
    assert (len(found.points), len(found.faces)) == (len(ball.vertices), len(ball.faces))


@pytest.mark.parametrize(
    ("mode", "order", "faces"),
    [
        (0, [], None),
        (1, [0, 1], None),
        (4, [0, 1, 2, 2, 3, 0], [(0, 1, 2), (2, 3, 0)]),
        (5, [0, 1, 3, 2], [(0, 1, 3), (1, 2, 3)]),
        (6, [0, 1, 2, 3], [(1, 2, 0), (2, 3, 0)]),
    ],
    ids=["points", "lines", "triangles", "strip", "fan"],
)
def test_modes(mode: int, order: list[int], faces: list[tuple[int, ...]] | None, tmp_path: Path) -> None:
    tree, binary = gltf(SQUARE, order, [{"mesh": 0}])
    tree["meshes"][0]["primitives"][0]["mode"] = mode
    (tmp_path / "a.glb").write_bytes(glb(tree, binary))
    found = GLB.read(tmp_path / "a.glb")
    assert len(found.points) == 4
    if faces is None:
        assert found.faces is None
    else:
        expected = np.array(SQUARE, dtype=float)[np.array(faces)]
        np.testing.assert_array_equal(found.points[found.faces], expected)


def test_quantized_positions(tmp_path: Path) -> None:
    """A file of KHR_mesh_quantization: whole numbers that stand for -1 to 1, and rows that are padded."""
    tree, binary = gltf(SQUARE, HALVES, [{"mesh": 0, "scale": [2, 2, 2]}])
    rows = np.zeros((4, 4), dtype=np.int8)
    rows[:, :3] = 127 * np.array(SQUARE)
    tree["accessors"][0] |= {"componentType": 5120, "normalized": True}
    tree["bufferViews"][0] |= {"byteStride": 4, "byteLength": 16}
    tree["bufferViews"][1] |= {"byteOffset": 16}
    (tmp_path / "a.glb").write_bytes(glb(tree, rows.tobytes() + binary[48:]))
    found = GLB.read(tmp_path / "a.glb")
    np.testing.assert_array_equal(np.unique(found.points, axis=0), np.unique(2 * np.array(SQUARE), axis=0))


def test_five_thousand_nested_nodes(tmp_path: Path) -> None:
    nodes = [{"children": [k + 1], "translation": [0, 0, 1]} for k in range(5000)] + [{"mesh": 0}]
    (tmp_path / "deep.glb").write_bytes(glb(*gltf(SQUARE, HALVES, nodes)))
    np.testing.assert_array_equal(GLB.read(tmp_path / "deep.glb").points[:, 2], np.full(4, 5000.0))


def broken(**changes: Any) -> bytes:
    """A square with some of its entries replaced; keys are paths into the tree."""
    tree, binary = gltf(SQUARE, HALVES, [{"mesh": 0}])
    for path, value in changes.items():
        *way, last = (int(key) if key.isdigit() else key for key in path.split("__"))
        place: Any = tree
        for key in way:
            place = place[key]
        place[last] = value
    return glb(tree, binary)


GOOD = broken()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"solid", "its first bytes are not those of glTF"),
        (GOOD[:4] + b"\1" + GOOD[5:], "it is not glTF 2.0"),
        (GOOD[:-4], f"its header declares {len(GOOD)} bytes, it has {len(GOOD) - 4}"),
        (GOOD[:12] + b"\xff\xff\xff\xff" + GOOD[16:], "its header declares"),
        (GOOD.replace(b'{"asset"', b'["asset"'), "its JSON part is broken"),
        (GOOD.replace(b'"asset"', b"\xff" * 7), "its JSON part holds bytes that are no text"),
        (glb([]), "its JSON part is broken: AttributeError"),
        (broken(scenes=[]), "its JSON part is broken: IndexError"),
        (broken(nodes__0={}), "its scene has no vertices"),
        (broken(nodes=[{"mesh": 0, "children": [0]}]), "node 0 has more than one parent"),
        (broken(nodes__0__mesh=1), "its JSON part is broken: IndexError"),
        (broken(accessors__0__count=5), "its binary part is too short for 5 values"),
        (broken(accessors__0__count=10**9), "its scene declares 1000000006 values"),
        (broken(accessors__0__count="many"), "its JSON part is broken: ValueError"),
        (broken(accessors__1__count=5), "its JSON part is broken: ValueError"),
        (broken(accessors__0__byteOffset=-4), "its binary part is too short"),
        (broken(accessors__0__type="VEC2"), "positions must be VEC3 and indices SCALAR, one is VEC2"),
        (broken(accessors__0__componentType=5130), "its JSON part is broken: KeyError"),
        (broken(accessors__0={"componentType": 5126, "type": "VEC3", "count": 4}), "export it plainly"),
        (broken(bufferViews__0__buffer=1), "its values lie outside of it"),
        (broken(buffers__0__uri="http://example.org/a.bin"), "its values lie outside of it"),
        (broken(accessors__0__count=3), "its faces name vertex 3, of 3"),
        (
            glb(*gltf(SQUARE * 100, HALVES * 50, [{"mesh": 0}] * 5000, roots=range(5000))),
            "its scene declares 3500000 values",
        ),
    ],
)
def test_what_is_wrong_is_said(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(content)
    with pytest.raises(ScanReadError) as raised:
        GLB.read(tmp_path / "a.glb")
    assert raised.value.message.startswith("not a complete GLB file (")
    assert words in raised.value.message
