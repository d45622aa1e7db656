"""Formats of scenes: the bodies in them, where they stand, and their unit."""

from __future__ import annotations

import re
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from scene_files import collada, three_mf, write_gltf

from pcretrieve import TriangleMesh, read_scan
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import members_of, missing_extra, parts_of, split_member, write_mesh
from pcretrieve.formats.registry import read_raw
from pcretrieve.ingestion.discover import content_hash, discover, shape_ids
from pcretrieve.ingestion.views import read_views
from pcretrieve.surface import defects
from pcretrieve.values import METRES

BALL = shapes.icosphere(1)
NODES: list[dict[str, Any]] = [{"mesh": 0, "name": "left"}, {"mesh": 0, "translation": [5, 0, 0]}]


def mesh(path: Path) -> TriangleMesh:
    found = read_scan(path)
    assert isinstance(found, TriangleMesh)
    return found


def needs(suffix: str) -> pytest.MarkDecorator:
    extra = missing_extra(suffix)
    return pytest.mark.skipif(extra is not None, reason=f"needs the extra of {suffix}")


def write_all(folder: Path) -> None:
    """The ball beside itself, five units apart, in each format."""
    write_gltf(folder / "a.gltf", BALL, NODES, "a.bin")
    write_gltf(folder / "data.gltf", BALL, NODES)
    items = '<item objectid="1"/><item objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"/>'
    (folder / "a.3mf").write_bytes(three_mf(BALL, unit="meter", items=items))


FILES = ("a.gltf", "data.gltf", pytest.param("a.3mf", marks=needs(".3mf")))


@pytest.mark.parametrize("name", FILES)
def test_a_scene_is_one_mesh_or_several(name: str, tmp_path: Path) -> None:
    write_all(tmp_path)
    both = mesh(tmp_path / name)
    assert len(both.faces) == 2 * len(BALL.faces)
    assert defects(both).components == 2
    assert not defects(both).boundary_edges
    assert both.volume == pytest.approx(2 * BALL.volume, rel=1e-5)
    first, second = members_of(tmp_path / name)
    for path, x in ((first, 0), (second, 5)):
        found = mesh(path)
        assert found.volume == pytest.approx(BALL.volume, rel=1e-5)
        np.testing.assert_allclose(found.vertices.mean(axis=0), [x, 0, 0], atol=1e-5)
        assert not defects(found)


@pytest.mark.parametrize("name", FILES)
def test_each_body_is_a_shape(name: str, tmp_path: Path) -> None:
    write_all(tmp_path)
    found = discover([tmp_path / name])
    assert [split_member(path)[0] for path in found] == 2 * [tmp_path / name]
    assert discover(found) == found
    ids = list(shape_ids([str(path) for path in found], {}).values())
    assert ids == [f"{Path(name).stem}#{split_member(path)[1]}" for path in found]
    hashes = {content_hash(path) for path in found}
    assert len(hashes | {content_hash(tmp_path / name)}) == 3


def test_bodies_of_one_file_are_views_in_one_frame(tmp_path: Path) -> None:
    write_all(tmp_path)
    views = read_views([tmp_path / "a.gltf"])
    assert [path.name for path in views.files] == ["a.gltf#left", "a.gltf#2"]
    np.testing.assert_array_equal(views.poses, [np.eye(4), np.eye(4)])
    assert read_views([tmp_path / "a.gltf", tmp_path / "data.gltf"]).poses is None


def test_names_in_a_file(tmp_path: Path) -> None:
    names = ["a/b", "", "same", "same", " c#d ", "\x07"]
    write_gltf(tmp_path / "a.gltf", BALL, [{"mesh": 0, "name": name} for name in names])
    found = [path.name for path in members_of(tmp_path / "a.gltf")]
    assert found == [f"a.gltf#{name}" for name in ("a_b", "2", "same", "same-2", "c_d", "6")]
    with pytest.raises(ScanReadError, match="the file must hold a scan 'x', got a_b, 2, same, same-2, c_d"):
        read_scan(tmp_path / "a.gltf#x")
    with pytest.raises(ScanReadError, match=r"cannot read .*gone\.gltf: No such file"):
        read_scan(tmp_path / "gone.gltf#x")


