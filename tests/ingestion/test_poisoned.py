"""Numbers that no scanner measured: each scan has a signature or a clear error, and none harms another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import poisoned_files
import pytest

from pcretrieve import Catalogue, PipelineOptions, ingest, reconstruct, signature
from pcretrieve.errors import ReconstructionError
from pcretrieve.ingestion.discover import discover

POINTS = poisoned_files.POINTS

# Good scans by the first letter of their names, which come first and last in a folder, and how their points
# are ordered: two files of one content would be stored once.
ORDERS = {"a": slice(None), "z": slice(None, None, -1)}


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    """The signature of the body that the poisoned files are made of."""
    return signature(POINTS).values


def test_a_batch_stores_every_good_scan_beside_poisoned_ones(values: np.ndarray, tmp_path: Path) -> None:
    """No native code may crash, no fault may be left unexplained, and the batch may not end early."""
    scans = tmp_path / "scans"
    scans.mkdir()
    good = {f"{when}_good": poisoned_files.doubles(POINTS[order]) for when, order in ORDERS.items()}
    poisoned_files.write(scans, good | poisoned_files.SAME_BODY | poisoned_files.GARBAGE)
    with Catalogue(tmp_path / "c.sqlite", create=True) as catalogue:
        summary = ingest(discover([scans]), catalogue)
        table = catalogue.signatures()
    failed = {record.id: record for record in summary.failed}
    assert {record.id for record in summary.done} | set(failed) == {
        *good,
        *poisoned_files.SAME_BODY,
        *poisoned_files.GARBAGE,
    }
    assert set(failed) <= set(poisoned_files.GARBAGE)
    for record in failed.values():
        assert record.error in {"ScanReadError", "ReconstructionError", "DegenerateMeshError"}, record
    for name in (*good, *poisoned_files.SAME_BODY):
        found = table.values[table.ids.index(name)]
        np.testing.assert_allclose(np.log(found), np.log(values), atol=0.02, err_msg=name)


def test_points_that_single_precision_merges_are_refused() -> None:
    """A tenth of the points so far away that all others coincide, and no thinning that drops them first."""
    options = PipelineOptions().changed(scan={"voxel": 0.0})
    with pytest.raises(ReconstructionError, match="at least 100 points must be distinct in single precision"):
        reconstruct(poisoned_files.far_and_near(0.1), options)
