"""An interrupted ingest loses no results, and can be continued."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import shapes

from pcretrieve import Catalogue
from pcretrieve.formats import write_mesh
from pcretrieve.values import TriangleMesh

N_SHAPES = 12
PATIENCE = 60  # seconds


def command(folder: Path) -> list[str]:
    return [
        *(sys.executable, "-m", "pcretrieve", "ingest", str(folder)),
        *("--catalogue", str(folder / "c.sqlite"), "--workers", "1", "--json"),
    ]


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished_and_the_same_command_goes_on(tmp_path: Path) -> None:
    for number in range(N_SHAPES):
        ball = shapes.icosphere(4)
        write_mesh(
            TriangleMesh(ball.vertices * [1, 1, 1 + number / 5], ball.faces), tmp_path / f"{number}.off"
        )
    running = subprocess.Popen(command(tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    started = time.monotonic()
    n_stored = 0
    while not n_stored and time.monotonic() < started + PATIENCE:
        time.sleep(0.05)
        if (tmp_path / "c.sqlite-wal").exists():
            with Catalogue(tmp_path / "c.sqlite") as reader:  # readable while it is being written
                n_stored = len(reader)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=PATIENCE)
    assert running.returncode == 130
    assert b"the same command goes on from there" in said
    with Catalogue(tmp_path / "c.sqlite") as catalogue:
        kept = {record.id for record in catalogue.records()}
    assert 0 < len(kept) < N_SHAPES

    answer = json.loads(subprocess.run(command(tmp_path), capture_output=True, check=True).stdout)["result"]
    assert set(answer["held"]) == kept
    assert len(answer["done"]) == N_SHAPES - len(kept)
    again = json.loads(subprocess.run(command(tmp_path), capture_output=True, check=True).stdout)["result"]
    assert (len(again["held"]), again["done"]) == (N_SHAPES, [])
