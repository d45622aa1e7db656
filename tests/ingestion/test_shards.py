"""Shards divide scans by their content, without gaps, overlaps, or reading what cannot be read."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import shapes

from pcretrieve import Catalogue, ingest, merge_catalogues
from pcretrieve.formats import write_mesh

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


@pytest.mark.slow
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
    with Catalogue(location) as store:
        found: list[object] = []
        for entry in store.entries([origin.id for origin in store.origins()]):
            steps = tuple(replace(step, seconds=0.0) for step in entry.record.steps)
            record = replace(entry.record, steps=steps, added="", stamp=None)
            found.append((record, dict(entry.signatures), dict(entry.payloads)))
        return found
