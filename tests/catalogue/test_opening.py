"""What is no catalogue, or not the one that was meant, is told apart and left as it was."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import shapes
from click.testing import CliRunner

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.catalogue import Content, Record, stored_shapes
from pcretrieve.catalogue.schema import SCHEMA_VERSION
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError
from pcretrieve.formats import read_scan
from pcretrieve.pipeline.process import process
from pcretrieve.values import TriangleMesh

OPTIONS = PipelineOptions().changed(scan={"voxel": 0.005}, signature={"n_values": 15})


# The user without rights, on Linux.
NOBODY = 65534


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A catalogue of one shape, with options of its own."""
    with Catalogue(tmp_path / "c.sqlite", OPTIONS, create=True) as store:
        shape = process(shapes.icosphere(3), OPTIONS)
        values = describe(shape, OPTIONS.signature).values
        store.put(Record("ball", "/ball.off", "hash"), Content(shape, values))
    return Path(store.location)


def execute(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


# --- options --------------------------------------------------------------------------------------------


def test_a_catalogue_has_the_options_it_was_built_with(path: Path) -> None:
    with Catalogue(path) as own, Catalogue(path, OPTIONS, create=True) as same:
        assert own.options == same.options == OPTIONS


def test_other_options_are_named(path: Path) -> None:
    with pytest.raises(CatalogueError) as raised:
        Catalogue(path, PipelineOptions(), create=True)
    assert raised.value.message == (
        f"{path} was built with other options: scan.voxel: 0.005 there, 'auto' here; signature.n_values: 15 "
        "there, 59 here. Ingest into a new catalogue, or leave the options out to use its own"
    )


def test_a_new_catalogue_gets_the_defaults(tmp_path: Path) -> None:
    with Catalogue(tmp_path / "new.sqlite", create=True) as store:
        assert store.options == PipelineOptions()


def test_of_several_that_make_one_catalogue_each_gets_the_same(tmp_path: Path) -> None:
    def voxel(number: int) -> float | str:
        with Catalogue(tmp_path / "new.sqlite", create=True) as store:
            store.put(Record(f"r{number}", f"/r{number}", "", status="failed"))
            return store.options.scan.voxel

    with ThreadPoolExecutor(8) as several:
        assert len(set(several.map(voxel, range(8)))) == 1
    with Catalogue(tmp_path / "new.sqlite") as store:
        assert len(store.records()) == 8


# --- what is no catalogue -------------------------------------------------------------------------------


def test_a_folder(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match="is a folder: name a file for --catalogue"):
        Catalogue(tmp_path, create=True)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match="make one with `pcretrieve ingest`"):
        Catalogue(tmp_path / "c.sqlite")
    assert not list(tmp_path.iterdir())


def test_no_folder_to_put_it_into(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match=r"there is no folder .*nowhere to put a catalogue into"):
        Catalogue(tmp_path / "nowhere" / "c.sqlite", create=True)


def test_an_empty_file_is_none_yet(tmp_path: Path) -> None:
    (tmp_path / "c.sqlite").touch()
    with pytest.raises(CatalogueError, match="there is no catalogue"):
        Catalogue(tmp_path / "c.sqlite")
    assert not (tmp_path / "c.sqlite").stat().st_size
    with Catalogue(tmp_path / "c.sqlite", create=True) as store:
        assert len(store) == 0


@pytest.mark.parametrize("content", [b"x", b"ply\nformat ascii 1.0\n" * 100], ids=["a byte", "a scan"])
@pytest.mark.parametrize("create", [False, True])
def test_a_file_of_another_kind_is_left_as_it_is(create: bool, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "scan.ply").write_bytes(content)
    before = (tmp_path / "scan.ply").read_bytes()
    with pytest.raises(CatalogueError, match="is not a catalogue: give another --catalogue"):
        Catalogue(tmp_path / "scan.ply", create=create)
    assert (tmp_path / "scan.ply").read_bytes() == before


@pytest.mark.parametrize("create", [False, True])
@pytest.mark.parametrize("version", [0, 1, 99])
def test_a_database_of_another_program_is_left_as_it_is(create: bool, version: int, tmp_path: Path) -> None:
    execute(tmp_path / "mail.db", "CREATE TABLE meta (mail TEXT)", f"PRAGMA user_version = {version}")
    before = (tmp_path / "mail.db").read_bytes()
    with pytest.raises(CatalogueError, match="is an SQLite file, but no catalogue"):
        Catalogue(tmp_path / "mail.db", create=create)
    assert (tmp_path / "mail.db").read_bytes() == before


