"""The job arrays of docs/batches.md, run as they are written there, make the catalogue of one ingest."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import shapes

from pcretrieve import Catalogue, ingest
from pcretrieve.formats import write_mesh

DOCUMENT = (Path(__file__).parents[1] / "docs" / "batches.md").read_text(encoding="utf-8")
N_TASKS = 2
PATIENCE = 120  # seconds

Rows = list[tuple[str, str, str, dict[str, bytes]]]


def example(language: str) -> str:
    """An example of the document, with two tasks instead of ten, and one worker instead of four."""
    ((text),) = re.findall(rf"```{language}\n(.*?)```", DOCUMENT, re.DOTALL)
    text, n_replaced = re.subn(r"\b([Nn] ?= ?)10\b", rf"\g<1>{N_TASKS}", text)
    assert n_replaced == 1
    return str(re.sub(r"((--workers|threads:) )4\b", r"\g<1>1", text))


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three eggs and a file that cannot be read."""
    folder = tmp_path_factory.mktemp("job_arrays") / "scans"
    folder.mkdir()
    for number in range(3):
        write_mesh(shapes.ellipsoid((1, 1, 1.5 + number), subdivisions=2), folder / f"egg{number}.off")
    (folder / "bad.off").write_text("OFF\n")
    return folder


def rows(catalogue: Path) -> Rows:
    """Id, status, content and signatures of each scan."""
    with Catalogue(catalogue) as stored:
        return [
            (entry.record.id, entry.record.status, entry.record.content_hash, dict(entry.signatures))
            for entry in stored.entries([origin.id for origin in stored.origins()])
        ]


@pytest.fixture(scope="module")
def expected(scans: Path) -> Rows:
    ingest(scans, scans.parent / "whole.sqlite", workers=1)
    found = rows(scans.parent / "whole.sqlite")
    assert [status for _, status, _, _ in found] == ["failed", "done", "done", "done"]
    return found


@pytest.fixture
def folder(scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the scans, and a command ``pcretrieve`` of this checkout."""
    (tmp_path / "scans").symlink_to(scans)
    command = tmp_path / "bin" / "pcretrieve"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pcretrieve "$@"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{command.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    return tmp_path


def run(arguments: list[str], place: Path, **variables: str) -> str:
    """Run a command that must succeed, and return what it printed on standard error."""
    done = subprocess.run(
        arguments,
        cwd=place,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stderr


@pytest.mark.slow
def test_slurm(folder: Path, expected: Rows) -> None:
    n_scans = []
    for task in range(1, N_TASKS + 1):
        said = run(
            ["bash", "-c", example("slurm")], folder, SLURM_ARRAY_TASK_ID=str(task), SLURM_CPUS_PER_TASK="1"
        )
        n_scans += re.findall(r"ingest: (\d) scans", said)
    assert sum(map(int, n_scans)) == len(expected)
    (merge,) = re.findall(r"--wrap '(.*?)'", DOCUMENT)
    run(["bash", "-c", merge], folder)
    assert rows(folder / "all.sqlite") == expected
