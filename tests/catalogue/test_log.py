"""Damage to a write-ahead log is told; what killed processes and restarts leave in it is no damage."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from stored import failure

import pcretrieve as pr
from pcretrieve import Catalogue
from pcretrieve.catalogue.log import log_fault

N_COMMITS = 20

# A message, so that records take several pages.
LONG = "why" * 500

# Bytes of a frame with a page.
FRAME = 24 + 4096


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue most of which is in its log."""
    path = tmp_path_factory.mktemp("log") / "c.sqlite"
    with Catalogue(path, create=True) as store:
        for number in range(N_COMMITS):
            store.put(failure(f"n{number}", message=LONG))
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", path.with_name(f"copy{suffix}"))
    return path.with_name("copy")


@pytest.fixture
def path(logged: Path, tmp_path: Path) -> Iterator[Path]:
    for suffix in ("", "-wal"):
        shutil.copy(f"{logged}{suffix}", tmp_path / f"c.sqlite{suffix}")
    yield tmp_path / "c.sqlite"


def log_of(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def flip(log: Path, at: int, bit: int = 0) -> None:
    data = bytearray(log.read_bytes())
    data[at] ^= 1 << bit
    log.write_bytes(data)


def test_a_whole_log_has_no_fault(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with Catalogue(path) as store:
        assert store.rows.failures() == {("read", "Bad"): N_COMMITS}
    assert not caplog.messages


@pytest.mark.parametrize("damage", ["flip", "cut"])
def test_commits_that_are_lost_are_defects(
    damage: str, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log = log_of(path)
    if damage == "flip":
        flip(log, log.stat().st_size // 2)
    else:
        os.truncate(log, log.stat().st_size - 2048)
    found = pr.check(path, sample=0)
    assert found.n_failed < N_COMMITS
    (defect,) = found.defects
    assert (defect.kind, defect.repair) == ("log", None)
    assert not found.is_whole
    assert f"{log} is damaged (" in defect.message
    assert defect.message in caplog.messages


def test_a_flipped_bit_is_seen_wherever_it_is(path: Path) -> None:
    rng = np.random.default_rng(0)
    log = log_of(path)
    # Also in the header of the last commit, and in its last byte.
    size = log.stat().st_size
    places = [*range(32), *range(size - FRAME, size - FRAME + 24), size - 1]
    for at in places + rng.integers(32, size, 60).tolist():
        bit = int(rng.integers(8))
        flip(log, at, bit)
        assert log_fault(log) is not None, (at, bit)
        flip(log, at, bit)
    assert log_fault(log) is None


def test_a_log_that_ends_between_two_writes_is_no_fault(path: Path) -> None:
    """As that of a killed process: at any frame, or after the header of one."""
    log = log_of(path)
    data = log.read_bytes()
    for n_frames in range((len(data) - 32) // FRAME):
        for n_more in (0, 24):
            log.write_bytes(data[: 32 + n_frames * FRAME + n_more])
            assert log_fault(log) is None, (n_frames, n_more)


def test_a_lost_sector_of_the_last_transaction_is_no_fault(path: Path) -> None:
    """Of a transaction that was not synced when the power failed, and so was not reported as stored."""
    log = log_of(path)
    data = log.read_bytes()
    last_header = len(data) - FRAME
    for start in range(-(-last_header // 512) * 512, len(data) - 512, 512):
        if data[start : start + 512].strip(b"\0"):
            log.write_bytes(data[:start] + bytes(512) + data[start + 512 :])
            assert log_fault(log) is None, start
            break


def test_old_frames_after_a_restart_are_no_fault(tmp_path: Path) -> None:
    path = tmp_path / "c.sqlite"
    with Catalogue(path, create=True) as store:
        for number in range(N_COMMITS):
            store.put(failure(f"n{number}", message=LONG))
        log = log_of(path)
        size = log.stat().st_size
        store.rows.database.execute("PRAGMA wal_checkpoint(RESTART)")
        store.put(failure(f"n{N_COMMITS}", message=LONG))
        assert log.stat().st_size == size  # most of it is old
        assert log_fault(log) is None
        flip(log, 32 + 24 + 100)
        assert log_fault(log) is not None
        flip(log, size - 100)  # in an old frame
        flip(log, 32 + 24 + 100)
        assert log_fault(log) is None


WRITER = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("PRAGMA journal_mode = WAL")
connection.execute("PRAGMA cache_size = 5")
connection.execute("CREATE TABLE IF NOT EXISTS a (b)")
print("ready", flush=True)
while True:
    connection.execute("BEGIN")
    for _ in range(30):
        connection.execute("INSERT INTO a VALUES (randomblob(3000))")
    connection.execute("COMMIT")
"""


def test_what_killed_writers_leave_is_no_fault(tmp_path: Path) -> None:
    """Transactions that are larger than the memory of SQLite, which so writes them in parts."""
    path = tmp_path / "killed"
    for turn in range(8):
        command = [sys.executable, "-c", WRITER, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(0.02 * turn)
            writer.send_signal(signal.SIGKILL)
        assert log_fault(log_of(path)) is None
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


@pytest.mark.parametrize("size", [512, 65536])
def test_logs_of_other_sizes_of_pages(size: int, tmp_path: Path) -> None:
    path = tmp_path / "pages"
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute(f"PRAGMA page_size = {size}")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE a (b)")
        for _ in range(100):
            connection.execute("INSERT INTO a VALUES (randomblob(100))")
        log = log_of(path)
        assert log_fault(log) is None
        flip(log, log.stat().st_size // 2)
        assert log_fault(log) is not None
