"""Ctrl-C during an ingest: once ends it in good order, twice ends it at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import shapes
from packages import install
from processes import PATIENCE, living, wait_for

from pcretrieve import Catalogue
from pcretrieve.formats import write_mesh

# A reader that never ends.
MODULE = """
import time

def read(path):
    path.with_suffix(".read").touch()
    time.sleep(1000)
"""
ENTRY_POINTS = "[pcretrieve.readers]\n.endless = endless:read\n"

pytestmark = pytest.mark.slow


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good scan, and one that takes for ever."""
    with pytest.MonkeyPatch.context() as patch:
        install(tmp_path / "site", "endless", {"endless": MODULE}, ENTRY_POINTS, patch)
    (tmp_path / "scans").mkdir()
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "scans" / "egg.off")
    (tmp_path / "scans" / "view.endless").write_text("has no end")
    return tmp_path


@pytest.fixture
def ingest(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """An ingest that has stored the good scan, and reads the other one."""
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "pcretrieve", "ingest", "scans", "-c", "c.sqlite"),
            *("--workers", "2"),
        ],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder / "site"), *filter(None, sys.path)])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert wait_for(lambda: (folder / "scans" / "view.read").exists() and ids(folder) == ["egg"])
        yield process
    finally:
        for pid in living(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.communicate()


def ids(folder: Path) -> list[str]:
    with Catalogue(folder / "c.sqlite") as store:
        return [record.id for record in store.records()]


def interrupt(process: subprocess.Popen[str]) -> None:
    """What the terminal does at Ctrl-C: the signal goes to all processes."""
    os.killpg(process.pid, signal.SIGINT)


def test_once_ends_it_in_good_order(ingest: subprocess.Popen[str], folder: Path) -> None:
    interrupt(ingest)
    _, said = ingest.communicate(timeout=PATIENCE)
    assert ingest.returncode == 130
    assert "stopped; 1 shapes are in c.sqlite, and the same command goes on from there" in said
    assert "Traceback" not in said
    assert wait_for(lambda: not living(ingest.pid))
    assert ids(folder) == ["egg"]
    assert not list(folder.glob("c.sqlite-*"))


def test_workers_end_with_a_process_that_is_killed(ingest: subprocess.Popen[str], folder: Path) -> None:
    """Also one that reads for ever."""
    ingest.kill()
    assert wait_for(lambda: not living(ingest.pid))
    assert ids(folder) == ["egg"]


def test_twice_ends_it_at_once(ingest: subprocess.Popen[str], folder: Path) -> None:
    interrupt(ingest)
    while ingest.poll() is None:
        time.sleep(0.2)
        interrupt(ingest)
    _, said = ingest.communicate(timeout=PATIENCE)
    assert ingest.returncode in (130, -signal.SIGINT)
    assert "Traceback" not in said
    assert wait_for(lambda: not living(ingest.pid))
    assert ids(folder) == ["egg"]
