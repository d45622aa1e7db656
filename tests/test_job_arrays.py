"""The job array of docs/batches.md, run as it is written there, makes the catalogue of one ingest."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from stored import everything

from pcretrieve import ingest
from pcretrieve.formats import write_mesh

DOCUMENT = (Path(__file__).parents[1] / "docs" / "batches.md").read_text(encoding="utf-8")
N_TASKS = 2
PATIENCE = 120  # seconds


def run(script: str, folder: Path, **variables: str) -> str:
    """Run a script that must succeed, with a command ``pcretrieve`` of this checkout; return its messages."""
    known = {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        env=os.environ | known | variables,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stderr


@pytest.mark.slow
def test_slurm(tmp_path: Path) -> None:
    """With two tasks in place of ten; of three eggs and a file that cannot be read."""
    (tmp_path / "scans").mkdir()
    for number in range(3):
        egg = shapes.ellipsoid((1, 1, 1.5 + number), subdivisions=2)
        write_mesh(egg, tmp_path / "scans" / f"egg{number}.off")
    (tmp_path / "scans" / "bad.off").write_text("OFF\n")
    (tmp_path / "pcretrieve").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pcretrieve "$@"\n')
    (tmp_path / "pcretrieve").chmod(0o755)
    (script,) = re.findall(r"```slurm\n(.*?)```", DOCUMENT, re.DOTALL)
    script, n_replaced = re.subn(r"\bN=10\b", f"N={N_TASKS}", script)
    assert n_replaced == 1
    n_scans = []
    for task in range(1, N_TASKS + 1):
        said = run(script, tmp_path, SLURM_ARRAY_TASK_ID=str(task), SLURM_CPUS_PER_TASK="1")
        n_scans += re.findall(r"ingest: (\d) scans", said)
    assert sum(map(int, n_scans)) == 4
    (merge,) = re.findall(r"--wrap '(.*?)'", DOCUMENT)
    run(merge, tmp_path)
    ingest(tmp_path / "scans", tmp_path / "whole.sqlite", workers=1)
    expected = everything(str(tmp_path / "whole.sqlite"))
    assert [row[0].status for row in expected.values()] == ["failed", "done", "done", "done"]
    assert everything(str(tmp_path / "all.sqlite")) == expected
