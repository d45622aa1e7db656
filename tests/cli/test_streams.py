"""Standard streams that are closed, or on a full disk: what is done does not depend on what is printed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import shapes

from pcretrieve.formats import write_mesh

FULL = Path("/dev/full")  # a device without space
needs_full = pytest.mark.skipif(not FULL.exists(), reason="needs a device without space, /dev/full")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """One good scan, and one that fails."""
    (tmp_path / "scans").mkdir()
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "scans" / "egg.off")
    (tmp_path / "scans" / "flat.xyz").write_text("1 2 3\n" * 200)
    return tmp_path


def run(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a command with redirections by the shell."""
    program = f"{sys.executable} -m pcretrieve {command}"
    return subprocess.run(
        ["/bin/sh", "-c", program], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("redirection", ["2>&-", "0<&- 2>&-", pytest.param(f"2>{FULL}", marks=needs_full)])
def test_messages_that_cannot_be_printed_end_no_batch(redirection: str, folder: Path) -> None:
    done = run(folder, f"ingest scans -c c.sqlite --json {redirection}")
    assert done.returncode == 3, done
    answer = json.loads(done.stdout)["result"]
    assert answer["done"] == ["egg"]
    assert [failure["id"] for failure in answer["failed"]] == ["flat"]


def test_results_that_nobody_wants_end_no_batch(folder: Path) -> None:
    done = run(folder, "ingest scans -c c.sqlite --json >&-")
    assert done.returncode == 3, done
    assert "1 done, 1 failed" in done.stderr
    assert "Traceback" not in done.stderr


@needs_full
def test_results_that_cannot_be_printed_are_an_error(folder: Path) -> None:
    done = run(folder, f"options >{FULL}")
    assert done.returncode == 1
    assert done.stderr == (
        "Error: cannot print the result: No space left on device; print it to another place\n"
    )
