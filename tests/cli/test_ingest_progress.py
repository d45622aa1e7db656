"""What `ingest` says while it works, what it would do, and when it stops by itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import Catalogue
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh

N_BAD = 3


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two eggs, one of them twice, and some empty files with different names."""
    (tmp_path / "scans").mkdir()
    for name, length in (("a", 1.5), ("b", 2.0), ("copy", 2.0)):
        write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), tmp_path / "scans" / f"{name}.off")
    for number in range(N_BAD):
        (tmp_path / "scans" / f"bad-{number}.off").write_text(f"OFF {number}\n")
    return tmp_path


def ingest(folder: Path, *options: str) -> Result:
    named = ["ingest", str(folder / "scans"), "-c", str(folder / "c.sqlite"), "--workers", "1", *options]
    return CliRunner().invoke(cli, named)


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_dry_run_says_what_would_be_done_and_writes_nothing(folder: Path) -> None:
    before = files(folder)
    done = ingest(folder, "--dry-run", "--json")
    assert files(folder) == before
    answer = json.loads(done.stdout)["result"]
    assert answer["planned"] == ["a", "b", *(f"bad-{number}" for number in range(N_BAD))]
    assert [Path(duplicate["path"]).name for duplicate in answer["duplicates"]] == ["copy.off"]
    assert (done.exit_code, answer["done"]) == (0, [])
    assert "5 to process, 0 failed, 0 held already, 1 duplicates" in done.stderr


def test_a_dry_run_knows_what_the_catalogue_has(folder: Path) -> None:
    ingest(folder)
    before = files(folder)
    answer = json.loads(ingest(folder, "--dry-run", "--json").stdout)["result"]
    assert (answer["planned"], answer["held"]) == ([], ["a", "b"])
    again = ingest(folder, "--dry-run", "--json", "--retry-failed")
    assert json.loads(again.stdout)["result"]["planned"] == [f"bad-{number}" for number in range(N_BAD)]
    assert files(folder) == before
    write_mesh(shapes.icosphere(2), folder / "scans" / "new.off")
    (folder / "scans" / "a.off").unlink()
    (folder / "scans" / "a.off").symlink_to(folder / "nowhere.off")
    unreadable = ingest(folder, "--dry-run", "--json")
    answer = json.loads(unreadable.stdout)["result"]
    assert (unreadable.exit_code, answer["planned"]) == (3, ["new"])
    assert answer["failed"][0]["id"] == "a"


def test_after_so_many_failures_the_ingest_stops_and_can_be_continued(folder: Path) -> None:
    stopped = ingest(folder, "--max-failures", "2")
    assert stopped.exit_code == 1
    assert "stopped after 2 scans that failed, which is the limit (--max-failures)" in str(stopped.exception)
    with Catalogue(folder / "c.sqlite") as catalogue:
        assert len(catalogue.records(status="failed")) == 2
    continued = ingest(folder, "--max-failures", "2")
    assert continued.exit_code == 3
    with Catalogue(folder / "c.sqlite") as catalogue:
        assert len(catalogue.records(status="failed")) == N_BAD
        assert [record.id for record in catalogue.records(status="done")] == ["a", "b"]


def test_progress_in_json_is_one_line_for_each_scan(folder: Path) -> None:
    done = ingest(folder, "--progress", "json", "--quiet")
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert [line["finished"] for line in lines] == list(range(1, 7))
    assert lines[-1]["failures"] == N_BAD
    assert {line["total"] for line in lines} == {6}
    by_id = {line["id"]: line for line in lines}
    assert by_id["a"]["status"] == "done"
    assert by_id["a"]["seconds"] > 0
    assert (by_id["bad-0"]["status"], by_id["bad-0"]["stage"]) == ("failed", "read")


def test_the_log_file_has_each_stage_of_each_scan(folder: Path) -> None:
    log = folder / "night.log"
    ingest(folder, "--quiet", "--log-file", str(log))
    text = log.read_text()
    for name in ("a.off", "b.off"):
        assert f"INFO pcretrieve.pipeline: {name}: spectrum in " in text
    assert "INFO pcretrieve.ingestion.run: failed: [bad-1 / read]" in text
    refused = ingest(folder, "--log-file", str(folder / "no" / "night.log"))
    assert "cannot write the log file" in str(refused.exception)
