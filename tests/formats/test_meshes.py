"""Meshes and scenes: polygons, the bodies in a file, where they stand, and their unit."""

from __future__ import annotations

import re
import warnings
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
import trimesh
from scan_files import (
    CUBE,
    HALVES,
    SIDES,
    SQUARE,
    THREE_MF,
    collada,
    glb,
    gltf,
    mesh,
    needs,
    three_mf,
    write_gltf,
)

from pcretrieve import TriangleMesh, read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import ScanPath, members_of, parts_of
from pcretrieve.formats.identity import content_hash
from pcretrieve.formats.registry import read_raw
from pcretrieve.ingestion.discover import discover, shape_ids
from pcretrieve.ingestion.views import read_views
from pcretrieve.values import METRES
from pcretrieve.values.topology import defects

BALL = shapes.icosphere(1)
PAIR: list[dict[str, Any]] = [
    {"mesh": 0, "name": "left"},
    {"mesh": 0, "translation": [5, 0, 0]},
]
NODES: list[dict[str, Any]] = [
    {"mesh": 0},
    {
        "mesh": 0,
        "translation": [1, 2, 3],
        "rotation": [0.1, 0.2, 0.3, 0.9],
        "scale": [1, 2, 0.5],
    },
    {"mesh": 0, "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]},
    {"mesh": 0, "scale": [-1, 1, 1]},  # a reflection
]


def is_cube(found: TriangleMesh) -> bool:
    return (
        not defects(found)
        and found.area == pytest.approx(6)
        and found.volume == pytest.approx(1)
    )


# --- one mesh ---------------------------------------------------------------------------------------------


def obj_lines(separator: str = "") -> str:
    """The cube as OBJ; each corner of each side with a texture or a normal of its own, where asked for."""
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in CUBE]
    lines += ["vt 0.5 0.5", "vn 0 0 1"] * 24
    for k, side in enumerate(SIDES):
        own = [
            f"{separator}{4 * k + corner + 1}" if separator else "" for corner in range(4)
        ]
        lines += [
            f"usemtl paint{k}",
            "f " + " ".join(f"{v + 1}{o}" for v, o in zip(side, own, strict=True)),
        ]
    return "\n".join(lines)


def test_polygons_of_obj_and_off(tmp_path: Path) -> None:
    """Seams of textures and of materials do not open an OBJ; its numbers may count backwards."""
    backwards = [f"v {x:g} {y:g} {z:g} 1.0" for x, y, z in CUBE]
    backwards += [
        "f " + " ".join(str(v - 8) for v in side) + "  # a side" for side in SIDES
    ]
    off = ["OFF # a cube", "8 6 0", *(" ".join(map(str, point)) for point in CUBE)]
    off += [" ".join(map(str, (4, *side))) for side in SIDES]
    texts = {
        f"{k}.obj": obj_lines(separator) for k, separator in enumerate(("", "/", "//"))
    }
    texts |= {"cube.OBJ": "\n".join(backwards), "cube.off": "\n".join(off)}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        assert len(mesh(tmp_path / name).vertices) == 8, name
        assert is_cube(mesh(tmp_path / name)), name
    (tmp_path / "points.obj").write_text("\n".join(f"v {x} {y} {z}" for x, y, z in CUBE))
    np.testing.assert_array_equal(
        read_raw(ScanPath.parse(tmp_path / "points.obj")).points, CUBE
    )


def test_a_vertex_that_is_nan_takes_its_faces_with_it(tmp_path: Path) -> None:
    ball = shapes.icosphere(2)
    lines = [f"v {x} {y} {z}" for x, y, z in ball.vertices]
    lines[7] = "v 0 nan 0"
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in ball.faces]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    found = mesh(tmp_path / "ball.obj")
    n_around = int((ball.faces == 7).any(axis=1).sum())
    assert len(found.vertices) == len(ball.vertices) - 1
    assert len(found.faces) == len(ball.faces) - n_around
    assert defects(found).boundary_edges == n_around


