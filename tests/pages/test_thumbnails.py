"""Thumbnails are drawn once, when a scan is ingested, and pages use what the catalogue keeps."""

from __future__ import annotations

import base64
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import shapes
from commands import run
from PIL import Image

import pcretrieve as pr
from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.draw.pictures import THUMBNAIL_PIXELS, Thumbnail, thumbnail
from pcretrieve.errors import OptionError
from pcretrieve.formats import ScanPath, write_mesh
from pcretrieve.ingestion.attempts import content_of
from pcretrieve.pages.thumbnails import Thumbnails

OPTIONS = PipelineOptions().changed(
    signature={"method": "r-bihdm", "n_values": 10}, spectral={"n_pairs": 61}
)


def ingested(folder: Path, name: str) -> Catalogue:
    store = Catalogue(folder / name, OPTIONS, create=True)
    pr.ingest(
        sorted(folder.glob("*.off")), store, labels={f"{n}.off": "egg" for n in range(3)}
    )
    return store


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three eggs, which are longest along the axis z."""
    place = tmp_path_factory.mktemp("thumbnails")
    for number in range(3):
        write_mesh(
            shapes.ellipsoid((1.0, 1.2, 2.0 + number / 5), subdivisions=3),
            place / f"{number}.off",
        )
    return place


@pytest.fixture(scope="module")
def catalogue(folder: Path) -> Iterator[Catalogue]:
    with ingested(folder, "eggs.sqlite") as store:
        yield store


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The directions upwards of the pictures that are drawn while pages are made."""
    ups: list[object] = []

    def counted(*mesh: object, **more: object) -> Thumbnail | None:
        ups.append(more["up"])
        return thumbnail(*mesh, **more)  # type: ignore[arg-type]

    monkeypatch.setattr("pcretrieve.draw.pictures.thumbnail", counted)
    return ups


def size_of(picture: bytes) -> tuple[int, int]:
    with Image.open(BytesIO(picture)) as image:
        return image.width, image.height


def is_upright(picture: bytes) -> bool:
    with Image.open(BytesIO(picture)) as image:
        left, top, right, bottom = image.convert("RGBA").getchannel("A").getbbox()
    return bool(bottom - top > right - left)


def test_a_catalogue_keeps_the_pictures_that_would_be_drawn_and_pages_use_them(
    catalogue: Catalogue, folder: Path, tmp_path: Path, drawn: list[object]
) -> None:
    pictures = Thumbnails(catalogue)
    for record in catalogue.records():
        mesh, kept = catalogue.mesh(record.id), catalogue.thumbnail(record.id)
        drawn_now = thumbnail(mesh.vertices, mesh.faces)
        assert drawn_now is not None
        assert kept == drawn_now.png == pictures.of(catalogue, record)
        np.testing.assert_array_equal(
            catalogue.rows.direction_upwards(record.id), drawn_now.up
        )
        assert kept and size_of(kept) == (THUMBNAIL_PIXELS, THUMBNAIL_PIXELS)
    assert catalogue.rows.stored_bytes("0")["thumbnails"] > 1000
    # No surface is stored.
    keeps_nothing = OPTIONS.changed(catalogue={"keep": ()})
    bare = content_of(ScanPath(folder / "0.off"), keeps_nothing)
    assert bare.thumbnail == catalogue.thumbnail("0")
    drawn.clear()
    pages = (
        pr.report(catalogue, tmp_path / "report.html"),
        pr.draw_map(catalogue, tmp_path / "map.html"),
        pr.query_page(catalogue, ["0", folder / "1.off"], tmp_path / "query.html", k=2),
    )
    assert drawn == []
    for page, pixels in zip(pages, (88, 128, 200), strict=True):
        inlined = re.findall(
            r'(?:base64,|data-picture="|")(iVBORw0KGgo[\w+/=]+)', page.read_text("utf-8")
        )
        assert {size_of(base64.b64decode(picture))[0] for picture in inlined} == {
            pixels
        }, page


@pytest.mark.parametrize(("up", "stands"), [("z", True), ("-z", True), ("x", False)])
def test_what_is_up_can_be_said_for_each_page(
    up: str, stands: bool, catalogue: Catalogue, tmp_path: Path, drawn: list[object]
) -> None:
    with pytest.raises(
        OptionError, match="up must be one of x, -x, y, -y, z, -z, got 'w'"
    ):
        pr.report(catalogue, tmp_path / "report.html", up="w")
    direction = np.zeros(3)
    direction["xyz".index(up[-1])] = -1 if up[0] == "-" else 1
    pictures = Thumbnails(catalogue, up)
    assert catalogue.rows.settings().get("up") == up
    assert [
        is_upright(pictures.of(catalogue, one) or b"") for one in catalogue.records()
    ] == [stands] * 3
    assert all((one == direction).all() for one in np.array(drawn))
    np.testing.assert_array_equal(catalogue.rows.direction_upwards("0"), direction)
    for axis, words in {
        "y": "report",
        "-y": "lab map",
        "-x": "query 0 -k 3 --html",
    }.items():
        drawn.clear()
        output = () if "--html" in words else ("-o",)
        run(
            *words.split(),
            *output,
            tmp_path / f"{axis}.html",
            "--up",
            axis,
            "-c",
            catalogue.location,
        )
        assert catalogue.rows.settings().get("up") == axis and len(drawn) == 3, words
    pictures.say(catalogue, None)
    assert (
        catalogue.rows.settings().get("up") is None and catalogue.thumbnail("0") is None
    ), "drawn again as it shows"
    shown = pictures.of(catalogue, catalogue.record("0")) or b""
    pictures.turn(catalogue, catalogue.record("0"), forwards=False)
    assert is_upright(catalogue.thumbnail("0") or b"") != is_upright(shown)


def test_what_was_not_stored_is_drawn_once_and_kept_if_it_can_be_written(
    folder: Path, drawn: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a shape whose picture was dropped; without its surface, a picture is left as it is."""
    monkeypatch.setattr("pcretrieve.catalogue.sqlite.LOCK_TIMEOUT", 1.0)
    with ingested(folder, "earlier.sqlite") as store:
        before = [store.thumbnail(record.id) for record in store.records()]
        with closing(sqlite3.connect(store.location)) as other, other:
            other.execute("UPDATE arrays SET thumbnails = NULL")
        for _ in range(2):
            pictures = Thumbnails(store)
            found = [pictures.of(store, record) for record in store.records()]
            assert found == before and len(drawn) == 3
        with closing(sqlite3.connect(store.location)) as other:
            other.execute("UPDATE arrays SET thumbnails = NULL")
            other.commit()
            other.execute("BEGIN IMMEDIATE")  # another process writes: drawn all the same
            pictures = Thumbnails(store)
            assert [pictures.of(store, record) for record in store.records()] == before
            other.rollback()
        assert len(drawn) == 6
        assert {store.thumbnail(record.id) for record in store.records()} == {None}
        assert store.rows.keep_thumbnail(
            store.record("0"), before[0] or b"", np.array([0, 0, 1.0])
        )
        with closing(sqlite3.connect(store.location)) as other, other:
            other.execute("UPDATE arrays SET meshes = NULL")
        assert Thumbnails(store, "x").of(store, store.record("0")) == before[0]
