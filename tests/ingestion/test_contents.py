"""Files are hashed in the background, once: one that hangs holds up no other, and changes are noticed."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapes
from benchmarks.simulation import write_ply
from processes import in_this_process

import pcretrieve as pr
from pcretrieve.errors import StageTimeout
from pcretrieve.formats import ScanPath, write_mesh
from pcretrieve.formats.identity import content_hash, file_hash
from pcretrieve.ingestion import plan

Ingested = Callable[..., tuple[list[str], list[str]]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scans = tmp_path / "scans"
    scans.mkdir()
    for number in range(3):
        write_mesh(
            shapes.ellipsoid((1, 1, 1.5 + number), subdivisions=2),
            scans / f"{number}.off",
        )
    return scans


def test_a_file_that_cannot_be_read_holds_up_no_other(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though it is asked for last, and every thread hangs, as at a network that is not connected."""
    files = {path.name: ScanPath(path) for path in sorted(folder.iterdir())}
    hanging, connected = ("0.off", "1.off"), threading.Event()
    monkeypatch.setattr(
        plan,
        "file_hash",
        lambda file, _: connected.wait() if file.name in hanging else file_hash(file),
    )
    contents = plan.Contents(files, 1, 1)
    contents.expect(files)
    assert contents.of("2.off") == content_hash(files["2.off"])
    for name in hanging:
        late = contents.of(name)
        assert isinstance(late, StageTimeout)
        assert (
            str(late) == f"[read] {files[name]} was not read within 1 s: raise --timeout"
        )
    connected.set()


# --- stamps ---------------------------------------------------------------------------------------------


@pytest.fixture
def ingested(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Ingested:
    """Ingests the folder, and gives the names of the files that were hashed, and the ids of the processed."""
    hashed: list[str] = []

    def noted(file: ScanPath, *_: object) -> str:
        hashed.append(file.name)
        return file_hash(file)

    monkeypatch.setattr(plan, "file_hash", noted)
    # Files of this test are as good as old ones, unless they are dated into the future.
    monkeypatch.setattr(plan, "SETTLED", 0.0)

    def ingest(*, settle: bool = True, **options: object) -> tuple[list[str], list[str]]:
        if settle:
            time.sleep(0.05)  # times of files are those of the last tick of the clock
        hashed.clear()
        path = folder.with_name("c.sqlite")
        done = pr.ingest(folder, path, executor=in_this_process, **options).done  # type: ignore[arg-type]
        return sorted(hashed), sorted(record.id for record in done)

    return ingest


def test_what_has_not_changed_is_hashed_once(folder: Path, ingested: Ingested) -> None:
    assert ingested() == (["0.off", "1.off", "2.off"], ["0", "1", "2"])
    assert ingested() == ([], [])
    write_mesh(shapes.icosphere(2), folder / "new.off")
    assert ingested() == (["new.off"], ["new"])
    assert ingested() == ([], [])
    assert ingested(dry_run=True) == ([], [])


def test_a_change_is_noticed_though_size_and_time_are_put_back(
    folder: Path, ingested: Ingested
) -> None:
    ingested()
    path = folder / "1.off"
    before, text = path.stat(), path.read_text()
    path.write_text(text[:-2] + ("1" if text[-2] != "1" else "2") + "\n")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    for known in ("st_size", "st_mtime_ns", "st_ino"):
        assert getattr(path.stat(), known) == getattr(before, known)
    assert ingested()[0] == ["1.off"]


def test_a_file_that_may_change_again_at_the_same_time_has_no_stamp(
    folder: Path, ingested: Ingested, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "SETTLED", 3600.0)
    for _ in range(2):
        assert ingested(settle=False)[0] == ["0.off", "1.off", "2.off"]
    with pr.Catalogue(folder.with_name("c.sqlite")) as store:
        assert {record.stamp for record in store.records()} == {None}
    monkeypatch.setattr(plan, "SETTLED", 0.0)
    later = time.time() + 3600
    os.utime(folder / "0.off", (later, later))
    assert ingested() == (["0.off", "1.off", "2.off"], [])
    assert ingested() == (["0.off"], [])


def test_a_file_that_is_cut_off_while_it_is_read_is_read_again(
    folder: Path, ingested: Ingested, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a network that breaks off: what was read is neither of the two contents for certain."""
    whole = (folder / "1.off").read_bytes()

    def cut(file: ScanPath, *_: object) -> str:
        if file.name == "1.off":
            file.file.write_bytes(whole[:1000])
        return file_hash(file)

    monkeypatch.setattr(plan, "file_hash", cut)
    assert ingested()[1] == ["0", "2"]
    monkeypatch.setattr(plan, "file_hash", file_hash)
    (folder / "1.off").write_bytes(whole)
    assert ingested()[1] == ["1"]


def test_a_view_of_a_conf_file_is_a_part_of_it(tmp_path: Path) -> None:
    """The stamp of a file has those of the files that it names."""
    for name in ("a", "b"):
        write_ply(tmp_path / f"{name}.ply", np.eye(3))
    conf = tmp_path / "two.conf"
    conf.write_text("bmesh a.ply 0 0 0 0 0 0 1\nbmesh b.ply 0 0 0 0 0 0 1\n")
    before, again = plan.stamp_of(ScanPath(conf)), plan.stamp_of(ScanPath(conf))
    assert before is not None
    assert before == again
    assert before.text.count(";") == 2
    (tmp_path / "b.ply").touch()
    assert plan.stamp_of(ScanPath(conf)) != before
    (tmp_path / "b.ply").unlink()
    assert plan.stamp_of(ScanPath(conf)) is None
