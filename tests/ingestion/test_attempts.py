"""What is changed when a scan that failed is tried again, and what the catalogue says of it."""

from __future__ import annotations

from pathlib import Path

import pytest
import shapes
from packages import install

from pcretrieve import Catalogue, ingest
from pcretrieve.formats import write_mesh

# A reader whose process ends at the first attempts: as often as the name of the file says. Each attempt of an
# ingest is in up to two processes, because the executor tries a scan again whose worker has ended.
READER = """
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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    entry = "[pcretrieve.readers]\n.frail = frail:read\n"
    install(tmp_path / "site", "frail", {"frail": READER}, entry, monkeypatch)
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "egg.off")
    return tmp_path


@pytest.mark.slow
def test_a_retry_stores_the_shape_and_says_what_was_changed(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for n_failing in (2, 4, 9):
        (folder / f"egg-{n_failing}.frail").write_text(f"content {n_failing}")
    summary = ingest([folder / "*.frail"], folder / "c.sqlite", retries=2, workers=2)
    assert [(record.id, record.message) for record in summary.failed if record.id != "egg-9"] == []
    assert sorted(record.id for record in summary.done) == ["egg-2", "egg-4"]
    with Catalogue(folder / "c.sqlite") as catalogue:
        tried = {record.id: record.steps[-1] for record in catalogue.records()}
    assert {name: step.stage for name, step in tried.items()} == dict.fromkeys(tried, "retry")
    assert {name: step.sizes["attempts"] for name, step in tried.items()} == {
        "egg-2": 2,
        "egg-4": 3,
        "egg-9": 3,
    }
    first, second = tried["egg-4"].notes
    assert "exit code 7" in first
    assert first.endswith("tried again in a new process")
    assert second.endswith(
        "surface.reconstructions = 1 instead of 2, with surface.cell = 0.006 instead of auto"
    )
    assert sum("egg-4.frail: WorkerDied" in message for message in caplog.messages) == 2
    assert (folder / "egg-9.tally").exists()
