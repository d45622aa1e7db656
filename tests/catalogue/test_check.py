"""`check` finds what was really damaged, `--repair` loses nothing else, and `backup` copies one state."""

from __future__ import annotations

import json
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
import shapes
from click.testing import CliRunner, Result
from processes import in_this_process, wait_for

import pcretrieve as pr
from pcretrieve.catalogue import Catalogue, cache
from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.records import RECORDS, checksum
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh

N_SHAPES = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some eggs, and a file that cannot be read."""
    scans = tmp_path_factory.mktemp("check") / "scans"
    scans.mkdir()
    for number in range(N_SHAPES):
        write_mesh(shapes.ellipsoid((1, 1.2, 1.5 + number / 5), subdivisions=3), scans / f"{number}.off")
    (scans / "bad.off").write_text("OFF\n")
    return scans


@pytest.fixture(scope="module")
def original(folder: Path) -> Path:
    """Their catalogue, which each test copies."""
    path = folder.with_name("original.sqlite")
    pr.ingest(folder, path, executor=in_this_process)
    return path


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "c.sqlite"
    pr.backup(original, copy)
    return copy


@pytest.fixture
def schema(original: Path, postgresql: str) -> str:
    """The same catalogue in a database."""
    location = f"{postgresql}?schema=check{uuid4().hex}"
    pr.merge_catalogues([original], location)
    return location


def execute(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def store_checksums(path: Path) -> None:
    """Let the present values be those that were stored."""
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.row_factory = sqlite3.Row
        for row in connection.execute(RECORDS).fetchall():
            values = (checksum(dict(row)), row["number"])
            connection.execute("UPDATE shapes SET checksum = ? WHERE number = ?", values)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


def rows_of(location: str | Path) -> list[Any]:
    """Everything that is stored of each shape."""
    with Catalogue(location) as store:
        entries = store.rows.entries([record.id for record in store.records()])
        return [(entry.record, dict(entry.signatures), dict(entry.payloads)) for entry in entries]


def test_a_whole_catalogue_has_no_defects(path: Path) -> None:
    found = pr.check(path, sample=2, repair=True)
    assert (found.n_shapes, found.n_failed, found.n_recomputed, found.defects) == (N_SHAPES, 1, 2, ())
    said = run("check", path, "--sample", "0")
    assert said.exit_code == 0
    assert said.stdout == f"{path}: 5 shapes, 1 failed, 0 signatures computed again, 0 defects\n"


def half(column: str) -> str:
    return f"substr({column}, 1, length({column}) / 2)"


def flipped(column: str) -> str:
    return f"CAST(substr({column}, 1, 99) || x'ff' || substr({column}, 101) AS BLOB)"


THIRD = "WHERE shape = (SELECT number FROM shapes WHERE id = '2')"
AGAIN = "set to be ingested again"
DAMAGES = [  # the statement, and what the check says
    (f"UPDATE arrays SET meshes = {flipped('meshes')} {THIRD}", "its checksum does not fit"),
    (f"UPDATE arrays SET spectra = {half('spectra')} {THIRD}", "its checksum does not fit"),
    (f"UPDATE arrays SET thumbnails = {half('spectra')} {THIRD}", "its thumbnail cannot be read"),
    (f"UPDATE signatures SET value = {flipped('value')} {THIRD}", "its signature cannot"),
    (f"UPDATE arrays SET moments = NULL {THIRD}", "its moments are missing"),
    (f"DELETE FROM signatures {THIRD}", "its signature is missing"),
    (f"UPDATE arrays SET meshes = spectra {THIRD}", "its arrays cannot be read"),
    (f"UPDATE arrays SET spectra = (SELECT spectra FROM arrays LIMIT 1) {THIRD}", "its area is"),
    ("UPDATE shapes SET n_faces = 7 WHERE id = '2'", "(642, 7, 2) in its record"),
    ("UPDATE shapes SET content_hash = '' WHERE id = '2'", "must be 64 hexadecimal digits"),
    ("UPDATE shapes SET error = 'E' WHERE id = '2'", "has the failure E"),
    ("UPDATE shapes SET status = 'failed' WHERE id = '2'", "it failed, but has"),
]


def test_a_damaged_shape_is_named_and_set_to_be_ingested_again(path: Path, tmp_path: Path) -> None:
    for number, (statement, words) in enumerate(DAMAGES):
        copy = tmp_path / f"{number}.sqlite"
        pr.backup(path, copy)
        execute(copy, statement)
        store_checksums(copy)
        (found,) = pr.check(copy, sample=0).defects
        assert (found.kind, found.shape_id, found.repair) == ("shape", "2", None)
        assert words in found.message
        (repaired,) = pr.check(copy, sample=0, repair=True).defects
        assert (repaired.shape_id, repaired.repair) == ("2", AGAIN)
        with Catalogue(copy) as store:
            record = store.record("2")
        assert (record.status, record.stage, record.error) == ("failed", "check", "CatalogueError")
        assert pr.check(copy, sample=0).is_whole


LABEL = "a class that no other shape has"


@pytest.mark.parametrize("bit", [0, 7])  # the second one leaves bytes that are not UTF-8
def test_a_flipped_bit_of_a_record(
    bit: int, path: Path, folder: Path, original: Path, tmp_path: Path
) -> None:
    """Wherever it is, the shape is named, and ingested again after the repair."""
    with Catalogue(path) as store:
        store.revise(labels={str(folder / "2.off"): LABEL})
    execute(path, f"UPDATE provenance SET versions = '{{\"versions of shape 2\": 1}}' {THIRD}")
    store_checksums(path)
    for number, text in enumerate((LABEL, "/scans/2.off", "versions of shape 2", f"{LABEL}done", None)):
        copy = tmp_path / f"{number}.sqlite"
        pr.backup(path, copy)
        if text is None:
            execute(copy, f"DELETE FROM provenance {THIRD}")
        else:
            data = bytearray(copy.read_bytes())
            place = data.find(text.encode())
            while place > 0:
                data[place + len(text) - 1] ^= 1 << bit
                place = data.find(text.encode(), place)
            copy.write_bytes(data)
        with pytest.raises(pr.CatalogueError, match="is damaged "), Catalogue(copy) as store:
            store.records()
        assert not pr.check(copy, sample=0).is_whole
        repaired = pr.check(copy, sample=0, repair=True)
        assert repaired.defects[-1].shape_id == "2"
        assert repaired.defects[-1].repair == "removed: ingest its file again"
        assert repaired.is_whole
        again = pr.ingest(folder, copy, executor=in_this_process)
        assert [record.id for record in again.done] == ["2"]
        for mended, whole in zip(rows_of(copy), rows_of(original), strict=True):
            assert (mended[0].id, mended[0].path, *mended[1:]) == (whole[0].id, whole[0].path, *whole[1:])


def test_what_was_damaged_is_processed_again(path: Path, original: Path) -> None:
    execute(path, f"UPDATE arrays SET moments = NULL {THIRD}")
    assert run("check", path, "--sample", "0", "--repair").exit_code == 0
    again = pr.retry(path, stage="check", executor=in_this_process)
    assert [record.id for record in again.done] == ["2"]
    assert [row[1:] for row in rows_of(path)] == [row[1:] for row in rows_of(original)]


def test_rows_of_no_shape_are_removed(path: Path) -> None:
    stray = "INSERT INTO signatures SELECT 'own', 99, value FROM signatures LIMIT 1"
    execute(path, "INSERT INTO arrays (shape) VALUES (99)", stray)
    before = rows_of(path)
    found = run("check", path, "--sample", "0", "--json")
    assert found.exit_code == 1
    answer = json.loads(found.stdout)["result"]
    assert not answer["is_whole"]
    assert [defect["kind"] for defect in answer["defects"]] == ["orphan", "orphan"]
    with pytest.raises(pr.CatalogueError, match="it has signatures of no shape"), Catalogue(path) as store:
        store.signatures()
    said = run("check", path, "--sample", "0", "--repair")
    assert said.exit_code == 0
    assert re.search("1 rows of arrays are of no shape  +removed\n", said.stdout)
    assert pr.check(path, sample=0).defects == ()
    assert rows_of(path) == before


def test_a_damaged_sql_index_is_made_again(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA writable_schema = ON")
        definition = "CREATE INDEX shapes_by_content ON shapes (label)"
        connection.execute("UPDATE sqlite_master SET sql = ? WHERE name = 'shapes_by_content'", (definition,))
        connection.commit()
    found = pr.check(path, sample=0)
    assert {defect.kind for defect in found.defects} == {"database"}
    assert "missing from index shapes_by_content" in found.defects[0].message
    assert all(defect.repair for defect in pr.check(path, sample=0, repair=True).defects)
    assert pr.check(path, sample=0).is_whole


def test_damaged_pages_are_named_and_left(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection:
        query = "SELECT rootpage FROM sqlite_master WHERE name = 'provenance'"
        ((page,),) = connection.execute(query)
        ((size,),) = connection.execute("PRAGMA page_size")
    data = bytearray(path.read_bytes())
    data[(page - 1) * size : page * size] = b"\x55" * size
    path.write_bytes(data)
    for options in ((), ("--repair",)):
        said = run("check", path, *options)
        assert said.exit_code == 1
        assert "not repaired" in said.stdout
        assert path.read_bytes() == data


def test_a_signature_that_its_surfaces_do_not_give(path: Path) -> None:
    with Catalogue(path) as store:
        values = store.signature("2") * np.linspace(1, 1.02, len(store.signature("2")))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"UPDATE signatures SET value = ? {THIRD}", (packed_values(values),))
    assert pr.check(path, sample=0).defects == ()
    found = pr.check(path, sample=99, repair=True)
    assert (found.n_recomputed, found.is_whole) == (N_SHAPES, True)
    (defect,) = found.defects
    assert (defect.kind, defect.shape_id, defect.repair) == ("signature", "2", AGAIN)
    assert "its signature differs from that of its stored surfaces by 2.0%" in defect.message


def test_a_signature_of_a_file(folder: Path, tmp_path: Path) -> None:
    for name in ("0.off", "1.off"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    options = pr.PipelineOptions().changed(catalogue={"keep": ()})
    pr.ingest(tmp_path, tmp_path / "c.sqlite", options=options, executor=in_this_process)
    (tmp_path / "1.off").write_bytes((folder / "2.off").read_bytes())
    found = pr.check(tmp_path / "c.sqlite")
    assert (found.n_recomputed, found.is_whole) == (1, True)


def test_a_damaged_index_is_removed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "SMALLEST_KEPT", 2)
    with Catalogue(path) as store:
        nearest = store.index().nearest("2", k=3)
    assert pr.check(path, sample=0).is_whole
    file = max(path.with_name("c.sqlite.gallery").rglob("*.npy"), key=lambda file: file.stat().st_size)
    data = bytearray(file.read_bytes())
    data[-5] ^= 1
    file.write_bytes(data)
    (found,) = pr.check(path, sample=0).defects
    assert (found.kind, found.repair) == ("index", None)
    assert f"has changed on the disk: {file.name}" in found.message
    assert pr.check(path, sample=0, repair=True).is_whole
    with Catalogue(path) as store:
        assert store.index().nearest("2", k=3) == nearest


@pytest.mark.slow
def test_damages_of_a_database(schema: str, tmp_path: Path) -> None:
    psycopg = pytest.importorskip("psycopg")
    assert pr.check(schema, sample=0, repair=True).defects == ()
    with Catalogue(schema) as store:
        pr.backup(store, tmp_path / "copy.sqlite")
    assert rows_of(tmp_path / "copy.sqlite") == rows_of(schema)
    url, _, name = schema.partition("?schema=")
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute(f'SET search_path = "{name}"')
        connection.execute("DELETE FROM shapes WHERE id = '1'")
        connection.execute(f"UPDATE arrays SET meshes = substr(meshes, 1, 99) {THIRD}")
        connection.execute("UPDATE shapes SET label = 'round' WHERE id = '3'")
    with pytest.raises(pr.CatalogueError, match=r"\(shape '3': its record has changed since .*--repair"):
        pr.merge_catalogues([schema], tmp_path / "all.sqlite")
    kinds = [(defect.kind, defect.shape_id) for defect in pr.check(schema, sample=0).defects]
    assert kinds == [("orphan", None)] * 3 + [("shape", "2"), ("shape", "3")]
    assert pr.check(schema, sample=0, repair=True).is_whole
    assert pr.check(schema, sample=0).defects == ()
    with Catalogue(schema) as store:
        assert len(store) == N_SHAPES - 3
        assert store.failures()[("check", "CatalogueError")] == 1


# --- backup ---------------------------------------------------------------------------------------------


def test_a_backup_has_the_same_rows(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.sqlite"
    assert run("backup", path, copy).exit_code == 0
    assert rows_of(copy) == rows_of(path)
    assert not list(tmp_path.glob(".backup*"))
    assert pr.check(copy, sample=0).is_whole
    assert "exists: name a new file for the backup" in str(run("backup", path, copy).exception)
    with pytest.raises(pr.CatalogueError, match=r"cannot write the backup .*: No such file"):
        pr.backup(path, tmp_path / "nowhere" / "copy.sqlite")
    with pytest.raises(pr.CatalogueError, match="there is no catalogue"):
        pr.backup(tmp_path / "none.sqlite", tmp_path / "other.sqlite")


WRITER = """
import sys
from dataclasses import replace
from pcretrieve import Catalogue

