"""Commands for one scan end with a message if the worker process crashes, hangs or lacks memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from commands import program
from packages import install

from pcretrieve.formats import write_mesh

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
    with pytest.MonkeyPatch.context() as patch:
        reader = "[pcretrieve.readers]\n.vicious = vicious:read\n"
        install(place / "site", "vicious", {"vicious": VICIOUS}, reader, patch)
    for deed in ("crash", "hang", "fill"):
        (place / f"{deed}.vicious").write_text(deed)
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), place / "egg.off")
    run(place, "ingest", "egg.off", "-c", "eggs.sqlite")
    return place


def run(folder: Path, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run a command where the package of the vicious reader is installed."""
    path = os.pathsep.join([str(folder / "site"), *filter(None, sys.path)])
    return program(*words, cwd=folder, code=code, PYTHONPATH=path)


def test_a_crash_in_native_code_is_a_message(folder: Path) -> None:
    for command, words in COMMANDS.items():
        done = run(folder, *words, "crash.vicious", code=3 if command == "signature" else 1)
        assert done.stderr.splitlines()[-1].startswith("failed: [" if command == "signature" else "Error: [")
        assert "the process that worked on it ended with SIGSEGV" in done.stderr
        assert done.stdout == ""


def test_limits_can_be_given(folder: Path) -> None:
    late = run(folder, *COMMANDS["query"], "hang.vicious", "--timeout", "2", code=1)
    assert late.stdout == ""
    assert "not finished within 2 s: raise --timeout" in late.stderr
    large = run(folder, *COMMANDS["signature"], "fill.vicious", "egg.off", "--memory", "1", code=3)
    assert "than --memory allows: raise that, or thin the scan" in large.stderr
    assert "egg.off\t" in large.stdout  # the scan after it has its signature
