"""Commands for one scan end with a message if the worker process crashes, hangs or lacks memory."""

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

from pcretrieve.formats import write_mesh

PATIENCE = 120  # seconds

pytestmark = pytest.mark.slow

# A reader of .vicious files, which does to its process what the file's name says.
VICIOUS = """
import ctypes, pathlib, time
import numpy as np

def read(path):
    return DEEDS[path.stem](path)

def crash(path):
    ctypes.string_at(0)

def hang(path):
    path.with_name("hangs").touch()
    time.sleep(1000)

def fill(path):
    return np.ones(1 << 29)

DEEDS = {name: deed for name, deed in globals().items() if callable(deed)}
"""

COMMANDS = {
    "reconstruct": ("reconstruct", "-o", "out.off"),
    "signature": ("signature",),
    "inspect": ("inspect", "-o", "out.html", "--rescans", "0"),
    "query": ("query", "-c", "eggs.sqlite"),
    "merge": ("merge", "egg.off", "-o", "out.ply"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of one egg, and vicious scans with the package that reads them."""
    place = tmp_path_factory.mktemp("limits")
    about = place / "site" / "vicious-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: vicious\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[pcretrieve.readers]\n.vicious = vicious:read\n")
    (place / "site" / "vicious.py").write_text(VICIOUS)
    for deed in ("crash", "hang", "fill"):
        (place / f"{deed}.vicious").write_text(deed)
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), place / "egg.off")
    done = run(place, "ingest", "egg.off", "-c", "eggs.sqlite")
    assert done.returncode == 0, done.stderr
    return place


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pcretrieve", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder / "site"), *filter(None, sys.path)])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    process = started(folder, *arguments)
    said, errors = process.communicate(timeout=PATIENCE)
    return subprocess.CompletedProcess(process.args, process.returncode, said, errors)


def test_a_crash_in_native_code_is_a_message(folder: Path) -> None:
    for command, words in COMMANDS.items():
        done = run(folder, *words, "crash.vicious")
        assert done.returncode == (3 if command == "signature" else 1)
        assert done.stderr.splitlines()[-1].startswith("failed: [" if command == "signature" else "Error: [")
        assert "the process that worked on it ended with SIGSEGV" in done.stderr
        assert "Traceback" not in done.stderr
        assert done.stdout == ""


def test_limits_can_be_given(folder: Path) -> None:
    late = run(folder, *COMMANDS["query"], "hang.vicious", "--timeout", "2")
    assert (late.returncode, late.stdout) == (1, "")
    assert "not finished within 2 s: raise --timeout" in late.stderr
    large = run(folder, *COMMANDS["signature"], "fill.vicious", "egg.off", "--memory", "1")
    assert large.returncode == 3
    assert "than --memory allows: raise that, or thin the scan" in large.stderr
    assert "egg.off\t" in large.stdout  # the scan after it has its signature


@pytest.fixture
def hanging(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A command whose worker hangs by now."""
    (folder / "hangs").unlink(missing_ok=True)
    process = started(folder, *COMMANDS["reconstruct"], "hang.vicious")
    ends = time.monotonic() + PATIENCE
    while not (folder / "hangs").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < ends
        time.sleep(0.05)
    yield process
    process.kill()
    process.communicate()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_command_and_its_worker(
    number: signal.Signals, code: int, hanging: subprocess.Popen[str]
) -> None:
    """Ctrl-C goes to the whole group, as the terminal sends it."""
    if number == signal.SIGINT:
        os.killpg(hanging.pid, number)
    else:
        hanging.send_signal(number)
    # The worker has inherited standard error: its pipe ends only when the worker has ended too.
    _, errors = hanging.communicate(timeout=PATIENCE)
    assert hanging.returncode == code
    assert "Traceback" not in errors
