"""`ingest`, `status` and `watch`: what they say while they work, and afterwards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import shapes
from click.testing import Result
from commands import result, run
from processes import in_this_process, living, wait_for

import pcretrieve as pr
from pcretrieve.errors import InputError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.run import Arrivals

N_BAD = 3
PATIENCE = 60  # seconds


def egg(path: Path, length: float) -> Path:
    write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), path)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two eggs, one of them twice, and some empty files with different names."""
    (tmp_path / "scans").mkdir()
    for name, length in (("a", 1.5), ("b", 2.0), ("copy", 2.0)):
        egg(tmp_path / "scans" / f"{name}.off", length)
    for number in range(N_BAD):
        (tmp_path / "scans" / f"bad-{number}.off").write_text(f"OFF {number}\n")
    return tmp_path


def ingest(folder: Path, *options: object, code: int | None = None) -> Result:
    return run(
        "ingest",
        folder / "scans",
        "-c",
        folder / "c.sqlite",
        "--workers",
        1,
        *options,
        code=code,
    )


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- ingest ---------------------------------------------------------------------------------------------


def test_a_dry_run_says_what_would_be_done_and_writes_nothing(folder: Path) -> None:
    before = files(folder)
    # Of another ingest, which has only begun.
    empty = folder.parent / "empty.sqlite"
    empty.touch()
    options = ("--dry-run", "--json", "-c", empty)
    assert json.loads(ingest(folder, *options, code=0).stdout)["result"]["planned"]
    assert not empty.stat().st_size
    done = ingest(folder, "--dry-run", "--json", code=0)
    assert files(folder) == before
    answer = json.loads(done.stdout)["result"]
    bad = [f"bad-{number}" for number in range(N_BAD)]
    assert (answer["planned"], answer["done"]) == (["a", "b", *bad], [])
    assert [Path(duplicate["path"]).name for duplicate in answer["duplicates"]] == [
        "copy.off"
    ]
    assert "5 to process, 0 failed, 0 known already, 1 duplicates" in done.stderr
    # With a catalogue, it knows what that has: `test_orders`.
    failures = [
        line
        for line in ingest(folder).stderr.splitlines()
        if line.startswith("failed: [")
    ]
    assert [line.split()[1] for line in failures] == [f"[{name}" for name in bad], (
        "one message each"
    )
    answer = json.loads(ingest(folder, "--dry-run", "--json", "--retry-failed").stdout)[
        "result"
    ]
    assert (answer["planned"], answer["held"]) == (bad, ["a", "b"])


def test_after_so_many_failures_the_ingest_stops_and_can_be_continued(
    folder: Path,
) -> None:
    log = folder / "night.log"
    stopped = ingest(folder, "--max-failures", 2, "--log-file", log, code=1)
    assert (
        "stopped after 2 scans that failed, which is the limit (--max-failures)"
        in str(stopped.exception)
    )
    with pr.Catalogue(folder / "c.sqlite") as catalogue:
        assert len(catalogue.records(status="failed")) == 2
    progress = ingest(
        folder, "--max-failures", 2, "--progress", "json", "--quiet", code=3
    )
    # Progress in JSON is one line for each scan, and the log has each stage of each scan.
    lines = [json.loads(line) for line in progress.stderr.splitlines()]
    assert [line["finished"] for line in lines] == list(range(1, 7))
    assert lines[-1]["failures"] == N_BAD
    assert {line["total"] for line in lines} == {6}
    by_id = {line["id"]: line for line in lines}
    assert by_id["a"]["status"] == "done"
    assert by_id["a"]["seconds"] > 0
    assert (by_id["bad-0"]["status"], by_id["bad-0"]["stage"]) == ("failed", "read")
    text = log.read_text()
    assert "INFO pcretrieve.pipeline: b.off: spectrum in " in text
    assert "INFO pcretrieve.ingestion.run: failed: [bad-1 / read]" in text


# --- status -----------------------------------------------------------------------------------