def test_vertices_are_merged_at_open_edges_only(tmp_path: Path) -> None:
    """Two cubes that touch in a corner remain two, with or without vertices in common among their faces."""
    faces = np.array([(*side[:1], *side[k : k + 2]) for side in SIDES for k in (1, 2)])
    corners, faces = (
        np.concatenate([CUBE, -CUBE]),
        np.concatenate([faces, faces[:, ::-1] + 8]),
    )
    for points, numbers in (
        (corners, faces),
        (corners[faces].reshape(-1, 3), np.arange(72).reshape(-1, 3)),
    ):
        lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in points]
        (tmp_path / "a.obj").write_text(
            "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in numbers + 1)])
        )
        found = mesh(tmp_path / "a.obj")
        np.testing.assert_array_equal(found.vertices[found.faces], corners[faces])
        assert len(found.vertices) == 16 and str(defects(found)) == "2 components"


# --- several meshes ---------------------------------------------------------------------------------------


def write_all(folder: Path) -> None:
    """The ball beside itself, five units apart, in each format."""
    write_gltf(folder / "a.gltf", BALL, PAIR, "a.bin")
    write_gltf(folder / "data.gltf", BALL, PAIR)
    items = '<item objectid="1"/><item objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"/>'
    (folder / "a.3mf").write_bytes(three_mf(BALL, unit="meter", items=items))


@pytest.mark.parametrize(
    "name", ["a.gltf", "data.gltf", pytest.param("a.3mf", marks=needs(".3mf"))]
)
def test_a_scene_is_one_mesh_or_several(name: str, tmp_path: Path) -> None:
    write_all(tmp_path)
    both = mesh(tmp_path / name)
    assert defects(both).components == 2
    assert not defects(both).boundary_edges
    assert both.volume == pytest.approx(2 * BALL.volume, rel=1e-5)
    members = members_of(tmp_path / name)
    for member, x in zip(members, (0, 5), strict=True):
        body = mesh(Path(str(member)))
        np.testing.assert_allclose(body.vertices.mean(axis=0), [x, 0, 0], atol=1e-5)
        assert not defects(body)
    assert discover([tmp_path / name]) == [*members] == discover([*map(str, members)])
    assert [member.file for member in members] == 2 * [tmp_path / name]
    ids = list(shape_ids({str(member): member for member in members}, {}).values())
    assert ids == [f"{Path(name).stem}#{member.member}" for member in members]
    whole = members[0].whole
    assert len({content_hash(scan) for scan in (*members, whole)}) == 3
    np.testing.assert_array_equal(
        read_views([tmp_path / name]).poses, [np.eye(4), np.eye(4)]
    )


def test_names_in_a_file(tmp_path: Path) -> None:
    names = ["a/b", "", "same", "same", " c#d ", "\x07"]
    write_gltf(tmp_path / "a.gltf", BALL, [{"mesh": 0, "name": name} for name in names])
    found = [path.name for path in members_of(tmp_path / "a.gltf")]
    assert found == [
        f"a.gltf#{name}" for name in ("a_b", "2", "same", "same-2", "c_d", "6")
    ]
    with pytest.raises(
        ScanReadError,
        match="the file must hold a scan 'x', got a_b, 2, same, same-2, c_d",
    ):
        read_scan(tmp_path / "a.gltf#x")
    with pytest.raises(ScanReadError, match=r"cannot read .*gone\.gltf: No such file"):
        read_scan(tmp_path / "gone.gltf#x")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("x/a.glb#left", ScanPath(Path("x/a.glb"), "left")),
        ("x/a.glb#b.glb#c", ScanPath(Path("x/a.glb"), "b.glb#c")),
        ("x/a.glb#", ScanPath(Path("x/a.glb#"))),
        ("x/scan#1.xyz", ScanPath(Path("x/scan#1.xyz"))),
        # As Emacs names its copies and locks.
        ("x/#a.glb#", ScanPath(Path("x/#a.glb#"))),
        ("x/.#a.glb", ScanPath(Path("x/.#a.glb"))),
        ("x#1.glb/a.ply", ScanPath(Path("x#1.glb/a.ply"))),
        ("s3://b/a.glb#1", ScanPath(Path("s3:/b/a.glb"), "1", "s3://b/a.glb")),
        ("https://h/a.ply", ScanPath(Path("https:/h/a.ply"), None, "https://h/a.ply")),
    ],
)
def test_a_place_is_taken_apart_once(text: str, place: ScanPath) -> None:
    found = ScanPath.parse(text)
    assert found == place == ScanPath.parse(Path(text))
    assert (str(found), found.name) == (text, Path(text).name)
    assert ScanPath.parse(found) is found


