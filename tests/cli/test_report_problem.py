"""`pcretrieve report-problem`: one file with what is needed, and nothing of the scan unless asked."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

import pcretrieve as pr
from pcretrieve.cli.main import cli
from pcretrieve.options import PipelineOptions


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in arguments])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A sheet, of which no closed surface can be made."""
    private = tmp_path / "Jane Doe"
    private.mkdir()
    (private / "sheet.xyz").write_text("".join(f"{i % 9} {i // 9} 0\n" for i in range(8)))
    monkeypatch.chdir(tmp_path)
    return private


def packed(path: Path) -> dict[str, str]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


def test_a_scan_that_fails_is_packed_without_its_points_and_its_folder(folder: Path) -> None:
    scan = folder / "sheet.xyz"
    result = run("report-problem", scan, "--unit", "cm")
    assert (result.exit_code, result.stdout) == (0, "sheet-problem.zip\n")
    files = packed(Path("sheet-problem.zip"))
    assert sorted(files) == ["log.txt", "options.toml", "problem.json"]
    found = json.loads(files["problem.json"])
    assert found["versions"]["pcretrieve"] == pr.__version__
    assert found["scan"]["name"] == "sheet.xyz"
    assert found["scan"]["bytes"] == scan.stat().st_size
    failure = found["failure"]
    assert f"failed in {failure['stage']}: {failure['message']}" in result.stderr
    assert "Jane Doe" not in "".join(files.values())
    Path("options.toml").write_text(files["options.toml"])
    assert PipelineOptions.from_toml("options.toml").scan.unit == "cm"


def test_the_scan_is_packed_when_asked_for(folder: Path) -> None:
    scan = folder / "sheet.xyz"
    assert run("report-problem", scan, "--with-scan", "-o", "p.zip").exit_code == 0
    assert packed(Path("p.zip"))["scan/sheet.xyz"] == scan.read_text()


def test_a_scan_that_ends_its_process_is_packed(folder: Path) -> None:
    """Even where nothing could be measured, there are the versions, the options and the error."""
    pr.write_mesh(shapes.icosphere(6), folder / "ball.off")
    result = run("report-problem", folder / "ball.off", "--timeout", 1, "--surface", "reconstruct")
    assert result.exit_code == 0
    found = json.loads(packed(Path("ball-problem.zip"))["problem.json"])
    assert found["failure"]["error"] == "StageTimeout"
