"""Readers that do their worst to the process that they run in: each is one failed row, with words."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import shapes
from packages import install

from pcretrieve.formats import write_mesh

PATIENCE = 300  # seconds

# A reader of .vicious files, which does to its process what the file's name says.
VICIOUS = """
import ctypes, itertools, os, signal, sys, time
import numpy as np
from pcretrieve.errors import ScanReadError

def read(path):
    DEEDS[path.stem]()
    raise ScanReadError(f"after the deed {path.stem}")

def crash():
    ctypes.string_at(0)

def abort():
    os.abort()

def alarm():
    signal.alarm(1)
    time.sleep(1000)

def loop():
    while True:
        pass

def loop_in_native_code():
    all(itertools.repeat(1))

def stop():
    os.kill(os.getpid(), signal.SIGSTOP)

def fill_30_gib():
    return [np.ones(1 << 27) for _ in range(30)]

def close_output():
    sys.stdout.close()
    sys.stderr.close()
    os.close(1)
    os.close(2)

def close_everything():
    os.closerange(0, 256)

def flood():
    for _ in range(200):
        os.write(1, 100_000 * b"x" + b"\\n")
        print("y" * 1000)

def fork():
    os.fork()

class Speechless(BaseException):
    def __str__(self):
        raise ValueError("no words")

def be_speechless():
    raise Speechless

DEEDS = {name: deed for name, deed in globals().items() if callable(deed)}
"""

# The error, the stage, and words of the message.
EXPECTED = {
    "crash": ("WorkerDied", "worker", "ended with SIGSEGV"),
    "abort": ("WorkerDied", "worker", "ended with SIGABRT"),
    "alarm": ("WorkerDied", "worker", "ended with SIGALRM"),
    "loop": ("StageTimeout", "worker", "not finished within 5 s: raise --timeout"),
    "loop_in_native_code": ("StageTimeout", "worker", "not finished within 5 s: raise --timeout"),
    "stop": ("StageTimeout", "worker", "not finished within 5 s: raise --timeout"),
    "fill_30_gib": ("MemoryExceeded", "read", "than --memory allows: raise that, or thin the scan"),
    "close_output": ("ScanReadError", "read", "after the deed close_output"),
    "close_everything": ("WorkerDied", "worker", "ended with exit code 1"),
    "flood": ("ScanReadError", "read", "after the deed flood"),
    "fork": ("ScanReadError", "read", "after the deed fork"),
    "be_speechless": ("UnexpectedError", "read", "Speechless: an exception without words"),
}


def ingested(folder: Path, environment: Mapping[str, str]) -> dict[str, Any]:
    """Ingest the scans of a folder with the package beside them; the JSON document."""
    command = [sys.executable, "-m", "pcretrieve", "ingest", "scans", "-c", "c.sqlite", "--json"]
    path = os.pathsep.join([str(folder / "site"), *filter(None, sys.path)])
    done = subprocess.run(
        [*command, "--workers", "2", "--timeout", "5", "--memory", "1"],
        cwd=folder,
        env={**os.environ, **environment, "PYTHONPATH": path},
        capture_output=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 3, done.stderr[-3000:].decode(errors="replace")
    answer: dict[str, Any] = json.loads(done.stdout)["result"]
    return answer


def write_scans(folder: Path, deeds: tuple[str, ...]) -> None:
    """Two good scans, which come first and last by their names, and vicious ones between them."""
    (folder / "scans").mkdir()
    for name, length in (("a", 1.5), ("z", 2.0)):
        write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), folder / "scans" / f"{name}.off")
    for deed in deeds:
        (folder / "scans" / f"{deed}.vicious").write_text(deed)
    with pytest.MonkeyPatch.context() as patch:
        entry_points = "[pcretrieve.readers]\n.vicious = vicious:read\n"
        install(folder / "site", "vicious", {"vicious": VICIOUS}, entry_points, patch)


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One ingest of all of them."""
    folder = tmp_path_factory.mktemp("faults")
    write_scans(folder, (*EXPECTED,))
    return ingested(folder, {})


@pytest.mark.slow
def test_the_batch_goes_on(answer: dict[str, Any]) -> None:
    assert answer["done"] == ["a", "z"]
    assert sorted(failure["id"] for failure in answer["failed"]) == sorted(EXPECTED)


@pytest.mark.slow
@pytest.mark.parametrize("deed", EXPECTED)
def test_each_fault_is_one_row_with_words(deed: str, answer: dict[str, Any]) -> None:
    error, stage, words = EXPECTED[deed]
    (failure,) = (failure for failure in answer["failed"] if failure["id"] == deed)
    assert (failure["error"], failure["stage"]) == (error, stage), failure["message"]
    assert words in failure["message"]
