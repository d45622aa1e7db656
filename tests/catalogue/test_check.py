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

import pytest
import shapes
from click.testing import CliRunner, Result
from processes import in_this_process, wait_for

import pcretrieve as pr
from pcretrieve.catalogue import Catalogue
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
        entries = store.entries([record.id for record in store.records()])
        return [(entry.record, dict(entry.signatures), dict(entry.payloads)) for entry in entries]


def test_a_whole_catalogue_has_no_defects(path: Path) -> None:
    found = pr.check(path, sample=2, repair=True)
    assert (found.n_shapes, found.n_failed, found.n_recomputed, found.defects) == (N_SHAPES, 1, 2, ())
    said = run("check", path, "--sample", "0")
    assert said.exit_code == 0
    assert said.stdout == f"{path}: 5 shapes, 1 failed, 0 signatures computed again, 0 defects\n"


THIRD = "WHERE shape = (SELECT number FROM shapes WHERE id = '2')"


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


def test_rows_of_no_shape_are_removed(path: Path) -> None:
    stray = "INSERT INTO signatures SELECT 'own', 99, value FROM signatures LIMIT 1"
    execute(path, "INSERT INTO arrays (shape) VALUES (99)", stray)
    before = rows_of(path)
    found = run("check", path, "--sample", "0", "--json")
    assert found.exit_code == 1
    answer = json.loads(found.stdout)["result"]
    assert not answer["is_whole"]
    assert [defect["kind"] for defect in answer["defects"]] == ["orphan", "orphan"]
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


# --- backup ---------------------------------------------------------------------------------------------


WRITER = """
import sys
from dataclasses import replace
from pcretrieve import Catalogue

with Catalogue(sys.argv[1]) as store:
    (entry,) = store.entries(["2"])
    number = 0
    while True:
        number += 1
        pair = [
            replace(entry, record=replace(entry.record, id=f"{side}{number}", path=f"/{side}{number}"))
            for side in "ab"
        ]
        store.add(pair)
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