def test_a_file_of_one_body_has_no_names_and_a_hash_in_its_name_is_no_mark(
    tmp_path: Path,
) -> None:
    write_gltf(tmp_path / "a.gltf", BALL, PAIR[:1])
    (tmp_path / "scan#1.xyz").write_text("1 2 3\n" * 5)
    assert members_of(tmp_path / "a.gltf") == members_of(tmp_path / "a.xyz") == ()
    found = [scan.file for scan in discover([tmp_path])]
    assert found == [tmp_path / "a.gltf", tmp_path / "scan#1.xyz"]
    assert len(read_raw(ScanPath.parse(tmp_path / "scan#1.xyz")).points) == 5


def test_nodes_place_their_meshes_as_trimesh_does(tmp_path: Path) -> None:
    nested = [
        *(
            NODES[1] | {"children": [2, 1]},
            NODES[2] | {"children": [3]},
            {"children": [4]},
        ),
        *(NODES[3], NODES[2]),
    ]
    for nodes in (*([node] for node in NODES), nested):
        (tmp_path / "a.glb").write_bytes(glb(*gltf(SQUARE, HALVES, nodes)))
        found = read_raw(ScanPath.parse(tmp_path / "a.glb"))
        assert found.faces is not None
        by_trimesh: Any = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
        expected = by_trimesh.vertices[by_trimesh.faces]
        np.testing.assert_allclose(
            found.points[found.faces], expected, rtol=0, atol=1e-14
        )
    deep = [{"children": [k + 1], "translation": [0, 0, 1]} for k in range(5000)] + [
        {"mesh": 0}
    ]
    (tmp_path / "deep.glb").write_bytes(glb(*gltf(SQUARE, HALVES, deep)))
    np.testing.assert_array_equal(
        read_raw(ScanPath.parse(tmp_path / "deep.glb")).points[:, 2], np.full(4, 5000.0)
    )


@pytest.mark.parametrize(
    "suffix",
    [".glb", ".gltf", *(pytest.param(one, marks=needs(one)) for one in (".3mf", ".dae"))],
)
def test_meshes_whose_open_edges_coincide_are_one_body(
    suffix: str, tmp_path: Path
) -> None:
    """As of photogrammetry, which writes a mesh for each image of a texture; other bodies stay their own."""
    path = tmp_path / f"a{suffix}"

    def write(*meshes: trimesh.Trimesh) -> None:
        if suffix == ".dae":
            own = (TriangleMesh(each.vertices, each.faces) for each in meshes)
            path.write_text(collada(*own))
            return
        scene: Any = trimesh.Scene()
        for number, each in enumerate(meshes):
            scene.add_geometry(
                each, node_name=f"texture_{number}", geom_name=f"texture_{number}"
            )
        content = scene.export(file_type=suffix[1:])
        for name, data in (
            content.items() if isinstance(content, dict) else [(path.name, content)]
        ):
            (tmp_path / name.replace("model.gltf", path.name)).write_bytes(data)

    pieces = [trimesh.Trimesh(BALL.vertices, BALL.faces[k::3]) for k in range(3)]
    others = [
        trimesh.Trimesh(BALL.vertices + np.array([shift, 0, 0]), BALL.faces)
        for shift in (5, 7)
    ]
    write(*pieces)
    assert not defects(mesh(path))
    assert members_of(path) == ()
    write(pieces[0], others[0], pieces[1], others[1], pieces[2])
    first, second, third = members_of(path)
    assert {found.name for found in (first, second, third)} == {
        f"{path.name}#texture_{number}" for number in (0, 1, 3)
    }
    for member in (first, second, third):
        body = mesh(Path(str(member)))
        assert not defects(body)
        assert len(body.faces) == len(BALL.faces)
    # Two halves that are not of one body: their open edges lie elsewhere.
    write(
        pieces[0],
        trimesh.Trimesh(BALL.vertices + np.array([0.1, 0, 0]), BALL.faces[1::3]),
    )
    assert len(members_of(path)) == 2


