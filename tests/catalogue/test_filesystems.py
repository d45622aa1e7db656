"""On file systems of a network, SQLite has a rollback journal, or only reads; elsewhere a write-ahead log."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from pcretrieve.catalogue import Catalogue, Record, filesystems
from pcretrieve.catalogue.filesystems import Mount, journal_of, mount_of
from pcretrieve.errors import CatalogueError

N_PUT = 40


def mounted(kind: str, options: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let a folder be one on which another file system is mounted; the table of what is mounted."""
    table = folder / "mountinfo"
    place = str(folder).replace(" ", "\\040")
    table.write_text(
        "22 27 0:21 / / rw,relatime - ext4 /dev/vda rw\n"
        f"23 22 0:50 / {place} rw,relatime shared:2 - {kind} server:/scans rw,{options}\n"
    )
    monkeypatch.setattr(filesystems, "MOUNTS", table)
    return table


def journal(path: Path) -> str:
    with closing(sqlite3.connect(path)) as connection:
        ((mode,),) = connection.execute("PRAGMA journal_mode")
        return str(mode)


def failure(name: str) -> Record:
    return Record(name, f"/{name}.ply", "", status="failed", stage="read", error="Bad", message="why")


# --- detection ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "options", "expected"),
    [
        ("ext4", "rw", "WAL"),
        ("tmpfs", "rw", "WAL"),
        ("", "", "WAL"),
        ("fuse.fuse-overlayfs", "rw", "WAL"),
        ("nfs4", "vers=4.2,local_lock=none", "DELETE"),
        ("nfs", "vers=3,local_lock=none", "DELETE"),
        ("nfs", "vers=3,nolock,local_lock=all", None),
        ("lustre", "rw,flock", "DELETE"),
        ("lustre", "rw,localflock", None),
        ("lustre", "rw", None),
        ("gpfs", "rw", "DELETE"),
        ("cifs", "rw", "DELETE"),
        ("cifs", "rw,nobrl", None),
        ("fuse.sshfs", "rw", None),
        ("fuse", "rw", "DELETE"),
        ("fuse.unheard-of", "rw", "DELETE"),
    ],
)
def test_the_journal_by_the_file_system(kind: str, options: str, expected: str | None) -> None:
    assert journal_of(Mount(kind, frozenset(options.split(",")))) == expected


def test_the_file_system_of_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "a folder"
    folder.mkdir()
    mounted("nfs4", "local_lock=none", folder, monkeypatch)
    assert mount_of(folder / "c.sqlite").kind == "nfs4"
    assert "local_lock=none" in mount_of(folder / "c.sqlite").options
    assert mount_of(tmp_path / "a folder beside").kind == "ext4"
    (tmp_path / "link").symlink_to(folder)
    assert mount_of(tmp_path / "link" / "c.sqlite").kind == "nfs4"
    monkeypatch.setattr(filesystems, "MOUNTS", tmp_path / "none")
    assert mount_of(folder).kind == ""


MOUNTED = """
import sys
from pathlib import Path
from pcretrieve.catalogue import Catalogue
from pcretrieve.catalogue.filesystems import mount_of
path = Path(sys.argv[1], "c.sqlite")
Catalogue(path, create=True).close()
with path.open("rb") as file:
    print(mount_of(path).kind, file.read(20)[18])
"""


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("mount -t tmpfs none {folder}/there", "tmpfs 2"),
        ("bindfs {folder}/here {folder}/there", "fuse 1"),
    ],
)
def test_file_systems_that_are_really_mounted(command: str, expected: str, tmp_path: Path) -> None:
    """In a namespace of mounts; a file of version 1 has a rollback journal, of version 2 a log."""
    if shutil.which(command.split()[0]) is None or shutil.which("unshare") is None:
        pytest.skip(f"{command.split()[0]} and unshare are not both installed")
    if os.geteuid() != 0:
        pytest.skip("only root mounts file systems")
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    mount = command.format(folder=tmp_path)
    script = f'{mount} && "$0" -c "$1" {tmp_path}/there; result=$?; umount {tmp_path}/there; exit $result'
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", script, sys.executable, MOUNTED],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    if done.returncode and not Path("/dev/fuse").exists():
        pytest.skip("this system has no FUSE")
    assert done.stdout.strip() == expected, done.stderr


# --- the journal ----------------------------------------------------------------------------------------


def test_a_new_catalogue_of_a_network_has_a_rollback_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mounted("nfs4", "local_lock=none", tmp_path, monkeypatch)
    with Catalogue(tmp_path / "c.sqlite", create=True) as store:
        store.put(failure("a"))
        assert not list(tmp_path.glob("c.sqlite-*"))
        assert journal(tmp_path / "c.sqlite") == "delete"


def test_a_catalogue_that_was_copied_to_a_network_loses_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.sqlite"
    with Catalogue(path, create=True) as store:
        store.put(failure("a"))
        assert journal(path) == "wal"
        for file in tmp_path.glob("c.sqlite*"):  # with the changes that are in the log alone
            shutil.copy(file, tmp_path / file.name.replace("c.", "d."))
    mounted("nfs4", "local_lock=none", tmp_path, monkeypatch)
    with Catalogue(tmp_path / "d.sqlite") as store, Catalogue(tmp_path / "d.sqlite") as other:
        store.put(failure("b"))
        assert [record.id for record in other.records()] == ["a", "b"]
    assert journal(tmp_path / "d.sqlite") == "delete"


WRITER = """
import sys
from pathlib import Path
from pcretrieve.catalogue import Catalogue, Record, filesystems
filesystems.MOUNTS = Path(sys.argv[2])
with Catalogue(sys.argv[1], create=True) as store:
    for number in range(int(sys.argv[4])):
        name = f"{sys.argv[3]}{number}"
        store.put(Record(name, f"/{name}.ply", "", status="failed", stage="read", error="E", message="why"))
        store.records()
"""


def test_two_writers_take_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = mounted("nfs4", "local_lock=none", tmp_path, monkeypatch)
    command = [sys.executable, "-c", WRITER, str(tmp_path / "c.sqlite"), str(table)]
    writers = [subprocess.Popen([*command, name, str(N_PUT)]) for name in "ab"]
    assert [writer.wait(100) for writer in writers] == [0, 0]
    with Catalogue(tmp_path / "c.sqlite") as store:
        assert len(store.records()) == 2 * N_PUT
        assert store.defects() == []
    assert journal(tmp_path / "c.sqlite") == "delete"


def test_without_locks_a_catalogue_is_only_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c.sqlite"
    with Catalogue(path, create=True) as store:
        store.put(failure("a"))
    before = path.read_bytes()
    mounted("fuse.sshfs", "rw", tmp_path, monkeypatch)
    for new in (path, tmp_path / "new.sqlite"):
        with pytest.raises(CatalogueError, match=r"type fuse\.sshfs, whose locks other computers do not see"):
            Catalogue(new, create=True)
    assert not (tmp_path / "new.sqlite").exists()
    with Catalogue(path) as store:
        assert [record.id for record in store.records()] == ["a"]
        with pytest.raises(CatalogueError, match="cannot be written to"):
            store.put(failure("b"))
    assert path.read_bytes() == before
