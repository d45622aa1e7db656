"""`pcretrieve watch`: scans that arrive are ingested once they stop growing, and Ctrl-C ends it cleanly."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from processes import living, wait_for

from pcretrieve import Catalogue, CatalogueError, InputError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.run import Arrivals

PATIENCE = 60  # seconds


def egg(path: Path, length: float) -> Path:
    write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), path)
    return path


def done(location: Path) -> set[str]:
    try:
        with Catalogue(location) as catalogue:
            return {record.id for record in catalogue.records(status="done")}
    except CatalogueError:  # it is being created
        return set()


def test_a_file_arrives_when_it_has_stopped_growing(tmp_path: Path) -> None:
    whole = egg(tmp_path / "a.off", 2).read_bytes()
    arrivals = Arrivals(tmp_path)
    assert arrivals.look() == []
    assert arrivals.look() == [tmp_path / "a.off"]
    assert arrivals.look() == []
    with (tmp_path / "b.off").open("wb") as growing:
        for start in range(0, len(whole), len(whole) // 3):
            growing.write(whole[start : start + len(whole) // 3])
            growing.flush()
            assert arrivals.look() == []
    assert arrivals.look() == [tmp_path / "b.off"]


def test_a_scan_of_several_files_arrives_with_the_last_of_its_views(tmp_path: Path) -> None:
    (tmp_path / "bun.conf").write_text("bmesh front.off 0 0 0 0 0 0 1\nbmesh back.off 0 0 0 0 0 0 1\n")
    egg(tmp_path / "front.off", 2)
    arrivals = Arrivals(tmp_path)
    assert (arrivals.look(), arrivals.look()) == ([], [])
    egg(tmp_path / "back.off", 3)
    assert (arrivals.look(), arrivals.look(), arrivals.look()) == ([], [tmp_path / "bun.conf"], [])
    egg(tmp_path / "front.off", 4)
    assert (arrivals.look(), arrivals.look()) == ([], [tmp_path / "bun.conf"])


def test_a_folder_that_is_away_for_a_while_brings_nothing_again(tmp_path: Path) -> None:
    (tmp_path / "net").mkdir()
    egg(tmp_path / "net" / "a.off", 2)
    arrivals = Arrivals(tmp_path / "net")
    assert (arrivals.look(), arrivals.look()) == ([], [tmp_path / "net" / "a.off"])
    (tmp_path / "net").rename(tmp_path / "away")
    assert arrivals.look() == []
    (tmp_path / "away").rename(tmp_path / "net")
    assert (arrivals.look(), arrivals.look()) == ([], [])
    with pytest.raises(InputError, match="there is no folder"):
        Arrivals(tmp_path / "away")


@pytest.mark.slow
def test_scans_that_arrive_are_ingested_until_ctrl_c(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    egg(tmp_path / "scans" / "early.off", 1.5)
    location = tmp_path / "c.sqlite"
    command = [*(sys.executable, "-m", "pcretrieve", "watch", tmp_path / "scans", "-c", location)]
    options = [*("--interval", "0.5", "--workers", "1")]
    with subprocess.Popen(
        [*map(str, command), *options],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=tmp_path,
    ) as running:
        try:
            assert wait_for(lambda: done(location) == {"early"})
            egg(tmp_path / "scans" / "late.off", 2)
            (tmp_path / "scans" / "bad.off").write_text("OFF\n")
            assert wait_for(lambda: done(location) == {"early", "late"})
            os.killpg(running.pid, signal.SIGINT)  # as a terminal does
            _, said = running.communicate(timeout=PATIENCE)
        finally:
            running.kill()
    assert running.returncode == 130
    assert "Traceback" not in said
    assert f"done: [late] {Path('scans', 'late.off')}\n" in said
    assert f"stopped; 2 shapes are in {location}, and the same command goes on from there" in said
    assert wait_for(lambda: not living(running.pid))
