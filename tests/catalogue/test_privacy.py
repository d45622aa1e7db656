"""What is removed is in no byte; who may read a catalogue; copies without names; links and pipes."""

from __future__ import annotations

import os
import shutil
import sqlite3
import stat
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import shapes
from commands import refusal, result, run
from processes import in_this_process

import pcretrieve as pr
from pcretrieve import Catalogue
from pcretrieve.catalogue import copies, records, sqlite
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.formats import write_mesh

N_SHAPES = 6
REMOVED = "anna-goes"
LABEL = "class of anna"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scans = tmp_path_factory.mktemp("people") / "scans"
    scans.mkdir()
    for number in range(N_SHAPES):
        name = REMOVED if number == 2 else f"ben-{number}"
        axes = (1, 1.2, 1.5 + number / 5)
        write_mesh(shapes.ellipsoid(axes, subdivisions=3), scans / f"{name}.off")
    (scans / "carl-fails.off").write_text("OFF\n")
    return scans


@pytest.fixture(scope="module")
def original(folder: Path) -> Path:
    path = folder.with_name("original.sqlite")
    labels = {f"{REMOVED}.off": LABEL, "ben-1.off": "class of ben"}
    pr.ingest(folder, path, labels=labels, executor=in_this_process)
    return path


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(original, tmp_path / "c.sqlite"))


def pieces(path: Path) -> list[bytes]:
    """What the file has of one shape alone: its names, and pieces of its mesh as they are stored."""
    with Catalogue(path) as store:
        (entry,) = store.rows.entries([REMOVED])
        others = [origin.id for origin in store.rows.origins() if origin.id != REMOVED]
        shared = b"".join(
            one.payloads.get("meshes", b"") for one in store.rows.entries(others)
        )
    mesh = entry.payloads["meshes"]
    parts = [mesh[at : at + 16] for at in range(0, len(mesh) - 16, 100)]
    own = [part for part in parts if part not in shared]
    assert len(own) > 30
    return [REMOVED.encode(), LABEL.encode(), entry.record.path.encode(), *own]


def found(wanted: list[bytes], *places: Path) -> int:
    """How many of some pieces are in files, and in the files of folders."""
    files = [one for place in places for one in ([place, *place.rglob("*")])]
    data = b"".join(file.read_bytes() for file in files if file.is_file())
    return sum(piece in data for piece in wanted)


