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
N_TASKS = 3


def run(script: str, folder: Path, **variables: str) -> str:
    """Run a script that must succeed, with a command ``pcretrieve`` of this checkout; return its messages."""
    known = {
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    command, environment = ["bash", "-c", script], os.environ | known | variables
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stderr


@pytest.mark.slow
def test_slurm(tmp_path: Path) -> None:
    """With three tasks in place of ten; of eggs of which two have the same name, a copy, and no scan."""
    scans = tmp_path / "scans"
    for number in range(6):
        path = scans / f"part{number % 2}" / f"egg{number // 2}.off"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_mesh(shapes.ellipsoid((1, 1, 1.5 + number), subdivisions=2), path)
    (scans / "zcopy.off").write_bytes((scans / "part0" / "egg1.off").read_bytes())
    (scans / "bad.off").write_text("OFF\n")
    (tmp_path / "pcretrieve").write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -m pcretrieve "$@"\n'
    )
    (tmp_path / "pcretrieve").chmod(0o755)
    (script,) = re.findall(r"```slurm\n(.*?)```", DOCUMENT, re.DOTALL)
    script, n_replaced = re.subn(r"\bN=10\b", f"N={N_TASKS}", script)
    assert n_replaced == 1
    n_scans: list[int] = []
    for task in range(1, N_TASKS + 1):
        said = run(
            script, tmp_path, SLURM_ARRAY_TASK_ID=str(task), SLURM_CPUS_PER_TASK="1"
        )
        n_scans += map(int, re.findall(r"ingest: (\d) scans", said))
    assert sum(n_scans) == 8 > max(n_scans)
    (merge,) = re.findall(r"--wrap '(.*?)'", DOCUMENT)
    run(merge, tmp_path)
    ingest(scans, tmp_path / "whole.sqlite", workers=1)
    expected = everything(str(tmp_path / "whole.sqlite"))
    assert [row[0].status for row in expected.values()] == ["failed", *["done"] * 6]
    assert [*everything(str(tmp_path / "all.sqlite")).items()] == [*expected.items()]
