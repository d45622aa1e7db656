"""A catalogue of an earlier version becomes one of this version, whole or not at all.

`version1.db` was made by pcretrieve 0.1.0 (commit 8dc65bd), and `version1.json` holds what that version read
of it: four meshes that were kept, a cloud that was made into two surfaces, and a file that cannot be read.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue
from pcretrieve.catalogue import Content, Record
from pcretrieve.catalogue.checksums import CHECKSUM_COLUMNS
from pcretrieve.catalogue.schema import SCHEMA_VERSION
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError, ShapeError
from pcretrieve.options import NUMBERS_VERSION
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import SignatureIndex
from pcretrieve.values import ModalSpectrum, Verdict

HERE = Path(__file__).parent
EXPECTED: dict[str, Any] = json.loads((HERE / "version1.json").read_text("utf-8"))

# Number of shapes of the catalogue whose migration is killed, and number of shapes before that.
MANY = 1000
KILLED_AFTER = 200


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The catalogue, as if its numbers were of the present version, since the layout alone is tested."""
    copy = Path(shutil.copy(HERE / "version1.db", tmp_path / "old.sqlite"))
    with closing(sqlite3.connect(copy)) as connection, connection:
        (options,) = connection.execute("SELECT value FROM meta WHERE key = 'options'").fetchone()
        numbers = {name: table for name, table in json.loads(options).items() if name != "signature"}
        made_by = json.dumps(numbers | {"numbers_version": NUMBERS_VERSION}, sort_keys=True)
        digest = hashlib.sha256(made_by.encode()).hexdigest()[:16]
        connection.execute("UPDATE meta SET value = ? WHERE key = 'digest'", (digest,))
    return copy


@pytest.fixture
def rows() -> dict[str, dict[str, Any]]:
    """The done rows of version 1 by id, read by themselves."""
    with closing(sqlite3.connect(f"{(HERE / 'version1.db').as_uri()}?mode=ro&immutable=1", uri=True)) as old:
        old.row_factory = sqlite3.Row
        found = old.execute("SELECT * FROM shapes WHERE status = 'done'").fetchall()
    archives = ("signature", "eigenvalues", "moments", "mesh")
    return {
        row["id"]: dict(row) | {name: np.load(io.BytesIO(row[name])) for name in archives} for row in found
    }


def version(path: Path) -> int:
    with closing(sqlite3.connect(path)) as connection:
        return int(connection.execute("PRAGMA user_version").fetchone()[0])


# --- what comes back ------------------------------------------------------------------------------------


def test_records_and_labels_are_those_of_before(path: Path) -> None:
    assert version(path) == 1
    with Catalogue(path) as store:
        records = json.loads(json.dumps([asdict(record) for record in store.records()]))
    assert records == [record | {"verdict": None, "stamp": None} for record in EXPECTED["records"]]
    assert version(path) == SCHEMA_VERSION


def drop(connection: sqlite3.Connection, *columns: str) -> None:
    for column in columns:
        connection.execute(f"ALTER TABLE shapes DROP COLUMN {column}")


def test_a_catalogue_of_version_3_gets_checksums(path: Path) -> None:
    with Catalogue(path) as store:
        before = store.records()
    with closing(sqlite3.connect(path)) as connection, connection:
        drop(connection, "stamp", *CHECKSUM_COLUMNS.values())
        connection.execute("DROP TABLE thumbnails")
        connection.execute("PRAGMA user_version = 3")
    with Catalogue(path) as store:
        assert store.records() == before
        assert store.defects() == []
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE provenance SET added = added || ' ' WHERE shape = 1")
    with Catalogue(path) as store:
        (found,) = store.defects()
        assert found.message == "its record has changed since it was stored"


def test_a_catalogue_of_version_4_gets_thumbnails(path: Path) -> None:
    with Catalogue(path) as store:
        before = store.records()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TABLE thumbnails")
        connection.execute("PRAGMA user_version = 4")
    with Catalogue(path) as store:
        assert store.records() == before
        assert store.defects() == []
        store.put(Record("new", "/new.ply", "a" * 64), Content(process(shapes.body()), np.ones(59), b"PNG"))
        assert store.thumbnail("new") == b"PNG"
        assert {store.thumbnail(record.id) for record in before} == {None}
    assert version(path) == SCHEMA_VERSION