def test_modes(tmp_path: Path) -> None:
    cases: list[tuple[int, list[int], list[tuple[int, ...]] | None]] = [
        (0, [], None),
        (1, [0, 1], None),
        (4, [0, 1, 2, 2, 3, 0], [(0, 1, 2), (2, 3, 0)]),
        (5, [0, 1, 3, 2], [(0, 1, 3), (1, 2, 3)]),
        (6, [0, 1, 2, 3], [(0, 1, 2), (0, 2, 3)]),
    ]
    for mode, order, faces in cases:
        tree, binary = gltf(SQUARE, order, [{"mesh": 0}])
        tree["meshes"][0]["primitives"][0]["mode"] = mode
        (tmp_path / "a.glb").write_bytes(glb(tree, binary))
        found = read_raw(ScanPath.parse(tmp_path / "a.glb"))
        assert len(found.points) == 4
        assert (found.faces is None) == (faces is None)
        if faces is not None:
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
    found = read_raw(ScanPath.parse(tmp_path / "a.glb"))
    np.testing.assert_array_equal(
        np.unique(found.points, axis=0), np.unique(2 * np.array(SQUARE), axis=0)
    )


def test_the_file_of_a_buffer_belongs_to_the_scan_if_it_lies_below(
    tmp_path: Path,
) -> None:
    write_gltf(tmp_path / "a.gltf", BALL, PAIR[:1], "with%20blank.bin")
    (tmp_path / "with%20blank.bin").rename(tmp_path / "with blank.bin")
    assert [part.path for part in parts_of(tmp_path / "a.gltf")] == [
        tmp_path / "with blank.bin"
    ]
    assert mesh(tmp_path / "a.gltf").volume == pytest.approx(BALL.volume, rel=1e-5)
    before = content_hash(ScanPath.parse(tmp_path / "a.gltf"))
    (tmp_path / "with blank.bin").write_bytes(
        (tmp_path / "with blank.bin").read_bytes() + b"\0"
    )
    assert content_hash(ScanPath.parse(tmp_path / "a.gltf")) != before
    write_gltf(tmp_path / "b.gltf", BALL, PAIR, "a.bin")
    text = (tmp_path / "b.gltf").read_text()
    (tmp_path / "short.bin").write_bytes(b"\0")
    for buffer, words in (
        (
            "/etc/passwd",
            "its buffers must be files below its own folder, got '/etc/passwd'",
        ),
        ("../a.bin", "its buffers must be files below its own folder"),
        ("https://example.org/a.bin", "its buffers must be files below its own folder"),
        ("//[", r"not a valid GLTF file \(Invalid IPv6 URL\)"),
        ("gone.bin", r"its buffer gone\.bin: No such file or directory"),
        ("short.bin", "its binary part is too short for"),
    ):
        (tmp_path / "b.gltf").write_text(text.replace("a.bin", buffer))
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / "b.gltf")


# --- 3MF and COLLADA --------------------------------------------------------------------------------------