def test_a_newer_catalogue(path: Path) -> None:
    execute(path, f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    said = rf"newer pcretrieve \(schema {SCHEMA_VERSION + 1}, this one knows {SCHEMA_VERSION}\): upgrade"
    with pytest.raises(CatalogueError, match=said):
        Catalogue(path)


def test_options_of_a_version_that_had_fewer_of_them(path: Path) -> None:
    """What is new has its default, which gives the numbers of before."""
    stored = OPTIONS.model_dump(exclude={"retrieval": True, "surface": {"bridge", "max_faces"}})
    execute(path, f"UPDATE meta SET value = '{json.dumps(stored)}' WHERE key = 'options'")
    with Catalogue(path, OPTIONS) as store:
        assert store.options == OPTIONS


def test_options_of_a_version_that_had_more_of_them(path: Path) -> None:
    options = json.dumps({"surface": {"fairness": 3}})
    execute(path, f"UPDATE meta SET value = '{options}' WHERE key = 'options'")
    with pytest.raises(CatalogueError, match="was built by a pcretrieve with other options"):
        Catalogue(path)


def test_numbers_of_another_version(path: Path) -> None:
    execute(path, "UPDATE meta SET value = '6' WHERE key = 'numbers_version'")
    with pytest.raises(CatalogueError, match=r"whose numbers differ \(version 6 there, 11 here\)"):
        Catalogue(path)
    with stored_shapes(path) as stored:
        assert [record.id for record in stored.records()] == ["ball"]
        mesh = stored.mesh("ball")
    copy = path.with_name("ball.off")
    for arguments in (["list"], ["show", "ball"], ["export", "ball", "-o", str(copy)]):
        done = CliRunner().invoke(cli, [*arguments, "-c", str(path)])
        assert done.exit_code == 0, done.output
        assert "ball" in done.output
    exported = read_scan(copy)
    assert isinstance(exported, TriangleMesh)
    assert (exported.faces == mesh.faces).all()


# --- files that are moved, removed or incomplete --------------------------------------------------------


@pytest.mark.parametrize("how", ["removed", "replaced"])
def test_nothing_is_written_to_a_file_that_is_not_there_any_more(how: str, path: Path) -> None:
    with Catalogue(path) as store:
        other = shutil.copy(path, path.with_name("copy.sqlite"))
        path.unlink()
        if how == "replaced":
            Path(other).rename(path)
        with pytest.raises(CatalogueError, match=r"was removed or replaced while it was in use: .* put the"):
            store.put(Record("other", "/other.off", "hash", status="failed"))
        with pytest.raises(CatalogueError, match="was removed or replaced while it was in use"):
            store.remove("ball")


def test_changes_that_are_in_the_log_alone_are_not_left_out() -> None:
    """As a killed process leaves them, and where SQLite cannot apply them."""
    with TemporaryDirectory(dir="/tmp") as place:  # that of pytest is closed to other users
        folder = Path(place) / "folder"
        folder.mkdir()
        with Catalogue(Path(place) / "c.sqlite", create=True) as store:
            store.put(Record("other", "/other.off", "hash", status="failed"))
            for suffix in ("", "-wal"):
                shutil.copy(f"{store.location}{suffix}", folder)
        Path(place).chmod(0o755)
        folder.chmod(0o555)
        user = os.geteuid()
        try:
            if user == 0:
                os.seteuid(NOBODY)
            words = r"is incomplete without its last changes in c\.sqlite-wal, .*: copy both files elsewhere"
            with pytest.raises(CatalogueError, match=words):
                Catalogue(folder / "c.sqlite")
        finally:
            os.seteuid(user)
            folder.chmod(0o755)


# --- damage ---------------------------------------------------------------------------------------------


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def overwritten(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[4096:] = b"\x55" * (len(data) - 4096)
    path.write_bytes(data)


def half(column: str) -> str:
    return f"substr({column}, 1, length({column}) / 2)"


def flipped(column: str, position: int) -> str:
    return f"CAST(substr({column}, 1, {position}) || x'ff' || substr({column}, {position + 2}) AS BLOB)"


DAMAGES: dict[str, Callable[[Path], None]] = {
    "truncated": truncated,
    "overwritten": overwritten,
    "a name that SQLite quotes and that is not UTF-8": lambda path: execute(
        path,
        "PRAGMA writable_schema = ON",
        "UPDATE sqlite_master SET name = CAST(x'ce41' AS TEXT), sql = 'x' WHERE name = 'shapes'",
    ),
    "no options": lambda path: execute(path, "DELETE FROM meta"),
    "options that are no JSON": lambda path: execute(
        path, "UPDATE meta SET value = '{' WHERE key = 'options'"
    ),
    "options that are a list": lambda path: execute(
        path, "UPDATE meta SET value = '[]' WHERE key = 'options'"
    ),
    "steps that are no JSON": lambda path: execute(path, "UPDATE provenance SET steps = '['"),
    "steps of another kind": lambda path: execute(path, "UPDATE provenance SET steps = '[{\"cat\": 1}]'"),
    "no provenance": lambda path: execute(path, "DELETE FROM provenance"),
    "half a signature": lambda path: execute(path, f"UPDATE signatures SET value = {half('value')}"),
    "a signature with a flipped byte": lambda path: execute(
        path, f"UPDATE signatures SET value = {flipped('value', 20)}"
    ),
    "no name of its state": lambda path: execute(path, "DELETE FROM meta WHERE key = 'revision'"),
    "bytes for a mesh": lambda path: execute(path, "UPDATE meshes SET arrays = x'00112233'"),
    "half a mesh": lambda path: execute(path, f"UPDATE meshes SET arrays = {half('arrays')}"),
    "a mesh with a flipped byte": lambda path: execute(
        path, f"UPDATE meshes SET arrays = {flipped('arrays', 2000)}"
    ),
    "eigenvalues for a mesh": lambda path: execute(
        path, "UPDATE meshes SET arrays = (SELECT arrays FROM spectra)"
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_bytes_are_an_error(damage: str, path: Path) -> None:
    DAMAGES[damage](path)
    with pytest.raises(CatalogueError, match=r"is damaged \(.*\): restore a copy, or ingest into a new"):  # noqa: SIM117
        with Catalogue(path) as store:
            store.records()
            store.signatures()
            store.mesh("ball")