def test_a_catalogue_of_version_2_gets_verdicts(path: Path) -> None:
    with Catalogue(path) as store:
        before = store.records()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP INDEX doubtful_shapes")
        drop(connection, "judgement", "uncertainty", "metres_per_unit", "stamp", *CHECKSUM_COLUMNS.values())
        columns = "shape, steps, options_digest, versions, added"
        connection.execute(f"CREATE TABLE earlier AS SELECT {columns} FROM provenance")
        connection.execute("DROP TABLE provenance")
        connection.execute("ALTER TABLE earlier RENAME TO provenance")
        connection.execute("DROP TABLE thumbnails")
        connection.execute("PRAGMA user_version = 2")
    with Catalogue(path) as store:
        assert store.records() == before
        assert {record.verdict for record in before} == {None}
        assert [record for page in store.pages(doubtful=True) for record in page] == []
        judged = replace(process(shapes.body()), verdict=Verdict("doubtful", 0.3, ("gaps: wide",)))
        stored = store.put(Record("new", "/new.ply", "hash"), Content(judged, np.ones(59)))
        assert stored.verdict == judged.verdict
        assert [record.id for page in store.pages(doubtful=True) for record in page] == ["new"]
    assert version(path) == SCHEMA_VERSION


def test_signatures_are_those_of_before_to_the_bit(path: Path) -> None:
    with Catalogue(path) as store:
        table = store.signatures()
    assert dict(zip(table.ids, table.values.tolist(), strict=True)) == EXPECTED["signatures"]
    assert table.labels == tuple(r["label"] for r in EXPECTED["records"] if r["status"] == "done")


def test_arrays_are_those_of_before_to_the_bit(path: Path, rows: dict[str, dict[str, Any]]) -> None:
    with Catalogue(path) as store:
        for shape_id, row in rows.items():
            shape = store.shape(shape_id, ("spectrum", "overlaps", "mesh"))
            np.testing.assert_array_equal(shape.mesh.vertices, row["mesh"]["vertices"])
            np.testing.assert_array_equal(shape.mesh.faces, row["mesh"]["faces"])
            assert shape.area == row["area"]
            for number, surface in enumerate(shape.surfaces):
                area = row["eigenvalues"]["areas"][number]
                given = ModalSpectrum(
                    row["eigenvalues"]["values"][number],
                    row["moments"]["values"][number],
                    area,
                    row["moments"]["overlaps"][number],
                ).scaled(1.0)
                assert surface.area == row["area"] * area
                assert surface.spectrum is not None
                for name in ("eigenvalues", "moments", "overlaps"):
                    np.testing.assert_array_equal(getattr(surface.spectrum, name), getattr(given, name))
    assert len(rows["cloud"]["eigenvalues"]["areas"]) == 2


@pytest.mark.parametrize("method", ["wks", "bihdm", "shape-dna"])
def test_other_descriptors_are_those_of_before(method: str, path: Path) -> None:
    with Catalogue(path) as store:
        table = store.signatures(store.options.changed(signature={"method": method}))
    for shape_id, values in zip(table.ids, table.values, strict=True):
        np.testing.assert_allclose(values, EXPECTED["described"][method][shape_id], rtol=1e-9)


def test_the_mesh_of_a_second_surface_is_gone(path: Path) -> None:
    """Version 1 did not keep it."""
    with (
        Catalogue(path) as store,
        pytest.raises(ShapeError, match=r"\[cloud / signature\] gone: the shape must hold its mesh"),
    ):
        store.signatures(store.options.changed(signature={"method": "hks-bow"}))


@pytest.mark.parametrize(
    "query", EXPECTED["queries"], ids=lambda query: f"{query['distance']} {query['whitening']}"
)
def test_queries_are_answered_as_before(query: dict[str, Any], path: Path) -> None:
    with Catalogue(path) as store:
        retrieval = {name: query[name] for name in ("distance", "whitening")}
        if query["whitening"] == "within-class":
            retrieval["shrinkage"] = 0.1  # which version 1 did not estimate
        # Version 1 compared values by area whatever the whitening.
        options = store.options.changed(retrieval=retrieval, signature={"scale": "area"})
        table = store.signatures(options)
        index = SignatureIndex(table, options.retrieval, whitening=store.whitening(options))
    found = index.query(table.values[table.ids.index("egg0")], 5)
    assert list(found.ids) == query["ids"]
    np.testing.assert_allclose(found.distances, query["distances"], rtol=1e-9, atol=1e-12)


