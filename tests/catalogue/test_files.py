"""A file that is no catalogue, not the one that was meant, or damaged, is told; repairs lose nothing else."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from sqlite3 import sqlite_version as VERSION
from tempfile import TemporaryDirectory

import pytest
import shapes
from commands import result, run
from processes import in_this_process, wait_for
from stored import content, failure

import pcretrieve as pr
from pcretrieve import Catalogue
from pcretrieve.catalogue.records import RECORDS, SCHEMA_VERSION, checksum
from pcretrieve.errors import CatalogueError
from pcretrieve.formats import read_scan, write_mesh
from pcretrieve.options import NUMBERS_VERSION
from pcretrieve.values import TriangleMesh

N_SHAPES = 5

# The user without rights, on Linux.
NOBODY = 65534


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some eggs, and a file that cannot be read."""
    scans = tmp_path_factory.mktemp("files") / "scans"
    scans.mkdir()
    for number in range(N_SHAPES):
        write_mesh(
            shapes.ellipsoid((1, 1.2, 1.5 + number / 5), subdivisions=3),
            scans / f"{number}.off",
        )
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
    pr.backup(original, tmp_path / "c.sqlite")
    return tmp_path / "c.sqlite"


def execute(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


# --- what is no catalogue, or not the one that was meant --------------------------------------------------


def test_what_is_no_catalogue_is_left_as_it_is(tmp_path: Path, original: Path) -> None:
    for name, data in (("byte", b"x"), ("scan.ply", b"ply\nformat ascii 1.0\n" * 100)):
        (tmp_path / name).write_bytes(data)
    for version in (0, 1, 99):
        mail = tmp_path / f"mail{version}.db"
        execute(mail, "CREATE TABLE meta (a TEXT)", f"PRAGMA user_version = {version}")
    for kind in (
        "TRIGGER a AFTER INSERT ON shapes BEGIN DELETE FROM meta; END",
        "VIEW a AS SELECT 1",
    ):
        execute(
            Path(shutil.copy(original, tmp_path / f"{kind[:4]}.sqlite")), f"CREATE {kind}"
        )
    words = {
        ".db": "is an SQLite file, but no catalogue",
        ".sqlite": "has the (trigger|view) 'a', which no",
    }
    for file in sorted(tmp_path.iterdir()):
        before = file.read_bytes()
        for create in (False, True):
            with pytest.raises(
                CatalogueError, match=words.get(file.suffix, "is not a catalogue: give")
            ):
                Catalogue(file, create=create)
            assert file.read_bytes() == before
    with pytest.raises(CatalogueError, match="is a folder: name a file for --catalogue"):
        Catalogue(tmp_path, create=True)
    with pytest.raises(
        CatalogueError, match=r"there is no folder .*nowhere to put a catalogue into"
    ):
        Catalogue(tmp_path / "nowhere" / "c.sqlite", create=True)


def test_catalogues_of_other_versions(path: Path, original: Path) -> None:
    """One with other numbers is still listed, shown and exported."""
    other = rf"another version of pcretrieve \(schema \d, this one knows {SCHEMA_VERSION}\): use that"
    setting = "UPDATE meta SET value = '{}' WHERE key = '{}_version'"
    for change, said in (
        (setting.format(SCHEMA_VERSION + 1, "schema"), other),
        (setting.format(SCHEMA_VERSION - 1, "schema"), other),
        ("DELETE FROM meta WHERE key = 'schema_version'", other),
        (
            "INSERT INTO meta VALUES ('schema_version', 'x')",
            r"is damaged \(it has no version\)",
        ),
        (setting.format(SCHEMA_VERSION, "schema"), ""),
        (
            setting.format(NUMBERS_VERSION + 1, "numbers"),
            rf"whose numbers differ \(version {NUMBERS_VERSION + 1} there, {NUMBERS_VERSION} here\)",
        ),
    ):
        execute(path, change)
        if said:
            with pytest.raises(CatalogueError, match=said):
                Catalogue(path)
    copy = path.with_name("egg2.off")
    for arguments in (("list",), ("show", "2"), ("catalogue", "export", "2", "-o", copy)):
        assert "2" in run(*arguments, "-c", path).output
    exported = read_scan(copy)
    assert isinstance(exported, TriangleMesh)
    with Catalogue(original) as whole:
        assert (exported.faces == whole.mesh("2").faces).all()


# --- files that are moved, removed or incomplete --------------------------------------------------------


def test_nothing_is_written_to_a_file_that_is_not_there_any_more(path: Path) -> None:
    said = r"was removed or replaced while it was in use: .* put the"
    with Catalogue(path) as store:
        other = Path(shutil.copy(path, path.with_name("copy.sqlite")))
        path.unlink()
        with pytest.raises(CatalogueError, match=said):
            store.put(failure("removed"))
        other.rename(path)
        with pytest.raises(CatalogueError, match=said):
            store.remove("2")


def test_computers_that_share_a_file_share_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On file systems of networks, and of FUSE, which may be such, there is a rollback journal."""
    device = tmp_path.stat().st_dev
    mounts = tmp_path / "mountinfo"
    monkeypatch.setattr("pcretrieve.catalogue.sqlite.MOUNTS", mounts)
    for kind, mode in {
        "ext4": "wal",
        "overlay": "wal",
        "nfs4": "delete",
        "fuse.sshfs": "delete",
    }.items():
        other = "21 27 0:0 / / rw - nfs server:/ rw\n"
        number = f"{os.major(device)}:{os.minor(device)}"
        mounts.write_text(
            f"{other}22 27 {number} / {tmp_path} rw - {kind} server:/scans rw\n"
        )
        with Catalogue(tmp_path / f"{kind}.sqlite", create=True) as store:
            assert store.rows.database.execute("PRAGMA journal_mode") == [(mode,)]


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """A folder in which this process, also that of root, may not write."""
    folder.chmod(0o555)
    user = os.geteuid()
    try:
        if user == 0:
            os.seteuid(NOBODY)
        yield
    finally:
        os.seteuid(user)
        folder.chmod(0o755)


def test_a_catalogue_that_may_not_be_written_can_be_read(original: Path) -> None:
    """Unless changes are in the log alone, as a killed process leaves them, which cannot be applied there."""
    with TemporaryDirectory(
        dir="/tmp"
    ) as place:  # that of pytest is closed to other users
        folder = Path(place)
        path = Path(shutil.copy(original, folder))
        path.chmod(0o644)
        with read_only(folder):
            with Catalogue(path) as reader:
                assert (len(reader), reader.mesh("2").euler_characteristic) == (
                    N_SHAPES,
                    2,
                )
                with pytest.raises(CatalogueError, match="cannot be written to"):
                    reader.remove("2")
            with pytest.raises(CatalogueError, match="cannot be written to"):
                Catalogue(path, create=True)
        with Catalogue(path) as store:
            store.put(failure("other"))
            for suffix in ("", "-wal"):
                shutil.copy(f"{path}{suffix}", folder / f"killed{suffix}")
        words = r"is incomplete without its last changes in killed-wal, .*: copy both files elsewhere"
        with read_only(folder), pytest.raises(CatalogueError, match=words):
            Catalogue(folder / "killed")


# Another process holds the lock of writers, or, as an older version might, one that others may share.
@pytest.mark.parametrize(
    "held", [fcntl.LOCK_EX, fcntl.LOCK_SH], ids=["exclusive", "shared"]
)
@pytest.mark.parametrize("change", ["remove", "scrub"])
def test_no_other_process_writes_while_one_ends_a_checkpoint(
    change: str, held: int, path: Path
) -> None:
    def write() -> None:
        with Catalogue(path) as other:
            if change == "remove":
                other.remove("2")
            else:
                other.rows.database.scrub()

    execute(path, "DELETE FROM arrays")
    before = path.stat().st_size
    with (
        Catalogue(path) as store,
        Path(f"{path}-wal").open("rb") as log,
        ThreadPoolExecutor(1) as thread,
    ):
        fcntl.flock(log, held)
        late = thread.submit(write)
        assert not wait_for(lambda: late.done() or store.get("2") is None, 0.3)
        fcntl.flock(log, fcntl.LOCK_UN)
        late.result()
        assert (store.get("2") is None) == (change == "remove")
    assert path.stat().st_size < before


def test_a_writer_shares_its_lock_with_nobody(path: Path) -> None:
    with Catalogue(path) as store, Path(f"{path}-wal").open("rb") as log:
        with store.rows.database.writing(), pytest.raises(BlockingIOError):
            fcntl.flock(log, fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(log, fcntl.LOCK_SH | fcntl.LOCK_NB)


def test_a_file_is_trusted_with_nothing_and_written_to_the_disk(path: Path) -> None:
    with Catalogue(path) as store:
        assert store.rows.database.execute("PRAGMA trusted_schema") == [(0,)]
        assert store.rows.database.execute("PRAGMA synchronous") == [(3,)]  # EXTRA


# --- damage ---------------------------------------------------------------------------------------------


def test_a_log_that_is_lost_is_told(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for log in (bytes(4152), b"garbage", b"7\x7f\x06\x82"):
        path.with_name(f"{path.name}-wal").write_bytes(log)
        with Catalogue(path) as store:
            assert len(store) == N_SHAPES
    said = "-wal is damaged (its header is wrong): what was stored last"
    assert [said in message for message in caplog.messages] == 3 * [True]


def flipped(column: str, position: int) -> str:
    return f"CAST(substr({column}, 1, {position}) || x'ff' || substr({column}, {position + 2}) AS BLOB)"


NOT_UTF8 = "UPDATE sqlite_master SET name = CAST(x'ce41' AS TEXT), sql = 'x' WHERE name = 'shapes'"
FLIPPED_SIGNATURE = f"UPDATE signatures SET value = {flipped('value', 20)}"
FLIPPED_MESH = f"UPDATE arrays SET meshes = {flipped('meshes', 2000)}"
# Half of the file, bytes in the place of all pages but the first, or statements.
DAMAGES: tuple[Callable[[bytes], bytes] | str, ...] = (
    lambda data: data[: len(data) // 2],
    lambda data: data[:4096] + b"\x55" * (len(data) - 4096),
    f"PRAGMA writable_schema = ON; {NOT_UTF8}",  # a name that SQLite quotes
    "DELETE FROM meta",
    "UPDATE meta SET value = '{' WHERE key = 'options'",
    "DELETE FROM meta WHERE key = 'revision'",
    "UPDATE provenance SET steps = '['",
    "DELETE FROM provenance",
    "UPDATE signatures SET value = substr(value, 1, length(value) / 2)",
    FLIPPED_SIGNATURE,
    FLIPPED_MESH,
    "UPDATE arrays SET meshes = spectra",
)


def test_damaged_bytes_are_an_error(original: Path, tmp_path: Path) -> None:
    for number, damage in enumerate(DAMAGES):
        path = Path(shutil.copy(original, tmp_path / f"{number}.sqlite"))
        if isinstance(damage, str):
            execute(path, *damage.split("; "))
        else:
            path.write_bytes(damage(path.read_bytes()))
        with pytest.raises(CatalogueError) as raised, Catalogue(path) as store:
            store.records()
            pr.signatures(store)
            store.mesh("2")
        assert re.search(
            r"is damaged \(.*\): restore a copy, or", str(raised.value), re.DOTALL
        ), damage


# --- checks and repairs ---------------------------------------------------------------------------------


def test_a_whole_catalogue_has_no_defects(path: Path) -> None:
    found = pr.check(path, sample=2, repair=True)
    assert (found.n_shapes, found.n_failed, found.n_recomputed, found.defects) == (
        N_SHAPES,
        1,
        2,
        (),
    )
    said = run("catalogue", "check", "-c", path, "--sample", 0).stdout
    assert (
        said
        == f"{path}: 5 shapes, 1 failed, 0 signatures computed again, 0 defects; SQLite {VERSION}\n"
    )


def test_a_number_that_is_no_number_any_more_is_damage(path: Path) -> None:
    execute(path, "UPDATE shapes SET area = 'est-' WHERE id = '2'")
    with pytest.raises(CatalogueError, match="is damaged "), Catalogue(path) as store:
        store.records()


THIRD = "WHERE shape = (SELECT number FROM shapes WHERE id = '2')"
LABEL = "a class that no other shape has"


@pytest.mark.parametrize("bit", [0, 7])  # the second one leaves bytes that are not UTF-8
def test_a_flipped_bit_of_a_record(
    bit: int, path: Path, folder: Path, original: Path, tmp_path: Path
) -> None:
    """Wherever it is, the shape is named, and ingested again after the repair."""
    with Catalogue(path) as store:
        store.rows.revise(labels={str(folder / "2.off"): LABEL})
    execute(
        path, f"UPDATE provenance SET versions = '{{\"versions of shape 2\": 1}}' {THIRD}"
    )
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.row_factory = sqlite3.Row
        (row,) = connection.execute(f"{RECORDS} WHERE id = '2'")
        connection.execute(
            "UPDATE shapes SET checksum = ? WHERE id = '2'", [checksum(dict(row))]
        )
    for number, text in enumerate(
        (LABEL, "/scans/2.off", "versions of shape 2", f"{LABEL}done", None)
    ):
        copy = tmp_path / f"{number}.sqlite"
        pr.backup(path, copy)
        if text is None:
            execute(copy, f"DELETE FROM provenance {THIRD}")
        else:
            changed = text[:-1].encode() + bytes([ord(text[-1]) ^ 1 << bit])
            copy.write_bytes(copy.read_bytes().replace(text.encode(), changed))
        with pytest.raises(CatalogueError, match="is damaged "), Catalogue(copy) as store:
            store.records()
        assert not pr.check(copy, sample=0).is_whole
        repaired = pr.check(copy, sample=0, repair=True)
        last_defect = repaired.defects[-1]
        assert (last_defect.shape_id, last_defect.repair) == (
            "2",
            "removed: ingest its file again",
        )
        assert repaired.is_whole
        again = pr.ingest(folder, copy, executor=in_this_process)
        assert [record.id for record in again.done] == ["2"]
        for mended, whole in zip(content(copy), content(original), strict=True):
            assert (mended[0].id, mended[0].path, *mended[1:]) == (
                whole[0].id,
                whole[0].path,
                *whole[1:],
            )


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (
            f"{FLIPPED_SIGNATURE} {THIRD}",
            "its signature cannot be read: its checksum does not fit",
        ),
        (
            f"{FLIPPED_MESH} {THIRD}",
            "its arrays cannot be read: its checksum does not fit",
        ),
        (f"DELETE FROM signatures {THIRD}", "its signature is missing"),
        (f"UPDATE arrays SET moments = NULL {THIRD}", "its moments are missing"),
    ],
)
def test_a_shape_with_damaged_arrays_is_processed_again(
    damage: str, said: str, path: Path, folder: Path, original: Path
) -> None:
    execute(path, damage)
    (defect,) = pr.check(path, sample=0, repair=True).defects
    assert (defect.shape_id, defect.message) == ("2", said)
    assert defect.repair == "removed: ingest its file again"
    again = pr.ingest(folder, path, executor=in_this_process)
    assert [record.id for record in again.done] == ["2"]
    assert [row[1:] for row in content(path)] == [row[1:] for row in content(original)]


def test_rows_of_no_shape_are_removed(path: Path) -> None:
    stray = "INSERT INTO signatures SELECT 'own', 99, value FROM signatures LIMIT 1"
    execute(path, "INSERT INTO arrays (shape) VALUES (99)", stray)
    before = content(path)
    found = result("catalogue", "check", "-c", path, "--sample", 0, code=1)
    assert not found["is_whole"]
    assert [defect["kind"] for defect in found["defects"]] == ["orphan", "orphan"]
    said = run("catalogue", "check", "-c", path, "--sample", 0, "--repair").stdout
    assert re.search("removed +1 rows of arrays are of no shape\n", said)
    assert pr.check(path, sample=0).defects == ()
    assert content(path) == before


def test_a_damaged_sql_index_is_made_again(path: Path) -> None:
    definition = "CREATE INDEX shapes_by_content ON shapes (label)"
    change = (
        f"UPDATE sqlite_master SET sql = '{definition}' WHERE name = 'shapes_by_content'"
    )
    execute(path, "PRAGMA writable_schema = ON", change)
    found = pr.check(path, sample=0, repair=True)
    assert {defect.kind for defect in found.defects} == {"database"}
    assert "missing from index shapes_by_content" in found.defects[0].message
    assert pr.check(path, sample=0).is_whole