@needs(".3mf")
def test_a_3mf_file_names_its_unit(tmp_path: Path) -> None:
    for named, unit in (
        ("millimeter", "mm"),
        ("micron", "um"),
        ("inch", "in"),
        ("meter", "m"),
        ("foot", "ft"),
    ):
        (tmp_path / "a.3mf").write_bytes(three_mf(BALL, unit=named))
        assert read_raw(ScanPath.parse(tmp_path / "a.3mf")).unit == unit
        assert mesh(tmp_path / "a.3mf").volume == pytest.approx(
            METRES[unit] ** 3 * BALL.volume, rel=1e-5
        )
        assert mesh(tmp_path / "a.3mf").provenance[0].sizes["metres_per_unit"] == 1
    (tmp_path / "b.3mf").write_bytes(three_mf(BALL, unit="parsec"))
    with pytest.raises(ScanReadError, match="its unit is 'parsec'"):
        read_scan(tmp_path / "b.3mf")


PRODUCTION = (
    f'xmlns="{THREE_MF}" requiredextensions="p" '
    'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"'
)


def three_mf_object(number: int, shift: float, name: str = "") -> str:
    rows = "".join(
        f'<vertex x="{x + shift:.9g}" y="{y:.9g}" z="{z:.9g}"/>'
        for x, y, z in BALL.vertices
    )
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in BALL.faces)
    return (
        f'<object id="{number}" name="{name}"><mesh><vertices>{rows}</vertices>'
        f"<triangles>{faces}</triangles></mesh></object>"
    )


def components(number: int, *uses: str, name: str = "") -> str:
    inside = "".join(f"<component {use}/>" for use in uses)
    return (
        f'<object id="{number}" name="{name}"><components>{inside}</components></object>'
    )


ONE, TWO = (
    'p:path="/3D/Objects/{}.model" objectid="{}"'.format(*one) for one in ("a1", "a2")
)
CLASH = 'p:path="/3d/objects/B.model" objectid="1"'
THREE_MFS = {
    "parts of one file": (components(3, ONE, TWO), ['objectid="3"'], [0, 5]),
    "files with equal ids": (components(1, ONE, CLASH), ['objectid="1"'], [0, 9]),
    "items of other files": ("", [TWO, CLASH], [5, 9]),
    "components of components": (
        three_mf_object(1, 0)
        + components(2, 'objectid="1" transform="1 0 0 0 1 0 0 0 1 2 0 0"')
        + components(
            3, 'objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 0"', 'objectid="1"'
        ),
        ['objectid="3" transform="-1 0 0 0 1 0 0 0 1 1 0 0"'],
        [-3, 1],
    ),
    "bodies of SolidWorks": (
        three_mf_object(1, 0, "Body 1")
        + three_mf_object(2, 5, "Body 2")
        + components(3, 'objectid="1"', name="person(1)")
        + components(4, 'objectid="2"', name="person(2)"),
        ['objectid="3"', 'objectid="4"'],
        [0, 5],
    ),
    "an object that is not built": (
        three_mf_object(1, 0) + three_mf_object(2, 5),
        ['objectid="2" p:UUID="1"'],
        [5],
    ),
}


@needs(".3mf")
@pytest.mark.parametrize("kind", THREE_MFS)
def test_bodies_of_3mf_in_their_places(kind: str, tmp_path: Path) -> None:
    """As slicers write them: objects in files of their own, by the production extension."""
    resources, items, places = THREE_MFS[kind]
    built = "".join(f"<item {item}/>" for item in items)
    model = "<model {}><resources>{}</resources><build>{}</build></model>"
    path = tmp_path / "a.3mf"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in (
            ("3D/Objects/a.model", three_mf_object(1, 0) + three_mf_object(2, 5)),
            ("3D/Objects/b.model", three_mf_object(1, 9)),
        ):
            archive.writestr(name, model.format(PRODUCTION, text, ""))
        main = model.format(f'unit="meter" {PRODUCTION}', resources, built)
        archive.writestr("3D/3dmodel.model", main)
    found = mesh(path)
    assert not defects(found).boundary_edges
    assert defects(found).components == len(places)
    own = [mesh(Path(str(member))) for member in members_of(path) or [path]]
    middles = [one.vertices.mean(axis=0) for one in own]
    np.testing.assert_allclose(
        sorted(x for x, _, _ in middles), places, atol=1e-6, err_msg=kind
    )
    assert all(one.volume > 0 for one in own)