def test_a_migrated_catalogue_can_be_written(path: Path) -> None:
    with Catalogue(path) as store:
        store.revise(labels={"/scans/cloud.xyz": "round"}, removed=["/scans/egg1.off"])
        store.remove("broken")
    with Catalogue(path) as store:
        table = store.signatures()
    assert dict(zip(table.ids, table.labels, strict=True)) == {
        "cloud": "round",
        "egg0": "round",
        "egg2": "long",
        "egg3": "long",
    }


def test_a_migrated_catalogue_takes_new_shapes(path: Path) -> None:
    """Shapes of before keep their overlaps, those of new shapes are computed from the mesh."""
    with Catalogue(path) as store:
        n_before = len(store)
        shape = process(shapes.ellipsoid((1, 1, 1.7), subdivisions=3), store.options)
        values = describe(shape, store.options.signature).values
        store.put(Record("new", "/scans/new.off", "new", steps=shape.provenance), Content(shape, values))
        assert [store.stored_bytes(name)["overlaps"] > 0 for name in ("egg0", "new")] == [True, False]
        by_overlaps = store.options.changed(signature={"method": "wks"})
        table = store.signatures(by_overlaps)
    assert len(table) == n_before + 1
    new = table.values[table.ids.index("new")]
    np.testing.assert_array_equal(new, describe(shape, by_overlaps.signature).values)


# --- whole or not at all --------------------------------------------------------------------------------


def many(path: Path) -> None:
    """Copy the shapes of a catalogue of version 1 until there are `MANY`."""
    with closing(sqlite3.connect(path)) as old, old:
        columns = [name for _, name, *_ in old.execute("PRAGMA table_info(shapes)")]
        copied = [f"{name} || '.' || ?" if name in ("id", "path") else name for name in columns]
        ids = [shape_id for (shape_id,) in old.execute("SELECT id FROM shapes")]
        query = f"INSERT INTO shapes SELECT {', '.join(copied)} FROM shapes WHERE id = ?"
        for number in range(len(ids), MANY):
            old.execute(query, (number, number, ids[number % len(ids)]))


def contents(path: Path, table: str) -> list[Any]:
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return connection.execute(f"SELECT * FROM {table} ORDER BY id").fetchall()


def test_killed_halfway_nothing_is_lost(path: Path) -> None:
    many(path)
    before = contents(path, "shapes")
    code = (
        "import logging, sys; logging.basicConfig(level=logging.INFO, stream=sys.stdout); "
        "from pcretrieve import Catalogue; Catalogue(sys.argv[1])"
    )
    with subprocess.Popen([sys.executable, "-c", code, path], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = next(line for line in process.stdout if f"rewritten: {KILLED_AFTER} of {MANY}" in line)
        process.kill()
    assert process.returncode == -signal.SIGKILL, said
    assert version(path) == 1
    assert contents(path, "shapes") == before
    with Catalogue(path) as store:
        assert len(store.records()) == MANY
        table = store.signatures()
    assert version(path) == SCHEMA_VERSION
    for shape_id, values in zip(table.ids, table.values.tolist(), strict=True):
        assert values == EXPECTED["signatures"][shape_id.partition(".")[0]]


def test_of_several_that_open_it_one_rewrites_it(path: Path) -> None:
    def ids(number: int) -> list[str]:
        with Catalogue(path) as store:
            return [record.id for record in store.records()]

    with ThreadPoolExecutor(4) as several:
        assert list(several.map(ids, range(4))) == [EXPECTED["ids"]] * 4


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        ("UPDATE meta SET value = '0123' WHERE key = 'digest'", "whose numbers differ"),
        ("UPDATE meta SET value = '{' WHERE key = 'options'", r"is damaged \(it has no readable options\)"),
        ("UPDATE shapes SET signature = NULL WHERE id = 'egg2'", r"is damaged \(the arrays of 'egg2'"),
        ("UPDATE shapes SET mesh = x'00' WHERE id = 'egg3'", r"is damaged \(the arrays of 'egg3'"),
    ],
)
def test_what_cannot_be_rewritten_is_left_as_it_is(damage: str, said: str, path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(damage)
    before = contents(path, "shapes")
    with pytest.raises(CatalogueError, match=said):
        Catalogue(path)
    assert version(path) == 1
    assert contents(path, "shapes") == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write every file")
def test_a_catalogue_that_cannot_be_written_is_an_error(path: Path) -> None:
    path.parent.chmod(0o500)
    try:
        with pytest.raises(CatalogueError, match=r"older pcretrieve \(schema 1\) and must be rewritten"):
            Catalogue(path)
    finally:
        path.parent.chmod(0o700)
