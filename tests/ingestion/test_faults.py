"""Readers that do their worst to the process that they run in: each is one failed row, with words."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
import shapes
from commands import program
from packages import install

from pcretrieve import Catalogue, ingest
from pcretrieve.formats import write_mesh

TIMEOUT = 10  # of a scan; seconds

# A reader of .vicious files, which does to its process what the file's name says.
VICIOUS = """
import contextlib, ctypes, os, signal, sys
import numpy as np
from pcretrieve.errors import ScanReadError
from pcretrieve.formats import Format

def read(path, name=None):
    DEEDS[path.stem]()
    raise ScanReadError(f"after the deed {path.stem}")

def crash():
    ctypes.string_at(0)

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
    with contextlib.suppress(OSError, ValueError):  # closed by the file before, in the same process
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

# Also when the file is only looked into for the names of its scans.
FORMAT = Format(read, names=read)
DEEDS = {name: deed for name, deed in globals().items() if callable(deed)}
"""

# The error, the stage, and words of the message.
EXPECTED = {
    "crash": ("WorkerDied", "worker", "ended with SIGSEGV"),
    "stop": (
        "StageTimeout",
        "worker",
        f"not finished within {TIMEOUT} s: raise --timeout",
    ),
    "fill_30_gib": (
        "MemoryExceeded",
        "read",
        "than --memory allows: raise that, or thin the scan",
    ),
    "close_output": ("ScanReadError", "read", "after the deed close_output"),
    "close_everything": ("WorkerDied", "worker", "ended with exit code 1"),
    "flood": ("ScanReadError", "read", "after the deed flood"),
    "fork": ("ScanReadError", "read", "after the deed fork"),
    "be_speechless": (
        "UnexpectedError",
        "read",
        "Speechless: an exception without words",
    ),
}


@pytest.mark.slow
def test_each_fault_is_one_row_with_words_and_the_batch_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two good scans come first and last by their names, and vicious ones between them."""
    (tmp_path / "scans").mkdir()
    for name, length in (("a", 1.5), ("z", 2.0)):
        write_mesh(
            shapes.ellipsoid((1, 1, length), subdivisions=3),
            tmp_path / "scans" / f"{name}.off",
        )
    for deed in EXPECTED:
        (tmp_path / "scans" / f"{deed}.vicious").write_text(deed)
    entry_points = "[pcretrieve.readers]\n.vicious = vicious:FORMAT\n"
    install(tmp_path / "site", "vicious", {"vicious": VICIOUS}, entry_points, monkeypatch)
    limits = ("--workers", 2, "--timeout", TIMEOUT, "--memory", 1)
    path = os.pathsep.join(filter(None, sys.path))
    command = ("ingest", "scans", "-c", "c.sqlite", "--json", *limits)
    done = program(*command, cwd=tmp_path, code=3, PYTHONPATH=path)
    answer = json.loads(done.stdout)["result"]
    assert answer["done"] == ["a", "z"]
    failed = {failure["id"]: failure for failure in answer["failed"]}
    assert failed.keys() == EXPECTED.keys()
    for deed, (error, stage, words) in EXPECTED.items():
        failure = failed[deed]
        assert (failure["error"], failure["stage"]) == (error, stage), failure["message"]
        assert words in failure["message"]


# A reader whose process ends at the first attempts: as often as the name of the file says. Each attempt of an
# ingest is in up to two processes, because the executor tries a scan again whose worker has ended.
FRAIL = """
import os, pathlib
from pcretrieve.formats import RawScan, read_scan

def read(path):
    tally = path.with_suffix(".tally")
    number = int(tally.read_text()) if tally.exists() else 0
    tally.write_text(str(number + 1))
    if number < int(path.stem.partition("-")[2]):
        os._exit(7)
    egg = read_scan(path.with_name("egg.off"))
    return RawScan(egg.vertices, faces=egg.faces)
"""


@pytest.mark.slow
def test_a_retry_stores_the_shape_and_says_what_was_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    entry = "[pcretrieve.readers]\n.frail = frail:read\n"
    install(tmp_path / "site", "frail", {"frail": FRAIL}, entry, monkeypatch)
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "egg.off")
    for n_failing in (2, 4, 9):
        (tmp_path / f"egg-{n_failing}.frail").write_text(f"content {n_failing}")
    summary = ingest([tmp_path / "*.frail"], tmp_path / "c.sqlite", retries=2, workers=2)
    assert [
        (record.id, record.message) for record in summary.failed if record.id != "egg-9"
    ] == []
    assert sorted(record.id for record in summary.done) == ["egg-2", "egg-4"]
    with Catalogue(tmp_path / "c.sqlite") as catalogue:
        tried = {record.id: record.steps[-1] for record in catalogue.records()}
    assert {name: step.stage for name, step in tried.items()} == dict.fromkeys(
        tried, "retry"
    )
    attempts = {name: step.sizes["attempts"] for name, step in tried.items()}
    assert attempts == {"egg-2": 2, "egg-4": 3, "egg-9": 3}
    first, second = tried["egg-4"].notes
    assert "exit code 7" in first
    assert first.endswith("tried again in a new process")
    assert second.endswith(
        "surface.reconstructions = 1 instead of 2, with surface.cell = 0.006 instead of auto"
    )
    assert sum("egg-4.frail: WorkerDied" in message for message in caplog.messages) == 2