def test_a_file_of_one_body_has_no_names(tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.gltf", BALL, NODES[:1])
    assert members_of(tmp_path / "a.gltf") == members_of(tmp_path / "a.xyz") == ()
    assert discover([tmp_path]) == [tmp_path / "a.gltf"]


def test_a_hash_in_the_name_of_a_file_is_no_mark(tmp_path: Path) -> None:
    (tmp_path / "scan#1.xyz").write_text("1 2 3\n" * 5)
    assert discover([tmp_path]) == [tmp_path / "scan#1.xyz"]
    assert len(read_raw(tmp_path / "scan#1.xyz").points) == 5


# --- glTF -------------------------------------------------------------------------------------------------


def test_the_file_of_a_buffer_belongs_to_the_scan(tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.gltf", BALL, NODES[:1], "with%20blank.bin")
    (tmp_path / "with%20blank.bin").rename(tmp_path / "with blank.bin")
    assert [part.path for part in parts_of(tmp_path / "a.gltf")] == [tmp_path / "with blank.bin"]
    assert mesh(tmp_path / "a.gltf").volume == pytest.approx(BALL.volume, rel=1e-5)
    before = content_hash(tmp_path / "a.gltf")
    (tmp_path / "with blank.bin").write_bytes((tmp_path / "with blank.bin").read_bytes() + b"\0")
    assert content_hash(tmp_path / "a.gltf") != before


@pytest.mark.parametrize(
    ("buffer", "words"),
    [
        ("/etc/passwd", "its buffers must be files below its own folder, got '/etc/passwd'"),
        ("../a.bin", "its buffers must be files below its own folder"),
        ("https://example.org/a.bin", "its buffers must be files below its own folder"),
        ("gone.bin", r"its buffer gone\.bin: No such file or directory"),
        ("folder", r"its buffer folder: .* is a folder"),
        ("short.bin", "its binary part is too short for"),
    ],
)
def test_buffers_elsewhere_are_not_read(buffer: str, words: str, tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.gltf", BALL, NODES, "a.bin")
    (tmp_path / "a.gltf").write_text((tmp_path / "a.gltf").read_text().replace("a.bin", buffer))
    (tmp_path / "short.bin").write_bytes(b"\0")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ScanReadError, match=words):
        read_scan(tmp_path / "a.gltf")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"asset": {"version": "1.0"}}', "it is not glTF 2.0, but 1.0"),
        ("[]", "its JSON part is broken: TypeError"),
        ("{", "its JSON part is broken"),
        ('{"asset": {"version": "2.0"}, "buffers": [{}]}', "KeyError 'uri'"),
    ],
)
def test_what_is_no_gltf(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.gltf").write_text(text)
    with pytest.raises(ScanReadError, match=words):
        read_scan(tmp_path / "a.gltf")


# --- units ------------------------------------------------------------------------------------------------


@needs(".3mf")
@pytest.mark.parametrize(
    ("named", "unit"),
    [("millimeter", "mm"), ("micron", "um"), ("inch", "in"), ("meter", "m"), ("foot", "ft")],
)
def test_a_3mf_file_names_its_unit(named: str, unit: str, tmp_path: Path) -> None:
    (tmp_path / "a.3mf").write_bytes(three_mf(BALL, unit=named))
    assert read_raw(tmp_path / "a.3mf").unit == unit
    (tmp_path / "b.3mf").write_bytes(three_mf(BALL, unit="parsec"))
    with pytest.raises(ScanReadError, match="its unit is 'parsec'"):
        read_scan(tmp_path / "b.3mf")


@needs(".dae")
@pytest.mark.parametrize(("metres", "unit", "scale"), [(0.01, "cm", 1), (1, "m", 1), (0.5, "m", 0.5)])
def test_a_collada_file_says_how_long_its_unit_is(
    metres: float, unit: str, scale: float, tmp_path: Path
) -> None:
    (tmp_path / "a.dae").write_text(collada(BALL, metres=metres, shift="1 2 3"))
    found = read_raw(tmp_path / "a.dae")
    assert found.unit == unit
    assert len(found.points) == len(BALL.vertices)
    np.testing.assert_allclose(found.points.mean(axis=0), scale * np.array([1, 2, 3]), atol=1e-6)
    length = scale * METRES[unit]
    assert mesh(tmp_path / "a.dae").volume == pytest.approx(length**3 * BALL.volume, rel=1e-5)


@needs(".3mf")
def test_scans_whose_unit_is_known_are_read_in_metres(tmp_path: Path) -> None:
    (tmp_path / "a.3mf").write_bytes(three_mf(BALL, unit="inch"))
    found = mesh(tmp_path / "a.3mf")
    assert found.volume == pytest.approx(0.0254**3 * BALL.volume, rel=1e-5)
    assert found.provenance[0].sizes["metres_per_unit"] == 1
    assert found.provenance[0].notes == ("converted the coordinates from in to m",)
    write_mesh(BALL, tmp_path / "a.obj")
    assert "metres_per_unit" not in mesh(tmp_path / "a.obj").provenance[0].sizes


def test_gltf_is_in_metres(tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.gltf", BALL, NODES[:1])
    assert read_raw(tmp_path / "a.gltf").unit == "m"
    assert read_raw(Path(tmp_path / "a.gltf")).faces is not None


@needs(".3mf")
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04", "not a complete 3MF file"),
        (three_mf(BALL, items=""), "not a complete 3MF file"),
        (three_mf(BALL)[:-30], "not a complete 3MF file"),
        (three_mf(BALL).replace(b"PK\x01\x02", b"PK\x09\x09"), "not a complete 3MF file"),
        (re.sub(rb"(?s)(PK\x01\x02..).", b"\\g<1>\xff", three_mf(BALL)), r"zip file version 25\.5"),
    ],
)
def test_damaged_archives(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.3mf").write_bytes(content)
    with pytest.raises(ScanReadError, match=words):
        read_scan(tmp_path / "a.3mf")


@needs(".3mf")
def test_an_archive_that_expands_to_much_more_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.3mf"
    file.write_bytes(three_mf(BALL))
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/blanks.model", b" " * 20_000_000)
    monkeypatch.setattr("pcretrieve.formats.scenes._markup", pytest.fail)
    with pytest.raises(ScanReadError, match=r"its members declare 2\d+ bytes in \d+"):
        read_scan(file)


@needs(".3mf")
def test_a_regular_mesh_which_is_compressed_best_is_read(tmp_path: Path) -> None:
    n = 300
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    corner = (np.arange(n - 1)[:, np.newaxis] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([corner[:, np.newaxis] + side for side in ([0, 1, n], [1, n + 1, n])])
    grid = TriangleMesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float), faces.astype(np.int32))
    (tmp_path / "grid.3mf").write_bytes(three_mf(grid))
    found = read_scan(tmp_path / "grid.3mf")
    assert isinstance(found, TriangleMesh) and len(found.faces) == len(faces)


@needs(".dae")
@pytest.mark.parametrize(
    "declared",
    [
        '<!ENTITY a "9 9 9">'
        + "".join(f'<!ENTITY {b} "{10 * f"&{a};"}">' for a, b in pairwise("abcdefghijz")),
        '<!ENTITY z SYSTEM "{secret}">',
        '<!ENTITY z SYSTEM "http://127.0.0.1:1/">',
    ],
    ids=["bomb", "file", "address"],
)
def test_entities_of_xml_neither_grow_nor_open_files(declared: str, tmp_path: Path) -> None:
    (tmp_path / "secret.txt").write_text("9 9 9")
    head = f"<!DOCTYPE COLLADA [{declared}]>\n<COLLADA".replace(
        "{secret}", (tmp_path / "secret.txt").as_uri()
    )
    hostile = collada(BALL).replace("<COLLADA", head, 1).replace("<float_array", "&z;<float_array")
    (tmp_path / "a.dae").write_text(hostile)
    with pytest.raises(ScanReadError, match=r"[Ee]ntity"):
        read_scan(tmp_path / "a.dae")
