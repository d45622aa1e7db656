"""What the stages of the pipeline log."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PipelineOptions
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
