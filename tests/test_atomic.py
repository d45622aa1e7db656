"""A file that is written is whole, or as it was before."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pcretrieve import Catalogue, backup
from pcretrieve.catalogue import Record, cache
from pcretrieve.errors import InputError
from pcretrieve.values.files import write_file

IMPORTS = "from pathlib import Path\nfrom pcretrieve.values.files import write_file\n"


def python(script: str, folder: Path) -> str:
    known = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", script]
    return subprocess.check_output(command, cwd=folder, env=known, text=True, timeout=60)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# The second is as long as the system allows.
@pytest.mark.parametrize("name", ["a", "x" * 255])
def test_a_file_is_replaced_and_has_the_permissions_of_a_new_one(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "other").touch()
    (tmp_path / name).write_text("old")
    write_file(tmp_path / name, b"new")
    assert (tmp_path / name).read_bytes() == b"new"
    assert (tmp_path / name).stat().st_mode == (tmp_path / "other").stat().st_mode
    assert names(tmp_path) == sorted([name, "other"])


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder/a")
    for content in (b"first", b"second"):
        write_file(tmp_path / "link", content)
        assert (tmp_path / "folder" / "a").read_bytes() == content
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "folder") == ["a"]


def test_a_device_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    write_file(Path(os.devnull), b"into nowhere")
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)
    assert (
        python(f"{IMPORTS}write_file(Path('/dev/stdout'), b'a page')", tmp_path)
        == "a page"
    )


@pytest.mark.parametrize("name", ["nowhere/a", "file/a", "folder", "x" * 256])
def test_what_cannot_be_written_leaves_nothing(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("old")
    with pytest.raises(
        InputError, match=f"cannot write .*{name}: .*; name a file in a folder"
    ):
        write_file(tmp_path / name, b"content")
    assert names(tmp_path) == ["file", "folder"]


FULL = f"""{IMPORTS}
import resource, signal
from pcretrieve.errors import InputError

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_file(Path("a"), b"x" * 5000)
except InputError as error:
    print(error.message)
"""


def test_a_disk_without_room_keeps_the_old_content(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    assert python(FULL, tmp_path).startswith("cannot write a: File too large;")
    assert (tmp_path / "a").read_text() == "old"
    assert names(tmp_path) == ["a"]


# --- the power may fail -----------------------------------------------------------------------------------


class Synced:
    """Calls of `os.fsync`, which still reach the disk, and what they had reached when a file was renamed.

    renamed: the new name of each renamed file or folder.
    lost: the names of renamed files, or files in a renamed folder, which a power cut could leave incomplete.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.renamed: list[str] = []
        self.lost: list[str] = []
        self._sizes: dict[int, int] = {}  # by inode
        self._fsync = os.fsync
        patch.setattr(os, "fsync", self._synced)
        for name in ("rename", "replace", "link"):
            patch.setattr(os, name, partial(self._renamed, getattr(os, name)))

    def _synced(self, descriptor: int) -> None:
        self._fsync(descriptor)
        found = os.fstat(descriptor)
        self._sizes[found.st_ino] = found.st_size

    def _renamed(self, rename: Callable[..., None], old: Path, new: Path) -> None:
        for path in (Path(old), *Path(old).rglob("*")):
            found = path.stat()
            if path.is_file() and self._sizes.get(found.st_ino) != found.st_size:
                self.lost.append(path.name)
        self.renamed.append(Path(new).name)
        rename(old, new)


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> Synced:
    return Synced(monkeypatch)


def test_a_file_reaches_the_disk_before_it_has_its_name(
    synced: Synced, tmp_path: Path
) -> None:
    for data in (b"a", b"x" * 5_000_000):
        write_file(tmp_path / "page.html", data)
    assert (synced.renamed, synced.lost) == (2 * ["page.html"], [])


def test_a_backup_reaches_the_disk_before_it_has_its_name(
    synced: Synced, tmp_path: Path
) -> None:
    with Catalogue(tmp_path / "c.sqlite", create=True) as store:
        store.put(
            Record(
                "a", "/a.ply", "", status="failed", stage="read", error="Bad", message=""
            )
        )
        backup(store, tmp_path / "copy.sqlite")
    assert (synced.renamed, synced.lost) == (["copy.sqlite"], [])


def test_an_index_reaches_the_disk_before_it_has_its_name(
    synced: Synced, tmp_path: Path
) -> None:
    cache._write(tmp_path, "index", {"large": np.zeros(100_000), "small": np.zeros(1)})
    # An index whose checksums are incomplete is computed again.
    assert (synced.renamed, synced.lost) == (["index"], [cache.CHECKSUMS])