def test_a_removed_shape_is_in_no_byte(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("pcretrieve.gallery.fitted.SMALLEST_KEPT", 1)
    wanted = pieces(path)
    log = path.with_name(f"{path.name}-wal")
    with Catalogue(path) as other:
        pr.index(other)
        # In the log.
        other.rows.revise(labels={other.record(REMOVED).path: f"{LABEL} and more"})
        assert found([REMOVED.encode()], tmp_path / "cache") == 1
        assert found(wanted, path, log) == len(wanted)
        said = run("remove", REMOVED, "-c", path).stderr
        pr.backup(other, tmp_path / "copy.sqlite")
        assert log.stat().st_size == 0
        assert found(wanted, path, log, tmp_path / "cache", tmp_path / "copy.sqlite") == 0
    assert "not removed: their 1 scans, and copies elsewhere" in said


def test_what_sqlite_leaves_in_its_pages_is_in_no_backup(
    path: Path, tmp_path: Path
) -> None:
    """Bytes of rows that were removed without secure_delete, as an SQLite that has it off does."""
    wanted = pieces(path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("PRAGMA secure_delete = OFF")
        for table in ("arrays", "provenance", "signatures"):
            connection.execute(
                f"DELETE FROM {table} WHERE shape = (SELECT number FROM shapes WHERE id = ?)",
                [REMOVED],
            )
        connection.execute("DELETE FROM shapes WHERE id = ?", [REMOVED])
    assert found(wanted, path) > len(wanted) / 2
    pr.backup(path, tmp_path / "copy.sqlite")
    assert found(wanted, tmp_path / "copy.sqlite") == 0
    with Catalogue(path) as store:
        assert store.rows.database.execute("PRAGMA secure_delete") == [(1,)]


def test_rows_that_are_replaced_are_overwritten(path: Path) -> None:
    """Where no `remove` writes the file again, secure_delete is what overwrites them."""
    wanted = pieces(path)[3:]
    with Catalogue(path) as store:
        store.rows.revise(removed=[store.record(REMOVED).path])
    assert found(wanted, path) == 0


def test_many_removals_leave_no_piece(tmp_path: Path) -> None:
    """SQLite leaves pieces of rows that it moved between pages, also with secure_delete."""
    path, rng = tmp_path / "many.sqlite", np.random.default_rng(0)
    names = [f"person-{number:05}-end" for number in rng.permutation(600)]
    entries = []
    for name in names:
        record = records.Record(
            name,
            f"/{'x' * int(rng.integers(300))}/{name}.ply",
            name,
            label=f"class of {name}",
        )
        spectra = name.encode() * int(rng.integers(5, 300))
        entries.append(
            records.Entry(record, {"own": name.encode() * 20}, {"spectra": spectra})
        )
    with Catalogue(path, create=True) as store:
        for start in range(0, len(entries), 20):
            store.rows.add(entries[start : start + 20])
        gone = names[::2]
        store.remove(*gone)
        assert len(store.rows.origins()) == 300
    assert found([name.encode() for name in gone], path) == 0


def test_what_another_reader_keeps_in_the_log_is_said(
    path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite, "LOCK_TIMEOUT", 0.1)
    with Catalogue(path) as store, closing(sqlite3.connect(path)) as reader:
        reader.execute("BEGIN")
        reader.execute("SELECT count(*) FROM shapes").fetchall()
        store.remove(REMOVED)
        reader.rollback()
    assert any("still has bytes of what was removed" in said for said in caplog.messages)


def test_remove_by_day(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        for number in range(1, 4):
            connection.execute(
                "UPDATE provenance SET added = ? WHERE shape = ?",
                [f"2026-01-0{number}T23:59:59+00:00", number],
            )
        connection.row_factory = sqlite3.Row
        for row in connection.execute(records.RECORDS).fetchall():
            total = records.checksum(dict(row))
            connection.execute(
                "UPDATE shapes SET checksum = ? WHERE number = ?", [total, row["number"]]
            )
    before = result("list", "-c", path)
    removed = result("remove", "--before", "2026-01-03", "-c", path)["removed"]
    assert len(removed) == 2
    assert {one["id"] for one in result("list", "-c", path)} == {
        one["id"] for one in before if one["added"] >= "2026-01-03"
    }
    assert result("remove", "--before", "2026-01-03", "-c", path)["removed"] == []
    assert "give the ids of shapes, or --before" in refusal("remove", "-c", path)
    assert "'x' does not match the format '%Y-%m-%d'" in refusal(
        "remove", "--before", "x", "-c", path
    )


# --- who may read it --------------------------------------------------------------------------------------


def rights(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_new_files_are_for_their_user_alone(path: Path, tmp_path: Path) -> None:
    umask = os.umask(0o022)
    try:
        with Catalogue(tmp_path / "new.sqlite", create=True) as store:
            store.rows.keep("digest", [])
            for suffix in ("", "-wal", "-shm"):
                assert rights(tmp_path / f"new.sqlite{suffix}") == 0o600
        for number, names in enumerate((True, False)):
            pr.backup(path, tmp_path / f"{number}.sqlite", names=names)
            assert rights(tmp_path / f"{number}.sqlite") == 0o600
        path.chmod(0o640)
        with Catalogue(path, create=True):
            assert rights(path) == 0o640
    finally:
        os.umask(umask)


def test_a_copy_without_names_answers_and_has_no_names(
    path: Path, folder: Path, tmp_path: Path
) -> None:
    with Catalogue(path) as store, store.rows.database.writing():
        store.rows.keep_setting("batch", "{'computer': 'of anna'}")
        store.rows.keep_setting("up", "z")
    pr.mark(path, [REMOVED], "rescan", "of anna: a foot is missing")
    whitening = tmp_path / "of-anna.whitening"
    options = {"retrieval": {"calibration": str(whitening)}}
    with closing(sqlite3.connect(path)) as connection, connection:
        own = pr.PipelineOptions.of(options).model_dump_json()
        connection.execute("UPDATE meta SET value = ? WHERE key = 'options'", [own])
    copy = tmp_path / "copy.sqlite"
    run("catalogue", "backup", path, copy, "--without-names")
    named = [
        b"foot",
        b"rescan",
        b"anna",
        b"ben",
        b"carl",
        b"class of",
        b".off",
        str(folder).encode(),
        b"batch",
    ]
    with Catalogue(path) as store:
        named += [record.content_hash.encode() for record in store.records()]
    assert found(named, copy) == 0
    with Catalogue(copy) as store:
        assert {record.id for record in store.records()} == {
            str(number) for number in range(1, N_SHAPES + 1)
        }
        assert {record.added for record in store.records()} == {""}
        assert store.rows.settings().get("up") == "z"
        assert store.options.retrieval.calibration is None
        first = pr.search(store, folder / f"{REMOVED}.off").neighbors.ids[0]
        with Catalogue(path) as whole:
            assert (store.mesh(first).vertices == whole.mesh(REMOVED).vertices).all()
    assert pr.check(copy, sample=0).is_whole
    # Two copies have the same paths, and no merge takes one person for another.
    run("catalogue", "backup", path, tmp_path / "second.sqlite", "--without-names")
    with pytest.raises(CatalogueError, match="has different contents"):
        pr.merge_catalogues(
            [copy, tmp_path / "second.sqlite"], tmp_path / "merged.sqlite"
        )


# --- links, pipes, and files that appear meanwhile --------------------------------------------------------


@pytest.mark.parametrize("suffix", ["", "-wal", "-shm", "-journal"])
@pytest.mark.parametrize("kind", ["pipe", "link"])
def test_pipes_and_links_are_not_opened(kind: str, suffix: str, path: Path) -> None:
    if kind == "link" and not suffix:
        pytest.skip("a catalogue may be named by a link")
    place = Path(f"{path}{suffix}")
    place.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(path.with_name("elsewhere"))
    for create in (False, True):
        with pytest.raises(
            CatalogueError, match="must be a file, and is a link, a pipe or"
        ):
            Catalogue(path, create=create)
    assert not path.with_name("elsewhere").exists()


def test_a_journal_of_somebody_else_deletes_no_file(path: Path, tmp_path: Path) -> None:
    """SQLite deletes the file that a journal names as the journal of several databases."""
    other = tmp_path / "precious"
    other.write_text("precious\n")
    name, magic = str(other).encode(), bytes.fromhex("d9d505f920a163d7")
    pages = path.stat().st_size // 4096
    header = (magic + struct.pack(">5I", 0, 1, pages, 512, 4096)).ljust(512, b"\0")
    end = struct.pack(">I", 0x40000000 // 4096 + 1) + name
    end += struct.pack(">2I", len(name), sum(name)) + magic
    Path(f"{path}-journal").write_bytes(header + end)
    with pytest.raises(
        CatalogueError, match="names another file, which SQLite would delete"
    ):
        Catalogue(path)
    assert other.read_text() == "precious\n"


@pytest.mark.parametrize("linked", [True, False])
def test_a_backup_replaces_no_file_that_appears_meanwhile(
    linked: bool, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, copy = tmp_path / "backup.sqlite", copies._copy_file

    def slow(source: Path, unfinished: Path) -> None:
        copy(source, unfinished)
        target.write_text("of another process")

    def without_links(*_: object) -> None:
        raise PermissionError("no links of files")

    monkeypatch.setattr(copies, "_copy_file", slow)
    if not linked:
        monkeypatch.setattr(os, "link", without_links)
    with pytest.raises(CatalogueError, match="exists: name a new file"):
        pr.backup(path, target)
    assert target.read_text() == "of another process"
    monkeypatch.undo()
    if not linked:
        monkeypatch.setattr(os, "link", without_links)
    target.unlink()
    target.symlink_to("nowhere")
    with pytest.raises(CatalogueError, match="exists: name a new file"):
        pr.backup(path, target)
    target.unlink()
    pr.backup(path, target)
    assert pr.check(target, sample=0).is_whole
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".backup-")]


def test_an_export_follows_no_links(path: Path, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "precious").write_text("precious\n")
    for name in ("precious", "nowhere"):
        link = tmp_path / "meshes" / f"{REMOVED}.ply"
        link.symlink_to(tmp_path / name)
        said = refusal("catalogue", "export", "-c", path, "-o", tmp_path / "meshes")
        assert "is a link, and what it leads to would be replaced" in said
        assert [one.name for one in (tmp_path / "meshes").iterdir()] == [link.name]
        link.unlink()
    assert (tmp_path / "precious").read_text() == "precious\n"
    run("catalogue", "export", "-c", path, "-o", tmp_path / "meshes")
    assert len([*(tmp_path / "meshes").iterdir()]) == N_SHAPES


def test_meshes_of_a_folder_follow_no_links(folder: Path, tmp_path: Path) -> None:
    (tmp_path / f"{REMOVED}.ply").symlink_to(tmp_path / "precious")
    with pytest.raises(InputError, match="is a link, and what it leads to"):
        [
            *pr.map_scans(
                pr.reconstruct, folder, output=tmp_path, suffix=".ply", kind="mesh"
            )
        ]
    assert not (tmp_path / "precious").exists()
