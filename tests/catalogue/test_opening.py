"""What is no catalogue, or not the one that was meant, is told apart and left as it was."""

from __future__ import annotations

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
from pcretrieve.catalogue import Content, Record
from pcretrieve.catalogue.tables import SCHEMA_VERSION
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError
from pcretrieve.formats import read_scan
from pcretrieve.pipeline.process import process
from pcretrieve.values import TriangleMesh

OPTIONS = PipelineOptions().changed(scan={"voxel": 0.005}, signature={"n_values": 15})


# The user without rights, on Linux.
NOBODY = 65534


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of one shape, with options of its own."""
    with Catalogue(tmp_path_factory.mktemp("ball") / "c.sqlite", OPTIONS, create=True) as store:
        shape = process(shapes.icosphere(3), OPTIONS)
        values = describe(shape, OPTIONS.signature).values
        store.put(Record("ball", "/ball.off", "hash"), Content(shape, values))
    return Path(store.location)


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(original, tmp_path / "c.sqlite"))


def execute(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def failure(name: str) -> Record:
    return Record(name, f"/{name}.ply", "", status="failed", stage="read", error="Bad", message="why")


# --- options --------------------------------------------------------------------------------------------


def test_of_several_that_make_one_catalogue_each_gets_the_same(tmp_path: Path) -> None:
    def voxel(number: int) -> float | str:
        with Catalogue(tmp_path / "new.sqlite", create=True) as store:
            store.put(failure(f"r{number}"))
            return store.options.scan.voxel

    with ThreadPoolExecutor(8) as several:
        assert len(set(several.map(voxel, range(8)))) == 1
    with Catalogue(tmp_path / "new.sqlite") as store:
        assert len(store.records()) == 8


# --- what is no catalogue -------------------------------------------------------------------------------


def test_what_is_no_catalogue_is_left_as_it_is(tmp_path: Path) -> None:
    for name, content in (("byte", b"x"), ("scan.ply", b"ply\nformat ascii 1.0\n" * 100)):
        (tmp_path / name).write_bytes(content)
    for version in (0, 1, 99):
        execute(
            tmp_path / f"mail{version}.db", "CREATE TABLE meta (a TEXT)", f"PRAGMA user_version = {version}"
        )
    for file in sorted(tmp_path.iterdir()):
        before = file.read_bytes()
        words = "is an SQLite file, but no catalogue" if file.suffix == ".db" else "is not a catalogue: give"
        for create in (False, True):
            with pytest.raises(CatalogueError, match=words):
                Catalogue(file, create=create)
            assert file.read_bytes() == before
    with pytest.raises(CatalogueError, match="is a folder: name a file for --catalogue"):
        Catalogue(tmp_path, create=True)
    with pytest.raises(CatalogueError, match="make one with `pcretrieve ingest`"):
        Catalogue(tmp_path / "c.sqlite")
    assert not (tmp_path / "c.sqlite").exists()
    with pytest.raises(CatalogueError, match=r"there is no folder .*nowhere to put a catalogue into"):
        Catalogue(tmp_path / "nowhere" / "c.sqlite", create=True)


def test_catalogues_of_other_versions(path: Path) -> None:
    newer = rf"newer pcretrieve \(schema {SCHEMA_VERSION + 1}, this one knows {SCHEMA_VERSION}\): upgrade"
    for change, said in (
        (f"UPDATE meta SET value = '{SCHEMA_VERSION + 1}' WHERE key = 'schema_version'", newer),
        (
            "UPDATE meta SET value = '5' WHERE key = 'schema_version'",
            "an older pcretrieve, .*: ingest into",
        ),
        ("DELETE FROM meta WHERE key = 'schema_version'", "by an older pcretrieve"),
        ("INSERT INTO meta VALUES ('schema_version', 'x')", r"is damaged \(it has no version\)"),
    ):
        execute(path, change)
        with pytest.raises(CatalogueError, match=said):
            Catalogue(path)


def test_numbers_of_another_version(path: Path) -> None:
    execute(path, "UPDATE meta SET value = '6' WHERE key = 'numbers_version'")
    with pytest.raises(CatalogueError, match=r"whose numbers differ \(version 6 there, 11 here\)"):
        Catalogue(path)
    with Catalogue(path, any_numbers=True) as stored:
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
            store.put(failure("other"))
        with pytest.raises(CatalogueError, match="was removed or replaced while it was in use"):
            store.remove("ball")


def test_changes_that_are_in_the_log_alone_are_not_left_out() -> None:
    """As a killed process leaves them, and where SQLite cannot apply them."""
    with TemporaryDirectory(dir="/tmp") as place:  # that of pytest is closed to other users
        folder = Path(place) / "folder"
        folder.mkdir()
        with Catalogue(Path(place) / "c.sqlite", create=True) as store:
            store.put(failure("other"))
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


def test_a_catalogue_that_may_not_be_written_can_be_read(original: Path) -> None:
    with TemporaryDirectory(dir="/tmp") as place:
        path = Path(shutil.copy(original, place))
        path.chmod(0o644)
        Path(place).chmod(0o555)
        user = os.geteuid()
        try:
            if user == 0:
                os.seteuid(NOBODY)
            with Catalogue(path) as reader:
                assert (len(reader), reader.mesh("ball").euler_characteristic) == (1, 2)
                with pytest.raises(CatalogueError, match="cannot be written to"):
                    reader.remove("ball")
            with pytest.raises(CatalogueError, match="cannot be written to"):
                Catalogue(path, create=True)
        finally:
            os.seteuid(user)
            Path(place).chmod(0o755)


# --- damage ---------------------------------------------------------------------------------------------


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def overwritten(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[4096:] = b"\x55" * (len(data) - 4096)
    path.write_bytes(data)


def flipped(column: str, position: int) -> str:
    return f"CAST(substr({column}, 1, {position}) || x'ff' || substr({column}, {position + 2}) AS BLOB)"


NOT_UTF8 = "UPDATE sqlite_master SET name = CAST(x'ce41' AS TEXT), sql = 'x' WHERE name = 'shapes'"
DAMAGES: dict[str, Callable[[Path], None] | tuple[str, ...]] = {
    "truncated": truncated,
    "overwritten": overwritten,
    "a name that SQLite quotes and that is not UTF-8": ("PRAGMA writable_schema = ON", NOT_UTF8),
    "no options": ("DELETE FROM meta",),
    "options that are no JSON": ("UPDATE meta SET value = '{' WHERE key = 'options'",),
    "options that are a list": ("UPDATE meta SET value = '[]' WHERE key = 'options'",),
    "other steps": ("UPDATE provenance SET steps = '['",),
    "no provenance": ("DELETE FROM provenance",),
    "half a signature": ("UPDATE signatures SET value = substr(value, 1, length(value) / 2)",),
    "a signature with a flipped byte": (f"UPDATE signatures SET value = {flipped('value', 20)}",),
    "no name of its state": ("DELETE FROM meta WHERE key = 'revision'",),
    "bytes for a mesh": ("UPDATE arrays SET meshes = x'00112233'",),
    "half a mesh": ("UPDATE arrays SET meshes = substr(meshes, 1, length(meshes) / 2)",),
    "a mesh with a flipped byte": (f"UPDATE arrays SET meshes = {flipped('meshes', 2000)}",),
    "eigenvalues for a mesh": ("UPDATE arrays SET meshes = spectra",),
}


def test_damaged_bytes_are_an_error(original: Path, tmp_path: Path) -> None:
    for number, (name, damage) in enumerate(DAMAGES.items()):
        path = Path(shutil.copy(original, tmp_path / f"{number}.sqlite"))
        if isinstance(damage, tuple):
            execute(path, *damage)
        else:
            damage(path)
        with pytest.raises(CatalogueError) as raised, Catalogue(path) as store:
            store.records()
            store.signatures()
            store.mesh("ball")
        assert "is damaged (" in str(raised.value), name
        assert "): restore a copy, or" in str(raised.value), name