with Catalogue(sys.argv[1]) as store:
    (entry,) = store.rows.entries(["2"])
    number = 0
    while True:
        number += 1
        pair = [
            replace(entry, record=replace(entry.record, id=f"{side}{number}", path=f"/{side}{number}"))
            for side in "ab"
        ]
        store.rows.add(pair)
"""


@pytest.fixture
def written(path: Path) -> Iterator[Path]:
    """A catalogue into which another process stores pairs of shapes."""
    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)]) as writer:
        try:
            with Catalogue(path) as store:
                assert wait_for(lambda: len(store) > N_SHAPES + 20)
            yield path
            assert writer.poll() is None
        finally:
            writer.kill()


@pytest.mark.slow
def test_a_backup_while_writing_goes_on_is_one_state(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcretrieve.catalogue.merge.PAGES_AT_ONCE", 100)
    sizes = []
    for number in range(2):
        copy = tmp_path / f"copy{number}.sqlite"
        pr.backup(written, copy)
        assert pr.check(copy, sample=0).is_whole
        with Catalogue(copy) as store:
            sizes.append(len(store) - N_SHAPES)
        assert sizes[-1] % 2 == 0
        with Catalogue(written) as store:
            assert wait_for(lambda: len(store) > N_SHAPES + sizes[-1])
    assert sizes == sorted({*sizes})
