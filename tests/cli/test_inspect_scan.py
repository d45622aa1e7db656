"""The command `inspect`: a page for every scan, words for people, one document for programs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from PIL import Image

from pcretrieve.formats import write_mesh
from pcretrieve.simulation import write_ply

FEW_CELLS = "[surface]\ncell = 0.01\ntarget_faces = 3000\n"


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pcretrieve", "inspect", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("inspect")
    write_ply(place / "body.ply", shapes.points_on(shapes.body(), 8000))
    write_ply(place / "few.ply", shapes.points_on(shapes.body(), 50))
    write_mesh(shapes.body(3), place / "mesh.off")
    (place / "garbage.ply").write_bytes(b"\x00\xff" * 500)
    (place / "fast.toml").write_text(FEW_CELLS)
    (place / "folder.html").mkdir()
    return place


def test_json_holds_checks_and_numbers(folder: Path) -> None:
    arguments = (
        "body.ply",
        "-o",
        "page.html",
        "--png",
        "sheet.png",
        "--config",
        "fast.toml",
        "--rescans",
        "2",
    )
    result = run(*arguments, "--json", cwd=folder)
    assert result.returncode == 0
    answer = json.loads(result.stdout)["result"]
    assert answer["page"] == str((folder / "page.html").resolve())
    assert answer["failure"] is None
    judgement = answer["shape_verdict"]["judgement"]
    assert (answer["verdict"], judgement) in (("passed", "sound"), ("look", "doubtful"))
    assert answer["shape_verdict"]["uncertainty"] >= answer["spread"]
    assert answer["next_body"]["distance"] == 0.5
    assert {"Points", "Normals", "Handles", "Signature"} <= {check["name"] for check in answer["checks"]}
    for check in answer["checks"]:
        assert f"{check['verdict']:<6}  {check['name']}" in result.stderr
    assert len(answer["signature"]) == len(answer["rescan_deviation"]) == 118
    assert "deviation" not in answer, "that is over the surfaces of one scan"
    assert answer["spread"] ** 2 == pytest.approx(sum(part**2 for part in answer["rescan_deviation"]))
    assert [step["stage"] for step in answer["steps"]][:3] == ["read", "crop", "clean"]
    with Image.open(folder / "sheet.png") as sheet:
        assert sheet.format == "PNG" and sheet.width > 1000


@pytest.mark.parametrize(("scan", "stage"), [("garbage.ply", "read"), ("few.ply", "crop")])
def test_a_scan_that_fails_gets_its_page(scan: str, stage: str, folder: Path) -> None:
    result = run(scan, "--json", cwd=folder)
    assert result.returncode == 3
    answer = json.loads(result.stdout)["result"]
    assert answer["failure"]["stage"] == stage
    assert answer["signature"] is answer["rescan_deviation"] is answer["spread"] is None
    assert f"the {stage} stage failed" in Path(answer["page"]).read_text(encoding="utf-8")
    assert f"the {stage} stage failed" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("nowhere.ply", 1, "there is no file or folder nowhere.ply"),
        ("folder.html", 2, "name a folder for the pages of the scans"),
        ("few.ply -o nowhere/page.html", 1, "there is no folder nowhere"),
        ("few.ply -o folder.html", 1, "is a folder"),
        ("few.ply --png few.ply", 1, "is one of the files to be read"),
        ("few.ply --rescans -1", 2, "--rescans"),
        ("few.ply --rescans 1", 2, "at least 2 rescans, got 1"),
        ("few.ply --config nowhere.toml", 2, "nowhere.toml"),
    ],
)
def test_what_cannot_be_done_says_why_and_leaves_nothing(
    arguments: str, code: int, words: str, folder: Path
) -> None:
    before = sorted(folder.iterdir())
    result = run(*arguments.split(), cwd=folder)
    assert result.returncode == code
    assert words in result.stderr and "Traceback" not in result.stderr
    assert sorted(folder.iterdir()) == before