def test_the_status_of_an_ingest_and_a_retry_of_its_failures(folder: Path) -> None:
    catalogue = folder / "c.sqlite"
    pr.Catalogue(catalogue, create=True).close()
    assert pr.status(catalogue).state == "none"
    assert "no ingest into it is known" in run("status", "-c", catalogue).stdout
    for seconds, state in ((0, "running"), (4000, "killed"), (-1e30, "none")):
        counts = {
            "state": "running",
            "updated": time.time() - seconds,
            "computer": "another",
        }
        with pr.Catalogue(catalogue) as store, store.rows.database.writing():
            store.rows.keep_setting("batch", json.dumps(counts))
        assert pr.status(catalogue).state == state
    counts = {
        "n_scans": 10,
        "n_done": 1,
        "n_failed": 1,
        "n_known": 3,
        "n_duplicates": 1,
        "n_processed": 2,
        "started": time.time() - 10,
    }
    with pr.Catalogue(catalogue) as store, store.rows.database.writing():
        known = {"state": "running", "updated": time.time(), "computer": "another"}
        store.rows.keep_setting("batch", json.dumps(known | counts))
    # Two scans in 10 s, and four are left.
    assert pr.status(catalogue).seconds_left == pytest.approx(20, rel=0.1)
    ingest(folder)
    found = pr.status(catalogue)
    assert (found.state, found.n_scans, found.n_done, found.n_failed) == (
        "finished",
        6,
        2,
        N_BAD,
    )
    assert (found.n_shapes, found.failures, found.seconds_left) == (
        2,
        {"ScanReadError in read": N_BAD},
        None,
    )
    assert found.scans_per_second > 0 and sum(found.stages.values()) == pytest.approx(1)
    assert {"read", "spectrum"} <= found.stages.keys()
    assert result("status", "-c", catalogue)["stages"] == found.stages
    assert (
        pr.backup(catalogue, folder / "d.sqlite")
        and pr.status(folder / "d.sqlite").state == "none"
    )
    said = run("status", "-c", catalogue).stdout
    assert f"ingest finished: 6 of 6 scans: 2 done, {N_BAD} failed" in said
    assert f"2 shapes, {N_BAD} failed\n" in said
    table = [line.split() for line in said.splitlines()[-2:]]
    assert table == [["NUMBER", "FAILURE"], [str(N_BAD), "ScanReadError", "in", "read"]]
    with pytest.raises(
        InputError, match="failed in the stage surface; stages with failures: read"
    ):
        pr.retry(catalogue, stage="surface")
    again = pr.retry(catalogue, stage="read", executor=in_this_process)
    assert {record.id for record in again.failed} == {
        f"bad-{number}" for number in range(N_BAD)
    }


@pytest.mark.slow
def test_a_running_ingest_and_one_that_was_killed(tmp_path: Path) -> None:
    catalogue, n_scans = tmp_path / "c.sqlite", 8
    (tmp_path / "scans").mkdir()
    for number in range(n_scans):
        body = shapes.ellipsoid((1, 1, 1.5 + number / 5), subdivisions=4)
        write_mesh(body, tmp_path / "scans" / f"{number}.off")
    words = ("ingest", tmp_path / "scans", "-c", catalogue, "--workers", 1)
    command = [sys.executable, "-m", "pcretrieve", *map(str, words)]
    with subprocess.Popen(
        command, stderr=subprocess.DEVNULL, start_new_session=True
    ) as running:
        try:
            # The file is empty for a moment before it is a catalogue.
            assert wait_for(
                lambda: run("status", "-c", catalogue, code=None).exit_code == 0
            )
            assert wait_for(lambda: result("status", "-c", catalogue)["n_shapes"] > 0)
            found = result("status", "-c", catalogue)
            assert (found["state"], found["n_scans"]) == ("running", n_scans)
        finally:
            os.killpg(running.pid, signal.SIGKILL)
    assert pr.status(catalogue).state == "killed"
    assert (
        "the same command of ingest goes on from there"
        in run("status", "-c", catalogue).stdout
    )
    run(*words)
    found = result("status", "-c", catalogue)
    assert (found["state"], found["n_shapes"]) == ("finished", n_scans)
    assert found["n_known"] > 0


