"""`pcretrieve status` and `pcretrieve retry`, while an ingest runs and afterwards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import shapes
from click.testing import CliRunner, Result
from processes import wait_for

import pcretrieve as pr
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh

N_SHAPES = 8


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Some eggs, and a file that cannot be read."""
    (tmp_path / "scans").mkdir()
    for number in range(N_SHAPES):
        egg = shapes.ellipsoid((1, 1, 1.5 + number / 5), subdivisions=4)
        write_mesh(egg, tmp_path / "scans" / f"{number}.off")
    (tmp_path / "scans" / "bad.off").write_text("OFF\n")
    return tmp_path


def ingest(folder: Path) -> list[str]:
    return [*("ingest", str(folder / "scans"), "-c", str(folder / "c.sqlite"), "--workers", "1")]


def document(folder: Path) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(run("status", folder / "c.sqlite", "--json").stdout)["result"]
    return answer


def test_a_finished_ingest(folder: Path) -> None:
    run(*ingest(folder))
    found = pr.status(folder / "c.sqlite")
    assert (found.state, found.n_scans, found.n_done, found.n_failed) == (
        "finished",
        N_SHAPES + 1,
        N_SHAPES,
        1,
    )
    assert (found.n_shapes, found.failures, found.seconds_left) == (
        N_SHAPES,
        {"ScanReadError in read": 1},
        None,
    )
    assert found.scans_per_second > 0
    assert sum(found.stages.values()) == pytest.approx(1)
    assert {"read", "spectrum"} <= found.stages.keys()
    assert document(folder)["stages"] == found.stages
    said = run("status", folder / "c.sqlite").stdout
    assert f"ingest finished: {N_SHAPES + 1} of {N_SHAPES + 1} scans: {N_SHAPES} done, 1 failed" in said
    assert f"{N_SHAPES} shapes, 1 failed\n" in said
    assert [line.split() for line in said.splitlines()[-2:]] == [
        ["NUMBER", "FAILURE"],
        ["1", "ScanReadError", "in", "read"],
    ]


@pytest.mark.slow
def test_a_running_ingest_and_one_that_was_killed(folder: Path) -> None:
    command = [sys.executable, "-m", "pcretrieve", *ingest(folder)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True) as running:
        try:
            # The file is empty for a moment before it is a catalogue.
            assert wait_for(lambda: run("status", folder / "c.sqlite").exit_code == 0)
            assert wait_for(lambda: document(folder)["n_shapes"] > 0)
            found = document(folder)
            assert found["state"] == "running"
            assert found["n_scans"] == N_SHAPES + 1
        finally:
            os.killpg(running.pid, signal.SIGKILL)
    assert pr.status(folder / "c.sqlite").state == "killed"
    assert "the same command of ingest goes on from there" in run("status", folder / "c.sqlite").stdout
    run(*ingest(folder))
    found = document(folder)
    assert (found["state"], found["n_shapes"]) == ("finished", N_SHAPES)
    assert found["n_skipped"] > 0


def test_a_catalogue_without_a_known_ingest(folder: Path) -> None:
    pr.Catalogue(folder / "c.sqlite", create=True).close()
    assert pr.status(folder / "c.sqlite").state == "none"
    assert "no ingest into it is known" in run("status", folder / "c.sqlite").stdout
    (folder / ".c.sqlite.batch").write_text("{}, or so")
    assert pr.status(folder / "c.sqlite").state == "none"


def test_failures_of_a_stage_are_processed_again(folder: Path) -> None:
    run(*ingest(folder))
    refused = run("retry", folder / "c.sqlite", "--stage", "surface")
    assert "failed in the stage surface; stages with failures: read" in str(refused.exception)
    again = run("retry", folder / "c.sqlite", "--stage", "read", "--json")
    assert (again.exit_code, json.loads(again.stdout)["result"]["failed"][0]["id"]) == (3, "bad")
    write_mesh(shapes.ellipsoid((1, 2, 3), subdivisions=3), folder / "scans" / "bad.off")
    mended = run("retry", folder / "c.sqlite", "--json")
    assert (mended.exit_code, json.loads(mended.stdout)["result"]["done"]) == (0, ["bad"])
    with pytest.raises(pr.InputError, match=r"no shape of .* failed"):
        pr.retry(folder / "c.sqlite")