def model_of(resources: str, *items: str) -> str:
    built = "".join(f"<item {item}/>" for item in items)
    return f"<model {PRODUCTION}><resources>{resources}</resources><build>{built}</build></model>"


RELATIONS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="{}" Id="r0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>"
)
BALL_MODEL = model_of(three_mf_object(1, 0), 'objectid="1"')
LATTICE = "<b:beamlattice radius='1'><b:beams><b:beam v1='0' v2='1'/></b:beams></b:beamlattice></mesh>"
WITH_LATTICE = BALL_MODEL.replace("</mesh>", LATTICE).replace(
    "<model",
    '<model xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"',
)
OTHERS = "".join(
    three_mf_object(k, 5).replace("<object", f'<object type="{kind}"')
    for k, kind in ((2, "other"), (3, "support"), (4, "solidsupport"))
)
WITH_OTHERS = model_of(
    three_mf_object(1, 0)
    + OTHERS
    + components(5, 'objectid="1"', 'objectid="2"', 'objectid="3"'),
    'objectid="5"',
    'objectid="4"',
)
DIALECTS_OF_3MF: dict[str, dict[str, str | bytes]] = {
    "a mark of UTF-8": {"3D/3dmodel.model": "\ufeff" + BALL_MODEL},
    "UTF-16": {"3D/3dmodel.model": BALL_MODEL.encode("utf-16")},
    "a lattice of beams": {"3D/3dmodel.model": WITH_LATTICE},
    "supports, and what is not printed": {"3D/3dmodel.model": WITH_OTHERS},
    "a surface": {
        "3D/3dmodel.model": BALL_MODEL.replace("<object", '<object type="surface"')
    },
    "a model of another name": {
        "[Content_Types].xml": "<Types/>",
        "_rels/.rels": RELATIONS.format("/3D/Ball.model"),
        "3D/Ball.model": BALL_MODEL,
    },
    "a relative path": {
        "_rels/.rels": RELATIONS.format("3D/ball.model"),
        "3D/Ball.model": BALL_MODEL,
    },
    "relations to a picture alone": {
        "_rels/.rels": RELATIONS.format("/a.png").replace("2013/01/3dmodel", "thumbnail"),
        "3D/3dmodel.model": BALL_MODEL,
    },
    "a model that builds its own": {
        "_rels/.rels": RELATIONS.format("/3D/3dmodel.model"),
        "3D/3dmodel.model": model_of("", 'p:path="/3D/a.model" objectid="1"'),
        "3D/a.model": BALL_MODEL,
    },
}


@needs(".3mf")
@pytest.mark.parametrize("dialect", DIALECTS_OF_3MF)
def test_dialects_of_3mf(dialect: str, tmp_path: Path) -> None:
    """Each is one ball, in millimetres, which is the unit where a model names none."""
    with zipfile.ZipFile(tmp_path / "a.3mf", "w") as archive:
        for name, content in DIALECTS_OF_3MF[dialect].items():
            archive.writestr(name, content)
    found = read_raw(ScanPath.parse(tmp_path / "a.3mf"))
    assert found.unit == "mm"
    np.testing.assert_allclose(found.points, BALL.vertices, atol=1e-6)
    assert found.faces is not None
    assert len(found.faces) == len(BALL.faces)


