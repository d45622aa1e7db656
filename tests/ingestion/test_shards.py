"""Shards divide scans by their content, without gaps, overlaps, or reading what cannot be read."""

from __future__ import annotations

import os
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import shapes

from pcretrieve import Catalogue, ingest, merge_catalogues
from pcretrieve.catalogue.rows import Rows
from pcretrieve.errors import OptionError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.discover import scans_of

N_SHARDS = 3


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Nine different eggs, in two folders with files of the same names, and a copy of one of them."""
    folder = tmp_path / "scans"
    for number in range(9):
        path = folder / f"part{number % 2}" / f"egg{number // 2}.off"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_mesh(shapes.ellipsoid((1, 1, 1 + number / 9), subdivisions=3), path)
    shutil.copy(folder / "part0" / "egg1.off", folder / "zcopy.off")
    return folder


SHARDS = [f"{number}/{N_SHARDS}" for number in range(1, N_SHARDS + 1)]


def shard_of(scan: Path) -> str:
    (shard,) = (shard for shard in SHARDS if scans_of(shard, [scan]))
    return shard


def test_each_scan_is_in_one_shard_also_under_another_name(tmp_path: Path) -> None:
    """Also what cannot be read."""
    counts = dict.fromkeys(SHARDS, 0)
    for number in range(300):
        path, copy = tmp_path / f"{number}.glb", tmp_path / f"copy {number}.glb"
        path.write_text(f"{number} 0 0\n" * 1000 * (number % 3))
        shutil.copy(path, copy)
        assert shard_of(path) == shard_of(copy)
        assert shard_of(tmp_path / f"{path.name}#left") == shard_of(tmp_path / f"{copy.name}#left")
        counts[shard_of(path)] += 1
    assert min(counts.values()) > 30  # a third of the files are empty, and in one shard
    os.mkfifo(tmp_path / "pipe.ply")
    for path in (tmp_path / "pipe.ply", tmp_path / "nothing.ply", tmp_path, tmp_path / "zero\0byte.ply"):
        assert shard_of(path)
    for text in ("0/3", "4/3", "1/0", "1", "1/2/3", "-1/3", "a/b", "1/3 ", ""):
        with pytest.raises(OptionError, match="a shard must be I/N"):
            scans_of(text, [])


def test_shards_make_together_what_one_ingest_makes(folder: Path, tmp_path: Path) -> None:
    ingest(folder, tmp_path / "whole.sqlite", workers=1)
    with Catalogue(tmp_path / "whole.sqlite") as whole:
        expected = {record.id: (record.path, record.content_hash) for record in whole.records()}
    found: dict[str, tuple[str, str]] = {}
    for shard in SHARDS:
        part = tmp_path / f"part-{shard[0]}.sqlite"
        summary = ingest(folder, part, workers=1, shard=shard)
        with Catalogue(part) as store:
            records = store.records()
        assert len(summary.done) == len(records) < len(expected)
        assert not found.keys() & {record.id for record in records}
        found |= {record.id: (record.path, record.content_hash) for record in records}
    assert found == expected
    merge_catalogues(sorted(tmp_path.glob("part-*.sqlite")), tmp_path / "all.sqlite")
    assert everything(tmp_path / "all.sqlite") == everything(tmp_path / "whole.sqlite")


def everything(location: Path) -> list[object]:
    """All that a catalogue has, except for times."""
    with closing(Rows(location, {}, create=False)) as rows:
        found: list[object] = []
        for entry in rows.entries([origin.id for origin in rows.origins()]):
            steps = tuple(replace(step, seconds=0.0) for step in entry.record.steps)
            record = replace(entry.record, steps=steps, added="", stamp=None)
            found.append((record, dict(entry.signatures), dict(entry.payloads)))
        return found


def test_new_files_change_no_shard_and_changed_files_may(folder: Path, tmp_path: Path) -> None:
    for shard in SHARDS:
        ingest(folder, tmp_path / f"{shard[0]}.sqlite", workers=1, shard=shard)
    write_mesh(shapes.ellipsoid((1, 1, 2.5), subdivisions=3), folder / "new.off")
    write_mesh(shapes.ellipsoid((1, 1, 3), subdivisions=3), folder / "part0" / "egg0.off")
    paths: list[str] = []
    done = 0
    for shard in SHARDS:
        part = tmp_path / f"{shard[0]}.sqlite"
        done += len(ingest(folder, part, workers=1, shard=shard).done)
        with Catalogue(part) as store:
            paths += (record.path for record in store.records())
    assert done == 2
    assert sorted(paths) == sorted(str(path) for path in folder.rglob("*.off") if path.stem != "zcopy")


def test_shards_may_share_a_catalogue(folder: Path, tmp_path: Path) -> None:
    """A task leaves the shapes of the other tasks where they are."""
    for shard in SHARDS:
        ingest(folder, tmp_path / "shared.sqlite", workers=1, shard=shard)
    ingest(folder, tmp_path / "whole.sqlite", workers=1)
    assert everything(tmp_path / "shared.sqlite") == everything(tmp_path / "whole.sqlite")


def test_a_shard_may_have_no_scans(folder: Path, tmp_path: Path) -> None:
    alone = folder / "zcopy.off"
    empty = next(number for number in (1, 2) if not scans_of(f"{number}/2", [alone]))
    summary = ingest(alone, tmp_path / "part.sqlite", workers=1, shard=f"{empty}/2")
    assert summary.done == summary.failed == []
    with Catalogue(tmp_path / "part.sqlite") as part:
        assert part.records() == []
