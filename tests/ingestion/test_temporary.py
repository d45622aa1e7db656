"""Temporary files of workers are gone when the worker has ended, or after the next start."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
import shapes

from pcretrieve.errors import StageTimeout, WorkerDied
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.isolation import Isolation

PATIENCE = 60  # seconds

# A program whose worker writes a temporary file, from a child process too, and then sleeps.
SLEEPER = """
import os, subprocess, tempfile, time
from pathlib import Path
from pcretrieve.ingestion.isolation import Isolation

def write_and_sleep(seconds):
    tempfile.mkstemp()
    subprocess.run(["mktemp"], check=True)
    Path({mark!r}).touch()
    time.sleep(seconds)

if __name__ == "__main__":
    Isolation().call(write_and_sleep, {seconds})
"""


def write_and_die(folder: Path) -> None:
    tempfile.mkstemp()
    (folder / "written").write_text(os.environ["TMPDIR"])
    os.kill(os.getpid(), signal.SIGKILL)


def write_and_sleep(folder: Path) -> None:
    tempfile.mkstemp()
    (folder / "written").write_text(tempfile.gettempdir())
    time.sleep(1000)


@pytest.mark.parametrize(("deed", "error"), [(write_and_die, WorkerDied), (write_and_sleep, StageTimeout)])
def test_a_worker_that_is_killed_leaves_no_file(
    deed: object, error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(error):
        Isolation(timeout=5).call(deed, tmp_path)  # type: ignore[arg-type]
    assert (tmp_path / "written").read_text().startswith(f"{tmp_path}/pcretrieve-worker-")
    assert [path.name for path in tmp_path.iterdir()] == ["written"]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "tmp").mkdir()
    path = os.pathsep.join(filter(None, sys.path))
    return {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "PYTHONPATH": path}


def sleeper(folder: Path, name: str, seconds: float, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    """A running program of its own process group, whose worker has written its files, if it is to sleep."""
    mark = folder / f"{name}.mark"
    (folder / f"{name}.py").write_text(SLEEPER.format(mark=str(mark), seconds=seconds))
    command = [sys.executable, str(folder / f"{name}.py")]
    running = subprocess.Popen(command, env=environment, start_new_session=True)
    end = time.monotonic() + PATIENCE
    while not mark.exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert mark.exists()
    return running


def test_what_a_killed_process_group_left_is_removed_by_the_next_start(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    """And what a running one has written is not."""
    killed = sleeper(tmp_path, "killed", 1000, environment)
    (left,) = (tmp_path / "tmp").iterdir()
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait(PATIENCE)
    assert len([*left.iterdir()]) == 2
    running = sleeper(tmp_path, "running", 1000, environment)
    try:
        assert not left.exists()
        (present,) = (tmp_path / "tmp").iterdir()
        assert sleeper(tmp_path, "next", 0, environment).wait(PATIENCE) == 0
        assert len([*present.iterdir()]) == 2
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait(PATIENCE)


def test_an_ingest_with_nothing_left_to_do_removes_them_too(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    (tmp_path / "scans").mkdir()
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=2), tmp_path / "scans" / "egg.off")
    command = [sys.executable, "-m", "pcretrieve", "ingest", "scans", "-c", "c.sqlite", "-q"]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=PATIENCE)
    left = tmp_path / "tmp" / "pcretrieve-worker-abandoned"
    left.mkdir()
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=PATIENCE)
    assert not left.exists()