@needs(".dae")
def test_a_collada_file_says_how_long_its_unit_is(tmp_path: Path) -> None:
    for metres, unit, scale in ((0.01, "cm", 1.0), (1, "m", 1.0), (0.5, "m", 0.5)):
        (tmp_path / "a.dae").write_text(collada(BALL, metres=metres, shift=(1, 2, 3)))
        found = read_raw(ScanPath.parse(tmp_path / "a.dae"))
        assert found.unit == unit
        np.testing.assert_allclose(
            found.points.mean(axis=0), scale * np.array([1, 2, 3]), atol=1e-6
        )
    twice = 2 * '<instance_node url="#n{}"/>'
    nodes = "".join(
        f'<node id="n{k}">{twice.format(k - 1, k - 1)}</node>' for k in range(30)
    )
    scene = f'<library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id="scene"><node>'
    scene += '<instance_node url="#n29"/></node></visual_scene></library_visual_scenes>'
    text = re.sub(
        "(?s)<library_visual_scenes>.*</library_visual_scenes>", scene, collada(BALL)
    )
    (tmp_path / "a.dae").write_text(text)
    with pytest.raises(
        ScanReadError, match=r"at most 1000 scans, .* this one has 1073741824 or more"
    ):
        read_scan(tmp_path / "a.dae")


@needs(".dae")
def test_a_date_of_a_collada_file_is_no_warning(tmp_path: Path) -> None:
    """pycollada would warn of names of time zones that have no offset for all."""
    text = re.sub("<created>.*?<", "<created>1 May 2011 10:00 PDT<", collada(BALL))
    (tmp_path / "a.dae").write_text(text)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert len(mesh(tmp_path / "a.dae").faces) == len(BALL.faces)
    assert not warned


@needs(".3mf")
def test_damaged_archives_and_those_that_expand_to_much_more(tmp_path: Path) -> None:
    whole, file = three_mf(BALL), tmp_path / "a.3mf"
    file.write_bytes(whole)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/blanks.model", b" " * 20_000_000)
    items = '<item objectid="1"/>' * 200
    part = '<object id="{}"><components>{}</components></object>'
    nested = "".join(
        part.format(k, f'<component objectid="{k - 1}"/>' * 2) for k in range(2, 32)
    )
    for content, words in (
        (file.read_bytes(), r"its members declare 2\d+ bytes in \d+"),
        (three_mf(shapes.icosphere(3), items=items), "its scene declares 1153200 values"),
        (
            three_mf(BALL, items=f"<item objectid='31'/>{nested}"),
            "at most 1000 scans, .* has 1001 or more",
        ),
        (
            whole[:-6] + b"\xff\xff\0\0" + whole[-2:],
            "not a valid 3MF file .*Invalid argument",
        ),
        (
            re.sub(rb"(?s)(PK\x01\x02..).", b"\\g<1>\xff", whole),
            r"zip file version 25\.5",
        ),
    ):
        file.write_bytes(content)
        with pytest.raises(ScanReadError, match=words):
            read_scan(file)


@pytest.mark.slow
def test_a_regular_mesh_which_is_compressed_best_is_read(tmp_path: Path) -> None:
    n = 300
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    corner = (np.arange(n - 1)[:, np.newaxis] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [corner[:, np.newaxis] + side for side in ([0, 1, n], [1, n + 1, n])]
    )
    grid = TriangleMesh(
        np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float),
        faces.astype(np.int32),
    )
    (tmp_path / "grid.3mf").write_bytes(three_mf(grid))
    found = read_scan(tmp_path / "grid.3mf")
    assert isinstance(found, TriangleMesh) and len(found.faces) == len(faces)


@needs(".dae")
def test_entities_of_xml_neither_grow_nor_open_files(tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("9 9 9")
    bomb = "".join(f'<!ENTITY {b} "{10 * f"&{a};"}">' for a, b in pairwise("abcdefghijz"))
    for declared in (
        f'<!ENTITY a "9 9 9">{bomb}',
        f'<!ENTITY z SYSTEM "{(tmp_path / "secret.txt").as_uri()}">',
        '<!ENTITY z SYSTEM "http://127.0.0.1:1/">',
    ):
        head = f"<!DOCTYPE COLLADA [{declared}]>\n<COLLADA"
        hostile = (
            collada(BALL)
            .replace("<COLLADA", head, 1)
            .replace("<float_array", "&z;<float_array")
        )
        (tmp_path / "a.dae").write_text(hostile)
        with pytest.raises(ScanReadError, match=r"[Ee]ntity"):
            read_scan(tmp_path / "a.dae")
