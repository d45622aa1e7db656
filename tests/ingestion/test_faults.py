"""Readers that do their worst to the process that they run in: each is one failed row, with words."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from packages import install

from pcretrieve.formats import write_mesh

PATIENCE = 300  # seconds
TIMEOUT = 10  # of a scan; seconds

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
    "loop": ("StageTimeout", "worker", f"not finished within {TIMEOUT} s: raise --timeout"),
    "loop_in_native_code": ("StageTimeout", "worker", f"not finished within {TIMEOUT} s: raise --timeout"),
    "stop": ("StageTimeout", "worker", f"not finished within {TIMEOUT} s: raise --timeout"),
    "fill_30_gib": ("MemoryExceeded", "read", "than --memory allows: raise that, or thin the scan"),
    "close_output": ("ScanReadError", "read", "after the deed close_output"),
    "close_everything": ("WorkerDied", "worker", "ended with exit code 1"),
    "flood": ("ScanReadError", "read", "after the deed flood"),
    "fork": ("ScanReadError", "read", "after the deed fork"),
    "be_speechless": ("UnexpectedError", "read", "Speechless: an exception without words"),
}


@pytest.mark.slow
def test_each_fault_is_one_row_with_words_and_the_batch_goes_on(tmp_path: Path) -> None:
    """Two good scans come first and last by their names, and vicious ones between them."""
    (tmp_path / "scans").mkdir()
    for name, length in (("a", 1.5), ("z", 2.0)):
        write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), tmp_path / "scans" / f"{name}.off")
    for deed in EXPECTED:
        (tmp_path / "scans" / f"{deed}.vicious").write_text(deed)
    with pytest.MonkeyPatch.context() as patch:
        entry_points = "[pcretrieve.readers]\n.vicious = vicious:read\n"
        install(tmp_path / "site", "vicious", {"vicious": VICIOUS}, entry_points, patch)
    command = [sys.executable, "-m", "pcretrieve", "ingest", "scans", "-c", "c.sqlite", "--json"]
    done = subprocess.run(
        [*command, "--workers", "2", "--timeout", f"{TIMEOUT}", "--memory", "1"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), *filter(None, sys.path)])},
        capture_output=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 3, done.stderr[-3000:].decode(errors="replace")
    answer = json.loads(done.stdout)["result"]
    assert answer["done"] == ["a", "z"]
    failed = {failure["id"]: failure for failure in answer["failed"]}
    assert failed.keys() == EXPECTED.keys()
    for deed, (error, stage, words) in EXPECTED.items():
        failure = failed[deed]
        assert (failure["error"], failure["stage"]) == (error, stage), failure["message"]
        assert words in failure["message"]