def test_status_and_ingest_have_the_same_counts(folder: Path) -> None:
    """Also of an ingest that finds its scans known, and failed, already."""
    for counts in ("2 done, 3 failed, 0 known", "0 done, 3 failed, 2 known"):
        counts += " already, 1 duplicates"
        assert counts in ingest(folder).stderr
        said = run("status", "-c", folder / "c.sqlite").stdout
        assert f"ingest finished: 6 of 6 scans: {counts}\n" in said


# --- watch ----------------------------------------------------------------------------------------------


def test_a_file_arrives_when_it_has_stopped_growing(tmp_path: Path) -> None:
    place = tmp_path / "net"
    place.mkdir()
    whole = egg(place / "a.off", 2).read_bytes()
    arrivals = Arrivals(place)
    assert [arrivals.look(), arrivals.look(), arrivals.look()] == [
        [],
        [place / "a.off"],
        [],
    ]
    with (place / "b.off").open("wb") as growing:
        for start in range(0, len(whole), len(whole) // 3):
            growing.write(whole[start : start + len(whole) // 3])
            growing.flush()
            assert arrivals.look() == []
    assert arrivals.look() == [place / "b.off"]
    # A folder that is away for a while brings nothing again.
    place.rename(tmp_path / "away")
    assert arrivals.look() == []
    with pytest.raises(pr.InputError, match="there is no folder"):
        Arrivals(place)
    (tmp_path / "away").rename(place)
    assert [arrivals.look(), arrivals.look()] == [[], []]


def test_a_scan_of_several_files_arrives_with_the_last_of_its_views(
    tmp_path: Path,
) -> None:
    conf = tmp_path / "bun.conf"
    conf.write_text("bmesh front.off 0 0 0 0 0 0 1\nbmesh back.off 0 0 0 0 0 0 1\n")
    arrivals = Arrivals(tmp_path)
    for name, found in (
        ("front", [[], [], []]),
        ("back", [[], [conf], []]),
        ("front", [[], [conf], []]),
    ):
        egg(tmp_path / f"{name}.off", 2 + len(found[1]) + (name == "front"))
        assert [arrivals.look(), arrivals.look(), arrivals.look()] == found


@pytest.mark.slow
def test_scans_that_arrive_are_ingested_until_ctrl_c(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    egg(tmp_path / "scans" / "early.off", 1.5)
    location = tmp_path / "c.sqlite"

    def done() -> set[str]:
        try:
            with pr.Catalogue(location) as catalogue:
                return {record.id for record in catalogue.records(status="done")}
        except pr.CatalogueError:  # it is being created
            return set()

    command = [
        *(sys.executable, "-m", "pcretrieve", "watch", tmp_path / "scans", "-c", location)
    ]
    command += ["--interval", "0.5", "--workers", "1"]
    with subprocess.Popen(
        [*map(str, command)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=tmp_path,
    ) as running:
        try:
            assert wait_for(lambda: done() == {"early"})
            egg(tmp_path / "scans" / "late.off", 2)
            (tmp_path / "scans" / "bad.off").write_text("OFF\n")
            assert wait_for(lambda: done() == {"early", "late"})
            os.killpg(running.pid, signal.SIGINT)  # as a terminal does
            _, said = running.communicate(timeout=PATIENCE)
        finally:
            running.kill()
    assert running.returncode == 130
    assert "Traceback" not in said
    assert f"done: [late] {Path('scans', 'late.off')}\n" in said
    assert (
        f"stopped; 2 shapes are in {location}, and the same command goes on from there"
        in said
    )
    assert wait_for(lambda: not living(running.pid))
