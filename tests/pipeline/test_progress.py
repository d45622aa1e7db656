"""What the stages of the pipeline log."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PipelineOptions, TriangleMesh
from pcretrieve.formats import write_mesh
from pcretrieve.pipeline.process import process

LOGGER = "pcretrieve.pipeline"


def test_each_stage_is_logged_once_with_its_repairs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scan = tmp_path / "body.xyz"
    np.savetxt(scan, [*shapes.points_on(shapes.body(), 8000), [300.0, 0, 0]])
    with caplog.at_level(logging.INFO, logger=LOGGER):
        shape = process(scan, PipelineOptions())
    records = [record for record in caplog.records if record.name == LOGGER]
    stages = [record.getMessage().split()[1] for record in records if record.levelno == logging.INFO]
    assert stages == [step.stage for step in shape.provenance]
    assert stages[-4:] == ["surface", "surface", "spectrum", "checks"]
    repairs = [record.getMessage() for record in records if record.levelno == logging.WARNING]
    assert repairs == [f"body.xyz: {step.stage}: {note}" for step in shape.provenance for note in step.notes]
    assert any("dropped 1 of 8001 points more than 20 median distances" in repair for repair in repairs)


def test_the_command_line_and_programs_without_logging_stay_quiet(tmp_path: Path) -> None:
    body = shapes.body(3)
    scan = tmp_path / "body.off"
    write_mesh(TriangleMesh(body.vertices, body.faces[:, ::-1]), scan)
    assert any(step.notes for step in process(scan).provenance)
    program = f"import pcretrieve; pcretrieve.reconstruct({str(scan)!r})"
    for arguments in (("-c", program), ("-m", "pcretrieve", "signature", "--json", str(scan))):
        done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=True)
        assert "topology" not in done.stderr


def test_compilation_is_announced_once() -> None:
    program = """
import logging
import numba
from pcretrieve.pipeline.progress import announce_compilation

logging.basicConfig(level=logging.INFO, format="%(name)s %(message)s")
announce_compilation()
announce_compilation()
for added in (1, 2):
    print("compiles", flush=True)
    numba.njit(lambda x: x + added)(1)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.count("compiles") == 2
    (line,) = run.stderr.splitlines()
    assert line.startswith("pcretrieve.compilation compiling, once")
